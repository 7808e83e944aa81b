"""The reference of the score: which pixel belongs to which known defect."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gpuspec.part.grooves import Grooves
from gpuspec.part.maps import TopographyMap
from gpuspec.part.relief import Relief
from gpuspec.part.view import pixel_position, surface_points
from gpuspec.shown import array
from gpuspec.station.defects import Defect, Patch, Scratch
from gpuspec.station.station import Station

ZONE = 2.0  # sigmas: relief of at least 13.5 % of the depth
_PAIRS_AT_ONCE = 2_000_000
_PIECE_PX = 32


@dataclass(frozen=True)
class KnownDefect:
    """A defect the station file, its seed or its topography says is there.

    Attributes
    ----------
    kind : str
        dent, bump, scratch, measured: a zone of a measured patch, or pit: one of the part's own
        measured relief.
    x_mm, y_mm : float
        Centre in the part frame.
    size_mm : float
        Diameter or width of its zone.
    length_mm : float
        Length of a scratch's centre line, else 0.
    depth_um : float
        Depth, or height of a bump.
    """

    kind: str
    x_mm: float
    y_mm: float
    size_mm: float
    length_mm: float
    depth_um: float


@dataclass(frozen=True)
class Truth:
    """Zones as a label image, and whose they are.

    Attributes
    ----------
    labels : ndarray of int32, shape (M, N)
        0 flawless, i the i-th of `defects`.
    defects : tuple of KnownDefect
    """

    labels: NDArray[np.int32]
    defects: tuple[KnownDefect, ...]

    def __repr__(self) -> str:
        return f"Truth({len(self.defects)} defects; labels {array(self.labels)})"

    @classmethod
    def of(cls, station: Station, relief: Relief) -> Truth:
        """Work out every zone in float64, from parameters.

        A pixel belongs to a defect if the point of the surface behind its centre is within
        2 sigma of the defect's centre or centre line; to the relatively nearest where zones
        overlap. It is the same for every backend.

        Parameters
        ----------
        station : Station
        relief : Relief
            Of that station.

        Examples
        --------
        >>> from gpuspec.part.relief import Relief
        >>> from gpuspec.part.truth import Truth
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.2)
        >>> truth = Truth.of(station, Relief.of(station))
        >>> truth
        Truth(36 defects; labels (250, 1000) int32)
        """
        labels = np.zeros(station.shape, np.int32)
        nearest = np.ones(station.shape, np.float32)
        for pixel, share, owner in _covered(relief.grooves, station):
            better = share < nearest.flat[pixel]
            better |= (share == nearest.flat[pixel]) & (labels.flat[pixel] == 0)
            nearest.flat[pixel[better]] = share[better]
            labels.flat[pixel[better]] = owner[better] + 1
        known = [_known(defect) for defect in relief.defects]
        maps = list(relief.maps)
        if station.part.relief is not None:
            known += _mark_pits(maps.pop(0), "pit", station, labels, len(known) + 1, len(known) + 2)
        patches = (i for i, d in enumerate(relief.defects) if isinstance(d, Patch))
        for index, patch in zip(patches, maps, strict=True):
            # The patch keeps its number, for the first of its pits; the others come after all.
            pits = _mark_pits(patch, "measured", station, labels, index + 1, len(known) + 1)
            known[index] = pits[0] if pits else known[index]
            known += pits[1:]
        return cls(labels, tuple(known))


def _covered(
    grooves: Grooves, station: Station
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]]:
    """Yield pixels, squared distance over squared zone radius, and owner, some pieces at a time."""
    if not len(grooves):
        return
    rows, columns = station.shape
    ends, piece = _cut(grooves, station.camera.sampling_mm * _PIECE_PX)
    sigma, owner = grooves.sigma[piece], grooves.owner[piece]
    points = ends.reshape(-1, 2)
    if station.part.surface == "height":
        height = station.part.shape.height(points[:, 0], points[:, 1])
        points = points / (1 - height / station.camera.height_mm)[:, None]
    position = pixel_position(points, station).reshape(-1, 2, 2)
    reach = ZONE * sigma / station.camera.sampling_mm * _stretch(station) + 2
    low = np.floor(position.min(axis=1) - reach[:, None]).astype(np.int64)
    high = np.ceil(position.max(axis=1) + reach[:, None]).astype(np.int64)
    low = np.clip(low, 0, [columns, rows])
    spans = np.clip(np.minimum(high, [columns, rows]) - low, 0, None)
    counts = spans.prod(axis=1)
    batch = np.cumsum(counts) // _PAIRS_AT_ONCE
    for part in np.split(np.arange(len(counts)), np.flatnonzero(np.diff(batch)) + 1):
        count = counts[part]
        index = np.repeat(part, count)
        nth = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        column = low[index, 0] + nth % np.maximum(spans[index, 0], 1)
        row = low[index, 1] + nth // np.maximum(spans[index, 0], 1)
        x, y = surface_points(station, column, row)
        start, course = ends[index, 0], ends[index, 1] - ends[index, 0]
        away_x, away_y = x - start[:, 0], y - start[:, 1]
        square = np.maximum((course**2).sum(axis=1), 1e-300)
        share = np.clip((away_x * course[:, 0] + away_y * course[:, 1]) / square, 0, 1)
        distance = (away_x - share * course[:, 0]) ** 2 + (away_y - share * course[:, 1]) ** 2
        relative = distance / (ZONE * sigma[index]) ** 2
        inside = relative <= 1
        pixel = (row * columns + column)[inside]
        relative, owners = relative[inside].astype(np.float32), owner[index][inside]
        order = np.lexsort((owners, relative, pixel))
        first = order[np.diff(pixel[order], prepend=-1) > 0]
        yield pixel[first], relative[first], owners[first]


def _stretch(station: Station) -> float:
    """Return how much larger than on z = 0 a stretch of the part may look to the camera.

    With z/h the height and s the slope at the edge, at x/h off the axis: x = X (1 - z/h) gives
    dX/dx = (1 - z/h + s x/h) / (1 - z/h)^2.
    """
    if station.part.surface == "orientation":
        return 1.0
    part, h = station.part, station.camera.height_mm
    edge = part.length_mm / 2, part.width_mm / 2
    lean = sum(
        float(abs(s)) * side / h for s, side in zip(part.shape.slope(*edge), edge, strict=True)
    )
    nearer = 1 - part.height_range_mm[1] / h
    return (nearer + lean) / nearer**2


def _cut(grooves: Grooves, length: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Cut long pieces so that their boxes stay small; return ends (n, 2, 2) and piece (n,)."""
    course = grooves.ends[:, 2:] - grooves.ends[:, :2]
    parts = np.maximum(np.ceil(np.hypot(*course.T) / length), 1).astype(np.int64)
    piece = np.repeat(np.arange(len(grooves)), parts)
    nth = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    start = grooves.ends[piece, :2] + course[piece] * (nth / parts[piece])[:, None]
    end = grooves.ends[piece, :2] + course[piece] * ((nth + 1) / parts[piece])[:, None]
    return np.stack([start, end], axis=1), piece


def _known(defect: Defect) -> KnownDefect:
    if isinstance(defect, Scratch):
        points = np.array(defect.points_mm)
        length = float(np.hypot(*np.diff(points, axis=0).T).sum())
        x, y = ((points.min(axis=0) + points.max(axis=0)) / 2).tolist()
        return KnownDefect("scratch", x, y, defect.width_mm, length, defect.depth_um)
    if isinstance(defect, Patch):
        return KnownDefect("measured", defect.x_mm, defect.y_mm, 0.0, 0.0, 0.0)
    return KnownDefect(
        defect.kind, defect.x_mm, defect.y_mm, defect.diameter_mm, 0.0, defect.depth_um
    )


def _mark_pits(
    relief: TopographyMap,
    kind: str,
    station: Station,
    labels: NDArray[np.int32],
    first: int,
    second: int,
) -> list[KnownDefect]:
    """Mark a map's connected zones, each a defect, numbered first, second, second + 1, ...

    Returns
    -------
    list of KnownDefect
        In the order of their numbers.
    """
    if relief.zone is None:
        return []
    pits, count = ndimage.label(relief.zone, np.ones((3, 3)))
    if not count:
        return []
    index = np.arange(1, count + 1)
    depth = ndimage.maximum(np.abs(relief.relief_mm), pits, index) * 1e3
    area = np.bincount(pits.ravel(), minlength=count + 1)[1:] * np.prod(relief.pitch_mm)
    centres = np.array(ndimage.center_of_mass(relief.zone, pits, index))
    # A pixel belongs to a pit that its square touches: a pit smaller than a pixel counts, too.
    half = station.camera.sampling_mm / 2
    size = [2 * round(half / pitch) + 1 for pitch in reversed(relief.pitch_mm)]
    pits = np.where(pits > 0, pits, ndimage.maximum_filter(pits, size))
    window = _window(relief, station)
    row, column, on = relief.position(*surface_points(station, *_grid(window)))
    rows, columns = pits.shape
    i = np.clip(np.rint(column), 0, columns - 1).astype(np.int64)
    j = np.clip(np.rint(row), 0, rows - 1).astype(np.int64)
    number = np.array([0, first, *range(second, second + count - 1)], np.int32)
    found = number[np.where(on, pits[j, i], 0)]
    free = (found > 0) & (labels[window] == 0)
    labels[window][free] = found[free]
    return [
        KnownDefect(
            kind,
            float(relief.corner_mm[0] + column * relief.pitch_mm[0]),
            float(relief.corner_mm[1] + row * relief.pitch_mm[1]),
            float(2 * np.sqrt(a / np.pi)),
            0.0,
            float(d),
        )
        for (row, column), a, d in zip(centres, area, depth, strict=True)
    ]


def _window(relief: TopographyMap, station: Station) -> tuple[slice, slice]:
    """Rows and columns that may see a map (with room for a height surface's parallax)."""
    ny, nx = relief.heights_mm.shape
    corner, pitch = np.array(relief.corner_mm), np.array(relief.pitch_mm)
    ends = np.stack([corner, corner + pitch * (nx - 1, ny - 1)])
    room = 0.1 * np.abs(ends).max() if station.part.surface == "height" else 0.0
    ends += np.array([[-room], [room]])
    (left, bottom), (right, top) = pixel_position(ends, station)
    rows, columns = station.shape

    def inside(low: float, high: float, size: int) -> slice:
        return slice(
            int(np.clip(np.floor(low) - 1, 0, size)), int(np.clip(np.ceil(high) + 1, 0, size))
        )

    return inside(top, bottom, rows), inside(left, right, columns)


def _grid(window: tuple[slice, slice]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    rows, columns = window
    return (
        np.arange(columns.start, columns.stop)[None, :],
        np.arange(rows.start, rows.stop)[:, None],
    )
