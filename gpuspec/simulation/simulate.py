"""The way through, in one place: from station and light map to blobs, classes and score."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.detection.classes import confusion
from gpuspec.light.backend import Backend, DeviceInfo
from gpuspec.light.devices import open_backend
from gpuspec.part.guard import guarded
from gpuspec.part.placement import MANY, asked_for
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.simulation.cautions.all import cautions
from gpuspec.simulation.light_map import Progress, ScoredLightMap
from gpuspec.simulation.memory import check_memory
from gpuspec.simulation.result import Result
from gpuspec.station.station import Station

_SECONDS_PER_DEFECT = 3e-5  # placed and its zone worked out, on a core of a server CPU


def simulate(
    station: Station | str | Path,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> Result:
    """Simulate an inspection station from part to score.

    Parameters
    ----------
    station : Station, str or Path
        Or the path of a station file.
    backend : str or Backend
        A name for :func:`gpuspec.light.devices.open_backend`, or an open backend.
    device : str, optional
        Part of the device's name, or its number.
    progress : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    Result

    Raises
    ------
    StationError
        If the file cannot be read, a population does not fit, or the images exceed the memory.
    TopographyError
        If a topography cannot be used.
    BackendError
        If the backend is absent or fails.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.2)
    >>> result = gpuspec.simulate(station)
    >>> result.score
    Score(P1 0.364, P2 0.998, F1 0.534; 36 of 36 defects hit, 0 of 36 blobs false)
    >>> result.aspect.shape, len(result.blobs), f"{result.threshold:.1f} DN"
    ((250, 1000), 36, '89.5 DN')
    """
    return trace(Station.of(station), backend, device, progress).result(progress=progress)


@dataclass(frozen=True)
class Traced:
    """A station whose part is placed and whose light map is traced: all that geometry decides.

    Attributes
    ----------
    station : Station
        As it was given to :func:`trace`.
    info : DeviceInfo
        Where its light map is.
    relief : Relief
    truth : Truth
    light_map : ScoredLightMap
        On the device; scores other designs of the same geometry.
    lost : ndarray of uint8, shape (M, N)
        Why a pixel sees no light, index into ``arrays.LOST``.
    """

    station: Station
    info: DeviceInfo
    relief: Relief
    truth: Truth
    light_map: ScoredLightMap
    lost: NDArray[np.uint8]

    def __repr__(self) -> str:
        return f"Traced({self.light_map!r}, {self.truth!r})"

    @cached_property
    def guard(self) -> Mask:
        """Pixels of zones and guard bands, shape (M, N)."""
        return guarded(self.station, self.relief, self.truth.labels)

    def result(
        self, light_map: ScoredLightMap | None = None, progress: Progress | None = None
    ) -> Result:
        """Take the aspect image, segment and score it.

        Parameters
        ----------
        light_map : ScoredLightMap, optional
            The traced one with another light on it; None: the station's own.
        progress : callable, optional
            Told in a few words what is being done.
        """
        light_map, station, truth = light_map or self.light_map, self.station, self.truth
        aspect, found, scored = light_map.inspected(station, progress)
        kinds = [defect.kind for defect in truth.defects]
        table = confusion(kinds, truth.labels, found.labels, found.classes)
        return Result(
            station, self.info, aspect, self.lost, truth.labels, truth.defects, found, scored,
            table, light_map, self.relief,
            cautions(
                station, self.relief, truth, self.lost, light_map, aspect, found, scored,
            ),
        )  # fmt: skip


def trace(
    station: Station,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> Traced:
    """Place a station's defects and trace it; parameters and errors as :func:`simulate`."""
    tell = progress or (lambda _: None)
    check_memory(station)
    tell(_placing(station))
    relief = Relief.of(station, tell)
    if len(relief.defects) >= MANY:
        tell(f"working out the zones of {len(relief.defects):,} defects")
    truth = Truth.of(station, relief)
    tell("opening the device")
    engine = open_backend(backend, device)
    tell(f"tracing on {engine.info.device}")
    light_map = engine.trace(station, relief)
    lost = light_map.lost()
    scored = ScoredLightMap(station, engine.info, relief, truth, lost, light_map)
    return Traced(station, engine.info, relief, truth, scored, lost)


def _placing(station: Station) -> str:
    """Say how many defects are placed where they are many, and how long that takes."""
    count = asked_for(station)
    if count < MANY:
        return "placing defects"
    seconds = count * _SECONDS_PER_DEFECT
    return f"placing {count:,} defects" + (f", about {seconds:.0f} s" if seconds > 2 else "")
