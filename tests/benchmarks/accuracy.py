"""Prints how close aspect images are to 4,096 rays per pixel, on the model's check scenes.

python tests/benchmarks/accuracy.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

import oracle
from scenes import TABLE, check_station, oracle_scene

from gpuspec.light.devices import open_backend
from gpuspec.light.float64_backend import NumpyBackend


def main() -> None:
    """Measure and print the table."""
    backend = open_backend("opencl")
    print(f"{backend.info}; errors in grey levels of 255, 32 x 32 pixels of 0.1 mm, 40 images\n")
    print(f"{'pupil sigma  depth gain':26}{'flawless':>9}{'maximum':>9}"
          f"{'rms':>8}{'max':>7}{'2x2 rms':>9}{'2x2 max':>9}{'vs float64':>12}")  # fmt: skip
    for pupil, sigma, depth, exposure, _, _ in TABLE:
        station = check_station(pupil, sigma, depth, exposure)
        truth = oracle.aspect_image(oracle_scene(station), rays=4096)
        row = [np.median(truth), truth.max()]
        for side in (1, 2):
            error = backend.trace(station.replace(camera__subsampling=side)).aspect() - truth
            row += [np.sqrt((error**2).mean()), np.abs(error).max()]
        reference = NumpyBackend().trace(station).aspect()
        row.append(np.abs(backend.trace(station).aspect() - reference).max())
        print(f"{pupil:5g}{sigma:6g}{depth:7g}{exposure:5g}   {row[0]:9.2f}{row[1]:9.2f}"
              f"{row[2]:8.3f}{row[3]:7.2f}{row[4]:9.3f}{row[5]:9.2f}{row[6]:12.5f}")  # fmt: skip


if __name__ == "__main__":
    main()
