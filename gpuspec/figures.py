"""Pictures of a simulated inspection, for a person to look at.

Each is a `matplotlib.figure.Figure`, or a GIF, in the part frame: mm, x along the columns, y up.
Images larger than their box on the page are reduced before they are drawn, grey levels by their
mean, zones and blobs by their maximum, so that no defect disappears and memory stays small.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import FuncFormatter, NullFormatter
from matplotlib.transforms import Transform
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from gpuspec.backends import BESIDE, LOST
from gpuspec.drawing import MARGIN, WIDTH, Sheet, essentials, station_drawing
from gpuspec.measures import measure_blobs
from gpuspec.station import Station

if TYPE_CHECKING:
    from gpuspec.inspection import Result
    from gpuspec.truth import KnownDefect

__all__ = [
    "PICTURES",
    "aspect_picture",
    "detection_picture",
    "histogram_picture",
    "lost_picture",
    "png",
    "sequence_animation",
    "sequence_strip",
    "station_picture",
]

GREY = matplotlib.colormaps["gray"].with_extremes(bad="white", under="black")

# M. Okabe, K. Ito, Color universal design (2008): told apart by colour-blind readers too.
SKY, VERMILION, YELLOW = "#56B4E9", "#D55E00", "#F0E442"
KINDS = {"hit": SKY, "false": YELLOW, "missed": VERMILION}  # by rising priority
LOST_COLOURS = ("#D9D9D9", "#FFFFFF", "#CC79A7", "#E69F00", "#0072B2")

LETTERS = "abcdef"
DETAILS = len(LETTERS)
BOXES_MAX = 400  # of one kind; more would hide the image
FRAME_MS = 120


@dataclass(frozen=True)
class _Find:
    """A defect or false blob, where it is, and what is said of it."""

    kind: str
    rows: tuple[int, int]
    columns: tuple[int, int]
    caption: str
    urgency: float


def sequence_strip(result: Result, count: int = 6) -> Figure:
    """Draw images of the sequence, spread evenly over one period, on one grey scale.

    Parameters
    ----------
    result : Result
        The inspection.
    count : int
        Number of images at most.

    Returns
    -------
    Figure
    """
    station = result.station
    chosen = _spread(station, count)
    columns, (width, height) = _grid(len(chosen), station.shape)
    rows = math.ceil(len(chosen) / columns)
    left = max(MARGIN, (WIDTH - columns * width - (columns - 1) * 24) / 2)
    sheet = Sheet(WIDTH, 76 + rows * (height + 34) + 76)
    period = station.tunnel.period_mm
    sheet.heading(
        f"{len(chosen)} of {station.sequence.images} images: the tunnel moves along x, "
        f"one period of {period:g} mm",
        essentials(station),
    )
    full = station.sensor.full_scale_dn
    for place, k in enumerate(chosen):
        row, column = divmod(place, columns)
        x, y = left + column * (width + 24), 76 + row * (height + 34)
        ax = sheet.axes(x, y + 26, width, height)
        drawn = _draw_grey(ax, result.light_map.image(k), station, 0, full)
        ax.set(xticks=[], yticks=[])
        sheet.text(x, y + 4, f"k = {k}    shift {k * station.step_mm:.2f} mm")
    _scale_bar(ax, 12)
    bar = sheet.axes(left, sheet.height - 52, 300, 14)
    sheet.figure.colorbar(drawn, cax=bar, orientation="horizontal")
    bar.text(1.04, 0.5, "grey level, DN", transform=bar.transAxes, va="center", fontsize=10)
    return sheet.figure


def sequence_animation(
    result: Result, path_or_file: str | Path | BinaryIO, frames: int = 20, width: int = 1000
) -> None:
    """Write the sequence over one period as an animated GIF that repeats.

    Parameters
    ----------
    result : Result
        The inspection.
    path_or_file : str, Path or binary file
        Where to write.
    frames : int
        Number of frames at most.
    width : int
        Widest and highest the images may be, px.
    """
    station = result.station
    rows, columns = station.shape
    factor = max(1, math.ceil(max(rows, columns) / width))
    zoom = max(1, min(width, 400) // max(rows, columns))
    font = ImageFont.truetype(
        str(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"), 15
    )
    bar = _round_length(columns * station.camera.sampling_mm / 5)
    px_per_mm = zoom / factor / station.camera.sampling_mm
    pages = []
    for k in _spread(station, frames):
        grey = _pooled(result.light_map.image(k), factor, np.add)
        # 64 grey levels look the same and make a smaller file.
        level = np.clip(grey * (64 / station.sensor.full_scale_dn), 0, 63).astype(np.uint8)
        level = level * 4 + level // 16
        picture = Pillow.fromarray(level.repeat(zoom, 0).repeat(zoom, 1))
        page = Pillow.new("L", (max(picture.width, 360), picture.height + 56), 255)
        left = (page.width - picture.width) // 2
        page.paste(picture, (left, 28))
        pen = ImageDraw.Draw(page)
        pen.rectangle((left, 28, left + picture.width - 1, 27 + picture.height), outline=0)
        pen.text((4, 4), f"image {k} of {station.sequence.images}", 0, font)
        shift = f"shift {k * station.step_mm:.2f} mm of {station.tunnel.period_mm:g} mm"
        pen.text((page.width - 4, 4), shift, 0, font, "ra")
        base = page.height - 14
        pen.rectangle((left, base - 2, left + round(bar * px_per_mm), base + 1), 0)
        pen.text((left + bar * px_per_mm + 8, base), _length(bar), 0, font, "lm")
        pages.append(page)
    pages[0].save(
        path_or_file,
        "GIF",
        save_all=True,
        append_images=pages[1:],
        duration=FRAME_MS,
        loop=0,
    )


def aspect_picture(result: Result) -> Figure:
    """Draw the aspect image with its grey scale.

    Returns
    -------
    Figure
    """
    station = result.station
    width, height = _fit(station.shape, WIDTH - 2 * MARGIN - 70, 1000)
    sheet = Sheet(WIDTH, 106 + height + 84)
    sheet.heading(
        f"Aspect image: {station.sequence.fusion} of {station.sequence.images} images",
        essentials(station),
        f"flawless level {result.flawless_dn:.1f} DN  ·  threshold {result.threshold:.1f} DN  ·  "
        f"full scale {station.sensor.full_scale_dn} DN  ·  {result.info}",
    )
    left = (WIDTH - 70 - width) / 2
    ax = sheet.axes(left, 106, width, height)
    low, high = _grey_range(result)
    drawn = _draw_grey(ax, result.aspect, station, low, high, result.lost)
    _millimetres(ax)
    _scale_bar(ax, 62)
    bar = sheet.axes(left + width + 20, 106, 16, height)
    dark, bright = result.aspect.min() < low, result.aspect.max() > high
    extend = "both" if dark and bright else "min" if dark else "max" if bright else "neither"
    sheet.figure.colorbar(drawn, cax=bar, extend=extend, extendfrac=0.03)
    bar.set_ylabel("grey level, DN", fontsize=10)
    return sheet.figure


def detection_picture(result: Result) -> Figure:
    """Draw what is detected, missed and false over the aspect image, and details of each.

    Returns
    -------
    Figure
        Zones of defects that are hit or missed, and false blobs, filled and in a box; beside them
        up to six details: missed defects first, the largest zone first, then false blobs, the
        largest first, then hits, the least covered first.
    """
    station, score = result.station, result.score
    finds = _finds(result)
    shown = finds[:DETAILS]
    rows, columns = station.shape
    below = columns >= 1.5 * rows
    top, gap, caption = 118, 34, 90  # px, the last above and below each detail
    room = WIDTH - 2 * MARGIN
    reserved = 0 if below or not shown else 520
    width, height = _fit(station.shape, room - reserved, 800)
    left = MARGIN if reserved else (WIDTH - width) / 2
    if below:
        per_row, details_left, details_top = DETAILS, float(MARGIN), top + height + 86
        side = (room - (per_row - 1) * gap) / per_row
    else:
        per_row = 3 if 3 * width < room else 2
        details_left, details_top = left + width + 60, top
        side = min(
            (WIDTH - MARGIN - details_left + gap) / per_row - gap,
            (height + 30) * per_row / DETAILS - caption,
        )
    bottom = details_top + math.ceil(len(shown) / per_row) * (side + caption)
    sheet = Sheet(WIDTH, max(top + height + 84, bottom + 10))
    p2, f1 = ("undefined" if v is None else f"{v:.3f}" for v in (score.p2, score.f1))
    sheet.heading(
        f"Detection: P1 {score.p1:.3f} (overdetection)   P2 {p2} (misdetection)   F1 {f1}",
        essentials(station),
    )
    counts = {
        "hit": f"defect hit ({score.defects_hit} of {score.defects})",
        "missed": f"defect missed ({score.defects - score.defects_hit} of {score.defects}"
        + (f", {score.unseen} unseen)" if score.unseen else ")"),
        "false": f"false blob ({score.false_blobs} of {score.blobs})",
    }
    handles: list[Any] = [
        Patch(facecolor=KINDS[kind], edgecolor="#404040", linewidth=0.6, label=label)
        for kind, label in counts.items()
    ]
    if shown:
        label = f"detected, above {result.threshold:.1f} DN, in the details"
        outline = Line2D([], [], color="white", linewidth=1.4, label=label)
        outline.set_path_effects(_halo())
        handles.append(outline)
    sheet.legend(handles, 76)

    low, high = _grey_range(result)
    ax = sheet.axes(left, top, width, height)
    _draw_grey(ax, result.aspect, station, low, high, result.lost)
    codes = _codes(result)
    _draw_codes(ax, codes, station, ["#00000000", *KINDS.values()])
    _draw_boxes(ax, finds, station)
    _millimetres(ax)
    _scale_bar(ax, 62)
    _name_boxes(ax, shown, station)
    for place, find in enumerate(shown):
        row, column = divmod(place, per_row)
        x = details_left + column * (side + gap)
        detail = sheet.axes(x, details_top + 58 + row * (side + caption), side, side)
        _draw_detail(detail, find, result, codes)
        letter = LETTERS[place]
        detail.set_title(find.caption, fontsize=9, loc="left", pad=6)
        _write_letter(detail, letter, (0.09, 0.91), detail.transAxes)
    return sheet.figure


def histogram_picture(result: Result) -> Figure:
    """Draw how often each grey level of the aspect image comes, inside and outside the zones.

    Returns
    -------
    Figure
        Over the pixels on the part, as they are scored.
    """
    full = result.station.sensor.full_scale_dn
    low, high = float(result.aspect.min()), float(result.aspect.max())
    low = min(low, result.flawless_dn)
    high = max(high, result.threshold)
    margin = max(0.04 * (high - low), 0.005 * full)
    low, high = max(low - margin, 0), min(high + margin, full)
    bins = 240
    bin_of = ((result.aspect - np.float32(low)) * np.float32(bins / (high - low))).astype(np.int16)
    np.clip(bin_of, 0, bins - 1, out=bin_of)
    # Both counts in one pass: bins of the zones come after those outside, unscored pixels last.
    bin_of[result.truth != 0] += bins
    bin_of[result.lost == BESIDE] = 2 * bins
    outside, inside = np.bincount(bin_of.ravel(), minlength=2 * bins + 1)[:-1].reshape(2, bins)

    sheet = Sheet(WIDTH, 660)
    sheet.heading("Grey levels of the aspect image", essentials(result.station))
    ax = sheet.axes(MARGIN + 20, 108, WIDTH - 2 * MARGIN - 20, 480)
    edges = np.linspace(low, high, bins + 1)
    score = result.score
    for counts, colour, name, above in (
        (outside, "#8C8C8C", "outside the zones", score.false_px),
        (inside, VERMILION, "inside the zones", score.hit_px),
    ):
        label = f"{name}: {counts.sum():,} px, {above:,} detected"
        if counts.any():
            ax.stairs(counts, edges, baseline=0.5, fill=True, color=colour, alpha=0.35)
            ax.stairs(counts, edges, baseline=0.5, color=colour, linewidth=1.4, label=label)
        else:
            ax.plot([], [], color=colour, label=label)
    for level, style, name in (
        (result.flawless_dn, ":", "flawless level"),
        (result.threshold, "--", "threshold"),
    ):
        ax.axvline(level, color="black", linestyle=style, label=f"{name} {level:.1f} DN")
    ax.set_yscale("log")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda count, _: f"{count:,.0f}"))
    ax.set(
        xlim=(low, high),
        ylim=(0.5, 3 * max(outside.max(), inside.max(), 1)),
        xlabel="grey level, DN",
    )
    ax.set_ylabel("pixels per bin", labelpad=2)
    ax.spines[["top", "right"]].set_visible(False)
    sheet.legend(ax.get_legend_handles_labels()[0], 76)
    return sheet.figure


def lost_picture(result: Result) -> Figure:
    """Draw where, and why, the camera sees no light.

    Returns
    -------
    Figure
        A plan view in the colours of the reasons, with their shares of the image.
    """
    station = result.station
    width, height = _fit(station.shape, WIDTH - 2 * MARGIN, 1000)
    sheet = Sheet(WIDTH, 118 + height + 84)
    counts = np.bincount(result.lost.ravel(), minlength=len(LOST))
    on_part = result.lost.size - counts[BESIDE]
    sheet.heading(
        f"Light is seen on {_share(counts[0], on_part)} of the part in view",
        f"{essentials(station)}  ·  shares of the image:",
    )
    handles = [
        Patch(
            facecolor=colour,
            edgecolor="#404040",
            linewidth=0.6,
            label=f"{reason} {_share(n, result.lost.size)}",
        )
        for reason, colour, n in zip(LOST, LOST_COLOURS, counts, strict=True)
    ]
    left = (WIDTH - width) / 2
    sheet.legend(handles, 76)
    ax = sheet.axes(left, 118, width, height)
    _draw_codes(ax, result.lost, station, LOST_COLOURS)
    if counts[BESIDE]:
        size = station.part.length_mm, station.part.width_mm
        corner = -size[0] / 2, -size[1] / 2
        ax.add_patch(Rectangle(corner, *size, fill=False, linestyle="--", edgecolor="#404040"))
    _millimetres(ax)
    _scale_bar(ax, 62)
    return sheet.figure


def station_picture(result: Result) -> Figure:
    """Draw the station to scale, with rays of its own relief.

    Returns
    -------
    Figure
    """
    from gpuspec.reference import ray_paths

    part = result.station.part
    along, across = (np.linspace(-0.48, 0.48, 7) * size for size in (part.length_mm, part.width_mm))
    side = ray_paths(result.station, result.relief, along, np.zeros(7))
    front = ray_paths(result.station, result.relief, np.zeros(7), across)
    return station_drawing(result.station, side, front)


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG file's bytes."""
    file = io.BytesIO()
    # A third of the time of the default level, a tenth more bytes.
    figure.savefig(file, format="png", pil_kwargs={"compress_level": 3})
    return file.getvalue()


def _written(draw: Callable[[Result], Figure]) -> Callable[[Result, Path], None]:
    def write(result: Result, path: Path) -> None:
        path.write_bytes(png(draw(result)))

    return write


PICTURES: dict[str, Callable[[Result, Path], None]] = {
    "station.png": _written(station_picture),
    "sequence.png": _written(sequence_strip),
    "sequence.gif": sequence_animation,
    "aspect.png": _written(aspect_picture),
    "detection.png": _written(detection_picture),
    "histogram.png": _written(histogram_picture),
    "lost.png": _written(lost_picture),
}
"""What a run draws: file name to what writes it."""


# Layout


def _fit(shape: tuple[int, int], width: float, height: float) -> tuple[int, int]:
    """Return the largest box (width, height) in px of an image's proportions, 60 px at least."""
    scale = min(width / shape[1], height / shape[0])
    return max(round(scale * shape[1]), 60), max(round(scale * shape[0]), 60)


def _grid(count: int, shape: tuple[int, int]) -> tuple[int, tuple[int, int]]:
    """Return the number of columns, and the box, with which `count` images are largest."""
    grids = {
        columns: _fit(
            shape,
            (WIDTH - 2 * MARGIN) / columns - 24,
            1560 / math.ceil(count / columns) - 34,
        )
        for columns in range(1, count + 1)
    }
    best = max(grids, key=lambda columns: grids[columns][0])
    return best, grids[best]


def _spread(station: Station, count: int) -> list[int]:
    """Choose up to `count` images whose shifts spread evenly over one period."""
    period = station.tunnel.period_mm
    shifts = np.arange(station.sequence.images) * station.step_mm % period
    wanted = np.arange(count) * period / count
    away = np.abs(shifts[:, None] - wanted)
    nearest = np.minimum(away, period - away).argmin(axis=0)
    return list(dict.fromkeys(nearest.tolist()))


def _round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not longer."""
    decade = float(10.0 ** math.floor(math.log10(length)))
    return max(m for m in (1, 2, 5) if m * decade <= length * (1 + 1e-9)) * decade


def _length(mm: float) -> str:
    return f"{mm:g} mm" if mm >= 0.1 else f"{1000 * mm:g} µm"


def _share(part: int, whole: int) -> str:
    """Return a percentage in which neither a few pixels nor a few missing ones are hidden."""
    percent = 100 * part / whole if whole else 0.0
    if 0 < percent < 0.01:
        return "< 0.01 %"
    if 99.99 < percent < 100:
        return "> 99.99 %"
    return f"{percent:.4g} %" if percent < 1 else f"{percent:.2f} %".replace(".00 %", " %")


# Images


def _pooled(image: NDArray[Any], factor: int, by: np.ufunc) -> NDArray[Any]:
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


def _factor(ax: Axes, shape: tuple[int, ...]) -> int:
    box = ax.get_window_extent()
    return max(1, math.ceil(shape[0] / box.height), math.ceil(shape[1] / box.width))


def _place(ax: Axes, image: NDArray[Any], factor: int, station: Station, **style: Any) -> AxesImage:
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


def _draw_grey(
    ax: Axes,
    image: NDArray[np.float32],
    station: Station,
    low: float,
    high: float,
    lost: NDArray[np.uint8] | None = None,
) -> AxesImage:
    """Draw grey levels; what is beside the part stays white if `lost` is given."""
    factor = _factor(ax, image.shape)
    grey = _pooled(image, factor, np.add)
    if lost is not None:
        grey = np.ma.masked_array(grey, _pooled(lost == BESIDE, factor, np.minimum))
    style = {"interpolation": "nearest"} if factor == 1 else {"interpolation": "bilinear"}
    return _place(ax, grey, factor, station, cmap=GREY, vmin=low, vmax=high, **style)


def _draw_codes(
    ax: Axes, codes: NDArray[np.uint8], station: Station, colours: Sequence[str]
) -> None:
    """Draw an image of small integers in one colour each; the highest prevails."""
    factor = _factor(ax, codes.shape)
    colourmap: Colormap = ListedColormap(list(colours))
    _place(
        ax,
        _pooled(codes, factor, np.maximum),
        factor,
        station,
        cmap=colourmap,
        vmin=-0.5,
        vmax=len(colours) - 0.5,
        interpolation="nearest",
    )


def _grey_range(result: Result) -> tuple[float, float]:
    """Return the grey levels drawn black and white: flawless a third of the way, white far
    enough above the threshold, so that a faint defect shows beside one that saturates.
    """
    flawless, full = result.flawless_dn, result.station.sensor.full_scale_dn
    far = flawless + max(8 * (result.threshold - flawless), 0.2 * full)
    return _range_up_to(min(float(result.aspect.max()), far), result, 0.1)


def _range_up_to(high: float, result: Result, least: float) -> tuple[float, float]:
    """Return a range that ends past the threshold and `least` of full scale above flawless: an
    even image is not to look rough.
    """
    flawless, full = result.flawless_dn, result.station.sensor.full_scale_dn
    high = max(high, result.threshold, flawless + least * full)
    return max(0.0, flawless - (high - flawless) / 2), high


def _millimetres(ax: Axes) -> None:
    ax.set_xlabel("x, mm", fontsize=10)
    ax.set_ylabel("y, mm", fontsize=10, labelpad=2)
    ax.tick_params(labelsize=9.5)


def _scale_bar(ax: Axes, below: float, share: float = 0.2) -> None:
    """Draw a bar of a round length under the right end of the axes, `below` px down."""
    low, high = ax.get_xlim()
    length = _round_length((high - low) * share)
    y = -below / ax.get_window_extent().height
    where = ax.get_xaxis_transform()
    ax.plot(
        [high - length, high],
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
        _length(length),
        (high - length, y),
        xycoords=where,
        xytext=(-5, 0),
        textcoords="offset points",
        ha="right",
        va="center",
        fontsize=9.5,
        annotation_clip=False,
    )


# Detection


def _false_blobs(result: Result) -> NDArray[np.bool_]:
    """Return whether each blob touches no zone."""
    touching = np.zeros(int(result.blobs.label.max(initial=0)) + 1, np.bool_)
    touching[result.labels[result.truth != 0]] = True
    return ~touching[result.blobs.label]


def _codes(result: Result) -> NDArray[np.uint8]:
    """Return 0, or 1 + the place in `KINDS` of what each pixel belongs to."""
    hit, false, missed = range(1, 4)
    of_defect = np.array([0, *(hit if n else missed for n in result.score.defect_hit_px)], np.uint8)
    of_blob = np.zeros(int(result.blobs.label.max(initial=0)) + 1, np.uint8)
    of_blob[result.blobs.label[_false_blobs(result)]] = false
    codes: NDArray[np.uint8] = of_defect[result.truth]
    if of_blob.any():
        np.maximum(codes, of_blob[result.labels], out=codes)
    return codes


def _finds(result: Result) -> list[_Find]:
    """Return missed defects, false blobs and hits, in this order, the most telling first."""
    blobs, score = result.blobs, result.score
    sampling = result.station.camera.sampling_mm
    zones = measure_blobs(
        result.truth, result.aspect, sampling_mm=sampling, flawless_dn=result.flawless_dn
    )
    finds = []
    for zone in zones.rows():
        number = int(zone["label"])
        hit_px = score.defect_hit_px[number - 1]
        kind = "hit" if hit_px else "missed"
        urgency = hit_px / zone["area_px"] if hit_px else -zone["area_px"]
        caption = (
            f"{kind}: {_caption(result.defects[number - 1], number)}\npeak {zone['peak_dn']:.0f} DN"
        )
        finds.append(_find(kind, zone, caption, urgency))
    false = np.flatnonzero(_false_blobs(result))
    largest = false[np.argsort(-blobs.area_px[false], kind="stable")][:BOXES_MAX]
    for index in largest:
        box = {
            side: int(getattr(blobs, side)[index]) for side in ("top", "left", "bottom", "right")
        }
        caption = (
            f"false: {result.classes[index]}\nblob {blobs.label[index]}, "
            f"{blobs.area_mm2[index]:.2g} mm²\n"
            f"peak {blobs.peak_dn[index]:.0f} DN"
        )
        finds.append(_find("false", box, caption, -float(blobs.area_px[index])))
    order = ["missed", "false", "hit"]
    return sorted(finds, key=lambda find: (order.index(find.kind), find.urgency))


def _find(kind: str, box: dict[str, Any], caption: str, urgency: float) -> _Find:
    return _Find(kind, (box["top"], box["bottom"]), (box["left"], box["right"]), caption, urgency)


def _caption(defect: KnownDefect, number: int) -> str:
    way = "high" if defect.kind == "bump" else "deep"
    wide = f"{defect.size_mm:.2g} mm wide" if defect.length_mm else f"⌀ {defect.size_mm:.2g} mm"
    return f"{defect.kind} {number}\n{wide}, {defect.depth_um:.2g} µm {way}"


def _box_mm(find: _Find, station: Station) -> tuple[float, float, float, float]:
    """Return a find's centre and half sides along x and y, in mm."""
    (rows, columns), p = station.shape, station.camera.sampling_mm
    x = (sum(find.columns) - columns) / 2 * p
    y = (rows - sum(find.rows)) / 2 * p
    return (
        x,
        y,
        (find.columns[1] - find.columns[0]) / 2 * p,
        (find.rows[1] - find.rows[0]) / 2 * p,
    )


def _half_box(find: _Find, ax: Axes, station: Station) -> NDArray[np.float64]:
    """Return centre and half sides in mm of the box drawn round a find: 5 px off, 8 px at least."""
    x, y, half_x, half_y = _box_mm(find, station)
    mm_per_px = station.shape[1] * station.camera.sampling_mm / ax.get_window_extent().width
    half = np.maximum(np.array([half_x, half_y]) + 5 * mm_per_px, 8 * mm_per_px)
    return np.array([x, y, *half])


def _draw_boxes(ax: Axes, finds: list[_Find], station: Station) -> None:
    """Draw open boxes round the finds, so that a pixel-sized one cannot be overlooked."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for kind, colour in KINDS.items():
        of_kind = [find for find in finds if find.kind == kind][:BOXES_MAX]
        if not of_kind:
            continue
        boxes = np.array([_half_box(find, ax, station) for find in of_kind])
        ax.add_collection(
            PolyCollection(
                boxes[:, None, :2] + corners * boxes[:, None, 2:],
                facecolors="none",
                edgecolors=colour,
                linewidths=2.2 if kind == "missed" else 1.2,
                linestyles="dashed" if kind == "false" else "solid",
            ),
            autolim=False,
        )


def _name_boxes(ax: Axes, finds: list[_Find], station: Station) -> None:
    """Name finds as their details are named, beside their boxes where there is room."""
    box = ax.get_window_extent()
    px_per_mm = box.width / (station.shape[1] * station.camera.sampling_mm)
    taken: list[NDArray[np.float64]] = []
    for letter, find in zip(LETTERS, finds, strict=False):
        x, y, half_x, half_y = _half_box(find, ax, station) * px_per_mm
        beside, above = half_x + 9, half_y + 11
        places = [
            np.array([x + dx, y + dy])
            for dx, dy in ((beside, 0), (-beside, 0), (0, above), (0, -above), (0, 0))
        ]
        place = next(
            (
                at
                for at in places
                if (np.abs(at) < [box.width / 2 - 9, box.height / 2 - 10]).all()
                and all(np.abs(at - other).max() > 16 for other in taken)
            ),
            places[-1],
        )
        taken.append(place)
        _write_letter(ax, letter, place / px_per_mm, ax.transData)


def _write_letter(ax: Axes, letter: str, place: Any, where: Transform) -> None:
    ax.text(
        place[0],
        place[1],
        letter,
        transform=where,
        ha="center",
        va="center_baseline",
        fontsize=11,
        fontweight="bold",
        color="white",
        path_effects=_halo(),
    )


def _halo() -> list[AbstractPathEffect]:
    return [withStroke(linewidth=2.5, foreground="black")]


def _draw_detail(ax: Axes, find: _Find, result: Result, codes: NDArray[np.uint8]) -> None:
    """Draw a find large, on a grey scale of its own, with zones and what is detected outlined."""
    station = result.station
    p = station.camera.sampling_mm
    x, y, half_x, half_y = _box_mm(find, station)
    rows, columns = station.shape
    half = min(max(1.5 * max(half_x, half_y), 8 * p), max(rows, columns) * p / 2)
    first_row = max(math.floor(rows / 2 - (y + half) / p), 0)
    last_row = math.ceil(rows / 2 - (y - half) / p)
    first_column = max(math.floor(columns / 2 + (x - half) / p), 0)
    last_column = math.ceil(columns / 2 + (x + half) / p)
    window = np.s_[first_row:last_row, first_column:last_column]
    aspect, labels, codes = result.aspect[window], result.labels[window], codes[window]
    factor = _factor(ax, aspect.shape)
    left, top = (first_column - columns / 2) * p, (rows / 2 - first_row) * p
    grey = _pooled(aspect, factor, np.add)
    low, high = _range_up_to(float(grey.max()), result, 0.05)
    right, bottom = left + grey.shape[1] * factor * p, top - grey.shape[0] * factor * p
    ax.imshow(
        grey,
        cmap=GREY,
        vmin=low,
        vmax=high,
        extent=(left, right, bottom, top),
        interpolation="nearest",
        aspect="auto",
    )
    outlines = [(codes == code, colour, 2.4) for code, colour in enumerate(KINDS.values(), 1)]
    for mask, colour, width in (*outlines, (labels != 0, "white", 1.2)):
        edges = _edges(_pooled(mask, factor, np.maximum)) * factor * p
        ax.add_collection(
            LineCollection(
                [*(edges * [1, -1] + [left, top])],
                colors=colour,
                linewidths=width,
                capstyle="projecting",
            )
        )
    ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half), xticks=[], yticks=[])
    for spine in ax.spines.values():
        spine.set(color=KINDS[find.kind], linewidth=3)
    _scale_bar(ax, 16, 0.55)


def _edges(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the pixel edges round a mask, shape (n, 2 ends, (column, row))."""
    padded = np.pad(mask, 1)
    row, column = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    flat = np.stack([np.stack([column, row], 1), np.stack([column + 1, row], 1)], 1)
    row, column = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    upright = np.stack([np.stack([column, row], 1), np.stack([column, row + 1], 1)], 1)
    return np.concatenate([flat, upright]).astype(np.float64)
