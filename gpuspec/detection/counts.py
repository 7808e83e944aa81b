"""Counts of independent events, each of its own probability, and the share of one in two of them.

Of a count N its generating function G(z) = E[z^N] is a product over the events. As 1/n is the
integral of z^(n - 1) over 0 to 1, and 1/n² that of -ln z z^(n - 1), mean and variance of a share of
two such counts are integrals over z, of sums over the events: exact, however few are expected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_RARE = 0.01
"""Probability up to which events are told by the sums of p and p²: log(1 - pu) within p³/3."""
_MANY = 300.0
"""Expected events above which a share is told by the leading orders: within 1e-4 of the integrals,
its deviation within a percent."""
_NODES = 128  # of Gauss and Legendre: below 1e-9 of the share for 300 events


@dataclass(frozen=True, eq=False)
class Count:
    """How many of some independent events happen.

    Attributes
    ----------
    mean, variance : float
    likely : ndarray, shape (n,)
        Probabilities of those that are not rare.
    rare, rare_squared : float
        Sums of the probabilities of the others, and of their squares.
    """

    mean: float
    variance: float
    likely: Array
    rare: float
    rare_squared: float

    @classmethod
    def of(cls, p: Array) -> Count:
        """Take the events' probabilities.

        Parameters
        ----------
        p : ndarray, shape (n,)

        Examples
        --------
        >>> from gpuspec.detection.counts import Count
        >>> count = Count.of(np.array([0.5, 0.5, 1.0]))
        >>> count.mean, count.variance
        (2.0, 0.5)
        """
        rare = p[p <= _RARE]
        return cls(
            float(p.sum()), float((p * (1 - p)).sum()), p[p > _RARE], float(rare.sum()),
            float((rare**2).sum()),
        )  # fmt: skip

    def tilted(self, z: float) -> tuple[float, float, float]:
        """Return G(z), and mean and variance of the count when z^N weighs what happens.

        Parameters
        ----------
        z : float
            0 to 1; at 1 nothing is weighed.
        """
        beside = 1 - z
        with np.errstate(divide="ignore"):
            log = float(np.log1p(-self.likely * beside).sum())
        weight = math.exp(log - beside * (self.rare + beside * self.rare_squared / 2))
        p = self.likely * z
        p = np.divide(p, p + 1 - self.likely, out=np.ones_like(p), where=self.likely < 1)
        rare = z * (self.rare + beside * self.rare_squared)
        mean = float(p.sum()) + rare
        variance = float((p * (1 - p)).sum()) + rare - z**2 * self.rare_squared
        return weight, mean, variance


def share_of(some: Count, others: Count) -> tuple[float, float]:
    """Return mean and standard deviation of ``some / (some + others)``, 1 where both are 0.

    Parameters
    ----------
    some, others : Count
        Independent of each other.

    Examples
    --------
    >>> from gpuspec.detection.counts import Count, share_of
    >>> mean, deviation = share_of(Count.of(np.zeros(0)), Count.of(np.array([0.25])))
    >>> round(mean, 6), round(deviation, 6)  # 0 once in four times, and else 1
    (0.75, 0.433013)
    """
    if not others.mean:
        return 1.0, 0.0
    total = some.mean + others.mean
    if total > _MANY or not some.variance + others.variance:
        return _of_many(some, others)
    y, weights = np.polynomial.legendre.leggauss(_NODES)
    y = (y + 1) / 2
    nodes = []
    for z in (y**2).tolist():
        one, two = some.tilted(z), others.tilted(z)
        nodes.append((one[0] * two[0], *one[1:], *two[1:]))
    both, mean, variance, other_mean, other_variance = np.array(nodes).T
    both *= weights / y  # dz/z = 2 dy/y, and half of it for the nodes lie from -1 to 1
    nothing = some.tilted(0.0)[0] * others.tilted(0.0)[0]
    share = min(nothing + float(both @ mean), 1.0)
    square = (
        ((1 - share) * mean - share * other_mean) ** 2
        + (1 - share) ** 2 * variance
        + share**2 * other_variance
    )
    spread = nothing * (1 - share) ** 2 + float(both @ (-2 * np.log(y) * square))
    return share, math.sqrt(spread)


def _of_many(some: Count, others: Count) -> tuple[float, float]:
    """Return the share to second order of its counts' deviations, and its deviation to first."""
    total = some.mean + others.mean
    bend = some.mean * others.variance - others.mean * some.variance
    spread = others.mean**2 * some.variance + some.mean**2 * others.variance
    return some.mean / total + bend / total**3, math.sqrt(spread) / total**2
