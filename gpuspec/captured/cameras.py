"""Frames as a camera's own interface gives them, for a line: GenICam by harvesters, and pylon.

Frames have the numbers of the camera, its block or frame IDs: where one is missing, a frame was
lost. What could not be grabbed is passed on with the reason, so that a line names it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import FrameError


class Grabbed(NamedTuple):
    """A frame as a camera gave it; what :meth:`gpuspec.Line.add` takes.

    Attributes
    ----------
    frame : ndarray of uint8 or uint16, shape (M, N), or None
        None: it could not be grabbed.
    number : int
        The camera's own.
    time_s : float
        When it came, by a clock of this computer that never goes back.
    why : str
        Why it could not be grabbed.
    """

    frame: NDArray[Any] | None
    number: int
    time_s: float
    why: str = ""


def pylon_frames(camera: Any, timeout_s: float = 5.0) -> Iterator[Grabbed]:
    """Grab frames of a Basler camera without an end; the grabbing stops with the iterator.

    Parameters
    ----------
    camera : pypylon.pylon.InstantCamera
        Opened, and set to a mono pixel format that is not packed. Also an emulated one, which
        replays a folder of pictures.
    timeout_s : float
        Longest wait for a frame.

    Yields
    ------
    Grabbed

    Raises
    ------
    FrameError
        If a frame does not come in time.
    """
    from pypylon import pylon

    before: int | None = None
    camera.StartGrabbing(pylon.GrabStrategy_OneByOne)
    try:
        while True:
            waited = round(timeout_s * 1000)
            with camera.RetrieveResult(waited, pylon.TimeoutHandling_Return) as result:
                if not result.IsValid():
                    raise _late(before, timeout_s)
                before, now = int(result.BlockID), time.monotonic()
                if result.GrabSucceeded():
                    yield Grabbed(result.Array, before, now)
                else:
                    yield Grabbed(None, before, now, str(result.ErrorDescription))
    finally:
        camera.StopGrabbing()


def harvester_frames(acquirer: Any, timeout_s: float = 5.0) -> Iterator[Grabbed]:
    """Grab frames of a GenICam camera without an end; the acquisition stops with the iterator.

    What harvesters gets incomplete it leaves out, so that the next one's number tells of it.

    Parameters
    ----------
    acquirer : harvesters.core.ImageAcquirer
        Of a camera that is set to a mono pixel format that is not packed.
    timeout_s : float
        Longest wait for a frame.

    Yields
    ------
    Grabbed

    Raises
    ------
    FrameError
        If a frame does not come in time.
    """
    before: int | None = None
    acquirer.start()
    try:
        while True:
            buffer = acquirer.try_fetch(timeout=timeout_s)
            if buffer is None:
                raise _late(before, timeout_s)
            with buffer:
                now = time.monotonic()
                before = int(buffer.module.frame_id)
                image = buffer.payload.components[0]
                colours = int(image.num_components_per_pixel)
                shape = (image.height, image.width) + ((colours,) if colours > 1 else ())
                frame = np.array(image.data).reshape(shape)  # a copy: the buffer goes back
            yield Grabbed(frame, before, now)
    finally:
        acquirer.stop()


def _late(before: int | None, timeout_s: float) -> FrameError:
    frame = "the first frame" if before is None else f"frame {before + 1}"
    return FrameError(
        f"{frame} did not come within {timeout_s:g} s; check the camera, its cable and its trigger."
    )
