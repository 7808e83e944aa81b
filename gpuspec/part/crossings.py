"""What of the relief crosses a pixel: one straight groove, or a crease where one bends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.part.grooves import BLOCK
from gpuspec.part.guard import faint_from
from gpuspec.part.marches import march_of
from gpuspec.part.relief import Relief
from gpuspec.part.truth import window
from gpuspec.part.view import surface_points
from gpuspec.station.station import Station

OTHER, GROOVE, CREASE = 0, 1, 2
"""What crosses a pixel: neither; one groove alone, as if it had no end, so that the light
coordinate bends across it and not along it; or the line on which two pieces of one groove are as
near, where it jumps."""

_CORNER = 0.71  # of a pixel: as far as its corners are from its centre
_AROUND = 3  # pixels: so far from what bends the light its neighbours may be refined
_BENT = 0.1  # sine of the angle between two pieces, from which on the jump matters


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
        ``OTHER``, ``GROOVE`` or ``CREASE``; ``OTHER`` wherever pixels look at a spot wider than
        themselves, or rays are followed in steps.
    """
    found = np.full(len(pixels), OTHER, np.uint8)
    camera, part, grooves = station.camera, station.part, relief.grooves
    spotted = camera.spot_side_mm != camera.sampling_mm
    if spotted or station.posed or part.relief or march_of(station, relief) is not None:
        return found
    columns = station.shape[1]
    row, column = np.divmod(pixels.astype(np.int64), columns)
    first, pieces = relief.blocks(station)
    block = row // BLOCK * -(-columns // BLOCK) + column // BLOCK
    count = first[block + 1] - first[block]
    near = np.flatnonzero(count)
    if not len(near):
        return found
    row, column, count, begin = row[near], column[near], count[near], first[block[near]]
    x, y = surface_points(station, column, row)
    corner = _CORNER * camera.sampling_mm
    alone = np.minimum(part.length_mm / 2 - np.abs(x), part.width_mm / 2 - np.abs(y)) > corner
    for patch in relief.maps:
        rows, across = window(patch, station)
        inside = (row >= rows.start) & (row < rows.stop)
        alone &= ~(inside & (column >= across.start) & (column < across.stop))
    # Pairs of a pixel and a piece that reaches its block.
    at = np.cumsum(count) - count
    piece = pieces[np.arange(count.sum()) + np.repeat(begin - at, count)]
    if len(relief.edges):
        alone &= np.maximum.reduceat(piece, at) < len(grooves)
        piece = np.minimum(piece, len(grooves) - 1)
    start_x, start_y, end_x, end_y = grooves.ends.T
    length = np.hypot(end_x - start_x, end_y - start_y)
    unit = np.maximum(length, 1e-30)
    ux, uy = ((end_x - start_x) / unit)[piece], ((end_y - start_y) / unit)[piece]
    dx, dy = np.repeat(x, count) - start_x[piece], np.repeat(y, count) - start_y[piece]
    along, length = dx * ux + dy * uy, length[piece]
    foot = np.minimum(np.maximum(along, 0), length)
    dx -= foot * ux
    dy -= foot * uy
    distance = np.sqrt(dx * dx + dy * dy)
    nearest = np.repeat(np.minimum.reduceat(distance, at), count)
    itself = distance == nearest
    one = np.add.reduceat(itself, at, dtype=np.int32) == 1
    owner = grooves.owner[piece]
    own = owner == np.repeat(np.maximum.reduceat(np.where(itself, owner, -1), at), count)
    reach = faint_from(grooves, station)[piece]
    # Others of the same defect are nowhere in the pixel as near, other defects faint there.
    fits = distance > np.where(own, nearest + 2 * corner, reach + corner)
    whole = (along > corner) & (along < length - corner)
    whole &= distance < reach + _AROUND * camera.sampling_mm
    alone &= one & np.logical_and.reduceat(np.where(itself, whole, fits), at)
    # Pieces whose sides meet in the pixel: on the outer side of a bend both are as near by its end.
    meet = own & (along > -corner) & (along < length + corner)
    meet &= distance <= nearest + 2 * corner
    turn = np.abs(ux * _of_nearest(uy, itself, at, count) - uy * _of_nearest(ux, itself, at, count))
    bent = np.logical_or.reduceat(meet & (turn > _BENT), at)
    found[near[bent]] = CREASE
    found[near[alone]] = GROOVE
    return found


def _of_nearest(
    values: NDArray[np.float64],
    itself: NDArray[np.bool_],
    at: NDArray[np.int64],
    count: NDArray[np.int32],
) -> NDArray[np.float64]:
    """Return, for each pair, the largest value of its pixel's nearest pieces."""
    largest: NDArray[np.float64] = np.maximum.reduceat(np.where(itself, values, -2.0), at)
    return np.repeat(largest, count)


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
