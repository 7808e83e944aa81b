"""Frames one after another, from files or arrays: added up, and what was seen of them meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.errors import FrameError
from gpuspec.frames.accumulator import Accumulator
from gpuspec.frames.period import sampled
from gpuspec.frames.readers import Colour, Frame, Source, Sources, sources
from gpuspec.frames.shading import Shading
from gpuspec.report.captured import FrameRow
from gpuspec.station.station import Station

Given = str | Path | Sequence[str | Path] | NDArray[Any] | Iterable[NDArray[Any]]
"""Frames: a folder, a pattern, files, an array (K, M, N), or arrays (M, N) one after another."""
DEPTHS = (8, 10, 12, 16)


@dataclass(frozen=True)
class Sequenced:
    """Frames that come one after another, from files or as arrays.

    Attributes
    ----------
    sources : Sources or None
        Of files; None: arrays.
    arrays : iterable of ndarray
        The frames, if they are no files.
    """

    sources: Sources | None
    arrays: Iterable[NDArray[Any]] = ()

    @classmethod
    def of(cls, given: Given, *, colour: Colour | None = None, gaps: bool = False) -> Sequenced:
        """Take frames as they are given.

        Parameters
        ----------
        given : str, Path, sequence of these, ndarray, or iterable of ndarray
        colour : str, optional
        gaps : bool

        Raises
        ------
        FrameError
            If they are nothing of these, or as :func:`gpuspec.frames.readers.sources`.
        """
        if isinstance(given, np.ndarray):
            if given.ndim not in (2, 3):
                raise FrameError(f"frames are an array (K, M, N), not of {given.shape}.")
            return cls(None, given if given.ndim == 3 else given[None])
        if isinstance(given, (str, Path)):
            return cls(sources([given], colour=colour, gaps=gaps))
        if isinstance(given, Sequence):
            files = [one for one in given if isinstance(one, (str, Path))]
            if len(files) == len(given):
                return cls(sources(files, colour=colour, gaps=gaps))
        if isinstance(given, Iterable):
            return cls(None, given)  # type: ignore[arg-type]
        raise FrameError(
            f"frames are a folder, a pattern, files or arrays, not {type(given).__name__}."
        )

    def only(self, used: range) -> Sequenced:
        """Return some of the frames.

        Parameters
        ----------
        used : range

        Raises
        ------
        FrameError
            If frames come one after another and cannot be had twice.
        """
        if self.sources is not None:
            some = self.sources.frames[used.start : used.stop]
            return Sequenced(replace(self.sources, frames=some))
        if isinstance(self.arrays, (Sequence, np.ndarray)):
            return Sequenced(None, self.arrays[used.start : used.stop])
        raise FrameError(
            f"of the frames only {used.start + 1} to {used.stop} are whole periods, and they "
            f"cannot be had twice; give them as a list or an array, or take every frame."
        )

    def __iter__(self) -> Iterator[tuple[Source | None, Frame]]:
        """Give each frame with its source."""
        if self.sources is None:
            for frame in self.arrays:
                yield None, frame
        else:
            yield from zip(self.sources.frames, self.sources.stream(), strict=True)


@dataclass(frozen=True)
class Seen:
    """What was seen of the frames while they were added up.

    Attributes
    ----------
    frames : tuple of FrameRow
    shape : tuple of int
    bits : int
        Of a number in the frames, 8 or 16.
    lowest, highest : int
        Grey level, of all pixels of all frames.
    samples : tuple of ndarray
        Of each frame, see :func:`gpuspec.frames.period.sampled`.
    ends : tuple of ndarray of float32, shape (M, N), or None
        Greatest and least level of each pixel, where asked for.
    """

    frames: tuple[FrameRow, ...]
    shape: tuple[int, int]
    bits: int
    lowest: int
    highest: int
    samples: tuple[NDArray[Any], ...] = ()
    ends: tuple[Image, Image] | None = None

    def check(self) -> None:
        """Refuse frames in which nothing can be seen.

        Raises
        ------
        FrameError
            If all are black, or all are saturated.
        """
        ends = f"{self.frames[0].name} to {self.frames[-1].name}"
        if self.highest == 0:
            raise FrameError(f"all frames are black, {ends}; check the light and the shutter.")
        if all(frame.saturated == 1 for frame in self.frames):
            raise FrameError(
                f"all frames are saturated everywhere, {ends}; take a shorter exposure."
            )


def added(
    sequence: Sequenced,
    station: Station,
    tell: Callable[[str], None],
    *,
    ends: bool = False,
) -> tuple[Accumulator, Seen]:
    """Add all frames up, one at a time.

    Parameters
    ----------
    sequence : Sequenced
    station : Station
        Its fusion, lag and full scale are used.
    tell : callable
        Told which frame it is.
    ends : bool
        Whether each pixel's greatest and least level are wanted.

    Raises
    ------
    FrameError
        If one cannot be decoded or is not like the first, or there is none.
    """
    sums = Accumulator(station.sequence.fusion, station.sequence.lag)
    extremes = [Accumulator("max"), Accumulator("min")] if ends else []
    samples = []
    total = len(sequence.sources) if sequence.sources else None
    rows: list[tuple[Source | None, float, int, NDArray[np.int64]]] = []
    shape, bits, lowest, highest = (0, 0), 8, 1 << 16, 0
    for number, (source, frame) in enumerate(sequence, 1):
        tell(f"frame {number:,}" + (f" of {total:,}" if total else ""))
        for each in (sums, *extremes):
            each.add(frame, str(source.path) if source else "")
        samples.append(sampled(frame).copy())
        shape, bits = (frame.shape[0], frame.shape[1]), 8 * frame.itemsize
        top = int(frame.max())
        lowest, highest = min(lowest, int(frame.min())), max(highest, top)
        fulls = np.array([np.count_nonzero(frame == 2**depth - 1) if 2**depth - 1 <= top else 0
                          for depth in DEPTHS])  # fmt: skip
        rows.append((source, float(frame.mean()), frame.size, fulls))
    if not rows:
        raise FrameError("no frame was given; the camera gave none.")
    depth = _depth(station, bits, highest)
    place = DEPTHS.index(depth)
    frames = tuple(
        FrameRow(
            source.name if source else f"frame {number}", source.path if source else None,
            mean, float(fulls[place] / size),
        )
        for number, (source, mean, size, fulls) in enumerate(rows, 1)
    )  # fmt: skip
    both = (extremes[0].fused(), extremes[1].fused()) if ends else None
    return sums, Seen(frames, shape, bits, lowest, highest, tuple(samples), both)


def stated_rate(station: Station) -> float | None:
    """Return by how many periods a station's file says the light moves from frame to frame.

    Parameters
    ----------
    station : Station
        As it was read.

    Returns
    -------
    float or None
        None if the file leaves it to a default.

    Examples
    --------
    >>> from gpuspec.captured.sequence import stated_rate
    >>> stated_rate(gpuspec.Station(sequence={"images": 16}))
    0.0625
    >>> print(stated_rate(gpuspec.Station()))
    None
    """
    if station.sequence.step_mm:
        stripes = {"luminous_mm", "dark_mm"} <= station.tunnel.model_fields_set
        return station.step_mm / station.tunnel.period_mm if stripes else None
    return 1 / station.sequence.images if "images" in station.sequence.model_fields_set else None


def _depth(station: Station, bits: int, highest: int) -> int:
    """Return the bit depth: the station's, or the least that holds all levels if it says none."""
    if "bit_depth" in station.sensor.model_fields_set:
        return station.sensor.bit_depth
    return next(depth for depth in DEPTHS if highest < 2**depth and depth <= bits)


def fitting(station: Station, seen: Seen) -> Station:
    """Return the station with the frames' size, depth and number in place of its own.

    Parameters
    ----------
    station : Station
    seen : Seen

    Raises
    ------
    FrameError
        If the frames have another size or depth than it says.
    """
    rows, columns = seen.shape
    camera = station.camera
    first = seen.frames[0].name
    for key, said, true in (("rows", camera.rows, rows), ("columns", camera.columns, columns)):
        if said and said != true:
            raise FrameError(
                f"{first} has {columns} x {rows} pixels, and {station.file} says camera.{key} = "
                f"{said}; leave it out, or take the station of these frames."
            )
    depth = _depth(station, seen.bits, seen.highest)
    if depth > seen.bits or (depth == 8 and seen.bits == 16 and seen.highest > 255):
        raise FrameError(
            f"{first} holds numbers of {seen.bits} bit, and {station.file} says sensor.bit_depth = "
            f"{depth}; set it to what the camera gives."
        )
    if seen.highest > 2**depth - 1:
        raise FrameError(
            f"the frames from {first} on reach {seen.highest:,} DN, above the full scale of "
            f"sensor.bit_depth = {depth} in {station.file}; set it to what the camera gives."
        )
    images = len([frame for frame in seen.frames if frame.used])
    return station.replace(
        camera={"rows": rows, "columns": columns},
        sensor={"bit_depth": depth},
        sequence={"images": images},
    )


def shading_of(
    dark: Given | None,
    flat: Given | None,
    shape: tuple[int, int],
    colour: Colour | None = None,
    progress: Callable[[str], None] | None = None,
) -> Shading:
    """Add dark and flat frames up.

    Parameters
    ----------
    dark, flat : as the frames of :func:`inspect`, or None
    shape : tuple of int
        Of the frames, (M, N).
    colour : str, optional
        What is taken of coloured ones.
    progress : callable, optional
        Told what is being done.

    Raises
    ------
    FrameError
        If one cannot be read, or has another size.
    """
    tell = progress or (lambda _: None)
    return Shading(
        _mean(dark, "dark", shape, colour, tell), _mean(flat, "flat", shape, colour, tell)
    )


def _mean(
    given: Given | None,
    name: str,
    shape: tuple[int, int],
    colour: Colour | None,
    tell: Callable[[str], None],
) -> Image | None:
    """Return the mean of dark or flat frames."""
    if given is None:
        return None
    tell(f"adding up the {name} frames")
    sums = Accumulator()
    for source, frame in Sequenced.of(given, colour=colour, gaps=True):
        where = str(source.path) if source else f"the {name} frame"
        if frame.shape != shape:
            rows, columns = frame.shape
            raise FrameError(
                f"{where} has {columns} x {rows} pixels and the frames {shape[1]} x {shape[0]}; "
                f"take {name} frames with the same camera and the same cut."
            )
        sums.add(frame, where)
    return sums.fused()
