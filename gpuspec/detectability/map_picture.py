"""The picture of a map: hits and misses over two sizes, a90 and its bound across."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from gpuspec.detectability.mapped import SizeMap
from gpuspec.detectability.picture import is_wide, scale
from gpuspec.detection.chances import CONFIDENCE
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet
from gpuspec.pictures.place import open_frame

_HEIGHT = 800
_FOOT = 84
_WIDE = 1000  # px, of the axes
_ROOM = 0.04  # beyond the sizes tried, of their range


def map_picture(found: SizeMap, lines: Sequence[str] = ()) -> Figure:
    """Draw a map.

    Parameters
    ----------
    found : SizeMap
    lines : sequence of str
        For its heading.
    """
    sheet = Sheet(WIDTH, _HEIGHT)
    lines = [*lines, *(f"note: {text}" for text in found.notes[:2])]
    sheet.heading(f"Map of a90: {found.label}", *lines)
    top = 44 + 24 * len(lines) + 14
    axes = sheet.axes(MARGIN, top, _WIDE, _HEIGHT - top - _FOOT)
    hit, small = found.hit, 5 if len(found.hit) < 3000 else 3
    count = f"{hit.sum():,} hits", f"{(~hit).sum():,} misses"
    for some, mark, colour, face, label in (
        (hit, "o", SKY, SKY, count[0]), (~hit, "x", VERMILION, VERMILION, count[1]),
    ):  # fmt: skip
        axes.plot(
            found.b[some], found.a[some], mark, color=colour, markerfacecolor=face,
            markersize=small, alpha=0.75, label=label,
        )  # fmt: skip
    shown = (
        (found.a90, "-", 2.4, "a90"),
        (found.a90_95, (0, (5, 3)), 1.8, f"a90/95, {100 * CONFIDENCE:.0f} % bound"),
    )
    for sizes, style, width, label in shown:
        inside = found.within(sizes)
        label += "" if np.isfinite(inside).any() else ": none here"
        axes.plot(found.at, inside, color="black", linestyle=style, linewidth=width, label=label)
    axes.plot(
        found.at, found.high, color="#606060", linestyle=":", linewidth=1, label="range tried"
    )
    axes.plot(found.at, found.low, color="#606060", linestyle=":", linewidth=1)
    open_frame(axes, found.second.label, found.first.label)
    for axis, sizes in (("x", found.b), ("y", found.a)):
        low, high = float(sizes.min()), float(sizes.max())
        scale(axes, axis, low, high)
        ends = np.log([low, high]) if is_wide(low, high) else np.array([low, high])
        ends += _ROOM * np.ptp(ends) * np.array([-1, 1])
        axes.set(**{f"{axis}lim": np.exp(ends) if is_wide(low, high) else ends})
    axes.legend(
        loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False, fontsize=10, borderaxespad=0,
        title=found.surface.method.replace("first size", found.first.name).replace(
            "second size", found.second.name
        ).replace(" by Firth", "\nby Firth"), title_fontsize=10, alignment="left",
    )  # fmt: skip
    return sheet.figure
