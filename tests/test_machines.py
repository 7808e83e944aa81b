"""The README's main command in a fresh environment, on machines that lack this or that."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from commandline import DEADLINE_S, UNKNOWN_CPU
from documents import CHECKOUT, block_said
from test_wheel import clean_environment

from gpuspec.light import pocl
from gpuspec.light.devices import BACKENDS

pytestmark = pytest.mark.slow

NUMPY_SECONDS = 60.0
"""Of one core, of the demo without any driver; 11 measured on an idle core,
38 on one whose other half was busy."""


@dataclass(frozen=True)
class Fresh:
    """A copy of the checkout with the environment that the README's command made in it."""

    folder: Path
    home: Path
    first: dict[str, object] = field(default_factory=dict)
    """What the README's command left in `score.json`."""

    def run(self, command: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run a shell command as a new user would, the environment activated if there is one."""
        activate = "if [ -d .venv ]; then . .venv/bin/activate; fi; "
        return subprocess.run(
            ["bash", "-c", activate + command], cwd=self.folder, capture_output=True, text=True,
            env={
                **clean_environment(self.home), "PATH": os.environ["PATH"],
                "PIP_NO_COMPILE": "0",  # pip's way to say --no-compile: what is used is compiled
                **environment,
            },
            timeout=2 * DEADLINE_S,  # it installs from the network
        )  # fmt: skip

    def score(self) -> dict[str, object]:
        found: dict[str, object] = json.loads((self.folder / "demo/score.json").read_text("utf-8"))
        return found


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Fresh:
    """Set up by the README's own command, on a CPU that PoCL's compiler does not know."""
    folder = tmp_path_factory.mktemp("fresh")
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=CHECKOUT, check=True,
        capture_output=True, text=True, timeout=DEADLINE_S,
    ).stdout.splitlines()  # fmt: skip
    for name in listed:
        if (CHECKOUT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(CHECKOUT / name, folder / name)
    made = Fresh(folder, tmp_path_factory.mktemp("home"))
    done = made.run(block_said("main command"), **UNKNOWN_CPU)
    assert done.returncode == 0, done.stderr
    return replace(made, first=made.score())


def test_the_readmes_command_runs_where_pocl_does_not_know_the_cpu(fresh):
    assert fresh.first["backend"] == "opencl"
    assert "generic" not in str(fresh.first["version"])
    assert (fresh.folder / "demo/detection.png").stat().st_size > 0
    told = fresh.run("gpuspec devices --json", **UNKNOWN_CPU, **{pocl.SWITCH: "off"})
    first = json.loads(told.stdout)["devices"][0]
    assert first["version"].endswith("generic"), "the CPU was known after all"


def test_with_the_repair_switched_off_the_next_backend_is_taken_and_named(fresh):
    done = fresh.run("gpuspec demo", **UNKNOWN_CPU, **{pocl.SWITCH: "off"})
    assert done.returncode == 0, done.stderr
    (line,) = done.stderr.splitlines()
    # OpenGL is an extra and not installed here.
    assert "unknown target CPU 'generic'" in line
    assert line.endswith("is taken.")
    assert " vulkan on " in line
    assert fresh.score()["backend"] == "vulkan"


def test_a_second_start_does_not_prove_its_device_again_and_compiles_nothing(fresh):
    def kernels() -> list[Path]:
        return sorted((fresh.home / ".cache/pocl").rglob("*.so"))

    assert fresh.run("gpuspec demo --no-pictures").returncode == 0
    first = kernels()
    assert first != []
    broken = "from gpuspec.light import proof; proof.ask = None"
    begin = "import sys; sys.argv = ['gpuspec', 'demo', '--no-pictures'"
    begin += ", '--set', 'camera.columns=3711']"  # PoCL compiles a kernel once, not for every width
    done = fresh.run(f'python -c "{begin}; {broken}; from gpuspec.cli.main import main; main()"')
    assert done.returncode == 0, done.stderr
    assert kernels() == first


def test_without_write_access_to_the_cache_it_runs_as_fast_and_says_nothing(fresh, tmp_path):
    home = tmp_path / "home"
    (home / ".cache").mkdir(parents=True)
    (home / ".cache").chmod(0o500)
    less = "setpriv --bounding-set=-all --inh-caps=-all " if os.geteuid() == 0 else ""
    refused = fresh.run(f"{less}touch {home}/.cache/file")
    assert refused.returncode != 0, "the cache can be written after all"
    for _ in range(2):
        done = fresh.run(f"{less}gpuspec demo", HOME=str(home), TMPDIR=str(tmp_path))
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        assert fresh.score()["backend"] == "opencl"
    assert list((home / ".cache").iterdir()) == []
    kept = tmp_path / f"gpuspec-{os.getuid()}"
    assert {"gpuspec", "pocl", "matplotlib"} <= {path.name for path in kept.iterdir()}


def test_without_any_driver_numpy_runs_the_demo_within_a_minute(fresh, tmp_path):
    fresh.run("pip uninstall -q -y pocl-binary-distribution && mv $(find .venv -name pocl.icd) .")
    nothing = {name: str(tmp_path / "none") for name in ("OCL_ICD_VENDORS", "VK_DRIVER_FILES",
               "VK_ICD_FILENAMES")}  # fmt: skip
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = fresh.run("gpuspec demo", **nothing)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert done.returncode == 0, done.stderr
    assert fresh.score()["backend"] == "numpy"
    assert fresh.score()["score"] == fresh.first["score"]
    lines = done.stderr.splitlines()
    assert len(lines) == len(BACKENDS) - 1
    assert all(line.startswith("note: ") for line in lines)
    assert "apt install pocl-opencl-icd" in done.stderr
    assert seconds <= NUMPY_SECONDS


def test_intels_runtime_is_found_by_itself_once_installed_and_comes_after_pocl(fresh):
    done = fresh.run('pip install -q ".[intel]" && gpuspec devices --json')
    assert done.returncode == 0, done.stderr
    first, second, *_ = json.loads(done.stdout)["devices"]
    assert "Portable Computing Language" in first["driver"]
    assert "Intel" in second["driver"]
    assert first["computes"] and second["computes"]
    done = fresh.run("gpuspec demo --backend opencl --device 1")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    score = fresh.score()
    assert "Intel" in str(score["driver"])
    assert score["score"]["defects_hit"] == 36
