"""A small station of which some dents are found and some are not."""

from __future__ import annotations

import pytest

import gpuspec
from gpuspec.light.backend import Backend
from gpuspec.station.station import Station

SMALL = """
[part]
length_mm = 24.0
width_mm = 12.0
[camera]
sampling_mm = 0.1
[[defects]]
kind = "dent"
x_mm = 0.0
y_mm = 0.0
diameter_mm = 0.8
depth_um = 6.0
[[populations]]
kind = "dent"
count = 12
seed = 4
diameter_mm = [0.3, 1.2]
depth_um = [0.2, 2.5]
[[populations]]
kind = "scratch"
count = 2
seed = 5
width_mm = [0.2, 0.5]
length_mm = [1.0, 3.0]
depth_um = [0.5, 2.0]
"""


@pytest.fixture(scope="session")
def station() -> Station:
    return Station.parse(SMALL, "small.toml")


@pytest.fixture(scope="session")
def engine() -> Backend:
    return gpuspec.open_backend()
