"""Which parts of which stations are tried, each by its number."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gpuspec.errors import StationError
from gpuspec.station.station import Station
from gpuspec.sweeps.axes import axis, varied
from gpuspec.sweeps.cluster.remote import message
from gpuspec.sweeps.plan import Plan, one_level

PARTS = 64
"""Random parts, where nothing else is said."""

PARTS_MAX = 100_000
SAMPLES = 2048
"""Pixels of the flawless surface that are drawn of each part but the first."""

_ROWS_MAX = 10_000_000


@dataclass(frozen=True)
class TrialPlan:
    """Random parts of one station, or of each of a grid of stations.

    Attributes
    ----------
    plan : Plan
        Of a sweep: its designs are the stations, and its parts are tried.
    """

    plan: Plan

    def __repr__(self) -> str:
        return f"TrialPlan({self.plan!r})"

    @classmethod
    def of(
        cls, station: Station, parts: int = PARTS, vary: Mapping[str, Any] | None = None
    ) -> TrialPlan:
        """Plan trials.

        Parameters
        ----------
        station : Station
        parts : int
            Random parts of each station.
        vary : mapping of str to str, number or list, optional
            Keys of the station and what each takes, as of a sweep; None: one station.

        Raises
        ------
        StationError
            If it takes whole images to inspect, a key or range is wrong, or the number of parts.

        Examples
        --------
        >>> from gpuspec.detectability.plan import TrialPlan
        >>> TrialPlan.of(gpuspec.example("trim"), 10, {"sensor.exposure": [2, 4]}).designs
        20
        """
        if not isinstance(parts, int) or isinstance(parts, bool) or not 1 <= parts <= PARTS_MAX:
            raise StationError(f"{parts!r} parts are asked for; 1 to {PARTS_MAX:,} can be tried.")
        one_level(station)
        base = station.replace(sweep=None)
        axes = [axis(base, key, given) for key, given in varied(vary or {}).items()]
        axes.sort(key=lambda a: not a.retraces)
        found = cls(Plan(base, tuple(axes), parts, SAMPLES))
        if found.designs > _ROWS_MAX:
            raise StationError(
                f"{found.designs:,} parts are more than could be tried; take fewer parts, or vary "
                f"fewer values."
            )
        return found

    @property
    def parts(self) -> int:
        """Random parts of each station."""
        return self.plan.parts

    @property
    def designs(self) -> int:
        """Rows of the table: parts of all stations, those of one station neighbours."""
        return self.plan.designs * self.plan.parts

    def identity(self) -> dict[str, Any]:
        """Return what makes these trials these, as JSON holds it: of one station, of any length."""
        found = self.plan.identity()
        return found if self.plan.axes else {**found, "parts": 1}

    def message(self) -> str:
        """Return it as text, from which another machine makes the very same trials."""
        return message(self.plan)

    @classmethod
    def from_message(cls, text: str) -> TrialPlan:
        """Return the plan of a :meth:`message`."""
        sent = json.loads(text)
        station = Station.from_dict(sent["tables"], sent["file"], sent["folder"])
        axes = tuple(axis(station, key, values) for key, values in sent["vary"].items())
        return cls(Plan(station, axes, sent["parts"], sent["samples"]))
