"""Measured topographies: read with their units, filled, form removed, ready for the device.

x points to the right and y up, as an instrument shows its map: the top line of the picture has the
greatest y. Between the points, and half a pitch beyond the outermost, the relief is the
interpolating cubic spline with natural ends: its slope is smooth and a tilt stays a tilt up to
the edge (a mirrored end would flatten it).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import TopographyError
from gpuspec.part.map_checks import (
    Laid,
    check_pitch,
    check_relief,
    remarks,
    steepness,
    without_outliers,
)
from gpuspec.station.defects import Patch, Topography
from gpuspec.station.sections import OwnRelief
from gpuspec.station.station import Station
from gpuspec.topographies.file import POINTS_MAX, brief, read_topography, silence
from gpuspec.topographies.form import Heights, Mask, filled, form
from gpuspec.units import MICRO

_REMEMBERED = 2**22  # points of a map whose averages are kept: of five cuts, 160 MB
_VARIANCE_MIN = 1e-9  # points^2; below, smoothing changes nothing
_VARIANCE_WIDE = 1e6  # points^2; above, the Gaussian on the grid is the true one (and ive fails)


@dataclass(frozen=True, eq=False)
class TopographyMap:
    """A map of relief on a regular grid, laid on the part.

    Attributes
    ----------
    heights_mm : ndarray of float64, shape (ny, nx)
        Relief itself or, of what :func:`averaged` returns, as a sub-ray averages it. Row 0 has the
        least y, column 0 the least x.
    relief_mm : ndarray of float64, shape (ny, nx)
        Relief itself: filled, form removed, smoothed, faded out; the depth of a pit is read here.
    pitch_mm : tuple of float
        Distance of two points along x and y.
    corner_mm : tuple of float
        x and y of point (0, 0) in the part's frame.
    zone : ndarray of bool, shape (ny, nx), or None
        Points of the map's known defects; None: none is known.
    name : str
        The key it comes from: ``part.relief``, ``defects[3]``.
    remarks : tuple of str
        What was done to the map that its owner should know: filled, left out, cropped; a sentence
        each.
    average : callable, optional
        Returns the relief under a Gaussian of a variance in mm^2; None: as it is under any.
    """

    heights_mm: Heights
    relief_mm: Heights
    pitch_mm: tuple[float, float]
    corner_mm: tuple[float, float]
    zone: Mask | None
    name: str
    remarks: tuple[str, ...] = ()
    average: Callable[[float], Heights] | None = None
    _known: dict[float, TopographyMap] = field(default_factory=dict, init=False, repr=False)

    def __getstate__(self) -> dict[str, object]:
        """Leave behind what can be worked out again."""
        return {**self.__dict__, "_known": {}}

    def __repr__(self) -> str:
        ny, nx = self.heights_mm.shape
        px, py = self.pitch_mm
        return f"TopographyMap({self.name}: {ny} x {nx} heights in mm, pitch {px:g} x {py:g} mm)"

    @cached_property
    def spline(self) -> Any:
        """The interpolant as a function of (row, column), in float64."""
        from scipy.interpolate import NdBSpline, make_interp_spline  # slow to import

        along_y = make_interp_spline(
            np.arange(self.heights_mm.shape[0]), self.heights_mm, bc_type="natural"
        )
        along_x = make_interp_spline(
            np.arange(self.heights_mm.shape[1]), along_y.c.T, bc_type="natural"
        )
        return NdBSpline((along_y.t, along_x.t), np.ascontiguousarray(along_x.c.T), 3)

    @cached_property
    def steepest(self) -> float:
        """At least its steepest slope, from point to point."""
        across, along = (
            np.abs(np.diff(self.relief_mm, axis=axis)).max(initial=0) for axis in (0, 1)
        )
        return float(math.hypot(along / self.pitch_mm[0], across / self.pitch_mm[1]))

    def position(self, x_mm: Heights, y_mm: Heights) -> tuple[Heights, Heights, Mask]:
        """Return row and column in points, and where these are on the map.

        Parameters
        ----------
        x_mm, y_mm : ndarray
            Points of the part, of one shape.

        Returns
        -------
        row, column : ndarray of float64
        on : ndarray of bool
            Whether they are on the map, all of the shape of `x_mm`.
        """
        column = (np.asarray(x_mm, np.float64) - self.corner_mm[0]) / self.pitch_mm[0]
        row = (np.asarray(y_mm, np.float64) - self.corner_mm[1]) / self.pitch_mm[1]
        ny, nx = self.heights_mm.shape
        on = (np.abs(column - (nx - 1) / 2) <= nx / 2) & (np.abs(row - (ny - 1) / 2) <= ny / 2)
        return row, column, on


def read_maps(station: Station) -> tuple[TopographyMap, ...]:
    """Read the part's relief and the measured patches.

    Parameters
    ----------
    station : Station
        Only files named in it are read.

    Returns
    -------
    tuple of TopographyMap
        The part's relief first, then the measured defects in their order.

    Raises
    ------
    TopographyError
        If a file is absent, is no areal topography with a length unit, or holds nothing that can
        be a specular surface; or if the part is larger than its map, which is neither blended into
        the part nor repeated.
    """
    maps: list[TopographyMap] = []
    if station.part.relief:
        own = station.part.relief
        maps.append(_laid(station, own, "part.relief", (own.x_mm, own.y_mm), 0.0, 0))
    for number, defect in enumerate(station.defects, 1):
        if isinstance(defect, Patch):
            centre, key = (defect.x_mm, defect.y_mm), f"defects[{number}]"
            points = sum(m.heights_mm.size for m in maps)
            maps.append(_laid(station, defect, key, centre, defect.taper, points))
    return tuple(maps)


def averaged(maps: tuple[TopographyMap, ...], station: Station) -> tuple[TopographyMap, ...]:
    """Return maps as a sub-ray averages them: over its share of all that a pixel looks at.

    The same as of grooves, see :func:`gpuspec.part.grooves.averaged`: however a pixel is cut, its
    sub-rays have the relief of their own size.

    Parameters
    ----------
    maps : tuple of TopographyMap
    station : Station
        Its sampling, spot and subsampling are used.
    """
    return tuple(_averaged(m, station.camera.sub_ray_variance) for m in maps)


def _averaged(m: TopographyMap, variance: float) -> TopographyMap:
    """Return a map as a Gaussian of a variance leaves it; small ones are remembered."""
    if m.average is None:
        return m
    if variance in m._known:
        return m._known[variance]
    found = replace(m, heights_mm=m.average(variance))
    if m.heights_mm.size <= _REMEMBERED:
        m._known[variance] = found
    return found


def relief_at(
    maps: tuple[TopographyMap, ...], x_mm: Heights, y_mm: Heights
) -> tuple[Heights, Heights, Heights, Heights, Heights, Heights]:
    """Return the maps' relief and its derivatives in float64, zero outside the maps.

    The same spline as the device's, solved for and evaluated by other means.

    Parameters
    ----------
    maps : tuple of TopographyMap
        Laid on the part.
    x_mm, y_mm : ndarray
        Points of the part, of one shape.

    Returns
    -------
    z, zx, zy, zxx, zxy, zyy : ndarray of float64
        Height in mm, slopes, and curvatures in 1/mm, of the shape of `x_mm`.
    """
    sums = np.zeros((6, *np.shape(x_mm)))
    for m in maps:
        row, column, on = m.position(x_mm, y_mm)
        points = np.stack([row[on], column[on]], axis=-1)
        for total, (ky, kx) in zip(
            sums, ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0)), strict=True
        ):
            scale = m.pitch_mm[0] ** -kx * m.pitch_mm[1] ** -ky
            total[on] += m.spline(points, nu=(ky, kx)) * scale
    return tuple(sums)


def zone_at(m: TopographyMap, x_mm: Heights, y_mm: Heights, reach_mm: float = 0.0) -> Mask:
    """Return whether the map's nearest point is in a zone; False outside the map.

    Parameters
    ----------
    m : TopographyMap
        Laid on the part.
    x_mm, y_mm : ndarray
        Points of the part, of one shape.
    reach_mm : float
        Zones within a square of this half side count too: half a pixel finds the pits that lie
        between the centres of pixels coarser than the map.

    Returns
    -------
    ndarray of bool, of the shape of `x_mm`
    """
    from scipy import ndimage  # slow to import

    row, column, on = m.position(x_mm, y_mm)
    inside = np.zeros(on.shape, bool)
    if m.zone is not None:
        size = [2 * round(reach_mm / pitch) + 1 for pitch in reversed(m.pitch_mm)]
        zone = ndimage.maximum_filter(m.zone, size, mode="constant")
        nearest = (
            np.clip(np.rint(index[on]).astype(np.int64), 0, points - 1)
            for index, points in zip((row, column), zone.shape, strict=True)
        )
        inside[on] = zone[tuple(nearest)]
    return inside


def _laid(
    station: Station,
    topography: Topography,
    key: str,
    centre: tuple[float, float],
    taper: float,
    points: int,
) -> TopographyMap:
    """Read a topography and lay it on the part; `points` are already read."""
    says = f'{station.file}: {key}.file = "{topography.file}"'
    path = station.locate(topography.file)
    measured = read_topography(topography, path, station.file, key, points)
    heights, pitch = measured.heights_mm, measured.pitch_mm
    ny, nx = heights.shape
    corner = centre[0] - (nx - 1) / 2 * pitch[0], centre[1] - (ny - 1) / 2 * pitch[1]
    laid = Laid(measured, key, says, corner)
    check_pitch(station, laid)
    sigma = topography.smoothing_um * MICRO
    if sigma > min(measured.size_mm) / 4:
        raise TopographyError(
            f"{says} with smoothing_um = {topography.smoothing_um:g}: nothing is left of a map of "
            f"{nx * pitch[0]:g} x {ny * pitch[1]:g} mm; smooth by less than a quarter of its side."
        )
    defined = measured.defined
    said: list[str] = []
    if topography.outlier_um is not None:
        defined, said = without_outliers(laid, topography.outlier_um)
    said += remarks(station, laid)
    rough = filled(heights, defined) - form(heights, defined, topography.form_removed)
    said += steepness(rough, defined, laid)
    tapers = (taper, taper)
    if isinstance(topography, OwnRelief):
        rough, defined, corner = _covering(station, topography, laid, rough, defined)
        laid = replace(laid, corner=corner)
        tapers = _blending(station, topography, laid, rough.shape)
    ny, nx = rough.shape
    window = np.outer(_fading(ny, tapers[1]), _fading(nx, tapers[0]))
    smooth = _smoothed(rough, sigma**2, pitch)
    relief = smooth * window
    check_relief(relief, laid)
    zone = _zone(station, topography, key, relief, heights.shape)
    return TopographyMap(
        relief,
        relief,
        pitch,
        laid.corner,
        None if zone is None else zone & defined,
        key,
        tuple(said),
        partial(_smoothed_more, smooth, window, pitch),
    )


def _smoothed_more(
    smooth: Heights, window: Heights, pitch: tuple[float, float], variance: float
) -> Heights:
    return _smoothed(smooth, variance, pitch) * window


def _fading(points: int, taper: float) -> Heights:
    """Return 1, falling to 0 at both ends as a raised cosine over `taper` of the points."""
    if taper == 0:
        return np.ones(points)
    end = np.minimum(np.arange(points), np.arange(points)[::-1]) / (taper * (points - 1))
    fading: Heights = (1 - np.cos(np.pi * np.minimum(end, 1))) / 2
    return fading


def _covering(
    station: Station, own: OwnRelief, laid: Laid, rough: Heights, defined: Mask
) -> tuple[Heights, Mask, tuple[float, float]]:
    """Return a map of the part, its points that were measured, and its corner: whole or repeated.

    Raises
    ------
    TopographyError
        If it is smaller than the part and neither blended nor repeated; or if, repeated, it has too
        many points.
    """
    pitch, corner = laid.measured.pitch_mm, laid.corner
    part = station.part.length_mm, station.part.width_mm
    size = laid.measured.size_mm
    # How far the part reaches beyond the map, at its low and at its high end, along x and along y.
    beyond = [
        (start - p / 2 + side / 2, side / 2 - (start - p / 2 + s))
        for start, p, s, side in zip(corner, pitch, size, part, strict=True)
    ]
    # A tenth of a pitch is left for rounding.
    if all(max(ends) <= 0.1 * p for ends, p in zip(beyond, pitch, strict=True)):
        return rough, defined, corner
    if own.repeat:
        more = [
            tuple(max(math.ceil(end / p), 0) for end in ends)
            for ends, p in zip(beyond, pitch, strict=True)
        ]
        points = math.prod(n + sum(m) for n, m in zip(rough.shape, reversed(more), strict=True))
        if points > POINTS_MAX:
            raise TopographyError(
                f"{laid.says}, repeated over the part, has {points:,} points, more than "
                f"{POINTS_MAX:,}; make the part smaller or the map coarser."
            )
        around = (more[1], more[0])
        corner = corner[0] - more[0][0] * pitch[0], corner[1] - more[1][0] * pitch[1]
        return np.pad(rough, around, "symmetric"), np.pad(defined, around, "symmetric"), corner
    if own.blend_mm:
        if any(-end >= s for ends, s in zip(beyond, size, strict=True) for end in ends):
            raise TopographyError(
                f"{laid.says} lies wholly beside the part of {part[0]:g} x {part[1]:g} mm; check "
                f"part.relief.x_mm = {own.x_mm:g} and part.relief.y_mm = {own.y_mm:g}."
            )
        return rough, defined, corner
    over = " and ".join(
        f"{sum(max(end, 0) for end in ends):.4g} mm along {axis}"
        for ends, axis in zip(beyond, ("x", "y"), strict=True)
        if max(ends) > 0
    )
    fit = [np.floor(s * 1e4) / 1e4 for s in size]
    raise TopographyError(
        f"{laid.says} is smaller than the part by {over}; leave part.length_mm and part.width_mm "
        f"out, and the part takes the map's size, or give it as part.length_mm = {fit[0]:g}, "
        f"part.width_mm = {fit[1]:g}; part.relief.blend_mm would fade it into the larger part, and "
        f"part.relief.repeat = true lay it again and again."
    )


def _blending(
    station: Station, own: OwnRelief, laid: Laid, points: tuple[int, ...]
) -> tuple[float, float]:
    """Return the shares of a map's sides, along x and y, over which it fades into the part.

    Raises
    ------
    TopographyError
        If nothing is left of it.
    """
    size = [n * p for n, p in zip(points[::-1], laid.measured.pitch_mm, strict=True)]
    if own.repeat or not own.blend_mm:
        return 0.0, 0.0
    if 2 * own.blend_mm > min(size):
        raise TopographyError(
            f"{laid.says} is {size[0]:.4g} x {size[1]:.4g} mm large: part.relief.blend_mm = "
            f"{own.blend_mm:g} leaves nothing of it; blend over less than half of its side."
        )
    return own.blend_mm / size[0], own.blend_mm / size[1]


def _smoothed(heights: Heights, variance: float, pitch: tuple[float, float]) -> Heights:
    """Gaussian low-pass of a variance in mm^2 along x and y.

    On the grid the Gaussian is exp(-t) I_n(t), whose variance is t even far below one point, where
    a sampled Gaussian has next to none: T. Lindeberg, IEEE PAMI 12(3), 1990. A straight line is
    fitted under it, which changes nothing but at the edge, where a tilt stays a tilt.
    """
    from scipy import ndimage  # slow to import
    from scipy.special import ive

    for axis in (0, 1):
        t = variance / pitch[1 - axis] ** 2
        if t < _VARIANCE_MIN:
            continue
        reach = min(int(np.ceil(6 * np.sqrt(t))) + 2, heights.shape[axis] - 1)
        away = np.arange(-reach, reach + 1.0)
        gaussian = ive(away, t) if t < _VARIANCE_WIDE else np.exp(-(away**2) / 2 / t)
        kernels = [gaussian * away**power for power in range(3)]
        inside = np.ones((heights.shape[0], 1) if axis == 0 else (1, heights.shape[1]))
        s0, s1, s2 = (ndimage.correlate1d(inside, k, axis, mode="constant") for k in kernels)
        m0, m1 = (ndimage.correlate1d(heights, k, axis, mode="constant") for k in kernels[:2])
        heights = (s2 * m0 - s1 * m1) / (s0 * s2 - s1**2)
    return heights


def _zone(
    station: Station,
    topography: Topography,
    key: str,
    relief: Heights,
    points: tuple[int, ...],
) -> Mask | None:
    """Zones from the picture of `points`, or from the height of the relief."""
    file, height = topography.zone_file, topography.zone_height_um
    says = f'{station.file}: {key}.zone_file = "{file}"'
    if file is None:
        return None if height is None else np.abs(relief) > height * MICRO
    if height is not None:
        raise TopographyError(f"{says} stands beside zone_height_um; give one of the two.")
    path = station.locate(file)
    if not path.is_file():
        raise TopographyError(f"{says} is not there; looked for {path}.")
    with silence():
        try:
            picture = _picture(path)
        except Exception as error:
            raise TopographyError(
                f"{says} is not an image that can be read ({brief(error)}); save it as .png or "
                f".tif."
            ) from None
    if picture.shape != points:
        raise TopographyError(
            f"{says} has {' x '.join(map(str, picture.shape))} pixels (rows x columns) and the map "
            f"{points[0]} x {points[1]} points; they must agree."
        )
    if picture.shape != relief.shape:
        raise TopographyError(
            f"{says} marks a map that is repeated over the part; mark its pits by "
            f"{key}.zone_height_um."
        )
    return picture[::-1]


def _picture(path: Path) -> Mask:
    """Non-zero pixels of an image; of a colour image, those that are not black."""
    values: NDArray[Any]
    if path.suffix.lower() in (".tif", ".tiff"):
        import tifffile

        values = tifffile.imread(path)
    else:
        from PIL import Image

        with Image.open(path) as image:
            grey = image.mode in ("1", "L", "I", "F") or image.mode.startswith("I;")
            values = np.asarray(image if grey else image.convert("RGB"))
    picture: Mask = (values[..., :3] != 0).any(axis=-1) if values.ndim == 3 else values != 0
    return picture
