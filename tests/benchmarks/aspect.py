"""Prints how fast the aspect image is made: this engine beside NumPy and Numba, in one run.

    python tests/benchmarks/aspect.py [--backend opengl] [--columns 4000 --rows 1000]

All work from the same light map, already traced (tracing has its own row). "copy" moves one light
coordinate per pixel to another place in the same memory: what the machine can move.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

import numba
import numpy as np

from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.light.speed import Run, best, steps
from gpuspec.part.relief import Relief
from gpuspec.station.examples import example
from gpuspec.station.station import Station

NARROW_MIN = np.float32(1e-5)
_SOME = 20
"""One pixel of so many is enough to time Numba's Poisson numbers."""
COUNTS = 8, 40, 400
"""Of images."""
ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


def numpy_mean(light, wide, narrow, irradiance, a, period, gain, images):
    """Mean of all images, image by image, in plain NumPy float32, of the same signal."""
    a = a / period
    w1, w2 = wide / period, np.maximum(narrow / period, NARROW_MIN)
    corner = np.minimum(w2, a)
    flank = np.maximum(np.minimum(w1, a), corner)
    edge = (np.maximum(w1, a) + flank + corner) / 2
    slope, bend = gain * irradiance * corner / (w1 * w2), HALF / corner
    centre = light / period - a / 2
    (overlap,) = np.nonzero((np.maximum(w1, a) < flank + corner) | (edge > HALF))

    def risen(y, corner, flank, bend):
        y = np.minimum(y, flank + corner)
        straight = np.maximum(y - corner, 0)
        return straight + (np.clip(y, 0, corner) ** 2 - np.maximum(y - flank, 0) ** 2) * bend

    some = corner[overlap], flank[overlap], bend[overlap]
    total = np.zeros_like(light)
    for k in range(images):
        u = centre - np.float32(k / images)
        d = np.abs(u - np.rint(u))
        value = risen(edge - d, corner, flank, bend)
        near, far = edge[overlap] - d[overlap], edge[overlap] + d[overlap]
        value[overlap] += risen(near - 1, *some) + risen(far, *some) + risen(far - 1, *some)
        value[overlap] -= some[1]
        total += np.minimum(slope * value, 1)
    return total * np.float32(255 / images)


@numba.njit(fastmath=True)
def sides(wide, narrow, irradiance, share, gain):
    """What a pixel sees of a stripe: edge, flank, corner, slope, and whether sides overlap."""
    narrow = max(narrow, NARROW_MIN)
    corner = min(narrow, share)
    flank = max(min(wide, share), corner)
    widest = max(wide, share)
    edge = HALF * (widest + flank + corner)
    slope = gain * irradiance * corner / (wide * narrow)
    return edge, flank, corner, slope, widest < flank + corner or edge > HALF


@numba.njit(fastmath=True)
def risen(y, flank, corner, bend):
    """How far a side has risen at y from its foot."""
    y = min(y, flank + corner)
    toe = min(max(y, ZERO), corner)
    shoulder = max(y - flank, ZERO)
    return max(y - corner, ZERO) + (toe * toe - shoulder * shoulder) * bend


@numba.njit(fastmath=True)
def everything_risen(edge, d, flank, corner, bend):
    """The same of all four sides that may reach a place."""
    near = risen(edge - d, flank, corner, bend) + risen(edge - d - ONE, flank, corner, bend)
    far = risen(edge + d, flank, corner, bend) + risen(edge + d - ONE, flank, corner, bend)
    return near + far - flank


@numba.njit(parallel=True, fastmath=True)
def numba_mean(light, wide, narrow, irradiance, a, period, gain, images, out):
    """Mean of all images in a parallel Numba loop: the same signal as the kernels'."""
    share, step = a / period, ONE / np.float32(images)
    for i in numba.prange(light.size):
        edge, flank, corner, slope, overlap = sides(
            wide[i] / period, narrow[i] / period, irradiance[i], share, gain
        )
        bend = HALF / corner
        centre = light[i] / period - HALF * share
        total = ZERO
        if overlap:
            for k in range(images):
                u = centre - np.float32(k) * step
                value = everything_risen(edge, abs(u - np.rint(u)), flank, corner, bend)
                total += min(slope * value, ONE)
        else:
            for k in range(images):
                u = centre - np.float32(k) * step
                total += min(slope * risen(edge - abs(u - np.rint(u)), flank, corner, bend), ONE)
        out[i] = total * np.float32(255) / np.float32(images)


@numba.njit(parallel=True, fastmath=True)
def numba_noisy_mean(light, wide, narrow, irradiance, a, period, gain, images, full, read, out):
    """The same with noise: a Poisson number of electrons, read noise, rounding, in every image."""
    share, step = a / period, ONE / np.float32(images)
    for i in numba.prange(light.size):
        edge, flank, corner, slope, _ = sides(
            wide[i] / period, narrow[i] / period, irradiance[i], share, gain
        )
        bend = HALF / corner
        centre = light[i] / period - HALF * share
        total = ZERO
        for k in range(images):
            u = centre - np.float32(k) * step
            signal = slope * risen(edge - abs(u - np.rint(u)), flank, corner, bend)
            electrons = np.random.poisson(full * signal)  # noqa: NPY002 - what Numba compiles
            electrons += read * np.random.normal()  # noqa: NPY002
            total += min(max(np.rint(np.float32(255) / full * electrons), ZERO), np.float32(255))
        out[i] = total / np.float32(images)


def main() -> None:
    """Measure and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--columns", type=int, default=4000)
    options.add_argument("--rows", type=int, default=1000)
    options.add_argument("--backend", default="opencl")
    given = options.parse_args()
    station = Station.from_dict(
        {
            "camera": {"columns": given.columns, "rows": given.rows, "subsampling": 1},
            "populations": [
                {"kind": "dent", "count": 40, "diameter_mm": [0.4, 1.0], "depth_um": [1, 10]}
            ],
        }
    )
    backend = open_backend(given.backend)
    print(f"{backend.info}, {given.columns} x {given.rows} pixels, best of 7\n")
    light_map = backend.trace(station)
    arrays = light_map.read()
    planes = [
        np.ascontiguousarray(a[0]).ravel()
        for a in (arrays.light_mm, arrays.wide_mm, arrays.narrow_mm, arrays.irradiance)
    ]
    light = planes[0]
    pixels = light.size
    a, period, gain = np.float32(4), np.float32(16), np.float32(4)
    out = np.empty_like(light)
    runs: dict[str, tuple[float, int]] = {}

    if given.backend != "numpy":
        with light_map.failures():
            finish, copy, trace, start = steps(backend, light_map)

            def timed(run: Run, per_pixel: int, times: int = 7) -> tuple[float, int]:
                return best(lambda: (run(), finish()), times), per_pixel

            runs["copy of a light coordinate"] = timed(copy, 8)
            runs["trace (40 dents)"] = timed(trace, 17)
            for images in COUNTS:
                design = station.replace(sequence__images=images)
                runs[f"closed form, {images} images"] = timed(start("closed_form", design), 20)
            for images in COUNTS:
                design = station.replace(sequence__images=images)
                runs[f"frame by frame, {images} images"] = timed(start("mean", design), 20, 3)
            noisy = station.replace(sensor__noise=True)
            runs["frame by frame, 40 images with noise"] = timed(start("mean", noisy), 20, 3)
    runs["closed form, 40 images, brought home"] = (best(light_map.closed_form), 24)
    for images in COUNTS:
        runs[f"Numba, {images} images"] = (
            best(lambda k=images: numba_mean(*planes, a, period, gain, k, out), 3),
            20,
        )
    difference = np.abs(out - light_map.mean(station.replace(sequence__images=400)).ravel()).max()
    runs["NumPy, 40 images"] = (
        best(lambda: numpy_mean(*planes, a, period, gain, 40), 1),
        20,
    )
    full, read = np.float32(station.sensor.saturation_e), np.float32(station.sensor.read_noise_e)
    some = [np.ascontiguousarray(plane[::_SOME]) for plane in (*planes, out)]
    runs["Numba, 40 images with noise"] = (
        _SOME
        * best(lambda: numba_noisy_mean(*some[:4], a, period, gain, 40, full, read, some[4]), 1),
        20,
    )

    copy_rate = 8 * pixels / runs.get("copy of a light coordinate", (math.nan, 0))[0]
    rivals = {name: seconds for name, (seconds, _) in runs.items() if name.startswith("Num")}
    print(f"{'':38}{'ms':>9}{'GB/s':>8}{'of copy':>9}{'x Numba':>9}{'x NumPy':>9}")
    for name, (seconds, per_pixel) in runs.items():
        rate = per_pixel * pixels / seconds
        images = name.partition(", ")[2].removesuffix(", brought home")
        images = images if f"Numba, {images}" in rivals else "40 images"
        faster = rivals[f"Numba, {images}"] / seconds
        print(
            f"{name:38}{seconds * 1e3:9.2f}{rate / 1e9:8.2f}{rate / copy_rate:9.2f}"
            f"{faster:9.2f}{rivals['NumPy, 40 images'] / seconds:9.1f}"
        )
    print(f"\nlargest difference from Numba at 400 images: {difference:.5f} DN")
    print("x Numba: how many times faster than its loop over as many images (else over 40)")
    print("x NumPy: than NumPy's at 40 images\n")
    light_map.release()
    automatic(backend)


def automatic(backend: Backend) -> None:
    """Print what sub-rays where they matter cost on the demo's part, in turn with one footprint."""
    station = example("trim")
    relief = Relief.of(station)
    designs = station, station.replace(camera__subsampling=1)
    traced = tuple(backend.trace(design, relief) for design in designs)
    counts = ", ".join(
        f"{count:,} pixels {f'of {cut} x {cut}' if cut > 0 else f'in {-cut} slices'}"
        for cut, count in traced[0].refined.items()
    )
    print(f"automatic sub-rays on the demo's part: {counts}")
    print(f"{'ms, images brought home':38}{'auto':>9}{'1':>9}{'ratio':>9}")
    noisy = station.replace(sensor__noise=True)
    works: dict[str, Callable[[int], object]] = {
        "light map": lambda i: backend.trace(designs[i], relief).faulty(),
        "closed form": lambda i: traced[i].closed_form(),
        "frame by frame, 40 images": lambda i: traced[i].mean(),
        "the same with noise": lambda i: traced[i].mean(traced[i].under(noisy)),
    }
    for name, work in works.items():
        auto, one = (min(spans) for spans in zip(*in_turn(work), strict=True))
        print(f"{name:38}{auto * 1e3:9.2f}{one * 1e3:9.2f}{auto / one:9.2f}")


def in_turn(work: Callable[[int], object]) -> list[tuple[float, float]]:
    """Return seconds of both works, one after the other, so that a machine's drift meets both."""
    return [(best(lambda: work(0), 1), best(lambda: work(1), 1)) for _ in range(7)]


if __name__ == "__main__":
    main()
