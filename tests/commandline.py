"""The command line as tests run it: in this process, or as a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpuspec.files import MANIFEST, Outputs

UNKNOWN_CPU = {"PYTHONPATH": str(Path(__file__).parent / "unknown_cpu")}
"""In such a process PoCL reports a CPU that its compiler does not know, on any machine."""
STATION = """
[part]
length_mm = 12.0
width_mm = 6.0
[camera]
sampling_mm = 0.1
[sequence]
images = 5
[[defects]]
kind = "dent"
x_mm = 2.0
y_mm = -1.0
diameter_mm = 0.8
depth_um = 8.0
"""
PROGRAM = [sys.executable, "-m", "gpuspec"]
DEADLINE_S = 300.0
"""After which a process that a test started has failed, however busy the machine."""


@dataclass(frozen=True)
class Ran:
    """What a command answered."""

    code: int
    out: str
    err: str


Command = Callable[..., Ran]


def program(*arguments: object, cwd: Path, **options: Any) -> Ran:
    """The command as a process of its own."""
    environment = {**os.environ, "COLUMNS": "200", **options.pop("env", {})}
    path = environment.get("PYTHONPATH"), str(Path(__file__).parents[1])  # that of this checkout
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, path))
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)], capture_output=True, text=True, cwd=cwd,
        env=environment, errors="surrogateescape", **{"timeout": DEADLINE_S, **options},
    )  # fmt: skip
    return Ran(done.returncode, done.stdout, done.stderr)


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def names(folder: Path) -> set[str]:
    """What a command left to look at: without the manifest."""
    return {path.name for path in folder.iterdir()} - {MANIFEST}


def hidden(folder: Path) -> list[Path]:
    return list(folder.rglob(".gpuspec-*"))


def earlier_run(folder: Path, files: tuple[str, ...]) -> None:
    """Leave a folder as a run does, with words in place of images."""
    with Outputs(folder, "run", files).writing() as partial:
        for name in files:
            (partial / name).write_text(f"earlier {name}", encoding="utf-8")


def said(ran: Ran) -> str:
    """The one thing a failed command says: a sentence, and nothing else."""
    assert ran.code == 1
    assert ran.out == ""
    assert "Traceback" not in ran.err
    assert ran.err.startswith("error: ")
    text = ran.err.removeprefix("error: ").rstrip("\n")
    assert text.endswith((".", "?")), text
    return text
