"""Fixtures: every backend there is, and no test passed over in silence."""

from __future__ import annotations

import os

import pytest

from gpuspec.backends import BACKENDS, Backend, open_backend
from gpuspec.opencl import OpenCLBackend


@pytest.fixture(scope="session", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return open_backend(request.param)


@pytest.fixture(scope="session")
def opencl() -> OpenCLBackend:
    return OpenCLBackend()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Where all backends must be present, a skipped test is a failed one."""
    skipped = terminalreporter.stats.get("skipped", [])
    if skipped and os.environ.get("GPUSPEC_NO_SKIPS"):
        terminalreporter.write_line(f"{len(skipped)} skipped tests count as failed here", red=True)
        terminalreporter._session.exitstatus = pytest.ExitCode.TESTS_FAILED
