"""The largest a90/95 within a station's tolerances, its threshold held."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pyarrow as pa

from gpuspec.detectability.bench import TrialBench
from gpuspec.detectability.outcome import Pod, Worst
from gpuspec.detectability.plan import TrialPlan
from gpuspec.detectability.telling import Progress, tried
from gpuspec.errors import StationError, TrialsError
from gpuspec.light.backend import Backend
from gpuspec.station.corners import corners, stated
from gpuspec.station.station import Station
from gpuspec.sweeps.crew import Alone

HELD = 3
"""Stations at most, those with the smallest a90/95, that are tried within the tolerances."""

Tell = Callable[[Station, pa.Table], Pod]
"""Says what the parts of one station tell."""


def tolerances_of(station: Station) -> dict[str, float]:
    """Return the tolerances that a station states, by key.

    Raises
    ------
    StationError
        If it states none, or one of a key that is not set.
    """
    halves = stated(station)
    if not halves:
        raise StationError(
            f"{station.file} states no tolerances; say in a table [tolerance] by how much which "
            f"keys may be off."
        )
    return halves


def with_worst(found: Pod, backend: Backend, tell: Tell, progress: Progress | None = None) -> Pod:
    """Try a station with what may be off, on the same parts and with its threshold held.

    Parameters
    ----------
    found : Pod
        Of the station, where nothing is off.
    backend : Backend
    tell : callable
    progress : callable, optional
        Told how many of these designs are done, and of how many.

    Returns
    -------
    Pod
        With the worst.

    Raises
    ------
    StationError
        If it states no tolerances.
    """
    assert found.station is not None and found.simulated is not None
    station = found.station.replace(segmentation__threshold=found.threshold_dn)
    some = corners(station, tolerances_of(station))
    own = found.simulated.rank
    every = [Worst({}, math.inf if own is None else own, len(some))]
    for number, off in enumerate(some):
        if progress:
            progress("designs within the tolerances", number, len(some))
        rank, reason = None, ""
        try:
            one = station.replace(**off)
            plan = TrialPlan.of(one, found.parts)
            table = tried(plan, Alone(TrialBench(plan, backend)), None, lambda *_: None)
            told = tell(one, table).simulated
            assert told is not None
            rank, reason = told.rank, " ".join(told.verdict.said)
        except (StationError, TrialsError) as error:
            reason = str(error)
        every.append(Worst(off, math.inf if rank is None else rank, len(some), reason))
    return replace(found, worst=max(every, key=lambda one: one.rank))
