"""What is saved is loaded again as it was; what was never saved so is refused in a sentence."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from tolerances import DEVICE_DN

import gpuspec as gs
from gpuspec.errors import BackendError, OutputError
from gpuspec.files import MANIFEST
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.patterns import Pattern
from gpuspec.report.folder import ARRAYS
from gpuspec.simulation import light_map
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import trace

STATION = gs.Station.from_dict(
    {
        "part": {"length_mm": 40.0, "width_mm": 20.0},
        "tunnel": {"length_mm": 45.0},  # so that some light is lost
        "camera": {"sampling_mm": 0.1, "rows": 210},  # and some pixels see no part
        "sequence": {"images": 12},
        "defects": [
            {"kind": "scratch", "points_mm": [[-9.0, 2.0], [-4.0, 4.5]], "width_mm": 0.4,
             "depth_um": 5.0},
            {"kind": "dent", "x_mm": 19.4, "y_mm": 0.0, "diameter_mm": 1.0, "depth_um": 5.0},
        ],
        "populations": [
            {"kind": "dent", "count": 6, "seed": 4, "diameter_mm": [0.6, 1.5], "depth_um": [3, 12]},
            {"kind": "bump", "count": 3, "seed": 5, "diameter_mm": [0.6, 1.5], "depth_um": [3, 12]},
        ],
        "classes": [{"name": "long", "elongation_min": 2.0}, {"name": "round"}],
    },
    "wide.toml",
)  # fmt: skip


@pytest.fixture(scope="module")
def result() -> Result:
    found = gs.simulate(STATION, "numpy")
    assert set(np.unique(found.lost)) == {0, 1, 3}
    assert (found.lost[found.truth == 2] == 3).any()  # which is scored all the same
    assert len(found.blobs) >= 5
    assert set(found.classes) == {"long", "round"}
    assert found.warnings
    assert found.refined["pixels"]
    return found


@pytest.fixture(scope="module")
def saved(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "run"
    result.save(folder, pictures=False)
    return folder


@pytest.fixture
def copied(saved: Path, tmp_path: Path) -> Path:
    return shutil.copytree(saved, tmp_path / "run")


def same(again: Result, result: Result) -> None:
    """Fail unless two results are equal in all that they hold, to the bit."""
    for name in ("aspect", "lost", "truth", "labels", "classes", "valid"):
        one, other = getattr(again, name), getattr(result, name)
        assert one.dtype == other.dtype
        assert np.array_equal(one, other), name
    for name in ("station", "info", "defects", "score", "threshold", "flawless_dn", "warnings",
                 "assumptions", "extent_mm"):  # fmt: skip
        assert getattr(again, name) == getattr(result, name), name
    assert again.blobs.rows() == result.blobs.rows()
    assert again.confusion.rows == result.confusion.rows
    assert again.confusion.columns == result.confusion.columns
    assert np.array_equal(again.confusion.counts, result.confusion.counts)
    assert again.relief.defects == result.relief.defects
    assert again.light_map.refined == result.light_map.refined
    assert repr(again) == repr(result)


def test_a_result_is_loaded_as_it_was_saved_without_a_trace(result, saved, monkeypatch):
    monkeypatch.setattr(light_map, "open_backend", None)
    same(gs.load(saved), result)
    same(gs.load(str(saved)), result)


def test_what_needs_no_image_of_the_sequence_is_drawn_without_a_trace(saved, monkeypatch):
    monkeypatch.setattr(light_map, "open_backend", None)
    again = gs.load(saved)
    for name in ("station", "aspect", "detection", "histogram", "lost"):
        assert again.picture(name).axes
    assert np.array_equal(again.light_map.lost(), again.lost)


def test_a_loaded_light_map_is_traced_once_when_it_is_asked_for(result, saved, monkeypatch):
    traced = []
    real = NumpyBackend.trace
    monkeypatch.setattr(NumpyBackend, "trace", lambda *given: traced.append(1) or real(*given))
    again = gs.load(saved)
    assert not traced
    assert np.array_equal(again.light_map.image(3), result.light_map.image(3))
    assert np.array_equal(again.light_map.aspect(), result.aspect)
    design = STATION.replace(sensor__exposure=6)
    assert again.light_map.score(design) == result.light_map.score(design)
    assert len(traced) == 1


def test_a_loaded_result_is_saved_again_as_it_was(result, saved, tmp_path):
    gs.load(saved).save(tmp_path / "again", pictures=False)
    same(gs.load(tmp_path / "again"), result)
    for name in ARRAYS:
        one, other = (tifffile.imread(f / f"{name}.tif") for f in (saved, tmp_path / "again"))
        assert np.array_equal(one, other)


def test_a_run_of_the_command_is_loaded_too(gpuspec_):
    assert (
        gpuspec_("simulate", "s.toml", "--backend", "numpy", "--frames", "--no-pictures").code == 0
    )
    again = gs.load("run")
    same(again, gs.simulate("s.toml", "numpy"))
    frames = tifffile.imread("run/frames.tif")
    assert np.array_equal(frames[1], np.rint(again.light_map.image(1)))


def test_a_measured_part_is_loaded_with_its_pits(tmp_path):
    result = gs.simulate(gs.example("measured"), "numpy")
    assert {defect.kind for defect in result.defects} >= {"pit"}
    result.save(tmp_path / "run", pictures=False)
    same(gs.load(tmp_path / "run"), result)


@pytest.mark.parametrize("name", ["opencl", "opengl", "vulkan"])
def test_the_device_that_traced_it_traces_it_again(tmp_path, name):
    result = gs.simulate(STATION, name)
    result.save(tmp_path / "run", pictures=False)
    again = gs.load(tmp_path / "run")
    same(again, result)
    assert np.array_equal(again.light_map.image(5), result.light_map.image(5))
    assert again.light_map.score() == result.score


@pytest.mark.parametrize("name", ["opengl"])
def test_a_prototype_is_loaded_with_its_light(tmp_path, name):
    traced = trace(STATION, name)
    result = traced.result(traced.light_map.with_pattern(Pattern.read("sinusoidal")))
    result.save(tmp_path / "run", pictures=False)
    again = gs.load(tmp_path / "run")
    same(again, result)
    assert again.light_map.pattern == result.light_map.pattern
    assert np.array_equal(again.light_map.image(2), result.light_map.image(2))
    assert np.abs(again.light_map.aspect() - traced.light_map.aspect()).max() > DEVICE_DN


def test_images_of_a_device_that_is_gone_are_a_sentence_and_the_rest_is_there(copied):
    edit(copied, device="H100")
    again = gs.load(copied)
    assert again.info.device == "H100"
    assert again.picture("detection").axes
    with pytest.raises(BackendError, match="no device 'H100'; choose by number or name"):
        again.light_map.image(0)


def test_a_sweep_is_loaded_as_its_folder(tmp_path):
    run = gs.sweep(STATION, {"sensor.exposure": [2, 4]}, tmp_path / "run", backend="numpy")
    again = gs.load(tmp_path / "run")
    assert isinstance(again, gs.RunFolder)
    assert again.table().equals(run.table())


# ------------------------------------------------------------------------------ what is no run


def refused(folder: Any, *words: str) -> None:
    with pytest.raises(OutputError) as caught:
        gs.load(folder)
    text = str(caught.value)
    assert text.endswith("."), text
    for word in words:
        assert word in text, text


def edit(folder: Path, **values: Any) -> None:
    """Change what score.json says, as if it had been written so."""
    (folder / MANIFEST).unlink(missing_ok=True)
    said = json.loads((folder / "score.json").read_text("utf-8"))
    (folder / "score.json").write_text(json.dumps(said | values), "utf-8")


def test_what_is_no_folder_of_gpuspec_is_refused(tmp_path):
    refused(tmp_path, "holds no run; result.save(folder) or")
    refused(tmp_path / "none", "none is not there; name the folder of a run")
    (tmp_path / "a.txt").write_text("", "utf-8")
    refused(tmp_path / "a.txt", "a.txt is no folder")
    for wrong in (None, 5, "", " "):
        refused(wrong, "the path of its folder")
    refused("a\0b", "is not there")
    refused("a" * 5000)


def test_the_folder_of_a_study_or_a_search_is_no_run(tmp_path):
    gs.study("coverage", STATION, backend="numpy").write(tmp_path / "study")
    refused(tmp_path / "study", "holds what a study of coverage wrote", "works it out again")
    plan = gs.search_plan(STATION, {"sensor.exposure": [2, 4]})
    gs.optimise(plan, tmp_path / "search", 1, backend="numpy")
    refused(tmp_path / "search", "is the folder of a search; gpuspec.optimise")


@pytest.mark.parametrize("name", ["score.json", "station.toml", *(f"{n}.tif" for n in ARRAYS)])
def test_a_missing_changed_or_damaged_file_is_named(copied, name):
    data = (copied / name).read_bytes()
    (copied / name).write_bytes(data + b"\n")
    refused(copied, f"{name} cannot be read back: it was changed since gpuspec wrote it")
    (copied / MANIFEST).unlink()
    for damaged in (b"", data[: len(data) // 3], b"\0" * 100):
        (copied / name).write_bytes(damaged)
        refused(copied, "cannot be read back" if damaged else "")
    (copied / name).unlink()
    refused(copied, f"no whole run: {name} is not there")


def test_the_score_must_be_that_of_the_images(copied):
    said = json.loads((copied / "score.json").read_text("utf-8"))["score"]
    edit(copied, score=said | {"p1": 0.5})
    refused(copied, "its score is not that of the images beside it")


@pytest.mark.parametrize("name", ["labels", "truth", "lost"])
def test_an_image_of_another_run_is_noticed(copied, result, name):
    (copied / MANIFEST).unlink()
    image = np.roll(getattr(result, name), 60, axis=0)
    tifffile.imwrite(copied / f"{name}.tif", image)
    refused(copied, "score.json cannot be read back")


@pytest.mark.parametrize(
    ("name", "image"),
    [
        ("aspect", np.zeros((3, 3), np.float32)),
        ("aspect", np.zeros((210, 400))),
        ("labels", np.zeros((210, 400), np.uint8)),
        ("lost", np.full((210, 400), 9, np.uint8)),
        ("lost", np.zeros((2, 210, 400), np.uint8)),
    ],
)
def test_an_image_of_another_kind_is_refused(copied, name, image):
    (copied / MANIFEST).unlink()
    tifffile.imwrite(copied / f"{name}.tif", image)
    refused(copied, f"{name}.tif cannot be read back: it ")


@pytest.mark.parametrize("text", ["[]", "{}", '{"station": 5}', "null", "{", "[" * 100_000])
def test_a_score_that_is_none_is_refused(copied, text):
    (copied / MANIFEST).unlink()
    (copied / "score.json").write_text(text, "utf-8")
    refused(copied, "score.json cannot be read back")


@pytest.mark.parametrize(
    "wrong",
    [
        {"threshold_dn": "high"}, {"threshold_dn": None}, {"score": None}, {"pattern": "x.glsl"},
        {"warnings": 5}, {"device": None, "score": {}}, {"flawless_dn": float("nan")},
        {"refined": None},
        {"refined": {"pixels": 1, "sub_rays": 4, "2": 0, "4": 0, "8": 0, "16": 0, "slices": 0}},
    ],
)  # fmt: skip
def test_a_score_with_other_values_is_refused(copied, wrong):
    edit(copied, **wrong)
    refused(copied, "cannot be read")


def test_a_station_of_another_size_or_without_a_key_is_refused(copied):
    (copied / MANIFEST).unlink()
    path = copied / "station.toml"
    text = path.read_text("utf-8")
    path.write_text(text.replace("rows = 210", "rows = 211"), "utf-8")
    refused(copied, "tif cannot be read back: it is float32 of (210, 400), the station's (211")
    path.write_text(text.replace("sampling_mm", "sampling_um"), "utf-8")
    refused(copied, "station.toml cannot be read back", "not a known key")


# -------------------------------------------------------------------------------------- saving


def test_saving_replaces_nothing_but_an_earlier_run(result, tmp_path):
    (tmp_path / "aspect.tif").write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"aspect\.tif is in the way"):
        result.save(tmp_path, pictures=False)
    assert (tmp_path / "aspect.tif").read_bytes() == b"mine"
    result.save(tmp_path, pictures=False, force=True)
    same(gs.load(tmp_path), result)
    for wrong, why in (("", "has no name"), (None, "named by its path"), (5, "named by its path")):
        with pytest.raises(OutputError, match=why):
            result.save(wrong)
