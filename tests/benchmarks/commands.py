"""Prints how long the commands take, and how much memory: cold (no kernel built) and warm.

python tests/benchmarks/commands.py
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def measured(command: list[str], cache: str, folder: str) -> tuple[float, float]:
    """Run a command; return seconds and peak resident memory in MB."""
    environment = {**os.environ, "XDG_CACHE_HOME": cache, "POCL_CACHE_DIR": f"{cache}/pocl"}
    start = time.perf_counter()
    process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{' '.join(command)} failed")
    return time.perf_counter() - start, usage.ru_maxrss / 1024


def main() -> None:
    """Measure and print the table."""
    program = str(Path(sys.executable).with_name("gpuspec"))
    folder, cache = tempfile.mkdtemp(), tempfile.mkdtemp()
    print(f"{'':38}{'s':>7}{'MB':>7}")
    for name, arguments in (
        ("gpuspec --help", ["--help"]),
        ("gpuspec demo, cold", ["demo"]),
        ("gpuspec demo, warm", ["demo"]),
        ("the same without pictures", ["demo", "--no-pictures"]),
        ("the same with --frames", ["demo", "--frames"]),
        ("the same with noise", ["demo", "--set", "sensor.noise=true"]),
    ):
        seconds, memory = measured([program, *arguments], cache, folder)
        print(f"{name:38}{seconds:7.2f}{memory:7.0f}")
    shutil.rmtree(folder)
    shutil.rmtree(cache)


if __name__ == "__main__":
    main()
