"""Images of the sequence: a strip, an animation, single ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from gpuspec.arrays import pooled
from gpuspec.pictures.page import (
    MARGIN,
    WIDTH,
    Sheet,
    essentials,
    fitted,
    length_text,
    scale_length,
)
from gpuspec.pictures.place import draw_grey, scale_bar
from gpuspec.pictures.seen import Simulated
from gpuspec.station.station import Station

FRAME_MS = 120
CAPTION_PX = 190  # of an image of the sequence


def sequence_strip(result: Simulated, count: int = 6) -> Figure:
    """Draw images of the sequence, spread evenly over one period, on one grey scale.

    Parameters
    ----------
    result : Simulated
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
    result: Simulated, path_or_file: str | Path | BinaryIO, frames: int = 20, width: int = 1000
) -> None:
    """Write the sequence over one period as an animated GIF that repeats.

    Parameters
    ----------
    result : Simulated
        The inspection.
    path_or_file : str, Path or binary file
        Where to write.
    frames : int
        Number of frames at most.
    width : int
        Widest and highest the images may be, px.
    """
    write_animation(animation_pages(result, frames, width), path_or_file)


def animation_pages(result: Simulated, frames: int = 20, width: int = 1000) -> list[Pillow.Image]:
    """Return the frames of an animation, as :func:`sequence_animation` writes them.

    Parameters
    ----------
    result : Simulated
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
    return pages


def write_animation(pages: Sequence[Pillow.Image], path_or_file: str | Path | BinaryIO) -> None:
    """Write frames as an animated GIF that repeats.

    Parameters
    ----------
    pages : sequence of Image
    path_or_file : str, Path or binary file
    """
    pages[0].save(
        path_or_file,
        "GIF",
        save_all=True,
        append_images=pages[1:],
        duration=FRAME_MS,
        loop=0,
    )


def write_image(result: Simulated, k: int, path: Path) -> None:
    """Write image k as an 8-bit PNG, full scale white.

    Parameters
    ----------
    result : Simulated
        With its light map.
    k : int
        From 0.
    path : Path
    """
    grey = result.light_map.image(k) * (255 / result.station.sensor.full_scale_dn)
    Pillow.fromarray(np.rint(grey).astype(np.uint8)).save(path, compress_level=3)


def _spread(station: Station, count: int) -> list[int]:
    """Choose up to `count` images whose shifts spread evenly over one period."""
    period = station.tunnel.period_mm
    shifts = np.arange(station.sequence.images) * station.step_mm % period
    wanted = np.arange(count) * period / count
    away = np.abs(shifts[:, None] - wanted)
    nearest = np.minimum(away, period - away).argmin(axis=0)
    return list(dict.fromkeys(nearest.tolist()))


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
