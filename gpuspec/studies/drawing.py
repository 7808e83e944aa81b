"""Pictures of the studies, on the page every picture is laid out on."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from gpuspec import words
from gpuspec.page import (
    MARGIN,
    SKY,
    VERMILION,
    WIDTH,
    Sheet,
    draw_codes,
    essentials,
    fitted,
    millimetres,
    open_frame,
    place_image,
    pooled,
    reduction,
)
from gpuspec.studies.coverage import KINDS, LOST_LIGHT, OFF_PART
from gpuspec.studies.deflection import signature_width
from gpuspec.studies.height import NEGLIGIBLE
from gpuspec.studies.outcome import percent

if TYPE_CHECKING:
    from gpuspec.studies.coverage import Coverage
    from gpuspec.studies.height import Height
    from gpuspec.studies.signature import Signature
    from gpuspec.studies.tolerance import Perturbation, Tolerance

GREY, PALE, DARK = "#606060", "#D9D9D9", "#404040"


def signature_picture(found: Signature) -> Figure:
    """Draw both widths over the distance."""
    sheet = Sheet(WIDTH, 770)
    tunnel, camera = found.station.tunnel, found.station.camera
    sheet.heading(
        "Signature of a dent against its distance to the light transition",
        f"{found.dent} (σ = {found.dent.sigma_mm:.3g} mm)  ·  {tunnel.section} at "
        f"{tunnel.top_mm:g} mm, camera at {camera.height_mm:g} mm  ·  A = {found.strength:.3g}",
        str(found.info),
    )
    ax = sheet.axes(MARGIN, 174, WIDTH - 2 * MARGIN, 520)
    open_frame(
        ax, "distance of the transition from the dent's centre, σ", "width of the signature, σ"
    )
    far = float(found.distance[-1])
    fine = np.linspace(0, far, 500)
    law = signature_width(fine, found.strength)
    curve = ax.plot(fine, law, color="black", label="closed form")
    dots = ax.plot(found.distance, found.simulated, "o", color=VERMILION, markersize=6,
                   label="measured in the simulated images")  # fmt: skip
    handles = [*curve, *dots]
    if found.vanishing:
        name = f"A/√e − 1 = {found.vanishing:.3g}"
        handles.append(ax.axvline(found.vanishing, color=GREY, linestyle="--", label=name))
    top = max(1.08 * float(law.max()), 0.5)
    ax.set(xlim=(0, far), ylim=(-0.02 * top, top))
    sheet.legend(handles, 100)
    across = ax.secondary_xaxis("top", functions=_times(found.dent.sigma_mm))
    across.set_xlabel("distance on the part, mm", fontsize=10)
    share = ax.secondary_yaxis("right", functions=_times(25.0))
    share.set_ylabel("share of the diameter, %", fontsize=10)
    return sheet.figure


def height_picture(found: Height) -> Figure:
    """Draw the movements, and their ratio, over the camera's height."""
    sheet = Sheet(WIDTH, 770)
    tunnel = found.station.tunnel
    verdict = "is" if found.negligible else "is not"
    sheet.heading(
        f"Movement of the light point: for this station, height {verdict} negligible beside "
        f"orientation",
        f"{found.dent}, {found.place_mm:.3g} mm off the axis  ·  {tunnel.section} at "
        f"{tunnel.top_mm:g} mm",
        str(found.info),
    )
    width = (WIDTH - 2 * MARGIN - 100) / 2
    moved, ratio = (sheet.axes(MARGIN + n * (width + 100), 150, width, 540) for n in range(2))
    for ax, label in (
        (moved, "greatest movement of the light point, mm"),
        (ratio, "movement by height over movement by slope, %"),
    ):
        open_frame(ax, "height of the camera, mm", label)
        ends = found.camera_mm[0] / 1.05, found.camera_mm[-1] * 1.05
        ax.set(xscale="log", yscale="log", xlim=ends)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
            axis.set_minor_formatter(NullFormatter())
    x = found.camera_mm
    handles = []
    curves = [("dent", "o", found.by_slope_mm, found.by_height_mm, found.ratio)]
    if found.crowned:
        shape = found.shape_by_slope_mm, found.shape_by_height_mm, found.shape_ratio
        curves.append(("crown", "s", *shape))
    for name, marker, by_slope, by_height, share in curves:
        colour = VERMILION if name == "dent" else SKY
        style: dict[str, Any] = {"marker": marker, "markersize": 5, "linestyle": "none"}
        for values, of, tint in ((by_slope, "slope", "black"), (by_height, "height", colour)):
            handles += moved.plot(x, values, color=tint, label=f"{name}, by {of}", **style)
        ratio.plot(x, 100 * share, color=colour, **style)
    for estimate in (found.slope_estimate_mm, found.height_estimate_mm):
        (law,) = moved.plot(x, estimate, color=GREY, label="dent, closed form")
    bound = ratio.axhline(100 * NEGLIGIBLE, color=GREY, linestyle="--",
                          label=f"negligible up to {percent(NEGLIGIBLE)}")  # fmt: skip
    for ax in (moved, ratio):
        own = ax.axvline(found.station.camera.height_mm, color="black", linestyle=":",
                         label="this station's camera")  # fmt: skip
    sheet.legend([*handles, law, bound, own], 100)
    return sheet.figure


def coverage_picture(found: Coverage) -> Figure:
    """Draw the distance on the part and on the light, the blind pixels, and one row's course.

    Squares of pixels drawn as one show their largest distance, and any blind pixel of theirs.
    """
    station = found.station
    beside = station.shape[1] < 1.5 * station.shape[0]
    cell = (WIDTH - 2 * MARGIN) / (3 if beside else 1)
    width, height = fitted(station.shape, cell - (170 if beside else 110), 420)
    bar_height = max(height, 110)  # room for its label
    corners = [
        (MARGIN + cell * place, 170.0) if beside else (MARGIN, 170.0 + place * (bar_height + 96))
        for place in range(3)
    ]
    below = corners[-1][1] + (bar_height if beside else height) + 90
    sheet = Sheet(WIDTH, below + 320)
    sheet.heading(
        f"Scan coverage: {percent(found.blind)} of the part is blind to a {found.dent}",
        essentials(station),
        f"blue: the scan rule, {found.reach_mm:.3g} mm on the part  ·  {found.info}",
    )
    colours = ("#FFFFFF", VERMILION, DARK, PALE)
    handles = [
        Patch(facecolor=colour, edgecolor=DARK, linewidth=0.6, label=f"{kind} {n:,} px")
        for kind, colour, n in zip(KINDS, colours, found.counts, strict=True)
    ]
    sheet.legend(handles, 100)
    reaches = found.reach_mm, found.reach_mm * found.magnification
    maps = zip(corners, (found.on_part_mm, found.on_light_mm), ("part", "light"), reaches,
               strict=False)  # fmt: skip
    for (left, top), image, where, reach in maps:
        sheet.text(left, top - 24, f"Distance to the nearest transition on the {where}")
        ax = sheet.axes(left, top, width, height)
        factor = reduction(ax, image.shape)
        worst = pooled(np.nan_to_num(image, nan=-1.0), factor, np.maximum)
        # Up to the rule at least: distances far within it are to look alike.
        highest = max(float(worst.max()), 1.1 * reach)
        drawn = place_image(ax, np.ma.masked_less(worst, 0), factor, station, cmap="cividis",
                            vmin=0, vmax=highest, interpolation="nearest")  # fmt: skip
        ax.set_facecolor(PALE)
        lost = pooled(found.kind == LOST_LIGHT, factor, np.maximum)
        place_image(ax, np.ma.masked_equal(lost, 0), factor, station,
                    cmap=ListedColormap([DARK]), interpolation="nearest")  # fmt: skip
        millimetres(ax)
        bar = sheet.axes(left + width + 16, top, 16, bar_height)
        sheet.figure.colorbar(drawn, cax=bar).set_label(f"mm on the {where}", fontsize=10)
        bar.axhline(reach, color=SKY, linewidth=3)
    left, top = corners[-1]
    sheet.text(left, top - 24, "Blind pixels")
    ax = sheet.axes(left, top, width, height)
    # The highest code prevails in a square of pixels, and blind ones are to.
    codes = np.where(found.kind == OFF_PART, 0, found.kind + 1).astype(np.uint8)
    draw_codes(ax, codes, station, [colours[OFF_PART], *colours[:OFF_PART]])
    millimetres(ax)
    sheet.text(MARGIN, below, "About the farthest pixel, over one period")
    _draw_row(sheet.axes(MARGIN, below + 28, WIDTH - 2 * MARGIN, 220), found)
    return sheet.figure


def _draw_row(ax: Axes, found: Coverage) -> None:
    """Draw the distance on the part along the row of the farthest pixel, about it."""
    (rows, columns), p = found.station.shape, found.station.camera.sampling_mm
    row, column = np.unravel_index(
        np.nan_to_num(found.on_part_mm, nan=-1.0).argmax(), found.on_part_mm.shape
    )
    half = math.ceil(found.station.tunnel.period_mm / found.magnification / 2 / p)
    near = slice(max(int(column) - half, 0), int(column) + half + 1)
    x = (np.arange(columns)[near] + 0.5 - columns / 2) * p
    distance = found.on_part_mm[row, near]
    ax.plot(x, distance, ".-", color="black", markersize=4, label="distance to a transition")
    ax.axhline(found.reach_mm, color=SKY, linestyle="--",
               label=f"scan rule, {found.reach_mm:.3g} mm")  # fmt: skip
    highest = max(float(np.nanmax(distance, initial=0)), found.reach_mm)
    ax.set(xlim=(x[0], x[-1]) if len(x) > 1 else None, ylim=(0, 1.15 * highest or 1.0))
    y = (rows / 2 - row - 0.5) * p
    open_frame(ax, f"x, mm, in the row at y = {y:.3g} mm", "mm on the part")
    ax.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False, fontsize=10)


def tolerance_picture(found: Tolerance) -> Figure:
    """Draw P1, P2 and the share of defects hit, a panel for each perturbation."""
    columns, width, height, pitch = 4, 285, 250, 370
    rows = math.ceil(len(found.perturbations) / columns)
    sheet = Sheet(WIDTH, 160 + rows * pitch)
    nominal = found.nominal
    sheet.heading(
        f"Tolerance at the fixed threshold of {found.threshold_dn:.5g} DN: nominally "
        f"P1 {nominal.p1:.3f}, P2 {nominal.p2:.3f}, {nominal.defects_hit} of {nominal.defects} "
        f"defects hit ({words.BEST})",
        essentials(found.station),
        str(found.info),
    )
    for number, perturbation in enumerate(found.perturbations):
        row, column = divmod(number, columns)
        ax = sheet.axes(MARGIN + column * (width + 56), 150 + row * pitch, width, height)
        curves = _draw_perturbation(ax, perturbation)
        if column:
            ax.set_ylabel("")
    sheet.legend(curves, 100)
    return sheet.figure


def _draw_perturbation(ax: Axes, moved: Perturbation) -> list[Line2D]:
    """Draw one perturbation's scores; return its curves for the legend."""
    names = [str(value) for value in moved.values]
    x = np.array(moved.values, np.float64) if moved.unit else np.arange(len(names))
    open_frame(ax, f"{moved.name}, {moved.unit}" if moved.unit else moved.name,
               f"share; {words.BEST}")  # fmt: skip
    style: dict[str, Any] = {"markersize": 5, "linestyle": "-" if moved.unit else "none"}
    drawn = [
        *ax.plot(x, moved.p1, marker="o", color="black", label=words.P1, **style),
        *ax.plot(x, moved.p2, marker="s", color=VERMILION, label=words.P2, **style),
        *ax.plot(x, moved.hit, marker="^", color=SKY, label="defects hit", **style),
        ax.axvline(x[moved.nominal], color=GREY, linestyle=":", label="nominal"),
    ]
    if not moved.unit:
        ax.set_xticks(x, names, rotation=60, ha="right", fontsize=9)
    ax.set_ylim(-0.03, 1.05)
    return drawn


def _times(factor: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return what turns an axis into one in another unit, and back."""
    return lambda value: value * factor, lambda value: value / factor
