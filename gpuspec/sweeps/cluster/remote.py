"""What a worker process does: it owns a device, and tries designs on it when it is asked to."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock

import pyarrow as pa
from filelock import FileLock, Timeout

from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.light.opencl_device import gpu_count
from gpuspec.station.station import Station
from gpuspec.sweeps.crew import Worker
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.bench import Bench

PLACES_MAX = 256
_one_at_a_time = Lock()  # a Dask worker has as many threads as its user gave it, but one bench


def message(plan: Plan) -> str:
    """Return a plan as text, from which another machine makes the very same table."""
    station = plan.station
    sent = {
        **plan.identity(),
        "tables": station.as_dict(),
        "file": station.file,
        "folder": str(station.locate(".").resolve()),
    }
    return json.dumps(sent)


def plan_of(text: str) -> Plan:
    """Return the plan of a :func:`message`."""
    sent = json.loads(text)
    station = Station.from_dict(sent["tables"], sent["file"], sent["folder"])
    return replace(Plan.from_identity(sent), station=station)


def bench_of(plan: str, backend: Backend) -> Worker:
    """Return the bench of a sweep.

    Parameters
    ----------
    plan : str
        As a :func:`message`.
    backend : Backend
    """
    return Bench(plan_of(plan), backend)


def rows(
    make: Callable[[str, Backend], Worker],
    plan: str,
    designs: Sequence[int],
    sampled: bool,
    backend: str,
    device: str | None,
    neighbours: int,
) -> pa.Table:
    """Try some designs on this process's bench.

    Parameters
    ----------
    make : callable
        Makes the bench of a plan and a device; a function of a module that workers can import,
        e.g. :func:`bench_of`.
    plan : str
        As that takes it.
    designs : sequence of int
    sampled : bool
        See :meth:`gpuspec.sweeps.trying.bench.Bench.rows`.
    backend : str
    device : str, optional
        None: each worker of a machine takes another of its GPUs.
    neighbours : int
        Number of workers on this machine, which share its devices' memory.

    Raises
    ------
    GpuspecError
        If the device is absent or fails, or this machine lacks a file of the station.
    """
    with _one_at_a_time:
        try:
            return _bench(make, plan, backend, device, neighbours).rows(designs, sampled=sampled)
        except BaseException:
            _bench.cache_clear()  # a device that failed is opened anew for the next try
            raise


@lru_cache(maxsize=1)
def _bench(
    make: Callable[[str, Backend], Worker],
    plan: str,
    backend: str,
    device: str | None,
    neighbours: int,
) -> Worker:
    return make(plan, _own(backend, device, neighbours))


def _own(backend: str, device: str | None, neighbours: int) -> Backend:
    """Open this worker's device, with its share of the memory."""
    gpus = gpu_count() if device is None and backend in ("auto", "opencl") else 0
    if gpus > 1:
        device = str(_place()[0] % gpus)
    opened = open_backend(backend, device)
    opened.memory_bytes //= -(-neighbours // max(gpus, 1))
    return opened


@lru_cache(maxsize=1)
def _place() -> tuple[int, FileLock | None]:
    """Take the first free place on this machine, which is free again when this process ends."""
    for place in range(PLACES_MAX):
        lock = FileLock(Path(tempfile.gettempdir()) / f"gpuspec-worker-{place}.lock", timeout=0)
        try:
            lock.acquire()
        except (Timeout, OSError):  # OSError: it is another user's
            continue
        return place, lock
    return 0, None
