"""The float64 reference of a light that is no stripes: what a footprint sees of its harmonics.

Told another way than `kernels/profile.h`, which weakens each harmonic by both boxes: here the light
is integrated twice, and four values of that are put together as of the stripes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.profiles import harmonics
from gpuspec.station.sections import Tunnel

Array = NDArray[np.float64]


def profile_seen(u: Array, wide: Array, narrow: Array, tunnel: Tunnel) -> Array:
    """Return the luminance that a footprint sees of a profile.

    Parameters
    ----------
    u, wide, narrow : ndarray
        Place on the light and widths of the footprint's two boxes, in periods, of one shape; no
        width is 0.
    tunnel : Tunnel
        Its profile is used.

    Returns
    -------
    ndarray of float64, of the same shape
        From 0 to 1.

    Examples
    --------
    >>> from gpuspec.light.float64_profile import profile_seen
    >>> tunnel = gpuspec.Station(tunnel={"profile": "sinusoid"}).tunnel
    >>> box = np.full(2, 0.5)  # weakens the fringes by 2/pi, and by 2/pi again
    >>> profile_seen(np.array([0.0, 0.25]), box, box, tunnel).round(3).tolist()
    [0.703, 0.5]
    """
    found = harmonics(tunnel)
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    total = np.full(u.shape, found[0].real)
    first = [np.exp(-2j * np.pi * (u + end)) for end in (outer, -outer, inner, -inner)]
    waves = [np.ones_like(wave) for wave in first]  # of each order, by its powers
    for order, amplitude in enumerate(found[1:], 1):
        waves = [wave * one for wave, one in zip(waves, first, strict=True)]
        ends = waves[0] + waves[1] - waves[2] - waves[3]
        integrated_twice = -(amplitude * ends).real / (2 * np.pi * order) ** 2
        total += integrated_twice / (wide * narrow)
    seen: Array = total.clip(0, 1)
    return seen
