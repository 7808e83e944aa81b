"""The command line: what it writes, what it says, and what it leaves when it is stopped."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import tifffile
from commandline import (
    DEADLINE_S,
    PROGRAM,
    STATION,
    Command,
    Ran,
    content,
    earlier_run,
    hidden,
    names,
    program,
    said,
)

import gpuspec
from gpuspec import files
from gpuspec.cli import main as cli
from gpuspec.cli.options import changed
from gpuspec.light import opencl, opencl_device, sources
from gpuspec.light.devices import BACKENDS, open_backend
from gpuspec.report.folder import FILES
from gpuspec.simulation import memory
from gpuspec.simulation import simulate as inspection
from gpuspec.station.examples import example, examples
from gpuspec.station.station import Station
from gpuspec.words import BEST, SCORES

COMMANDS = (
    "simulate",
    "demo",
    "inspect",
    "fit",
    "camera",
    "prototype",
    "sweep",
    "front",
    "optimise",
    "pod",
    "dataset",
    "init",
    "schema",
    "reference",
    "devices",
)
GROUPS = ("study",)


# ------------------------------------------------------------------------------------- commands


def test_simulate_writes_every_file_and_says_how_well_it_did(folder):
    ran = program("simulate", "s.toml", "--frames", cwd=folder)
    assert (ran.code, ran.err) == (0, "")
    assert names(folder / "run") == set(FILES)
    assert {path.name for path in folder.iterdir()} == {"s.toml", "run"}
    for words in (
        "s.toml: 120 x 60 pixels",
        *SCORES.values(),
        BEST,
        "1 of 1",
        "opencl on",
        "results in run",
    ):
        assert words in ran.out


def test_the_program_and_the_module_are_one_command(folder):
    script = Path(sys.executable).with_name("gpuspec")
    shown = subprocess.run(
        [script, "--version"], capture_output=True, text=True, check=True, timeout=DEADLINE_S
    )
    assert (
        shown.stdout == program("--version", cwd=folder).out == f"gpuspec {gpuspec.__version__}\n"
    )


def test_demo_simulates_an_example(gpuspec_):
    ran = gpuspec_("demo", "--set", "camera.sampling_mm=0.5", "--no-pictures", "-o", "out")
    assert ran.code == 0
    assert "trim.toml: 400 x 100 pixels" in ran.out
    assert {Path(name).suffix for name in names(Path("out"))} == {".tif", ".csv", ".json", ".toml"}


def test_help_lists_every_command(gpuspec_):
    ran = gpuspec_("--help")
    assert ran.code == 0
    for command in COMMANDS:
        assert command in ran.out
        shown = gpuspec_(command, "--help")
        assert shown.code == 0
        assert "Usage:" in shown.out
        assert f" {command} " in shown.out
    assert set(COMMANDS) == {command.callback.__name__ for command in cli.app.registered_commands}
    groups = {group.name for group in cli.app.registered_groups}
    assert groups == set(GROUPS)
    assert all(group in ran.out for group in groups)


@pytest.mark.parametrize("command", [*COMMANDS, "study tolerance"])
def test_help_shows_its_words_as_they_are(gpuspec_, command):
    """Brackets are no markup in it: `[sweep]` is a table of the station file."""
    ran = gpuspec_(*command.split(), "-h")
    assert ran.out == gpuspec_(*command.split(), "--help").out
    assert not {"╭", "│"} & set(ran.out)
    if command in ("sweep", "optimise"):
        assert "[sweep]" in ran.out


@pytest.mark.parametrize("group", ["", "study"])
def test_no_line_of_the_commands_is_cut_off_at_80_columns(gpuspec_, group, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = gpuspec_(*group.split(), "-h").out
    assert "..." not in shown.partition("Commands:")[2]
    assert all(len(line) <= 80 for line in shown.splitlines())


SLOW = [
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.special",
    "skimage",
    "matplotlib",
    "PIL",
    "pyarrow",
]
"""Libraries, or parts of them, that a tenth of a second or more goes into."""


@pytest.mark.parametrize(
    ("work", "unused"),
    [
        ("import gpuspec.cli.main", ["numpy", "scipy", "pyopencl", "tifffile", "pydantic", *SLOW]),
        ("import gpuspec; gpuspec.simulate('s.toml')", SLOW),
    ],
    ids=["help", "simulate"],
)
def test_nothing_is_imported_that_is_not_used(folder, work, unused):
    code = f"import sys; {work}; print([name for name in {unused} if name in sys.modules])"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=folder,
        timeout=DEADLINE_S,
    )  # fmt: skip
    assert shown.stdout == "[]\n"


def test_the_schema_is_json_that_knows_every_section(gpuspec_):
    schema = json.loads(gpuspec_("schema").out)
    assert set(schema["properties"]) == set(Station.model_fields)
    assert "sampling_mm" in json.dumps(schema)


def piped(arguments: str, where: str, folder: Path) -> Ran:
    """The command in a shell, its standard output led somewhere."""
    done = subprocess.run(
        f"{shlex.join([*PROGRAM, *arguments.split()])} {where}",
        shell=True, capture_output=True, text=True, cwd=folder, timeout=DEADLINE_S,
    )  # fmt: skip
    return Ran(done.returncode, done.stdout, done.stderr)


def test_a_reader_that_stops_listening_is_no_error(folder):
    done = piped("schema", "| head -n 1", folder)
    assert done.out == "{\n"
    assert "Traceback" not in done.err


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    ["--help", "--version", "schema", "devices", "simulate --help", "study --help", "init new",
     "simulate s.toml --no-pictures --backend numpy", "study height s.toml",
     "sweep s.toml --vary tunnel.dark_mm=1:4:4 --backend numpy"],
)  # fmt: skip
def test_standard_output_that_is_full_is_said(folder, arguments):
    done = piped(arguments, "> /dev/full", folder)
    assert done.code == 1
    assert done.err.startswith("error: standard output cannot be written: No space left")
    assert done.err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ["--help", "devices", "study height s.toml"])
def test_a_reader_that_never_listened_is_no_error(folder, arguments):
    done = piped(arguments, "| exec 0<&-", folder)
    assert (done.out, done.err) == ("", "")


def test_devices_lists_all_and_what_auto_takes(gpuspec_):
    ran = gpuspec_("devices")
    assert ran.code == 0
    lines = {name: [r for r in ran.out.splitlines() if name in r] for name in BACKENDS}
    assert "0: " in lines["opencl"][0]
    assert "chosen by auto" in lines["opencl"][0]
    assert "0: cpu" in lines["numpy"][0]
    assert "chosen" not in lines["numpy"][0]


def test_init_writes_a_file_that_simulate_takes(gpuspec_):
    ran = gpuspec_("init", "new")
    assert ran.code == 0
    assert "gpuspec simulate new.toml" in ran.out
    text = Path("new.toml").read_text("utf-8")
    assert "sampling_mm" in text
    assert "distance of two pixels" in text  # each key explained
    again = gpuspec_("simulate", "new.toml", "--set", "camera.sampling_mm=0.5", "--no-pictures")
    assert again.code == 0
    assert BEST in json.loads(Path("run/score.json").read_text("utf-8"))["score_legend"]


def test_init_replaces_a_file_only_when_told(gpuspec_):
    Path("mine.toml").write_text("mine", encoding="utf-8")
    assert said(gpuspec_("init", "mine.toml")) == (
        "mine.toml exists already; choose another name, or --force to replace it."
    )
    assert Path("mine.toml").read_text("utf-8") == "mine"
    assert gpuspec_("init", "mine.toml", "--force").code == 0
    assert "[part]" in Path("mine.toml").read_text("utf-8")
    assert not hidden(Path())


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("/", "is a folder"),
        (".", "is a folder"),
        ("..", "is a folder"),
        ("folder.toml", "is a folder"),
        ("s.toml/new.toml", "Not a directory"),
        ("none/new.toml", "No such file or directory"),
        ("/proc/new.toml", "No such file or directory"),
        ("x" * 300 + ".toml", "File name too long"),
    ],
)
def test_init_says_where_it_cannot_write(gpuspec_, path, why):
    Path("folder.toml").mkdir()
    before = set(Path().iterdir())
    assert why in said(gpuspec_("init", path))
    assert set(Path().iterdir()) == before


def test_set_changes_a_key(gpuspec_):
    ran = gpuspec_(
        "simulate", "s.toml", "--no-pictures", "--set", "sequence.images=7",
        "--set", "sensor.bit_depth = 12", "--set", "part.material=gold",
        "--set", "segmentation.threshold=auto", "--set", "defects=[]", "--frames",
    )  # fmt: skip
    assert ran.code == 0
    station = Station.read("run/station.toml")
    assert station.sequence.images == 7
    assert station.sensor.bit_depth == 12
    assert station.part.material == "gold"
    assert station.defects == ()
    with tifffile.TiffFile("run/frames.tif") as file:
        assert len(file.pages) == 7


def test_a_table_set_merges_into_its_section_and_none_unsets_a_key(gpuspec_):
    Path("s.toml").write_text(STATION + "[tunnel]\nluminous_mm = 3\ndark_mm = 5\n", "utf-8")
    ran = gpuspec_(
        "simulate", "s.toml", "--no-pictures", "--set", "tunnel={height_mm=120}",
        "--set", "tunnel.dark_mm=none", "--set", "camera.vignetting=none",
        "--set", 'defects[1]={kind="bump"}',
    )  # fmt: skip
    assert ran.code == 0
    station = Station.read("run/station.toml")
    assert (station.tunnel.height_mm, station.tunnel.luminous_mm) == (120, 3)
    assert station.tunnel.dark_mm == Station().tunnel.dark_mm
    assert station.defects[0].kind == "bump"


def test_none_is_a_choice_of_some_keys_and_unsets_the_others():
    station = example("measured")
    assert changed(station, ["part.relief.form_removed=none"]).part.relief.form_removed == "none"
    assert changed(station, ["part.relief.zone_height_um=none"]).part.relief.zone_height_um is None
    assert changed(station, ["part.relief=none"]).part.relief is None
    assert changed(station, ["part.length_mm=1"]).part.length_mm == 1
    assert changed(station, ['part.relief={form_removed="plane"}']).part.relief.file == "polished"


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("sequence.images=" + "9" * 5000, "--set sequence.images: the number is too long."),
        ("tunnel.dark_mm=", "KEY=none unsets a key"),
        ("a" * 5000, "..: write it as KEY=VALUE"),
        ("sensor.exposure=1e999", "must be a finite number"),
        ("part.relief=" + "{a=" * 90 + "1" + "}" * 90, "part.relief.a is not a known key"),
        ("part.relief=" + "{a=" * 900 + "1" + "}" * 900, "nested too deeply"),
        ("tunnel.dark_mm=3\nx=4", "must be a number"),
        ("defects[1]=none", "cannot be unset alone"),
        ("defects[1].depth_um=none", "depth_um is missing"),
        ("defects[2]={depth_um=5}", "no such entry; there is 1, numbered from 1"),
        ("populations[1].count=5", "no such entry; there is none"),
        ("part.material=\udcff", "must be text that can be written as UTF-8"),
    ],
)
def test_a_change_that_cannot_be_made_is_answered_in_a_sentence(gpuspec_, change, why):
    told = said(gpuspec_("simulate", "s.toml", "--set", change))
    assert why in told
    assert len(told) < 400


def test_a_key_is_set_once(gpuspec_):
    told = said(gpuspec_("demo", "--set", "tunnel.dark_mm=3", "--set", "tunnel.dark_mm = 4"))
    assert told == "--set tunnel.dark_mm stands twice; set each key once."


def test_the_help_names_every_example(gpuspec_):
    for command in ("demo", "init"):
        shown = gpuspec_(command, "--help").out
        assert all(name in shown for name in examples())


@pytest.mark.parametrize("name", examples())
def test_every_example_runs_as_it_is_and_as_init_writes_it(gpuspec_, name):
    small = ["--no-pictures"] + ["--set", "camera.sampling_mm=0.5"] * (name == "trim")
    ran = gpuspec_("demo", name, *small)
    assert ran.code == 0
    assert gpuspec_("init", "mine.toml", "--example", name).code == 0
    assert gpuspec_("simulate", "mine.toml", "-o", "again", *small).code == 0
    files = [Path(folder) / "score.json" for folder in ("demo", "again")]
    p2 = [json.loads(file.read_text("utf-8"))["score"]["p2"] for file in files]
    assert p2[0] == p2[1] > 0.5
    assert gpuspec_("simulate", "demo/station.toml", "-o", "third", *small).code == 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_backend_asked_for_is_the_one_recorded(gpuspec_, backend):
    ran = gpuspec_("simulate", "s.toml", "--no-pictures", "--backend", backend)
    assert ran.code == 0
    assert f"{backend} on" in ran.out
    assert json.loads(Path("run/score.json").read_text("utf-8"))["backend"] == backend


def test_a_device_is_taken_by_number_and_by_name(gpuspec_):
    name = opencl_device.devices()[0].name.strip()
    for device in ("0", name, name[2:7].lower()):
        ran = gpuspec_("simulate", "s.toml", "--no-pictures", "--device", device)
        assert ran.code == 0
        assert f"opencl on {name}" in ran.out


# --------------------------------------------------------------------------------- user mistakes


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ("simulate none.toml", "none.toml: no such station file; `gpuspec init` writes one"),
        ("simulate .", "this is a folder"),
        ("simulate typo.toml", "camera.sampling_m is not a known key (did you mean sampling_mm?)"),
        ("simulate wrong.toml", "camera.sampling_mm = -1 must be at least"),
        ("simulate text.toml", "not a valid TOML file"),
        ("simulate binary.toml", "cannot be read as UTF-8"),
        ("simulate brackets.toml", "not a valid TOML file"),
        ("simulate s.toml --backend cuda", "'cuda' is not known; choose one of auto, opencl"),
        (
            "simulate s.toml --backend opencl --device 99",
            "device '99'; choose by number or name",
        ),
        ("simulate s.toml --device ²", "no device '²'"),
        (
            "simulate s.toml --backend numpy --device gpu",
            "'gpu'; choose by number or name from 0 (cpu)",
        ),
        ("simulate s.toml --set camera.sampling_mm", "write it as KEY=VALUE"),
        ("simulate s.toml --set camera.pixel=1", "camera.pixel is not a known key"),
        ("simulate s.toml --set camera.sampling_mm=fine", "must be a number"),
        ("simulate s.toml --set camera=5", "camera = 5 must be a table"),
        ("simulate s.toml --set camera.sampling_mm.x=1", "sampling_mm is not a table"),
        ("simulate s.toml --set defects.1.depth_um=1", "a list has entries [1]"),
        ("simulate s.toml --set self=1", "self is not a known key"),
        ("simulate s.toml --set =1", "is not a known key"),
        (f"simulate s.toml --set camera.rows={'[' * 50_000}", "nested too deeply"),
        ("simulate s.toml -o s.toml", "s.toml is a file; choose another folder with -o"),
        ("simulate s.toml -o s.toml/below", "s.toml is a file; choose another folder with -o"),
        ("simulate s.toml -o /proc/x", "results cannot be written to /proc/x: No such file"),
        (f"simulate s.toml -o {'x' * 300}", "File name too long"),
        ("demo none", f"there is no example 'none'; choose one of {', '.join(examples())}"),
        ("init new --example none", "there is no example 'none'"),
    ],
)
def test_a_mistake_ends_in_a_sentence_and_leaves_nothing(gpuspec_, arguments, why):
    Path("typo.toml").write_text("camera = { sampling_m = 0.1 }", encoding="utf-8")
    Path("wrong.toml").write_text("camera = { sampling_mm = -1 }", encoding="utf-8")
    Path("text.toml").write_text("Dear colleague,\n", encoding="utf-8")
    Path("binary.toml").write_bytes(bytes(range(256)))
    Path("brackets.toml").write_text("part = " + "[" * 1_000_000, encoding="utf-8")
    before = set(Path().iterdir())
    assert why in said(gpuspec_(*arguments.split()))
    assert set(Path().iterdir()) == before


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ("simulate", "Missing argument"),
        ("simulate s.toml --bogus", "No such option"),
        ("simulate s.toml other.toml", "unexpected extra argument"),
        ("simulte s.toml", "No such command"),
    ],
)
def test_a_wrong_use_is_told_apart_by_its_exit_code(gpuspec_, arguments, why):
    ran = gpuspec_(*arguments.split())
    assert ran.code == 2
    assert why in ran.err
    assert "Traceback" not in ran.err
    assert {path.name for path in Path().iterdir()} == {"s.toml"}


def test_a_run_beside_the_station_file_never_replaces_it(gpuspec_):
    Path("station.toml").write_text(f"# mine{STATION}", encoding="utf-8")
    Path("link.toml").symlink_to("station.toml")
    Path("below").mkdir()
    before = content(Path())
    for station in ("station.toml", "link.toml", "below/../station.toml"):
        for more in ((), ("--force",)):
            for place in (".", "below/..", Path.cwd()):
                command = "simulate", station, "-o", place, "--set", "tunnel.dark_mm=8", *more
                assert "station.toml is read here" in said(gpuspec_(*command))
    assert content(Path()) == before


def test_force_replaces_another_station_file_only(gpuspec_):
    Path("station.toml").write_text("# mine", encoding="utf-8")
    Path("notes.txt").write_text("mine", encoding="utf-8")
    command = "simulate", "s.toml", "-o", ".", "--no-pictures", "--backend", "numpy"
    told = said(gpuspec_(*command))
    assert "station.toml is in the way: it is not known to be of an earlier run" in told
    assert names(Path()) == {"s.toml", "station.toml", "notes.txt"}
    assert gpuspec_(*command, "--force").code == 0
    assert gpuspec_(*command).code == 0  # from now on they are its own
    assert Path("notes.txt").read_text("utf-8") == "mine"


@pytest.mark.parametrize(
    "command",
    ["simulate s.toml", "demo", "sweep s.toml --vary tunnel.dark_mm=1:4:4", "front s.toml",
     "optimise s.toml --vary tunnel.dark_mm=1:4", "study height s.toml",
     "prototype s.toml --pattern binary"],
)  # fmt: skip
def test_a_folder_without_a_name_is_refused_by_every_command(gpuspec_, command):
    before = content(Path())
    assert "write -o . for the current folder" in said(gpuspec_(*command.split(), "-o", ""))
    assert content(Path()) == before


def test_more_images_than_the_disk_holds_are_refused_before_any_work(gpuspec_, monkeypatch):
    monkeypatch.setattr(inspection, "trace", lambda *_: pytest.fail("work was begun"))
    for command in (("simulate", "s.toml"), ("demo",)):
        told = said(
            gpuspec_(*command, "--frames", "--set", "sequence.images=100000",
                     "--set", "camera.sampling_mm=0.004")
        )  # fmt: skip
        assert "100,000 images of" in told
        assert "GB on disk" in told
        assert "leave --frames out, or set fewer sequence.images" in told
    assert names(Path()) == {"s.toml"}


def test_a_folder_that_may_not_be_written_is_said_before_any_work(gpuspec_, monkeypatch):
    monkeypatch.setattr(inspection, "trace", lambda *_: pytest.fail("work was begun"))

    def refused(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(files.tempfile, "mkdtemp", refused)  # root may write everywhere
    assert "cannot be written to run: Permission denied" in said(gpuspec_("simulate", "s.toml"))


def test_a_linked_folder_is_written_where_it_leads(gpuspec_):
    Path("real").mkdir()
    Path("run").symlink_to("real")
    for _ in range(2):
        assert gpuspec_("simulate", "s.toml", "--no-pictures", "--backend", "numpy").code == 0
    assert Path("run").is_symlink()
    assert Path("real/score.json").exists()
    Path("lost").symlink_to("nowhere")
    assert "lost is a file" in said(gpuspec_("simulate", "s.toml", "-o", "lost"))


def test_an_image_beyond_the_memory_is_refused_before_any_work(gpuspec_, monkeypatch):
    monkeypatch.setattr(memory, "free_bytes", lambda: 2**30)
    told = said(
        gpuspec_(
            "simulate", "s.toml", "--set", "camera.columns=40000", "--set", "camera.rows=25000"
        )
    )
    assert "40000 x 25000 pixels, which needs" in told
    assert "GiB" in told
    assert "camera.columns" in told
    assert not Path("run").exists()


def test_more_pixels_than_can_be_counted_are_refused(gpuspec_):
    assert "more than 2,147,483,647" in said(
        gpuspec_("simulate", "s.toml", "--set", "camera.sampling_mm=1e-5")
    )


def test_memory_that_runs_out_is_said_with_what_to_do(gpuspec_, monkeypatch):
    def greedy(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(inspection, "simulate", greedy)
    assert "out of memory; use a larger camera.sampling_mm" in said(gpuspec_("simulate", "s.toml"))
    assert not Path("run").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two words é 光", "[/b] [red]odd[/] :smile:", "-- dash"])
def test_names_are_taken_and_shown_as_they_are(gpuspec_, name):
    station, output = Path(f"{name.replace('/', '')}.toml"), Path(f"out {name.replace('/', '')}")
    station.write_text(STATION, encoding="utf-8")
    ran = gpuspec_("simulate", f"./{station}", "-o", f"./{output}", "--backend", "numpy")
    assert ran.code == 0
    assert f"{station}: 120 x 60 pixels" in ran.out
    assert f"results in {output}\n" in ran.out
    assert names(output) == set(FILES) - {"frames.tif"}


def test_a_class_may_have_any_name(gpuspec_):
    ran = gpuspec_(
        "simulate", "s.toml", "--no-pictures", "--set", 'classes=[{ name = "[/b] [red]odd :x:" }]'
    )
    assert ran.code == 0
    assert "[/b] [red]odd :x:" in ran.out


def test_a_name_that_the_terminal_cannot_show_ends_no_run(folder):
    name = os.fsdecode(b"out\xff")
    ran = program(
        "simulate", "s.toml", "-o", name, "--no-pictures", "--backend", "numpy", cwd=folder,
        env={"PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert (ran.code, ran.err) == (0, "")
    assert (folder / name / "score.json").exists()


# ------------------------------------------------------------------------------- absent backends


@pytest.fixture
def no_platform(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the OpenCL loader finds no platform, the pip-installed ones too."""
    absent = str(tmp_path_factory.mktemp("no") / "platform")  # in an empty one others are found
    return {"OCL_ICD_VENDORS": absent, "OPENCL_VENDOR_PATH": absent}


def test_without_an_opencl_platform_it_is_said_what_to_install(folder, no_platform):
    told = said(program("simulate", "s.toml", "--backend", "opencl", cwd=folder, env=no_platform))
    assert "no OpenCL platform found" in told
    assert "pip install pocl-binary-distribution" in told
    assert {path.name for path in folder.iterdir()} == {"s.toml"}


def test_without_an_opencl_platform_auto_goes_on_and_says_so(folder, no_platform):
    ran = program("simulate", "s.toml", "--no-pictures", cwd=folder, env=no_platform)
    assert ran.code == 0
    taken = json.loads((folder / "run/score.json").read_text("utf-8"))["backend"]
    assert taken in BACKENDS[1:]
    assert f"{taken} on " in ran.out


@pytest.mark.slow
def test_devices_shows_why_a_backend_is_absent(folder, no_platform):
    ran = program("devices", cwd=folder, env={**no_platform, "COLUMNS": "300"})
    assert ran.code == 0
    (absent,) = [line for line in ran.out.splitlines() if line.startswith("│ opencl")]
    assert "absent" in absent
    assert "no OpenCL platform found" in absent
    assert "pip install" in absent
    (chosen,) = [line for line in ran.out.splitlines() if "chosen by auto" in line]
    assert any(name in chosen for name in BACKENDS[1:])


def test_a_kernel_that_does_not_build_is_reported_with_file_and_line(gpuspec_, monkeypatch):
    def broken(name: str) -> str:
        return sources.resolved(f"/* {name} */\n\n__kernel void broken(", f"kernels/{name}")

    monkeypatch.setattr(opencl_device, "kernel_source", broken)
    for backend in ("opencl", "auto"):  # auto never hides a fault of the program
        ran = gpuspec_("simulate", "s.toml", "--backend", backend)
        assert ran.code == 1
        assert ran.err.startswith("error: ")
        assert "kernels/trace.cl does not build" in ran.err
        assert "kernels/trace.cl:3:" in ran.err
        assert "Traceback" not in ran.err
        assert {path.name for path in Path().iterdir()} == {"s.toml"}


def test_a_device_that_fails_is_said_in_a_sentence(gpuspec_, monkeypatch):
    import pyopencl as cl

    def full(*_: object) -> None:
        raise cl.MemoryError("create_buffer", cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE)

    monkeypatch.setattr(opencl.OpenCLBackend, "empty", full)
    told = said(gpuspec_("simulate", "s.toml", "--backend", "opencl"))
    assert "out of memory" in told
    assert open_backend("opencl").info.device in told


# ----------------------------------------------------------------------------------- interrupted


@pytest.mark.slow
def test_a_long_calculation_is_stopped_within_seconds(folder):
    images = ("--set", "sequence.images=100000", "--set", "sensor.noise=true")
    process = subprocess.Popen(
        [*PROGRAM, "simulate", "s.toml", *images, "--set", "camera.sampling_mm=0.02"], cwd=folder,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    with pytest.raises(subprocess.TimeoutExpired):  # it would take minutes
        process.wait(4)
    process.terminate()
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert err.endswith("stopped; nothing half-written was left.\n")
    assert hidden(folder) == []


@pytest.mark.slow
@pytest.mark.parametrize(("largest", "backend"), [(4_000, "numpy"), (60_000, "numpy")])
def test_a_full_disk_leaves_an_earlier_run_whole(folder, largest, backend):
    # A process may write no file larger than this; below, tables fail; above, pictures do.
    earlier_run(folder / "run", FILES)
    before = content(folder)

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    told = said(program("simulate", "s.toml", "--backend", backend, cwd=folder, preexec_fn=limited))
    assert "results cannot be written to run" in told
    assert "Free some space" in told
    assert content(folder) == before
    assert not hidden(folder)


@pytest.fixture
def long_run(folder: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Start a run that would write for minutes; returned once it has begun to."""
    earlier_run(folder / "run", FILES)
    started = []

    def heed() -> None:
        # A test run in the background of a shell ignores Ctrl-C, and so would what it starts.
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    def start(backend: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*PROGRAM, "simulate", "s.toml", "--frames", "--backend", backend,
             "--set", "sequence.images=20000", "--set", "camera.sampling_mm=0.02"],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            preexec_fn=heed,
        )  # fmt: skip
        started.append(process)
        given_up = time.monotonic() + 120
        # Two images of 600 x 300 pixels: by then its kernels are built, too.
        while not any(p.stat().st_size > 360_000 for p in folder.rglob(".gpuspec-*/frames.tif")):
            assert process.poll() is None, process.communicate(timeout=DEADLINE_S)
            assert time.monotonic() < given_up, "nothing was written"
            time.sleep(0.01)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate(timeout=DEADLINE_S)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "backend"), [(signal.SIGINT, "opencl"), (signal.SIGTERM, "numpy")]
)
def test_a_stopped_run_leaves_nothing_behind(folder, long_run, number, backend):
    before = content(folder)
    process = long_run(backend)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == ""
    note, stopped = err.splitlines()
    assert note == "note: 20,000 images of 600 x 300 pixels will take about 3.6 GB on disk."
    assert stopped == "stopped; nothing half-written was left."
    assert content(folder) == before
    assert not hidden(folder)


@pytest.mark.slow
def test_a_killed_run_leaves_results_whole_and_the_next_run_tidies_up(folder, long_run, gpuspec_):
    before = content(folder)
    process = long_run("numpy")
    (partial,) = hidden(folder)
    process.kill()
    process.communicate(timeout=DEADLINE_S)
    assert partial.exists()
    assert {k: v for k, v in content(folder).items() if ".gpuspec-" not in k} == before
    assert gpuspec_("simulate", "s.toml", "--no-pictures", "--backend", "numpy").code == 0
    assert not hidden(folder)
    assert Station.read("run/station.toml").sequence.images == 5


@pytest.mark.slow
def test_a_run_leaves_another_that_is_still_running_alone(folder, long_run, gpuspec_):
    process = long_run("numpy")
    (partial,) = hidden(folder)
    assert gpuspec_("simulate", "s.toml", "--no-pictures", "--backend", "numpy").code == 0
    assert hidden(folder) == [partial]
    assert process.poll() is None


def test_the_printed_scores_are_those_that_are_written(gpuspec_: Command):
    ran = gpuspec_("simulate", "s.toml", "--no-pictures", "--set",
                   "segmentation.threshold=60")  # fmt: skip
    score = json.loads(Path("run/score.json").read_text("utf-8"))["score"]
    printed = [f"{score[name]:.3f}" for name in ("p1", "p2", "f1")]
    assert len(set(printed)) == 3
    for name, value in zip(("precision P1", "recall P2", "F1"), printed, strict=True):
        assert re.search(rf"{name}\b.*\s{value}\s", ran.out), (name, value)


def test_how_much_is_refined_is_printed_where_the_station_leaves_it_open(gpuspec_: Command):
    ran = gpuspec_("simulate", "s.toml", "--no-pictures", "--set", "camera.subsampling=auto")
    refined = json.loads(Path("run/score.json").read_text("utf-8"))["refined"]
    assert refined["pixels"] > 0
    told = rf"refined pixels\s+{refined['pixels']:,}\s+{refined['sub_rays']:,} sub-rays"
    assert re.search(told, ran.out)
    ran = gpuspec_("simulate", "s.toml", "--no-pictures", "--set", "camera.subsampling=1")
    assert "refined" not in ran.out
    assert json.loads(Path("run/score.json").read_text("utf-8"))["refined"]["pixels"] == 0


def test_p2_is_undefined_for_the_reason_that_is_true(gpuspec_):
    flawless = gpuspec_("simulate", "s.toml", "--no-pictures", "--set", "defects=[]")
    assert "undefined (the part is flawless)" in flawless.out
    aside = gpuspec_("simulate", "s.toml", "--no-pictures", "--set", "camera.columns=10", "--set",
                     "camera.rows=10")  # fmt: skip
    assert "undefined (no defect's zone has a pixel in the image)" in aside.out


def test_notes_and_what_is_taken_as_ideal_are_printed_and_kept(gpuspec_):
    short = ["--no-pictures", "--set", "tunnel.length_mm=6.0"]
    ran = gpuspec_("simulate", "s.toml", *short)
    (share,) = re.findall(r"note: (5\d\.\d %) of the part sees no light", ran.out)
    assert "assumed: the camera looks through the tunnel's top" in ran.out
    kept = json.loads(Path("run/score.json").read_text("utf-8"))
    assert kept["warnings"][0].startswith(f"{share} of the part")
    assert len(kept["assumptions"]) == 1
    opened = ["--set", "tunnel.opening_length_mm=20.0", "--set", "tunnel.opening_width_mm=20.0"]
    assert "assumed: " not in gpuspec_("simulate", "s.toml", *short, *opened).out
