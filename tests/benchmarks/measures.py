"""Time what follows the aspect image: 10,000 blobs on 4000 x 1000 pixels.

Run from the root of the checkout: ``python -m tests.benchmarks.measures``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from gpuspec.detection.classes import DEFAULT_RULES, classify, confusion
from gpuspec.detection.measures import measure_blobs
from gpuspec.detection.score import score
from gpuspec.detection.segmentation import automatic_threshold, flawless_level, segment

T = TypeVar("T")

ROWS, COLUMNS = 1000, 4000
PITCH = (10, 40)


def scene() -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
    """Return an aspect image with a noisy background and 10,000 ellipses, and their zones."""
    rng = np.random.default_rng(0)
    down, along = PITCH
    ellipse = np.hypot(*np.ogrid[-3:4:7j, -3:4:29j]) <= 3
    blocks = (ROWS // down, COLUMNS // along)
    numbers = np.arange(1, blocks[0] * blocks[1] + 1, dtype=np.int32).reshape(blocks)
    cell = np.zeros(PITCH, np.int32)
    cell[1:8, 5:34] = ellipse
    truth = np.kron(numbers, cell).astype(np.int32)
    aspect = rng.normal(70, 0.5, truth.shape) + 60 * (truth > 0)
    return aspect.astype(np.float32), truth


def timed(what: str, call: Callable[[], T], repeats: int = 7) -> T:
    """Print the least time of a few calls, in ms, and return what the call returns."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    print(f"{what:<16}{1e3 * min(times):8.1f} ms")
    return result


def main() -> None:
    """Time each step once the one before is done."""
    aspect, truth = scene()
    valid = np.ones(aspect.shape, np.bool_)
    defects = int(truth.max())
    print(f"{defects} zones, {np.count_nonzero(truth)} zone pixels, {COLUMNS} x {ROWS} pixels")
    flawless = timed("flawless level", lambda: flawless_level(aspect, valid))
    threshold = timed(
        "threshold", lambda: automatic_threshold(aspect, valid, full_scale_dn=255, images=40)
    )
    labels = timed("label", lambda: segment(aspect, valid, threshold))
    timed("label, filtered", lambda: segment(aspect, valid, threshold, min_area_px=5))
    blobs = timed(
        "measure",
        lambda: measure_blobs(labels, aspect, sampling_mm=0.05, flawless_dn=flawless),
    )
    classes = timed("classify", lambda: classify(blobs, DEFAULT_RULES))
    timed("confusion", lambda: confusion(["dent"] * defects, truth, labels, classes))
    result = timed("score", lambda: score(labels, truth, valid, defects))
    print(f"{len(blobs)} blobs. {result.summary}")


if __name__ == "__main__":
    main()
