"""From an aspect image, simulated or real, to blobs and classes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # whose modules are imported when they are used
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.detection.background import flattened, robust_sigma
from gpuspec.detection.classes import DEFAULT_RULES, ClassRule, classify
from gpuspec.detection.false_blobs import least_pixels
from gpuspec.detection.measures import Blobs, measure_blobs
from gpuspec.detection.segmentation import (
    Ceiling,
    Margins,
    flawless_level,
    segment,
    threshold_margins,
)
from gpuspec.errors import StationError
from gpuspec.shown import array
from gpuspec.station.station import Station

LOCAL_SIGMAS = 6.0
"""Robust sigmas of an image without its background, above which a pixel is detected: of a million
flawless ones not one in a hundred images."""
LOCAL_FLOOR = 0.01  # share of full scale that it is at least above the flawless level
WINDOW_MIN = 3.0  # pixels
Rule = Literal["stated", "ceiling", "spread", "background"]
"""How a threshold came about: the station states it; the ceiling and its noise; the median and what
levels spread about it; the same of what is left of an image without its background."""


@dataclass(frozen=True)
class Inspection:
    """What is found in an aspect image, simulated or real.

    Attributes
    ----------
    threshold : float
        Grey level above which a pixel is detected, DN.
    flawless_dn : float
        Median grey level of the part.
    labels : ndarray of int32, shape (M, N)
        Blobs, 0 elsewhere.
    blobs : Blobs
        Their measures.
    classes : ndarray of str, shape (n,)
        Class of each blob.
    rule : {"stated", "ceiling", "spread", "background"}
        How the threshold came about.
    ceiling : Ceiling or None
        From which it came, if it did.
    untold : str
        Why no ceiling is known, as the end of a sentence.
    """

    threshold: float
    flawless_dn: float
    labels: NDArray[np.int32]
    blobs: Blobs
    classes: NDArray[np.str_]
    rule: Rule
    ceiling: Ceiling | None = None
    untold: str = ""

    @property
    def threshold_said(self) -> str:
        """How the threshold came about, in words."""
        if self.rule == "stated":
            return "as the station states"
        if self.rule == "background":
            return "background and six robust sigmas"
        if self.ceiling is None:
            return "median and spread" + (f": {self.untold}" if self.untold else "")
        return self.ceiling.said

    def __repr__(self) -> str:
        return (
            f"Inspection({len(self.blobs)} blobs above {self.threshold:.1f} DN, flawless "
            f"{self.flawless_dn:.1f} DN; labels {array(self.labels)})"
        )


class Found:
    """What an inspected sequence shows of its inspection, simulated or real.

    Attributes
    ----------
    inspection : Inspection
    """

    inspection: Inspection

    @property
    def labels(self) -> NDArray[np.int32]:
        """Blobs as a label image, shape (M, N)."""
        return self.inspection.labels

    @property
    def blobs(self) -> Blobs:
        """Measures of the blobs."""
        return self.inspection.blobs

    @property
    def classes(self) -> NDArray[np.str_]:
        """Class of each blob."""
        return self.inspection.classes

    @property
    def threshold(self) -> float:
        """Grey level above which a pixel was detected, DN."""
        return self.inspection.threshold

    @property
    def flawless_dn(self) -> float:
        """Median grey level of what was inspected, DN."""
        return self.inspection.flawless_dn


def inspect(
    aspect: Image,
    valid: NDArray[np.bool_],
    station: Station,
    lit: NDArray[np.bool_] | None = None,
    ceiling: Ceiling | None = None,
    untold: str = "",
) -> Inspection:
    """Segment, measure and classify an aspect image, simulated or real.

    With ``segmentation.background_mm`` the slow background is taken off before, see
    :mod:`gpuspec.detection.background`; blobs are then measured above it, and what looks beyond the
    part or the light with some of its blur is left out.

    Parameters
    ----------
    aspect : ndarray of float32, shape (M, N)
        Grey levels in DN.
    valid : ndarray of bool, shape (M, N)
        Pixels on the part.
    station : Station
        Its threshold, size filter, classes, sampling and full scale are used.
    lit : ndarray of bool, shape (M, N), optional
        Pixels known to see the light, from which the flawless level and the automatic threshold
        are taken; None, or none at all: the valid ones.
    ceiling : Ceiling, optional
        The highest level that a flawless pixel can have, from which the automatic threshold of what
        is bright is taken; None: it is not known, and the spread of the levels tells.
    untold : str
        Why it is not known, as the end of a sentence.

    Returns
    -------
    Inspection

    Raises
    ------
    StationError
        If no pixel is valid.

    Examples
    --------
    >>> from gpuspec.detection.inspection import inspect
    >>> station = gpuspec.Station(camera={"sampling_mm": 0.1})
    >>> aspect = np.full((50, 80), 60.0, np.float32)
    >>> aspect[20:24, 30:50] = 120.0  # a bright streak of 2 mm by 0.4 mm
    >>> found = inspect(aspect, np.full((50, 80), True), station)
    >>> found.classes.tolist(), found.blobs.area_mm2.round(3).tolist()
    (['scratch'], [0.8])
    >>> found.threshold
    67.125
    """
    if not valid.any():
        raise StationError(
            f"{station.file}: no pixel of the image sees the part; check {station.seen_by}."
        )
    rule = station.segmentation
    sampling = station.camera.sampling_mm
    if lit is None or not lit.any():
        lit = valid
    aspect = levelled(aspect, valid, station, lit)
    if rule.threshold == "auto" and rule.background_mm:
        level, full = flawless_level(aspect, lit), station.sensor.full_scale_dn
        noise = LOCAL_SIGMAS * robust_sigma(aspect[lit])
        threshold = Margins(level, noise, 0.0, LOCAL_FLOOR * full).rounded_dn(full)
        how: Rule = "background"
    elif rule.threshold == "auto" and ceiling and rule.polarity == "bright":
        level, how = flawless_level(aspect, lit), "ceiling"
        threshold = ceiling.threshold_dn(station.sensor.full_scale_dn)
    elif rule.threshold == "auto":
        full, images = station.sensor.full_scale_dn, station.sequence.images
        margins = threshold_margins(aspect, lit, full_scale_dn=full, images=images)
        level, threshold, how = margins.flawless_dn, margins.rounded_dn(full), "spread"
    else:
        level, threshold, how = flawless_level(aspect, lit), float(rule.threshold), "stated"
    least = least_pixels(rule.min_area_mm2, sampling)
    labels = segment(aspect, valid, threshold, min_area_px=least)
    blobs = measure_blobs(labels, aspect, sampling_mm=sampling, flawless_dn=level)
    classes = classify(blobs, class_rules(station))
    known = ceiling if how == "ceiling" else None
    return Inspection(threshold, level, labels, blobs, classes, how, known, untold)


def levelled(
    aspect: Image,
    valid: NDArray[np.bool_],
    station: Station,
    lit: NDArray[np.bool_] | None = None,
) -> Image:
    """Return the image whose levels a threshold is held against: as it is, unless the station asks.

    Its slow background is taken off, and what is darker turned to be brighter, see the station's
    ``segmentation.background_mm`` and ``segmentation.polarity``.

    Parameters
    ----------
    aspect, valid, station, lit
        As of :func:`inspect`.

    Returns
    -------
    ndarray of float32, shape (M, N)
        DN; the image itself where nothing is to be done.
    """
    rule, sampling = station.segmentation, station.camera.sampling_mm
    if lit is None or not lit.any():
        lit = valid
    if rule.background_mm:
        window, smoothing = (mm / sampling for mm in (rule.background_mm, rule.smoothing_mm))
        whole = _clear_of_edges(valid & lit, station.camera.beyond_px)
        aspect, _ = flattened(aspect, whole, max(window, WINDOW_MIN), smoothing_px=smoothing)
    if rule.polarity != "bright":
        aspect = _turned(aspect, np.float32(flawless_level(aspect, lit)), rule.polarity)
    return aspect


def _clear_of_edges(region: NDArray[np.bool_], beyond: int) -> NDArray[np.bool_]:
    """Leave out what looks beyond a region or the image with more than its own pixel.

    A blurred rim is darker than the part. In the median of its surroundings it would make what is
    beside it bright. Where nothing is left, the region itself is returned.
    """
    if not beyond:
        return region
    size = 2 * beyond + 1
    clear = scipy.ndimage.minimum_filter(region, size, mode="constant", cval=False)
    return clear if clear.any() else region


def _turned(aspect: Image, level: np.float32, polarity: str) -> Image:
    """Return the image with what is darker than the flawless level as much brighter than it."""
    below = level - aspect
    return level + (np.abs(below) if polarity == "both" else below)


def class_rules(station: Station) -> tuple[ClassRule, ...]:
    """Return the station's class rules, or the default ones if it has none."""
    if not station.classes:
        return tuple(DEFAULT_RULES)
    return tuple(
        ClassRule(
            rule.name,
            (rule.area_min_mm2, rule.area_max_mm2),
            (rule.weight_min_dn, rule.weight_max_dn),
            (rule.elongation_min, rule.elongation_max),
        )
        for rule in station.classes
    )
