"""The aspect image with its grey scale."""

from __future__ import annotations

from matplotlib.figure import Figure

from gpuspec.pictures.page import MARGIN, NOTES, WIDTH, Sheet, fitted
from gpuspec.pictures.place import draw_grey, grey_range, millimetres, scale_bar
from gpuspec.pictures.seen import Inspected


def aspect_picture(result: Inspected) -> Figure:
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
        f"Aspect image: {result.made}",
        result.about,
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
