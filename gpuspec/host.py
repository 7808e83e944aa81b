"""The machine on which Python runs."""

from __future__ import annotations

import gc
import os
from pathlib import Path

AVX512 = frozenset({"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"})
"""Flags of a CPU that computes with sixteen floats at once, as all but the first of them do."""

_OBJECTS = 50_000


def collect_seldom() -> None:
    """Let Python look for garbage less often: modules and figures are objects by the thousand.

    For processes of gpuspec's own; a twentieth of a run's time.
    """
    gc.set_threshold(_OBJECTS, 20, 20)


def free_bytes() -> int:
    """Return how much memory is free, or can be freed; 2**63 where the system does not say."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:  # noqa: PTH123
            for line in lines:
                if line.startswith("MemAvailable"):
                    return int(line.split()[1]) * 1024
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError, AttributeError):
        return 2**63


def processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(len(os.sched_getaffinity(0)), 1)
    return os.cpu_count() or 1


def cpu_flags() -> set[str]:
    """Return the instructions that the CPU has, as Linux names them; none where it does not say."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return set()
    lines = (line.partition(":") for line in text.splitlines())
    return next((set(value.split()) for key, _, value in lines if key.strip() == "flags"), set())
