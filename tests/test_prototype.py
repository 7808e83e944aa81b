"""Lights of one's own: patterns as shaders, on every backend that speaks GLSL."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import DEADLINE_S, PROGRAM, Command, content, names, said
from scenes import check_station
from tolerances import (
    DEVICE_DN,
    IMAGE_DN,
    PATTERN_FLIPS,
    THRESHOLD_STEP_DN,
    WARPED_FLIPS,
    WARPED_S,
    WARPED_TIMES,
)

from gpuspec import prototype
from gpuspec.errors import BackendError, OutputError, PatternError
from gpuspec.light.devices import open_backend
from gpuspec.light.patterns import Pattern, shipped
from gpuspec.light.shader_log import own_lines
from gpuspec.light.sources import named_files
from gpuspec.pictures.detection import KINDS
from gpuspec.pictures.preview import preview_picture
from gpuspec.simulation import preview
from gpuspec.simulation.preview import Previewer
from gpuspec.simulation.simulate import Traced, trace
from gpuspec.station.examples import example
from gpuspec.station.station import Station

HEAD = "float pattern(float light, float across, float shift, float footprint)"
STATION = """
[part]
length_mm = 20.0
width_mm = 10.0
[camera]
sampling_mm = 0.1
[[defects]]
kind = "dent"
x_mm = 2.0
y_mm = 1.0
diameter_mm = 1.0
depth_um = 8.0
"""


@pytest.fixture(scope="module", params=["opengl", "vulkan"])
def traced(request: pytest.FixtureRequest) -> Traced:
    return trace(check_station(camera__subsampling=1), open_backend(request.param))


def pattern(body: str) -> Pattern:
    return Pattern.parse(f"{HEAD} {{\n{body}\n}}", "mine.glsl")


def one_box(**changes: Any) -> Station:
    """A station whose footprints are one box, as a pattern takes them: flat, by a pinhole."""
    return check_station(pupil=0.0, defects=[], camera__subsampling=1).replace(**changes)


def test_the_binary_pattern_is_the_stripes_themselves(traced):
    light_map = open_backend(traced.info.backend).trace(one_box())
    lit = light_map.with_pattern(Pattern.read("binary"))
    assert np.abs(lit.image(7) - light_map.image(7)).max() < DEVICE_DN
    assert np.abs(lit.aspect() - light_map.aspect()).max() < DEVICE_DN
    fused, stripes = lit.fuse(), light_map.fuse()
    for name, image in fused.items():
        assert np.abs(image - stripes[name]).max() < DEVICE_DN
    assert lit.faulty() == 0


def test_what_is_scored_is_what_the_pattern_shows_and_not_the_stripes(traced):
    """Stripes of another width, of which the closed form of the station's knows nothing."""
    lit = traced.light_map.with_pattern(
        pattern("return mod(light - shift, 16.0) < 7.0 ? 1.0 : 0.0;")
    )
    seen = np.mean([lit.image(k) for k in range(40)], axis=0)
    assert np.abs(lit.aspect() - seen).max() < DEVICE_DN
    assert np.abs(lit.aspect() - traced.light_map.aspect()).max() > 40
    result = traced.result(lit)
    assert np.array_equal(result.aspect, lit.aspect())
    assert np.array_equal(result.labels > 0, (lit.aspect() > result.threshold) & result.valid)
    assert result.score != traced.result().score


def test_with_sub_rays_and_a_leak_the_binary_pattern_is_still_the_stripes(traced):
    station = one_box(camera__subsampling=2, tunnel__dark_leak=0.1, sensor__noise=True)
    light_map = open_backend(traced.info.backend).trace(station)
    lit = light_map.with_pattern(Pattern.read("binary"))
    # A rounded sum may turn one electron, and so one grey level of one image.
    assert (np.abs(lit.image(3) - light_map.image(3)) > DEVICE_DN).mean() < PATTERN_FLIPS


def test_every_shipped_pattern_runs_and_stays_within_bounds(traced):
    assert set(shipped()) >= {"binary", "sinusoidal", "checkerboard", "warped"}
    for name in shipped():
        lit = traced.light_map.with_pattern(Pattern.read(name))
        assert lit.faulty() == 0
        result = traced.result(lit)
        assert np.isfinite(result.aspect).all()
        assert 0 < result.aspect.mean() < 255


def test_sinusoidal_fringes_are_the_mean_of_a_cosine_over_the_footprint(traced):
    arrays = traced.light_map.read()
    light, footprint = arrays.light_mm[0].astype(float), arrays.footprint_mm[0].astype(float)
    u = np.pi * footprint / 16
    radiance = 0.5 + 0.5 * np.sin(u) / u * np.cos(2 * np.pi * (light - 3 * 0.4) / 16)
    lit = traced.light_map.with_pattern(Pattern.read("sinusoidal"))
    assert np.abs(lit.image(3) - 255 * np.minimum(4 * radiance, 1)).max() < 5 * DEVICE_DN


def test_warped_stripes_are_evenly_spaced_on_a_crowned_part(traced):
    station = Station.parse(STATION).replace(
        part__length_mm=100.0, part__crown_radius_x_mm=150.0, defects=[], camera__pupil_mm=0.0
    )
    light_map = open_backend(traced.info.backend).trace(station)
    row = light_map.with_pattern(Pattern.read("warped")).image(0)[50] > 127
    edges = np.flatnonzero(np.diff(row.astype(int)) > 0)
    plain = np.flatnonzero(np.diff((light_map.image(0)[50] > 127).astype(int)) > 0)
    assert len(edges) > 5
    assert np.ptp(np.diff(edges)) <= 2  # pixels
    assert np.ptp(np.diff(plain)) > 2


def test_warped_stripes_take_no_longer_than_a_few_simple_ones(traced):
    station = example("trim").replace(camera__sampling_mm=0.25)
    light_map = open_backend(traced.info.backend).trace(station)

    def seconds(name: str) -> float:
        lit = light_map.with_pattern(Pattern.read(name))
        lit.aspect()  # compiles
        times = []
        for _ in range(3):
            start = time.process_time()
            lit.aspect()
            times.append(time.process_time() - start)
        return min(times)

    assert seconds("warped") < WARPED_TIMES * seconds("sinusoidal") + WARPED_S


def test_warped_stripes_of_a_flat_part_are_the_stripes_themselves(traced):
    station = example("trim").replace(camera__sampling_mm=0.5)
    light_map = open_backend(traced.info.backend).trace(station)
    plain = light_map.with_pattern(Pattern.read("binary"))
    warped = light_map.with_pattern(Pattern.read("warped"))
    assert (np.abs(warped.aspect() - plain.aspect()) > IMAGE_DN).mean() < WARPED_FLIPS


def test_the_other_coordinate_is_that_of_the_light_point(traced):
    lit = traced.light_map.with_pattern(pattern("return across > 0.0 ? 1.0 : 0.0;"))
    image = lit.image(0)
    assert (image[:3] == 255).all()  # y > 0 is up
    assert (image[-3:] == 0).all()


def test_a_picture_of_one_s_own_is_the_whole_image(traced):
    text = """float picture(vec2 place, float light, float across, float footprint, int k) {
        return place.x == 3.0 && place.y == 5.0 && k == 2 ? 1.0 : 0.25; }"""
    lit = traced.light_map.with_pattern(Pattern.parse(text, "mine.glsl"))
    image = lit.image(2)
    assert image[5, 3] == 255
    assert np.delete(image.ravel(), 5 * 32 + 3) == pytest.approx(63.75)
    assert lit.image(1)[5, 3] == pytest.approx(63.75)


@pytest.mark.parametrize(
    ("body", "value"),
    [("return sqrt(-1.0 - light * light);", 0), ("return 7.0;", 255), ("return -0.5;", 0)],
)
def test_values_that_are_none_are_bounded_and_told(traced, body, value):
    lit = traced.light_map.with_pattern(pattern(body))
    assert lit.faulty() == 1
    assert (lit.mean() == value).all()


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return 0.2;", ["all 40 images are the same: mine.glsl does not change with its `shift`",
                         "the aspect image is even, 204.0 DN everywhere: under mine.glsl nothing"]),
        ("return 0.1 + 0.05 * sin(light);", ["all 40 images are the same: mine.glsl"]),
        ("return mod(light - shift, 4.0) < 1.0 ? 0.25 : 0.0;", []),
    ],
)  # fmt: skip
def test_a_pattern_that_can_show_nothing_is_told_so(traced, body: str, said: list[str]):
    notes = traced.result(traced.light_map.with_pattern(pattern(body))).warnings
    notes = [note for note in notes if "mine.glsl" in note]
    assert [note[: len(start)] for note, start in zip(notes, said, strict=True)] == said


def test_images_that_differ_in_one_pixel_are_not_the_same(traced):
    text = """float picture(vec2 place, float light, float across, float footprint, int k) {
        return place.x == 3.0 && place.y == 5.0 && k == 2 ? 1.0 : 0.25; }"""
    lit = traced.light_map.with_pattern(Pattern.parse(text, "mine.glsl"))
    assert not any("are the same" in note for note in traced.result(lit).warnings)


def test_a_pattern_is_not_told_what_is_wrong_with_stripes(traced):
    # Of the stripes, neither exposure nor shifts would give an aspect image.
    station = check_station(sensor__exposure=1.0, sequence__step_mm=16.0, camera__subsampling=1)
    under = trace(station, open_backend(traced.info.backend))
    text = "return mod(light - shift, 48.0) < 12.0 ? 1.0 : 0.0;"
    lit = under.result(under.light_map.with_pattern(pattern(text)))
    assert not any("images cover" in note or "does not saturate" in note for note in lit.warnings)
    assert any("all 40 images are the same" in note for note in under.result().warnings)


def test_a_pattern_after_another_gives_what_it_gives_alone(traced):
    after = traced.light_map.with_pattern(Pattern.read("binary")).with_pattern(
        pattern("return 1.0;")
    )
    first = traced.light_map.with_pattern(pattern("return 1.0;"))
    np.testing.assert_array_equal(after.aspect(), first.aspect())
    np.testing.assert_array_equal(after.image(3), first.image(3))


@pytest.mark.parametrize("body", ["return lihgt;", "float a = 1.0\nreturn a;"])
def test_a_pattern_that_does_not_compile_names_the_user_s_file_and_line(traced, body):
    with pytest.raises(PatternError, match=r"(?m)^mine\.glsl:[23]: ") as told:
        traced.light_map.with_pattern(pattern(body))
    assert "mine.glsl does not compile" in str(told.value)


# What is wrong, and the line of the file that tells it.
MISTAKES = {
    "undeclared name": (f"{HEAD} {{\n    return lihgt;\n}}\n", 2),
    "unknown function": (f"{HEAD} {{\n    return sine(light);\n}}\n", 2),
    "missing semicolon": (f"{HEAD} {{\n    float a = 1.0\n    return a;\n}}\n", 3),
    "wrong type": (f"{HEAD} {{\n\n    float a = vec2(1.0, 2.0);\n    return a;\n}}\n", 3),
    "missing return": (f"\n{HEAD} {{\n    float a = light;\n}}\n", 2),
    "constant changed": (f"{HEAD} {{\n    const float a = 1.0;\n    a = 2.0;\n"
                         f"    return a;\n}}\n", 3),
    "brace too many": (f"{HEAD} {{\n    return light;\n}}\n}}\n\n", 4),
    "brace missing at the end": (f"{HEAD} {{\n    return light;\n\n\n", 2),
    "semicolon missing at the end": (f"{HEAD} {{\n    return light;\n}}\nconst float x = 1.0", 4),
    "name alone at the end": (f"{HEAD} {{\n    return light;\n}}\nfloat", 4),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_by_the_user_s_lines_and_no_other(traced, mistake, capfd):
    text, line = MISTAKES[mistake]
    with pytest.raises(PatternError) as told:
        traced.light_map.with_pattern(Pattern.parse(text, "mine.glsl"))
    first, *lines = str(told.value).splitlines()
    assert first == "mine.glsl does not compile:"
    assert lines[0].startswith(f"mine.glsl:{line}: ")
    assert "error" in lines[0]
    assert ("ends too early" in lines[0]) == ("at the end" in mistake)
    assert all(re.match(r"mine\.glsl:\d+: ", each) for each in lines)
    assert not re.search(r"shaders/|SemanticError|Token|naga", str(told.value))
    assert capfd.readouterr().err == ""


def test_a_function_that_the_program_cannot_call_is_told_as_it_must_be(traced):
    text = "float pattern(float light) {\n    return light;\n}\n"
    with pytest.raises(PatternError, match=f"must define {re.escape(HEAD)}") as told:
        traced.light_map.with_pattern(Pattern.parse(text, "mine.glsl"))
    assert "shaders/" not in str(told.value)
    assert "warning" not in str(told.value)


@pytest.mark.parametrize(
    "log",
    [
        '0(1) : warning C7050: "d" might be used before being initialized\n'
        '0(200003) : error C1008: undefined variable "lihgt"\n',
        "WARNING: 0:1: 'd' : used uninitialized\n"
        "ERROR: 0:200003: Use of undeclared identifier 'lihgt'\n",
        "0:1(3): warning: `d' used uninitialized\n0:200003(9): error: `lihgt' undeclared\n",
    ],
    ids=["NVIDIA", "Apple", "Mesa"],
)
def test_every_compiler_s_messages_are_reduced_to_the_user_s(log):
    light = pattern("float a = light;\nreturn lihgt;")
    said = own_lines(named_files(log, ("shaders/a", "shaders/b", light.file)), light)
    assert said.startswith("mine.glsl:3: ")
    assert "lihgt" in said
    assert "\n" not in said


def test_a_pattern_on_a_backend_without_shaders_is_refused_by_name(opencl):
    with pytest.raises(BackendError, match="opengl or vulkan"):
        opencl.trace(check_station()).with_pattern(Pattern.read("binary"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("float patern(float x) { return x; }", "must define one of"),
        ("", "must define one of"),
        (f"{HEAD} {{ return 1.0; }} float picture (vec2 a) {{ return 1.0; }}", "defines both"),
        ("// float pattern(float a)", "must define one of"),
        (f'#include "/etc/passwd"\n{HEAD} {{ return 1.0; }}', "#include is not for a pattern"),
        (f"#version 450\n{HEAD} {{ return 1.0; }}", "#version is not for a pattern"),
        (f'#include "x.h"\n{HEAD} {{ return 1.0; }}', "#include is not for a pattern"),
        (f"#line 7\n{HEAD} {{ return 1.0; }}", "#line is not for a pattern"),
        (f"#extension all : enable\n{HEAD} {{ return 1.0; }}", "#extension is not for a pattern"),
        (f"{HEAD};", "must define one of"),
        (f"{HEAD} {{ return 1.0; }}\n/* the end", r"mine\.glsl:2: a comment begins here"),
        (f"#if 1\n{HEAD} {{ return 1.0; }}", "an #if has no #endif"),
        (f"/* §\n*/ {HEAD} {{\n return 1.0 § 2.0; }}", r"mine\.glsl:3: '§' is no character"),
    ],
)
def test_a_file_that_is_no_pattern_is_refused_with_what_to_write(text, told):
    with pytest.raises(PatternError, match=told):
        Pattern.parse(text, "mine.glsl")


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(PatternError, match="no such pattern"):
        Pattern.read(tmp_path / "none.glsl")
    (tmp_path / "bytes.glsl").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(PatternError, match="UTF-8"):
        Pattern.read(tmp_path / "bytes.glsl")


# Mesa ends a loop after 65,535 rounds: this one takes a minute there, and for ever on a GPU.
LOOP = "float x = light; while (x < 1e9) { x = sin(x + shift); } return x;"


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["opengl", "vulkan"])
def test_a_pattern_that_loops_for_ever_is_stopped_and_the_next_one_runs(tmp_path, backend):
    station = Station.parse(STATION)
    with prototype.bench(station, backend, None, limit_s=30.0) as bench:
        rendered = bench.render(Pattern.read("binary"), tmp_path, glance=True)
        assert rendered.summary["score"]["defects_hit"] == 1
        assert (tmp_path / "detection.png").read_bytes().startswith(b"\x89PNG")
        bench.limit_s = 2.0
        with pytest.raises(PatternError, match="loop for ever"):
            bench.render(pattern(LOOP), tmp_path, glance=True)
        bench.limit_s = 30.0
        with pytest.raises(PatternError, match="was not rendered"):
            bench.faulty(pattern(LOOP))
        again = bench.render(Pattern.read("binary"), tmp_path, glance=True)
        assert again.summary == rendered.summary
        assert bench.faulty(Pattern.read("binary")) == 0
        bench.render(pattern("return 7.0;"), tmp_path, glance=True)
        assert bench.faulty(pattern("return 7.0;")) == 1


def test_each_save_is_rendered_once(tmp_path):
    path, seen, done = tmp_path / "mine.glsl", [], threading.Event()
    path.write_text("a")
    thread = threading.Thread(
        target=prototype.watch, args=(path, lambda: seen.append(path.read_text()), done.is_set)
    )
    thread.start()
    try:
        for text in ("bb", "ccc"):
            until(lambda: len(seen) > 0 and seen[-1] == path.read_text())
            path.unlink()  # as editors do, or
            path.write_text("")
            time.sleep(2 * prototype.POLL_S)
            (tmp_path / "new").write_text(text)
            (tmp_path / "new").replace(path)
        until(lambda: seen[-1] == "ccc")
    finally:
        done.set()
        thread.join(timeout=DEADLINE_S)
    assert seen == ["a", "bb", "ccc"]


def until(holds) -> None:
    end = time.monotonic() + DEADLINE_S
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("most", [2**19, 400])
def test_a_preview_is_of_some_pixels_as_they_are(traced, monkeypatch, most):
    monkeypatch.setattr(preview, "MOST", most)
    light = Pattern.read("sinusoidal")
    seen = Previewer(traced, open_backend(traced.info.backend)).under(light)
    whole = traced.result(traced.light_map.with_pattern(light))
    step = {2**19: 1, 400: 2}[most]
    some = np.s_[step // 2 :: step, step // 2 :: step]
    assert seen.step == step
    np.testing.assert_array_equal(seen.aspect, whole.aspect[some])
    np.testing.assert_array_equal(seen.truth, whole.truth[some])
    assert seen.threshold == pytest.approx(whole.threshold, abs=THRESHOLD_STEP_DN)
    picture = np.asarray(preview_picture(seen))
    hit = tuple(int(KINDS["hit"][at : at + 2], 16) for at in (1, 3, 5))
    side = picture.shape[1] // seen.aspect.shape[1]
    inside = picture[: seen.aspect.shape[0] * side : side, ::side]
    np.testing.assert_array_equal((inside == hit).all(axis=-1), seen.labels > 0)


@pytest.mark.slow
def test_the_command_writes_pictures_sequence_and_score(tmp_path):
    (tmp_path / "s.toml").write_text(STATION)
    command = [
        sys.executable, "-m", "gpuspec", "prototype", "s.toml", "--pattern", "sinusoidal",
        "--frames", "look.gif", "-o", "out", "--set", "sequence.images=8",
    ]  # fmt: skip
    ran = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=DEADLINE_S
    )
    assert ran.returncode == 0, ran.stderr
    assert "P1" in ran.stdout
    assert (tmp_path / "look.gif").read_bytes().startswith(b"GIF8")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"aspect.tif", "score.json", "detection.png", "pattern.glsl"} <= written
    assert "station.png" not in written
    assert Pattern.read(tmp_path / "out" / "pattern.glsl").text == Pattern.read("sinusoidal").text
    assert "note: nothing is detected" in ran.stdout
    dark = [*command, "--set", "tunnel.length_mm=4.0"]
    ran = subprocess.run(
        dark, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=DEADLINE_S
    )
    assert re.search(r"note: 8\d(\.\d)? % of the part sees no light", ran.stdout)
    command[command.index("out")] = "none"
    (tmp_path / "bad.glsl").write_text(f"{HEAD} {{ return x; }}")
    command[command.index("sinusoidal")] = "bad.glsl"
    ran = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=DEADLINE_S
    )
    assert ran.returncode == 1
    assert "bad.glsl:1:" in ran.stderr
    assert "Traceback" not in ran.stderr
    assert not (tmp_path / "none").exists()


def test_the_printed_scores_are_those_that_are_written(gpuspec_: Command):
    Path("s.toml").write_text(STATION, encoding="utf-8")
    ran = gpuspec_("prototype", "s.toml", "--pattern", "binary", "-o", "out", "--limit", 120)
    score = json.loads(Path("out/score.json").read_text("utf-8"))["score"]
    p1, p2 = f"{score['p1']:.3f}", f"{score['p2']:.3f}"
    assert p1 != p2
    assert f"precision P1 (overdetection) {p1}, recall P2 (misdetection) {p2} (" in ran.out


@pytest.mark.slow
def test_images_for_a_look_are_written_as_pngs(tmp_path):
    station = Station.parse(STATION).replace(sequence__images=3)
    frames = tmp_path / "frames"
    frames.mkdir()
    with prototype.bench(station, "opengl", None, 30.0) as bench:
        bench.render(Pattern.read("checkerboard"), tmp_path, glance=True, frames=frames)
    assert sorted(path.name for path in frames.iterdir()) == [
        "image_0000.png", "image_0001.png", "image_0002.png",
    ]  # fmt: skip


@pytest.fixture
def shown(gpuspec_: Command) -> Command:
    """The command with images small enough for a glance at it."""
    small = "--set", "sequence.images=4", "--set", "camera.sampling_mm=0.4"
    Path("s.toml").write_text(STATION, encoding="utf-8")
    return partial(gpuspec_, "prototype", "s.toml", "--pattern", "binary", *small)


def glanced(cwd: Path, *arguments: object, until_saved: Path) -> str:
    """The command with --watch, ended by Ctrl-C after its first picture."""
    (cwd / "s.toml").write_text(STATION, encoding="utf-8")
    (cwd / "mine.glsl").write_text(Pattern.read("binary").text, encoding="utf-8")
    process = subprocess.Popen(
        [*PROGRAM, "prototype", "s.toml", "--pattern", "mine.glsl", "--watch", *arguments],
        cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    end = time.monotonic() + DEADLINE_S
    before = until_saved.stat().st_mtime_ns if until_saved.exists() else None
    while process.poll() is None and time.monotonic() < end:
        if until_saved.exists() and until_saved.stat().st_mtime_ns != before:
            process.send_signal(signal.SIGINT)
            break
        time.sleep(0.02)
    return process.communicate(timeout=DEADLINE_S)[0]


@pytest.mark.slow
def test_a_glance_never_replaces_a_whole_run(shown, tmp_path):
    assert shown("-o", "out").code == 0
    before = content(tmp_path / "out")
    told = glanced(tmp_path, "-o", "out", until_saved=tmp_path / "never")
    assert "out/score.json is in the way: it belongs to a run" in told
    assert "watching" not in told
    assert content(tmp_path / "out") == before
    picture = tmp_path / "watch" / "detection.png"
    for _ in range(2):  # of its own it does
        told = glanced(tmp_path, "--frames", "look.gif", until_saved=picture)
        assert "error" not in told
    assert names(tmp_path / "watch") == {"score.json", "detection.png", "preview.png"}
    assert (tmp_path / "look.gif").exists()
    assert shown("-o", "watch").code == 0  # and a whole run replaces a glance
    assert "aspect.tif" in names(tmp_path / "watch")


@pytest.mark.slow
def test_a_sequence_is_a_gif_or_a_folder(shown, tmp_path):
    for name in ("x.mp4", "x.png", "below/x.tif"):
        told = said(shown("--frames", name))
        assert f"--frames {name}: the sequence is written as a .gif, or as PNGs into a" in told
    assert names(tmp_path) == {"s.toml"}
    (tmp_path / "of 7.5").mkdir()
    assert shown("--frames", "of 7.5").code == 0
    assert len(names(tmp_path / "of 7.5")) == 4


@pytest.mark.slow
def test_a_sequence_replaces_only_an_earlier_one(shown, tmp_path):
    (tmp_path / "look.gif").write_text("mine", encoding="utf-8")
    assert "look.gif is in the way" in said(shown("--frames", "look.gif"))
    assert names(tmp_path) == {"look.gif", "s.toml"}
    assert shown("--frames", "look.gif", "--force").code == 0
    assert shown("--frames", "other.GIF").code == 0
    assert shown("--frames", "look.gif").code == 0
    assert {"look.gif", "other.GIF"} <= names(tmp_path)
    told = said(shown("-o", ".", "--frames", "sequence.gif"))
    assert "would be written twice" in told


@pytest.mark.slow
def test_a_pattern_is_never_replaced(gpuspec_: Command, tmp_path: Path):
    (tmp_path / "s.toml").write_text(STATION, encoding="utf-8")
    text = Pattern.read("binary").text
    (tmp_path / "pattern.glsl").write_text(text, encoding="utf-8")
    for more in ((), ("--force",)):
        command = "prototype", "s.toml", "--pattern", "pattern.glsl", "-o", ".", *more
        assert "pattern.glsl is read here" in said(gpuspec_(*command))
    assert (tmp_path / "pattern.glsl").read_text("utf-8") == text


def test_images_beyond_the_disk_are_refused(tmp_path):
    station = Station.parse(STATION).replace(sequence__images=100_000, camera__sampling_mm=0.002)
    prototype.planned(station, tmp_path / "run", Path("binary"), str(tmp_path / "look.gif"))
    with pytest.raises(OutputError, match=r"100,000 images of 10,000 x 5,000 pixels need about"):
        prototype.planned(station, tmp_path / "run", Path("binary"), str(tmp_path / "images"))


@pytest.mark.parametrize("body", ["return 0.0;", "return 1.0;"])
def test_an_even_pattern_is_cause_enough(traced, body: str):
    notes = " ".join(traced.result(traced.light_map.with_pattern(pattern(body))).warnings)
    assert "the aspect image is even" in notes
    assert "sensor.exposure" not in notes
    assert "darker" not in notes
