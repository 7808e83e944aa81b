"""What a search tried, as a table and as a picture."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gpuspec import words
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, png
from gpuspec.pictures.place import open_frame
from gpuspec.sweeps.aim import Aim
from gpuspec.sweeps.measures import MEASURES
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.rule import Rule, f1_of
from gpuspec.sweeps.searching.search import Trial, best_of


class Searched(Protocol):
    """What a search found, as :class:`gpuspec.sweeps.searching.optimise.Optimum` explains it."""

    @property
    def plan(self) -> Plan:
        """With two values of each key: the bounds."""

    @property
    def rule(self) -> Rule | Aim:
        """By which the best was chosen."""

    @property
    def trials(self) -> Sequence[Trial]:
        """In their order."""

    @property
    def best(self) -> int:
        """Which of them is the best by the rule."""


def write_trials(path: Path, found: Searched) -> None:
    """Write a row for each trial; of one that is no valid station, its values and the reason.

    Parameters
    ----------
    path : Path
    found : Searched
    """
    keys = list(found.trials[0].values)
    named = found.rule.names if isinstance(found.rule, Aim) else ()
    more = [name for name in named if name not in ("p1", "p2", "f1", "hits")]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["trial", *keys, "how", "threshold_dn", "p1", "p2", "f1", "hits", "defects",
                        "reason", "notes", *more])  # fmt: skip
        for number, t in enumerate(found.trials, 1):
            f1 = _f1(t)
            scores = [t.threshold_dn, t.p1, t.p2, f1, t.hits, t.defects]
            table.writerow([
                number, *(t.values[key] for key in keys), "step" if t.step else "sampler",
                *([""] * len(scores) if t.reason else scores), t.reason or "",
                t.notes or "", *(t.measures.get(name, "") for name in more),
            ])  # fmt: skip


def optimise_picture(found: Searched) -> bytes:
    """Draw every trial in the plane of P1 and P2, and how the best one came about; a PNG.

    Of an aim the goal is drawn over what is missed of its requirements.
    """
    if isinstance(found.rule, Aim):
        return _aim_picture(found, found.rule)
    valid = [(n, t) for n, t in enumerate(found.trials, 1) if t.reason is None]
    best, goal = found.trials[found.best], found.rule.goal
    sheet = Sheet(WIDTH, 800)
    sheet.heading(
        "What the search tried: each point is a design at its best threshold",
        f"{words.plural(len(found.trials), 'trial')}, {found.plan.tries}, "
        f"{words.plural(best.defects, 'defect')}  ·  rule: {found.rule}",
    )
    plane = sheet.axes(MARGIN, 136, 600, 580)
    handles = []
    for step, colour, marker, name in (
        (False, "#8C8C8C", "o", "sampler's choice"),
        (True, SKY, "^", "step from the best"),
    ):
        some = [(t.p1, t.p2) for _, t in valid if t.step is step]
        points = np.array(some).reshape(-1, 2)
        handles += plane.plot(*points.T, marker, color=colour, markersize=5, label=name)
    corner = np.array(sorted(((t.p1, t.p2) for _, t in valid), reverse=True))
    front = corner[np.r_[True, corner[1:, 1] > np.maximum.accumulate(corner[:, 1])[:-1]]]
    handles += plane.plot(*front.T, "k-", linewidth=1.6, drawstyle="steps-post",
                          label="front of these points")  # fmt: skip
    mark: dict[str, Any] = {
        "color": VERMILION,
        "markeredgecolor": "white",
        "markersize": 12,
        "clip_on": False,
    }
    handles += plane.plot(best.p1, best.p2, "o", label="best by the rule", zorder=5, **mark)
    plane.set(xlim=(0, 1.02), ylim=(0, 1.02))
    if found.rule.p2_floor:
        plane.axhline(found.rule.p2_floor, color="#404040", linewidth=1, linestyle=(0, (5, 4)))
        plane.text(1.015, found.rule.p2_floor - 0.01, f"least P2: {found.rule.p2_floor:g}",
                   ha="right", va="top", fontsize=9.5, color="#404040")  # fmt: skip
    open_frame(plane, f"{words.P1}; {words.BEST}", f"{words.P2}; {words.BEST}")
    course = sheet.axes(800, 136, 604, 580)
    numbers, goals = [], []
    for end, _ in valid:
        so_far = best_of(found.trials[:end], found.rule)
        held = found.trials[so_far or 0]
        numbers.append(end)
        goals.append({"p1": held.p1, "p2": held.p2, "f1": _f1(held)}[goal])
    course.plot([*numbers, len(found.trials)], [*goals, goals[-1]], color=VERMILION, linewidth=1.8,
                drawstyle="steps-post")  # fmt: skip
    course.set(xlim=(0, len(found.trials)), ylim=(0, 1.02))
    open_frame(course, "trials", f"{words.SCORES[goal]} of the best by the rule so far")
    sheet.legend(handles, 82)
    return png(sheet.figure)


def _aim_picture(found: Searched, aim: Aim) -> bytes:
    """Draw the goal of every trial over the number of images, and how the best one came about."""
    valid = [(n, t) for n, t in enumerate(found.trials, 1) if t.reason is None]
    best, goal = found.trials[found.best], MEASURES[aim.goal]
    sheet = Sheet(WIDTH, 800)
    sheet.heading(
        "What the search tried: each point is a design at its best threshold",
        f"{words.plural(len(found.trials), 'trial')}, {found.plan.tries}, "
        f"{words.plural(best.defects, 'defect')}  ·  {aim}",
    )
    across = MEASURES["images" if goal.name != "images" else "margin_dn"]
    plane = sheet.axes(MARGIN, 136, 600, 580)
    handles = []
    for met, colour, marker, name in (
        (False, "#B8B8B8", "x", "misses a requirement"),
        (True, SKY, "o", "meets them all"),
    ):
        some = [t.measures for _, t in valid if (sum(t.missed) == 0) is met]
        points = np.array([[t[across.name], t[goal.name]] for t in some], float).reshape(-1, 2)
        handles += plane.plot(*points.T, marker, color=colour, markersize=5, label=name)
    mark = np.array([[best.measures[across.name]], [best.measures[goal.name]]], float)
    handles += plane.plot(*mark, "o", label="best", color=VERMILION, markeredgecolor="white",
                          markersize=12, zorder=5, clip_on=False)  # fmt: skip
    plane.margins(0.06)
    open_frame(plane, across.axis, goal.axis)
    course = sheet.axes(800, 136, 604, 580)
    points_of_course = []
    for end, _ in valid:
        held = found.trials[best_of(found.trials[:end], aim) or 0]
        if sum(held.missed) == 0:
            points_of_course.append((end, held.measures[aim.goal]))
    if points_of_course:
        points_of_course.append((len(found.trials), points_of_course[-1][1]))
        course.plot(*np.array(points_of_course, float).T, color=VERMILION, linewidth=1.8,
                    drawstyle="steps-post")  # fmt: skip
    course.set(xlim=(0, len(found.trials)))
    course.margins(y=0.06)
    open_frame(course, "trials", f"{goal.axis}; of the best so far that meets all")
    sheet.legend(handles, 82)
    return png(sheet.figure)


def _f1(trial: Trial) -> float:
    return float(f1_of(np.array(trial.p1), np.array(trial.p2)))
