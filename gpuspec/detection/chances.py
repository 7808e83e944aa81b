"""What so many trials tell of a chance: bounds of counts alone, exact and one-sided."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

CONFIDENCE = 0.95
"""Where nothing else is said: a statement is wrong once in twenty times at most."""


def least_share(hits: ArrayLike, trials: ArrayLike, confidence: float = CONFIDENCE) -> Any:
    """Return the lower bound of a probability (Clopper, Pearson, Biometrika 26, 1934).

    Parameters
    ----------
    hits, trials : array_like
        Of shapes that broadcast.
    confidence : float
        One-sided.

    Examples
    --------
    >>> from gpuspec.detection.chances import least_share
    >>> bool(least_share(28, 28) < 0.9 < least_share(29, 29))  # 29 of 29 is 90/95
    True
    """
    from scipy import special  # slow to import

    hits, trials = np.asarray(hits, float), np.asarray(trials, float)
    low = special.betaincinv(np.maximum(hits, 0.5), trials - hits + 1, 1 - confidence)
    return np.where(hits > 0, low, 0.0)[()]


def greatest_share(hits: ArrayLike, trials: ArrayLike, confidence: float = CONFIDENCE) -> Any:
    """Return the upper bound of a probability, see :func:`least_share`.

    Parameters
    ----------
    hits, trials : array_like
        Of shapes that broadcast.
    confidence : float
        One-sided.
    """
    return 1 - least_share(np.subtract(trials, hits), trials, confidence)


def share_within(hits: float, trials: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return between which bounds a probability lies, see :func:`least_share`.

    Parameters
    ----------
    hits, trials : float
    confidence : float
        Two-sided: half of the risk on each side.

    Examples
    --------
    >>> from gpuspec.detection.chances import share_within
    >>> [round(end, 3) for end in share_within(36, 36)]
    [0.903, 1.0]
    """
    each = (1 + confidence) / 2
    return float(least_share(hits, trials, each)), float(greatest_share(hits, trials, each))


def greatest_mean(events: float, confidence: float = CONFIDENCE) -> float:
    """Return the upper bound of the mean of a Poisson distribution that gave this many events.

    Parameters
    ----------
    events : float
    confidence : float
        One-sided.

    Examples
    --------
    >>> from gpuspec.detection.chances import greatest_mean
    >>> round(greatest_mean(0), 3)  # the rule of three
    2.996
    """
    from scipy import special  # slow to import

    return float(special.gammaincinv(events + 1, confidence))


def trials_all_hit(chance: float = 0.9, confidence: float = CONFIDENCE) -> int:
    """Return how many trials, all of them hit, show a probability: 29 for 90/95.

    Parameters
    ----------
    chance, confidence : float

    Examples
    --------
    >>> from gpuspec.detection.chances import trials_all_hit
    >>> trials_all_hit()
    29
    """
    return math.ceil(math.log(1 - confidence) / math.log(chance))
