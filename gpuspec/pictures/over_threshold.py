"""Over the threshold: what is found, what by mistake, and where all is found and nothing else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from gpuspec import words
from gpuspec.arrays import BESIDE
from gpuspec.detection.false_blobs import least_pixels
from gpuspec.detection.inspection import levelled
from gpuspec.detection.over_threshold import OverThreshold, over_threshold, thresholds_of
from gpuspec.part.guard import guarded
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, YELLOW, Sheet
from gpuspec.pictures.seen import Simulated

STATED = "stated"
_LEVELS = 120
_NEAR = 2.5  # times as far as what matters, from the lowest threshold on, is drawn large
_STYLES = ("--", "-.", ":")
Named = Sequence[tuple[str, float]]
"""Thresholds that are marked: name and DN."""


def over_threshold_picture(result: Simulated) -> Figure:
    """Draw what each threshold would have found in an inspection with known defects.

    Parameters
    ----------
    result : Simulated
    """
    station, on_part = result.station, result.lost != BESIDE
    image = levelled(result.aspect, on_part, station, result.lost == 0)
    found = over_threshold(
        image, result.truth, on_part, guarded(station, result.relief, result.truth),
        thresholds_of(image, on_part, result.inspection, _LEVELS),
        min_area_px=least_pixels(station.segmentation.min_area_mm2, station.camera.sampling_mm),
    )  # fmt: skip
    how = STATED if result.inspection.rule == "stated" else "automatic"
    return thresholds_figure(found, [(how, result.threshold)], result.about)


def thresholds_figure(found: OverThreshold, named: Named, *about: str) -> Figure:
    """Draw shares and false blobs over the grey level: near what matters, and over all levels.

    Parameters
    ----------
    found : OverThreshold
    named : sequence of (str, float)
        Thresholds to be marked.
    *about : str
        Lines of the heading.
    """
    sheet = Sheet(WIDTH, 760 + 24 * len(about))
    sheet.heading("Over the threshold: what is found, and what by mistake", *about)
    top = 88 + 24 * len(about)
    left, gap = MARGIN + 16, 96
    width = (WIDTH - MARGIN - left - gap) / 2
    low, high = (float(found.threshold_dn[i]) for i in (0, -1))
    marks = [level for name, level in named if name != STATED]
    marks += [found.clean_dn, found.found_dn]
    near = low + _NEAR * (max(m for m in marks if not np.isnan(m)) - low)
    handles: list[Line2D | Patch] = []
    for column, end in enumerate((min(near, high), high)):
        x = left + column * (width + gap)
        shares = sheet.axes(x, top, width, 330)
        errors = sheet.axes(x, top + 350, width, 220)
        handles = _draw(shares, errors, found, named)
        for ax in (shares, errors):
            ax.set_xlim(low - 0.02 * (end - low), end if end > low else low + 1)
            if column:
                ax.set_ylabel("")
        shares.tick_params(labelbottom=False)
    sheet.legend(handles, top - 36)
    return sheet.figure


def _draw(shares: Axes, errors: Axes, found: OverThreshold, named: Named) -> list[Line2D | Patch]:
    """Draw one pair of frames; return what their legend is made of."""
    x = found.threshold_dn
    handles: list[Line2D | Patch] = [
        *shares.plot(x, found.hits / max(found.defects, 1), color=SKY, linewidth=3.0,
                     drawstyle="steps-post", label=f"hit, of {found.defects}"),
        *shares.plot(x, found.p1, color="black", linewidth=1.4, label=words.P1),
        *shares.plot(x, found.p2, color=VERMILION, linewidth=1.4, label=words.P2),
        *shares.plot(x, found.f1, color="#8C8C8C", linewidth=1.4, label="F1"),
    ]  # fmt: skip
    errors.step(x, found.false_blobs, where="post", color="black", linewidth=1.4)
    if found.range_dn:
        for ax in (shares, errors):
            span = ax.axvspan(*found.range_dn, color=YELLOW, alpha=0.45, linewidth=0, zorder=0)
        low, high = found.range_dn
        span.set_label(f"all, nothing else: {low:.1f} to {high:.1f} DN")
        handles.append(span)
    for (name, level), style in zip(named, _STYLES, strict=False):
        for ax in (shares, errors):
            line = ax.axvline(level, color="black", linestyle=style, linewidth=1.2,
                              label=f"{name} {level:.1f} DN")  # fmt: skip
        handles.append(line)
    shares.set(ylim=(-0.03, 1.05), ylabel=f"share; {words.BEST}")
    errors.set_yscale("symlog", linthresh=1, linscale=0.4)
    most = max(int(found.false_blobs.max(initial=0)), 1)
    errors.set_yticks([0, *(10**k for k in range(int(np.log10(most)) + 2))])
    errors.yaxis.set_major_formatter(FuncFormatter(lambda count, _: f"{count:,.0f}"))
    errors.minorticks_off()
    errors.set(ylim=(-0.2, 3 * most), xlabel="threshold, DN",
               ylabel="false blobs\nbeyond guard bands")  # fmt: skip
    for ax in (shares, errors):
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(axis="y", color="#E6E6E6")
        ax.set_axisbelow(True)
    return handles
