"""Fixtures of sweeps."""

from __future__ import annotations

import pytest
from sweeping import STATION

from gpuspec.station.station import Station


@pytest.fixture
def station() -> Station:
    return Station.from_dict(STATION, "part.toml")
