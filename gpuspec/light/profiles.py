"""The light's profile over a period as a sum of harmonics, for a light that is no stripes.

A sum of harmonics seen through boxes is again one, each harmonic weakened by itself: exact, and
the same work for every profile.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.constants import HARMONICS
from gpuspec.station.sections import Tunnel

_SAMPLES = 4096
"""Of a sinusoid through a screen's gamma, over a period: aliases are below 1e-6 of full scale."""


def harmonics(tunnel: Tunnel) -> NDArray[np.complex128]:
    """Return the amplitudes of the light's harmonics, the mean first.

    The luminance at the light coordinate u, in periods and at shift 0, is the real part of
    ∑ cₕ exp(−2πihu). A table passes through its values where it has no more than twice
    `HARMONICS` of them; what a longer one has beyond is left out.

    Parameters
    ----------
    tunnel : Tunnel
        Whose profile is no stripes.

    Returns
    -------
    ndarray of complex128, shape (harmonics + 1,)
        At most `HARMONICS` + 1 of them; luminances relative to full.

    Examples
    --------
    >>> from gpuspec.light.profiles import harmonics
    >>> tunnel = gpuspec.Station(tunnel={"profile": "sinusoid"}).tunnel
    >>> harmonics(tunnel).round(3).real.tolist()
    [0.5, 0.5]
    """
    return _harmonics(tunnel.profile, tunnel.profile_gamma)


@lru_cache(maxsize=64)
def _harmonics(profile: str | tuple[float, ...], gamma: float) -> NDArray[np.complex128]:
    values = _values(profile, gamma)
    count = len(values)
    found = np.fft.rfft(values)[: HARMONICS + 1].conj() / count
    found[1:] *= 2
    if len(found) == count / 2 + 1:  # half the samples' frequency has no other half
        found[-1] /= 2
    above = np.flatnonzero(np.abs(found) > 1e-7)
    kept: NDArray[np.complex128] = found[: int(above.max(initial=0)) + 1]
    kept.flags.writeable = False
    return kept


def _values(profile: str | tuple[float, ...], gamma: float) -> NDArray[np.float64]:
    """Return luminances over a period at equal steps from its start."""
    if not isinstance(profile, str):
        return np.array(profile, float)
    turn = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    values: NDArray[np.float64] = (0.5 + 0.5 * np.cos(turn)) ** gamma
    return values


def luminance(tunnel: Tunnel, periods: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light's luminance at points of it, stripes or not, at shift 0.

    Parameters
    ----------
    tunnel : Tunnel
    periods : ndarray
        Light coordinates, in periods.

    Returns
    -------
    ndarray of float64, of the same shape
        From 0 to 1, without the leak.

    Examples
    --------
    >>> from gpuspec.light.profiles import luminance
    >>> tunnel = gpuspec.Station(tunnel={"profile": [1.0, 0.5, 0.0, 0.5]}).tunnel
    >>> luminance(tunnel, np.array([0.0, 0.25, 0.5])).round(3).tolist()
    [1.0, 0.5, 0.0]
    """
    if tunnel.is_striped:
        return (periods % 1 < tunnel.luminous_mm / tunnel.period_mm).astype(float)
    found = harmonics(tunnel)
    turns = np.multiply.outer(periods, np.arange(len(found)))
    seen: NDArray[np.float64] = (found * np.exp(-2j * np.pi * turns)).real.sum(axis=-1)
    return seen.clip(0, 1)


def left_out(tunnel: Tunnel) -> float:
    """Return by how much, of full, the harmonics miss the values of a profile; 0 of stripes."""
    if tunnel.is_striped:
        return 0.0
    values = _values(tunnel.profile, tunnel.profile_gamma)
    at = np.arange(len(values)) / len(values)
    return float(np.abs(luminance(tunnel, at) - values).max())
