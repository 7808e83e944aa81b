"""Prints how fast the aspect image is made: this engine beside NumPy and Numba, in one run.

    python tests/benchmarks/aspect.py [--backend opengl] [--columns 4000 --rows 1000]

All work from the same light map, already traced (tracing has its own row). "copy" moves one light
coordinate per pixel to another place in the same memory: what the machine can move.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np

from gpuspec.backends import open_backend
from gpuspec.opencl import OpenCLBackend
from gpuspec.opengl import OpenGLBackend
from gpuspec.parameters import design_block
from gpuspec.sources import resolved_shader
from gpuspec.station import Station
from gpuspec.vulkan import GROUP, VulkanBackend

Run = Callable[[], object]
Steps = tuple[Run, Run, Callable[[str, Station], Run]]


def best(run: Run, times: int = 7) -> float:
    """Return the shortest of some runs in seconds, after one to warm up."""
    run()
    spans = []
    for _ in range(times):
        start = time.perf_counter()
        run()
        spans.append(time.perf_counter() - start)
    return min(spans)


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


def opencl_steps(b: OpenCLBackend, light_map: Any, shape: tuple[int, int]) -> Steps:
    """Return how OpenCL finishes, copies a light coordinate, and starts what makes images."""
    tile, size = light_map._kept[0], light_map.stride * shape[0]
    grey = b.empty(4 * size)
    kernel = b.program(
        "__kernel void copy(__global const float8 *a, __global float8 *b)"
        "{ size_t i = get_global_id(0); b[i] = a[i]; }",
        "copy",
    ).copy

    def start(what: str, station: Station) -> Run:
        return partial(light_map.enqueue, tile, what, b.constant(design_block(station)), 0, grey)

    return b.queue.finish, partial(kernel, b.queue, (size // 8,), None, tile.light, grey), start


def opengl_steps(b: OpenGLBackend, light_map: Any, shape: tuple[int, int]) -> Steps:
    """Return the same of OpenGL; its copy is a fragment shader from texture to texture."""
    grey, other = b.target(shape[::-1], 1), b.target(shape[::-1], 1)
    text = "uniform sampler2D a; out float b;"
    text += "void main() { b = texelFetch(a, ivec2(gl_FragCoord.xy), 0).x; }"
    copy = b.build(*resolved_shader(text, "copy", 330))

    def start(what: str, station: Station) -> Run:
        return partial(light_map.draw, light_map._kept[0], what, station, 0, [grey])

    zero = np.zeros(4, np.float32)
    return b.context.finish, partial(b.draw, copy, [grey], zero, {"a": other}), start


def vulkan_steps(b: VulkanBackend, light_map: Any, shape: tuple[int, int]) -> Steps:
    """Return the same of Vulkan; its copy is a compute shader from buffer to buffer."""
    tile, grey, one = light_map._kept[0], b.empty(4 * math.prod(shape)), np.empty(1, np.float32)
    text = f"""layout(local_size_x = {GROUP}) in;
        layout(std430, set = 0, binding = 0) readonly buffer A {{ float a[]; }};
        layout(std430, set = 0, binding = 1) buffer B {{ float b[]; }};
        void main() {{
            uint i = gl_GlobalInvocationID.y * {shape[1]}u + gl_GlobalInvocationID.x;
            if (gl_GlobalInvocationID.x < {shape[1]}u) b[i] = a[i];
        }}"""
    copy = b.program(*resolved_shader(text, "copy", 450), ("read-only-storage", "storage"))

    def start(what: str, station: Station) -> Run:
        return partial(light_map.enqueue, tile, what, station, 0, grey)

    run = partial(b.enqueue, copy, (tile.light, grey), shape[1], shape[0])
    return partial(b.copy_home, one, grey), run, start


STEPS: dict[type, Callable[..., Steps]] = {
    OpenCLBackend: opencl_steps,
    OpenGLBackend: opengl_steps,
    VulkanBackend: vulkan_steps,
}


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

    if type(backend) in STEPS:
        with light_map.failures():
            finish, copy, start = STEPS[type(backend)](backend, light_map, station.shape)
            trace = partial(light_map.trace_tile, 0, given.rows)

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
