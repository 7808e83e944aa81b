"""What a data set holds, in figures: sizes, depths, areas and contrasts, found or missed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from gpuspec.datasets.folder import Record
from gpuspec.datasets.plan import DataSetPlan
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet

MEASURES = {
    "size_mm": "diameter or width, mm",
    "depth_um": "depth or height, µm",
    "area": "area of the mask, px",
    "contrast_dn": "contrast, DN",
}
"""What is told of every defect, and its axis."""
_COLUMNS, _HEIGHT, _GAP, _BINS = 4, 210, 84, 24


def values_of(annotations: Sequence[Any], name: str) -> NDArray[np.float64]:
    """Return a measure of every annotation.

    Parameters
    ----------
    annotations : sequence of dict
    name : str
        One of ``MEASURES``.
    """
    return np.array([a[name] if name == "area" else a["attributes"][name] for a in annotations],
                    np.float64)  # fmt: skip


def histograms(plan: DataSetPlan, records: Sequence[Record]) -> Figure:
    """Draw how often each size, depth, area and contrast comes, a row for each category.

    Parameters
    ----------
    plan : DataSetPlan
    records : sequence of dict
        Of the parts.

    Returns
    -------
    Figure
        Found and missed by the station's own threshold, one on the other.
    """
    every = [annotation for record in records for annotation in record["annotations"]]
    rows = len(plan.categories)
    top = 122
    sheet = Sheet(WIDTH, top + rows * (_HEIGHT + _GAP))
    sheet.heading(
        "The defects of the data set",
        f"{len(every):,} on {len(records):,} parts; found or missed by the station's own threshold",
    )
    found = sum(a["attributes"]["found"] for a in every)
    sheet.legend(
        [Patch(color=SKY, label=f"found: {found:,}"),
         Patch(color=VERMILION, label=f"missed: {len(every) - found:,}")], 76,
    )  # fmt: skip
    room = (WIDTH - 2 * MARGIN - (_COLUMNS - 1) * 60) / _COLUMNS
    for row, category in enumerate(plan.categories):
        own = [a for a in every if a["category_id"] == row + 1]
        hit = np.array([a["attributes"]["found"] for a in own], bool)
        for column, (name, label) in enumerate(MEASURES.items()):
            ax = sheet.axes(MARGIN + column * (room + 60), top + row * (_HEIGHT + _GAP), room,
                            _HEIGHT)  # fmt: skip
            values = values_of(own, name)
            logarithmic = name == "area" and values.size > 0 and values.max() > 20 * values.min()
            edges = _edges(values, whole=name == "area", logarithmic=logarithmic)
            ax.hist(
                [values[hit], values[~hit]], edges.tolist(), stacked=True, color=[SKY, VERMILION]
            )
            if logarithmic:
                ax.set_xscale("log")
                ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
            ax.yaxis.set_major_locator(MaxNLocator(4, integer=True))
            ax.set_xlabel(label)
            if not column:
                ax.set_ylabel(f"{category}: defects")
            ax.spines[["top", "right"]].set_visible(False)
    return sheet.figure


def _edges(values: NDArray[np.float64], *, whole: bool, logarithmic: bool) -> NDArray[np.float64]:
    if not values.size:
        return np.linspace(0, 1, _BINS + 1)
    low, high = float(values.min()), float(values.max())
    if logarithmic:
        return np.geomspace(low, high * 1.001, _BINS + 1)
    if whole:  # each bin as many whole numbers
        step = math.ceil((high - low + 1) / _BINS)
        return np.arange(low - 0.5, high + step, step)
    high = high if high > low else low + max(abs(low), 1) * 1e-3
    return np.linspace(low, high, _BINS + 1)
