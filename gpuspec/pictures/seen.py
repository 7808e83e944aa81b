"""What a picture is drawn of: any inspection, simulated or not, that has these."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.detection.measures import Blobs
from gpuspec.detection.score import Score
from gpuspec.light.backend import DeviceInfo
from gpuspec.light.light_map import LightMap
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect
from gpuspec.station.station import Station


class Inspected(Protocol):
    """An inspection; attributes as :class:`gpuspec.simulation.result.Result` explains them."""

    @property
    def station(self) -> Station:
        """The station."""

    @property
    def info(self) -> DeviceInfo:
        """What made the images."""

    @property
    def aspect(self) -> Image:
        """Aspect image, DN, shape (M, N)."""

    @property
    def lost(self) -> NDArray[np.uint8]:
        """Why a pixel sees no light, (M, N): index into ``arrays.LOST``."""

    @property
    def truth(self) -> NDArray[np.int32]:
        """Zones, (M, N): 0 flawless, i the i-th of ``defects``."""

    @property
    def defects(self) -> tuple[KnownDefect, ...]:
        """The known defects."""

    @property
    def labels(self) -> NDArray[np.int32]:
        """Blobs, (M, N)."""

    @property
    def blobs(self) -> Blobs:
        """Their measures."""

    @property
    def classes(self) -> NDArray[np.str_]:
        """Class of each blob."""

    @property
    def threshold(self) -> float:
        """Grey level above which a pixel was detected, DN."""

    @property
    def flawless_dn(self) -> float:
        """Median grey level of the part, DN."""

    @property
    def score(self) -> Score:
        """How good that is."""

    @property
    def light_map(self) -> LightMap:
        """For single images."""

    @property
    def relief(self) -> Relief:
        """The part's relief."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting the score."""
