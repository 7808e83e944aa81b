"""Parts on the device: each geometry is traced once per part, and its levels counted from there."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from threading import Event
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE
from gpuspec.light.backend import Backend
from gpuspec.light.levels import LevelCounter, Levels, Pixels, Sample, Zones
from gpuspec.light.light_map import LIGHT, LightMap, in_closed_form
from gpuspec.light.refined import with_cut
from gpuspec.light.refined_levels import RefinedCounter
from gpuspec.light.refinement import ACROSS, further
from gpuspec.part.guard import near
from gpuspec.part.placement import place
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect, Truth
from gpuspec.simulation.cautions.light import of_light, of_losses
from gpuspec.simulation.memory import check_memory
from gpuspec.station.defects import Defect
from gpuspec.station.station import Station
from gpuspec.sweeps.plan import with_part
from gpuspec.sweeps.trying.flawless import Bounds, Flawless, surveyed
from gpuspec.sweeps.trying.listing import Listing, crowd, listed
from gpuspec.sweeps.trying.noise import Noise

# Of a light map on a device, per pixel: four planes of floats and the reason of loss.
BYTES_PER_PIXEL = 17
_PLACED_KEPT = 64
Key = TypeVar("Key")
Kept = TypeVar("Kept")
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
        Of the part, its random defects placed.
    truth : Truth
        Its zones.
    near : ndarray of int64
        Flat indices of the zones' pixels and those of their guard band.
    """

    relief: Relief
    truth: Truth
    near: NDArray[np.int64]

    @classmethod
    def of(
        cls, station: Station, relief: Relief | None = None, truth: Truth | None = None
    ) -> Placed:
        """Find the zones of a station's defects.

        Parameters
        ----------
        station : Station
        relief : Relief, optional
            Of that station; None: it is not resolved yet.
        truth : Truth, optional
            Likewise of its zones.
        """
        relief = relief or Relief.of(station)
        truth = truth or Truth.of(station, relief)
        return cls(relief, truth, near(station, relief, truth.labels))

    @cached_property
    def zones(self) -> Zones:
        """Its zones, as if every pixel were on the part."""
        everywhere = np.broadcast_to(np.True_, self.truth.labels.shape)
        return Zones.of(self.truth.labels, everywhere, len(self.truth.defects), self.near)


@dataclass(frozen=True)
class TracedPart:
    """A part under one geometry.

    Attributes
    ----------
    counter : LevelCounter or None
        On the device, of any design of this geometry; None: it has counted.
    zones : Zones
    sample : Sample or None
    known : tuple of KnownDefect
        What is in the zones.
    notes : tuple of str
        On how much of it sees no light; of the first part alone.
    noise : Noise or None
        Of its flawless surface; likewise.
    """

    counter: LevelCounter | None
    zones: Zones
    sample: Sample | None
    known: tuple[KnownDefect, ...] = ()
    notes: tuple[str, ...] = ()
    noise: Noise | None = None


class Parts:
    """The parts of a sweep, traced when asked for and kept on the device as memory allows.

    Parameters
    ----------
    backend : Backend
    count : int
        Number of parts.
    samples : int
        Strata of the screening sample per part; 0: none is drawn.
    seeds : int
        Draws of the noise on each part.

    Attributes
    ----------
    traced : int
        Light maps traced so far.
    stopped : threading.Event
        Set from another thread, it ends the counting within a second by StoppedError.
    """

    def __init__(self, backend: Backend, count: int, samples: int, seeds: int = 1) -> None:
        self.backend = backend
        self.count = count
        self.samples = samples
        self.seeds = seeds
        self.traced = 0
        self.stopped = Event()
        self._drawn: OrderedDict[tuple[str, int], tuple[Defect, ...]] = OrderedDict()
        self._placed: OrderedDict[tuple[str, int], Placed] = OrderedDict()
        self._truths: OrderedDict[tuple[str, int], Truth] = OrderedDict()
        self._screens: OrderedDict[tuple[str, int, bool], Screen] = OrderedDict()
        self._flawless: OrderedDict[str, Flawless] = OrderedDict()
        self._geometry = ""
        self._kept: OrderedDict[tuple[int, bool], TracedPart] = OrderedDict()

    def levels(
        self, stations: Sequence[Station], *, sampled: bool
    ) -> tuple[list[Levels], list[TracedPart]]:
        """Count the levels of every part under designs of one geometry.

        Parameters
        ----------
        stations : sequence of Station
            Of one geometry, with part 0.
        sampled : bool
            Whether the sample may stand for the pixels outside the zones, under designs whose image
            has a closed form.

        Returns
        -------
        levels : list of Levels
            One for each part under each draw of the noise, a part's draws one after another.
        parts : list of TracedPart
            As many.

        Raises
        ------
        StationError
            If the geometry cannot be: a population that does not fit, an image that the memory
            does not hold.
        """
        sampled = sampled and self.samples > 0 and self.backend.screens
        sampled = sampled and not any(map(counted_whole, stations))
        listed = np.array([sampled and in_closed_form(station) for station in stations])
        self._turn_to(stations[0])
        noisy = any(station.sensor.noise for station in stations)
        found, parts = [], []
        for number, draw in product(range(self.count), range(self.seeds)):
            own = [with_part(s, number, draw) for s in stations] if noisy else stations
            levels = None
            for way in (True, False):
                some = np.flatnonzero(listed == way)
                if not some.size:
                    continue
                part = self._part(stations[0], number, listed=way)
                if levels is None:  # a screened part tells of its sample
                    levels = Levels.empty(len(stations), len(part.zones.sizes))
                    parts.append(replace(part, counter=None))  # what the device holds may go
                self._count(levels, part, own, some, _TOGETHER[sampled])
            assert levels is not None
            found.append(levels)
        return found, parts

    def _count(
        self, found: Levels, part: TracedPart, stations: Sequence[Station],
        every: NDArray[np.intp], together: int,
    ) -> None:  # fmt: skip
        """Count levels under some of the stations, and write them into their places."""
        assert part.counter is not None
        for some in np.split(every, range(together, len(every), together)):
            if self.stopped.is_set():
                raise StoppedError
            found.put(some, part.counter.count([stations[i] for i in some]))

    def _turn_to(self, station: Station) -> None:
        """Forget the light maps of another geometry: they are not wanted again."""
        key = geometry(station)
        if key != self._geometry:
            check_memory(station)
            self._kept.clear()
            self._geometry = key

    def _part(self, station: Station, number: int, *, listed: bool) -> TracedPart:
        key = number, listed
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        rows, columns = station.shape
        size = rows * columns * BYTES_PER_PIXEL * station.camera.sub_rays
        while not listed and len(self._kept) >= max(self.backend.memory_bytes // size, 1):
            self._kept.popitem(last=False)
        self.traced += 1
        part = (self._screened if listed else self._whole)(station, number)
        self._kept[key] = part
        self._make_room()
        return part

    def _make_room(self) -> None:
        """Forget light maps, those not wanted for longest first, while the device holds too much.

        What sub-rays take, and their tables, is known when they are there.
        """
        for key in list(self._kept)[:-1]:
            if self.backend.held_bytes <= self.backend.memory_bytes:
                return
            del self._kept[key]
            for (_, of, _), screen in self._screens.items():
                if of == key[0]:
                    screen.forget()

    def _whole(self, station: Station, number: int) -> TracedPart:
        """Trace every pixel of a part."""
        placed = self._place(station, number)
        light_map = self.backend.trace(with_part(station, number), placed.relief)
        lost = light_map.lost()
        zones = placed.zones.only(lost != BESIDE)
        notes = () if number else tuple(of_light(station, lost))
        noise = None if number else Noise.traced(station, placed.relief)
        known = placed.truth.defects
        return TracedPart(light_map.counter(zones), zones, None, known, notes, noise)

    def _screened(self, station: Station, number: int) -> TracedPart:
        """Trace the pixels of a part that stand for all."""
        shape = _key(station, ("tunnel", "sensor", "sequence", "defects", "populations"))
        flawless = _kept(self._flawless, shape, lambda: Flawless(station, self.backend), 2)
        found = None
        for everywhere in (bool(station.tunnel.opening_length_mm), True):
            if found is None:
                screen = self._screen(station, number, everywhere=everywhere)
                found = screen.under(station, self.backend, flawless, first=number == 0)
        assert found is not None
        return found

    def _screen(self, station: Station, number: int, *, everywhere: bool) -> Screen:
        """Return the list of a part's pixels, which no change of the tunnel moves."""
        return _kept(
            self._screens, (_seen_key(station), number, everywhere),
            lambda: Screen.of(
                station, self._place(station, number), self.samples, number, everywhere=everywhere
            ),
        )  # fmt: skip

    def _place(self, station: Station, number: int) -> Placed:
        """Return relief and zones, which no change of the tunnel moves."""

        def placed() -> Placed:
            own = with_part(station, number)
            relief = Relief.of(own, placed=self._defects(station, number))
            return Placed.of(own, relief, self._zones(own, number, relief))

        return _kept(self._placed, (_seen_key(station), number), placed)

    def _zones(self, station: Station, number: int, relief: Relief) -> Truth:
        """Return the zones of a part, which no camera moves whose pixels see the same points."""
        key = _seen_key(station)
        if station.part.surface == "orientation" and not station.posed:
            sees = f"{station.shape} {station.camera.sampling_mm} "
            key = sees + _seen_key(station, ("camera",))
        return _kept(self._truths, (key, number), lambda: Truth.of(station, relief))

    def _defects(self, station: Station, number: int) -> tuple[Defect, ...]:
        """Return a part's defects, which no change of its shape or of the camera moves."""
        part, outline = station.part, ("tunnel", "sensor", "sequence", "part", "camera")
        key = f"{part.length_mm} {part.width_mm} {_key(station, outline)}", number
        return _kept(self._drawn, key, lambda: place(with_part(station, number)))


class Screen:
    """The list of a part's pixels that screens it, traced under one tunnel after another.

    Parameters
    ----------
    relief : Relief
        Of the part.
    listing : Listing
        Its pixels.
    crowd : int
        How many defects may reach a pixel that is near none.
    known : tuple of KnownDefect
        What is in the zones.
    everywhere : bool
        Whether the drawn pixels have sub-rays where they need them, see :func:`listed`.
    """

    def __init__(
        self, relief: Relief, listing: Listing, crowd: int, known: tuple[KnownDefect, ...], *,
        everywhere: bool,
    ) -> None:  # fmt: skip
        self.relief = relief
        self._everywhere = everywhere
        self.listing = listing
        self.crowd = crowd
        self.known = known
        self._before: dict[int, LightMap] = {}

    @classmethod
    def of(
        cls, station: Station, placed: Placed, strata: int, seed: int, *, everywhere: bool = True
    ) -> Screen:
        """List the pixels of a part.

        Parameters
        ----------
        station : Station
        placed : Placed
            What is on the part.
        strata : int
            Of the sample.
        seed : int
            Of its draw.
        everywhere : bool
            See :func:`listed`.
        """
        listing = listed(
            station, placed.relief, placed.truth, strata, seed, placed.near, everywhere=everywhere
        )
        known = placed.truth.defects
        near = crowd(placed.relief, station)
        return cls(placed.relief, listing, near, known, everywhere=everywhere)

    def under(
        self, station: Station, backend: Backend, flawless: Flawless, *, first: bool
    ) -> TracedPart | None:
        """Trace the list.

        Parameters
        ----------
        station : Station
            The part's, with a tunnel.
        backend : Backend
            The same each time.
        flawless : Flawless
            Of that part's shape and camera.
        first : bool
            Whether it is the first of the parts, which tells how much of it sees no light.

        Returns
        -------
        TracedPart or None
            None: the light is lost at a drawn pixel, and none of them would have sub-rays.
        """
        base = self._traced(station, backend, 1, self.listing.pixels)
        zones, refinable = self.listing.zones, self.listing.refinable
        lost = base.lost()
        if refinable and not self._everywhere:
            of_drawn = lost.flat[self.listing.chosen]
            if ((of_drawn != 0) & (of_drawn != BESIDE)).any():
                return None
        if station.part.uneven:
            bounds, noise = self._surveyed(station, backend)
        else:
            bounds, noise = flawless.bounds(station, self.crowd), flawless.noise
        sample = self.listing.sample(bounds)
        finer = refinable.places(base) if refinable else {}
        counter: LevelCounter
        # Noise gives a pixel beside the part a level, too: there it is none.
        beside = np.flatnonzero(lost == BESIDE).astype(np.uint32)
        if not finer:
            counter = backend.without(base, beside).counter(zones, sample)
        else:
            parts = [
                self._traced(station, backend, cut, self.listing.pixels[own])
                for cut, own in finer.items()
            ]
            lists, places = base.together(parts), np.concatenate(list(finer.values()))
            lost.flat[places] = lists.each(lambda part: part.lost())
            sets = self.listing.roles.without(np.flatnonzero(lost == BESIDE)).sets(places)
            out = np.concatenate([places, beside])
            one = backend.without(base, out).counter(zones, sample)
            counter = RefinedCounter(one, sets, lists.counter(sets))
        losses = self.listing.losses(lost) if first else None
        notes = () if losses is None else tuple(of_losses(station, losses))
        drawn = sample if len(sample.chosen) else None
        in_view = self.listing.in_view(lost)
        return TracedPart(counter, in_view, drawn, self.known, notes, noise if first else None)

    def forget(self) -> None:
        """Let go what was traced last."""
        self._before.clear()

    def _surveyed(self, station: Station, backend: Backend) -> tuple[Bounds, Noise]:
        """Return what bounds the pixels that are not listed, and their noise, from all of them."""
        light_map = backend.traced(with_cut(station, 1), self.relief)
        arrays = light_map.read()
        light_map.release()
        rest = arrays.lost != BESIDE
        rest.flat[self.listing.itself] = False
        beyond = np.flatnonzero(rest)
        planes = (arrays.wide_mm, arrays.narrow_mm, arrays.irradiance)
        return surveyed(arrays, rest), Noise(*(plane[0].flat[beyond] for plane in planes))

    def _traced(self, station: Station, backend: Backend, cut: int, pixels: Pixels) -> LightMap:
        """Return the light map of some pixels, all cut in the same way."""
        station = with_cut(station, cut)
        before = self._before.get(cut)
        if before is None:
            light_map = backend.traced(station, self.relief, pixels)
        else:
            again = None if cut == 1 else pixels
            light_map = backend.trace_again(before, station, again)
        self._before[cut] = light_map
        return light_map


def _kept(
    shelf: OrderedDict[Key, Kept], key: Key, make: Callable[[], Kept], most: int = _PLACED_KEPT
) -> Kept:
    """Return what stands on a shelf, made where it is not; what was not asked for longest falls."""
    if key not in shelf:
        shelf[key] = make()
        while len(shelf) > most:
            shelf.popitem(last=False)
    shelf.move_to_end(key)
    return shelf[key]


def _key(station: Station, without: tuple[str, ...]) -> str:
    data = station.model_dump(
        exclude={*without, "segmentation", "classes", "decision", "sweep", "dataset", "tolerance"},
        mode="json",
    )
    return json.dumps(data)


def _seen_key(station: Station, without: tuple[str, ...] = ()) -> str:
    """Return what decides which point of the part a pixel sees, and what is there, as text.

    The crown does not where rays meet the part at z = 0; of a part of `without` it is not said.
    """
    part = station.part
    if part.surface == "orientation":
        flat = dict.fromkeys(("crown_radius_x_mm", "crown_radius_y_mm", "sphere_radius_mm"))
        part = part.model_copy(update=flat)
    station = station.model_copy(update={"part": part})
    return _key(station, ("tunnel", "sensor", "sequence", *without))


def counted_whole(station: Station) -> bool:
    """Return whether a part's images are counted whole, for nothing tells which pixels can be left.

    None of a posed part; of one that is uneven any pixel may have sub-rays, and of such no bound is
    known; a few pixels across are seen with neighbours beyond the image; wide spots reach further
    than neighbours.

    Parameters
    ----------
    station : Station
    """
    camera = station.camera
    narrow = min(station.shape) < ACROSS
    refined = station.part.uneven or narrow or further(camera) > 0
    return station.posed or (camera.subsampling != 1 and refined)


def geometry(station: Station) -> str:
    """Return what a light map depends on, as text."""
    tunnel: dict[str, Any] = station.tunnel.model_dump(
        exclude={key for section, key in LIGHT if section == "tunnel"}
    )
    return json.dumps(tunnel) + _key(station, ("tunnel", "sensor", "sequence"))
