"""How a detector learnt from a data set compares with the threshold: simulated parts, real frames.

    python tests/benchmarks/learning.py [FRAMES]

The detector and the station are those of the chapter on data sets. Both ways have a level; it is
the lowest with so many false blobs at most. On real frames (a folder, whole periods) nobody knows
the defects: false calls are counted on the image turned upside down about its background, on which
noise is as likely and scratches, which are bright, are dark.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from documents import CHECKOUT, blocks

import gpuspec
from gpuspec.detection.background import flattened, robust_sigma
from gpuspec.detection.score import score
from gpuspec.detection.segmentation import segment

CHAPTER = CHECKOUT / ".readme/datasets.md"
PARTS = 30
MIN_AREA_PX = 10
Floats = NDArray[Any]


def unpacked(folder: Path) -> ModuleType:
    """Write the chapter's files into a folder; return its detector."""
    for block in blocks(CHAPTER):
        if block.said.startswith("file: "):
            (folder / block.said.removeprefix("file: ")).write_text(block.text, "utf-8")
    spec = importlib.util.spec_from_file_location("learn", folder / "learn.py")
    assert spec and spec.loader
    learn = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(learn)
    return learn


def brightness(aspect: Floats, region: Floats) -> Floats:
    """The threshold's way: what is brighter than the local background, in robust sigmas."""
    flat = flattened(aspect, region, 41.0, smoothing_px=1.0)[0]
    return np.where(region, (flat - np.median(flat[region])) / robust_sigma(flat[region]), 0)


def at_false_blobs(maps: Sequence[Floats], truths: Sequence[Floats], most: int) -> dict[str, Any]:
    """Score at the lowest level with at most so many false blobs in all."""
    rows = []
    for level in np.unique(np.quantile(np.concatenate([m.ravel() for m in maps]),
                                       1 - np.geomspace(0.2, 1e-4, 40))):  # fmt: skip
        total = dict.fromkeys(("hit_px", "false_px", "zone_px", "false_blobs", "hit", "defects"), 0)
        for found, zones in zip(maps, truths, strict=True):
            everywhere = np.full(zones.shape, True)
            labels = segment(found, everywhere, float(level), min_area_px=MIN_AREA_PX)
            one = score(labels, zones, everywhere, int(zones.max())).as_dict()
            one["hit"] = one["defects_hit"]
            for name in total:
                total[name] += one[name]
        rows.append(total)
    # Above the highest level with too many: at very low ones all blobs are one.
    too_many = [i for i, row in enumerate(rows) if row["false_blobs"] > most]
    row = rows[min(max(too_many, default=-1) + 1, len(rows) - 1)]
    p1 = row["hit_px"] / max(row["hit_px"] + row["false_px"], 1)
    return {"P1": p1, "P2": row["hit_px"] / row["zone_px"], **row}


def simulated(learn: ModuleType, folder: Path, parts: int = PARTS) -> tuple[Any, dict[str, Any]]:
    """Make the data set and learn from it; return the trees, and the score of each way."""
    gpuspec.dataset(folder / "learn.toml", parts, folder / "set", format="tif", bits=32)
    trees = learn.learned(folder / "set")
    test = list(learn.samples(folder / "set", "test"))
    truths = [zones for _, zones in test]
    scored = {}
    for name, way in ways(learn, trees).items():
        maps = [way(aspect, np.full(aspect.shape, True)) for aspect, _ in test]
        scored[name] = at_false_blobs(maps, truths, len(test))
    return trees, scored


def ways(learn: ModuleType, trees: Any) -> dict[str, Callable[[Floats, Floats], Floats]]:
    """Each way from an aspect image to a map that a level is put on."""
    return {"threshold": brightness, "learnt": lambda *image: learn.likelihood(trees, *image)}


def real(
    learn: ModuleType, trees: Any, aspect: Floats, region: Floats, most: int
) -> dict[str, Any]:
    """Count the blobs of each way at the lowest level with so many on the turned image."""
    turned = np.float32(2 * np.median(aspect[region])) - aspect
    found: dict[str, Any] = {}
    labels = {}
    for name, way in ways(learn, trees).items():
        right, wrong = way(aspect, region), way(turned, region)
        levels = np.unique(np.quantile(right[region], 1 - np.geomspace(0.1, 1e-4, 40)))
        counts = [segment(wrong, region, float(v), min_area_px=MIN_AREA_PX).max() for v in levels]
        too_many = [i for i, count in enumerate(counts) if count > most]
        place = min(max(too_many, default=-1) + 1, len(levels) - 1)
        labels[name] = segment(right, region, float(levels[place]), min_area_px=MIN_AREA_PX)
        found[name] = {"blobs": int(labels[name].max()), "px": int((labels[name] > 0).sum()),
                       "turned": int(counts[place])}  # fmt: skip
    for name, other in (("threshold", "learnt"), ("learnt", "threshold")):
        met = np.unique(labels[name][labels[other] > 0])
        found[name]["met by the other"] = int((met > 0).sum())
    return found


def main() -> None:
    with tempfile.TemporaryDirectory() as given:
        folder = Path(given)
        learn = unpacked(folder)
        trees, scored = simulated(learn, folder)
        for name, row in scored.items():
            print(f"{name}: P1 {row['P1']:.3f}, P2 {row['P2']:.3f}, {row['hit']} of "
                  f"{row['defects']} defects hit, {row['false_blobs']} false blobs")  # fmt: skip
        if len(sys.argv) > 1:
            station = gpuspec.Station(camera={"sampling_mm": 0.1})
            taken = gpuspec.inspect(sys.argv[1], station, region="found:25")
            for most in (3, 10):
                found = real(learn, trees, taken.aspect, taken.region, most)
                for name, row in found.items():
                    print(f"real, at most {most} on the turned image: {name}: {row}")


if __name__ == "__main__":
    main()
