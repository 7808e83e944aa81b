"""The data sheet: what the data set is, what is in it, and how it is loaded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpuspec.datasets.contact import contact_sheet
from gpuspec.datasets.folder import PICTURES, SHEET, DataSetFolder, Record
from gpuspec.datasets.histograms import MEASURES, histograms, values_of
from gpuspec.datasets.plan import SPLITS, DataSetPlan
from gpuspec.pictures.page import png
from gpuspec.simulation.cautions.station import assumptions
from gpuspec.version import __version__

LOADING = """\
from pycocotools.coco import COCO

coco = COCO("annotations/train.json")
for image in coco.loadImgs(coco.getImgIds()):
    path = "images/" + image["file_name"]
    for defect in coco.loadAnns(coco.getAnnIds(imgIds=image["id"])):
        mask = coco.annToMask(defect)  # (rows, columns), 1 in the defect's zone
        kind, told = coco.cats[defect["category_id"]]["name"], defect["attributes"]
"""
_EVERY = (5, 50, 95)  # percentiles


def write_sheet(folder: Path, run: DataSetFolder, records: Sequence[Record]) -> None:
    """Write the data sheet and its pictures into a folder.

    Parameters
    ----------
    folder : Path
        An existing one.
    run : DataSetFolder
        Where the images are.
    records : sequence of dict
        Of every part.
    """
    figures = (contact_sheet(run.plan, records, run.path / "images"), histograms(run.plan, records))
    for name, figure in zip(PICTURES, figures, strict=True):
        (folder / name).write_bytes(png(figure))
    (folder / SHEET).write_text(sheet(run.plan, records), "utf-8")


def sheet(plan: DataSetPlan, records: Sequence[Record]) -> str:
    """Return the data sheet as Markdown.

    Parameters
    ----------
    plan : DataSetPlan
    records : sequence of dict
        Of every part.
    """
    return "\n".join(_lines(plan, records)).rstrip() + "\n"


def _lines(plan: DataSetPlan, records: Sequence[Record]) -> Iterator[str]:
    every = [annotation for record in records for annotation in record["annotations"]]
    devices = sorted({f"{m['device']} ({m['backend']}, {m['driver']} {m['version']})"
                      for m in (record["made_by"] for record in records)})  # fmt: skip
    yield f"# Simulated images of specular parts: {plan.station.file}\n"
    yield (
        f"{len(records):,} parts with {len(every):,} known defects, simulated by gpuspec "
        f"{__version__} on {'; '.join(devices)}. **Licence:** "
        f"{plan.kept.licence or 'none was stated; ask whoever gave you the data set'}.\n"
    )
    yield f"![Some of the images]({PICTURES[0]})\n"
    yield from _counts(plan, records, every)
    yield "## Images\n"
    yield f"{_images(plan, records)}\n"
    yield from _files(plan)
    yield "## Loading\n"
    yield f"```python\n{LOADING}```\n"
    yield from _defects(plan, every)
    yield f"![Sizes, depths, areas and contrasts]({PICTURES[1]})\n"
    yield "## How it was drawn\n"
    yield from _drawn(plan)
    yield "## What to know\n"
    unseen = sum(record["image"]["unseen"] for record in records)
    yield from (f"- {note}" for note in _notes(plan, unseen))


def _counts(plan: DataSetPlan, records: Sequence[Record], every: Sequence[Any]) -> Iterator[str]:
    yield "## Counts\n"
    of_split = {split: [r for r in records if r["image"]["split"] == split] for split in SPLITS}
    rows = []
    for split, own in of_split.items():
        kinds = [a["category_id"] for r in own for a in r["annotations"]]
        counts = (f"{kinds.count(n):,}" for n in range(1, len(plan.categories) + 1))
        rows.append((f"`annotations/{split}.json`", f"{len(own):,}", *counts))
    yield _table(("split", "images", *plan.categories), rows)
    yield "A part is in one split alone.\n"


def _images(plan: DataSetPlan, records: Sequence[Record]) -> str:
    shapes = sorted({(r["image"]["width"], r["image"]["height"]) for r in records})
    size = f"{shapes[0][0]:,} × {shapes[0][1]:,} pixels"
    if len(shapes) > 1:
        size += f" to {shapes[-1][0]:,} × {shapes[-1][1]:,}"
    kept = plan.kept
    if kept.bits == 32:
        level = "floats, grey levels of the aspect image in DN"
    else:
        level = (f"{kept.bits} bits; level {2**kept.bits - 1:,} is the sensor's full scale, "
                 f"`full_scale_dn` of each image")  # fmt: skip
    return f"{size}, {kept.format.upper()} of {level}. Each is the aspect image of its own part."


def _files(plan: DataSetPlan) -> Iterator[str]:
    kept = plan.kept
    rows = [
        ("`annotations/`", "COCO files of the splits: masks as run lengths, boxes, areas, kinds, "
                           "`attributes` of each defect"),
        ("`images/`", "the aspect images, under the `file_name` of the annotations"),
        ("`masks/`", "PNG of 16 bits: 0 flawless, else `attributes.defect` of an annotation"),
        *([("`fusions/`", "the sequence's other fusions")] if kept.fusions else []),
        *([("`frames/`", "TIFFs with a page for each image of the sequence")] * kept.frames),
        ("`parts/`", "a record of each part: values, seeds, device, SHA-256 of its files"),
        ("`station.toml`", "what it was made from: `gpuspec dataset station.toml` makes it again"),
        ("`dataset.sha256`", "of every file, for `sha256sum --check`"),
    ]  # fmt: skip
    yield _table(("file", "what"), rows)


def _defects(plan: DataSetPlan, every: Sequence[Any]) -> Iterator[str]:
    yield "## Defects\n"
    yield (
        "`attributes` of an annotation: place, `size_mm` (diameter or width), `length_mm` of a "
        "scratch, `depth_um` (or height), `contrast_dn` and `peak_contrast_dn` (mean and highest "
        "level of the mask above the median around it), `found`: whether the station's own "
        "threshold detects a pixel of it. A mask is the defect's zone, within two standard "
        "deviations of its profile. The table has the 5th, 50th and 95th percentiles.\n"
    )
    rows = []
    for number, name in enumerate(plan.categories, 1):
        own = [a for a in every if a["category_id"] == number]
        found = sum(a["attributes"]["found"] for a in own)
        rows.append((name, f"{len(own):,}", f"{found:,}",
                     *(_percentiles(values_of(own, measure)) for measure in MEASURES)))  # fmt: skip
    yield _table(("category", "defects", "found", *MEASURES.values()), rows)


def _percentiles(values: Any) -> str:
    if not values.size:
        return "-"
    return " · ".join(f"{value:,.4g}" for value in np.percentile(values, _EVERY))


def _drawn(plan: DataSetPlan) -> Iterator[str]:
    yield (
        f"Every part has defects and noise of its own, of seeds that follow from `seed = "
        f"{plan.table.seed}` and its number; its record holds them."
        + (" Drawn for each, too:\n" if plan.draws else "\n")
    )
    if plan.draws:
        rows = [(f"`{d.key}`", str(d), "uniform" if d.between else "each as likely")
                for d in plan.draws]  # fmt: skip
        yield _table(("key", "values", "how"), rows)


def _notes(plan: DataSetPlan, unseen: int) -> Iterator[str]:
    yield (
        "The images are simulated. How well a detector trained on them does on a real part is to "
        "be measured on real frames."
    )
    yield from plan.notes
    if unseen:
        yield f"{unseen:,} more defects have no pixel in the image, and no annotation."
    yield from (f"Assumed: {one}" for one in assumptions(plan.station))


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
