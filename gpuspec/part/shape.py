"""The part's shape without relief, whatever it is made of: crown, sphere or mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gpuspec.part.maps import TopographyMap, relief_at
from gpuspec.part.meshes import mesh_map
from gpuspec.shapes import Array, Shape
from gpuspec.station.station import Station


@dataclass(frozen=True, eq=False)
class Meshed:
    """A mesh as a shape: the spline through its sampled heights; beyond them it stays level.

    Attributes
    ----------
    sampled : TopographyMap
        Heights of the mesh over the part.
    """

    sampled: TopographyMap

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """See :meth:`gpuspec.shapes.Shape.height`."""
        return self._all(x, y)[0]

    def slope(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """See :meth:`gpuspec.shapes.Shape.slope`."""
        _, along, across, *_ = self._all(x, y)
        return along, across

    def curvature(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """See :meth:`gpuspec.shapes.Shape.curvature`."""
        *_, xx, xy, yy = self._all(x, y)
        return xx, xy, yy

    def height_range(self, length: float, width: float) -> tuple[float, float]:
        """See :meth:`gpuspec.shapes.Shape.height_range`."""
        return float(self.sampled.relief_mm.min()), float(self.sampled.relief_mm.max())

    @property
    def convex(self) -> bool:
        """See :meth:`gpuspec.shapes.Shape.convex`."""
        return False

    def _all(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, ...]:
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        found = relief_at((self.sampled,), np.atleast_1d(x), np.atleast_1d(y))
        return tuple(one.reshape(x.shape) for one in found)


def shape_of(station: Station) -> Shape:
    """Return the shape of a station's part.

    Parameters
    ----------
    station : Station

    Raises
    ------
    TopographyError
        If it is a mesh that cannot be used.
    """
    sampled = mesh_map(station)
    return station.part.shape if sampled is None else Meshed(sampled)


def steepest(shape: Shape, station: Station) -> float:
    """Return at least the steepest slope of a shape over the part: of a crown, at its corner.

    Parameters
    ----------
    shape : Shape
    station : Station
        The size of its part is used.
    """
    if isinstance(shape, Meshed):
        slopes = np.gradient(shape.sampled.relief_mm, *shape.sampled.pitch_mm[::-1])
        return sum(float(np.abs(slope).max()) for slope in slopes)
    along, across = shape.slope(station.part.length_mm / 2, station.part.width_mm / 2)
    return float(abs(along) + abs(across))
