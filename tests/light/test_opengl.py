"""The OpenGL backend's own: what is said when it is absent, its errors, its contexts."""

from __future__ import annotations

import gc
import sys

import moderngl
import numpy as np
import pytest
from scenes import check_station

from gpuspec.errors import BackendError
from gpuspec.light.devices import open_backend, survey
from gpuspec.light.opengl import OpenGLBackend
from gpuspec.light.sources import folder, resolved_shader


@pytest.fixture(scope="module")
def opengl() -> OpenGLBackend:
    return OpenGLBackend()


def test_without_moderngl_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "moderngl", None)
    with pytest.raises(BackendError, match=r'moderngl cannot be imported.*"gpuspec\[opengl\]"'):
        open_backend("opengl")


def test_without_a_driver_every_way_says_its_reason_and_what_to_install(monkeypatch):
    def fail(**way: object) -> None:
        raise Exception("libEGL.so not loaded" if "backend" in way else "cannot open display")

    monkeypatch.setattr(moderngl, "create_context", fail)
    told = r"egl: libEGL.so not loaded; default: cannot open display.*libegl1 libgl1-mesa-dri"
    with pytest.raises(BackendError, match=told):
        open_backend("opengl")
    (absent,) = (entry for entry in survey() if entry.backend == "opengl")
    assert absent.info is None
    assert "libegl1" in absent.remark


def test_where_egl_fails_the_platform_s_own_context_serves(monkeypatch):
    create, asked = moderngl.create_context, []

    def without_egl(**way: object) -> moderngl.Context:
        asked.append(way.pop("backend", "default"))
        way.pop("device_index", None)
        if asked[-1] == "egl":
            raise Exception("no EGL")
        return create(**way, backend="egl")

    monkeypatch.setattr(moderngl, "create_context", without_egl)
    assert open_backend("opengl").info.backend == "opengl"
    assert asked == ["egl", "default"]


def test_a_driver_without_float_targets_is_refused(monkeypatch):
    def incomplete(*_: object) -> None:
        raise moderngl.Error("the framebuffer is not complete")

    monkeypatch.setattr(moderngl.Context, "framebuffer", incomplete)
    with pytest.raises(BackendError, match=r"cannot draw into float targets .*libgl1-mesa-dri"):
        OpenGLBackend()


@pytest.mark.parametrize("code", ["GL_OUT_OF_MEMORY", "GL_INVALID_OPERATION"])
def test_a_driver_that_fails_says_so_in_a_sentence(opengl, monkeypatch, code):
    monkeypatch.setattr(moderngl.Context, "error", code)
    told = (
        "is out of memory .*; use a larger" if "MEMORY" in code else f"failed .{code}.; try another"
    )
    with pytest.raises(BackendError, match=told):
        opengl.trace(check_station())


def test_a_relief_larger_than_a_texture_is_refused(opengl):
    many = np.broadcast_to(np.float32(0), opengl.texture_size * 4096 + 1)
    with pytest.raises(BackendError, match=rf"{len(many):,} values of relief .*--backend opencl"):
        opengl.listed(many)


@pytest.mark.parametrize("header", ["portable.h", "station.h", "stripes.h"])
def test_an_error_after_a_header_is_reported_where_it_is(opengl, header):
    lines = ['#include "portable.h"', f'#include "{header}"', "", "float broken = nothing_so;"]
    text, names = resolved_shader("\n".join(lines), "own.frag", 330)
    with pytest.raises(BackendError, match=r"own\.frag:4: .*nothing_so"):
        opengl.build(text, names)


def test_an_error_in_a_header_is_reported_there(opengl):
    text, names = resolved_shader('#include "portable.h"\n#include "stripes.h"\n', "own.frag", 330)
    where = (folder("kernels") / "stripes.h").read_text("utf-8").splitlines()
    line = next(i for i, words in enumerate(where, 1) if "REAL centre = " in words)
    broken = text.replace("REAL centre = (light", "REAL centre = (nothing_so")
    with pytest.raises(BackendError, match=rf"kernels/stripes\.h:{line}: .*nothing_so"):
        opengl.build(broken, names)


def test_contexts_do_not_disturb_one_another(opengl):
    light_map = opengl.trace(check_station())
    expected = light_map.mean()
    other = OpenGLBackend()
    traced = other.trace(check_station(exposure=2.0))
    assert np.array_equal(light_map.mean(), expected)
    assert not np.array_equal(traced.mean(), expected)
    del other, traced
    gc.collect()
    assert np.array_equal(light_map.mean(), expected)
