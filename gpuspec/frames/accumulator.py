"""Frames added up as they come: exact in whole numbers, in memory that does not grow with them.

On a CPU a frame of 8 bit is added as fast as memory allows, 14 Gpixel/s on a core of a server, so
that no device is asked: bringing a frame to one takes as long as adding it here.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.errors import FrameError

Fusion = Literal["mean", "max", "min", "std", "differential"]
_WIDER: dict[type, type] = {np.uint8: np.uint16, np.uint16: np.uint32}


class _Sum:
    """A sum of frames in the narrowest numbers that hold it, for adding is as fast as they are."""

    def __init__(self, shape: tuple[int, int], kind: type, wider: type | None = None) -> None:
        self._wide: NDArray[np.uint64] | None = None
        wider = wider or _WIDER[kind]
        self._narrow: NDArray[Any] = np.zeros(shape, wider)
        self._room = int(np.iinfo(wider).max) // (int(np.iinfo(kind).max) or 1)
        self._held = 0

    def add(self, frame: NDArray[Any]) -> None:
        if self._held == self._room:
            self._flush()
        np.add(self._narrow, frame, out=self._narrow, casting="unsafe")
        self._held += 1

    def _flush(self) -> None:
        if self._wide is None:
            self._wide = np.zeros(self._narrow.shape, np.uint64)
        self._wide += self._narrow
        self._narrow[:] = 0
        self._held = 0

    @property
    def total(self) -> NDArray[Any]:
        return self._narrow if self._wide is None else self._wide + self._narrow


class Accumulator:
    """Adds frames up, one at a time, to what a sequence is fused to.

    Parameters
    ----------
    fusion : {"mean", "max", "min", "std", "differential"}
        As of a station's ``sequence.fusion``.
    lag : int
        Frames between the pairs of the differential fusion.

    Attributes
    ----------
    count : int
        Frames so far.

    Examples
    --------
    >>> from gpuspec.frames.accumulator import Accumulator
    >>> sums = Accumulator()
    >>> for level in (10, 20, 31):
    ...     sums.add(np.full((2, 2), level, np.uint8))
    >>> sums.count, sums.fused()[0, 0].round(4)
    (3, np.float32(20.3333))
    """

    def __init__(self, fusion: Fusion = "mean", lag: int = 1) -> None:
        self.fusion, self.lag, self.count = fusion, lag, 0
        self._like: tuple[tuple[int, ...], np.dtype[Any]] | None = None
        self._first: list[NDArray[Any]] = []
        self._last: deque[NDArray[Any]] = deque(maxlen=lag)

    def __repr__(self) -> str:
        size = "" if self._like is None else f" of {self._like[0]} {self._like[1]}"
        return f"Accumulator({self.fusion} of {self.count} frames{size})"

    def add(self, frame: NDArray[Any], name: str = "") -> None:
        """Add a frame; it is not kept, but for the `lag` first and last of a differential fusion.

        Parameters
        ----------
        frame : ndarray of uint8 or uint16, shape (M, N)
        name : str
            By which an error calls it; "": its number.

        Raises
        ------
        FrameError
            If it is no image of whole grey levels, or another size or depth than the first.
        """
        name = name or f"frame {self.count + 1}"
        if not isinstance(frame, np.ndarray) or frame.ndim != 2 or not frame.size:
            what = f"of {frame.shape}" if isinstance(frame, np.ndarray) else type(frame).__name__
            raise FrameError(f"{name} is not an image of rows and columns, but {what}.")
        if frame.dtype not in (np.uint8, np.uint16):
            raise FrameError(
                f"{name} holds {frame.dtype}; frames are uint8 or uint16, as the camera gives them."
            )
        if self._like is None:
            self._begin(frame)
        if (frame.shape, frame.dtype) != self._like:
            shape, kind = self._like or ((), frame.dtype)
            raise FrameError(
                f"{name} is {frame.dtype} of {frame.shape} and the first {kind} of {shape}; frames "
                f"of one sequence are alike."
            )
        self._add(frame)
        self.count += 1

    def _begin(self, frame: NDArray[Any]) -> None:
        shape, kind = (frame.shape[0], frame.shape[1]), frame.dtype.type
        self._like = frame.shape, frame.dtype
        if self.fusion in ("mean", "std"):
            self._sum = _Sum(shape, kind)
        if self.fusion == "std":
            self._squares = _Sum(shape, _WIDER[kind], np.uint32 if kind is np.uint8 else np.uint64)
        if self.fusion == "differential":
            self._gaps = _Sum(shape, kind)
        if self.fusion in ("max", "min"):
            self._extreme = frame.copy()

    def _add(self, frame: NDArray[Any]) -> None:
        if self.fusion in ("mean", "std"):
            self._sum.add(frame)
        if self.fusion == "std":
            wide: NDArray[Any] = frame.astype(_WIDER[frame.dtype.type])
            self._squares.add(np.multiply(wide, wide, out=wide))
        if self.fusion == "differential":
            if len(self._first) < self.lag:
                self._first.append(frame.copy())
            if len(self._last) == self.lag:
                self._gaps.add(_gap(frame, self._last[0]))
            self._last.append(frame.copy())
        if self.fusion == "max":
            np.maximum(self._extreme, frame, out=self._extreme)
        if self.fusion == "min":
            np.minimum(self._extreme, frame, out=self._extreme)

    def fused(self, *, periodic: bool = True) -> Image:
        """Return what the frames so far are fused to, rounded once.

        Parameters
        ----------
        periodic : bool
            Whether the first frame comes after the last again, for the differential fusion.

        Returns
        -------
        ndarray of float32, shape (M, N)
            Grey levels, DN.

        Raises
        ------
        FrameError
            If there is no frame, or of the differential fusion none `lag` before another.
        """
        if not self.count:
            raise FrameError("no frame was added; the camera gave none.")
        if self.fusion in ("max", "min"):
            return self._extreme.astype(np.float32)
        if self.fusion == "mean":
            return _ratio(self._sum.total, self.count)
        if self.fusion == "std":
            mean = self._sum.total / self.count
            variance = self._squares.total / self.count - mean * mean
            return np.sqrt(np.maximum(variance, 0)).astype(np.float32)
        if self.count <= self.lag:
            raise FrameError(
                f"{self.count} frames hold no pair sequence.lag = {self.lag} apart; take more."
            )
        if not periodic:
            return _ratio(self._gaps.total, self.count - self.lag)
        wrapped = self._gaps.total.astype(np.uint64)
        for early, late in zip(self._first, self._last, strict=True):
            wrapped += _gap(early, late)
        return _ratio(wrapped, self.count)


def _ratio(total: NDArray[Any], count: int) -> Image:
    """Return whole numbers over one, each rounded once to float32."""
    if total.dtype.itemsize < 4 or not total.size or total.max() < 1 << 24:  # exact in float32
        exact: Image = np.divide(total, np.float32(count), dtype=np.float32)
        return exact
    rounded: Image = (total / count).astype(np.float32)
    return rounded


def _gap(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    gap: NDArray[Any] = np.maximum(one, other) - np.minimum(one, other)
    return gap
