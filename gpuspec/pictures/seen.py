"""What a picture is drawn of: an inspection of any frames, and what only a simulated one has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.detection.inspection import Inspection
from gpuspec.detection.measures import Blobs
from gpuspec.detection.score import Score
from gpuspec.light.backend import DeviceInfo
from gpuspec.light.light_map import LightMap
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect
from gpuspec.station.station import Station


class Known(Protocol):
    """A known defect, as far as a caption tells it; see :class:`gpuspec.part.truth.KnownDefect`."""

    @property
    def kind(self) -> str:
        """What it is."""

    @property
    def size_mm(self) -> float:
        """Diameter or width."""

    @property
    def length_mm(self) -> float:
        """Length of a scratch, else 0."""

    @property
    def depth_um(self) -> float | None:
        """Depth, if it is known."""


class Levelled(Protocol):
    """An aspect image with its levels, of which grey is made."""

    @property
    def station(self) -> Station:
        """The station."""

    @property
    def aspect(self) -> Image:
        """Aspect image, DN, shape (M, N)."""

    @property
    def threshold(self) -> float:
        """Grey level above which a pixel was detected, DN."""

    @property
    def flawless_dn(self) -> float:
        """Median grey level of the part, DN."""


class Inspected(Levelled, Protocol):
    """An inspection; attributes as :class:`gpuspec.simulation.result.Result` explains them."""

    @property
    def made(self) -> str:
        """How the aspect image was made, in a few words."""

    @property
    def about(self) -> str:
        """What matters most of how it was taken, in a line."""

    @property
    def info(self) -> DeviceInfo:
        """What made the images."""

    @property
    def lost(self) -> NDArray[np.uint8]:
        """Why a pixel sees no light, (M, N): index into ``arrays.LOST``."""

    @property
    def truth(self) -> NDArray[np.int32]:
        """Zones, (M, N): 0 flawless, i the i-th of ``defects``."""

    @property
    def defects(self) -> Sequence[Known]:
        """The known defects."""

    @property
    def inspection(self) -> Inspection:
        """What was found in the aspect image, and how its threshold came about."""

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
    def score(self) -> Score | None:
        """How good that is; None where no defects are known."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting it."""


class Previewed(Levelled, Protocol):
    """Some pixels of a station; attributes as :class:`gpuspec.simulation.preview.Preview` has."""

    @property
    def labels(self) -> NDArray[np.int32]:
        """Blobs, (M, N)."""

    @property
    def truth(self) -> NDArray[np.int32]:
        """Zones, (M, N)."""

    @property
    def step(self) -> int:
        """How many pixels of the image they are apart."""


class Simulated(Inspected, Protocol):
    """An inspection of a station that was simulated."""

    @property
    def defects(self) -> tuple[KnownDefect, ...]:
        """The known defects."""

    @property
    def score(self) -> Score:
        """How good it is."""

    @property
    def light_map(self) -> LightMap:
        """For single images."""

    @property
    def relief(self) -> Relief:
        """The part's relief."""
