"""What the laws of device functions share: draws, structs as arrays, vectors."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from device import LANES, Device, Outputs
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scenes import members
from scipy.interpolate import BSpline

from gpuspec.light.records import packed
from gpuspec.light.sources import structs

Array = NDArray[np.float64]
Law = Callable[[Device], None]
Edit = tuple[str, str]
GROUPS = 250
"""Groups of pixels that share what a function takes as `float`."""
SURFACE = ("station.h", "surface.h")
REFLECTION = (*SURFACE, "reflection.h")
LAWS: dict[str, tuple[Law, Edit]] = {}
"""Function to the test that holds it, and to an edit that this test must notice."""
NARROW_MIN = 1e-5
"""Periods: what a narrower box of a footprint is taken for."""


def holds(function: str, wrong: Edit) -> Callable[[Law], Law]:
    """Register the test of a device function."""

    def register(law: Law) -> Law:
        source = inspect.getsource(law)
        assert f"{function}(" in source, f"{law.__name__} does not call {function}"
        LAWS[function] = law, wrong
        return law

    return register


def rounded(values: Any) -> Array:
    return np.asarray(values, np.float32).astype(np.float64)


class Draws:
    """Random inputs, rounded to float: (GROUPS, LANES) for each pixel, (GROUPS, 1) shared."""

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


def sagitta(x: Array, curvature: Array) -> Array:
    """Height of a circle through 0, as the integral of its slope angle: no cancellation."""
    angle = np.arcsin(curvature * x)
    return -x * np.tan(angle / 2)


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
    dx[50:60], dy[50:60] = vx[50:60], vy[50:60]
    course = {
        "along_x": vx, "along_y": vy, "inverse_square": inverse**2, "inverse_length": inverse,
    }  # fmt: skip
    return dx, dy, vx, vy, struct("Groove", d.groups, **course)


def basis() -> list[Polynomial]:
    """The four pieces of a cubic B-spline over [0, 1], from SciPy's."""
    spline = BSpline.basis_element(np.arange(-2.0, 3.0))
    points = np.array([0.1, 0.3, 0.6, 0.9])
    return [Polynomial.fit(points, spline(points + 1 - k), 3).convert() for k in range(4)]


RAY = "Vector o = vector(ox, oy, oz), r = vector(rx, ry, rz); "


def overlap(light: Array, wide: Array, narrow: Array, luminous: Array) -> Array:
    """Lit fraction: of two boxes folded, a trapezoid, what lies on one stripe after another."""
    given = np.broadcast_arrays(light, wide, np.maximum(narrow, NARROW_MIN), luminous)
    shape = given[0].shape
    order = np.argsort(-(given[1] + given[2]), axis=None)
    place, w1, w2, a = (values.ravel()[order] for values in given)
    place = place - np.floor(place)
    lit = np.zeros_like(place)
    reach = (w1 + w2) / 2 + 2

    def up_to(x: Array, some: slice) -> Array:
        """Share of the trapezoid about 0 that lies below x."""
        bend = 2 * w1[some] * w2[some]
        from_foot = (w1 + w2)[some] / 2 - np.abs(x)
        toe = np.clip(from_foot, 0, w2[some])
        tail = toe**2 / bend + np.maximum(from_foot - w2[some], 0) / w1[some]
        return np.where(x < 0, tail, 1 - tail)

    for stripe in range(-int(reach[0]), int(reach[0]) + 1):
        some = slice(np.searchsorted(-reach, -abs(stripe), side="right"))
        begin = stripe - place[some]
        lit[some] += up_to(begin + a[some], some) - up_to(begin, some)
    result = np.empty_like(lit)
    result[order] = lit
    return result.reshape(shape)


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


PIXELS = """STRUCT(Pixels) { int sub_rays; Ray first; };
DEVICE Ray made_ray(Pixels px, int i) {
    Ray r = px.first; r.light += 0.75f * FLOAT(i); return r; }
#define RAY(px, i) made_ray(px, i)"""
SCAN = (*IMAGE, PIXELS, "scan.h")
