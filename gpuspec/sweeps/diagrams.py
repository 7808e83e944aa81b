"""Pictures of a sweep: maps of the score, and the sensitivity of the chosen design."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gpuspec.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, open_frame
from gpuspec.sweeps.chosen import Choice
from gpuspec.sweeps.maps import Map
from gpuspec.sweeps.sensitivity import SHARE, Course, Line

MAPPED_KEYS = 4
LINES_MAX = 8
WORST = 0.75
"""Of the best score, below which all is drawn alike."""

GREY, PALE = "#606060", "#DBDBDB"
_UNITS = {"mm": "mm", "um": "µm", "mm2": "mm²", "rad": "rad", "e": "e⁻", "dn": "DN"}
_GOALS = {"p1": "P1 (overdetection)", "p2": "P2 (misdetection)", "f1": "F1"}
_COLOURS = matplotlib.colormaps["cividis"].with_extremes(bad="white")


def label(key: str) -> str:
    """Return a key as an axis says it: ``tunnel.dark_mm`` is "tunnel dark, mm"."""
    name, _, suffix = key.rpartition("_")
    if suffix not in _UNITS:
        return key.replace(".", " ").replace("_", " ")
    return f"{name.replace('.', ' ').replace('_', ' ')}, {_UNITS[suffix]}"


def maps_picture(choice: Choice, maps: Sequence[Map]) -> Figure:
    """Draw the best score for each pair of values of two keys, whatever the others are."""
    columns = min(len(maps), 3)
    gap = 100
    width = (WIDTH - 2 * MARGIN - (columns - 1) * gap) / columns
    height = min(0.85 * width, 520)
    pitch = height + 84
    sheet = Sheet(WIDTH, 140 + math.ceil(len(maps) / columns) * pitch + 50)
    goal = _GOALS[choice.rule.goal]
    sheet.heading(
        f"Highest {goal} for each pair of values, over all values of the other keys",
        about(choice),
    )
    kept = [m.kept(choice.rule, choice.defects) for m in maps]
    rule_is_kept = any(k.any() for k in kept)
    shown = [
        np.where(k, m.goal, np.nan) if rule_is_kept else m.goal
        for m, k in zip(maps, kept, strict=True)
    ]
    low, high = (f(np.concatenate([s.ravel() for s in shown])) for f in (np.nanmin, np.nanmax))
    low, high = max(low, WORST * high), max(high, 1e-3)
    if high - low < 1e-3:
        low = (1 - SHARE) * high
    for number, (m, values) in enumerate(zip(maps, shown, strict=True)):
        row, column = divmod(number, columns)
        ax = sheet.axes(MARGIN + column * (width + gap), 130 + row * pitch, width, height)
        order = [np.argsort(a.values, kind="stable") for a in (m.down, m.across)]
        short = np.isfinite(m.goal) & np.isnan(values)
        for layer, style in (
            (np.where(short, 0.0, np.nan), {"cmap": ListedColormap([PALE])}),
            (values, {"cmap": _COLOURS, "vmin": low, "vmax": high}),
        ):
            masked = np.ma.masked_invalid(layer[np.ix_(*order)])
            drawn = ax.imshow(
                masked, origin="lower", aspect="auto", interpolation="nearest", **style
            )
        best = choice.best.values
        places = [int(np.searchsorted(np.sort(a.values), best[a.key])) for a in (m.down, m.across)]
        ax.plot(places[1], places[0], "o", markersize=11, markerfacecolor="none",
                markeredgecolor="white", markeredgewidth=4)  # fmt: skip
        (mark,) = ax.plot(places[1], places[0], "o", markersize=11, markerfacecolor="none",
                          markeredgecolor=VERMILION, markeredgewidth=2.2, linestyle="none",
                          label="chosen design")  # fmt: skip
        for axis, a in ((ax.yaxis, m.down), (ax.xaxis, m.across)):
            _tick(axis, np.sort(a.values))
            axis.set_label_text(label(a.key), fontsize=10)
        ax.tick_params(labelsize=9.5)
    handles: list[Any] = [mark]
    if rule_is_kept and not all(
        k[np.isfinite(m.goal)].all() for m, k in zip(maps, kept, strict=True)
    ):
        handles.append(Patch(color=PALE, label="no design keeps the rule"))
    if any(np.isnan(m.goal).any() for m in maps):
        handles.append(Patch(facecolor="white", edgecolor=GREY, label="no valid design"))
    sheet.legend(handles, 78)
    bar = sheet.axes(MARGIN, sheet.height - 58, 420, 14)
    sheet.figure.colorbar(drawn, cax=bar, orientation="horizontal", extend="min")
    bar.tick_params(labelsize=9.5)
    bar.text(1.03, 0.5, goal, transform=bar.transAxes, va="center", fontsize=10)
    return sheet.figure


def sensitivity_picture(choice: Choice, found: Sequence[Line]) -> Figure:
    """Draw P1, P2 and defects hit along each key, with a threshold of its own and with one held."""
    shown = found[:LINES_MAX]
    columns = min(len(shown), 4)
    gap, height = 52, 250
    width = (WIDTH - 2 * MARGIN - (columns - 1) * gap) / columns
    block = 2 * (height + 92) + 16
    sheet = Sheet(WIDTH, 134 + math.ceil(len(shown) / columns) * block)
    sheet.heading("The chosen design with other values of one key, the others held", about(choice))
    threshold = choice.best.threshold_dn
    for number, line in enumerate(shown):
        across, down = number % columns, number // columns
        for row, (course, way) in enumerate(
            ((line.own, "threshold chosen anew"), (line.held, f"threshold {threshold:.4g} DN held"))
        ):
            top = 150 + down * block + row * (height + 92)
            ax = sheet.axes(MARGIN + across * (width + gap), top, width, height)
            handles = _draw_course(ax, line, course, choice)
            ax.set_title(f"{way}: {line.tolerated(course)}", fontsize=9.5, loc="left", pad=6)
            if across:
                ax.set_ylabel("")
    sheet.legend(handles, 84)
    return sheet.figure


def _draw_course(ax: Axes, line: Line, course: Course, choice: Choice) -> list[Any]:
    values = np.array(line.values, float)
    open_frame(ax, label(line.key), "share")
    low, high = line.span(course)
    pad = 0.04 * (values[-1] - values[0]) or 0.1 * max(abs(values[0]), 1)
    span = ax.axvspan(low - pad / 3, high + pad / 3, color="#E9E4C8", linewidth=0,
                      label=f"within {SHARE:.0%}, all hits kept")  # fmt: skip
    curves = (
        (course.hits / choice.defects, SKY, "^", "defects hit"),
        (course.p2, VERMILION, "s", "P2 (misdetection)"),
        (course.p1, "black", "o", "P1 (overdetection)"),
    )
    drawn = [
        ax.plot(values, curve, marker, color=colour, linestyle="-", markersize=4.5, label=name)[0]
        for curve, colour, marker, name in curves
    ]
    chosen = ax.axvline(values[line.place], color=GREY, linestyle=":", label="chosen value")
    ax.set(xlim=(values[0] - pad, values[-1] + pad), ylim=(-0.03, 1.05))
    if isinstance(line.values[0], int):
        ax.xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(6, integer=True))
    return [*reversed(drawn), span, chosen]


def about(choice: Choice) -> str:
    """Return what was swept and by which rule it is judged, in one line."""
    plan, there = choice.plan, choice.run.there()
    of = "" if there == plan.designs else f"{there:,} of "
    screened = "; P1 of screened designs is estimated" if plan.samples else ""
    return (
        f"{of}{counted(plan.designs, 'design')}, {counted(plan.parts, 'part')}, "
        f"{counted(choice.defects, 'defect')}  ·  rule: {choice.rule}{screened}"
    )


def counted(number: int, thing: str) -> str:
    """Return "1 design" or "2 designs"."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"


def _tick(axis: Any, values: Any) -> None:
    step = math.ceil(len(values) / 10)
    axis.set_ticks(range(0, len(values), step), [f"{v:g}" for v in values[::step]])
