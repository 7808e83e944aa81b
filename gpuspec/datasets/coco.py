"""Records become COCO's annotation files, one for each split."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gpuspec.datasets.folder import Record
from gpuspec.datasets.plan import SPLITS, DataSetPlan
from gpuspec.version import __version__


def tables(plan: DataSetPlan, records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """Return what each split's annotation file holds.

    Annotations are numbered from 1 through all splits, part by part.

    Parameters
    ----------
    plan : DataSetPlan
    records : sequence of dict
        Of every part, by number.
    """
    found = {split: _empty(plan, split) for split in SPLITS}
    count = 0
    for record in records:
        own = found[record["image"]["split"]]
        own["images"].append(record["image"])
        for annotation in record["annotations"]:
            count += 1
            own["annotations"].append({"id": count, **annotation})
    return found


def write(folder: Path, of: dict[str, dict[str, Any]]) -> None:
    """Write the annotation files into a folder's ``annotations``.

    Parameters
    ----------
    folder : Path
    of : dict
        See :func:`tables`.
    """
    (folder / "annotations").mkdir()
    for split, table in of.items():
        text = json.dumps(table) + "\n"
        (folder / "annotations" / f"{split}.json").write_text(text, "utf-8")


def _empty(plan: DataSetPlan, split: str) -> dict[str, Any]:
    licence = plan.kept.licence
    return {
        "info": {
            "description": f"{plan.station.file}, {split}: simulated images of specular parts",
            "version": __version__,
            "contributor": "gpuspec",
        },
        "licenses": [{"id": 1, "name": licence, "url": ""}] if licence else [],
        "categories": [
            {"id": number, "name": name, "supercategory": "defect"}
            for number, name in enumerate(plan.categories, 1)
        ],
        "images": [],
        "annotations": [],
    }
