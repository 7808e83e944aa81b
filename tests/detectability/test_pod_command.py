"""`gpuspec pod`: the same files whoever does the work and however often it is killed."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import time

import numpy as np
import pytest
from commandline import DEADLINE_S, PROGRAM, program
from commandline import said as said_of
from conftest import SMALL
from legible import check_legible

import gpuspec
from gpuspec.errors import OutputError, StationError, TrialsError
from gpuspec.station.corners import corners
from gpuspec.sweeps.cluster.crew import crew_of

PARTS = 20


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


def written(folder):
    """Everything in a folder, by name."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "trials.lock"
    }


@pytest.mark.slow
def test_a_run_that_was_killed_ends_with_the_same_bytes(folder):
    command = ["pod", "small.toml", "--parts", PARTS, "--set", "sensor.noise=true"]
    whole = program(*command, "-o", "whole", cwd=folder)
    assert whole.code == 0, whole.err
    assert "a90/95" in whole.out and "false calls per part" in whole.out
    killed = subprocess.Popen(
        [*PROGRAM, *map(str, command), "-o", "killed"], cwd=folder,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ},
    )  # fmt: skip
    end = time.monotonic() + DEADLINE_S
    while not list((folder / "killed").glob("trials/part-*")) and killed.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.01)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    assert program(*command, "-o", "killed", cwd=folder).code == 0
    assert written(folder / "killed") == written(folder / "whole")


def test_two_workers_give_the_same_trials_and_more_parts_go_on(folder, station, engine):
    from gpuspec.detectability.bench import bench_of
    from gpuspec.detectability.plan import TrialPlan

    plan = TrialPlan.of(station, PARTS)
    with crew_of(bench_of, plan.message(), workers=2) as crew:
        shared = gpuspec.pod(station, parts=PARTS, folder=folder / "two", crew=crew)
    shared.write(folder / "two")
    few = gpuspec.pod(station, parts=9, folder=folder / "one", backend=engine)
    assert few.parts == 9 and few.trials.num_rows < shared.trials.num_rows
    told = []
    more = gpuspec.pod(
        station, parts=PARTS, folder=folder / "one", backend=engine,
        progress=lambda _, done, of: told.append((done, of)),
    )  # fmt: skip
    assert told[0] == (8, PARTS)  # those of the file that was whole
    more.write(folder / "one")
    assert written(folder / "one") == written(folder / "two")


def test_what_is_written_agrees(folder, station, engine):
    found = gpuspec.pod(station, parts=PARTS, backend=engine)
    found.write(folder / "out")
    with (folder / "out" / "pod-trials.csv").open() as file:
        trials = list(csv.DictReader(file))
    said = json.loads((folder / "out" / "pod.json").read_text())
    assert len(trials) == said["hits"]["trials"] == len(found.simulated.size)
    assert sum(row["hit"] == "True" for row in trials) == said["hits"]["hits"]
    assert {row["part"] for row in trials} == {str(part) for part in range(PARTS)}
    slope = [float(row["slope_mrad"]) for row in trials]
    assert slope == pytest.approx(found.simulated.size, rel=1e-5)
    assert said["hits"]["a90_95"] == found.simulated.sizes["a90_95"]
    assert said["hits"]["a50"] < said["hits"]["a90"] < said["hits"]["a90_95"]
    assert said["false_calls"]["at_most"] == found.false_calls.bound
    with (folder / "out" / "pod.csv").open() as file:
        curve = [row for row in csv.DictReader(file) if row["of"] == "hits"]
    size, pod, bound = (np.array([float(row[k]) for row in curve]) for k in list(curve[0])[1:])
    assert np.interp(0.9, pod, size) == pytest.approx(said["hits"]["a90"], rel=0.01)
    assert (bound < pod + 1e-9).all()
    # The file of trials is one that the command reads: the same curve comes out.
    again = folder / "again.csv"
    again.write_text("x,y\n" + "".join(f"{r['slope_mrad']},{int(r['hit'] == 'True')}\n"
                                       for r in trials))  # fmt: skip
    of_file = gpuspec.pod(trials=again)
    assert of_file.measured[0].sizes["a90"] == pytest.approx(said["hits"]["a90"], rel=1e-3)


def test_its_picture_is_legible(station, engine, folder):
    file = folder / "real.csv"
    size = np.linspace(1, 30, 60)
    file.write_text("x,y\n" + "".join(f"{x},{int(x + 4 * np.sin(9 * x) > 9)}\n" for x in size))
    found = gpuspec.pod(station, trials=file, parts=PARTS, backend=engine)
    assert [one.name for one in found.curves] == ["hits", "signals", "real.csv"]
    check_legible(found.figure())


def test_noise_makes_a_station_find_less(station, engine):
    # The threshold rises with the noise, and defects of more slope are needed.
    quiet = gpuspec.pod(station, parts=PARTS, backend=engine)
    loud = station.replace(sensor__noise=True, sensor__read_noise_e=1500.0)
    noisy = gpuspec.pod(loud, parts=PARTS, backend=engine)
    assert noisy.threshold_dn > quiet.threshold_dn + 5
    assert noisy.simulated.sizes["a90"] > 1.2 * quiet.simulated.sizes["a90"]


def test_the_station_with_the_smallest_size_is_found(station, engine):
    vary = {"sensor.exposure": [2.0, 4.0]}
    found = gpuspec.pod(station, parts=PARTS, vary=vary, backend=engine)
    each = []
    for tried in found.stations:
        own = station.replace(**tried.values)
        alone = gpuspec.pod(own, parts=PARTS, backend=engine)
        assert alone.simulated.sizes == tried.sizes
        each.append(alone.simulated.rank or np.inf)
    best = found.stations[int(np.argmin(each))]
    assert found.station.sensor.exposure == best.values["sensor.exposure"]
    assert len(set(each)) > 1
    with pytest.raises(TrialsError, match="false calls per part, more than"):
        gpuspec.pod(station, parts=PARTS, vary=vary, false_calls=0.0, backend=engine)


def test_the_worst_within_the_tolerances_decides(station, engine, folder):
    """Each design of the tolerances by itself, at the threshold of the station that is not off."""
    halves = {"sensor.exposure": 0.4}
    own = station.replace(tolerance=halves)
    found = gpuspec.pod(own, parts=PARTS, backend=engine, tolerance=True)
    at = own.replace(segmentation__threshold=found.threshold_dn)
    ranks = [
        gpuspec.pod(at.replace(**off), parts=PARTS, backend=engine).simulated.rank
        for off in corners(at, halves)
    ]
    assert found.worst.rank == max(ranks) > found.simulated.rank
    assert found.worst.tried == len(ranks)
    assert found.numbers()["within_tolerance"]["a90_95"] == max(ranks)
    assert any("within the tolerances, the threshold held" in said for said in found.findings())
    # Of several stations that of the smallest worst, which need not be that of the smallest.
    vary = {"sensor.exposure": [2.0, 4.0]}
    few = gpuspec.pod(own, parts=PARTS, vary=vary, backend=engine, tolerance=True)
    other = gpuspec.pod(
        own.replace(sensor__exposure=2.0), parts=PARTS, backend=engine, tolerance=True
    )
    assert found.station.sensor.exposure == 4.0
    assert few.worst.rank == min(found.worst.rank, other.worst.rank)


def test_bad_input_is_one_sentence_and_leaves_nothing(folder, station, engine, gpuspec_):
    gpuspec.pod(station, parts=2, folder=folder / "kept", backend=engine)
    other = station.replace(sensor__exposure=2.0)
    with pytest.raises(OutputError, match="holds another pod"):
        gpuspec.pod(other, parts=2, folder=folder / "kept", backend=engine)
    (folder / "mine").mkdir()
    (folder / "mine" / "note.txt").write_text("keep")
    with pytest.raises(OutputError, match="holds other files"):
        gpuspec.pod(station, parts=2, folder=folder / "mine", backend=engine)
    (folder / "even.csv").write_text("x,y\n1,0\n1,1\n")
    (folder / "signals.csv").write_text("x,y\n1,3\n2,5\n")
    for options, said in (
        (["--trials", "even.csv"], "all 2 trials have the size 1"),
        (["--trials", "signals.csv"], "--threshold"),
        (["--trials", "none.csv"], "cannot be read"),
        ([], "neither a station nor a file"),
        (["--set", "sensor.exposure=2"], "name a station file"),
        (["--trials", "even.csv", "--tolerance"], "name a station file"),
        (["small.toml", "--tolerance"], "states no tolerances"),
        (["small.toml", "--size", "volume"], "choose one of"),
        (["small.toml", "--model", "cubic"], "no model"),
    ):
        found = said_of(gpuspec_("pod", *options, "-o", "new"))
        assert said in found and len(found.splitlines()) == 1
        assert not (folder / "new").exists()
    with pytest.raises(StationError, match=r"camera\.columns"):
        gpuspec.pod(station.replace(camera__columns=1, camera__rows=1), parts=1, backend=engine)
