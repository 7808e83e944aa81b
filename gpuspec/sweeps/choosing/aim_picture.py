"""The picture of an aim's choice: its measures, the front, the peak, what holds, and the next."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gpuspec import words
from gpuspec.pictures.page import MARGIN, VERMILION, WIDTH, Sheet
from gpuspec.pictures.place import open_frame
from gpuspec.sweeps.choosing.aimed import AimChoice, Held
from gpuspec.sweeps.choosing.captions import label
from gpuspec.sweeps.measures import MEASURES, measure

DRAWN = 20_000
"""Designs drawn at most."""

NEXT = 3
_DARK = "#404040"
_BLUE = "#0072B2"


def aim_picture(choice: AimChoice) -> Figure:
    """Draw every design that meets an aim over its measures, and what is chosen of them.

    Of three measures the third is the colour of the points.

    Parameters
    ----------
    choice : AimChoice
    """
    up, across, *third = (measure(name) for name in choice.over)
    coloured = f", coloured by {third[0].said}" if third else ""
    sheet = Sheet(WIDTH, 900)
    sheet.heading(
        f"{up.said[0].upper()}{up.said[1:]} over {across.said}{coloured}: the front is what no "
        f"other design beats in {'all' if third else 'both'}",
        f"{words.plural(choice.plan.designs, 'design')}, {len(choice.ranked.design):,} of them "
        f"meet what is required  ·  {choice.aim}",
        f"tolerances: {choice.tolerances}",
    )
    ax = sheet.axes(MARGIN, 150, 860, 660)
    handles, coloured_points = _draw(ax, choice)
    open_frame(ax, across.axis, up.axis)
    _arrow(ax, up.high, across.high)
    sheet.legend(handles, 98)
    top = 150.0
    for held, name, colour in (
        (choice.peak, "Peak: the best where nothing is off", VERMILION),
        (choice.robust, "Robust: the best within the tolerances", _BLUE),
    ):
        top = _describe(sheet, choice, held, (name, colour), top)
    if third:
        scale = sheet.axes(1046, top + 24, 358, 14)
        sheet.figure.colorbar(coloured_points, cax=scale, orientation="horizontal")
        sheet.text(1046, top, third[0].axis, color=_DARK)
    return sheet.figure


def _draw(ax: Axes, choice: AimChoice) -> tuple[list[Any], Any]:
    """Draw the designs; return what a legend tells, and the points that a scale belongs to."""
    first, second, *third = choice.over
    y, x = (choice.ranked.values[name] for name in (first, second))
    some = np.arange(len(x))
    if len(some) > DRAWN:
        some = np.random.default_rng(0).choice(len(x), DRAWN, replace=False)
    handles = ax.plot(x[some], y[some], "o", color="#B8B8B8", markersize=4,
                      label="meets what is required")  # fmt: skip
    front = _draw_surface(ax, choice, third[0]) if third else _draw_line(ax, choice)
    handles.append(front)
    following = choice.next(NEXT)
    ring: dict[str, Any] = {"markerfacecolor": "none", "markeredgecolor": "black"}
    handles += ax.plot(following.values[second], following.values[first], "s", markersize=8,
                       label="next three", **ring)  # fmt: skip
    for held, colour, marker, size, name in (
        (choice.peak, VERMILION, "o", 14, "peak"), (choice.robust, _BLUE, "D", 9, "robust"),
    ):  # fmt: skip
        handles += ax.plot(held.values[second], held.values[first], marker, color=colour,
                           markersize=size, markeredgecolor="white", markeredgewidth=1.4,
                           linestyle="none", label=name, zorder=5, clip_on=False)  # fmt: skip
    ax.margins(0.06)
    return handles, front


def _draw_line(ax: Axes, choice: AimChoice) -> Any:
    """Draw the front of two measures."""
    first, second = choice.over
    rising = choice.front.only(np.argsort(choice.front.values[second], kind="stable"))
    way = "steps-pre" if MEASURES[second].high else "steps-post"
    (drawn,) = ax.plot(rising.values[second], rising.values[first], ".-", label="front",
                       color="black", linewidth=1.6, markersize=8, drawstyle=way)  # fmt: skip
    return drawn


def _draw_surface(ax: Axes, choice: AimChoice, third: str) -> Any:
    """Draw the front of three measures, the third as colour."""
    first, second, _ = choice.over
    values = choice.front.values
    return ax.scatter(values[second], values[first], s=26, c=values[third], cmap="viridis",
                      edgecolors="black", linewidths=0.5, label="front", zorder=3)  # fmt: skip


def _arrow(ax: Axes, up: bool, right: bool) -> None:
    """Show which way is better, in the corner that is the best."""
    x, y = (0.965 if right else 0.035), (0.955 if up else 0.045)
    ax.annotate(
        "better", (x, y), (x - (0.075 if right else -0.075), y - (0.085 if up else -0.085)),
        xycoords="axes fraction", textcoords="axes fraction", ha="center", va="center",
        color=_DARK, fontsize=10, bbox={"facecolor": "white", "edgecolor": "none", "pad": 2},
        zorder=6, arrowprops={"arrowstyle": "->", "color": _DARK},
    )  # fmt: skip


def _describe(
    sheet: Sheet, choice: AimChoice, held: Held, head: tuple[str, str], top: float
) -> float:
    """Write down a design, a line each; return where the next one begins."""
    left, right = 1046.0, 1404.0
    sheet.text(left, top, head[0], fontsize=12, fontweight="bold", color=head[1])
    values = held.values
    names = dict.fromkeys([choice.aim.goal, *choice.over, "hits", "false_blobs"])
    keys = list(choice.plan.values(held.design).items())
    said = [(label(key), words.number(value)) for key, value in keys[:6]]
    if len(keys) > 6:
        said.append((f"and {len(keys) - 6} more keys", "see chosen.json"))
    said.append(("threshold", f"{held.threshold_dn:.5g} DN"))
    for name in names:
        of = f" of {choice.all_of[name]}" if name in choice.all_of else ""
        said.append((MEASURES[name].said, f"{MEASURES[name].shown(values[name])}{of}"))
    said.append(("room within the tolerances", f"{held.room_dn:.1f} DN"))
    for number, (name, value) in enumerate(said, 1):
        short = textwrap.shorten(name, 34, placeholder=" ...")
        sheet.text(left, top + 4 + 23 * number, short, color=_DARK)
        sheet.text(right, top + 4 + 23 * number, value, ha="right")
    return top + 4 + 23 * (len(said) + 1) + 30
