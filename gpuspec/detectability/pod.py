"""From a station, or a table of trials, to its probability of detection."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from gpuspec.detectability.bench import TRIALS, TrialBench
from gpuspec.detectability.false_calls import FalseCalls
from gpuspec.detectability.fitted import Fitted, fitted_hits, fitted_signals
from gpuspec.detectability.folder import TrialsFolder
from gpuspec.detectability.mapped import SizeMap
from gpuspec.detectability.measured import read_trials
from gpuspec.detectability.outcome import Pod, Tried
from gpuspec.detectability.plan import PARTS, TrialPlan
from gpuspec.detectability.sizes import SIZES, Size, both, chosen
from gpuspec.errors import StationError, TrialsError
from gpuspec.files import folder_of
from gpuspec.light.backend import Backend, DeviceInfo
from gpuspec.light.devices import open_backend
from gpuspec.station.station import Station
from gpuspec.sweeps.crew import Alone, Crew, Task

SATURATED = 0.9
"""Share of the way from the flawless level to full scale from which on a signal is saturated: in
some images every pixel is dark, so that none comes to full scale."""

Floats = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
"""Told what is being done, how many parts are done, and of how many."""


def pod(
    station: Station | str | Path | None = None,
    *,
    trials: str | Path | Sequence[str | Path] = (),
    parts: int = PARTS,
    size: str | None = None,
    over: str | None = None,
    kinds: Sequence[str] = (),
    model: str = "auto",
    vary: Mapping[str, Any] | None = None,
    false_calls: float | None = None,
    threshold: float | None = None,
    noise: float | None = None,
    saturation: float | None = None,
    folder: str | Path | None = None,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
    crew: Crew | None = None,
) -> Pod:
    """Find the probability of detection: of a station by random parts, or of trials in files.

    Every defect of the station's populations is a trial on every part; it is a hit if a blob of the
    station's threshold and least area has a pixel in its zone. An automatic threshold is taken of
    the first part and held.

    Parameters
    ----------
    station : Station, str or Path, optional
        With random populations; None: of files alone.
    trials : str, Path or sequence of them
        CSV files with the columns x, sizes, and y, hits as 1 and misses as 0, or signals.
    parts : int
        Random parts of the station.
    size : str, optional
        slope (mrad), depth (um), diameter or width (mm); None: slope.
    over : str, optional
        A second size: a map of the a90 of the first at each of the second, of the defects that
        have both.
    kinds : sequence of str
        Of the defects that are trials: dent, bump, scratch; none given: all that have the size.
    model : str
        auto, by the least AIC, or logit, probit, logit-log or probit-log.
    vary : mapping of str to str, number or list, optional
        Keys of the station and what each takes, as of a sweep: all these stations are tried on the
        same parts, and what is returned is of the one with the smallest a90/95.
    false_calls : float, optional
        Of `vary`: at most so many per part, by their upper bound; None: any number.
    threshold, noise, saturation : float, optional
        Of the signals in files.
    folder : str or Path, optional
        Keeps the trials, so that a run that was stopped, or one on more parts, goes on.
    backend, device
        As for :func:`gpuspec.simulate`.
    progress : callable, optional
        Told what is being done, how many parts are done, and of how many.
    crew : Crew, optional
        Others to do the work; then `backend` and `device` are not used.

    Returns
    -------
    Pod

    Raises
    ------
    StationError
        If the station has no random defects of different sizes, or takes whole images to inspect.
    TrialsError
        If trials cannot be read, or tell of no curve.
    OutputError
        If the folder holds other trials, or cannot be written.
    BackendError
        If the device is absent or fails.

    Examples
    --------
    >>> import gpuspec as gs
    >>> station = gs.example("trim").replace(camera__sampling_mm=0.2)
    >>> found = gs.pod(station, parts=4, kinds=["dent"])
    >>> found.simulated.size.shape, found.false_calls.per_part
    ((64,), 0.0)
    """
    paths = [trials] if isinstance(trials, (str, Path)) else list(trials)
    if station is None and not paths:
        raise TrialsError("there is neither a station nor a file of trials; give one of them.")
    if size is not None and size not in SIZES:
        raise StationError(f"{size!r} is not known here; choose one of {', '.join(SIZES)}.")
    if station is None and over is not None:
        raise TrialsError("a map needs two sizes, and files have one; name a station, too.")
    first = SIZES[size or "slope"] if size or station is not None else None
    unit = first.unit if first else ""
    measured = tuple(_measured(p, unit, model, threshold, noise, saturation) for p in paths)
    if station is None:
        return Pod(first.name if first else "x", unit, None, None, measured)
    plan = TrialPlan.of(Station.of(station), parts, vary)
    assert first is not None
    second = None
    if over is None:
        _, wanted = chosen(plan.plan.station, first.name, kinds)
    else:
        _, second, wanted = both(plan.plan.station, first.name, over, kinds)
    with ExitStack() as stack:
        kept = None
        if folder is not None:
            kept = stack.enter_context(TrialsFolder.writing(folder_of(folder), plan))
        workers = crew or Alone(TrialBench(plan, open_backend(backend, device)))
        table = tried(plan, workers, kept, progress or (lambda *_: None))
    if plan.plan.axes:
        found = smallest(plan, table, first, wanted, model, measured, false_calls)
    else:
        found = told(plan.plan.station, table, first, wanted, model, measured)
    return found if second is None else _mapped(found, first, second, model)


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
        See :func:`pod`.

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


def smallest(
    plan: TrialPlan, table: pa.Table, size: Size, kinds: Sequence[str], model: str = "auto",
    measured: tuple[Fitted, ...] = (), false_calls: float | None = None,
) -> Pod:  # fmt: skip
    """Return what the parts of the station with the smallest a90/95 tell.

    Parameters
    ----------
    plan : TrialPlan
        Of several stations.
    table, size, kinds, model, measured
        As of :func:`told`.
    false_calls : float, optional
        See :func:`pod`.

    Raises
    ------
    TrialsError
        If no station has an a90/95 that applies, with so few false calls: the first reason.
    """
    stations: list[Tried] = []
    best: tuple[float, Pod] | None = None
    alike = 0
    for one in range(plan.plan.designs):
        values = plan.plan.values(one)
        try:
            station = plan.plan.station_of(one)
            found = told(
                station, table.slice(one * plan.parts, plan.parts), size, kinds, model, measured
            )
        except (StationError, TrialsError) as error:
            none = dict.fromkeys(("a50", "a90", "a90_95"))
            stations.append(Tried(values, none, reason=str(error)))
            continue
        assert found.simulated is not None and found.false_calls is not None
        calls, sizes = found.false_calls, found.simulated.sizes
        rank, applies = found.simulated.rank, found.simulated.verdict.applies
        reason = ""
        if rank is None:
            reason = " ".join(found.simulated.verdict.said) or "there is no a90/95."
        elif false_calls is not None and calls.bound > false_calls:
            reason = f"up to {calls.bound:.3g} false calls per part, more than {false_calls:g}."
        elif best is None or rank < best[0]:
            best = rank, found
            alike = 1
        elif rank == best[0]:
            alike += 1
        stations.append(Tried(values, sizes, applies, calls.per_part, calls.bound, reason))
    if best is None:
        raise TrialsError(
            f"none of {len(stations):,} stations has an a90/95 to choose by, e.g.: "
            f"{stations[0].reason}"
        )
    notes = best[1].notes
    if alike > 1:
        notes += (
            f"{alike} stations have the same a90/95 or find every trial, and the first of them is "
            f"shown; smaller defects would tell them apart.",
        )
    return replace(best[1], stations=tuple(stations), notes=notes)


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
        See :func:`pod`.
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
    flawless, full = first["flawless_dn"], first["full_dn"]
    try:
        signals = fitted_signals(
            "signals", own, some["signal_dn"].to_numpy(), size.unit,
            first["threshold_dn"] - flawless, first["noise_dn"], SATURATED * (full - flawless),
        )  # fmt: skip
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


def _mapped(found: Pod, first: Size, second: Size, model: str) -> Pod:
    """Add the map to what trials told, or why there is none."""
    assert found.trials is not None
    across, depth = found.trials["size_mm"].to_numpy(), found.trials["depth_um"].to_numpy()
    hit = np.array(found.trials["hit"].to_pylist(), bool)
    a, b = first.of(across, depth), second.of(across, depth)
    try:
        return replace(found, map=SizeMap.of(first, second, a, b, hit, model))
    except TrialsError as error:
        return replace(found, notes=(*found.notes, f"map: {error}"))


def _measured(
    path: str | Path, unit: str, model: str, threshold: float | None, noise: float | None,
    saturation: float | None,
) -> Fitted:  # fmt: skip
    x, y = read_trials(path)
    name = Path(path).name
    if np.isin(y, (0.0, 1.0)).all():
        return fitted_hits(name, x, y == 1, unit, model)
    if threshold is None:
        raise TrialsError(
            f"{path}: y is not 0 and 1 alone, so these are signals; say above which one a defect "
            f"is found, with --threshold."
        )
    ends = (-np.inf if noise is None else noise, np.inf if saturation is None else saturation)
    return fitted_signals(name, x, y, unit, threshold, *ends)
