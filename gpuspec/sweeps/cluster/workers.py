"""The workers of a Dask cluster as a sweep's crew: work handed out, rows brought home."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

import pyarrow as pa
from distributed import KilledWorker, wait
from distributed.comm.core import CommClosedError

from gpuspec.errors import ClusterError, GpuspecError
from gpuspec.sweeps.cluster.remote import rows
from gpuspec.sweeps.crew import Task, Worker
from gpuspec.version import __version__

AHEAD = 3
"""Pieces of work a worker has at once: one is being done, the others wait."""

INSTALL = f'pip install "gpuspec[cluster]=={__version__}"'
RETRIES = 2
PATIENCE_S = 60.0
_KEPT = "Everything finished is kept: run the same command again to go on."


@dataclass(frozen=True)
class Piece:
    """Some designs of a task, for one worker.

    Attributes
    ----------
    task : Task
        The whole of which this is a piece.
    designs : tuple of int
        Their numbers.
    """

    task: Task
    designs: tuple[int, ...]


@dataclass(frozen=True)
class Workers:
    """The workers of a Dask cluster, each with its bench.

    Attributes
    ----------
    client : distributed.Client
    make : callable
        See :func:`gpuspec.sweeps.cluster.remote.rows`.
    plan : str
        As `make` takes it.
    how : tuple
        Backend, device and number of workers on a machine.
    """

    client: Any
    make: Callable[..., Worker]
    plan: str
    how: tuple[str, str | None, int]

    def done(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, pa.Table]]:
        """See :meth:`gpuspec.sweeps.crew.Crew.done`.

        Raises
        ------
        ClusterError
            If the scheduler goes away, no worker is left, or some designs end every worker.
        """
        waiting: dict[Any, Piece] = {}
        home: dict[Task, list[pa.Table]] = {}
        with self._explained(waiting):
            pieces = _cut(tasks, self._ahead())
            while True:
                for piece in islice(pieces, max(self._ahead() - len(waiting), 0)):
                    waiting[self._begin(piece)] = piece
                if not waiting:
                    return
                for future in self._finished(waiting):
                    found, task = future.result(), waiting[future].task
                    del waiting[future]
                    home.setdefault(task, []).append(found)
                    if sum(map(len, home[task])) == len(task.designs):
                        yield task, pa.concat_tables(home.pop(task)).sort_by("design")

    def _ahead(self) -> int:
        """Return how many pieces may be under way: workers come and go."""
        return AHEAD * max(len(self.client.nthreads()), 1)

    def _begin(self, piece: Piece) -> Any:
        return self.client.submit(
            rows, self.make, self.plan, piece.designs, piece.task.sampled, *self.how,
            pure=False, retries=RETRIES,
        )  # fmt: skip

    def _finished(self, waiting: Iterable[Any]) -> list[Any]:
        """Wait for some pieces and return them."""
        while True:
            try:
                return list(wait(list(waiting), PATIENCE_S, "FIRST_COMPLETED").done)  # type: ignore[no-untyped-call]
            except TimeoutError:
                if not self.client.nthreads():
                    raise ClusterError(
                        f"no worker is left at {_address(self.client)}, and none has come for "
                        f"{PATIENCE_S:.0f} s. {_KEPT}"
                    ) from None

    @contextmanager
    def _explained(self, waiting: Mapping[Any, Piece]) -> Iterator[None]:
        """Say in a sentence what became of the cluster."""
        try:
            yield
        except KilledWorker as error:
            # Of the pieces that died together, the first was tried; the others stood behind it.
            piece = next(p for future, p in waiting.items() if future.status == "error")
            raise ClusterError(
                f"designs {piece.designs[0]} to {piece.designs[-1]} ended "
                f"{error.allowed_failures + 1} workers, one after the other; mostly the memory is "
                f"too small: take fewer workers or a larger camera.sampling_mm. {_KEPT}"
            ) from None
        except ImportError as error:
            raise ClusterError(
                f"a worker cannot import what it needs ({error}); {INSTALL} there. {_KEPT}"
            ) from None
        except (CancelledError, asyncio.CancelledError, CommClosedError):
            raise self._gone() from None
        except GpuspecError:
            raise
        except Exception:
            if self.client.status == "running":
                raise
            raise self._gone() from None

    def _gone(self) -> ClusterError:
        return ClusterError(f"the scheduler at {_address(self.client)} went away. {_KEPT}")


def _cut(tasks: Iterable[Task], wanted: int) -> Iterator[Piece]:
    """Yield tasks whole if there are many, else in pieces, so that every worker has some."""
    tasks = iter(tasks)
    first = list(islice(tasks, wanted))
    count = -(-wanted // max(len(first), 1))
    for task in chain(first, tasks):
        size = -(-len(task.designs) // count)
        for start in range(0, len(task.designs), size):
            yield Piece(task, task.designs[start : start + size])


def _address(client: Any) -> str:
    return str(client.scheduler.address) if client.scheduler else "its address"
