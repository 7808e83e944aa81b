"""A data set: what its files hold, that others can read them, and that it is gone on with."""

from __future__ import annotations

import hashlib
import json
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import faster_coco_eval as faster
import numpy as np
import pytest
import tifffile
from commandline import DEADLINE_S, PROGRAM, content, program, said
from PIL import Image
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

import gpuspec
from gpuspec.datasets.plan import SPLITS, DataSetPlan
from gpuspec.datasets.rle import masks
from gpuspec.errors import GpuspecError, OutputError, StationError
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.simulation.simulate import trace
from gpuspec.station.station import Station

STATION = {
    "part": {"length_mm": 20.0, "width_mm": 12.0},
    "camera": {"sampling_mm": 0.1},
    "tunnel": {"height_mm": 300.0, "luminous_mm": 2.0, "dark_mm": 6.0},
    "sensor": {"noise": True},
    "populations": [
        {"kind": "dent", "count": 3, "diameter_mm": [0.3, 1.0], "depth_um": [0.02, 6.0]},
        {"kind": "scratch", "count": 2, "width_mm": [0.05, 0.2], "length_mm": [2, 6],
         "depth_um": [0.5, 3.0]},
    ],
    "dataset": {"split": [0.5, 0.2, 0.3],
                "vary": {"sensor.exposure": [2, 6], "populations[1].count": [2, 5]}},
}  # fmt: skip
PARTS = 10


@pytest.fixture(scope="module")
def station() -> Station:
    return Station.from_dict(STATION, "s.toml")


@pytest.fixture(scope="module")
def made(station: Station, tmp_path_factory: pytest.TempPathFactory) -> gpuspec.DataSetMade:
    folder = tmp_path_factory.mktemp("made") / "set"
    return gpuspec.dataset(station, PARTS, folder, licence="CC0-1.0")


def tables(made: gpuspec.DataSetMade) -> dict[str, Any]:
    return {split: json.loads(made.annotations(split).read_text("utf-8")) for split in SPLITS}


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {name: data for name, data in content(folder).items() if "lock" not in name}


def test_masks_are_the_zones_pixel_by_pixel_and_boxes_and_areas_are_theirs(made):
    for split in SPLITS:
        coco = COCO(made.annotations(split))
        for image in coco.loadImgs(coco.getImgIds()):
            station = made.plan.station_of(image["id"])
            zones = Truth.of(station, Relief.of(station)).labels
            kept = np.asarray(Image.open(made.folder / "masks" / image["file_name"]))
            assert np.array_equal(kept, zones)
            told = coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
            assert {a["attributes"]["defect"] for a in told} == set(np.unique(zones)) - {0}
            for one in told:
                mask = zones == one["attributes"]["defect"]
                assert np.array_equal(coco.annToMask(one), mask)
                row, column = np.nonzero(mask)
                box = (column.min(), row.min(), np.ptp(column) + 1, np.ptp(row) + 1)
                assert (one["area"], tuple(one["bbox"])) == (mask.sum(), box)
                assert isinstance(one["segmentation"]["counts"], str)


def test_one_pixel_a_whole_image_and_none_are_masks():
    assert masks(np.zeros((3, 4), np.int32)) == []
    (whole,) = masks(np.ones((3, 4), np.int32))
    assert (whole.area, whole.box) == (12, (0, 0, 4, 3))
    labels = np.zeros((3, 4), np.int32)
    labels[0, 3], labels[2, 1] = 2, 9
    assert [(m.number, m.box) for m in masks(labels)] == [(2, (3, 0, 1, 1)), (9, (1, 2, 1, 1))]


def test_a_perfect_prediction_has_the_greatest_precision_in_both_evaluators(made):
    for load, evaluate in ((COCO, COCOeval), (faster.COCO, faster.COCOeval_faster)):
        truth = load(str(made.annotations("train")))
        for kind in ("segm", "bbox"):
            perfect = [{**a, "score": 0.9} for a in truth.loadAnns(truth.getAnnIds())]
            run = evaluate(truth, truth.loadRes(perfect), kind)
            run.evaluate()
            run.accumulate()
            run.summarize()
            assert run.stats[0] == pytest.approx(1.0)
        moved = [{**a, "bbox": [a["bbox"][0] + 40, *a["bbox"][1:]]} for a in perfect]
        run = evaluate(truth, truth.loadRes(moved), "bbox")
        run.evaluate()
        run.accumulate()
        run.summarize()
        assert run.stats[0] < 0.2


def test_a_strict_validator_finds_nothing_and_would(made, tmp_path):
    panlabel = Path(sys.executable).parent / "panlabel"
    validator = [panlabel, "validate", "--strict", "--format", "coco"]
    for split in SPLITS:
        subprocess.run([*validator, made.annotations(split)], check=True, timeout=DEADLINE_S)
    wrong = tables(made)["train"]
    wrong["annotations"][0]["category_id"] = 99
    (tmp_path / "wrong.json").write_text(json.dumps(wrong))
    done = subprocess.run([*validator, tmp_path / "wrong.json"], timeout=DEADLINE_S)
    assert done.returncode


def test_every_annotation_tells_its_defect_and_whether_the_threshold_finds_it(made):
    found = []
    for table in tables(made).values():
        for image in table["images"]:
            station = made.plan.station_of(image["id"])
            traced = trace(station)
            aspect, truth = traced.light_map.counted(), traced.truth
            around = np.median(aspect)
            assert image["values"]["sensor.exposure"] == station.sensor.exposure
            own = [a for a in table["annotations"] if a["image_id"] == image["id"]]
            for one in own:
                told, defect = one["attributes"], truth.defects[one["attributes"]["defect"] - 1]
                assert told["depth_um"] == pytest.approx(defect.depth_um, abs=1e-5)
                assert told["size_mm"] == pytest.approx(defect.size_mm, abs=1e-5)
                name = table["categories"][one["category_id"] - 1]["name"]
                assert name == defect.kind
                inside = aspect[truth.labels == told["defect"]]
                contrast = inside.mean() - around
                assert told["contrast_dn"] == pytest.approx(contrast, rel=0.05, abs=1.5)
                assert told["found"] == (told["hit_px"] > 0)
                assert told["found"] == (inside.max() > image["threshold_dn"])
                found.append(told["found"])
    assert {True, False} == set(found)


def test_a_part_is_in_one_split_and_the_splits_have_their_shares(made, station):
    own = [{image["id"] for image in table["images"]} for table in tables(made).values()]
    assert sorted(number for ids in own for number in ids) == list(range(1, PARTS + 1))
    plan = DataSetPlan.of(station)
    counts = [sum(plan.split(k) == split for k in range(1, 1001)) for split in SPLITS]
    assert counts == pytest.approx([500, 200, 300], abs=3)
    numbers = [a["id"] for table in tables(made).values() for a in table["annotations"]]
    assert sorted(numbers) == list(range(1, len(numbers) + 1))


def test_what_is_drawn_lies_in_its_range_fills_it_and_follows_from_the_seed(station):
    vary = {"sensor.exposure": [2, 6], "sequence.images": "20:22", "part.material": "gold,silver",
            "sensor.noise": [True, False], "segmentation.threshold": [90, 95, 100]}  # fmt: skip
    plan = DataSetPlan.of(station, vary)
    drawn = [plan.values(k) for k in range(1, 201)]
    exposures = [values["sensor.exposure"] for values in drawn]
    assert 2 <= min(exposures) < 2.2
    assert 5.8 < max(exposures) <= 6
    assert {values["sequence.images"] for values in drawn} == {20, 21, 22}
    assert {values["part.material"] for values in drawn} == {"gold", "silver"}
    assert {values["sensor.noise"] for values in drawn} == {True, False}
    assert {values["segmentation.threshold"] for values in drawn} == {90, 95, 100}
    assert DataSetPlan.of(plan.station).values(7) == plan.values(7)
    assert DataSetPlan.of(station, vary, seed=5).values(7) != plan.values(7)
    seeds = {(s.sensor.seed, s.populations[0].seed) for s in map(plan.station_of, range(1, 21))}
    assert len(seeds) == 20


def test_values_that_make_no_station_together_are_drawn_again(station):
    vary = {"camera.height_mm": [350, 800], "tunnel.height_mm": [200, 790]}
    plan = DataSetPlan.of(station, vary)
    for number in range(1, 41):
        drawn = plan.station_of(number)
        assert drawn.camera.height_mm > drawn.tunnel.height_mm
        assert plan.values(number)["camera.height_mm"] == drawn.camera.height_mm


@pytest.mark.parametrize(
    ("vary", "why"),
    [
        ({"sensor.exposure": [6, 2]}, "reversed; write 2:6"),
        ({"sensor.exposure": "2:x"}, "not a range"),
        ({"sensor.exposure": [-1, 2]}, "must be greater than 0"),
        ({"sensor.exposur": [1, 2]}, "did you mean exposure"),
        ({"sequence.images": [8, 9.5]}, "whole numbers"),
        ({"part.material": ["gold", "tin"]}, "must be 'ideal'"),
        ({"part.material": [1, 2]}, "not a number"),
        ({"sensor.seed": [1, 2]}, "dataset.seed gives other parts"),
        ({"populations[7].count": [1, 2]}, "there is no populations"),
        ({"sensor.exposure": [2, 2, 3]}, "stands twice"),
        ({"sensor.exposure": []}, "neither a range nor values"),
        ({"decision[1].count_max": [1, 2]}, "makes no other image"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_a_sentence(station, vary, why):
    with pytest.raises(StationError, match=why) as caught:
        DataSetPlan.of(station, vary)
    assert str(caught.value).endswith((".", "?"))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"populations": None}, "has no defects, so there is nothing to learn"),
        ({"populations": None, "defects": [{"kind": "dent", "x_mm": 0.0, "y_mm": 0.0,
          "diameter_mm": 1.0, "depth_um": 5.0}]}, "every part would be the same"),
    ],
)  # fmt: skip
def test_a_station_without_a_random_defect_is_refused(station, tmp_path, change, why):
    with pytest.raises(StationError, match=why):
        gpuspec.dataset(station.replace(dataset=None, **change), 3, tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_known_defects_that_stand_still_are_told(station):
    dent = {"kind": "dent", "x_mm": 0.0, "y_mm": 0.0, "diameter_mm": 1.0, "depth_um": 5.0}
    still = station.replace(defects=[dent])
    assert "same place on every part" in DataSetPlan.of(still).notes[0]
    assert not DataSetPlan.of(still, {"defects[1].x_mm": [-5, 5]}).notes


def test_levels_of_8_and_16_bits_are_those_of_the_floats(station, tmp_path):
    images = {}
    for format_, bits in (("png", 8), ("png", 16), ("tif", 8), ("tif", 16), ("tif", 32)):
        kept = gpuspec.dataset(station, 1, tmp_path / f"{format_}{bits}", format=format_, bits=bits,
                               fusions=True)  # fmt: skip
        path = kept.images / f"000001.{format_}"
        images[format_, bits] = (
            tifffile.imread(path) if format_ == "tif" else np.asarray(Image.open(path))
        )
        assert len(list((kept.folder / "fusions").iterdir())) == 4
    exact = images["tif", 32]
    assert exact.dtype == np.float32
    for format_ in ("png", "tif"):
        assert np.array_equal(images[format_, 8], np.rint(exact))
        assert np.abs(images[format_, 16] / 257.0 - exact).max() < 0.51 / 257
        assert images[format_, 16].dtype == np.uint16
    for kept_badly in ({"format": "png", "bits": 32}, {"bits": 12}, {"format": "jpg"}):
        with pytest.raises(StationError):
            gpuspec.dataset(station, 1, tmp_path / "none", **kept_badly)


def test_frames_are_the_sequence_and_their_mean_the_image(station, tmp_path):
    few = station.replace(sequence__images=8)
    kept = gpuspec.dataset(few, 1, tmp_path / "set", format="tif", bits=32, frames=True)
    frames = tifffile.imread(kept.folder / "frames/000001.tif")
    assert frames.shape == (8, *few.shape)
    aspect = tifffile.imread(kept.images / "000001.tif")
    assert np.abs(frames.mean(axis=0) - aspect).max() < 1e-3


class Stopped(BaseException):
    """Whatever ends it in the middle."""


def test_stopped_anywhere_it_ends_with_the_same_bytes(station, made, tmp_path):
    def stop(_: str, done: int, of: int) -> None:
        if 3 <= done < of:
            raise Stopped

    with pytest.raises(Stopped):
        gpuspec.dataset(station, PARTS, tmp_path / "cut", licence="CC0-1.0", progress=stop)
    assert not (tmp_path / "cut/annotations").exists()
    there = bytes_of(tmp_path / "cut/images")
    assert 3 <= len(there) < PARTS
    (tmp_path / "cut/images/000002.png").write_bytes(b"half")  # as a power cut leaves it
    again = gpuspec.dataset(station, PARTS, tmp_path / "cut", licence="CC0-1.0")
    assert again.made <= PARTS - 2
    assert bytes_of(tmp_path / "cut") == bytes_of(made.folder)


def test_a_smaller_data_set_grows_to_the_same_bytes(station, made, tmp_path):
    gpuspec.dataset(station, 4, tmp_path / "set", licence="CC0-1.0")
    grown = gpuspec.dataset(station, PARTS, tmp_path / "set", licence="CC0-1.0")
    assert grown.made == PARTS - 4
    assert bytes_of(tmp_path / "set") == bytes_of(made.folder)
    with pytest.raises(OutputError, match="as many or more"):
        gpuspec.dataset(station, 4, tmp_path / "set", licence="CC0-1.0")


def test_another_data_set_and_other_files_are_not_touched(station, made, tmp_path):
    before = content(made.folder)
    for other in (
        {"seed": 9},
        {"bits": 16},
        {"licence": ""},
        {"vary": {"sensor.exposure": [2, 5]}},
    ):
        with pytest.raises(OutputError, match="holds another data set: "):
            gpuspec.dataset(station, PARTS, made.folder, **{"licence": "CC0-1.0", **other})
    assert content(made.folder) == before
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        gpuspec.dataset(station, 2, tmp_path)
    assert content(tmp_path) == {"thesis.tex": b"mine"}


def test_the_data_sheet_counts_what_is_there_and_every_checksum_holds(made):
    sheet = (made.folder / "README.md").read_text("utf-8")
    for split, table in tables(made).items():
        kinds = [a["category_id"] for a in table["annotations"]]
        counts = len(table["images"]), kinds.count(1), kinds.count(2)
        assert f"| `annotations/{split}.json` | {' | '.join(map(str, counts))} |" in sheet
    assert "**Licence:** CC0-1.0" in sheet
    assert "| `sensor.exposure` | 2 to 6 | uniform |" in sheet
    lines = (made.folder / "dataset.sha256").read_text("utf-8").splitlines()
    told = {name: sha for sha, name in (line.split("  ") for line in lines)}
    assert {"images/000001.png", "annotations/test.json", "README.md", "contact.png"} <= set(told)
    for name, sha in told.items():
        assert hashlib.sha256((made.folder / name).read_bytes()).hexdigest() == sha
    with Image.open(made.folder / "contact.png") as picture:
        assert picture.width == 1500


def limited(size: int) -> Any:
    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return limit


@pytest.mark.slow
def test_the_command_makes_goes_on_and_is_refused_in_a_sentence(station, tmp_path):
    (tmp_path / "s.toml").write_text(gpuspec.to_toml(station))
    made = program("dataset", "s.toml", "-n", "3", "-o", "set", "--backend", "numpy", cwd=tmp_path)
    assert made.code == 0, made.err
    assert "the station's own threshold finds" in made.out
    again = program("dataset", "s.toml", "-n", "3", "-o", "set", "--backend", "numpy", cwd=tmp_path)
    assert "3 were there already" in again.out
    assert "holds another data set: the station has" in said(
        program("dataset", "s.toml", "-n", "3", "-o", "set", "--seed", "4", cwd=tmp_path)
    )
    command = ("dataset", "s.toml", "-n", "3", "-o", "full", "--backend", "numpy")
    floats = ("--format", "tif", "--bits", "32")
    full = program(*command, *floats, cwd=tmp_path, preexec_fn=limited(60_000))
    assert full.code == 1
    assert "cannot be written to full" in full.err
    assert "Traceback" not in full.err
    assert not list((tmp_path / "full").rglob("*.tif"))


def test_ctrl_c_says_that_the_same_command_goes_on(station, tmp_path):
    (tmp_path / "s.toml").write_text(gpuspec.to_toml(station))
    command = ["dataset", "s.toml", "-n", "5000", "-o", "set", "--backend", "numpy"]
    process = subprocess.Popen([*PROGRAM, *command], cwd=tmp_path, stderr=subprocess.PIPE,
                               stdout=subprocess.DEVNULL, text=True)  # fmt: skip
    while not list((tmp_path / "set").glob("parts/*.json")) and process.poll() is None:
        pass
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 130
    assert "the same command goes on" in error
    assert "Traceback" not in error
    assert not list((tmp_path / "set").glob(".partial-*"))


def test_parts_are_counted_from_one(station, tmp_path):
    for wrong in (0, -1, 2.5, True, 10**9):
        with pytest.raises(GpuspecError, match="a data set has 1 to"):
            gpuspec.dataset(station, wrong, tmp_path / "set")
