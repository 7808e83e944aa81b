"""No kernel reads or writes what is not its own, and no two work-items the same: oclgrind looks."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import gpuspec
from gpuspec.light import opencl_device, sources

SECONDS = 300.0
"""Ten times what it takes on two cores."""

pytestmark = pytest.mark.skipif(
    shutil.which("oclgrind") is None, reason="oclgrind is not there; apt install oclgrind"
)


def looked_at(
    tmp_path: Path, what: str, *fault: str, device: tuple[str, ...] = ()
) -> tuple[str, str, set[str]]:
    """Run kernels under oclgrind.

    Parameters
    ----------
    tmp_path : Path
    what : "all" or "first"
        Of the scenes.
    *fault : str
        Words of a kernel, and what stands in their place.
    device : tuple of str
        Options of oclgrind: which device it is.

    Returns
    -------
    report : str
        What oclgrind has to say.
    error : str
        Of the program, if there was one.
    ran : set of str
        Kernels started.
    """
    log = tmp_path / "oclgrind.log"
    script = Path(__file__).with_name("every_kernel.py")
    package = Path(gpuspec.__file__).parent.parent
    done = subprocess.run(
        ["oclgrind", "--data-races", "--max-errors", "20", "--log", log, *device,
         "--build-options", "-fno-inline",  # it does not know the marks that inlining leaves
         sys.executable, script, what, *fault],
        env={**os.environ, "PYTHONPATH": str(package), "PYOPENCL_NO_CACHE": "1"},
        capture_output=True, text=True, timeout=SECONDS,
    )  # fmt: skip
    return log.read_text(encoding="utf-8"), done.stderr, set(done.stdout.split())


@pytest.mark.slow
def test_oclgrind_has_nothing_to_report_of_any_kernel(tmp_path):
    report, error, ran = looked_at(tmp_path, "all")
    assert (report, error) == ("", "")
    files = (sources.folder("kernels") / file for file in opencl_device.FILES)
    assert ran == {
        name for file in files for name in re.findall(r"__kernel void (\w+)", file.read_text())
    }


FAULTS = {
    "mean, at - begin": ("mean, at - begin + 1", "Invalid write"),
    "light, at + i * plane": ("light, i * plane", "data race"),
    "atomic_inc(own + copy + (uint)LEVEL(at))": ("own[copy + (uint)LEVEL(at)]++", "data race"),
    "uint at = chosen[i];": ("uint at = chosen[i + 1];", "Invalid read"),
}
"""Words of the kernels to those that are wrong in their place, and what is said of these."""


@pytest.mark.parametrize("words", FAULTS)
def test_oclgrind_reports_a_fault(tmp_path, words):
    """The test above can fail: each fault is seen."""
    fault, said = FAULTS[words]
    assert said in looked_at(tmp_path, "first", words, fault)[0]


def test_counts_are_right_on_a_device_of_little_local_memory_and_small_groups(tmp_path):
    little = "--local-mem-size", "3000", "--max-wgsize", "7"
    report, error, ran = looked_at(tmp_path, "first", device=little)
    assert (report, error) == ("", "")
    assert "count_levels" in ran
