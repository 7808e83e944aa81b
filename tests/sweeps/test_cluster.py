"""A sweep by several processes: the very table that one makes, whoever dies on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count, islice
from pathlib import Path
from typing import Any

import dask
import pyarrow as pa
import pytest
from commandline import DEADLINE_S, PROGRAM, STATION
from dask.system import CPU_COUNT
from filelock import FileLock

from gpuspec.errors import BackendError, ClusterError
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.station.examples import example
from gpuspec.station.station import Station
from gpuspec.sweeps.cluster import crew as cluster
from gpuspec.sweeps.cluster import remote
from gpuspec.sweeps.cluster.crew import crew
from gpuspec.sweeps.cluster.workers import AHEAD
from gpuspec.sweeps.crew import Task
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.sweep import sweep
from gpuspec.version import __version__

pytestmark = pytest.mark.slow

VARY = {
    "tunnel.height_mm": "100,150,-1",
    "tunnel.luminous_mm": "1:12:10",
    "sensor.exposure": "1:4:100",
}
"""3,000 designs in 6 files of the table; a third of them is no valid station."""


def plan(samples: int = 0) -> Plan:
    return Plan.of(Station.parse(STATION, "mine.toml"), VARY, samples=samples)


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory, opencl: OpenCLBackend) -> dict[int, pa.Table]:
    """The tables of a single process, exact and screened."""
    folder = tmp_path_factory.mktemp("one")
    return {n: sweep(plan(n), folder / str(n), backend=opencl).table() for n in (0, 100)}


def same(a: pa.Table, b: pa.Table) -> bool:
    return a.num_rows == 3000 and a.equals(b, check_metadata=True)


def pids(by: Any) -> list[int]:
    return list(by.client.run(os.getpid).values())


def kill_after_first(*victims: int) -> Any:
    """Progress that ends processes once, after the first file of the table."""
    left = list(victims)

    def tell(what: str, done: int, of: int) -> None:
        assert done < of, "the sweep was over before anything was killed"
        while left:
            os.kill(left.pop(), signal.SIGKILL)

    return lambda what, done, of: tell(what, done, of) if left else None


@pytest.mark.parametrize("samples", [0, 100], ids=["exact", "screened"])
def test_two_local_workers_make_the_table_that_one_process_makes(
    samples: int, one: dict[int, pa.Table], tmp_path: Path
) -> None:
    with crew(plan(samples), workers=2) as by:
        assert len(set(pids(by)) - {os.getpid()}) == 2
        run = sweep(plan(samples), tmp_path, crew=by)
    assert same(run.table(), one[samples])
    assert run.invalid() == (1000, one[samples]["reason"][-1].as_py())


def test_a_worker_killed_in_the_middle_changes_nothing(
    one: dict[int, pa.Table], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with crew(plan(), workers=2) as by:
        sweep(plan(), tmp_path, crew=by, progress=kill_after_first(pids(by)[0]))
    assert same(RunFolder.read(tmp_path).table(), one[0])
    assert capfd.readouterr() == ("", "")


def test_designs_that_end_every_worker_are_named_and_the_rest_is_kept(
    one: dict[int, pa.Table], tmp_path: Path
) -> None:
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        crew(plan(), workers=2) as by,
        pytest.raises(ClusterError, match=r"designs \d+ to \d+ ended 1 workers.* is kept"),
    ):
        sweep(plan(), tmp_path, crew=by, progress=kill_after_first(*pids(by)))
    assert 0 < RunFolder.read(tmp_path).there() < 3000
    assert same(sweep(plan(), tmp_path).table(), one[0])


def test_what_a_worker_complains_of_is_the_sentence_a_single_process_says(tmp_path: Path) -> None:
    with (
        crew(plan(), workers=1, backend="opencl", device="nosuch") as by,
        pytest.raises(BackendError, match=r"opencl: no device 'nosuch'; choose .* from 0 \("),
    ):
        sweep(plan(), tmp_path, crew=by)


def test_tasks_are_taken_as_they_are_needed_and_processors_are_shared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken = []

    def endless() -> Iterator[Task]:
        for n in count():
            taken.append(n)
            yield Task(n, tuple(range(10)), sampled=False)

    def units() -> int:
        import pyopencl as cl

        return int(cl.get_platforms()[0].get_devices()[0].max_compute_units)

    monkeypatch.delenv("POCL_MAX_PTHREAD_COUNT", raising=False)
    with crew(plan(), workers=2) as by:
        done = list(islice(by.done(endless()), 20))
        assert set(by.client.run(units).values()) == {max(CPU_COUNT // 2, 1)}
    assert len(done) == 20
    assert len(taken) <= 20 + 2 * AHEAD


def test_threads_of_a_worker_that_its_user_set_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POCL_MAX_PTHREAD_COUNT", "7")
    with crew(plan(), workers=1) as by:
        assert by.client.run(os.getenv, "POCL_MAX_PTHREAD_COUNT").popitem()[1] == "7"


@contextmanager
def dask_process(which: str, *arguments: object, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", f"distributed.cli.dask_{which}", *map(str, arguments)]
    process = subprocess.Popen(
        [*command, "--no-dashboard"], cwd=cwd, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.terminate()
        process.wait(DEADLINE_S)


@contextmanager
def scheduler_process(folder: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    file = folder / "scheduler.json"
    arguments = ("--host", "127.0.0.1", "--port", 0, "--scheduler-file", file)
    with dask_process("scheduler", *arguments, cwd=folder) as process:
        deadline = time.monotonic() + DEADLINE_S
        while not file.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"], process


def test_an_existing_cluster_makes_the_same_table_and_its_end_loses_nothing(
    one: dict[int, pa.Table], tmp_path: Path
) -> None:
    with (
        scheduler_process(tmp_path) as (address, process),
        dask_process("worker", address, "--nthreads", 1, cwd=tmp_path),
        dask_process("worker", address, "--nthreads", 4, cwd=tmp_path),
    ):
        with crew(plan(), scheduler=address) as by:
            run = sweep(plan(), tmp_path / "whole", crew=by)
        assert same(run.table(), one[0])
        with (
            crew(plan(), scheduler=address) as by,
            pytest.raises(ClusterError, match=rf"scheduler at {address} went away.* is kept"),
        ):
            sweep(plan(), tmp_path / "cut", crew=by, progress=kill_after_first(process.pid))
    assert 0 < RunFolder.read(tmp_path / "cut").there() < 3000
    assert same(sweep(plan(), tmp_path / "cut").table(), one[0])


def test_a_scheduler_without_workers_says_how_to_start_some(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "JOIN_S", 0.5)
    with (
        scheduler_process(tmp_path) as (address, _),
        pytest.raises(ClusterError, match=f"`dask worker {address} --nthreads 1`"),
        crew(plan(), scheduler=address),
    ):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "localhost", "carrier://pigeon:1"])
def test_a_scheduler_that_is_not_there_is_a_sentence(
    address: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    answers = f"no Dask scheduler answers at {address} .*start one with `dask scheduler`"
    with pytest.raises(ClusterError, match=answers), crew(plan(), scheduler=address):
        pass
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("worker", "scheduler", "said"),
    [
        (
            ModuleNotFoundError("No module named 'gpuspec'"),
            "",
            "the worker tcp://a:1 cannot import",
        ),
        ("0.0.1", __version__, f"the worker tcp://a:1 has gpuspec 0.0.1 and this is {__version__}"),
        (__version__, "0.0.1", "the scheduler has gpuspec 0.0.1"),
    ],
)
def test_another_gpuspec_elsewhere_is_noticed_before_work_begins(
    worker: str | Exception, scheduler: str, said: str
) -> None:
    class Elsewhere:
        def run(self, *_: object, **__: object) -> dict[str, str | Exception]:
            return {"tcp://a:1": worker}

        def run_on_scheduler(self, _: object) -> str:
            return scheduler

    with pytest.raises(ClusterError, match=f"{said}.*pip install"):
        cluster._check_versions(Elsewhere())


def test_workers_are_either_local_or_a_schedulers() -> None:
    with (
        pytest.raises(ClusterError, match="one of the two"),
        crew(plan(), workers=2, scheduler="tcp://127.0.0.1:9"),
    ):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no process groups of this kind")
def test_ctrl_c_ends_workers_without_a_traceback(folder: Path) -> None:
    vary = [f"--vary={key}={values}" for key, values in VARY.items()]
    arguments = ("sweep", "s.toml", *vary, "--vary=sensor.read_noise_e=1:9:90", "--workers=2")
    process = subprocess.Popen(
        [*PROGRAM, *arguments], cwd=folder, start_new_session=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    deadline = time.monotonic() + DEADLINE_S
    while not list(folder.glob("sweep/designs/part-*")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it: to the workers, too
    _, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert err.endswith("stopped; nothing half-written was left.\n")
    assert RunFolder.read(folder / "sweep").there() > 0
    deadline = time.monotonic() + DEADLINE_S  # the last of them is still on its way out

    def left() -> list[bytes]:
        told = subprocess.run(
            ["ps", "-o", "stat=", "-s", str(process.pid)], capture_output=True, timeout=DEADLINE_S
        )
        return [state for state in told.stdout.split() if not state.startswith(b"Z")]

    while left() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not left()


def test_a_plan_arrives_as_it_was_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for station in (Station.parse(STATION, "mine.toml"), example("trim"), example("measured")):
        sent = Plan.of(station, {"tunnel.dark_mm": [1, 2.5], "sequence.images": "4,8"}, samples=3)
        came = remote.plan_of(remote.message(sent))
        assert came.identity() == sent.identity()
        assert came.station.file == sent.station.file
        assert came.station.locate("map.sur") == tmp_path / "map.sur"


def test_workers_of_a_machine_take_different_gpus_and_share_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opencl: OpenCLBackend
) -> None:
    opened = []

    class Opened:
        memory_bytes = 1200

    def open_backend(name: str, device: str | None) -> Opened:
        opened.append(device)
        return Opened()

    monkeypatch.setattr(remote, "open_backend", open_backend)
    monkeypatch.setattr(remote, "gpu_count", lambda: 2)
    monkeypatch.setattr(remote.tempfile, "gettempdir", lambda: str(tmp_path))
    remote._place.cache_clear()
    with FileLock(tmp_path / "gpuspec-worker-0.lock"):  # another worker's
        assert remote._own("auto", None, 6).memory_bytes == 1200 // 3
    assert remote._own("auto", "0", 6).memory_bytes == 1200 // 6
    assert opened == ["1", "0"]
    remote._place.cache_clear()
