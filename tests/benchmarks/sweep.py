"""Prints how fast designs are tried, beside NumPy with scikit-image and Numba, in one run.

    python tests/benchmarks/sweep.py [--device NAME] [--columns 4000 --rows 1024] [--designs 256]

Every design is scored at 256 thresholds: P1, P2 and defects hit. The light map is traced already
but where it says "whole command": there a new folder is filled, plan, tracing and table included.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from aspect import best, numba_mean, numpy_mean
from skimage.measure import label

from gpuspec.light.opencl import OpenCLBackend
from gpuspec.part.truth import Truth
from gpuspec.station.examples import example
from gpuspec.station.station import Station
from gpuspec.sweeps.choosing.front import Front
from gpuspec.sweeps.crew import Alone
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.bench import Bench
from gpuspec.sweeps.trying.screening import STRATA

GRID = {
    "tunnel.luminous_mm": "0.5:8:16",
    "tunnel.dark_mm": "2:24:12",
    "sensor.exposure": "1:8:8",
    "sequence.images": "8:80:10",
}


def timed(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def copy_rate(b: OpenCLBackend, pixels: int) -> float:
    """Return bytes per second of a copy on the device, read and written."""
    one, other = b.empty(4 * pixels), b.empty(4 * pixels)

    def run() -> None:
        b.cl.enqueue_copy(b.queue, other, one)
        b.queue.finish()

    return 8 * pixels / best(run)


def main() -> None:
    asked = argparse.ArgumentParser()
    asked.add_argument("--device")
    asked.add_argument("--columns", type=int, default=4000)
    asked.add_argument("--rows", type=int, default=1024)
    asked.add_argument("--designs", type=int, default=256)
    options = asked.parse_args()
    b = OpenCLBackend(options.device)
    station = example("trim").replace(
        **{
            "part.width_mm": max(50.0, options.rows * 0.05),
            "camera.columns": options.columns,
            "camera.rows": options.rows,
        }
    )
    pixels = options.columns * options.rows
    print(f"{b.info}; {options.columns} x {options.rows} pixels, 40 images, 256 thresholds")

    whole = Plan.of(station, GRID, samples=STRATA)
    bench = Bench(whole, b)
    few, many = (
        np.linspace(0, whole.designs - 1, count).astype(int).tolist()
        for count in (options.designs, 4096)
    )
    rate = copy_rate(b, pixels)
    rows = [("exact", len(few) / best(lambda: bench.rows(few, sampled=False), 3))]
    rows += [("screening", len(many) / best(lambda: bench.rows(many, sampled=True), 3))]

    with tempfile.TemporaryDirectory() as folder:
        span = timed(lambda: sweep(whole, Path(folder) / "run", crew=Alone(Bench(whole, b))))
        run = sweep(whole, Path(folder) / "run", crew=Alone(Bench(whole, b)))
        exact = sum(int(np.count_nonzero(t["exact"])) for t in run.batches(["exact"]))
        front = Front()
        for table in run.batches():
            front.add(table)
        on_front = np.unique(front.points().design).size
    name = f"screening, whole command of {whole.designs:,} designs"
    rows += [(name, whole.designs / span)]

    rows += numpy_rows(station, b)
    slowest = rows[-1][1]
    print(f"{'':56}{'designs/s':>12}{'x NumPy':>10}{'GB/s of light map':>20}{'of copy':>9}")
    for name, speed in rows:
        read = f"{speed * pixels * 12 / 1e9:>20.1f}" if name == "exact" else f"{'':>20}"
        share = f"{speed * pixels * 12 / rate:>9.2f}" if name == "exact" else ""
        print(f"{name:56}{speed:>12,.3g}{speed / slowest:>10,.0f}{read}{share}")
    print(f"copy on the device: {rate / 1e9:.1f} GB/s, read and written")
    print(f"of the screened designs {exact} were made exact, {on_front} are on the front")


def numpy_rows(station: Station, b: OpenCLBackend) -> list[tuple[str, float]]:
    """Return designs/s of NumPy and Numba, with scikit-image for the segmentation."""
    light_map = b.trace(station).read()
    light, footprint, irradiance = (
        getattr(light_map, name)[0].astype(np.float32)
        for name in ("light_mm", "footprint_mm", "irradiance")
    )
    from gpuspec.part.relief import Relief

    truth = Truth.of(station, Relief.of(station)).labels
    tunnel, sensor = station.tunnel, station.sensor
    given = [np.float32(v) for v in (tunnel.luminous_mm, tunnel.period_mm, sensor.exposure)]
    images = station.sequence.images
    flat = np.empty(light.size, np.float32)

    def by_numba() -> np.ndarray:
        numba_mean(light.ravel(), footprint.ravel(), irradiance.ravel(), *given, images, flat)
        return flat.reshape(light.shape)

    def scored(aspect: np.ndarray, thresholds: range) -> None:
        for threshold in thresholds:
            labels = label(aspect > threshold, connectivity=2)
            detected = labels > 0
            hit = np.count_nonzero(detected & (truth > 0))
            _ = hit / max(np.count_nonzero(detected), 1), hit / np.count_nonzero(truth)
            np.count_nonzero(np.bincount(truth[detected])[1:])

    aspect = by_numba().copy()
    segmenting = timed(lambda: scored(aspect, range(256)))
    by_hand = timed(lambda: numpy_mean(light, footprint, irradiance, *given, images))
    return [
        ("Numba, scikit-image at 256 thresholds", 1 / (best(by_numba, 3) + segmenting)),
        ("NumPy, scikit-image at one threshold", 1 / (by_hand + segmenting / 256)),
        ("NumPy, scikit-image at 256 thresholds", 1 / (by_hand + segmenting)),
    ]


if __name__ == "__main__":
    main()
