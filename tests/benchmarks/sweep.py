"""Prints how fast designs are tried, beside NumPy with scikit-image and Numba, in one run.

    python tests/benchmarks/sweep.py [--device NAME] [--columns 4000 --rows 1024] [--designs 256]
                                     [--geometry]

Every design is scored at 256 thresholds: P1, P2 and defects hit. The light map is traced already
but where it says "whole command": there a new folder is filled, plan, tracing and table included,
and in the last table, where each design has a light map of its own.
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

from gpuspec.light.constants import NO_PIXEL
from gpuspec.light.opencl import OpenCLBackend, OpenCLLightMap
from gpuspec.light.tiles import PlanarTile
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
    asked.add_argument("--geometry", action="store_true", help="only the table of geometries")
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
    if options.geometry:
        geometries(station, b)
        return

    whole = Plan.of(station, GRID, samples=STRATA)
    bench = Bench(whole, b)
    few, many = (
        np.linspace(0, whole.designs - 1, count).astype(int).tolist()
        for count in (options.designs, 4 * options.designs)
    )
    rate = copy_rate(b, pixels)
    rows = [("exact", len(few) / best(lambda: bench.rows(few, sampled=False), 3))]
    one = Bench(Plan.of(station.replace(camera__subsampling=1), GRID, samples=STRATA), b)
    rows += [("exact, one footprint", len(few) / best(lambda: one.rows(few, sampled=False), 3))]
    noisy = Bench(Plan.of(station.replace(sensor__noise=True), GRID, samples=STRATA), b)
    rows += [("exact, with noise", len(few) / best(lambda: noisy.rows(few, sampled=False), 3))]
    rows += [("screening", len(many) / best(lambda: bench.rows(many, sampled=True), 3))]
    rows += [
        ("screening, one footprint", len(many) / best(lambda: one.rows(many, sampled=True), 3))
    ]
    rows += [("screening, with noise", len(many) / best(lambda: noisy.rows(many, sampled=True), 3))]

    with tempfile.TemporaryDirectory() as folder:
        span = timed(lambda: sweep(whole, Path(folder) / "run", crew=Alone(Bench(whole, b))))
        run = sweep(whole, Path(folder) / "run", crew=Alone(Bench(whole, b)))
        exact = sum(int(np.count_nonzero(t["exact"])) for t in run.batches(["exact"]))
        front = Front()
        for table in run.batches():
            front.add(table)
        on_front = np.unique(front.points().design).size
    with tempfile.TemporaryDirectory() as folder:
        alone = Alone(Bench(one.plan, b))
        faster = timed(lambda: sweep(one.plan, Path(folder) / "run", crew=alone))
    name = f"screening, whole command of {whole.designs:,} designs"
    rows += [(name, whole.designs / span), (f"{name}, one footprint", whole.designs / faster)]

    rows += numpy_rows(station, b)
    slowest = rows[-1][1]
    print(f"{'':64}{'designs/s':>12}{'x NumPy':>10}{'GB/s of light map':>20}{'of copy':>9}")
    for name, speed in rows:
        read = f"{speed * pixels * 16 / 1e9:>20.1f}" if name == "exact" else f"{'':>20}"
        share = f"{speed * pixels * 16 / rate:>9.2f}" if name == "exact" else ""
        print(f"{name:64}{speed:>12,.3g}{speed / slowest:>10,.0f}{read}{share}")
    speeds = dict(rows)
    for name in ("exact", "screening"):
        ratio = speeds[f"{name}, with noise"] / speeds[name]
        better = speeds[name] / speeds[f"{name}, one footprint"]
        print(f"{name}: {better:.2f} of the rate of one footprint, with noise {ratio:.2f} of it")
    print(f"the whole command: {faster / span:.2f} of the rate of one footprint")
    print(f"copy on the device: {rate / 1e9:.1f} GB/s, read and written")
    print(f"of the screened designs {exact} were made exact, {on_front} are on the front")
    geometries(station, b)


VARIED = {
    "tunnel": ("tunnel.height_mm", 150.0, 400.0),
    "camera": ("camera.height_mm", 600.0, 1000.0),
    "sampling": ("camera.sampling_mm", 0.05, 0.06),
    "part": ("part.crown_radius_x_mm", 3000.0, 9000.0),
}
"""What needs a new light map for every design, and from where to where it is varied."""


def geometries(station: Station, b: OpenCLBackend) -> None:
    """Print how fast designs are tried of which each has a light map of its own."""
    print(
        f"{'a light map for every design':40}{'designs/s':>12}{'best':>9}{'rays':>12}{'fewer':>8}"
    )
    for rays in (1, "auto"):
        base = station.replace(camera__subsampling=rays)
        for name, (key, low, high) in VARIED.items():
            plan = Plan.of(base, {key: f"{low}:{high}:600"}, samples=STRATA)
            for sampled, count in ((True, 40), (False, 4)):
                traced = Rays()
                bench = Bench(plan, b)
                numbers = iter(range(600))
                bench.rows([next(numbers), next(numbers)], sampled=sampled)
                with traced:
                    spans = [
                        timed(lambda: bench.rows([next(numbers)], sampled=sampled))  # noqa: B023
                        for _ in range(count)
                    ]
                each = traced.count / count
                way = "screened" if sampled else "exact"
                whole = np.prod(base.shape)
                print(
                    f"{f'{name}, {rays} sub-rays, {way}':40}{1 / np.median(spans):>12.3g}"
                    f"{1 / min(spans):>9.3g}{each:>12,.0f}{whole / each:>8.1f}"
                )


class Rays:
    """Counts the rays that an OpenCL backend traces inside a block."""

    count = 0

    def __enter__(self) -> None:
        self._real = real = OpenCLLightMap.trace_tile

        def counted(light_map: OpenCLLightMap, first_row: int, rows: int) -> PlanarTile:
            pixels = rows * light_map.grid[1]
            if light_map.pixels is not None:
                pixels = min(pixels, np.count_nonzero(light_map.pixels != NO_PIXEL))
            self.count += pixels * light_map.station.camera.sub_rays
            return real(light_map, first_row, rows)

        OpenCLLightMap.trace_tile = counted  # type: ignore[method-assign]

    def __exit__(self, *_: object) -> None:
        OpenCLLightMap.trace_tile = self._real  # type: ignore[method-assign]


def numpy_rows(station: Station, b: OpenCLBackend) -> list[tuple[str, float]]:
    """Return designs/s of NumPy and Numba, with scikit-image for the segmentation."""
    light_map = b.trace(station).read()
    planes = [
        getattr(light_map, name)[0].astype(np.float32).ravel()
        for name in ("light_mm", "wide_mm", "narrow_mm", "irradiance")
    ]
    from gpuspec.part.relief import Relief

    truth = Truth.of(station, Relief.of(station)).labels
    tunnel, sensor = station.tunnel, station.sensor
    given = [np.float32(v) for v in (tunnel.luminous_mm, tunnel.period_mm, sensor.exposure)]
    images = station.sequence.images
    flat = np.empty_like(planes[0])

    def by_numba() -> np.ndarray:
        numba_mean(*planes, *given, images, flat)
        return flat.reshape(station.shape)

    def scored(aspect: np.ndarray, thresholds: range) -> None:
        for threshold in thresholds:
            labels = label(aspect > threshold, connectivity=2)
            detected = labels > 0
            hit = np.count_nonzero(detected & (truth > 0))
            _ = hit / max(np.count_nonzero(detected), 1), hit / np.count_nonzero(truth)
            np.count_nonzero(np.bincount(truth[detected])[1:])

    aspect = by_numba().copy()
    segmenting = timed(lambda: scored(aspect, range(256)))
    by_hand = timed(lambda: numpy_mean(*planes, *given, images))
    return [
        ("Numba, scikit-image at 256 thresholds", 1 / (best(by_numba, 3) + segmenting)),
        ("NumPy, scikit-image at one threshold", 1 / (by_hand + segmenting / 256)),
        ("NumPy, scikit-image at 256 thresholds", 1 / (by_hand + segmenting)),
    ]


if __name__ == "__main__":
    main()
