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
    for order, amplitude in enumerate(found[1:], 1):
        rate = 2 * np.pi * order

        def integrated_twice(at: Array, rate: float = rate) -> Array:
            wave: Array = -(amplitude * np.exp(-1j * rate * at)).real / rate**2  # noqa: B023
            return wave

        ends = integrated_twice(u + outer) + integrated_twice(u - outer)
        ends -= integrated_twice(u + inner) + integrated_twice(u - inner)
        total += ends / (wide * narrow)
    seen: Array = total.clip(0, 1)
    return seen
