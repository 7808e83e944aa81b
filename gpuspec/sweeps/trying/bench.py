"""From designs to rows of the table: the one place where a sweep's work is done."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import pyarrow as pa

from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.constants import LEVELS
from gpuspec.simulation.cautions.station import of_design
from gpuspec.station.station import Station
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.curves import Curves
from gpuspec.sweeps.trying.parts import Parts, TracedPart
from gpuspec.sweeps.trying.rows import invalid_rows, rows
from gpuspec.sweeps.trying.screening import CONFIDENCE


class Bench:
    """A device on which designs of one plan are tried.

    Parameters
    ----------
    plan : Plan
    backend : Backend
    """

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.plan = plan
        self.backend = backend
        self.parts = Parts(backend, plan.parts, plan.samples)
        # Bonferroni: all bounds of all designs at all thresholds hold together.
        self._risk = (1 - CONFIDENCE) / (2 * LEVELS * plan.designs)

    def rows(self, designs: Sequence[int], *, sampled: bool) -> pa.Table:
        """Try some designs.

        Parameters
        ----------
        designs : sequence of int
            In rising order, so that each geometry is traced once.
        sampled : bool
            Whether pixels outside the zones may be sampled, if the plan says so.

        Returns
        -------
        pyarrow.Table
            A row each, in their order; with a reason where a design is no valid station.

        Raises
        ------
        BackendError
            If the device fails.
        """
        tables = []
        for _, group in groupby(designs, self.plan.geometry_of):
            stations: dict[int, Station] = {}
            reasons: dict[int, str] = {}
            base: Station | None = None
            for design in group:
                try:
                    base = stations[design] = self.plan.station_of(design, base)
                except StationError as error:
                    reasons[design] = str(error)
            if stations:
                try:
                    tables.append(self._tried(stations, sampled=sampled))
                except StationError as error:
                    reasons.update(dict.fromkeys(stations, str(error)))
            if reasons:
                tables.append(invalid_rows(self.plan, reasons))
        return pa.concat_tables(tables).sort_by("design")

    def _tried(self, stations: dict[int, Station], *, sampled: bool) -> pa.Table:
        tried = list(stations.values())
        levels, parts = self.parts.levels(tried, sampled=sampled)
        curves = Curves.of(levels, parts, self._risk)
        if not curves.seen.any():
            raise StationError("no pixel of a defect's zone is in view.")
        notes = [notes_of(station, parts) for station in tried]
        return rows(self.plan, list(stations), tried, curves, self.backend.info, notes)


def notes_of(station: Station, parts: Sequence[TracedPart]) -> str | None:
    """Return what to know of a tried design, a line each; None: nothing.

    Parameters
    ----------
    station : Station
    parts : sequence of TracedPart
        At least one.
    """
    return "\n".join([*parts[0].notes, *of_design(station)]) or None
