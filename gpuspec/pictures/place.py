"""How an image is brought onto a page, in the part frame: x along the columns, y up, mm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba_array
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, pooled
from gpuspec.pictures.page import length_text, scale_length
from gpuspec.pictures.seen import Levelled
from gpuspec.station.station import Station

_TICK_PX = 75, 34  # least distance of labelled ticks along x and y
_STEPS = 1, 2, 2.5, 5, 10
GREY = matplotlib.colormaps["gray"].with_extremes(bad="white", under="black")


def reduction(ax: Axes, shape: tuple[int, ...]) -> int:
    """Return by how much an image must be reduced to have no more pixels than its axes.

    Parameters
    ----------
    ax : Axes
    shape : tuple of int
        Of the image, (M, N).
    """
    box = ax.get_window_extent()
    return max(1, math.ceil(shape[0] / box.height), math.ceil(shape[1] / box.width))


def place_image(
    ax: Axes, image: NDArray[Any], factor: int, station: Station, **style: Any
) -> AxesImage:
    """Draw a reduced image where it lies in the part frame.

    Parameters
    ----------
    ax : Axes
    image : ndarray, shape (ceil(M / factor), ceil(N / factor))
    factor : int
        By which it was reduced.
    station : Station
        Of image shape (M, N).
    **style
        As matplotlib's ``Axes.imshow`` takes it.
    """
    (rows, columns), p = station.shape, station.camera.sampling_mm
    right, top = columns * p / 2, rows * p / 2
    extent = (
        -right,
        image.shape[1] * factor * p - right,
        top - image.shape[0] * factor * p,
        top,
    )
    drawn = ax.imshow(image, extent=extent, aspect="auto", **style)
    ax.set(xlim=(-right, right), ylim=(-top, top))
    return drawn


def draw_grey(
    ax: Axes,
    image: NDArray[np.float32],
    station: Station,
    low: float,
    high: float,
    lost: NDArray[np.uint8] | None = None,
) -> AxesImage:
    """Draw grey levels.

    Parameters
    ----------
    ax : Axes
    image : ndarray of float32, shape (M, N)
        In DN.
    station : Station
    low, high : float
        What is black and what is white, DN.
    lost : ndarray of uint8, shape (M, N), optional
        Why pixels see no light: what is beside the part stays white.
    """
    factor = reduction(ax, image.shape)
    grey = pooled(image, factor, np.add)
    if lost is not None and (beside := lost == BESIDE).any():
        grey = np.ma.masked_array(grey, pooled(beside, factor, np.minimum))
    style = {"interpolation": "nearest"} if factor == 1 else {"interpolation": "bilinear"}
    return place_image(ax, grey, factor, station, cmap=GREY, vmin=low, vmax=high, **style)


def draw_codes(
    ax: Axes, codes: NDArray[np.uint8], station: Station, colours: Sequence[str]
) -> None:
    """Draw an image of small integers in one colour each; the highest prevails.

    Parameters
    ----------
    ax : Axes
    codes : ndarray of uint8, shape (M, N)
        Indices into `colours`.
    station : Station
    colours : sequence of str
    """
    factor = reduction(ax, codes.shape)
    # As colours already: a colour map goes by way of real numbers, in three times the time.
    table = np.rint(to_rgba_array(list(colours)) * 255).astype(np.uint8)
    image = table[pooled(codes, factor, np.maximum)]
    place_image(ax, image, factor, station, interpolation="nearest")


def grey_range(result: Levelled) -> tuple[float, float]:
    """Return the grey levels drawn black and white: flawless a third of the way, white far
    enough above the threshold, so that a faint defect shows beside one that saturates.
    """
    flawless, full = result.flawless_dn, result.station.sensor.full_scale_dn
    far = flawless + max(8 * (result.threshold - flawless), 0.2 * full)
    return range_up_to(min(float(result.aspect.max()), far), result, 0.1)


def range_up_to(high: float, result: Levelled, least: float) -> tuple[float, float]:
    """Return a range that ends past the threshold and `least` of full scale above flawless, for
    an even image is not to look rough; but never past full scale, which is white.

    Parameters
    ----------
    high : float
        What is to be in the range, DN.
    result : Levelled
    least : float
        Share of full scale.

    Returns
    -------
    low, high : float
        In DN.
    """
    flawless, full = result.flawless_dn, result.station.sensor.full_scale_dn
    high = max(high, min(result.threshold, full), flawless + least * full)
    return max(0.0, flawless - (high - flawless) / 2), min(high, full)


def millimetres(ax: Axes) -> None:
    """Label axes in the part frame; a side too short for ticks is told by its ends alone."""
    ax.tick_params(labelsize=9.5)
    box = ax.get_window_extent()
    for axis, side, pitch, end in (
        (ax.xaxis, box.width, _TICK_PX[0], ax.get_xlim()[1]),
        (ax.yaxis, box.height, _TICK_PX[1], ax.get_ylim()[1]),
    ):
        name = f"{axis.axis_name}, mm"
        if side >= 2 * pitch:
            axis.set_major_locator(tick_locator(side, pitch))
            axis.set_label_text(name, fontsize=10)
        else:
            axis.set_ticks([])
            axis.set_label_text(f"{name}\n±{end:.4g}", fontsize=10)
            axis.labelpad = 18 if axis is ax.yaxis else 8  # clear of the other side's ticks
    if box.height >= 2 * _TICK_PX[1]:
        ax.yaxis.labelpad = 2
    else:
        ax.yaxis.label.set(rotation=0, ha="right", va="center", multialignment="center")


def tick_locator(px: float, pitch: float = _TICK_PX[0]) -> MaxNLocator:
    """Return round places for as many labelled ticks as a side of so many px has room for.

    Parameters
    ----------
    px : float
        Length of the side.
    pitch : float
        Least distance of two ticks, px.
    """
    return MaxNLocator(min(max(int(px / pitch), 2), 9), steps=_STEPS)


def scale_bar(ax: Axes, below: float, share: float = 0.2) -> None:
    """Draw a bar of a round length under the right end of the axes.

    Parameters
    ----------
    ax : Axes
        In mm along x.
    below : float
        How far down, px.
    share : float
        Of the axes' width that the bar takes, about.
    """
    low, high = ax.get_xlim()
    length = scale_length(high - low, ax.get_window_extent().width, share)
    y = -below / ax.get_window_extent().height
    where = ax.get_xaxis_transform()
    # One longer than the axes begins with them: there may be no room at their left.
    start = max(high - length, low)
    ax.plot(
        [start, start + length],
        [y, y],
        transform=where,
        clip_on=False,
        color="black",
        linewidth=3,
        solid_capstyle="butt",
        scalex=False,
        scaley=False,
    )
    ax.annotate(
        length_text(length),
        (start, y) if length < high - low else (start + length, y),
        xycoords=where,
        xytext=(-5, 0) if length < high - low else (5, 0),
        textcoords="offset points",
        ha="right" if length < high - low else "left",
        va="center",
        fontsize=9.5,
        annotation_clip=False,
    )


def open_frame(ax: Axes, x: str, y: str) -> None:
    """Label axes of curves, and leave their frame open above and to the right.

    Parameters
    ----------
    ax : Axes
    x, y : str
        Labels.
    """
    ax.xaxis.set_major_locator(tick_locator(ax.get_window_extent().width))
    ax.set_xlabel(x, fontsize=10)
    ax.set_ylabel(y, fontsize=10)
    ax.tick_params(labelsize=9.5)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="#E4E4E4", linewidth=0.8)
    ax.set_axisbelow(True)
