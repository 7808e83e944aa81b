"""Prints how long the commands take, and how much memory: cold (no kernel built) and warm.

python tests/benchmarks/commands.py [ANOTHER CHECKOUT ...]

With other checkouts, a column of seconds each, in turn, so that a machine's drift meets all alike.
Of what is repeated, the least time counts.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

OWN = str(Path(__file__).parents[2])
QUIET: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
TRIALS = ["--kind", "dent", "--set", "populations[1].depth_um=[0.1,2]", "--parts", "640"]
IMAGES = ["-n", "200", "--set", "part.length_mm=100", "--set", "camera.sampling_mm=0.07"]
IMAGES += ["--set", "defects=none", "-o", "learn"]
TWO = ["--workers", "2"]
NOISE = ["--set", "sensor.noise=true"]
SAVES = 8
STARTS = 5
PATTERN = """float pattern(float light, float across, float shift, float footprint) {
    float period = 1.0 / d.periods_per_mm;
    Trapezoid lit = lit_fraction(light / period, footprint / period, d.luminous_share);
    return at_shift(lit, shift / period);
}
"""


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "gpuspec", *arguments]


def environment(checkout: str, cache: str) -> dict[str, str]:
    caches = {"XDG_CACHE_HOME": cache, "POCL_CACHE_DIR": f"{cache}/pocl"}
    return {**os.environ, **caches, "PYTHONPATH": checkout}


def measured(arguments: list[str], around: dict[str, str], folder: str) -> tuple[float, float]:
    """Run a command; return seconds and peak resident memory in MB."""
    start = time.perf_counter()
    process = subprocess.Popen(command(*arguments), cwd=folder, env=around, **QUIET)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{' '.join(arguments)} failed")
    return time.perf_counter() - start, usage.ru_maxrss / 1024


@contextmanager
def running(
    arguments: list[str], around: dict[str, str], folder: Path
) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command(*arguments), cwd=folder, env=around, **QUIET)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def until(there: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    while not there():
        if process.poll() is not None:
            sys.exit(f"{process.args} ended early")
        time.sleep(0.002)


def watching(
    stack: ExitStack, around: dict[str, str], folder: Path, name: str
) -> Callable[[int], float]:
    """Start `prototype --watch`; what is returned saves the pattern and waits for a picture."""
    pattern, picture = folder / "mine.glsl", folder / "watch" / name
    pattern.write_text(PATTERN)
    arguments = ["prototype", "t.toml", "--pattern", "mine.glsl", "--watch"]
    process = stack.enter_context(running([*arguments, "--backend", "opengl"], around, folder))
    until(picture.exists, process)

    def save(number: int) -> float:
        time.sleep(1.5)  # till all of the save before is written
        before, start = picture.stat().st_ino, time.perf_counter()
        pattern.write_text(f"{PATTERN}// {number}\n")
        until(lambda: picture.exists() and picture.stat().st_ino != before, process)
        return time.perf_counter() - start

    return save


def first_design(around: dict[str, str], folder: Path) -> float:
    """Return seconds from the start of a small sweep to the first designs in its table."""
    shutil.rmtree(folder / "sweep", ignore_errors=True)
    start = time.perf_counter()
    arguments = ["sweep", "t.toml", "--vary", "sensor.exposure=1:8:8"]
    with running(arguments, around, folder) as process:
        until(lambda: any((folder / "sweep" / "designs").glob("*.parquet")), process)
        return time.perf_counter() - start


def main() -> None:
    """Measure and print the table."""
    checkouts = [OWN, *sys.argv[1:]]
    folders = [Path(tempfile.mkdtemp()) for _ in checkouts]
    around = [environment(c, str(f / "cache")) for c, f in zip(checkouts, folders, strict=True)]
    both = list(zip(around, folders, strict=True))
    for one, folder in both:
        measured(["init", "t.toml"], one, str(folder))
    print(f"{'':38}" + "".join(f"{Path(c).name[:10]:>11}{'MB':>7}" for c in checkouts))
    for name, times, arguments in (
        ("gpuspec --help", STARTS, ["--help"]),
        ("gpuspec demo, cold", 1, ["demo"]),
        ("gpuspec demo, warm", STARTS, ["demo"]),
        ("the same without pictures", 3, ["demo", "--no-pictures"]),
        ("the same with --frames", 1, ["demo", "--frames"]),
        ("the same with noise", 1, ["demo", *NOISE]),
        ("pod, 10,240 trials", 1, ["pod", "t.toml", "-o", "one", *TRIALS]),
        ("the same with noise", 1, ["pod", "t.toml", "-o", "noisy", *TRIALS, *NOISE]),
        ("the same by 2 workers", 1, ["pod", "t.toml", "-o", "two", *TRIALS, *NOISE, *TWO]),
        ("dataset, 200 images of 1 megapixel", 1, ["dataset", "t.toml", *IMAGES, *NOISE]),
    ):
        runs = [[measured(arguments, a, str(f)) for a, f in both] for _ in range(times)]
        least = [min(of) for of in zip(*runs, strict=True)]
        print(f"{name:38}" + "".join(f"{s:11.2f}{memory:7.0f}" for s, memory in least))
    for name, said in (("preview.png", "preview"), ("detection.png", "picture")):
        with ExitStack() as stack:
            saves = [watching(stack, a, f, name) for a, f in both]
            turns = [[save(n) for save in saves] for n in range(SAVES)]
        print_row(f"prototype --watch, save to {said}", turns)
    print_row(
        "sweep, start to first design",
        [[first_design(a, f) for a, f in both] for _ in range(STARTS)],
    )
    for folder in folders:
        shutil.rmtree(folder)


def print_row(name: str, turns: list[list[float]]) -> None:
    print(f"{name:38}" + "".join(f"{min(of):11.2f}{'':7}" for of in zip(*turns, strict=True)))


if __name__ == "__main__":
    main()
