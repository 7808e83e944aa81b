"""Runs of pixels around centre lines: all that are near, and hardly another."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.part.grooves import Grooves
from gpuspec.part.spans import pixels_of, runs_around, together
from gpuspec.part.view import surface_points
from gpuspec.station.station import Station

STATION = Station.from_dict(
    {"part": {"length_mm": 30.0, "width_mm": 20.0}, "camera": {"sampling_mm": 0.2}}
)


def near(grooves: Grooves, station: Station, reach: np.ndarray) -> np.ndarray:
    """Pixels within reach of each piece, (S, M, N), one by one."""
    rows, columns = station.shape
    x, y = surface_points(station, np.arange(columns)[None], np.arange(rows)[:, None])
    found = []
    for (ax, ay, bx, by), most in zip(grooves.ends, reach, strict=True):
        square = max((bx - ax) ** 2 + (by - ay) ** 2, 1e-300)
        share = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / square, 0, 1)
        found.append(np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay)) <= most)
    return np.array(found)


@pytest.mark.parametrize(
    "changes",
    [{}, {"part.surface": "height", "part.crown_radius_x_mm": 60.0}],
    ids=["flat", "heights"],
)
def test_runs_hold_every_pixel_within_reach(changes):
    """Random pieces, some of no length, along rows, along columns, and over the image's border."""
    station = STATION.replace(**changes)
    random = np.random.default_rng(3)
    ends = random.uniform([-16, -11, -16, -11], [16, 11, 16, 11], (60, 4))
    ends[:10, 2:] = ends[:10, :2]
    ends[10:20, 3], ends[20:30, 2] = ends[10:20, 1], ends[20:30, 0]
    one = np.ones(60)
    grooves = Grooves(ends, one, one, np.arange(60))
    reach = random.uniform(0.05, 2, 60)
    piece, first, count = runs_around(grooves, station, reach)
    wanted = near(grooves, station, reach)
    columns = station.shape[1]
    assert (first // columns == (first + count - 1) // columns).all()
    extra = 0
    for number, mask in enumerate(wanted):
        of = piece == number
        found = pixels_of(first[of], count[of])
        assert np.isin(np.flatnonzero(mask), found).all()
        extra += np.unique(found).size - np.count_nonzero(mask)
    if not changes:  # at most a pixel at each end of a run, and a row above and below
        assert extra <= 2 * len(first) + 60


def test_runs_together_hold_each_pixel_once():
    first, count = np.array([30, 2, 4, 10, 10]), np.array([3, 4, 1, 5, 2])
    wanted = [2, 3, 4, 5, 10, 11, 12, 13, 14, 30, 31, 32]
    assert together(first, count).tolist() == wanted
    none = np.zeros(0, np.int64)
    assert together(none, none).tolist() == []
