"""The ceiling: no flawless pixel is above it, on any station, and some pixel comes to it."""

from __future__ import annotations

from typing import Any

import pytest
from random_stations import flawless
from tolerances import CEILING_MET_DN, CEILING_NOISE, CEILING_ROUNDING_DN

from gpuspec.light.ceiling import ceiling_of, untold
from gpuspec.simulation.simulate import simulate


@pytest.mark.parametrize(
    ("seed", "noise"), [(seed, seed % 3 != 0) for seed in range(8)] + [(1, False), (6, True)]
)
def test_nothing_is_detected_on_a_flawless_part(backend, seed: int, noise: bool) -> None:
    station = flawless(seed, noise=noise)
    found = simulate(station, backend)
    assert found.score.blobs == 0
    # To the bit the same on every backend: none has a part in it.
    assert found.threshold == ceiling_of(station).threshold_dn(255)


@pytest.mark.parametrize("seed", range(8, 24))
def test_some_flawless_pixel_comes_to_the_ceiling_and_none_beyond(opencl, seed: int) -> None:
    station = flawless(seed, noise=False)
    highest = float(opencl.trace(station).aspect().max())
    ceiling = ceiling_of(station).level_dn
    assert ceiling - CEILING_MET_DN < highest < ceiling + CEILING_ROUNDING_DN


@pytest.mark.parametrize("pattern", [{}, {"prnu": 0.02}, {"dsnu_e": 25.0}])
def test_the_noise_is_what_pixels_differ_by(opencl, pattern: dict[str, float]) -> None:
    """Unsaturated and never quite dark every pixel has one mean: noise alone tells them apart."""
    sensor = {"exposure": 0.7, "noise": True, "saturation_e": 2000.0, "dark_e": 300.0, **pattern}
    station = flawless(0, noise=True).replace(
        sensor=sensor, tunnel={"luminous_mm": 4.0, "dark_mm": 12.0}, sequence={"images": 16}
    )
    spread = float(opencl.trace(station).aspect().std())
    assert ceiling_of(station).noise_dn == pytest.approx(spread, rel=CEILING_NOISE)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"sequence.fusion": "max"}, "not of their max"),
        ({"part.orange_peel": {"slope_rad": 0.001, "wavelength_mm": 4.0}}, "uneven by itself"),
    ],
)
def test_where_no_ceiling_is_told_it_is_said_why(changes: dict[str, Any], why: str) -> None:
    station = flawless(0, noise=False).replace(**changes)
    assert ceiling_of(station) is None
    assert why in untold(station)


def test_defects_leave_the_ceiling_as_it_is() -> None:
    station = flawless(1, noise=True)
    dents = {"kind": "dent", "count": 5, "diameter_mm": 1.0, "depth_um": 9.0}
    assert ceiling_of(station.replace(populations=[dents])) == ceiling_of(station)


def test_a_part_that_sees_no_light_has_none() -> None:
    station = flawless(0, noise=False).replace(
        tunnel__opening_length_mm=400.0, tunnel__opening_width_mm=400.0
    )
    assert ceiling_of(station) is None
