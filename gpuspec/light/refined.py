"""A light map whose pixels have sub-rays where they matter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.light.constants import AT_LOSS, NO_PIXEL
from gpuspec.light.float64_noise import Moments
from gpuspec.light.levels import LevelCounter, Levels, Pixels, Sample, Zones
from gpuspec.light.light_map import LightMap, LightMapArrays, in_closed_form
from gpuspec.light.lists import Lists
from gpuspec.light.patterns import Pattern
from gpuspec.light.refined_levels import RefinedCounter
from gpuspec.light.refinement import (
    ACROSS,
    SIDES,
    Neighbourhood,
    at_loss_within,
    bend_of,
    by_cut,
    further,
    with_neighbours,
)
from gpuspec.part.crossings import crossings
from gpuspec.part.edges import cut_at_border
from gpuspec.part.grooves import by_block
from gpuspec.part.guard import widened
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

Traced = Callable[[Station, Relief, Pixels | None], LightMap]
"""Traces a station whose pixels are all cut in the same way: its image, or a list of pixels."""


class RefinedLightMap(LightMap):
    """A light map of one footprint per pixel, and lists of pixels with sub-rays.

    Every image is that of one footprint, with the lists' pixels put into it.

    Parameters
    ----------
    station : Station
        With ``camera.subsampling = "auto"``.
    relief : Relief
        Of that station.
    traced : callable
        A backend's, see :meth:`gpuspec.light.backend.Backend.traced`.
    pixels : ndarray of uint32, shape (n,), optional
        Those of a list; None: all of the image.
    cuts : callable, optional
        Returns, from the list's light map of one footprint, the places of those that are refined by
        how they are cut, where the list holds what tells; None: the neighbours of all are traced
        to tell.
    """

    def __init__(
        self,
        station: Station,
        relief: Relief,
        traced: Traced,
        pixels: Pixels | None = None,
        cuts: Callable[[LightMap], dict[int, Pixels]] | None = None,
    ) -> None:
        self.station, self.pixels = station, pixels
        self._coarse: Callable[..., LightMap] = lambda some, of=station: traced(
            with_cut(of, 1), relief, some
        )
        self.base = traced(with_cut(station, 1), relief, pixels)
        finer = cuts(self.base) if cuts else self._cuts(relief)
        self.lists = self.base.together(
            [
                traced(with_cut(station, cut), relief, own if pixels is None else pixels[own])
                for cut, own in finer.items()
            ]
        )
        self.places = np.concatenate([np.zeros(0, np.uint32), *finer.values()])
        """Where the lists' pixels stand in the image, or in the list that this is of."""

    def _cuts(self, relief: Relief) -> dict[int, Pixels]:
        """Return the places of the pixels that are refined, by how they are cut."""
        station, listed = self.station, self.pixels
        pitch = station.camera.sampling_mm / SIDES[-1]
        if min(station.part.length_mm, station.part.width_mm) < pitch:
            return {}  # sub-rays would miss a part that is thinner
        border = cut_at_border(relief.edges, station).astype(np.uint32)
        if listed is None and min(station.shape) >= ACROSS:
            sides = at_loss_within(self.base.sides_needed(), further(station.camera)).ravel()
        else:
            every = np.arange(station.shape[0] * station.shape[1], dtype=np.uint32)
            sides = self._sides_of(every if listed is None else listed)
        sides[border if listed is None else np.isin(listed, border)] = AT_LOSS
        own = _not_one(sides)
        numbers = own if listed is None else listed[own]
        order = by_block(numbers, station.shape)
        own, numbers = own[order], numbers[order]
        found = by_cut(sides[own], lambda some: crossings(station, relief, numbers[some]))
        return {cut: own[some] for cut, some in found.items()}

    def _sides_of(self, pixels: Pixels) -> NDArray[np.uint8]:
        """Return how many sub-rays listed pixels need on a side: traced with their neighbours."""
        there = pixels != NO_PIXEL
        several, which = np.unique(pixels[there], return_inverse=True)
        wider, own = with_neighbours(self.station, several.astype(np.int64))
        beyond = further(wider.camera)
        every = widened(own, wider.shape, beyond)
        around = Neighbourhood(every, wider.shape)
        arrays = self._coarse(around.pixels.astype(np.uint32), wider).read()
        light, wide = arrays.light_mm[0, 0], arrays.wide_mm[0, 0]
        found = around.sides_needed(light, wide, bend_of(wider.camera))
        near = widened(every[found == AT_LOSS], wider.shape, beyond)
        found[np.isin(every, near, assume_unique=True)] = AT_LOSS
        sides = np.ones(len(pixels), np.uint8)
        sides[there] = found[np.searchsorted(every, own)][which]
        return sides

    @property
    def refined(self) -> dict[int, int]:
        """See :attr:`LightMap.refined`."""
        return {part.station.camera.cut: part.shape[1] for part in self.lists.parts}

    @property
    def parts(self) -> tuple[LightMap, ...]:
        """The light map of one footprint and the lists."""
        return (self.base, *self.lists.parts)

    def _put_in(
        self, image: NDArray[Any], own: Callable[[Lists[LightMap]], NDArray[Any]]
    ) -> NDArray[Any]:
        """Put what the lists give into an image of one footprint."""
        if len(self.places):
            image.flat[self.places] = own(self.lists)
        return image

    def release(self) -> None:
        """See :meth:`LightMap.release`."""
        for part in self.parts:
            part.release()
        self.lists.release()
        super().release()

    def with_pattern(self, pattern: Pattern) -> LightMap:
        """See :meth:`LightMap.with_pattern`."""
        self.held()
        lit = copy(self)
        lit.base = self.base.with_pattern(pattern)
        lit.lists = lit.base.together([p.with_pattern(pattern) for p in self.lists.parts])
        lit.pattern = pattern
        return lit

    def failures(self) -> AbstractContextManager[None]:
        """See :meth:`LightMap.failures`."""
        return self.base.failures()

    def faulty(self) -> float:
        """See :meth:`LightMap.faulty`."""
        self.held()
        return max(part.faulty() for part in self.parts)

    def read(self) -> LightMapArrays:
        """Bring the light map of one footprint per pixel home."""
        self.held()
        return self.base.read()

    def lost(self) -> NDArray[np.uint8]:
        """See :meth:`LightMap.lost`."""
        self.held()
        return self._put_in(self.base.lost(), lambda lists: lists.each(lambda part: part.lost()))

    def image(self, k: int, station: Station | None = None) -> Image:
        """See :meth:`LightMap.image`."""
        station = self.lit_by(station)
        number = self.image_number(k, station)
        return self._put_in(
            self.base.image(number, self.base.under(station)),
            lambda lists: lists.each(lambda part: part.image(number, part.under(station))),
        )

    def mean(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.mean`."""
        station = self.lit_by(station)
        return self._put_in(
            self.base.mean(self.base.under(station)),
            lambda lists: lists.each(lambda part: part.mean(part.under(station))),
        )

    def fuse(self, station: Station | None = None) -> dict[str, Image]:
        """See :meth:`LightMap.fuse`."""
        station = self.lit_by(station)
        fused = self.base.fuse(self.base.under(station))
        own = [part.fuse(part.under(station)) for part in self.lists.parts]
        for name, image in fused.items() if own else ():
            image.flat[self.places] = np.concatenate([found[name][0] for found in own])
        return fused

    def closed_form(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.closed_form`.

        Of the lists' pixels a sum over the images: their sub-rays saturate together.
        """
        station = self.lit_by(station)
        return self._put_in(
            self.base.closed_form(self.base.under(station)),
            lambda lists: lists.means_of_exposures(station, [station.sensor.exposure])[0],
        )

    def moments(self, station: Station | None = None) -> Moments:
        """See :meth:`LightMap.moments`."""
        station = self.noisy(station)
        found = self.base.moments(self.base.under(station))
        if len(self.places):
            own = self.lists.moments(station)
            found.mean.flat[self.places] = own.mean
            found.deviation.flat[self.places] = own.deviation
        return found

    def one_draw(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.one_draw`."""
        station = self.noisy(station)
        return self._put_in(
            self.base.one_draw(self.base.under(station)), lambda lists: lists.one_draw(station)
        )

    def counter(self, zones: Zones, sample: Sample | None = None) -> LevelCounter:
        """See :meth:`LightMap.counter`."""
        self.held()
        if not len(self.places):
            return self.base.counter(zones, sample)
        if type(self.base).counter is LightMap.counter or self.pixels is not None:
            return super().counter(zones, sample)
        return _ByWay(
            RefinedCounter.of_image(
                self.base, self.lists, self.places, self._coarse, zones, sample
            ),
            super().counter(zones, sample),
        )


@dataclass(frozen=True)
class _ByWay:
    """Counts closed forms by one counter and all other images by another."""

    closed: LevelCounter
    other: LevelCounter

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        closed = np.array([in_closed_form(station) for station in stations])
        found: Levels | None = None
        for counter, which in ((self.closed, closed), (self.other, ~closed)):
            where = np.flatnonzero(which)
            if len(where):
                some = counter.count([stations[i] for i in where.tolist()])
                found = found or Levels.empty(len(stations), some.peaks.shape[1])
                found.put(where, some)
        return found or Levels.empty(0, 0)


def with_cut(station: Station, cut: int) -> Station:
    """Return a station whose pixels are all cut in the same way.

    Parameters
    ----------
    station : Station
    cut : int
        Into n x n squares, or -n slices along the groove that crosses each.
    """
    camera = station.camera.model_copy(update={"subsampling": cut})
    return station.model_copy(update={"camera": camera})


def _not_one(needed: NDArray[np.uint8]) -> Pixels:
    """Return where bytes are not 1, eight at a look: most are."""
    whole = len(needed) // 8 * 8
    eights = np.flatnonzero(needed[:whole].view(np.uint64) != 0x0101010101010101)
    near = (8 * eights[:, None] + np.arange(8)).ravel()
    places = np.concatenate([near, np.arange(whole, len(needed))]).astype(np.uint32)
    found: Pixels = places[needed[places] != 1]
    return found
