"""From an aspect image, simulated or real, to blobs and classes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.detection.classes import DEFAULT_RULES, ClassRule, classify
from gpuspec.detection.measures import Blobs, measure_blobs
from gpuspec.detection.segmentation import automatic_threshold, flawless_level, segment
from gpuspec.errors import StationError
from gpuspec.shown import array
from gpuspec.station.station import Station


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
    """

    threshold: float
    flawless_dn: float
    labels: NDArray[np.int32]
    blobs: Blobs
    classes: NDArray[np.str_]

    def __repr__(self) -> str:
        return (
            f"Inspection({len(self.blobs)} blobs above {self.threshold:.1f} DN, flawless "
            f"{self.flawless_dn:.1f} DN; labels {array(self.labels)})"
        )


def inspect(
    aspect: Image,
    valid: NDArray[np.bool_],
    station: Station,
    lit: NDArray[np.bool_] | None = None,
) -> Inspection:
    """Segment, measure and classify an aspect image, simulated or real.

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
            f"{station.file}: no pixel of the image sees the part; check part.length_mm, "
            f"part.width_mm and camera.sampling_mm."
        )
    rule = station.segmentation
    sampling = station.camera.sampling_mm
    if lit is None or not lit.any():
        lit = valid
    level = flawless_level(aspect, lit)
    threshold = (
        automatic_threshold(
            aspect,
            lit,
            full_scale_dn=station.sensor.full_scale_dn,
            images=station.sequence.images,
        )
        if rule.threshold == "auto"
        else float(rule.threshold)
    )
    labels = segment(
        aspect, valid, threshold, min_area_px=math.ceil(rule.min_area_mm2 / sampling**2 - 1e-9)
    )
    blobs = measure_blobs(labels, aspect, sampling_mm=sampling, flawless_dn=level)
    return Inspection(threshold, level, labels, blobs, classify(blobs, class_rules(station)))


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
