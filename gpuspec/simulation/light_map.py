"""A light map that knows its part's zones: other designs are scored without tracing again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image
from gpuspec.detection.expected import Expected, expected_score
from gpuspec.detection.inspection import Inspection, inspect
from gpuspec.detection.score import Score, score
from gpuspec.detection.segmentation import Ceiling
from gpuspec.light.backend import DeviceInfo
from gpuspec.light.ceiling import ceiling_of, untold
from gpuspec.light.devices import open_backend
from gpuspec.light.float64_noise import Moments
from gpuspec.light.levels import LevelCounter, Sample, Zones
from gpuspec.light.light_map import LightMap, LightMapArrays
from gpuspec.light.patterns import Pattern
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.station.station import Station

Progress = Callable[[str], None]


class ScoredLightMap(LightMap):
    """The light map of a result: a device's own, with the part's zones beside it.

    One that comes from a pickle or a folder is traced again when its images are first asked for,
    by the backend and on the device that traced it at first.

    Parameters
    ----------
    station : Station
    info : DeviceInfo
        What traced it, or is to trace it again.
    relief : Relief
    truth : Truth
        Zones of the part.
    lost : ndarray of uint8, shape (M, N)
        Index into ``gpuspec.arrays.LOST``.
    traced : LightMap, optional
        As it stands on the device; None: traced when asked for.
    pattern : Pattern, optional
        That lights it in place of the stripes.
    refined : mapping of int to int, optional
        What :attr:`refined` is where it was not traced yet.

    Examples
    --------
    >>> import gpuspec as gs
    >>> station = gs.example("trim").replace(camera__sampling_mm=0.5)
    >>> light_map = gs.simulate(station, "numpy").light_map
    >>> light_map.score(station.replace(sensor__exposure=6)).defects
    36
    """

    def __init__(
        self,
        station: Station,
        info: DeviceInfo,
        relief: Relief,
        truth: Truth,
        lost: NDArray[np.uint8],
        traced: LightMap | None = None,
        pattern: Pattern | None = None,
        refined: Mapping[int, int] | None = None,
    ) -> None:
        self.station, self.info, self.pattern = station, info, pattern
        self._relief, self._truth, self._lost, self._traced = relief, truth, lost, traced
        self._refined = dict(refined or (traced.refined if traced else {}))

    def __getstate__(self) -> dict[str, Any]:
        """Leave behind what stands on the device."""
        return self.__dict__ | {"_traced": None}

    @property
    def refined(self) -> dict[int, int]:
        """See :attr:`LightMap.refined`; known without a trace."""
        return self._refined

    @property
    def traced(self) -> LightMap:
        """The device's own light map, traced now if it is not there yet.

        Raises
        ------
        BackendError
            If the device that traced it at first is absent or fails, or it was released.
        """
        self.held()
        if self._traced is None:
            engine = open_backend(self.info.backend, self.info.device)
            light_map = engine.trace(self.station, self._relief)
            self._traced = light_map.with_pattern(self.pattern) if self.pattern else light_map
        return self._traced

    def inspected(
        self, station: Station | None = None, progress: Progress | None = None
    ) -> tuple[Image, Inspection, Score]:
        """Take the aspect image of a design of the same geometry, inspect and score it.

        Parameters
        ----------
        station : Station, optional
            With its own threshold, size filter and classes; None: the traced one.
        progress : callable, optional
            Told in a few words what is being done.

        Returns
        -------
        aspect : ndarray of float32, shape (M, N)
            DN.
        found : Inspection
        scored : Score

        Raises
        ------
        StationError
            If its geometry is another, or no pixel sees the part.
        """
        station = self.lit_by(station)
        tell = progress or (lambda _: None)
        on_part = self._lost != BESIDE
        tell("taking the aspect image")
        aspect = self.aspect(station)
        tell("segmenting and scoring")
        ceiling, why = self._ceiling(station)
        found = inspect(aspect, on_part, station, self._lost == 0, ceiling, why)
        zones = self._truth
        return aspect, found, score(found.labels, zones.labels, on_part, len(zones.defects))

    def _ceiling(self, station: Station) -> tuple[Ceiling | None, str]:
        """Return the ceiling for a threshold that is to be found, and why there is none."""
        if station.segmentation.threshold != "auto":
            return None, ""
        if self.pattern:
            return None, "a pattern tells no ceiling"
        return ceiling_of(station), untold(station)

    def score(self, station: Station | None = None) -> Score:
        """Score another design of the same geometry, without tracing again.

        Parameters
        ----------
        station : Station, optional
            With its own threshold; None: the traced one.

        Raises
        ------
        StationError
            If its geometry is another.
        """
        return self.inspected(station)[2]

    def expected(self, threshold: float, station: Station | None = None) -> Expected:
        """Return what noise makes of the score: expectation and spread over all its draws.

        A pixel is detected by its own level: a background, another polarity and a size filter are
        no part of it.

        Parameters
        ----------
        threshold : float
            Grey level above which a pixel is detected, DN.
        station : Station, optional
            A design of the same geometry; None: the traced one.

        Raises
        ------
        StationError
            If its geometry is another, or its noise has no closed form, see
            :func:`gpuspec.light.light_map.has_noisy_form`.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.4, sensor__noise=True)
        >>> result = gpuspec.simulate(station, "numpy")
        >>> result.light_map.expected(result.threshold)
        Expected(P1 0.244 +- 0.0006, P2 1.000 +- 0.0000; 34.00 +- 0.00 defects hit)
        """
        found = self.moments(station)
        zones, on_part = self._truth, self._lost != BESIDE
        return expected_score(
            found.mean, found.deviation, zones.labels, on_part, len(zones.defects), threshold,
            (station or self.station).sequence.images,
        )  # fmt: skip

    def with_pattern(self, pattern: Pattern) -> ScoredLightMap:
        """See :meth:`LightMap.with_pattern`."""
        lit = self.traced.with_pattern(pattern)
        return ScoredLightMap(
            self.station, self.info, self._relief, self._truth, self._lost, lit, pattern
        )

    def release(self) -> None:
        """See :meth:`LightMap.release`."""
        if self._traced is not None:
            self._traced.release()
            self._traced = None
        super().release()

    def failures(self) -> AbstractContextManager[None]:
        """See :meth:`LightMap.failures`."""
        return self.traced.failures()

    def faulty(self) -> float:
        """See :meth:`LightMap.faulty`."""
        return self.traced.faulty()

    def read(self) -> LightMapArrays:
        """See :meth:`LightMap.read`."""
        return self.traced.read()

    def lost(self) -> NDArray[np.uint8]:
        """See :meth:`LightMap.lost`; known without a trace."""
        return self._lost

    def image(self, k: int, station: Station | None = None) -> Image:
        """See :meth:`LightMap.image`."""
        return self.traced.image(k, station)

    def mean(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.mean`."""
        return self.traced.mean(station)

    def fuse(self, station: Station | None = None) -> dict[str, Image]:
        """See :meth:`LightMap.fuse`."""
        return self.traced.fuse(station)

    def closed_form(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.closed_form`."""
        return self.traced.closed_form(station)

    def moments(self, station: Station | None = None) -> Moments:
        """See :meth:`LightMap.moments`."""
        return self.traced.moments(station)

    def one_draw(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.one_draw`."""
        return self.traced.one_draw(station)

    def counter(self, zones: Zones, sample: Sample | None = None) -> LevelCounter:
        """See :meth:`LightMap.counter`."""
        return self.traced.counter(zones, sample)
