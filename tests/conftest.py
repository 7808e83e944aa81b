"""Fixtures: every backend there is, and no test passed over in silence."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from commandline import STATION, Command, Ran

from gpuspec.cli import main as cli
from gpuspec.errors import BackendError
from gpuspec.light.backend import Backend
from gpuspec.light.devices import BACKENDS, open_backend
from gpuspec.light.opencl import OpenCLBackend


@pytest.fixture(scope="session", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return open_backend(request.param)


@pytest.fixture(scope="session", params=[name for name in BACKENDS if name != "numpy"])
def device_backend(request: pytest.FixtureRequest) -> Backend:
    """Every backend but the reference."""
    return open_backend(request.param)


@pytest.fixture(scope="session")
def opencl() -> OpenCLBackend:
    found = open_backend("opencl")
    assert isinstance(found, OpenCLBackend)
    return found


@pytest.fixture
def gpuspec_(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Iterator[Command]:
    """The command in this process, in an empty folder with a station file."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    Path("s.toml").write_text(STATION, encoding="utf-8")
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def run(*arguments: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["gpuspec", *map(str, arguments)])
        code: Any = 0
        try:
            cli.main()
        except SystemExit as stop:
            code = stop.code or 0
        return Ran(code, *capsys.readouterr())

    yield run
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty folder with a station file, for processes."""
    (tmp_path / "s.toml").write_text(STATION, encoding="utf-8")
    return tmp_path


LONGEST = ("test_machines.py", "test_readme.py", "test_style.py")
"""Files of a minute or more: environments set up, every command of the chapters, mypy."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Workers begin with what takes longest, so that the others fill up the time beside it.

    Without a driver the tests of its backend are skipped, or fail where none may be absent.
    """
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: item.path.name not in LONGEST)
    if os.environ.get("GPUSPEC_NO_SKIPS"):
        return
    for name in ("opengl", "vulkan"):
        try:
            open_backend(name)
        except BackendError as error:
            for item in items:
                if name in item.nodeid:
                    item.add_marker(pytest.mark.skip(reason=str(error)))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Where all backends must be present, a skipped test is a failed one."""
    skipped = terminalreporter.stats.get("skipped", [])
    if skipped and os.environ.get("GPUSPEC_NO_SKIPS"):
        terminalreporter.write_line(f"{len(skipped)} skipped tests count as failed here", red=True)
        terminalreporter._session.exitstatus = pytest.ExitCode.TESTS_FAILED
