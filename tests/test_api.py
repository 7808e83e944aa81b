"""The package as Python sees it: names, what objects say of themselves, what a notebook shows."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from base64 import b64decode
from html import escape

import numpy as np
import pytest
from commandline import DEADLINE_S
from PIL import Image
from tolerances import PNG_DN

import gpuspec
from gpuspec import studies
from gpuspec.errors import ExtraError, StationError
from gpuspec.light.devices import BACKENDS
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import trace
from gpuspec.station.station import Station

SMALL = {
    "part": {"length_mm": 20.0, "width_mm": 10.0},
    "camera": {"sampling_mm": 0.1},
    "defects": [
        {"kind": "dent", "x_mm": x, "y_mm": 1.0, "diameter_mm": 1.0, "depth_um": 8.0}
        for x in (-6.0, 0.0, 6.0)
    ],
}


@pytest.fixture(scope="module")
def result() -> Result:
    return gpuspec.simulate(Station.from_dict(SMALL, "small.toml"), "numpy")


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> gpuspec.RunFolder:
    station = Station.from_dict(SMALL, "small.toml")
    plan = gpuspec.Plan.of(station, {"tunnel.luminous_mm": "2:4:3"})
    return gpuspec.sweep(plan, tmp_path_factory.mktemp("run") / "sweep", backend="numpy")


@pytest.fixture(scope="module")
def optimum(tmp_path_factory) -> gpuspec.Optimum:
    station = Station.from_dict(SMALL, "small.toml")
    plan = gpuspec.search_plan(station, {"tunnel.luminous_mm": "2:4"})
    return gpuspec.optimise(plan, tmp_path_factory.mktemp("run") / "search", 3, backend="numpy")


def test_every_public_name_is_there_and_listed():
    for name in gpuspec.__all__:
        assert getattr(gpuspec, name) is not None
        assert name in dir(gpuspec)
    assert set(gpuspec.__all__) == set(gpuspec._HOME) - {"__version__"}
    assert {"studies", "sweeps"} <= set(dir(gpuspec))
    assert gpuspec.front is gpuspec.choose
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        gpuspec.simulat  # noqa: B018


def test_import_alone_reads_no_library():
    heavy = ["numpy", "scipy", "matplotlib", "pyopencl", "pydantic", "pyarrow", "typer"]
    code = f"import sys, gpuspec; dir(gpuspec); print([n for n in {heavy} if n in sys.modules])"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=DEADLINE_S
    )
    assert shown.stdout == "[]\n"


@pytest.mark.slow
def test_names_reach_the_same_after_any_import_of_their_files():
    code = (
        "import gpuspec, gpuspec.sweeps.choosing.front, gpuspec.sweeps.searching.optimise\n"
        "import gpuspec.light.devices, gpuspec.studies.coverage\n"
        "print([n for n in gpuspec.__all__ if type(getattr(gpuspec, n)).__name__ == 'module'])"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=DEADLINE_S
    )
    assert shown.stdout == "[]\n"


def test_without_its_packages_a_sweep_says_which_extra(monkeypatch):
    for name in [n for n in sys.modules if n.startswith("gpuspec.sweeps.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ExtraError, match=r'needs pyarrow.*pip install "gpuspec\[sweep\]"'):
        gpuspec.sweep  # noqa: B018


def test_a_study_is_run_by_its_name():
    station = Station.from_dict(SMALL, "small.toml")
    outcome = gpuspec.study("coverage", station, backend="numpy")
    assert type(outcome).__name__ == "Coverage"
    assert repr(outcome).startswith("Coverage(small.toml, numpy on cpu")
    assert "pixels are blind" in repr(outcome)
    assert gpuspec.studies.coverage.study is studies.coverage.study
    with pytest.raises(StationError, match="choose one of signature, height, coverage"):
        gpuspec.study("covrage", station)
    with pytest.raises(StationError, match="the study of height needs a station"):
        gpuspec.study("height")
    with pytest.raises(AttributeError):
        studies.covrage  # noqa: B018


def readable(thing: object, *words: str) -> str:
    """What an object says of itself: short, in words, without its arrays."""
    text = repr(thing)
    assert len(text) < 900, text
    assert len(text.splitlines()) <= 9
    for jargon in ("array(", "object at 0x", "dtype=", "..., "):
        assert jargon not in text
    for word in words:
        assert word in text
    return text


def test_a_result_and_its_parts_say_what_they_are(result):
    readable(result, "small.toml: 200 x 100 pixels, numpy on cpu", "P1", "3 of 3 defects hit",
             "aspect: (100, 200) float32, grey levels in DN")  # fmt: skip
    readable(result.station, "small.toml", "20 x 10 mm", "3 defects", "200 x 100 pixels")
    readable(result.score, "P1", "P2", "3 of 3 defects hit")
    readable(result.blobs, "Blobs(3: label, area_px")
    readable(result.confusion, "dent: 3 dent or bump")
    readable(result.inspection, "3 blobs above", "DN")
    readable(result.relief, "3 defects, 3 grooves")
    readable(result.relief.grooves, "in mm")
    readable(trace(result.station, "numpy"), "Truth(3 defects; labels (100, 200) int32)")


@pytest.mark.parametrize("backend", BACKENDS)
def test_backends_and_light_maps_say_what_they_are(backend):
    opened = gpuspec.open_backend(backend)
    readable(opened, f"{backend} on ")
    light_map = opened.trace(Station.from_dict(SMALL, "small.toml"))
    readable(light_map, "LightMap(small.toml: 200 x 100 pixels of 1 sub-ray", "light_mm", "in DN")
    readable(light_map.read(), "light_mm: (1, 100, 200)", ", mm")


def test_sweep_choice_and_search_say_what_they_are(run, optimum):
    readable(run.plan, "small.toml: 3 designs, 3 of tunnel.luminous_mm; 1 part")
    readable(run.plan.axes[0], "tunnel.luminous_mm: 3 values, 2 to 4")
    readable(run, "3 designs, all there")
    choice = gpuspec.front(run)
    readable(choice, "rule: all defects hit", "best: design", "3 of 3 defects hit", "DN")
    readable(choice.front, "designs at a threshold")
    readable(choice.best, "threshold_dn")
    readable(optimum, "3 trials", "tunnel.luminous_mm = ", "3 of 3 defects hit")


def test_a_measured_relief_says_what_it_is():
    relief = gpuspec.simulate(gpuspec.example("measured"), "opencl").relief
    readable(relief, "TopographyMap(part.relief: 480 x 560 heights in mm, pitch 0.0035 x 0.0035 mm")
    readable(gpuspec.example("measured"), "relief polished")


def test_a_notebook_shows_pictures_and_tables(result, run, optimum):
    for thing in (result, result.light_map, gpuspec.front(run), optimum):
        with Image.open(io.BytesIO(thing._repr_png_())) as picture:
            assert min(picture.size) >= 100
    blobs = result.blobs._repr_html_()
    assert blobs.count("<tr>") == 4
    assert "<th>area_mm2</th>" in blobs
    assert "<td>dent</td>" in result.confusion._repr_html_()


def test_a_notebook_shows_words_with_pictures(result, run, optimum, tmp_path):
    outcome = gpuspec.study("coverage", result.station, backend="numpy")
    choice = gpuspec.front(run)
    for thing, pictures in ((result, 2), (choice, 1), (optimum, 1), (outcome, 1), (run, 0),
                            (result.station, 0)):  # fmt: skip
        shown = thing._repr_html_()
        assert escape(repr(thing)) in shown
        found = re.findall(r'src="data:image/png;base64,([^"]+)"', shown)
        assert len(found) == pictures
        for one in found:
            with Image.open(io.BytesIO(b64decode(one))) as picture:
                assert min(picture.size) >= 100
    assert run._repr_html_().count("<tr>") == 1 + len(run.plan.axes)
    sections = re.findall(r"<tr><td>([a-z]+)</td>", result.station._repr_html_())
    assert sections == ["part", "tunnel", "camera", "sensor", "sequence", "defects", "segmentation"]
    assert "<td>3 dent</td>" in result.station._repr_html_()
    assert "luminous_mm = 4" in result.station._repr_html_()


def test_a_notebook_shows_no_text_as_markup():
    station = Station.from_dict(SMALL, "<b>small</b>.toml")
    assert "<b>" not in station._repr_html_()


def test_a_long_table_is_shown_in_part(result):
    many = result.blobs.rows() * 10
    from gpuspec.shown import html_table

    shown = html_table(many, len(many))
    assert shown.count("<tr>") == 21
    assert "10 more" in shown
    assert html_table([], 0) == "<p>none</p>"


def test_a_light_map_shows_its_aspect_image(result):
    with Image.open(io.BytesIO(result.light_map._repr_png_())) as picture:
        grey = np.asarray(picture).astype(float)
    np.testing.assert_allclose(grey, np.clip(result.aspect, 0, 255), atol=PNG_DN)


@pytest.mark.parametrize("wrong", [None, {"a": 1}, b"t.toml", np.zeros(2)])
def test_what_is_no_station_is_refused_in_a_sentence(wrong):
    for call in (gpuspec.simulate, Station.read, gpuspec.Plan.of):
        with pytest.raises(StationError, match="a station is a Station or the path of its file"):
            call(wrong)


def test_a_path_is_taken_wherever_a_station_is(run, result, tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(gpuspec.to_toml(Station.from_dict(SMALL)), encoding="utf-8")
    assert gpuspec.Plan.of(str(path), {"tunnel.luminous_mm": "2:4:3"}).designs == 3
    assert gpuspec.search_plan(path, {"tunnel.luminous_mm": "2:4"}).designs == 2
    with pytest.raises(StationError, match="nothing to vary"):
        gpuspec.sweep(str(path), tmp_path / "sweep")
    np.testing.assert_array_equal(result.light_map.aspect(str(path)), result.aspect)
    assert "blind" in repr(gpuspec.study("coverage", path, backend="numpy"))
    assert gpuspec.front(str(run.path)).best == gpuspec.front(run).best
    with pytest.raises(gpuspec.GpuspecError, match="a sweep is a RunFolder or the path"):
        gpuspec.front(None)


@pytest.mark.parametrize("vary", [{5: [1]}, {"sequence.images": None}, ["tunnel.dark_mm=1,2"]])
def test_what_cannot_be_varied_is_refused_in_a_sentence(vary):
    with pytest.raises(StationError, match=r"dictionary of keys|not a list of numbers"):
        gpuspec.Plan.of(Station.from_dict(SMALL), vary)


def test_a_rule_and_an_image_number_are_checked(result):
    with pytest.raises(StationError, match="p2_floor is 'x'; it must be a number from 0 to 1"):
        gpuspec.Rule(p2_floor="x")
    with pytest.raises(StationError, match="there is no image"):
        result.light_map.image(np.array([1, 2]))
    np.testing.assert_array_equal(result.light_map.image(np.int64(1)), result.light_map.image(1))


@pytest.mark.parametrize("folder", ["", "."])
def test_a_folder_in_place_of_a_station_file_is_named_as_one(folder):
    with pytest.raises(StationError, match="is a folder; name a station file in it"):
        Station.read(folder)


def test_a_folder_in_place_of_a_relief_is_named_as_one():
    relief = {"file": ".", "height_unit": "um", "pitch_um": 1.0}
    station = Station.from_dict(SMALL | {"part": SMALL["part"] | {"relief": relief}})
    with pytest.raises(gpuspec.GpuspecError, match="is a folder; name a file in it"):
        gpuspec.simulate(station, "numpy")
