"""Which pixels one straight groove crosses, and nothing else of the relief."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.part.grooves import BLOCK, averaged, blocks
from gpuspec.part.guard import faint_from
from gpuspec.part.marches import march_of
from gpuspec.part.relief import Relief
from gpuspec.part.truth import window
from gpuspec.part.view import surface_points
from gpuspec.station.station import Station

_CORNER = 0.71  # of a pixel: as far as its corners are from its centre
_AROUND = 3  # pixels: so far from what bends the light its neighbours may be refined


def crossed(station: Station, relief: Relief, pixels: NDArray[np.integer]) -> Mask:
    """Return which pixels see, of the relief, one groove alone, and this as if it had no end.

    Across it such a pixel's light coordinate bends, and along it does not.

    Parameters
    ----------
    station : Station
    relief : Relief
        Of that station.
    pixels : ndarray of int, shape (n,)
        Flat indices into the image.

    Returns
    -------
    ndarray of bool, shape (n,)
        None where a pixel looks at a spot wider than itself, or rays are followed in steps.
    """
    found = np.zeros(len(pixels), np.bool_)
    camera, grooves = station.camera, relief.grooves
    spotted = camera.spot_side_mm != camera.sampling_mm
    if spotted or station.posed or station.part.relief or not len(grooves) or not len(pixels):
        return found
    if march_of(station, relief) is not None:
        return found
    columns = station.shape[1]
    row, column = np.divmod(pixels.astype(np.int64), columns)
    first, pieces = blocks(grooves, station, relief.edges)
    block = row // BLOCK * -(-columns // BLOCK) + column // BLOCK
    count = first[block + 1] - first[block]
    near = count > 0
    row, column, count, begin = row[near], column[near], count[near], first[block[near]]
    if not len(row):
        return found
    x, y = surface_points(station, column, row)
    corner = _CORNER * camera.sampling_mm
    part = station.part
    alone = np.minimum(part.length_mm / 2 - np.abs(x), part.width_mm / 2 - np.abs(y)) > corner
    for patch in relief.maps:
        rows, across = window(patch, station)
        alone &= ~_within(row, rows) | ~_within(column, across)
    # Pairs of a pixel and a piece that reaches its block.
    at = np.cumsum(count) - count
    of = np.repeat(np.arange(len(row)), count)
    piece = pieces[begin[of] + np.arange(len(of)) - at[of]]
    alone &= np.maximum.reduceat(piece, at) < len(grooves)  # an edge defect reaches some
    piece = np.minimum(piece, len(grooves) - 1)
    ends = grooves.ends[piece]
    course = ends[:, 2:] - ends[:, :2]
    away = np.stack([x[of], y[of]], axis=1) - ends[:, :2]
    length = np.hypot(*course.T)
    along = (course * away).sum(axis=1) / np.maximum(length, 1e-30)
    foot = np.clip(along, 0, length) / np.maximum(length, 1e-30)
    distance = np.hypot(*(away - foot[:, None] * course).T)
    nearest = np.minimum.reduceat(distance, at)[of]
    itself = distance == nearest
    alone &= np.add.reduceat(itself.astype(np.int64), at) == 1
    inside = (along > corner) & (along < length - corner)
    reach = faint_from(grooves, station)[piece]
    owner = np.zeros(len(row), grooves.owner.dtype)
    owner[of[itself]] = grooves.owner[piece[itself]]
    same = grooves.owner[piece] == owner[of]
    around = _AROUND * camera.sampling_mm
    beyond = np.where(same, nearest + 2 * corner, reach + corner)
    fits = np.where(itself, inside & (distance < reach + around), distance > beyond)
    alone &= np.logical_and.reduceat(fits, at)
    found[near] = alone
    return found


def _within(places: NDArray[np.int64], span: slice) -> Mask:
    inside: Mask = (places >= span.start) & (places < span.stop)
    return inside


class Crossed:
    """Remembers of some pixels which one groove alone crosses, see :func:`crossed`.

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
        self._asked, self._crossed = (np.zeros(len(pixels), np.bool_) for _ in range(2))

    def at(self, places: NDArray[np.integer]) -> Mask:
        """Return which are, of the pixels at some places, shape (k,).

        Parameters
        ----------
        places : ndarray of int, shape (k,)
            None twice.
        """
        new = places[~self._asked[places]]
        if len(new):
            self._crossed[new] = crossed(self._station, self._relief, self._pixels[new])
            self._asked[new] = True
        return self._crossed[places]
