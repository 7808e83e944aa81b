"""Zones: which pixel belongs to which known defect, against every pixel asked one by one."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scenes
from maps import grid, pit, write_sur
from scenes import part_with
from tolerances import PIT_DEPTH, PIT_SIZE_PITCHES, SEEN_POINT_MM, SMALL_ZONE_AREA, ZONE_AREA

from gpuspec.part.relief import Relief
from gpuspec.part.truth import ZONE, Truth
from gpuspec.part.view import surface_points
from gpuspec.station.station import Station

DEFECTS = [
    {"kind": "dent", "x_mm": 20.0, "y_mm": 18.0, "diameter_mm": 6.0, "depth_um": 5.0},
    {"kind": "bump", "x_mm": 22.0, "y_mm": 17.0, "diameter_mm": 3.0, "depth_um": 5.0},
    {
        "kind": "scratch", "points_mm": [[-25, -22], [-10, 24], [0, 0], [25, 20]],
        "width_mm": 1.0, "depth_um": 5.0,
    },
    {"kind": "dent", "x_mm": 30.0, "y_mm": -25.0, "diameter_mm": 8.0, "depth_um": 5.0},
    {"kind": "scratch", "points_mm": [[-30, 12], [30, 12]], "width_mm": 0.3, "depth_um": 5.0},
    {"kind": "dent", "x_mm": 3.37, "y_mm": -7.01, "diameter_mm": 0.02, "depth_um": 5.0},
]  # fmt: skip

SURFACES: dict[str, dict[str, Any]] = {
    **scenes.SURFACES,
    "coarse": {"camera.sampling_mm": 1.3},
    "hollow, near the camera": {
        "part.surface": "height", "part.crown_radius_y_mm": -26.0, "camera.height_mm": 40.0,
        "camera.rows": 600, "camera.columns": 600,
    },
    "steep, near the camera": {
        "part.surface": "height", "part.crown_radius_y_mm": 26.0, "camera.height_mm": 60.0,
    },
    "a piece of the part": {"camera.rows": 60, "camera.columns": 130},
    "one pixel": {"camera.rows": 1, "camera.columns": 1},
}  # fmt: skip


def scene(**changes: Any) -> Station:
    return part_with(DEFECTS, 0.2).replace(**changes)


def truth(station: Station) -> Truth:
    return Truth.of(station, Relief.of(station))


def seen(station: Station) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = station.shape
    x, y = surface_points(station, np.arange(columns)[None, :], np.arange(rows)[:, None])
    return tuple(np.broadcast_arrays(x, y))


def shares(station: Station) -> np.ndarray:
    """Distance over zone radius of every pixel from every defect, by the definition."""
    x, y = seen(station)
    found = []
    for defect in station.defects:
        if defect.kind == "scratch":
            points, radius = np.array(defect.points_mm), defect.width_mm / 2
        else:
            points, radius = np.array(2 * [(defect.x_mm, defect.y_mm)]), defect.diameter_mm / 2
        away = np.full(x.shape, np.inf)
        for (ax, ay), (bx, by) in pairwise(points):
            square = max((bx - ax) ** 2 + (by - ay) ** 2, 1e-300)
            t = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / square, 0, 1)
            away = np.minimum(away, np.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay)))
        found.append(away / radius)
    return np.array(found)


@pytest.mark.parametrize("name", SURFACES)
def test_a_pixel_belongs_to_the_relatively_nearest_defect_within_two_sigmas(name: str):
    station = scene(**SURFACES[name])
    labels = truth(station).labels
    share = shares(station)
    want = np.where(share.min(axis=0) <= 1, share.argmin(axis=0) + 1, 0)
    # Where a pixel is on the rim, or equally far from two, rounding may choose.
    ordered = np.sort(share, axis=0)
    clear = (np.abs(ordered[0] - 1) > 1e-6) & (ordered[1] - ordered[0] > 1e-6)
    assert clear.mean() > 0.99
    assert np.array_equal(labels[clear], want[clear])
    assert labels.dtype == np.int32
    assert labels.shape == station.shape


@pytest.mark.parametrize("name", ["flat", "hollow", "steep, near the camera"])
def test_every_scene_shows_every_defect_but_the_smallest(name: str):
    labels = truth(scene(**SURFACES[name])).labels
    assert set(np.unique(labels)) >= {0, 1, 2, 3, 5}


def test_zones_do_not_depend_on_how_many_pieces_are_worked_at_once(monkeypatch):
    whole = truth(scene()).labels
    monkeypatch.setattr("gpuspec.part.truth._PAIRS_AT_ONCE", 500)
    assert np.array_equal(truth(scene()).labels, whole)
    twice = truth(scene(defects=[DEFECTS[0], DEFECTS[0]])).labels
    assert set(np.unique(twice)) == {0, 1}


def test_zones_reach_two_sigmas_so_that_the_diameter_is_theirs():
    assert ZONE == 2
    station = scene(defects=DEFECTS[:1], camera__sampling_mm=0.07)
    labels = truth(station).labels
    assert (labels > 0).sum() == pytest.approx(np.pi * 3**2 / 0.07**2, rel=ZONE_AREA)


def test_a_scratch_has_rounded_ends():
    line = {"kind": "scratch", "points_mm": [[-9, 0], [9, 4]], "width_mm": 2.0, "depth_um": 1.0}
    labels = truth(scene(defects=[line], camera__sampling_mm=0.08)).labels
    area = np.pi + 2 * np.hypot(18, 4)
    assert (labels > 0).sum() == pytest.approx(area / 0.08**2, rel=ZONE_AREA)


def test_of_two_equal_zones_the_first_has_the_pixel():
    labels = truth(scene(defects=[DEFECTS[0], DEFECTS[0]])).labels
    assert set(np.unique(labels)) == {0, 1}


def test_a_zone_at_the_edge_ends_with_the_image():
    labels = truth(scene(defects=DEFECTS[3:4])).labels
    assert labels[-1, -1] == 1
    quarter = np.pi * 4**2 / 4 / 0.2**2
    assert labels.sum() == pytest.approx(quarter, rel=3 * ZONE_AREA)


def test_a_defect_outside_the_image_is_known_but_has_no_pixel():
    found = truth(scene(camera__rows=20, camera__columns=20))
    assert len(found.defects) == len(DEFECTS)
    assert 1 not in found.labels


def test_no_defect_is_no_zone():
    found = truth(scene(defects=[]))
    assert not found.labels.any()
    assert found.defects == ()


def test_known_defects_tell_what_the_station_says():
    dent, bump, scratch, *_ = truth(scene()).defects
    assert (dent.kind, dent.x_mm, dent.y_mm, dent.size_mm) == ("dent", 20, 18, 6)
    assert (bump.kind, bump.depth_um, bump.length_mm) == ("bump", 5, 0)
    assert (scratch.kind, scratch.size_mm, scratch.x_mm, scratch.y_mm) == ("scratch", 1, 0, 1)
    assert scratch.length_mm == pytest.approx(
        np.hypot(15, 46) + np.hypot(10, 24) + np.hypot(25, 20)
    )


@pytest.mark.parametrize("name", ["crowned", "hollow", "steep, near the camera"])
def test_the_point_behind_a_pixel_lies_on_its_ray_and_on_the_surface(name: str):
    station = scene(**SURFACES[name])
    x, y = seen(station)
    rows, columns = station.shape
    x0 = (np.arange(columns) + 0.5 - columns / 2)[None, :] * 0.2
    y0 = (rows / 2 - np.arange(rows) - 0.5)[:, None] * 0.2
    toward = 1 - station.part.shape.height(x, y) / station.camera.height_mm
    on = (np.abs(x) <= 30) & (np.abs(y) <= 25)
    assert np.abs(x - x0 * toward)[on].max() < SEEN_POINT_MM
    assert np.abs(y - y0 * toward)[on].max() < SEEN_POINT_MM


def test_a_population_has_zones_that_can_be_counted():
    many = {
        "kind": "dent", "count": 300, "seed": 1, "diameter_mm": [1.0, 2.0], "depth_um": 1.0
    }  # fmt: skip
    station = scene(defects=[], populations=[many])
    found = truth(station)
    pixels = np.bincount(found.labels.ravel(), minlength=301)[1:]
    size = np.array([d.size_mm for d in found.defects])
    assert np.abs(pixels * 0.2**2 / (np.pi / 4 * size**2) - 1).max() < SMALL_ZONE_AREA
    assert np.abs(pixels.sum() * 0.2**2 / (np.pi / 4 * size**2).sum() - 1) < ZONE_AREA


# ------------------------------------------------------------------------- measured topographies

PITCH = 0.01
PITS = (((0.4, 0.2), 0.03, 2.0), ((-0.3, -0.25), 0.02, 1.0), ((0.055, -0.305), 0.006, 3.0))


@pytest.fixture
def folder(tmp_path):
    x, y = grid(120, 100, PITCH)
    heights = sum(pit(x, y, centre, sigma, depth) for centre, sigma, depth in PITS)
    write_sur(tmp_path / "x.sur", heights, pitch_mm=(PITCH, PITCH))
    return tmp_path


def measured(folder, sampling: float = PITCH, defects=(), **relief: Any) -> Station:
    table = {"file": "x.sur", "form_removed": "none", "zone_height_um": 0.4, **relief}
    return Station.from_dict(
        {
            "part": {"length_mm": 1.2, "width_mm": 1.0, "relief": table},
            "camera": {"sampling_mm": sampling},
            "defects": list(defects),
        },
        "s.toml",
        folder,
    )


def nearest(found: Truth, centre: tuple[float, float]):
    return min(
        enumerate(found.defects, 1),
        key=lambda item: np.hypot(item[1].x_mm - centre[0], item[1].y_mm - centre[1]),
    )


def test_pits_of_a_measured_relief_are_numbered_and_sized(folder):
    found = truth(measured(folder))
    assert [d.kind for d in found.defects] == 3 * ["pit"]
    assert set(np.unique(found.labels)) == {0, 1, 2, 3}
    for centre, sigma, depth in PITS:
        _, known = nearest(found, centre)
        assert (known.x_mm, known.y_mm) == pytest.approx(centre, abs=PITCH)
        assert known.depth_um == pytest.approx(depth, rel=PIT_DEPTH)
        # Below 0.4 um: r = sigma sqrt(2 ln(depth / 0.4)), in whole points.
        assert known.size_mm == pytest.approx(
            2 * sigma * np.sqrt(2 * np.log(depth / 0.4)), abs=PIT_SIZE_PITCHES * PITCH
        )


def test_a_pits_pixels_lie_where_it_is(folder):
    station = measured(folder)
    found = truth(station)
    x, y = seen(station)
    for centre, sigma, depth in PITS:
        number, _ = nearest(found, centre)
        radius = np.hypot(x - centre[0], y - centre[1])[found.labels == number]
        assert radius.max() < sigma * np.sqrt(2 * np.log(depth / 0.4)) + 2 * PITCH


@pytest.mark.parametrize("sampling", [0.1, 0.2])
def test_a_pit_smaller_than_a_pixel_still_has_one(folder, sampling: float):
    station = measured(folder, sampling)
    found = truth(station)
    x, y = seen(station)
    assert set(np.unique(found.labels)) == {0, 1, 2, 3}
    for centre, _, _ in PITS:
        number, _ = nearest(found, centre)
        home = (np.abs(x - centre[0]) < sampling / 2) & (np.abs(y - centre[1]) < sampling / 2)
        assert (found.labels[home] == number).all()


def test_points_that_touch_at_a_corner_are_one_pit(folder):
    """A scratch aslant is one defect, whatever the grid it was measured on."""
    heights = np.zeros((100, 120))
    heights[40 + np.arange(9), 50 + np.arange(9)] = -0.001
    heights[60, 50] = -0.001
    write_sur(folder / "x.sur", heights, pitch_mm=(PITCH, PITCH))
    found = truth(measured(folder))
    assert [d.kind for d in found.defects] == 2 * ["pit"]
    sizes = sorted(d.size_mm for d in found.defects)
    assert sizes == pytest.approx([2 * PITCH / np.sqrt(np.pi), 6 * PITCH / np.sqrt(np.pi)])


def test_a_relief_without_stated_zones_holds_no_known_defect(folder):
    station = measured(folder).replace(part__relief__zone_height_um=None)
    found = truth(station)
    assert found.defects == ()
    assert not found.labels.any()


def test_explicit_defects_come_before_pits_and_keep_their_pixels(folder):
    dent = {"kind": "dent", "x_mm": 0.4, "y_mm": 0.2, "diameter_mm": 0.05, "depth_um": 1.0}
    found = truth(measured(folder, defects=[dent]))
    assert [d.kind for d in found.defects] == ["dent", "pit", "pit", "pit"]
    station = measured(folder, defects=[dent])
    x, y = seen(station)
    inside = np.hypot(x - 0.4, y - 0.2) < 0.025
    assert (found.labels[inside] == 1).all()
    assert set(np.unique(found.labels)) == {0, 1, 2, 3, 4}


def test_a_measured_defects_zone_is_where_its_patch_lies(folder):
    station = Station.from_dict(
        {
            "part": {"length_mm": 8.0, "width_mm": 6.0},
            "camera": {"sampling_mm": PITCH},
            "defects": [
                {"kind": "dent", "x_mm": -3.0, "y_mm": 0.0, "diameter_mm": 0.5, "depth_um": 1.0},
                {
                    "kind": "measured", "file": "x.sur", "x_mm": 2.0, "y_mm": -1.5,
                    "form_removed": "none", "zone_height_um": 0.4,
                },
            ],
        },
        "s.toml",
        folder,
    )  # fmt: skip
    found = truth(station)
    assert [d.kind for d in found.defects] == ["dent", *3 * ["measured"]]
    assert set(np.unique(found.labels)) == {0, 1, 2, 3, 4}
    x, y = seen(station)
    zone = found.labels >= 2
    centres = [(2.0 + cx, -1.5 + cy) for (cx, cy), _, _ in PITS]
    away = np.min([np.hypot(x - cx, y - cy) for cx, cy in centres], axis=0)
    assert away[zone].max() < 0.08
    for cx, cy in centres:
        assert zone[np.hypot(x - cx, y - cy) < 0.7 * PITCH].all()
    for centre, sigma, depth in PITS:
        _, known = nearest(found, (2.0 + centre[0], -1.5 + centre[1]))
        assert (known.x_mm - 2.0, known.y_mm + 1.5) == pytest.approx(centre, abs=PITCH)
        assert known.depth_um == pytest.approx(depth, rel=PIT_DEPTH)
        assert known.size_mm == pytest.approx(
            2 * sigma * np.sqrt(2 * np.log(depth / 0.4)), abs=PIT_SIZE_PITCHES * PITCH
        )


def test_a_map_counts_alike_as_relief_and_as_a_patch(folder):
    whole = measured(folder)
    patch = {"kind": "measured", "file": "x.sur", "x_mm": 0.0, "y_mm": 0.0, "taper": 0.0,
             "form_removed": "none", "zone_height_um": 0.4}  # fmt: skip
    relief, laid = truth(whole), truth(whole.replace(part__relief=None, defects=[patch]))
    assert np.array_equal(relief.labels, laid.labels)
    assert [vars(d) | {"kind": ""} for d in relief.defects] == [
        vars(d) | {"kind": ""} for d in laid.defects
    ]


def test_a_patch_of_many_pits_leaves_the_other_defects_their_numbers(folder):
    patch = {"kind": "measured", "file": "x.sur", "x_mm": -0.6, "y_mm": 0.0,
             "form_removed": "none", "zone_height_um": 0.4}  # fmt: skip
    dent = {"kind": "dent", "x_mm": 1.0, "y_mm": 0.0, "diameter_mm": 0.3, "depth_um": 1.0}
    station = Station.from_dict(
        {"part": {"length_mm": 4.0, "width_mm": 2.0}, "camera": {"sampling_mm": PITCH},
         "defects": [patch, dent]}, "s.toml", folder,
    )  # fmt: skip
    found = truth(station)
    assert [d.kind for d in found.defects] == ["measured", "dent", "measured", "measured"]
    x, y = seen(station)
    assert (found.labels[np.hypot(x - 1.0, y) < 0.14] == 2).all()
    for number, known in enumerate(found.defects, 1):
        rows, columns = np.nonzero(found.labels == number)
        assert x[0, columns].mean() == pytest.approx(known.x_mm, abs=PITCH)
        assert y[rows, 0].mean() == pytest.approx(known.y_mm, abs=PITCH)


def test_a_patch_off_the_image_is_known_without_pixels(folder):
    station = Station.from_dict(
        {
            "camera": {"rows": 30, "columns": 30},
            "defects": [
                {
                    "kind": "measured", "file": "x.sur", "x_mm": 90.0, "y_mm": 20.0,
                    "zone_height_um": 0.4,
                }
            ],
        },
        "s.toml",
        folder,
    )  # fmt: skip
    found = truth(station)
    assert not found.labels.any()
    assert found.defects[0].size_mm > 0
