"""Constants that Python and the programs on a device share: told once."""

from __future__ import annotations

import re

import pytest

from gpuspec.arrays import BESIDE, LOST, Lost
from gpuspec.light import sources
from gpuspec.light.constants import DEFINES, defines
from gpuspec.light.sources import folder, kernel_source, resolved_shader, shader_source

FILES = [
    path
    for name in ("kernels", "shaders")
    for path in sorted(folder(name).rglob("*.*"))
    if path.suffix != ".md"
]
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


def code_of(path):
    return COMMENT.sub("", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_no_program_gives_a_shared_constant_a_value_of_its_own(path):
    found = re.findall(r"#define\s+(\w+)|\b(?:const|enum)\b[^;]*?\b(\w+)\s*=", code_of(path))
    assert not {name for pair in found for name in pair} & DEFINES.keys()


# A tunnel of none of the other sections is a ceiling: no program asks for it.
@pytest.mark.parametrize("name", sorted(DEFINES.keys() - {"SECTION_CEILING"}))
def test_every_shared_constant_is_used_by_a_program(name):
    assert any(re.search(rf"\b{name}\b", code_of(path)) for path in FILES)


@pytest.mark.parametrize("file", ["trace.cl", "sequence.cl", "sweep.cl"])
def test_a_program_defines_the_constants_it_names_and_no_others(file):
    text = kernel_source(file)
    defined = {line.split()[1] for line in text.splitlines() if line.startswith("#define")}
    named = set(re.findall(r"\w+", COMMENT.sub("", text)))
    assert {name for name in DEFINES if name in named} == defined & DEFINES.keys()


def test_a_word_that_is_given_stands_in_the_place_of_a_constant():
    text, _ = shader_source("trace.comp", 450, ("NEWTON_STEPS 0",))
    assert re.findall(r"#define NEWTON_STEPS (\w+)", text) == ["0"]
    text, _ = shader_source("trace.comp", 450)
    assert re.findall(r"#define NEWTON_STEPS (\w+)", text) == [DEFINES["NEWTON_STEPS"]]


def test_the_names_of_a_pattern_are_its_own():
    pattern = "mine.glsl", "const int LEVELS = 4; float pattern(float a) { return float(LEVELS); }"
    text, _ = resolved_shader('#include "pattern.glsl"\n', "own.frag", 330, pattern=pattern)
    assert "const int LEVELS = 4" in text
    assert "#define LEVELS" not in text


def test_a_changed_constant_is_another_program(monkeypatch):
    # What is known of a device holds for the programs it was tried with.
    sources.digest.cache_clear()
    before = sources.digest()
    monkeypatch.setitem(DEFINES, "NEWTON_STEPS", "9")
    sources.digest.cache_clear()
    after = sources.digest()
    monkeypatch.undo()
    sources.digest.cache_clear()
    assert before != after
    assert sources.digest() == before


def test_every_reason_of_loss_has_its_words_and_its_name_in_the_programs():
    assert len(LOST) == len(Lost)
    assert [Lost(i).value for i in range(len(LOST))] == list(range(len(LOST)))
    assert LOST[BESIDE] == "beside the part"
    assert defines("LOST_END == LOST_NOT") == ["#define LOST_NOT 0.0f", "#define LOST_END 3.0f"]
