"""Every function of `kernels/*.h`, alone on the device, against float64.

Where there is one, the reference is not the function's own formula: derivatives are differences of
heights, integrals are sums of overlaps, Fresnel's reflectance is that of complex amplitudes, and
tunnels are met by bisection. Inputs are rounded to float first, so that what is seen is the
function's error alone.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import tolerances
from device import DEVICES, LANES, Device, Outputs, open_device
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scenes import members
from scipy.interpolate import BSpline
from scipy.stats import poisson

from gpuspec.light.float64 import random_words
from gpuspec.light.records import packed
from gpuspec.light.sources import folder, structs
from gpuspec.part.grooves import BLOCK
from gpuspec.station.materials import MATERIALS

Array = NDArray[np.float64]
Law = Callable[[Device], None]
Edit = tuple[str, str]

GROUPS = 250
"""Groups of eight pixels that share what a function takes as `float`: 2000 random inputs."""

SURFACE = ("station.h", "surface.h")
REFLECTION = (*SURFACE, "reflection.h")
STRIPES = ("stripes.h",)
SENSOR = ("station.h", "sensor.h")

LAWS: dict[str, tuple[Law, Edit]] = {}
"""Function to the test that holds it, and to an edit that this test must notice."""


def holds(function: str, wrong: Edit) -> Callable[[Law], Law]:
    """Register the test of a device function."""

    def register(law: Law) -> Law:
        source = inspect.getsource(law)
        assert f"{function}(" in source, f"{law.__name__} does not call {function}"
        LAWS[function] = law, wrong
        return law

    return register


@pytest.fixture(scope="module", params=DEVICES)
def device(request: pytest.FixtureRequest) -> Device:
    return open_device(request.param)


# ------------------------------------------------------------------------------------------ inputs


def rounded(values: Any) -> Array:
    return np.asarray(values, np.float32).astype(np.float64)


class Draws:
    """Random inputs, rounded to float: (GROUPS, 8) for each pixel, (GROUPS, 1) shared."""

    def __init__(self, seed: int, groups: int = GROUPS) -> None:
        self.rng = np.random.default_rng(seed)
        self.groups = groups

    def pixel(self, low: float, high: float) -> Array:
        return rounded(self.rng.uniform(low, high, (self.groups, LANES)))

    def shared(self, low: float, high: float) -> Array:
        return rounded(self.rng.uniform(low, high, (self.groups, 1)))

    def scales(self, low: float, high: float, shared: bool = False) -> Array:
        """Values of every order of magnitude."""
        exponents = self.rng.uniform(
            np.log(low), np.log(high), (self.groups, 1 if shared else LANES)
        )
        return rounded(np.exp(exponents))

    def vectors(self) -> Array:
        return np.stack([self.pixel(-1, 1) for _ in range(3)])

    def units(self) -> Array:
        v = self.rng.normal(size=(3, self.groups, LANES))
        return rounded(v / np.sqrt(dot(v, v)))


def dot(a: Array, b: Array) -> Array:
    return np.einsum("i...,i...->...", a, b)


def named(name: str, vector: Array) -> dict[str, Array]:
    """Inputs of a vector's three components."""
    return {f"REAL {name}{axis}": part for axis, part in zip("xyz", vector, strict=True)}


def shared(**values: Array) -> dict[str, Array]:
    return {f"float {name}": np.broadcast_to(v, (len(v), 1))[:, 0] for name, v in values.items()}


def struct(name: str, groups: int, **members: Any) -> Array:
    """Records of a struct of `kernels/station.h`, (groups, members); those not given are 0."""
    values = dict.fromkeys((m for m in structs()[name] if not m.startswith("unused")), 0.0)
    assert members.keys() <= values.keys(), (name, tuple(members))
    filled = {m: np.broadcast_to(members.get(m, 0.0), (groups, 1))[:, 0] for m in values}
    return packed(name, **filled).astype(np.float64)


def design_of(records: Array, *names: str) -> list[Array]:
    """Members of designs, (groups, 1) each."""
    return [members("Design", records)[name][:, None] for name in names]


def stacked(outputs: Outputs) -> Array:
    return np.stack(outputs).astype(np.float64)


def close(got: Any, expected: Any, atol: Any = 0.0, rtol: float = 0.0) -> None:
    got, expected = np.asarray(got, np.float64), np.asarray(expected)
    limit = atol + rtol * np.abs(expected)
    excess = np.where(np.isfinite(got), np.abs(got - expected) / np.maximum(limit, 1e-300), np.inf)
    worst = np.unravel_index(np.argmax(excess), excess.shape)
    assert excess.max() <= 1, (
        f"{excess.max():.3g} times the tolerance at {worst}: got {got[worst]}, "
        f"expected {np.broadcast_to(expected, got.shape)[worst]}"
    )


def components(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.{axis}" for axis in "xyz")


FIELDS = ("height", "slope_x", "slope_y", "curve_xx", "curve_xy", "curve_yy")
SURFACE_FIELDS = tuple(f"s.{field}" for field in FIELDS)
SET_SURFACE = "Surface s; " + " ".join(f"s.{field} = {field};" for field in FIELDS)


# ------------------------------------------------------------------------------------------ surface


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


def sagitta(x: Array, curvature: Array) -> Array:
    """Height of a circle through 0, as the integral of its slope angle: no cancellation."""
    angle = np.arcsin(curvature * x)
    return -x * np.tan(angle / 2)


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


def test_beyond_its_circle_a_crown_stays_finite(device: Device) -> None:
    x = rounded([[0, 9.99, 10, 10.01, 20, -10, -1e3, 1e4]])
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


def pieces(d: Draws) -> tuple[Array, Array, Array, Array, Array]:
    """Straight pieces of centre lines and points near them: on, beside, past the ends, at them."""
    angle = d.rng.uniform(0, 2 * np.pi, (d.groups, 1))
    length = d.scales(0.01, 20, True)
    length[:10] = 0
    vx, vy = rounded(length * np.cos(angle)), rounded(length * np.sin(angle))
    length = np.hypot(vx, vy)
    inverse = np.divide(1, length, out=np.zeros_like(length), where=length > 0)
    share, beside = d.pixel(-0.5, 1.5), d.pixel(-0.6, 0.6)
    beside[10:40] = 0
    dx = rounded(share * vx - beside * np.sin(angle))
    dy = rounded(share * vy + beside * np.cos(angle))
    dx[40:50], dy[40:50] = 0, 0
    dx[50:60], dy[50:60] = np.broadcast_to(vx[50:60], (10, 8)), np.broadcast_to(vy[50:60], (10, 8))
    course = {
        "along_x": vx, "along_y": vy, "inverse_square": inverse**2, "inverse_length": inverse,
    }  # fmt: skip
    return dx, dy, vx, vy, struct("Groove", d.groups, **course)


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


def basis() -> list[Polynomial]:
    """The four pieces of a cubic B-spline over [0, 1], from SciPy's."""
    spline = BSpline.basis_element(np.arange(-2.0, 3.0))
    points = np.array([0.1, 0.3, 0.6, 0.9])
    return [Polynomial.fit(points, spline(points + 1 - k), 3).convert() for k in range(4)]


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


# -------------------------------------------------------------------------------------- reflection


@holds("vector", wrong=("v.z = z;", "v.z = y;"))
@holds("inner", wrong=("a.y * b.y + a.z * b.z", "a.y * b.y - a.z * b.z"))
@holds("along", wrong=("a.y + k * b.y", "a.y - k * b.y"))
@holds("scaled", wrong=("vector(k * a.x, k * a.y, k * a.z)", "vector(k * a.x, k * a.y, a.z)"))
def test_vectors_add_scale_and_project(device: Device) -> None:
    d = Draws(9)
    a, b, k = d.vectors(), d.vectors(), d.pixel(-3, 3)
    code = """Vector a = vector(ax, ay, az), b = vector(bx, by, bz);
        Vector sum = along(a, k, b), times = scaled(k, a); REAL product = inner(a, b);"""
    inputs = {**named("a", a), **named("b", b), "REAL k": k}
    outputs = (*components("sum"), *components("times"), "product")
    got = stacked(device.call(REFLECTION, code, inputs, outputs))
    close(got[:3], a + k * b, tolerances.VECTOR)
    close(got[3:6], k * a, tolerances.VECTOR)
    close(got[6], dot(a, b), tolerances.VECTOR)


@holds("unit_change", wrong=("-inner(unit, change), unit", "inner(unit, change), unit"))
def test_the_change_of_a_unit_vector_is_its_derivative(device: Device) -> None:
    d = Draws(10)
    n = d.units() * d.scales(0.5, 900)
    change = d.vectors()
    size = np.sqrt(dot(n, n))
    unit = rounded(n / size)
    size = rounded(size)
    inputs = {**named("u", unit), **named("c", change), "REAL size": size}
    code = "Vector r = unit_change(vector(ux, uy, uz), size, vector(cx, cy, cz));"
    got = stacked(device.call(REFLECTION, code, inputs, components("r")))
    e = 1e-5 * size
    ahead, behind = unit * size + e * change, unit * size - e * change
    difference = ahead / np.sqrt(dot(ahead, ahead)) - behind / np.sqrt(dot(behind, behind))
    close(got * size, difference / (2 * e) * size, tolerances.DERIVATIVE)


@holds(
    "surface_normal",
    wrong=("vector(-s.slope_x, -s.slope_y, 1.0f)", "vector(s.slope_x, s.slope_y, 1.0f)"),
)
def test_the_normal_is_perpendicular_to_the_surface_and_points_up(device: Device) -> None:
    d = Draws(11)
    zx, zy = d.pixel(-1, 1), d.pixel(-1, 1)
    code = (
        "Surface s = flat_surface(); s.slope_x = zx; s.slope_y = zy; Vector n = surface_normal(s);"
    )
    n = stacked(device.call(REFLECTION, code, {"REAL zx": zx, "REAL zy": zy}, components("n")))
    close(n[0] + zx * n[2], 0 * zx, tolerances.VECTOR)
    close(n[1] + zy * n[2], 0 * zx, tolerances.VECTOR)
    assert (n[2] == 1).all()


@holds("reflect_direction", wrong=("(incident, normal), normal)", "(incident, normal), incident)"))
def test_the_angle_out_is_the_angle_in_and_the_three_are_coplanar(device: Device) -> None:
    d = Draws(12)
    i, n = d.units(), d.units()
    n[:, 0], n[:, 1] = -i[:, 0], i[:, 1]
    i[:, 2], n[:, 2] = np.array([0, 0, -1])[:, None], np.array([0, 0, 1])[:, None]
    i[:, 3], n[:, 3] = np.array([1, 0, 0])[:, None], np.array([0, 0, 1])[:, None]
    inputs = {**named("i", i), **named("n", n)}
    code = "Vector r = reflect_direction(vector(ix, iy, iz), vector(nx, ny, nz));"
    r = stacked(device.call(REFLECTION, code, inputs, components("r")))
    close(dot(r, n), -dot(i, n), tolerances.VECTOR)
    close(dot(r, r), np.ones_like(r[0]), tolerances.VECTOR)
    close(dot(i, np.cross(n, r, axis=0)), 0 * r[0], tolerances.VECTOR)
    # What lies in the surface goes on as it came.
    close(np.cross(n, r, axis=0), np.cross(n, i, axis=0), tolerances.VECTOR)


@holds("reflect_change", wrong=("inner(d_incident, normal) + inner(incident", "inner(incident"))
def test_the_change_of_a_reflected_ray_is_its_derivative(device: Device) -> None:
    d = Draws(13)
    i, n, di, dn = d.units(), d.units(), d.vectors(), d.vectors()
    inputs = {**named("i", i), **named("n", n), **named("di", di), **named("dn", dn)}
    code = """Vector r = reflect_change(vector(ix, iy, iz), vector(nx, ny, nz),
                                       vector(dix, diy, diz), vector(dnx, dny, dnz));"""
    got = stacked(device.call(REFLECTION, code, inputs, components("r")))
    e = 1e-5

    def reflected(step: float) -> Array:
        ray, normal = i + step * di, n + step * dn
        return ray - 2 * dot(ray, normal) * normal

    close(got, (reflected(e) - reflected(-e)) / (2 * e), tolerances.DERIVATIVE)


@holds("newton_height", wrong=("(z - s.height) / (1.0f + ", "(z - s.height) / (1.0f - "))
def test_one_newton_step_meets_a_plane_and_a_few_a_crown(device: Device) -> None:
    d = Draws(14)
    x0, y0, guess = d.pixel(-100, 100), d.pixel(-25, 25), d.pixel(-5, 5)
    level, zx, zy = d.pixel(-5, 5), d.pixel(-0.5, 0.5), d.pixel(-0.5, 0.5)
    h = d.shared(300, 2000)
    k = 1 - guess / h
    height = rounded(level + zx * x0 * k + zy * y0 * k)
    inputs = {
        "REAL x0": x0, "REAL y0": y0, "REAL guess": guess, "REAL height": height,
        "REAL zx": zx, "REAL zy": zy, **shared(h=h),
    }  # fmt: skip
    code = """Surface s = flat_surface(); s.height = height; s.slope_x = zx; s.slope_y = zy;
        REAL z = newton_height(guess, s, x0, y0, h);"""
    (z,) = device.call(REFLECTION, code, inputs, ("z",))
    k = 1 - z.astype(float) / h
    plane = height + zx * x0 * (k - (1 - guess / h)) + zy * y0 * (k - (1 - guess / h))
    close(z, plane, tolerances.HEIGHT_MM)
    cx, cy = rounded(1 / d.shared(150, 1000)), rounded(-1 / d.shared(40, 1000))
    inputs = {"REAL x0": x0, "REAL y0": y0, **shared(h=h, cx=cx, cy=cy)}
    code = """REAL z = 0.0f * x0;
        for (int i = 0; i < NEWTON_STEPS; i++) {
            Surface s = crown(x0 * (1.0f - z / h), y0 * (1.0f - z / h), cx, cy);
            z = newton_height(z, s, x0, y0, h);
        }"""
    (z,) = device.call(REFLECTION, code, inputs, ("z",))
    k = 1 - z.astype(float) / h
    close(z, sagitta(x0 * k, cx) + sagitta(y0 * k, cy), tolerances.HEIGHT_MM)


class Hill:
    """A smooth surface of which all derivatives are known: the part of `sight`'s test."""

    def __init__(self, d: Draws) -> None:
        self.slope = d.shared(-0.05, 0.05), d.shared(-0.05, 0.05)
        self.bend = tuple(d.shared(-2e-3, 2e-3) for _ in range(3))
        self.cubic = d.shared(-2e-5, 2e-5)

    def fields(self, x: Array, y: Array) -> list[Array]:
        (a, b), (xx, xy, yy), c = self.slope, self.bend, self.cubic
        return [
            a * x + b * y + xx * x * x / 2 + xy * x * y + yy * y * y / 2 + c * x**3 / 6,
            a + xx * x + xy * y + c * x * x / 2,
            b + xy * x + yy * y,
            xx + c * x,
            xy + 0 * x,
            yy + 0 * x,
        ]

    def meet(self, x0: Array, y0: Array, h: Array) -> Array:
        """Height at which the camera ray of (x0, y0, 0) meets the surface, by bisection."""
        low, high = np.full(x0.shape, -30.0), np.full(x0.shape, 30.0)
        for _ in range(60):
            z = (low + high) / 2
            above = z > self.fields(x0 * (1 - z / h), y0 * (1 - z / h))[0]
            low, high = np.where(above, low, z), np.where(above, z, high)
        return (low + high) / 2


@holds("surface_change", wrong=("vector(k * dx - x0 * dz / h", "vector(k * dx + x0 * dz / h"))
def test_the_change_of_the_surface_point_is_its_derivative(device: Device) -> None:
    d = Draws(15)
    hill = Hill(d)
    x0, y0, h = d.pixel(-50, 50), d.pixel(-25, 25), d.shared(300, 2000)
    dx, dy = d.shared(-1, 1), d.shared(-1, 1)
    rises = np.where(np.arange(d.groups) % 2 == 0, 1.0, 0.0)[:, None]
    z = rounded(rises * hill.meet(x0, y0, h))
    inputs = {"REAL x0": x0, "REAL y0": y0, "REAL z": z, **shared(h=h, dx=dx, dy=dy, rises=rises)}
    fields = hill.fields(x0 * (1 - z / h), y0 * (1 - z / h))
    inputs |= {f"REAL {name}": v for name, v in zip(FIELDS, fields, strict=True)}
    code = SET_SURFACE + " Vector v = surface_change(s, x0, y0, z, h, dx, dy, rises);"
    got = stacked(device.call(REFLECTION, code, inputs, components("v")))
    e = 1e-3

    def point(step: float) -> Array:
        x, y = x0 + step * dx, y0 + step * dy
        z = rises * hill.meet(x, y, h)
        return np.stack([x * (1 - z / h), y * (1 - z / h), z])

    close(got, (point(e) - point(-e)) / (2 * e), tolerances.DERIVATIVE)


def rays_up(d: Draws) -> tuple[Array, Array]:
    """Points on the part and rays that go up, the first ones vertical, along x, and grazing."""
    origin = np.stack([d.pixel(-100, 100), d.pixel(-25, 25), d.pixel(-3, 3)])
    ray = d.units()
    ray[2] = np.abs(ray[2])
    ray[:, 0] = np.array([0, 0, 1])[:, None]
    ray[:, 1] = rounded(np.array([0.6, 0, 0.8])[:, None])
    ray[:, 2] = rounded(np.array([1, 0, 1e-3])[:, None])
    ray[:, 3] = rounded(np.array([0, -1, 1e-4])[:, None])
    return origin, ray


HIT = ("hit.path", *components("hit.normal"))
RAY = "Vector o = vector(ox, oy, oz), r = vector(rx, ry, rz); "


def hits(device: Device, code: str, origin: Array, ray: Array, **sizes: Array) -> tuple[Array, ...]:
    """Path, normal, point, and the rounding to expect of the point."""
    inputs = {**named("o", origin), **named("r", ray), **shared(**sizes)}
    path, *normal = stacked(device.call(REFLECTION, RAY + code, inputs, HIT))
    scale = path + np.abs(origin).max(axis=0) + max(np.max(size) for size in sizes.values())
    return path, np.stack(normal), origin + path * ray, tolerances.HIT * scale


@holds("hit_ceiling", wrong=("(height - origin.z) / max", "(height + origin.z) / max"))
def test_rays_meet_the_ceiling_at_its_height(device: Device) -> None:
    d = Draws(16)
    origin, ray = rays_up(d)
    height = d.shared(50, 500)
    _, normal, point, limit = hits(
        device, "Hit hit = hit_ceiling(o, r, height);", origin, ray, height=height
    )
    close(point[2], np.broadcast_to(height, point[2].shape), limit)
    assert (normal == np.array([0, 0, 1])[:, None, None]).all()


@holds("hit_box", wrong=("first ? side : hit.normal.y", "first ? -side : hit.normal.y"))
def test_rays_meet_the_box_where_they_first_leave_it(device: Device) -> None:
    d = Draws(17)
    origin, ray = rays_up(d)
    height, width = d.shared(50, 500), d.shared(30, 200)
    # Rays to the very corner, where wall and ceiling tie, all numbers exact.
    origin[:, 4] = 0
    height[4], width[4] = 64, 64
    ray[:, 4] = np.array([0, 0.5, 0.5])[:, None]
    ray[1, 4, ::2] *= -1
    code = "Hit hit = hit_box(o, r, height, half_width);"
    path, normal, point, limit = hits(device, code, origin, ray, height=height, half_width=width)
    assert (path > 0).all()
    assert (point[2] <= height + limit).all()
    assert (np.abs(point[1]) <= width + limit).all()
    wall = normal[2] == 0
    close(np.where(wall, np.abs(point[1]), point[2]), np.where(wall, width, height), limit)
    np.testing.assert_array_equal(normal[1], np.where(wall, np.sign(ray[1]), 0))
    np.testing.assert_array_equal(normal[2], np.where(wall, 0, 1))
    assert not normal[0].any()
    assert 200 < wall.sum() < 1800
    assert (path[4] == 128).all()
    # Straight up along a wall the ceiling is met, not the wall.
    assert not wall[0].any()


@holds("hit_arch", wrong=("0.0f)) - b) / a", "0.0f)) + b) / a"))
def test_rays_meet_the_arch_on_its_circle(device: Device) -> None:
    d = Draws(18)
    origin, ray = rays_up(d)
    radius = d.shared(60, 500)
    code = "Hit hit = hit_arch(o, r, radius);"
    path, normal, point, limit = hits(device, code, origin, ray, radius=radius)
    assert (path > 0).all()
    # Where a ray runs along the axis, its path is long and its place on the circle uncertain.
    close(np.hypot(point[1], point[2]), np.broadcast_to(radius, path.shape), limit)
    close(normal * radius, np.stack([0 * path, point[1], point[2]]), limit)


@holds("hit_tunnel", wrong=("g.section == SECTION_BOX", "g.section == 3.0f"))
def test_the_tunnel_is_met_in_its_own_section(device: Device) -> None:
    d = Draws(19)
    origin, ray = rays_up(d)
    section = (np.arange(d.groups) % 3)[:, None]
    sizes = d.shared(50, 500), d.shared(30, 200), d.shared(200, 900)
    tunnel = {
        "section": section, "tunnel_top": sizes[0], "tunnel_half_width": sizes[1],
        "tunnel_half_length": sizes[2],
    }  # fmt: skip
    g = struct("Geometry", d.groups, **tunnel)
    inputs = {**named("o", origin), **named("r", ray), "Geometry g": g}
    code = (
        RAY
        + """Hit hit = hit_tunnel(o, r, g), c = hit_ceiling(o, r, g.tunnel_top),
        b = hit_box(o, r, g.tunnel_top, g.tunnel_half_width), a = hit_arch(o, r, g.tunnel_top);"""
    )
    outputs = [name.replace("hit", hit, 1) for hit in ("hit", "c", "b", "a") for name in HIT]
    got = stacked(device.call(REFLECTION, code, inputs, outputs)).reshape(4, 4, *ray.shape[1:])
    np.testing.assert_array_equal(got[0], np.choose(section, got[1:]))


def reflectance(cosine: Array, n: Array, k: Array) -> Array:
    """Reflectance of unpolarised light from Fresnel's complex amplitudes, Snell's law with them."""
    index = n - 1j * k
    sine = np.sqrt(1 - cosine**2) / index
    inside = np.sqrt(1 - sine**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    result: Array = (np.abs(s) ** 2 + np.abs(p) ** 2) / 2
    return result


@holds("fresnel_reflectance", wrong=("c2 * modulus + s2 * s2", "c2 * modulus + s2"))
def test_reflectance_is_that_of_fresnels_complex_amplitudes(device: Device) -> None:
    d = Draws(20)
    cosine, n, k = d.pixel(0, 1), d.shared(0.05, 4), d.shared(0, 7)
    cosine[:, 0], cosine[:, 1], cosine[:, 2] = 0, 1, rounded(1e-3)
    for group, (index, extinction) in enumerate(MATERIALS.values()):
        n[group], k[group] = rounded(index), rounded(extinction)
    k[10:60], n[10:60] = 0, d.shared(1.2, 4)[10:60]
    inputs = {"REAL cosine": cosine, **shared(n=n, k=k)}
    (got,) = device.call(REFLECTION, "REAL r = fresnel_reflectance(cosine, n, k);", inputs, ("r",))
    ideal = (n == 0) & (k == 0)
    expected = np.where(ideal, 1, reflectance(cosine, np.where(ideal, 2, n), k))
    close(got, expected, tolerances.REFLECTANCE)
    assert (got[ideal[:, 0]] == 1).all()
    close(got[:, 0], np.ones(d.groups), tolerances.REFLECTANCE)


class Scene:
    """What `sight` is called with, and the same rays followed in float64 without its formulas."""

    def __init__(self, seed: int) -> None:
        d = Draws(seed, 3 * GROUPS)
        self.hill = Hill(d)
        n = d.groups
        section = (np.arange(n) % 3)[:, None]
        self.section = section
        self.x0, self.y0 = d.pixel(-60, 60), d.pixel(-20, 20)
        self.x0[:3], self.y0[:3] = 0, 0
        self.h = d.shared(500, 1500)
        self.rises = (np.arange(n) // 3 % 2)[:, None].astype(float)
        self.top, self.width = d.shared(80, 200), d.shared(35, 60)
        self.length = d.shared(60, 400)
        self.pupil = np.where(d.shared(0, 1) < 0.3, 0, d.shared(0, 10))
        self.rough = np.where(d.shared(0, 1) < 0.5, 0, d.shared(0, 0.02))
        self.sampling = d.scales(0.005, 0.2, True)
        self.sub = np.floor(d.shared(1, 5))
        self.part = d.shared(40, 60), d.shared(12, 20)
        self.opening = d.shared(5, 30), d.shared(5, 30)
        closed = d.shared(0, 1) < 0.5
        self.opening = tuple(np.where(closed, 0, size) for size in self.opening)
        self.cos4 = (d.shared(0, 1) < 0.5).astype(float)
        materials = np.array(list(MATERIALS.values()))
        self.n, self.k = rounded(materials[np.arange(n) % len(materials)]).T[..., None]
        # Some parts so steep that rays go down.
        self.hill.slope[0][9:60] = rounded(d.shared(0.7, 1.1)[9:60])
        # The first parts flat and seen from straight above, their rays vertical.
        for field in (*self.hill.slope, *self.hill.bend, self.hill.cubic):
            field[:3] = 0
        # The camera's opening above the origin, not above what is tilted.
        self.opening[0][:3] = self.opening[1][:3] = 0
        self.z = rounded(self.rises * self.hill.meet(self.x0, self.y0, self.h))

    def inputs(self) -> dict[str, Array]:
        k = 1 - self.z / self.h
        fields = self.hill.fields(self.x0 * k, self.y0 * k)
        g = struct(
            "Geometry",
            len(self.h),
            camera_height=self.h,
            pupil=self.pupil,
            sampling=self.sampling,
            subsampling=self.sub,
            rises=self.rises,
            vignetting=self.cos4,
            half_length=self.part[0],
            half_width=self.part[1],
            section=self.section,
            tunnel_top=self.top,
            tunnel_half_width=self.width,
            tunnel_half_length=self.length,
            opening_half_length=self.opening[0],
            opening_half_width=self.opening[1],
            roughness=self.rough,
            refractive_index=self.n,
            extinction=self.k,
        )
        return {
            "REAL x0": self.x0, "REAL y0": self.y0, "REAL z": self.z,
            **{f"REAL {name}": v for name, v in zip(FIELDS, fields, strict=True)},
            "Geometry g": g,
        }  # fmt: skip

    def follow(self, x0: Array, y0: Array) -> dict[str, Array]:
        """Follow the camera rays of (x0, y0, 0); meet the tunnel by bisection."""
        z = self.rises * self.hill.meet(x0, y0, self.h)
        k = 1 - z / self.h
        point = np.stack([x0 * k, y0 * k, z])
        _, zx, zy, *_ = self.hill.fields(point[0], point[1])
        incident = point - np.stack([0 * z, 0 * z, 0 * z + self.h])
        distance = np.sqrt(dot(incident, incident))
        incident = incident / distance
        normal = np.stack([-zx, -zy, np.ones_like(z)])
        normal = normal / np.sqrt(dot(normal, normal))
        ray = incident - 2 * dot(incident, normal) * normal
        low, high = np.zeros_like(z), np.full(z.shape, 1e6)
        for _ in range(80):
            path = (low + high) / 2
            y, top = point[1] + path * ray[1], point[2] + path * ray[2]
            outside = np.where(self.section == 2, np.hypot(y, top) > self.top, top > self.top)
            outside |= (self.section == 1) & (np.abs(y) > self.width)
            low, high = np.where(outside, low, path), np.where(outside, path, high)
        light = point + path * ray
        wall = (self.section == 1) & (np.abs(light[1]) > self.width - 1e-6)
        return {
            "point": point, "ray": ray, "path": path, "light": light, "distance": distance,
            "wall": wall, "cosine": -dot(incident, normal),
        }  # fmt: skip


WAY = (
    SET_SURFACE
    + """CameraRay c = camera_ray(x0, y0, z, g.camera_height);
    Mirror m = mirror_of(c, s); Hit hit = hit_tunnel(c.point, m.ray, g);
    Vector met = along(c.point, hit.path, m.ray);"""
)


@holds("camera_ray", wrong=("vector(x0 * k, y0 * k, z)", "vector(x0, y0 * k, z)"))
def test_a_camera_ray_leads_from_the_pinhole_through_its_pixel(device: Device) -> None:
    scene = Scene(46)
    code = "CameraRay c = camera_ray(x0, y0, z, g.camera_height);" + SET_SURFACE
    outputs = (*components("c.point"), *components("c.direction"), "c.distance")
    got = stacked(device.call(REFLECTION, code, scene.inputs(), outputs))
    point, direction, distance = got[:3], got[3:6], got[6]
    pinhole = np.stack([0 * scene.x0, 0 * scene.x0, scene.h + 0 * scene.x0])
    pixel = np.stack([scene.x0, scene.y0, 0 * scene.x0])
    seen = np.cross(pixel - pinhole, point - pinhole, axis=0) / scene.h**2
    close(seen, 0 * seen, tolerances.VECTOR)
    np.testing.assert_array_equal(point[2], scene.z)
    close(direction * distance, point - pinhole, tolerances.VECTOR * scene.h)
    close(dot(direction, direction), np.ones_like(distance), tolerances.VECTOR)


@holds("mirror_of", wrong=("m.length = sqrt(inner(upright, upright))", "m.length = upright.z"))
def test_the_part_mirrors_a_ray_about_its_normal(device: Device) -> None:
    scene = Scene(47)
    outputs = (*components("c.direction"), *components("m.normal"), *components("m.ray"))
    code = (
        SET_SURFACE
        + """CameraRay c = camera_ray(x0, y0, z, g.camera_height);
        Mirror m = mirror_of(c, s); REAL scaled_z = m.normal.z * m.length;"""
    )
    got = stacked(device.call(REFLECTION, code, scene.inputs(), (*outputs, "scaled_z")))
    incident, normal, ray = got[:3], got[3:6], got[6:9]
    k = 1 - scene.z / scene.h
    _, zx, zy, *_ = scene.hill.fields(scene.x0 * k, scene.y0 * k)
    close(normal[0] + zx * normal[2], 0 * zx, tolerances.VECTOR)
    close(normal[1] + zy * normal[2], 0 * zy, tolerances.VECTOR)
    close(got[9], np.ones_like(zx), tolerances.VECTOR)
    close(dot(normal, normal), np.ones_like(zx), tolerances.VECTOR)
    close(dot(ray, normal), -dot(incident, normal), tolerances.VECTOR)
    close(dot(incident, np.cross(normal, ray, axis=0)), 0 * zx, tolerances.VECTOR)


@holds("light_change", wrong=("moved.x + dt * m.ray.x", "moved.x"))
def test_the_change_of_the_light_coordinate_is_its_derivative(device: Device) -> None:
    scene = Scene(48)
    d = Draws(49, len(scene.h))
    dx, dy = d.shared(-1, 1), d.shared(-1, 1)
    code = (
        WAY
        + """REAL dl = light_change(g, s, c, m, hit, dx, dy);
        REAL lost = loss_of(g, c, m, hit, met);"""
    )
    inputs = {**scene.inputs(), **shared(dx=dx, dy=dy)}
    got, lost = device.call(REFLECTION, code, inputs, ("dl", "lost"))
    e = 1e-3
    ahead, behind = (scene.follow(scene.x0 + i * dx, scene.y0 + i * dy) for i in (e, -e))
    paths = scene.follow(scene.x0, scene.y0)
    change = (ahead["light"][0] - behind["light"][0]) / (2 * e)
    bend = ahead["light"][0] - 2 * paths["light"][0] + behind["light"][0]
    # Where wall and ceiling meet the light coordinate has a crease.
    smooth = (lost == 0) & (np.abs(bend) < 1e-4) & (np.abs(scene.z) < 29)  # met, by bisection
    assert smooth.sum() > 0.98 * (lost == 0).sum() > 1000
    # It grows with the path and with the ray's obliquity, and its error with it.
    limit = tolerances.FOOTPRINT * (np.abs(change) + 1) * (1 + 0.01 / paths["ray"][2] ** 2)
    close(got[smooth], change[smooth], limit[smooth])


@holds("loss_of_both", wrong=("LOST_NOT : max(a, b)", "LOST_NOT : min(a, b)"))
def test_a_pixel_is_seen_if_any_sub_ray_is_else_lost_for_the_largest_reason(device: Device) -> None:
    a, b, c = (rounded(v) for v in np.indices((5, 5, 5)).reshape(3, -1))
    pad = -len(a) % LANES
    a, b, c = (np.pad(v, (0, pad)).reshape(-1, LANES) for v in (a, b, c))
    code = "REAL r = loss_of_both(loss_of_both(loss_of_both(LOST_BESIDE + 0.0f * a, a), b), c);"
    inputs = {"REAL a": a, "REAL b": b, "REAL c": c}
    (got,) = device.call(REFLECTION, code, inputs, ("r",))
    rays = np.stack([a, b, c])
    np.testing.assert_array_equal(got, np.where((rays == 0).any(axis=0), 0, rays.max(axis=0)))


@holds("loss_of", wrong=("m.ray.z <= 0.0f ? LOST_DOWN", "m.ray.z <= -2.0f ? LOST_DOWN"))
@holds("footprint_of", wrong=("0.8660254f * g.pupil", "0.5f * g.pupil"))
@holds("irradiance_of", wrong=("cosine * cosine * cosine * cosine", "cosine * cosine"))
def test_loss_footprint_and_irradiance_are_those_of_the_ray_s_path(device: Device) -> None:
    scene = Scene(21)
    code = (
        WAY
        + """REAL lost = loss_of(g, c, m, hit, met);
        REAL w = footprint_of(g, s, c, m, hit); REAL e = irradiance_of(g, c, m);"""
    )
    light, footprint, irradiance, lost = stacked(
        device.call(REFLECTION, code, scene.inputs(), ("met.x", "w", "e", "lost"))
    )
    lit = lost == 0
    check_sight(scene, light * lit, np.where(lit, footprint, 1), np.where(lit, irradiance, 0), lost)


@holds("sight", wrong=("v.footprint = (lit ? footprint : 1.0f)", "v.footprint = 1.0f"))
def test_a_ray_sees_the_light_it_meets_over_the_footprint_that_differences_give(
    device: Device,
) -> None:
    scene = Scene(21)
    code = SET_SURFACE + " Sight v = sight(g, s, x0, y0, z);"
    outputs = ("v.light", "v.footprint", "v.irradiance", "v.lost")
    check_sight(scene, *stacked(device.call(REFLECTION, code, scene.inputs(), outputs)))


def check_sight(
    scene: Scene, light: Array, footprint: Array, irradiance: Array, lost: Array
) -> None:
    """Hold what rays see against the same rays followed without the functions' formulas."""
    paths = scene.follow(scene.x0, scene.y0)
    point, ray, met = paths["point"], paths["ray"], paths["light"]

    expected = np.zeros(lost.shape)
    half_length, half_width = scene.opening
    open_ = (half_length > 0) & ~paths["wall"]
    expected[open_ & (np.abs(met[0]) <= half_length) & (np.abs(met[1]) <= half_width)] = 4
    expected[np.abs(met[0]) > scene.length] = 3
    expected[ray[2] <= 0] = 2
    expected[(np.abs(point[0]) > scene.part[0]) | (np.abs(point[1]) > scene.part[1])] = 1
    # Within this of a border either side is right.
    margin = tolerances.SIGHT_MM
    edges = [
        (np.abs(met[0]), scene.length), (np.abs(met[0]), half_length),
        (np.abs(met[1]), half_width), (np.abs(point[0]), scene.part[0]),
        (np.abs(point[1]), scene.part[1]),
    ]  # fmt: skip
    clear = np.abs(ray[2]) > 1e-5
    for place, border in edges:
        clear &= np.abs(place - border) > margin
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(lost[clear], expected[clear])
    assert {0, 1, 2, 3, 4} == set(np.unique(lost[clear]))

    seen = lost == 0
    assert seen.mean() > 0.3
    for value, blind in ((light, 0), (footprint, 1), (irradiance, 0)):
        assert (value[~seen] == blind).all()

    # Where the ray hardly rises, path and light grow beyond all bounds, and their error with them.
    reach = 1 / np.maximum(ray[2], 1e-9) ** 2
    close(light[seen], met[0][seen], (tolerances.SIGHT_MM * np.maximum(reach, 1))[seen])

    p = scene.sampling / scene.sub
    e = 1e-3
    square = np.zeros_like(light)
    smooth = seen.copy()
    for dx, dy in ((e, 0.0), (0.0, e)):
        ahead = scene.follow(scene.x0 + dx, scene.y0 + dy)
        behind = scene.follow(scene.x0 - dx, scene.y0 - dy)
        smooth &= ahead["wall"] == behind["wall"]
        square += ((ahead["light"][0] - behind["light"][0]) / (2 * e) * p) ** 2
    # The box of the variance of a uniform disc (D^2/16), and of a tilt of 2 alpha rms.
    square += 12 * (scene.pupil / 4 * paths["path"] / paths["distance"]) ** 2
    square += 12 * (2 * scene.rough * paths["path"]) ** 2
    assert smooth.sum() > 0.99 * seen.sum()
    steep = 1 + 0.01 * reach
    close((footprint / np.maximum(np.sqrt(square), 1e-4))[smooth], np.ones(smooth.sum()),
          (tolerances.FOOTPRINT * steep)[smooth])  # fmt: skip

    field = np.arctan(np.hypot(scene.x0, scene.y0) / scene.h)
    vignetting = np.where(scene.cos4 == 1, np.cos(field) ** 4, 1)
    ideal = (scene.n == 0) & (scene.k == 0)
    rho = np.where(
        ideal, 1, reflectance(np.abs(paths["cosine"]), np.where(ideal, 2, scene.n), scene.k)
    )
    close(irradiance[seen], (rho * vignetting)[seen], tolerances.REFLECTANCE)
    # Seen from straight above, a flat part sends the ray straight up.
    vertical = seen[:3]
    assert vertical.all()
    assert (light[:3] == 0).all()


# ---------------------------------------------------------------------------------------- stripes


def overlap(light: Array, footprint: Array, luminous: Array) -> Array:
    """Lit fraction: the sum of the footprint's overlaps with one luminous stripe after another."""
    low, high = light - footprint / 2, light + footprint / 2
    first, last = int(np.floor(low.min())) - 1, int(np.ceil(high.max())) + 1
    lit = np.zeros(np.broadcast_shapes(light.shape, luminous.shape))
    for stripe in range(first, last + 1):
        lit += np.maximum(np.minimum(high, stripe + luminous) - np.maximum(low, stripe), 0)
    return lit / footprint


class Stripes:
    """Random footprints, in periods, over random stripes: every order of size, every share."""

    def __init__(self, seed: int) -> None:
        d = Draws(seed, 2 * GROUPS)
        self.light = d.pixel(-30, 30)
        self.footprint = d.scales(1e-5, 60)
        self.footprint[:20] = 1
        self.footprint[20:30] = 3
        self.footprint[30:40] = rounded(1e-4)
        self.luminous = d.shared(0.02, 0.98)
        self.luminous[40:60], self.luminous[60:80] = rounded(1e-4), rounded(1 - 1e-4)
        self.irradiance = d.pixel(0.2, 1)
        self.irradiance[80:90] = 0
        self.gain = d.scales(0.05, 100, True)
        self.leak = np.where(d.shared(0, 1) < 0.4, 0, d.shared(0, 0.9))
        self.gain[90:110], self.leak[90:110] = 8, 0.5
        self.draws = d
        self.inputs = {
            "REAL light": self.light, "REAL footprint": self.footprint,
            "REAL irradiance": self.irradiance,
            **shared(luminous=self.luminous, gain=self.gain, leak=self.leak),
        }  # fmt: skip

    @property
    def rounding(self) -> Array:
        """Uncertainty of the place of the footprint's ends: the last bit of where they are."""
        return tolerances.LIGHT_ROUNDING * (np.abs(self.light) + self.footprint + 1)

    def exposure(self, light: Array) -> Array:
        lit = overlap(light, self.footprint, self.luminous)
        return self.gain * self.irradiance * (self.leak + (1 - self.leak) * lit)


@holds("lit_fraction", wrong=("max(luminous + rest - 1.0f, 0.0f)", "0.0f * rest"))
@holds("at_shift", wrong=("fabs(u - rint(u))", "fabs(u - floor(u))"))
def test_the_lit_fraction_is_the_share_of_the_footprint_on_luminous_stripes(device: Device) -> None:
    s = Stripes(22)
    shift = s.draws.shared(0, 40)
    shift[::4] = 0
    code = "Trapezoid q = lit_fraction(light, footprint, luminous); REAL lit = at_shift(q, shift);"
    (got,) = device.call(STRIPES, code, {**s.inputs, **shared(shift=shift)}, ("lit",))
    limit = tolerances.LIT + (s.rounding + tolerances.LIGHT_ROUNDING * shift) / s.footprint
    close(got, overlap(s.light - shift, s.footprint, s.luminous), limit)
    inside = (got >= -limit) & (got <= 1 + limit)
    assert inside.all()


@holds("exposed", wrong=("q.slope *= full * (1.0f - leak)", "q.slope *= full"))
def test_exposure_is_gain_times_irradiance_times_what_is_lit_or_leaks(device: Device) -> None:
    s = Stripes(23)
    code = """Trapezoid q = lit_fraction(light, footprint, luminous);
        REAL e = at_shift(exposed(q, irradiance, gain, leak), 0.0f);"""
    (got,) = device.call(STRIPES, code, s.inputs, ("e",))
    full = s.gain * s.irradiance
    close(got, s.exposure(s.light), full * (tolerances.LIT + s.rounding / s.footprint) + 1e-30)
    assert not got[80:90].any()


@holds("series_side", wrong=("0.5f * (n0 + n1 - 1.0f)", "0.5f * (n0 + n1 + 1.0f)"))
def test_a_side_of_the_series_is_the_direct_sum_of_its_samples(device: Device) -> None:
    d = Draws(24)
    steps = d.scales(1, 800, True)
    o, reach = d.pixel(0, 1), rounded(d.pixel(0, 0.5) * steps)
    h = rounded(reach * d.pixel(0, 1))
    k = rounded(h * np.maximum(d.pixel(-1, 1), 0))
    k[:10] = h[:10]
    inputs = {"REAL o": o, "REAL reach": reach, "REAL h": h, "REAL k": k}
    (got,) = device.call(STRIPES, "REAL sum = series_side(o, reach, h, k);", inputs, ("sum",))
    distance = np.arange(420)[:, None, None] + o
    expected = (np.clip(reach - distance, k, h) - k).sum(axis=0)
    close(got, expected, tolerances.SERIES * (reach + 1) * (reach + 1))


@holds("mean_over_scan", wrong=("1.0f - phase, t.reach", "phase, t.reach"))
def test_the_mean_over_a_scan_is_the_mean_of_the_saturated_images(device: Device) -> None:
    s = Stripes(25)
    choices = np.array([1, 2, 3, 7, 8, 40, 100])
    shifts = choices[np.arange(s.draws.groups) % len(choices)][:, None]
    code = """REAL mean = mean_over_scan(exposed(lit_fraction(light, footprint, luminous),
                                             irradiance, gain, leak), shifts);"""
    (got,) = device.call(STRIPES, code, {**s.inputs, **shared(shifts=shifts)}, ("mean",))
    expected = np.zeros(got.shape)
    limit = np.zeros(got.shape)
    for k in range(int(shifts.max())):
        # Each image may be wrong by what the light's last bits are worth to it.
        taken = (k < shifts) / shifts
        here, *near = (
            np.minimum(s.exposure(s.light - k / shifts + e * s.rounding), 1) for e in (0, -1, 1)
        )
        expected += taken * here
        limit += taken * sum(np.abs(beside - here) for beside in near)
    # What is cut off above saturation was there: its last bit is lost.
    full = s.gain * s.irradiance
    close(got, expected, limit + tolerances.SCAN * full + 1e-30)
    # Dark stripes that leak enough saturate every image; no irradiance is dark.
    close(
        got[90:110],
        np.minimum(expected[90:110], 1),
        limit[90:110] + (tolerances.SCAN * full)[90:110],
    )
    assert not got[80:90].any()


@pytest.mark.slow
@holds("highest_mean_over_scan", wrong=("t.centre = t.reach - min", "t.centre = 0.0f * min"))
def test_no_light_coordinate_has_a_higher_mean_over_a_scan(device: Device) -> None:
    s = Stripes(29)
    choices = np.array([1, 2, 3, 7, 12])
    shifts = choices[np.arange(s.draws.groups) % len(choices)][:, None]
    code = """REAL mean = highest_mean_over_scan(exposed(lit_fraction(light, footprint, luminous),
                                             irradiance, gain, leak), shifts);"""
    (got,) = device.call(STRIPES, code, {**s.inputs, **shared(shifts=shifts)}, ("mean",))
    phases = 400
    highest = np.zeros(got.shape)
    for phase in np.arange(phases) / phases:
        mean = np.zeros(got.shape)
        for k in range(int(shifts.max())):
            light = s.light + (phase - k) / shifts
            mean += (k < shifts) / shifts * np.minimum(s.exposure(light), 1)
        highest = np.maximum(highest, mean)
    # What is cut off above saturation was there: its last bit is lost.
    lost = tolerances.SCAN * s.gain * s.irradiance + 1e-6
    assert (got >= highest - lost).all()
    # It is reached: between two phases no image changes by more than its flank is steep.
    steep = s.gain * s.irradiance / s.footprint * (1 / (phases * shifts) + 2e-6)
    assert (got <= highest + lost + np.minimum(steep, 1)).all()


# ----------------------------------------------------------------------------------------- sensor


def pcg4d(column: int, row: int, image: int, seed: int) -> tuple[int, ...]:
    """pcg4d in whole numbers, as Jarzynski and Olano print it."""
    mask = 0xFFFFFFFF
    x, y, z, w = ((v * 1664525 + 1013904223) & mask for v in (column, row, image, seed))
    for last in (False, True):
        x = (x + y * w) & mask
        y = (y + z * x) & mask
        z = (z + x * y) & mask
        w = (w + y * z) & mask
        if not last:
            x, y, z, w = (v ^ (v >> 16) for v in (x, y, z, w))
    return x, y, z, w


@holds("random_words", wrong=("v.d ^= v.d >> 16u;", ""))
def test_random_words_are_pcg4d(device: Device) -> None:
    rng = np.random.default_rng(26)
    counters = rng.integers(0, 2**32, (4, 64, LANES), np.uint32)
    extremes = np.array([0, 1, 2, 2**31 - 1, 2**31, 2**32 - 1, 2**16, 12345], np.uint32)
    for axis in range(4):
        counters[axis, axis] = extremes
        counters[axis, 8:16] = extremes[rng.integers(0, 8, (8, LANES))]
    inputs = {f"COUNTER {n}": v for n, v in zip("xyzw", counters, strict=True)}
    outputs = [f"COUNTER r.{n}" for n in "abcd"]
    got = device.call(SENSOR, "Words r = random_words(x, y, z, w);", inputs, outputs)
    expected = [pcg4d(*map(int, c)) for c in counters.reshape(4, -1).T]
    np.testing.assert_array_equal(np.stack(got).reshape(4, -1).T, np.array(expected, np.uint32))


@holds("uniform_number", wrong=("+ 0.5f) * 1.1920929e-7f", ") * 1.1920929e-7f"))
def test_uniform_numbers_are_the_middles_of_equal_steps(device: Device) -> None:
    word = np.random.default_rng(27).integers(0, 2**32, (GROUPS, LANES), np.uint32)
    word[0] = 0, 511, 512, 2**31, 2**31 - 1, 2**32 - 1, 2**32 - 512, 2**32 - 513
    (got,) = device.call(SENSOR, "REAL u = uniform_number(word);", {"COUNTER word": word}, ("u",))
    np.testing.assert_array_equal(got, ((word >> 9) + 0.5) / 2**23)
    assert got.min() > 0
    assert got.max() < 1


@holds("normal_numbers", wrong=("radius * sin(angle)", "radius * sin(2.0f * angle)"))
def test_normal_numbers_are_the_coordinates_of_box_and_mullers_point(device: Device) -> None:
    words = np.random.default_rng(28).integers(0, 2**32, (2, GROUPS, LANES), np.uint32)
    words[0, 0, :4] = words[1, 1, :4] = 0, 511, 2**32 - 1, 2**31
    inputs = {"COUNTER word": words[0], "COUNTER other": words[1]}
    code = "Normals n = normal_numbers(word, other);"
    first, second = stacked(device.call(SENSOR, code, inputs, ("n.first", "n.second")))
    u, v = ((w >> np.uint32(9)).astype(float) / 2**23 + 2.0**-24 for w in words)
    point = np.sqrt(-2 * np.log(u)) * np.exp(2j * np.pi * v)
    slack = tolerances.NORMAL + tolerances.LOG_NEAR_ONE / (np.abs(point) + 1e-4)
    close(first, point.real, slack)
    close(second, point.imag, slack)


@holds("poisson_number", wrong=("uniform_ > sum && term", "term"))
def test_poisson_numbers_are_the_quantiles_of_few_and_rounded_gaussians_of_many(
    device: Device,
) -> None:
    d = Draws(29)
    code = "REAL n = poisson_number(mu, u, g);"
    u, g = rounded((np.floor(d.pixel(0, 2**23 - 1)) + 0.5) / 2**23), d.pixel(-4, 4)
    mu = rounded(d.scales(0.01, 15.99))
    mu[:10], mu[10:20, ::2] = 0, 0
    many = rounded(d.scales(16, 1e5))
    mu[20:40, ::2] = many[20:40, ::2]
    mu[40:] = np.where((np.arange(d.groups) % 2 == 0)[40:, None], many[40:], mu[40:])
    (got,) = device.call(SENSOR, code, {"REAL mu": mu, "REAL u": u, "REAL g": g}, ("n",))
    few = mu < 16
    # A uniform number within rounding of a step of the distribution may fall on either side.
    slack = tolerances.POISSON_STEP
    low, high = poisson.ppf(u - slack, mu), poisson.ppf(np.minimum(u + slack, 1 - 1e-9), mu)
    low[mu == 0] = high[mu == 0] = 0
    assert ((got >= np.maximum(low, 0)) & (got <= high))[few].all()
    gauss = mu + np.sqrt(np.maximum(mu - 1 / 12, 0)) * g
    slack = 0.5 + tolerances.FLOAT_ROUNDING * 4 * mu
    assert (np.abs(got - np.maximum(gauss, 0)) <= slack)[~few].all()
    assert (got == np.floor(got)).all()
    assert not got[:10].any()


@holds("saturated", wrong=("full_scale * min(signal, 1.0f)", "full_scale * signal"))
def test_grey_levels_grow_with_the_signal_up_to_full_scale(device: Device) -> None:
    d = Draws(30)
    signal, full = d.pixel(0, 3), np.choose(np.arange(d.groups) % 4, [255, 1023, 4095, 65535])
    inputs = {"REAL signal": signal, **shared(full=full[:, None])}
    (got,) = device.call(SENSOR, "REAL y = saturated(signal, full);", inputs, ("y",))
    close(got, np.minimum(signal * full[:, None], full[:, None]), rtol=tolerances.FLOAT_ROUNDING)


@holds("noisy_grey_level", wrong=("d.read_noise * normal.second", "d.read_noise * normal.first"))
def test_noise_takes_the_formulas_of_emva_1288_in_their_order(device: Device) -> None:
    d = Draws(31, 4 * GROUPS)
    words = d.rng.integers(0, 2**32, (3, d.groups, LANES), np.uint32)
    signal = d.scales(1e-4, 1.5)
    pattern = d.pixel(-3, 3), d.pixel(-3, 3)
    full = np.choose(np.arange(d.groups) % 4, [255.0, 1023.0, 4095.0, 65535.0])[:, None]
    capacity, read = d.scales(2000, 50000, True), d.shared(0, 30)
    dark, dsnu, prnu = d.shared(0, 50), d.shared(0, 40), d.shared(0, 0.4)
    black = np.floor(d.shared(0, 60))
    # Neither signal nor noise: the black level, whatever the words.
    signal[:4], read[:4], dark[:4], dsnu[:4] = 0, 0, 0, 0
    design = struct(
        "Design", d.groups, full_scale=full, saturation=capacity, read_noise=read,
        dark_signal=dark, dsnu=dsnu, prnu=prnu, black_level=black,
    )  # fmt: skip
    inputs = {
        "REAL signal": signal, "REAL pattern_prnu": pattern[0], "REAL pattern_dsnu": pattern[1],
        **{f"COUNTER {name}": w for name, w in zip("abc", words, strict=True)},
        "Design d": design,
    }  # fmt: skip
    code = """Normals pattern; pattern.first = pattern_prnu; pattern.second = pattern_dsnu;
        Words w; w.a = a; w.b = b; w.c = c; w.d = c;
        REAL y = noisy_grey_level(signal, pattern, w, d);"""
    (got,) = device.call(SENSOR, code, inputs, ("y",))
    electrons = capacity * signal * np.maximum(1 + prnu * pattern[0], 0)
    electrons = electrons + np.maximum(dark + dsnu * pattern[1], 0)
    u, v, w = ((word >> np.uint32(9)).astype(float) / 2**23 + 2.0**-24 for word in words)
    gauss = np.sqrt(-2 * np.log(v)) * np.exp(2j * np.pi * w)
    spread = np.sqrt(np.maximum(electrons - 1 / 12, 0))
    many = np.maximum(np.floor(electrons + spread * gauss.real + 0.5), 0)
    taken = np.where(electrons < 16, np.maximum(poisson.ppf(u, electrons), 0), many)
    taken = np.minimum(taken + read * gauss.imag, capacity)
    gain = (full - black) / capacity
    expected = np.clip(np.rint(gain * taken + black), 0, full)
    # One electron more or less, where a number lies within float rounding of a half.
    off = np.abs(got - expected)
    assert (off <= np.ceil(gain)).all()
    assert (off > 0).mean() <= tolerances.ROUNDING_FLIPS
    assert (got == np.rint(got)).all()
    assert (got[:4] == black[:4]).all()
    assert (got == full).sum() > 100


# ------------------------------------------------------------------------------- image.h, by design

IMAGE = ("station.h", "stripes.h", "sensor.h", "image.h")


def designs(d: Draws, noise: bool) -> Array:
    """Designs, one for each group, as `kernels/station.h` lays them out."""
    return struct(
        "Design",
        d.groups,
        seed_low=np.floor(d.shared(0, 65535)),
        seed_high=np.floor(d.shared(0, 65535)),
        luminous_share=d.shared(0.1, 0.9),
        periods_per_mm=1 / d.shared(2, 40),
        dark_leak=d.shared(0, 0.5),
        images=4095.0,
        step=1 / np.floor(d.shared(2, 99)),
        exposure=d.shared(0.5, 6),
        full_scale=4095.0,
        saturation=d.scales(2000, 50000, True),
        read_noise=d.shared(1, 30),
        dark_signal=d.shared(0, 50),
        dsnu=d.shared(1, 40),
        prnu=d.shared(0.01, 0.4),
        black_level=d.shared(0, 60),
        noise=float(noise),
    )


@holds("exposed_ray", wrong=("FLOAT(sub_rays), d.dark_leak", "1.0f, d.dark_leak"))
def test_sub_rays_share_a_pixel_and_see_the_lit_fraction_of_their_footprint(device: Device) -> None:
    d = Draws(40)
    design = designs(d, noise=False)
    light, footprint = d.pixel(-60, 60), d.pixel(0.5, 30)
    seen, shift = d.pixel(0, 1), d.shared(0, 1)
    inputs = {"REAL light": light, "REAL footprint": footprint, "REAL seen": seen,
              **shared(shift=shift), "Design d": design}  # fmt: skip
    code = "REAL e = at_shift(exposed_ray(d, light, footprint, seen, 4), shift);"
    (got,) = device.call(IMAGE, code, inputs, ("e",))
    a, per_mm, leak = design_of(design, "luminous_share", "periods_per_mm", "dark_leak")
    low = light * per_mm - shift - footprint * per_mm / 2
    high = low + footprint * per_mm
    lit = [a * np.floor(u) + np.minimum(u - np.floor(u), a) for u in (low, high)]
    share = (lit[1] - lit[0]) / (footprint * per_mm)
    (gain,) = design_of(design, "exposure")
    close(got, gain * seen / 4 * (leak + (1 - leak) * share), atol=tolerances.EXPOSED_RAY)


@holds("exposure_of", wrong=("(1.0f - d.dark_leak) * lit", "lit"))
def test_a_radiance_of_one_s_own_is_exposed_as_the_stripes_are(device: Device) -> None:
    d = Draws(45)
    design = designs(d, noise=False)
    lit, seen = d.pixel(0, 1), d.pixel(0, 1)
    code = "REAL e = exposure_of(d, lit, seen, 9);"
    (got,) = device.call(
        IMAGE, code, {"REAL lit": lit, "REAL seen": seen, "Design d": design}, ("e",)
    )
    leak, gain = design_of(design, "dark_leak", "exposure")
    close(got, gain * seen / 9 * (leak + (1 - leak) * lit), rtol=3 * tolerances.FLOAT_ROUNDING)


@holds("shift_of", wrong=("FLOAT(k) * d.step", "FLOAT(k) * d.images"))
def test_images_are_shifted_by_equal_steps(device: Device) -> None:
    d = Draws(41)
    design = designs(d, noise=False)
    k = np.broadcast_to(np.arange(d.groups, dtype=float)[:, None], (d.groups, LANES))
    inputs = {**shared(k=k[:, :1]), "Design d": design}
    code = "int n = 0; while (FLOAT(n) < k) { n++; } REAL s = shift_of(d, n);"
    (got,) = device.call(IMAGE, code, inputs, ("s",))
    close(got, k * design_of(design, "step")[0], rtol=tolerances.FLOAT_ROUNDING)


@holds("words_of", wrong=("65536u * UINT(d.seed_high)", "65535u * UINT(d.seed_high)"))
def test_words_belong_to_pixel_image_and_seed(device: Device) -> None:
    d = Draws(42)
    design = designs(d, noise=True)
    column, row = d.rng.integers(0, 2**32, (2, d.groups, LANES), np.uint32)
    inputs = {"COUNTER column": column, "COUNTER row": row, "Design d": design}
    code = "Words w = words_of(d, column, row, 7u);"
    got = device.call(IMAGE, code, inputs, ("COUNTER w.a", "COUNTER w.d"))
    low, high = design_of(design, "seed_low", "seed_high")
    seeds = (low + 65536 * high)[:, 0]
    for group in range(0, d.groups, 25):
        words = random_words(column[group], row[group], 7, int(seeds[group]))
        assert np.array_equal(got[0][group], words[0])
        assert np.array_equal(got[1][group], words[3])


@holds("fixed_pattern", wrong=("d.noise == 0.0f || (d.dsnu", "d.noise == 1.0f || (d.dsnu"))
def test_the_fixed_pattern_is_none_without_noise_and_normal_with_it(device: Device) -> None:
    d = Draws(43, 4 * GROUPS)
    column, row = d.rng.integers(0, 2**32, (2, d.groups, LANES), np.uint32)
    code = "Normals p = fixed_pattern(d, column, row);"
    for noise in (False, True):
        design = designs(d, noise)
        inputs = {"COUNTER column": column, "COUNTER row": row, "Design d": design}
        first, second = device.call(IMAGE, code, inputs, ("p.first", "p.second"))
        if not noise:
            assert (first == 0).all()
            assert (second == 0).all()
        else:
            count = first.size
            for values in (first, second):  # five standard errors
                assert abs(values.mean()) < 5 / np.sqrt(count)
                assert abs(values.var() - 1) < 5 * np.sqrt(2 / count)


@holds("grey_level", wrong=("words_of(d, column, row, UINT(k))", "words_of(d, column, row, 0u)"))
def test_a_grey_level_is_saturated_or_noisy_by_the_image_s_own_words(device: Device) -> None:
    d = Draws(44)
    column, row = d.rng.integers(0, 4000, (2, d.groups, LANES), np.uint32)
    signal = d.pixel(0, 1.5)
    code = """Normals none; none.first = 0.0f; none.second = 0.0f;
        REAL y = grey_level(signal, d, 5, column, row, none);
        REAL z = noisy_grey_level(signal, none, words_of(d, column, row, 5u), d);"""
    for noise in (False, True):
        inputs = {"REAL signal": signal, "COUNTER column": column, "COUNTER row": row,
                  "Design d": designs(d, noise)}  # fmt: skip
        got, noisy = device.call(IMAGE, code, inputs, ("y", "z"))
        if noise:
            assert np.array_equal(got, noisy)
        else:
            close(got, 4095 * np.minimum(signal, 1), rtol=tolerances.FLOAT_ROUNDING)


# ------------------------------------------------------------------------------- relief.h, by lists


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


# -------------------------------------------------------------------------------- scan.h, by pixels

PIXELS = """STRUCT(Pixels) { int sub_rays; REAL light; REAL footprint; REAL irradiance; };
DEVICE Ray made_ray(Pixels px, int i) {
    Ray r; r.light = px.light + 0.75f * FLOAT(i); r.footprint = px.footprint;
    r.irradiance = px.irradiance; return r; }
#define RAY(px, i) made_ray(px, i)"""
SCAN = (*IMAGE, PIXELS, "scan.h")
PIXEL = """Pixels px; px.sub_rays = 3; px.light = light; px.footprint = footprint;
    px.irradiance = irradiance;"""


class Scanned:
    """Pixels of three sub-rays under designs without noise, and their signals in float64."""

    def __init__(self, seed: int, images: int = 13) -> None:
        d = self.draws = Draws(seed)
        self.images = images
        self.design = struct(
            "Design",
            d.groups,
            luminous_share=d.shared(0.1, 0.9),
            periods_per_mm=d.shared(0.1, 0.5),
            dark_leak=d.shared(0, 0.5),
            images=float(images),
            step=1 / images,
            exposure=d.shared(1, 4),
            full_scale=255.0,
            lag=2.0,
            pairs=np.where(np.arange(d.groups) % 2, images, images - 2)[:, None],
        )
        self.light, self.footprint = d.pixel(-20, 20), d.pixel(0.5, 30)
        self.irradiance = d.pixel(0.2, 1)
        self.inputs = {
            "REAL light": self.light, "REAL footprint": self.footprint,
            "REAL irradiance": self.irradiance, "Design d": self.design,
        }  # fmt: skip

    def signal(self, k: int) -> Array:
        a, per_mm, leak, gain, step = design_of(
            self.design, "luminous_share", "periods_per_mm", "dark_leak", "exposure", "step"
        )
        total = np.zeros_like(self.light)
        for i in range(3):
            light = (self.light + 0.75 * i) * per_mm - k * step
            lit = overlap(light, self.footprint * per_mm, a)
            total += gain * self.irradiance / 3 * (leak + (1 - leak) * lit)
        return total

    def levels(self) -> Array:
        return np.stack([255 * np.minimum(self.signal(k), 1) for k in range(self.images)])


@holds("exposed_at", wrong=("ray.irradiance, px.sub_rays)", "ray.irradiance, 1)"))
@holds("signal_of", wrong=("signal += at_shift(", "signal = at_shift("))
@holds("signals_from", wrong=("shift_of(d, first + j)", "shift_of(d, j)"))
def test_the_signals_of_images_are_the_sums_of_their_sub_rays(device: Device) -> None:
    s = Scanned(60)
    code = (
        PIXEL
        + """REAL one = at_shift(exposed_at(d, px, 1), 0.0f), k5 = signal_of(d, px, 5);
        Signals some = signals_from(d, px, 4);"""
    )
    outputs = ("one", "k5", "some.value[0]", "some.value[1]", "some.value[7]")
    one, *got = device.call(SCAN, code, s.inputs, outputs)
    for value, k in zip(got, (5, 4, 5, 11), strict=True):
        close(value, s.signal(k), atol=tolerances.EXPOSED_RAY)
    a, per_mm, leak, gain = design_of(
        s.design, "luminous_share", "periods_per_mm", "dark_leak", "exposure"
    )
    lit = overlap((s.light + 0.75) * per_mm, s.footprint * per_mm, a)
    close(one, gain * s.irradiance / 3 * (leak + (1 - leak) * lit), atol=tolerances.EXPOSED_RAY)


@holds("mean_over_images", wrong=("return sum / FLOAT(images)", "return sum / FLOAT(images + 1)"))
@holds("fusion_over_images", wrong=("if (k < pairs)", "if (k < images)"))
def test_what_images_are_fused_to_is_what_numpy_makes_of_them(device: Device) -> None:
    s = Scanned(61)
    column, row = s.draws.rng.integers(0, 4000, (2, s.draws.groups, LANES), np.uint32)
    inputs = {**s.inputs, "COUNTER column": column, "COUNTER row": row}
    code = (
        PIXEL
        + """REAL mean = mean_over_images(d, px, column, row);
        Fusion f = fusion_over_images(d, px, column, row);"""
    )
    outputs = ("mean", "f.mean", "f.high", "f.low", "f.deviation", "f.difference")
    mean, f_mean, high, low, deviation, difference = stacked(
        device.call(SCAN, code, inputs, outputs)
    )
    y = s.levels()
    atol = 255 * tolerances.EXPOSED_RAY
    for got in (mean, f_mean):
        close(got, y.mean(axis=0), atol)
    close(high, y.max(axis=0), atol)
    close(low, y.min(axis=0), atol)
    close(deviation, y.std(axis=0), atol)
    gap = np.abs(np.roll(y, -2, axis=0) - y)
    wraps = design_of(s.design, "pairs")[0] == s.images
    close(difference, np.where(wraps, gap.mean(axis=0), gap[:-2].mean(axis=0)), 2 * atol)


@holds("fusion_of_none", wrong=("f.low = d.full_scale", "f.low = 0.0f"))
@holds("with_image", wrong=("gap * (y - f.mean)", "gap * gap"))
@holds("fusion_of_all", wrong=("f.deviation / FLOAT(images)", "f.deviation"))
def test_images_are_fused_one_by_one_without_cancelling(device: Device) -> None:
    d = Draws(62)
    # Of 65,535 DN a deviation of some DN: its square's difference from the mean square is lost.
    images = np.stack([rounded(65_000 + d.pixel(-3, 3)) for _ in range(6)])
    code = """Fusion f = fusion_of_none(d);
        f = with_image(f, a, 0); f = with_image(f, b, 1); f = with_image(f, c, 2);
        f = with_image(f, e, 3); f = with_image(f, p, 4); f = with_image(f, q, 5);
        f.difference = 6.0f; f = fusion_of_all(f, 6, 3);"""
    inputs = {f"REAL {name}": y for name, y in zip("abcepq", images, strict=True)}
    inputs["Design d"] = struct("Design", d.groups, full_scale=65_535.0)
    outputs = ("f.mean", "f.high", "f.low", "f.deviation", "f.difference")
    mean, high, low, deviation, difference = stacked(device.call(SCAN, code, inputs, outputs))
    close(mean, images.mean(axis=0), 4 * 65_000 * tolerances.FLOAT_ROUNDING)
    np.testing.assert_array_equal(high, images.max(axis=0))
    np.testing.assert_array_equal(low, images.min(axis=0))
    close(deviation, images.std(axis=0), 4 * 65_000 * tolerances.FLOAT_ROUNDING)
    assert (difference == 2).all()


# --------------------------------------------------------------------------------------- coverage


def test_every_device_function_has_a_law_here() -> None:
    pattern = re.compile(r"^DEVICE\s+\w+\s+(\w+)\(", re.MULTILINE)
    texts = [path.read_text(encoding="utf-8") for path in sorted(folder("kernels").glob("*.h"))]
    functions = [name for text in texts for name in pattern.findall(text)]
    assert len(functions) >= 65
    assert sorted(functions) == sorted(LAWS)


@pytest.mark.slow
@pytest.mark.parametrize("function", sorted(LAWS))
def test_a_law_fails_where_its_function_is_wrong(function: str) -> None:
    law, wrong = LAWS[function]
    device = open_device("opencl")
    with pytest.raises(AssertionError, match=r"tolerance|assert|Arrays"):
        law(replace(device, edits=(wrong,)))
