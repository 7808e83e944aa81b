"""Screening: how sure one can be of what a sample of a part's pixels says."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

STRATA = 16_384
"""Of one part, where nothing else is said: with ten times as many the bounds are not tighter where
it matters, see `Flawless`."""

_EACH = 500  # numbers of drawn pixels whose bounds are worked out one by one
_STEPS = 2000

CONFIDENCE = 0.99
"""Of all bounds of a sweep together."""


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
    from scipy import special  # slow to import

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
