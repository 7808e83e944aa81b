"""Device functions of `kernels/relief.h`, one by one, each a law."""

from __future__ import annotations

import numpy as np
import tolerances
from device import Device
from laws import (
    REFLECTION,
    SURFACE_FIELDS,
    Array,
    Draws,
    basis,
    close,
    holds,
    rounded,
    sagitta,
    shared,
    stacked,
    struct,
)
from scenes import members

from gpuspec.light.sources import structs
from gpuspec.part.grooves import BLOCK


def listed(name: str, function: str, rows: Array) -> str:
    """Text of a function of i that returns the i-th of some records, its values as literals."""
    lines = [f"DEVICE {name} {function}(int i) {{ {name} r;"]
    for number, row in enumerate(rows):
        values = zip(structs()[name], row, strict=True)
        lines.append(f"if (i == {number}) {{")
        lines += [f"r.{member} = {float(np.float32(value)):.9e}f;" for member, value in values]
        lines.append("}")
    return " ".join([*lines, "return r; }"])


def relief_headers(grooves: Array, maps: Array, maps_count: int = 0) -> tuple[str, ...]:
    """What a program needs of relief.h, with these records, the grooves listed from the last on."""
    coefficient = """DEVICE REAL coefficient_at(COUNTER at) {
        return (TO_REAL((at * 37u) % 101u) - 50.0f) * 1e-4f; }"""
    lists = f"""STRUCT(Lists) {{ int maps; }};
{listed("Groove", "groove_at", grooves)}
{listed("Map", "map_at", maps)}
{coefficient}
#define PIECE(lists, i) ({len(grooves) - 1} - (i))
#define GROOVE(lists, i) groove_at(i)
#define MAP(lists, i) map_at(i)
#define COEFFICIENT(lists, at) coefficient_at(at)"""
    return (*REFLECTION, lists, "relief.h")


NO_GROOVE, NO_MAP = struct("Groove", 1), struct("Map", 1)
PLACE = """Place place; place.column = column; place.row = row; place.sub_x = 0.25f;
    place.sub_y = 0.75f; place.shift_x = shift_x; place.shift_y = shift_y;
    Lists lists; lists.maps = 1;"""


@holds("block_of", wrong=("(last / BLOCK + 1)", "(columns / BLOCK + 1)"))
def test_a_block_is_counted_row_by_row_and_padding_is_of_the_last(device: Device) -> None:
    columns = np.repeat([1, 15, 16, 17, 160, 1000], 40)[:, None]
    rng = np.random.default_rng(50)
    column, row = rng.integers(0, columns + 8), rng.integers(0, 700, columns.shape)
    inputs = shared(column=column, row=row, columns=columns)
    code = """Lists lists; lists.maps = 0;
        REAL b = FLOAT(block_of(INT(column), INT(row), INT(columns)));"""
    (got,) = device.call(relief_headers(NO_GROOVE, NO_MAP), code, inputs, ("b",))
    across = -(-columns // BLOCK)
    expected = row // BLOCK * across + np.minimum(column // BLOCK, across - 1)
    np.testing.assert_array_equal(got, np.broadcast_to(expected, got.shape))


@holds("grooves_at", wrong=("if (piece.defect == defect) {", "if (false) {"))
def test_grooves_of_different_defects_add_and_of_one_the_nearest_piece_counts(
    device: Device,
) -> None:
    d = Draws(51)
    owner = np.array([0, 1, 1, 1, 2, 4])[:, None]
    rng = np.random.default_rng(52)
    start, course = rng.uniform(-3, 3, (6, 2)), rng.uniform(-2, 2, (6, 2))
    course[0] = 0
    depth = np.array([-0.01, 0.02, 0.02, 0.02, -0.03, 0.005])
    sigma = np.array([0.5, 0.4, 0.4, 0.4, 0.3, 0.6])
    square = (course**2).sum(axis=1)
    inverse = np.divide(1, square, out=np.zeros(6), where=square > 0)
    sampling = 0.125
    whole = np.floor(1000 + start / sampling)
    rows = struct(
        "Groove", 6,
        column=whole[:, :1], row=whole[:, 1:], column_fraction=0.5, row_fraction=0.25,
        along_x=course[:, :1], along_y=course[:, 1:], inverse_square=inverse[:, None],
        inverse_length=np.sqrt(inverse)[:, None], height=depth[:, None],
        inverse_variance=1 / sigma[:, None] ** 2, defect=owner,
    )  # fmt: skip
    column, row = (np.floor(1000 + d.pixel(-4, 4) / sampling) for _ in "xy")
    shift_x, shift_y = d.pixel(-0.1, 0.1), d.pixel(-0.1, 0.1)
    inputs = {"REAL column": column, "REAL row": row, "REAL shift_x": shift_x,
              "REAL shift_y": shift_y}  # fmt: skip
    code = PLACE + f"Surface s = grooves_at(flat_surface(), lists, 0, 6, place, {sampling}f);"
    got = stacked(device.call(relief_headers(rows, NO_MAP), code, inputs, SURFACE_FIELDS))

    def height(ex: float = 0.0, ey: float = 0.0) -> Array:
        total = 0.0
        for one in np.unique(owner):
            nearest = np.inf
            for i in np.flatnonzero(owner[:, 0] == one):
                dx = (column + 0.25 - whole[i, 0] - 0.5) * sampling + shift_x + ex
                dy = shift_y + ey - (row + 0.75 - whole[i, 1] - 0.25) * sampling
                share = np.clip((dx * course[i, 0] + dy * course[i, 1]) * inverse[i], 0, 1)
                away = (dx - share * course[i, 0]) ** 2 + (dy - share * course[i, 1]) ** 2
                nearest = np.minimum(nearest, away)
            total = total + depth[i] * np.exp(-nearest / (2 * sigma[i] ** 2))
        return np.asarray(total)

    close(got[0], height(), tolerances.GROOVES_MM)
    # Where another piece or end becomes the nearest, the slope has a crease that differences see.
    e = 1e-5
    slopes = np.stack([height(e) - height(-e), height(0, e) - height(0, -e)]) / (2 * e)
    assert np.quantile(np.abs(got[1:3] - slopes), 0.99) < tolerances.GROOVES_MM / sigma.min()


def grid() -> tuple[Array, Array, float]:
    """One map of 9 x 7 points whose first coefficient is far along, and its coefficients."""
    first = 65_536 + 77
    at = np.arange(first, first + 11 * 9, dtype=np.uint32)
    coefficients = (((at * np.uint32(37)) % np.uint32(101)) - 50.0).reshape(9, 11) * 1e-4
    per_mm = 4.0
    rows = struct(
        "Map", 1, column=np.array([[100.0]]), row=200.0, column_fraction=0.5, row_fraction=0.5,
        points_x=9.0, points_y=7.0, first_low=77.0, first_high=1.0, points_per_mm_x=per_mm,
        points_per_mm_y=2 * per_mm,
    )  # fmt: skip
    return rows, coefficients, per_mm


def spline_surface(u: Array, v: Array, c: Array, per_mm: float) -> Array:
    """Height and derivatives of the grid's spline, by SciPy's basis."""
    i, j = (np.clip(np.floor(t), 0, n - 2).astype(int) for t, n in ((u, 9), (v, 7)))
    px, py = per_mm, 2 * per_mm

    def of(nx: int, ny: int) -> Array:
        total = np.zeros_like(u)
        for a, x in enumerate(basis()):
            for b, y in enumerate(basis()):
                wx = (x.deriv(nx) if nx else x)(u - i)
                wy = (y.deriv(ny) if ny else y)(v - j)
                total += c[j + b, i + a] * wx * wy
        return total * px**nx * py**ny

    return np.stack([of(0, 0), of(1, 0), of(0, 1), of(2, 0), of(1, 1), of(0, 2)])


@holds("map_surface", wrong=("at += width;", "at += width - 1u;"))
def test_a_map_is_the_spline_of_its_coefficients_with_its_derivatives(device: Device) -> None:
    d = Draws(53)
    rows, c, per_mm = grid()
    u, v = d.pixel(-0.5, 8.5), d.pixel(-0.5, 6.5)
    code = "Lists lists; lists.maps = 1; Surface s = map_surface(lists, map_at(0), u, v);"
    inputs = {"REAL u": u, "REAL v": v}
    got = stacked(device.call(relief_headers(NO_GROOVE, rows), code, inputs, SURFACE_FIELDS))
    expected = spline_surface(u, v, c, per_mm)
    scale = np.array([1, 4, 8, 16, 32, 64])[:, None, None] * 5e-3
    close(got, expected, tolerances.SPLINE * 4 * scale)


@holds("maps_at", wrong=("u <= map.points_x - 0.5f", "u <= map.points_x + 0.5f"))
def test_a_map_reaches_half_a_pitch_beyond_its_points_and_is_nothing_outside(
    device: Device,
) -> None:
    d = Draws(54)
    rows, c, per_mm = grid()
    sampling = 0.0625
    column, row = np.floor(d.pixel(90, 150)), np.floor(d.pixel(170, 210))
    shift_x, shift_y = d.pixel(-0.05, 0.05), d.pixel(-0.05, 0.05)
    inputs = {"REAL column": column, "REAL row": row, "REAL shift_x": shift_x,
              "REAL shift_y": shift_y}  # fmt: skip
    code = (
        PLACE
        + f"""Surface one = flat_surface(); one.height = 1.0f;
        Surface s = maps_at(one, lists, place, {sampling}f);"""
    )
    got = stacked(device.call(relief_headers(NO_GROOVE, rows), code, inputs, SURFACE_FIELDS))
    u = ((column + 0.25 - 100.5) * sampling + shift_x) * per_mm
    v = (shift_y - (row + 0.75 - 200.5) * sampling) * 2 * per_mm
    on = (u >= -0.5) & (u <= 8.5) & (v >= -0.5) & (v <= 6.5)
    assert 0.1 < on.mean() < 0.9
    expected = np.where(on, spline_surface(u, v, c, per_mm), 0)
    expected[0] += 1
    clear = (np.abs(np.abs(u - 4) - 4.5) > 1e-4) & (np.abs(np.abs(v - 3) - 3.5) > 1e-4)
    scale = np.array([1, 4, 8, 16, 32, 64])[:, None, None] * 5e-3
    limit = tolerances.SPLINE * 20 * scale + tolerances.FLOAT_ROUNDING
    close(got[:, clear], expected[:, clear], np.broadcast_to(limit, got.shape)[:, clear])


@holds("sub_ray", wrong=("at.sub_y = (FLOAT(index / side)", "at.sub_y = (FLOAT(index % side)"))
def test_a_sub_ray_sees_what_its_pixel_s_place_on_the_part_sees(device: Device) -> None:
    d = Draws(55)
    columns, rows, sampling, side = 400.0, 300.0, 0.25, 3.0
    cx, cy = rounded(1 / d.shared(150, 1000)), rounded(-1 / d.shared(90, 1000))
    rises = (np.arange(d.groups) % 2).astype(float)[:, None]
    g = struct(
        "Geometry", d.groups, camera_height=d.shared(500, 1500), sampling=sampling,
        subsampling=side, columns=columns, rows=rows, rises=rises, half_length=60.0,
        half_width=60.0, curvature_x=cx, curvature_y=cy, tunnel_top=200.0,
        tunnel_half_length=1e4,
    )  # fmt: skip
    h = members("Geometry", g)["camera_height"][:, None]
    column, row = np.floor(d.pixel(0, 400)), np.floor(d.pixel(0, 300))
    index = 5  # the last column of sub-rays, the middle row
    x0 = (column - columns / 2 + 2.5 / 3) * sampling
    y0 = (rows / 2 - row - 1.5 / 3) * sampling
    z = np.zeros_like(x0)
    for _ in range(60):  # the crown's slopes are gentle: to the last bit
        k = 1 - z / h
        z = rises * (sagitta(x0 * k, cx) + sagitta(y0 * k, cy))
    inputs = {"REAL column": column, "REAL row": row, "Geometry g": g, "REAL x0": x0,
              "REAL y0": y0, "REAL z": z}  # fmt: skip
    code = f"""Lists lists; lists.maps = 0; REAL k = 1.0f - z / g.camera_height;
        Sight v = sub_ray(g, lists, 0, 0, column, row, {index});
        Sight w = sight(g, crown(x0 * k, y0 * k, g.curvature_x, g.curvature_y), x0, y0, z);"""
    outputs = [f"{v}.{name}" for v in "vw" for name in ("light", "footprint", "lost")]
    got = stacked(device.call(relief_headers(NO_GROOVE, NO_MAP), code, inputs, outputs))
    seen = (got[2] == 0) & (got[5] == 0)
    assert seen.mean() > 0.9
    close(got[0][seen], got[3][seen], 1e-3)
    close(got[1][seen], got[4][seen], rtol=tolerances.FOOTPRINT)
