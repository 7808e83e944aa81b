"""What a flawless surface shows in an aspect image: its level, its ripple and its noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image, Mask
from gpuspec.detection.background import robust_sigma, smoothed
from gpuspec.frames.replay import FINE_PX, WIDE_PX

_HIGH_PX = 4.0  # Gaussian below which neighbours' noise is compared


@dataclass(frozen=True)
class Texture:
    """An aspect image of an even part, in five numbers.

    Attributes
    ----------
    level_dn : float
        Median grey level.
    noise_dn : float
        Robust standard deviation between Gaussians of 1.5 and 25 px: what hides a scratch.
    pixel_noise_dn : float
        The same of what is finer than 1.5 px.
    ripple_dn : float
        Rms of what goes with the light's phase: stripes that are left in the mean.
    correlation : float
        Of the noise of neighbours in a row; 0: each pixel has its own.
    """

    level_dn: float
    noise_dn: float
    pixel_noise_dn: float
    ripple_dn: float
    correlation: float


def texture(
    aspect: Image, phase: NDArray[np.float64], region: Mask, images_per_period: float
) -> Texture:
    """Measure the aspect image of an even part.

    Parameters
    ----------
    aspect : ndarray of float32, shape (M, N)
        DN.
    phase : ndarray of float64, shape (M, N)
        Of the light, in periods.
    region : ndarray of bool, shape (M, N)
    images_per_period : float

    Examples
    --------
    >>> from gpuspec.frames.texture import texture
    >>> x, rng = np.arange(400) + np.zeros((300, 1)), np.random.default_rng(3)
    >>> aspect = (70 + np.sin(2 * np.pi * x / 40) + rng.normal(0, 0.5, x.shape)).astype("f4")
    >>> found = texture(aspect, x / 40, np.full(x.shape, True), 12)
    >>> round(found.level_dn), round(found.ripple_dn, 2), round(found.pixel_noise_dn, 1)
    (70, 0.71, 0.5)
    """
    fine, wide = smoothed(aspect, region, FINE_PX), smoothed(aspect, region, WIDE_PX)
    rest = aspect - smoothed(aspect, region, _HIGH_PX)
    both = region[:, 1:] & region[:, :-1]
    limit = 5 * robust_sigma(rest[region])
    both &= (np.abs(rest[:, 1:]) < limit) & (np.abs(rest[:, :-1]) < limit)
    left, right = rest[:, :-1][both], rest[:, 1:][both]
    return Texture(
        float(np.median(aspect[region])),
        robust_sigma((fine - wide)[region]),
        robust_sigma((aspect - fine)[region]),
        _ripple(aspect[region], phase[region], images_per_period),
        float(np.mean(left * right) / max(float(np.mean(left * left)), 1e-12)),
    )


def _ripple(
    levels: NDArray[np.float32], phase: NDArray[np.float64], images_per_period: float
) -> float:
    """Return the rms of the levels' waves: of one and two to a period, and of one to a step."""
    rest = levels - np.median(levels)
    waves = [np.mean(rest * np.exp(-2j * np.pi * order * phase))
             for order in (1.0, 2.0, images_per_period)]  # fmt: skip
    return float(np.sqrt(2 * sum(abs(one) ** 2 for one in waves)))


def band_gain() -> float:
    """Return by how much :attr:`Texture.noise_dn` is less than noise that each pixel has alone.

    Examples
    --------
    >>> from gpuspec.frames.texture import band_gain
    >>> round(band_gain(), 3)
    0.187
    """
    point = np.zeros((257, 257), np.float32)
    point[128, 128] = 1
    everywhere = np.full(point.shape, True)
    seen = smoothed(point, everywhere, FINE_PX) - smoothed(point, everywhere, WIDE_PX)
    return float(np.sqrt(np.sum(seen.astype(np.float64) ** 2)))
