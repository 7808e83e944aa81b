"""What goes to another process arrives there as it was; what stands on a device stays behind."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_saving import STATION, same

import gpuspec as gs
from gpuspec.errors import BackendError
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.patterns import Pattern
from gpuspec.simulation import light_map
from gpuspec.simulation.simulate import trace
from gpuspec.studies.study import STUDIES


def again(thing: Any) -> Any:
    return pickle.loads(pickle.dumps(thing))


def test_a_result_of_any_backend_is_pickled_and_traced_again_when_asked(backend, monkeypatch):
    result = gs.simulate(STATION, backend)
    found = again(result)
    with monkeypatch.context() as closed:
        closed.setattr(light_map, "open_backend", None)
        same(found, result)
        assert found.picture("detection").axes
    assert np.array_equal(found.light_map.image(3), result.light_map.image(3))
    design = STATION.replace(sensor__exposure=6)
    assert found.light_map.score(design) == result.light_map.score(design)


def test_a_pickle_leaves_the_light_map_behind():
    result = gs.simulate(STATION, "numpy")
    images = 4 * result.aspect.size * (1 + 1 + 1 + 1 / 4)
    assert len(pickle.dumps(result)) < images + 100_000
    before = result.light_map.traced
    pickle.dumps(result)
    copy.copy(result)
    assert result.light_map.traced is before


@pytest.mark.parametrize("name", ["opengl"])
def test_a_pickled_prototype_keeps_its_light(name):
    traced = trace(STATION, name)
    result = traced.result(traced.light_map.with_pattern(Pattern.read("sinusoidal")))
    found = again(result)
    same(found, result)
    assert np.array_equal(found.light_map.image(2), result.light_map.image(2))


def test_a_measured_part_needs_its_files_no_more(tmp_path, monkeypatch):
    result = gs.simulate(gs.example("measured"), "numpy")
    found = again(result)
    same(found, result)
    monkeypatch.setattr("gpuspec.part.relief.read_maps", None)
    assert np.array_equal(found.light_map.aspect(), result.aspect)


def test_images_on_a_device_that_is_not_there_are_a_sentence(monkeypatch):
    found = again(gs.simulate(STATION, "numpy"))

    def absent(self: NumpyBackend, device: str | None = None) -> None:
        raise BackendError("numpy: no device 'cpu'.")

    monkeypatch.setattr(NumpyBackend, "__init__", absent)
    for ask in (lambda m: m.image(0), lambda m: m.read(), lambda m: m.score(), lambda m: m.fuse()):
        with pytest.raises(BackendError, match="no device"):
            ask(found.light_map)


@pytest.mark.slow
def test_results_come_home_from_other_processes():
    stations = [STATION.replace(sensor__exposure=e) for e in (2.0, 4.0)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        found = [f.result(120) for f in [pool.submit(gs.simulate, s, "numpy") for s in stations]]
    for result, station in zip(found, stations, strict=True):
        same(result, gs.simulate(station, "numpy"))
        assert result.light_map.score() == result.score


@pytest.mark.slow
def test_a_pickle_is_read_by_a_fresh_process(tmp_path):
    result = gs.simulate(STATION)
    (tmp_path / "r.pickle").write_bytes(pickle.dumps(result))
    code = (
        "import pickle, pathlib; r = pickle.loads(pathlib.Path('r.pickle').read_bytes())\n"
        "print(r.score.p1, r.light_map.score() == r.score)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, cwd=tmp_path,
        timeout=120, check=False,
    )  # fmt: skip
    assert done.stdout == f"{result.score.p1} True\n", done.stderr


def test_what_a_result_is_made_of_is_pickled_too(tmp_path):
    result = gs.simulate(STATION, "numpy")
    for part in (result.station, result.score, result.inspection, result.relief, result.info):
        assert repr(again(part)) == repr(part)
    traced = again(trace(STATION, "numpy"))
    assert traced.result().score == result.score


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_the_outcome_of_a_study_is_pickled(name):
    small = STATION.replace(camera__sampling_mm=0.4, camera__rows=None)
    own = {} if name == "height" else {"backend": "numpy"}
    outcome = gs.study(name, small, **own, **({"steps": 3} if name == "tolerance" else {}))
    found = again(outcome)
    assert repr(found) == repr(outcome)
    assert str(found.table()) == str(outcome.table())  # NaN is not itself
    assert found.figure().axes


def test_sweeps_choices_and_searches_are_pickled(tmp_path: Path):
    small = STATION.replace(camera__sampling_mm=0.4, camera__rows=None)
    run = gs.sweep(small, {"sensor.exposure": [2, 4]}, tmp_path / "run", backend="numpy")
    assert again(run).table().equals(run.table())
    choice = gs.choose(run, p2_floor=0)
    assert again(choice).best == choice.best
    assert again(choice).station() == choice.station()
    plan = gs.search_plan(small, {"sensor.exposure": [2, 4]})
    best = gs.optimise(plan, tmp_path / "search", 2, gs.Rule(p2_floor=0), backend="numpy")
    assert again(best) == best
