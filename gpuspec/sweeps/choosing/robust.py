"""Which designs hold: the worst within tolerances, with the threshold held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.station.corners import stated
from gpuspec.sweeps.axes import Axis
from gpuspec.sweeps.plan import Plan

Ints = NDArray[np.int64]

_SAME = 1e-9


@dataclass(frozen=True)
class Tolerances:
    """By how much keys may be off, each way.

    Attributes
    ----------
    halves : dict of str to float or None
        By key; None: to the next value of the grid on both sides.
    """

    halves: Mapping[str, float | None]

    @classmethod
    def of(cls, plan: Plan) -> Tolerances:
        """Return those of a plan: its station's ``[tolerance]``, else a step of the grid.

        Keys that the table does not name are exact, and without it those that take whole numbers.

        Raises
        ------
        StationError
            If the table names no key, or none that is a number.
        """
        given = stated(plan.station, [a.key for a in plan.axes])
        steps = {a.key: None for a in plan.axes
                 if len(a.values) > 1 and not isinstance(a.values[0], int)}  # fmt: skip
        return cls(given or steps)

    def __str__(self) -> str:
        said = [
            f"{key} {'a step of the grid' if half is None else f'+- {half:g}'}"
            for key, half in self.halves.items()
        ]
        return ", ".join(said) or "none: every key that is varied takes whole numbers"

    def beyond(self, plan: Plan, design: int) -> dict[str, float]:
        """Return the tolerances that the grid does not hold at a design: keys and their halves.

        Parameters
        ----------
        plan : Plan
        design : int
        """
        axes = {a.key: a for a in plan.axes}
        values = plan.values(design)
        found = {}
        for key, half in self.halves.items():
            if half is None:
                continue
            there = axes[key].values if key in axes else ()
            ends = (values[key] - half, values[key] + half) if key in axes else (None,)
            on_grid = [e is not None and any(abs(v - e) <= _SAME + 1e-6 * half for v in there)
                       for e in ends]  # fmt: skip
            if not all(on_grid):
                found[key] = half
        return found


def windows(plan: Plan, tolerances: Tolerances, weakest: Ints, flawless: Ints) -> tuple[Ints, Ints]:
    """Return between which thresholds each design and all its neighbours find all and nothing else.

    Neighbours are the designs of the grid within the tolerances of all keys at once.

    Parameters
    ----------
    plan : Plan
    tolerances : Tolerances
    weakest, flawless : ndarray of int64, shape (designs,)
        Level of the faintest defect, and the highest of what is flawless.

    Returns
    -------
    low, high : ndarray of int64, shape (designs,)
        Thresholds from low to high - 1; high <= low: none.
    """
    shape = [len(a.values) for a in plan.axes]
    low, high = flawless.reshape(shape), weakest.reshape(shape)
    for number, a in enumerate(plan.axes):
        if a.key not in tolerances.halves:
            continue
        reach = _reach(a, tolerances.halves[a.key])
        low = _over(low, number, reach, np.maximum)
        high = _over(high, number, reach, np.minimum)
    return low.ravel(), high.ravel()


def _reach(a: Axis, half: float | None) -> NDArray[np.bool_]:
    """Return which values are neighbours of which, shape (values, values)."""
    values = np.array(a.values, np.float64)
    if half is None:
        rank = np.argsort(np.argsort(values))
        near: NDArray[np.bool_] = np.abs(rank[:, None] - rank) <= 1
        return near
    within: NDArray[np.bool_] = np.abs(values[:, None] - values) <= half * (1 + 1e-6) + _SAME
    return within


def _over(values: Ints, number: int, reach: NDArray[np.bool_], worst: Any) -> Ints:
    moved = np.moveaxis(values, number, 0)
    found = np.stack([worst.reduce(moved[own], axis=0) for own in reach])
    return np.moveaxis(found, 0, number)
