"""The wheel: whole, and able to run where nothing else of gpuspec is."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from commandline import DEADLINE_S, names

from gpuspec.report.folder import FILES

pytestmark = pytest.mark.slow

CHECKOUT = Path(__file__).resolve().parents[1]


def clean_environment(home: Path) -> dict[str, str]:
    """What a new user's shell has: no trace of this checkout or of its caches."""
    home.mkdir(exist_ok=True)
    return {"PATH": os.defpath, "HOME": str(home), "LANG": "C.UTF-8", "COLUMNS": "200"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", folder, CHECKOUT],
        check=True, stdout=subprocess.DEVNULL, timeout=DEADLINE_S,
    )  # fmt: skip
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel in an environment of its own: the environment's programs.

    Its dependencies are those of this one; that they are all named, test_machines.py sees.
    """
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    subprocess.run(
        [sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "-q",
         "--no-compile", "--no-deps", wheel],
        check=True, env=environment, cwd=folder, timeout=DEADLINE_S,
    )  # fmt: skip
    (packages,) = folder.glob("lib/python*/site-packages")
    # A path alone: what else this environment puts on the path, such as this checkout, is not.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"), "utf-8")
    return folder / "bin"


def test_the_wheel_holds_every_kernel_shader_and_example(wheel):
    held = set(zipfile.ZipFile(wheel).namelist())
    wanted = {
        *(f"gpuspec/kernels/{path.name}" for path in (CHECKOUT / "kernels").glob("*.h")),
        *(f"gpuspec/kernels/{path.name}" for path in (CHECKOUT / "kernels").glob("*.cl")),
        *(f"gpuspec/shaders/{path.name}" for path in (CHECKOUT / "shaders").glob("*.*")),
        *(
            f"gpuspec/examples/{path.name}"
            for path in (CHECKOUT / "gpuspec/examples").glob("*.toml")
        ),
        *(f"gpuspec/{path.name}" for path in (CHECKOUT / "gpuspec").glob("*.py")),
    }
    assert {"gpuspec/kernels/trace.cl", "gpuspec/examples/trim.toml"} < wanted
    assert wanted | {"gpuspec/py.typed"} <= held


def test_the_wheel_holds_nothing_but_the_package(wheel):
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {top.partition("-")[0] for top in tops} == {"gpuspec"}
    assert len(tops) == 2  # the package and its metadata


def test_an_installed_gpuspec_is_the_installed_one(installed, tmp_path):
    found = subprocess.run(
        [installed / "python", "-c", "import gpuspec; print(gpuspec.__file__)"],
        check=True, capture_output=True, text=True, cwd=tmp_path,
        env=clean_environment(tmp_path / "home"), timeout=DEADLINE_S,
    ).stdout  # fmt: skip
    assert "site-packages" in Path(found.strip()).parts
    assert not Path(found.strip()).is_relative_to(CHECKOUT / "gpuspec")


def test_an_installed_gpuspec_runs_its_example_far_from_the_checkout(installed, tmp_path):
    ran = subprocess.run(
        [installed / "gpuspec", "demo", "--set", "camera.sampling_mm=0.5", "-o", "out"],
        capture_output=True, text=True, cwd=tmp_path, env=clean_environment(tmp_path / "home"),
        timeout=DEADLINE_S,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    written = names(tmp_path / "out")
    assert written == set(FILES) - {"frames.tif"}
    score = json.loads((tmp_path / "out" / "score.json").read_text("utf-8"))
    assert score["backend"] == "opencl"
    assert score["score"]["defects_hit"] > 0
