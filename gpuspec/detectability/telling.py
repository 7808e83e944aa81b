"""From a plan of trials to rows of parts, and from these to what they tell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa

from gpuspec.detectability.bench import TRIALS
from gpuspec.detectability.false_calls import FalseCalls
from gpuspec.detectability.fitted import Fitted, fitted_hits, fitted_signals
from gpuspec.detectability.folder import TrialsFolder
from gpuspec.detectability.outcome import Pod
from gpuspec.detectability.plan import TrialPlan
from gpuspec.detectability.sizes import SIZES, Size
from gpuspec.errors import StationError, TrialsError
from gpuspec.light.backend import DeviceInfo
from gpuspec.station.station import Station
from gpuspec.sweeps.crew import Crew, Task

SATURATED = 0.9
"""Share of the way from the flawless level to full scale from which on a signal is saturated: in
some images every pixel is dark, so that none comes to full scale."""

Progress = Callable[[str, int, int], None]
"""Told what is being done, how many parts are done, and of how many."""


def tried(
    plan: TrialPlan, crew: Crew, kept: TrialsFolder | None, tell: Progress
) -> pa.Table:  # fmt: skip
    """Try all parts that are not kept yet.

    Parameters
    ----------
    plan : TrialPlan
    crew : Crew
    kept : TrialsFolder or None
        Open to write; None: nothing is kept.
    tell : callable
        See :func:`gpuspec.pod`.

    Returns
    -------
    pyarrow.Table
        A row for each part.
    """
    size = TrialsFolder.rows_per_file
    files: Iterable[int] = range(-(-plan.designs // size))
    found: list[pa.Table] = []
    done = 0
    if kept is not None:
        kept.repair()
        files, done = kept.missing(), kept.there()
    tasks = (
        Task(n, tuple(range(n * size, min((n + 1) * size, plan.designs))), sampled=True)
        for n in files
    )
    tell("parts", done, plan.designs)
    for task, table in crew.done(tasks):
        if kept is None:
            found.append(table)
        else:
            kept.write(task.file, table)
        done += len(table)
        tell("parts", done, plan.designs)
    if kept is None:
        return pa.concat_tables(found).sort_by("design")
    kept.seal()
    return pa.concat_tables(list(kept.batches()))


def told(
    station: Station, table: pa.Table, size: Size, kinds: Sequence[str], model: str = "auto",
    measured: tuple[Fitted, ...] = (),
) -> Pod:  # fmt: skip
    """Return what the parts of one station tell.

    Parameters
    ----------
    station : Station
    table : pyarrow.Table
        Its rows.
    size : Size
    kinds : sequence of str
        Of the defects that are trials.
    model : str
        See :func:`gpuspec.pod`.
    measured : tuple of Fitted
        To stand beside.

    Raises
    ------
    StationError
        If a part was none, or no defect was in view.
    TrialsError
        If the trials tell of no curve.
    """
    reasons = table["reason"].drop_null()
    if len(reasons):
        raise StationError(f"{len(reasons)} of {len(table)} parts are none, e.g.: {reasons[0]}")
    every = trials_of(table)
    some = every.filter(pa.array(np.isin(every["kind"].to_pylist(), kinds)))
    if not len(some):
        raise StationError(
            f"{station.file}: no defect is in the image; check camera.columns, camera.rows."
        )
    own = size.of(some["size_mm"].to_numpy(), some["depth_um"].to_numpy())
    first = table.slice(0, 1).to_pylist()[0]
    hits = fitted_hits("hits", own, np.array(some["hit"].to_pylist(), bool), size.unit, model)
    signals, notes = None, []
    if first["caution"]:  # of that no trial tells anything
        hits = replace(hits, verdict=replace(hits.verdict, said=(first["caution"],)))
    else:
        try:
            signals = _signals(own, some, size, first)
        except TrialsError as error:
            notes.append(f"signals: {error}")
    near, false, drawn, rest = (
        table[name].to_numpy() for name in ("near_false", "drawn_false", "drawn", "rest_px")
    )
    calls = FalseCalls.of(near, false, drawn, rest, all(table["clear"].to_pylist()))
    info = DeviceInfo(*(first[name] for name in ("backend", "device", "driver", "version")))
    return Pod(
        size.name, size.unit, hits, signals, measured, calls, some, len(table),
        first["threshold_dn"], station, info, notes=tuple(notes),
    )  # fmt: skip


def _signals(own: Any, trials: pa.Table, size: Size, first: dict[str, Any]) -> Fitted:
    """Fit the signals of some trials over their sizes, by what is held of the first part."""
    flawless, full = first["flawless_dn"], first["full_dn"]
    return fitted_signals(
        "signals", own, trials["signal_dn"].to_numpy(), size.unit,
        first["threshold_dn"] - flawless, first["noise_dn"], SATURATED * (full - flawless),
    )  # fmt: skip


def trials_of(table: pa.Table) -> pa.Table:
    """Return a row for each trial, with the number of its part and its slope.

    Parameters
    ----------
    table : pyarrow.Table
        A row for each part.
    """
    lists = {name: table[name].combine_chunks() for name in TRIALS}
    count = np.diff(lists["kind"].offsets.to_numpy())
    found: dict[str, Any] = {"part": np.repeat(np.arange(len(table)), count)}
    found |= {name: values.flatten() for name, values in lists.items()}
    slope = SIZES["slope"].of(found["size_mm"].to_numpy(), found["depth_um"].to_numpy())
    return pa.table({**found, "slope_mrad": slope})
