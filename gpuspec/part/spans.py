"""Pixels near centre lines, row by row: found from the lines, no other is ever looked at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.part.grooves import Grooves
from gpuspec.part.view import magnified, pixel_position, seen_at
from gpuspec.station.station import Station

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_PIECE_PX = 32


def runs_around(grooves: Grooves, station: Station, reach_mm: Floats) -> tuple[Ints, Ints, Ints]:
    """Return runs of pixels of a row that hold all those whose point is near a centre line.

    On a flat part, and where heights do not count, they hold no other but a pixel at each end.

    Parameters
    ----------
    grooves : Grooves
        S pieces.
    station : Station
        Its image shape, sampling and the part's shape are used.
    reach_mm : ndarray of float64, shape (S,)
        How far from each piece is near.

    Returns
    -------
    piece : ndarray of int64, shape (n,)
        Ascending.
    first : ndarray of int64, shape (n,)
        Flat index of the run's first pixel.
    count : ndarray of int64, shape (n,)
        Its pixels, at least one.
    """
    rows, columns = station.shape
    piece, ends, reach = _seen(grooves, station, reach_mm)
    low = np.clip(np.floor(ends[:, :, 1].min(axis=1) - reach), 0, rows).astype(np.int64)
    high = np.clip(np.ceil(ends[:, :, 1].max(axis=1) + reach), 0, rows).astype(np.int64)
    counts = high - low
    part = np.repeat(np.arange(len(low)), counts)
    row = low[part] + np.arange(len(part)) - np.repeat(np.cumsum(counts) - counts, counts)
    left, right = _run(ends[part], reach[part], row + 0.5)
    first = np.clip(np.floor(left - 0.5), 0, columns).astype(np.int64)
    last = np.clip(np.ceil(right + 0.5), 0, columns).astype(np.int64)
    there = last > first
    return piece[part[there]], (row * columns + first)[there], (last - first)[there]


def _seen(grooves: Grooves, station: Station, reach_mm: Floats) -> tuple[Ints, Floats, Floats]:
    """Return pieces as the camera sees them: whose, their ends (n, 2, 2) and reach in pixels."""
    ends = grooves.ends.reshape(-1, 2, 2)
    piece, reach = np.arange(len(grooves)), reach_mm / station.camera.sampling_mm
    if station.part.surface == "height" or station.posed:
        # What is straight on the part is not to the camera: less so in short pieces.
        course = ends[:, 1] - ends[:, 0]
        length = station.camera.sampling_mm * _PIECE_PX
        parts = np.maximum(np.ceil(np.hypot(*course.T) / length), 1).astype(np.int64)
        piece = np.repeat(piece, parts)
        nth = np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)
        share = np.stack([nth, nth + 1], axis=1) / parts[piece][:, None]
        ends = ends[piece, 0][:, None] + course[piece][:, None] * share[:, :, None]
        reach = reach[piece] * stretch(station) + 1
        position = seen_at(ends, station)
        there = np.isfinite(position).all(axis=(1, 2))
        return piece[there], position[there], reach[there]
    position = pixel_position(ends.reshape(-1, 2), station).reshape(-1, 2, 2)
    return piece, position, reach


def _run(ends: Floats, reach: Floats, row: Floats) -> tuple[Floats, Floats]:
    """Return between which columns a row is within reach of a piece; left > right: nowhere.

    Points of the piece at a share s reach the row from x(s) - c(s) to x(s) + c(s), c the half chord
    of the circle about them: the least of a convex and the greatest of a concave function, which is
    where the circle's normal is the piece's, or at the nearest s that reaches the row at all.
    """
    (x, y), (along, down) = ends[:, 0].T, (ends[:, 1] - ends[:, 0]).T
    length = np.maximum(np.hypot(along, down), 1e-300)
    level = np.abs(down) < 1e-9
    by = np.where(level, 1.0, down)
    one, other = (row - reach - y) / by, (row + reach - y) / by
    low = np.where(level, 0.0, np.clip(np.minimum(one, other), 0, 1))
    high = np.where(level, 1.0, np.clip(np.maximum(one, other), 0, 1))
    tangent = reach * np.sign(by) * along / length
    found = []
    for side in (-1, 1):
        share = np.where(level, side * along > 0, (row - y + side * tangent) / by)
        share = np.clip(share, low, high)
        off = row - y - share * down
        half = np.sqrt(np.maximum(reach**2 - off**2, 0))
        edge = x + share * along + side * half
        # A share at which the row is not reached at all, but for rounding.
        found.append(np.where(np.abs(off) > reach + 1e-6, -side * np.inf, edge))
    return found[0], found[1]


def pixels_of(first: Ints, count: Ints) -> Ints:
    """Return the flat indices of all pixels of runs, in their order, as often as they come.

    Parameters
    ----------
    first : ndarray of int64, shape (n,)
        Flat index of each run's first pixel.
    count : ndarray of int64, shape (n,)
        Its pixels.
    """
    return np.repeat(first - (np.cumsum(count) - count), count) + np.arange(count.sum())


def together(first: Ints, count: Ints) -> Ints:
    """Return the flat indices of all pixels of runs once, ascending.

    Parameters
    ----------
    first : ndarray of int64, shape (n,)
        Flat index of each run's first pixel.
    count : ndarray of int64, shape (n,)
        Its pixels.
    """
    order = np.argsort(first, kind="stable")
    first, last = first[order], (first + count)[order]
    # A run begins where no earlier one, of all before, has come to.
    before = np.maximum.accumulate(last)
    new = np.ones(len(first), np.bool_)
    new[1:] = first[1:] > before[:-1]
    begin = np.flatnonzero(new)
    ends = before[np.append(begin[1:], len(first)) - 1] if len(first) else before
    return pixels_of(first[begin], ends - first[begin])


def stretch(station: Station) -> float:
    """Return how much larger than on z = 0 a stretch of the part may look to the camera.

    With z/h the height and s the slope at the edge, at x/h off the axis: x = X (1 - z/h) gives
    dX/dx = (1 - z/h + s x/h) / (1 - z/h)^2.
    """
    if station.posed:
        return magnified(station)
    if station.part.surface == "orientation":
        return 1.0
    part, h = station.part, station.camera.height_mm
    edge = part.length_mm / 2, part.width_mm / 2
    lean = sum(
        float(abs(s)) * side / h for s, side in zip(part.shape.slope(*edge), edge, strict=True)
    )
    nearer = 1 - part.height_range_mm[1] / h
    return (nearer + lean) / nearer**2
