"""The part's shape without its relief: height, slope and curvature, told once for all who ask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.station.station import Station


def curvatures(station: Station) -> tuple[float, float]:
    """Return the crown's curvatures along x and y in 1/mm, 0 where flat."""
    radii = station.part.crown_radius_x_mm, station.part.crown_radius_y_mm
    return 1 / radii[0] if radii[0] else 0.0, 1 / radii[1] if radii[1] else 0.0


def shape_height(
    x: NDArray[np.float64], y: NDArray[np.float64], station: Station
) -> NDArray[np.float64]:
    """Return the height of the part's shape without relief, mm."""
    cx, cy = curvatures(station)
    qx, qy = (np.sqrt(np.maximum(1 - (c * u) ** 2, 1e-6)) for c, u in ((cx, x), (cy, y)))
    height: NDArray[np.float64] = -cx * x**2 / (1 + qx) - cy * y**2 / (1 + qy)
    return height
