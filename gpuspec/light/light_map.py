"""What a backend is: it traces a station to a light map, from which every image comes.

Nothing downstream of an aspect image knows which backend made it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from operator import index
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from gpuspec.arrays import Image
from gpuspec.errors import BackendError, StationError
from gpuspec.light.levels import LevelCounter, Levels, Sample, Zones, levels_of
from gpuspec.light.patterns import Pattern
from gpuspec.shown import array, object_of
from gpuspec.station.station import Station

FUSIONS = ("mean", "max", "min", "std", "differential")
LIGHT = (("tunnel", "luminous_mm"), ("tunnel", "dark_mm"), ("tunnel", "dark_leak"))
"""Sections and keys that leave a light map as it is, beside the sensor's and the sequence's."""


@dataclass(frozen=True)
class LightMapArrays:
    """A light map brought home.

    Attributes
    ----------
    light_mm, footprint_mm, irradiance : ndarray, shape (n * n, M, N)
        Light coordinate, footprint and relative irradiance of each sub-ray, sub-rays row by
        row within the pixel; irradiance 0 where lost.
    lost : ndarray of uint8, shape (M, N)
        Index into ``LOST``: why a pixel sees no light.
    """

    light_mm: NDArray[Any]
    footprint_mm: NDArray[Any]
    irradiance: NDArray[Any]
    lost: NDArray[np.uint8]

    def __repr__(self) -> str:
        units = {"light_mm": "mm", "footprint_mm": "mm", "irradiance": "relative", "lost": "codes"}
        parts = {name: array(getattr(self, name), unit) for name, unit in units.items()}
        return object_of("LightMapArrays", "sub-rays, rows, columns", parts)


class LightMap(ABC):
    """A traced station. Stripes, sequence and sensor may change without tracing again.

    Every method takes a station of the same geometry, or the traced one if None. Another geometry
    is refused with a StationError. The memory that it takes on the device is given back with the
    last that knows it, by `release()`, or at the end of a block::

        with backend.trace(station) as light_map:
            image = light_map.aspect()

    A light map that was released refuses with a BackendError.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> light_map = gpuspec.open_backend().trace(station)
    >>> darker = station.replace(sensor__exposure=2)  # another design of the same geometry
    >>> [f"{np.median(light_map.aspect(s)):.1f} DN" for s in (station, darker)]
    ['92.4 DN', '82.8 DN']
    """

    station: Station
    pattern: Pattern | None = None
    released: bool = False

    def __repr__(self) -> str:
        rows, columns = self.station.shape
        rays = self.station.camera.subsampling**2
        lit = f", lit by {self.pattern.file}" if self.pattern else ""
        if self.released:
            return f"{type(self).__name__}({self.station.file}{lit}; released)"
        return (
            f"{type(self).__name__}({self.station.file}: {columns} x {rows} pixels of {rays} "
            f"sub-ray{'s' * (rays > 1)}{lit}; read() gives light_mm, footprint_mm, irradiance, "
            f"image(k) and aspect() grey levels in DN)"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Give the device's memory back; the light map is of no use any more."""
        self.released = True

    def held(self) -> None:
        """See that it was not released.

        Raises
        ------
        BackendError
            If it was.
        """
        if self.released:
            raise BackendError(
                f"the light map of {self.station.file} was released, and its memory is given "
                f"back; trace the station again, or release it later."
            )

    def _repr_png_(self) -> bytes | None:
        """Show itself in a notebook: the aspect image it gives, black to full scale."""
        if self.released:
            return None
        from gpuspec.shown import grey_png

        return grey_png(self.aspect(), self.station.sensor.full_scale_dn)

    def with_pattern(self, pattern: Pattern) -> LightMap:
        """Return the light map lit by a user's pattern in place of the stripes.

        Raises
        ------
        BackendError
            If the backend does not run patterns.
        PatternError
            If the pattern does not compile.
        """
        raise BackendError(
            f"{pattern.file} is a shader: it runs on --backend opengl or vulkan, not on this one."
        )

    def failures(self) -> AbstractContextManager[None]:
        """Turn a driver's failures into sentences."""
        return nullcontext()

    def faulty(self) -> float:
        """Return the share of a pattern's samples, in some images, that are no radiance."""
        self.held()
        return 0.0

    def lit_by(self, station: Station | None) -> Station:
        """Return the station to take images of: the one given, or the traced one if None.

        Raises
        ------
        StationError
            If it has another geometry than the traced one.
        BackendError
            If the light map was released.
        """
        self.held()
        if station is None or station is self.station:
            return self.station
        station = Station.of(station)
        differ = _differing(self.station, station)
        if differ:
            raise StationError(
                f"{station.file}: {differ}, and a light map holds for one geometry alone; trace "
                f"the station anew, e.g. by gpuspec.simulate."
            )
        return station

    def under(self, station: Station) -> Station:
        """Return the traced station under another's tunnel, sensor and sequence.

        For sweeps, which see to the geometry: seeds of another part are not another one.
        """
        own = {name: getattr(station, name) for name in ("tunnel", "sensor", "sequence")}
        return self.station.model_copy(update=own)

    def image_number(self, k: int, station: Station) -> int:
        """Return k, checked to be one of the sequence's images.

        Parameters
        ----------
        k : int
        station : Station
            Its sequence is meant.

        Raises
        ------
        StationError
            If it is none.
        """
        images = station.sequence.images
        try:
            number = -1 if isinstance(k, (bool, np.bool_)) else index(k)
        except TypeError:  # arrays, too
            number = -1
        if not 0 <= number < images:
            raise StationError(
                f"{station.file}: there is no image {k!r}; sequence.images = {images}, numbered "
                f"0 to {images - 1}."
            )
        return number

    @abstractmethod
    def read(self) -> LightMapArrays:
        """Bring the light map home.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> arrays = gpuspec.open_backend().trace(station).read()
        >>> arrays.light_mm.shape, f"{np.median(arrays.footprint_mm):.2f} mm"
        ((1, 100, 400), '1.19 mm')
        """

    @abstractmethod
    def lost(self) -> NDArray[np.uint8]:
        """Return why each pixel sees no light: indices into ``LOST``, shape (M, N).

        Examples
        --------
        >>> from gpuspec.arrays import LOST
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> lost = gpuspec.open_backend().trace(station.replace(tunnel__length_mm=200.0)).lost()
        >>> {LOST[code]: int(count) for code, count in enumerate(np.bincount(lost.flat)) if count}
        {'seen': 29002, "past the tunnel's end": 10998}
        """

    @abstractmethod
    def image(self, k: int, station: Station | None = None) -> Image:
        """Return one image of the sequence.

        Parameters
        ----------
        k : int
            From 0.
        station : Station, optional
            Another design of the traced geometry; None: the traced one.

        Returns
        -------
        ndarray of float32, shape (M, N)
            In DN.

        Raises
        ------
        StationError
            If there is no such image, or the station has another geometry.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> light_map = gpuspec.open_backend().trace(station)
        >>> image = light_map.image(0)
        >>> image.shape, float(image.min()), float(image.max())
        ((100, 400), 0.0, 255.0)
        >>> light_map.image(40)
        Traceback (most recent call last):
            ...
        gpuspec.errors.StationError: trim.toml: there is no image 40; sequence.images = 40,
            numbered 0 to 39.
        """

    @abstractmethod
    def mean(self, station: Station | None = None) -> Image:
        """Return the mean of all images, each worked out, in DN, shape (M, N)."""

    @abstractmethod
    def fuse(self, station: Station | None = None) -> dict[str, Image]:
        """Return every fusion of ``FUSIONS`` in DN, each (M, N), without holding the sequence.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> fused = gpuspec.open_backend().trace(station).fuse()
        >>> sorted(fused)
        ['differential', 'max', 'mean', 'min', 'std']
        """

    @abstractmethod
    def closed_form(self, station: Station | None = None) -> Image:
        """Return the noise-free mean over whole periods in closed form, in DN, shape (M, N)."""

    def counter(self, zones: Zones, sample: Sample | None = None) -> LevelCounter:
        """Return what counts levels of the aspect image under many designs of this geometry.

        Parameters
        ----------
        zones : Zones
            Of the traced part.
        sample : Sample, optional
            Pixels that may stand for all those outside the zones; None: all are counted.
        """
        self.held()
        return _ImageCounter(self, zones)

    def aspect(self, station: Station | None = None) -> Image:
        """Return the aspect image in DN, shape (M, N), by the fastest exact way.

        That is the closed form of the mean where the model allows it (`has_closed_form`), else
        the images one by one.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> aspect = gpuspec.open_backend().trace(station).aspect()
        >>> aspect.shape, f"{np.median(aspect):.1f} DN"
        ((100, 400), '92.4 DN')
        """
        station = self.lit_by(station)
        if self.pattern is None and has_closed_form(station):
            return self.closed_form(station)
        if station.sequence.fusion != "mean":
            return self.fuse(station)[station.sequence.fusion]
        return self.mean(station)


@dataclass(frozen=True)
class _ImageCounter:
    """Counts levels of aspect images brought home one by one: exact, whatever the sample."""

    light_map: LightMap
    zones: Zones

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = Levels.empty(len(stations), len(self.zones.sizes))
        for i, station in enumerate(stations):
            image = self.light_map.aspect(self.light_map.under(station))
            found.put(np.array([i]), levels_of(image, self.zones, station.sensor.full_scale_dn))
        return found


def _differing(traced: Station, station: Station) -> str:
    """Return what of the geometry differs, with both values; "" if nothing does."""
    for name in ("part", "camera", "tunnel"):
        old, new = getattr(traced, name), getattr(station, name)
        if old is new:
            continue
        for key in type(old).model_fields:
            was, now = getattr(old, key), getattr(new, key)
            if was != now and (name, key) not in LIGHT:
                if isinstance(was, BaseModel) or isinstance(now, BaseModel):
                    return f"its {name}.{key} is another than that traced"
                return f"{name}.{key} is {now} and was {was} when it was traced"
    for name in ("defects", "populations"):
        if getattr(traced, name) != getattr(station, name):
            return f"its {name} are others than those traced"
    for name in station.files:  # of one name, but in another folder
        was, now = (one.locate(name).resolve() for one in (traced, station))
        if was != now:
            return f"{name} is {now} and was {was} when it was traced"
    return ""


def has_closed_form(station: Station) -> bool:
    """Whether a station's aspect image has a closed form.

    A mean does over whole periods in equal steps, without noise, with one footprint per pixel.

    Examples
    --------
    >>> from gpuspec.light.light_map import has_closed_form
    >>> station = gpuspec.example("trim")
    >>> has_closed_form(station), has_closed_form(station.replace(sensor__noise=True))
    (True, False)
    """
    return (
        station.sequence.fusion == "mean"
        and station.distinct_shifts is not None
        and not station.sensor.noise
        and station.camera.subsampling == 1
    )
