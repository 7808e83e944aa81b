"""Prints all ratios of speed and error in one run: each other benchmark, one after another.

    python tests/benchmarks/ratios.py

Beside NumPy, Numba and a path tracer; beside Mitsuba 3, too, where it is installed.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

RUNS = (
    "aspect.py",
    "trace.py",
    "sweep.py --designs 64",
    "path_tracer.py --scenes 1 --rays 1024 --mitsuba-rays 16 256 1024",
    "commands.py",
)


def main() -> None:
    """Run them all, each in a process of its own."""
    here = Path(__file__).parent
    for run in RUNS:
        name, *options = run.split()
        print(f"\n--- {run}\n", flush=True)
        subprocess.run([sys.executable, here / name, *options], check=True)


if __name__ == "__main__":
    main()
