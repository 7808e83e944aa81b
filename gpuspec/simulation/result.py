"""A simulated inspection, as it is handed on."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image
from gpuspec.detection.classes import Confusion
from gpuspec.detection.inspection import Inspection
from gpuspec.detection.measures import Blobs
from gpuspec.detection.score import Score
from gpuspec.light.backend import DeviceInfo
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect
from gpuspec.shown import array, object_of
from gpuspec.simulation.cautions import assumptions
from gpuspec.simulation.light_map import ScoredLightMap
from gpuspec.station.station import Station


@dataclass(frozen=True)
class Result:
    """A simulated inspection: images, what was found in them, and how good that is.

    Attributes
    ----------
    station : Station
    info : DeviceInfo
        Backend, device, driver and version that made the images.
    aspect : ndarray of float32, shape (M, N)
        Aspect image, DN.
    lost : ndarray of uint8, shape (M, N)
        Why a pixel sees no light, index into ``backends.LOST``.
    truth : ndarray of int32, shape (M, N)
        Zones: 0 flawless, i the i-th of ``defects``.
    defects : tuple of KnownDefect
    inspection : Inspection
    score : Score
    confusion : Confusion
    light_map : ScoredLightMap
        For single images: ``result.light_map.image(k)``.
    relief : Relief
    warnings : tuple of str
        What to know before trusting the score, see :mod:`gpuspec.simulation.cautions`.
    """

    station: Station
    info: DeviceInfo
    aspect: Image
    lost: NDArray[np.uint8]
    truth: NDArray[np.int32]
    defects: tuple[KnownDefect, ...]
    inspection: Inspection
    score: Score
    confusion: Confusion
    light_map: ScoredLightMap = field(repr=False, compare=False)
    relief: Relief = field(repr=False, compare=False)
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        parts = {
            "score": str(self.score),
            "aspect": array(self.aspect, "grey levels in DN"),
            "labels": array(self.labels, f"{len(self.blobs)} blobs above {self.threshold:.1f} DN"),
            "truth": array(self.truth, f"zones of {len(self.defects)} defects"),
            "lost": array(self.lost, "why a pixel sees no light"),
            "light_map": "on the device; image(k), fuse()",
        }
        if self.warnings:
            parts["warnings"] = f"{len(self.warnings)}, the first: {self.warnings[0]}"
        return object_of("Result", f"{self.station.file}, {self.info}", parts)

    @property
    def labels(self) -> NDArray[np.int32]:
        """Blobs as a label image, shape (M, N)."""
        return self.inspection.labels

    @property
    def blobs(self) -> Blobs:
        """Measures of the blobs."""
        return self.inspection.blobs

    @property
    def classes(self) -> NDArray[np.str_]:
        """Class of each blob."""
        return self.inspection.classes

    @property
    def threshold(self) -> float:
        """Grey level above which a pixel was detected, DN."""
        return self.inspection.threshold

    @property
    def flawless_dn(self) -> float:
        """Median grey level of the part, DN."""
        return self.inspection.flawless_dn

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken as ideal."""
        return assumptions(self.station)

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels on the part, shape (M, N): the others are never scored."""
        on_part: NDArray[np.bool_] = self.lost != BESIDE
        return on_part

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook: the detection over the truth."""
        from gpuspec.pictures.all import detection_picture
        from gpuspec.pictures.page import png

        return png(detection_picture(self))
