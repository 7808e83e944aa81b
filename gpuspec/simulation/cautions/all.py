"""What a user should know before trusting a score: what, why, and which key to change.

What the images can tell is read off them; the rest are laws of the model that a station breaks. A
wrong diagnosis is worse than none: each is said only where it is true.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image
from gpuspec.detection.inspection import Inspection
from gpuspec.detection.score import Score
from gpuspec.light.light_map import LightMap
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.simulation.cautions.camera import of_camera
from gpuspec.simulation.cautions.defects import of_defects
from gpuspec.simulation.cautions.detection import of_detection
from gpuspec.simulation.cautions.light import of_light, of_pattern
from gpuspec.simulation.cautions.station import (
    of_shifts,
    of_stripes,
    unstated,
    without_effect,
)
from gpuspec.station.station import Station


def cautions(
    station: Station,
    relief: Relief,
    truth: Truth,
    lost: NDArray[np.uint8],
    light_map: LightMap,
    aspect: Image,
    found: Inspection,
    scored: Score,
) -> tuple[str, ...]:
    """Return what is to be known of one simulated inspection.

    Parameters
    ----------
    station : Station
    relief, truth : Relief, Truth
        Of the station.
    lost : ndarray of uint8, shape (M, N)
        Index into ``arrays.LOST``.
    light_map : LightMap
        From which the aspect image is; its pattern, if it has one, is the light.
    aspect : ndarray of float32, shape (M, N)
        DN.
    found : Inspection
    scored : Score

    Returns
    -------
    tuple of str
        A note each, of one or two sentences; most basic first.
    """
    lit = lost == 0
    said = [*unstated(station), *without_effect(station), *relief.remarks]
    said += of_light(station, lost, truth)
    if light_map.pattern is None:
        said += of_stripes(station)
        basic = bool(of_shifts(station))
    else:
        under = of_pattern(light_map, lit, aspect)
        said += under
        basic = bool(under)
        if station.part.diffuse:
            said.append(
                f"part.diffuse is lit as by tunnel.luminous_mm and tunnel.dark_mm: what "
                f"{light_map.pattern.file} is on average is not known."
            )
    said += of_camera(station)
    said += of_defects(station, relief, truth, scored, lost)
    if lit.any():
        valid = lost != BESIDE
        said += of_detection(light_map, aspect, lit, valid, found, scored, basic=basic)
    return tuple(said)


def common(lists: Iterable[Sequence[str]]) -> list[str]:
    """Return the notes that are in every list, in the order of the first."""
    found: list[Any] = list(lists)
    return [note for note in found[0] if all(note in other for other in found)] if found else []
