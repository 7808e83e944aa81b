"""Every device function has a law, and a law fails where its function is wrong."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import import_module

import pytest
from device import open_device
from laws import LAWS
from test_sources import shared_code

from gpuspec.light.sources import folder

for file in (
    "footprint", "image", "noise_form", "portable", "pose", "reflection", "relief_on_devices",
    "scan", "sensor", "slices", "stripes", "surface",
):  # fmt: skip
    import_module(f"test_{file}")  # where the laws stand


def test_every_device_function_has_a_law_here() -> None:
    pattern = re.compile(r"^DEVICE\s+\w+\s+(\w+)\(", re.MULTILINE)
    # Another light than stripes is held to integrals of whole images, in test_profiles.py.
    files = [path.name for path in folder("kernels").glob("*.h") if path.name != "profile.h"]
    functions = {name for file in files for name in pattern.findall(shared_code(file))}
    assert len(functions) >= 65
    assert functions == set(LAWS)


@pytest.mark.slow
@pytest.mark.parametrize("function", sorted(LAWS))
def test_a_law_fails_where_its_function_is_wrong(function: str) -> None:
    law, wrong = LAWS[function]
    device = open_device("opencl")
    with pytest.raises(AssertionError, match=r"tolerance|assert|Arrays"):
        law(replace(device, edits=(wrong,)))
