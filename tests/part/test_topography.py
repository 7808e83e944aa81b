"""Measured topographies: what is read, refused, laid on the part and seen by the device."""

from __future__ import annotations

import re
import struct
import sys

import numpy as np
import pytest
import tifffile
from maps import UNIT_MM, grid, pit, polished, write_sur
from PIL import Image
from scenes import members
from scipy import ndimage
from tolerances import (
    MAP_CURVE_DIFFERENCE,
    MAP_FILLED_MM,
    MAP_FOOTPRINT,
    MAP_LIGHT_MM,
    MAP_PITCH,
    MAP_RECORD_PX,
    MAP_SEEN_MM,
    MAP_SLOPE,
    MAP_SLOPE_DIFFERENCE,
    MAP_SMOOTHED_MM,
    MAP_SOLVED_MM,
    MAP_TILT,
    MAP_TILT_SEEN_MM,
)

from gpuspec.errors import StationError, TopographyError
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.records import coefficients, map_records
from gpuspec.part.maps import read_maps, relief_at, zone_at
from gpuspec.simulation import memory
from gpuspec.simulation.simulate import simulate
from gpuspec.station.defects import Topography
from gpuspec.station.sections import Part
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml
from gpuspec.topographies import form
from gpuspec.topographies.form import filled


def relief_station(folder, size=(0.48, 0.4), **relief):
    return Station.from_dict(
        {
            "part": {
                "length_mm": size[0],
                "width_mm": size[1],
                "relief": {"file": "x.sur", **relief},
            },
            "camera": {"sampling_mm": 0.004, "height_mm": 150.0, "pupil_mm": 0.0},
            "tunnel": {"height_mm": 80.0},
        },
        "demo.toml",
        folder,
    )


def patch_station(folder, sampling=0.01, subsampling=1, part=2.0, **patch):
    return Station.from_dict(
        {
            "part": {"length_mm": part, "width_mm": part},
            "camera": {
                "sampling_mm": sampling,
                "height_mm": 150.0,
                "pupil_mm": 0.0,
                "subsampling": subsampling,
            },
            "tunnel": {"height_mm": 80.0},
            "defects": [
                {"kind": "dent", "x_mm": 0.9, "y_mm": 0.9, "diameter_mm": 0.01, "depth_um": 1e-3},
                {"kind": "measured", "file": "x.sur", "x_mm": 0.0, "y_mm": 0.0, **patch},
            ],
        },
        "demo.toml",
        folder,
    )


@pytest.fixture(scope="module")
def backend():
    return OpenCLBackend()


@pytest.fixture
def folder(tmp_path):
    heights, missing = polished()
    write_sur(tmp_path / "x.sur", heights, missing=missing)
    return tmp_path


def light_and_footprint(backend, station):
    arrays = backend.trace(station).read()
    return arrays.light_mm.squeeze(), arrays.footprint_mm.squeeze()


def rejected(station):
    """The one sentence with which a station's topography is refused."""
    with pytest.raises(TopographyError) as caught:
        read_maps(station)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("demo.toml: ")
    assert message.endswith(".")
    return message


def test_a_map_is_laid_with_its_pitch_and_centre(folder):
    (m,) = read_maps(relief_station(folder))
    assert m.name == "part.relief"
    assert m.heights_mm.shape == (100, 120)
    assert m.heights_mm.dtype == np.float64
    np.testing.assert_allclose(m.pitch_mm, 0.004, rtol=MAP_PITCH)
    np.testing.assert_allclose(m.corner_mm, (-0.238, -0.198), rtol=MAP_PITCH)
    assert m.zone is None


def test_the_first_line_of_the_file_has_the_greatest_y(folder):
    (m,) = read_maps(relief_station(folder))
    row, column = np.unravel_index(m.heights_mm.argmin(), m.heights_mm.shape)
    x = m.corner_mm[0] + column * m.pitch_mm[0]
    y = m.corner_mm[1] + row * m.pitch_mm[1]
    np.testing.assert_allclose((x, y), (0.1, 0.05), atol=0.004)


def test_the_parts_relief_comes_first_and_patches_follow_in_their_order(folder):
    station = relief_station(folder)
    patch = {"kind": "measured", "file": "x.sur", "x_mm": 0.1, "y_mm": 0.02}
    station = station.replace(defects=[patch, {**patch, "y_mm": -0.02}])
    maps = read_maps(station)
    assert [m.name for m in maps] == ["part.relief", "defects[1]", "defects[2]"]
    np.testing.assert_allclose(maps[2].corner_mm, (0.1 - 0.238, -0.02 - 0.198), rtol=MAP_PITCH)


def test_a_pit_is_seen_where_it_is_and_not_at_the_mirrored_places(folder, backend):
    x, y = grid(120, 100)
    write_sur(folder / "x.sur", pit(x, y, (0.1, 0.05), 0.006, 1.0))
    station = relief_station(folder)
    light, _ = light_and_footprint(backend, station)
    flat, _ = light_and_footprint(backend, station.replace(part__relief=None))
    # Ceiling: l - l_flat is about 2 H dz/dx against the surface's tilt, so -80 mm x 2 x slope.
    moved = np.abs(light - flat)

    def near(px, py):
        column, row = 60 + px / 0.004, 50 - py / 0.004
        return moved[int(row) - 3 : int(row) + 3, int(column) - 3 : int(column) + 3].max()

    assert near(0.1, 0.05) > 5.0
    for mirrored in ((-0.1, 0.05), (0.1, -0.05), (-0.1, -0.05), (0.05, 0.1)):
        assert near(*mirrored) < 0.02
    row = 50 - int(0.05 / 0.004)
    assert (light - flat)[row, 60 + 25 - 2] > 1.0  # falling towards the pit: seen further along x
    assert (light - flat)[row, 60 + 25 + 2] < -1.0


@pytest.mark.parametrize("subsampling", [1, 2])
@pytest.mark.parametrize("surface", ["orientation", "height"])
def test_a_sampled_pit_gives_the_light_map_of_the_same_dent(
    tmp_path, backend, subsampling, surface
):
    x, y = grid(200, 200)
    write_sur(tmp_path / "x.sur", pit(x, y, (0, 0), 0.04, 2.0), step_mm=1e-11)
    spot = {"x_mm": 0.123, "y_mm": -0.217}
    station = patch_station(tmp_path, subsampling=subsampling, form_removed="none", taper=0, **spot)
    dent = {"kind": "dent", "diameter_mm": 0.16, "depth_um": 2.0, **spot}
    station = station.replace(part__surface=surface)
    measured, parametric = (
        station.replace(defects=[station.as_dict()["defects"][1]]),
        (station.replace(defects=[dent])),
    )
    light, footprint = light_and_footprint(backend, measured)
    light_dent, footprint_dent = light_and_footprint(backend, parametric)
    assert np.ptp(light_dent - light_and_footprint(backend, station.replace(defects=[]))[0]) > 5
    np.testing.assert_allclose(light, light_dent, rtol=0, atol=MAP_LIGHT_MM)
    np.testing.assert_allclose(
        footprint, footprint_dent, rtol=0, atol=MAP_FOOTPRINT * footprint_dent.max()
    )


def device_slopes(maps, station, x, y):
    """The device's spline in float32, as kernels/relief.h evaluates it."""
    m, c = members("Map", map_records(maps, station)[0]), coefficients(maps)
    size, inverse = ((m[f"{word}_x"], m[f"{word}_y"]) for word in ("points", "points_per_mm"))
    columns, rows = station.shape[1], station.shape[0]
    p = np.float32(station.camera.sampling_mm)
    column, row = columns / 2 + x / p, rows / 2 - y / p
    u = (((column - m["column"]) - m["column_fraction"]) * p * inverse[0]).astype(np.float32)
    v = (-((row - m["row"]) - m["row_fraction"]) * p * inverse[1]).astype(np.float32)
    i = np.clip(np.floor(u), 0, size[0] - 2).astype(int)
    j = np.clip(np.floor(v), 0, size[1] - 2).astype(int)
    c = c.reshape(int(size[1]) + 2, int(size[0]) + 2)

    def weights(t, slope):
        s = np.float32(1) - t
        if slope:
            return -s * s / 2, t * (1.5 * t - 2), s * (2 - 1.5 * s), t * t / 2
        return s**3 / 6, 2 / 3 - t * t * (1 + s) / 2, 2 / 3 - s * s * (1 + t) / 2, t**3 / 6

    def total(wx, wy):
        return sum(wy[b] * wx[a] * c[j + b, i + a] for a in range(4) for b in range(4))

    u, v = u - i, v - j
    return total(weights(u, True), weights(v, False)) * inverse[0], (
        total(weights(u, False), weights(v, True)) * inverse[1]
    )


def test_the_coefficients_give_the_slopes_of_the_float64_spline(folder):
    station = relief_station(folder)
    maps = read_maps(station)
    random = np.random.default_rng(1)
    x, y = random.uniform(-0.24, 0.24, 5000), random.uniform(-0.2, 0.2, 5000)
    _, zx, zy, *_ = relief_at(maps, x, y)
    assert np.abs(zx).max() > 0.05
    dx, dy = device_slopes(maps, station, x, y)
    np.testing.assert_allclose(dx, zx, atol=MAP_SLOPE)
    np.testing.assert_allclose(dy, zy, atol=MAP_SLOPE)


def test_the_device_sees_the_slopes_of_the_float64_spline(folder, backend):
    station = relief_station(folder)
    light, _ = light_and_footprint(backend, station)
    rows, columns = station.shape
    x = (np.arange(columns) + 0.5 - columns / 2)[None, :] * 0.004 + np.zeros((rows, 1))
    y = (rows / 2 - 0.5 - np.arange(rows))[:, None] * 0.004 + np.zeros((1, columns))
    _, zx, zy, *_ = relief_at(read_maps(station), x, y)
    view = np.stack([x, y, np.full_like(x, -150.0)])
    normal = np.stack([-zx, -zy, np.ones_like(x)])
    normal /= np.linalg.norm(normal, axis=0)
    ray = view - 2 * (view * normal).sum(axis=0) * normal
    np.testing.assert_allclose(light, x + 80 * ray[0] / ray[2], atol=MAP_SEEN_MM)


def test_maps_add_up_and_stop_at_their_edge(folder):
    station = patch_station(folder, x_mm=0.1, taper=0)
    (m,) = read_maps(station)
    half = 120 * m.pitch_mm[0] / 2
    x = np.array([0.1 + half - 1e-4, 0.1 + half + 1e-4, 0.1 - half - 1e-4])
    z, zx, *_ = relief_at((m,), x, np.zeros(3))
    assert z[0] != 0
    assert (z[1:] == 0).all()
    assert (zx[1:] == 0).all()
    np.testing.assert_array_equal(relief_at((m, m), x, 0 * x)[0], 2 * z)
    assert not np.any(relief_at((), x, 0 * x))


def test_points_are_interpolated_and_derivatives_are_those_of_the_height(folder):
    (m,) = read_maps(relief_station(folder))
    ny, nx = m.heights_mm.shape
    x = m.corner_mm[0] + np.arange(nx) * m.pitch_mm[0]
    y = m.corner_mm[1] + np.arange(ny) * m.pitch_mm[1]
    z, *_ = relief_at((m,), *np.meshgrid(x, y))
    np.testing.assert_allclose(z, m.heights_mm, atol=MAP_SOLVED_MM)
    random = np.random.default_rng(2)
    x, y = random.uniform(-0.23, 0.23, 500), random.uniform(-0.19, 0.19, 500)
    e = 1e-6
    _, zx, zy, zxx, zxy, zyy = relief_at((m,), x, y)
    east, west = relief_at((m,), x + e, y), relief_at((m,), x - e, y)
    north, south = relief_at((m,), x, y + e), relief_at((m,), x, y - e)
    np.testing.assert_allclose((east[0] - west[0]) / 2 / e, zx, atol=MAP_SLOPE_DIFFERENCE)
    np.testing.assert_allclose((north[0] - south[0]) / 2 / e, zy, atol=MAP_SLOPE_DIFFERENCE)
    np.testing.assert_allclose((east[1] - west[1]) / 2 / e, zxx, atol=MAP_CURVE_DIFFERENCE)
    np.testing.assert_allclose((east[2] - west[2]) / 2 / e, zxy, atol=MAP_CURVE_DIFFERENCE)
    np.testing.assert_allclose((north[2] - south[2]) / 2 / e, zyy, atol=MAP_CURVE_DIFFERENCE)


def test_slope_and_curvature_do_not_jump_at_the_points(folder):
    (m,) = read_maps(relief_station(folder))
    x = m.corner_mm[0] + np.arange(1, 119) * m.pitch_mm[0]
    y = np.full(x.shape, 0.05)
    before, after = relief_at((m,), x - 1e-9, y), relief_at((m,), x + 1e-9, y)
    for low, high, jump in zip(before, after, (1e-9, 1e-6, 1e-6, 1e-3, 1e-3, 1e-3), strict=True):
        np.testing.assert_allclose(low, high, atol=jump)


def test_a_tilt_stays_a_tilt_up_to_the_edge_of_the_map(tmp_path, backend):
    x, y = grid(120, 100)
    write_sur(tmp_path / "x.sur", 3e-3 * x + 1e-3 * y)
    station = relief_station(tmp_path, form_removed="none")
    px, py = np.meshgrid(np.linspace(-0.24, 0.24, 97), np.linspace(-0.2, 0.2, 81))
    _, zx, zy, *_ = relief_at(read_maps(station), px, py)
    np.testing.assert_allclose(zx, 3e-3, atol=MAP_TILT)
    np.testing.assert_allclose(zy, 1e-3, atol=MAP_TILT)
    light, _ = light_and_footprint(backend, station)
    flat, _ = light_and_footprint(backend, station.replace(part__relief=None))
    np.testing.assert_allclose(light - flat, -2 * 80 * 3e-3, atol=MAP_TILT_SEEN_MM)


@pytest.mark.parametrize(("form_removed", "power"), [("mean", 0), ("plane", 1), ("curvature", 2)])
def test_a_form_is_removed_exactly_missing_points_or_not(tmp_path, form_removed, power):
    x, y = grid(60, 50)
    form = 0.009 + (power > 0) * (4e-3 * x - 3e-3 * y)
    form = form + (power > 1) * (0.02 * x * x - 0.01 * y * y + 0.015 * x * y)
    missing = np.hypot(x - 0.1, y - 0.09) < 0.02  # one side only, at the edge
    write_sur(tmp_path / "x.sur", form, missing=missing)
    (m,) = read_maps(relief_station(tmp_path, (0.24, 0.2), form_removed=form_removed))
    np.testing.assert_allclose(m.heights_mm, 0, atol=UNIT_MM)


def test_the_form_is_the_one_surface_topography_fits(folder):
    from SurfaceTopography import read_topography

    heights = read_topography(folder / "x.sur").to_unit("mm")
    for form_removed, mode in (("mean", "center"), ("plane", "height"), ("curvature", "curvature")):
        (m,) = read_maps(relief_station(folder, form_removed=form_removed))
        expected = heights.detrend(mode).heights().T[::-1]
        np.testing.assert_allclose(
            m.relief_mm[~expected.mask], expected.compressed(), atol=MAP_SOLVED_MM
        )


def test_no_form_removed_keeps_the_heights(folder):
    (m,) = read_maps(relief_station(folder, form_removed="none"))
    heights, missing = polished()
    np.testing.assert_allclose(m.relief_mm[::-1][~missing], heights[~missing], atol=UNIT_MM)


def test_missing_points_are_filled_smoothly(folder):
    heights, missing = polished()
    write_sur(folder / "x.sur", heights)
    (whole,) = read_maps(relief_station(folder))
    write_sur(folder / "x.sur", heights, missing=missing)
    (filled,) = read_maps(relief_station(folder))
    # The holes lie clear of the pits: what is missing is 20 nm of waves.
    np.testing.assert_allclose(filled.relief_mm, whole.relief_mm, atol=MAP_FILLED_MM)


def test_filled_points_are_never_counted_as_zone(tmp_path):
    x, y = grid(120, 100)
    heights = pit(x, y, (0.1, 0.05), 0.02, 1.0)
    missing = np.hypot(x - 0.1, y - 0.05) < 0.01
    write_sur(tmp_path / "x.sur", heights, missing=missing)
    (m,) = read_maps(relief_station(tmp_path, form_removed="none", zone_height_um=0.5))
    assert (m.relief_mm[::-1][missing] < -5e-4).all()
    np.testing.assert_array_equal(m.zone[::-1], (heights < -5e-4) & ~missing)


def test_smoothing_widens_a_pit_by_its_variance(tmp_path):
    x, y = grid(120, 100)
    write_sur(tmp_path / "x.sur", pit(x, y, (0, 0), 0.03, 1.0))
    station = relief_station(tmp_path, form_removed="none", smoothing_um=20.0)
    (m,) = read_maps(station)
    square = 0.004**2 / 12
    for relief, variance in ((m.relief_mm, 4e-4), (m.heights_mm, 4e-4 + square)):
        wide = np.sqrt(0.03**2 + variance)
        expected = pit(x, y, (0, 0), wide, 1.0 * (0.03 / wide) ** 2)
        np.testing.assert_allclose(relief[::-1], expected, atol=MAP_SMOOTHED_MM)


def test_a_square_below_the_pitch_is_averaged_too(tmp_path):
    x, y = grid(120, 100)
    write_sur(tmp_path / "x.sur", pit(x, y, (0, 0), 0.012, 1.0))
    station = relief_station(tmp_path, form_removed="none").replace(camera__sampling_mm=0.004)
    (m,) = read_maps(station)
    wide = np.sqrt(0.012**2 + 0.004**2 / 12)
    expected = pit(x, y, (0, 0), wide, (0.012 / wide) ** 2)
    np.testing.assert_allclose(m.heights_mm[::-1], expected, atol=MAP_SMOOTHED_MM)
    assert np.abs(m.relief_mm[::-1] - expected).max() > 5e-6


def test_a_pixel_larger_than_the_map_is_no_burden(folder):
    (m,) = read_maps(patch_station(folder, sampling=500.0, taper=0))
    assert np.ptp(m.heights_mm) < 0.1 * np.ptp(m.relief_mm)


def test_a_patch_fades_to_zero_over_its_taper(folder):
    (m,) = read_maps(patch_station(folder, taper=0.25, form_removed="none"))
    edge = np.concatenate([m.heights_mm[[0, -1]].ravel(), m.heights_mm[:, [0, -1]].ravel()])
    assert (edge == 0).all()
    (bare,) = read_maps(patch_station(folder, taper=0, form_removed="none"))
    inner = slice(25, 75), slice(30, 90)
    np.testing.assert_array_equal(m.heights_mm[inner], bare.heights_mm[inner])
    share = m.heights_mm[50] / bare.heights_mm[50]
    np.testing.assert_allclose(share[:30], 0.5 - 0.5 * np.cos(np.pi * np.arange(30) / 29.75))


def test_zones_are_where_the_relief_exceeds_the_height(folder):
    station = relief_station(folder, zone_height_um=0.3)
    (m,) = read_maps(station)
    np.testing.assert_array_equal(m.zone, np.abs(m.relief_mm) > 3e-4)
    here = [
        zone_at(m, np.array([x]), np.array([y]))[0]
        for x, y in ((0.1, 0.05), (-0.15, -0.1), (0.1, -0.05), (0.0, 0.0), (5.0, 0.0))
    ]
    assert here == [True, True, False, False, False]


def test_zones_do_not_depend_on_the_camera(folder):
    zones = [
        read_maps(relief_station(folder, zone_height_um=0.3).replace(camera__sampling_mm=p))[0].zone
        for p in (0.002, 0.02)
    ]
    np.testing.assert_array_equal(*zones)


def test_half_a_pixel_of_reach_finds_a_zone_between_pixel_centres(folder):
    picture = np.zeros((100, 120), np.uint8)
    picture[49, 60] = 1  # one point, at (0.002, 0.002)
    Image.fromarray(picture).save(folder / "zone.png")
    (m,) = read_maps(relief_station(folder, zone_file="zone.png"))
    x, y = np.array([0.01, -0.01, 0.01]), np.array([0.01, 0.01, 0.03])
    assert zone_at(m, x, y).tolist() == [False, False, False]
    assert zone_at(m, x, y, reach_mm=0.01).tolist() == [True, False, False]


@pytest.mark.parametrize("name", ["zone.png", "zone.tif", "colour.png"])
def test_a_zone_picture_is_read_with_its_top_line_at_the_greatest_y(folder, name):
    picture = np.zeros((100, 120), np.uint8)
    picture[10:14, 80:90] = 1
    colour = np.stack([picture, 0 * picture, 0 * picture, 0 * picture + 255], axis=-1)
    Image.fromarray(colour if name == "colour.png" else picture).save(folder / name)
    (m,) = read_maps(relief_station(folder, zone_file=name))
    np.testing.assert_array_equal(m.zone[::-1], picture != 0)
    assert zone_at(m, np.array([0.1]), np.array([0.15]))[0]


def test_records_and_coefficients_of_several_maps_follow_one_another(folder):
    station = relief_station(folder)
    station = station.replace(
        defects=[{"kind": "measured", "file": "x.sur", "x_mm": 0.1, "y_mm": 0.02}] * 8
    )
    maps = read_maps(station)
    records = map_records(maps, station)
    assert records.dtype == np.float32
    assert records.shape == (9, 12)
    record = members("Map", records)
    first = record["first_low"] + 65536 * record["first_high"]
    np.testing.assert_array_equal(first, np.arange(9) * 102 * 122)
    assert coefficients(maps).shape == (9 * 102 * 122,)
    # Corner in pixels of 4 um: half an image and half a pitch from the middle.
    corner = [record[axis][0] + record[f"{axis}_fraction"][0] for axis in ("column", "row")]
    np.testing.assert_allclose(corner, (0.5, 99.5), atol=MAP_RECORD_PX)
    assert map_records((), station).shape == (0, 12)
    assert coefficients(()).shape == (0,)


def test_smoothing_is_as_wide_along_x_as_along_y_whatever_the_pitches(tmp_path):
    x, _ = grid(120, 200)
    _, y = grid(120, 200, 0.002)
    write_sur(tmp_path / "x.sur", pit(x, y, (0, 0), 0.03, 1.0), pitch_mm=(0.004, 0.002))
    (m,) = read_maps(relief_station(tmp_path, form_removed="none", smoothing_um=20.0))
    wide = np.hypot(0.03, 0.02)
    expected = pit(x, y, (0, 0), wide, (0.03 / wide) ** 2)
    np.testing.assert_allclose(m.relief_mm[::-1], expected, atol=MAP_SMOOTHED_MM)


def test_a_map_ends_half_a_pitch_beyond_its_points_on_every_device(tmp_path, device_backend):
    """A tilt seen by pixels a quarter of the pitch wide is a tilt up to the part's edge."""
    x, _ = grid(30, 25)
    write_sur(tmp_path / "x.sur", 3e-3 * x)
    tilted = relief_station(tmp_path, (0.12, 0.1), form_removed="none")
    tilted = tilted.replace(camera__sampling_mm=0.001)
    light, flat = (
        device_backend.trace(station).read().light_mm[0]
        for station in (tilted, tilted.replace(part__relief=None))
    )
    assert light.shape == (100, 120)
    np.testing.assert_allclose(light - flat, -2 * 80 * 3e-3, atol=MAP_TILT_SEEN_MM)


def test_what_stands_out_is_a_zone_as_what_is_sunk(tmp_path):
    x, y = grid(120, 100)
    write_sur(tmp_path / "x.sur", pit(x, y, (0.1, 0), 0.02, 1.0) - pit(x, y, (-0.1, 0), 0.02, 1.0))
    (m,) = read_maps(relief_station(tmp_path, form_removed="none", zone_height_um=0.5))
    zone = m.zone[::-1]
    assert np.array_equal(zone, zone[:, ::-1])
    assert zone[x > 0].any()


def test_a_part_wider_than_its_map_along_one_side_alone_is_refused(folder):
    for size, axis in (((0.5, 0.3), "x"), ((0.3, 0.5), "y")):
        told = rejected(relief_station(folder, size))
        assert f"mm along {axis};" in told
        assert " and " not in told.partition("leave part")[0].partition("smaller")[2]


def test_a_map_is_no_mirror_from_an_rms_slope_of_1_on(tmp_path):
    x, _ = grid(120, 100)
    wave = np.sin(2 * np.pi * x / 0.08)  # its rms slope is 2 pi / 0.08 / sqrt(2): 55.5
    for slope in (0.9, 1.1):
        write_sur(tmp_path / "x.sur", wave * slope / 55.54)
        station = relief_station(tmp_path, form_removed="none")
        if slope < 1:
            read_maps(station)
        else:
            assert "has an rms slope of 1.09, more than 1: no mirror" in rejected(station)


def test_a_part_may_be_as_large_as_its_map_but_not_larger(folder):
    read_maps(relief_station(folder, (0.48, 0.4)))
    read_maps(relief_station(folder, (0.4803, 0.3)))
    message = rejected(relief_station(folder, (0.5, 0.41)))
    assert 'part.relief.file = "x.sur" is smaller than the part by 0.02 mm along x' in message
    assert "0.01 mm along y" in message
    assert "leave part.length_mm and part.width_mm out" in message
    assert message.endswith("part.length_mm = 0.48, part.width_mm = 0.4.")


def test_a_missing_file_is_named_with_the_place_looked_for(folder):
    message = rejected(relief_station(folder).replace(part__relief__file="nowhere.sur"))
    assert message.startswith(
        'demo.toml: part.relief.file = "nowhere.sur" is not there; looked for'
    )
    message = rejected(patch_station(folder, file="nowhere.sur"))
    assert message.startswith('demo.toml: defects[2].file = "nowhere.sur" is not there')


def test_a_file_without_unit_is_refused(folder):
    np.savetxt(folder / "x.sur", np.random.default_rng(0).normal(size=(9, 9)))
    told = rejected(patch_station(folder))
    assert "carries no length unit" in told
    assert "defects[2].height_unit" in told
    assert "defects[2].pitch_um" in told


@pytest.mark.slow
def test_unknown_formats_and_damaged_files_are_refused_in_silence(folder, capfd):
    whole = (folder / "x.sur").read_bytes()
    random = np.random.default_rng(3)
    flipped = [
        bytes(b ^ (random.random() < 0.05) * int(random.integers(1, 256)) for b in whole[:512])
        + whole[512:]
        for _ in range(20)
    ]
    truncated = [whole[:n] for n in (0, 1, 12, 100, 511, 512, 600, len(whole) - 1)]
    noise = [random.bytes(n) for n in (3, 300, 3000)]
    text = [
        b"not a topography\n",
        b"1 2 3\n4 5\n",
        b"PK\x03\x04" + b"\0" * 60,
        b"\x89HDF\r\n\x1a\n",
    ]
    refused = 0
    for content in flipped + truncated + noise + text:
        (folder / "x.sur").write_bytes(content)
        try:
            read_maps(patch_station(folder))
        except TopographyError as error:
            refused += 1
            assert str(error).startswith('demo.toml: defects[2].file = "x.sur" ')
            assert "\n" not in str(error)
    assert refused >= len(truncated + noise + text)
    assert capfd.readouterr() == ("", "")


def test_a_line_scan_is_refused(folder):
    np.savetxt(folder / "x.sur", np.stack([np.arange(20.0), np.zeros(20)], axis=1))
    assert "is a line scan, not an area" in rejected(patch_station(folder))


def test_too_few_points_are_refused(folder):
    write_sur(folder / "x.sur", np.zeros((3, 9)))
    assert "has 9 x 3 points; at least 4 x 4" in rejected(patch_station(folder))


def test_a_huge_map_is_refused_before_it_is_read(folder):
    write_sur(folder / "x.sur", np.zeros((4, 4)))
    content = bytearray((folder / "x.sur").read_bytes())
    content[108:120] = struct.pack("<iiI", 20_000, 20_000, 400_000_000)
    (folder / "x.sur").write_bytes(content)
    assert "400,000,000 points, more than 100,000,000" in rejected(patch_station(folder))


@pytest.mark.parametrize(("rows", "share"), [(100, "all"), (60, "60%")])
def test_a_map_that_misses_most_of_its_points_is_refused(folder, rows, share):
    heights, missing = polished()
    missing[:] = False
    missing[:rows] = True
    write_sur(folder / "x.sur", heights, missing=missing)
    assert f"misses {share} of its points" in rejected(patch_station(folder))


def test_infinite_heights_are_refused(folder, monkeypatch):
    import SurfaceTopography

    read = SurfaceTopography.open_topography

    def with_infinity(path):
        reader = read(path)
        measured = reader.topography()
        heights = measured.heights().copy()
        heights[50, 50] = np.inf
        unit, size = measured.unit, measured.physical_sizes
        measured = SurfaceTopography.Topography(heights, size, unit=unit)
        monkeypatch.setattr(reader, "topography", lambda: measured)
        return reader

    monkeypatch.setattr(SurfaceTopography, "open_topography", with_infinity)
    assert "holds infinite heights" in rejected(patch_station(folder))


def test_absurd_slopes_are_refused(folder):
    write_sur(folder / "x.sur", np.random.default_rng(0).normal(size=(40, 40)))
    assert "rms slope" in rejected(patch_station(folder))


def test_heights_too_far_from_zero_for_single_precision_are_refused(folder):
    heights, _ = polished()
    write_sur(folder / "x.sur", heights + 5)
    assert "reaches 5.0" in rejected(relief_station(folder, form_removed="none"))
    read_maps(relief_station(folder, form_removed="mean"))


def test_smoothing_that_leaves_nothing_is_refused(folder):
    assert "nothing is left" in rejected(patch_station(folder, smoothing_um=500.0))


def test_zone_files_that_cannot_be_used_are_refused(folder):
    assert 'zone_file = "z.png" is not there' in rejected(patch_station(folder, zone_file="z.png"))
    (folder / "z.png").write_bytes(b"nothing")
    assert "is not an image" in rejected(patch_station(folder, zone_file="z.png"))
    Image.fromarray(np.zeros((120, 100), np.uint8)).save(folder / "z.png")
    message = rejected(patch_station(folder, zone_file="z.png"))
    assert message.startswith('demo.toml: defects[2].zone_file = "z.png" has 120 x 100 pixels')
    both = patch_station(folder, zone_file="z.png", zone_height_um=1.0)
    assert "stands beside zone_height_um" in rejected(both)


def test_without_surface_topography_the_extra_is_named(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    assert 'pip install "gpuspec[topography]"' in rejected(patch_station(folder))


def test_a_station_without_topography_needs_no_reader(monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    assert read_maps(Station()) == ()


# ------------------------------------------------------------------------------- plain matrices

PLAIN = {"height_unit": "nm", "pitch_um": 4.0, "form_removed": "none"}


def plain_station(folder, file, **relief):
    part = {"relief": {"file": file, **PLAIN, **relief}}
    camera = {"sampling_mm": 0.004, "height_mm": 150.0}
    data = {"part": part, "camera": camera, "tunnel": {"height_mm": 80.0}}
    return Station.from_dict(data, "demo.toml", folder)


def as_text(heights, apart, number="{:.3f}"):
    return "".join(apart.join(number.format(h) for h in line) + "\n" for line in heights)


@pytest.mark.parametrize("name", ["x.npy", "x.tif", "x.txt", "x.csv", "x.asc", "x.dat"])
def test_a_matrix_without_units_takes_those_of_the_station_file(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)  # none of these needs it
    heights, missing = polished()
    nanometres = np.where(missing, np.nan, heights * 1e6)
    path = tmp_path / name
    if name == "x.npy":
        np.save(path, nanometres)
    elif name == "x.tif":
        tifffile.imwrite(path, nanometres.astype(np.float32))
    else:
        path.write_text(as_text(nanometres, "," if name == "x.csv" else " "), encoding="utf-8")
    (m,) = read_maps(plain_station(tmp_path, name))
    np.testing.assert_allclose(m.relief_mm[::-1][~missing], heights[~missing], atol=UNIT_MM / 2)
    assert m.pitch_mm == (0.004, 0.004)
    assert "(10) are missing" in m.remarks[0]


@pytest.mark.parametrize(
    ("lines", "apart", "number"),
    [
        ("\ufeff% exported\n", "\t", "{:.3f}"),
        ("# heights\n\n", ";", "{:.3f}"),
        ("", ", ", "{:.6e}"),
        ("", "   ", "{:g}"),
    ],
)
def test_text_is_read_however_its_numbers_stand_apart(tmp_path, lines, apart, number):
    heights, _ = polished()
    text = lines + as_text(heights * 1e6, apart, number)
    (tmp_path / "x.txt").write_text(text, encoding="utf-8")
    (m,) = read_maps(plain_station(tmp_path, "x.txt"))
    np.testing.assert_allclose(m.relief_mm[::-1], heights, atol=UNIT_MM)
    assert m.remarks == ()


def test_decimal_commas_empty_cells_and_a_separator_at_the_end_are_read(tmp_path):
    heights, missing = polished()
    lines = as_text(heights * 1e6, ";").replace(".", ",").splitlines()
    cells = [line.split(";") for line in lines]
    for row, column in np.argwhere(missing):
        cells[row][column] = "" if column else "Bad"
    text = "\r\n".join(";".join(line) + ";" for line in cells)
    (tmp_path / "x.csv").write_text(text, encoding="utf-8")
    (m,) = read_maps(plain_station(tmp_path, "x.csv"))
    np.testing.assert_allclose(m.relief_mm[::-1][~missing], heights[~missing], atol=UNIT_MM / 2)
    assert "(10) are missing" in m.remarks[0]


def test_a_header_that_states_units_is_believed(tmp_path):
    heights, _ = polished()
    header = "# Width: 0.48 mm\n# Height: 0.4 mm\n# Value units: nm\n"
    text = header + as_text(heights * 1e6, "\t")
    (tmp_path / "x.txt").write_text(text, encoding="utf-8")
    station = plain_station(tmp_path, "x.txt", height_unit=None, pitch_um=None)
    (m,) = read_maps(station)
    np.testing.assert_allclose(m.relief_mm[::-1], heights, atol=UNIT_MM / 2)
    assert station.part.length_mm == pytest.approx(0.48)


def test_grey_levels_are_heights_times_their_scale(tmp_path):
    heights, _ = polished()
    levels = np.round(heights * 1e6 / 0.5).astype(np.uint16)  # half a nanometre each
    tifffile.imwrite(tmp_path / "x.tif", levels)
    (m,) = read_maps(plain_station(tmp_path, "x.tif", height_scale=0.5))
    np.testing.assert_allclose(m.relief_mm[::-1], heights, atol=2.6e-7)


def test_a_pitch_may_differ_along_x_and_y(tmp_path):
    np.save(tmp_path / "x.npy", np.zeros((10, 20)))
    station = plain_station(tmp_path, "x.npy", pitch_um=[5, 8.0])
    (m,) = read_maps(station)
    np.testing.assert_allclose(m.pitch_mm, (0.005, 0.008))
    np.testing.assert_allclose((station.part.length_mm, station.part.width_mm), (0.1, 0.08))


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"height_unit": None}, "give part.relief.height_unit"),
        ({"pitch_um": None}, "give part.relief.pitch_um, a number or [along x, along y]"),
    ],
)
def test_a_unit_or_pitch_that_neither_file_nor_station_gives_is_named(tmp_path, keys, why):
    np.save(tmp_path / "x.npy", np.zeros((10, 20)))
    assert why in rejected(plain_station(tmp_path, "x.npy", **keys))


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"height_unit": "um"}, 'part.relief.height_unit = "um" another than its "mm"'),
        ({"pitch_um": 5.0}, "states a pitch of 4 x 4 um itself, and part.relief.pitch_um another"),
    ],
)
def test_units_that_contradict_those_of_the_file_are_refused(folder, keys, why):
    assert why in rejected(relief_station(folder, **keys))


def test_units_that_repeat_those_of_the_file_are_taken(folder):
    read_maps(relief_station(folder, height_unit="mm", pitch_um=4.0))


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (np.zeros((4, 20, 20)), "holds 4 x 20 x 20 values of type float64, not one matrix"),
        (np.zeros((20, 20), complex), "of type complex128, not one matrix"),
        (np.zeros(20), "holds 20 values"),
        (np.zeros((20, 3)), "has 3 x 20 points"),
        (np.full((20, 20), np.inf), "holds infinite heights"),
        (np.full((20, 20), np.nan), "misses all of its points"),
        (np.array([["a"] * 20] * 20), "of type <U1, not one matrix"),
        (np.array([[{}] * 20] * 20), "cannot be read"),
    ],
)
def test_arrays_that_are_no_map_of_heights_are_refused(tmp_path, values, why):
    np.save(tmp_path / "x.npy", values)
    assert why in rejected(plain_station(tmp_path, "x.npy"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x.npy", "x.tif", "x.txt"])
def test_a_damaged_matrix_is_refused_in_a_sentence(tmp_path, name, capfd):
    for content in (b"", b"\x93NUMPY\x01\x00", b"II*\0\x08\0\0\0", bytes(range(256)), b"1 2\n3"):
        (tmp_path / name).write_bytes(content)
        rejected(plain_station(tmp_path, name))
    assert capfd.readouterr() == ("", "")


# --------------------------------------------------------------- what was done to a map is told


def test_a_part_takes_the_size_of_its_map_where_it_states_none(folder):
    data = relief_station(folder).as_dict()
    for given, size in (
        ({}, (0.48, 0.4)),
        ({"length_mm": 0.3}, (0.3, 0.4)),
        ({"width_mm": 0.2}, (0.48, 0.2)),
    ):
        part = {"relief": {"file": "x.sur"}, **given}
        station = Station.from_dict({**data, "part": part}, "demo.toml", folder)
        np.testing.assert_allclose(
            (station.part.length_mm, station.part.width_mm), size, rtol=MAP_PITCH
        )
        (m,) = read_maps(station)
        assert m.name == "part.relief"
        again = Station.parse(to_toml(station), "again.toml", folder)
        assert again.part == station.part  # written as resolved


def test_a_map_that_cannot_be_read_is_told_before_the_size_it_would_have_given(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(memory, "free_bytes", lambda: 1000)
    for file, keys, why in (
        ("nowhere.npy", {}, 'part.relief.file = "nowhere.npy" is not there'),
        ("x.npy", {"height_unit": None}, "give part.relief.height_unit"),
        ("x.npy", {"pitch_um": None}, "give part.relief.pitch_um"),
    ):
        np.save(tmp_path / "x.npy", np.zeros((10, 20)))
        with pytest.raises(TopographyError, match=re.escape(why)):
            simulate(plain_station(tmp_path, file, **keys), "numpy")
    with pytest.raises(StationError, match="GiB"):
        simulate(plain_station(tmp_path, "x.npy"), "numpy")


def test_a_pitch_is_a_number_or_two(tmp_path):
    np.save(tmp_path / "x.npy", np.zeros((10, 20)))
    for pitch in (4, 4.5, [5, 4.0]):
        station = plain_station(tmp_path, "x.npy", pitch_um=pitch)
        assert Station.parse(to_toml(station), "demo.toml", tmp_path).part == station.part
    for wrong, why in (
        ("4", "must be a number, or must be a list"),
        ([1.0], "pitch_um"),
        ([1.0, 2.0, 3.0], "pitch_um"),
        (-1.0, "must be greater than 0"),
        ([0.0, 1.0], "must be greater than 0"),
    ):
        with pytest.raises(StationError) as caught:
            plain_station(tmp_path, "x.npy", pitch_um=wrong)
        assert why in str(caught.value)
        assert "part.relief.pitch_um" in str(caught.value)
        for jargon in ("tuple", "Field", "Input"):
            assert jargon not in str(caught.value), str(caught.value)


def test_a_station_made_in_python_has_its_maps_size_too():
    for part in ({"relief": {"file": "polished"}}, Part(relief=Topography(file="polished"))):
        station = Station(part=part)
        assert (station.part.length_mm, station.part.width_mm) == (1.96, 1.68)
        assert station.sides_of_map == ("length_mm", "width_mm")
    assert Station(part=Part(length_mm=1.0, relief={"file": "polished"})).part.length_mm == 1.0
    assert Station().sides_of_map == ()


def test_another_map_gives_the_part_another_size_and_none_leaves_it(folder):
    write_sur(folder / "y.sur", np.zeros((50, 60)))
    data = relief_station(folder).as_dict()
    part = {"relief": {"file": "nowhere.sur"}}
    station = Station.from_dict({**data, "part": part}, "demo.toml", folder)
    assert "is not there" in rejected(station)
    for file, length in (("x.sur", 0.48), ("y.sur", 0.24)):
        station = station.replace(part__relief__file=file)
        assert station.part.length_mm == pytest.approx(length)
    assert station.replace(part__relief=None).part.length_mm == pytest.approx(0.24)
    fixed = station.replace(part__length_mm=0.2)
    assert fixed.replace(part__relief__file="x.sur").part.length_mm == 0.2
    assert fixed.replace(part__length_mm=None).part.length_mm == pytest.approx(0.24)


def test_a_map_larger_than_the_part_is_cropped_with_a_word(folder):
    (m,) = read_maps(relief_station(folder, (0.24, 0.4)))
    (told,) = (r for r in m.remarks if "left out" in r)
    assert told.startswith("part.relief: 50 % of its map, 0.48 x 0.4 mm, lie beyond the part")
    (whole,) = read_maps(relief_station(folder))
    assert not any("left out" in r for r in whole.remarks)


def test_a_patch_beyond_the_edge_is_cropped_with_a_word(folder):
    (m,) = read_maps(patch_station(folder, x_mm=1.0))
    assert any(r.startswith("defects[2]: 50 % of its map") for r in m.remarks)
    (m,) = read_maps(patch_station(folder))
    assert not any("left out" in r for r in m.remarks)


def test_missing_points_are_told_with_their_share_and_place(folder):
    heights, missing = polished()
    missing[20:64, 10:70] = True
    write_sur(folder / "x.sur", heights, missing=missing)
    (m,) = read_maps(relief_station(folder))
    assert m.remarks == (
        "part.relief: 22 % of the map's points (2,641) are missing; they were filled smoothly from "
        "those around them and count as flawless (the largest hole, 0.24 x 0.176 mm, at "
        "x = -0.08, y = 0.032 mm).",
    )


def test_a_map_without_faults_is_passed_over_in_silence(folder):
    write_sur(folder / "x.sur", polished()[0])
    assert read_maps(relief_station(folder))[0].remarks == ()


def test_filling_needs_no_other_package_and_is_harmonic(tmp_path):
    x, y = grid(40, 30)
    saddle = 1e-3 * x * y + 2e-3 * (x * x - y * y) + 1e-3 * x
    defined = np.ones(saddle.shape, bool)
    defined[5:20, 8:25] = defined[28, 3] = False
    np.testing.assert_allclose(filled(saddle * defined, defined), saddle, atol=MAP_SOLVED_MM)
    defined[:, 30:] = False  # up to the edge
    found = filled(saddle * defined, defined)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[defined], saddle[defined])


def test_many_missing_points_are_filled_from_half_of_them(monkeypatch):
    x, y = grid(121, 101)
    random = np.random.default_rng(5)
    heights = 1e-3 * ndimage.gaussian_filter(random.normal(size=x.shape), 8)
    defined = np.hypot(x - 0.05, y) > 0.1
    defined[60:, 100:] = False
    solved = filled(heights, defined)
    monkeypatch.setattr(form, "SOLVED_MAX", 300)
    halved = filled(heights, defined)
    np.testing.assert_array_equal(halved[defined], heights[defined])
    # Measured 2.2 % of the heights' range, 0.45 % in the mean.
    np.testing.assert_allclose(halved, solved, rtol=0, atol=0.03 * np.ptp(heights))
    assert np.abs(halved - solved)[~defined].mean() < 0.01 * np.ptp(heights)


@pytest.mark.parametrize("times", [1000.0, 1e6])
def test_a_map_in_another_unit_than_its_file_says_is_refused(folder, times):
    heights, _ = polished()
    write_sur(folder / "x.sur", heights * times, pitch_mm=(0.004 * times,) * 2, step_mm=1e-5)
    told = rejected(relief_station(folder))
    assert "covers fewer than 4 of its points; check the unit of the map's pitch" in told


def test_a_size_that_the_map_gives_is_named_where_it_makes_the_station_impossible(folder):
    write_sur(folder / "x.sur", polished()[0], pitch_mm=(4.0, 4.0))
    with pytest.raises(StationError) as caught:
        plain_station(folder, "x.sur", height_unit=None, pitch_um=None)
    assert "makes an image of 120000 x 100000 pixels" in str(caught.value)
    assert "part.relief gives the part length_mm = 480 and width_mm = 400" in str(caught.value)


def test_points_many_pixels_apart_are_told(folder):
    station = relief_station(folder).replace(camera__sampling_mm=0.0004)
    assert "10 pixels apart, 0.004 mm" in " ".join(read_maps(station)[0].remarks)


def test_a_map_smaller_than_a_pixel_is_told(folder):
    (m,) = read_maps(patch_station(folder, sampling=0.5))
    assert any("is smaller than a pixel" in remark for remark in m.remarks)


def spiked(folder, *points, height_mm=0.25):
    heights, _ = polished()
    for row, column in points:
        heights[row, column] += height_mm
    write_sur(folder / "x.sur", heights)
    return relief_station(folder, form_removed="plane")


def test_a_spike_that_makes_a_map_no_mirror_is_named_with_the_way_out(folder):
    station = spiked(folder, (30, 100), height_mm=2.0)
    told = rejected(station)
    assert "one point stands far out of the surroundings, by 2000 um in line 31" in told
    assert "column 101 of the map, at x = 0.162 mm, y = 0.078 mm" in told
    assert "part.relief.outlier_um = 4 leaves out" in told
    (m,) = read_maps(station.replace(part__relief__outlier_um=4.0))
    write_sur(folder / "x.sur", polished()[0])
    (clean,) = read_maps(relief_station(folder))
    np.testing.assert_allclose(m.relief_mm, clean.relief_mm, atol=MAP_FILLED_MM)
    assert m.remarks == (
        "part.relief: 1 of the map's points stands more than outlier_um = 4 um out of its "
        "surroundings and was left out: by 2000 um in line 31, column 101 of the map, at "
        "x = 0.162 mm, y = 0.078 mm.",
    )


def test_a_filled_point_is_no_spike_however_steep_its_neighbours(tmp_path):
    """Two above and two below: what is filled between them lies in the middle."""
    heights = np.zeros((100, 120))
    heights[50, [59, 61]], heights[[49, 51], 60] = 0.02, -0.02
    missing = np.zeros(heights.shape, bool)
    missing[50, 60] = True
    write_sur(tmp_path / "x.sur", heights, missing=missing)
    (m,) = read_maps(relief_station(tmp_path, form_removed="none"))
    assert "part.relief: 4 points stand out, steeper than 45" in " ".join(m.remarks)


def test_outliers_are_left_out_of_the_form_and_of_the_zones(folder):
    station = spiked(folder, (30, 100), (31, 100), (0, 0), (99, 5))
    station = station.replace(part__relief__zone_height_um=0.3)
    (m,) = read_maps(station.replace(part__relief__outlier_um=10.0))
    write_sur(folder / "x.sur", polished()[0])
    (clean,) = read_maps(relief_station(folder, zone_height_um=0.3))
    np.testing.assert_array_equal(m.zone, clean.zone)
    assert "4 of the map's points stand more than" in m.remarks[0]


def test_pits_and_polish_are_no_outliers(folder):
    write_sur(folder / "x.sur", polished()[0])
    (m,) = read_maps(relief_station(folder, outlier_um=1.2))
    assert m.remarks == ()


def test_a_limit_that_leaves_nothing_is_refused(folder):
    rough = np.random.default_rng(0).normal(0, 1e-5, (100, 120))
    write_sur(folder / "x.sur", polished()[0] + rough)
    assert "give a larger one" in rejected(relief_station(folder, outlier_um=1e-4))


def test_a_rough_map_is_not_blamed_on_a_point(folder):
    write_sur(folder / "x.sur", np.random.default_rng(0).normal(size=(40, 40)))
    assert "check the units of its heights and pitch" in rejected(patch_station(folder))


def test_what_was_done_to_a_map_stands_beside_the_score(folder, opencl):
    result = simulate(relief_station(folder, zone_height_um=0.3), opencl)
    assert any(warning.startswith("part.relief: ") for warning in result.warnings)


def test_the_made_surface_is_read_without_a_file(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    data = {"part": {"relief": {"file": "polished", "form_removed": "curvature"}}}
    station = Station.from_dict(data, "demo.toml", tmp_path)
    assert (station.part.length_mm, station.part.width_mm) == (1.96, 1.68)
    (m,) = read_maps(station)
    slopes = np.gradient(m.relief_mm, 0.0035)
    assert 0.001 < np.sqrt(sum(np.mean(s**2) for s in slopes)) < 0.005
    assert m.remarks == ()
    np.save(tmp_path / "polished", np.zeros((4, 4)))
    (tmp_path / "polished.npy").rename(tmp_path / "polished")
    assert "polished" in rejected(station)  # a file of that name comes first


def test_a_spike_in_a_map_is_named_with_the_way_to_leave_it_out(tmp_path):
    heights = np.zeros((200, 200))
    heights[150, 60] = 0.5
    np.savetxt(tmp_path / "x.txt", heights)
    station = relief_station(tmp_path).replace(
        part__length_mm=10.0, part__width_mm=10.0, camera__sampling_mm=0.05,
        part__relief={"file": "x.txt", "pitch_um": 50.0, "height_unit": "mm"},
    )  # fmt: skip
    (m,) = read_maps(station)
    assert "part.relief: one point stands out, steeper than 45" in " ".join(m.remarks)
    assert "in line 151, column 61 of the map" in " ".join(m.remarks)
    (kept,) = read_maps(station.replace(part__relief__outlier_um=50.0))
    assert "steeper" not in " ".join(kept.remarks)


def test_heights_in_another_unit_are_suspected(tmp_path):
    heights = 0.02 * np.sin(np.arange(100) / 2)[:, None] * np.ones(100)
    np.savetxt(tmp_path / "x.txt", heights)
    station = relief_station(tmp_path).replace(
        part__length_mm=1.0, part__width_mm=1.0,
        part__relief={"file": "x.txt", "pitch_um": 9.0, "height_unit": "mm"},
    ).replace(part__length_mm=0.9, part__width_mm=0.9)  # fmt: skip
    (m,) = read_maps(station)
    assert "heights may be in another unit: check height_unit" in " ".join(m.remarks)
    (m,) = read_maps(station.replace(part__relief__height_unit="um"))
    assert "steeper" not in " ".join(m.remarks)
