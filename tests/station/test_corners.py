"""Designs that are off by what a station's tolerances allow."""

from __future__ import annotations

import pytest

import gpuspec
from gpuspec.station.corners import CORNERS_MAX, INSIDE, corners

STATION = gpuspec.example("trim")


@pytest.mark.parametrize(("value", "half"), [(1500.125, 0.001), (1000.25, 0.001), (800.0, 25.0)])
def test_every_key_is_off_by_all_it_may_and_by_no_more(value, half):
    station = STATION.replace(camera__height_mm=value)
    tried = [one["camera.height_mm"] for one in corners(station, {"camera.height_mm": half})]
    assert min(tried) == pytest.approx(value - half, abs=half / 1e3)
    assert max(tried) == pytest.approx(value + half, abs=half / 1e3)
    assert 2 + INSIDE // 2 < len(tried) <= 2 + INSIDE


def test_whole_numbers_are_tried_once_each():
    tried = [one["sequence.images"] for one in corners(STATION, {"sequence.images": 1})]
    assert sorted(tried) == sorted(set(tried))
    assert {39, 41} <= set(tried) <= {39, 40, 41}


def test_of_many_keys_some_corners_are_tried_and_of_none_nothing():
    keys = ("tunnel.luminous_mm", "tunnel.dark_mm", "tunnel.height_mm", "sensor.exposure",
            "camera.height_mm")  # fmt: skip
    tried = corners(STATION, dict.fromkeys(keys, 0.1))
    assert 2 * 5 + CORNERS_MAX // 2 + INSIDE < len(tried) <= 2 * 5 + CORNERS_MAX + INSIDE
    assert corners(STATION, {}) == []
