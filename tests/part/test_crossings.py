"""What of the relief crosses a pixel: told from where the defects are."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import check_station

from gpuspec.part.crossings import CREASE, GROOVE, OTHER, Crossings, crossings
from gpuspec.part.relief import Relief
from gpuspec.part.view import surface_points

SCRATCH = {"kind": "scratch", "points_mm": [[-4.0, -1.3], [4.0, 2.1]], "width_mm": 0.25,
           "depth_um": 1.5}  # fmt: skip
DENT = {"kind": "dent", "x_mm": 0.2, "y_mm": 0.5, "diameter_mm": 0.3, "depth_um": 2.0}


def scene(*defects, **changes):
    station = check_station(pupil=0.0).replace(
        camera__columns=90, camera__rows=60, defects=list(defects), **changes
    )
    return station, Relief.of(station)


def told(station, relief):
    pixels = np.arange(np.prod(station.shape))
    return crossings(station, relief, pixels).reshape(station.shape)


def every(station, relief):
    """The pixels that one groove alone crosses."""
    return told(station, relief) == GROOVE


def places(station):
    rows, columns = station.shape
    return surface_points(station, np.arange(columns)[None], np.arange(rows)[:, None])


def aside(station, a, b):
    """Distance from a straight line's course, and how far along it a pixel is, mm."""
    x, y = places(station)
    course = np.subtract(b, a)
    length = np.hypot(*course)
    ux, uy = course / length
    along = (x - a[0]) * ux + (y - a[1]) * uy
    return np.abs((y - a[1]) * ux - (x - a[0]) * uy), along, length


@pytest.mark.parametrize("surface", ["orientation", "height"])
def test_pixels_near_a_scratch_are_crossed_and_those_of_its_ends_are_not(surface):
    station, relief = scene(SCRATCH, part__surface=surface, part__crown_radius_x_mm=500.0)
    found, p = every(station, relief), station.camera.sampling_mm
    off, along, length = aside(station, *SCRATCH["points_mm"])
    inside = (along > p) & (along < length - p)
    x, y = places(station)
    on = (np.abs(x) < station.part.length_mm / 2 - p) & (np.abs(y) < station.part.width_mm / 2 - p)
    assert found[(off < 0.25) & inside & on].all()
    assert not found[(along < 0) | (along > length)].any()
    assert not found[~on & (np.abs(x) > station.part.length_mm / 2)].any()


def test_pixels_that_another_defect_reaches_are_not():
    station, relief = scene(SCRATCH)
    alone = every(station, relief)
    station, relief = scene(SCRATCH, DENT)
    found = every(station, relief)
    x, y = places(station)
    near = np.hypot(x - DENT["x_mm"], y - DENT["y_mm"]) < 0.3
    assert alone[near].any()
    assert not found[near].any()
    far = np.hypot(x - DENT["x_mm"], y - DENT["y_mm"]) > 1.5
    assert np.array_equal(found[far], alone[far])
    assert not (found & ~alone).any()


def test_pixels_of_a_bend_have_a_crease_on_its_inner_side():
    bent = {**SCRATCH, "points_mm": [[-4.0, -1.3], [0.0, 0.4], [4.0, -1.3]]}
    station, relief = scene(bent)
    found, p = told(station, relief), station.camera.sampling_mm
    x, y = places(station)
    # On the line of symmetry both pieces are as near, below the end that they share by their sides.
    middle = np.abs(x) < p / 2
    assert (found[middle & (y < 0.3) & (y > -1)] == CREASE).all()
    assert (found[middle & (y > 0.6) & (y < 2)] == OTHER).all()
    assert not (found[np.abs(x) > 4 * p] == CREASE).any()
    off, along, _ = aside(station, *bent["points_mm"][:2])
    assert (found[(off < 0.1) & (along > 0.5) & (x < -1)] == GROOVE).all()


def test_a_gentle_bend_has_no_crease():
    bent = {**SCRATCH, "points_mm": [[-4.0, 0.0], [0.0, 0.1], [4.0, 0.0]]}
    station, relief = scene(bent)
    assert not (told(station, relief) == CREASE).any()


@pytest.mark.parametrize(
    "changes",
    [
        {"camera__blur_mm": 0.05}, {"camera__focus_mm": 400.0},
        {"part__pose": {"tilt_y_deg": 1.0}}, {"defects": [DENT]}, {"defects": []},
    ],
)  # fmt: skip
def test_none_is_where_slices_would_not_tell(changes):
    station, _ = scene(SCRATCH)
    station = station.replace(camera__pupil_mm=2.0, **changes)
    assert (told(station, Relief.of(station)) == OTHER).all()


def test_an_edge_defect_takes_the_pixels_of_its_blocks():
    chip = {"kind": "chip", "side": "top", "at_mm": 0.2, "width_mm": 0.7, "depth_mm": 0.3}
    low = {**SCRATCH, "points_mm": [[-4.0, 1.3], [4.0, 1.3]]}
    small = {"part__width_mm": 3.2, "part__length_mm": 8.0}
    station, relief = scene(low, **small)
    alone = every(station, relief)
    station, relief = scene(low, edges=[chip], **small)
    found = every(station, relief)
    assert (alone & ~found).any()
    assert not (found & ~alone).any()


def test_what_was_asked_is_remembered(monkeypatch):
    station, relief = scene(SCRATCH, DENT)
    pixels = np.arange(np.prod(station.shape))[::7]
    known = Crossings(station, relief, pixels)
    expected = crossings(station, relief, pixels)
    first = np.flatnonzero(pixels % 2 == 0)
    assert np.array_equal(known.at(first), expected[first])
    assert np.array_equal(known.at(np.arange(len(pixels))), expected)
    monkeypatch.setattr("gpuspec.part.crossings.crossings", None)
    assert np.array_equal(known.at(first), expected[first])
