"""Frames that a path tracer rendered, inspected as a camera's are: what is found of the defects.

*Mitsuba* 3 renders them where it is installed, else the brute force of `path_tracer.py`. The frames
are PNG files of 8 bit; `gpuspec inspect` is told of the station alone its scale and segmentation.

    python tests/benchmarks/rendered_frames.py --seed 101 --rays 256
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import oracle
from path_tracer import brute_force, hold_out, mitsuba_scene
from PIL import Image
from scenes import oracle_scene

import gpuspec
from gpuspec.light.devices import open_backend

ROWS = 8  # pixels' rows at once


def frames(scene: oracle.Scene, follow: Callable[..., np.ndarray], rays: int) -> np.ndarray:
    """Every image of the sequence, 8 bit, shape (K, M, N)."""
    shape = scene.rows, scene.columns
    x, y = (c.reshape(shape) for c in oracle.pixel_centres(scene))
    points = oracle.even_points(rays, 4 if scene.pupil_mm > 0 else 2)
    shifts = np.random.default_rng(1).random((*shape, 1, points.shape[1]))
    step = scene.period_mm / scene.images
    found = np.empty((scene.images, *shape), np.uint8)
    for first in range(0, scene.rows, ROWS):
        some = slice(first, first + ROWS)
        even = np.mod(points + shifts[some], 1.0)
        at = [c[some, :, None] + (even[..., i] - 0.5) * scene.sampling_mm
              for i, c in enumerate((x, y))]  # fmt: skip
        light = follow(*(v.ravel() for v in (*at, even[..., -2], even[..., -1])))
        light = light.reshape(at[0].shape)
        for k in range(scene.images):
            lit = np.mod(light - k * step, scene.period_mm) < scene.luminous_mm  # NaN: dark
            seen = np.minimum(scene.exposure * lit.mean(axis=-1), 1)
            found[k, some] = np.rint(scene.full_scale * seen)
    return found


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--seed", type=int, default=101, help="of the scene")
    options.add_argument("--pupil", type=float, default=0.0, help="of the lens, mm")
    options.add_argument("--rays", type=int, default=256, help="of each pixel")
    given = options.parse_args()
    station = hold_out(given.seed, given.pupil)
    scene = oracle_scene(station)
    follow = mitsuba_scene(scene)
    name = "brute force" if follow is None else "Mitsuba"
    taken = frames(scene, follow or brute_force(scene), given.rays)
    simulated = gpuspec.simulate(station, open_backend())
    with tempfile.TemporaryDirectory() as folder:
        for k, frame in enumerate(taken):
            Image.fromarray(frame).save(Path(folder) / f"{k:03}.png")
        found = gpuspec.inspect(folder, station, truth=simulated.truth)
    seen = simulated.lost == 0
    gap = (found.aspect - simulated.aspect)[seen]
    print(f"{len(taken)} frames by {name}, {given.rays} rays a pixel; aspect image against the "
          f"simulated: rms {math.sqrt(float(np.mean(gap**2))):.2f} DN")  # fmt: skip
    print(*found.warnings, sep="\n")
    for which, result in (("frames", found), ("simulation", simulated)):
        print(f"{which:10}: above {result.threshold:.1f} DN, {result.score}")


if __name__ == "__main__":
    main()
