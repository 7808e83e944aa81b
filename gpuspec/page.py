"""The page every picture is laid out on, and how an image is brought onto it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from gpuspec.backends import BESIDE
from gpuspec.patterns import Pattern
from gpuspec.station import Station

if TYPE_CHECKING:
    from gpuspec.inspection import Result

NOTES = 60  # px at the foot of a page, where something is to be known of what it shows
DPI = 110
WIDTH = 1500  # px, of a page
MARGIN = 96  # px, left and right of what is drawn
SMALLEST = 9.0  # points, letters
BAR_PX_MIN = 50
_EDGE = 12  # px, free at the right of a line
_TICK_PX = 75, 34  # least distance of labelled ticks along x and y
_STEPS = 1, 2, 2.5, 5, 10
# M. Okabe, K. Ito, Color universal design (2008): told apart by colour-blind readers too.
SKY, VERMILION, YELLOW = "#56B4E9", "#D55E00", "#F0E442"

GREY = matplotlib.colormaps["gray"].with_extremes(bad="white", under="black")


class Sheet:
    """A white page laid out in pixels from its top left corner."""

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self.figure = Figure((width / DPI, height / DPI), dpi=DPI, facecolor="white")

    def axes(self, left: float, top: float, width: float, height: float) -> Axes:
        """Add axes whose frame is this box."""
        return self.figure.add_axes(
            (
                left / self.width,
                1 - (top + height) / self.height,
                width / self.width,
                height / self.height,
            )
        )

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        """Write text whose top left corner is here."""
        style = {"ha": "left", "va": "top", "fontsize": 10, **style}
        self.figure.text(x / self.width, 1 - y / self.height, text, **style)

    def heading(self, title: str, *lines: str) -> None:
        """Write a bold title and lines under it, 24 px each; what is too long, in small letters."""
        self._line(14, title, fontsize=13, fontweight="bold")
        for number, line in enumerate(lines):
            self._line(44 + 24 * number, line, color="#404040")

    def notes(self, said: Sequence[str]) -> None:
        """Write the first note at the foot of the page, in two lines, and where the others are."""
        if not said:
            return
        more = f" (1 of {len(said)} notes in score.json)" if len(said) > 1 else ""
        text = textwrap.shorten(f"note: {said[0]}", 290 - len(more), placeholder=" …") + more
        self.text(
            MARGIN, self.height - NOTES + 8, "\n".join(textwrap.wrap(text, 150)), color=VERMILION
        )

    def legend(self, handles: Sequence[Any], top: float) -> None:
        """Put a legend of one line under the heading; a long one is drawn closer and smaller."""
        labels = [str(handle.get_label()) for handle in handles]
        room = self.width - MARGIN - _EDGE
        symbols = 1.6 + 0.8  # of the letters' size, with what stands between symbol and label
        for size, spacing in ((10.0, 1.8), (10.0, 1.2), (SMALLEST, 1.2)):
            letters = sum(text_width(label, size) for label in labels)
            between = spacing * (len(labels) - 1) + symbols * len(labels)
            if letters + between * size / 72 * DPI <= room:
                break
        self.figure.legend(
            handles=list(handles),
            loc="upper left",
            bbox_to_anchor=(MARGIN / self.width, 1 - top / self.height),
            ncols=len(handles),
            frameon=False,
            borderaxespad=0,
            borderpad=0,
            handlelength=1.6,
            columnspacing=spacing,
            fontsize=size,
        )

    def _line(self, y: float, text: str, **style: Any) -> None:
        """Write a line that ends on the page: with smaller letters, else with an ellipsis."""
        size, weight = style.pop("fontsize", 10.0), style.get("fontweight", "normal")
        room = self.width - MARGIN - _EDGE
        while size > SMALLEST and text_width(text, size, weight) > room:
            size -= 0.5
        while (wide := text_width(text, size, weight)) > room:
            text = text[: min(int(len(text) * room / wide), len(text) - 2) - 1] + "…"
        self.text(MARGIN, y, text, fontsize=size, **style)


def text_width(text: str, size: float, weight: str = "normal") -> float:
    """Return how wide a line of text is, px; `size` is that of its letters, points."""
    font = FontProperties(size=size, weight=weight)
    renderer: Any = RendererAgg
    width, _, _ = renderer(1, 1, DPI).get_text_width_height_descent(text, font, ismath=False)
    return float(width)


def essentials(station: Station, pattern: Pattern | None = None) -> str:
    """Return what matters most of a station, in one line; `pattern` is its light if not stripes."""
    part, tunnel, camera = station.part, station.tunnel, station.camera
    kind = "crowned part" if part.crown_radius_x_mm or part.crown_radius_y_mm else "flat part"
    if part.relief:
        kind = "measured relief"
    stripes = f"stripes {tunnel.luminous_mm:g} + {tunnel.dark_mm:g} mm"
    light = f"light {pattern.file}" if pattern else stripes
    return (
        f"{kind} {part.length_mm:g} × {part.width_mm:g} mm  ·  "
        f"{tunnel.section} at {tunnel.top_mm:g} mm, {light}  ·  "
        f"camera at {camera.height_mm:g} mm, {camera.sampling_mm:g} mm/px, "
        f"pupil {camera.pupil_mm:g} mm  ·  exposure {station.sensor.exposure:g}, "
        f"{station.sequence.images} images"
    )


def fitted(shape: tuple[int, int], width: float, height: float) -> tuple[int, int]:
    """Return the largest box (width, height) in px of an image's proportions, 2 px at least."""
    scale = min(width / shape[1], height / shape[0])
    return max(round(scale * shape[1]), 2), max(round(scale * shape[0]), 2)


def round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not longer."""
    decade = float(10.0 ** math.floor(math.log10(length)))
    return max(m for m in (1, 2, 5) if m * decade <= length * (1 + 1e-9)) * decade


def scale_length(mm: float, px: float, share: float = 0.2) -> float:
    """Return a round length for a scale bar: a share of a side, but one that can be seen, mm."""
    return round_length(mm * max(share, BAR_PX_MIN / px))


def length_text(mm: float) -> str:
    """Return a length with the unit that suits it."""
    return f"{mm:g} mm" if mm >= 0.1 else f"{1000 * mm:g} µm"


def pooled(image: NDArray[Any], factor: int, by: np.ufunc) -> NDArray[Any]:
    """Reduce squares of `factor` pixels by np.add (to their mean), np.maximum or np.minimum."""
    if factor == 1:
        return image
    # Whole slices, rows then columns: far faster than reduceat, and the last square may be small.
    for _ in range(2):
        length = image.shape[0]
        reduced = image[::factor].copy()
        for start in range(1, factor):
            others = image[start::factor]
            by(reduced[: len(others)], others, out=reduced[: len(others)])
        if by is np.add:
            counts = np.minimum(factor, length - np.arange(0, length, factor))
            reduced /= counts.astype(np.float32)[:, None]
        image = reduced.T
    return image


def grey_png(image: NDArray[Any], full: float, width: int = 1200) -> bytes:
    """Return an image as a PNG, reduced to a width, black at 0 and white at `full`."""
    from io import BytesIO

    from PIL import Image

    factor = max(1, math.ceil(max(image.shape) / width))
    grey = pooled(image, factor, np.add) * (255 / full)
    file = BytesIO()
    Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save(file, "PNG")
    return file.getvalue()


def reduction(ax: Axes, shape: tuple[int, ...]) -> int:
    """Return by how much an image must be reduced to have no more pixels than its axes."""
    box = ax.get_window_extent()
    return max(1, math.ceil(shape[0] / box.height), math.ceil(shape[1] / box.width))


def place_image(
    ax: Axes, image: NDArray[Any], factor: int, station: Station, **style: Any
) -> AxesImage:
    """Draw a reduced image where it lies in the part frame."""
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
    """Draw grey levels; what is beside the part stays white if `lost` is given."""
    factor = reduction(ax, image.shape)
    grey = pooled(image, factor, np.add)
    if lost is not None:
        grey = np.ma.masked_array(grey, pooled(lost == BESIDE, factor, np.minimum))
    style = {"interpolation": "nearest"} if factor == 1 else {"interpolation": "bilinear"}
    return place_image(ax, grey, factor, station, cmap=GREY, vmin=low, vmax=high, **style)


def draw_codes(
    ax: Axes, codes: NDArray[np.uint8], station: Station, colours: Sequence[str]
) -> None:
    """Draw an image of small integers in one colour each; the highest prevails."""
    factor = reduction(ax, codes.shape)
    colourmap: Colormap = ListedColormap(list(colours))
    place_image(
        ax,
        pooled(codes, factor, np.maximum),
        factor,
        station,
        cmap=colourmap,
        vmin=-0.5,
        vmax=len(colours) - 0.5,
        interpolation="nearest",
    )


def grey_range(result: Result) -> tuple[float, float]:
    """Return the grey levels drawn black and white: flawless a third of the way, white far
    enough above the threshold, so that a faint defect shows beside one that saturates.
    """
    flawless, full = result.flawless_dn, result.station.sensor.full_scale_dn
    far = flawless + max(8 * (result.threshold - flawless), 0.2 * full)
    return range_up_to(min(float(result.aspect.max()), far), result, 0.1)


def range_up_to(high: float, result: Result, least: float) -> tuple[float, float]:
    """Return a range that ends past the threshold and `least` of full scale above flawless, for
    an even image is not to look rough; but never past full scale, which is white.
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
    """Return round places for as many labelled ticks as a side of so many px has room for."""
    return MaxNLocator(min(max(int(px / pitch), 2), 9), steps=_STEPS)


def scale_bar(ax: Axes, below: float, share: float = 0.2) -> None:
    """Draw a bar of a round length under the right end of the axes, `below` px down."""
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
    """Label axes of curves, and leave their frame open above and to the right."""
    ax.xaxis.set_major_locator(tick_locator(ax.get_window_extent().width))
    ax.set_xlabel(x, fontsize=10)
    ax.set_ylabel(y, fontsize=10)
    ax.tick_params(labelsize=9.5)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="#E4E4E4", linewidth=0.8)
    ax.set_axisbelow(True)
