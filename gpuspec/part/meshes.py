"""A part's mesh as a map of heights, and what is wrong with it."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import numpy as np

from gpuspec.errors import TopographyError
from gpuspec.part.maps import TopographyMap
from gpuspec.station.sections import MeshFile
from gpuspec.station.station import Station
from gpuspec.topographies.form import Mask, filled
from gpuspec.topographies.mesh import Mesh, read_mesh, sampled

POINTS_MAX = 20_000_000
BACKS_MAX = 0.001
"""Share of the points that may see the back of a face: the thinnest slivers turn by rounding."""
_MARGIN = 12  # points beyond the part's edge: there the spline's natural ends are forgotten
_MISSING_MAX = 0.5
_POINTS_MIN = 8
_OTHER_UNITS = {"metres": 1e3, "inches": 25.4, "millimetres, and unit is wrong": 1e-3}


def mesh_map(station: Station) -> TopographyMap | None:
    """Return the heights of the part's mesh over its rectangle; None: it has none.

    They are remembered until the file or what is asked of it changes.

    Parameters
    ----------
    station : Station

    Raises
    ------
    TopographyError
        If the mesh cannot be read, is of another size than the part, inside out, or has holes.
    """
    mesh = station.part.mesh
    if mesh is None:
        return None
    path = station.locate(mesh.file)
    state = path.stat() if path.is_file() else None
    changed = (state.st_mtime_ns, state.st_size) if state else None
    return _map(mesh, path, changed, station.file, station.part.length_mm, station.part.width_mm)


@lru_cache(maxsize=4)
def _map(
    given: MeshFile, path: Path, changed: object, file: str, length: float, width: float
) -> TopographyMap:
    says = f'{file}: part.mesh.file = "{given.file}"'
    counts = [_intervals(side / given.resolution_mm) for side in (length, width)]
    points = math.prod(n + 1 + 2 * _MARGIN for n in counts)
    if points > POINTS_MAX:
        raise TopographyError(
            f"{file}: part.mesh.resolution_mm = {given.resolution_mm:g} takes {points:,} points "
            f"over a part of {length:g} x {width:g} mm, over {POINTS_MAX:,}; give a larger one."
        )
    mesh = read_mesh(path, given.unit, given.smooth_deg, says)
    _check_size(mesh, length, width, given, says)
    low, high = mesh.box_mm
    middle = (low + high) / 2
    mesh = mesh.moved((-middle[0], -middle[1], -high[2]))
    pitch = length / counts[0], width / counts[1]
    x, y = (
        (np.arange(n + 1 + 2 * _MARGIN) - _MARGIN - n / 2) * p
        for n, p in zip(counts, pitch, strict=True)
    )
    seen = sampled(mesh, x.astype(np.float64), y.astype(np.float64))
    inner = slice(_MARGIN, -_MARGIN)
    _check_cover(seen.defined[inner, inner], x[inner], y[inner], says)
    if seen.backs > BACKS_MAX:
        how = "inside out" if seen.backs > 0.5 else "in part inside out"
        raise TopographyError(
            f"{says} is {how}: {100 * seen.backs:.3g} % of what is seen from above is the back of "
            f"its faces; turn their normals outward and export it again."
        )
    heights = filled(seen.heights_mm, seen.defined)
    heights = heights - heights[len(y) // 2, len(x) // 2]
    slope = max(float(np.abs(d).max()) for d in np.gradient(heights[inner, inner], *pitch[::-1]))
    said: tuple[str, ...] = ()
    if slope > 1:
        said = (
            f"part.mesh: parts of the mesh are steeper than 45 degrees, up to a slope of "
            f"{slope:.3g}; steps and walls are rounded over part.mesh.resolution_mm = "
            f"{given.resolution_mm:g}.",
        )
    return TopographyMap(
        heights, heights, pitch, (float(x[0]), float(y[0])), None, "part.mesh", said
    )


def _intervals(least: float) -> int:
    """Return an even number of intervals, so that a point lies in the middle."""
    return 2 * max(math.ceil(least / 2 - 1e-9), _POINTS_MIN // 2)


def _check_size(mesh: Mesh, length: float, width: float, given: MeshFile, says: str) -> None:
    """Refuse a mesh smaller than the part, or a thousand times larger: its unit is another."""
    low, high = mesh.box_mm
    size = (high - low)[:2]
    needed = np.array([length, width])
    told = (
        f'{says} is {size[0]:.4g} x {size[1]:.4g} mm large in unit = "{given.unit}" and the part '
        f"{length:g} x {width:g} mm"
    )
    if size.min() <= 0:
        raise TopographyError(f"{told}; it has no surface seen from above: z is up, x along.")
    smaller = (size < needed * (1 - 1e-6)).any()
    if not smaller and (size < 30 * needed).all():
        return
    for name, factor in _OTHER_UNITS.items():
        if (size * factor >= needed * (1 - 1e-3)).all() and (size * factor < 3 * needed).all():
            raise TopographyError(f"{told}; it seems to be in {name}: check part.mesh.unit.")
    if not smaller:
        return
    if (size[::-1] >= needed * (1 - 1e-6)).all():
        raise TopographyError(
            f"{told}; turned by 90 degrees it would fit: exchange part.length_mm and "
            f"part.width_mm, or turn the mesh."
        )
    raise TopographyError(
        f"{told}; it must reach as far as the part: give a smaller part.length_mm and "
        f"part.width_mm, or check part.mesh.unit."
    )


def _check_cover(defined: Mask, x: np.ndarray, y: np.ndarray, says: str) -> None:
    """Refuse a mesh of which nothing is seen at points of the part."""
    missing = ~defined
    share = float(missing.mean())
    if not share:
        return
    if share > _MISSING_MAX:
        raise TopographyError(
            f"{says} has nothing at {100 * share:.3g} % of the points of the part, seen from "
            f"above; check that z is up, and part.length_mm and part.width_mm."
        )
    from scipy import ndimage  # slow to import

    holes, count = ndimage.label(missing)
    border = np.unique(np.concatenate([holes[0], holes[-1], holes[:, 0], holes[:, -1]]))
    inside = np.setdiff1d(np.arange(1, count + 1), border)
    if not len(inside):
        raise TopographyError(
            f"{says} does not reach to the part's edge at {100 * share:.3g} % of its points; the "
            f"part is a rectangle: give a smaller part.length_mm or part.width_mm."
        )
    sizes = np.bincount(holes.ravel(), minlength=count + 1)
    largest = inside[sizes[inside].argmax()]
    ys, xs = ndimage.find_objects(holes)[largest - 1]
    many = "a hole" if len(inside) == 1 else f"{len(inside)} holes; the largest"
    reach = (xs.stop - xs.start) * (x[1] - x[0]), (ys.stop - ys.start) * (y[1] - y[0])
    raise TopographyError(
        f"{says} has {many} of some {reach[0]:.3g} x {reach[1]:.3g} mm at x = "
        f"{(x[xs.start] + x[xs.stop - 1]) / 2:.4g}, y = {(y[ys.start] + y[ys.stop - 1]) / 2:.4g} "
        f"mm; close it, or give a part that does not reach it."
    )
