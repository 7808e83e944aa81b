"""Maps of a sweep: the best score for each pair of values of two keys."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from gpuspec.sweeps.axes import Axis
from gpuspec.sweeps.choosing.scores import Scores
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.rule import Rule


@dataclass(frozen=True)
class Map:
    """The best designs over all other keys.

    Attributes
    ----------
    down, across : Axis
        The two keys.
    criteria : ndarray of float64, shape (values down, values across, 6)
        Of the best design of each pair, see :meth:`Rule.criteria`; -inf where there is none.
    """

    down: Axis
    across: Axis
    criteria: NDArray[np.float64]

    def kept(self, rule: Rule, defects: int) -> NDArray[np.bool_]:
        """Return where the best design has all that the rule asks for.

        Parameters
        ----------
        rule : Rule
        defects : int
            Most defects that can be hit.

        Returns
        -------
        ndarray of bool, shape (values down, values across)
        """
        asked = [rule.required(defects), rule.p2_floor, rule.p1_floor]
        kept: NDArray[np.bool_] = np.all(self.criteria[..., :3] >= np.array(asked), axis=-1)
        return kept

    @property
    def goal(self) -> NDArray[np.float64]:
        """What is to be highest, of the best design of each pair; NaN where there is none."""
        goal = self.criteria[..., 3]
        return np.where(np.isfinite(goal), goal, np.nan)


class Maps:
    """Maps for every pair of keys with more than one value, drawn up file by file.

    Parameters
    ----------
    plan : Plan
    rule : Rule
    defects : int
        Most defects that can be hit.
    """

    def __init__(self, plan: Plan, rule: Rule, defects: int) -> None:
        self._plan, self._rule, self._defects = plan, rule, defects
        varied = [n for n, a in enumerate(plan.axes) if len(a.values) > 1]
        sizes = [len(a.values) for a in plan.axes]
        self._maps = {
            pair: np.full((math.prod(sizes[n] for n in pair), 6), -np.inf)
            for pair in combinations(varied, 2)
        }

    def add(self, table: pa.Table) -> None:
        """Add a file of the table."""
        points = Scores.of(table).best(self._rule, self._defects)
        sizes = [len(a.values) for a in self._plan.axes]
        places = np.unravel_index(points.design, sizes)
        criteria = self._rule.criteria(points.p1, points.p2, points.hits, self._defects)
        found = np.stack(np.broadcast_arrays(*criteria), axis=-1).astype(np.float64)
        order = np.lexsort([-c for c in reversed(criteria)])
        for (one, other), best in self._maps.items():
            cell = places[one] * sizes[other] + places[other]
            cells, first = np.unique(cell[order], return_index=True)
            new, old = found[order[first]], best[cells]
            # Higher in the first criterion in which they differ.
            differs = (new != old).argmax(axis=1)[:, None]
            higher = np.take_along_axis(new > old, differs, axis=1)
            best[cells] = np.where(higher, new, old)

    def of(self, keys: list[str]) -> list[Map]:
        """Return the maps of each pair of some keys."""
        axes = self._plan.axes
        found = []
        for (one, other), best in self._maps.items():
            down, across = axes[one], axes[other]
            if down.key in keys and across.key in keys:
                shape = len(down.values), len(across.values), 6
                found.append(Map(down, across, best.reshape(shape)))
        return found
