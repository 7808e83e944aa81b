"""What an aim chooses from a sweep: the best that meets it, the one that holds, and the front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.light.levels import thresholds
from gpuspec.shown import object_of
from gpuspec.station.corners import corners
from gpuspec.station.costs import COSTS
from gpuspec.station.station import Station
from gpuspec.sweeps.aim import Aim, best_of
from gpuspec.sweeps.choosing.choose import most_defects
from gpuspec.sweeps.choosing.measured import COLUMNS, Measured, counts_of_kinds
from gpuspec.sweeps.choosing.robust import Tolerances, windows
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.measures import MEASURES, NEEDS, measure
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.confirm import Confirmed, confirm_all, held_window

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LOOKED_AT = 24
"""Designs at most that are looked at whole until one is found that meets the aim."""

HELD = 3
"""Designs at most whose corner designs are tried."""


@dataclass(frozen=True)
class Standing:
    """Designs at one threshold each, the best first.

    Attributes
    ----------
    design, level : ndarray of int64, shape (n,)
    values : dict of str to ndarray, shape (n,)
        By the name of the measure.
    """

    design: Ints
    level: Ints
    values: dict[str, Floats]

    def only(self, where: Any) -> Standing:
        """Return some of them, or in another order."""
        values = {name: own[where] for name, own in self.values.items()}
        return Standing(self.design[where], self.level[where], values)

    @classmethod
    def together(cls, parts: Sequence[Standing]) -> Standing:
        """Put several one after another."""
        return cls(
            np.concatenate([p.design for p in parts]), np.concatenate([p.level for p in parts]),
            {name: np.concatenate([p.values[name] for p in parts]) for name in parts[0].values},
        )  # fmt: skip


@dataclass(frozen=True)
class Held:
    """A design with what is left of it within the tolerances, its threshold held.

    Attributes
    ----------
    design : int
    threshold_dn : float
    confirmed : Confirmed
        At this threshold, where nothing is off.
    room_dn : float
        Of the worst within the tolerances: from its threshold to the highest level of what is
        flawless, or to the faintest defect that must be hit, whichever is nearer. Below 0:
        somewhere one is missed, or something else is detected.
    tried : int
        Neighbours of the grid and corner designs that were looked at.
    """

    design: int
    threshold_dn: float
    confirmed: Confirmed
    room_dn: float
    tried: int

    @property
    def values(self) -> dict[str, float]:
        """Its measures."""
        return self.confirmed.values()

    @property
    def station(self) -> Station:
        """With its threshold, and part 0."""
        return self.confirmed.station


@dataclass(frozen=True)
class AimChoice:
    """What an aim chooses from a sweep.

    Attributes
    ----------
    run : RunFolder
    aim : Aim
    ranked : Standing
        Every design that meets the aim, at its best threshold, the best first.
    over : tuple of str
        The two or three measures of the front.
    front : Standing
        What no other that meets the aim beats in all of them.
    peak, robust : Held
        The best where nothing is off, and the one that is the best within the tolerances.
    tolerances : Tolerances
    all_of : dict of str to int
        How many defects there are, by ``hits`` and ``hits.KIND``.
    """

    run: RunFolder
    aim: Aim
    ranked: Standing
    over: tuple[str, ...]
    front: Standing
    peak: Held
    robust: Held
    tolerances: Tolerances
    all_of: dict[str, int]

    def __repr__(self) -> str:
        goal = MEASURES[self.aim.goal]
        shown = {
            name: f"design {one.design}, {goal.name} {goal.shown(one.values[goal.name])}, "
            f"threshold {one.threshold_dn:.6g} DN, room within the tolerances {one.room_dn:.3g} DN"
            for name, one in (("peak", self.peak), ("robust", self.robust))
        }
        return object_of("AimChoice", f"{self.run.path}, aim: {self.aim}", shown)

    @property
    def plan(self) -> Plan:
        """The sweep's."""
        return self.run.plan

    def station(self) -> Station:
        """Return the robust choice with its threshold, and part 0."""
        return self.robust.station

    def threshold_dn(self, points: Standing, number: int) -> float:
        """Return the threshold of one of some points in DN.

        Parameters
        ----------
        points : Standing
        number : int
            Of the point among them.
        """
        return _threshold(self.plan, int(points.design[number]), int(points.level[number]))

    def next(self, count: int) -> Standing:
        """Return the first of those after the peak."""
        return self.ranked.only(slice(1, 1 + count))


def choose_for(
    run: RunFolder | str | Path,
    aim: Aim,
    over: tuple[str, ...] | None = None,
    *,
    min_area_mm2: float | None = None,
    backend: str | Backend = "auto",
    device: str | None = None,
) -> AimChoice:
    """Choose by an aim from the designs that a sweep's folder holds.

    What is chosen is looked at whole, every pixel, and meets the aim exactly.

    Parameters
    ----------
    run : RunFolder, str or Path
        Or the path of a sweep's folder.
    aim : Aim
    over : tuple of str, optional
        The two or three measures of the front; None: the goal and the number of images, or the
        margin.
    min_area_mm2 : float, optional
        Blobs that are smaller are left out: the size filter of the chosen station; None: its own.
    backend, device
        As for :func:`gpuspec.simulate`.

    Raises
    ------
    OutputError
        If the folder holds no designs yet, or a damaged file.
    StationError
        If no design meets the aim: which comes nearest, and what stands in its way; or a measure
        does not follow from the station.
    BackendError
        If the device is absent or fails.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> run = gpuspec.sweep(station, {"sequence.images": [20, 40], "sensor.exposure": [2, 4]}, "s")
    >>> choice = gpuspec.choose_for(run, gpuspec.Aim("images", ["hits >= 30"]))
    >>> choice.peak.values["images"]
    20.0
    """
    run = run if isinstance(run, RunFolder) else RunFolder.read(run)
    over = over or (aim.goal, "margin_dn" if aim.goal in COSTS else "images")
    names = dict.fromkeys([*aim.names, *over])
    for name in names:
        measure(name)
    _check_known(run.plan.station, names)
    tolerances = Tolerances.of(run.plan)
    all_of = {"hits": most_defects(run)}
    for table in run.batches(["exact", "peaks", "kinds"]):
        for name, count in counts_of_kinds(table).items():
            all_of[name] = max(all_of.get(name, 0), count)
    # What the table only bounds is taken for as good as it may be, and then looked at.
    if min_area_mm2 is None:
        min_area_mm2 = run.plan.station.segmentation.min_area_mm2
    lenient = frozenset(["false_blobs"] if min_area_mm2 else _loose(aim)) - {aim.goal, *over}
    standing, front, weakest, flawless = _read(run, aim, over, all_of, lenient)
    ranked = _ranked(standing, aim, all_of)
    met = _met(ranked, aim, all_of)
    if not met.any():
        raise StationError(_nearest(run, ranked, aim, all_of))
    ranked = ranked.only(met)
    engine = open_backend(backend, device)
    looker = _Looker(run.plan, aim, all_of, min_area_mm2, engine)
    peak = looker.first(ranked)
    low, high = windows(run.plan, tolerances, weakest, flawless)
    # Of the peak the threshold is held as it is, of the robust choice it is set for all of them.
    one = looker.held(peak[0], peak[1], tolerances, (low, high))
    order = _by_window(ranked, aim, low, high)
    robust = looker.robust(ranked.only(order), tolerances, (low, high), one)
    return AimChoice(run, aim, ranked, over, front, one, robust, tolerances, all_of)


def _check_known(station: Station, names: Any) -> None:
    for name in names:
        if name == "exposure_s" and station.sensor.light_e_per_s is None:
            break
        if name == "cycle_s" and not (
            station.sensor.light_e_per_s or station.sequence.frame_rate_hz
        ):
            break
    else:
        return
    raise StationError(
        f"{station.file} does not tell {name}: set {NEEDS[name]} in it and sweep again."
    )


def _loose(aim: Aim) -> list[str]:
    """Return the measures whose requirement a screened or a counted bound does not decide."""
    return [r.name for r in aim.require if r.name == "false_blobs" and r.value > 0]


def _read(
    run: RunFolder, aim: Aim, over: tuple[str, ...], all_of: dict[str, int],
    lenient: frozenset[str],
) -> tuple[Standing, Standing, Ints, Ints]:  # fmt: skip
    """Return each design at its best threshold, the front, and the levels of the whole grid."""
    weakest = np.full(run.plan.designs, -1, np.int64)
    flawless = np.full(run.plan.designs, 256, np.int64)
    wanted = {*aim.names, *over}
    standing: list[Standing] = []
    fronts: list[Standing] = []
    for table in run.batches([*COLUMNS]):
        found = Measured.of(table, wanted, aim.least_hits)
        if found is None:
            continue
        weakest[found.design], flawless[found.design] = found.weakest, found.flawless
        values = {**found.values, **{name: np.zeros((1, 1)) for name in lenient}}
        level = best_of(aim.order(values, all_of))
        standing.append(_at(found, values, np.arange(len(level)), level))
        missed = aim.shortfalls(values, all_of)
        met = np.broadcast_to(sum(missed) == 0 if missed else True, (len(level), 256))
        row, at = np.nonzero(met)
        points = _at(found, values, row, at)
        fronts.append(points.only(_undominated(points, over)))
    every = Standing.together(fronts)
    return (
        Standing.together(standing), every.only(_undominated(every, over)), weakest, flawless
    )  # fmt: skip


def _at(found: Measured, values: dict[str, Any], row: Any, level: Any) -> Standing:
    shape = len(found.design), 256
    picked = {name: np.broadcast_to(v, shape)[row, level] for name, v in values.items()}
    return Standing(found.design[row], np.asarray(level, np.int64), picked)


def _undominated(points: Standing, over: tuple[str, ...]) -> Ints:
    """Return the places of the points that no other beats in all measures, best of the first first.

    Of points that are equal in all of them the first by margin, room, design and level is kept.
    """
    high = np.array([points.values[n] * (1 if MEASURES[n].high else -1) for n in over])
    known = np.flatnonzero(~np.isnan(high).any(axis=0))
    left = known[
        np.lexsort(
            (points.level[known], points.design[known], -points.values["room"][known],
             -points.values["margin_dn"][known], *-high[::-1, known])
        )
    ]  # fmt: skip
    if len(over) == 2:
        best = np.maximum.accumulate(np.append(-np.inf, high[1, left]))
        found: Ints = left[high[1, left] > best[:-1]]
        return found
    kept = []
    while len(left):  # the first is beaten by none that is left
        kept.append(left[0])
        left = left[(high[:, left] > high[:, left[:1]]).any(axis=0)]
    return np.array(kept, np.int64)


def _ranked(standing: Standing, aim: Aim, all_of: dict[str, int]) -> Standing:
    criteria = aim.order(standing.values, all_of)
    every = np.broadcast_arrays(*criteria, standing.design)[:-1]
    return standing.only(np.lexsort((standing.design, *(-c for c in reversed(every)))))


def _met(standing: Standing, aim: Aim, all_of: dict[str, int]) -> NDArray[np.bool_]:
    missed = aim.shortfalls(standing.values, all_of)
    return np.broadcast_to(sum(missed) == 0 if missed else True, standing.design.shape)


def _nearest(run: RunFolder, ranked: Standing, aim: Aim, all_of: dict[str, int]) -> str:
    """Say which design comes nearest to an aim, and what stands in its way."""
    first = ranked.only(slice(0, 1))
    design = int(first.design[0])
    missed = aim.shortfalls(first.values, all_of)
    ways = []
    for requirement, short in zip(aim.require, missed, strict=True):
        if short[0] > 0:
            value = float(first.values[requirement.name][0])
            has = "is not known" if np.isnan(value) else f"is {requirement.measure.shown(value)}"
            of = f" of {all_of[requirement.name]}" if requirement.name in all_of else ""
            ways.append(f"{requirement.name} {has}{of}, not {requirement}")
    values = ", ".join(f"{key} = {value:g}" for key, value in run.plan.values(design).items())
    dn = _threshold(run.plan, design, int(first.level[0]))
    return (
        f"no design of {run.path} meets {', '.join(map(str, aim.require))}. Design {design} "
        f"({values}) comes nearest, at {dn:.4g} DN; in its way stands: {'; '.join(ways)}. Ask for "
        f"less of that, or sweep further."
    )


def _threshold(plan: Plan, design: int, level: int) -> float:
    bits = int(plan.values(design).get("sensor.bit_depth", plan.station.sensor.bit_depth))
    return float(thresholds(2**bits - 1)[level])


def _by_window(ranked: Standing, aim: Aim, low: Ints, high: Ints) -> NDArray[np.intp]:
    """Return the designs of which something is left within the tolerances of the grid, in order."""
    left = (high - low)[ranked.design].astype(np.float64)
    goal = ranked.values[aim.goal] * (1 if MEASURES[aim.goal].high else -1)
    if aim.goal.startswith("margin"):
        scale = ranked.values[aim.goal] / np.where(ranked.values["margin_dn"] == 0, np.nan,
                                                   ranked.values["margin_dn"])  # fmt: skip
        goal = np.nan_to_num(left * np.abs(scale), nan=-np.inf)
    sigmas = np.nan_to_num(ranked.values["margin_sigma"], nan=-np.inf)
    order: NDArray[np.intp] = np.lexsort(
        (ranked.design, -sigmas, ranked.values["images"], -left, -goal)
    )
    return order[left[order] > 0]


@dataclass(frozen=True)
class _Looker:
    """Looks at designs whole, and at what is left of them when they are off."""

    plan: Plan
    aim: Aim
    all_of: dict[str, int]
    min_area_mm2: float
    backend: Backend

    def at(self, design: int, threshold_dn: float, **off: Any) -> Confirmed:
        """Look at a design at a threshold, some keys off."""
        return self._every(design, threshold_dn, [off], drawn=True)[0]

    def levels(
        self, design: int, threshold_dn: float, offs: Sequence[dict[str, Any]]
    ) -> list[Confirmed]:
        """Look at a design with some keys off, once for each of several: at its levels alone."""
        return self._every(design, threshold_dn, offs, drawn=False)

    def _every(
        self, design: int, threshold_dn: float, offs: Sequence[dict[str, Any]], *, drawn: bool
    ) -> list[Confirmed]:
        station = self.plan.station_of(design)
        rule = {"segmentation.threshold": threshold_dn,
                "segmentation.min_area_mm2": self.min_area_mm2}  # fmt: skip
        stations = [station.replace(**off, **rule) for off in offs]
        plan = self.plan
        return confirm_all(stations, plan.parts, self.backend, plan.seeds, drawn=drawn)

    def meets(self, found: Confirmed) -> bool:
        """Whether what was looked at meets the aim."""
        values = {name: np.array(value) for name, value in found.values().items()}
        return not any(float(m) > 0 for m in self.aim.shortfalls(values, self.all_of))

    def first(self, ranked: Standing) -> tuple[int, float]:
        """Return the first design that meets the aim when it is looked at, and its threshold."""
        for design, level in list(
            zip(ranked.design.tolist(), ranked.level.tolist(), strict=True)
        )[:LOOKED_AT]:  # fmt: skip
            threshold = _threshold(self.plan, design, level)
            found = self.at(design, threshold)
            if self.meets(found):
                return design, threshold
        raise StationError(
            f"of the {min(LOOKED_AT, len(ranked.design))} designs that promise most none meets "
            f"{self.aim} when it is looked at whole; ask for less."
        )

    def held(
        self, design: int, threshold_dn: float | None, tolerances: Tolerances,
        grid: tuple[Ints, Ints],
    ) -> Held:  # fmt: skip
        """Look at a design within the tolerances.

        Parameters
        ----------
        design : int
        threshold_dn : float or None
            None: the middle of what all leave is taken, if it meets the aim.
        tolerances : Tolerances
        grid : tuple of ndarray
            What the grid's neighbours leave of every design, see `windows`.
        """
        step = _threshold(self.plan, design, 255) / 255
        low, high = (float(ends[design]) * step for ends in grid)
        beyond = tolerances.beyond(self.plan, design)
        station = self.plan.station_of(design)
        some = corners(station, beyond) if beyond else []
        held = threshold_dn if threshold_dn is not None else (low + high) / 2
        off = self.levels(design, held, some)
        if off:
            least, most = held_window(off, self.aim.least_hits)
            low, high = max(low, least), min(high, most)
        if threshold_dn is None:
            level = np.floor((low + high) / 2 / step)
            held = _threshold(self.plan, design, int(np.clip(level, 0, 254)))
        neighbours = sum(half is None for half in tolerances.halves.values())
        tried = len(off) + 3**neighbours - 1
        return Held(design, held, self.at(design, held), min(high - held, held - low), tried)

    def robust(
        self, ordered: Standing, tolerances: Tolerances, grid: tuple[Ints, Ints], peak: Held
    ) -> Held:  # fmt: skip
        """Return the best of the first designs within the tolerances, or the peak."""
        best: Held | None = None
        for design in ordered.design[:HELD].tolist():
            found = self.held(design, None, tolerances, grid)
            if not self.meets(found.confirmed):
                continue
            if best is None or found.room_dn > best.room_dn:
                best = found
            if not tolerances.beyond(self.plan, design):
                break  # the grid tells all, and the first is the best
        return best or replace(peak)
