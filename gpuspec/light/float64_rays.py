"""The sub-rays of pixels in float64: of squares, or of slices along a groove that crosses each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.float64 import Array, Part, Paths, Sides, follow
from gpuspec.part.crossings import courses
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

_NOTHING = 1e-6  # of a pixel: what is thinner has no slice
_NODE = 0.5 / np.sqrt(3)  # of Gauss and Legendre, from the middle of an interval of length 1


def _centres(
    station: Station, column: NDArray[Any], row: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return where on z = 0 the centres of pixels are, mm; y points up."""
    (rows, columns), p = station.shape, station.camera.sampling_mm
    return (column + 0.5 - columns / 2) * p, (rows / 2 - row - 0.5) * p


def sub_rays(
    part: Part, station: Station, relief: Relief, column: NDArray[Any], row: NDArray[Any]
) -> Iterator[Paths]:
    """Yield each sub-ray of pixels: of squares row by row within the pixel, or of slices.

    Parameters
    ----------
    part : Part
    station : Station
        Its camera says how pixels are cut.
    relief : Relief
        Of that station.
    column, row : ndarray
        Of the pixels, of shapes that broadcast; of slices of one.
    """
    if station.camera.sliced:
        along = courses(station, relief, row.ravel(), column.ravel()).reshape(2, *row.shape)
        return _sliced(part, station, column, row, along)
    return _squared(part, station, column, row)


def _squared(
    part: Part, station: Station, column: NDArray[Any], row: NDArray[Any]
) -> Iterator[Paths]:
    n, p = station.camera.side, station.camera.sampling_mm
    x, y = _centres(station, column, row)
    first, third = station.camera.spread
    for i in range(n * n):
        east, north = (i % n + 0.5) / n - 0.5, 0.5 - (i // n + 0.5) / n
        # Of a pixel that looks at a spot wider than itself they are spread over that.
        apart = (
            p * (east + first * east + third * east**3),
            p * (north + first * north + third * north**3),
        )
        yield follow(part, station, x + apart[0], y + apart[1], apart)


def _sliced(
    part: Part, station: Station, column: NDArray[Any], row: NDArray[Any], along: Array
) -> Iterator[Paths]:
    p = station.camera.sampling_mm
    x, y = _centres(station, column, row)
    for dx, dy, sides, share in slices((-along[1], along[0]), station.camera.side):
        across, down = ((p * side[0], p * side[1]) for side in sides)
        paths = follow(part, station, x + p * dx, y + p * dy, sides=(across, down))
        yield replace(paths, irradiance=paths.irradiance * share)


def slices(
    across: tuple[Array, Array], count: int
) -> Iterator[tuple[Array, Array, tuple[Sides, Sides], Array]]:
    """Yield the slices of unit squares, from one corner to the one opposite.

    Chords are integrated between where they begin to grow or to shrink: a slice is that far exact
    in its area, its middle and its variance, which a parallelogram of two sides has.

    Parameters
    ----------
    across : tuple of two ndarray
        Unit vectors, along which slices follow one another.
    count : int
        Even.

    Yields
    ------
    x, y : ndarray
        The middle.
    sides : tuple of two (x, y)
    share : ndarray
        Area over that of one slice if all were as large.
    """
    nx, ny = np.asarray(across[0], float), np.asarray(across[1], float)
    thin, wide = np.sort(np.abs([nx, ny]), axis=0)
    few = np.rint(count * thin / (thin + wide))
    few = np.clip(few, thin > _NOTHING, count // 2 - (wide - thin > _NOTHING))
    for i in range(count):
        place = min(i, count - 1 - i)
        behind = [  # the corner, the slice's two faces
            np.where(
                nth <= few,
                thin * nth / np.maximum(few, 1),
                thin + (wide - thin) / 2 * (nth - few) / np.maximum(count / 2 - few, 1),
            )
            for nth in (place, place + 1)
        ]
        sign = -1 if 2 * i < count else 1
        middle, step = (behind[0] + behind[1]) / 2, behind[1] - behind[0]
        ends = [_chord(sign * nx, sign * ny, middle + node * step) for node in (-_NODE, _NODE)]
        weights = np.array([length for _, length in ends])
        total = np.maximum(weights.sum(axis=0), 1e-300)
        share = weights / total
        (a, _), (b, _) = ends
        x, y = share[0] * a + share[1] * b
        spread = np.sqrt(12 * share[0] * share[1])
        length = np.sqrt((weights**3).sum(axis=0) / total)
        sides = (spread * (b[0] - a[0]), spread * (b[1] - a[1])), (-length * ny, length * nx)
        yield x, y, sides, count * step * weights.mean(axis=0)


def _chord(nx: Array, ny: Array, depth: Array) -> tuple[Array, Array]:
    """Return middle and length of a unit square's chord across n, behind its furthest corner."""
    signs = np.where(np.array([nx, ny]) < 0, -1.0, 1.0)
    size = np.maximum(np.abs([nx, ny]), 1e-300)
    # From that corner along its two sides, or on those that go on from their ends.
    legs = depth / size
    over = np.maximum(depth - size, 0) / size[::-1]
    first = np.array([np.minimum(legs[0], 1), over[0]])
    second = np.array([over[1], np.minimum(legs[1], 1)])
    return signs * (0.5 - (first + second) / 2), np.hypot(*(first - second))
