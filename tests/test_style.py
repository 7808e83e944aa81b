"""Style and types: what ruff and mypy say of the whole checkout."""

from __future__ import annotations

import subprocess
import sys

import pytest
from commandline import DEADLINE_S
from documents import CHECKOUT


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["ruff check .", "ruff format --check .", "mypy"])
def test_style_and_types_are_as_agreed(tool: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", *tool.split()], cwd=CHECKOUT, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, timeout=DEADLINE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
