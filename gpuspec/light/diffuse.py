"""What a part scatters of the whole tunnel's light: the same at every shift of fine stripes.

A Lambertian point of albedo r looks r m F bright from everywhere, m the mean luminance of what
lights it and F the form factor of that, the share of the hemisphere that it fills, weighted by the
cosine. Stripes finer than the tunnel is high are even from there: as a function of the shift a
harmonic k = 2 pi h / P of a ceiling at H is weakened by kH K1(kH), the Fourier transform of
H^2 / 2 (H^2 + x^2)^1.5, to 1e-24 for P = 16 and H = 150 mm.

F is that of the part's middle, facing up; a point tilted by t has (1 + cos t) / 2 of it, one
beside the middle of a long tunnel as good as all.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from gpuspec.light.profiles import harmonics
from gpuspec.station.materials import reflectance
from gpuspec.station.sections import Tunnel
from gpuspec.station.station import Station

_ANGLES = 2000


def form_factor(tunnel: Tunnel, x_mm: float = 0.0) -> float:
    """Return the share of its light that a point on the part's axis gets from a tunnel.

    Of a tunnel without ends it is 1. At the angle a from the x axis, in a half-plane at v from
    upright, light comes if the section, r(v) away, is met within the length: the integral of
    sin^2 a between is (atan u + u / (1 + u^2)) / 2 a side, u how far the end is over r. What the
    opening takes is that of a rectangle, J. R. Howell, A Catalog of Radiation Heat Transfer
    Configuration Factors, B-3.

    Parameters
    ----------
    tunnel : Tunnel
    x_mm : float
        Of the point, at y = z = 0.

    Returns
    -------
    float
        From 0 to 1; 0 where the point is not within the tunnel.

    Examples
    --------
    >>> from gpuspec.light.diffuse import form_factor
    >>> tunnel = gpuspec.Station(tunnel={"height_mm": 150.0, "length_mm": 400.0}).tunnel
    >>> round(form_factor(tunnel), 6)  # a strip: half its length over the way to its end, 0.8
    0.8
    """
    angle = (np.arange(_ANGLES) + 0.5) / _ANGLES * math.pi - math.pi / 2
    top = tunnel.top_mm
    away = np.full(_ANGLES, top) if tunnel.section == "arch" else top / np.cos(angle)
    if tunnel.section == "box":
        away = np.minimum(away, (tunnel.width_mm or 0.0) / 2 / np.abs(np.sin(angle)))
    total = 0.0
    for side in (-1, 1):
        u = max(tunnel.length_mm / 2 + side * x_mm, 0.0) / away
        total += float((np.cos(angle) * (np.arctan(u) + u / (1 + u**2))).sum())
    opening = 0.0
    for end in (-1, 1):
        reach = (tunnel.opening_length_mm / 2 + end * x_mm) / top
        opening += 2 * _corner(reach, tunnel.opening_width_mm / 2 / top)
    return max(total / 2 / _ANGLES - opening, 0.0)


def _corner(a: float, b: float) -> float:
    """Return the form factor of a parallel rectangle, a x b heights, seen from under its corner."""
    u, v = math.hypot(1, a), math.hypot(1, b)
    return (a / u * math.atan(b / u) + b / v * math.atan(a / v)) / (2 * math.pi)


@lru_cache(maxsize=64)
def _middle(tunnel: Tunnel) -> float:
    return form_factor(tunnel)


def mean_luminance(tunnel: Tunnel) -> float:
    """Return the mean luminance of the light over a period, with what the dark stripes leak."""
    share = tunnel.luminous_mm / tunnel.period_mm
    if not tunnel.is_striped:
        share = float(harmonics(tunnel)[0].real)
    return tunnel.dark_leak + (1 - tunnel.dark_leak) * share


def diffuse_share(station: Station) -> float:
    """Return how bright the part is by what it scatters, over what it mirrors of full luminance.

    The mirror's reflectance is that of straight view: to 30 degrees a metal's changes by less than
    0.5 %, a lacquer's by 4 %.

    Parameters
    ----------
    station : Station

    Examples
    --------
    >>> from gpuspec.light.diffuse import diffuse_share
    >>> station = gpuspec.Station(part={"diffuse": 0.1})  # a quarter is luminous
    >>> round(diffuse_share(station), 4)
    0.0239
    """
    part, tunnel = station.part, station.tunnel
    if not part.diffuse:
        return 0.0
    mirrored = reflectance(part.material, tunnel.wavelength_nm)
    return part.diffuse / mirrored * _middle(tunnel) * mean_luminance(tunnel)


def ripple(tunnel: Tunnel) -> float:
    """Return by how much of its mean the light that falls on the part changes with the shift.

    Half of the way from least to most, of the first harmonic under a ceiling.

    Parameters
    ----------
    tunnel : Tunnel

    Examples
    --------
    >>> from gpuspec.light.diffuse import ripple
    >>> tunnel = gpuspec.Station(tunnel={"luminous_mm": 75.0, "dark_mm": 75.0}).tunnel
    >>> round(ripple(tunnel), 4)  # as long a period as the tunnel is high
    0.0079
    """
    x = 2 * math.pi * tunnel.top_mm / tunnel.period_mm
    # x K1(x), M. Abramowitz, I. Stegun, 9.7.2; of coarser stripes more than any that pass as fine.
    weakened = math.sqrt(math.pi * x / 2) * math.exp(-x) * (1 + 3 / (8 * x)) if x > 1 else 1.0
    share = tunnel.luminous_mm / tunnel.period_mm
    first = 2 / math.pi * math.sin(math.pi * share)
    if not tunnel.is_striped:
        first = abs(harmonics(tunnel)[1])
    return (1 - tunnel.dark_leak) * first * weakened / max(mean_luminance(tunnel), 1e-9)
