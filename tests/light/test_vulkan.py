"""What is special to Vulkan: adapters and their choice, absence, its compiler's messages."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import wgpu
import wgpu.backends.wgpu_native  # now: importing it later replaces wgpu.gpu
from commandline import DEADLINE_S
from scenes import check_station

from gpuspec.errors import BackendError
from gpuspec.light.devices import open_backend
from gpuspec.light.sources import folder, resolved_shader
from gpuspec.light.vulkan import VulkanBackend, describe, preferred


@pytest.fixture(scope="module")
def backend() -> VulkanBackend:
    return VulkanBackend()


def adapter_info(backend_type: str, adapter_type: str, device: str = "a GPU") -> dict[str, Any]:
    return {
        "backend_type": backend_type, "adapter_type": adapter_type, "device": device,
        "description": "driver 1.2", "vendor": "a vendor",
    }  # fmt: skip


DISCRETE = adapter_info("Vulkan", "DiscreteGPU")
INTEGRATED = adapter_info("Vulkan", "IntegratedGPU")
SOFTWARE = adapter_info("Vulkan", "CPU")
VIRTUAL = adapter_info("Vulkan", "Unknown")
METAL = adapter_info("Metal", "IntegratedGPU")
DIRECT3D = adapter_info("D3D12", "DiscreteGPU")
OPENGL = adapter_info("OpenGL", "DiscreteGPU")


@pytest.mark.parametrize(
    ("infos", "order"),
    [
        ([SOFTWARE, INTEGRATED, DISCRETE], [2, 1, 0]),
        ([VIRTUAL, SOFTWARE], [1, 0]),
        ([DISCRETE, DISCRETE], [0, 1]),
        ([OPENGL, SOFTWARE], [1]),
        ([DIRECT3D, SOFTWARE], [1]),
        ([OPENGL, METAL], [1]),
        ([OPENGL, DIRECT3D], [1]),
        ([OPENGL], []),
        ([], []),
    ],
)
def test_vulkan_goes_before_other_interfaces_and_gpus_before_cpus(infos, order):
    assert preferred(infos) == order


def test_metal_and_direct3d_are_said_to_be_what_they_are():
    assert describe(METAL).driver == "Metal through wgpu"
    assert describe(DIRECT3D).driver == "D3D12 through wgpu"
    assert describe(DISCRETE).driver == "driver 1.2"
    assert describe(METAL).version == f"Metal, wgpu {wgpu.__version__}"
    silent = {**DISCRETE, "description": "", "vendor": ""}
    assert all(describe(silent).as_dict().values())


def test_without_wgpu_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "wgpu", None)
    with pytest.raises(BackendError, match=r"wgpu cannot be imported.*pip install wgpu"):
        open_backend("vulkan")


@pytest.mark.parametrize("found", [[], [SimpleNamespace(info=OPENGL)]])
def test_without_a_driver_it_is_said_what_to_install(monkeypatch, found):
    monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", lambda: found)
    with pytest.raises(BackendError, match=r"no Vulkan .*apt install mesa-vulkan-drivers libvulk"):
        open_backend("vulkan")


def test_a_loader_that_fails_is_quoted(monkeypatch):
    def fail() -> None:
        raise RuntimeError("libvulkan.so.1 is no library")

    monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", fail)
    with pytest.raises(BackendError, match=r"libvulkan\.so\.1 is no library.*apt install"):
        open_backend("vulkan")


def test_a_device_that_does_not_open_is_named(monkeypatch):
    def fail(**_: Any) -> None:
        raise RuntimeError("lost")

    adapter = SimpleNamespace(info=DISCRETE, limits={}, request_device_sync=fail)
    monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", lambda: [adapter])
    with pytest.raises(BackendError, match=r"vulkan: a GPU does not open \(lost\)"):
        open_backend("vulkan")


def test_a_machine_without_drivers_gets_a_sentence():
    # In a process of its own: the loader reads the names of drivers once.
    code = (
        "import gpuspec.light.devices as b\ntry: b.open_backend('vulkan')\n"
        "except b.BackendError as error: print(error)"
    )
    none = {"VK_ICD_FILENAMES": os.devnull, "VK_DRIVER_FILES": os.devnull}
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **none},
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
    )
    assert ran.returncode == 0, ran.stderr
    assert "no Vulkan loader or device found" in ran.stdout
    assert "apt install" in ran.stdout


@pytest.mark.slow
def test_opening_is_silent_and_leaves_the_environment_alone():
    code = (
        "import os, gpuspec.light.devices as b; before = dict(os.environ)\n"
        "b.open_backend('vulkan')\n"
        "assert dict(os.environ) == before"
    )
    env = {name: value for name, value in os.environ.items() if name != "XDG_RUNTIME_DIR"}
    ran = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=DEADLINE_S
    )
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")


SHADER = """#include "portable.h"
#include "station.h"
#include "surface.h"
layout(local_size_x = 1) in;
layout(std430, set = 0, binding = 0) buffer Out { float values[]; };
void main() {
    WRONG
}
"""


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ("values[0] = unheard;", "unheard"),
        ("values[0] = (1.0;", "InvalidToken"),
        ("values[0] = flat_surface(1.0).height;", "flat_surface"),
    ],
)
def test_a_shader_that_does_not_compile_names_file_and_line(backend, wrong, reason):
    text, names = resolved_shader(SHADER.replace("WRONG", wrong), "shaders/mine.comp", 450)
    with pytest.raises(BackendError, match=rf"shaders/mine\.comp:7: .*{reason}") as raised:
        backend.program(text, names, ("storage",))
    assert "does not build with vulkan on" in str(raised.value)


def test_a_fault_in_a_header_is_found_there(backend):
    text, names = resolved_shader(SHADER.replace("WRONG", ""), "shaders/mine.comp", 450)
    text = text.replace("s.slope_y = -(cy * y) / qy;", "s.slope_y = -(cy * y) / unheard;")
    lines = (folder("kernels") / "surface.h").read_text()
    line = 1 + lines[: lines.index("s.slope_y = -(cy * y)")].count("\n")
    with pytest.raises(BackendError, match=rf"kernels/surface\.h:{line}: .*unheard"):
        backend.program(text, names, ("storage",))


def test_what_the_validator_says_is_kept(backend):
    text, names = resolved_shader(
        "layout(local_size_x = 1) in; float f() { } void main() { f(); }", "shaders/mine.comp", 450
    )
    with pytest.raises(BackendError, match=r"(?s)shaders/mine\.comp does not build.*return"):
        backend.program(text, names, ())


def test_a_light_map_larger_than_a_binding_is_done_in_tiles(backend, monkeypatch):
    station = check_station(camera__subsampling=3)
    whole = backend.trace(station)
    monkeypatch.setitem(backend.limits, "max-storage-buffer-binding-size", 20_000)
    tiled = backend.trace(station)
    assert (whole.tiles, tiled.tiles) == (1, 8)
    assert np.array_equal(tiled.mean(), whole.mean())
    assert np.array_equal(tiled.read().light_mm, whole.read().light_mm)


def test_a_relief_larger_than_a_binding_is_refused_in_a_sentence(backend, monkeypatch):
    monkeypatch.setitem(backend.limits, "max-storage-buffer-binding-size", 40)
    with pytest.raises(BackendError, match="48 bytes exceed the 40 that"):
        backend.trace(check_station())


@pytest.mark.parametrize(
    ("error", "words"),
    [(wgpu.GPUOutOfMemoryError, "is out of memory .*sampling_mm"), (wgpu.GPUError, "failed")],
)
def test_a_device_that_fails_says_so_in_a_sentence(backend, monkeypatch, error, words):
    light_map = backend.trace(check_station())

    def full(size: int) -> None:
        raise error("no more")

    monkeypatch.setattr(backend, "empty", full)
    for method in (light_map.aspect, lambda: backend.trace(light_map.station)):
        with pytest.raises(BackendError, match=words):
            method()
