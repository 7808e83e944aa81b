"""Prints how fast the aspect image is made: this engine beside NumPy and Numba, in one run.

    python tests/benchmarks/aspect.py [--backend opengl] [--columns 4000 --rows 1000]

All work from the same light map, already traced (tracing has its own row). "copy" moves one light
coordinate per pixel to another place in the same memory: what the machine can move.
"""

from __future__ import annotations

import argparse
import math

import numba
import numpy as np

from gpuspec.light.device_test import Run, best, steps
from gpuspec.light.devices import open_backend
from gpuspec.station.station import Station


def numpy_mean(light, footprint, irradiance, a, period, gain, images):
    """Mean of all images, image by image, in plain NumPy float32."""
    total = np.zeros_like(light)
    for k in range(images):
        high = light - np.float32(k * period / images) + footprint / 2
        low = high - footprint
        lit = a * (np.floor(high / period) - np.floor(low / period))
        lit += np.minimum(high - np.floor(high / period) * period, a)
        lit -= np.minimum(low - np.floor(low / period) * period, a)
        total += np.minimum(gain * irradiance * lit / footprint, 1)
    return total * np.float32(255 / images)


@numba.njit(parallel=True, fastmath=True)
def numba_mean(light, footprint, irradiance, a, period, gain, images, out):
    """Mean of all images in a parallel Numba loop: the same trapezoid as the kernels."""
    for i in numba.prange(light.size):
        w = footprint[i]
        n = math.floor(w / period)
        rest = w - n * period
        e = np.float32(0.5) * (a + rest)
        low = max(a + rest - period, np.float32(0))
        high = min(rest, a)
        slope = gain * irradiance[i] / w
        centre = (light[i] - np.float32(0.5) * a) / period - np.float32(0.5) * n
        total = np.float32(0)
        for k in range(images):
            u = centre - np.float32(k) / np.float32(images)
            d = abs(u - np.rint(u)) * period
            q = min(max(e - d, low), high)
            total += min(slope * (n * a + q), np.float32(1))
        out[i] = total * np.float32(255) / np.float32(images)


def main() -> None:
    """Measure and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--columns", type=int, default=4000)
    options.add_argument("--rows", type=int, default=1000)
    options.add_argument("--backend", default="opencl")
    given = options.parse_args()
    station = Station.from_dict(
        {
            "camera": {"columns": given.columns, "rows": given.rows},
            "populations": [
                {"kind": "dent", "count": 40, "diameter_mm": [0.4, 1.0], "depth_um": [1, 10]}
            ],
        }
    )
    backend = open_backend(given.backend)
    print(f"{backend.info}, {given.columns} x {given.rows} pixels, best of 7\n")
    light_map = backend.trace(station)
    arrays = light_map.read()
    light, footprint, irradiance = (
        np.ascontiguousarray(a[0]).ravel()
        for a in (arrays.light_mm, arrays.footprint_mm, arrays.irradiance)
    )
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
            runs["trace (40 dents)"] = timed(trace, 13)
            for images in (8, 40, 400):
                design = station.replace(sequence__images=images)
                runs[f"closed form, {images} images"] = timed(start("closed_form", design), 16)
            for images in (40, 400):
                design = station.replace(sequence__images=images)
                runs[f"frame by frame, {images} images"] = timed(start("mean", design), 16, 3)
    runs["closed form, 40 images, brought home"] = (best(light_map.closed_form), 20)
    for images in (40, 400):
        runs[f"Numba, {images} images"] = (
            best(
                lambda k=images: numba_mean(light, footprint, irradiance, a, period, gain, k, out),
                3,
            ),
            16,
        )
    difference = np.abs(out - light_map.mean(station.replace(sequence__images=400)).ravel()).max()
    runs["NumPy, 40 images"] = (
        best(lambda: numpy_mean(light, footprint, irradiance, a, period, gain, 40), 1),
        16,
    )

    copy_rate = 8 * pixels / runs.get("copy of a light coordinate", (math.nan, 0))[0]
    numba_40, numpy_40 = runs["Numba, 40 images"][0], runs["NumPy, 40 images"][0]
    print(f"{'':38}{'ms':>9}{'GB/s':>8}{'of copy':>9}{'x Numba':>9}{'x NumPy':>9}")
    for name, (seconds, per_pixel) in runs.items():
        rate = per_pixel * pixels / seconds
        print(
            f"{name:38}{seconds * 1e3:9.2f}{rate / 1e9:8.2f}{rate / copy_rate:9.2f}"
            f"{numba_40 / seconds:9.2f}{numpy_40 / seconds:9.1f}"
        )
    print(f"\nlargest difference from Numba at 400 images: {difference:.5f} DN")
    print("x Numba, x NumPy: how many times faster than theirs at 40 images")


if __name__ == "__main__":
    main()
