"""From a station, or a table of trials, to its probability of detection."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gpuspec.detectability.bench import TrialBench
from gpuspec.detectability.fitted import Fitted, fitted_hits, fitted_signals
from gpuspec.detectability.folder import TrialsFolder
from gpuspec.detectability.mapped import SizeMap
from gpuspec.detectability.measured import read_trials
from gpuspec.detectability.outcome import Pod, Tried
from gpuspec.detectability.plan import PARTS, TrialPlan
from gpuspec.detectability.sizes import SIZES, Size, both, chosen
from gpuspec.detectability.telling import Progress, told, tried
from gpuspec.detectability.worst import HELD, Tell, tolerances_of, with_worst
from gpuspec.errors import StationError, TrialsError
from gpuspec.files import folder_of
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.station.station import Station
from gpuspec.sweeps.crew import Alone, Crew


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
    tolerance: bool = False,
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
    tolerance : bool
        Whether the largest a90/95 within the station's ``[tolerance]`` is found, the threshold
        held. Of `vary` the few stations with the smallest a90/95 are so tried, and the one of the
        smallest worst is returned.
    threshold, noise, saturation : float, optional
        Of the signals in files.
    folder : str or Path, optional
        Keeps the trials, so that a run that was stopped, or one on more parts, goes on.
    backend, device
        As for :func:`gpuspec.simulate`.
    progress : callable, optional
        Told what is being done, how many parts are done, and of how many.
    crew : Crew, optional
        Others to do the work; then `backend` and `device` are not used, but for tolerances.

    Returns
    -------
    Pod

    Raises
    ------
    StationError
        If the station has no random defects of different sizes, takes whole images to inspect, or
        states no tolerances where they are asked for.
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
    if tolerance:
        tolerances_of(plan.plan.station)
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
        engine = open_backend(backend, device) if tolerance or crew is None else None
        if crew is None:
            assert engine is not None
            crew = Alone(TrialBench(plan, engine))
        table = tried(plan, crew, kept, progress or (lambda *_: None))

    def tell(one: Station, rows: pa.Table) -> Pod:
        return told(one, rows, first, wanted, model, measured)

    if plan.plan.axes:
        few = smallest(plan, table, tell, false_calls, HELD if tolerance else 1)
    else:
        few = [tell(plan.plan.station, table)]
    if engine and tolerance:
        few = [with_worst(one, engine, tell, progress) for one in few]
        few.sort(key=lambda one: one.worst.rank if one.worst else math.inf)
    return few[0] if second is None else _mapped(few[0], first, second, model)


def smallest(
    plan: TrialPlan, table: pa.Table, tell: Tell, false_calls: float | None = None, count: int = 1
) -> list[Pod]:
    """Return what the parts of the stations with the smallest a90/95 tell, the smallest first.

    Parameters
    ----------
    plan : TrialPlan
        Of several stations.
    table : pyarrow.Table
        A row for each part of each.
    tell : callable
    false_calls : float, optional
        See :func:`pod`.
    count : int
        How many stations, at most.

    Raises
    ------
    TrialsError
        If no station has an a90/95 that applies, with so few false calls: the first reason.
    """
    stations: list[Tried] = []
    best: list[tuple[float, int, Pod]] = []
    ranks: list[float] = []
    for one in range(plan.plan.designs):
        values = plan.plan.values(one)
        try:
            found = tell(plan.plan.station_of(one), table.slice(one * plan.parts, plan.parts))
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
        else:
            ranks.append(rank)
            best = sorted([*best, (rank, one, found)], key=lambda each: each[:2])[:count]
        stations.append(Tried(values, sizes, applies, calls.per_part, calls.bound, reason))
    if not best:
        raise TrialsError(
            f"none of {len(stations):,} stations has an a90/95 to choose by, e.g.: "
            f"{stations[0].reason}"
        )
    alike = ranks.count(best[0][0])
    said = (
        f"{alike} stations have the same a90/95 or find every trial, and one of them is shown; "
        f"smaller defects would tell them apart."
    )
    return [
        replace(
            found,
            stations=tuple(stations),
            notes=(*found.notes, *[said] * (alike > 1 and rank == best[0][0])),
        )
        for rank, _, found in best
    ]


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
