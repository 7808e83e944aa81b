"""Levels of an image of one footprint per pixel, with lists of refined pixels put into it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.light.constants import LEVELS, NO_PIXEL
from gpuspec.light.levels import (
    Counts,
    Levels,
    Pixels,
    Sample,
    Zones,
    levels_per_dn,
)
from gpuspec.light.light_map import LightMap
from gpuspec.light.lists import Lists
from gpuspec.station.station import Station

LevelImages = NDArray[np.uint8]
"""Levels of some pixels under some designs, shape (designs, pixels)."""

_AHEAD = 2  # images that wait to be counted


class RefinedCounter:
    """Counts levels on a device that counts those of one footprint, and puts right what is refined.

    Parameters
    ----------
    base : LightMap
        Of one footprint per pixel; its counter takes any pixel of the image that is in no zone for
        outside.
    lists : Lists
        Of the refined pixels, no pixel twice.
    places : ndarray of uint32
        Where these stand in the image, or in the list that `base` is of.
    coarse : callable
        Traces a list of pixels with one footprint each; not needed with a sample.
    zones : Zones
    sample : Sample, optional
        Pixels that stand for all others, of which no refined one is looked at; None: all are
        counted.
    """

    def __init__(
        self,
        base: LightMap,
        lists: Lists[LightMap],
        places: Pixels,
        coarse: Callable[[Pixels], LightMap] | None,
        zones: Zones,
        sample: Sample | None,
    ) -> None:
        refined = np.zeros(zones.valid.shape, bool)
        refined.flat[places] = True
        self._coarse: LightMap | None = None
        if sample is None and coarse is not None:
            self._coarse = coarse(np.flatnonzero(refined & zones.valid).astype(np.uint32))
        elif sample is not None:
            of_zones = np.zeros_like(refined)
            of_zones.flat[zones.pixels] = True
            near = sample.near[~refined.flat[sample.near]]
            of_zones.flat[sample.near] = True
            of_zones.flat[zones.guard] = True
            refined &= of_zones
            sample = replace(sample, near=near)
        owner = np.full(zones.valid.shape, -1, np.int64)
        owner.flat[zones.pixels] = np.repeat(np.arange(len(zones.sizes)), zones.sizes)
        guard = np.zeros(zones.valid.shape, np.bool_)
        guard.flat[zones.guard] = True
        self._lists = lists
        self._sorted = _Sorted.of(places, owner, refined & zones.valid, guard)
        self._inner = base.counter(replace(zones.only(~refined), valid=zones.valid), sample)

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = self._inner.count(stations)
        # What the device has seen is counted here while it looks at the next.
        with ThreadPoolExecutor(1, "gpuspec-count") as counting:
            tasks: deque[Future[None]] = deque()
            for count, images, scale in self._looks(stations, found):
                tasks.append(counting.submit(_count, count, images, scale))
                if len(tasks) > _AHEAD:
                    tasks.popleft().result()
            for task in tasks:
                task.result()
        return found

    def _looks(
        self, stations: Sequence[Station], found: Levels
    ) -> Iterator[tuple[Callable[[LevelImages], None], NDArray[np.float32], float]]:
        """Yield images of refined pixels, their full scale, and what counts their levels."""
        for group in _alike(stations):
            exposures = [stations[i].sensor.exposure for i in group]
            station = stations[group[0]]
            scale = station.sensor.full_scale_dn
            if self._coarse is not None:
                own = [self._coarse.counted(self._coarse.under(stations[i])) for i in group]
                yield partial(_take_off, found, group), np.concatenate(own), scale
            if station.sensor.noise:
                means = np.stack([self._drawn(stations[i]) for i in group])
            else:
                means = self._lists.means_of_exposures(station, exposures)
            yield partial(self._sorted.count, found, group), means, scale

    def _drawn(self, station: Station) -> NDArray[np.float32]:
        return self._lists.each(lambda part: part.mean(part.under(station)))


@dataclass(frozen=True)
class _Sorted:
    """The refined pixels: those of the zones in their order, of none, of the guard band."""

    order: NDArray[np.intp]
    first: NDArray[np.intp]
    zones: NDArray[np.int64]
    inside: int
    beyond: int

    @classmethod
    def of(cls, places: Pixels, owner: NDArray[np.int64], counted: Mask, guard: Mask) -> _Sorted:
        """Sort them; those that are not to be counted are left out."""
        own = owner.flat[places]
        kept = np.flatnonzero(counted.flat[places])
        rank = np.where(own[kept] < 0, NO_PIXEL + guard.flat[places[kept]], own[kept])
        order = kept[np.argsort(rank, kind="stable")]
        inside = int(np.count_nonzero(own[order] >= 0))
        zones, first = np.unique(own[order[:inside]], return_index=True)
        beyond = len(order) - int(np.count_nonzero(guard.flat[places[kept]]))
        return cls(order, first, zones, inside, beyond)

    def count(self, found: Levels, group: Sequence[int], level: LevelImages) -> None:
        """Add the levels of some designs, (designs, pixels), to what was found of them."""
        sorted_ = level.take(self.order, axis=1)
        found.inside[group] += _counts(sorted_[:, : self.inside])
        guard = _counts(sorted_[:, self.beyond :])
        found.outside[group] += _counts(sorted_[:, self.inside : self.beyond]) + guard
        found.guard[group] += guard
        if len(self.first):
            highest = np.maximum.reduceat(sorted_[:, : self.inside], self.first, axis=1)
            peaks = found.peaks[group]
            peaks[:, self.zones] = np.maximum(peaks[:, self.zones], highest)
            found.peaks[group] = peaks


def _take_off(found: Levels, group: Sequence[int], level: LevelImages) -> None:
    """Take the levels of some designs, (designs, pixels), off what was found outside."""
    found.outside[group] -= _counts(level)


def _count(count: Callable[[LevelImages], None], images: NDArray[np.float32], scale: float) -> None:
    count(_levels(images, scale))


def _alike(stations: Sequence[Station]) -> list[list[int]]:
    """Return the numbers of designs that differ in exposure alone, together."""
    groups: dict[object, list[int]] = {}
    for i, station in enumerate(stations):
        sensor = station.sensor.model_copy(update={"exposure": 1.0})
        groups.setdefault((station.tunnel, station.sequence, sensor), []).append(i)
    return list(groups.values())


def _levels(images: NDArray[np.float32], full_scale_dn: float) -> LevelImages:
    level: NDArray[np.float32] = np.ceil(images * levels_per_dn(full_scale_dn))
    np.fmin(np.fmax(level, 0, out=level), LEVELS - 1, out=level)
    return level.astype(np.uint8)


def _counts(level: LevelImages) -> Counts:
    """Return how often each level comes in each row, shape (rows, 256)."""
    return np.stack([np.bincount(row, minlength=LEVELS) for row in level])
