"""The reference of the score: which pixel belongs to which known defect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.part.grooves import Grooves
from gpuspec.part.maps import TopographyMap
from gpuspec.part.relief import Relief
from gpuspec.part.spans import pixels_of, runs_around
from gpuspec.part.view import pixel_position, seen_at, surface_points
from gpuspec.shown import array
from gpuspec.station.defects import Defect, Patch, Scratch
from gpuspec.station.station import Station

ZONE = 2.0  # sigmas: relief of at least 13.5 % of the depth
_PAIRS_AT_ONCE = 2_000_000


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
        pixel, owner = _covered(relief.grooves, station)
        labels.flat[pixel] = owner + 1
        known = [_known(defect) for defect in relief.defects]
        maps = {m.name: m for m in relief.maps}
        if "part.relief" in maps:
            own = maps["part.relief"]
            known += _mark_pits(own, "pit", station, labels, len(known) + 1, len(known) + 2)
        for index, defect in enumerate(relief.defects):
            if not isinstance(defect, Patch):
                continue
            patch = maps[f"defects[{index + 1}]"]
            # The patch keeps its number, for the first of its pits; the others come after all.
            pits = _mark_pits(patch, "measured", station, labels, index + 1, len(known) + 1)
            known[index] = pits[0] if pits else known[index]
            known += pits[1:]
        return cls(labels, tuple(known))


def _covered(grooves: Grooves, station: Station) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pixels of all zones, ascending, and whose they are."""
    piece, first, count = runs_around(grooves, station, ZONE * grooves.sigma)
    found = [
        _nearest(grooves, station, piece[part], first[part], count[part])
        for part in np.split(
            np.arange(len(piece)),
            np.flatnonzero(np.diff(np.cumsum(count) // _PAIRS_AT_ONCE)) + 1,
        )
    ]
    pixel, relative, owner = (np.concatenate(values) for values in zip(*found, strict=True))
    order = np.lexsort((owner, relative, pixel))
    best = order[np.diff(pixel[order], prepend=-1) > 0]
    return pixel[best], owner[best]


def _nearest(
    grooves: Grooves,
    station: Station,
    piece: NDArray[np.int64],
    first: NDArray[np.int64],
    count: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """Return pixels of runs that are in zones, squared distance over squared radius, and owner."""
    index, pixel = np.repeat(piece, count), pixels_of(first, count)
    row, column = np.divmod(pixel, station.shape[1])
    x, y = surface_points(station, column, row)
    start, course = grooves.ends[index, :2], grooves.ends[index, 2:] - grooves.ends[index, :2]
    away_x, away_y = x - start[:, 0], y - start[:, 1]
    square = np.maximum((course**2).sum(axis=1), 1e-300)
    share = np.clip((away_x * course[:, 0] + away_y * course[:, 1]) / square, 0, 1)
    distance = (away_x - share * course[:, 0]) ** 2 + (away_y - share * course[:, 1]) ** 2
    relative = distance / (ZONE * grooves.sigma[index]) ** 2
    inside = relative <= 1
    return pixel[inside], relative[inside].astype(np.float32), grooves.owner[index[inside]]


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
    from scipy import ndimage  # slow to import

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
    seen = window(relief, station)
    row, column, on = relief.position(*surface_points(station, *_grid(seen)))
    rows, columns = pits.shape
    i = np.clip(np.rint(column), 0, columns - 1).astype(np.int64)
    j = np.clip(np.rint(row), 0, rows - 1).astype(np.int64)
    number = np.array([0, first, *range(second, second + count - 1)], np.int32)
    found = number[np.where(on, pits[j, i], 0)]
    free = (found > 0) & (labels[seen] == 0)
    labels[seen][free] = found[free]
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


def window(relief: TopographyMap, station: Station) -> tuple[slice, slice]:
    """Return rows and columns that may see a map, with room for a height surface's parallax.

    Parameters
    ----------
    relief : TopographyMap
    station : Station
    """
    ny, nx = relief.heights_mm.shape
    corner, pitch = np.array(relief.corner_mm), np.array(relief.pitch_mm)
    ends = np.stack([corner, corner + pitch * (nx - 1, ny - 1)])
    room = 0.1 * np.abs(ends).max() if station.part.surface == "height" else 0.0
    ends += np.array([[-room], [room]])
    (left, bottom), (right, top) = pixel_position(ends, station)
    if station.posed:
        corners = seen_at(np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 2), station)
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
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
