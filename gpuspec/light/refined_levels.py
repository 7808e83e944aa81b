"""Levels of an image of one footprint per pixel, with lists of refined pixels put into it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.light.constants import NO_PIXEL
from gpuspec.light.levels import LevelCounter, Levels, Pixels, Sample, Zones
from gpuspec.light.light_map import LightMap
from gpuspec.light.lists import Lists, Sets
from gpuspec.station.station import Station


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
        self._coarse: LevelCounter | None = None
        if sample is None and coarse is not None:
            one = coarse(np.flatnonzero(refined & zones.valid).astype(np.uint32))
            self._coarse = one.counter(Zones.none(one.shape))
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
        self._sets = _sets_of(places, owner, refined & zones.valid, guard)
        self._refined = lists.counter(self._sets)
        self._inner = base.counter(replace(zones.only(~refined), valid=zones.valid), sample)

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = self._inner.count(stations)
        if self._coarse is not None:
            found.outside[:, 1:] -= self._coarse.count(stations).outside[:, 1:]
        more = self._refined(stations)
        inside, none, guard = more.counts.transpose(1, 0, 2)
        for counts, own in (
            (found.inside, inside), (found.outside, none), (found.outside, guard),
            (found.guard, guard),
        ):  # fmt: skip
            counts += own
        zones = self._sets.number >= 0
        peaks, number = more.highest[:, zones], self._sets.number[zones]
        found.peaks[:, number] = np.maximum(found.peaks[:, number], peaks)
        return found


def _sets_of(places: Pixels, owner: NDArray[np.int64], counted: Mask, guard: Mask) -> Sets:
    """Return the refined pixels zone by zone, then those of none, then those of the guard band."""
    own = owner.flat[places]
    kept = np.flatnonzero(counted.flat[places])
    rank = np.where(own[kept] < 0, NO_PIXEL + guard.flat[places[kept]], own[kept])
    order = np.argsort(rank, kind="stable")
    number, first = np.unique(rank[order], return_index=True)
    kinds = np.where(number < NO_PIXEL, 0, 1 + number - NO_PIXEL)
    number[kinds > 0] = -1
    return Sets(kept[order], np.append(first, len(order)), kinds, number)
