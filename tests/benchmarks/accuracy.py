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

LENSES = ((5.0, 0.25, 0.010, 4.0), (5.0, 0.10, 0.002, 4.0))
"""Two more scenes, seen by a lens of 5 mm."""


def main() -> None:
    """Measure and print the table."""
    backend = open_backend("opencl")
    print(f"{backend.info}; errors in grey levels of 255, 32 x 32 pixels of 0.1 mm, 40 images\n")
    print(f"{'pupil sigma  depth gain':26}{'flawless':>9}{'maximum':>9}"
          f"{'1 rms':>8}{'max':>6}{'auto rms':>10}{'max':>6}{'8x8 rms':>9}{'max':>6}"
          f"{'vs float64':>12}")  # fmt: skip
    for pupil, sigma, depth, exposure, *_ in (*TABLE, *LENSES):
        station = check_station(pupil, sigma, depth, exposure)
        truth = oracle.aspect_image(oracle_scene(station), rays=4096)
        row = [np.median(truth), truth.max()]
        for side in (1, "auto", 8):
            error = backend.trace(station.replace(camera__subsampling=side)).aspect() - truth
            row += [np.sqrt((error**2).mean()), np.abs(error).max()]
        reference = NumpyBackend().trace(station).aspect()
        row.append(np.abs(backend.trace(station).aspect() - reference).max())
        print(f"{pupil:5g}{sigma:6g}{depth:7g}{exposure:5g}   {row[0]:9.2f}{row[1]:9.2f}"
              f"{row[2]:8.3f}{row[3]:6.2f}{row[4]:10.3f}{row[5]:6.2f}{row[6]:9.3f}{row[7]:6.2f}"
              f"{row[8]:12.5f}")  # fmt: skip


if __name__ == "__main__":
    main()
