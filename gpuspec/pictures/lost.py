"""Where, and why, the camera sees no light."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from gpuspec.arrays import BESIDE, LOST, Lost
from gpuspec.pictures.page import MARGIN, WIDTH, Sheet, fitted
from gpuspec.pictures.place import draw_codes, millimetres, scale_bar
from gpuspec.pictures.seen import Simulated

LOST_COLOURS = ("#D9D9D9", "#FFFFFF", "#CC79A7", "#E69F00", "#0072B2", "#009E73", "#56B4E9")


def lost_picture(result: Simulated) -> Figure:
    """Draw where, and why, the camera sees no light.

    Returns
    -------
    Figure
        A plan view in the colours of the reasons, with their shares of the image.
    """
    station = result.station
    width, height = fitted(station.shape, WIDTH - 2 * MARGIN, 1000)
    rare = [code for code in (Lost.HIDDEN, Lost.AGAIN) if (result.lost == code).any()]
    top = 118 + 26 * bool(rare)
    sheet = Sheet(WIDTH, top + height + 84)
    counts = np.bincount(result.lost.ravel(), minlength=len(LOST))
    on_part = result.lost.size - counts[BESIDE]
    sheet.heading(
        f"Light is seen on {_share(counts[0], on_part)} of the part in view",
        f"{result.about}  (shares of the image)",
    )
    handles = [
        Patch(
            facecolor=colour,
            edgecolor="#404040",
            linewidth=0.6,
            label=f"{reason} {_share(n, result.lost.size)}",
        )
        for code, (reason, colour, n) in enumerate(zip(LOST, LOST_COLOURS, counts, strict=True))
        if code < Lost.HIDDEN or code in rare
    ]
    left = (WIDTH - width) / 2
    sheet.legend(handles[: Lost.HIDDEN], 76)
    if rare:  # of few parts: named where they are
        sheet.legend(handles[Lost.HIDDEN :], 102)
    ax = sheet.axes(left, top, width, height)
    draw_codes(ax, result.lost, station, LOST_COLOURS)
    if counts[BESIDE] and not station.posed:
        size = station.part.length_mm, station.part.width_mm
        corner = -size[0] / 2, -size[1] / 2
        ax.add_patch(Rectangle(corner, *size, fill=False, linestyle="--", edgecolor="#404040"))
    millimetres(ax)
    scale_bar(ax, 62)
    return sheet.figure


def _share(part: int, whole: int) -> str:
    """Return a percentage in which neither a few pixels nor a few missing ones are hidden."""
    percent = 100 * part / whole if whole else 0.0
    if 0 < percent < 0.01:
        return "< 0.01 %"
    if 99.99 < percent < 100:
        return "> 99.99 %"
    return f"{percent:.4g} %" if percent < 1 else f"{percent:.2f} %".replace(".00 %", " %")
