"""Lists of pixels of one light map, each with its own number of sub-rays, seen side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.light.constants import KINDS, LEVELS
from gpuspec.light.float64_noise import Moments
from gpuspec.light.levels import level_image
from gpuspec.station.station import Station

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Sets:
    """Some pixels of lists, set by set.

    Attributes
    ----------
    order : ndarray of int64, shape (n,)
        Their places in the lists, one list after another.
    first : ndarray of int64, shape (sets + 1,)
        Where in `order` each set begins, none of them empty, and the end.
    kinds : ndarray of int64, shape (sets,)
        With which others each is counted, from 0 to ``KINDS`` - 1.
    number : ndarray of int64, shape (sets,)
        What it is to whoever made it.
    """

    order: Ints
    first: Ints
    kinds: Ints
    number: Ints


@dataclass(frozen=True)
class SetLevels:
    """Levels of sets under D designs.

    Attributes
    ----------
    counts : ndarray of int64, shape (D, KINDS, 256)
        How often each comes.
    highest : ndarray of int64, shape (D, sets)
    """

    counts: Ints
    highest: Ints

    @classmethod
    def empty(cls, designs: int, sets: int) -> SetLevels:
        """Return zeros.

        Parameters
        ----------
        designs : int
            D.
        sets : int
        """
        counts = np.zeros((designs, KINDS, LEVELS), np.int64)
        return cls(counts, np.zeros((designs, sets), np.int64))


SetCounter = Callable[[Sequence[Station]], SetLevels]
"""Counts the levels of sets under designs of one geometry."""


class Listed(Protocol):
    """What is asked of the light map of a list, see :class:`gpuspec.light.light_map.LightMap`."""

    def under(self, station: Station) -> Station:
        """Return the traced station under another's light."""

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]:
        """Return noise-free means."""

    def summed_moments(self, station: Station) -> Moments:
        """Return mean and deviation of the noisy mean."""

    def draw_of(self, moments: Moments, station: Station) -> Image:
        """Return one draw of an image whose moments are known."""


Part = TypeVar("Part", bound=Listed)


def one_draw(part: Listed, station: Station) -> Image:
    """Return one draw of a list's noisy mean, with any number of sub-rays, shape (1, pixels).

    Parameters
    ----------
    part : LightMap
    station : Station
    """
    own = part.under(station)
    return part.draw_of(part.summed_moments(own), own)


class Lists(Generic[Part]):
    """Light maps of lists of pixels of one station, one after another.

    Parameters
    ----------
    parts : sequence of LightMap
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)

    def each(self, of: Callable[[Part], NDArray[Any]]) -> NDArray[Any]:
        """Return what a function says of their pixels, shape (n,).

        Parameters
        ----------
        of : callable
            Returns the image of a list, shape (1, pixels).
        """
        return np.concatenate([of(part)[0] for part in self.parts])

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]:
        """Return noise-free means of their pixels, shape (exposures, n).

        Parameters and errors as :meth:`LightMap.means_of_exposures`.
        """
        means = [part.means_of_exposures(part.under(station), exposures) for part in self.parts]
        return np.concatenate([own[:, 0] for own in means], axis=1)

    def one_draw(self, station: Station) -> NDArray[np.float32]:
        """Return one draw of their noisy mean, shape (n,); see :meth:`LightMap.one_draw`."""
        return self.each(lambda part: one_draw(part, station))

    def moments(self, station: Station) -> Moments:
        """Return mean and deviation of that mean over all its draws, each of shape (n,)."""
        own = [part.summed_moments(part.under(station)) for part in self.parts]
        mean, deviation = (
            np.concatenate([getattr(one, name)[0] for one in own]) for name in ("mean", "deviation")
        )
        return Moments(mean, deviation)

    def counter(self, sets: Sets) -> SetCounter:
        """Return what counts levels of aspect images or, with noise, of one draw of them.

        Parameters
        ----------
        sets : Sets
        """
        return partial(self._count, sets)

    def release(self) -> None:
        """Give back what the device keeps beside the light maps."""

    def _count(self, sets: Sets, stations: Sequence[Station]) -> SetLevels:
        found = SetLevels.empty(len(stations), len(sets.kinds))
        for group in alike(stations):
            first = stations[group[0]]
            if first.sensor.noise:
                images = np.stack([self.one_draw(stations[i]) for i in group])
            else:
                exposures = [stations[i].sensor.exposure for i in group]
                images = self.means_of_exposures(first, exposures)
            levels = level_image(images[:, sets.order], first.sensor.full_scale_dn)
            for kind, start, end in zip(sets.kinds, sets.first, sets.first[1:], strict=False):
                for i, level in zip(group, levels[:, start:end], strict=True):
                    found.counts[i, kind] += np.bincount(level, minlength=LEVELS)
            if len(sets.order):
                found.highest[group] = np.maximum.reduceat(levels, sets.first[:-1], axis=1)
        return found


def alike(stations: Sequence[Station]) -> list[list[int]]:
    """Return the numbers of designs that differ in exposure alone, together.

    Parameters
    ----------
    stations : sequence of Station
    """
    groups: dict[object, list[int]] = {}
    for i, station in enumerate(stations):
        sensor = station.sensor.model_copy(update={"exposure": 1.0})
        groups.setdefault((station.tunnel, station.sequence, sensor), []).append(i)
    return list(groups.values())
