"""The part's shape without its relief, in float64: told once for station, part, light and studies.

A shape is asked for its height, slope and curvature at points and for its range over the part. What
else a part may be, a measured form or a mesh, answers the same questions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
_SQUARE_MIN = 1e-6  # of the cosine of the slope's angle: beyond the crown's sphere, kept finite


class Shape(Protocol):
    """A surface z(x, y) over the part's plane; lengths in mm, slopes and curvatures in 1, 1/mm."""

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return z at points (x, y), of their common shape."""

    def slope(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return dz/dx and dz/dy."""

    def curvature(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the second derivatives along xx, xy and yy."""

    def height_range(self, length: float, width: float) -> tuple[float, float]:
        """Return least and greatest height over a rectangle about the origin."""

    @property
    def convex(self) -> bool:
        """Whether no ray that it reflects can meet it again."""


@dataclass(frozen=True)
class Crown:
    """The sum of two sagittas, z = -c x^2 / (1 + sqrt(1 - c^2 x^2)), c = 1/radius; flat where 0.

    This form of R - sqrt(R^2 - x^2) does not cancel.

    Attributes
    ----------
    curvature_x, curvature_y : float
        1/radius along x and y in 1/mm, > 0 convex.

    Examples
    --------
    >>> from gpuspec.shapes import Crown
    >>> crown = Crown.of_radii(500.0, None)
    >>> f"{crown.height(100.0, 0.0):.3f} mm, slope {crown.slope(100.0, 0.0)[0]:.3f}"
    '-10.102 mm, slope -0.204'
    """

    curvature_x: float
    curvature_y: float

    @classmethod
    def of_radii(cls, radius_x_mm: float | None, radius_y_mm: float | None) -> Crown:
        """Return the crown of two radii.

        Parameters
        ----------
        radius_x_mm, radius_y_mm : float or None
            > 0 convex, < 0 concave; None: flat along that axis.
        """
        return cls(*(1 / radius if radius else 0.0 for radius in (radius_x_mm, radius_y_mm)))

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """See :meth:`Shape.height`."""
        x, y = np.asarray(x), np.asarray(y)
        cx, cy, qx, qy = self._cosines(x, y)
        height: Array = -cx * x**2 / (1 + qx) - cy * y**2 / (1 + qy)
        return height

    def slope(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """See :meth:`Shape.slope`."""
        x, y = np.asarray(x), np.asarray(y)
        cx, cy, qx, qy = self._cosines(x, y)
        return -cx * x / qx, -cy * y / qy

    def curvature(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """See :meth:`Shape.curvature`."""
        cx, cy, qx, qy = self._cosines(np.asarray(x), np.asarray(y))
        return -cx / qx**3, np.zeros(np.broadcast_shapes(qx.shape, qy.shape)), -cy / qy**3

    def height_range(self, length: float, width: float) -> tuple[float, float]:
        """See :meth:`Shape.height_range`."""
        edges = float(self.height(length / 2, 0.0)), float(self.height(0.0, width / 2))
        return sum(min(edge, 0.0) for edge in edges), sum(max(edge, 0.0) for edge in edges)

    @property
    def convex(self) -> bool:
        """See :meth:`Shape.convex`."""
        return min(self.curvature_x, self.curvature_y) >= 0

    def _cosines(self, x: Array, y: Array) -> tuple[float, float, Array, Array]:
        """Return both curvatures and the cosines of the slope's angle along x and y."""
        cx, cy = self.curvature_x, self.curvature_y
        qx, qy = (np.sqrt(np.maximum(1 - (c * u) ** 2, _SQUARE_MIN)) for c, u in ((cx, x), (cy, y)))
        return cx, cy, qx, qy


@dataclass(frozen=True)
class Sphere:
    """A spherical cap, z = -c r^2 / (1 + sqrt(1 - c^2 r^2)), r the distance to the z axis.

    A crown of two equal radii is no sphere: it is higher by some x^2 y^2 c^3 / 4.

    Attributes
    ----------
    curvature_mm : float
        c = 1/radius in 1/mm, > 0 convex.

    Examples
    --------
    >>> from gpuspec.shapes import Crown, Sphere
    >>> sphere, crown = Sphere(1 / 500.0), Crown.of_radii(500.0, 500.0)
    >>> f"{1e3 * (crown.height(100.0, 25.0) - sphere.height(100.0, 25.0)):.1f} um"
    '12.9 um'
    """

    curvature_mm: float

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """See :meth:`Shape.height`."""
        square, cosine = self._cosine(np.asarray(x), np.asarray(y))
        height: Array = -self.curvature_mm * square / (1 + cosine)
        return height

    def slope(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """See :meth:`Shape.slope`."""
        x, y = np.asarray(x), np.asarray(y)
        steep = -self.curvature_mm / self._cosine(x, y)[1]
        return steep * x, steep * y

    def curvature(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """See :meth:`Shape.curvature`."""
        x, y, c = np.asarray(x), np.asarray(y), self.curvature_mm
        cosine = self._cosine(x, y)[1]
        even, more = -c / cosine, -((c / cosine) ** 3)
        return even + more * x * x, more * x * y, even + more * y * y

    def height_range(self, length: float, width: float) -> tuple[float, float]:
        """See :meth:`Shape.height_range`."""
        corner = float(self.height(length / 2, width / 2))
        return min(corner, 0.0), max(corner, 0.0)

    @property
    def convex(self) -> bool:
        """See :meth:`Shape.convex`."""
        return self.curvature_mm >= 0

    def _cosine(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the squared distance to the axis and the cosine of the slope's angle."""
        square = x**2 + y**2
        return square, np.sqrt(np.maximum(1 - self.curvature_mm**2 * square, _SQUARE_MIN))
