"""A sweep by many processes: on this machine, or on all those of a Dask cluster."""

from __future__ import annotations

import logging
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import resource_tracker
from typing import Any

import dask
from dask.system import CPU_COUNT
from distributed import Client, LocalCluster

from gpuspec.errors import ClusterError
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.sweeps.cluster.remote import bench_of, message
from gpuspec.sweeps.cluster.workers import INSTALL, Workers
from gpuspec.sweeps.crew import Alone, Crew, Worker
from gpuspec.sweeps.plan import Plan
from gpuspec.version import __version__

CONNECT_S = 10.0
JOIN_S = 30.0
_SPAWN = "distributed.nanny.pre-spawn-environ"
_SILENT = logging.CRITICAL + 1


def crew(
    plan: Plan,
    *,
    workers: int = 0,
    scheduler: str = "",
    backend: str = "auto",
    device: str | None = None,
) -> AbstractContextManager[Crew]:
    """Bring together whoever does a sweep's tasks; local processes end with the context.

    Parameters
    ----------
    plan : Plan
    workers : int
        Number of processes on this machine; 0: none but this one.
    scheduler : str
        Address of a Dask scheduler with workers, e.g. ``"tcp://host:8786"``; empty: none.
    backend : str
        See :func:`gpuspec.light.devices.open_backend`.
    device : str, optional
        Which device every worker takes; None: each worker of a machine another of its GPUs.

    Returns
    -------
    context manager of Crew

    Raises
    ------
    ClusterError
        If the scheduler or its workers are not there, or lack this gpuspec.
    """
    return crew_of(
        bench_of, message(plan), workers=workers, scheduler=scheduler, backend=backend,
        device=device,
    )  # fmt: skip


@contextmanager
def crew_of(
    make: Callable[[str, Backend], Worker],
    plan: str,
    *,
    workers: int = 0,
    scheduler: str = "",
    backend: str = "auto",
    device: str | None = None,
) -> Iterator[Crew]:
    """Bring together whoever does the tasks of a plan of any kind.

    Parameters
    ----------
    make : callable
        See :func:`gpuspec.sweeps.cluster.remote.rows`.
    plan : str
        As that takes it.
    workers, scheduler, backend, device
        As of :func:`crew`.

    Yields
    ------
    Crew

    Raises
    ------
    ClusterError
        If the scheduler or its workers are not there, or lack this gpuspec.
    """
    if workers and scheduler:
        raise ClusterError("workers are either local or a scheduler's; give one of the two.")
    if not (workers or scheduler):
        yield Alone(make(plan, open_backend(backend, device)))
        return
    with _quiet(), _local(workers) if workers else _existing(scheduler) as client:
        hosts = Counter(address.rpartition(":")[0] for address in client.nthreads())
        how = (backend, device, max(hosts.values(), default=1))
        yield Workers(client, make, plan, how)


@contextmanager
def _local(workers: int) -> Iterator[Any]:
    """Start processes on this machine, each with its share of the processors."""
    threads = str(max(CPU_COUNT // workers, 1))
    # Told to trim at once, malloc gives each array back to the system, which takes half the time.
    spawned = dict(dask.config.get(_SPAWN))
    spawned.pop("MALLOC_TRIM_THRESHOLD_", None)
    names = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")  # PoCL 3, and since 4
    try:
        with _deaf(), dask.config.set({_SPAWN: spawned}):
            cluster = LocalCluster(  # type: ignore[no-untyped-call]
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=0,  # what a light map takes is the bench's to know
                dashboard_address=None,
                silence_logs=_SILENT,
                env={name: os.environ.get(name, threads) for name in names},
            )
    except (OSError, RuntimeError, TimeoutError) as error:
        raise ClusterError(
            f"the workers do not start ({error}); a script that starts some must do so under "
            f'`if __name__ == "__main__":`.'
        ) from None
    with cluster, Client(cluster) as client:  # type: ignore[no-untyped-call]
        yield client


@contextmanager
def _deaf() -> Iterator[None]:
    """Let Ctrl-C, which a terminal sends to all, not reach what is started here: this ends it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # when it starts, it lets the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # threads inherit it
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _existing(scheduler: str) -> Iterator[Any]:
    """Reach a scheduler, and see that its workers can do the work."""
    try:
        client = Client(scheduler, timeout=CONNECT_S)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"no Dask scheduler answers at {scheduler} ({error}); start one with `dask scheduler`, "
            f"and workers with `dask worker ADDRESS --nthreads 1`."
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=JOIN_S)
        except TimeoutError:
            raise ClusterError(
                f"the scheduler at {scheduler} has no worker, and none came within {JOIN_S:.0f} s; "
                f"start some with `dask worker {scheduler} --nthreads 1`."
            ) from None
        _check_versions(client)
        yield client


def _check_versions(client: Any) -> None:
    def version() -> str:  # sent as it stands: a machine without gpuspec can run it, too
        from gpuspec.version import __version__

        return __version__

    found = {f"worker {w}": v for w, v in client.run(version, on_error="return").items()}
    try:
        found["scheduler"] = client.run_on_scheduler(version)  # tasks pass through it
    except Exception as error:
        found["scheduler"] = error
    for who, answer in found.items():
        if isinstance(answer, Exception):
            raise ClusterError(f"the {who} cannot import gpuspec ({answer}); {INSTALL} there.")
        if answer != __version__:
            raise ClusterError(
                f"the {who} has gpuspec {answer} and this is {__version__}, so that rows may "
                f"differ; {INSTALL} there."
            )


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Dask says of workers that come and go off the terminal: errors say it."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(_SILENT)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
