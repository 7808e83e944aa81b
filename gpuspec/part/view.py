"""Which point of the part a pixel looks at, and which pixel sees a point."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.part.pose import Frames
from gpuspec.part.shape import shape_of
from gpuspec.station.station import Station

_NEWTON_STEPS = 8
_GRID = 33
_BETWEEN = 1.05  # what may be larger between the points of that grid


def surface_points(
    station: Station, column: NDArray[Any] | float, row: NDArray[Any] | float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y (mm) of the surface behind pixel centres; relief is left out of parallax.

    Parameters
    ----------
    station : Station
    column, row : ndarray of int64 or float64
        Pixels from 0, or places between their centres, of shapes that broadcast.

    Returns
    -------
    x, y : ndarray of float64, of their common shape
        In mm; y points up, rows down.
    """
    rows, columns = station.shape
    rises = station.part.surface == "height"
    x = (np.asarray(column, np.float64) + 0.5 - columns / 2) * station.camera.sampling_mm
    y = (rows / 2 - np.asarray(row, np.float64) - 0.5) * station.camera.sampling_mm
    x, y = np.broadcast_arrays(x, y)
    if station.posed:
        start, look = Frames.of(station).rays(station, x, y)
        way = -start[2] / look[2]
        shape = shape_of(station)
        for _ in range(_NEWTON_STEPS if rises else 0):
            x, y, z = start + way * look
            slope_x, slope_y = shape.slope(x, y)
            falls = look[2] - slope_x * look[0] - slope_y * look[1]
            way = way - (z - shape.height(x, y)) / falls
        x, y, _ = start + way * look
        return x, y
    if not rises:
        return x, y
    h = station.camera.height_mm
    shape = shape_of(station)
    k = np.ones(x.shape)
    for _ in range(_NEWTON_STEPS):
        miss = k - 1 + shape.height(x * k, y * k) / h
        slope_x, slope_y = shape.slope(x * k, y * k)
        k = k - miss / (1 + (slope_x * x + slope_y * y) / h)
    return x * k, y * k


def pixel_position(points: NDArray[np.float64], station: Station) -> NDArray[np.float64]:
    """Return (column, row), pixel edges whole, of points of z = 0, no camera posed.

    Devices count places on the part in pixels, too, whatever the camera's pose.

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


def seen_at(points: NDArray[np.float64], station: Station) -> NDArray[np.float64]:
    """Return (column, row), pixel edges whole, at which points of the part's shape are seen.

    Parameters
    ----------
    points : ndarray of float64, shape (..., 2)
        x and y in the part's frame, mm.
    station : Station

    Returns
    -------
    ndarray of float64, shape (..., 2)
        Not finite of what is not before the camera.
    """
    x, y = points[..., 0], points[..., 1]
    rises = station.part.surface == "height"
    z = shape_of(station).height(x, y) if rises else np.zeros(x.shape)
    on_plane = points / (1 - z / station.camera.height_mm)[..., None] if rises else points
    if station.posed:
        on_plane = Frames.of(station).seen(station, np.stack([x, y, z], axis=-1))
    return pixel_position(on_plane, station)


def magnified(station: Station) -> float:
    """Return how many pixels a pixel's width of a posed part's surface is wide, at most.

    Parameters
    ----------
    station : Station
    """
    part, step = station.part, 1e-3
    x, y = (np.linspace(-0.5, 0.5, _GRID) * side for side in (part.length_mm, part.width_mm))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    moves = [
        (seen_at(points + by, station) - seen_at(points - by, station)) / (2 * step)
        for by in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    widths = np.linalg.norm(np.stack(moves, axis=-1), 2, axis=(-2, -1))
    found = float(np.nanmax(widths, initial=0) * station.camera.sampling_mm)
    return _BETWEEN * max(found, 1.0)


def widest(station: Station) -> float:
    """Return the largest angle between a camera ray and the normal of the part's base plane, rad.

    Parameters
    ----------
    station : Station
    """
    (rows, columns), p = station.shape, station.camera.sampling_mm
    x, y = np.array([-1, 1]) * columns * p / 2, np.array([[-1], [1]]) * rows * p / 2
    _, rays = Frames.of(station).rays(station, x, y)
    return float(np.arctan2(np.hypot(rays[0], rays[1]), -rays[2]).max())
