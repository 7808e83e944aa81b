"""Measured maps on the part: laid, smoothed, cropped, seen by every device as by float64."""

from __future__ import annotations

import numpy as np
import pytest
from maps import UNIT_MM, grid, patch_station, pit, polished, rejected, relief_station, write_sur
from PIL import Image
from scenes import members
from tolerances import (
    MAP_AS_DENT_DN,
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

from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.records import coefficients, map_records
from gpuspec.part.maps import averaged, read_maps, relief_at, zone_at
from gpuspec.station.station import Station


@pytest.fixture(scope="module")
def backend():
    return OpenCLBackend()


def light_and_footprint(backend, station):
    arrays = backend.trace(station).read()
    return arrays.light_mm.squeeze(), arrays.footprint_mm.squeeze()


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
    _, zx, zy, *_ = relief_at(averaged(read_maps(station), station), x, y)
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
    (m,) = averaged(read_maps(station), station)
    square = 0.004**2 / 12
    for relief, variance in ((m.relief_mm, 4e-4), (m.heights_mm, 4e-4 + square)):
        wide = np.sqrt(0.03**2 + variance)
        expected = pit(x, y, (0, 0), wide, 1.0 * (0.03 / wide) ** 2)
        np.testing.assert_allclose(relief[::-1], expected, atol=MAP_SMOOTHED_MM)


def test_a_square_below_the_pitch_is_averaged_too(tmp_path):
    x, y = grid(120, 100)
    write_sur(tmp_path / "x.sur", pit(x, y, (0, 0), 0.012, 1.0))
    station = relief_station(tmp_path, form_removed="none").replace(camera__sampling_mm=0.004)
    (m,) = averaged(read_maps(station), station)
    wide = np.sqrt(0.012**2 + 0.004**2 / 12)
    expected = pit(x, y, (0, 0), wide, (0.012 / wide) ** 2)
    np.testing.assert_allclose(m.heights_mm[::-1], expected, atol=MAP_SMOOTHED_MM)
    assert np.abs(m.relief_mm[::-1] - expected).max() > 5e-6


def test_a_pixel_larger_than_the_map_is_no_burden(folder):
    station = patch_station(folder, sampling=500.0, taper=0)
    (m,) = averaged(read_maps(station), station)
    assert np.ptp(m.heights_mm) < 0.1 * np.ptp(m.relief_mm)


@pytest.mark.parametrize(
    "camera",
    [{}, {"subsampling": 4}, {"subsampling": 1, "blur_mm": 0.05}, {"blur_mm": 0.1, "pupil_mm": 3.0},
     {"focus_mm": 700.0, "pupil_mm": 4.0}],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("diameter", [0.3, 1.0])
def test_a_dent_measured_finely_looks_as_the_dent_itself(tmp_path, backend, camera, diameter):
    """However its pixels are cut and whatever they look at: sub-rays of both see as much of it."""
    sigma = diameter / 4
    pitch, depth = sigma / 8, 6 * diameter
    x, y = grid(193, 193, pitch)
    write_sur(tmp_path / "x.sur", pit(x, y, (0, 0), sigma, depth), None, (pitch, pitch), 1e-8)
    place = {"x_mm": 0.03, "y_mm": -0.02}
    dent = {"kind": "dent", "diameter_mm": diameter, "depth_um": depth, **place}
    measured = {"kind": "measured", "file": "x.sur", "form_removed": "none", "taper": 0.0, **place}
    measured["zone_height_um"] = depth / 8
    images = [
        backend.trace(
            Station.from_dict(
                {
                    "part": {"length_mm": 16.0, "width_mm": 6.0},
                    "camera": {"sampling_mm": 0.1, "columns": 40, "rows": 30, "pupil_mm": 0.0,
                               **camera},
                    "sequence": {"images": 12},
                    "defects": [defect],
                },
                "s.toml", tmp_path,
            )
        ).aspect()
        for defect in (dent, measured)
    ]  # fmt: skip
    assert images[0].max() > np.median(images[0]) + 20
    np.testing.assert_allclose(*images, atol=MAP_AS_DENT_DN)


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
    assert "part.length_mm = 0.48, part.width_mm = 0.4;" in message
