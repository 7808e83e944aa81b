"""`gpuspec sweep`: what it prints, notes and refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from commandline import Command, content, said
from sweeping import rows, spoilt

from gpuspec.errors import StationError
from gpuspec.station.station import Station
from gpuspec.sweeps import sweep as running
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.notes import of_plan, of_table
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.parts import Parts


def test_sweep_prints_its_plan_and_what_to_do_next(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--vary",
                   "sensor.exposure=-1:4:6", "--vary", "tunnel.height_mm=100,150")  # fmt: skip
    assert ran.code == 0, ran.err
    for words in ("48 designs at 256 thresholds", "2 light maps", "exact", "time about",
                  "memory", "MiB", "16 designs are no valid station, e.g.: s.toml: sensor.exposure",
                  "gpuspec front sweep"):  # fmt: skip
        assert words in ran.out
    assert Path("sweep/sweep.json").exists()


@pytest.mark.parametrize(
    ("change", "way"),
    [("part.orange_peel={wavelength_mm=2, slope_rad=0.001}", "every pixel is counted"),
     ("part.pose.tilt_y_deg=1", "every pixel is counted"), ("camera.pupil_mm=1", "screening, ")],
)  # fmt: skip
def test_the_plan_says_where_screening_spares_nothing(gpuspec_: Command, change, way):
    vary = "sensor.exposure=2,4"
    ran = gpuspec_("sweep", "s.toml", "--screen", "--plan", "--set", change, "--vary", vary)
    assert ran.code == 0, ran.err
    assert way in ran.out


def test_notes_are_in_the_table_where_they_are_true_and_nowhere_else(station, opencl, tmp_path):
    grid = {"tunnel.length_mm": [10.0, 400.0], "sensor.exposure": [1.0, 4.0],
            "sequence.step_mm": [0.2, 8.0]}  # fmt: skip
    for row in rows(sweep(Plan.of(station, grid), tmp_path / "run", backend=opencl)):
        notes = row["notes"] or ""
        assert ("of the part sees no light" in notes) == (row["tunnel.length_mm"] == 10)
        assert ("does not saturate" in notes) == (row["sensor.exposure"] == 1)
        assert ("all 40 images are the same" in notes) == (row["sequence.step_mm"] == 8)
        assert (row["notes"] is None) == (notes == "")


def test_what_is_said_of_every_design_already_is_told_again_only_of_some(station, opencl, tmp_path):
    grid = {"sensor.exposure": [0.8, 1.0, 4.0]}
    run = sweep(Plan.of(station, grid), tmp_path / "some", backend=opencl)
    told = of_table(run)
    assert len(told) == 2  # of two exposures, a note each
    line = told[0].partition(": ")[2]
    assert of_table(run, [line]) == told
    same = sweep(Plan.of(station, {"sensor.exposure": [0.8]}), tmp_path / "all", backend=opencl)
    (one,) = of_table(same)
    assert of_table(same, [one.partition(": ")[2]]) == []


def test_a_geometry_beyond_the_memory_is_refused_in_a_sentence(station, opencl, monkeypatch):
    monkeypatch.setattr("gpuspec.simulation.memory.free_bytes", lambda: 1000)
    with pytest.raises(StationError, match=r"of memory while"):
        Parts(opencl, 1, 0).levels([station], sampled=False)


def test_sweep_and_front_tell_what_is_wrong_with_designs(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.radius_mm=60,90", "--vary",
                   "tunnel.length_mm=6:200:4", "--set", "sensor.exposure=0.5")  # fmt: skip
    assert ran.code == 0, ran.err
    for words in (
        "note: tunnel.radius_mm is varied and has no effect with tunnel.section",
        "note: sensor.exposure = 0.5 does not saturate the sensor",
        "assumed: the camera looks through the tunnel's top",
    ):
        assert ran.out.count(words) == 1
    lost = re.findall(r"note: 2 of 8 designs: 5\d\.\d % of the part sees no light", ran.out)
    assert len(lost) == 1
    ran = gpuspec_("front", "sweep", "--no-pictures", "--p2-floor", "0")
    assert "note: sensor.exposure = 0.5 does not saturate the sensor" in ran.out
    chosen = json.loads(Path("sweep/front/chosen.json").read_text("utf-8"))
    assert any("does not saturate" in note for note in chosen["notes"])


def test_what_is_said_of_every_design_is_true_of_every_design(station):
    # A stride through the grid would meet the first exposure and the first number of images alone.
    wide = {"tunnel.luminous_mm": "0.5:8:16", "tunnel.dark_mm": "2:24:12",
            "sensor.exposure": "1:8:8", "sequence.images": "8:80:10"}  # fmt: skip
    assert of_plan(Plan.of(station, wide)) == []
    (said,) = of_plan(Plan.of(station.replace(sensor__exposure=0.5), {
        key: values for key, values in wide.items() if key != "sensor.exposure"}))  # fmt: skip
    assert "does not saturate" in said


def test_a_sound_sweep_has_no_notes(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4")
    assert "note: " not in ran.out
    assert gpuspec_("front", "sweep", "--no-pictures", "--p2-floor", "0").code == 0
    assert json.loads(Path("sweep/front/chosen.json").read_text("utf-8"))["notes"] == []


def test_the_plan_alone_writes_nothing(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--plan")
    assert ran.code == 0
    assert "4 designs" in ran.out
    assert not Path("sweep").exists()


def test_a_plan_needs_no_empty_folder(gpuspec_: Command):
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("mine", encoding="utf-8")
    Path("spoilt").mkdir()
    Path("spoilt/sweep.json").write_text("{", encoding="utf-8")
    before = content(Path())
    for place in ("mine", "spoilt", "s.toml", "mine/notes.txt"):
        ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--plan", "-o",
                       place)  # fmt: skip
        assert (ran.code, ran.err) == (0, "")
        assert "4 designs" in ran.out
    assert content(Path()) == before


def test_a_plan_tells_what_the_disk_cannot_hold(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--plan", "--vary", "tunnel.dark_mm=1:2:100000", "--vary",
                   "tunnel.luminous_mm=1:2:100000")  # fmt: skip
    assert ran.code == 0
    assert "note: 10,000,000,000 designs need about" in ran.out


@pytest.mark.slow
def test_the_command_says_which_files_it_sweeps_again(gpuspec_: Command):
    command = "sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4"
    assert gpuspec_(*command).code == 0
    file = Path("sweep/designs/part-00000000.parquet")
    whole = file.read_bytes()
    file.write_bytes(spoilt(whole, "middle"))
    for more, word in (("--plan",), "4 designs"), ((), "designs/s"):
        ran = gpuspec_(*command, *more)
        assert ran.code == 0
        assert "note: damaged since they were written: part-00000000.parquet;" in ran.out
        assert word in ran.out
    assert file.read_bytes() == whole
    assert "damaged" not in gpuspec_(*command).out


def test_a_threshold_of_the_stations_own_is_left_out_and_told(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--plan", "--set",
                   "segmentation.min_area_mm2=0.1")  # fmt: skip
    assert "threshold and size filter are left out" in ran.out


def test_another_sweeps_folder_is_refused_before_the_plan(gpuspec_: Command):
    assert gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4").code == 0
    told = said(gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:3"))
    assert "tunnel.luminous_mm is 1, 2, 3, 4 there and 1, 2.5, 4 here" in told


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--vary", "tunnel.luminous_mm"], "write KEY=FROM:TO:COUNT"),
        (["--vary", "tunnel.lumi=1:2:3"], "did you mean luminous_mm?"),
        (["--vary", "part.surface=1,2"], "is not a number"),
        (["--vary", "sensor.seed=1,2"], "another seed is another part or other noise, not another"),
        (["--vary", "populations[1].seed=1:9:9"], "--parts tries every design on several parts"),
        ([], "nothing to vary; give --vary"),
        (["--vary", "tunnel.dark_mm=9:1:3"], "is reversed"),
        (["--vary", "tunnel.dark_mm=1:3:2", "--vary", "tunnel.dark_mm=5"], "stands twice"),
        (["--vary", "sensor.exposure=-1,0"], "no design of the sweep is a valid station"),
        (["--vary", "tunnel.dark_mm=1:9:3", "--parts", "2"], "has no random [[populations]]"),
        (["--vary", "tunnel.dark_mm=1:2:100000", "--vary", "tunnel.luminous_mm=1:2:100000"],
         "GB on disk"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence_before_work_starts(gpuspec_: Command, options, words):
    assert words in said(gpuspec_("sweep", "s.toml", *options))
    assert not Path("sweep").exists()


def test_a_missing_package_is_named_with_its_extra(gpuspec_: Command, monkeypatch):
    import sys

    for name in [n for n in sys.modules if n.split(".")[0] == "pyarrow"]:
        monkeypatch.delitem(sys.modules, name)
    for name in [n for n in sys.modules if n.startswith("gpuspec.sweeps.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    text = said(gpuspec_("sweep", "s.toml", "--vary", "tunnel.dark_mm=1:9:3"))
    assert 'pip install "gpuspec[sweep]"' in text


def test_the_same_sweep_in_python_as_on_the_command_line(gpuspec_: Command, opencl):
    gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "-o", "a")
    plan = Plan.of(Station.read("s.toml"), {"tunnel.luminous_mm": "1:4:4"})
    run = running.sweep(plan, "b", backend=opencl)
    assert run.table().equals(RunFolder.read("a").table())
