"""What defects do to the light around their zones: a guard band, in which nothing is false."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import LabelImage, Mask
from gpuspec.part.grooves import Grooves, averaged
from gpuspec.part.relief import Relief
from gpuspec.part.spans import runs_around, stretch, together
from gpuspec.part.truth import ZONE, window
from gpuspec.station.station import Station

Ints = NDArray[np.int64]

FAINT = 0.001
"""Share by which what is left of one defect may change the footprint of a pixel not near it."""

REACH_PX = 2
"""Around zones, whatever is left of the defect there."""

_NEWTON_STEPS = 6


def near(station: Station, relief: Relief, zones: LabelImage) -> Ints:
    """Return the zones' pixels and those of their guard band, ascending.

    A defect does not end where its zone does. The band reaches as far as what is left of it changes
    the light by `FAINT`: a bright rim of a found defect lies in it, and beyond it the part is
    flawless.

    Parameters
    ----------
    station : Station
    relief : Relief
        Of that station.
    zones : ndarray of int32, shape (M, N)
        Of that part, see :class:`gpuspec.part.truth.Truth`.

    Returns
    -------
    ndarray of int64
        Flat indices into the image.
    """
    grooves = relief.grooves
    reach = np.maximum(faint_from(grooves, station), ZONE * grooves.sigma + _around(station))
    _, first, count = runs_around(grooves, station, reach)
    columns = station.shape[1]
    for patch in (m for m in relief.maps if m.name.startswith("defects")):
        rows, across = window(patch, station)
        begin = np.arange(rows.start, rows.stop) * columns + across.start
        first = np.concatenate([first, begin])
        count = np.concatenate([count, np.full(len(begin), across.stop - across.start)])
    there = count > 0
    found = together(first[there], count[there])
    if station.part.relief:  # of which the pits are known
        marked = widened(np.flatnonzero(zones), station.shape, REACH_PX)
        found = np.union1d(found, marked)
    return found


def guarded(station: Station, relief: Relief, zones: LabelImage) -> Mask:
    """Return which pixels are in a zone or its guard band, shape (M, N); see :func:`near`.

    Parameters
    ----------
    station : Station
    relief : Relief
    zones : ndarray of int32, shape (M, N)
    """
    found = np.zeros(zones.shape, np.bool_)
    found.flat[near(station, relief, zones)] = True
    return found


def _around(station: Station) -> float:
    return (REACH_PX + 1) * station.camera.spot_side_mm * stretch(station)


def faint_curvature(station: Station) -> float:
    """Return the curvature, 1/mm, that changes a flat part's footprint by FAINT under any tunnel.

    Light comes from t, a share s of the camera's distance h. From pixel to pixel it moves by
    p (1 + s), and a curvature c makes that 2 c t p more. Squared and with the pupil's and the
    roughness' squares, k p^2 s^2, that is a share 2 c h s (1 + s) / ((1 + s)^2 + k s^2) of the
    footprint, for s = 0 to 1. Of a spot wider than a pixel p is its side; off focus the pupil's
    points that look at a place turn the ray by a lean at most, which leaves 1 + (1 - lean) s of
    1 + s.

    Parameters
    ----------
    station : Station
        Its camera and roughness are used.
    """
    camera = station.camera
    p, h = camera.spot_side_mm, camera.height_mm
    lean = np.array([[0.0], [camera.lean]])
    alone = 0.75 * camera.pupil_mm**2 * (1 - lean * camera.off_focus)
    wider = alone + 48 * (station.part.roughness_rad * h) ** 2
    share = np.geomspace(1e-6, 1, 400)
    moves = 1 + (1 - lean) * share
    changed = share * np.abs(moves) / (moves**2 + wider / p**2 * share**2)
    return float(FAINT / (2 * h * changed.max()))


def faint_from(grooves: Grooves, station: Station) -> NDArray[np.float64]:
    """Return from which distance of each centre line on, in mm, a groove is faint.

    With u the distance in sigmas its curvature is at most u^2 exp(-u^2/2) d / sigma^2, u^2 > 2:
    that is c at v = u^2/2, v exp(-v) = c sigma^2 / (2 d), of its two roots the larger.

    Parameters
    ----------
    grooves : Grooves
    station : Station
        Its sampling and camera are used.
    """
    seen = averaged(grooves, station)
    share = faint_curvature(station) * seen.sigma**2 / (2 * np.abs(seen.depth))
    least = np.log(np.minimum(share, np.exp(-1)))
    v = 1 - least + np.sqrt(np.maximum(-2 - 2 * least, 0))  # above the root: Newton's method falls
    for _ in range(_NEWTON_STEPS):
        v = np.maximum(v - (v - np.log(v) + least) / np.maximum(1 - 1 / v, 1e-9), 1)
    reach: NDArray[np.float64] = seen.sigma * np.sqrt(2 * v)
    return reach


def widened(pixels: Ints, shape: tuple[int, int], by: int = 1) -> Ints:
    """Return pixels and all within so many of them, across as well, ascending, none twice.

    Parameters
    ----------
    pixels : ndarray of int64
        Flat indices, ascending, none twice.
    shape : tuple of int
        Rows and columns of the image.
    by : int
        Pixels; 1: the eight neighbours.
    """
    for _ in range(by):
        pixels = _with_neighbours(pixels, shape)
    return pixels


def _with_neighbours(pixels: Ints, shape: tuple[int, int]) -> Ints:
    (rows, columns), row = shape, pixels // shape[1]
    begin = np.flatnonzero((np.diff(pixels, prepend=-2) != 1) | (np.diff(row, prepend=-1) != 0))
    first, last = (
        pixels[begin],
        pixels[np.append(begin[1:], len(pixels)) - 1] if len(begin) else pixels,
    )
    row = first // columns
    first, last = (
        np.maximum(first - 1, row * columns),
        np.minimum(last + 1, (row + 1) * columns - 1),
    )
    runs = [
        (first[there] + step * columns, (last - first + 1)[there])
        for step in (-1, 0, 1)
        for there in [(row + step >= 0) & (row + step < rows)]
    ]
    return together(*(np.concatenate(part) for part in zip(*runs, strict=True)))
