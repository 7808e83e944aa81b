"""All thresholds at once: how often each level of an aspect image comes, inside and outside zones.

A level counts thresholds: a pixel of level j is detected at thresholds 0 to j - 1 and no other, so
that counts of levels are P1, P2 and the defects hit at every threshold, exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import LabelImage, Mask
from gpuspec.light.constants import LEVELS
from gpuspec.station.station import Station

Counts = NDArray[np.int64]
Pixels = NDArray[np.uint32]


def levels_per_dn(full_scale_dn: float) -> np.float32:
    """Return the scale from grey levels to thresholds: 1 at 8 bits, less above."""
    return np.float32((LEVELS - 1) / full_scale_dn)


def thresholds(full_scale_dn: float) -> NDArray[np.float32]:
    """Return the thresholds that are scored: 0 to full scale in 255 equal steps.

    Parameters
    ----------
    full_scale_dn : float
        Highest grey level, DN.

    Returns
    -------
    ndarray of float32, shape (256,)
        In DN. A float32 pixel is above the i-th if, and only if, its level is above i: each is the
        largest number whose product with `levels_per_dn`, rounded to float32, is not above i.

    Examples
    --------
    >>> from gpuspec.light.levels import thresholds
    >>> thresholds(255.0)[[0, 1, 255]].tolist()
    [0.0, 1.0, 255.0]
    """
    scale = levels_per_dn(full_scale_dn)
    level = np.arange(LEVELS, dtype=np.float32)
    found = level / scale
    for _ in range(4):  # a division and a product round by less than two steps
        found = np.where(found * scale > level, np.nextafter(found, np.float32(-1)), found)
    for _ in range(4):
        above = np.nextafter(found, np.float32(np.inf))
        found = np.where(above * scale <= level, above, found)
    found[0] = 0  # and no subnormal number
    return found.astype(np.float32)


@dataclass(frozen=True)
class Zones:
    """The zones' pixels of one part, and those scored at all.

    Attributes
    ----------
    pixels : ndarray of uint32, shape (n,)
        Flat indices of the valid pixels in zones, zone by zone.
    first : ndarray of int64, shape (defects + 1,)
        Where each defect's pixels begin, and the end.
    valid : ndarray of bool, shape (M, N)
        Pixels on the part.
    guard : ndarray of uint32, shape (k,)
        Flat indices of the valid pixels around the zones that what is in them may light up, see
        :mod:`gpuspec.part.guard`.
    """

    pixels: Pixels
    first: NDArray[np.int64]
    valid: Mask
    guard: Pixels = field(default_factory=lambda: np.zeros(0, np.uint32))

    @classmethod
    def of(
        cls, truth: LabelImage, valid: Mask, defects: int, near: NDArray[np.int64] | None = None
    ) -> Zones:
        """Collect them from the zones as a label image.

        Parameters
        ----------
        truth : ndarray of int32, shape (M, N)
            See :class:`gpuspec.part.truth.Truth`.
        valid : ndarray of bool, shape (M, N)
            Pixels on the part.
        defects : int
            Number of zones, of which some may have no pixel.
        near : ndarray of int64, optional
            Flat indices of the pixels of the zones and their guard band; None: there is none.
        """
        inside = np.flatnonzero((truth != 0) & valid).astype(np.uint32)
        owner = truth.flat[inside]
        order = np.argsort(owner, kind="stable")
        first = np.searchsorted(owner[order], np.arange(1, defects + 2))
        found = cls(inside[order], first, valid)
        if near is None:
            return found
        around = near[(truth.flat[near] == 0) & valid.flat[near]].astype(np.uint32)
        return replace(found, guard=around)

    @classmethod
    def none(cls, shape: tuple[int, int]) -> Zones:
        """Return no zones, of an image all of which is scored."""
        return cls(np.zeros(0, np.uint32), np.zeros(1, np.int64), np.ones(shape, np.bool_))

    def only(self, valid: Mask) -> Zones:
        """Return the zones without the pixels that are not valid, too."""
        kept = valid.flat[self.pixels]
        first = np.concatenate([[0], np.cumsum(kept)])[self.first]
        guard = self.guard[valid.flat[self.guard]]
        return Zones(self.pixels[kept], first, self.valid & valid, guard)

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Pixels of each zone, shape (defects,)."""
        return np.diff(self.first)


@dataclass(frozen=True)
class Sample:
    """Pixels outside the zones that stand for all of them.

    Attributes
    ----------
    near : ndarray of uint32, shape (k,)
        Flat indices of pixels outside zones and their guard band that stand for themselves.
    chosen : ndarray of uint32, shape (n,)
        One pixel drawn from each of n strata; together with `near` and the guard band these are all
        pixels outside.
    weight : int
        Pixels of a stratum, the same for all.
    wide_mm, narrow_mm, irradiance : ndarray of float32, shape (g,)
        What bounds the aspect image over the strata, region by region, whatever the light
        coordinate: a footprint and an irradiance whose exposure is not below that of any pixel.
    """

    near: Pixels
    chosen: Pixels
    weight: int
    wide_mm: NDArray[np.float32]
    narrow_mm: NDArray[np.float32]
    irradiance: NDArray[np.float32]

    @property
    def bounds(self) -> tuple[NDArray[np.float32], ...]:
        """What bounds the aspect image, in the order of a light map's planes."""
        return self.wide_mm, self.narrow_mm, self.irradiance


@dataclass(frozen=True)
class Levels:
    """How often each level comes under D designs.

    Level 0, detected at no threshold, is counted as it comes: pixels off the part have it too.

    Attributes
    ----------
    inside : ndarray of int64, shape (D, 256)
        Of the zones' pixels.
    outside : ndarray of int64, shape (D, 256)
        Of all other valid pixels or, with a sample, of those near the zones, guard band included.
    sampled : ndarray of int64, shape (D, 256)
        Of the sample's chosen pixels; 0 without one.
    peaks : ndarray of int64, shape (D, defects)
        Highest level in each zone.
    ceiling : ndarray of int64, shape (D,)
        No pixel that was not counted has a higher level; 0 if all were.
    guard : ndarray of int64, shape (D, 256)
        Of the guard band's pixels, which are among those outside.
    """

    inside: Counts
    outside: Counts
    sampled: Counts
    peaks: Counts
    ceiling: Counts
    guard: Counts

    @classmethod
    def empty(cls, designs: int, defects: int) -> Levels:
        """Return zeros.

        Parameters
        ----------
        designs : int
            D.
        defects : int
            Number of zones.
        """
        inside, outside, sampled, guard = (np.zeros((designs, LEVELS), np.int64) for _ in range(4))
        peaks = np.zeros((designs, defects), np.int64)
        return cls(inside, outside, sampled, peaks, np.zeros(designs, np.int64), guard)

    def put(self, where: NDArray[np.intp], other: Levels) -> None:
        """Write the counts of some designs into their places.

        Parameters
        ----------
        where : ndarray of intp, shape (d,)
            Their numbers among the D.
        other : Levels
            Of these d designs.
        """
        for own, more in (
            (self.inside, other.inside), (self.outside, other.outside),
            (self.sampled, other.sampled), (self.peaks, other.peaks), (self.guard, other.guard),
        ):  # fmt: skip
            own[where] = more
        self.ceiling[where] = other.ceiling


class LevelCounter(Protocol):
    """Counts levels of one traced part under designs of its geometry."""

    def count(self, stations: Sequence[Station]) -> Levels:
        """Return the levels under some designs, in their order."""


def level_image(aspect: NDArray[np.float32], full_scale_dn: float) -> NDArray[np.uint8]:
    """Return how many of the 256 thresholds each pixel is above.

    Parameters
    ----------
    aspect : ndarray of float32
        Grey levels, DN.
    full_scale_dn : float
        Highest grey level, DN.
    """
    # A float32 mean of many saturated images may be a last bit above full scale.
    level: NDArray[np.float32] = np.ceil(aspect * levels_per_dn(full_scale_dn))
    return level.clip(0, LEVELS - 1, out=level).astype(np.uint8)


def levels_of(aspect: NDArray[np.float32], zones: Zones, full_scale_dn: float) -> Levels:
    """Count the levels of one aspect image.

    Parameters
    ----------
    aspect : ndarray of float32, shape (M, N)
        Grey levels, DN.
    zones : Zones
    full_scale_dn : float
        Highest grey level, DN.

    Returns
    -------
    Levels
        Of one design.
    """
    level = level_image(aspect, full_scale_dn)
    every = np.bincount(level[zones.valid], minlength=LEVELS)
    inside = level.flat[zones.pixels]
    found = Levels.empty(1, len(zones.first) - 1)
    found.inside[0] = np.bincount(inside, minlength=LEVELS)
    found.outside[0] = every - found.inside[0]
    found.guard[0] = np.bincount(level.flat[zones.guard], minlength=LEVELS)
    seen = np.flatnonzero(zones.sizes)
    if seen.size:
        found.peaks[0, seen] = np.maximum.reduceat(inside, zones.first[seen])
    return found
