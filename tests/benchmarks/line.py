"""Time a line: 40 frames of 4 megapixels, 8 bit, in memory, to the decision; and PNG and NumPy.

Run from the root of the checkout: ``python -m tests.benchmarks.line``. Least of some repeats each;
the frames are those of the example `trim`, with noise.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable

import numpy as np
from PIL import Image

import gpuspec
from gpuspec.captured.line import Line, PartDecision
from gpuspec.host import processors

REPEATS = 7
LOCAL_MM = 5.0
"""Side of the window of a local background, 100 px."""


def least(call: Callable[[], object]) -> float:
    """Return the least time of some calls, s."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def decided(line: Line, frames: np.ndarray) -> tuple[float, float, PartDecision]:
    """Return how long adding a part's frames and deciding on it took, s, and the decision."""
    start = time.perf_counter()
    for frame in frames:
        line.add(frame)
    added = time.perf_counter()
    decision = line.decide()
    return added - start, time.perf_counter() - added, decision


def main() -> None:
    """Print adding, segmenting and decoding, and NumPy's sum and mean beside them."""
    station = gpuspec.example("trim").replace(sensor__noise=True)
    light_map = gpuspec.open_backend().trace(station)
    frames = np.stack([light_map.image(k).astype(np.uint8) for k in range(station.sequence.images)])
    count, rows, columns = frames.shape
    print(f"{count} frames of {columns} x {rows} pixels, 8 bit; {processors()} processors")
    summed = least(lambda: frames.sum(axis=0, dtype=np.uint16))
    mean = least(lambda: frames.mean(axis=0, dtype=np.float32))
    for name, window in (("one threshold", None), (f"background {LOCAL_MM:g} mm", LOCAL_MM)):
        line = Line(station.replace(segmentation__background_mm=window))
        runs = [decided(line, frames) for _ in range(REPEATS)]
        adding, deciding = min(run[0] for run in runs), min(run[1] for run in runs)
        whole = min(run[0] + run[1] for run in runs)
        found = len(runs[0][2].inspection.blobs)
        print(
            f"{name:<18}{1e3 * whole:7.0f} ms: adding {1e3 * adding:.0f}, segmenting and deciding "
            f"{1e3 * deciding:.0f}; {found} blobs"
        )
    rate = frames.size / adding / 1e9
    print(f"adding: {rate:.1f} Gpixel/s; NumPy's sum takes {summed / adding:.2f} times as long, ")
    print(f"its mean {mean / adding:.2f} times")
    file = io.BytesIO()
    Image.fromarray(frames[0]).save(file, "png")
    decoding = least(lambda: np.asarray(Image.open(io.BytesIO(file.getvalue()))))
    per_frame = adding / count
    print(
        f"decoding one frame's PNG: {1e3 * decoding:.1f} ms, {decoding / per_frame:.0f} times "
        f"adding it"
    )


if __name__ == "__main__":
    main()
