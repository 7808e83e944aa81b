"""Which devices there are, and which is taken: the one file that names every backend."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gpuspec.errors import BackendError, DeviceError, DeviceWarning
from gpuspec.light import proof
from gpuspec.light.backend import Backend, DeviceInfo, Settings
from gpuspec.light.speed import COPY, FILES, measured
from gpuspec.shown import html_table

# In the order in which `auto` tries them.
BACKENDS = ("opencl", "opengl", "vulkan", "numpy")
_HEADS = ("backend", "number", "device", "driver", "remark")
FASTER = 1.1
"""By how much other settings must be faster to be taken: times of one run repeat to a tenth."""


def open_backend(
    name: str | Backend = "auto", device: str | int | None = None, among: Sequence[str] = BACKENDS
) -> Backend:
    """Open a device that computes; a backend or device asked for by name is never swapped.

    A device counts as usable only after a small station was traced on it with the right image
    (:mod:`gpuspec.light.proof`). Where none is named, the next device of the backend is taken in
    place of one that fails, then the next backend; a `DeviceWarning` says what was left and why.

    Parameters
    ----------
    name : str or Backend
        One of ``BACKENDS``, or "auto": the first of them with a device that computes. An open
        backend is returned as it is.
    device : str or int, optional
        Part of the device's name, or its number in `gpuspec devices`.
    among : sequence of str
        What "auto" tries, in order.

    Returns
    -------
    Backend

    Raises
    ------
    BackendError
        If it is absent, with the reason and what to install, or does not compute.

    Examples
    --------
    >>> backend = gpuspec.open_backend("numpy")
    >>> backend.info.backend
    'numpy'
    >>> gpuspec.open_backend("cuda")
    Traceback (most recent call last):
        ...
    gpuspec.errors.BackendError: backend 'cuda' is not known; choose one of auto, opencl,
        opengl, vulkan, numpy.
    """
    if isinstance(name, Backend):
        return name
    if not isinstance(name, str):
        raise BackendError(
            f"a backend is an open Backend or one of auto, {', '.join(BACKENDS)}, not {name!r}."
        )
    device = None if device is None else str(device)
    left: list[str] = []
    absent: list[str] = []
    for candidate in among if name == "auto" else (name,):
        try:
            found = _first(candidate, left) if device is None else proven(candidate, device)
        except DeviceError:
            if name != "auto" or device is not None:
                raise
        except BackendError as error:
            if name != "auto":
                raise
            absent.append(str(error))
        else:
            slow = absent if found.info.backend == "numpy" and name == "auto" else []
            for reason in (*left, *slow):
                warnings.warn(
                    f"{in_one_line(reason)} {found.info.backend} on {found.info.device} is taken.",
                    DeviceWarning,
                    stacklevel=2,
                )
            return found
    what = "no backend can be opened" if device is None else f"no backend has a device {device!r}"
    raise BackendError("\n".join((f"{what}.", *left, *absent)))


def _first(name: str, left: list[str]) -> Backend:
    """Open a backend's first device that computes; why others do not is added to `left`."""
    reasons: list[str] = []
    while True:
        try:
            return proven(name, str(len(reasons)) if reasons else None)
        except DeviceError as error:
            reasons.append(str(error))
            left.append(str(error))
        except BackendError:  # there is no further device
            if not reasons:
                raise
            raise DeviceError("\n".join(reasons)) from None


def proven(name: str, device: str | None) -> Backend:
    """Open a device and see that it computes.

    Parameters
    ----------
    name : str
        One of ``BACKENDS``.
    device : str or None
        Part of the device's name, or its number; None: the first.

    Raises
    ------
    BackendError
        If there is none; `DeviceError` if it does not compute.
    """
    found = opened(name, device)
    proof.prove(found)
    return found


def opened(name: str, device: str | None) -> Backend:
    """Open a device, whether it computes or not; parameters as :func:`open_backend`."""
    # Backends are imported when used: an absent driver must not keep the others from working.
    if name == "opencl":
        from gpuspec.light.opencl import OpenCLBackend

        return OpenCLBackend(device)
    if name == "opengl":
        from gpuspec.light.opengl import OpenGLBackend

        return OpenGLBackend(device)
    if name == "vulkan":
        from gpuspec.light.vulkan import VulkanBackend

        return VulkanBackend(device)
    if name == "numpy":
        from gpuspec.light.float64_backend import NumpyBackend

        return NumpyBackend(device)
    raise BackendError(f"backend {name!r} is not known; choose one of auto, {', '.join(BACKENDS)}.")


def in_one_line(reason: str) -> str:
    """Return what matters most of a message of several lines: its first, and the first error."""
    first, *lines = (line.strip() for line in reason.splitlines() if line.strip())
    error = next((line for line in lines if "error" in line.lower()), "")
    text = f"{first} {error}".rstrip(": ")
    text = text if len(text) <= 300 else f"{text[:297]}..."
    return text if text.endswith((".", "?", "...")) else f"{text}."


@dataclass(frozen=True)
class Found:
    """A line of `gpuspec devices`: a device, or why a backend is absent.

    Attributes
    ----------
    backend : str
        Its name, of ``BACKENDS``.
    info : DeviceInfo or None
        None: the backend is absent.
    number : int
        Of the device.
    remark : str
        Whether `auto` takes it, and why not.
    computes, chosen : bool
        Whether it computes, and whether `auto` takes it.
    """

    backend: str
    info: DeviceInfo | None
    number: int
    remark: str
    computes: bool = False
    chosen: bool = False


class Survey(list[Found]):
    """The devices there are, as a table of itself."""

    def rows(self) -> list[dict[str, str]]:
        """Return a dict for each device: backend, number, device, driver and remark."""
        return [
            {
                "backend": one.backend,
                "number": str(one.number) if one.info else "-",
                "device": one.info.device.strip() if one.info else "-",
                "driver": f"{one.info.driver} {one.info.version}" if one.info else "-",
                "remark": in_one_line(one.remark),
            }
            for one in self
        ]

    def __repr__(self) -> str:
        lines = [list(_HEADS), *([row[head] for head in _HEADS] for row in self.rows())]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )

    def _repr_html_(self) -> str:
        """Show itself in a notebook."""
        return html_table(self.rows(), len(self))


def survey() -> Survey:
    """Return every device of every backend, what `auto` takes, and why not the others."""
    found = Survey()
    for name in BACKENDS:
        try:
            infos = _devices(name)
        except BackendError as error:
            found.append(Found(name, None, 0, f"absent: {error}"))
            continue
        for number, info in enumerate(infos):
            first = next((entry.backend for entry in found if entry.chosen), "")
            try:
                proven(name, str(number))
            except BackendError as error:
                found.append(Found(name, info, number, f"left out: {in_one_line(str(error))}"))
                continue
            remark = f"auto takes {first} first" if first else "chosen by auto"
            found.append(Found(name, info, number, remark, computes=True, chosen=not first))
    return found


def _devices(name: str) -> list[DeviceInfo]:
    if name == "opencl":
        from gpuspec.light import opencl_device

        return [opencl_device.describe(device) for device in opencl_device.devices()]
    if name == "opengl":
        from gpuspec.light import opengl

        return opengl.devices()
    if name == "vulkan":
        from gpuspec.light import vulkan

        return [vulkan.describe(adapter.info) for adapter in vulkan.adapters()]
    return [opened(name, None).info]


@dataclass(frozen=True)
class DeviceReport:
    """What a test of a device found.

    Attributes
    ----------
    found : Found
        The device, or why it is not there.
    difference_dn : float or None
        How far its image of the small station is from float64; None: it does not compute.
    ms : dict of str to float
        How long each of `gpuspec.light.speed.ROWS` takes.
    settings : dict
        With which it is taken from now on.
    failure : str
        Why it does not compute.
    """

    found: Found
    difference_dn: float | None = None
    ms: Mapping[str, float] = field(default_factory=dict)
    settings: Settings = field(default_factory=dict)
    failure: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        info = self.found.info
        copy = self.ms.get(COPY)
        return {
            **(info.as_dict() if info else {"backend": self.found.backend}),
            "number": self.found.number,
            "remark": self.found.remark,
            "computes": self.found.computes and not self.failure,
            "difference_dn": self.difference_dn,
            "ms": dict(self.ms),
            "copies": {row: ms / copy for row, ms in self.ms.items()} if copy else {},
            "settings": dict(self.settings),
            "failure": self.failure,
        }


def tested(found: Found) -> DeviceReport:
    """Test a device anew, with all settings it may have; the fastest are kept for it.

    Parameters
    ----------
    found : Found
        Of :func:`survey`.
    """
    if found.info is None:
        return DeviceReport(found, failure=found.remark)
    answers: list[tuple[Settings, dict[str, Any]]] = []
    try:
        device = opened(found.backend, str(found.number))
    except BackendError as error:
        return DeviceReport(found, failure=str(error))
    failure = ""
    for settings in device.candidates():
        try:
            answers.append((settings, proof.ask("test", device, settings)))
        except DeviceError as error:
            failure = failure or str(error)
    if not answers:
        proof.remember(device, None)
        return DeviceReport(found, failure=f"{failure}\n{device.advice}")
    best, ms = fastest([(settings, answer["ms"]) for settings, answer in answers])
    try:
        apart = proof.ask("prove", device, best)["difference_dn"]
    except DeviceError:  # each is right, and both together are not
        best, answer = answers[0]
        ms, apart = answer["ms"], answer["difference_dn"]
    proof.remember(device, best)
    return DeviceReport(found, apart, ms, best)


def fastest(
    answers: Sequence[tuple[Settings, Mapping[str, float]]],
) -> tuple[Settings, dict[str, float]]:
    """Return the settings that were fastest, kernel file by kernel file, and their times.

    Parameters
    ----------
    answers : sequence of (settings, ms by row)
        The first is kept where another is not faster by more than `FASTER`.
    """
    settings, ms = answers[0]
    ms = dict(ms)
    widths = dict(settings.get("widths", {}))
    for other, times in answers[1:]:
        for row, files in FILES.items():
            if times[row] < ms[row] / FASTER:
                ms[row] = times[row]
                widths |= {file: other["widths"][file] for file in files}
    return ({**settings, "widths": widths} if widths else settings), ms


def answer(what: str, name: str, number: str, settings: str) -> None:
    """Print as JSON what a device does, asked by :func:`gpuspec.light.proof.ask`.

    Parameters
    ----------
    what : "prove" or "test"
        The small station alone, or with it how fast the device is.
    name, number : str
        Backend and device.
    settings : str
        As JSON.
    """
    found: dict[str, Any] = {"failure": ""}
    try:
        device = opened(name, number)
        device.settle(json.loads(settings))
        found["difference_dn"] = proof.difference(device)
        if what == "test":
            found["ms"] = measured(device)
    except BackendError as error:
        found["failure"] = str(error)
    print(json.dumps(found))
