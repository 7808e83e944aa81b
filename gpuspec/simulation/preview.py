"""Some of a station's pixels, evenly spread: what a light does, in a fraction of the time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image
from gpuspec.detection.inspection import Found, Inspection, inspect
from gpuspec.light.backend import Backend
from gpuspec.light.patterns import Pattern
from gpuspec.light.refined import with_cut
from gpuspec.simulation.simulate import Traced
from gpuspec.station.station import Station

MOST = 2**19
"""Pixels: a screen shows no more at a glance."""


@dataclass(frozen=True)
class Preview(Found):
    """What a light does to some pixels.

    Attributes
    ----------
    station : Station
        Its camera's pixels are as far apart as these.
    aspect : ndarray of float32, shape (m, n)
        DN, of one footprint per pixel.
    inspection : Inspection
        What stands out in it.
    truth : ndarray of int32, shape (m, n)
        Zones: 0 flawless, i the i-th defect.
    step : int
        How many pixels they are apart.
    """

    station: Station
    aspect: Image
    inspection: Inspection
    truth: NDArray[np.int32]
    step: int


class Previewer:
    """Every some-th pixel of a traced station, traced once more as a list.

    Parameters
    ----------
    traced : Traced
    engine : Backend
        That it is traced on.
    """

    def __init__(self, traced: Traced, engine: Backend) -> None:
        rows, columns = traced.station.shape
        self._step = step = math.ceil(math.sqrt(rows * columns / MOST))
        some = tuple(slice(min(step // 2, n - 1), n, step) for n in (rows, columns))
        pixels = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)[some]
        self._lost, self._truth = traced.lost[some], traced.truth.labels[some]
        camera = traced.station.camera
        self._station = traced.station.model_copy(
            update={
                "camera": camera.model_copy(
                    update={
                        "rows": pixels.shape[0], "columns": pixels.shape[1],
                        "sampling_mm": camera.sampling_mm * step,
                    }
                )
            }
        )  # fmt: skip
        self._light_map = engine.trace(with_cut(traced.station, 1), traced.relief, pixels.ravel())

    def under(self, pattern: Pattern) -> Preview:
        """Take their aspect image under a light, and segment it.

        Parameters
        ----------
        pattern : Pattern

        Raises
        ------
        PatternError
            If it does not compile.
        StationError
            If none of the pixels sees the part.
        """
        self._light_map = self._light_map.with_pattern(pattern)
        aspect = self._light_map.aspect().reshape(self._truth.shape)
        found = inspect(aspect, self._lost != BESIDE, self._station, self._lost == 0)
        return Preview(self._station, aspect, found, self._truth, self._step)
