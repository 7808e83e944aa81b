"""Prints how many designs a second one process tries, and how many several local ones do together.

    python tests/benchmarks/workers.py [--workers 2 --designs 1536 --repeats 3]

The trim part at full size, every pixel counted; the processes take turns. Starting the workers,
and what the first design costs a process (its kernels, tracing), have lines of their own.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from gpuspec.light.devices import open_backend
from gpuspec.station.examples import example
from gpuspec.sweeps.cluster.crew import crew
from gpuspec.sweeps.cluster.workers import Workers
from gpuspec.sweeps.crew import Alone, Crew, Task
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.bench import Bench


def plan(designs: int) -> Plan:
    """Return a plan of one geometry."""
    stripes = f"1:12:{designs // 16}"
    return Plan.of(example("trim"), {"tunnel.luminous_mm": stripes, "sensor.exposure": "1:8:16"})


def seconds(swept: Plan, by: Crew) -> float:
    """Return what a sweep takes from its first design to its last row on disk."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        sweep(swept, Path(folder) / "sweep", crew=by)
        return time.perf_counter() - start


def first(by: Crew, count: int) -> float:
    """Return what the first design of each of some processes takes, at the same time."""
    start = time.perf_counter()
    list(by.done([Task(n, (n,), sampled=True) for n in range(count)]))
    return time.perf_counter() - start


def processor_seconds(by: Workers) -> float:
    """Return what the workers have used of the processors: other programs' load hardly shows."""
    return sum(by.client.run(time.process_time).values())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--designs", type=int, default=1536)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    swept = plan(options.designs)
    rows, columns = swept.station.shape
    alone = Alone(Bench(swept, open_backend()))
    print(f"{swept.designs} designs of {columns} x {rows} pixels on {alone.bench.backend.info}")
    print(f"load of the machine before: {os.getloadavg()[0]:.2f}")
    print(f"first design, one process: {first(alone, 1):.2f} s")
    start = time.perf_counter()
    with crew(swept, workers=options.workers) as together:
        print(f"starting {options.workers} workers: {time.perf_counter() - start:.2f} s")
        print(f"first design, {options.workers} workers: {first(together, options.workers):.2f} s")
        whose: dict[str, tuple[Crew, Callable[[], float]]] = {
            "one process": (alone, time.process_time),
            f"{options.workers} workers": (together, partial(processor_seconds, together)),
        }
        best = dict.fromkeys(whose, 0.0)
        for _ in range(options.repeats):
            for name, (by, processor) in whose.items():
                before = processor()
                speed = swept.designs / seconds(swept, by)
                each_ms = (processor() - before) / swept.designs * 1e3
                best[name] = max(best[name], speed)
                print(f"{name}: {speed:.1f} designs/s, {each_ms:.1f} ms of processor each")
    one, many = best.values()
    print(f"workers / one process, best of each: {many / one:.2f}")


if __name__ == "__main__":
    main()
