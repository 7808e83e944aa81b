"""Grey levels of the pixels of a random part that are traced."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE
from gpuspec.light.backend import Backend
from gpuspec.light.constants import NO_PIXEL
from gpuspec.light.levels import Pixels
from gpuspec.light.light_map import LightMap
from gpuspec.light.refined import RefinedLightMap
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station
from gpuspec.sweeps.trying.listing import Listing

Ints = NDArray[np.int64]
Levels = NDArray[np.float32]


@dataclass(frozen=True)
class Seen:
    """Grey levels of a list of pixels.

    Attributes
    ----------
    pixels : ndarray of int64, shape (n,)
        Flat indices into the image, ascending.
    levels : ndarray of float32, shape (n,)
        DN; -inf beside the part, where nothing is detected.
    """

    pixels: Ints
    levels: Levels

    @classmethod
    def listed(cls, station: Station, relief: Relief, listing: Listing, backend: Backend) -> Seen:
        """Trace a list, which holds the neighbours that tell which pixels need sub-rays.

        Parameters
        ----------
        station : Station
        relief : Relief
            Of the part.
        listing : Listing
        backend : Backend
        """
        if listing.refinable is None:
            return cls.of(station, relief, listing.pixels, backend)
        return cls._of(
            RefinedLightMap(
                station, relief, backend.traced, listing.pixels, listing.refinable.places
            ),
            listing.pixels[: listing.refinable.end],
        )  # fmt: skip

    @classmethod
    def of(cls, station: Station, relief: Relief, pixels: Pixels, backend: Backend) -> Seen:
        """Trace some pixels.

        Parameters
        ----------
        station : Station
        relief : Relief
            Of the part.
        pixels : ndarray of uint32, shape (n,)
            None twice; ``NO_PIXEL`` is none.
        backend : Backend
        """
        return cls._of(backend.trace(station, relief, pixels), pixels)

    @classmethod
    def _of(cls, traced: LightMap, pixels: Pixels) -> Seen:
        """Take the levels of the first pixels of a list."""
        with traced as light_map:
            levels = light_map.counted()[0, : len(pixels)]
            lost = light_map.lost()[0, : len(pixels)]
        order = np.argsort(pixels, kind="stable")[: np.count_nonzero(pixels != NO_PIXEL)]
        levels = np.where(lost != BESIDE, levels, np.float32(-np.inf))
        return cls(pixels[order].astype(np.int64), levels[order])

    def at(self, pixels: Ints) -> Levels:
        """Return the levels of some of the pixels.

        Parameters
        ----------
        pixels : ndarray of int64, shape (k,)
        """
        return self.levels[np.searchsorted(self.pixels, pixels)]
