"""Levels of an image of one footprint per pixel, with lists of refined pixels put into it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.levels import LevelCounter, Levels, Pixels, Sample, Zones
from gpuspec.light.light_map import LightMap
from gpuspec.light.lists import Lists, Sets
from gpuspec.station.station import Station


@dataclass(frozen=True)
class Roles:
    """With which others each pixel is counted.

    Attributes
    ----------
    role : ndarray of int32, shape (n,)
        Of each pixel of an image or a list the number of its zone; of all others outside `zones`,
        of the guard band ``zones + 1``; -1 where none is counted.
    zones : int
        How many there are.
    """

    role: NDArray[np.int32]
    zones: int

    @classmethod
    def of(cls, zones: Zones, sample: Sample | None = None) -> Roles:
        """Tell the roles of valid pixels, all or, with a sample, those that stand for themselves.

        Parameters
        ----------
        zones : Zones
        sample : Sample, optional
        """
        count = len(zones.sizes)
        role = np.full(zones.valid.size, count if sample is None else -1, np.int32)
        if sample is not None:
            role[sample.near] = count
        role[zones.guard] = count + 1
        role[zones.pixels] = np.repeat(np.arange(count), zones.sizes)
        role[~zones.valid.ravel()] = -1
        return cls(role, count)

    def sets(self, places: Pixels) -> Sets:
        """Return some pixels zone by zone, then those of none, then those of the guard band.

        Parameters
        ----------
        places : ndarray of uint32
        """
        role = self.role[places]
        kept = np.flatnonzero(role >= 0)
        order = kept[np.argsort(role[kept], kind="stable")]
        role = role[order]
        first = np.flatnonzero(np.diff(role, prepend=-1))
        number = role[first].astype(np.int64)
        kinds = np.maximum(number - self.zones + 1, 0)
        number[kinds > 0] = -1
        return Sets(order, np.append(first, len(order)), kinds, number)


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
    roles : Roles, optional
        Of these zones and that sample, where they are known.
    """

    def __init__(
        self,
        base: LightMap,
        lists: Lists[LightMap],
        places: Pixels,
        coarse: Callable[[Pixels], LightMap] | None,
        zones: Zones,
        sample: Sample | None,
        roles: Roles | None = None,
    ) -> None:
        roles = roles or Roles.of(zones, sample)
        one = np.ones(zones.valid.shape, bool)
        one.flat[places] = False
        self._coarse: LevelCounter | None = None
        if sample is not None:
            sample = replace(sample, near=sample.near[one.flat[sample.near]])
        elif coarse is not None:
            some = coarse(np.flatnonzero(~one & zones.valid).astype(np.uint32))
            self._coarse = some.counter(Zones.none(some.shape))
        self._sets = roles.sets(places)
        self._refined = lists.counter(self._sets)
        self._inner = base.counter(replace(zones.only(one), valid=zones.valid), sample)

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
