"""Device functions of `kernels/slices.h` and those that trace slices, one by one, each a law."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import tolerances
from device import Device
from laws import FIELDS, REFLECTION, SURFACE, Array, Draws, close, holds, sagitta, stacked, struct
from numpy.typing import NDArray
from scenes import check_station, members
from scipy.ndimage import maximum_filter, minimum_filter
from test_relief_on_devices import NO_GROOVE, NO_MAP, relief_headers

from gpuspec.light.constants import AT_LOSS
from gpuspec.light.float64_rays import slices
from gpuspec.light.refined import with_cut
from gpuspec.light.refinement import SLICES
from gpuspec.part.crossings import GROOVE, crossings
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

SLICED = "#define SLICED"
HEADERS = (SURFACE[0], SLICED, "slices.h")
COUNT = SLICES


def directions(d: Draws) -> tuple[Array, Array]:
    """Unit vectors, some along a pixel's sides and its diagonals, or nearly."""
    angle = d.rng.uniform(0, 2 * np.pi, (d.groups, 16))
    angle[:40] = np.arange(16) * np.pi / 4
    angle[10:30] += d.rng.normal(size=(20, 16)) * np.logspace(-9, -1, 20)[:, None]
    return np.float32(np.cos(angle)), np.float32(np.sin(angle))


def of_every_slice(inputs: dict[str, Array]) -> dict[str, Array]:
    """Inputs for each slice in turn, its number with them."""
    groups = len(next(iter(inputs.values())))
    repeated = {
        name: np.tile(values, (COUNT, *[1] * (values.ndim - 1))) for name, values in inputs.items()
    }
    return {**repeated, "float index": np.repeat(np.arange(COUNT, dtype=float), groups)}


def chord(nx: Array, ny: Array, place: Array) -> tuple[Array, Array, Array]:
    """Middle and length of n.(x, y) = place within a unit square, clipped side by side."""
    low, high = np.full(nx.shape, -9.0), np.full(nx.shape, 9.0)
    for start, along in ((nx * place, -ny), (ny * place, nx)):
        ways = [(edge - start) / np.where(along == 0, 1e-300, along) for edge in (-0.5, 0.5)]
        low, high = np.maximum(low, np.minimum(*ways)), np.minimum(high, np.maximum(*ways))
    middle = (low + high) / 2
    return nx * place - ny * middle, ny * place + nx * middle, high - low


@holds("chord_at", wrong=("0.5f * (ax + ay) - depth", "0.5f * (ax + ay) + depth"))
def test_a_chord_goes_through_the_pixel_from_side_to_side(device: Device) -> None:
    d = Draws(301)
    nx, ny = directions(d)
    thin, wide = np.sort(np.abs([nx, ny]), axis=0)
    corner = d.rng.random(nx.shape) < 0.5
    share = d.pixel(0.02, 0.98)
    depth = np.where(corner, thin * share, thin + (wide - thin) / 2 * share)
    there = np.where(corner, thin, wide - thin) > 1e-4
    inputs = {"REAL nx": nx, "REAL ny": ny, "REAL depth": depth, "REAL corner": corner}
    code = "Chord c = chord_at(nx, ny, depth, corner > 0.5f);"
    got = stacked(device.call(HEADERS, code, inputs, ("c.x", "c.y", "c.length")))
    exact = [np.asarray(values, np.float64) for values in (nx, ny)]
    size = np.hypot(*exact)
    place = (np.abs(exact[0]) + np.abs(exact[1])) / 2 - depth
    expected = np.stack(chord(exact[0] / size, exact[1] / size, place / size))
    close(got[:, there], expected[:, there], 2e-3 * (thin[there] < 0.01) + 1e-5)


@holds("slice_of", wrong=("0.28867513f", "0.2f"))
def test_slices_share_out_the_pixel_its_middle_and_its_variance(device: Device) -> None:
    d = Draws(302, groups=60)
    nx, ny = directions(d)
    outputs = [f"s.{name}" for name in ("x", "y", "across_x", "across_y", "along_x", "along_y",
                                        "share")]  # fmt: skip
    code = f"Slice s = slice_of(nx, ny, INT(index), {COUNT});"
    got = stacked(
        device.call(HEADERS, code, of_every_slice({"REAL nx": nx, "REAL ny": ny}), outputs)
    )
    got = got.reshape(len(outputs), COUNT, *nx.shape)
    x, y, across_x, across_y, along_x, along_y, share = got
    close(share.sum(axis=0), COUNT, 1e-4)
    for total, expected in (
        (x, 0), (y, 0), (12 * x * x + across_x**2 + along_x**2, 1),
        (12 * y * y + across_y**2 + along_y**2, 1),
        (12 * x * y + across_x * across_y + along_x * along_y, 0),
    ):  # fmt: skip
        close((share * total).mean(axis=0), expected, 1e-5)
    # One after another across the groove, and each as a fine grid of points finds it.
    assert (np.diff(x * nx + y * ny, axis=0)[share[1:] > 1e-3] > 0).all()
    assert np.abs(along_x * nx + along_y * ny).max() < 1e-5
    expected = slices((nx.astype(np.float64), ny.astype(np.float64)), COUNT)
    for number, (at_x, at_y, _, part) in enumerate(expected):
        there = part > 1e-3
        close(share[number], part, 5e-5)
        close(x[number][there], at_x[there], 1e-4)
        close(y[number][there], at_y[there], 1e-4)


def test_the_reference_s_slices_are_those_of_a_fine_grid_of_points():
    fine = 900
    grid = (np.arange(fine) + 0.5) / fine - 0.5
    u, v = np.meshgrid(grid, grid)
    for angle in (0.0, 0.3, np.pi / 4, 1.2, 2.9):
        nx, ny = np.cos(angle), np.sin(angle)
        found = list(slices((np.array(nx), np.array(ny)), COUNT))
        # Where one ends: so far that those before it have their shares.
        place = np.sort((u * nx + v * ny).ravel())
        shares = np.cumsum([part / COUNT for *_, part in found])
        ends = place[np.minimum((shares * place.size).astype(int), place.size - 1)]
        of = np.searchsorted(ends[:-1], u * nx + v * ny)
        for number, (x, y, sides, part) in enumerate(found):
            if part < 1e-3:
                continue
            own = np.stack([u[of == number], v[of == number]])
            assert own.mean(axis=1) == pytest.approx([x, y], abs=2e-3)
            second = sum(np.outer(side, side) for side in sides) / 12
            assert np.allclose(np.cov(own), second, atol=2e-4)


def grooves(seed: int) -> tuple[Array, Array, Array]:
    """Records of six straight pieces on pixels of 0.125 mm, their starts and their courses."""
    rng = np.random.default_rng(seed)
    start, course = rng.uniform(-3, 3, (6, 2)), rng.uniform(-2, 2, (6, 2))
    whole = np.floor(1000 + start * [1, -1] / 0.125)
    inverse = 1 / np.hypot(*course.T)[:, None]
    rows = struct(
        "Groove", 6, column=whole[:, :1], row=whole[:, 1:], along_x=course[:, :1],
        along_y=course[:, 1:], inverse_square=inverse**2, inverse_length=inverse,
        height=-0.001, inverse_variance=4.0, defect=np.arange(6)[:, None],
    )  # fmt: skip
    return rows, (whole - 1000) * [0.125, -0.125], course


def nearest(x: Array, y: Array, start: Array, course: Array) -> tuple[NDArray[np.int64], Array]:
    """The piece nearest to each point, and by how much nearer it is than the next."""
    distance = []
    for (ax, ay), (bx, by) in zip(start, course, strict=True):
        share = np.clip(((x - ax) * bx + (y - ay) * by) / (bx**2 + by**2), 0, 1)
        distance.append(np.hypot(x - ax - share * bx, y - ay - share * by))
    order = np.sort(distance, axis=0)
    return np.argmin(distance, axis=0), order[1] - order[0]


@holds("nearest_course", wrong=("point.square < c.square", "point.square > c.square"))
def test_the_course_is_that_of_the_nearest_piece(device: Device) -> None:
    d = Draws(303)
    rows, start, course = grooves(304)
    column, row = (np.floor(1000 + d.pixel(-4, 4) / 0.125) for _ in "xy")
    inputs = {"REAL column": column, "REAL row": row}
    code = """Place place; place.column = column; place.row = row; place.sub_x = 0.0f * row + 0.5f;
        place.sub_y = place.sub_x; place.shift_x = 0.0f * row; place.shift_y = place.shift_x;
        Lists lists; lists.maps = 0;
        Course c; c.square = 0.0f * row + 1e30f; c.x = 0.0f * row; c.y = c.x;
        c = nearest_course(c, lists, 0, 6, place, 0.125f);"""
    headers = (SLICED, *relief_headers(rows, NO_MAP))
    got = stacked(device.call(headers, code, inputs, ("c.x", "c.y")))
    x, y = (column - 1000 + 0.5) * 0.125, (1000 - row - 0.5) * 0.125
    which, clear = nearest(x, y, start, course)
    unit = course / np.hypot(*course.T)[:, None]
    sure = clear > 1e-3
    close(np.moveaxis(got, 0, -1)[sure], unit[which][sure], 1e-5)


@holds("course_at", wrong=("-x0 * (z * inverse)", "x0 * (z * inverse)"))
def test_the_groove_of_a_pixel_is_the_nearest_to_its_centre_on_the_shape(device: Device) -> None:
    d = Draws(305)
    rows, start, course = grooves(306)
    cx = d.shared(1 / 300, 1 / 120)
    g = struct(
        "Geometry", d.groups, camera_height=120.0, sampling=0.125, subsampling=COUNT,
        columns=2000.0, rows=2000.0, rises=(np.arange(d.groups) % 2).astype(float)[:, None],
        curvature_x=cx,
    )  # fmt: skip
    # A shape far from z = 0 where the grooves are: the parallax is of some pixels.
    far = np.array([40.0, 0.0])
    rows[:, 0] += far[0] / 0.125
    column = np.floor(1000 + (far[0] + d.pixel(-4, 4)) / 0.125)
    row = np.floor(1000 + d.pixel(-4, 4) / 0.125)
    inputs = {"REAL column": column, "REAL row": row, "Geometry g": g}
    code = """Lists lists; lists.maps = 0; lists.blocks = 1; lists.first[0] = 0;
        lists.last[0] = 6; lists.mine[0] = column == column;
        Course c = course_at(g, lists, 0, 6, column, row);"""
    unit = course / np.hypot(*course.T)[:, None]
    x0, y0 = (column - 1000 + 0.5) * 0.125, (1000 - row - 0.5) * 0.125
    z, h = np.zeros_like(x0), 120.0
    rises = members("Geometry", g)["rises"][:, None]
    for _ in range(80):
        z = rises * sagitta(x0 * (1 - z / h), cx)
    shifted = x0 * (1 - z / h), y0 * (1 - z / h)
    which, clear = nearest(*shifted, start + far, course)
    assert np.abs(shifted[0] - x0).max() > 1
    for mixed in (False, True):
        headers = (SLICED, *relief_headers(rows, NO_MAP, mixed))
        got = stacked(device.call(headers, code, inputs, ("c.x", "c.y")))
        sure = clear > 2e-3
        close(np.moveaxis(got, 0, -1)[sure], unit[which][sure], 1e-5)


@holds("meeting_of", wrong=("-x0 * (m.z * inverse)", "x0 * (m.z * inverse)"))
def test_a_ray_meets_the_part_where_its_place_is_as_high(device: Device) -> None:
    d = Draws(307)
    cx, cy = d.shared(1 / 1000, 1 / 300), d.shared(1 / 1000, 1 / 300)
    rises = (np.arange(d.groups) % 2).astype(float)[:, None]
    g = struct(
        "Geometry", d.groups, camera_height=800.0, sampling=0.25, subsampling=1.0, columns=400.0,
        rows=300.0, rises=rises, curvature_x=cx, curvature_y=cy,
    )  # fmt: skip
    column, row = np.floor(d.pixel(0, 400)), np.floor(d.pixel(0, 300))
    x0, y0 = (column - 200 + 0.5) * 0.25, (150 - row - 0.5) * 0.25
    inputs = {"REAL column": column, "REAL row": row, "Geometry g": g, "REAL x0": x0,
              "REAL y0": y0}  # fmt: skip
    code = """Place place; place.column = column; place.row = row; place.sub_x = 0.5f;
        place.sub_y = 0.5f;
        place.shift_x = 0.0f * x0; place.shift_y = place.shift_x; Lists lists; lists.maps = 0;
        Meeting m = meeting_of(g, lists, 0, 0, place, x0, y0);"""
    outputs = ("m.z", "m.surface.height", "m.at.shift_x", "m.at.shift_y")
    z, height, east, north = stacked(
        device.call(relief_headers(NO_GROOVE, NO_MAP), code, inputs, outputs)
    )
    x, y = x0 + east, y0 + north
    close(height, sagitta(x, cx) + sagitta(y, cy), 1e-4)
    rising = rises[:, 0] > 0
    close(z[rising], height[rising], 2e-3)
    close(x[rising], (x0 * (1 - z / 800))[rising], 1e-4)
    assert np.abs(z[rising]).max() > 1
    assert not z[~rising].any()
    assert not east[~rising].any()


SQUARE = """c.slice.x = 0.0f * x0; c.slice.y = c.slice.x; c.slice.across_x = c.slice.x + 0.25f;
    c.slice.across_y = c.slice.x; c.slice.along_x = c.slice.x;
    c.slice.along_y = c.slice.x + 0.25f; c.slice.share = c.slice.x + 0.5f;"""


@holds(
    "slice_sight",
    wrong=("c.slice.along_x * slope.x", "c.slice.across_x * slope.x"),
)
def test_a_slice_that_is_a_square_sees_what_the_square_does(device: Device) -> None:
    d = Draws(308)
    g = struct(
        "Geometry", d.groups, camera_height=d.shared(500, 1500), pupil=d.shared(0, 6),
        sampling=0.25, subsampling=4.0, columns=400.0, rows=300.0, rises=1.0, half_length=60.0,
        half_width=60.0, tunnel_top=200.0, tunnel_half_length=1e4, roughness=d.shared(0, 1e-3),
    )  # fmt: skip
    inputs = {"REAL x0": d.pixel(-50, 50), "REAL y0": d.pixel(-50, 50), "Geometry g": g}
    inputs |= {
        f"REAL {name}": d.pixel(-scale, scale)
        for name, scale in zip(FIELDS, (0.1, 0.2, 0.2, 0.02, 0.02, 0.02), strict=True)
    }
    surface = "Surface s; " + " ".join(f"s.{name} = {name};" for name in FIELDS)
    fields = ("light", "wide", "narrow", "irradiance", "lost")
    outputs = [f"v.{field}" for field in fields]
    one = f"{surface} Sight v = sight_from(g, s, x0, y0, height, 0.0f, 0.0f, 0.0f * x0);"
    other = f"""{surface} CameraRay c = camera_ray(x0, y0, height, g.camera_height); {SQUARE}
        Sight v = slice_sight(g, s, c, 0.0f * x0);"""
    square = stacked(device.call(REFLECTION, one, inputs, outputs))
    sliced = stacked(device.call((SLICED, *REFLECTION), other, inputs, outputs))
    square[3] *= 0.5
    assert (square[3] > 0).mean() > 0.5
    close(sliced, square, 1e-6, rtol=1e-5)


@holds("slice_ray", wrong=("0.5f + slice.x", "0.5f - slice.x"))
def test_a_slice_s_ray_goes_through_its_middle(device: Device) -> None:
    d = Draws(309)
    g = struct(
        "Geometry", d.groups, camera_height=800.0, sampling=0.25, subsampling=COUNT,
        columns=400.0, rows=300.0, half_length=60.0, half_width=60.0, tunnel_top=200.0,
        tunnel_half_length=1e4,
    )  # fmt: skip
    nx, ny = directions(d)
    column, row = np.floor(d.pixel(0, 400)), np.floor(d.pixel(0, 300))
    inputs = {"REAL column": column, "REAL row": row, "REAL nx": nx, "REAL ny": ny,
              "Geometry g": g}  # fmt: skip
    code = """Lists lists; lists.maps = 0; lists.blocks = 0; Course groove; groove.x = ny;
        groove.y = -nx; groove.square = 0.0f * nx;
        Sight v = slice_ray(g, lists, 0, 0, column, row, groove, INT(index));"""
    outputs = ("v.light", "v.wide", "v.narrow", "v.irradiance")
    headers = (SLICED, *relief_headers(NO_GROOVE, NO_MAP))
    got = stacked(device.call(headers, code, of_every_slice(inputs), outputs))
    got = got.reshape(len(outputs), COUNT, *nx.shape)
    moves = 1 + 200 / 800  # flat under a ceiling: l = x0 (1 + H/h)
    for (x, _, sides, part), (light, wide, narrow, irradiance) in zip(
        slices((nx, ny), COUNT), got.swapaxes(0, 1), strict=True
    ):
        there = part > 1e-3
        close(light[there], (((column - 200 + 0.5 + x) * 0.25) * moves)[there], 2e-4)
        close(irradiance[there], part[there], 1e-4)
        widths = np.sort([np.abs(side[0]) * 0.25 * moves for side in sides], axis=0)
        close(np.hypot(wide, narrow)[there], np.hypot(*widths)[there], 1e-3)


def scratched(angle: float, width: float, **changes) -> Station:
    """One long scratch through the middle of a pinhole's view."""
    end = 4 * np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    scratch = {"kind": "scratch", "points_mm": [(-end).tolist(), end.tolist()],
               "width_mm": width, "depth_um": 2.0}  # fmt: skip
    return check_station(pupil=0.0, exposure=5.0).replace(
        camera__columns=60, camera__rows=60, part__width_mm=8.0, defects=[scratch], **changes
    )


@pytest.mark.parametrize("angle", [7.0, 35.0, 45.0, 90.0])
@pytest.mark.parametrize("width", [0.12, 0.25])
def test_slices_tell_as_much_as_three_times_as_many_squares(opencl, angle, width):
    """Where 8 x 8 are needed: of 48 x 48 squares, rms and in the worst pixel."""
    station = scratched(angle, width)
    relief = Relief.of(station)
    with opencl.trace(station) as light_map:
        at = np.cumsum([0, *light_map.refined.values()])
        ways = dict(zip(light_map.refined, pairwise(at), strict=True))
        own = light_map.places[slice(*ways[-SLICES])]
    assert len(own) > 100
    exact, squares, sliced = (
        opencl.traced(with_cut(station, cut), relief, own).mean()[0] for cut in (48, 8, -SLICES)
    )
    rms = [np.sqrt(((image - exact) ** 2).mean()) for image in (squares, sliced)]
    most = [np.abs(image - exact).max() for image in (squares, sliced)]
    assert rms[1] < tolerances.SLICES_OF_SQUARES * rms[0] + tolerances.SLICES_RMS_DN
    assert most[1] < tolerances.SLICES_OF_SQUARES * most[0] + 10 * tolerances.SLICES_RMS_DN


def test_where_light_is_lost_across_a_groove_pixels_are_squares(device_backend):
    # The tunnel's end runs across the scratch: slices are lost whole, or seen whole.
    wrong = []
    for length in np.arange(4.0, 4.4, 0.05):
        station = scratched(2.0, 0.25, tunnel__length_mm=float(length))
        relief = Relief.of(station)
        light_map = device_backend.trace(station)
        lost = light_map.base.lost() != 0
        squares, chosen = (
            device_backend.trace(station.replace(camera__subsampling=n)).aspect()
            for n in (8, "auto")
        )
        near = maximum_filter(lost, 3) & ~minimum_filter(lost, 3)
        across = crossings(station, relief, np.arange(lost.size)).reshape(lost.shape)
        both = near & (across == GROOVE)
        assert both.any()
        assert (light_map.base.sides_needed()[near] == AT_LOSS).all()
        wrong.append(np.abs(chosen - squares)[both].max())
        some = np.flatnonzero(both)[:40].astype(np.uint32)
        listed = device_backend.trace(station, relief, some).aspect()[0]
        assert np.abs(listed - chosen.flat[some]).max() < tolerances.SAME_IMAGES_DN
    assert max(wrong) < tolerances.FOOTPRINT_MAX_DN
