"""The only reader of `kernels/` and `shaders/`: source text with its includes resolved."""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path

from gpuspec.light.constants import DEFINES, defines

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_LINE = re.compile(r"^#line (\d+) (\d+)$", re.MULTILINE)
_PLACE = re.compile(r"^((?:ERROR: |WARNING: )?)\d+[:(](\d+)(?:\(\d+\)|\))?\s*:", re.MULTILINE)
# The line after a pattern: text that is not finished is met here, not in the program's own lines.
_CLOSED = "void end_of_pattern_() { }"
_STRUCT = re.compile(r"RECORD\((\w+)\) \{(.*?)\};", re.DOTALL)
_MEMBER = re.compile(r"^ *float (\w+);", re.MULTILINE)
_FILE = 100_000  # lines of a file, at most


def folder(name: str) -> Path:
    """Return the folder of `kernels` or `shaders`: inside the installed package, or beside it."""
    package = Path(__file__).parents[1]
    return package / name if (package / name).is_dir() else package.parent / name


@cache
def digest() -> str:
    """Return a digest of every kernel and shader, and of the constants defined in them."""
    found = hashlib.sha256(repr(DEFINES).encode())
    for name in ("kernels", "shaders"):
        for path in sorted(folder(name).rglob("*.*")):
            found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()


@cache
def structs() -> dict[str, tuple[str, ...]]:
    """Return the structs of `kernels/station.h` and the names of their members, in order."""
    text = (folder("kernels") / "station.h").read_text(encoding="utf-8")
    return {name: tuple(_MEMBER.findall(body)) for name, body in _STRUCT.findall(text)}


@cache
def kernel_source(name: str) -> str:
    """Return an OpenCL C file of `kernels/` with every include in place, once each.

    ``#line`` directives keep file and line in the compiler's messages.
    """
    return resolved((folder("kernels") / name).read_text(encoding="utf-8"), f"kernels/{name}")


def resolved(text: str, name: str) -> str:
    """Return OpenCL C text with every include of `kernels/` in place.

    The constants that it names are defined.

    Parameters
    ----------
    text : str
    name : str
        Of its file, for messages.
    """
    body = _resolved(text, name, {}, '#line {line} "{name}"')
    return "\n".join([*defines("\n".join(body)), *body])


@cache
def shader_source(
    name: str,
    version: int,
    words: tuple[str, ...] = (),
    pattern: tuple[str, str] | None = None,
) -> tuple[str, tuple[str, ...]]:
    """Return a GLSL file of `shaders/` by its `name` there, ready to compile.

    What is returned, and the other parameters as :func:`resolved_shader`.
    """
    text = (folder("shaders") / name).read_text(encoding="utf-8")
    return resolved_shader(text, f"shaders/{name}", version, words, pattern)


def resolved_shader(
    text: str,
    name: str,
    version: int,
    words: tuple[str, ...] = (),
    pattern: tuple[str, str] | None = None,
) -> tuple[str, tuple[str, ...]]:
    """Return GLSL text with every include of `shaders/` and `kernels/` in place, once each.

    The constants that it names are defined; ``#line`` keeps file and line, the files by number.

    Parameters
    ----------
    text : str
        Without ``#version``.
    name : str
        For messages.
    version : int
        Of the language, e.g. 330.
    words : tuple of str
        Words to define, e.g. ``"NOISE"`` or ``"NEWTON_STEPS 0"``.
    pattern : tuple of str, optional
        File name and text of a user's own, in place of ``#include "pattern.glsl"``.

    Returns
    -------
    text : str
    names : tuple of str
        The files by their number; `named_files` puts them into a compiler's messages.
    """
    names: dict[str, int] = {}
    body = _resolved(text, name, names, "#line {line} {number}", pattern)
    own = "\n".join(_resolved(text, name, {}, ""))  # what a pattern names is its own
    given = [f"#define {word}" for word in ("GPUSPEC_GLSL", *words)]
    head = [f"#version {version}", *given, *defines(own, words)]
    return "\n".join([*head, *body, ""]), tuple(names)


def numbered_lines(text: str) -> str:
    """Return GLSL text whose lines carry their file's number: Mesa forgets that of ``#line``."""
    return _LINE.sub(lambda found: f"#line {int(found[2]) * _FILE + int(found[1])}", text)


def named_files(log: str, names: tuple[str, ...]) -> str:
    """Return the compiler's messages on `numbered_lines` with file and line.

    Mesa writes ``0:12(5): error``, NVIDIA ``0(12) : error``, Apple ``ERROR: 0:12:``.

    Parameters
    ----------
    log : str
    names : tuple of str
        Of the files by number, as :func:`shader_source` returns them.
    """

    def name(found: re.Match[str]) -> str:
        file, line = divmod(int(found[2]), _FILE)
        return f"{found[1]}{names[file]}:{line}:" if file < len(names) else found[0]

    return _PLACE.sub(name, log)


def _resolved(
    text: str,
    name: str,
    seen: dict[str, int],
    directive: str,
    pattern: tuple[str, str] | None = None,
) -> list[str]:
    """Text line by line; `seen` numbers the files, `directive` says where a line is from."""
    number = seen.setdefault(name, len(seen))

    def here(line: int) -> list[str]:
        return [directive.format(line=line, number=number, name=name)] if directive else []

    lines = here(1)
    for at, line in enumerate(text.splitlines(), 1):
        include = _INCLUDE.match(line)
        if include is None:
            lines.append(line)
            continue
        where = "shaders" if include[1].endswith(".glsl") else "kernels"
        included = f"{where}/{include[1]}"
        if include[1] == "pattern.glsl":
            if pattern is not None:
                lines += _resolved(f"{pattern[1].rstrip()}\n{_CLOSED}", pattern[0], seen, directive)
                lines += here(at + 1)
        elif included not in seen:
            header = (folder(where) / include[1]).read_text(encoding="utf-8")
            lines += _resolved(header, included, seen, directive, pattern)
            lines += here(at + 1)
        else:
            lines.append("")
    return lines
