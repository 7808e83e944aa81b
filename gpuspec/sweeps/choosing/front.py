"""The front: the points that no other beats in P1, P2 and defects hit together.

Thresholds at which more than half of what is flawless is detected are no points. Every design has
some that detect everything: all have the same P1 and a P2 of 1, which nothing beats.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute
from numpy.typing import NDArray

from gpuspec.light.constants import LEVELS

COLUMNS = ("design", "exact", "p1", "p2", "hits", "p1_low", "p1_high")
"""Of a sweep's table, what a score is made of."""

MOST = 0.5
"""Share of what is flawless, of all that is detected at the lowest threshold, that a point may
detect at most."""


@dataclass(frozen=True)
class Points:
    """Designs at thresholds.

    Attributes
    ----------
    design, level : ndarray of int64, shape (n,)
        Which design, and which of the 256 thresholds.
    p1, p2 : ndarray of float64, shape (n,)
    hits : ndarray of int64, shape (n,)
    exact : ndarray of bool, shape (n,)
        Whether P1 is that of every pixel, and no bound of it.
    """

    design: NDArray[np.int64]
    level: NDArray[np.int64]
    p1: NDArray[np.float64]
    p2: NDArray[np.float64]
    hits: NDArray[np.int64]
    exact: NDArray[np.bool_]

    def __repr__(self) -> str:
        names = ", ".join(field.name for field in fields(self))
        return f"Points({len(self.design):,} designs at a threshold: {names})"

    @classmethod
    def empty(cls) -> Points:
        """Return no points."""
        whole, real = np.empty(0, np.int64), np.empty(0)
        return cls(whole, whole, real, real, whole, np.empty(0, np.bool_))

    def only(self, where: NDArray[np.bool_] | NDArray[np.intp]) -> Points:
        """Return some of the points."""
        return Points(*(getattr(self, field.name)[where] for field in fields(self)))

    def with_points(self, more: Points) -> Points:
        """Return these points and more."""
        return Points(
            *(np.concatenate([getattr(p, f.name) for p in (self, more)]) for f in fields(self))
        )


def dominated(points: Points, by: Points) -> NDArray[np.bool_]:
    """Return which points some others dominate.

    A point dominates another if it is at least as high in all three and higher in one; of equal
    points none dominates the other.

    Parameters
    ----------
    points, by : Points
    """
    found = np.zeros(len(points.p1), np.bool_)
    above = _Stairs.empty()
    left = np.ones(len(by.p1), np.bool_)
    for level in np.unique(points.hits)[::-1]:
        here = points.hits == level
        p1, p2 = points.p1[here], points.p2[here]
        more, equal = left & (by.hits > level), left & (by.hits == level)
        above = above.with_points(by.p1[more], by.p2[more])
        same = above.with_points(by.p1[equal], by.p2[equal])
        beaten = same.highest(p2) > p1
        beaten |= same.highest(p2, strictly=True) >= p1
        beaten |= above.highest(p2) >= p1
        found[here] = beaten
        above = same
        left &= ~(more | equal)
    return found


@dataclass(frozen=True)
class _Stairs:
    """Highest P1 among points whose P2 is at least something: rising P2, falling P1."""

    p2: NDArray[np.float64]
    p1: NDArray[np.float64]

    @classmethod
    def empty(cls) -> _Stairs:
        return cls(np.empty(0), np.empty(0))

    def with_points(self, p1: NDArray[np.float64], p2: NDArray[np.float64]) -> _Stairs:
        p1, p2 = np.concatenate([self.p1, p1]), np.concatenate([self.p2, p2])
        order = np.lexsort((p1, p2))[::-1]  # falling P2, of equal ones the highest P1 first
        p1, p2 = p1[order], p2[order]
        step = np.r_[True, p1[1:] > np.maximum.accumulate(p1)[:-1]] if len(p1) else []
        return _Stairs(p2[step][::-1], p1[step][::-1])

    def highest(self, p2: NDArray[np.float64], *, strictly: bool = False) -> NDArray[np.float64]:
        """Return the highest P1 where P2 is at least (or above) some values, -1 if nowhere."""
        first = np.searchsorted(self.p2, p2, "right" if strictly else "left")
        return np.append(self.p1, -1.0)[first]


class Front:
    """What may be on the front, found batch by batch: memory does not grow with the designs.

    Where P1 is estimated a point has a greatest and a least P1 it may be. A point is left out if
    another beats its greatest with its least; the others are the `pool`.

    Attributes
    ----------
    pool : Points
        With the greatest P1.
    """

    def __init__(self) -> None:
        self.pool = Points.empty()
        self._sure = Points.empty()  # with the least P1

    def add(self, table: pa.Table) -> None:
        """Add rows of a sweep's table, in place of earlier ones of the same designs."""
        self.pool = self.pool.only(~np.isin(self.pool.design, table["design"].to_numpy()))
        greatest, least = _points(table)
        self._sure = self._sure.with_points(least)
        self._sure = self._sure.only(~dominated(self._sure, self._sure))
        self.pool = self.pool.with_points(greatest)
        self.pool = self.pool.only(~dominated(self.pool, self._sure))

    def points(self) -> Points:
        """Return the front by falling P2, the greatest P1 taken where it is estimated."""
        front = self.pool.only(~dominated(self.pool, self.pool))
        return front.only(np.lexsort((front.level, front.design, -front.p1, -front.p2)))


def curves(table: pa.Table, name: str) -> NDArray[np.float64]:
    """Return a column of curves as an array (D, 256).

    Parameters
    ----------
    table : pyarrow.Table
        D rows.
    name : str
        Of a column of lists of 256.
    """
    column = table[name].combine_chunks()
    array = column.flatten() if not column.null_count else column.values
    values: NDArray[np.float64] = array.to_numpy(zero_copy_only=False).reshape(-1, LEVELS)
    return values


def p1_bounds(table: pa.Table) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the greatest P1 there may be, equal where it is exact; (D, 256)."""
    p1, exact = curves(table, "p1"), table["exact"].to_numpy()
    if exact.all():
        return p1, p1
    low, high = (
        table[name].combine_chunks().fill_null([0.0] * LEVELS).flatten().to_numpy()
        for name in ("p1_low", "p1_high")
    )
    low, high = low.reshape(-1, LEVELS), high.reshape(-1, LEVELS)
    return np.where(exact[:, None], p1, low), np.where(exact[:, None], p1, high)


def _points(table: pa.Table) -> tuple[Points, Points]:
    """Return the points of a table's designs with the greatest and the least P1 they may have."""
    table = table.select(COLUMNS).filter(pa.compute.is_valid(table["exact"]))
    if not len(table):
        return Points.empty(), Points.empty()
    p2, hits = curves(table, "p2"), curves(table, "hits")
    low, high = p1_bounds(table)
    # Of a design's thresholds that detect the same zone pixels the highest has the best P1.
    row, level = np.nonzero(np.diff(p2, axis=1, append=-1.0) != 0)
    at = row, level
    design, exact = table["design"].to_numpy()[row], low[at] == high[at]
    greatest = Points(design, level, high[at], p2[at], hits[at].astype(np.int64), exact)
    least = replace(greatest, p1=low[at])
    fewest, most = _detected(p2, high), _detected(p2, low)
    maybe = ~(fewest > MOST * most[:, :1])[at]
    surely = ~(most > MOST * fewest[:, :1])[at]
    return greatest.only(maybe), least.only(surely)


def _detected(p2: NDArray[np.float64], p1: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how many flawless pixels are detected at each threshold, over those of the zones."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found: NDArray[np.float64] = p2 * (1 / p1 - 1)
    return found
