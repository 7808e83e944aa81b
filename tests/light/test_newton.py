"""How many Newton steps a ray needs to a height surface: on hard parts, against float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import tolerances

from gpuspec.light import sources
from gpuspec.light.backend import Backend
from gpuspec.light.constants import DEFINES, NEWTON_STEPS
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.station.station import Station

PLACES = [(x, y) for x in (-18.0, -9.0, 0.0, 9.0, 18.0) for y in (-8.0, 0.0, 8.0)]


def defects(kind: str, diameter_mm: float, depth_um: float) -> list[dict[str, Any]]:
    return [
        {"kind": kind, "x_mm": x, "y_mm": y, "diameter_mm": diameter_mm, "depth_um": depth_um}
        for x, y in PLACES
    ]


HARD: dict[str, tuple[float, dict[str, Any]]] = {
    "a hollow of nearly a half cylinder, from 1.5 times the part's length": (
        tolerances.NEWTON,
        {"part.crown_radius_x_mm": -25.0, "camera.height_mm": 60.0, "camera.sampling_mm": 0.2},
    ),
    "dents of slope 1, from 2.5 times": (
        tolerances.NEWTON,
        {"camera.height_mm": 100.0, "defects": defects("dent", 2.0, 800.0)},
    ),
    "bumps of slope 1, from the part's length": (
        tolerances.NEWTON_HARDEST,
        {"camera.height_mm": 40.0, "tunnel.height_mm": 30.0,
         "defects": defects("bump", 1.0, 400.0)},
    ),
}  # fmt: skip


def hard(name: str) -> tuple[float, Station]:
    """The largest error allowed, and the station."""
    station = Station.from_dict(
        {
            "part": {"length_mm": 40.0, "width_mm": 20.0, "surface": "height"},
            "camera": {"sampling_mm": 0.05},
            "tunnel": {"height_mm": 50.0, "length_mm": 5000.0},
        }
    )
    tolerance, changes = HARD[name]
    return tolerance, station.replace(**changes)


def error_of(backend: Backend, station: Station) -> float:
    """Largest error of the light coordinate, in footprints, where both see light."""
    got, want = backend.trace(station).read(), NumpyBackend().trace(station).read()
    seen = (got.lost == 0) & (want.lost == 0)
    assert seen.mean() > 0.9
    away = np.abs(got.light_mm - want.light_mm)[0][seen] / want.footprint_mm[0][seen]
    return float(away.max())


@pytest.mark.parametrize("name", HARD)
def test_rays_meet_a_hard_part_within_a_small_share_of_their_footprint(
    device_backend: Backend, name: str
):
    tolerance, station = hard(name)
    assert error_of(device_backend, station) < tolerance


@pytest.mark.parametrize("name", HARD)
def test_one_newton_step_less_would_show(monkeypatch, name):
    tolerance, station = hard(name)
    monkeypatch.setitem(DEFINES, "NEWTON_STEPS", f"{NEWTON_STEPS - 1}")
    sources.kernel_source.cache_clear()
    try:
        assert error_of(OpenCLBackend(), station) > 2 * tolerance
    finally:
        monkeypatch.undo()
        sources.kernel_source.cache_clear()
