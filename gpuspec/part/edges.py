"""Chips and burrs: where the part's outline is another than a rectangle, and which pixels see it.

Each is half an ellipse about its place on an edge, width along and depth across it: what is in it
is beside the part, of a chip, or of the part, of a burr.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.part.view import magnified, pixel_position, seen_at, surface_points
from gpuspec.station.defects import EdgeDefect
from gpuspec.station.station import Station

OUTLINE = {"chip": -1, "burr": 1}
"""What an edge defect says of the points in it: beside the part, or of it."""
_OUTWARD = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}


@dataclass(frozen=True)
class Edges:
    """Edge defects, in float64.

    Attributes
    ----------
    defects : tuple of EdgeDefect
    middle : ndarray, shape (E, 2)
        x and y of the ellipses' middles, on the edge, mm.
    along : ndarray, shape (E, 2)
        From there to the ellipse's end along the edge, mm.
    depth : ndarray, shape (E,)
        Of the ellipses, across the edge, mm.
    """

    defects: tuple[EdgeDefect, ...]
    middle: NDArray[np.float64]
    along: NDArray[np.float64]
    depth: NDArray[np.float64]

    @classmethod
    def of(cls, station: Station) -> Edges:
        """Lay a station's edge defects on the edges of its part.

        Parameters
        ----------
        station : Station

        Examples
        --------
        >>> from gpuspec.part.edges import Edges
        >>> chip = {"kind": "chip", "side": "top", "at_mm": 3, "width_mm": 2, "depth_mm": 0.5}
        >>> edges = Edges.of(gpuspec.Station(edges=[chip]))
        >>> edges.middle.tolist(), edges.along.tolist()
        ([[3.0, 25.0]], [[-1.0, 0.0]])
        >>> edges.outline(np.array([3.0, 3.0]), np.array([24.6, 24.4])).tolist()
        [-1, 0]
        """
        half = np.array([station.part.length_mm, station.part.width_mm]) / 2
        outward = np.array([_OUTWARD[one.side] for one in station.edges], float).reshape(-1, 2)
        turned = outward[:, ::-1] * [-1, 1]
        at = np.array([one.at_mm for one in station.edges])[:, None]
        wide = np.array([one.width_mm for one in station.edges])[:, None]
        middle = outward * half + np.abs(turned) * at
        return cls(
            station.edges, middle, turned * wide / 2,
            np.array([one.depth_mm for one in station.edges]),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.depth)

    def __repr__(self) -> str:
        return f"Edges({len(self)} chips and burrs, in mm)"

    @property
    def signs(self) -> NDArray[np.int8]:
        """What each says of the points in it, see ``OUTLINE``, shape (E,)."""
        return np.array([OUTLINE[one.kind] for one in self.defects], np.int8)

    @property
    def ends(self) -> NDArray[np.float64]:
        """Both ends of the ellipses' axes along the edge, x and y in mm, shape (E, 4)."""
        return np.concatenate([self.middle - self.along, self.middle + self.along], axis=1)

    def inside(self, number: int, x: NDArray[np.float64], y: NDArray[np.float64]) -> Mask:
        """Return whether points are in the ellipse of one of them.

        Parameters
        ----------
        number : int
            From 0.
        x, y : ndarray
            Points of the part in mm, of one shape.
        """
        along = self.along[number]
        away = np.stack([x, y], axis=-1) - self.middle[number]
        u = away @ along / (along @ along)
        across = away - u[..., None] * along
        inside: Mask = u**2 + (across**2).sum(axis=-1) / self.depth[number] ** 2 < 1
        return inside

    def outline(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int8]:
        """Return what they say of points: -1 beside the part, 1 of it, 0 nothing.

        Parameters
        ----------
        x, y : ndarray
            Points of the part in mm, of one shape.
        """
        said = np.zeros(np.shape(x), np.int8)
        for number in reversed(range(len(self))):
            said[self.inside(number, x, y)] = self.signs[number]
        return said


NO_EDGES = Edges((), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
"""Of a part whose outline is whole."""


def straight(station: Station, column: NDArray[Any] | float, row: NDArray[Any] | float) -> Mask:
    """Return which pixels see a part whose edges are straight.

    Parameters
    ----------
    station : Station
    column, row : ndarray of int64 or float64
        Pixels, or places between their centres, of shapes that broadcast.
    """
    return _on_part(NO_EDGES, station, column, row)


def _on_part(
    edges: Edges, station: Station, column: NDArray[Any] | float, row: NDArray[Any] | float
) -> Mask:
    x, y = surface_points(station, column, row)
    part = station.part
    inside = (np.abs(x) <= part.length_mm / 2) & (np.abs(y) <= part.width_mm / 2)
    said = edges.outline(x, y)
    found: Mask = np.where(said == 0, inside, said > 0)
    return found


def cut_at_border(edges: Edges, station: Station) -> NDArray[np.int64]:
    """Return which pixels by the image's border the part's edge cuts.

    Elsewhere neighbours tell of it: one of them is lost. Beyond the image is none, and there looks
    what of a pixel's spot is wider than itself.

    Parameters
    ----------
    edges : Edges
    station : Station
        That they are of.

    Returns
    -------
    ndarray of int64
        Flat indices into the image, ascending, none twice.
    """
    rows, columns = station.shape
    down, across = np.arange(rows), np.arange(columns)
    reach = station.camera.reach_px
    sides: list[tuple[Any, Any, float, float]] = [
        side
        for line in range(min(max(station.camera.beyond_px, 1), rows, columns))
        for side in (
            (down, line, 0, -reach), (down, columns - 1 - line, 0, reach),
            (line, across, -reach, 0), (rows - 1 - line, across, reach, 0),
        )
    ]  # fmt: skip
    found = []
    for row, column, below, beside in sides:
        cut = _on_part(edges, station, column, row) != _on_part(
            edges, station, column + beside, row + below
        )
        found.append((row * columns + column)[cut])
    return np.unique(np.concatenate(found))


def zones(edges: Edges, station: Station) -> NDArray[np.int32]:
    """Return which pixels each chip takes away, and each burr adds.

    Parameters
    ----------
    edges : Edges
    station : Station
        That they are of.

    Returns
    -------
    ndarray of int32, shape (M, N)
        0 where the part is as it should be, i in the i-th edge defect.
    """
    labels = np.zeros(station.shape, np.int32)
    for number in reversed(range(len(edges))):
        rows, columns = _window(edges, number, station)
        row = np.arange(rows.start, rows.stop)[:, None]
        column = np.arange(columns.start, columns.stop)[None]
        changed = edges.inside(number, *surface_points(station, column, row))
        on_part = straight(station, column, row)
        changed &= on_part if edges.defects[number].kind == "chip" else ~on_part
        labels[rows, columns][changed] = number + 1
    return labels


def _window(edges: Edges, number: int, station: Station) -> tuple[slice, slice]:
    """Return rows and columns that may see an edge defect, with room for a height's parallax."""
    ends = edges.ends[number].reshape(2, 2)
    room = float(edges.depth[number])
    if station.part.surface == "height":
        room += 0.1 * float(np.abs(ends).max())
    position = seen_at(ends, station) if station.posed else pixel_position(ends, station)
    reach = room * (magnified(station) if station.posed else 1) / station.camera.sampling_mm + 1
    if not np.isfinite(position).all():  # not before the camera
        return slice(0, 0), slice(0, 0)
    rows, columns = (
        (max(int(low), 0), max(min(int(high) + 1, size), 0))
        for low, high, size in zip(
            position[:, ::-1].min(axis=0) - reach, position[:, ::-1].max(axis=0) + reach,
            station.shape, strict=True,
        )
    )  # fmt: skip
    return slice(*rows), slice(*columns)
