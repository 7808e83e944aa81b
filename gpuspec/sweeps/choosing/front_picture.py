"""The picture of a choice: P2 versus P1, a curve per design, the front and the chosen point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gpuspec import words
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet
from gpuspec.pictures.place import open_frame
from gpuspec.sweeps.choosing.captions import about, label
from gpuspec.sweeps.choosing.chosen import Choosing
from gpuspec.sweeps.choosing.front import COLUMNS, Points, dominated
from gpuspec.sweeps.choosing.scores import Scores, rows_of

CURVES = 100
"""Designs drawn at random, and as many spread along the front."""

_LEAP = 0.1  # between neighbouring thresholds: drawn pale, for nothing lies there
_ZOOM = 0.06, 0.2  # of P1 and P2, to each side of the chosen point
_DARK = "#404040"


def front_picture(choice: Choosing) -> Figure:
    """Draw P2 versus P1: a curve per design over its thresholds, the front and the chosen point."""
    best = choice.best
    at_random, along = _drawn(choice)
    sheet = Sheet(WIDTH, 1010)
    sheet.heading(
        f"Recall P2 over precision P1 ({words.BEST}): each curve is a design at all its thresholds",
        about(choice),
        f"drawn: {words.plural(len(at_random), 'design')} at random and {len(along):,} of the "
        f"{len(choice.ranked.design):,} on the front; pale: leaps from one threshold to the next",
    )
    kinds = [
        (_curves(choice, at_random), "#A8A8A8", 0.7, "design"),
        (_curves(choice, along), SKY, 0.7, "design on the front"),
        (_curves(choice, [best.design]), VERMILION, 1.8, "chosen design"),
    ]
    fronts = _fronts(choice)
    whole = sheet.axes(MARGIN, 150, 860, 780)
    zoom = sheet.axes(1054, 520, 350, 410)
    for ax in (whole, zoom):
        open_frame(ax, f"{words.P1}; {words.BEST}", f"{words.P2}; {words.BEST}")
        handles = [_draw_curves(ax, *kind) for kind in kinds]
        for points, style, name in fronts:
            handles += ax.plot(
                points.p1, points.p2, style, color="black", linewidth=2, label=name,
                drawstyle="steps-pre", marker="." if len(points.p1) == 1 else None,
            )  # fmt: skip
        ax.plot(best.p1, best.p2, "o", markersize=11, color=VERMILION, markeredgecolor="white",
                markeredgewidth=1.5, zorder=5, clip_on=False)  # fmt: skip
    whole.set(xlim=(0, 1.02), ylim=(0, 1.02))
    (left, right), (low, high) = (
        (max(value - reach, 0), min(value + reach, 1.02))
        for value, reach in zip((best.p1, best.p2), _ZOOM, strict=True)
    )
    zoom.set(xlim=(left, right), ylim=(low, high))
    zoom.set_title("around the chosen point", fontsize=10, loc="left", pad=6)
    whole.plot([left, right, right, left, left], [low, low, high, high, low], color=_DARK,
               linewidth=0.8)  # fmt: skip
    _draw_floors(whole, choice)
    sheet.legend(handles, 98)
    _describe(sheet, choice, 1010, 150)
    return sheet.figure


def _drawn(choice: Choosing) -> tuple[list[int], list[int]]:
    """Return designs to draw: some at random of all, some spread along the front."""
    count = choice.plan.designs
    at_random = np.random.default_rng(0).choice(count, min(CURVES, count), replace=False)
    _, first = np.unique(choice.front.design, return_index=True)
    along = choice.front.design[np.sort(first)]
    spread = np.linspace(0, len(along) - 1, min(CURVES, len(along))).round().astype(int)
    return np.sort(at_random).tolist(), along[spread].tolist()


def _curves(choice: Choosing, designs: Sequence[int]) -> list[NDArray[np.float64]]:
    """Return P1 and P2 of designs over their thresholds, as far as something is detected."""
    scores = Scores.of(rows_of(choice.run, designs, COLUMNS))
    return [
        np.column_stack([p1[p2 > 0], p2[p2 > 0]])
        for p1, p2 in zip(scores.p1, scores.p2, strict=True)
        if (p2 > 0).any()
    ]


def _draw_curves(
    ax: Axes, found: Sequence[NDArray[np.float64]], colour: str, width: float, name: str
) -> Any:
    leaps, runs = [], []
    for curve in found:
        far = np.abs(np.diff(curve, axis=0)).max(axis=1, initial=0.0) > _LEAP
        leaps += [*np.stack([curve[:-1][far], curve[1:][far]], axis=1)]
        runs += np.split(curve, np.flatnonzero(far) + 1)
    for part, alpha in ((leaps, 0.25), (runs, 1.0)):
        lines = LineCollection(part, colors=colour, linewidths=width, alpha=alpha)
        ax.add_collection(lines, autolim=False)  # the axes have theirs, and to find them takes long
    return Line2D([], [], color=colour, linewidth=max(width, 1.2), label=name)


def _fronts(choice: Choosing) -> list[tuple[Points, str, str]]:
    """Return the fronts of P1 and P2: whatever is hit, and with the defects hit that are asked."""
    required = choice.rule.required(choice.defects)
    asked = "all" if required == choice.defects else f"at least {required} of"
    kept = choice.front.only(choice.front.hits >= required)
    found = [(_upper(choice.front), ":", "front, whatever is hit")]
    if len(kept.p1):
        found.append((_upper(kept), "-", f"front, {asked} {choice.defects} defects hit"))
    return found


def _upper(points: Points) -> Points:
    """Return the front of P1 and P2 alone, by falling P2, as far as something is detected."""
    points = points.only(points.p2 > 0)
    flat = replace(points, hits=np.zeros_like(points.hits))
    return points.only(~dominated(flat, flat))


def _draw_floors(ax: Axes, choice: Choosing) -> None:
    rule = choice.rule
    line: dict[str, Any] = {"color": _DARK, "linewidth": 1, "linestyle": (0, (5, 4))}
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
    text: dict[str, Any] = {"color": _DARK, "fontsize": 9.5, "bbox": box, "ha": "right"}
    if rule.p2_floor:
        ax.axhline(rule.p2_floor, **line)
        ax.text(1.015, rule.p2_floor - 0.01, f"least P2: {rule.p2_floor:g}", va="top", **text)
    if rule.p1_floor:
        ax.axvline(rule.p1_floor, **line)
        name = f"least P1: {rule.p1_floor:g}"
        ax.text(rule.p1_floor - 0.008, 0.015, name, rotation=90, va="bottom", **text)


def _describe(sheet: Sheet, choice: Choosing, left: float, top: float) -> None:
    """Write down the chosen design, a line each."""
    best = choice.best
    sheet.text(left, top, "Chosen design", fontsize=12, fontweight="bold", color=VERMILION)
    bound = "" if best.exact else "at most "
    values = [(label(key), words.number(value)) for key, value in best.values.items()]
    if len(values) > 6:
        values = [*values[:5], (f"and {len(values) - 5} more keys", "see chosen.json")]
    said = [
        *values,
        ("threshold, DN", f"{best.threshold_dn:.6g}"),
        (words.P1, f"{bound}{best.p1:.4f}"),
        (words.P2, f"{best.p2:.4f}"),
        ("F1", f"{bound}{best.f1:.4f}"),
        ("defects hit", f"{best.hits} of {choice.defects}"),
        ("design", f"{best.design:,}"),
    ]
    for number, (name, value) in enumerate(said, 1):
        sheet.text(left, top + 6 + 25 * number, name, color=_DARK)
        sheet.text(left + 394, top + 6 + 25 * number, value, ha="right")
