"""What a backend is: a device that traces stations to light maps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from gpuspec.errors import BackendError
from gpuspec.light.constants import NO_PIXEL
from gpuspec.light.levels import Pixels
from gpuspec.light.light_map import LightMap
from gpuspec.light.refined import RefinedLightMap
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

Settings = Mapping[str, Any]
"""What a device needs to compute, and to be fast, as JSON holds it."""


@dataclass(frozen=True)
class DeviceInfo:
    """Where images are made; recorded with every output.

    Attributes
    ----------
    backend : str
        One of ``BACKENDS``.
    device, driver : str
        As the driver names them.
    version : str
        Of the driver, or of the library.
    """

    backend: str
    device: str
    driver: str
    version: str

    def as_dict(self) -> dict[str, str]:
        """Return the fields as a dictionary."""
        return asdict(self)

    def __str__(self) -> str:
        return f"{self.backend} on {self.device} ({self.driver} {self.version})"


class Backend(ABC):
    """A device that traces stations.

    Attributes
    ----------
    info : DeviceInfo
    number : int
        Of the device, as `gpuspec devices` counts.
    memory_bytes : int
        What light maps may take of its memory.
    advice : str
        What to do where the device does not compute.
    """

    info: DeviceInfo
    number: int = 0
    memory_bytes: int = 1 << 30
    advice = (
        "Update its driver, or choose another --device or --backend; `gpuspec devices` lists them."
    )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.info})"

    def candidates(self) -> Sequence[Settings]:
        """Return the settings with which the device may compute, the best first."""
        return ({},)

    def settle(self, settings: Settings) -> None:  # noqa: B027 (most have none)
        """Take the settings with which the device is known to compute."""

    def trace_again(
        self, light_map: LightMap, station: Station, pixels: Pixels | None = None
    ) -> LightMap:
        """Trace the part of a light map under another tunnel, seen by the same camera.

        Parameters
        ----------
        light_map : LightMap
            Of this backend.
        station : Station
            Of another tunnel or, where rays meet the part at z = 0, of another crown.
        pixels : ndarray of uint32, shape (n,), optional
            Those of a list; None: the same as before.

        Raises
        ------
        BackendError
            If the backend keeps nothing to trace again with.
        """
        raise BackendError(f"{self.info} does not trace a light map again; trace the station.")

    def without(self, light_map: LightMap, places: Pixels) -> LightMap:
        """Return the light map of a list without some of its pixels, in whose place there is none.

        It takes the place of the other, in which they may see no light any more; without none it is
        the other.

        Parameters
        ----------
        light_map : LightMap
            Of this backend.
        places : ndarray of uint32
            In the list.
        """
        if not len(places):
            return light_map
        return self.trace_again(light_map, light_map.station, without(light_map, places))

    @property
    def held_bytes(self) -> int:
        """What its light maps take of the device's memory now; 0 where that is not known."""
        return 0

    screens = False
    """Whether its counters take lists of pixels in place of whole images."""

    def trace(
        self, station: Station, relief: Relief | None = None, pixels: Pixels | None = None
    ) -> LightMap:
        """Trace a station to a light map that stays on the device.

        Parameters
        ----------
        station : Station
        relief : Relief, optional
            The station's relief if already resolved.
        pixels : ndarray of uint32, shape (n,), optional
            Flat indices into the image, in any order: a light map of these pixels alone, whose
            images have the shape (1, n) and are theirs to the bit, but for the last bits of means
            made image by image. None: the whole image.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> light_map = gpuspec.open_backend("numpy").trace(station)
        >>> light_map.aspect().shape
        (100, 400)
        """
        relief = relief or Relief.of(station)
        if station.camera.subsampling != "auto":
            return self.traced(station, relief, pixels)
        return RefinedLightMap(station, relief, self.traced, pixels)

    @abstractmethod
    def traced(self, station: Station, relief: Relief, pixels: Pixels | None = None) -> LightMap:
        """Trace a station whose pixels all have the same number of sub-rays.

        Parameters
        ----------
        station : Station
        relief : Relief
            The station's.
        pixels : ndarray of uint32, shape (n,), optional
            See :meth:`trace`.
        """


def without(light_map: LightMap, places: Pixels) -> Pixels:
    """Return the pixels of a light map's list, some left out: ``NO_PIXEL`` is in their places.

    Parameters
    ----------
    light_map : LightMap
        Of a list.
    places : ndarray of uint32
        In the list.
    """
    assert light_map.pixels is not None
    fewer = light_map.pixels.copy()
    fewer[places] = NO_PIXEL
    return fewer


def chosen(backend: str, names: Sequence[str], wanted: str | None) -> int:
    """Return the number of the device asked for.

    Parameters
    ----------
    backend : str
        Its name, for the message.
    names : sequence of str
        Of its devices, in their order.
    wanted : str or None
        A number, or part of a name; None: the first.

    Raises
    ------
    BackendError
        If there is none, naming those there are.
    """
    if wanted is None:
        return 0
    for number, name in enumerate(names):
        named = not wanted.isdecimal() and wanted.lower() in name.lower()
        if named or wanted == str(number):
            return number
    known = ", ".join(f"{number} ({name.strip()})" for number, name in enumerate(names))
    raise BackendError(f"{backend}: no device {wanted!r}; choose by number or name from {known}.")


def failure(info: DeviceInfo, reason: object, *, memory: bool = False) -> BackendError:
    """Return what to say of a device that failed, where its driver only has a code.

    Parameters
    ----------
    info : DeviceInfo
    reason : object
        What the driver says.
    memory : bool
        Whether its memory is what is missing.
    """
    if memory:
        return BackendError(
            f"{info.backend}: {info.device} is out of memory ({reason}); use a larger "
            f"camera.sampling_mm, another --device or --backend numpy."
        )
    return BackendError(
        f"{info.backend}: {info.device} failed ({reason}); try another --device or --backend numpy."
    )
