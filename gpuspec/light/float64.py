"""The float64 reference: the formulas of `kernels/*.h` in plain NumPy, for tests and as a fallback.

Same model, other arithmetic: every device is held against it. It is not fast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Lost
from gpuspec.part.grooves import Grooves, averaged
from gpuspec.part.maps import averaged as averaged_maps
from gpuspec.part.maps import relief_at
from gpuspec.part.marches import MARCH_STEPS, March, march_of
from gpuspec.part.pose import Frames
from gpuspec.part.relief import Relief
from gpuspec.station.materials import optical_constants
from gpuspec.station.station import Station

Array = NDArray[np.float64]
Sides = tuple[Array | float, Array | float]
Words = tuple[NDArray[np.uint32], ...]
FOOTPRINT_MIN_MM = 1e-4
POISSON_EXACT = 16.0
POISSON_TERMS = 44
FIXED_PATTERN = 0xFFFFFFFF
_NEWTON_STEPS = 8
_POSED_STEPS = 12
_REACH = 8.0  # sigmas


@dataclass
class Surface:
    """The part's surface at points.

    Attributes
    ----------
    z : ndarray
        Height, mm.
    zx, zy : ndarray
        Slopes.
    zxx, zxy, zyy : ndarray
        Second derivatives, 1/mm. All of the shape of the points.
    """

    z: Array
    zx: Array
    zy: Array
    zxx: Array
    zxy: Array
    zyy: Array

    def add(self, where: Any, *terms: Array) -> None:
        """Add terms (z, zx, zy, zxx, zxy, zyy) at some points.

        Parameters
        ----------
        where : index
            Of the points, as NumPy takes it.
        *terms : ndarray
            z, zx, zy, zxx, zxy and zyy, of the shape of the points.
        """
        for field, term in zip((self.z, self.zx, self.zy, self.zxx, self.zxy, self.zyy), terms,
                               strict=True):  # fmt: skip
            field[where] += term


class Part:
    """Shape and relief of a station's part, as the pixels average it."""

    def __init__(self, station: Station, relief: Relief) -> None:
        self.shape = station.part.shape
        self.grooves = averaged(relief.grooves, station)
        # Pieces of one defect stand together: where each begins, and the box that it reaches.
        self.first = np.flatnonzero(np.diff(self.grooves.owner, prepend=-1))
        corners = self.grooves.ends.reshape(-1, 2, 2)
        self.low, self.high = np.zeros((0, 2)), np.zeros((0, 2))
        if len(self.first):
            reach = _REACH * self.grooves.sigma[self.first, None]
            self.low = np.minimum.reduceat(corners.min(axis=1), self.first) - reach
            self.high = np.maximum.reduceat(corners.max(axis=1), self.first) + reach
        self.maps = averaged_maps(relief.maps, station)
        self.edges = relief.edges
        self.march = march_of(station, relief)
        self.free = station.posed or self.march is not None

    def at(self, x: Array, y: Array) -> Surface:
        """Return the surface at points.

        Parameters
        ----------
        x, y : ndarray
            In mm, of one shape.
        """
        shape = self.shape
        s = Surface(shape.height(x, y), *shape.slope(x, y), *shape.curvature(x, y))
        for low, high, groove in self._near(x, y):
            near = np.nonzero((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]))
            if len(near[0]):
                s.add(near, *gaussian_groove(groove, x[near], y[near]))
        if self.maps:
            s.add(..., *relief_at(self.maps, x, y))
        return s

    def _near(self, x: Array, y: Array) -> Iterator[tuple[Array, Array, Grooves]]:
        """Yield the defects whose box meets that of the points: its corners, and the groove."""
        if not x.size:
            return
        meet = (self.low <= [x.max(), y.max()]).all(axis=1)
        meet &= (self.high >= [x.min(), y.min()]).all(axis=1)
        ends = np.append(self.first, len(self.grooves))
        every = self.grooves
        for nth in np.flatnonzero(meet).tolist():
            of = slice(ends[nth], ends[nth + 1])
            groove = Grooves(every.ends[of], every.depth[of], every.sigma[of], every.owner[of])
            yield self.low[nth], self.high[nth], groove


def gaussian_groove(groove: Grooves, x: Array, y: Array) -> tuple[Array, ...]:
    """Return z, zx, zy, zxx, zxy, zyy of one defect's groove at points.

    Parameters
    ----------
    groove : Grooves
        The pieces of one defect.
    x, y : ndarray, shape (n,)
        In mm.

    Returns
    -------
    tuple of ndarray of float64, shape (n,)
        In mm, 1 and 1/mm.
    """
    best = np.full(x.shape, np.inf)
    vx, vy, ux, uy = (np.zeros_like(x) for _ in range(4))
    for ax, ay, bx, by in groove.ends:
        length = np.hypot(bx - ax, by - ay)
        tx, ty = ((bx - ax) / length, (by - ay) / length) if length else (0.0, 0.0)
        share = (x - ax) * tx + (y - ay) * ty
        foot = np.clip(share, 0, length)
        wx, wy = x - ax - foot * tx, y - ay - foot * ty
        nearer = wx**2 + wy**2 < best
        inside = share == foot
        best = np.where(nearer, wx**2 + wy**2, best)
        vx, vy = np.where(nearer, wx, vx), np.where(nearer, wy, vy)
        ux, uy = np.where(nearer, tx * inside, ux), np.where(nearer, ty * inside, uy)
    variance = groove.sigma[0] ** 2
    z = groove.depth[0] * np.exp(-best / (2 * variance))
    k = z / variance
    return (
        z,
        -k * vx,
        -k * vy,
        k * vx * vx / variance - k * (1 - ux * ux),
        k * vx * vy / variance + k * ux * uy,
        k * vy * vy / variance - k * (1 - uy * uy),
    )


def meet(part: Part, station: Station, x0: Array, y0: Array) -> tuple[Array, Surface]:
    """Return the height at which the rays through (x0, y0, 0) meet the part, and its surface.

    Parameters
    ----------
    part : Part
    station : Station
    x0, y0 : ndarray
        In mm, of one shape.

    Returns
    -------
    z : ndarray of float64
        In mm, of the same shape.
    surface : Surface
    """
    h = station.camera.height_mm
    z = np.zeros_like(x0)
    if station.part.surface == "orientation":
        return z, part.at(x0, y0)
    for _ in range(_NEWTON_STEPS):
        s = part.at(x0 * (1 - z / h), y0 * (1 - z / h))
        z = z - (z - s.z) / (1 + (s.zx * x0 + s.zy * y0) / h)
    return z, part.at(x0 * (1 - z / h), y0 * (1 - z / h))


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.einsum("i...,i...->...", a, b)
    return product


def hit_tunnel(station: Station, origin: Array, ray: Array) -> tuple[Array, Array]:
    """Return path t and the tunnel's normal (3, ...) where rays going up meet it.

    Parameters
    ----------
    station : Station
    origin : ndarray, shape (3, ...)
        Points of the part, mm.
    ray : ndarray, shape (3, ...)
        Unit vectors.

    Returns
    -------
    t : ndarray
        In mm.
    normal : ndarray, shape (3, ...)
    """
    tunnel = station.tunnel
    if tunnel.section == "arch":
        radius = tunnel.top_mm
        a = np.maximum(ray[1] ** 2 + ray[2] ** 2, 1e-12)
        b = origin[1] * ray[1] + origin[2] * ray[2]
        c = origin[1] ** 2 + origin[2] ** 2 - radius**2
        path = (np.sqrt(np.maximum(b * b - a * c, 0)) - b) / a
        across = origin + path * ray
        return path, np.stack([0 * path, across[1] / radius, across[2] / radius])
    path = (tunnel.height_mm - origin[2]) / np.maximum(ray[2], 1e-6)
    normal = np.stack([0 * path, 0 * path, 1 + 0 * path])
    if tunnel.section == "box":
        assert tunnel.width_mm is not None
        side = np.where(ray[1] < 0, -1.0, 1.0)
        wall = (tunnel.width_mm / 2 - side * origin[1]) / np.maximum(side * ray[1], 1e-9)
        first = wall < path
        path = np.where(first, wall, path)
        normal[1], normal[2] = np.where(first, side, 0), np.where(first, 0, 1)
    return path, normal


def fresnel_reflectance(cosine: Array, n: float, k: float) -> Array:
    """Return the unpolarised reflectance of a medium n - ik, from the complex amplitudes.

    M. Born, E. Wolf, Principles of Optics, 14.2.

    Parameters
    ----------
    cosine : ndarray
        Of the angle of incidence.
    n, k : float
        Refractive index and extinction coefficient; both 0: a perfect mirror.

    Returns
    -------
    ndarray of float64, of the shape of `cosine`
        From 0 to 1.

    Examples
    --------
    >>> from gpuspec.light.float64 import fresnel_reflectance
    >>> cosine = np.array([1.0, 0.5])  # of 0 and 60 degrees, on glass
    >>> fresnel_reflectance(cosine, 1.5, 0.0).round(3).tolist()
    [0.04, 0.089]
    """
    if n == k == 0:
        return np.ones_like(cosine)
    index = n - 1j * k
    inside = np.sqrt(index**2 - (1 - cosine**2))
    s = (cosine - inside) / (cosine + inside)
    p = (index**2 * cosine - inside) / (index**2 * cosine + inside)
    reflectance: Array = (np.abs(s) ** 2 + np.abs(p) ** 2) / 2
    return reflectance


@dataclass(frozen=True)
class Paths:
    """Rays followed to the tunnel.

    Attributes
    ----------
    surface, light : ndarray, shape (..., 3)
        Points on the surface and on the tunnel, mm.
    lost : ndarray of uint8
        Why none is seen, index into ``LOST``.
    wide, narrow : ndarray
        Widths of the two boxes that are the footprint on the light, mm; 1 and 0 where lost.
    irradiance : ndarray
        Relative; 0 where lost.
    """

    surface: Array
    light: Array
    lost: NDArray[np.uint8]
    wide: Array
    narrow: Array
    irradiance: Array


def ray_paths(station: Station, relief: Relief, x_mm: Any, y_mm: Any) -> Paths:
    """Follow the camera rays through the points (x, y, 0) to the part and the tunnel.

    Parameters
    ----------
    station : Station
    relief : Relief
    x_mm, y_mm : array_like
        Of one shape.

    Returns
    -------
    Paths
        Points with the shape of the input and a last axis of 3.
    """
    return follow(Part(station, relief), station, np.asarray(x_mm, float), np.asarray(y_mm, float))


def follow(
    part: Part,
    station: Station,
    x0: Array,
    y0: Array,
    apart: tuple[float, float] = (0.0, 0.0),
    sides: tuple[Sides, Sides] | None = None,
) -> Paths:
    """Follow camera rays to the light; see :func:`ray_paths`.

    The footprint is from ray differentials: H. Igehy, Tracing ray differentials, SIGGRAPH 1999.

    Parameters
    ----------
    part : Part
    station : Station
    x0, y0 : ndarray
        Where the rays meet the plane z = 0, mm, of shapes that broadcast.
    apart : tuple of float
        How far that is from their pixels' centres, mm.
    sides : tuple of two (x, y), optional
        Of the parallelogram that each of them stands for, mm; None: squares of a side p/n.
    """
    camera, tunnel = station.camera, station.tunnel
    h, p = camera.height_mm, camera.sampling_mm / camera.side
    x0, y0 = np.broadcast_arrays(x0, y0)
    met = _posed(part, station, x0, y0) if part.free else _plain(part, station, x0, y0)
    point, normal, size = met.point, met.normal, met.size
    view = met.view
    viewing = np.sqrt(_dot(view, view))
    incident = view / viewing
    ray = incident - 2 * _dot(incident, normal) * normal
    path, wall = hit_tunnel(station, point, ray)

    def change(dp: Array, dn: Array, seen: Array) -> Array:
        """How l moves as S, its normal and the view from the pupil do."""
        di = (seen - incident * _dot(incident, seen)) / viewing
        dn = (dn - normal * _dot(normal, dn)) / size
        turned = (_dot(di, normal) + _dot(incident, dn)) * normal
        dr = di - 2 * (_dot(incident, normal) * dn + turned)
        moved = dp + path * dr
        dt = -_dot(wall, moved) / np.maximum(_dot(wall, ray), 1e-6)
        dl: Array = moved[0] + dt * ray[0]
        return dl

    across, down = (
        change(dp, dn, dp)
        for dp, dn in (met.moved(dx, dy) for dx, dy in sides or ((p, 0.0), (0.0, p)))
    )
    radius = camera.pupil_mm * path / viewing / 2
    spread = 2 * station.part.roughness_rad * path
    light = point + path * ray
    if part.free or camera.spotted:
        # How l moves as a mm of the pupil turns the ray about its point.
        still = np.zeros_like(point)
        aside = np.stack([change(still, still, -axis) for axis in met.pupil])
        if part.free:
            radius = camera.pupil_mm / 2 * np.hypot(*aside)
    if camera.spotted:
        by = np.stack([across, down]) / p  # and as it moves by a mm on the camera's z = 0
        if camera.focus_mm is not None:
            off = 1 / met.share - h / camera.focus_mm
            radius = camera.pupil_mm / 2 * np.hypot(*(off * by + aside))
        lens = camera.blur_mm * np.hypot(*by)
        if camera.side == 1:
            spread = np.hypot(spread, lens)
        else:  # sub-rays lie on a square of the whole spot's variance; a disc is what that lacks
            variance = ((camera.sampling_mm * by) ** 2).sum(axis=0) / 12 + lens**2 + radius**2 / 4
            own = camera.spot_side_mm**2 * (by**2).sum(axis=0) / 12
            least = camera.least_lean
            lean = camera.lean * (least + (1 - least) * np.minimum(own / variance, 1))
            whole = camera.spot_side_mm * (by + lean * aside)
            across, down = whole / camera.side
            radius = 2 * np.sqrt(np.maximum(variance - (whole**2).sum(axis=0) / 12, 0))
            light[0] += lean * (apart[0] * aside[0] + apart[1] * aside[1])
    wide, narrow = two_boxes(across, down, radius, spread)
    lost = np.zeros(path.shape, np.uint8)
    lost[
        (np.abs(light[0]) <= tunnel.opening_length_mm / 2)
        & (np.abs(light[1]) <= tunnel.opening_width_mm / 2)
        & (wall[2] > 0)
        & (tunnel.opening_length_mm > 0)
    ] = Lost.OPENING
    lost[np.abs(light[0]) > tunnel.length_mm / 2] = Lost.END
    lost[met.again] = Lost.AGAIN
    lost[ray[2] <= 0] = Lost.DOWN
    lost[met.hidden] = Lost.HIDDEN
    beside = np.abs(met.place[0]) > station.part.length_mm / 2
    beside |= np.abs(met.place[1]) > station.part.width_mm / 2
    said = part.edges.outline(met.place[0], met.place[1])
    lost[np.where(said == 0, beside, said < 0)] = Lost.BESIDE
    field = (h / np.sqrt(x0**2 + y0**2 + h**2)) ** 4 if camera.vignetting == "cos4" else 1.0
    cosine = np.abs(_dot(incident, normal))
    constants = optical_constants(station.part.material, tunnel.wavelength_nm)
    seen = field * fresnel_reflectance(cosine, *constants)
    return Paths(
        np.moveaxis(point, 0, -1),
        np.moveaxis(light, 0, -1),
        lost,
        np.where(lost == 0, wide, 1.0),
        np.where(lost == 0, narrow, 0.0),
        np.where(lost == 0, seen, 0.0),
    )


@dataclass(frozen=True)
class _Met:
    """Where camera rays meet the part, in the station's frame; arrays of shape (3, ...) or (...).

    Attributes
    ----------
    point, view, normal : ndarray
        The point S, from the pupil to it, and the unit normal there.
    size : ndarray
        Of the normal (-dz/dx, -dz/dy, 1).
    place : ndarray
        S in the part's frame.
    share : ndarray
        Of the way from the pupil to the camera's plane z = 0 that S is away.
    moved : callable
        How S and the normal of that size move as a ray does by (dx, dy) on the plane in focus.
    pupil : tuple of ndarray
        The two directions in the pupil's plane.
    hidden, again : ndarray of bool
        Whether another piece of the part hides S, or its reflected ray meets the part again.
    """

    point: Array
    view: Array
    normal: Array
    size: Array
    place: Array
    share: Array
    moved: Callable[[Array | float, Array | float], tuple[Array, Array]]
    pupil: tuple[Array, ...]
    hidden: Any = False
    again: Any = False


def _turning(s: Surface, dp: Array) -> Array:
    """Return how (-dz/dx, -dz/dy, 1) changes as its point moves by dp."""
    return np.stack([-(s.zxx * dp[0] + s.zxy * dp[1]), -(s.zxy * dp[0] + s.zyy * dp[1]), 0 * s.z])


def _plain(part: Part, station: Station, x0: Array, y0: Array) -> _Met:
    """Follow the rays of a camera above the origin to a part that lies on z = 0."""
    h = station.camera.height_mm
    z, s = meet(part, station, x0, y0)
    k = 1 - z / h
    point = np.stack([x0 * k, y0 * k, z])
    upright = np.stack([-s.zx, -s.zy, np.ones_like(z)])
    size = np.sqrt(_dot(upright, upright))

    def moved(dx: Array | float, dy: Array | float) -> tuple[Array, Array]:
        dz = (s.zx * dx + s.zy * dy) * k / (1 + (s.zx * x0 + s.zy * y0) / h)
        if station.part.surface == "orientation":
            dz = np.zeros_like(z)
        dp = np.stack([k * dx - x0 * dz / h, k * dy - y0 * dz / h, dz])
        return dp, _turning(s, dp)

    view = np.stack([point[0], point[1], z - h])
    axes = tuple(np.zeros_like(point) for _ in range(2))
    for i, axis in enumerate(axes):
        axis[i] = 1
    return _Met(point, view, upright / size, size, point, k, moved, axes)


def _posed(part: Part, station: Station, x0: Array, y0: Array) -> _Met:
    """Follow the rays of any camera to a part in any pose: in the part's frame, then turned."""
    frames, h = Frames.of(station), station.camera.height_mm
    start, look = frames.rays(station, x0, y0)
    rises = station.part.surface == "height"
    high = part.march.highest_mm if part.march else 0.0
    way = (high - start[2]) / look[2]
    s = part.at(*(start + way * look)[:2])
    for _ in range(_POSED_STEPS if rises else 0):
        miss = start[2] + way * look[2] - s.z
        way = way - miss / (look[2] - s.zx * look[0] - s.zy * look[1])
        s = part.at(*(start + way * look)[:2])
    place = start + way * look
    upright = np.stack([-s.zx, -s.zy, np.ones_like(s.z)])
    size = np.sqrt(_dot(upright, upright))
    level = np.stack([0 * s.z, 0 * s.z, np.ones_like(s.z)])
    kept = upright if rises else level  # what the point keeps to as its ray moves
    share = 1 + way / h

    def turned(v: Array) -> Array:
        there: Array = np.tensordot(frames.turn, v, 1)
        return there

    def moved(dx: Array | float, dy: Array | float) -> tuple[Array, Array]:
        step = (frames.view @ [dx, dy, 0.0]).reshape(3, *[1] * s.z.ndim)
        dp = share * (step - look * _dot(kept, step + 0 * look) / _dot(kept, look))
        return turned(dp), turned(_turning(s, dp))

    facing = _dot(look, upright)
    hidden, again = facing >= 0, np.zeros(s.z.shape, bool)
    if part.march is not None:
        onward = look - 2 * facing / size**2 * upright
        hidden |= np.abs(place[2] - s.z) > part.march.slack_mm
        hidden |= _meets(part, station, part.march, place, -look)
        again = _meets(part, station, part.march, place, onward)
    origin = frames.origin.reshape(3, *[1] * s.z.ndim)
    # What is behind the camera is beside the part.
    beside = np.where(share > 0, place, np.inf)
    axes = frames.turn @ frames.view
    pupil = tuple(np.broadcast_to(axes[:, i].reshape(origin.shape), place.shape) for i in (0, 1))
    return _Met(
        turned(place) + origin, turned(share * h * look), turned(upright / size), size, beside,
        share, moved, pupil, hidden, again,
    )  # fmt: skip


def _meets(part: Part, station: Station, march: March, start: Array, ray: Array) -> Any:
    """Whether rays dip below the part on their way up, or across it."""
    up = np.maximum(march.highest_mm - start[2], 0) / np.maximum(ray[2], 1e-6)
    half = station.part.length_mm / 2, station.part.width_mm / 2
    ends = [
        (side - np.sign(ray[i]) * start[i]) / np.maximum(np.abs(ray[i]), 1e-6)
        for i, side in enumerate(half)
    ]
    way = np.minimum(*ends)
    way = np.maximum(np.where(ray[2] > 0, np.minimum(way, up), way), 0)
    met = np.zeros(way.shape, bool)
    for number in range(1, MARCH_STEPS + 1):
        x, y, z = start + (number / MARCH_STEPS) ** 2 * way * ray
        met |= z < part.at(x, y).z - march.slack_mm
    return met


def two_boxes(across: Array, down: Array, radius: Array, spread: Array) -> tuple[Array, Array]:
    """Return the widths of two boxes that, folded, are much like what a pixel averages.

    Their variance and fourth cumulant are the sums of those of four kernels; of two boxes the
    fourth cumulant is at most that of two of one width.

    Parameters
    ----------
    across, down : ndarray
        Widths of the boxes that are the pixel's square, mm.
    radius : ndarray
        Of the pupil's image, a disc seen edge-on, mm.
    spread : ndarray
        Standard deviation of the Gaussian of roughness and lens, mm.

    Returns
    -------
    wide, narrow : ndarray

    Examples
    --------
    >>> from gpuspec.light.float64 import two_boxes
    >>> pixel, pupil = np.array([[-3.0, 0.0], [4.0, 0.0]]), np.array([0.0, 1.0])
    >>> wide, narrow = two_boxes(pixel[0], pixel[1], pupil, np.zeros(2))
    >>> wide.round(3).tolist(), narrow.round(3).tolist()
    ([4.0, 1.651], [3.0, 0.525])
    """
    variance = (across**2 + down**2) / 12 + radius**2 / 4 + spread**2
    cumulant = -(across**4 + down**4) / 120 - radius**4 / 16
    squares = 12 * variance
    fourths = np.maximum(-120 * cumulant, squares**2 / 2)
    root = np.sqrt(np.maximum(2 * fourths - squares**2, 0))
    wide = np.sqrt((squares + root) / 2)
    narrow = np.sqrt(np.maximum(squares - root, 0) / 2)
    return np.maximum(wide, FOOTPRINT_MIN_MM), narrow


def random_words(column: Any, row: Any, image: int, seed: int) -> Words:
    """Return pcg4d's four words for counters, as `kernels/sensor.h` does.

    M. Jarzynski, M. Olano, Hash functions for GPU rendering, JCGT 9(3), 2020.

    Parameters
    ----------
    column, row : int or ndarray
        Of the pixels, of shapes that broadcast.
    image : int
        Number of the image.
    seed : int

    Returns
    -------
    tuple of four ndarray of uint32, of their common shape
    """
    shape = np.broadcast_shapes(np.shape(column), np.shape(row))
    counters = (column, row, image, seed)
    a, b, c, d = (np.broadcast_to(np.asarray(v, np.uint32), shape).copy() for v in counters)
    with np.errstate(over="ignore"):
        for v in (a, b, c, d):
            v *= np.uint32(1664525)
            v += np.uint32(1013904223)
        for last in (False, True):
            a += b * d
            b += c * a
            c += a * b
            d += b * c
            if not last:
                for v in (a, b, c, d):
                    v ^= v >> np.uint32(16)
    return a, b, c, d


def uniform_number(word: NDArray[np.uint32]) -> Array:
    """Return a uniform number in (0, 1) from the 23 high bits of a word."""
    return ((word >> np.uint32(9)) + 0.5) / 2**23


def normal_numbers(word: NDArray[np.uint32], other: NDArray[np.uint32]) -> tuple[Array, Array]:
    """Return two standard normal numbers from two words (Box and Muller, 1958).

    Parameters
    ----------
    word, other : ndarray of uint32
        Independent, of one shape.

    Returns
    -------
    tuple of two ndarray of float64, of the same shape
    """
    radius = np.sqrt(-2 * np.log(uniform_number(word)))
    angle = 2 * np.pi * uniform_number(other)
    return radius * np.cos(angle), radius * np.sin(angle)


def poisson_number(mu: Array, uniform: Array, normal: Array) -> Array:
    """Return Poisson numbers: exact below ``POISSON_EXACT``, Gaussian and rounded above.

    Exact by inversion of the distribution function, with ``POISSON_TERMS`` terms.

    Parameters
    ----------
    mu : ndarray
        Mean.
    uniform, normal : ndarray
        Independent random numbers, uniform in (0, 1) and standard normal, of the shape of `mu`.

    Returns
    -------
    ndarray of float64, of the same shape
    """
    # Rounding adds a variance of 1/12.
    many = np.maximum(np.floor(mu + np.sqrt(np.maximum(mu - 1 / 12, 0)) * normal + 0.5), 0)
    few = mu < POISSON_EXACT
    term = np.exp(-np.minimum(mu, POISSON_EXACT))
    total, count = term.copy(), np.zeros_like(mu)
    if (few & (mu > 0)).any():
        for i in range(1, POISSON_TERMS + 1):
            count += uniform > total
            term = term * np.minimum(mu, POISSON_EXACT) / i
            total += term
    return np.where(few, count, many)


def grey_level(signal: Array, station: Station, k: int, column: Any, row: Any) -> Array:
    """Return the grey level of a signal E in image k, in the words of EMVA 1288.

    Parameters
    ----------
    signal : ndarray
        Irradiance times exposure; 1 saturates.
    station : Station
        Its sensor is used.
    k : int
        Number of the image.
    column, row : int or ndarray
        Of the pixels, of the shape of `signal`.

    Returns
    -------
    ndarray of float64, of the shape of `signal`
        In DN.
    """
    sensor = station.sensor
    if not sensor.noise:
        return sensor.full_scale_dn * np.minimum(signal, 1)
    first, second = 0.0, 0.0
    if sensor.prnu or sensor.dsnu_e:
        words = random_words(column, row, FIXED_PATTERN, sensor.seed)
        first, second = normal_numbers(words[0], words[1])  # type: ignore[assignment]
    mu = sensor.saturation_e * signal * np.maximum(1 + sensor.prnu * first, 0)
    mu = mu + np.maximum(sensor.dark_e + sensor.dsnu_e * second, 0)
    words = random_words(column, row, k, sensor.seed)
    shot, read = normal_numbers(words[1], words[2])
    electrons = poisson_number(mu, uniform_number(words[0]), shot) + sensor.read_noise_e * read
    grey = sensor.gain_dn_per_e * np.minimum(electrons, sensor.saturation_e)
    return np.clip(np.rint(grey + sensor.black_level_dn), 0, sensor.full_scale_dn)
