"""Levels of an image of one footprint per pixel, with lists of refined pixels put into it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.levels import LevelCounter, Levels, Pixels, Sample, Zones
from gpuspec.light.light_map import LightMap
from gpuspec.light.lists import Lists, SetCounter, Sets
from gpuspec.station.station import Station


@dataclass(frozen=True)
class Roles:
    """With which others each pixel is counted.

    Attributes
    ----------
    role : ndarray of int32, shape (n,)
        Of each pixel of an image or a list the number of its zone; of all others outside `zones`,
        of the guard band ``zones + 1``, of a sample's chosen ones ``zones + 2``; -1 where none is
        counted.
    zones : int
        How many there are.
    """

    role: NDArray[np.int32]
    zones: int

    @classmethod
    def of(cls, zones: Zones, sample: Sample | None = None) -> Roles:
        """Tell the roles of valid pixels, all or, with a sample, those that it has.

        Parameters
        ----------
        zones : Zones
        sample : Sample, optional
        """
        count = len(zones.sizes)
        role = np.full(zones.valid.size, count if sample is None else -1, np.int32)
        if sample is not None:
            role[sample.near] = count
            role[sample.chosen] = count + 2
        role[zones.guard] = count + 1
        role[zones.pixels] = np.repeat(np.arange(count), zones.sizes)
        role[~zones.valid.ravel()] = -1
        return cls(role, count)

    def without(self, places: NDArray[np.intp]) -> Roles:
        """Return the roles where some pixels are not counted.

        Parameters
        ----------
        places : ndarray of intp
        """
        role = self.role.copy()
        role[places] = -1
        return replace(self, role=role)

    def sets(self, places: Pixels) -> Sets:
        """Return some pixels zone by zone, then those of none, of the guard band, and the chosen.

        Parameters
        ----------
        places : ndarray of uint32
        """
        role = self.role[places]
        kept = np.flatnonzero(role >= 0)
        few = np.uint16 if self.zones < 1 << 15 else np.uint32  # short numbers are sorted at once
        order = kept[np.argsort(role[kept].astype(few), kind="stable")]
        role = role[order]
        first = np.flatnonzero(np.diff(role, prepend=-1))
        number = role[first].astype(np.int64)
        kinds = np.maximum(number - self.zones + 1, 0)
        number[kinds > 0] = -1
        return Sets(order, np.append(first, len(order)), kinds, number)


@dataclass(frozen=True)
class RefinedCounter:
    """Counts levels of what is seen with one footprint, and of lists of refined pixels.

    Attributes
    ----------
    one : LevelCounter
        Of the former.
    sets : Sets
        The lists' pixels by how they are counted, see :meth:`Roles.sets`.
    refined : callable
        Counts these.
    twice : LevelCounter or None
        Of one footprint of the lists' pixels, where `one` counts them, too, as if outside.
    """

    one: LevelCounter
    sets: Sets
    refined: SetCounter
    twice: LevelCounter | None = None

    @classmethod
    def of_image(
        cls,
        base: LightMap,
        lists: Lists[LightMap],
        places: Pixels,
        coarse: Callable[[Pixels], LightMap],
        zones: Zones,
        sample: Sample | None,
    ) -> RefinedCounter:
        """Return that of an image.

        Parameters
        ----------
        base : LightMap
            Of one footprint per pixel; its counter takes any pixel of the image that is in no zone
            for outside.
        lists : Lists
            Of the refined pixels, no pixel twice.
        places : ndarray of uint32
            Where these stand in the image.
        coarse : callable
            Traces a list of pixels with one footprint each; not asked with a sample.
        zones : Zones
        sample : Sample, optional
            Pixels that stand for all others; None: all are counted.
        """
        sets = Roles.of(zones, sample).sets(places)
        one = np.ones(zones.valid.shape, bool)
        one.flat[places] = False
        twice = None
        if sample is not None:
            near, chosen = (some[one.flat[some]] for some in (sample.near, sample.chosen))
            sample = replace(sample, near=near, chosen=chosen)
        else:
            some = coarse(np.flatnonzero(~one & zones.valid).astype(np.uint32))
            twice = some.counter(Zones.none(some.shape))
        inner = base.counter(replace(zones.only(one), valid=zones.valid), sample)
        return cls(inner, sets, lists.counter(sets), twice)

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = self.one.count(stations)
        if self.twice is not None:
            found.outside[:, 1:] -= self.twice.count(stations).outside[:, 1:]
        more = self.refined(stations)
        inside, none, guard, chosen = more.counts.transpose(1, 0, 2)
        for counts, own in (
            (found.inside, inside), (found.outside, none), (found.outside, guard),
            (found.guard, guard), (found.sampled, chosen),
        ):  # fmt: skip
            counts += own
        zones = self.sets.number >= 0
        peaks, number = more.highest[:, zones], self.sets.number[zones]
        found.peaks[:, number] = np.maximum(found.peaks[:, number], peaks)
        return found
