"""Devices: which one is opened, that it computes, and what is said of those that do not."""

from __future__ import annotations

import json
import os
import re
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from commandline import UNKNOWN_CPU, program, said

from gpuspec import cache, host
from gpuspec.errors import BackendError, DeviceError, DeviceWarning
from gpuspec.light import devices, intel, opencl_device, pocl, proof, speed
from gpuspec.light import opencl as opencl_module
from gpuspec.light.devices import BACKENDS, DeviceReport, Found, fastest, open_backend, survey
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.speed import COPY, FILES, ROWS

QUICK = ("--set", "camera.sampling_mm=0.5", "--no-pictures")


@pytest.fixture
def without_opencl(monkeypatch):
    def absent() -> list[Any]:
        raise BackendError("opencl: no OpenCL platform found; install one.")

    monkeypatch.setattr(opencl_device, "devices", absent)


def test_auto_takes_the_first_that_opens():
    assert BACKENDS[0] == "opencl"
    assert isinstance(open_backend("auto"), OpenCLBackend)


def test_auto_goes_on_to_the_next(without_opencl):
    assert open_backend("auto").info.backend == BACKENDS[1]


def test_auto_tries_in_the_documented_order_and_keeps_every_reason(monkeypatch):
    tried = []

    def fail(name: str, device: str | None) -> None:
        tried.append(name)
        raise BackendError(f"{name}: absent because of the test.")

    monkeypatch.setattr(devices, "opened", fail)
    with pytest.raises(BackendError) as raised:
        open_backend("auto")
    assert tried == list(BACKENDS)
    for name in BACKENDS:
        assert f"{name}: absent because of the test." in str(raised.value)


def test_a_named_backend_is_never_swapped(without_opencl):
    with pytest.raises(BackendError, match="no OpenCL platform"):
        open_backend("opencl")
    assert isinstance(open_backend("numpy"), NumpyBackend)


@pytest.mark.parametrize("name", BACKENDS)
def test_a_named_backend_is_the_one_that_opens(name):
    assert open_backend(name).info.backend == name


def test_without_pyopencl_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    with pytest.raises(BackendError, match=r"pyopencl cannot be imported.*pip install"):
        open_backend("opencl")
    assert open_backend("auto").info.backend == BACKENDS[1]


@pytest.mark.parametrize("name", ["", "cuda", "OpenCL", "auto "])
def test_an_unknown_backend_names_the_known(name):
    with pytest.raises(BackendError, match=f"'{name}' is not known.*auto, {', '.join(BACKENDS)}"):
        open_backend(name)


@pytest.mark.parametrize("device", ["no such device", "99", "-1", "²"])
@pytest.mark.parametrize("name", BACKENDS)
def test_an_unknown_device_names_the_known(name, device):
    with pytest.raises(BackendError, match=rf"{name}: no device .* name from 0 \("):
        open_backend(name, device)


def test_a_device_that_no_backend_has_is_told_as_that():
    with pytest.raises(BackendError) as raised:
        open_backend("auto", "RTX")
    head, *lines = str(raised.value).splitlines()
    assert head == "no backend has a device 'RTX'."
    assert [line.split(":")[0] for line in lines] == list(BACKENDS)


def test_a_device_is_found_by_number_and_by_part_of_its_name(opencl):
    name = opencl.device.name.strip()
    for wanted in ("0", name, name[1:5], name.upper()):
        assert open_backend("opencl", wanted).info == opencl.info


def test_the_survey_marks_what_auto_takes(opencl):
    found = survey()
    assert [entry.backend for entry in found if entry.info is None] == []
    assert {entry.backend for entry in found} == set(BACKENDS)
    chosen = [entry for entry in found if entry.remark == "chosen by auto"]
    assert [entry.info for entry in chosen] == [open_backend("auto").info]
    others = [entry.remark for entry in found if entry not in chosen]
    assert set(others) == {f"auto takes {chosen[0].backend} first"}
    assert [entry.number for entry in found if entry.backend == "opencl"] == list(
        range(len(opencl_device.devices()))
    )


def test_the_survey_keeps_the_reason_of_an_absent_backend(without_opencl):
    absent, present, *_ = survey()
    assert absent.info is None
    assert absent.remark == "absent: opencl: no OpenCL platform found; install one."
    assert present.info == open_backend(BACKENDS[1]).info
    assert "auto" in present.remark


# ------------------------------------------------------------------------------- it must compute


@pytest.fixture
def forgotten(monkeypatch, tmp_path) -> Path:
    """A cache folder that holds nothing yet."""
    monkeypatch.setattr(proof, "folder", lambda: tmp_path)
    return tmp_path


@pytest.fixture
def failing(monkeypatch, forgotten):
    """Makes a backend's devices fail their proof."""

    def fail(name: str) -> None:
        real = proof.ask

        def ask(what: str, backend: Any, settings: Any) -> dict[str, Any]:
            if backend.info.backend == name:
                raise DeviceError("error: it cannot add.")
            return real(what, backend, settings)

        monkeypatch.setattr(proof, "ask", ask)

    return fail


def test_a_device_that_does_not_compute_is_left_for_the_next_backend_in_one_line(failing, opencl):
    failing("opencl")
    with pytest.warns(DeviceWarning) as told:
        taken = open_backend("auto")
    assert taken.info.backend == BACKENDS[1]
    (line,) = (str(warning.message) for warning in told)
    assert "\n" not in line
    assert opencl.info.device in line
    assert "it cannot add" in line
    assert line.endswith(f"{taken.info.backend} on {taken.info.device} is taken.")


def test_the_next_device_of_a_backend_is_taken_in_place_of_one_that_fails(monkeypatch, forgotten):
    both = opencl_device.devices() * 2
    monkeypatch.setattr(opencl_device, "devices", lambda: both)

    def ask(what: str, backend: Any, settings: Any) -> dict[str, Any]:
        if backend.number == 0:
            raise DeviceError("it cannot add.")
        return {}

    monkeypatch.setattr(proof, "ask", ask)
    with pytest.warns(DeviceWarning, match="it cannot add"):
        taken = open_backend("opencl")
    assert (taken.info.backend, taken.number) == ("opencl", 1)


@pytest.mark.parametrize(("name", "device"), [("opencl", None), ("opencl", "0"), ("auto", "0")])
def test_what_is_asked_for_by_name_and_fails_is_never_swapped(name, device, failing):
    failing("opencl")
    with pytest.raises(DeviceError, match=r"does not compute: error: it cannot add.*\n.*--backend"):
        open_backend(name, device)


def test_a_good_start_says_nothing(forgotten):
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeviceWarning)
        assert open_backend("auto").info.backend == BACKENDS[0]


def test_where_numpy_alone_is_left_it_is_said_why_the_faster_ones_are_absent(monkeypatch):
    real = devices.opened

    def opened(name: str, device: str | None) -> Any:
        if name != "numpy":
            raise BackendError(f"{name}: no driver.")
        return real(name, device)

    monkeypatch.setattr(devices, "opened", opened)
    with pytest.warns(DeviceWarning) as told:
        assert isinstance(open_backend("auto"), NumpyBackend)
    assert [str(one.message).split(":")[0] for one in told] == list(BACKENDS[:-1])


def test_a_device_is_proven_once_and_then_remembered(forgotten, monkeypatch):
    open_backend("opencl")
    (kept,) = (forgotten / "devices").iterdir()
    assert json.loads(kept.read_text("utf-8"))["backend"] == "opencl"

    def again(*_: Any) -> None:
        raise AssertionError("it was remembered")

    monkeypatch.setattr(proof, "ask", again)
    open_backend("opencl")
    kept.write_text("{ damaged", encoding="utf-8")
    with pytest.raises(AssertionError, match="remembered"):
        open_backend("opencl")


def test_a_device_that_failed_is_tried_again_at_the_next_start(failing, forgotten, monkeypatch):
    real = proof.ask
    failing("opencl")
    with pytest.raises(DeviceError):
        open_backend("opencl")
    monkeypatch.setattr(proof, "ask", real)
    open_backend("opencl")


def test_what_is_remembered_is_so_per_version_of_the_driver(forgotten, opencl):
    proof.remember(opencl, {"widths": {}})
    assert proof.remembered(opencl) == {"widths": {}}
    other = OpenCLBackend()
    other.info = opencl_device.DeviceInfo("opencl", opencl.info.device, opencl.info.driver, "2")
    assert proof.remembered(other) is None
    proof.remember(opencl, None)
    assert proof.remembered(opencl) is None


@pytest.mark.parametrize("name", BACKENDS)
def test_every_device_here_has_the_image_of_float64(name):
    assert proof.difference(open_backend(name)) <= proof.LARGEST_DN


def test_a_wrong_image_is_noticed(opencl, monkeypatch):
    real = opencl_module.OpenCLLightMap.closed_form

    def shifted(light_map: Any, station: Any = None) -> Any:
        image = real(light_map, station)
        image[3, 5] += 0.1
        return image

    monkeypatch.setattr(opencl_module.OpenCLLightMap, "closed_form", shifted)
    with pytest.raises(DeviceError, match=r"0\.1\d* DN off float64"):
        proof.difference(opencl)


def test_an_image_that_is_none_is_noticed(opencl, monkeypatch):
    def none(light_map: Any, station: Any = None) -> Any:
        return opencl_module.np.full(light_map.station.shape, opencl_module.np.nan, "f4")

    monkeypatch.setattr(opencl_module.OpenCLLightMap, "closed_form", none)
    with pytest.raises(DeviceError, match="nan DN off"):
        proof.difference(opencl)


def test_a_device_that_never_answers_is_left(opencl, monkeypatch):
    monkeypatch.setattr(proof, "SECONDS", 0.01)
    with pytest.raises(DeviceError, match="no answer within"):
        proof.ask("prove", opencl, opencl.candidates()[0])


def test_a_driver_that_ends_the_process_ends_another_one(opencl, monkeypatch, tmp_path):
    # A kernel file of that name stands for a driver that crashes: nothing of gpuspec is caught.
    (tmp_path / "sitecustomize.py").write_text("import os; os.abort()\n", encoding="utf-8")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with pytest.raises(DeviceError, match="ended the process with code -6"):
        proof.ask("prove", opencl, opencl.candidates()[0])


def test_in_a_frozen_program_the_device_is_tried_in_the_process_itself(forgotten, monkeypatch):
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    monkeypatch.setattr(proof, "ask", None)
    assert open_backend("opencl").info.backend == "opencl"
    assert len(list((forgotten / "devices").iterdir())) == 1


@pytest.mark.slow
def test_vectors_of_every_width_give_the_same_image_within_rounding(opencl):
    tried = OpenCLBackend()
    assert tried.candidates()[-1] == {"widths": dict.fromkeys(opencl_device.FILES, 1)}
    for settings in tried.candidates():
        tried.settle(settings)
        assert proof.difference(tried) <= proof.LARGEST_DN


def test_sixteen_pixels_at_once_are_for_a_cpu_that_has_avx512(monkeypatch):
    device = OpenCLBackend()
    monkeypatch.setattr(pocl, "cpu", lambda _: "skylake-avx512")
    for flags, widest in ((host.AVX512, 16), (host.AVX512 - {"avx512f"}, 8), (set(), 8)):
        monkeypatch.setattr(pocl, "cpu_flags", lambda flags=flags: flags)
        best, *_, last = device.candidates()
        assert best == {"widths": dict.fromkeys(opencl_device.FILES, widest)}
        assert last == {"widths": dict.fromkeys(opencl_device.FILES, 1)}
    monkeypatch.setattr(pocl, "cpu_flags", lambda: host.AVX512)
    monkeypatch.setattr(pocl, "cpu", lambda _: "znver3")  # built for another CPU than it is
    assert device.candidates()[0] == {"widths": dict.fromkeys(opencl_device.FILES, 8)}


def test_a_compiler_without_avx512_refuses_sixteen_pixels_in_words(opencl):
    text = "#undef __AVX512F__\n" + opencl_device.kernel_source("aspect.cl")
    with pytest.raises(BackendError, match="sixteen pixels at once take AVX-512"):
        opencl.program(text, "aspect.cl", 16)


@pytest.mark.parametrize("file", opencl_device.FILES)
def test_each_kernel_file_may_have_a_width_of_its_own(file, opencl):
    mixed = OpenCLBackend()
    widest = opencl.width
    mixed.settle({"widths": {**dict.fromkeys(opencl_device.FILES, widest), file: 1}})
    assert mixed.width == widest > 1
    station = opencl_module.Station.from_dict(proof.STATION)
    light_map, usual = mixed.trace(station), opencl.trace(station)
    for made, expected in (
        (light_map.aspect(), usual.aspect()),
        (light_map.image(3), usual.image(3)),
    ):
        assert abs(made - expected).max() <= proof.LARGEST_DN


# ------------------------------------------------------------------------- PoCL and unknown CPUs


@pytest.mark.slow
def test_the_test_process_really_has_an_unknown_cpu(tmp_path):
    told = program(
        "devices", "--json", cwd=tmp_path, env={**UNKNOWN_CPU, pocl.SWITCH: "off"}
    )  # fmt: skip
    first = json.loads(told.out)["devices"][0]
    assert first["version"].endswith("for generic")
    assert not first["computes"]
    assert "unknown target CPU 'generic'" in first["remark"]


def test_pocl_computes_on_a_cpu_that_its_compiler_does_not_know(tmp_path):
    ran = program("demo", *QUICK, cwd=tmp_path, env=UNKNOWN_CPU)
    assert ran.code == 0, ran.err
    assert ran.err == ""
    score = json.loads((tmp_path / "demo/score.json").read_text("utf-8"))
    assert score["backend"] == "opencl"
    assert not score["version"].endswith("generic")
    assert score["score"]["defects_hit"] > 0


@pytest.mark.slow
def test_pocl_computes_on_the_least_cpu_too_if_without_vectors(tmp_path):
    # With vectors its compiler ends the process there: "LLVM ERROR: Cannot select: fsqrt".
    ran = program("demo", *QUICK, cwd=tmp_path, env={**UNKNOWN_CPU, pocl.SWITCH: "x86-64"})
    assert ran.code == 0, ran.err
    assert "for x86-64" in ran.out


def test_without_the_repair_the_next_backend_is_taken_and_named(tmp_path):
    ran = program("demo", *QUICK, cwd=tmp_path, env={**UNKNOWN_CPU, pocl.SWITCH: "off"})
    assert ran.code == 0, ran.err
    (line,) = ran.err.splitlines()
    assert line.startswith("note: opencl on ")
    assert "unknown target CPU 'generic'" in line
    assert f" {BACKENDS[1]} on " in line
    score = json.loads((tmp_path / "demo/score.json").read_text("utf-8"))
    assert score["backend"] == BACKENDS[1]


@pytest.mark.slow
def test_without_the_repair_opencl_by_name_is_an_error_that_says_what_else_there_is(tmp_path):
    told = said(
        program(
            "demo", *QUICK, "--backend", "opencl", cwd=tmp_path,
            env={**UNKNOWN_CPU, pocl.SWITCH: "off"},
        )
    )  # fmt: skip
    assert "unknown target CPU 'generic'" in told
    assert 'pip install "gpuspec[intel]"' in told
    assert "apt install pocl-opencl-icd" in told
    assert list(tmp_path.iterdir()) == []


def test_a_cpu_gets_the_newest_name_whose_instructions_it_has():
    amd = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe", "popcnt", "sse4a", "adx"}
    wide = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
    assert pocl.suited(amd | {"clzero"}) == b"znver3"
    assert pocl.suited(amd | {"clzero"} | wide) == b"skylake-avx512"
    assert pocl.suited((amd | wide) - {"sse4a"}) == b"skylake-avx512"
    assert pocl.suited(amd - {"sse4a"}) == b"haswell"
    assert pocl.suited(amd - {"avx2"}) == b"x86-64"
    assert pocl.suited(set()) == b"x86-64"


def test_no_other_build_of_pocl_is_touched(monkeypatch, opencl):
    monkeypatch.setattr(pocl, "REPAIRED", "OpenCL 3.0 PoCL 3.1")

    def touched(*_: Any) -> None:
        raise AssertionError("its structure is not known")

    monkeypatch.setattr(pocl, "_words", touched)
    pocl.repair(opencl.device)
    assert pocl.cpu(opencl.device) == ""


# ------------------------------------------------------------------------ Intel's runtime for CPUs


@pytest.fixture
def with_intel(monkeypatch, tmp_path) -> Path:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/libintelocl.so").touch()
    (tmp_path / "system").mkdir()
    (tmp_path / "system/other.icd").write_text("libother.so\n", encoding="utf-8")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(intel, "_SYSTEM", tmp_path / "system")
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    return tmp_path


def test_intels_runtime_is_named_to_the_loader_beside_the_systems_drivers(with_intel):
    with intel.known_to_loader():
        files = Path(os.environ["OCL_ICD_VENDORS"])
        named = {path.name: path.read_text("utf-8").strip() for path in files.iterdir()}
    assert named == {
        "other.icd": "libother.so",
        "gpuspec-intel.icd": str(with_intel / "lib/libintelocl.so"),
    }
    assert "OCL_ICD_VENDORS" not in os.environ


def test_a_user_who_chose_the_drivers_has_chosen_them(with_intel, monkeypatch):
    monkeypatch.setenv("OCL_ICD_VENDORS", "/elsewhere")
    with intel.known_to_loader():
        assert os.environ["OCL_ICD_VENDORS"] == "/elsewhere"


def test_where_intels_runtime_is_not_installed_nothing_is_changed(with_intel):
    (with_intel / "lib/libintelocl.so").unlink()
    with intel.known_to_loader():
        assert "OCL_ICD_VENDORS" not in os.environ


# ------------------------------------------------------------------------------------ cache folder


@pytest.fixture
def fresh_cache(monkeypatch):
    for cached in (cache.folder, cache._usual):
        cached.cache_clear()
    yield
    for cached in (cache.folder, cache._usual):
        cached.cache_clear()


def test_where_the_users_cache_cannot_be_written_a_folder_of_his_own_stands_in(
    monkeypatch, tmp_path, fresh_cache
):
    (tmp_path / "home").touch()  # a file: no folder can be made in it
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path))
    found = cache.folder()
    assert found == tmp_path / f"gpuspec-{os.getuid()}/gpuspec"
    assert found.parent.stat().st_mode & 0o077 == 0
    cache.lend()
    assert Path(os.environ["XDG_CACHE_HOME"]) == found.parent
    for cached in (cache.folder, cache._usual):
        cached.cache_clear()
    assert cache.folder() == found  # in a process that it starts, too


def test_a_folder_that_others_can_write_is_not_used(monkeypatch, tmp_path, fresh_cache):
    (tmp_path / "home").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path))
    (tmp_path / f"gpuspec-{os.getuid()}").mkdir()
    (tmp_path / f"gpuspec-{os.getuid()}").chmod(0o777)
    assert cache.folder() is None


def test_the_usual_cache_is_used_where_it_can_be(monkeypatch, tmp_path, fresh_cache):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.folder() == tmp_path / "gpuspec"
    cache.lend()
    assert os.environ["XDG_CACHE_HOME"] == str(tmp_path)


# ---------------------------------------------------------------------------------------- --test


def test_the_fastest_settings_are_taken_kernel_by_kernel():
    wide, narrow = ({"widths": dict.fromkeys(opencl_device.FILES, width)} for width in (8, 1))
    slow = dict.fromkeys(ROWS, 10.0)
    best, ms = fastest([(wide, slow), (narrow, {**slow, "closed form": 3.0, "trace": 9.5})])
    assert best["widths"] == {**wide["widths"], "aspect.cl": 1}
    assert ms == {**slow, "closed form": 3.0}
    assert {file for files in FILES.values() for file in files} == set(opencl_device.FILES)


@pytest.fixture
def small(monkeypatch):
    """A test of devices on few of the pixels, in this process: in seconds."""
    monkeypatch.setitem(speed.STATION, "camera", {"columns": 256, "rows": 64, "subsampling": 1})

    def ask(what: str, backend: Any, settings: Any) -> dict[str, Any]:
        engine = devices.opened(backend.info.backend, str(backend.number))
        engine.settle(settings)
        found: dict[str, Any] = {"difference_dn": proof.difference(engine)}
        return {**found, "ms": speed.measured(engine)} if what == "test" else found

    monkeypatch.setattr(proof, "ask", ask)


@pytest.mark.slow
def test_a_device_is_tested_in_a_process_of_its_own(opencl):
    found = proof.ask("test", open_backend("opencl"), opencl.candidates()[0])
    assert set(found["ms"]) == set(ROWS)


@pytest.mark.slow
def test_a_tests_report_holds_every_device_and_what_it_takes(gpuspec_, small, forgotten):
    ran = gpuspec_("devices", "--test", "--json")
    assert ran.code == 0, ran.err
    report = json.loads(ran.out)
    assert {one["backend"] for one in report["devices"]} == set(BACKENDS)
    for one in report["devices"]:
        assert one["computes"], one
        assert one["failure"] == ""
        assert 0 <= one["difference_dn"] <= proof.LARGEST_DN
        assert set(one["ms"]) == set(ROWS)
        assert min(one["ms"].values()) > 0
        assert one["copies"][COPY] == 1
        assert one["copies"]["trace"] == pytest.approx(one["ms"]["trace"] / one["ms"][COPY])
    reference = next(one for one in report["devices"] if one["backend"] == "numpy")
    assert reference["difference_dn"] == 0
    assert report["devices"][0]["ms"]["trace"] < reference["ms"]["trace"]


def _tested(number: int, failure: str) -> DeviceReport:
    info = opencl_device.DeviceInfo("opencl", f"device {number}", "driver", "1")
    ms = {} if failure else dict.fromkeys(ROWS, 2.0)
    found = Found("opencl", info, number, "", computes=True, chosen=not number)
    return DeviceReport(found, None if failure else 0.002, ms, {}, failure)


@pytest.mark.parametrize(("failing", "code"), [(0, 1), (1, 0)])
def test_a_test_ends_with_an_error_if_what_auto_chooses_fails(failing, code, gpuspec_, monkeypatch):
    results = [_tested(n, "it cannot add." if n == failing else "") for n in (0, 1)]
    monkeypatch.setattr(devices, "survey", lambda: [one.found for one in results])
    monkeypatch.setattr(devices, "tested", lambda found: results[found.number])
    ran = gpuspec_("devices", "--test")
    assert ran.code == code
    assert "it cannot add." in ran.out
    assert "0.00200 DN" in ran.out
    assert ("what auto chooses fails: it cannot add." in ran.err) is bool(code)


@dataclass(frozen=True)
class Lacking:
    """A device, of which something is not so."""

    device: Any
    changes: Mapping[str, int]

    def __getattr__(self, name: str) -> Any:
        return self.changes[name] if name in self.changes else getattr(self.device, name)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"available": 0}, "is not available"),
        ({"compiler_available": 0}, "has no compiler"),
        ({"local_mem_size": 1024}, "has 1,024 bytes of local memory"),
    ],
)
def test_a_device_that_cannot_compute_is_left_out_with_the_reason(
    opencl, monkeypatch, changes, said
):
    name = opencl.info.device
    lacking = Lacking(opencl.device, changes)
    monkeypatch.setattr(opencl_device, "devices", lambda: [lacking])
    with pytest.raises(DeviceError, match=re.escape(f"opencl: {name} {said}")):
        open_backend("opencl")
    monkeypatch.setattr(opencl_device, "devices", lambda: [lacking, opencl.device])
    with pytest.warns(DeviceWarning, match=said):
        assert open_backend("opencl").number == 1
