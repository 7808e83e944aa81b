"""Fixtures of the light."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import oracle
import pytest
from device import DEVICES, Device, open_device
from scenes import check_station, oracle_scene


@pytest.fixture(scope="session")
def check_truth() -> Callable[..., oracle.Floats]:
    """The model's check scenes as the oracle sees them, each once."""
    return cache(lambda *scene: oracle.aspect_image(oracle_scene(check_station(*scene))))


@pytest.fixture(scope="module", params=DEVICES)
def device(request: pytest.FixtureRequest) -> Device:
    return open_device(request.param)
