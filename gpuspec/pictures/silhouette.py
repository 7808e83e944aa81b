"""The part's outline against the nominal one: what is missing, what is extra, and where."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from gpuspec.frames.silhouette import Find, Silhouette
from gpuspec.pictures.page import MARGIN, VERMILION, WIDTH, Sheet, fitted
from gpuspec.pictures.place import draw_codes, millimetres, scale_bar
from gpuspec.station.station import Station
from gpuspec.words import plural

_COLOURS = ("#FFFFFF", "#D9D9D9", VERMILION, "#0072B2")  # beside, part, missing, extra
_LARGE = 6  # finds drawn enlarged
_SIDE, _GAP = 196.0, 26.0  # of their views, px
_ROOM = 1.0  # around a find, of its size


def silhouette_picture(found: Silhouette, station: Station, about: str) -> Figure:
    """Draw a part's outline against the nominal one, and its largest differences enlarged.

    Parameters
    ----------
    found : Silhouette
    station : Station
        Of its image.
    about : str
        Which frames, for the line under the heading.

    Returns
    -------
    Figure
    """
    width, height = fitted(station.shape, WIDTH - 2 * MARGIN, 760)
    large = found.finds[:_LARGE]
    below = 118 + height + 96
    sheet = Sheet(WIDTH, below + (_SIDE + 92 if large else 0))
    missing, extra = (
        [one.area_mm2 for one in found.finds if one.kind == kind] for kind in ("missing", "extra")
    )
    sheet.heading(f"Outline: {sum(missing):.3g} mm² missing, {sum(extra):.3g} mm² extra", about)
    sheet.legend(
        [
            Patch(facecolor=_COLOURS[1], edgecolor="#404040", linewidth=0.6, label="part"),
            Patch(facecolor=_COLOURS[2], label=f"missing, at {plural(len(missing), 'place')}"),
            Patch(facecolor=_COLOURS[3], label=f"extra, at {plural(len(extra), 'place')}"),
            Line2D([], [], color="black", linestyle="--", linewidth=1, label="nominal outline"),
        ],
        76,
    )
    codes = found.outline.astype(np.uint8)
    for number, one in enumerate(found.finds, 1):
        codes[found.labels == number] = 2 if one.kind == "missing" else 3
    ax = sheet.axes((WIDTH - width) / 2, 118, width, height)
    draw_codes(ax, codes, station, _COLOURS)
    _draw_outline(ax, found.nominal, station)
    millimetres(ax)
    scale_bar(ax, 62)
    left = (WIDTH - len(large) * _SIDE - (len(large) - 1) * _GAP) / 2
    for number, one in enumerate(large, 1):
        half = max(one.width_mm, one.depth_mm, 8 * station.camera.sampling_mm) * (0.5 + _ROOM / 2)
        corner = one.x_mm - half, one.y_mm - half
        ax.add_patch(Rectangle(corner, 2 * half, 2 * half, fill=False, linewidth=1))
        ax.annotate(
            str(number), (one.x_mm, one.y_mm + (half if one.y_mm < 0 else -half)),
            xytext=(0, 3 if one.y_mm < 0 else -3), textcoords="offset points",
            ha="center", va="bottom" if one.y_mm < 0 else "top", fontsize=10,
        )  # fmt: skip
        view = sheet.axes(left + (number - 1) * (_SIDE + _GAP), below + 24, _SIDE, _SIDE)
        _draw_find(view, codes, found, one, half, station)
        view.set_title(f"{number}: {one.kind}", fontsize=10, loc="left", pad=4)
        view.set_xlabel(
            f"{one.area_mm2:.3g} mm², {one.area_px:,} px\n"
            f"{one.width_mm:.3g} mm, {one.depth_mm:.3g} mm deep",
            fontsize=9.5,
        )
    return sheet.figure


def _draw_find(
    ax: Axes, codes: NDArray[np.uint8], found: Silhouette, one: Find, half: float, station: Station
) -> None:
    """Draw the surroundings of one find, pixel by pixel."""
    (rows, columns), p = station.shape, station.camera.sampling_mm
    middle = rows / 2 - one.y_mm / p, columns / 2 + one.x_mm / p
    top, left = (max(int(at - half / p), 0) for at in middle)
    bottom, right = (int(at + half / p) + 1 for at in middle)
    colours = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _COLOURS], np.uint8)
    shown = colours[codes[top:bottom, left:right]]
    high, wide = shown.shape[:2]
    x, y = (left - columns / 2) * p, (rows / 2 - top) * p
    ax.imshow(
        shown, extent=(x, x + wide * p, y - high * p, y), interpolation="nearest", aspect="auto"
    )
    _draw_outline(ax, found.nominal, station, (slice(top, bottom), slice(left, right)))
    ax.set(xticks=[], yticks=[])
    ax.set_xlim(one.x_mm - half, one.x_mm + half)
    ax.set_ylim(one.y_mm - half, one.y_mm + half)


def _draw_outline(
    ax: Axes,
    nominal: NDArray[np.bool_],
    station: Station,
    window: tuple[slice, slice] = (slice(None), slice(None)),
) -> None:
    """Draw the border of a mask, or of a piece of it, where it lies in the part frame."""
    (rows, columns), p = station.shape, station.camera.sampling_mm
    step = max(1, max(nominal[window].shape) // 1500)
    piece = nominal[window][::step, ::step]
    top, left = (piece_slice.start or 0 for piece_slice in window)
    x = (left + np.arange(piece.shape[1]) * step + 0.5 - columns / 2) * p
    y = (rows / 2 - top - np.arange(piece.shape[0]) * step - 0.5) * p
    limits = ax.get_xlim(), ax.get_ylim()
    if piece.any() and not piece.all():
        ax.contour(x, y, piece, [0.5], colors="black", linestyles="--", linewidths=1)
    ax.set(xlim=limits[0], ylim=limits[1])
