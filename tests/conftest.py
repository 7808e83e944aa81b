"""Fixtures: every backend there is, and no test passed over in silence."""

from __future__ import annotations

import os

import pytest

from gpuspec.backends import BACKENDS, Backend, open_backend
from gpuspec.errors import BackendError
from gpuspec.opencl import OpenCLBackend


@pytest.fixture(scope="session", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return open_backend(request.param)


@pytest.fixture(scope="session", params=[name for name in BACKENDS if name != "numpy"])
def device_backend(request: pytest.FixtureRequest) -> Backend:
    """Every backend but the reference."""
    return open_backend(request.param)


@pytest.fixture(scope="session")
def opencl() -> OpenCLBackend:
    return OpenCLBackend()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Without a driver the tests of its backend are skipped, or fail where none may be absent."""
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
