"""Which point of the part a pixel looks at, and which pixel sees a point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.station.station import Station

_NEWTON_STEPS = 8


def surface_points(
    station: Station, column: NDArray[np.int64], row: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y (mm) of the surface behind pixel centres; relief is left out of parallax.

    Parameters
    ----------
    station : Station
    column, row : ndarray of int64
        Pixels from 0, of shapes that broadcast.

    Returns
    -------
    x, y : ndarray of float64, of their common shape
        In mm; y points up, rows down.
    """
    rows, columns = station.shape
    x = (np.asarray(column, np.float64) + 0.5 - columns / 2) * station.camera.sampling_mm
    y = (rows / 2 - np.asarray(row, np.float64) - 0.5) * station.camera.sampling_mm
    x, y = np.broadcast_arrays(x, y)
    if station.part.surface == "orientation":
        return x, y
    h = station.camera.height_mm
    shape = station.part.shape
    k = np.ones(x.shape)
    for _ in range(_NEWTON_STEPS):
        miss = k - 1 + shape.height(x * k, y * k) / h
        slope_x, slope_y = shape.slope(x * k, y * k)
        k = k - miss / (1 + (slope_x * x + slope_y * y) / h)
    return x * k, y * k


def pixel_position(points: NDArray[np.float64], station: Station) -> NDArray[np.float64]:
    """Return (column, row), pixel edges whole, of points of the part.

    Parameters
    ----------
    points : ndarray of float64, shape (S, 2)
        x and y in mm.
    station : Station

    Returns
    -------
    ndarray of float64, shape (S, 2)
    """
    rows, columns = station.shape
    half = np.array([columns, rows]) / 2
    position: NDArray[np.float64] = half + points * [1, -1] / station.camera.sampling_mm
    return position
