"""What of the relief crosses a pixel: told from where the defects are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import check_station

from gpuspec.part.crossings import CREASE, GROOVE, OTHER, Crossings, crossings
from gpuspec.part.guard import faint_from
from gpuspec.part.maps import TopographyMap
from gpuspec.part.marches import march_of
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
    middle = np.abs(x) < 0.6 * p
    assert middle.any(axis=0).sum() == 2
    assert (found[middle & (y < 0.3) & (y > 0.1)] == CREASE).all()
    assert (found[middle & (y > 0.6) & (y < 2)] == OTHER).all()
    assert not (found[np.abs(x) > 4 * p] == CREASE).any()
    off, along, _ = aside(station, *bent["points_mm"][:2])
    assert (found[(off < 0.1) & (along > 0.5) & (x < -1)] == GROOVE).all()


@pytest.mark.parametrize(
    "pose", [{"part__pose": {"shift_x_mm": 1e-9}}, {"camera__pose": {"tilt_x_deg": 1e-9}}], ids=str
)
def test_a_bend_of_a_part_that_is_moved_has_the_same_crease(pose):
    bent = {**SCRATCH, "points_mm": [[-4.0, -1.3], [0.0, 0.4], [4.0, -1.3]]}
    station, relief = scene(bent)
    still, moved = (told(of, relief) for of in (station, station.replace(**pose)))
    other = (moved == CREASE) != (still == CREASE)  # where a side ends within rounding
    assert other.sum() <= 3 < (still == CREASE).sum()
    assert not (moved == GROOVE).any()


def test_of_a_tilted_part_pixels_at_a_bend_see_its_crease():
    bent = {**SCRATCH, "points_mm": [[-4.0, -1.3], [0.0, 0.4], [4.0, -1.3]]}
    station, relief = scene(bent)
    tilted = station.replace(part__pose={"tilt_x_deg": 25.0, "turn_deg": 30.0})
    found = told(tilted, relief)
    x, y = places(tilted)
    p = tilted.camera.sampling_mm
    assert (found[(np.abs(x) < 0.5 * p) & (y < 0.3) & (y > 0.1)] == CREASE).all()
    assert not (found[np.abs(x) > 5 * p] == CREASE).any()


def test_a_gentle_bend_has_no_crease():
    bent = {**SCRATCH, "points_mm": [[-4.0, 0.0], [0.0, 0.1], [4.0, 0.0]]}
    station, relief = scene(bent)
    assert not (told(station, relief) == CREASE).any()


@pytest.mark.parametrize(
    "changes",
    [
        {"camera__blur_mm": 0.05}, {"camera__focus_mm": 400.0}, {"camera__focus_mm": 800.0},
        {"part__pose": {"tilt_y_deg": 1.0}}, {"defects": [DENT]}, {"defects": []},
    ],
)  # fmt: skip
def test_none_is_where_slices_would_not_tell(changes):
    station, _ = scene(SCRATCH)
    station = station.replace(camera__pupil_mm=2.0, **changes)
    assert (told(station, Relief.of(station)) == OTHER).all()


def line(y, x=4.0, **changes):
    return {**SCRATCH, "points_mm": [[-x, y], [x, y]], **changes}


def test_where_a_patch_may_be_seen_grooves_are_not_all():
    heights = 1e-4 * np.random.default_rng(0).random((9, 11))
    patch = TopographyMap(heights, heights, (0.1, 0.1), (0.5, -0.2), None, "defects[2]")
    station, relief = scene(line(0.0))
    assert (every(station, relief) & ~every(station, replace(relief, maps=(patch,)))).any()
    found = every(station, replace(relief, maps=(patch,)))
    x, y = places(station)
    assert not found[(np.abs(x - 1.0) < 0.5) & (np.abs(y - 0.2) < 0.4)].any()
    assert np.array_equal(found[x < 0.2], every(station, relief)[x < 0.2])


def test_a_part_that_rays_may_meet_twice_has_none():
    deep = line(0.0, width_mm=0.1, depth_um=60.0)
    station, relief = scene(deep, part__surface="height")
    assert march_of(station, relief) is not None
    assert (told(station, relief) == OTHER).all()


def test_between_two_scratches_both_reach_none_is_alone():
    other = [[-4.0, -0.5], [4.0, -1.5]]  # comes nearer from right to left
    station, relief = scene(line(0.0), {**SCRATCH, "points_mm": other})
    found, p = every(station, relief), station.camera.sampling_mm
    reach = faint_from(relief.grooves, station).max()
    x, y = places(station)
    off, _, _ = aside(station, *other)
    own = (np.abs(y) < 0.3) & (np.abs(x) < 3.5)
    assert not found[own & (off < reach + 0.6 * p)].any()
    assert found[own & (off > reach + 0.8 * p)].all()
    assert np.count_nonzero(own & (np.abs(off - reach) < 0.6 * p)) > 10


def test_beside_a_bend_a_pixel_that_another_defect_reaches_has_no_crease():
    bent = {**SCRATCH, "points_mm": [[-4.0, -1.3], [0.0, 0.4], [4.0, -1.3]]}
    station, relief = scene(bent, {**DENT, "x_mm": 1.2, "y_mm": -0.2, "diameter_mm": 1.2})
    x, y = places(station)
    # Its feet are on both pieces, one of which is 2 pixels nearer.
    near = np.hypot(x - 0.25, y + 0.2) < 0.1
    assert (told(station, relief)[near] == OTHER).all()


def test_pixels_of_the_part_s_edge_are_not():
    station, relief = scene(line(1.4), part__width_mm=3.0)
    found, p = every(station, relief), station.camera.sampling_mm
    x, y = places(station)
    inside = np.abs(x) < 3
    assert not found[inside & (y > 1.5 - 0.7 * p)].any()
    assert found[inside & (y < 1.5 - 0.8 * p) & (y > 1.2)].all()


def test_two_sides_of_one_scratch_that_look_at_each_other_have_a_crease_between():
    hairpin = {**SCRATCH, "points_mm": [[-4.0, 0.2], [3.0, 0.2], [3.0, -0.2], [-4.0, -0.2]]}
    station, relief = scene(hairpin)
    found, p = told(station, relief), station.camera.sampling_mm
    x, y = places(station)
    inside = np.abs(x) < 2.2
    assert (found[inside & (np.abs(y) < 0.6 * p)] == CREASE).all()
    assert (found[inside & (np.abs(np.abs(y) - 0.2) < 0.4 * p)] == GROOVE).all()


def test_far_from_every_groove_nothing_crosses():
    station, relief = scene(line(0.0, width_mm=0.1, depth_um=0.5))
    reach = faint_from(relief.grooves, station).max()
    _, y = places(station)
    far = np.abs(y) > reach + 4 * station.camera.sampling_mm
    assert far.any()
    assert (told(station, relief)[far] == OTHER).all()


def test_a_block_of_very_many_pieces_is_not_looked_at():
    x = np.linspace(-2, 2, 200)
    wavy = {**SCRATCH, "points_mm": np.stack([x, 0.05 * np.sin(9 * x)], axis=1).tolist()}
    station, relief = scene(wavy)
    assert (told(station, relief) == OTHER).all()


def test_pixels_are_looked_at_some_at_a_time(monkeypatch):
    station, relief = scene(SCRATCH, DENT)
    whole = told(station, relief)
    monkeypatch.setattr("gpuspec.part.crossings._PAIRS_AT_ONCE", 50)
    assert np.array_equal(told(station, relief), whole)


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
