"""What a sweep will take, told before it begins, from a few designs tried on the device."""

from __future__ import annotations

import time
from dataclasses import dataclass

from gpuspec.sweeps.keeping.folder import table_bytes
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.bench import Bench
from gpuspec.sweeps.trying.parts import BYTES_PER_PIXEL

_TRIED = {False: 8, True: 512}  # designs, sampled or not: enough to see past what is done once


@dataclass(frozen=True)
class Estimate:
    """What a sweep takes.

    Attributes
    ----------
    designs, traces : int
        Designs, and light maps to trace for them.
    seconds : float or None
        Measured on this device; None if none of the first designs is valid.
    device_bytes, disk_bytes : int
    """

    designs: int
    traces: int
    seconds: float | None
    device_bytes: int
    disk_bytes: int


def estimate(plan: Plan, bench: Bench | None, left: int) -> Estimate:
    """Try a few designs and extrapolate.

    Parameters
    ----------
    plan : Plan
    bench : Bench or None
        None: time is not estimated.
    left : int
        Designs still to do.
    """
    valid = plan.first_valid()
    geometries = min(plan.geometries, -(-left // plan.designs_per_geometry))
    size = 0
    seconds = None
    if valid is not None:
        station = plan.station_of(valid)
        rows, columns = station.shape
        size = rows * columns * BYTES_PER_PIXEL * station.camera.sub_rays * plan.parts
        if bench is not None:
            seconds = _seconds(plan, bench, valid, left, geometries) if left else 0.0
    if bench is not None:
        size = min(size, bench.backend.memory_bytes)
    return Estimate(plan.designs, geometries * plan.parts, seconds, size, table_bytes(plan))


def _seconds(plan: Plan, bench: Bench, valid: int, left: int, geometries: int) -> float:
    sampled = bool(plan.samples)
    first = valid // plan.designs_per_geometry * plan.designs_per_geometry
    tried = range(valid, min(valid + _TRIED[sampled], first + plan.designs_per_geometry))
    bench.rows([valid], sampled=sampled)  # builds kernels, and traces
    start = time.perf_counter()
    bench.rows(tried, sampled=sampled)
    each = (time.perf_counter() - start) / len(tried)
    tracing = 0.0
    if geometries > 1:
        other = (valid + plan.designs_per_geometry) % plan.designs
        start = time.perf_counter()
        bench.rows([other], sampled=sampled)
        tracing = max(time.perf_counter() - start - each, 0.0)
    return left * each + geometries * tracing
