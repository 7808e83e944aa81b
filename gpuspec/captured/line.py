"""On a line: frames one at a time, from any camera, to a decision per part; no file is written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image, Mask
from gpuspec.captured.cameras import Grabbed
from gpuspec.captured.ceiling import ceiling_for, says_light
from gpuspec.captured.sequence import Given, shading_of, stated_rate
from gpuspec.detection.decision import Decision, decide, decision_rules
from gpuspec.detection.inspection import Inspection, inspect
from gpuspec.errors import FrameError
from gpuspec.frames.accumulator import Accumulator
from gpuspec.frames.outline import outlined
from gpuspec.frames.period import sampled
from gpuspec.shown import array
from gpuspec.station.station import Station

_WRAPPED = 65535, 1  # block IDs of GigE Vision, one after the other


@dataclass(frozen=True, eq=False)
class PartDecision:
    """The decision on a part, and what it was made from.

    Attributes
    ----------
    part : int
        Its number on the line, from 1.
    decision : Decision
        Accept or reject, with the reasons.
    inspection : Inspection
        Blobs, classes, threshold.
    aspect : ndarray of float32, shape (M, N)
        Aspect image, DN.
    """

    part: int
    decision: Decision
    inspection: Inspection
    aspect: Image

    @property
    def accepted(self) -> bool:
        """Whether the part is accepted."""
        return self.decision.accepted

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not."""
        return self.decision.reasons

    def __repr__(self) -> str:
        return f"PartDecision(part {self.part}, {self.decision}; aspect {array(self.aspect)})"


class Line:
    """Takes a camera's frames one at a time and decides on each part.

    A part has ``station.sequence.images`` frames. They are added up as they come;
    of each no more is kept than a few thousand pixels, which tell the period of the light.
    A frame that was lost or came late, or is unlike the others, is an error that names it; that
    part then has no decision, and the line goes on with :meth:`begin`. So are frames of another
    size than the station's file says: ``camera.rows`` and ``camera.columns``, or those that follow
    from the part's size and the sampling.

    Parameters
    ----------
    station : Station, str or Path
        Its fusion, number of images, sampling, threshold, classes and rules of decision are used.
    region : str, Path or ndarray of bool, optional
        What is inspected, see :func:`gpuspec.frames.outline.outlined`; None: everything.
    dark, flat : as the frames of :func:`gpuspec.inspect`, optional
        Frames without light, and of an evenly lit surface.
    gap_s : float, optional
        Longest time between two frames; None: any.

    Attributes
    ----------
    part : int
        Number of the part that is being taken, from 1.

    Raises
    ------
    StationError
        If the station cannot be read, or a rule names no class.

    Examples
    --------
    >>> station = gpuspec.Station(sequence={"images": 3}, decision=[{"area_min_mm2": 0.1}])
    >>> line = gpuspec.Line(station)
    >>> frame = np.full((60, 80), 60, np.uint8)
    >>> frame[20:30, 20:30] = 200  # 0.5 x 0.5 mm
    >>> for number in range(3):
    ...     line.add(frame, number)
    >>> line.decide()
    PartDecision(part 1, reject: 1 blob of at least 0.1 mm², 0 allowed; aspect (60, 80) float32)
    >>> line.add(frame, 3)
    >>> line.add(frame, 5)
    Traceback (most recent call last):
        ...
    gpuspec.errors.FrameError: part 2: frame 4 was lost, for frame 5 came after frame 3; take the
        part again.
    """

    def __init__(
        self,
        station: Station | str | Path,
        *,
        region: str | Path | Mask | None = None,
        dark: Given | None = None,
        flat: Given | None = None,
        gap_s: float | None = None,
    ) -> None:
        self.station = Station.of(station)
        self.part = 0
        self._rules = decision_rules(self.station)
        self._region, self._dark, self._flat, self._gap_s = region, dark, flat, gap_s
        self._inside: Mask | None = None
        self._number: int | None = None
        self._camera: Iterable[Grabbed] | None = None
        self.begin()

    def __repr__(self) -> str:
        return f"Line(part {self.part}: {len(self)} of {self.station.sequence.images} frames)"

    def __len__(self) -> int:
        """Return the number of frames of the part so far."""
        return self._sums.count

    def begin(self) -> None:
        """Begin the next part; what was taken of one that is not decided is left."""
        sequence = self.station.sequence
        self._sums = Accumulator(sequence.fusion, sequence.lag)
        self._samples: list[NDArray[Any]] = []
        self._time: float | None = None
        self._failure: str | None = None
        self.part += 1

    def take(self, frames: Iterable[Grabbed]) -> PartDecision:
        """Take the frames of the next part from a camera, and decide on it.

        Parameters
        ----------
        frames : iterable of Grabbed
            As :mod:`gpuspec.captured.cameras` gives them; as many are taken as the part has, fewer
            if some of them were lost. Numbers go on from part to part of one iterator; another
            begins anew.

        Returns
        -------
        PartDecision

        Raises
        ------
        FrameError
            As of :meth:`add` and :meth:`decide`, when the part's other frames are taken too; the
            line is then ready for the next part.

        Examples
        --------
        >>> from gpuspec.captured.cameras import Grabbed
        >>> station = gpuspec.Station(sequence={"images": 3}, decision=[{"area_min_mm2": 0.1}])
        >>> line = gpuspec.Line(station)
        >>> even = np.full((60, 80), 60, np.uint8)
        >>> camera = iter([Grabbed(even, n, n / 20) for n in range(3)] +
        ...               [Grabbed(even, n, n / 20) for n in (3, 5)])
        >>> line.take(camera).accepted
        True
        >>> line.take(camera)
        Traceback (most recent call last):
            ...
        gpuspec.errors.FrameError: part 2: frame 4 was lost, for frame 5 came after frame 3; take
            the part again.
        """
        if len(self) or self._failure:
            self.begin()
        if frames is not self._camera:
            self._camera, self._number = frames, None
        images, first, wrong = self.station.sequence.images, None, None
        try:
            for count, one in enumerate(frames, 1):
                first = one.number if first is None else first
                try:
                    self.add(*one)
                except FrameError as error:
                    wrong = wrong or error
                if max(count, one.number - first + 1) >= images:
                    break
            if wrong:
                raise wrong
            return self.decide()
        except FrameError:
            self.begin()
            raise

    def add(
        self,
        frame: NDArray[Any] | None,
        number: int | None = None,
        time_s: float | None = None,
        why: str = "",
    ) -> None:
        """Add the part's next frame.

        Parameters
        ----------
        frame : ndarray of uint8 or uint16, shape (M, N), or None
            It is not kept: the camera may write over it. None: it could not be grabbed.
        number : int, optional
            The camera's own (its block or frame ID), which grows by one a frame, from part to part
            too; None: lost frames are not noticed until the part is decided.
        time_s : float, optional
            When it was taken, by any clock; None: late frames are not noticed.
        why : str
            Why it could not be grabbed.

        Raises
        ------
        FrameError
            If a frame was lost, could not be grabbed, is late, is unlike the others, has another
            size than the station says, or is one too many.
        """
        said = f"frame {len(self) + 1 if number is None else number}"
        if self._failure:
            self._number = number
            raise FrameError(self._failure)
        before, self._number = self._number, number
        images = self.station.sequence.images
        if len(self) == images:
            self._fail(f"{said} is one more than its {images}; decide on the part before")
        after = None if before is None else 1 if (before, number) == _WRAPPED else before + 1
        if number is not None and after is not None and number != after:
            self._fail(_lost(after - 1, number))
        if time_s is not None:
            late = None if self._time is None else time_s - self._time
            if late is not None and self._gap_s is not None and late > self._gap_s:
                self._fail(
                    f"{said} is late: it came {late:.3f} s after the one before, and "
                    f"{self._gap_s:g} s are allowed; take the part again"
                )
            self._time = time_s
        if frame is None:
            reason = f": {why.rstrip('.')}" if why else ""
            self._fail(f"{said} could not be grabbed{reason}; take the part again")
        try:
            self._sums.add(frame, said)
            self._samples.append(sampled(frame).copy())
        except FrameError as error:
            self._fail(str(error).rstrip("."))
        if len(self) == 1:
            self._check_size(said, frame.shape)

    def decide(self) -> PartDecision:
        """Decide on the part whose frames were added, and begin the next.

        Returns
        -------
        PartDecision

        Raises
        ------
        FrameError
            If frames are missing or one was wrong, nothing can be seen in them, or their size is
            not that of the region, the dark or the flat frame.
        """
        if self._failure:
            raise FrameError(self._failure)
        images = self.station.sequence.images
        if len(self) < images:
            self._fail(
                f"{len(self)} of {images} frames came, so {images - len(self)} were lost; take the "
                f"part again"
            )
        aspect = self._sums.fused()
        self._check(aspect)
        inside = self._ready(aspect.shape)
        aspect = self._shading.corrected(aspect, self.station.sequence.fusion, inside)
        ceiling, untold, _ = ceiling_for(
            self._samples, aspect, inside, self._fitted,
            lit_as_said=says_light(self.station), rate=stated_rate(self.station),
        )  # fmt: skip
        found = inspect(aspect, inside, self._fitted, ceiling=ceiling, untold=untold)
        decision = decide(found.blobs, found.classes, self._rules)
        decided = PartDecision(self.part, decision, found, aspect)
        self.begin()
        return decided

    def _fail(self, why: str) -> NoReturn:
        self._failure = f"part {self.part}: {why}."
        raise FrameError(self._failure)

    def _check_size(self, said: str, shape: tuple[int, ...]) -> None:
        """Refuse frames of another size than the station's, where its file says one.

        An inspection shows the frames it was given; nobody looks at those of a line, and a cut of
        them has fewer blobs.
        """
        camera, stated = self.station.camera, _stated_shape(self.station)
        # What follows from the part's size is a pixel more or less by how it is rounded.
        off = [0 if due is None else abs(due - n) for due, n in zip(stated, shape, strict=True)]
        if off[0] > (camera.rows is None) or off[1] > (camera.columns is None):
            due = self.station.shape
            self._fail(
                f"{said} has {shape[1]} x {shape[0]} pixels, and by {self.station.file} the image "
                f"has {due[1]} x {due[0]}; take frames of that size, or set camera.columns = "
                f"{shape[1]} and camera.rows = {shape[0]} if they show the whole part"
            )

    def _check(self, aspect: Image) -> None:
        full = self.station.sensor.full_scale_dn
        highest = float(aspect.max())
        if highest > full:
            self._fail(
                f"its frames reach {highest:,.0f} DN, above the full scale of sensor.bit_depth = "
                f"{self.station.sensor.bit_depth}; set it to what the camera gives"
            )
        if self.station.sequence.fusion in ("mean", "max", "min"):
            if highest == 0:
                self._fail("all frames are black; check the light and the shutter")
            if float(aspect.min()) == full:
                self._fail("all frames are saturated everywhere; take a shorter exposure")

    def _ready(self, shape: tuple[int, ...]) -> Mask:
        """Return the region, worked out with the first part's size."""
        if self._inside is None or self._inside.shape != shape:
            rows, columns = shape
            size = (rows, columns)
            everything = np.full(size, True)
            inside = everything if self._region is None else outlined(self._region, size)
            self._shading = shading_of(self._dark, self._flat, size)
            self._fitted = self.station.replace(camera={"rows": rows, "columns": columns})
            self._inside = inside
        return self._inside


def _stated_shape(station: Station) -> tuple[int | None, int | None]:
    """Return rows and columns of the frames as a station's file says them, None where it does not.

    It says them as ``camera.rows`` and ``camera.columns``, or by the part's size and the sampling.
    """
    camera, part = station.camera, station.part
    sampled_as_said = "sampling_mm" in {*camera.model_fields_set, *camera.following}
    said = {*part.model_fields_set, *station.sides_of_map}
    return (
        station.shape[0] if camera.rows or (sampled_as_said and "width_mm" in said) else None,
        station.shape[1] if camera.columns or (sampled_as_said and "length_mm" in said) else None,
    )


def _lost(before: int, number: int) -> str:
    """Say which frames did not come between two that did."""
    if number <= before:
        return f"frame {number} came after frame {before}; frames come in their order, each once"
    missing = number - before - 1
    if missing == 1:
        said = f"frame {before + 1} was"
    else:
        said = f"frames {before + 1} to {number - 1} were"
    return f"{said} lost, for frame {number} came after frame {before}; take the part again"
