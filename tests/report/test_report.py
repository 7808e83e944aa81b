"""What a run leaves behind: every number again, whole or not at all."""

from __future__ import annotations

import csv
import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from commandline import names
from maps import polished, write_sur
from PIL import Image
from tolerances import FOUR_DIGITS, NINE_DIGITS, PLACES

import gpuspec
from gpuspec import files
from gpuspec.errors import OutputError
from gpuspec.files import MANIFEST, Outputs, digest, folder_of
from gpuspec.light.constants import AT_LOSS
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.refinement import CREASED, SLICES
from gpuspec.part.crossings import CREASE, GROOVE, crossings
from gpuspec.part.relief import Relief
from gpuspec.pictures import all as figures
from gpuspec.report import folder as report
from gpuspec.report.folder import FILES, summary, write
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import simulate
from gpuspec.station.station import Station
from gpuspec.station.toml import keep, to_toml

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
    "aspect.tif", "labels.tif", "truth.tif", "lost.tif", "blobs.csv", "defects.csv",
    "score.json", "station.toml",
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
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def hidden(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.name.startswith(".gpuspec-")]


def outputs(folder: Path) -> Outputs:
    return Outputs(folder, "run", FILES)


def test_every_promised_file_is_written_and_no_other(written):
    assert names(written) == set(FILES)
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
            assert float(given) == pytest.approx(value, rel=NINE_DIGITS)


def test_the_table_of_defects_is_that_of_the_score(result, written):
    rows = table(written / "defects.csv")
    assert [row["defect"] for row in rows] == ["1", "2", "3"]
    assert [row["kind"] for row in rows] == ["dent", "scratch", "bump"]
    for number, (row, defect) in enumerate(zip(rows, result.defects, strict=True), 1):
        for key in ("x_mm", "y_mm", "size_mm", "length_mm", "depth_um"):
            assert float(row[key]) == pytest.approx(
                getattr(defect, key), rel=FOUR_DIGITS, abs=PLACES
            )
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
    refined = result.light_map.traced.sides_needed().ravel().astype(int)
    finest = np.flatnonzero(refined == 8)
    refined[refined == AT_LOSS] = 8
    relief = Relief.of(result.station)
    across = crossings(result.station, relief, finest)
    refined[finest[across == GROOVE]] = -SLICES
    refined[finest[across == CREASE]] = CREASED
    rays = np.where(refined < 0, -refined, refined**2)
    assert score["refined"] == {
        "pixels": (refined != 1).sum(),
        "sub_rays": rays[refined != 1].sum(),
        **{str(side): (refined == side).sum() for side in (2, 4, 8, 16)},
        "slices": (refined < 0).sum(),
    }
    assert score["refined"]["pixels"] > 0
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


@pytest.mark.slow
def test_a_moved_run_runs_again_without_what_it_was_made_from(tmp_path, monkeypatch):
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
    home.rename(tmp_path / "gone")
    (tmp_path / "run").rename(tmp_path / "moved")
    again = Station.read(tmp_path / "moved" / "station.toml")
    assert np.array_equal(simulate(again, NumpyBackend()).aspect, found.aspect)


def test_files_of_one_name_are_kept_apart_and_a_lost_one_by_its_path(tmp_path):
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "pit.sur").write_text(place, encoding="utf-8")
    table = {"kind": "measured", "x_mm": 0.0, "y_mm": 0.0}
    files = ["a/pit.sur", "b/pit.sur", "c/pit.sur"]
    station = Station.from_dict(
        {"defects": [{**table, "file": file} for file in files]}, folder=tmp_path
    )
    (tmp_path / "run").mkdir()
    keep(station, tmp_path / "run" / "s.toml")
    kept = Station.read(tmp_path / "run" / "s.toml")
    places = [kept.locate(defect.file) for defect in kept.defects]
    assert [path.read_text("utf-8") for path in places[:2]] == ["a", "b"]
    assert places[2] == tmp_path / "c" / "pit.sur"


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


@pytest.mark.slow
def test_a_folder_never_mixes_two_runs(result, tmp_path):
    write(result, tmp_path, frames=True)
    write(result, tmp_path, frames=False, pictures=False)
    assert names(tmp_path) == TABLES


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
        monkeypatch.setitem(
            figures.PICTURES, picture, lambda _: lambda path: path.write_text("drawn")
        )
    monkeypatch.setitem(figures.PICTURES, name, failure)
    folder = tmp_path / "deep" / "run"
    if existing:
        write(result, folder, frames=True, pictures=False)
        (folder / "notes.txt").write_text("mine", encoding="utf-8")
        before = content(folder)
    with pytest.raises(error):
        write(replace(result, warnings=("another run",)), folder)
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


def test_a_picture_that_cannot_be_written_is_said_too(result, tmp_path, monkeypatch):
    """It is compressed and written beside the drawing, in another thread."""
    monkeypatch.setitem(figures.PICTURES, "station.png", lambda _: full_disk)
    with pytest.raises(OutputError, match="No space left on device"):
        write(result, tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert not hidden(tmp_path)


def test_a_short_write_of_numpy_is_said_as_a_full_disk(tmp_path):
    with (
        pytest.raises(OutputError, match=r"the disk may be full \(9 requested and 2 written\)"),
        outputs(tmp_path / "run").writing(),
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
    assert names(tmp_path) == TABLES
    assert np.array_equal(tifffile.imread(tmp_path / "aspect.tif"), other.aspect)
    assert Station.read(tmp_path / "station.toml").sensor == other.station.sensor
    assert json.loads((tmp_path / "score.json").read_text("utf-8"))["backend"] == "numpy"


def test_a_file_in_the_way_is_named_before_any_work(tmp_path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with (
            pytest.raises(OutputError, match="file is a file; choose another folder"),
            outputs(folder).writing(),
        ):
            pytest.fail("work was begun")
    assert content(tmp_path) == {"file": b"mine"}


@pytest.mark.parametrize("name", ["aspect.tif", MANIFEST])
def test_a_folder_in_a_files_place_is_named_before_any_work(tmp_path, name):
    (tmp_path / name).mkdir()
    for force in (False, True):
        forced = replace(outputs(tmp_path), force=force)
        with pytest.raises(OutputError, match=f"{name} is a folder"), forced.writing():
            pytest.fail("work was begun")


def test_what_a_dead_run_left_is_removed_and_a_living_ones_kept(tmp_path):
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)  # from here on, a number that was a process
    dead = tmp_path / f"{files._PREFIX}{child}-abc"
    living = tmp_path / f"{files._PREFIX}{os.getppid()}-abc"
    elsewhere = tmp_path / f".gpuspec-another machine-{child}-abc"
    for folder in (dead, living, elsewhere):
        folder.mkdir()
        (folder / "aspect.tif").write_text("half", encoding="utf-8")
    with outputs(tmp_path / "run").writing():
        pass
    assert not dead.exists()
    assert living.exists()
    assert elsewhere.exists()


# -------------------------------------------------------------------- nothing of the user's is lost


def mine(folder: Path, *names: str) -> dict[str, bytes]:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_text(f"my {name}", encoding="utf-8")
    return content(folder)


@pytest.mark.parametrize("name", ["station.toml", "histogram.png", "frames.tif"])
def test_a_file_that_no_run_wrote_is_named_before_any_work_and_kept(result, tmp_path, name):
    before = mine(tmp_path / "run", name, "notes.txt")
    with (
        pytest.raises(
            OutputError,
            match=f"{name} is in the way: it is not known to be .*or --force",
        ),
        outputs(tmp_path / "run").writing(),
    ):
        pytest.fail("work was begun")
    with pytest.raises(OutputError, match=name):
        write(result, tmp_path / "run", pictures=False)
    assert content(tmp_path / "run") == before


def test_force_replaces_what_is_in_the_way_and_deletes_nothing(result, tmp_path):
    mine(tmp_path, "station.toml", "histogram.png", "frames.tif")
    write(result, tmp_path, pictures=False, force=True)
    assert names(tmp_path) == TABLES | {"histogram.png", "frames.tif"}
    assert (tmp_path / "frames.tif").read_text("utf-8") == "my frames.tif"
    assert Station.read(tmp_path / "station.toml").as_dict() == result.station.as_dict()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["station.toml", "aspect.png"])
def test_what_was_changed_since_the_run_is_the_users(result, tmp_path, name):
    write(result, tmp_path)
    with (tmp_path / name).open("ab") as file:
        file.write(b"\n")
    before = content(tmp_path)
    with pytest.raises(OutputError, match=f"{name} is in the way: it was changed"):
        write(result, tmp_path, pictures=False)
    assert content(tmp_path) == before
    write(result, tmp_path, pictures=False, force=True)
    assert names(tmp_path) == TABLES | ({name} - TABLES)


def test_a_large_file_is_known_by_its_size_and_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_LARGE", 100)
    monkeypatch.setattr(files, "_END", 10)
    seen = set()
    for data in (b"a" * 200, b"a" * 201, b"b" + b"a" * 199, b"a" * 199 + b"b", b"a" * 100):
        (tmp_path / "frames.tif").write_bytes(data)
        seen.add(digest(tmp_path / "frames.tif"))
    assert len(seen) == 5


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("way", ["plain", "dots", "link", "linked folder", "hard link"])
def test_an_output_never_replaces_an_input(result, tmp_path, way, force):
    home = tmp_path / "home"
    home.mkdir()
    file = home / "station.toml"
    file.write_text(to_toml(result.station), encoding="utf-8")
    target = {"dots": home / ".." / "home", "linked folder": tmp_path / "link"}.get(way, home)
    if way == "linked folder":
        target.symlink_to(home)
    elif way in ("link", "hard link"):
        target = tmp_path / "run"
        target.mkdir()
        if way == "link":
            (target / "station.toml").symlink_to(file)
        else:
            (target / "station.toml").hardlink_to(file)
    before = file.read_bytes()
    found = replace(result, station=Station.read(file))
    said = "is read here" if force or way == "plain" else "is read here|not written by gpuspec"
    with pytest.raises(OutputError, match=said):
        write(found, target, pictures=False, force=force)
    assert file.read_bytes() == before
    assert [path.name for path in home.iterdir()] == ["station.toml"]


def test_a_topography_beside_its_results_is_never_replaced(tmp_path):
    (tmp_path / "aspect.tif").write_bytes(b"measured")
    patch = {"kind": "measured", "file": "aspect.tif", "x_mm": 0.0, "y_mm": 0.0}
    station = Station.from_dict({"defects": [patch]}, folder=tmp_path)
    for force in (False, True):
        with pytest.raises(OutputError, match=r"aspect\.tif is read here"):
            report.outputs(station, tmp_path, force=force).check()


def test_what_an_earlier_run_kept_is_not_removed_while_it_is_read(tmp_path):
    with Outputs(tmp_path, "run", ("a.csv", "pit.sur")).writing() as partial:
        mine(partial, "a.csv", "pit.sur")
    for force in (False, True):
        again = Outputs(tmp_path, "run", ("a.csv",), (tmp_path / "pit.sur",), force=force)
        with pytest.raises(OutputError, match=r"pit\.sur is read here"), again.writing():
            pytest.fail("work was begun")


def test_a_file_that_comes_while_the_work_is_done_costs_neither_it_nor_the_results(tmp_path):
    for number in (2, 3):
        with (
            pytest.raises(OutputError, match=f"the results are in .*run-{number}"),
            outputs(tmp_path / "run").writing() as partial,
        ):
            mine(tmp_path / "run", "aspect.tif")
            (partial / "aspect.tif").write_text("hours", encoding="utf-8")
            mine(tmp_path / "run", "aspect.tif")
        assert (tmp_path / f"run-{number}" / "aspect.tif").read_text("utf-8") == "hours"
        assert content(tmp_path / "run") == {"aspect.tif": b"my aspect.tif"}
        (tmp_path / "run" / "aspect.tif").unlink()
    assert not hidden(tmp_path)


WRITES = """
import os, sys
from pathlib import Path
from gpuspec import files
from gpuspec.files import Outputs

names, word, moves = sys.argv[1].split(), sys.argv[2], int(sys.argv[3])
replace, moved = Path.replace, []

def killed(path, target):
    moved.append(path)
    if len(moved) == moves:
        os._exit(9)
    return replace(path, target)

Path.replace = killed
folder = Path("run")
for _ in range(1 if moves else 30):
    with Outputs(folder, "run", tuple(names)).writing() as partial:
        for name in names:
            (partial / name).write_text(word)
    with files._alone(folder):
        assert len({(folder / name).read_text() for name in names}) == 1
"""


@pytest.mark.parametrize("name", ["../mine.txt", "one/two/mine.txt", "one/../../mine.txt"])
def test_a_manifest_that_names_files_elsewhere_removes_none(tmp_path, name):
    """Only what lies in the folder, or in one of its own, can be an earlier run's."""
    folder = tmp_path / "run"
    (folder / "one" / "two").mkdir(parents=True)
    mine_ = folder / name
    mine_.write_text("mine", encoding="utf-8")
    entry = {"of": {}, "files": {name: [files.digest(mine_)], "old.txt": []}}
    (folder / MANIFEST).write_text(json.dumps({"run": entry}), encoding="utf-8")
    with Outputs(folder, "run", ("new.txt",)).writing() as partial:
        (partial / "new.txt").write_text("new", encoding="utf-8")
    assert mine_.read_text(encoding="utf-8") == "mine"
    assert (folder / "new.txt").exists()


def process(folder: Path, *arguments: object) -> subprocess.Popen[bytes]:
    """Another process that writes such files, and kills itself before it moves the n-th."""
    command = [sys.executable, "-c", WRITES, *map(str, arguments)]
    return subprocess.Popen(command, cwd=folder)


@pytest.mark.slow
@pytest.mark.parametrize("moves", range(1, 7))
def test_a_run_killed_while_its_files_move_is_known_to_the_next(tmp_path, moves):
    assert process(tmp_path, "a b c d", "old", 0).wait(60) == 0
    assert process(tmp_path, "b c d e", "new", moves).wait(60) == 9
    assert process(tmp_path, "b c d e", "last", 0).wait(60) == 0
    assert names(tmp_path / "run") == set("bcde")
    assert not hidden(tmp_path)


@pytest.mark.slow
def test_two_runs_that_end_at_once_are_not_mixed(tmp_path):
    both = [process(tmp_path, " ".join(FILES), word, 0) for word in "ab"]
    assert [one.wait(60) for one in both] == [0, 0]


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"run": 3}', '{"run": {"of": {}, "files": {"station.toml": 3}}}', "\x00"],
)
def test_a_spoilt_manifest_tells_nothing(result, tmp_path, text):
    before = mine(tmp_path, "station.toml")
    (tmp_path / MANIFEST).write_text(text, encoding="utf-8")
    with pytest.raises(OutputError, match="is in the way"):
        write(result, tmp_path, pictures=False)
    assert content(tmp_path).items() >= before.items()


@pytest.mark.parametrize("name", ["../mine", "/mine", "a/b/mine", "a/../mine", ""])
def test_a_manifest_reaches_no_file_beyond_its_folder(result, tmp_path, name):
    mine(tmp_path, "mine")
    (tmp_path / "run").mkdir()
    known = {name: [digest(tmp_path / "mine")]}
    (tmp_path / "run" / MANIFEST).write_text(
        json.dumps({"run": {"of": {}, "files": known}}), encoding="utf-8"
    )
    write(result, tmp_path / "run", pictures=False)
    assert (tmp_path / "mine").exists()


def test_only_another_of_its_kind_is_replaced(tmp_path):
    def written(kind: str, rule: str, **options: bool) -> None:
        with Outputs(tmp_path, kind, ("a.csv",), of={"rule": rule}, **options).writing() as partial:
            (partial / "a.csv").write_text(kind + rule, encoding="utf-8")

    written("front", "one")
    written("front", "one")
    with pytest.raises(OutputError, match="holds a front of another rule: one there and two here"):
        written("front", "two")
    with pytest.raises(OutputError, match=r"a\.csv is in the way: it belongs to a front"):
        written("search", "one")
    written("front", "two", force=True)
    written("search", "one", force=True)
    assert (tmp_path / "a.csv").read_text("utf-8") == "searchone"
    with pytest.raises(OutputError, match="belongs to a search"):
        written("front", "two")


def test_a_folder_without_a_name_is_refused(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OutputError, match=r"has no name; write -o \. for the current folder"):
        write(result, "")
    assert not list(tmp_path.iterdir())


def test_images_beyond_the_disk_are_refused_before_any_work(tmp_path):
    station = Station.from_dict(STATION).replace(sequence__images=10**5, camera__sampling_mm=1e-3)
    report.outputs(station, tmp_path / "run").check()
    with pytest.raises(OutputError, match=r"100,000 images of 12,000 x 6,000 pixels need about"):
        report.outputs(station, tmp_path / "run", frames=True).check()


@pytest.mark.parametrize("name", ["a" * 300, "/proc/foo"])
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(tmp_path, name):
    with pytest.raises(OutputError, match="cannot be written to") as refused:
        Outputs(tmp_path / name, "run", ("score.json",)).check()
    assert "space" not in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_blank_name_of_a_folder_is_refused():
    with pytest.raises(OutputError, match="has no name"):
        folder_of("   ")


@pytest.mark.parametrize("name", ["sweep.json", "optimise.json"])
def test_a_run_is_not_written_into_the_folder_of_a_sweep_or_search(tmp_path, name):
    (tmp_path / name).touch()
    with pytest.raises(OutputError, match="not of a run; choose another folder"):
        report.outputs(Station.from_dict({}), tmp_path)
