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


def relief_headers(grooves: Array, maps: Array, mixed: bool = False) -> tuple[str, ...]:
    """What a program needs of relief.h, with these records, the grooves listed from the last on."""
    define = "#define MIXED_BLOCKS" if mixed else ""
    coefficient = """DEVICE REAL coefficient_at(COUNTER at) {
        return (TO_REAL((at * 37u) % 101u) - 50.0f) * 1e-4f; }"""
    lists = f"""{define}
STRUCT(Lists) {{ int maps; int blocks; int first[2]; int last[2]; MASK mine[2]; }};
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


@holds("away_from", wrong=("away.y = at.shift_y", "away.y = -at.shift_y"))
def test_a_place_is_as_far_from_a_record_as_its_pixels_and_its_shift_say(device: Device) -> None:
    d = Draws(310)
    rows = struct(
        "Groove", 1, column=9000.0, row=70.0, column_fraction=0.625, row_fraction=0.125, defect=0.0
    )
    column, row = np.floor(9000 + d.pixel(-9, 9)), np.floor(70 + d.pixel(-9, 9))
    shift_x, shift_y = d.pixel(-0.1, 0.1), d.pixel(-0.1, 0.1)
    inputs = {"REAL column": column, "REAL row": row, "REAL shift_x": shift_x,
              "REAL shift_y": shift_y}  # fmt: skip
    code = PLACE + "Away away = away_from(place, groove_at(0), 0.125f);"
    headers = relief_headers(rows, NO_MAP)
    got = stacked(device.call(headers, code, inputs, ("away.x", "away.y")))
    east = (column + 0.25 - 9000.625) * 0.125 + shift_x
    north = shift_y - (row + 0.75 - 70.125) * 0.125
    close(got, np.stack([east, north]), 1e-6)


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


@holds(
    "mixed_grooves_at",
    wrong=("s.height = mine ? with.height : s.height", "s.height = with.height"),
)
def test_neighbours_of_different_blocks_have_the_grooves_of_their_own(device: Device) -> None:
    d = Draws(53)
    rows = struct(
        "Groove", 6, column=d.rng.uniform(990, 1010, (6, 1)).round(), row=1000.0,
        height=d.rng.uniform(0.01, 0.03, (6, 1)), inverse_variance=4.0,
        defect=np.arange(6)[:, None],
    )  # fmt: skip
    column, row = (np.floor(1000 + d.pixel(-9, 9)) for _ in "xy")
    inputs = {"REAL column": column, "REAL row": row}
    code = (
        "REAL shift_x = 0.0f; REAL shift_y = 0.0f;"
        + PLACE
        + """
        lists.blocks = 2; lists.first[0] = 0; lists.last[0] = 2; lists.first[1] = 2;
        lists.last[1] = 6; lists.mine[0] = column < 1000.0f; lists.mine[1] = column >= 1000.0f;
        Surface a = grooves_at(flat_surface(), lists, 0, 2, place, 0.1f);
        Surface b = grooves_at(flat_surface(), lists, 2, 6, place, 0.1f);
        Surface s = mixed_grooves_at(flat_surface(), lists, place, 0.1f);"""
    )
    fields = [field.removeprefix("s.") for field in SURFACE_FIELDS]
    outputs = [f"{name}.{field}" for name in "abs" for field in fields]
    first, second, got = np.split(
        stacked(device.call(relief_headers(rows, NO_MAP, mixed=True), code, inputs, outputs)), 3
    )
    assert np.ptp(first) > 0
    # Two programs' texts of one sum round differently on Mesa.
    close(got, np.where(column < 1000, first, second), rtol=4 * tolerances.FLOAT_ROUNDING)


def chips_and_burrs() -> tuple[Array, Array, Array, Array]:
    """Five edge defects as records, their middles, axes along and depths; and then a groove."""
    rng = np.random.default_rng(54)
    middle, along = rng.uniform(-2, 2, (5, 2)), rng.uniform(-2, 2, (5, 2))
    depth = rng.uniform(0.3, 1.2, 5)
    inverse = 1 / np.hypot(*along.T)
    edges = struct(
        "Groove", 5,
        column=np.floor(1000 + middle[:, :1] / 0.125), row=np.floor(1000 - middle[:, 1:] / 0.125),
        column_fraction=0.5, row_fraction=0.25, along_x=along[:, :1], along_y=along[:, 1:],
        inverse_square=inverse[:, None] ** 2, inverse_length=inverse[:, None],
        inverse_variance=1 / depth[:, None] ** 2, outline=np.array([1, -1, 1, -1, 1])[:, None],
    )  # fmt: skip
    groove = struct("Groove", 1, column=1000.0, row=1000.0, height=0.01, inverse_variance=1.0)
    middle = np.stack(
        [(edges[:, 0] + 0.5 - 1000) * 0.125, (1000 - edges[:, 1] - 0.25) * 0.125], axis=1
    )
    return np.concatenate([edges, groove]), middle, along, depth


@holds("in_ellipse", wrong=("u * u + (off_x", "u * u * u * u + (off_x"))
@holds("outline_at", wrong=("edge.outline == 0.0f", "edge.outline <= 0.0f"))
def test_what_is_in_a_chip_is_beside_the_part_and_in_a_burr_of_it(device: Device) -> None:
    rows, middle, along, depth = chips_and_burrs()
    d = Draws(55)
    column, row = (np.floor(1000 + d.pixel(-4, 4) / 0.125) for _ in "xy")
    shift_x, shift_y = d.pixel(-0.1, 0.1), d.pixel(-0.1, 0.1)
    inputs = {"REAL column": column, "REAL row": row, "REAL shift_x": shift_x,
              "REAL shift_y": shift_y}  # fmt: skip
    code = (
        PLACE
        + """REAL said = outline_at(lists, 0, 6, place, 0.125f);
        Groove first = GROOVE(lists, 0); MASK inside = in_ellipse(place.shift_x, shift_y, first);
        REAL alone = inside ? TO_REAL(place.column) : 0.0f * shift_x;"""
    )
    said, alone = device.call(relief_headers(rows, NO_MAP), code, inputs, ("said", "alone"))
    x = (column + 0.25 - 1000) * 0.125 + shift_x
    y = (1000 - row - 0.75) * 0.125 + shift_y

    def square(i: int, x: Array, y: Array) -> Array:
        angle = np.arctan2(along[i, 1], along[i, 0])
        u = (x * np.cos(angle) + y * np.sin(angle)) / np.hypot(*along[i])
        v = (y * np.cos(angle) - x * np.sin(angle)) / depth[i]
        return u**2 + v**2

    away = np.stack([square(i, x - middle[i, 0], y - middle[i, 1]) for i in range(5)])
    # Listed from the last on: the groove, then the edge defects; the first of the list says.
    expected = np.zeros(x.shape)
    for i in range(5):
        expected = np.where(away[i] < 1, rows[i, -1], expected)
    clear = (np.abs(away - 1) > 1e-4).all(axis=0)
    assert clear.mean() > 0.99
    assert set(np.unique(expected[clear])) == {-1.0, 0.0, 1.0}
    np.testing.assert_array_equal(said[clear], expected[clear])
    np.testing.assert_array_equal(alone != 0, square(0, shift_x, shift_y) < 1)


@holds("mixed_outline_at", wrong=("lists.mine[i] ? says : said", "lists.mine[i] ? said : says"))
def test_neighbours_of_different_blocks_have_the_outline_of_their_own(device: Device) -> None:
    rows, *_ = chips_and_burrs()
    d = Draws(56)
    column, row = (np.floor(1000 + d.pixel(-20, 20)) for _ in "xy")
    inputs = {"REAL column": column, "REAL row": row}
    code = (
        "REAL shift_x = 0.0f; REAL shift_y = 0.0f;"
        + PLACE
        + """
        lists.blocks = 2; lists.first[0] = 0; lists.last[0] = 3; lists.first[1] = 3;
        lists.last[1] = 6; lists.mine[0] = column < 1000.0f; lists.mine[1] = column >= 1000.0f;
        REAL a = outline_at(lists, 0, 3, place, 0.125f);
        REAL b = outline_at(lists, 3, 6, place, 0.125f);
        REAL both = mixed_outline_at(lists, place, 0.125f);"""
    )
    headers = relief_headers(rows, NO_MAP, mixed=True)
    first, second, got = stacked(device.call(headers, code, inputs, ("a", "b", "both")))
    assert np.ptp(first) > 0
    assert (first != second).any()
    np.testing.assert_array_equal(got, np.where(column < 1000, first, second))


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
        Surface s = crown(x0 * k, y0 * k, g.curvature_x, g.curvature_y);
        Sight w = sight(g, s, x0, y0, z, 0.0f * x0);"""
    outputs = [f"{v}.{name}" for v in "vw" for name in ("light", "wide", "narrow", "lost")]
    got = stacked(device.call(relief_headers(NO_GROOVE, NO_MAP), code, inputs, outputs))
    seen = (got[3] == 0) & (got[7] == 0)
    assert seen.mean() > 0.9
    close(got[0][seen], got[4][seen], 1e-3)
    for width in (1, 2):
        close(got[width][seen], got[4 + width][seen], rtol=tolerances.FOOTPRINT)
