"""Bounds of counts alone, exact and one-sided: Clopper and Pearson's, and Poisson's."""

from __future__ import annotations

import math

from gpuspec.detectability.curve import CONFIDENCE, POD


def least_share(hits: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """Return the lower bound of a probability (Clopper, Pearson, Biometrika 26, 1934).

    Parameters
    ----------
    hits, trials : int
    confidence : float
        One-sided.

    Examples
    --------
    >>> from gpuspec.detectability.exact import least_share
    >>> least_share(28, 28) < 0.9 < least_share(29, 29)  # 29 of 29 is 90/95
    True
    """
    from scipy import special  # slow to import

    if not hits:
        return 0.0
    return float(special.betaincinv(hits, trials - hits + 1, 1 - confidence))


def greatest_share(hits: float, trials: int, confidence: float = CONFIDENCE) -> float:
    """Return the upper bound of a probability, see :func:`least_share`.

    Parameters
    ----------
    hits : float
    trials : int
    confidence : float
        One-sided.
    """
    from scipy import special  # slow to import

    if hits >= trials:
        return 1.0
    return float(special.betaincinv(hits + 1, trials - hits, confidence))


def greatest_mean(events: float, confidence: float = CONFIDENCE) -> float:
    """Return the upper bound of the mean of a Poisson distribution that gave this many events.

    Parameters
    ----------
    events : float
    confidence : float
        One-sided.

    Examples
    --------
    >>> from gpuspec.detectability.exact import greatest_mean
    >>> round(greatest_mean(0), 3)  # the rule of three
    2.996
    """
    from scipy import special  # slow to import

    return float(special.gammaincinv(events + 1, confidence))


def trials_all_hit(pod: float = POD, confidence: float = CONFIDENCE) -> int:
    """Return how many trials, all of them hit, show a probability: 29 for 90/95.

    Parameters
    ----------
    pod, confidence : float

    Examples
    --------
    >>> from gpuspec.detectability.exact import trials_all_hit
    >>> trials_all_hit()
    29
    """
    return math.ceil(math.log(1 - confidence) / math.log(pod))
