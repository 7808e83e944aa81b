"""How often each grey level of the aspect image comes, inside and outside the zones."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from matplotlib.ticker import FuncFormatter, NullFormatter

from gpuspec.arrays import BESIDE
from gpuspec.detection.inspection import levelled
from gpuspec.pictures.page import MARGIN, VERMILION, WIDTH, Sheet
from gpuspec.pictures.seen import Inspected


def histogram_picture(result: Inspected) -> Figure:
    """Draw how often each grey level of the aspect image comes, inside and outside the zones.

    Without its background, and turned, where the station asks for that.

    Returns
    -------
    Figure
        Over the pixels on the part, as they are scored.
    """
    station, full = result.station, result.station.sensor.full_scale_dn
    held = levelled(result.aspect, result.lost != BESIDE, station, result.lost == 0)
    low, high = float(held.min()), float(held.max())
    low = min(low, result.flawless_dn)
    high = max(high, min(result.threshold, full))
    margin = max(0.04 * (high - low), 0.005 * full)
    low, high = max(low - margin, 0), min(high + margin, full)
    bins = 240
    bin_of = ((held - np.float32(low)) * np.float32(bins / (high - low))).astype(np.int16)
    np.clip(bin_of, 0, bins - 1, out=bin_of)
    # Both counts in one pass: bins of the zones come after those outside, unscored pixels last.
    bin_of[result.truth != 0] += bins
    bin_of[result.lost == BESIDE] = 2 * bins
    outside, inside = np.bincount(bin_of.ravel(), minlength=2 * bins + 1)[:-1].reshape(2, bins)

    sheet = Sheet(WIDTH, 660)
    said = "" if held is result.aspect else ", as the threshold is held against it"
    sheet.heading(f"Grey levels of the aspect image{said}", result.about)
    left = MARGIN + 50  # for counts of ten million
    ax = sheet.axes(left, 108, WIDTH - MARGIN - left, 480)
    edges = np.linspace(low, high, bins + 1)
    score = result.score
    shares = [(outside, "#8C8C8C", "inspected", int(result.blobs.area_px.sum()))]
    if score:
        shares = [
            (outside, "#8C8C8C", "outside the zones", score.false_px),
            (inside, VERMILION, "inside the zones", score.hit_px),
        ]
    for counts, colour, name, above in shares:
        label = f"{name}: {counts.sum():,} px, {above:,} detected"
        if counts.any():
            # Axes.stairs would work out limits, which are set below, in a tenth of all the time.
            ax.add_artist(
                StepPatch(
                    counts, edges, baseline=0.5, fill=True, color=colour, alpha=0.35, linewidth=0
                )
            )
            ax.add_artist(
                StepPatch(
                    counts, edges, baseline=0.5, fill=False, color=colour, linewidth=1.4,
                    label=label,
                )
            )  # fmt: skip
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
