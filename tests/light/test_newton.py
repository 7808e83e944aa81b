"""How many Newton steps a ray needs to a height surface: on hard parts, against float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import tolerances

from gpuspec.light import sources
from gpuspec.light.backend import Backend
from gpuspec.light.constants import DEFINES
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.part.marches import march_of
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

PLACES = [(x, y) for x in (-18.0, -9.0, 0.0, 9.0, 18.0) for y in (-8.0, 0.0, 8.0)]


def defects(kind: str, diameter_mm: float, depth_um: float) -> list[dict[str, Any]]:
    return [
        {"kind": kind, "x_mm": x, "y_mm": y, "diameter_mm": diameter_mm, "depth_um": depth_um}
        for x, y in PLACES
    ]


def hard(**changes: Any) -> Station:
    station = Station.from_dict(
        {
            "part": {"length_mm": 40.0, "width_mm": 20.0, "surface": "height"},
            "camera": {"sampling_mm": 0.05, "subsampling": 1},
            "tunnel": {"height_mm": 30.0, "length_mm": 5000.0},
        }
    )
    return station.replace(**changes)


NEAR: dict[str, Any] = {"camera.height_mm": 40.0}
COARSE: dict[str, Any] = {"camera.sampling_mm": 0.1}
ONCE = {
    "dents of slope 0.36, from the part's length": hard(
        **NEAR, defects=defects("dent", 2.0, 300.0)
    ),
    "bumps of slope 0.36, from the part's length": hard(
        **NEAR, defects=defects("bump", 1.0, 150.0)
    ),
    "a crown of slope 0.9 where it is seen last, from the part's length": hard(
        **NEAR, **COARSE, **{"part.crown_radius_x_mm": 30.0}
    ),
}
TWICE = {
    "a hollow of nearly a half cylinder, from 1.5 times the part's length": hard(
        **COARSE, **{"part.crown_radius_x_mm": -25.0, "camera.height_mm": 60.0}
    ),
    "dents of slope 1, from 2.5 times": hard(
        **COARSE, **{"camera.height_mm": 100.0}, defects=defects("dent", 2.0, 800.0)
    ),
    "bumps of slope 1, from the part's length": hard(
        **COARSE, **NEAR, defects=defects("bump", 1.0, 400.0)
    ),
}


def away(backend: Backend, station: Station) -> tuple[float, int]:
    """Largest error of the light coordinate, in footprints; pixels that are lost otherwise."""
    got, want = backend.trace(station).read(), NumpyBackend().trace(station).read()
    seen = (got.lost == 0) & (want.lost == 0)
    assert seen.any()
    error = np.abs(got.light_mm - want.light_mm)[0][seen] / want.footprint_mm[0][seen]
    return float(error.max()), int((got.lost != want.lost).sum())


@pytest.fixture
def one_step_less(monkeypatch):
    """How a constant is made one less in every program that is built from then on."""

    def less(name: str) -> OpenCLBackend:
        monkeypatch.setitem(DEFINES, name, f"{int(DEFINES[name]) - 1}")
        sources.kernel_source.cache_clear()
        return OpenCLBackend()

    yield less
    monkeypatch.undo()
    sources.kernel_source.cache_clear()


@pytest.mark.parametrize("name", [*ONCE, *TWICE])
def test_rays_meet_a_hard_part_within_a_small_share_of_their_footprint(
    device_backend: Backend, name: str
):
    station = (ONCE | TWICE)[name]
    twice = march_of(station, Relief.of(station)) is not None
    assert twice == (name in TWICE)
    error, lost = away(device_backend, station)
    assert error < (tolerances.NEWTON_TWICE if twice else tolerances.NEWTON)
    assert lost == 0


@pytest.mark.parametrize("name", ONCE)
def test_one_newton_step_less_would_show(one_step_less, name):
    error, _ = away(one_step_less("NEWTON_STEPS"), ONCE[name])
    assert error > 50 * tolerances.NEWTON


def test_one_step_less_leaves_grazing_rays_undecided(one_step_less):
    station = hard(
        **COARSE,
        **{"camera.height_mm": 100.0, "part.pose.tilt_y_deg": 60.0},
        defects=defects("dent", 2.0, 500.0),
    )
    _, as_it_is = away(OpenCLBackend(), station)
    _, less = away(one_step_less("POSED_STEPS"), station)
    assert as_it_is < 50 < 60 < less  # of 80,000
