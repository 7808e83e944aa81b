"""Screening: which pixels stand for a part, and how sure one can be of what they say."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from gpuspec.arrays import Mask
from gpuspec.light.levels import Sample, Zones
from gpuspec.light.light_map import LightMapArrays

STRATA = 32_768
"""Of one part, where nothing else is said: with ten times as many the bounds are not tighter where
it matters, see `_bounding`."""

_REACH_PX = 2
_OUTLYING = 0.001  # share of the footprint
_OUTLYING_MAX = 0.1  # share of the pixels: more than these are the surface itself
_REGION_PX = 64
_EACH = 500  # numbers of drawn pixels whose bounds are worked out one by one
_STEPS = 2000

CONFIDENCE = 0.99
"""Of all bounds of a sweep together."""


def draw(
    zones: Zones, arrays: LightMapArrays, flawless_mm: NDArray[np.floating[Any]], strata: int,
    seed: int,
) -> Sample | None:  # fmt: skip
    """Draw the pixels that stand for all those outside the zones.

    A defect's relief reaches past its zone: pixels next to a zone are all taken, and so are those
    whose footprint is not that of a flawless part. The others, row by row, are cut into runs of
    neighbours of one length, a stratum each, and one pixel is drawn at random from every run.

    Parameters
    ----------
    zones : Zones
    arrays : LightMapArrays
        Of one footprint per pixel.
    flawless_mm : ndarray, shape (M, N)
        Footprint of the part without defects.
    strata : int
        Number of runs, about.
    seed : int

    Returns
    -------
    Sample or None
        None if nothing is left to be drawn from.
    """
    footprint, irradiance = arrays.footprint_mm[0], arrays.irradiance[0]
    near = np.zeros(zones.valid.shape, np.uint8)
    near.flat[zones.pixels] = 1
    for along in (0, 1):
        near = ndimage.maximum_filter1d(near, 2 * _REACH_PX + 1, axis=along)
    near = near != 0
    outlying = np.abs(footprint - flawless_mm) > _OUTLYING * flawless_mm
    if np.count_nonzero(outlying) < _OUTLYING_MAX * outlying.size:
        near |= outlying
    near &= zones.valid
    rest = zones.valid & ~near
    near.flat[zones.pixels] = False
    others = np.flatnonzero(rest).astype(np.uint32)
    # One length for all parts of a geometry, so that their strata can be taken together.
    weight = max(zones.valid.size // strata, 1)
    runs = len(others) // weight
    if not runs:
        return None
    offset = np.random.default_rng(seed).integers(0, weight, runs)
    chosen = others[np.arange(runs) * weight + offset]
    near.flat[others[runs * weight :]] = True
    bound = _bounding(footprint, irradiance, rest)
    return Sample(np.flatnonzero(near).astype(np.uint32), chosen, weight, *bound)


def _regions(values: Any, keep: Mask, fill: float) -> NDArray[np.float32]:
    """Return values of an image by region, shape (g, pixels); `fill` where not kept, or beyond."""
    values = np.where(keep, values, np.float32(fill))
    (rows, columns), size = values.shape, _REGION_PX
    padding = ((0, -rows % size), (0, -columns % size))
    padded = np.pad(values, padding, constant_values=np.float32(fill))
    across = padded.shape[1] // size
    return padded.reshape(-1, size, across, size).swapaxes(1, 2).reshape(-1, size * size)


def _bounding(
    footprint: NDArray[np.float32], irradiance: NDArray[np.float32], rest: Mask
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a footprint and an irradiance per region whose exposure is not below any pixel's.

    The light on a footprint grows with it: q(w) w <= q(w1) w1 for w <= w1 around the same light
    coordinate, so that V q(w) <= (V1 w1/w0) q(w1) where w0 <= w <= w1 and V <= V1.
    """
    seen = rest & (irradiance > 0)
    narrowest = _regions(footprint, seen, np.inf).min(axis=1)
    widest = _regions(footprint, seen, 0).max(axis=1)
    brightest = _regions(irradiance, seen, 0).max(axis=1)
    there = widest > 0
    if not there.any():
        return np.ones(1, np.float32), np.zeros(1, np.float32)
    widest, narrowest = widest[there], narrowest[there]
    return widest, brightest[there] * (widest / narrowest)


@dataclass(frozen=True)
class Bounds:
    """How many pixels are detected, from how many of a sample are.

    One pixel is drawn from each of n strata of equal size. The number x of drawn pixels that are
    detected is then a sum of n independent trials of unequal chances. Its tails are thinner than
    those of n equal trials with the mean chance (Hoeffding, Ann. Math. Statist. 27, 1956), so that
    the interval of Clopper and Pearson (Biometrika 26, 1934) for the mean chance holds with at
    least its confidence.

    Attributes
    ----------
    strata : int
        n.
    weight : int
        Pixels of a stratum.
    risk : float
        Greatest chance that the true number is below the lower bound; the same for the upper.
    """

    strata: int
    weight: int
    risk: float

    def low(self, drawn: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the lower bound for some x: the drawn pixels are detected for certain."""
        return np.maximum(_tables(self)[0][drawn], drawn)

    def high(self, drawn: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the upper bound for some x: the drawn pixels that are not are not, for certain."""
        certain = self.strata * self.weight - (self.strata - drawn)
        return np.minimum(_tables(self)[1][drawn], certain)


@lru_cache(maxsize=4)
def _tables(bounds: Bounds) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both bounds for every x; between steps of 0.2 %, those of the step further out."""
    n = bounds.strata
    steps = np.arange(min(n, _EACH))
    x = np.unique(np.concatenate([steps, np.geomspace(_EACH, max(n, _EACH), _STEPS), [n]]))
    x = x[x <= n].astype(np.int64)
    low, high = np.zeros(len(x)), np.ones(len(x))
    low[1:] = special.betaincinv(x[1:], n - x[1:] + 1, bounds.risk)
    high[:-1] = special.betainccinv(x[:-1] + 1, n - x[:-1], bounds.risk)
    every, total = np.arange(n + 1), n * bounds.weight
    below = np.searchsorted(x, every, "right") - 1
    return low[below] * total, high[np.searchsorted(x, every)] * total
