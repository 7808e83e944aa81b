"""Fixtures of sweeps."""

from __future__ import annotations

import pytest
from sweeping import STATION

from gpuspec.station.station import Station


@pytest.fixture
def station() -> Station:
    return Station.from_dict(STATION, "part.toml")


@pytest.fixture
def refined(station: Station) -> Station:
    """The same with sub-rays where one footprint does not tell, as they are by default."""
    return station.replace(camera__subsampling="auto")
