"""That a device computes: a small station traced on it has the float64 reference's image.

A driver that is there may still refuse every program, answer wrongly, never answer, or end the
process. So the station is tried in a process of its own, once per driver, device and version; what
was found is kept in the cache folder, and a normal start reads one small file.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.cache import folder
from gpuspec.errors import BackendError, DeviceError
from gpuspec.light.backend import Backend, Settings
from gpuspec.light.sources import digest
from gpuspec.version import __version__

if TYPE_CHECKING:
    from gpuspec.station.station import Station

SECONDS = 120.0
"""Longest a device may take: on a slow machine PoCL builds for some ten seconds."""

LARGEST_DN = 0.02
"""Largest difference from float64, of 255, of a device that computes: PoCL, llvmpipe and lavapipe
are 0.0026 off on this station. Other drivers differ in the last bits of divisions and square roots;
any mistake moves a pixel at an edge by whole grey levels."""

STATION: dict[str, Any] = {
    "part": {"length_mm": 3.3, "width_mm": 2.0, "crown_radius_x_mm": 300.0, "surface": "height"},
    "camera": {"sampling_mm": 0.05},
    "sequence": {"images": 8},
    "defects": [
        {"kind": "dent", "x_mm": 0.3, "y_mm": 0.2, "diameter_mm": 0.8, "depth_um": 4.0},
        {
            "kind": "scratch",
            "points_mm": [[-1.4, -0.6], [-0.2, -0.3], [0.6, -0.7]],
            "width_mm": 0.3,
            "depth_um": 2.0,
        },
    ],
}
"""A crowned part whose every ray meets height, dent and scratch; its rows fill no whole vectors."""


def prove(backend: Backend) -> None:
    """Let a device compute, or know that it did, and give it the settings with which it does.

    Parameters
    ----------
    backend : Backend
        Just opened.

    Raises
    ------
    DeviceError
        If it does not compute: what it did instead.
    """
    if backend.info.backend == "numpy":  # it is what the others are held against
        return
    settings = remembered(backend)
    if settings is None:
        settings = tried(backend)
        remember(backend, settings)
    backend.settle(settings)


def tried(backend: Backend) -> Settings:
    """Return the first settings with which a device computes.

    Raises
    ------
    DeviceError
        With what the last ones gave.
    """
    reason = ""
    for settings in backend.candidates():
        try:
            if getattr(sys, "frozen", False):  # a program of its own, which is no Python to start
                backend.settle(settings)
                difference(backend)
            else:
                ask("prove", backend, settings)
        except BackendError as error:
            reason = str(error)
        else:
            return settings
    raise DeviceError(f"{backend.info} does not compute: {reason}\n{backend.advice}")


def ask(what: str, backend: Backend, settings: Settings) -> dict[str, Any]:
    """Have a process of its own do something with a device.

    Parameters
    ----------
    what : "prove" or "test"
    backend : Backend
        Whose device it opens anew.
    settings : Settings

    Raises
    ------
    DeviceError
        If the device fails, answers wrongly, never answers, or ends the process.
    """
    code = "import sys; from gpuspec.light.devices import answer; answer(*sys.argv[1:])"
    device = what, backend.info.backend, str(backend.number), json.dumps(settings)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-W", "ignore", "-c", code, *device], env=environment,
            stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
            timeout=SECONDS,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise DeviceError(f"it gave no answer within {SECONDS:g} s.") from None
    except OSError as error:
        raise DeviceError(f"no process can be started to try it ({error}).") from None
    try:
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    except (ValueError, IndexError):
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        last = f" ({lines[-1].strip()[:200]})" if lines else ""
        raise DeviceError(
            f"its driver ended the process with code {done.returncode}{last}."
        ) from None
    if found["failure"]:
        raise DeviceError(found["failure"])
    return found


def difference(backend: Backend) -> float:
    """Return how far a device's aspect image of the small station is from float64, DN.

    Raises
    ------
    DeviceError
        If that is too far, or no image, or the device loses other pixels than the reference.
    """
    station, aspect, lost = _reference()
    here = backend.trace(station)
    apart = float(np.abs(here.aspect() - aspect).max())
    if not apart <= LARGEST_DN:
        raise DeviceError(f"its image of a small station is {apart:.3g} DN off float64.")
    if (here.lost() != lost).any():
        raise DeviceError("it loses other pixels of a small station than float64.")
    return apart


@cache
def _reference() -> tuple[Station, Image, NDArray[np.uint8]]:
    """Return the small station, and what float64 sees of it: for every device the same."""
    from gpuspec.light.float64_backend import NumpyBackend
    from gpuspec.station.station import Station

    station = Station.from_dict(STATION)
    there = NumpyBackend().trace(station)
    return station, there.aspect(), there.lost()


def remembered(backend: Backend) -> Settings | None:
    """Return the settings with which a device is known to compute, None if it is not."""
    path = _file(backend)
    try:
        found = json.loads(path.read_text("utf-8")) if path else None
    except (OSError, ValueError):
        return None
    settings = found.get("settings") if isinstance(found, dict) else None
    return settings if isinstance(settings, dict) else None


def remember(backend: Backend, settings: Settings | None) -> None:
    """Keep that a device computes with some settings.

    Nothing is kept where nothing can be written: the next start tries again.

    Parameters
    ----------
    backend : Backend
    settings : mapping or None
        None: forget it.
    """
    path = _file(backend)
    if path is None:
        return
    try:
        if settings is None:
            path.unlink(missing_ok=True)
            return
        path.parent.mkdir(exist_ok=True)
        text = json.dumps({**backend.info.as_dict(), "settings": settings}, indent=1)
        with tempfile.NamedTemporaryFile(
            "w", dir=path.parent, delete=False, encoding="utf-8"
        ) as file:
            file.write(text + "\n")
        Path(file.name).replace(path)
    except OSError:
        return


def _file(backend: Backend) -> Path | None:
    above = folder()
    if above is None:
        return None
    key = "\n".join([__version__, digest(), str(backend.info), repr(backend.candidates())])
    return above / "devices" / f"{hashlib.sha256(key.encode()).hexdigest()[:20]}.json"
