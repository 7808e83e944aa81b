"""What an engineer types, as it is typed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import gpuspec as gs
from gpuspec.errors import ExtraError, OutputError, StationError
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.patterns import Pattern
from gpuspec.pictures.all import PICTURES
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import trace


def small(**changes: object) -> gs.Station:
    """The part that comes with gpuspec, in pixels of half a millimetre."""
    return gs.example("trim").replace(camera__sampling_mm=0.5, **changes)


@pytest.fixture(scope="module")
def result() -> Result:
    return gs.simulate(small(), "numpy")


def test_every_line_of_the_example_runs_as_typed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small().write("trim.toml")

    station = gs.Station.read("trim.toml")
    result = gs.simulate(station)
    picture = result.picture("histogram")
    table = result.blobs.to_pandas()
    extent = result.extent_mm
    run = gs.sweep(station, {"tunnel.luminous_mm": "0.5:8:16"}, "run", parts=3)
    best = gs.choose(run, goal="f1").station()
    best.write("best.toml")
    figure = gs.study("coverage", station).figure()
    score = result.light_map.score(station.replace(sensor__exposure=6))

    for word in ("trim.toml", "400 x 100 pixels", result.info.device, "P1", "P2", "defects hit"):
        assert word in repr(result)
    assert isinstance(picture, Figure)
    assert len(table) == len(result.blobs) > 0
    assert extent == (-100.0, 100.0, -25.0, 25.0)
    assert (run.plan.designs, run.plan.parts, run.path) == (16, 3, Path("run"))
    assert gs.Station.read("best.toml") == best
    assert best.tunnel.luminous_mm in run.plan.axes[0].values
    assert isinstance(figure, Figure)
    assert score == gs.simulate(station.replace(sensor__exposure=6)).score != result.score


# ------------------------------------------------------------------------------------- pictures


@pytest.mark.parametrize("name", [n.removesuffix(".png") for n in PICTURES if n.endswith(".png")])
def test_every_picture_of_a_run_is_a_figure_by_its_name(result, name):
    figure = result.picture(name)
    assert isinstance(figure, Figure)
    assert figure.axes


@pytest.mark.parametrize("wrong", ["histogramm", "histogram.png", "", 5, None])
def test_an_unknown_picture_is_refused_with_those_there_are(result, wrong):
    known = "station, sequence, aspect, detection, histogram, over_threshold, lost"
    with pytest.raises(StationError, match=f"there is no picture {wrong!r}; choose one of {known}"):
        result.picture(wrong)


@pytest.mark.parametrize("name", ["opengl"])
def test_no_picture_shows_stripes_where_a_pattern_is_the_light(name):
    traced = trace(small(), name)
    lit = traced.result(traced.light_map.with_pattern(Pattern.read("binary")))
    with pytest.raises(StationError, match="choose one of sequence, aspect"):
        lit.picture("station")


def test_an_extent_puts_an_image_where_the_part_is(result):
    left, right, bottom, top = result.extent_mm
    rows, columns = result.aspect.shape
    for defect, zone in ((result.defects[0], 1), (result.defects[1], 2)):
        row, column = np.argwhere(result.truth == zone).mean(axis=0)
        assert left + (column + 0.5) / columns * (right - left) == pytest.approx(
            defect.x_mm, abs=0.5
        )
        assert top - (row + 0.5) / rows * (top - bottom) == pytest.approx(defect.y_mm, abs=0.5)


# --------------------------------------------------------------------------------------- tables


def test_pandas_gets_the_blobs_under_the_heads_of_their_file(result, tmp_path):
    pandas = pytest.importorskip("pandas")
    result.save(tmp_path / "run", pictures=False)
    written = pandas.read_csv(tmp_path / "run" / "blobs.csv")
    table = result.blobs.to_pandas(result.classes)
    assert list(table.columns) == list(written.columns)
    pandas.testing.assert_frame_equal(table, written, rtol=1e-8)  # nine digits in the file
    assert "class" not in result.blobs.to_pandas().columns
    with pytest.raises(ValueError, match="classes for"):
        result.blobs.to_pandas(["dent"])


def test_without_pandas_a_sentence_says_what_to_install(result, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ExtraError, match=r"needs pandas, which is not installed; pip install"):
        result.blobs.to_pandas()


# ----------------------------------------------------------------------------- another design


DESIGNS = [
    {"sensor__exposure": 6.0},
    {"tunnel__luminous_mm": 1.0, "tunnel__dark_mm": 5.0},
    {"sequence__images": 16, "sequence__fusion": "std"},
    {"segmentation__threshold": 90.0},
    {"sensor__noise": True, "sensor__seed": 3},
]


@pytest.mark.parametrize("design", DESIGNS)
def test_another_design_is_scored_as_if_it_were_simulated_without_a_trace(
    result, monkeypatch, design
):
    other = small(**design)
    want = gs.simulate(other, "numpy").score
    monkeypatch.setattr(NumpyBackend, "trace", None)
    assert result.light_map.score(other) == want
    aspect, found, scored = result.light_map.inspected(other)
    assert scored == want
    assert np.array_equal(aspect, result.light_map.aspect(other))
    assert found.labels.max() == scored.blobs


def test_a_result_scores_its_own_design_as_it_did(result):
    assert result.light_map.score() == result.score
    with pytest.raises(StationError, match=r"tunnel\.height_mm is 100\.0 and was 300\.0"):
        result.light_map.score(small(tunnel__height_mm=100.0))


# ---------------------------------------------------------------------------- sweep and choice


def test_a_sweep_takes_a_plan_or_what_to_vary(tmp_path):
    vary = {"sensor.exposure": [2, 4]}
    plan = gs.Plan.of(small(), vary)
    planned = gs.sweep(plan, tmp_path / "a", backend="numpy")
    varied = gs.sweep(small(), vary, tmp_path / "b", backend="numpy")
    named = gs.sweep(small(), vary=vary, folder=tmp_path / "c", backend="numpy")
    assert planned.table().equals(varied.table())
    assert named.plan == varied.plan == plan
    assert gs.sweep(plan, folder=tmp_path / "a", backend="numpy").table().equals(planned.table())


def test_a_sweep_takes_the_table_of_the_station(tmp_path):
    station = small(sweep={"vary": {"sensor.exposure": [2, 4]}, "parts": 2})
    run = gs.sweep(station, tmp_path / "run", backend="numpy")
    assert (run.plan.designs, run.plan.parts) == (2, 2)
    screened = gs.sweep(station, None, tmp_path / "s", parts=1, samples=300, backend="numpy")
    assert (screened.plan.parts, screened.plan.samples) == (1, 300)


def test_a_sweep_without_a_folder_or_with_two_plans_is_refused(tmp_path):
    plan = gs.Plan.of(small(), {"sensor.exposure": [2, 4]})
    for call in (lambda: gs.sweep(plan), lambda: gs.sweep(small(), {"sensor.exposure": [2]})):
        with pytest.raises(OutputError, match="a sweep needs a folder"):
            call()
    for more in ({"vary": {"sensor.exposure": [2]}}, {"parts": 2}, {"samples": 5}):
        with pytest.raises(StationError, match="a plan says already what is varied"):
            gs.sweep(plan, folder=tmp_path / "run", **more)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["parts", "samples"])
@pytest.mark.parametrize("count", [2.5, "3", True, -1])
def test_numbers_of_parts_and_samples_are_whole(tmp_path, name, count):
    with pytest.raises(StationError, match=f"{name} is {count!r}; it must be a whole number"):
        gs.sweep(small(), {"sensor.exposure": [2, 4]}, tmp_path, **{name: count})


def test_a_choice_is_made_by_what_is_asked_or_by_a_rule(tmp_path):
    run = gs.sweep(small(), {"sensor.exposure": [2, 4, 8]}, tmp_path / "run", backend="numpy")
    assert gs.choose(run, goal="f1", p2_floor=0.5).rule == gs.Rule("f1", p2_floor=0.5)
    assert gs.choose(run, gs.Rule(p1_floor=0.2), goal="p2").rule == gs.Rule("p2", p1_floor=0.2)
    assert gs.choose(run).rule == gs.Rule()
    with pytest.raises(StationError, match="a rule has no aim; it has goal, p2_floor"):
        gs.choose(run, aim="f1")
    with pytest.raises(StationError, match="the goal 'f2' is not known"):
        gs.choose(run, goal="f2")


# ------------------------------------------------------------------------------- station files


def test_a_station_is_written_to_a_new_file_alone(tmp_path):
    path = small().write(tmp_path / "a.toml")
    assert gs.Station.read(path) == small()
    assert "# " in path.read_text("utf-8")  # what each key means
    with pytest.raises(OutputError, match="exists already"):
        small().write(path)
    assert small(sensor__exposure=2).write(path, force=True) == path
    assert gs.Station.read(str(path)).sensor.exposure == 2
    for wrong, why in ((tmp_path, "is a folder"), (tmp_path / "no" / "a.toml", "cannot be written"),
                       (5, "the path of a file"), ("", "is a folder")):  # fmt: skip
        with pytest.raises(OutputError, match=why):
            small().write(wrong)


def test_a_written_station_never_replaces_what_it_was_read_from(tmp_path):
    path = small().write(tmp_path / "a.toml")
    with pytest.raises(OutputError, match="is read here"):
        gs.Station.read(path).replace(sensor__exposure=2).write(path, force=True)


def test_a_station_finds_its_files_from_where_it_is_written(tmp_path):
    (tmp_path / "map.sur").write_bytes(b"a map")
    relief = {"file": "map.sur", "height_unit": "um", "pitch_um": 10.0}
    part = {"length_mm": 20.0, "width_mm": 10.0, "relief": relief}
    station = gs.Station.from_dict({"part": part}, "s.toml", tmp_path)
    (tmp_path / "else").mkdir()
    for folder, name in ((tmp_path, "map.sur"), (tmp_path / "else", str(tmp_path / "map.sur"))):
        again = gs.Station.read(station.write(folder / "b.toml"))
        assert again.part.relief.file == name
        assert again.locate(name).read_bytes() == b"a map"


# ------------------------------------------------------------------------------------- devices


def test_devices_are_a_table_of_what_there_is():
    found = gs.devices()
    assert [one.backend for one in found] == [one.backend for one in gs.survey()]
    assert sum(one.chosen for one in found) == 1
    lines = repr(found).splitlines()
    assert lines[0].split() == ["backend", "number", "device", "driver", "remark"]
    assert len(lines) == 1 + len(found)
    assert any(line.startswith("numpy") and "cpu" in line for line in lines)
    assert found._repr_html_().count("<tr>") == 1 + len(found)


def test_an_open_backend_is_taken_as_it_is(opencl: OpenCLBackend):
    assert gs.open_backend(opencl) is opencl
    assert gs.open_backend("numpy", 0).info.device == "cpu"
    for wrong in (5, None):
        with pytest.raises(gs.GpuspecError, match="a backend is an open Backend or one of auto"):
            gs.simulate(small(), wrong)
