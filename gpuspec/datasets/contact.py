"""A contact sheet: some of the images, the defects in boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gpuspec.arrays import pooled
from gpuspec.datasets.folder import Record
from gpuspec.datasets.plan import DataSetPlan
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, fitted
from gpuspec.pictures.place import GREY, reduction

_SHOWN = 12
_GAP, _CAPTION, _TOP = 24, 44, 112  # px
_CELL_HEIGHT = 320  # px at most


def contact_sheet(plan: DataSetPlan, records: Sequence[Record], images: Path) -> Figure:
    """Draw twelve images spread over the data set, defects found and missed in boxes.

    Parameters
    ----------
    plan : DataSetPlan
    records : sequence of dict
        Of the parts.
    images : Path
        Folder of their images.
    """
    chosen = [records[i] for i in
              np.unique(np.linspace(0, len(records) - 1, _SHOWN).round().astype(int))]  # fmt: skip
    shapes = [(r["image"]["height"], r["image"]["width"]) for r in chosen]
    wide = max(columns / rows for rows, columns in shapes)
    across = min(2 if wide > 2 else 4, len(chosen))
    room = (WIDTH - 2 * MARGIN - (across - 1) * _GAP) / across
    height = max(fitted(shape, room, _CELL_HEIGHT)[1] for shape in shapes)
    down = math.ceil(len(chosen) / across)
    sheet = Sheet(WIDTH, _TOP + down * (height + _CAPTION) + 8)
    drawn = "; ".join(f"{draw.key} {draw}" for draw in plan.draws) or "random defects"
    sheet.heading(f"{len(chosen)} of {len(records):,} parts", drawn)
    sheet.legend(
        [Line2D([], [], color=colour, label=label) for colour, label in
         ((SKY, "found by the station's own threshold"), (VERMILION, "missed"))], 76,
    )  # fmt: skip
    for place, record in enumerate(chosen):
        row, column = divmod(place, across)
        left, top = MARGIN + column * (room + _GAP), _TOP + row * (height + _CAPTION)
        _draw(sheet, (left, top, room, height), record, images, plan)
    return sheet.figure


def _draw(
    sheet: Sheet, cell: tuple[float, float, float, float], record: Record, images: Path,
    plan: DataSetPlan,
) -> None:  # fmt: skip
    left, top, room, height = cell
    image = record["image"]
    width, height = fitted((image["height"], image["width"]), room, height)
    ax = sheet.axes(left, top, width, height)
    grey = _read(images / image["file_name"]).astype(np.float32)
    factor = reduction(ax, grey.shape)
    full = image["full_scale_dn"] if plan.kept.bits == 32 else 2**plan.kept.bits - 1
    shown = pooled(grey, factor, np.add)
    across, down = shown.shape[1] * factor, shown.shape[0] * factor
    ax.imshow(shown, GREY, vmin=0, vmax=full, extent=(0, across, down, 0), aspect="auto",
              interpolation="bilinear" if factor > 1 else "nearest")  # fmt: skip
    pad = 3 * image["width"] / width  # three px of the page, so that a box hides nothing
    for found, colour in ((True, SKY), (False, VERMILION)):
        boxes = [_box(a["bbox"], pad) for a in record["annotations"]
                 if a["attributes"]["found"] == found]  # fmt: skip
        ax.add_collection(LineCollection(boxes, colors=colour, linewidths=1.1))
    ax.set(xlim=(0, image["width"]), ylim=(image["height"], 0), xticks=[], yticks=[])
    values = ", ".join(
        f"{key.rpartition('.')[2]} {value}" for key, value in image["values"].items()
    )
    said = f"{image['id']}, {image['split']}" + (f": {values}" if values else "")
    letters = int(room / 7.2)
    said = said if len(said) <= letters else said[: letters - 1] + "…"
    sheet.text(left, top + height + 4, said, fontsize=9, color="#404040")


def _box(box: Sequence[float], pad: float) -> list[tuple[float, float]]:
    left, top, width, height = box
    left, top, right, bottom = left - pad, top - pad, left + width + pad, top + height + pad
    return [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]


def _read(path: Path) -> NDArray[Any]:
    if path.suffix == ".tif":
        import tifffile

        return np.asarray(tifffile.imread(path))
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image)
