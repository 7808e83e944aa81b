"""Defects that are out of view, too steep, or too small."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE
from gpuspec.detection.score import Score
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect, Truth
from gpuspec.simulation.cautions.station import percent
from gpuspec.station.station import Station

TWICE = math.tan(math.pi / 6)
"""Slope of the sides of a groove in which light is reflected a second time."""


def of_defects(
    station: Station, relief: Relief, truth: Truth, scored: Score, lost: NDArray[np.uint8]
) -> list[str]:
    """Say which defects cannot be found, or not be trusted.

    Parameters
    ----------
    station : Station
    relief, truth : Relief, Truth
        Of the station.
    scored : Score
    lost : ndarray of uint8, shape (M, N)
        Index into ``arrays.LOST``.
    """
    said = []
    least = station.segmentation.min_area_mm2
    sizes = [_zone_area(defect) for defect in truth.defects] if least else []
    if sizes and least > min(sizes):
        small = sum(size < least for size in sizes)
        said.append(
            f"segmentation.min_area_mm2 = {least:g} may swallow {small} of {len(sizes)} defects: "
            f"the smallest zone has {min(sizes):.2g} mm2."
        )
    if scored.unseen:
        said.append(_unseen(scored.unseen, scored.defects))
    grooves = relief.grooves
    slope = np.abs(grooves.depth) / grooves.sigma / math.sqrt(math.e)
    steep = len(np.unique(grooves.owner[slope > TWICE]))
    if steep:
        said.append(
            f"{steep} of {len(relief.defects)} defects have slopes steeper than 30 degrees, up to "
            f"{slope.max():.2g}: light is reflected again in them, and the model follows it once. "
            f"Check depth_um against diameter_mm or width_mm."
        )
    part = lost.size - np.count_nonzero(lost == BESIDE)
    if scored.zone_px > part / 2:
        said.append(
            f"the zones of the defects cover {percent(scored.zone_px / part)} of the part: the "
            f"flawless level, a median, is then that of defects. Take fewer or smaller ones."
        )
    return said


def _unseen(unseen: int, defects: int) -> str:
    return (
        f"{unseen} of {defects} defects have no pixel of their own in the image: "
        f"outside the field, smaller than camera.sampling_mm, or under another."
    )


def out_of_view(station: Station, parts: int, seen: int) -> list[str]:
    """Say how many of the known defects no image has, where the station alone tells their number.

    Parameters
    ----------
    station : Station
    parts : int
        Number of parts.
    seen : int
        Defects with a pixel in view, of all parts.
    """
    counts = [population.count for population in station.populations]
    measured = station.part.relief or any(d.kind == "measured" for d in station.defects)
    if measured or None in counts:
        return []
    known = parts * (len(station.defects) + sum(count or 0 for count in counts))
    return [_unseen(known - seen, known)] if seen < known else []


def _zone_area(defect: KnownDefect) -> float:
    return math.pi * (defect.size_mm / 2) ** 2 + defect.size_mm * defect.length_mm
