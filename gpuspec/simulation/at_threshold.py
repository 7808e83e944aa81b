"""One part under a design, at its threshold: what is hit, what is false, and what room is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, GreyLevels
from gpuspec.detection.connected import connected
from gpuspec.detection.expected import Expected, pixel_by_pixel
from gpuspec.detection.false_blobs import false_blobs, least_pixels
from gpuspec.detection.inspection import levelled
from gpuspec.light.light_map import has_noisy_form
from gpuspec.simulation.simulate import Traced
from gpuspec.station.station import Station


@dataclass(frozen=True)
class Looked:
    """A part's aspect image under a design, whatever its threshold.

    Attributes
    ----------
    aspect : ndarray of float32, shape (M, N)
        Whose levels a threshold is held against.
    level : ndarray of float32, shape (M, N)
        Of which levels are told: of noise as they are on average, its spread beside them.
    """

    aspect: GreyLevels
    level: GreyLevels

    @classmethod
    def of(cls, traced: Traced, station: Station, *, drawn: bool = True) -> Looked:
        """Take the image of a traced part.

        Parameters
        ----------
        traced : Traced
        station : Station
            Of its geometry.
        drawn : bool
            See :meth:`AtThreshold.of`.
        """
        light_map, level = traced.light_map, None
        if has_noisy_form(station):
            level = _held(light_map.moments(station).mean, traced, station)
        if level is not None and not drawn:
            return cls(level, level)
        aspect = _held(light_map.aspect(station), traced, station)
        return cls(aspect, aspect if level is None else level)


@dataclass(frozen=True)
class AtThreshold:
    """One part under a design, at its threshold.

    Attributes
    ----------
    hit_px, false_zone_px, zone_px : int
        Detected pixels inside and outside the zones, and pixels of the zones.
    hits, defects : int
        Defects hit, and those in view.
    false_px, false_blobs : int
        Beyond the guard bands.
    peaks_dn, sizes_mm, kinds : tuple
        Of each defect in view: level of its brightest pixel, size and kind. Levels are those that a
        threshold is held against, see :func:`gpuspec.detection.inspection.levelled`.
    hit : tuple of bool
        Which of these are hit.
    flawless_dn : float
        Highest level of what is flawless.
    expected : Expected or None
        What noise makes of it; None without noise, or without a closed form of it.
    """

    hit_px: int
    false_zone_px: int
    zone_px: int
    hits: int
    defects: int
    false_px: int
    false_blobs: int
    peaks_dn: tuple[float, ...]
    sizes_mm: tuple[float, ...]
    kinds: tuple[str, ...]
    hit: tuple[bool, ...]
    flawless_dn: float
    expected: Expected | None

    def room_dn(self, threshold_dn: float) -> float:
        """Return what a threshold keeps to what is flawless, or to the faintest defect if less.

        Parameters
        ----------
        threshold_dn : float

        Returns
        -------
        float
            DN; below 0 a defect is missed, or something else is detected.
        """
        return min(threshold_dn - self.flawless_dn, min(self.peaks_dn, default=0) - threshold_dn)

    @property
    def margin_dn(self) -> float:
        """Level of the faintest defect less the highest of what is flawless."""
        return min(self.peaks_dn, default=0) - self.flawless_dn

    @classmethod
    def of(
        cls,
        traced: Traced,
        station: Station,
        *,
        drawn: bool = True,
        expected: bool = True,
        looked: Looked | None = None,
    ) -> AtThreshold:
        """Look at a traced part under a design of its geometry.

        Parameters
        ----------
        traced : Traced
        station : Station
            With its threshold, size filter, polarity and background.
        drawn : bool
            Whether noise is drawn; else its mean is looked at, where it has a closed form, which
            takes a tenth of the time.
        expected : bool
            Whether it is told what noise makes of it.
        looked : Looked, optional
            Of that station at any threshold; None: it is taken.
        """
        looked = looked or Looked.of(traced, station, drawn=drawn)
        aspect, level = looked.aspect, looked.level
        on_part, truth, rule = traced.lost != BESIDE, traced.truth, station.segmentation
        guard, threshold = traced.guard, float(rule.threshold)
        told = expected and has_noisy_form(station) and pixel_by_pixel(station)
        least = least_pixels(rule.min_area_mm2, station.camera.sampling_mm)
        detected = (aspect > threshold) & on_part
        if least > 1:
            detected &= connected(detected, least) != 0
        false = false_blobs(detected, guard, min_area_px=least)
        defects = len(truth.defects)
        marked = np.flatnonzero((truth.labels != 0) & on_part)
        owner = truth.labels.flat[marked]
        peaks = np.full(defects + 1, -np.inf)
        np.maximum.at(peaks, owner, level.flat[marked])
        pixels = np.bincount(owner, minlength=defects + 1)[1:]
        hit = np.bincount(owner[detected.flat[marked]], minlength=defects + 1)[1:]
        seen = np.flatnonzero(pixels)
        flawless = level[on_part & ~guard]
        return cls(
            int(hit.sum()), int(np.count_nonzero(detected) - hit.sum()), len(marked),
            int(np.count_nonzero(hit)), len(seen),
            int(np.count_nonzero(false)), int(false.max(initial=0)),
            tuple(peaks[1:][seen].tolist()),
            tuple(truth.defects[n].size_mm for n in seen),
            tuple(truth.defects[n].kind for n in seen),
            tuple((hit[seen] > 0).tolist()),
            float(flawless.max(initial=0.0)),
            traced.light_map.expected(threshold, station) if told else None,
        )  # fmt: skip


def _held(image: NDArray[Any], traced: Traced, station: Station) -> NDArray[Any]:
    """Return the image whose levels a design's threshold is held against."""
    return levelled(image, traced.lost != BESIDE, station, traced.lost == 0)
