"""Continuous search for the best station: designs between bounds, not those of a grid."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

from gpuspec.errors import OutputError, StationError
from gpuspec.files import Outputs, folder_of, write_new
from gpuspec.light.backend import Backend, DeviceInfo
from gpuspec.light.devices import open_backend
from gpuspec.light.levels import thresholds
from gpuspec.shown import html_page, object_of
from gpuspec.station.station import Station
from gpuspec.sweeps.aim import Aim
from gpuspec.sweeps.aim import best_of as best_by
from gpuspec.sweeps.axes import VARY_BETWEEN, bounds, varied
from gpuspec.sweeps.choosing.measured import Measured, counts_of_kinds
from gpuspec.sweeps.keeping.folder import differences
from gpuspec.sweeps.keeping.writing import taken_lock, writes_to
from gpuspec.sweeps.measures import check_kinds
from gpuspec.sweeps.plan import Plan, scored_at
from gpuspec.sweeps.rule import Rule
from gpuspec.sweeps.searching.search import Search, Trial, Values, best_of, directions
from gpuspec.sweeps.trying.bench import notes_of
from gpuspec.sweeps.trying.confirm import Confirmed, confirm_all
from gpuspec.sweeps.trying.curves import Curves
from gpuspec.sweeps.trying.parts import Parts
from gpuspec.sweeps.trying.rows import rows

IDENTITY, JOURNAL, LOCK = "optimise.json", "optimise.journal", "optimise.lock"
WRITTEN = ("trials.csv", "optimise.png")
Progress = Callable[[Trial, int], None]
"""Told each new trial, and how many there are with it."""


@dataclass(frozen=True)
class Optimum:
    """What a search found.

    Attributes
    ----------
    plan : Plan
        With two values of each key: the bounds.
    rule : Rule or Aim
    trials : tuple of Trial
    best : int
        Which of them is the best by the rule.
    info : DeviceInfo
    confirmed : Confirmed or None
        Of an aim: the best, looked at whole.
    """

    plan: Plan
    rule: Rule | Aim
    trials: tuple[Trial, ...]
    best: int
    info: DeviceInfo
    confirmed: Confirmed | None = None

    def __repr__(self) -> str:
        best = self.trials[self.best]
        values = ", ".join(f"{key} = {shown(value)}" for key, value in best.values.items())
        parts = {
            "best": f"trial {self.best + 1}, {values}, threshold {best.threshold_dn:.6g} DN",
            "score": f"P1 {best.p1:.4f}, P2 {best.p2:.4f}, {best.hits} of {best.defects} defects "
            f"hit",
        }
        return object_of("Optimum", f"{len(self.trials)} trials, rule: {self.rule}", parts)

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook: every trial, and how the best one came about."""
        from gpuspec.sweeps.searching.picture import optimise_picture

        return optimise_picture(self)

    def _repr_html_(self) -> str:
        """Show itself in a notebook: the best trial, and all of them."""
        return html_page(self, self._repr_png_())

    def station(self) -> Station:
        """Return the best station with its threshold, and part 0.

        Raises
        ------
        StationError
            If the threshold is full scale, above which nothing is detected.
        """
        best = self.trials[self.best]
        station = self.plan.station.replace(**best.values)
        if best.threshold_dn >= station.sensor.full_scale_dn:
            raise StationError(
                "the rule chooses a threshold above which nothing is detected; ask for some P2 "
                "with --p2-floor, or for hits with --hit-share."
            )
        return scored_at(station, best.threshold_dn)


def plan_of(
    station: Station | str | Path,
    vary: Mapping[str, Any] | None = None,
    parts: int | None = None,
    seeds: int | None = None,
) -> Plan:
    """Return the bounds of a search as a plan with the two ends of each key.

    Parameters
    ----------
    station, parts, seeds
        As for a sweep, see :meth:`Plan.of`.
    vary : mapping of str to str, number or list, optional
        Keys and what :func:`gpuspec.sweeps.axes.bounds` takes, e.g. ``"1:12"`` or ``[1, 12]``.

    Raises
    ------
    StationError
        Nothing to vary, or a wrong key or interval.

    Examples
    --------
    >>> gpuspec.search_plan(gpuspec.example("trim"), {"tunnel.luminous_mm": "0.5:8"})
    Plan(trim.toml: 2 designs, 2 of tunnel.luminous_mm; 1 part)
    """
    station = Station.of(station)
    vary = varied(vary if vary is not None else station.sweep.vary if station.sweep else {})
    if not vary:
        raise StationError(
            f"{station.file}: nothing to vary; give --vary {VARY_BETWEEN}, or a table "
            f"[sweep.vary] in the station file."
        )
    ends = {key: bounds(station, key, given).values for key, given in vary.items()}
    return Plan.of(station, ends, parts, seeds=seeds)


def outputs(plan: Plan, folder: str | Path, *, force: bool = False) -> Outputs:
    """Return what is drawn of a search, to be checked before it and written after it.

    Parameters
    ----------
    plan : Plan
    folder : str or Path
    force : bool
        Whether files are replaced that are not known to be an earlier search's.
    """
    return Outputs(folder_of(folder), "search", WRITTEN, plan.station.inputs, force=force)


def shown(value: Any) -> str:
    """Return what a key takes as it is printed: a number, or a word."""
    return f"{value:g}" if isinstance(value, (int, float)) and value is not True else str(value)


def tried(plan: Plan, rule: Rule | Aim, parts: Parts, values: Values, *, step: bool) -> Trial:
    """Try one design at all thresholds, exactly.

    Parameters
    ----------
    plan : Plan
    rule : Rule or Aim
        Chooses the threshold.
    parts : Parts
    values : mapping
        By key.
    step : bool
        Whether they are a step from the best trial, and no sample.

    Raises
    ------
    BackendError
        If the device fails.
    """
    try:
        station = plan.station.replace(**values)
        levels, traced = parts.levels([station], sampled=False)
    except StationError as error:
        return Trial(values, step, reason=str(error))
    curves = Curves.of(levels, traced, 1.0, plan.seeds)
    defects = int(curves.seen.sum())
    if not defects:
        return Trial(values, step, reason="no pixel of a defect's zone is in view.")
    p1, p2, hits = curves.p1[0], curves.p2[0], curves.hits.sum(axis=0)[0]
    measures: dict[str, float | None] = {}
    missed: list[float] = []
    if isinstance(rule, Aim):
        at, measures, missed = _aimed(plan, rule, parts, station, curves, traced)
    else:
        at = rule.best(p1, p2, hits, defects)
    threshold = float(thresholds(station.sensor.full_scale_dn)[at])
    return Trial(
        values, step, None, threshold, float(p1[at]), float(p2[at]), int(hits[at]), defects,
        notes_of(station, traced), measures, missed,
    )  # fmt: skip


def _aimed(
    plan: Plan, aim: Aim, parts: Parts, station: Station, curves: Curves, traced: Sequence[Any]
) -> tuple[int, dict[str, float | None], list[float]]:
    """Return the best threshold by an aim, the measures there, and what misses the aim."""
    noise = traced[0].noise
    table = rows(plan, [0], [station], curves, parts.backend.info, [None], [noise.of(station)])
    found = Measured.of(table, aim.names, aim.least_hits)
    assert found is not None
    all_of = {"hits": int(curves.seen.sum()), **counts_of_kinds(table)}
    at = int(best_by(aim.order(found.values, all_of))[0])
    told = {name: float(np.broadcast_to(v, (1, 256))[0, at]) for name, v in found.values.items()}
    point = {name: np.array(value) for name, value in told.items()}
    missed = [float(short) for short in aim.shortfalls(point, all_of)]
    told |= {f"all {name}": float(count) for name, count in all_of.items()}
    return at, {name: v if math.isfinite(v) else None for name, v in told.items()}, missed


def optimise(
    plan: Plan,
    folder: str | Path,
    trials: int,
    rule: Rule | Aim | None = None,
    seed: int = 0,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
    choices: Mapping[str, Sequence[Any]] | None = None,
) -> Optimum:
    """Search until there are so many trials, those that the folder holds included.

    Parameters
    ----------
    plan : Plan
        See :func:`plan_of`.
    folder : str or Path
        Of a new search, or of this one to go on with.
    trials : int
    rule : Rule or Aim, optional
    seed : int
    backend : str or Backend
        A name for :func:`gpuspec.light.devices.open_backend`, or an open backend.
    device : str, optional
        Part of the device's name, or its number.
    progress : callable, optional
    choices : mapping of str to sequence, optional
        Keys that take one of some values, numbers, words or true and false, and these: e.g.
        ``{"tunnel.luminous_mm": [0.5, 1, 2], "tunnel.section": ["ceiling", "arch"]}``.

    Raises
    ------
    OutputError
        If the folder holds another search or anything else, or cannot be written.
    StationError
        If no trial is a valid station, or an aim asks for defects of which there are none.
    BackendError
        If the device is absent or fails.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> plan = gpuspec.search_plan(station, {"tunnel.luminous_mm": "1:4", "sensor.exposure": "2:6"})
    >>> optimum = gpuspec.optimise(plan, "search", trials=4)
    >>> len(optimum.trials), optimum.trials[optimum.best].hits <= 36
    (4, True)
    >>> 1 <= optimum.station().tunnel.luminous_mm <= 4
    True
    """
    rule, folder = rule or Rule(), folder_of(folder)
    engine = open_backend(backend, device)
    makeable = checked_choices(plan, choices or {})
    if isinstance(rule, Aim):
        check_kinds(rule.names, _kinds(plan, makeable))
    told = {"choices": {key: list(v) for key, v in makeable.items()}} if makeable else {}
    identity = {**plan.identity(), "rule": str(rule), "seed": seed, **told}
    search = Search(plan.axes, rule, seed, makeable)
    with _writing(folder, identity, rule) as study:
        for stored in study.get_trials(deepcopy=False):
            search.add(Trial(dict(stored.params), **stored.user_attrs))
        parts = Parts(engine, plan.parts, 0, plan.seeds)
        while len(search.trials) < trials:
            values, step = search.propose()
            trial = tried(plan, rule, parts, values, step=step)
            with writes_to(folder, "the search"):
                study.add_trial(search.frozen(trial))
            search.add(trial)
            if progress:
                progress(trial, len(search.trials))
    best = best_of(search.trials, rule)
    if best is None:
        raise StationError(f"no trial is a valid station. The first: {search.trials[0].reason}")
    found = Optimum(plan, rule, tuple(search.trials), best, engine.info)
    if not isinstance(rule, Aim):
        return found
    (looked,) = confirm_all([found.station()], plan.parts, engine, plan.seeds)
    return replace(found, confirmed=looked)


def _kinds(plan: Plan, choices: Mapping[str, Sequence[Any]]) -> set[str]:
    """Return of which defects there may be any, as ``hits.KIND``."""
    station = plan.station
    found = {d.kind for d in (*station.defects, *station.populations)}
    chosen = {kind for key, values in choices.items() if key.endswith(".kind") for kind in values}
    pits = {"pit"} if station.part.relief else set()
    return {f"hits.{kind}" for kind in (*found, *chosen, *pits)}


def checked_choices(plan: Plan, choices: Mapping[str, Sequence[Any]]) -> dict[str, tuple[Any, ...]]:
    """Return keys and the values of which each takes one, checked one by one.

    Parameters
    ----------
    plan : Plan
    choices : mapping of str to sequence

    Raises
    ------
    StationError
        If a key is varied, too, takes a value twice, or takes none such.
    """
    found = {}
    for key, given in choices.items():
        values = tuple(given)
        if any(a.key == key for a in plan.axes):
            raise StationError(
                f"{key} is searched between bounds and among values; do one of both."
            )
        if len(values) < 2 or len({*map(repr, values)}) < len(values):
            raise StationError(f"{key}: of {list(values)} there is nothing to choose; name others.")
        reasons = []
        for value in values:
            try:
                plan.station.replace(**{key: value})
            except StationError as error:
                reasons.append(str(error))
        # A value may do with others of the search alone, but one that the key never takes does not.
        never = [r for r in reasons if "is not a known key" in r or " must be '" in r]
        if never or len(reasons) == len(values):
            raise StationError((never or reasons)[0])
        found[key] = values
    return found


class _Held(JournalFileOpenLock):
    """For a journal whose folder is locked already: a killed process leaves no lock behind."""

    def acquire(self) -> bool:
        return True

    def release(self) -> None:
        pass


@contextmanager
def _writing(
    folder: Path, identity: dict[str, Any], rule: Rule | Aim | None = None
) -> Iterator[optuna.Study]:
    """Open the study of a folder, a new one or one to go on with, and lock it."""
    with writes_to(folder, "the search"):
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{folder} is a file; choose another folder with -o.")
        known = (folder / IDENTITY).exists()
        others = [p.name for p in folder.iterdir()] if folder.exists() and not known else []
        others = [name for name in others if name != LOCK]
        if others:
            raise OutputError(
                f"{folder} holds other files ({others[0]}); choose an empty folder, or that of the "
                f"search to go on with, with -o."
            )
        folder.mkdir(parents=True, exist_ok=True)
        lock = taken_lock(folder, LOCK)
    try:
        with writes_to(folder, "the search"):
            _claim(folder, identity)
            study = _study(folder / JOURNAL, directions(rule))
        yield study
    finally:
        lock.release()


def _claim(folder: Path, identity: dict[str, Any]) -> None:
    path = folder / IDENTITY
    if not path.exists():
        write_new(path, json.dumps(identity, indent=1) + "\n")
        return
    try:
        held = json.loads(path.read_text("utf-8"))
        said = differences(held, identity)
        for name in ("rule", "seed"):
            if held[name] != identity[name]:
                said.append(f"the {name} is {held[name]!s} there and {identity[name]!s} here")
        if held.get("choices") != identity.get("choices"):
            said.append("other values are chosen among there")
    except (ValueError, KeyError, TypeError):
        raise OutputError(f"{path} is not that of a search; choose another folder.") from None
    if said:
        raise OutputError(
            f"{folder} holds another search: {'; '.join(said)}. Choose another folder with -o, or "
            f"the same search to go on with it."
        )


def _study(journal: Path, wanted: list[Any]) -> optuna.Study:
    """Open Optuna's journal; a last line that a killed process left unfinished is cut off."""
    if journal.exists():
        with journal.open("r+b") as file:
            file.truncate(file.read().rfind(b"\n") + 1)
    try:
        storage = optuna.storages.JournalStorage(
            JournalFileBackend(os.fspath(journal), lock_obj=_Held(os.fspath(journal)))
        )
        return optuna.create_study(
            storage=storage, study_name="gpuspec", directions=wanted, load_if_exists=True
        )
    except (ValueError, KeyError) as error:
        raise OutputError(
            f"{journal} cannot be read ({error}); remove it to begin the search anew."
        ) from None
