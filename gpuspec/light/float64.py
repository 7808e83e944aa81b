"""The float64 reference: the formulas of `kernels/*.h` in plain NumPy, for tests and as a fallback.

Same model, other arithmetic: every device is held against it. It is not fast.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Lost
from gpuspec.part.grooves import Grooves, averaged
from gpuspec.part.maps import relief_at
from gpuspec.part.relief import Relief
from gpuspec.station.materials import MATERIALS
from gpuspec.station.station import Station

Array = NDArray[np.float64]
Words = tuple[NDArray[np.uint32], ...]
FOOTPRINT_MIN_MM = 1e-4
POISSON_EXACT = 16.0
POISSON_TERMS = 44
FIXED_PATTERN = 0xFFFFFFFF
_NEWTON_STEPS = 8
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
        self.maps = relief.maps

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
    footprint : ndarray
        On the light, mm; 1 where lost.
    irradiance : ndarray
        Relative; 0 where lost.
    """

    surface: Array
    light: Array
    lost: NDArray[np.uint8]
    footprint: Array
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


def follow(part: Part, station: Station, x0: Array, y0: Array) -> Paths:
    """Follow camera rays to the light; see :func:`ray_paths`.

    The footprint is from ray differentials: H. Igehy, Tracing ray differentials, SIGGRAPH 1999.

    Parameters
    ----------
    part : Part
    station : Station
    x0, y0 : ndarray
        Where the rays meet the plane z = 0, mm, of shapes that broadcast.
    """
    camera, tunnel = station.camera, station.tunnel
    h, p = camera.height_mm, camera.sampling_mm / camera.subsampling
    x0, y0 = np.broadcast_arrays(x0, y0)
    z, s = meet(part, station, x0, y0)
    k = 1 - z / h
    point = np.stack([x0 * k, y0 * k, z])
    view = np.stack([point[0], point[1], z - h])
    viewing = np.sqrt(_dot(view, view))
    incident = view / viewing
    upright = np.stack([-s.zx, -s.zy, np.ones_like(z)])
    size = np.sqrt(_dot(upright, upright))
    normal = upright / size
    ray = incident - 2 * _dot(incident, normal) * normal
    path, wall = hit_tunnel(station, point, ray)
    square = np.zeros_like(z)
    for dx, dy in ((p, 0.0), (0.0, p)):
        dz = (s.zx * dx + s.zy * dy) * k / (1 + (s.zx * x0 + s.zy * y0) / h)
        if station.part.surface == "orientation":
            dz = np.zeros_like(z)
        dp = np.stack([k * dx - x0 * dz / h, k * dy - y0 * dz / h, dz])
        di = (dp - incident * _dot(incident, dp)) / viewing
        dn = np.stack([-(s.zxx * dp[0] + s.zxy * dp[1]), -(s.zxy * dp[0] + s.zyy * dp[1]), 0 * z])
        dn = (dn - normal * _dot(normal, dn)) / size
        turned = (_dot(di, normal) + _dot(incident, dn)) * normal
        dr = di - 2 * (_dot(incident, normal) * dn + turned)
        moved = dp + path * dr
        dt = -_dot(wall, moved) / np.maximum(_dot(wall, ray), 1e-6)
        square += (moved[0] + dt * ray[0]) ** 2
    pupil = np.sqrt(3) / 2 * camera.pupil_mm * path / viewing
    rough = np.sqrt(12) * 2 * station.part.roughness_rad * path
    footprint = np.maximum(np.sqrt(square + pupil**2 + rough**2), FOOTPRINT_MIN_MM)
    light = point + path * ray
    lost = np.zeros(z.shape, np.uint8)
    lost[
        (np.abs(light[0]) <= tunnel.opening_length_mm / 2)
        & (np.abs(light[1]) <= tunnel.opening_width_mm / 2)
        & (wall[2] > 0)
        & (tunnel.opening_length_mm > 0)
    ] = Lost.OPENING
    lost[np.abs(light[0]) > tunnel.length_mm / 2] = Lost.END
    lost[ray[2] <= 0] = Lost.DOWN
    beside = np.abs(point[0]) > station.part.length_mm / 2
    lost[beside | (np.abs(point[1]) > station.part.width_mm / 2)] = Lost.BESIDE
    field = (h / np.sqrt(x0**2 + y0**2 + h**2)) ** 4 if camera.vignetting == "cos4" else 1.0
    cosine = np.abs(_dot(incident, normal))
    seen = field * fresnel_reflectance(cosine, *MATERIALS[station.part.material])
    return Paths(
        np.moveaxis(point, 0, -1),
        np.moveaxis(light, 0, -1),
        lost,
        np.where(lost == 0, footprint, 1.0),
        np.where(lost == 0, seen, 0.0),
    )


def trapezoid(light: Array, footprint: Array, station: Station) -> tuple[Array, ...]:
    """Return centre, reach, low, high (periods), base and slope of the lit fraction.

    Parameters
    ----------
    light, footprint : ndarray
        Light coordinate and footprint in mm, of one shape.
    station : Station
        Its stripes are used.

    Returns
    -------
    centre, reach, low, high, base, slope : ndarray, of the same shape
    """
    period = station.tunnel.period_mm
    a = station.tunnel.luminous_mm / period
    light, footprint = light / period, footprint / period
    n = np.floor(footprint)
    rest = footprint - n
    return (
        light - a / 2 - n / 2,
        (a + rest) / 2,
        np.maximum(a + rest - 1, 0),
        np.minimum(rest, a),
        n * a / footprint,
        1 / footprint,
    )


def lit_fraction(light: Array, footprint: Array, shift_mm: float, station: Station) -> Array:
    """Return the luminous share of the footprint, by the integral of the stripes.

    Parameters
    ----------
    light, footprint : ndarray
        Light coordinate and footprint in mm, of one shape.
    shift_mm : float
        Of the tunnel.
    station : Station
        Its stripes are used.

    Returns
    -------
    ndarray of float64, of the same shape
        From 0 to 1.

    Examples
    --------
    >>> from gpuspec.light.float64 import lit_fraction
    >>> station = gpuspec.Station(tunnel={"luminous_mm": 4.0, "dark_mm": 12.0})
    >>> light = np.array([2.0, 4.0, 8.0])  # in the stripe, on its edge, in the dark
    >>> lit_fraction(light, np.full(3, 1.0), 0.0, station).tolist()
    [1.0, 0.5, 0.0]
    """
    a, period = station.tunnel.luminous_mm, station.tunnel.period_mm

    def luminous_up_to(u: Array) -> Array:
        turns = np.floor(u / period)
        return a * turns + np.minimum(u - turns * period, a)

    centre = light - shift_mm
    return (
        luminous_up_to(centre + footprint / 2) - luminous_up_to(centre - footprint / 2)
    ) / footprint


def mean_over_scan(light: Array, footprint: Array, irradiance: Array, station: Station) -> Array:
    """Return the mean of min(E, 1) over a whole period in equal steps, in closed form.

    Parameters
    ----------
    light, footprint, irradiance : ndarray
        Light coordinate and footprint in mm, and relative irradiance, of one shape.
    station : Station
        Its shifts fill whole periods in equal steps.

    Returns
    -------
    ndarray of float64, of the same shape
        From 0 to 1, full scale.
    """
    centre, reach, low, high, base, slope = trapezoid(light, footprint, station)
    gain, leak = station.sensor.exposure * irradiance, station.tunnel.dark_leak
    base, slope = gain * (leak + (1 - leak) * base), gain * (1 - leak) * slope
    assert station.distinct_shifts is not None
    shifts = float(station.distinct_shifts)
    h = np.minimum((1 - base) / np.maximum(slope, 1e-20), high)
    k = np.minimum(low, h)
    phase = centre * shifts
    phase = phase - np.floor(phase)
    total = shifts * k
    for o in (phase, 1 - phase):
        n1 = np.maximum(np.floor((reach - h) * shifts - o) + 1, 0)
        n0 = np.maximum(np.floor((reach - k) * shifts - o) + 1, 0)
        m = n0 - n1
        total = total + n1 * (h - k) + m * (reach - k)
        total = total - (m * o + (n0 * (n0 - 1) - n1 * (n1 - 1)) / 2) / shifts
    return base + slope * total / shifts


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
