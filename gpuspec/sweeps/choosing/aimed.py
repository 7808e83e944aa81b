"""What an aim chooses from a sweep: the best that meets it, the one that holds, and the front."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec import words
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.constants import LEVELS
from gpuspec.light.devices import open_backend
from gpuspec.light.levels import thresholds
from gpuspec.shown import object_of
from gpuspec.station.corners import corners
from gpuspec.station.costs import COSTS
from gpuspec.station.station import Station
from gpuspec.sweeps.aim import KNOWN, Aim, best_of
from gpuspec.sweeps.choosing.choose import most_defects
from gpuspec.sweeps.choosing.measured import BITS, COLUMNS, Measured, counts_of_kinds
from gpuspec.sweeps.choosing.robust import Tolerances, windows
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.measures import MEASURES, NEEDS, check_kinds, measure
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.confirm import Confirmed, confirm_all, held_window

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


LOOKED_AT = 24
"""Designs at most that are looked at whole until one is found that meets the aim."""

FILTERED = frozenset(MEASURES).difference(
    COSTS, ("margin_dn", "margin_sigma", "noise_dn", "smallest_mm")
)
"""Measures that a size filter changes: all but those of levels, and costs."""

_FIRST_STEP = 16  # of the levels that a design is looked at through a filter

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
    spans : dict of str to ndarray, shape (2, n)
        Between which some of these are, that a table does not tell exactly.
    """

    design: Ints
    level: Ints
    values: dict[str, Floats]
    spans: dict[str, Floats] = field(default_factory=dict)

    def only(self, where: Any) -> Standing:
        """Return some of them, or in another order."""
        values = {name: own[where] for name, own in self.values.items()}
        spans = {name: own[:, where] for name, own in self.spans.items()}
        return Standing(self.design[where], self.level[where], values, spans)

    @classmethod
    def together(cls, parts: Sequence[Standing]) -> Standing:
        """Put several one after another."""
        return cls(
            np.concatenate([p.design for p in parts]), np.concatenate([p.level for p in parts]),
            {name: np.concatenate([p.values[name] for p in parts]) for name in parts[0].values},
            {name: np.concatenate([p.spans[name] for p in parts], axis=1)
             for name in parts[0].spans},
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
        Every design that meets the aim as far as the table tells, at its best threshold, the best
        first.
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

    What is chosen is looked at whole, every pixel, and meets the aim exactly: the table tells
    margins to a level, and knows of no size filter. Of designs that may be as good the best is
    taken.

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
        does not follow from the station, or is of defects of which there are none.
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
    check_kinds(names, [name for name, count in all_of.items() if count])
    # What the table only bounds is taken for as good as it may be, and then looked at.
    if min_area_mm2 is None:
        min_area_mm2 = run.plan.station.segmentation.min_area_mm2
    loose = (FILTERED if min_area_mm2 else _loose(aim)) - ({"false_blobs"} & {aim.goal, *over})
    standing, front, weakest, flawless = _read(run, aim, over, all_of, loose)
    ranked = _ranked(standing, aim, all_of)
    met = _met(ranked, aim, all_of)
    if not met.any():
        raise StationError(_nearest(run, ranked, aim, all_of))
    engine = open_backend(backend, device)
    looker = _Looker(run.plan, aim, all_of, min_area_mm2, engine)
    peak, missed = looker.best(ranked.only(met))
    ranked = ranked.only(met & ~np.isin(ranked.design, missed))
    ranked = ranked.only(np.argsort(ranked.design != peak[0], kind="stable"))
    low, high = windows(run.plan, tolerances, weakest, flawless)
    # Of the peak the threshold is held as it is, of the robust choice it is set for all of them.
    one = looker.held(*peak, tolerances, (low, high))
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


def _loose(aim: Aim) -> frozenset[str]:
    """Return the measures whose requirement a screened or a counted bound does not decide."""
    return frozenset(r.name for r in aim.require if r.name == "false_blobs" and r.value > 0)


def _read(
    run: RunFolder, aim: Aim, over: tuple[str, ...], all_of: dict[str, int], loose: frozenset[str],
) -> tuple[Standing, Standing, Ints, Ints]:  # fmt: skip
    """Return each design at its best threshold, the front, and the levels of the whole grid."""
    weakest = np.full(run.plan.designs, -1, np.int64)
    flawless = np.full(run.plan.designs, 256, np.int64)
    wanted = {*aim.names, *over}
    standing: list[Standing] = []
    fronts: list[Standing] = []
    bits = [BITS] * any(a.key == BITS for a in run.plan.axes)
    for table in run.batches([*COLUMNS, *bits]):
        found = Measured.of(table, wanted, aim.least_hits, run.plan.station.sensor)
        if found is None:
            continue
        weakest[found.design], flawless[found.design] = found.weakest, found.flawless
        spans = {**found.spans, **_spans(found.values, loose.intersection(wanted))}
        # At full scale nothing is detected, and no station may have that threshold.
        below = (len(found.design), LEVELS - 1)
        order = aim.order(found.values, all_of, spans)
        level = best_of([np.broadcast_to(_below(values), below) for values in order])
        standing.append(_at(found, spans, np.arange(len(level)), level))
        missed = aim.shortfalls(found.values, all_of, spans)
        row, at = np.nonzero(np.broadcast_to(_below(sum(missed) == 0) if missed else True, below))
        points = _at(found, spans, row, at)
        fronts.append(points.only(_undominated(points, over)))
    every = Standing.together(fronts)
    return (
        Standing.together(standing), every.only(_undominated(every, over)), weakest, flawless
    )  # fmt: skip


def _below(values: Any) -> Any:
    """Return values over levels without the last, where there are that many."""
    return values[..., :-1] if np.shape(values)[-1:] == (LEVELS,) else values


def _spans(values: dict[str, Floats], loose: Collection[str]) -> dict[str, tuple[Floats, Floats]]:
    """Return between which measures are that a table but bounds: no size filter adds to a pixel."""
    return {
        name: (0 * values[name], values[name] if name not in ("p1", "f1") else 0 * values[name] + 1)
        for name in loose
    }


def _at(found: Measured, spans: dict[str, tuple[Floats, Floats]], row: Any, level: Any) -> Standing:
    def picked(values: Floats) -> Floats:
        of: Floats = np.broadcast_to(values, (len(found.design), LEVELS))[row, level]
        return of

    return Standing(
        found.design[row], np.asarray(level, np.int64),
        {name: picked(values) for name, values in found.values.items()},
        {name: np.stack([picked(end) for end in ends]) for name, ends in spans.items()},
    )  # fmt: skip


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
    criteria = aim.order(standing.values, all_of, standing.spans)
    every = np.broadcast_arrays(*criteria, standing.design)[:-1]
    return standing.only(np.lexsort((standing.design, *(-c for c in reversed(every)))))


def _met(standing: Standing, aim: Aim, all_of: dict[str, int]) -> NDArray[np.bool_]:
    missed = aim.shortfalls(standing.values, all_of, standing.spans)
    return np.broadcast_to(sum(missed) == 0 if missed else True, standing.design.shape)


def _nearest(run: RunFolder, ranked: Standing, aim: Aim, all_of: dict[str, int]) -> str:
    """Say which design comes nearest to an aim, and what stands in its way."""
    design, level = int(ranked.design[0]), int(ranked.level[0])
    values = {name: own[0] for name, own in ranked.values.items()}
    spans = {name: (low[0], high[0]) for name, (low, high) in ranked.spans.items()}
    way = _in_the_way(aim, values, all_of, spans)
    return (
        f"no design of {run.path} meets {', '.join(map(str, aim.require))}. "
        f"{_named(run.plan, design)} comes nearest, at {_threshold(run.plan, design, level):.4g} "
        f"DN; in its way stands: {way}. Ask for less of that, or sweep further."
    )


def _named(plan: Plan, design: int) -> str:
    values = ", ".join(f"{key} = {value:g}" for key, value in plan.values(design).items())
    return f"Design {design} ({values})"


def _in_the_way(
    aim: Aim, values: Mapping[str, Any], all_of: dict[str, int],
    spans: Mapping[str, tuple[Any, Any]] = KNOWN,
) -> str:  # fmt: skip
    """Say what of an aim one design misses, and by what it does."""
    ways = []
    for requirement, short in zip(aim.require, aim.shortfalls(values, all_of, spans), strict=True):
        if short > 0:
            value = float(values[requirement.name])
            has = "is not known" if np.isnan(value) else f"is {requirement.measure.shown(value)}"
            of = f" of {all_of[requirement.name]}" if requirement.name in all_of else ""
            ways.append(f"{requirement.name} {has}{of}, not {requirement}")
    return "; ".join(ways)


def _threshold(plan: Plan, design: int, level: int) -> float:
    bits = int(plan.values(design).get("sensor.bit_depth", plan.station.sensor.bit_depth))
    return float(thresholds(2**bits - 1)[level])


def _points(some: Standing) -> list[tuple[int, int]]:
    """Return the first designs and their levels, so many as are looked at."""
    return list(zip(some.design.tolist(), some.level.tolist(), strict=True))[:LOOKED_AT]


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

    def at(self, points: Iterable[tuple[int, float]]) -> list[Confirmed]:
        """Look at designs, each at a threshold."""
        return self._every([(design, dn, {}) for design, dn in points], drawn=True)

    def levels(
        self, design: int, threshold_dn: float, offs: Sequence[dict[str, Any]]
    ) -> list[Confirmed]:
        """Look at a design with some keys off, once for each of several: at its levels alone."""
        return self._every([(design, threshold_dn, off) for off in offs], drawn=False)

    def _every(
        self, points: Sequence[tuple[int, float, dict[str, Any]]], *, drawn: bool
    ) -> list[Confirmed]:
        stations = [
            self.plan.station_of(design).replace(
                **off, segmentation__threshold=dn, segmentation__min_area_mm2=self.min_area_mm2
            )
            for design, dn, off in points
        ]
        plan = self.plan
        return confirm_all(stations, plan.parts, self.backend, plan.seeds, drawn=drawn)

    def meets(self, found: Confirmed) -> bool:
        """Whether what was looked at meets the aim."""
        values = {name: np.array(value) for name, value in found.values().items()}
        return not any(float(m) > 0 for m in self.aim.shortfalls(values, self.all_of))

    def best(self, ranked: Standing) -> tuple[tuple[int, float], list[int]]:
        """Return the best design that meets the aim when it is looked at, and its threshold.

        After the first that does, those are looked at that may be better for all the table tells.

        Parameters
        ----------
        ranked : Standing
            What may meet the aim.

        Returns
        -------
        design, threshold_dn : int, float
        missed : list of int
            Designs that do not meet it.
        """
        certain = ranked.only(_met(replace(ranked, spans={}), self.aim, self.all_of))
        looked: dict[int, Confirmed] = {}
        for design, level in chain(_points(ranked), _points(certain)):
            if design not in looked:
                looked |= self._look([(design, level)])
            if self.meets(looked[design]):
                rivals = ranked.only(self._may_beat(looked[design], ranked))
                left = max(LOOKED_AT - len(looked), 0)
                looked |= self._look([p for p in _points(rivals) if p[0] not in looked][:left])
                break
        best = self._best_of(looked)
        if not self.meets(looked[best]):
            raise StationError(self._none(looked, best))
        missed = [design for design, found in looked.items() if not self.meets(found)]
        return (best, float(looked[best].station.segmentation.threshold)), missed

    def _look(self, points: Sequence[tuple[int, int]]) -> dict[int, Confirmed]:
        """Look at designs at their levels or, through a size filter, at the level that is best."""
        if self.min_area_mm2:
            return self._filtered([design for design, _ in points])
        found = self.at((design, _threshold(self.plan, design, level)) for design, level in points)
        return {design: one for (design, _), one in zip(points, found, strict=True)}

    def _filtered(self, designs: Sequence[int]) -> dict[int, Confirmed]:
        """Look at designs at levels that come closer and closer to the best of each.

        What a size filter leaves no table tells: a blob shrinks as the threshold rises. Of designs
        that share a light map that is traced once for a step of all.
        """
        looked: dict[int, dict[int, Confirmed]] = {design: {} for design in designs}
        best: dict[int, Confirmed] = {}
        first = [*range(0, LEVELS - 1, _FIRST_STEP), LEVELS - 2]
        wanted = [(design, level) for design in designs for level in first]
        while wanted:
            found = self.at((design, _threshold(self.plan, design, at)) for design, at in wanted)
            for (design, level), one in zip(wanted, found, strict=True):
                looked[design][level] = one
            steps = {design: self._step(looked[design]) for design, _ in wanted}
            best |= {design: looked[design][level] for design, (level, _) in steps.items()}
            wanted = [(design, level) for design, (_, more) in steps.items() for level in more]
        return best

    def _step(self, looked: Mapping[int, Confirmed]) -> tuple[int, list[int]]:
        """Return the best level of those a design was looked at, and at which to look next."""
        low, high = self._window(looked)
        best = self._best_of(looked, {level: min(level - low, high - level) for level in looked})
        between = {(one + next_) // 2 for one, next_ in pairwise(sorted(looked))
                   if best in (one, next_) or low == one or high == next_}  # fmt: skip
        return best, sorted({*between, (low + high) // 2} - {*looked})

    def _window(self, looked: Mapping[int, Confirmed]) -> tuple[int, int]:
        """Return the last level with a false blob, and the first at which too little is hit."""
        least = self.aim.least_hits
        low = max(
            (level for level, one in looked.items() if one.values()["false_blobs"]), default=0
        )
        high = min(
            (level for level, one in looked.items()
             if one.values()["hits"] < min(one.defects, least or one.defects)),
            default=LEVELS - 1,
        )  # fmt: skip
        return low, high

    def _best_of(
        self, looked: Mapping[int, Confirmed], room: Mapping[int, float] | None = None
    ) -> int:
        """Return which of what was looked at is the best by the aim, the first of equals."""
        measures = [one.values() for one in looked.values()]
        values = {name: np.array([one[name] for one in measures]) for name in MEASURES}
        values["room"] = np.array([room[key] if room else 0.0 for key in looked])
        return list(looked)[int(best_of(self.aim.order(values, self.all_of)))]

    def _may_beat(self, found: Confirmed, ranked: Standing) -> NDArray[np.bool_]:
        """Return which designs may be better than one that was looked at, by goal and margin."""
        goal, own = self.aim.goal, found.values()
        most = {
            **ranked.values,
            **{name: ranked.spans[name][1] for name in ("margin_dn", "margin_sigma")},
        }
        sign = 1 if MEASURES[goal].high else -1
        more: Floats = sign * (most[goal] - own[goal])
        better: NDArray[np.bool_] = (more > 0) | (
            (more == 0) & (most["margin_dn"] > own["margin_dn"])
        )
        return better

    def _none(self, looked: Mapping[int, Confirmed], nearest: int) -> str:
        """Say that no design meets the aim, and what stands in the way of the nearest."""
        found = looked[nearest]
        values = {name: np.array(value) for name, value in found.values().items()}
        way = _in_the_way(self.aim, values, self.all_of)
        return (
            f"of the {words.plural(len(looked), 'design')} that promise most none meets {self.aim} "
            f"when it is looked at whole. {_named(self.plan, nearest)} comes nearest, at "
            f"{found.station.segmentation.threshold:.4g} DN; in its way stands: {way}. Ask for "
            f"less of that."
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
        (found,) = self.at([(design, held)])
        return Held(design, held, found, min(high - held, held - low), tried)

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
