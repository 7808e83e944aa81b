"""Device functions of `kernels/surface.h`, one by one, each a law."""

from __future__ import annotations

import numpy as np
import tolerances
from device import LANES, Device
from laws import (
    SURFACE,
    SURFACE_FIELDS,
    Array,
    Draws,
    basis,
    close,
    holds,
    named,
    pieces,
    rounded,
    sagitta,
    shared,
    stacked,
)


@holds("flat_surface", wrong=("s.curve_xy = 0.0f;", "s.curve_xy = 1.0f;"))
@holds("add_surface", wrong=("a.curve_xy += b.curve_xy;", ""))
def test_surfaces_add_and_the_flat_one_adds_nothing(device: Device) -> None:
    d = Draws(1)
    a, b = np.stack([d.vectors(), d.vectors()]).reshape(2, 3, -1, LANES)
    inputs = {**named("a", a), **named("b", b)}
    code = """Surface a = flat_surface(), b = flat_surface();
        a.height = ax; a.slope_x = ay; a.slope_y = az;
        a.curve_xx = bx; a.curve_xy = by; a.curve_yy = bz;
        b.height = bx; b.slope_x = by; b.slope_y = bz;
        b.curve_xx = ax; b.curve_xy = ay; b.curve_yy = az;
        Surface s = add_surface(a, b), n = add_surface(a, flat_surface());"""
    outputs = SURFACE_FIELDS + tuple(f.replace("s.", "n.", 1) for f in SURFACE_FIELDS)
    got = stacked(device.call(SURFACE, code, inputs, outputs))
    first = np.concatenate([a, b])
    close(got[:6], first + np.concatenate([b, a]), tolerances.FLOAT_ROUNDING, 0)
    np.testing.assert_array_equal(got[6:], first)


@holds("crown", wrong=("s.slope_y = -(cy * y) / qy;", "s.slope_y = -(cy * y) * qy;"))
def test_a_crown_is_two_circles_with_their_slopes_and_curvatures(device: Device) -> None:
    d = Draws(2)
    x, y = d.pixel(-100, 100), d.pixel(-25, 25)
    sign = np.where(d.shared(0, 1) < 0.5, -1, 1)
    cx, cy = rounded(sign / d.scales(150, 1e7, True)), rounded(sign / d.scales(40, 1e7, True))
    cx[:5] = cy[3:8] = 0
    x[0], y[1] = 0, 0
    inputs = {"REAL x": x, "REAL y": y, **shared(cx=cx, cy=cy)}
    got = stacked(device.call(SURFACE, "Surface s = crown(x, y, cx, cy);", inputs, SURFACE_FIELDS))
    e = 1e-3
    expected = [sagitta(x, cx) + sagitta(y, cy)]
    for u, c in ((x, cx), (y, cy)):
        expected.append((sagitta(u + e, c) - sagitta(u - e, c)) / (2 * e))
    for u, c in ((x, cx), (y, cy)):
        expected.append((sagitta(u + e, c) - 2 * sagitta(u, c) + sagitta(u - e, c)) / e**2)
    close(got[0], expected[0], rtol=tolerances.CROWN)
    close(got[1:3], expected[1:3], tolerances.SLOPE_DIFFERENCE, tolerances.CROWN)
    close(got[[3, 5]], expected[3:], tolerances.CURVE_DIFFERENCE, tolerances.CROWN)
    assert not got[4].any()


@holds("sphere", wrong=("more * x * y;", "0.5f * more * x * y;"))
def test_a_sphere_has_the_slopes_and_curvatures_of_its_heights(device: Device) -> None:
    d = Draws(3)
    x, y = d.pixel(-60, 60), d.pixel(-25, 25)
    c = rounded(np.where(d.shared(0, 1) < 0.5, -1, 1) / d.scales(150, 1e7, True))
    c[:5] = 0
    inputs = {"REAL x": x, "REAL y": y, **shared(c=c)}
    got = stacked(device.call(SURFACE, "Surface s = sphere(x, y, c);", inputs, SURFACE_FIELDS))
    e = 1e-3

    def z(dx: int, dy: int) -> Array:
        return sagitta(np.hypot(x + dx * e, y + dy * e), c)

    slopes = [(z(1, 0) - z(-1, 0)) / (2 * e), (z(0, 1) - z(0, -1)) / (2 * e)]
    mixed = (z(1, 1) - z(1, -1) - z(-1, 1) + z(-1, -1)) / (4 * e**2)
    curves = [(z(1, 0) - 2 * z(0, 0) + z(-1, 0)) / e**2, mixed,
              (z(0, 1) - 2 * z(0, 0) + z(0, -1)) / e**2]  # fmt: skip
    close(got[0], z(0, 0), rtol=tolerances.CROWN)
    close(got[1:3], slopes, tolerances.SLOPE_DIFFERENCE, tolerances.CROWN)
    close(got[3:], curves, tolerances.CURVE_DIFFERENCE, tolerances.CROWN)


@holds("shape_at", wrong=("g.spherical > 0.0f", "g.spherical < 0.0f"))
def test_a_part_is_a_sphere_or_a_crown(device: Device) -> None:
    d = Draws(4)
    x, y = d.pixel(-60, 60), d.pixel(-25, 25)
    inputs = {"REAL x": x, "REAL y": y, **shared(c=rounded(1 / d.scales(150, 1e4, True)))}
    for spherical, same in ((1, "sphere(x, y, c)"), (0, "crown(x, y, c, 2.0f * c)")):
        set_up = f"""Geometry g; g.spherical = {spherical}.0f; g.curvature_x = c;
            g.curvature_y = 2.0f * c; Surface s = shape_at(g, x, y);"""
        got = device.call(SURFACE, set_up, inputs, SURFACE_FIELDS)
        expected = device.call(SURFACE, f"Surface s = {same};", inputs, SURFACE_FIELDS)
        assert np.array_equal(stacked(got), stacked(expected))


def test_beyond_its_circle_a_crown_stays_finite(device: Device) -> None:
    x = rounded([np.resize([0, 9.99, 10, 10.01, 20, -10, -1e3, 1e4], LANES)])
    inputs = {"REAL x": x, **shared(c=rounded([[0.1]]))}
    outputs = device.call(SURFACE, "Surface s = crown(x, x, c, c);", inputs, SURFACE_FIELDS)
    assert np.isfinite(stacked(outputs)).all()


@holds(
    "offset_mm", wrong=("(index - whole) + (sub - fraction)", "(index + sub) - (whole + fraction)")
)
def test_offsets_are_exact_to_the_last_bit_anywhere_on_the_part(device: Device) -> None:
    d = Draws(3)
    whole = np.floor(d.scales(1, 9e5, True))
    fraction, sub, sampling = d.shared(0, 1), d.shared(0, 1), d.scales(1e-3, 1, True)
    index = whole + np.floor(d.pixel(-30, 30))
    inputs = {
        "REAL index": index,
        **shared(sub=sub, whole=whole, fraction=fraction, sampling=sampling),
    }
    code = "REAL offset = offset_mm(index, sub, whole, fraction, sampling);"
    (got,) = device.call(SURFACE, code, inputs, ("offset",))
    pixels = (index - whole) + (sub - fraction)
    # Three roundings, of a pixel or of the whole offset where that is larger.
    bit = 1.5 * tolerances.FLOAT_ROUNDING * np.maximum(np.abs(pixels), 1)
    close(got, pixels * sampling, bit * sampling)


NEAREST = ("n.square", "n.away_x", "n.away_y", "n.along_x", "n.along_y")


@holds("nearest_point", wrong=("clamp(share, 0.0f, 1.0f)", "max(share, 0.0f)"))
def test_no_point_of_a_line_is_nearer_than_the_nearest(device: Device) -> None:
    dx, dy, vx, vy, course = pieces(Draws(4))
    inputs = {"REAL dx": dx, "REAL dy": dy, "Groove piece": course}
    got = stacked(
        device.call(SURFACE, "Nearest n = nearest_point(dx, dy, piece);", inputs, NEAREST)
    )
    square, away_x, away_y, along_x, along_y = got
    step = np.linspace(0, 1, 2001)[:, None, None]
    least = np.hypot(dx - step * vx, dy - step * vy).min(axis=0)
    length = np.hypot(vx, vy)
    scale = length + np.hypot(dx, dy)
    assert (np.sqrt(square) <= least + tolerances.POINT * scale).all()
    close(square, away_x**2 + away_y**2, 1e-30, tolerances.SUM)
    # The nearest point is on the piece: neither beside it nor past its ends.
    foot_x, foot_y = dx - away_x, dy - away_y
    close(foot_x * vy - foot_y * vx, 0 * dx, tolerances.POINT * scale * length + 1e-30)
    share = (foot_x * vx + foot_y * vy) / np.maximum(length, 1e-30) ** 2
    allowed = tolerances.POINT * scale / np.maximum(length, 1e-30)
    assert ((share >= -allowed) & (share <= 1 + allowed)).all()
    # The line's direction there: of unit length, and none at a rounded end.
    inside = (share > allowed) & (share < 1 - allowed)
    raw = (dx * vx + dy * vy) / np.maximum(length, 1e-30) ** 2
    end = (raw < -allowed) | (raw > 1 + allowed) | (length == 0)
    unit_x, unit_y = vx / np.maximum(length, 1e-30), vy / np.maximum(length, 1e-30)
    close(along_x, np.where(inside & ~end, unit_x, along_x), tolerances.POINT)
    close(along_y, np.where(inside & ~end, unit_y, along_y), tolerances.POINT)
    assert not along_x[end].any()
    assert not along_y[end].any()
    assert inside.sum() > 500
    assert end.sum() > 500


@holds("nearer", wrong=("b.square < a.square", "b.square <= a.square"))
def test_of_two_points_the_nearer_is_kept_and_the_first_of_equals(device: Device) -> None:
    d = Draws(5)
    first = np.stack([np.abs(d.pixel(0, 1)), *(d.pixel(-1, 1) for _ in range(4))])
    other = np.stack([np.abs(d.pixel(0, 1)), *(d.pixel(-1, 1) for _ in range(4))])
    other[0, ::3] = first[0, ::3]
    names = [name[2:] for name in NEAREST]
    inputs = {f"REAL a_{name}": v for name, v in zip(names, first, strict=True)}
    inputs |= {f"REAL b_{name}": v for name, v in zip(names, other, strict=True)}
    code = "Nearest a, b; " + " ".join(f"a.{n} = a_{n}; b.{n} = b_{n};" for n in names)
    got = device.call(SURFACE, code + " Nearest n = nearer(a, b);", inputs, NEAREST)
    np.testing.assert_array_equal(stacked(got), np.where(other[0] < first[0], other, first))


def groove_height(dx: Array, dy: Array, vx: Array, vy: Array, depth: Array, sigma: Array) -> Array:
    share = (dx * vx + dy * vy) / np.maximum(vx**2 + vy**2, 1e-300)
    share = np.clip(share, 0, 1)
    square = (dx - share * vx) ** 2 + (dy - share * vy) ** 2
    return depth * np.exp(-square / (2 * sigma**2))


@holds(
    "gaussian_groove",
    wrong=("+ k * n.along_x * n.along_y;", "- k * n.along_x * n.along_y;"),
)
def test_slopes_and_curvatures_of_a_groove_are_the_derivatives_of_its_height(
    device: Device,
) -> None:
    d = Draws(6)
    dx, dy, vx, vy, course = pieces(d)
    depth = rounded(d.scales(1e-5, 0.05, True) * np.where(d.shared(0, 1) < 0.5, -1, 1))
    inverse = rounded(1 / d.scales(0.05, 0.6, True) ** 2)
    sigma = 1 / np.sqrt(inverse)
    inputs = {
        "REAL dx": dx, "REAL dy": dy, "Groove piece": course,
        **shared(depth=depth, inverse=inverse),
    }  # fmt: skip
    code = "Surface s = gaussian_groove(nearest_point(dx, dy, piece), depth, inverse);"
    got = stacked(device.call(SURFACE, code, inputs, SURFACE_FIELDS))
    e = 2e-4 * sigma

    def z(i: int, j: int) -> Array:
        return groove_height(dx + i * e, dy + j * e, vx, vy, depth, sigma)

    expected = np.stack([
        z(0, 0),
        (z(1, 0) - z(-1, 0)) / (2 * e),
        (z(0, 1) - z(0, -1)) / (2 * e),
        (z(1, 0) - 2 * z(0, 0) + z(-1, 0)) / e**2,
        (z(1, 1) - z(1, -1) - z(-1, 1) + z(-1, -1)) / (4 * e**2),
        (z(0, 1) - 2 * z(0, 0) + z(0, -1)) / e**2,
    ])  # fmt: skip
    # Where the rounded end begins the second derivative jumps, and differences see it.
    length = np.hypot(vx, vy)
    along = (dx * vx + dy * vy) / np.maximum(length, 1e-30)
    smooth = (length == 0) | ((np.abs(along) > 3 * e) & (np.abs(along - length) > 3 * e))
    assert smooth.mean() > 0.9
    # The distance is known to the last bit of the offsets it is the difference of.
    reach = 1 + np.hypot(dx, dy) / sigma
    for order, fields in enumerate(([0], [1, 2], [3, 4, 5])):
        limit = tolerances.GROOVE * reach * np.abs(depth) / sigma**order
        at = smooth if order else np.ones_like(smooth)
        for field in fields:
            close(got[field][at], expected[field][at], limit[at])


WEIGHTS = ("w.w0", "w.w1", "w.w2", "w.w3")


@holds("spline_value", wrong=("2.0f / 3.0f - 0.5f * v * v * (1.0f + u)", "0.666f - 0.5f * v * v"))
@holds("spline_slope", wrong=("u * (1.5f * u - 2.0f)", "u * (1.5f * u - 1.0f)"))
@holds("spline_curve", wrong=("3.0f * u - 2.0f", "3.0f * u - 1.0f"))
def test_spline_weights_are_the_cubic_b_spline_and_its_derivatives(device: Device) -> None:
    # A map's edge reaches half a pitch beyond its outermost points.
    u = Draws(7).pixel(-0.5, 1.5)
    u[0, :4] = 0, 1, -0.5, 1.5
    for order, code in enumerate(
        (
            "Spline w = spline_value(u);",
            "Spline w = spline_slope(u);",
            "Spline w = spline_curve(u);",
        )
    ):
        got = stacked(device.call(SURFACE, code, {"REAL u": u}, WEIGHTS))
        close(
            got,
            np.stack([p.deriv(order)(u) if order else p(u) for p in basis()]),
            tolerances.SPLINE,
        )
        close(got.sum(axis=0), np.full(u.shape, 1.0 if order == 0 else 0.0), tolerances.SPLINE)


@holds("spline_sum", wrong=("s.w2 * c2", "s.w2 * c1"))
def test_a_spline_is_the_weighted_sum_of_four_coefficients(device: Device) -> None:
    d = Draws(8)
    u, c = d.pixel(0, 1), np.stack([d.pixel(-1, 1) for _ in range(4)])
    inputs = {"REAL u": u, **{f"REAL c{i}": v for i, v in enumerate(c)}}
    code = "REAL z = spline_sum(spline_value(u), c0, c1, c2, c3);"
    (got,) = device.call(SURFACE, code, inputs, ("z",))
    close(got, sum(p(u) * v for p, v in zip(basis(), c, strict=True)), tolerances.SPLINE)
