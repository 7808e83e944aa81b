"""A sweep's folder: stopped, killed, spoilt, gone on with."""

from __future__ import annotations

import hashlib
import json
import resource
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tolerances
from commandline import DEADLINE_S, PROGRAM, content, program
from sweeping import GRID, STATION, rows, spoilt

import gpuspec
from gpuspec.errors import OutputError
from gpuspec.station.station import Station
from gpuspec.sweeps.crew import Alone
from gpuspec.sweeps.estimate import estimate
from gpuspec.sweeps.keeping.checksums import Checksums
from gpuspec.sweeps.keeping.folder import RunFolder, differences, table_bytes
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.bench import Bench


class Stopped(BaseException):
    """Whatever ends a sweep in the middle."""


def stopping_after(count: int) -> Any:
    left = [count]

    def tell(*_: object) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise Stopped

    return tell


class Watched(Alone):
    """A crew that remembers the designs it tried."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        object.__setattr__(self, "tried", [])

    def done(self, tasks: Any) -> Any:
        for task, table in super().done(tasks):
            self.tried.extend(task.designs)
            yield task, table


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of 64 rows, so that a small sweep has many."""
    monkeypatch.setattr(RunFolder, "rows_per_file", 64)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 300])
def test_a_sweep_stopped_anywhere_ends_with_the_same_table(
    station, opencl, tmp_path, samples, small_parts
):
    plan = Plan.of(station, GRID, samples=samples)
    undisturbed = sweep(plan, tmp_path / "whole", backend=opencl).table()
    steps = [1, 3, 11] + ([14, 17] if samples else [])
    for step in steps:
        for _ in range(3):
            try:
                sweep(plan, tmp_path / "cut", backend=opencl, progress=stopping_after(step))
            except Stopped:
                continue
        run = sweep(plan, tmp_path / "cut", backend=opencl)
        assert run.table().equals(undisturbed), step
        for path in (tmp_path / "cut" / "designs").iterdir():
            path.unlink()


def test_what_is_there_is_not_done_again(station, opencl, tmp_path, small_parts):
    plan = Plan.of(station, GRID)
    with pytest.raises(Stopped):
        sweep(plan, tmp_path / "run", backend=opencl, progress=stopping_after(5))
    there = content(tmp_path / "run" / "designs")
    assert len(there) == 5
    crew = Watched(Bench(plan, opencl))
    sweep(plan, tmp_path / "run", crew=crew)
    assert crew.tried == list(range(5 * 64, plan.designs))
    after = content(tmp_path / "run" / "designs")
    assert all(after[name] == data for name, data in there.items())


@pytest.mark.slow
def test_a_killed_process_leaves_whole_files_and_is_gone_on_with(tmp_path, opencl):
    """kill -9 while it writes, again and again."""
    (tmp_path / "s.toml").write_text(gpuspec.station.toml.to_toml(Station.from_dict(STATION)))
    command = ["sweep", "s.toml", "-o", "run", "--vary", "tunnel.luminous_mm=0.5:6:40",
               "--vary", "sensor.exposure=1:8:40", "--vary", "tunnel.dark_mm=1:20:5"]  # fmt: skip
    files = 0
    for wanted in (2, 5, 8):
        process = subprocess.Popen([*PROGRAM, *command], cwd=tmp_path, stdout=subprocess.PIPE)
        until = time.monotonic() + DEADLINE_S
        while files < wanted and time.monotonic() < until and process.poll() is None:
            time.sleep(0.005)
            files = len(list((tmp_path / "run").glob("designs/part-*.parquet")))
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=DEADLINE_S)
        assert process.returncode == -signal.SIGKILL
        for path in (tmp_path / "run").glob("designs/part-*.parquet"):
            assert len(pq.read_table(path)) == 512
    ran = program(*command, cwd=tmp_path)
    assert ran.code == 0
    assert "designs are there already" in ran.out
    plan = RunFolder.read(tmp_path / "run").plan
    assert not list((tmp_path / "run").rglob(".partial-*"))
    run = sweep(plan, tmp_path / "other", backend=opencl)
    assert run.table().equals(RunFolder.read(tmp_path / "run").table())


@pytest.mark.slow
def test_ctrl_c_says_that_the_same_command_goes_on(tmp_path):
    (tmp_path / "s.toml").write_text(gpuspec.station.toml.to_toml(Station.from_dict(STATION)))
    command = ["sweep", "s.toml", "-o", "run", "--vary", "tunnel.luminous_mm=0.5:6:100",
               "--vary", "sensor.exposure=1:8:400"]  # fmt: skip
    process = subprocess.Popen([*PROGRAM, *command], cwd=tmp_path, stderr=subprocess.PIPE,
                               stdout=subprocess.DEVNULL, text=True)  # fmt: skip
    until = time.monotonic() + DEADLINE_S
    while not list((tmp_path / "run").glob("designs/part-*.parquet")) and process.poll() is None:
        assert time.monotonic() < until, "nothing was written"
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 130
    assert "the same command goes on" in error
    assert "Traceback" not in error


def test_a_full_disk_leaves_what_was_finished(station, tmp_path, small_parts):
    """No file may be larger than this; NumPy, for PoCL writes larger ones of its own."""
    plan = Plan.of(station, {"tunnel.luminous_mm": "0.5:6:12", "sensor.exposure": "1:8:8"})
    whole = sweep(plan, tmp_path / "run", backend="numpy").table()
    run = RunFolder.read(tmp_path / "run")
    run.file(1).unlink()
    before = content(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, hard))
    try:
        with pytest.raises(OutputError, match="it goes on where it was") as error:
            sweep(plan, tmp_path / "run", backend="numpy")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert f"the sweep cannot be written to {tmp_path / 'run'}: " in str(error.value)
    assert content(tmp_path) == before
    assert sweep(plan, tmp_path / "run", backend="numpy").table().equals(whole)


def test_two_sweeps_are_never_mixed(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    sweep(plan, tmp_path / "run", backend=opencl)
    before = content(tmp_path)
    others = {
        "sensor.exposure is 1, 2, 3, 4, ... (8 values) there and 1, 8 here":
            Plan.of(station, {**GRID, "sensor.exposure": "1:8:2"}),
        "tunnel.dark_mm is not varied there and 3 here":
            Plan.of(station, {**GRID, "tunnel.dark_mm": "3"}),
        "parts is 1 there and 2 here": Plan.of(station, GRID, parts=2),
        "pixels of --screen is 0 there and 50 here": Plan.of(station, GRID, samples=50),
        "the station has sampling_mm = 0.1 there and sampling_mm = 0.2 here":
            Plan.of(station.replace(**{"camera.sampling_mm": 0.2}), GRID),
    }  # fmt: skip
    for words, other in others.items():
        with pytest.raises(OutputError) as error:
            sweep(other, tmp_path / "run", backend=opencl)
        assert words in str(error.value)
        assert "holds another sweep" in str(error.value)
    assert content(tmp_path) == before


def test_another_version_makes_another_sweep(station):
    here = Plan.of(station, GRID).identity()
    assert differences(here, here) == []
    assert differences({**here, "gpuspec": "0.0.1"}, here) == [
        f"gpuspec is 0.0.1 there and {gpuspec.__version__} here"
    ]


@pytest.mark.parametrize("samples", [0, 300])
def test_a_table_takes_no_more_disk_than_is_asked_for(station, opencl, tmp_path, samples):
    plan = Plan.of(station, GRID, samples=samples)
    run = sweep(plan, tmp_path / "run", backend=opencl)
    size = sum(path.stat().st_size for path in (run.path / "designs").iterdir())
    assert tolerances.TABLE_SHARE * table_bytes(plan) < size <= table_bytes(plan)
    # With bounds a row is twice as large.
    plain, screened = (replace(plan, samples=n) for n in (0, 300))
    assert table_bytes(screened) >= 2 * table_bytes(plain)


def test_what_a_killed_sweep_left_half_written_is_removed(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    (tmp_path / "run" / ".partial-one").mkdir()
    (tmp_path / "run" / ".partial-one" / "part").write_bytes(b"half")
    (tmp_path / "run" / "designs" / ".partial-two").write_bytes(b"half")
    assert sweep(plan, tmp_path / "run", backend=opencl).table().equals(whole)
    assert not list((tmp_path / "run").rglob(".partial-*"))


def test_what_is_left_of_a_sweep_is_estimated(station, opencl):
    """Two of five geometries, each traced for two parts; time for what is left, and its traces."""
    grid = {"tunnel.height_mm": "100:300:5", "sensor.exposure": "1:8:8"}
    plan = Plan.of(station, grid, parts=2)
    assert [estimate(plan, None, left).traces for left in (40, 16, 9, 8, 1, 0)] == [
        10,
        4,
        4,
        2,
        2,
        0,
    ]
    assert estimate(plan, None, 9).seconds is None
    bench = Bench(plan, opencl)
    some, more = (estimate(plan, bench, left) for left in (8, 4_000_000))
    assert 0 < some.seconds < more.seconds
    assert estimate(plan, bench, 0).seconds == 0


def test_the_time_of_tracing_is_part_of_the_estimate(station, opencl, monkeypatch):
    """A bench whose traces take a second and whose designs a hundredth."""
    plan = Plan.of(station, {"tunnel.height_mm": "100:300:5", "sensor.exposure": "1:8:8"})
    clock, traced = [0.0], set()

    class Slow(Bench):
        def rows(self, designs: Any, *, sampled: bool) -> Any:
            for design in designs:
                clock[0] += 0.01 + (plan.geometry_of(design) not in traced)
                traced.add(plan.geometry_of(design))

    monkeypatch.setattr("gpuspec.sweeps.estimate.time.perf_counter", lambda: clock[0])
    found = estimate(plan, Slow(plan, opencl), 40).seconds
    assert found == pytest.approx(40 * 0.01 + 5 * 1.0)


def test_a_table_without_its_identity_is_not_adopted(station, opencl, tmp_path):
    sweep(Plan.of(station, GRID), tmp_path / "run", backend=opencl)
    (tmp_path / "run" / "sweep.json").unlink()
    with pytest.raises(OutputError, match=r"holds other files \(part-.* and no sweep\.json"):
        sweep(Plan.of(station, GRID), tmp_path / "run", backend=opencl)


def test_a_named_file_that_changed_makes_another_sweep(station, tmp_path):
    (tmp_path / "zones.png").write_bytes(b"one")
    (tmp_path / "map.sur").write_bytes(b"map")
    patch = {
        "kind": "measured",
        "file": "map.sur",
        "zone_file": "zones.png",
        "x_mm": 0.0,
        "y_mm": 0.0,
    }
    measured = Station.from_dict({**STATION, "defects": [patch]}, "part.toml", tmp_path)
    plan = Plan.of(measured, GRID)
    before = plan.identity()
    assert differences(before, plan.identity()) == []
    (tmp_path / "zones.png").write_bytes(b"two")
    assert differences(before, plan.identity()) == ["zones.png holds something else than there"]


@pytest.mark.parametrize(
    "text",
    ["null", "[]", "{", '{"vary": 3}', *(
        json.dumps({"gpuspec": "0", "station": "", "files": {}, "vary": {"sensor.exposure": [1]},
                    "parts": 1, "samples": 0, **wrong})
        for wrong in ({"vary": [1]}, {"vary": {"sensor.exposure": 3}}, {"vary": {}},
                      {"vary": {"sensor.exposure": []}}, {"vary": {"foo.bar": [1, 2]}},
                      {"vary": {"sensor.exposure": ["x"]}}, {"parts": "x"}, {"parts": 0},
                      {"samples": -5}, {"station": 5}, {"station": "part = 3"})
    )],
)  # fmt: skip
def test_a_spoilt_identity_is_a_sentence(text, tmp_path):
    (tmp_path / "sweep.json").write_text(text)
    with pytest.raises(OutputError, match=r"sweep\.json"):
        RunFolder.read(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 300])
@pytest.mark.parametrize(
    "how", ["start", "first page", "middle", "last page", "footer", "end", "cut", "empty"]
)
def test_a_damaged_file_is_noticed_and_swept_again(
    station, opencl, tmp_path, small_parts, how, samples
):
    plan = Plan.of(station, GRID, samples=samples)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    run = RunFolder.read(tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("part-*")}
    run.file(3).write_bytes(spoilt(run.file(3).read_bytes(), how))
    for read in (run.table, lambda: list(run.batches(["reason"])), lambda: run.read_file(3)):
        with pytest.raises(OutputError, match=r"part-00000003\.parquet is damaged.*same `gpuspec"):
            read()
    assert run.damaged() == [3]
    crew = Watched(Bench(plan, backend=opencl))
    again = sweep(plan, tmp_path / "run", crew=crew)
    assert set(crew.tried) == set(run.designs_of(3))
    assert again.table().equals(whole)
    assert {path: path.read_bytes() for path in before} == before


def test_checksums_are_those_that_sha256sum_reads(station, opencl, tmp_path, small_parts):
    sweep(Plan.of(station, GRID, samples=300), tmp_path / "run", backend=opencl)
    lines = (tmp_path / "run" / "sweep.sha256").read_text("ascii").splitlines()
    for line in lines:
        found, _, name = line.partition("  ")
        assert hashlib.sha256((tmp_path / "run" / name).read_bytes()).hexdigest() == found
    files = list((tmp_path / "run" / "designs").iterdir())
    assert len({line.partition("  ")[2] for line in lines}) == len(lines) == len(files)


def test_a_damaged_line_of_checksums_costs_its_designs_and_no_more(
    station, opencl, tmp_path, small_parts
):
    plan = Plan.of(station, GRID)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    sums = tmp_path / "run" / "sweep.sha256"
    sums.write_bytes(b"\xff" + sums.read_bytes()[1:-9])  # the first line, and half of the last
    assert RunFolder.read(tmp_path / "run").damaged() == [0, 11]
    assert sweep(plan, tmp_path / "run", backend=opencl).table().equals(whole)
    assert RunFolder.read(tmp_path / "run").damaged() == []


def test_half_a_line_of_checksums_spoils_no_other(tmp_path):
    """A process was killed while it added one."""
    (tmp_path / "sweep.sha256").write_bytes(b"ab  designs/a\ncd  desi")
    sums = Checksums(tmp_path)
    sums.add(tmp_path / "designs" / "b", "cd")
    assert Checksums(tmp_path).hold(tmp_path / "designs" / "a", "ab")
    assert Checksums(tmp_path).hold(tmp_path / "designs" / "b", "cd")
    assert not Checksums(tmp_path).hold(tmp_path / "designs" / "b", "ab")


def test_a_sweep_of_before_there_were_checksums_gets_them(station, opencl, tmp_path, small_parts):
    plan = Plan.of(station, GRID)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    run = RunFolder.read(tmp_path / "run")
    (tmp_path / "run" / "sweep.sha256").unlink()
    pq.write_table(run.read_file(0)[:5], run.file(0))
    run.file(1).write_bytes(b"PAR1 no more")
    run.file(2).unlink()
    with pytest.raises(OutputError, match="5 rows of 64"):
        RunFolder.read(tmp_path / "run").table()
    assert sweep(plan, tmp_path / "run", backend=opencl).table().equals(whole)
    assert len((tmp_path / "run" / "sweep.sha256").read_text("ascii").splitlines()) == run.files


@pytest.mark.parametrize("stop", range(1, 4))
def test_a_file_written_anew_is_known_whenever_the_writing_is_cut_short(
    station, opencl, tmp_path, monkeypatch, stop
):
    """Killed before the checksum, between it and the file, or after both."""
    plan = Plan.of(station, GRID)
    run = sweep(plan, tmp_path / "run", backend=opencl)
    table = run.read_file(0)
    changed = table.set_column(
        table.schema.get_field_index("backend"), "backend", pa.array(["other"] * len(table))
    )
    with monkeypatch.context() as patch:
        left = [stop]

        def cut(real: Any) -> Any:
            def call(*arguments: Any) -> Any:
                left[0] -= 1
                if left[0] == 0:
                    raise Stopped
                return real(*arguments)

            return call

        patch.setattr(Checksums, "add", cut(Checksums.add))
        patch.setattr(Path, "replace", cut(Path.replace))
        if stop < 3:
            with pytest.raises(Stopped):
                run.write(0, changed)
        else:
            run.write(0, changed)
    again = RunFolder.read(tmp_path / "run")
    assert again.damaged() == []
    assert set(again.read_file(0)["backend"].to_pylist()) == {"opencl" if stop < 3 else "other"}


def test_a_folder_of_something_else_or_in_use_is_refused(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"holds other files \(note\.txt\)"):
        sweep(plan, tmp_path, backend=opencl)
    with pytest.raises(OutputError, match=r"note\.txt is a file; choose another folder"):
        sweep(plan, tmp_path / "note.txt", backend=opencl)
    with pytest.raises(OutputError, match="cannot be written"):
        sweep(plan, tmp_path / "note.txt" / "run", backend=opencl)
    with pytest.raises(OutputError, match="File name too long"):
        sweep(plan, tmp_path / ("a" * 300), backend=opencl)
    with (
        RunFolder.writing(tmp_path / "run", plan),
        pytest.raises(OutputError, match="being written by another gpuspec"),
    ):
        sweep(plan, tmp_path / "run", backend=opencl)
    with pytest.raises(OutputError, match="holds no sweep; `gpuspec sweep STATION"):
        RunFolder.read(tmp_path / "nothing")


def test_a_damaged_file_is_named_with_what_to_do(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    run = sweep(plan, tmp_path / "run", backend=opencl)
    run.file(0).write_bytes(b"PAR1 no more")
    with pytest.raises(OutputError, match=r"part-00000000\.parquet is damaged.*the same `gpuspec"):
        list(run.batches())


def test_more_designs_than_the_disk_holds_are_refused_before_work(station, opencl, tmp_path):
    plan = Plan.of(station, {"tunnel.luminous_mm": "1:2:100000", "tunnel.dark_mm": "1:2:100000"})
    with pytest.raises(OutputError, match=r"10,000,000,000 designs need about .* GB on disk"):
        sweep(plan, tmp_path / "run", backend=opencl)
    assert not (tmp_path / "run").exists()


def test_pandas_polars_and_duckdb_read_the_folder(station, opencl, tmp_path):
    import duckdb
    import pandas as pd
    import polars as pl

    run = sweep(Plan.of(station, GRID), tmp_path / "run", backend=opencl)
    best = max(row["best_p1"] for row in rows(run))
    where = tmp_path / "run" / "designs"
    assert pd.read_parquet(where)["best_p1"].max() == best
    assert pl.read_parquet(where)["best_p1"].max() == best
    assert pl.read_parquet(where / "*.parquet")["best_p1"].max() == best
    found = duckdb.sql(f"select max(best_p1), len(p1) from '{where}/*.parquet' group by 2")
    assert found.fetchall() == [(best, 256)]
    kinds = run.table().schema
    for name in ("p1", "p2", "hits"):
        assert pa.types.is_fixed_size_list(kinds.field(name).type)
        assert kinds.field(name).type.list_size == 256


@pytest.mark.slow
def test_memory_does_not_grow_with_the_designs(tmp_path):
    """Ten times the designs, the same peak to within a tenth."""
    (tmp_path / "s.toml").write_text(gpuspec.station.toml.to_toml(Station.from_dict(STATION)))
    code = (
        "import resource, sys; from gpuspec.cli.main import main; sys.argv[0] = 'gpuspec'\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    peaks = []
    for count in (30, 300):
        done = subprocess.run(
            [PROGRAM[0], "-c", code, "sweep", "s.toml", "-o", f"run{count}", "--screen",
             "--vary", f"tunnel.luminous_mm=0.5:6:{count}", "--vary", "sensor.exposure=1:8:50"],
            cwd=tmp_path, capture_output=True, text=True, check=True, timeout=DEADLINE_S,
        )  # fmt: skip
        peaks.append(int(done.stdout.split("peak ")[1]))
    assert peaks[1] < 1.1 * peaks[0]
