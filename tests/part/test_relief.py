"""Which grooves reach which block of the image, and as what the device gets them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scenes
from scenes import members, part_with
from tolerances import DEVICE_DN, FLOAT_ROUNDING, FOOTPRINT_SHARE, LIGHT_MM, RECORD_PX, VOLUME

from gpuspec.errors import StationError
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.records import groove_records
from gpuspec.part.grooves import BLOCK, REACH, Grooves, averaged, blocks
from gpuspec.part.relief import Relief
from gpuspec.part.view import surface_points
from gpuspec.station.station import Station

DEFECTS = [
    {"kind": "dent", "x_mm": 20.0, "y_mm": 18.0, "diameter_mm": 5.0, "depth_um": 5.0},
    {"kind": "bump", "x_mm": -29.9, "y_mm": -24.9, "diameter_mm": 2.0, "depth_um": 5.0},
    {"kind": "dent", "x_mm": 3.3, "y_mm": 0.1, "diameter_mm": 0.01, "depth_um": 0.1},
    {
        "kind": "scratch", "points_mm": [[-25, -22], [-10, 24], [0, 0], [0, 0]],
        "width_mm": 0.5, "depth_um": 5.0,
    },
    {"kind": "scratch", "points_mm": [[-29, 24], [29, -24]], "width_mm": 0.1, "depth_um": 5.0},
    {"kind": "scratch", "points_mm": [[-30, 25], [30, 25]], "width_mm": 2.0, "depth_um": 5.0},
]  # fmt: skip

SURFACES: dict[str, dict[str, Any]] = {
    **scenes.SURFACES,
    "steep, near the camera": {
        "part.surface": "height", "part.crown_radius_y_mm": 26.0, "part.crown_radius_x_mm": 60.0,
        "camera.height_mm": 60.0,
    },
    "a piece of the part": {"camera.rows": 50, "camera.columns": 70},
    "smaller than a block": {"camera.rows": 5, "camera.columns": 3},
    "sub-rays": {"camera.subsampling": 4, "camera.sampling_mm": 1.0},
}  # fmt: skip


def scene(**changes: Any) -> Station:
    return part_with(DEFECTS, 0.25).replace(**changes)


def distance(x, y, ends):
    """Distance of points from a straight piece."""
    (ax, ay, bx, by) = ends
    square = (bx - ax) ** 2 + (by - ay) ** 2
    share = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / square, 0, 1) if square else 0
    return np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay))


@pytest.mark.parametrize("name", SURFACES)
def test_a_block_lists_every_groove_within_six_sigmas_of_its_pixels(name: str):
    station = scene(**SURFACES[name])
    grooves = Relief.of(station).grooves
    first, pieces = blocks(grooves, station)
    rows, columns = station.shape
    wide, high = -(-columns // BLOCK), -(-rows // BLOCK)
    assert first.shape == (wide * high + 1,)
    assert first[-1] == len(pieces)
    listed = np.zeros((wide * high, len(grooves)), bool)
    listed[np.repeat(np.arange(wide * high), np.diff(first)), pieces] = True
    x, y = surface_points(station, np.arange(columns)[None, :], np.arange(rows)[:, None])
    x, y = np.broadcast_arrays(x, y)
    on = (np.abs(x) <= 30) & (np.abs(y) <= 25)
    block = (np.arange(rows) // BLOCK)[:, None] * wide + (np.arange(columns) // BLOCK)[None, :]
    sigma = averaged(grooves, station).sigma
    for index, ends in enumerate(grooves.ends):
        near = on & (distance(x, y, ends) <= REACH * sigma[index])
        assert listed[block[near], index].all()


@pytest.mark.parametrize("name", SURFACES)
def test_pieces_ascend_within_a_block(name: str):
    station = scene(**SURFACES[name])
    first, pieces = blocks(Relief.of(station).grooves, station)
    for start, end in pairwise(first):
        assert (np.diff(pieces[start:end]) > 0).all()


def test_a_block_far_from_all_grooves_lists_none():
    station = scene(defects=DEFECTS[2:3])
    first, pieces = blocks(Relief.of(station).grooves, station)
    assert 1 <= len(pieces) <= 4
    assert (np.diff(first) == 0).sum() >= len(first) - 5


def test_a_long_scratch_is_listed_along_its_line_only():
    station = scene(defects=DEFECTS[4:5])
    _, pieces = blocks(Relief.of(station).grooves, station)
    assert len(pieces) < 45  # a diagonal of 15 x 13 blocks, not all 195


def test_no_defect_is_no_groove_in_any_block():
    station = scene(defects=[])
    first, pieces = blocks(Relief.of(station).grooves, station)
    assert not len(pieces)
    assert not first.any()


def test_lists_beyond_all_memory_are_refused():
    station = Station.from_dict(
        {
            "part": {"length_mm": 4000.0, "width_mm": 4000.0},
            "tunnel": {"length_mm": 9000.0},
            "camera": {"sampling_mm": 0.1},
        },
        "s.toml",
    )
    many = 5000
    grooves = Grooves(
        np.zeros((many, 4)), np.full(many, -1e-3), np.full(many, 90.0), np.arange(many)
    )
    with pytest.raises(StationError, match=r"^s\.toml: the defects reach [0-9,]+ image blocks"):
        blocks(grooves, station)


def test_ten_thousand_defects_are_seen_as_the_float64_reference_sees_them(opencl: OpenCLBackend):
    station = Station.from_dict(
        {
            "camera": {"rows": 96, "columns": 200},
            "populations": [
                {
                    "kind": "dent", "count": 10_000, "seed": 1, "diameter_mm": [0.2, 0.5],
                    "depth_um": [0.5, 4],
                }
            ],
        }
    )  # fmt: skip
    relief = Relief.of(station)
    assert len(relief.grooves) == 10_000
    seen = opencl.trace(station, relief)
    # The reference asks every defect for every pixel: only those near the crop are left to it.
    near = (np.abs(relief.grooves.ends[:, :2]) < [7.0, 4.4]).all(axis=1)
    assert 40 < near.sum() < 500
    g = relief.grooves
    few = Grooves(g.ends[near], g.depth[near], g.sigma[near], g.owner[near])
    known = NumpyBackend().trace(station, Relief(relief.defects, few, ()))
    got, want = seen.read(), known.read()
    assert (got.lost == want.lost).all()
    assert np.abs(got.light_mm - want.light_mm).max() < LIGHT_MM
    assert np.abs(got.footprint_mm / want.footprint_mm - 1).max() < FOOTPRINT_SHARE
    aspect = known.aspect()
    assert np.abs(seen.aspect() - aspect).max() < DEVICE_DN
    assert np.ptp(aspect) > 50


def volume(grooves: Grooves, x, y):
    """Of one defect of one piece over a grid, per cell of the grid."""
    square = distance(x, y, grooves.ends[0]) ** 2
    return (grooves.depth[0] * np.exp(-square / 2 / grooves.sigma[0] ** 2)).sum()


@pytest.mark.parametrize("subsampling", [1, 3])
def test_a_dent_averaged_over_pixels_keeps_its_volume(subsampling: int):
    station = scene(defects=[{**DEFECTS[0], "diameter_mm": 0.4}], camera__subsampling=subsampling)
    sharp = Relief.of(station).grooves
    soft = averaged(sharp, station)
    assert soft.sigma[0] > sharp.sigma[0]
    assert soft.sigma[0] ** 2 - sharp.sigma[0] ** 2 == pytest.approx((0.25 / subsampling) ** 2 / 12)
    x, y = np.meshgrid(np.arange(18, 22, 0.01), np.arange(16, 20, 0.01))
    assert volume(soft, x, y) == pytest.approx(volume(sharp, x, y), rel=VOLUME)


def test_a_scratch_averaged_over_pixels_keeps_the_area_of_its_section():
    station = scene(defects=DEFECTS[5:])
    sharp = Relief.of(station).grooves
    soft = averaged(sharp, station)
    y = np.arange(15, 35, 0.01)
    assert volume(soft, 0 * y, y) == pytest.approx(volume(sharp, 0 * y, y), rel=VOLUME)


def test_the_light_map_of_a_device_is_that_of_the_averaged_relief():
    # Twice as fine a sampling has half the square: deeper and narrower.
    coarse, fine = (
        averaged(Relief.of(s).grooves, s) for s in (scene(), scene(camera__subsampling=2))
    )
    assert (np.abs(fine.depth) > np.abs(coarse.depth)).all()
    assert (fine.sigma < coarse.sigma).all()


def test_records_give_positions_back_far_from_the_origin():
    station = Station.from_dict(
        {
            "part": {"length_mm": 2000.0, "width_mm": 1000.0},
            "tunnel": {"length_mm": 9000.0},
            "camera": {"sampling_mm": 0.043},
            "defects": [
                {
                    "kind": "scratch", "points_mm": [[x, y], [x + 0.37, y - 0.11]],
                    "width_mm": 0.1, "depth_um": 1,
                }
                for x in (-999.123456, 0.000123, 998.765432)
                for y in (-499.111111, 0.777777, 498.999999)
            ],
        }
    )  # fmt: skip
    grooves = Relief.of(station).grooves
    record = members("Groove", groove_records(grooves, station))
    rows, columns = station.shape
    want = [columns / 2, rows / 2] + grooves.ends[:, :2] * [1, -1] / 0.043
    got = [record[f"{axis}"] + record[f"{axis}_fraction"] for axis in ("column", "row")]
    assert np.abs(np.transpose(got) - want).max() < RECORD_PX
    assert np.abs(want).max() > 46_000
    np.testing.assert_allclose(record["along_x"], 9 * [0.37], rtol=FLOAT_ROUNDING)
    np.testing.assert_allclose(record["along_y"], 9 * [-0.11], rtol=FLOAT_ROUNDING)
    length = np.hypot(0.37, 0.11)
    np.testing.assert_allclose(record["inverse_square"], 9 * [length**-2], rtol=FLOAT_ROUNDING)
    np.testing.assert_allclose(record["inverse_length"], 9 * [1 / length], rtol=FLOAT_ROUNDING)
    np.testing.assert_array_equal(record["defect"], np.arange(9))


def test_a_dents_record_has_no_course():
    station = scene(defects=DEFECTS[:1])
    record = members("Groove", groove_records(Relief.of(station).grooves, station))
    for none in ("along_x", "along_y", "inverse_square", "inverse_length"):
        assert not record[none].any()
    assert (record["height"] < 0).all()


def test_grooves_are_numbered_by_their_defect():
    grooves = Relief.of(scene()).grooves
    assert grooves.owner.tolist() == [0, 1, 2, 3, 3, 3, 4, 5]
    assert (np.sign(grooves.depth) == [-1, 1, -1, -1, -1, -1, -1, -1]).all()
    assert grooves.sigma[0] == 5.0 / 4
