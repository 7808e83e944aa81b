"""What a rule chooses from a sweep, and the station that it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
from numpy.typing import NDArray

from gpuspec.errors import OutputError, StationError
from gpuspec.light.levels import thresholds
from gpuspec.shown import html_page, object_of
from gpuspec.simulation.cautions.defects import out_of_view
from gpuspec.simulation.cautions.detection import BY_CHANCE
from gpuspec.simulation.cautions.station import without_effect
from gpuspec.station.station import Station
from gpuspec.sweeps.choosing.chosen import Chosen
from gpuspec.sweeps.choosing.front import COLUMNS, Front, Points
from gpuspec.sweeps.choosing.scores import rows_of
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.plan import Plan, scored_at
from gpuspec.sweeps.rule import Rule, f1_of


@dataclass(frozen=True)
class Choice:
    """What a rule chooses from a sweep.

    Attributes
    ----------
    run : RunFolder
        The sweep's.
    rule : Rule
        By which it chooses.
    defects : int
        Most defects that can be hit on any of the designs; the rule's share is of these.
    front : Points
        By falling P2.
    ranked : Points
        Each design of the front at its best threshold there, the best design first.
    """

    run: RunFolder
    rule: Rule
    defects: int
    front: Points
    ranked: Points

    def __repr__(self) -> str:
        best = self.best
        values = ", ".join(f"{key} = {value:g}" for key, value in best.values.items())
        parts = {
            "best": f"design {best.design}, {values}, threshold {best.threshold_dn:.6g} DN",
            "score": f"P1 {best.p1:.4f}, P2 {best.p2:.4f}, F1 {best.f1:.4f}, {best.hits} of "
            f"{self.defects} defects hit",
            "front": f"{len(self.ranked.design):,} designs",
        }
        return object_of("Choice", f"{self.run.path}, rule: {self.rule}", parts)

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook: P2 versus P1, the front and the chosen point."""
        from gpuspec.pictures.page import png
        from gpuspec.sweeps.choosing.front_picture import front_picture

        return png(front_picture(self))

    def _repr_html_(self) -> str:
        """Show itself in a notebook: the chosen design, and the front."""
        return html_page(self, self._repr_png_())

    @property
    def plan(self) -> Plan:
        """The sweep's plan."""
        return self.run.plan

    @property
    def best(self) -> Chosen:
        """The chosen design."""
        return self.described(self.ranked, 0)

    def described(self, points: Points, number: int) -> Chosen:
        """Return one of some points with its values and its threshold.

        Parameters
        ----------
        points : Points
        number : int
            Of the point, from 0.
        """
        design, p1, p2 = int(points.design[number]), points.p1[number], points.p2[number]
        return Chosen(
            design, self.plan.values(design), self.threshold_dn(design, points.level[number]),
            float(p1), float(p2), float(f1_of(p1, p2)), int(points.hits[number]),
            bool(points.exact[number]),
        )  # fmt: skip

    def threshold_dn(self, design: int, level: float) -> float:
        """Return a threshold in DN, given as one of 0 to 255.

        Parameters
        ----------
        design : int
            Its number: the bit depth may be varied.
        level : float
            0 to 255.
        """
        values = self.plan.values(design)
        bits = int(values.get("sensor.bit_depth", self.plan.station.sensor.bit_depth))
        return float(thresholds(2**bits - 1)[int(level)])

    @property
    def shortfall(self) -> str | None:
        """What no design fulfils, and the option that asks for less; None: the rule is kept."""
        best, rule = self.best, self.rule
        required = rule.required(self.defects)
        asked = f"all {required}" if required == self.defects else f"{required} of {self.defects}"
        if best.hits < required:
            share = int(100 * best.hits / self.defects) / 100
            return (
                f"no design hits {asked} defects; the most is {best.hits}. The best of those that "
                f"hit {best.hits} is chosen; ask for fewer with --hit-share {share:g}."
            )
        for name, value, floor in (
            ("p2", best.p2, rule.p2_floor), ("p1", best.p1, rule.p1_floor),
        ):  # fmt: skip
            if value < floor:
                also = f" and has P2 of {rule.p2_floor:g}" if name == "p1" and rule.p2_floor else ""
                return (
                    f"no design that hits {asked} defects{also} reaches {name.upper()} "
                    f"{floor:g}; the highest, {value:.4f}, is chosen. Ask for less with "
                    f"--{name}-floor {int(100 * value) / 100:g}."
                )
        return None

    def station(self) -> Station:
        """Return the chosen station with its threshold, and part 0.

        Raises
        ------
        StationError
            If the threshold is full scale, above which nothing is detected.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> run = gpuspec.sweep(gpuspec.Plan.of(station, {"sensor.exposure": [2, 4]}), "sweep")
        >>> best = gpuspec.choose(run).station()
        >>> result = gpuspec.simulate(best)
        >>> result.threshold == best.segmentation.threshold
        True
        """
        best = self.best
        station = self.plan.station_of(best.design)
        if best.threshold_dn >= station.sensor.full_scale_dn:
            raise StationError(
                "the rule chooses a threshold above which nothing is detected; ask for some P2 "
                "with --p2-floor, or for hits with --hit-share."
            )
        return scored_at(station, best.threshold_dn)

    @cached_property
    def notes(self) -> list[str]:
        """What to know of the chosen design before trusting its score."""
        try:
            (row,) = rows_of(self.run, [self.best.design], ("notes",)).to_pylist()
            lines = (row["notes"] or "").splitlines()
        except OutputError:  # a table of before there was this column: the others were read
            lines = []
        plan, station = self.plan, self.plan.station_of(self.best.design)
        (row,) = rows_of(self.run, [self.best.design], ("zone_px", "defects")).to_pylist()
        return [
            *lines,
            *out_of_view(station, plan.inspections, row["defects"]),
            *self._by_chance(station, row["zone_px"]),
            *without_effect(station),
        ]

    def _by_chance(self, station: Station, zone_px: int) -> list[str]:
        """Say so where the chosen design detects so much that defects are hit by chance."""
        best, plan = self.best, self.plan
        hit = best.p2 * zone_px
        if not (hit and best.p1):
            return []
        p, (m, n), part = station.camera.sampling_mm, station.shape, station.part
        pixels = min(part.width_mm / p, m) * min(part.length_mm / p, n) * plan.inspections
        share = hit * (1 / best.p1 - 1) / max(pixels - zone_px, 1)
        if share <= BY_CHANCE:
            return []
        return [
            f"{100 * share:.3g} % of the flawless surface is detected with the chosen design, so "
            f"that defects are hit by chance; ask for a higher P1 with --p1-floor."
        ]

    def details(self) -> dict[str, Any]:
        """Return what else the chosen design's row tells.

        Returns
        -------
        dict
            What computed it: ``backend``, ``device``, ``driver``, ``version``; and, where the row
            is at the chosen threshold, ``part_p1``, ``part_p2`` and ``part_hits`` of each part.
        """
        names = ("backend", "device", "driver", "version")
        parts = ("part_p1", "part_p2", "part_hits")
        own = ("exact", "best_p1", "best_p2", "best_hits")
        best = self.best
        (row,) = rows_of(self.run, [best.design], (*names, *parts, *own)).to_pylist()
        same = tuple(row[name] for name in own) == (True, best.p1, best.p2, best.hits)
        return {name: row[name] for name in (*names, *(parts if same else ()))}


def choose(
    run: RunFolder | str | Path,
    rule: Rule | None = None,
    also: Callable[[pa.Table], None] | None = None,
    **asked: Any,
) -> Choice:
    """Choose from the designs that a sweep's folder holds; one file is held at a time.

    For every rule that asks for no less P1, P2 or hits, the best point is on the front, and that is
    exact where a sweep is finished, screened or not. Of equal points the lowest design is chosen.

    Parameters
    ----------
    run : RunFolder, str or Path
        Or the path of a sweep's folder.
    rule : Rule, optional
    also : callable, optional
        Told the `COLUMNS` of every file, in their order.
    **asked
        What else the rule asks for: ``goal``, ``p2_floor``, ``p1_floor``, ``hit_share``, see
        :class:`Rule`; e.g. ``choose(run, goal="f1")``.

    Raises
    ------
    OutputError
        If the folder holds no designs yet, or a damaged file.
    StationError
        If none of the designs is a valid station, or no rule asks for such a thing.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> run = gpuspec.sweep(station, {"sensor.exposure": [1, 2, 4]}, "sweep")
    >>> choice = gpuspec.choose(run, goal="f1", hit_share=0.9)
    >>> choice.best.values, choice.best.hits
    ({'sensor.exposure': 2.0}, 30)
    >>> choice.station().segmentation.threshold == choice.best.threshold_dn
    True
    """
    run = run if isinstance(run, RunFolder) else RunFolder.read(run)
    rule = (rule or Rule()).asking(**asked)
    defects = most_defects(run)
    front = Front()
    for table in run.batches([*COLUMNS]):
        table = table.filter(pa.compute.is_valid(table["exact"]))
        if len(table):
            front.add(table)
            if also:
                also(table)
    points = front.points()
    order = ranking(rule, points, defects)
    _, first = np.unique(points.design[order], return_index=True)
    return Choice(run, rule, defects, points, points.only(order[np.sort(first)]))


def most_defects(run: RunFolder) -> int:
    """Return the most defects that can be hit on any of the designs.

    Raises
    ------
    OutputError, StationError
        If there are no designs, or no valid ones.
    """
    if not run.there():
        raise OutputError(
            f"{run.path} holds no designs yet; run the same `gpuspec sweep` again to go on with it."
        )
    found = [pa.compute.max(table["defects"]).as_py() for table in run.batches(["defects"])]
    valid = [most for most in found if most is not None]
    if not valid:
        (_, reason) = run.invalid() or (0, "")
        raise StationError(f"no design of the sweep is a valid station, e.g.: {reason}")
    return int(max(valid))


def ranking(rule: Rule, points: Points, defects: int) -> NDArray[np.intp]:
    """Return the places of points from the best to the worst; of equals the lowest design first.

    Parameters
    ----------
    rule : Rule
    points : Points
    defects : int
        Most defects that can be hit.

    Returns
    -------
    ndarray of intp
        One for each point.
    """
    criteria = rule.criteria(points.p1, points.p2, points.hits, defects)
    order: NDArray[np.intp] = np.lexsort(
        (points.level, points.design, *(-c for c in reversed(criteria)))
    )
    return order
