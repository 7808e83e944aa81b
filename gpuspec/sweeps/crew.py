"""Whoever does a sweep's tasks: this process alone, or others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event
from typing import Protocol

import pyarrow as pa


@dataclass(frozen=True)
class Task:
    """Some designs of one file of the table.

    Attributes
    ----------
    file : int
        Its number, as in the name ``part-00000003.parquet``.
    designs : tuple of int
        Their numbers.
    sampled : bool
        Whether pixels outside the zones may be sampled, if the plan says so.
    """

    file: int
    designs: tuple[int, ...]
    sampled: bool


class Worker(Protocol):
    """A device with what is tried on it, e.g. :class:`gpuspec.sweeps.trying.bench.Bench`."""

    @property
    def stopped(self) -> Event:
        """Set from another thread, it ends the work within a second by StoppedError."""

    def rows(self, designs: Sequence[int], *, sampled: bool) -> pa.Table:
        """Return a row for each design, with its number in the column ``design``."""


class Crew(Protocol):
    """Whoever does a sweep's tasks."""

    def done(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, pa.Table]]:
        """Yield each task with its rows, in any order."""


@dataclass(frozen=True)
class Alone:
    """A bench of this process, with its device.

    Attributes
    ----------
    bench : Worker
    """

    bench: Worker

    def done(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, pa.Table]]:
        """See :meth:`Crew.done`; the next task is begun while one's rows are written."""
        stopped = self.bench.stopped
        stopped.clear()
        with ThreadPoolExecutor(1) as pool:
            before: tuple[Task, Future[pa.Table]] | None = None
            try:
                for task in tasks:
                    begun = task, pool.submit(self.bench.rows, task.designs, sampled=task.sampled)
                    if before:
                        yield before[0], before[1].result()
                    before = begun
                if before:
                    yield before[0], before[1].result()
            finally:
                stopped.set()
