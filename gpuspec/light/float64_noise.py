"""Noise without drawing it, in float64: what a noisy grey level is on average, and how it varies.

A sum over images of what the sensor does to each: exact, and the reference for the closed form of
`kernels/noise.h`, which takes the sensor's share from the table that is made here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.constants import CELLS_COARSE, CELLS_FINE, CELLS_OFFSET
from gpuspec.light.diffuse import diffuse_share
from gpuspec.light.float64 import (
    FIXED_PATTERN,
    POISSON_EXACT,
    POISSON_TERMS,
    Array,
    normal_numbers,
    random_words,
)
from gpuspec.light.float64_stripes import lit_fraction
from gpuspec.station.sections import Sensor
from gpuspec.station.station import Station

ONE_DRAW = 0xFFFFFFFE
"""Image number of the normal numbers that stand for a whole sequence's noise."""

_SMOOTH_DN = 2.0
"""Noise of so many grey levels, or more, makes rounding even: a variance of 1/12 and no bias."""

_REACH = 6.5  # standard deviations beyond which a normal number is not met


def grey_moments(electrons: Array, sensor: Sensor) -> tuple[Array, Array]:
    """Return mean and variance of the grey level of one image, as `grey_level` draws it.

    The electrons are a mixture of normal numbers: of one for each Poisson number where those are
    exact, else of a single one. Each is clipped at saturation and at zero, and rounded.

    Parameters
    ----------
    electrons : ndarray
        Mean number of electrons before read noise.
    sensor : Sensor

    Returns
    -------
    mean, variance : ndarray of float64, of the same shape
        In DN and DN^2.
    """
    mu = np.asarray(electrons, np.float64)
    mean, variance = np.empty_like(mu), np.empty_like(mu)
    few = mu < POISSON_EXACT
    counts = np.arange(POISSON_TERMS + 1.0)
    # 0 log 0 = 0: no electron is certain to be none.
    powers = counts * np.log(np.maximum(mu[few, None], 1e-300))
    factorials = np.array([math.lgamma(count + 1) for count in counts.tolist()])
    weights = np.exp(np.where(counts > 0, powers, 0) - mu[few, None] - factorials)
    first, second = _clipped(counts, np.full_like(counts, sensor.read_noise_e), sensor)
    mean[few] = weights @ first
    variance[few] = weights @ second - mean[few] ** 2
    many = mu[~few]
    first, second = _clipped(many, np.hypot(np.sqrt(many), sensor.read_noise_e), sensor)
    mean[~few], variance[~few] = first, second - first**2
    return mean, np.maximum(variance, 0)


def _clipped(electrons: Array, noise: Array, sensor: Sensor) -> tuple[Array, Array]:
    """Return first and second moment of clip(round(K min(n, saturation) + black level)), n normal.

    Parameters
    ----------
    electrons, noise : ndarray, shape (n,)
        Mean and standard deviation of n.
    sensor : Sensor
    """
    full, gain = sensor.full_scale_dn, sensor.gain_dn_per_e
    grey, spread = gain * electrons + sensor.black_level_dn, gain * noise
    first, second = np.empty_like(grey), np.empty_like(grey)
    even = spread > _SMOOTH_DN
    # Clipped at both ends, without rounding: integrals of the normal density.
    m, s = grey[even], spread[even]
    low, high = -m / s, (full - m) / s
    inside = ndtr(high) - ndtr(low)
    at_low, at_high = (np.exp(-(t**2) / 2) / np.sqrt(2 * np.pi) for t in (low, high))
    saturated = ndtr(-high)
    first[even] = m * inside + s * (at_low - at_high) + full * saturated
    second[even] = (m**2 + s**2 + 1 / 12) * inside + full**2 * saturated
    second[even] += s * (m * at_low - (m + full) * at_high)
    # Rounded: a sum over the levels that the noise reaches, of the chance to be above each.
    m, s = grey[~even, None], np.maximum(spread[~even, None], 1e-9)
    reach = np.ceil(_REACH * _SMOOTH_DN) + 1
    below = np.clip(np.floor(m) - reach, 0, full)
    level = below + np.arange(2 * reach + 1)
    above = np.where(level < full, ndtr((m - level - 0.5) / s), 0)
    first[~even] = below[:, 0] + above.sum(axis=1)
    second[~even] = below[:, 0] ** 2 + ((2 * level + 1) * above).sum(axis=1)
    return first, second


def ndtr(x: Array) -> Array:
    """Return the normal distribution's share below x; SciPy's takes a tenth of a second to import.

    Parameters
    ----------
    x : ndarray

    Returns
    -------
    ndarray of float64, of the same shape
    """
    scaled = (-np.sqrt(0.5) * x).ravel().tolist()
    shares = np.fromiter(map(math.erfc, scaled), np.float64, np.size(x))
    return 0.5 * shares.reshape(np.shape(x))


@dataclass(frozen=True)
class Excess:
    """What noise makes of a grey level that it would not if it were neither clipped nor rounded.

    A table over the signal E, linear within its cells: fine where noise may be less than a grey
    level, then coarse. One begins where the sensor saturates; from the last on all is saturated.

    Attributes
    ----------
    cells : ndarray of float64, shape (n, 4)
        Excess of the mean where a cell begins, DN, and by how much it rises there; the same of the
        variance, DN^2.
    mean_dn : float
        Highest excess of a mean.
    variance_dn2 : float
        Highest variance of one grey level.
    """

    cells: Array
    mean_dn: float
    variance_dn2: float

    @classmethod
    def of(cls, sensor: Sensor) -> Excess:
        """Return a sensor's, made once for all that share its noise."""
        return _excess(
            sensor.saturation_e, sensor.read_noise_e, sensor.black_level_dn, sensor.bit_depth
        )

    def at(self, signal: Array) -> tuple[Array, Array]:
        """Return the excess of mean and variance at some signals.

        Parameters
        ----------
        signal : ndarray
            E, not below 0.

        Returns
        -------
        mean, variance : ndarray of float64, of the same shape
            In DN and DN^2.
        """
        place = np.minimum(signal * CELLS_FINE, signal * CELLS_COARSE + CELLS_OFFSET)
        place = np.minimum(place, len(self.cells) - 1)
        begin = np.floor(place)
        found = self.cells[begin.astype(np.intp)]
        share = place - begin
        return found[..., 0] + share * found[..., 1], found[..., 2] + share * found[..., 3]


@lru_cache(maxsize=64)
def _excess(
    saturation_e: float, read_e: float, black_dn: float, bits: Literal[8, 10, 12, 16]
) -> Excess:
    sensor = Sensor.model_construct(
        saturation_e=saturation_e, read_noise_e=read_e, black_level_dn=black_dn, bit_depth=bits
    )
    spread = np.hypot(saturation_e**0.5, read_e) / saturation_e
    bend = CELLS_OFFSET / (CELLS_FINE - CELLS_COARSE)
    last = 1 + _REACH * spread * (1 + _REACH * spread)
    fine = np.arange(bend * CELLS_FINE) / CELLS_FINE
    coarse = np.arange(bend * CELLS_COARSE, last * CELLS_COARSE + 1) / CELLS_COARSE
    signal = np.concatenate([fine, coarse])
    mean, variance = grey_moments(signal * saturation_e, sensor)
    above = mean - unclipped_mean(signal, sensor)
    # A cell is of one piece: what ends where the sensor saturates is unsaturated throughout.
    below, even = signal[:-1] < 1, unclipped_variance(signal, sensor)
    begin, end = variance[:-1] - below * even[:-1], variance[1:] - below * even[1:]
    cells = np.zeros((len(signal), 4))
    cells[:-1] = np.stack([above[:-1], np.diff(above), begin, end - begin], axis=1)
    return Excess(cells, above.max(), variance.max())


def unclipped_mean(signal: Array, sensor: Sensor) -> Array:
    """Return a grey level without noise: black level + K mu_sat min(E, 1).

    Parameters
    ----------
    signal : ndarray
        E.
    sensor : Sensor

    Returns
    -------
    ndarray of float64, of the same shape
        In DN.
    """
    full: Array = (sensor.full_scale_dn - sensor.black_level_dn) * np.minimum(signal, 1)
    return sensor.black_level_dn + full


def unclipped_variance(signal: Array, sensor: Sensor) -> Array:
    """Return K^2 (mu_sat E + sigma_d^2) + 1/12, the variance of noise that meets no bound.

    Parameters
    ----------
    signal : ndarray
        E.
    sensor : Sensor

    Returns
    -------
    ndarray of float64, of the same shape
        In DN^2.
    """
    electrons: Array = sensor.saturation_e * signal + sensor.read_noise_e**2
    return sensor.gain_dn_per_e**2 * electrons + 1 / 12


@dataclass(frozen=True)
class Moments:
    """What the noisy aspect image is on average over all its draws.

    Attributes
    ----------
    mean, deviation : ndarray, shape (M, N)
        Mean and standard deviation of each pixel, DN.
    """

    mean: NDArray[Any]
    deviation: NDArray[Any]


def noisy_moments(
    planes: Sequence[NDArray[Any]], station: Station, column: Any, row: Any
) -> Moments:
    """Return mean and deviation of the mean over a scan with noise: a sum over its images.

    Parameters
    ----------
    planes : sequence of ndarray
        Light coordinate and widths of the footprint's two boxes in mm, and relative irradiance, of
        all sub-rays: of one shape (n * n, M, N).
    station : Station
    column, row : int or ndarray
        Of the pixels, of shape (M, N): their gain and dark signal are their own.
    """
    sensor, leak = station.sensor, station.tunnel.dark_leak
    shifts = station.distinct_shifts or station.sequence.images  # those that differ
    light, wide, narrow, irradiance = (np.asarray(plane, np.float64) for plane in planes)
    excess, scattered = Excess.of(sensor), diffuse_share(station)
    gain, dark = own_response(sensor, column, row)
    mean, variance = np.zeros(light.shape[1:]), np.zeros(light.shape[1:])
    for k in range(shifts):
        lit = lit_fraction(light, wide, narrow, k * station.step_mm, station)
        seen = (irradiance * (leak + (1 - leak) * lit + scattered)).mean(axis=0)
        signal = sensor.exposure * seen * gain + dark
        above, more = excess.at(signal)
        mean += unclipped_mean(signal, sensor) + above
        variance += np.where(signal < 1, unclipped_variance(signal, sensor), 0) + more
    deviation = np.sqrt(np.maximum(variance, 0) / (shifts * station.sequence.images))
    return Moments(mean / shifts, deviation)


def own_response(sensor: Sensor, column: Any, row: Any) -> tuple[Any, Any]:
    """Return a pixel's gain and its dark signal over saturation, the same in every image.

    Parameters
    ----------
    sensor : Sensor
    column, row : int or ndarray
        Of the pixels.
    """
    first, second = 0.0, 0.0
    if sensor.prnu or sensor.dsnu_e:
        words = random_words(column, row, FIXED_PATTERN, sensor.seed)
        first, second = normal_numbers(words[0], words[1])  # type: ignore[assignment]
    dark = np.maximum(sensor.dark_e + sensor.dsnu_e * second, 0) / sensor.saturation_e
    return np.maximum(1 + sensor.prnu * first, 0), dark


def drawn(moments: Moments, station: Station, column: Any, row: Any) -> Array:
    """Return an aspect image of these moments: a normal number for each pixel, from its counter.

    Parameters
    ----------
    moments : Moments
    station : Station
        Its sensor is used.
    column, row : int or ndarray
        Of the pixels.
    """
    words = random_words(column, row, ONE_DRAW, station.sensor.seed)
    normal, _ = normal_numbers(words[0], words[1])
    grey = moments.mean + moments.deviation * normal
    return np.clip(grey, 0, station.sensor.full_scale_dn)
