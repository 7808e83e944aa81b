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

from gpuspec import words
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, text_width
from gpuspec.pictures.place import open_frame, tick_locator
from gpuspec.sweeps.choosing.captions import about, label
from gpuspec.sweeps.choosing.choose import Choice
from gpuspec.sweeps.choosing.maps import Map
from gpuspec.sweeps.choosing.sensitivity import SHARE, Course, Line
from gpuspec.words import number

MAPPED_KEYS = 4
LINES_MAX = 8
WORST, NEAR = 0.75, 0.9
"""Of the best score: below the first all is drawn alike, and colours go down to the second at
least, so that designs that are nearly equal look so."""

_TICKS_PT = 9.5
GREY, PALE = "#606060", "#DBDBDB"
_COLOURS = matplotlib.colormaps["cividis"].with_extremes(bad="white")


def maps_picture(choice: Choice, maps: Sequence[Map]) -> Figure:
    """Draw the best score for each pair of values of two keys, whatever the others are.

    Parameters
    ----------
    choice : Choice
    maps : sequence of Map
    """
    columns = min(len(maps), 3)
    widest = max(text_width(number(v), _TICKS_PT) for m in maps for v in m.down.values)
    gap, left = max(100, widest + 60), max(MARGIN, widest + 45)
    width = (WIDTH - left - MARGIN - (columns - 1) * gap) / columns
    height = min(0.85 * width, 520)
    pitch = height + 84
    sheet = Sheet(WIDTH, 140 + math.ceil(len(maps) / columns) * pitch + 50)
    goal = words.SCORES[choice.rule.goal]
    sheet.heading(
        f"Highest {goal} for each pair of values, over all values of the other keys ({words.BEST})",
        about(choice),
    )
    kept = [m.kept(choice.rule, choice.defects) for m in maps]
    rule_is_kept = any(k.any() for k in kept)
    shown = [
        np.where(k, m.goal, np.nan) if rule_is_kept else m.goal
        for m, k in zip(maps, kept, strict=True)
    ]
    least, most = (f(np.concatenate([s.ravel() for s in shown])) for f in (np.nanmin, np.nanmax))
    high = max(most, 1e-3)
    low = min(max(least, WORST * high), NEAR * high)
    for place, (m, values) in enumerate(zip(maps, shown, strict=True)):
        row, column = divmod(place, columns)
        ax = sheet.axes(left + column * (width + gap), 130 + row * pitch, width, height)
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
            _tick(axis, np.sort(a.values), ax)
            axis.set_label_text(label(a.key), fontsize=10)
        ax.tick_params(labelsize=_TICKS_PT)
    handles: list[Any] = [mark]
    if rule_is_kept and not all(
        k[np.isfinite(m.goal)].all() for m, k in zip(maps, kept, strict=True)
    ):
        handles.append(Patch(color=PALE, label="no design keeps the rule"))
    if any(np.isnan(m.goal).any() for m in maps):
        handles.append(Patch(facecolor="white", edgecolor=GREY, label="no valid design"))
    sheet.legend(handles, 78)
    bar = sheet.axes(MARGIN, sheet.height - 58, 420, 14)
    sheet.figure.colorbar(drawn, cax=bar, orientation="horizontal",
                          extend="min" if least < low else "neither")  # fmt: skip
    bar.xaxis.set_major_locator(tick_locator(420))
    bar.tick_params(labelsize=_TICKS_PT)
    said = f"{goal}: {least:.4f} to {most:.4f} on these maps"
    bar.text(1.03, 0.5, said, transform=bar.transAxes, va="center", fontsize=10)
    return sheet.figure


def sensitivity_picture(choice: Choice, found: Sequence[Line]) -> Figure:
    """Draw P1, P2 and defects hit along each key, with a threshold of its own and with one held.

    Parameters
    ----------
    choice : Choice
    found : sequence of Line
        Of which the first are drawn.
    """
    shown = found[:LINES_MAX]
    columns = min(len(shown), 4)
    gap, height = 52, 250
    width = (WIDTH - 2 * MARGIN - (columns - 1) * gap) / columns
    block = 2 * (height + 92) + 16
    sheet = Sheet(WIDTH, 142 + math.ceil(len(shown) / columns) * block)
    sheet.heading("The chosen design with other values of one key, the others held", about(choice))
    threshold = choice.best.threshold_dn
    for place, line in enumerate(shown):
        across, down = place % columns, place // columns
        for row, (course, way) in enumerate(
            ((line.own, "threshold chosen anew"), (line.held, f"threshold {threshold:.4g} DN held"))
        ):
            top = 158 + down * block + row * (height + 92)
            ax = sheet.axes(MARGIN + across * (width + gap), top, width, height)
            handles = _draw_course(ax, line, course, choice)
            ax.set_title(f"{way}:\n{line.tolerated(course)}", fontsize=9.5, loc="left", pad=6)
            if across:
                ax.set_ylabel("")
    sheet.legend(handles, 84)
    return sheet.figure


def _draw_course(ax: Axes, line: Line, course: Course, choice: Choice) -> list[Any]:
    values = np.array(line.values, float)
    open_frame(ax, label(line.key), f"share; {words.BEST}")
    low, high = line.span(course)
    pad = 0.04 * (values[-1] - values[0]) or 0.1 * max(abs(values[0]), 1)
    span = ax.axvspan(low - pad / 3, high + pad / 3, color="#E9E4C8", linewidth=0,
                      label=f"within {SHARE:.0%}, all hits kept")  # fmt: skip
    curves = (
        (course.hits / choice.defects, SKY, "^", "defects hit"),
        (course.p2, VERMILION, "s", words.P2),
        (course.p1, "black", "o", words.P1),
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


def _tick(axis: Any, values: Any, ax: Axes) -> None:
    """Label as many values as there is room for."""
    box, texts = ax.get_window_extent(), [number(v) for v in values]
    if axis.axis_name == "x":
        room = box.width / (max(text_width(text, _TICKS_PT) for text in texts) + 12)
    else:
        room = box.height / 26
    step = math.ceil(len(values) / max(int(min(room, 10)), 1))
    axis.set_ticks(range(0, len(values), step), texts[::step])
