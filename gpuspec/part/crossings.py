"""What of the relief crosses a pixel: one straight groove, or a crease where one bends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.part.grooves import block_of
from gpuspec.part.guard import faint_from
from gpuspec.part.marches import march_of
from gpuspec.part.relief import Relief
from gpuspec.part.truth import window
from gpuspec.part.view import surface_points
from gpuspec.station.station import Station

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

OTHER, GROOVE, CREASE = 0, 1, 2
"""What crosses a pixel: neither; one groove alone, as if it had no end, so that the light
coordinate bends across it and not along it; or a line on which two sides of one groove are as near,
so that it jumps."""

_CORNER = 0.71  # of a pixel: as far as its corners are from its centre
_AROUND = 3  # pixels: so far from what bends the light its neighbours may be refined
_BENT = 0.1  # sine of the angle between two pieces, from which on the jump matters
_CROWD = 16  # pieces: where more reach a block nothing is told of its pixels
_PAIRS_AT_ONCE = 1 << 19


@dataclass(frozen=True)
class Near:
    """What reaches the blocks of some pixels.

    Attributes
    ----------
    first, count : ndarray of int64, shape (n,)
        Where in :meth:`Relief.blocks` each block's list begins, and how many grooves it has.
    edges : ndarray of bool, shape (n,)
        Whether edge defects stand behind them.
    """

    first: Ints
    count: Ints
    edges: Mask

    @classmethod
    def of(cls, station: Station, relief: Relief, row: Ints, column: Ints) -> Near:
        """Look up the blocks of pixels.

        Parameters
        ----------
        station : Station
        relief : Relief
        row, column : ndarray of int64, shape (n,)
        """
        begin, pieces = relief.blocks(station)
        block = block_of(row, column, station.shape)
        first, end = begin[block].astype(np.int64), begin[block + 1].astype(np.int64)
        if not len(relief.edges):
            return cls(first, end - first, np.zeros(len(first), np.bool_))
        before = np.concatenate([[0], np.cumsum(pieces >= len(relief.grooves))])
        edges = before[end] - before[first]
        return cls(first, end - first - edges, edges > 0)

    def only(self, some: Ints) -> Near:
        """Return those of some of the pixels."""
        return Near(self.first[some], self.count[some], self.edges[some])


@dataclass(frozen=True)
class Pairs:
    """Pixels, and for each of them the pieces of grooves that reach its block.

    Attributes
    ----------
    piece : ndarray of int64, shape (n,)
        Number of the piece; pixel by pixel.
    begin, count : ndarray of int64, shape (pixels,)
        Where each pixel's pairs begin, and how many they are, one at least.
    course : ndarray of float64, shape (2, n)
        Direction of the piece.
    along : ndarray of float64, shape (n,)
        How far along it the pixel is from its beginning, mm.
    beside : ndarray of float64, shape (n,)
        How far to its left, mm.
    length, distance : ndarray of float64, shape (n,)
        Of the piece, and from it, mm.
    nearest : ndarray of int64, shape (pixels,)
        Of each pixel the pair of the nearest piece, the first of these.
    """

    piece: Ints
    begin: Ints
    count: Ints
    course: Floats
    along: Floats
    beside: Floats
    length: Floats
    distance: Floats
    nearest: Ints

    @classmethod
    def of(cls, station: Station, relief: Relief, near: Near, x: Floats, y: Floats) -> Pairs:
        """Measure them.

        Parameters
        ----------
        station : Station
        relief : Relief
        near : Near
            Of these pixels, each with a groove at least.
        x, y : ndarray of float64, shape (pixels,)
            Where the pixels' centres meet the part's shape, mm.
        """
        count, (_, listed) = near.count, relief.blocks(station)
        begin = np.cumsum(count) - count
        piece = listed[np.arange(count.sum()) + np.repeat(near.first - begin, count)]
        start_x, start_y, end_x, end_y = relief.grooves.ends.T
        length = np.hypot(end_x - start_x, end_y - start_y)
        point = length == 0  # has no direction: any will do
        unit = np.where(point, 1, length)
        ux, uy = (
            np.where(point, 1, (end_x - start_x) / unit)[piece],
            ((end_y - start_y) / unit)[piece],
        )
        dx, dy = np.repeat(x, count) - start_x[piece], np.repeat(y, count) - start_y[piece]
        along, beside = dx * ux + dy * uy, ux * dy - uy * dx
        length = length[piece]
        past = along - np.minimum(np.maximum(along, 0), length)
        distance = np.sqrt(past * past + beside * beside)
        least = np.repeat(np.minimum.reduceat(distance, begin), count)
        least = np.flatnonzero(distance == least)
        nearest = least[np.searchsorted(least, begin)]
        course = np.stack([ux, uy])
        return cls(piece, begin, count, course, along, beside, length, distance, nearest)

    def of_nearest(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return, for each pair, what its pixel's nearest piece has."""
        found: NDArray[Any] = np.repeat(values[..., self.nearest], self.count, axis=-1)
        return found

    def all(self, holds: Mask) -> Mask:
        """Return for which pixels something holds of all pairs."""
        found: Mask = np.logical_and.reduceat(holds, self.begin)
        return found


def crossings(station: Station, relief: Relief, pixels: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return what of the relief crosses each pixel.

    Parameters
    ----------
    station : Station
    relief : Relief
        Of that station.
    pixels : ndarray of int, shape (n,)
        Flat indices into the image.

    Returns
    -------
    ndarray of uint8, shape (n,)
        ``OTHER``, ``GROOVE`` or ``CREASE``; ``OTHER`` wherever pixels look at spots wider than
        themselves, rays are followed in steps, or a block has very many grooves; of a part or a
        camera that is moved or tilted none is a ``GROOVE``.
    """
    found = np.full(len(pixels), OTHER, np.uint8)
    camera, part = station.camera, station.part
    stepped = part.relief or march_of(station, relief) is not None
    if camera.spotted or stepped:
        return found
    row, column = np.divmod(pixels.astype(np.int64), station.shape[1])
    near = Near.of(station, relief, row, column)
    told = np.flatnonzero((near.count > 0) & (near.count <= _CROWD) & ~near.edges)
    ends = np.flatnonzero(np.diff(np.cumsum(near.count[told]) // _PAIRS_AT_ONCE)) + 1
    for some in np.split(told, ends) if len(told) else ():
        x, y = surface_points(station, column[some], row[some])
        pairs = Pairs.of(station, relief, near.only(some), x, y)
        found[some] = _told(pairs, station, relief)
        inward = np.minimum(part.length_mm / 2 - np.abs(x), part.width_mm / 2 - np.abs(y))
        found[some[inward <= _CORNER * _pitch(station)]] = OTHER
    if station.posed:  # slices are of pixels that look straight down
        found[found == GROOVE] = OTHER
    for patch in relief.maps:
        rows, across = window(patch, station)
        inside = (row >= rows.start) & (row < rows.stop)
        found[inside & (column >= across.start) & (column < across.stop)] = OTHER
    return found


def courses(station: Station, relief: Relief, row: Ints, column: Ints) -> Floats:
    """Return the direction of the groove nearest to each pixel, of those that reach its block.

    Parameters
    ----------
    station : Station
    relief : Relief
        Of that station.
    row, column : ndarray of int64, shape (n,)

    Returns
    -------
    ndarray of float64, shape (2, n)
        Unit vectors; of no groove (1, 0).
    """
    found = np.zeros((2, len(row)))
    found[0] = 1
    near = Near.of(station, relief, row, column)
    told = np.flatnonzero(near.count > 0)
    if len(told):
        x, y = surface_points(station, column[told], row[told])
        pairs = Pairs.of(station, relief, near.only(told), x, y)
        found[:, told] = pairs.course[:, pairs.nearest]
    return found


def _told(pairs: Pairs, station: Station, relief: Relief) -> NDArray[np.uint8]:
    """Return what crosses pixels of which nothing but grooves is to be told."""
    p, grooves = _pitch(station), relief.grooves
    corner = _CORNER * p
    owner = grooves.owner[pairs.piece]
    reach = faint_from(grooves, station)[pairs.piece]
    itself = np.zeros(len(owner), np.bool_)
    itself[pairs.nearest] = True
    own = owner == pairs.of_nearest(owner)
    gap = pairs.distance - pairs.of_nearest(pairs.distance)
    matters = pairs.distance < reach + _AROUND * p
    # One that does not end here; others of the same defect are nowhere in the pixel as near, other
    # defects faint there.
    endless = (pairs.along > corner) & (pairs.along < pairs.length - corner)
    away = np.where(own, gap > 2 * corner, pairs.distance > reach + corner)
    groove = pairs.all(np.where(itself, endless & matters, away))
    # Two sides that meet here: of pieces at an angle, or of such that look at each other. On the
    # outer side of a bend both are as near by the end that they share.
    meet = own & matters & (gap <= 2 * corner)
    meet &= (pairs.along > -corner) & (pairs.along < pairs.length + corner)
    (ux, uy), (vx, vy) = pairs.course, pairs.of_nearest(pairs.course)
    beside = pairs.of_nearest(pairs.beside)
    facing = (ux * vx + uy * vy) * pairs.beside * beside < 0
    facing &= np.minimum(np.abs(pairs.beside), np.abs(beside)) > corner
    crease = ~pairs.all(~(meet & ((np.abs(ux * vy - uy * vx) > _BENT) | facing)))
    return np.where(groove, GROOVE, np.where(crease, CREASE, OTHER)).astype(np.uint8)


def _pitch(station: Station) -> float:
    """Return how far apart on the part neighbouring pixels look, at most of some of the image."""
    if not station.posed:
        return station.camera.sampling_mm
    row, column = np.meshgrid(*(np.linspace(0, n - 1, 3) for n in station.shape))
    here = surface_points(station, column, row)
    steps = [surface_points(station, column + 1, row), surface_points(station, column, row + 1)]
    return max(float(np.hypot(x - here[0], y - here[1]).max()) for x, y in steps)


class Crossings:
    """Remembers what crosses some pixels, see :func:`crossings`.

    Parameters
    ----------
    station : Station
    relief : Relief
        Of that station.
    pixels : ndarray of int, shape (n,)
        Flat indices into the image.
    """

    def __init__(self, station: Station, relief: Relief, pixels: NDArray[np.integer]) -> None:
        self._station, self._relief, self._pixels = station, relief, pixels
        self._asked = np.zeros(len(pixels), np.bool_)
        self._found = np.full(len(pixels), OTHER, np.uint8)

    def at(self, places: NDArray[np.integer]) -> NDArray[np.uint8]:
        """Return what crosses the pixels at some places, shape (k,).

        Parameters
        ----------
        places : ndarray of int, shape (k,)
            None twice.
        """
        new = places[~self._asked[places]]
        if len(new):
            self._found[new] = crossings(self._station, self._relief, self._pixels[new])
            self._asked[new] = True
        found: NDArray[np.uint8] = self._found[places]
        return found
