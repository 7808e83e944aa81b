"""Pictures of a simulated inspection, for a person to look at.

Each is a `matplotlib.figure.Figure`, or a GIF, in the part frame: mm, x along the columns, y up.
Images larger than their box on the page are reduced before they are drawn, grey levels by their
mean, zones and blobs by their maximum, so that no defect disappears and memory stays small.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter, NullFormatter
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from gpuspec.backends import BESIDE, LOST
from gpuspec.detection import detection_picture
from gpuspec.drawing import station_drawing
from gpuspec.page import (
    MARGIN,
    NOTES,
    VERMILION,
    WIDTH,
    Sheet,
    draw_codes,
    draw_grey,
    essentials,
    fitted,
    grey_range,
    length_text,
    millimetres,
    pooled,
    scale_bar,
    scale_length,
)
from gpuspec.station import Station

if TYPE_CHECKING:
    from gpuspec.inspection import Result

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


LOST_COLOURS = ("#D9D9D9", "#FFFFFF", "#CC79A7", "#E69F00", "#0072B2")
FRAME_MS = 120
CAPTION_PX = 190  # of an image of the sequence


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
    pitch = max(width, CAPTION_PX) + 24
    left = max(MARGIN, (WIDTH - columns * pitch + 24) / 2)
    sheet = Sheet(WIDTH, 76 + rows * (height + 34) + 76)
    period, pattern = station.tunnel.period_mm, result.light_map.pattern
    moves = f"the tunnel moves along x, one period of {period:g} mm"
    if pattern:  # whose period may be another
        moves = f"the tunnel moves {period:g} mm (tunnel.luminous_mm + dark_mm)"
    sheet.heading(
        f"{len(chosen)} of {station.sequence.images} images: {moves}",
        essentials(station, result.light_map.pattern),
    )
    full = station.sensor.full_scale_dn
    for place, k in enumerate(chosen):
        row, column = divmod(place, columns)
        x, y = left + column * pitch, 76 + row * (height + 34)
        ax = sheet.axes(x, y + 26, width, height)
        drawn = draw_grey(ax, result.light_map.image(k), station, 0, full)
        ax.set(xticks=[], yticks=[])
        sheet.text(x, y + 4, f"k = {k}    shift {k * station.step_mm:.2f} mm")
    scale_bar(ax, 12)
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
    px_per_mm = zoom / factor / station.camera.sampling_mm
    size = columns * station.camera.sampling_mm
    bar = scale_length(size, size * px_per_mm)
    captions = {
        k: (
            f"image {k} of {station.sequence.images}",
            f"shift {k * station.step_mm:.2f} mm of {station.tunnel.period_mm:g} mm",
        )
        for k in _spread(station, frames)
    }
    words = max(sum(map(font.getlength, caption)) for caption in captions.values())
    pages = []
    for k, (number, shift) in captions.items():
        grey = pooled(result.light_map.image(k), factor, np.add)
        # 64 grey levels look the same and make a smaller file.
        level = np.clip(grey * (64 / station.sensor.full_scale_dn), 0, 63).astype(np.uint8)
        level = level * 4 + level // 16
        picture = Pillow.fromarray(level.repeat(zoom, 0).repeat(zoom, 1))
        wide = max(picture.width, 360, math.ceil(words) + 32)
        page = Pillow.new("L", (wide, picture.height + 56), 255)
        left = (page.width - picture.width) // 2
        page.paste(picture, (left, 28))
        pen = ImageDraw.Draw(page)
        pen.rectangle((left, 28, left + picture.width - 1, 27 + picture.height), outline=0)
        pen.text((4, 4), number, 0, font)
        pen.text((page.width - 4, 4), shift, 0, font, "ra")
        base = page.height - 14
        pen.rectangle((left, base - 2, left + round(bar * px_per_mm), base + 1), 0)
        pen.text((left + bar * px_per_mm + 8, base), length_text(bar), 0, font, "lm")
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
    width, height = fitted(station.shape, WIDTH - 2 * MARGIN - 70, 1000)
    bar_height = max(height, 150)
    below = max(height + 84, bar_height + 20) + NOTES * bool(result.warnings)
    sheet = Sheet(WIDTH, 106 + below)
    sheet.notes(result.warnings)
    sheet.heading(
        f"Aspect image: {station.sequence.fusion} of {station.sequence.images} images",
        essentials(station, result.light_map.pattern),
        f"flawless level {result.flawless_dn:.1f} DN  ·  threshold {result.threshold:.1f} DN  ·  "
        f"full scale {station.sensor.full_scale_dn} DN  ·  {result.info}",
    )
    left = (WIDTH - 70 - width) / 2
    ax = sheet.axes(left, 106, width, height)
    low, high = grey_range(result)
    drawn = draw_grey(ax, result.aspect, station, low, high, result.lost)
    millimetres(ax)
    scale_bar(ax, 62)
    bar = sheet.axes(left + width + 20, 106, 16, bar_height)
    dark, bright = result.aspect.min() < low, result.aspect.max() > high
    extend = "both" if dark and bright else "min" if dark else "max" if bright else "neither"
    sheet.figure.colorbar(drawn, cax=bar, extend=extend, extendfrac=0.03)
    bar.set_ylabel("grey level, DN", fontsize=10)
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
    high = max(high, min(result.threshold, full))
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
    sheet.heading(
        "Grey levels of the aspect image", essentials(result.station, result.light_map.pattern)
    )
    left = MARGIN + 50  # for counts of ten million
    ax = sheet.axes(left, 108, WIDTH - MARGIN - left, 480)
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
        # The threshold is seen wherever it lies, beyond every grey level, too.
        xlim=(min(low, result.threshold - margin), max(high, result.threshold + margin)),
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
    width, height = fitted(station.shape, WIDTH - 2 * MARGIN, 1000)
    sheet = Sheet(WIDTH, 118 + height + 84)
    counts = np.bincount(result.lost.ravel(), minlength=len(LOST))
    on_part = result.lost.size - counts[BESIDE]
    sheet.heading(
        f"Light is seen on {_share(counts[0], on_part)} of the part in view",
        f"{essentials(station, result.light_map.pattern)}  (shares of the image)",
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
    draw_codes(ax, result.lost, station, LOST_COLOURS)
    if counts[BESIDE]:
        size = station.part.length_mm, station.part.width_mm
        corner = -size[0] / 2, -size[1] / 2
        ax.add_patch(Rectangle(corner, *size, fill=False, linestyle="--", edgecolor="#404040"))
    millimetres(ax)
    scale_bar(ax, 62)
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


def write_image(result: Result, k: int, path: Path) -> None:
    """Write image k as an 8-bit PNG, full scale white."""
    grey = result.light_map.image(k) * (255 / result.station.sensor.full_scale_dn)
    Pillow.fromarray(np.rint(grey).astype(np.uint8)).save(path, compress_level=3)


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


def _spread(station: Station, count: int) -> list[int]:
    """Choose up to `count` images whose shifts spread evenly over one period."""
    period = station.tunnel.period_mm
    shifts = np.arange(station.sequence.images) * station.step_mm % period
    wanted = np.arange(count) * period / count
    away = np.abs(shifts[:, None] - wanted)
    nearest = np.minimum(away, period - away).argmin(axis=0)
    return list(dict.fromkeys(nearest.tolist()))


def _share(part: int, whole: int) -> str:
    """Return a percentage in which neither a few pixels nor a few missing ones are hidden."""
    percent = 100 * part / whole if whole else 0.0
    if 0 < percent < 0.01:
        return "< 0.01 %"
    if 99.99 < percent < 100:
        return "> 99.99 %"
    return f"{percent:.4g} %" if percent < 1 else f"{percent:.2f} %".replace(".00 %", " %")


def _grid(count: int, shape: tuple[int, int]) -> tuple[int, tuple[int, int]]:
    """Return the number of columns, and the box, with which `count` images are largest."""
    grids = {
        columns: fitted(
            shape,
            (WIDTH - 2 * MARGIN + 24) / columns - 24,
            1560 / math.ceil(count / columns) - 34,
        )
        for columns in range(1, min(count, (WIDTH - 2 * MARGIN + 24) // (CAPTION_PX + 24)) + 1)
    }
    best = max(grids, key=lambda columns: math.prod(grids[columns]))
    return best, grids[best]
