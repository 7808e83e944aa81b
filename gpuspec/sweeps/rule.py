"""Which threshold, and which design, is the best."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import StationError

Goal = Literal["p1", "p2", "f1"]
GOALS: tuple[Goal, ...] = ("p1", "p2", "f1")


def f1_of(p1: NDArray[np.float64], p2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 2 P1 P2/(P1 + P2), 0 where both are 0.

    Parameters
    ----------
    p1, p2 : ndarray
        Of shapes that broadcast.

    Returns
    -------
    ndarray of float64
        Of the shape they broadcast to.

    Examples
    --------
    >>> from gpuspec.sweeps.rule import f1_of
    >>> f1_of(np.array([1.0, 0.0]), np.array([0.5, 0.0])).round(3).tolist()
    [0.667, 0.0]
    """
    return 2 * p1 * p2 / np.maximum(p1 + p2, np.finfo(float).tiny)


@dataclass(frozen=True)
class Rule:
    """What is asked of a design, the first things first.

    By default, in the paper's spirit: all defects hit, P2 above a floor, then the highest P1. The
    floor of 0.85 is ours: with a lower one P1 rises only as P2 falls, at thresholds so high that
    the faintest defect decides, and the chosen designs stand alone among worse ones. What no
    threshold fulfils is fulfilled as far as can be.

    Attributes
    ----------
    goal : "p1", "p2" or "f1"
        What is to be highest.
    p2_floor, p1_floor : float
        Least P2 and P1.
    hit_share : float
        Least share of the defects that must be hit.

    Examples
    --------
    >>> rule = gpuspec.Rule(goal="f1", p2_floor=0.9, hit_share=0.95)
    >>> print(rule)
    95% of the defects hit, P2 at least 0.9, then the highest F1
    >>> rule.required(36)
    35
    >>> gpuspec.Rule(goal="f2")
    Traceback (most recent call last):
        ...
    gpuspec.errors.StationError: the goal 'f2' is not known; choose p1, p2, f1.
    """

    goal: Goal = "p1"
    p2_floor: float = 0.85
    p1_floor: float = 0.0
    hit_share: float = 1.0

    def __post_init__(self) -> None:
        if self.goal not in GOALS:
            raise StationError(f"the goal {self.goal!r} is not known; choose {', '.join(GOALS)}.")
        for name in ("p2_floor", "p1_floor", "hit_share"):
            value = getattr(self, name)
            if not isinstance(value, Real) or not 0 <= float(value) <= 1:
                raise StationError(f"{name} is {value!r}; it must be a number from 0 to 1.")

    def asking(self, **asked: Any) -> Rule:
        """Return the rule with other things asked for, by the names of its attributes.

        Raises
        ------
        StationError
            If a name or a value is none.

        Examples
        --------
        >>> from gpuspec import Rule
        >>> str(Rule().asking(goal="f1", p2_floor=0))
        'all defects hit, then the highest F1'
        """
        known = [field.name for field in fields(self)]
        for name in asked:
            if name not in known:
                raise StationError(f"a rule has no {name}; it has {', '.join(known)}.")
        return replace(self, **asked)

    def required(self, seen: int) -> int:
        """Return how many of the defects that can be seen must be hit."""
        return math.ceil(self.hit_share * seen - 1e-9)

    def criteria(self, p1: Any, p2: Any, hits: Any, seen: Any) -> list[NDArray[np.float64]]:
        """Return what is to be highest, one after another.

        Parameters
        ----------
        p1, p2, hits : array
            Of points, of one shape.
        seen : int or array
            Defects that can be hit, of a shape that broadcasts with theirs.

        Returns
        -------
        list of ndarray
            Hits, P2 and P1 as far as they are asked for, then the goal, P2 and P1.
        """
        required = np.ceil(self.hit_share * np.asarray(seen) - 1e-9)
        goal = {"p1": p1, "p2": p2}.get(self.goal)
        return [
            np.minimum(hits, required),
            np.minimum(p2, self.p2_floor),
            np.minimum(p1, self.p1_floor),
            f1_of(p1, p2) if goal is None else goal,
            p2,
            p1,
        ]

    def thresholds(self, p1: Any, p2: Any, hits: Any, seen: Any) -> NDArray[np.intp]:
        """Return the best threshold of each design, the lowest of equals.

        Parameters
        ----------
        p1, p2, hits : array, shape (D, 256)
        seen : int or array, shape (D, 1)
            Defects that can be hit.

        Returns
        -------
        ndarray of int, shape (D,)
        """
        left = np.ones(np.shape(p1), np.bool_)
        for criterion in self.criteria(p1, p2, hits, seen):
            value = np.where(left, criterion, -np.inf)
            left &= value == value.max(axis=-1, keepdims=True)
        best: NDArray[np.intp] = left.argmax(axis=-1)
        return best

    def best(self, p1: Any, p2: Any, hits: Any, seen: Any) -> int:
        """Return the best of some points, the first of equals.

        Parameters
        ----------
        p1, p2, hits : array, shape (n,)
        seen : int or array
            Defects that can be hit.

        Examples
        --------
        >>> p1, p2, hits = np.array([[0.5, 0.7, 0.9], [0.95, 0.9, 0.6], [9, 9, 8]])
        >>> gpuspec.Rule().best(p1, p2, hits, 9)  # all hit, P2 at least 0.85, then the highest P1
        1
        >>> gpuspec.Rule(p2_floor=0.5, hit_share=0.8).best(p1, p2, hits, 9)
        2
        """
        return int(self.thresholds(p1, p2, hits, seen))

    def fulfilled(self, p1: float, p2: float, hits: int, seen: int) -> bool:
        """Whether a point has all that is asked for.

        Parameters
        ----------
        p1, p2 : float
        hits : int
            Defects hit.
        seen : int
            Defects that can be hit.
        """
        return hits >= self.required(seen) and p2 >= self.p2_floor and p1 >= self.p1_floor

    def __str__(self) -> str:
        share = "all" if self.hit_share == 1 else f"{self.hit_share:.0%} of the"
        floors = [
            f"{name} at least {floor:g}"
            for name, floor in (("P2", self.p2_floor), ("P1", self.p1_floor))
            if floor
        ]
        return ", ".join([f"{share} defects hit", *floors, f"then the highest {self.goal.upper()}"])
