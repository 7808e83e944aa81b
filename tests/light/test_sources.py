"""The kernels' text: includes resolved, errors where they are, and only what GLSL shares."""

from __future__ import annotations

import itertools
import re
import shutil

import pytest

from gpuspec.errors import BackendError
from gpuspec.light import sources
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.sources import kernel_source, resolved

KERNELS = sources.folder("kernels")
FILES = sorted(path.name for path in KERNELS.iterdir() if path.suffix in (".h", ".cl"))
PROGRAMS = [name for name in FILES if name.endswith(".cl")]
# `portable.h` is where the languages differ, so it alone may name what only one of them has.
SHARED = [name for name in FILES if name.endswith(".h") and name != "portable.h"]

ADDRESS_SPACES = (
    "__global", "__local", "__constant", "__private", "global", "local", "constant", "private",
)  # fmt: skip

# The GLSL Language Specification, version 4.60, section 3.6: keywords and words reserved for later.
GLSL_OWNS = set(
    """
attribute varying uniform buffer shared layout centroid flat smooth noperspective patch sample
coherent volatile restrict readonly writeonly invariant precise subroutine in out inout discard
lowp mediump highp precision mat2 mat3 mat4 vec2 vec3 vec4 ivec2 ivec3 ivec4 uvec2 uvec3 uvec4
bvec2 bvec3 bvec4 dvec2 dvec3 dvec4 sampler1D sampler2D sampler3D samplerCube image1D image2D
image3D atomic_uint common partition active asm class union enum typedef template this resource
goto inline noinline public static extern external interface long short half fixed unsigned superp
input output hvec2 hvec3 hvec4 fvec2 fvec3 fvec4 filter sizeof cast namespace using row_major
""".split()  # noqa: SIM905 - a list of 130 quoted words is no easier to read
)

PLAIN = {
    "vector", "inner", "scaled", "flat_surface", "add_surface", "nearer", "spline_sum",
    "hit_tunnel",
}  # fmt: skip

COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])(?:\d+\.\d*|\.\d+|\d+(?=[eE][-+\d]))(?:[eE][-+]?\d+)?\w*")


def code(name: str) -> str:
    """A kernel file without its comments, line for line."""
    text = (KERNELS / name).read_text(encoding="utf-8")
    return COMMENT.sub(lambda found: "\n" * found[0].count("\n"), text)


def shared_code(name: str) -> str:
    """What GLSL too sees of a header, without its comments."""
    return re.sub(r"#ifndef GPUSPEC_GLSL\n.*?\n#endif\n", "", code(name), flags=re.DOTALL)


def words(text: str) -> set[str]:
    return set(re.findall(r"[A-Za-z_]\w*", text))


def lone_doubles(text: str) -> list[str]:
    return [number for number in NUMBER.findall(text) if not number.endswith("f")]


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """A copy of the kernels to break."""
    copy = tmp_path / "kernels"
    shutil.copytree(KERNELS, copy)
    monkeypatch.setattr(sources, "folder", lambda name: tmp_path / name)
    return copy


def errors_of(backend: OpenCLBackend, text: str, name: str) -> str:
    with pytest.raises(BackendError) as raised:
        backend.program(resolved(text, f"kernels/{name}"), name)
    return str(raised.value)


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_include_is_resolved_once(name):
    text = kernel_source(name)
    assert "#include" not in text
    wanted = re.findall(r'#include "([^"]+)"', (KERNELS / name).read_text(encoding="utf-8"))
    assert wanted
    for header in wanted:
        assert text.count(f'#line 1 "kernels/{header}"') == 1


def test_a_header_included_twice_is_there_once(kernels):
    (kernels / "stripes.h").write_text('#include "portable.h"\nfloat stripes;\n')
    text = resolved('#include "portable.h"\n#include "stripes.h"\n#include "portable.h"\n', "a.cl")
    assert text.count("#define PORTABLE_H") == 1
    assert text.count("float stripes;") == 1


@pytest.mark.parametrize("header", ["portable.h", "station.h", "stripes.h"])
def test_an_error_in_a_header_is_reported_there(opencl, kernels, header):
    lines = (kernels / header).read_text(encoding="utf-8").splitlines()
    lines.append("float broken = nothing_of_that_name;")
    (kernels / header).write_text("\n".join(lines), encoding="utf-8")
    told = errors_of(opencl, (kernels / "aspect.cl").read_text(encoding="utf-8"), "aspect.cl")
    assert f"kernels/{header}:{len(lines)}:" in told
    assert "nothing_of_that_name" in told


@pytest.mark.parametrize("after", ["stripes.h", "portable.h"])
def test_an_error_below_the_includes_is_reported_there(opencl, after):
    # The header included a second time leaves no text, yet must not move the lines below it.
    text = '#include "portable.h"\n#include "station.h"\n'
    text += f'\n#include "{after}"\n\nfloat broken = nothing_of_that_name;\n'
    assert "kernels/aspect.cl:6:" in errors_of(opencl, text, "aspect.cl")


@pytest.mark.parametrize("name", FILES)
def test_every_literal_is_a_float(name):
    # PoCL takes a literal without f as a double in silence; a GPU may refuse it.
    assert lone_doubles(code(name)) == []
    assert not {"double", "double2", "double4", "double8"} & words(code(name))


def test_the_check_of_literals_sees_doubles():
    text = "a = 2.0; b = 2.f; c = .5; d = 1e-3; e = 0.25f; f = 1e-3f; g = v.x2; h = 3; i = 7.;"
    assert lone_doubles(text) == ["2.0", ".5", "1e-3", "7."]


@pytest.mark.parametrize("name", SHARED)
def test_shared_headers_know_no_address_space(name):
    assert not words(shared_code(name)) & set(ADDRESS_SPACES)


@pytest.mark.parametrize("name", SHARED)
def test_shared_headers_use_no_name_that_glsl_owns(name):
    found = words(shared_code(name))
    assert not found & GLSL_OWNS
    assert not {word for word in found if "__" in word or word.startswith("gl_")}


@pytest.mark.parametrize("name", SHARED)
def test_shared_headers_point_at_nothing(name):
    # Structs are returned; GLSL has no pointers.
    text = shared_code(name)
    assert "->" not in text
    assert not re.search(r"\b(?:REAL|float\d?|int|[A-Z]\w+)\s*\*\s*\w+\s*[,)=;]", text)


@pytest.mark.parametrize("name", SHARED)
def test_every_device_function_says_its_law(name):
    # Above itself, or above the struct it returns; what its name says whole needs no more.
    lines = (KERNELS / name).read_text(encoding="utf-8").splitlines()
    said = {line for above, line in itertools.pairwise(lines) if above.endswith("*/")}
    silent = []
    for line in lines:
        function = re.match(r"DEVICE (\w+) (\w+)\(", line)
        if function and line not in said and f"STRUCT({function[1]}) {{" not in said:
            silent.append(function[2])
    assert set(silent) <= PLAIN


def test_instructions_of_one_processor_stand_where_the_compiler_has_them():
    # Clang knows a built-in of AVX on every x86, and fails only where it is used without.
    opened: list[str] = []
    used = 0
    for line in code("portable.h").splitlines():
        words_ = line.split()
        if line.startswith("#if"):
            opened.append(line)
        elif words_[:1] == ["#endif"]:
            opened.pop()
        elif "__builtin_ia32_" in line:
            used += 1
            assert any("defined(__AVX__)" in condition for condition in opened)
    assert used
