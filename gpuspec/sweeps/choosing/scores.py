"""Some designs of a sweep at all thresholds, read from its folder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute
from numpy.typing import NDArray

from gpuspec.light.constants import LEVELS
from gpuspec.sweeps.choosing.front import Points, curves, p1_bounds
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.rule import Rule


def rows_of(run: RunFolder, designs: Iterable[int], columns: Sequence[str]) -> pa.Table:
    """Return the rows of some designs, by their number; without those that are not there yet.

    Parameters
    ----------
    run : RunFolder
    designs : iterable of int
        Their numbers.
    columns : sequence of str
        Read beside ``design``.
    """
    wanted = np.unique(np.fromiter(designs, np.int64))
    owner = wanted // run.rows_per_file
    missing = set(run.missing())
    tables = []
    for file in np.unique(owner).tolist():
        if file not in missing:
            table = run.read_file(file, ["design", *(c for c in columns if c != "design")])
            tables.append(table.filter(np.isin(table["design"].to_numpy(), wanted[owner == file])))
    return pa.concat_tables(tables)


@dataclass(frozen=True)
class Scores:
    """Designs at all thresholds; where P1 is estimated, the estimate within its bounds.

    Attributes
    ----------
    design : ndarray of int64, shape (D,)
    p1, p2, hits : ndarray, shape (D, 256)
    exact : ndarray of bool, shape (D, 256)
    """

    design: NDArray[np.int64]
    p1: NDArray[np.float64]
    p2: NDArray[np.float64]
    hits: NDArray[np.int64]
    exact: NDArray[np.bool_]

    @classmethod
    def of(cls, table: pa.Table) -> Scores:
        """Read the valid designs of a table with `COLUMNS`."""
        table = table.filter(pa.compute.is_valid(table["exact"]))
        if not len(table):
            none = np.empty((0, LEVELS))
            return cls(np.empty(0, np.int64), none, none, none.astype(np.int64), none == 0)
        low, high = p1_bounds(table)
        return cls(
            table["design"].to_numpy(), np.clip(curves(table, "p1"), low, high),
            curves(table, "p2"), curves(table, "hits").astype(np.int64), low == high,
        )  # fmt: skip

    def at(self, level: NDArray[np.intp] | int) -> Points:
        """Return the designs at one threshold each, or at the same."""
        level = np.broadcast_to(level, self.design.shape)
        place = np.arange(len(level)), level
        return Points(
            self.design, level.astype(np.int64), self.p1[place], self.p2[place],
            self.hits[place], self.exact[place],
        )  # fmt: skip

    def best(self, rule: Rule, defects: int) -> Points:
        """Return each design at its own best threshold.

        Parameters
        ----------
        rule : Rule
        defects : int
            Most defects that can be hit.
        """
        if not len(self.design):
            return Points.empty()
        return self.at(rule.thresholds(self.p1, self.p2, self.hits, defects))
