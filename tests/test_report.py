"""What a run leaves behind: every number again, whole or not at all."""

from __future__ import annotations

import csv
import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from test_topography import polished, write_sur

import gpuspec
from gpuspec import figures, report
from gpuspec.errors import OutputError
from gpuspec.inspection import Result, simulate
from gpuspec.opencl import OpenCLBackend
from gpuspec.reference import NumpyBackend
from gpuspec.report import FILES, output_folder, summary, write
from gpuspec.station import Station
from gpuspec.stationfile import to_toml

STATION = {
    "part": {"length_mm": 12.0, "width_mm": 6.0},
    "camera": {"sampling_mm": 0.1},
    "sequence": {"images": 5},
    "defects": [
        {"kind": "dent", "x_mm": 2.0, "y_mm": -1.0, "diameter_mm": 0.8, "depth_um": 8.0},
        {
            "kind": "scratch", "points_mm": [[-4.0, 1.0], [-1.0, 1.5]], "width_mm": 0.4,
            "depth_um": 6.0,
        },
        {"kind": "bump", "x_mm": 5.0, "y_mm": 2.0, "diameter_mm": 0.6, "depth_um": 1e-6},
    ],
}  # fmt: skip
TABLES = {
    "aspect.tif", "labels.tif", "truth.tif", "blobs.csv", "defects.csv", "score.json",
    "station.toml",
}  # fmt: skip


@pytest.fixture(scope="module")
def result(opencl: OpenCLBackend) -> Result:
    found = simulate(Station.from_dict(STATION, "trim é.toml"), opencl)
    assert len(found.blobs) >= 2, "a test of tables needs blobs"
    return found


@pytest.fixture(scope="module")
def written(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "a run"
    write(result, folder, frames=True)
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def hidden(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.name.startswith(".gpuspec")]


def test_every_promised_file_is_written_and_no_other(written):
    assert {path.name for path in written.iterdir()} == set(FILES)
    assert set(FILES) == TABLES | {"frames.tif"} | set(figures.PICTURES)
    assert not hidden(written.parent)


def test_a_folder_of_results_may_be_read_by_others(written):
    mask = os.umask(0)
    os.umask(mask)
    assert (written / "score.json").stat().st_mode & 0o777 == 0o666 & ~mask
    assert written.stat().st_mode & 0o777 == 0o777 & ~mask


def test_the_aspect_image_is_kept_to_the_bit(result, written):
    image = tifffile.imread(written / "aspect.tif")
    assert image.dtype == np.float32
    assert np.array_equal(image, result.aspect)


@pytest.mark.parametrize("name", ["labels", "truth"])
def test_label_images_are_kept_exactly(result, written, name):
    image = tifffile.imread(written / f"{name}.tif")
    assert image.dtype == np.int32
    assert image.max() >= 2
    assert np.array_equal(image, getattr(result, name))


@pytest.mark.parametrize("name", ["aspect.tif", "labels.tif", "truth.tif", "frames.tif"])
def test_every_image_knows_its_scale_and_where_it_was_made(result, written, name):
    with tifffile.TiffFile(written / name) as file:
        for page in file.pages:
            tags = page.tags
            for axis in ("XResolution", "YResolution"):
                numerator, denominator = tags[axis].value
                assert numerator / denominator == pytest.approx(100.0)  # per cm: 0.1 mm
            assert tags["ResolutionUnit"].value == tifffile.RESUNIT.CENTIMETER
            assert tags["Software"].value == f"gpuspec {gpuspec.__version__}"
            assert json.loads(tags["ImageDescription"].value) == {
                "gpuspec": gpuspec.__version__,
                **result.info.as_dict(),
                "sampling_mm": 0.1,
            }


@pytest.mark.parametrize(
    ("bits", "dtype"), [(8, np.uint8), (10, np.uint16), (12, np.uint16), (16, np.uint16)]
)
def test_frames_are_the_images_in_whole_grey_levels(opencl, tmp_path, bits, dtype):
    station = Station.from_dict(STATION).replace(sensor__bit_depth=bits)
    found = simulate(station, opencl)
    write(found, tmp_path, frames=True, pictures=False)
    with tifffile.TiffFile(tmp_path / "frames.tif") as file:
        pages = [page.asarray() for page in file.pages]
    assert len(pages) == station.sequence.images
    for k, page in enumerate(pages):
        assert page.dtype == dtype
        assert np.array_equal(page, np.rint(found.light_map.image(k)))
    assert max(page.max() for page in pages) == 2**bits - 1


def test_the_table_of_blobs_is_that_of_the_result(result, written):
    rows = table(written / "blobs.csv")
    assert len(rows) == len(result.blobs) == result.labels.max()
    for row, blob, name in zip(rows, result.blobs.rows(), result.classes, strict=True):
        assert row.pop("class") == name
        assert len(row) == len(blob)
        for key, value in blob.items():
            given = row.get(key, row.get(f"{key}_px"))
            assert float(given) == pytest.approx(value, rel=1e-8)


def test_the_table_of_defects_is_that_of_the_score(result, written):
    rows = table(written / "defects.csv")
    assert [row["defect"] for row in rows] == ["1", "2", "3"]
    assert [row["kind"] for row in rows] == ["dent", "scratch", "bump"]
    for number, (row, defect) in enumerate(zip(rows, result.defects, strict=True), 1):
        for key in ("x_mm", "y_mm", "size_mm", "length_mm", "depth_um"):
            assert float(row[key]) == pytest.approx(getattr(defect, key), rel=1e-3, abs=1e-4)
        zone = result.truth == number
        assert int(row["zone_px"]) == zone.sum()
        assert int(row["hit_px"]) == (zone & (result.labels > 0)).sum()
        assert row["hit"] == ("yes" if int(row["hit_px"]) else "no")
    assert [row["hit"] for row in rows] == ["yes", "yes", "no"]


def test_the_score_is_complete_and_says_where_it_was_made(result, written):
    score = json.loads((written / "score.json").read_text("utf-8"))
    assert score == json.loads(json.dumps(summary(result)))
    assert score.items() >= result.info.as_dict().items()
    assert score["gpuspec"] == gpuspec.__version__
    assert score["station"] == "trim é.toml"
    assert score["threshold_dn"] == result.threshold
    assert score["score"]["p1"] == result.score.p1
    assert score["score"]["p2"] == result.score.p2
    assert sum(score["classes"].values()) == len(result.blobs)
    rows = score["confusion"]
    assert [list(line.values()) for line in rows.values()] == result.confusion.counts.tolist()


def test_a_flawless_part_has_a_score_that_any_reader_of_json_takes(opencl, tmp_path):
    found = simulate(Station.from_dict({**STATION, "defects": []}), opencl)
    write(found, tmp_path, pictures=False)
    text = (tmp_path / "score.json").read_text("utf-8")
    score = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert score["score"]["p2"] is None
    assert table(tmp_path / "defects.csv") == []


def test_the_station_is_kept_with_every_default(result, written):
    again = Station.read(written / "station.toml")
    assert again.as_dict() == result.station.as_dict()
    assert to_toml(again) == to_toml(result.station)
    assert "roughness_rad = 0.0" in (written / "station.toml").read_text("utf-8")


def test_a_kept_station_finds_its_topography_from_any_folder(tmp_path, monkeypatch):
    home = tmp_path / "my stations"
    home.mkdir()
    write_sur(home / "pit.sur", *polished())
    (home / "s.toml").write_text(
        "part = { length_mm = 4.0, width_mm = 4.0 }\ncamera = { sampling_mm = 0.02 }\n"
        '[[defects]]\nkind = "measured"\nfile = "pit.sur"\nx_mm = 0.0\ny_mm = 0.0\n',
        encoding="utf-8",
    )
    monkeypatch.chdir(home)
    found = simulate(Station.read("s.toml"), NumpyBackend())
    write(found, tmp_path / "run", pictures=False)
    monkeypatch.chdir(tmp_path)
    again = Station.read(tmp_path / "run" / "station.toml")
    assert again.locate(again.defects[0].file) == home / "pit.sur"
    assert np.array_equal(simulate(again, NumpyBackend()).aspect, found.aspect)


@pytest.mark.parametrize("name", [n for n in FILES if n.endswith(".png")])
def test_pictures_open_and_show_something(written, name):
    with Image.open(written / name) as picture:
        picture.load()
        assert picture.format == "PNG"
        assert min(picture.size) > 100
        assert np.ptp(np.asarray(picture.convert("L"))) > 100


def test_the_animation_moves(written):
    with Image.open(written / "sequence.gif") as picture:
        assert picture.format == "GIF"
        assert picture.n_frames > 1
        first = np.asarray(picture.convert("L")).copy()
        picture.seek(picture.n_frames // 2)
        assert not np.array_equal(first, np.asarray(picture.convert("L")))


def test_a_folder_never_mixes_two_runs(result, tmp_path):
    write(result, tmp_path, frames=True)
    write(result, tmp_path, frames=False, pictures=False)
    assert {path.name for path in tmp_path.iterdir()} == TABLES


def test_two_runs_of_one_station_write_the_same_tables(result, written, tmp_path):
    write(simulate(result.station, OpenCLBackend()), tmp_path, pictures=False)
    for name in TABLES - {"aspect.tif", "labels.tif", "truth.tif"}:
        assert (tmp_path / name).read_bytes() == (written / name).read_bytes()


def test_foreign_files_are_left_alone(result, tmp_path):
    for name in ("notes.txt", "aspect.tif.bak", ".hidden", ".gpuspec-mine"):
        (tmp_path / name).write_text(name, encoding="utf-8")
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "frames.tif").write_text("mine", encoding="utf-8")
    write(result, tmp_path, pictures=False)
    for name in ("notes.txt", "aspect.tif.bak", ".hidden", ".gpuspec-mine"):
        assert (tmp_path / name).read_text("utf-8") == name
    assert (tmp_path / "raw" / "frames.tif").read_text("utf-8") == "mine"


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def ctrl_c(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("existing", [True, False])
@pytest.mark.parametrize("name", ["station.png", "aspect.png", "lost.png"])
@pytest.mark.parametrize(
    ("failure", "error"), [(full_disk, OutputError), (ctrl_c, KeyboardInterrupt)]
)
def test_a_run_cut_short_leaves_all_as_it_was(
    result, tmp_path, monkeypatch, failure, error, name, existing
):
    for picture in figures.PICTURES:
        monkeypatch.setitem(figures.PICTURES, picture, lambda _, path: path.write_text("drawn"))
    monkeypatch.setitem(figures.PICTURES, name, failure)
    folder = tmp_path / "deep" / "run"
    if existing:
        write(result, folder, frames=True, pictures=False)
        (folder / "notes.txt").write_text("mine", encoding="utf-8")
        before = content(folder)
    with pytest.raises(error):
        write(result.__class__(**{**result.__dict__, "warnings": ("another run",)}), folder)
    if existing:
        assert content(folder) == before
    else:
        assert not folder.parent.exists()
    assert not hidden(tmp_path)


def test_a_full_disk_is_said_with_what_to_do(result, tmp_path, monkeypatch):
    monkeypatch.setitem(figures.PICTURES, "station.png", full_disk)
    with pytest.raises(OutputError) as raised:
        write(result, tmp_path / "run")
    assert str(raised.value) == (
        f"results cannot be written to {tmp_path / 'run'}: No space left on device. Free some "
        f"space or choose another folder with -o; nothing half-written was left."
    )


def test_a_short_write_of_numpy_is_said_as_a_full_disk(tmp_path):
    with (
        pytest.raises(OutputError, match=r"the disk may be full \(9 requested and 2 written\)"),
        output_folder(tmp_path / "run"),
    ):
        raise OSError("9 requested and 2 written")


def test_ctrl_c_while_files_move_does_not_mix_two_runs(result, tmp_path, monkeypatch):
    write(result, tmp_path, frames=True, pictures=False)
    replace, moved = Path.replace, []

    def interrupted(path: Path, target: Path) -> Path:
        moved.append(path.name)
        if len(moved) == 3:
            raise KeyboardInterrupt
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    other = simulate(result.station.replace(sensor__exposure=2.0), NumpyBackend())
    with pytest.raises(KeyboardInterrupt):
        write(other, tmp_path, pictures=False)
    assert {path.name for path in tmp_path.iterdir()} == TABLES
    assert np.array_equal(tifffile.imread(tmp_path / "aspect.tif"), other.aspect)
    assert Station.read(tmp_path / "station.toml").sensor == other.station.sensor
    assert json.loads((tmp_path / "score.json").read_text("utf-8"))["backend"] == "numpy"


def test_a_file_in_the_way_is_named_before_any_work(tmp_path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with (
            pytest.raises(OutputError, match="file is a file; choose another folder"),
            output_folder(folder),
        ):
            pytest.fail("work was begun")
    assert content(tmp_path) == {"file": b"mine"}


def test_a_folder_in_a_files_place_is_named_before_any_work(tmp_path):
    (tmp_path / "aspect.tif").mkdir()
    with pytest.raises(OutputError, match=r"aspect\.tif is a folder"), output_folder(tmp_path):
        pytest.fail("work was begun")


def test_what_a_dead_run_left_is_removed_and_a_living_ones_kept(tmp_path):
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)  # from here on, a number that was a process
    dead = tmp_path / f"{report._PREFIX}{child}-abc"
    living = tmp_path / f"{report._PREFIX}{os.getppid()}-abc"
    elsewhere = tmp_path / f".gpuspec-another machine-{child}-abc"
    for folder in (dead, living, elsewhere):
        folder.mkdir()
        (folder / "aspect.tif").write_text("half", encoding="utf-8")
    with output_folder(tmp_path / "run"):
        pass
    assert not dead.exists()
    assert living.exists()
    assert elsewhere.exists()
