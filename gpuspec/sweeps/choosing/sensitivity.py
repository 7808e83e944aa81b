"""How far each key of the chosen design may vary: its score along each key, the others held."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.sweeps.choosing.choose import Choice
from gpuspec.sweeps.choosing.front import COLUMNS, Points
from gpuspec.sweeps.choosing.scores import Scores, rows_of
from gpuspec.sweeps.rule import f1_of
from gpuspec.words import number

SHARE = 0.05
"""Of the score, by which it may fall within a tolerated range."""


@dataclass(frozen=True)
class Course:
    """The score along one key.

    Attributes
    ----------
    p1, p2, f1, hits : ndarray of float64, shape (n,)
        NaN where there is no valid design.
    threshold_dn : ndarray of float64, shape (n,)
    exact : ndarray of bool, shape (n,)
        Whether P1 is that of every pixel, and no estimate.
    kept : ndarray of bool, shape (n,)
        Where the rule's goal and floors stay within `SHARE` of the chosen design's and no defect
        less is hit, from the chosen value on to both sides.
    """

    p1: NDArray[np.float64]
    p2: NDArray[np.float64]
    f1: NDArray[np.float64]
    hits: NDArray[np.float64]
    threshold_dn: NDArray[np.float64]
    exact: NDArray[np.bool_]
    kept: NDArray[np.bool_]


@dataclass(frozen=True)
class Line:
    """The chosen design with other values of one key.

    Attributes
    ----------
    key : str
    values : tuple of float or int, length n
        In rising order.
    place : int
        Of the chosen value.
    own : Course
        Each design at its own best threshold.
    held : Course
        Each at the chosen threshold: the same share of full scale.
    """

    key: str
    values: tuple[float | int, ...]
    place: int
    own: Course
    held: Course

    @property
    def alone(self) -> bool:
        """Whether the score falls with any other value, whatever the threshold."""
        return len(self.values) > 2 and int(self.own.kept.sum()) == 1

    def span(self, course: Course) -> tuple[float | int, float | int]:
        """Return the least and the greatest value of the tolerated range."""
        kept = np.flatnonzero(course.kept)
        return self.values[kept[0]], self.values[kept[-1]]

    def tolerated(self, course: Course) -> str:
        """Return the tolerated range in words; beyond what was swept nothing is known."""
        (low, high), (least, most) = self.span(course), (self.values[0], self.values[-1])
        if least == most:
            return "one value swept"
        from_, to = number(low), number(high)
        if (low, high) == (least, most):
            return f"all, {from_} to {to}"
        if low == high:
            return f"only {from_}"
        if low == least:
            return f"up to {to}"
        return f"from {from_} on" if high == most else f"{from_} to {to}"


def lines(choice: Choice) -> list[Line]:
    """Return the chosen design's lines, that along which the goal changes most first."""
    plan, best = choice.plan, choice.best.design
    designs, steps = [], []
    stride = plan.designs
    for a in plan.axes:
        stride //= len(a.values)
        place = best // stride % len(a.values)
        order = np.argsort(a.values, kind="stable")
        designs.append(best + (order - place) * stride)
        steps.append((a.key, tuple(a.values[n] for n in order), int((order == place).argmax())))
    scores = Scores.of(rows_of(choice.run, np.concatenate(designs).tolist(), COLUMNS))
    at = [scores.best(choice.rule, choice.defects), scores.at(int(choice.ranked.level[0]))]
    found = []
    for line, (key, values, place) in zip(designs, steps, strict=True):
        own, held = (_course(choice, points, line, place) for points in at)
        found.append(Line(key, values, place, own, held))
    return sorted(found, key=lambda line: -_change(choice, line))


def _course(choice: Choice, points: Points, line: NDArray[np.int64], place: int) -> Course:
    """Return points of designs in the order of a line."""
    at = np.searchsorted(points.design, line)
    at[at == len(points.design)] = 0
    there = points.design[at] == line
    p1, p2, hits = (
        np.where(there, getattr(points, name)[at], np.nan) for name in ("p1", "p2", "hits")
    )
    threshold_dn = [
        choice.threshold_dn(design, level) if valid else np.nan
        for design, level, valid in zip(line.tolist(), points.level[at], there, strict=True)
    ]
    f1 = f1_of(p1, p2)
    criteria = choice.rule.criteria(p1, p2, hits, choice.defects)[:4]
    best = choice.best
    wanted = choice.rule.criteria(best.p1, best.p2, best.hits, choice.defects)[:4]
    kept = criteria[0] >= wanted[0]
    for value, want in zip(criteria[1:], wanted[1:], strict=True):
        kept &= value >= (1 - SHARE) * want
    kept[place] = True
    broken = np.flatnonzero(~kept)
    first, last = broken[broken < place], broken[broken > place]
    kept[: first[-1] if first.size else 0] = False
    kept[last[0] if last.size else len(kept) :] = False
    return Course(p1, p2, f1, hits, np.array(threshold_dn), there & points.exact[at], kept)


def _change(choice: Choice, line: Line) -> float:
    """Return by how much the goal changes along a line."""
    goal = getattr(line.own, choice.rule.goal)
    return float(np.nanmax(goal) - np.nanmin(goal))


def write_csv(path: Path, choice: Choice, found: Sequence[Line]) -> None:
    """Write a row for each value of each line.

    Parameters
    ----------
    path : Path
    choice : Choice
    found : sequence of Line
    """
    names = ("threshold_dn", "p1", "p2", "f1", "hits", "exact", "kept")
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["key", "value", "chosen", *names, *(f"held_{name}" for name in names)])
        for line in found:
            for n, value in enumerate(line.values):
                courses = [[getattr(c, name)[n] for name in names] for c in (line.own, line.held)]
                cells = courses[0] + courses[1]
                table.writerow(
                    [line.key, value, _word(n == line.place), *(_cell(cell) for cell in cells)]
                )


def _cell(value: Any) -> str:
    if isinstance(value, np.bool_):
        return _word(bool(value))
    return "" if math.isnan(value) else f"{value:.9g}"


def _word(value: bool) -> str:
    return "yes" if value else "no"
