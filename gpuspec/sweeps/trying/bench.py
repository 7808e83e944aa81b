"""From designs to rows of the table: the one place where a sweep's work is done."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from threading import Event

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
        self.parts = Parts(backend, plan.parts, plan.samples, plan.seeds)
        # Bonferroni: all bounds of all designs at all thresholds hold together.
        self._risk = (1 - CONFIDENCE) / (2 * LEVELS * plan.designs)

    @property
    def stopped(self) -> Event:
        """See :class:`Parts`."""
        return self.parts.stopped

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
        reasons: dict[int, str] = {}
        tried: list[Tried] = []
        for _, group in groupby(designs, self.plan.geometry_of):
            stations: dict[int, Station] = {}
            base: Station | None = None
            for design in group:
                try:
                    base = stations[design] = self.plan.station_of(design, base)
                except StationError as error:
                    reasons[design] = str(error)
            if stations:
                try:
                    tried.append(self._tried(stations, sampled=sampled))
                except StationError as error:
                    reasons.update(dict.fromkeys(stations, str(error)))
        tables = [
            self._table([part for _, part in alike])
            for _, alike in groupby(((one.curves.view, one) for one in tried), lambda pair: pair[0])
        ]
        if reasons:
            tables.append(invalid_rows(self.plan, reasons))
        return pa.concat_tables(tables).sort_by("design")

    def _tried(self, stations: dict[int, Station], *, sampled: bool) -> Tried:
        levels, parts = self.parts.levels(list(stations.values()), sampled=sampled)
        curves = Curves.of(levels, parts, self._risk, self.plan.seeds)
        if not curves.seen.any():
            raise StationError("no pixel of a defect's zone is in view.")
        notes = [notes_of(station, parts) for station in stations.values()]
        noise = parts[0].noise
        noises = [noise.of(s) if noise else math.nan for s in stations.values()]
        return Tried(stations, curves, notes, noises)

    def _table(self, tried: Sequence[Tried]) -> pa.Table:
        """Return the rows of designs that see the same pixels of the same zones."""
        stations = {design: s for one in tried for design, s in one.stations.items()}
        curves = Curves.together([one.curves for one in tried])
        notes = [note for one in tried for note in one.notes]
        noises = [one for of in tried for one in of.noise_dn]
        return rows(
            self.plan, list(stations), list(stations.values()), curves, self.backend.info, notes,
            noises,
        )  # fmt: skip


@dataclass(frozen=True)
class Tried:
    """Designs of one geometry, tried.

    Attributes
    ----------
    stations : dict of int to Station
        By number.
    curves : Curves
    notes : list of str or None
        What to know of each.
    noise_dn : list of float
        Of the flawless surface of each.
    """

    stations: dict[int, Station]
    curves: Curves
    notes: list[str | None]
    noise_dn: list[float]


def notes_of(station: Station, parts: Sequence[TracedPart]) -> str | None:
    """Return what to know of a tried design, a line each; None: nothing.

    Parameters
    ----------
    station : Station
    parts : sequence of TracedPart
        At least one.
    """
    return "\n".join([*parts[0].notes, *of_design(station)]) or None
