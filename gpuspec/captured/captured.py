"""An inspected sequence of a real camera, as it is handed on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image
from gpuspec.detection.classes import Confusion
from gpuspec.detection.decision import Decision, decide, decision_rules
from gpuspec.detection.inspection import Found, Inspection
from gpuspec.detection.score import Score
from gpuspec.frames.silhouette import Silhouette
from gpuspec.light.backend import DeviceInfo
from gpuspec.report.captured import FrameRow
from gpuspec.shown import array, html_page, object_of
from gpuspec.station.station import Station
from gpuspec.words import plural

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Zone:
    """A known defect of which nothing but its zone is known.

    Attributes
    ----------
    kind : str
    size_mm, length_mm : float
        Minor and major axis of its zone; the length 0 unless it is three times as long as wide.
    depth_um : None
        Not known.
    """

    kind: str
    size_mm: float
    length_mm: float
    depth_um: None = None


@dataclass(frozen=True, eq=False)
class Captured(Found):
    """An inspected sequence: aspect image and what was found in it.

    Attributes
    ----------
    station : Station
        With the frames' size, depth and number in place of its own.
    info : DeviceInfo
        What added the frames up.
    aspect : ndarray of float32, shape (M, N)
        Aspect image, DN.
    region : ndarray of bool, shape (M, N)
        Pixels that are inspected.
    inspection : Inspection
    frames : tuple of FrameRow
        What each frame was, and whether it was used.
    truth : ndarray of int32, shape (M, N)
        Zones of known defects: 0 flawless, i the i-th of ``defects``; all 0 if none was given.
    defects : tuple of Zone
    score, confusion : Score and Confusion, or None
        None if no truth was given.
    made_with : mapping of str to str
        What else the image was made with: dark, flat, region.
    warnings : tuple of str
        What to know before trusting it.
    silhouette : Silhouette or None
        The part's outline against the nominal one, if it was asked for.
    """

    station: Station
    info: DeviceInfo
    aspect: Image
    region: NDArray[np.bool_]
    inspection: Inspection
    frames: tuple[FrameRow, ...]
    truth: NDArray[np.int32]
    defects: tuple[Zone, ...] = ()
    score: Score | None = None
    confusion: Confusion | None = None
    made_with: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    silhouette: Silhouette | None = None

    def __repr__(self) -> str:
        rows, columns = self.aspect.shape
        parts = {
            "aspect": array(self.aspect, "grey levels in DN"),
            "labels": array(
                self.labels, f"{plural(len(self.blobs), 'blob')} above {self.threshold:.1f} DN"
            ),
        }
        if self.station.decision:
            parts["decision"] = str(self.decision)
        if self.silhouette:
            parts["silhouette"] = self.silhouette.told
        if self.score:
            parts = {"score": str(self.score), **parts}
        if self.warnings:
            parts["warnings"] = f"{len(self.warnings)}, the first: {self.warnings[0]}"
        return object_of("Captured", f"{self.made}: {columns} x {rows} pixels", parts)

    @property
    def used(self) -> tuple[FrameRow, ...]:
        """The frames that the aspect image is made of."""
        return tuple(frame for frame in self.frames if frame.used)

    @property
    def made(self) -> str:
        """How the aspect image was made, in a few words."""
        return f"{self.station.sequence.fusion} of {plural(len(self.used), 'frame')}"

    @property
    def about(self) -> str:
        """What the picture is of, in a line."""
        used = self.used
        rows, columns = self.aspect.shape
        ends = used[0].name if len(used) == 1 else f"{used[0].name} to {used[-1].name}"
        extra = "".join(f"  ·  {name} {said}" for name, said in self.made_with.items())
        return (
            f"{ends}  ·  {columns} × {rows} px of {self.station.sensor.bit_depth} bit, "
            f"{self.station.camera.sampling_mm:g} mm/px{extra}"
        )

    @cached_property
    def lost(self) -> NDArray[np.uint8]:
        """Code of ``arrays.LOST``: beside the part where nothing is inspected, shape (M, N)."""
        return np.where(self.region, 0, BESIDE).astype(np.uint8)

    @cached_property
    def decision(self) -> Decision:
        """Whether the part is accepted, by the station's rules."""
        return decide(self.blobs, self.classes, decision_rules(self.station))

    def picture(self, name: str) -> Figure:
        """Draw one of the pictures.

        Parameters
        ----------
        name : str
            ``"aspect"``, ``"detection"`` or ``"histogram"``.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        StationError
            If there is none of that name.
        """
        from gpuspec.pictures.all import IMAGE_FIGURES, figure_of

        return figure_of(self, name, IMAGE_FIGURES)

    def save(
        self,
        folder: str | Path,
        *,
        pictures: bool = True,
        force: bool = False,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        """Write the files of an inspection into a folder.

        Parameters
        ----------
        folder : str or Path
            Made if missing. Files of an earlier inspection in it are replaced, and no others.
        pictures : bool
            Whether to draw the pictures.
        force : bool
            Whether files of the same names are replaced that are not known to be an earlier
            inspection's; what was read never is.
        progress : callable, optional
            Told what is being written.

        Raises
        ------
        OutputError
            If a file is in the way, or the folder cannot be written.
        """
        from gpuspec.report.captured import outputs, write_files

        read = tuple(frame.path for frame in self.frames if frame.path)
        with outputs(self.station, folder, read, force=force).writing() as partial:
            write_files(self, partial, pictures=pictures, progress=progress)

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook: what was found."""
        from gpuspec.pictures.page import png

        return png(self.picture("detection"))

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what it is, what was found, and the aspect image."""
        from gpuspec.pictures.page import png

        return html_page(self, *(png(self.picture(name)) for name in ("detection", "aspect")))
