"""The chapter's detector in a small form: learnt from simulated parts, tried on others and really.

The figures of the chapter are those of `tests/benchmarks/learning.py`, of more parts.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from benchmarks.learning import real, simulated, unpacked
from documents import CHECKOUT

import gpuspec

MIRROR = next((m for above in CHECKOUT.parents if (m := above / "shared/measured/mirror").is_dir()),
              None)  # fmt: skip
"""Frames of a real mirror, which lie beside the checkout where there are any."""


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> tuple[ModuleType, Any, dict[str, Any]]:
    folder: Path = tmp_path_factory.mktemp("learning")
    learn = unpacked(folder)
    return learn, *simulated(learn, folder, parts=8)


def test_it_finds_more_than_the_threshold_with_as_many_false_calls(tried):
    _, _, scored = tried
    threshold, learnt = scored["threshold"], scored["learnt"]
    assert max(threshold["false_blobs"], learnt["false_blobs"]) <= 3
    assert learnt["P1"] > threshold["P1"] + 0.1
    assert learnt["P2"] > 0.4
    assert learnt["hit"] > threshold["hit"]


if MIRROR:

    def test_it_sees_the_scratches_of_a_real_mirror(tried):
        learn, trees, _ = tried
        station = gpuspec.Station(camera={"sampling_mm": 0.1})
        taken = gpuspec.inspect(MIRROR, station, region="found:25")
        middle = np.s_[300:900, 600:1200]
        found = real(learn, trees, taken.aspect[middle], taken.region[middle], 2)["learnt"]
        assert found["turned"] <= 2
        assert found["blobs"] > 8
        assert found["met by the other"] > found["blobs"] / 2
