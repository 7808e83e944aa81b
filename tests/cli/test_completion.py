"""Shell completion: asked for as a shell asks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commandline import DEADLINE_S

GPUSPEC = Path(sys.executable).with_name("gpuspec")


def ran(*arguments: str, **words: str) -> str:
    """What the program answers, called by its name as a shell calls it."""
    environment = {**os.environ, **words}
    return subprocess.run(
        [GPUSPEC, *arguments],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        timeout=DEADLINE_S,
    ).stdout


def completed(line: str) -> list[str]:
    """What bash offers at the end of a line."""
    place = str(len(line.split()) - 1)
    return ran(COMP_WORDS=line, COMP_CWORD=place, _GPUSPEC_COMPLETE="complete_bash").split()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("gpuspec sim", ["simulate"]),
        ("gpuspec simulate --back", ["--backend"]),
        ("gpuspec simulate --backend open", ["opencl", "opengl"]),
        ("gpuspec simulate --set tunnel.he", ["tunnel.height_mm="]),
        ("gpuspec demo m", ["measured"]),
        ("gpuspec init --example t", ["trim"]),
        ("gpuspec prototype --pattern w", ["warped"]),
        ("gpuspec reference camera.s", ["camera.sampling_mm", "camera.subsampling"]),
        ("gpuspec study cov", ["coverage"]),
    ],
)
def test_tab_completes_what_the_program_knows(line, offered):
    assert completed(line) == offered


def test_the_script_for_a_shell_is_shown():
    # It asks which shell it was started from; without the exit bash would turn into the program.
    command = ["bash", "-c", '"$0" --show-completion; exit $?', GPUSPEC]
    shown = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=DEADLINE_S
    ).stdout
    assert "complete -o default -F _gpuspec_completion gpuspec" in shown
