"""Parts on the device: each geometry is traced once per part, and its levels counted from there."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE
from gpuspec.light.backend import Backend
from gpuspec.light.levels import LevelCounter, Levels, Sample, Zones
from gpuspec.light.light_map import LIGHT
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect, Truth
from gpuspec.simulation.cautions.light import of_light
from gpuspec.simulation.memory import check_memory
from gpuspec.station.station import Station
from gpuspec.sweeps.plan import with_part
from gpuspec.sweeps.trying.screening import draw

# Of a light map on a device, per pixel: light coordinate, footprint, irradiance, reason of loss.
BYTES_PER_PIXEL = 13
_PLACED_KEPT = 64
# Designs counted between two looks at whether to stop: a quarter of a second on two slow cores.
_TOGETHER = {False: 32, True: 512}


class StoppedError(Exception):
    """Whoever wanted the rows does no more."""


@dataclass(frozen=True)
class Placed:
    """A part with its defects: what every tunnel leaves as it is.

    Attributes
    ----------
    relief : Relief
    zones : Zones
        As if every pixel were on the part.
    defects : tuple of KnownDefect
    """

    relief: Relief
    zones: Zones
    defects: tuple[KnownDefect, ...]


@dataclass(frozen=True)
class TracedPart:
    """A part under one geometry.

    Attributes
    ----------
    counter : LevelCounter
    zones : Zones
    sample : Sample or None
    notes : tuple of str
        On how much of it sees no light; of the first part alone.
    """

    counter: LevelCounter
    zones: Zones
    sample: Sample | None
    notes: tuple[str, ...] = ()


class Parts:
    """The parts of a sweep, traced when asked for and kept on the device as memory allows.

    Parameters
    ----------
    backend : Backend
    count : int
        Number of parts.
    samples : int
        Strata of the screening sample per part; 0: none is drawn.

    Attributes
    ----------
    traced : int
        Light maps traced so far.
    stopped : threading.Event
        Set from another thread, it ends the counting within a second by StoppedError.
    """

    def __init__(self, backend: Backend, count: int, samples: int) -> None:
        self.backend = backend
        self.count = count
        self.samples = samples
        self.traced = 0
        self.stopped = Event()
        self._placed: OrderedDict[str, Placed] = OrderedDict()
        self._bare: tuple[str, NDArray[np.floating[Any]]] | None = None
        self._kept: OrderedDict[tuple[str, int, bool], TracedPart] = OrderedDict()

    def levels(
        self, stations: Sequence[Station], *, sampled: bool
    ) -> tuple[list[Levels], list[TracedPart]]:
        """Count the levels of every part under designs of one geometry.

        Parameters
        ----------
        stations : sequence of Station
            Of one geometry, with part 0.
        sampled : bool
            Whether the sample may stand for the pixels outside the zones.

        Returns
        -------
        levels : list of Levels
            One for each part.
        parts : list of TracedPart

        Raises
        ------
        StationError
            If the geometry cannot be: a population that does not fit, an image that the memory
            does not hold.
        """
        found, parts = [], []
        for number in range(self.count):
            part = self._part(stations[0], number, sampled=sampled)
            own = stations
            if number and any(station.sensor.noise for station in stations):
                own = [with_part(station, number) for station in stations]
            found.append(self._counted(part, own, _TOGETHER[sampled]))
            parts.append(part)
        return found, parts

    def _counted(self, part: TracedPart, stations: Sequence[Station], together: int) -> Levels:
        found = Levels.empty(len(stations), len(part.zones.sizes))
        every = np.arange(len(stations))
        for some in np.split(every, range(together, len(every), together)):
            if self.stopped.is_set():
                raise StoppedError
            found.put(some, part.counter.count([stations[i] for i in some]))
        return found

    def _part(self, station: Station, number: int, *, sampled: bool) -> TracedPart:
        sampled = sampled and self.samples > 0
        key = (_geometry(station), number, sampled)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        check_memory(station)
        rows, columns = station.shape
        size = rows * columns * BYTES_PER_PIXEL * station.camera.subsampling**2
        while len(self._kept) >= max(self.backend.memory_bytes // size, 1):
            self._kept.popitem(last=False)
        # Light maps of another geometry are not wanted again.
        for other in [k for k in self._kept if k[0] != key[0]]:
            del self._kept[other]
        part = self._trace(with_part(station, number), number, sampled)
        self._kept[key] = part
        return part

    def _trace(self, station: Station, number: int, sampled: bool) -> TracedPart:
        placed = self._place(station)
        light_map = self.backend.trace(station, placed.relief)
        self.traced += 1
        lost = light_map.lost()
        zones = placed.zones.only(lost != BESIDE)
        sample = None
        if sampled and station.camera.subsampling == 1:
            flawless = self._flawless(station)
            sample = draw(zones, light_map.read(), flawless, self.samples, number)
        notes = () if number else tuple(of_light(station, lost))
        return TracedPart(light_map.counter(zones, sample), zones, sample, notes)

    def _flawless(self, station: Station) -> NDArray[np.floating[Any]]:
        """Return the footprints of the part without defects, shape (M, N)."""
        key = _geometry(station.replace(defects=(), populations=()))
        if self._bare is None or self._bare[0] != key:
            light_map = self.backend.trace(station.replace(defects=(), populations=()))
            self._bare = key, light_map.read().footprint_mm[0]
        return self._bare[1]

    def _place(self, station: Station) -> Placed:
        """Return relief and zones, which no change of the tunnel moves."""
        key = _key(station, ("tunnel", "sensor", "sequence"))
        if key not in self._placed:
            relief = Relief.of(station)
            truth = Truth.of(station, relief)
            everywhere = np.broadcast_to(np.True_, station.shape)
            zones = Zones.of(truth.labels, everywhere, len(truth.defects))
            self._placed[key] = Placed(relief, zones, truth.defects)
            while len(self._placed) > _PLACED_KEPT:
                self._placed.popitem(last=False)
        self._placed.move_to_end(key)
        return self._placed[key]


def _key(station: Station, without: tuple[str, ...]) -> str:
    data = station.model_dump(exclude={*without, "segmentation", "classes", "sweep"}, mode="json")
    return json.dumps(data)


def _geometry(station: Station) -> str:
    """Return what a light map depends on, as text."""
    tunnel: dict[str, Any] = station.tunnel.model_dump(
        exclude={key for section, key in LIGHT if section == "tunnel"}
    )
    return json.dumps(tunnel) + _key(station, ("tunnel", "sensor", "sequence"))
