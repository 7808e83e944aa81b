"""The only reader of `kernels/` and `shaders/`: source text with its includes resolved."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')


def folder(name: str) -> Path:
    """Return the folder of `kernels` or `shaders`: inside the installed package, or beside it."""
    inside = Path(__file__).parent / name
    return inside if inside.is_dir() else Path(__file__).parent.parent / name


@cache
def kernel_source(name: str) -> str:
    """Return an OpenCL C file of `kernels/` with every include in place, once each.

    ``#line`` directives keep file and line in the compiler's messages.
    """
    return resolved((folder("kernels") / name).read_text(encoding="utf-8"), f"kernels/{name}")


def resolved(text: str, name: str) -> str:
    """Return OpenCL C text with every include of `kernels/` in place; `name` is for messages."""
    return "\n".join(_resolved(folder("kernels"), text, name, set()))


def _resolved(where: Path, text: str, name: str, seen: set[str]) -> list[str]:
    lines = [f'#line 1 "{name}"']
    for number, line in enumerate(text.splitlines(), 1):
        include = _INCLUDE.match(line)
        if include is None:
            lines.append(line)
        elif include[1] not in seen:
            seen.add(include[1])
            included = (where / include[1]).read_text(encoding="utf-8")
            lines += _resolved(where, included, f"kernels/{include[1]}", seen)
            lines.append(f'#line {number + 1} "{name}"')
        else:
            lines.append("")
    return lines
