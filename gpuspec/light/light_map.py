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
from gpuspec.light.constants import NO_PIXEL
from gpuspec.light.float64_noise import Moments, drawn, noisy_moments
from gpuspec.light.levels import LevelCounter, Levels, Pixels, Sample, Zones, levels_of
from gpuspec.light.lists import Lists
from gpuspec.light.patterns import Pattern
from gpuspec.light.refinement import Neighbourhood, bend_of, counted, sides_needed
from gpuspec.shown import array, object_of
from gpuspec.station.station import Station

PLANES = 4
"""Of a light map: light coordinate, both widths of the footprint, irradiance."""

BLIND = (0.0, 1.0, 0.0, 0.0)
"""What they hold where no light is seen."""

FUSIONS = ("mean", "max", "min", "std", "differential")
_SUMMED = 1 << 20  # sub-rays whose moments are summed at once
LIGHT = tuple(
    ("tunnel", key) for key in ("luminous_mm", "dark_mm", "dark_leak", "profile", "profile_gamma")
)
"""Sections and keys that leave a light map as it is, beside the sensor's and the sequence's."""


@dataclass(frozen=True)
class LightMapArrays:
    """A light map brought home.

    Attributes
    ----------
    light_mm, wide_mm, narrow_mm, irradiance : ndarray, shape (n * n, M, N)
        Light coordinate, widths of the two boxes that are the footprint, and relative irradiance of
        each sub-ray, sub-rays row by row within the pixel; irradiance 0 where lost.
    lost : ndarray of uint8, shape (M, N)
        Index into ``LOST``: why a pixel sees no light.
    """

    light_mm: NDArray[Any]
    wide_mm: NDArray[Any]
    narrow_mm: NDArray[Any]
    irradiance: NDArray[Any]
    lost: NDArray[np.uint8]

    @property
    def footprint_mm(self) -> NDArray[Any]:
        """Width of one box of the variance of both, shape (n * n, M, N)."""
        width: NDArray[Any] = np.sqrt(self.wide_mm**2 + self.narrow_mm**2)
        return width

    def __repr__(self) -> str:
        units = dict.fromkeys(("light_mm", "wide_mm", "narrow_mm"), "mm")
        units |= {"irradiance": "relative", "lost": "codes"}
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
    ['92.1 DN', '81.7 DN']
    """

    station: Station
    pixels: Pixels | None = None
    pattern: Pattern | None = None
    released: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its images; of a list of n pixels 1 and n."""
        return self.station.shape if self.pixels is None else (1, len(self.pixels))

    def __repr__(self) -> str:
        rows, columns = self.shape
        rays, refined = self.station.camera.sub_rays, counted(self.refined)["pixels"]
        more = f", {refined:,} of them refined" if refined else ""
        lit = f", lit by {self.pattern.file}" if self.pattern else ""
        if self.released:
            return f"{type(self).__name__}({self.station.file}{lit}; released)"
        return (
            f"{type(self).__name__}({self.station.file}: {columns} x {rows} pixels of {rays} "
            f"sub-ray{'s' * (rays > 1)}{more}{lit}; read() gives light_mm, wide_mm, narrow_mm, "
            f"irradiance, image(k) and aspect() grey levels in DN)"
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

    @property
    def refined(self) -> dict[int, int]:
        """How many pixels are refined, where one footprint does not tell them, by their cut.

        See :attr:`gpuspec.station.sections.Camera.cut`.
        """
        return {}

    def sides_needed(self) -> NDArray[np.uint8]:
        """Return how many sub-rays each pixel needs on each side, shape (M, N).

        See :func:`gpuspec.light.refinement.sides_needed`; of a light map of one ray per pixel.
        """
        arrays = self.read()
        bend = bend_of(self.station.camera)
        return sides_needed(arrays.light_mm[0], arrays.wide_mm[0], bend)

    def sides_beside(self, around: Neighbourhood, places: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return how many sub-rays pixels of a list need on each side, shape (n,).

        Parameters
        ----------
        around : Neighbourhood
            Of these n pixels, all of it in the list.
        places : ndarray of int64, shape (k,)
            Where its `pixels` stand there.
        """
        arrays = self.read()
        light, wide = (plane[0, 0, places] for plane in (arrays.light_mm, arrays.wide_mm))
        return around.sides_needed(light, wide, bend_of(self.station.camera))

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
        {'seen': 29205, "past the tunnel's end": 10795}
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

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]:
        """Return noise-free means over whole periods under designs that differ in exposure alone.

        Parameters
        ----------
        station : Station
            Another design of the traced geometry, whose shifts fill whole periods.
        exposures : sequence of float
            In place of its ``sensor.exposure``.

        Returns
        -------
        ndarray of float32, shape (exposures, M, N)
            In DN; each to the bit the same, whatever the others are.
        """
        station = self.lit_by(station)
        station = without_noise(station)
        sensors = (station.sensor.model_copy(update={"exposure": e}) for e in exposures)
        designs = (station.model_copy(update={"sensor": sensor}) for sensor in sensors)
        return np.stack([self.mean(design) for design in designs])

    def together(self, parts: Sequence[LightMap]) -> Lists[LightMap]:
        """Return light maps of lists of pixels, of one station and this backend, side by side."""
        return Lists(parts)

    def noisy(self, station: Station | None) -> Station:
        """Return the station to take noise of, checked to have it in closed form.

        Raises
        ------
        StationError
            If it has not.
        """
        station = self.lit_by(station)
        if self.pattern is not None or not has_noisy_form(station):
            raise StationError(
                f"{station.file}: its noise has no closed form (`has_noisy_form` says when); take "
                f"its images one by one, by mean()."
            )
        return station

    def moments(self, station: Station | None = None) -> Moments:
        """Return mean and standard deviation of the noisy aspect image over all its draws, in DN.

        The gain and the dark signal of each pixel are its own, as in its images.

        Raises
        ------
        StationError
            If they have no closed form, see `has_noisy_form`.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5, sensor__noise=True)
        >>> moments = gpuspec.open_backend().trace(station).moments()
        >>> f"{np.median(moments.mean):.1f} +- {np.median(moments.deviation):.2f} DN"
        '92.2 +- 0.10 DN'
        """
        return self.summed_moments(self.noisy(station))

    def summed_moments(self, station: Station) -> Moments:
        """Return the same as sums over all images, in float64, with any number of sub-rays."""
        arrays = self.read()
        planes = arrays.light_mm, arrays.wide_mm, arrays.narrow_mm, arrays.irradiance
        column, row = self._every_place()
        found = Moments(*(np.empty(self.shape, np.float32) for _ in range(2)))
        some = max(_SUMMED // (len(planes[0]) * self.shape[0]), 1)
        for first in range(0, self.shape[1], some):  # a sum takes a hundred times their memory
            at = np.s_[..., first : first + some]
            own = noisy_moments([plane[at] for plane in planes], station, column[at], row[at])
            found.mean[at], found.deviation[at] = own.mean, own.deviation
        return found

    def one_draw(self, station: Station | None = None) -> Image:
        """Return the aspect image of one draw of the noise, from its moments, in DN.

        A normal number of each pixel stands for the noise of all its images: it is not the image
        that these give, but one as likely. Sweeps count it.

        Raises
        ------
        StationError
            If the moments have no closed form, see `has_noisy_form`.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5, sensor__noise=True)
        >>> light_map = gpuspec.open_backend().trace(station)
        >>> f"{light_map.one_draw()[50, 200]:.1f} DN, its images {light_map.mean()[50, 200]:.1f} DN"
        '137.3 DN, its images 137.1 DN'
        """
        station = self.noisy(station)
        return self.draw_of(self.moments(station), station)

    def draw_of(self, moments: Moments, station: Station) -> Image:
        """Return one draw of an aspect image whose moments are known, in DN.

        Parameters
        ----------
        moments : Moments
            Of all pixels.
        station : Station
        """
        return drawn(moments, station, *self._every_place()).astype(np.float32)

    def counted(self, station: Station | None = None) -> Image:
        """Return the image whose levels sweeps count: one draw of noise, else the aspect image."""
        station = self.lit_by(station)
        if self.pattern is None and has_noisy_form(station):
            return self.one_draw(station)
        return self.aspect(station)

    def _every_place(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the column and the row in the image of each pixel, each of the shape `shape`."""
        numbers = np.arange(np.prod(self.shape)) if self.pixels is None else self.pixels
        row, column = np.divmod(numbers.astype(np.int64), self.station.shape[1])
        return column.reshape(self.shape), row.reshape(self.shape)

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
        ((100, 400), '92.1 DN')
        """
        station = self.lit_by(station)
        if self.pattern is None and has_closed_form(station):
            return self.closed_form(station)
        if station.sequence.fusion != "mean":
            return self.fuse(station)[station.sequence.fusion]
        return self.mean(station)


def check_list(pixels: Pixels, station: Station) -> None:
    """See that a list of pixels is one of a station's image.

    Parameters
    ----------
    pixels : ndarray
    station : Station

    Raises
    ------
    StationError
        If it is not.
    """
    rows, columns = station.shape
    if rows * columns > NO_PIXEL:
        raise StationError(
            f"{station.file}: lists count the pixels of an image in 32 bits; {columns} x {rows} "
            f"are too many: set a larger camera.sampling_mm."
        )
    if pixels.ndim != 1 or pixels.dtype != np.uint32:
        raise StationError(f"{station.file}: a list of pixels is a row of numbers of 32 bits.")
    there = pixels[pixels != NO_PIXEL]
    if len(there) and there.max() >= rows * columns:
        raise StationError(
            f"{station.file}: there is no pixel {there.max()}; the image has {rows * columns}."
        )


@dataclass(frozen=True)
class _ImageCounter:
    """Counts levels of aspect images brought home one by one: exact, whatever the sample."""

    light_map: LightMap
    zones: Zones

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = Levels.empty(len(stations), len(self.zones.sizes))
        for i, station in enumerate(stations):
            image = self.light_map.counted(self.light_map.under(station))
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
    for name in ("defects", "populations", "edges"):
        if getattr(traced, name) != getattr(station, name):
            return f"its {name} are others than those traced"
    for name in station.files:  # of one name, but in another folder
        was, now = (one.locate(name).resolve() for one in (traced, station))
        if was != now:
            return f"{name} is {now} and was {was} when it was traced"
    return ""


# What noise in closed form was measured for: the mean of few images is no normal number, and read
# noise of more than 1 % of the saturation capacity clips what is nearly dark.
_IMAGES_MIN = 8
_CAPACITY_MIN_E = 100.0
_READ_MAX = 100.0


def without_noise(station: Station) -> Station:
    """Return a station whose sensor has no noise.

    Parameters
    ----------
    station : Station
    """
    sensor = station.sensor.model_copy(update={"noise": False})
    return station.model_copy(update={"sensor": sensor})


def has_closed_form(station: Station) -> bool:
    """Whether a station's aspect image has a closed form.

    A mean does over whole periods of stripes in equal steps, without noise, with one footprint per
    pixel (but for those refined by themselves).

    Examples
    --------
    >>> from gpuspec.light.light_map import has_closed_form
    >>> station = gpuspec.example("trim")
    >>> has_closed_form(station), has_closed_form(station.replace(sensor__noise=True))
    (True, False)
    """
    return not station.sensor.noise and _is_periodic_mean(station)


def _is_periodic_mean(station: Station) -> bool:
    return (
        station.sequence.fusion == "mean"
        and station.distinct_shifts is not None
        and station.camera.sub_rays == 1
        and station.tunnel.is_striped
    )


def has_noisy_form(station: Station) -> bool:
    """Whether mean and deviation of a station's noisy aspect image have a closed form.

    They do where the image without noise has one, of at least 8 images by a sensor of at least 100
    electrons whose read noise is at most 1 % of them. Otherwise every image is drawn.

    Examples
    --------
    >>> from gpuspec.light.light_map import has_noisy_form
    >>> station = gpuspec.example("trim").replace(sensor__noise=True)
    >>> has_noisy_form(station), has_noisy_form(station.replace(sensor__read_noise_e=1000.0))
    (True, False)
    """
    sensor = station.sensor
    return (
        sensor.noise
        and _is_periodic_mean(station)
        and station.sequence.images >= _IMAGES_MIN
        and sensor.saturation_e >= max(_CAPACITY_MIN_E, _READ_MAX * sensor.read_noise_e)
    )


def in_closed_form(station: Station) -> bool:
    """Whether the image that sweeps count has a closed form, with noise or without."""
    return has_closed_form(station) or has_noisy_form(station)
