"""What the docstrings promise: every argument and error is told, and every example runs."""

from __future__ import annotations

import ast
import builtins
import doctest
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import gpuspec
from gpuspec import errors
from gpuspec.cli import study
from gpuspec.cli.main import app

PACKAGE = Path(gpuspec.__file__).parent
SOURCES = {
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): (
        path.read_text("utf-8")
    )
    for path in sorted(PACKAGE.rglob("*.py"))
    if path.name != "__main__.py"
}
"""Every module and its text."""
PROMPT = re.compile(r"^ *>>> ", re.MULTILINE)
TOLD_ELSEWHERE = re.compile(r"\ASee :|\b[Pp]arameters(?: and errors)? as (?::|there\b)")
OWN_ERRORS = tuple(name for name, value in vars(errors).items() if isinstance(value, type))
RAISED = {*OWN_ERRORS, "ValueError", "TypeError"}


class Definition(NamedTuple):
    """A function or method that others may call."""

    name: str
    function: Callable[..., Any]
    text: str

    @property
    def arguments(self) -> set[str]:
        names = list(inspect.signature(self.function).parameters)
        return set(names[1:] if names[:1] in (["self"], ["cls"]) else names)

    @property
    def raised(self) -> set[str]:
        """Errors that its own lines raise."""
        found = set()
        for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(self.function)))):
            made = node.exc if isinstance(node, ast.Raise) else None
            while isinstance(made, (ast.Call, ast.Attribute)):
                made = made.func if isinstance(made, ast.Call) else made.value
            if isinstance(made, ast.Name) and made.id in RAISED:
                found.add(made.id)
        return found

    def told(self, section: str) -> set[str]:
        """Return the names that a section of the docstring explains."""
        title = re.compile(rf"^{section}\n-+\n", re.MULTILINE)
        found = title.search(self.text)
        if not found:
            return set()
        lines = self.text[found.end() :].split("\n")
        ends = [i for i, line in enumerate(lines) if re.fullmatch("-{3,}", line)]
        heads = [line for line in lines[: ends[0] - 1 if ends else None] if line[:1].strip()]
        return {name.strip(" *`") for head in heads for name in head.split(" : ")[0].split(",")}


def unwrapped(member: object) -> Callable[..., Any] | None:
    """Return the function behind a method, property or decorator."""
    if isinstance(member, (staticmethod, classmethod)):
        member = member.__func__
    elif isinstance(member, property):
        member = member.fget
    elif isinstance(member, cached_property):
        member = member.func
    member = inspect.unwrap(member) if callable(member) else member
    return member if inspect.isfunction(member) else None


def members(module: str) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield the public functions of a module and the methods of its classes that are not told of
    in a base class or a protocol.
    """
    for name, value in vars(import_module(module)).items():
        if name.startswith("_") or getattr(value, "__module__", "") != module:
            continue
        if not isinstance(value, type):
            found = unwrapped(value)
            if found:
                yield name, found
            continue
        if getattr(value, "_is_protocol", False):
            continue
        for member, held in vars(value).items():
            found = unwrapped(held)
            told = any(member in vars(base) for base in value.__mro__[1:])
            if found and found.__module__ == module and not told and not member.startswith("_"):
                yield f"{name}.{member}", found


@cache
def definitions() -> tuple[Definition, ...]:
    """Return all that is public, but commands, whose options have their own help."""
    commands = {one.callback for one in (*app.registered_commands, *study.app.registered_commands)}
    return tuple(
        Definition(f"{module}.{name}", function, inspect.getdoc(function) or "")
        for module in SOURCES
        for name, function in members(module)
        if function not in commands
    )


def held(value: type) -> set[str]:
    """Return the public fields of a dataclass; of another class, none."""
    found = fields(value) if is_dataclass(value) else ()
    return {one.name for one in found if not one.name.startswith("_")}


def parents(error: str) -> set[str]:
    """Return the names by which an error can be told: its own and those of its kinds."""
    kind = getattr(errors, error, None) or getattr(builtins, error)
    return {base.__name__ for base in kind.__mro__}


def test_functions_and_methods_are_found_and_commands_left_to_their_own_help():
    names = {definition.name for definition in definitions()}
    assert len(names) > 400
    assert {
        "gpuspec.simulation.simulate.simulate",
        "gpuspec.station.station.Station.read",
        "gpuspec.light.light_map.LightMap.image",
        "gpuspec.sweeps.keeping.folder.RunFolder.writing",
        "gpuspec.part.relief.Relief.of",
    } <= names
    assert "gpuspec.light.opencl.OpenCLLightMap.mean" not in names
    assert "gpuspec.cli.simulate.simulate" not in names


def test_every_argument_of_two_or_more_is_told():
    wrong = []
    for one in definitions():
        told = one.told("Parameters")
        needed = one.arguments if len(one.arguments) > 1 else set()
        if told and told != one.arguments:
            wrong.append(f"{one.name}: {sorted(told ^ one.arguments)}")
        elif needed and not told and not TOLD_ELSEWHERE.search(one.text):
            wrong.append(f"{one.name}: no Parameters, takes {', '.join(sorted(needed))}")
    assert not wrong, "\n".join(wrong)


def test_every_field_of_a_dataclass_is_told() -> None:
    wrong, count = [], 0
    for module in SOURCES:
        for name, value in vars(import_module(module)).items():
            if name.startswith("_") or getattr(value, "__module__", "") != module:
                continue
            if isinstance(value, type) and is_dataclass(value):
                count += 1
                has = held(value)
                own = has.difference(*map(held, value.__mro__[1:]))  # a base tells its own
                told = Definition(name, value, inspect.getdoc(value) or "").told("Attributes")
                wrong += [] if own <= told <= has else [f"{module}.{name}: {sorted(own ^ told)}"]
    assert count > 50
    assert not wrong, "\n".join(wrong)


def test_every_error_that_is_raised_is_told():
    wrong = []
    for one in definitions():
        told = one.told("Raises")
        wrong += [
            f"{one.name}: {error} is not in Raises"
            for error in sorted(one.raised)
            if not told & parents(error) and not TOLD_ELSEWHERE.search(one.text)
        ]
        if re.search(rf"\b[Rr]aises? (?:{'|'.join(RAISED)})\b", one.text) and not told:
            wrong.append(f"{one.name}: says that it raises, and has no Raises")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "module", [module for module, text in SOURCES.items() if PROMPT.search(text)]
)
def test_every_example_prints_what_it_says(module: str, tmp_path: Path, monkeypatch) -> None:
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    said: list[str] = []
    lines = 0
    for found in doctest.DocTestFinder().find(import_module(module), module):
        folder = tmp_path / found.name
        folder.mkdir()
        monkeypatch.chdir(folder)
        found.globs = {"gpuspec": gpuspec, "np": np}
        lines += len(found.examples)
        runner.run(found, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
    written = len(PROMPT.findall(SOURCES[module]))
    assert lines == written, f"of {written} lines of examples only {lines} are found and run"
