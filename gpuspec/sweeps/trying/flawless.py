"""What bounds the aspect image where no defect is: from a few rays to the part without defects."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.light.backend import Backend
from gpuspec.light.float64 import hit_tunnel, ray_paths
from gpuspec.light.light_map import LightMapArrays
from gpuspec.part.grooves import Grooves
from gpuspec.part.guard import faint_curvature
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station
from gpuspec.sweeps.trying.listing import seeing
from gpuspec.sweeps.trying.noise import PLACES, Noise

Floats = NDArray[np.float64]
Bounds = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]

REGION_PX = 64
"""Side of the regions, each bounded by the rays at its corners."""

BOX_PX = 8
"""Their height under a box: by its edge rays to a wall and to the ceiling differ much."""

NO_RELIEF = Relief((), Grooves.of(()), ())

_FAR_MM = 1e9  # as good as endless
_BULGE = 1.5 / 8  # of a second difference: between two points, a parabola rises by 1/8 of it
_STEEPEST = 2.3  # most that a box changes by, over what l does, where the boxes are unlike
_UNLIKE = 0.25  # (w1^2 - w2^2) / (w1^2 + w2^2) from which on they are
_ROUNDING = 1e-5  # share by which float32 may be off
_OBLIQUE = 1.1  # between rays, by more than which no path is longer than at the rays beside


_NOTHING: Bounds = (np.ones(1, np.float32), np.zeros(1, np.float32), np.zeros(1, np.float32))


class Flawless:
    """The part without defects as a camera sees it: rays at the corners of regions of the image.

    Parameters
    ----------
    station : Station
        Its part's shape and camera are used.
    backend : Backend

    Attributes
    ----------
    noise : Noise
        Of the part under the tunnel that was bounded last.
    """

    def __init__(self, station: Station, backend: Backend) -> None:
        self._backend = backend
        self._bare = station.model_copy(
            update={
                "part": station.part.model_copy(
                    update={"relief": None, "length_mm": _FAR_MM, "width_mm": _FAR_MM}
                ),
                "camera": station.camera.model_copy(
                    update={
                        "rows": station.shape[0], "columns": station.shape[1], "subsampling": 1
                    }
                ),
                "defects": (), "populations": (),
            }
        )  # fmt: skip
        height = BOX_PX if station.tunnel.section == "box" else REGION_PX
        rows, columns = (
            _nodes(span, size)
            for span, size in zip(seeing(station), (height, REGION_PX), strict=True)
        )
        self._shape = len(rows), len(columns)
        width = station.shape[1]
        self._pixels = (rows[:, None] * width + columns).ravel().astype(np.uint32)
        p = station.camera.sampling_mm
        x, y = (columns + 0.5 - width / 2) * p, (station.shape[0] / 2 - rows - 0.5) * p
        paths = ray_paths(self._lit(section="ceiling"), NO_RELIEF, x[None], y[:, None])
        self._points = np.moveaxis(paths.surface, -1, 0)
        ray = np.moveaxis(paths.light, -1, 0) - self._points
        self._rays = ray / np.sqrt((ray**2).sum(axis=0))
        view = self._points - np.array([0, 0, station.camera.height_mm])[:, None, None]
        self._distance = np.sqrt((view**2).sum(axis=0))
        self._curvature = faint_curvature(station)
        self._traced: dict[str, Any] = {}
        self._known: tuple[Any, Bounds] | None = None
        self.noise = Noise(*np.zeros((3, 1)))

    def bounds(self, station: Station, crowd: int) -> Bounds:
        """Return what bounds the aspect image of the part, region by region.

        A footprint and an irradiance each whose exposure is not below that of any pixel there that
        is not near a defect, whatever the light coordinate.

        Parameters
        ----------
        station : Station
            With the part's shape, the camera, and a tunnel.
        crowd : int
            How many defects may be near, each of them faint.
        """
        key = station.tunnel, crowd
        if self._known is None or self._known[0] != key:
            self._known = key, self._bounds(station, crowd)
        return self._known[1]

    def _lit(self, **tunnel: Any) -> Station:
        """Return the station without end or opening of its tunnel, in which no ray is lost."""
        endless = {"length_mm": _FAR_MM, "opening_length_mm": 0.0, **tunnel}
        return self._bare.model_copy(
            update={"tunnel": self._bare.tunnel.model_copy(update=endless)}
        )

    def _bounds(self, station: Station, crowd: int) -> Bounds:
        self._bare = self._bare.model_copy(update={"tunnel": station.tunnel})
        tunnel = station.tunnel
        nodes: Floats
        if tunnel.section != "box":
            regions, nodes = self._regions("", {}, station, crowd)
            found = [regions]
        else:
            # Where rays meet the ceiling: beyond the walls, a wall is what they see. In
            # a region by the edge it may be either.
            across = self._points[1] + tunnel.height_mm / self._rays[2] * self._rays[1]
            across[self._rays[2] <= 0] = np.inf
            high, low = _greatest(np.stack([across, -across])) * [[[1]], [[-1]]]
            half = (tunnel.width_mm or 0) / 2
            wall, ceiling = (high > half) | (low < -half), (low <= half) & (high >= -half)
            found, nodes = [], np.zeros((3, *across.shape))
            for name, change, there, own in (
                ("ceiling", {"section": "ceiling"}, ceiling, np.abs(across) <= half),
                ("wall", {"height_mm": _FAR_MM}, wall, np.abs(across) > half),
            ):
                if there.any():
                    regions, seen = self._regions(name, change, station, crowd)
                    found.append(regions[:, there])
                    nodes[:, own] = seen[:, own]
        row, column = (np.array([int(size * at) for at in PLACES]) for size in self._shape)
        self.noise = Noise(*nodes[:, row[:, None], column].reshape(3, -1))
        least, most = -station.tunnel.length_mm / 2, station.tunnel.length_mm / 2
        regions = np.concatenate([part.reshape(len(part), -1) for part in found], axis=1)
        inside = (regions[3] <= most) & (regions[4] >= least)
        wide, narrow, irradiance = regions[:3, inside].astype(np.float32)
        if not len(wide):
            return _NOTHING
        return wide, narrow, irradiance

    def _traced_in(self, name: str, lit: Station) -> LightMapArrays:
        """Return the light map of the corners in a tunnel, kept under a name."""
        before = self._traced.get(name)
        if before is None:
            light_map = self._backend.traced(lit, NO_RELIEF, self._pixels)
        else:
            light_map = self._backend.trace_again(before, lit)
        self._traced[name] = light_map
        return light_map.read()

    def _regions(
        self, name: str, change: dict[str, Any], station: Station, crowd: int
    ) -> tuple[Floats, Floats]:
        """Return by region wide, narrow, irradiance, least and greatest light coordinate.

        And of the corners both boxes and the irradiance.

        Parameters
        ----------
        name : str
            Of the change.
        change : dict
            Keys of the tunnel.
        station : Station
            Its camera and roughness are used.
        crowd : int
            See :meth:`bounds`.
        """
        lit = self._lit(**change)
        arrays = self._traced_in(name, lit)
        path, wall = hit_tunnel(lit, self._points, self._rays)
        facing = np.maximum((wall * self._rays).sum(axis=0), 1e-6)
        # By how much what is left of the defects may change how l moves from pixel to pixel: rays
        # turn by twice the slope, dL = t dR + dt R.
        bend = 2 * self._curvature * crowd * station.camera.spot_side_mm * _OBLIQUE
        faint = bend * path * (1 + np.abs(self._rays[0]) / facing)
        # Squares of what the pupil and the roughness add to the footprint.
        # What the pupil adds off focus changes with the rest: as of a square of the whole spot.
        other = 0.75 * (station.camera.pupil_mm * path / self._distance) ** 2
        if station.camera.focus_mm is not None:
            other = np.zeros_like(path)
        other += 48 * (station.part.roughness_rad * path) ** 2
        planes = arrays.wide_mm, arrays.narrow_mm, arrays.irradiance, arrays.light_mm
        w1, w2, seen, light = (p[0, 0].reshape(self._shape).astype(np.float64) for p in planes)
        nodes = np.stack([w1, w2, seen])
        square, unlike = w1**2 + w2**2, w1**2 - w2**2
        moves = np.sqrt(np.maximum(square - other, 0) + _ROUNDING * square)
        more = 2 * faint * (2 * moves + faint)  # of both squares of l's changes together, at most
        stack = np.stack([w1, w2, w1 + w2, seen, square, unlike**2, -w1, -w1 * w2, -square,
                          -(unlike**2), light, -light, faint, -unlike / square, more])  # fmt: skip
        top = _greatest(stack)
        more, alike = top[14], -top[13] < _UNLIKE
        # Of the squares' sum, w1^2 + w2^2, and (w1^2 - w2^2)^2 the former changes by as much, the
        # latter by at most four times the former as often.
        most, few = top[4] + more, np.maximum(-top[8] - more, 0)
        apart, near = top[5] + 4 * most * more, np.maximum(-top[9] - 4 * most * more, 0)
        # Each box changes as its square, at most so steeply; those much alike as a square root.
        part = more * (0.5 + 1 / np.maximum(-top[13], _UNLIKE))
        w1, w2, least = top[0], top[1], -top[6]
        wider, thicker = (
            np.minimum(np.sqrt(w**2 + part) - w, _STEEPEST * top[12]) for w in (w1, w2)
        )
        thinner = np.minimum(least - np.sqrt(np.maximum(least**2 - part, 0)), _STEEPEST * top[12])
        wide = np.where(alike, np.sqrt((most + np.sqrt(apart)) / 2), w1 + wider)
        narrow = np.where(alike, np.sqrt((most - np.sqrt(near)) / 2), w2 + thicker)
        least = np.where(alike, np.sqrt((few + np.sqrt(near)) / 2), least - thinner)
        product = np.where(
            alike, np.sqrt(np.maximum(few**2 - apart, 0)) / 2,
            -top[7] - wide * thicker - narrow * wider,
        )  # fmt: skip
        both = np.where(alike, wide + narrow, top[2] + wider + thicker)
        bright = top[3]
        wide, narrow, factor = bounding(wide, narrow, both, least, product)
        bright = bright * factor * (1 + _ROUNDING)
        # Where a ray is reflected down nothing is known of its neighbours.
        down = _corners(arrays.lost[0].reshape(self._shape) != 0).any(axis=0)
        bright = np.where(down, 1e6, bright)
        past = np.where(down, np.inf, 0)
        return np.stack([wide, narrow, bright, -top[11] - past, top[10] + past]), nodes


def surveyed(arrays: LightMapArrays, rest: Mask) -> Bounds:
    """Return what bounds the aspect image of some pixels, region by region, from all of them.

    Where the part's own relief is measured, no shape tells of it.

    Parameters
    ----------
    arrays : LightMapArrays
        Of the image, one footprint per pixel.
    rest : ndarray of bool, shape (M, N)
        The pixels.
    """
    w1, w2, irradiance = arrays.wide_mm[0], arrays.narrow_mm[0], arrays.irradiance[0]
    seen = rest & (irradiance > 0)
    there = _by_region(seen, seen, False).any(axis=1)
    if not there.any():
        return _NOTHING
    top = [
        _by_region(values, seen, 0)[there].max(axis=1).astype(np.float64)
        for values in (w1, w2, w1 + w2, irradiance)
    ]
    least = [
        _by_region(values, seen, np.inf)[there].min(axis=1).astype(np.float64)
        for values in (w1, w1 * w2)
    ]
    wide, narrow, factor = bounding(top[0], top[1], top[2], *least)
    bright = top[3] * factor * (1 + _ROUNDING)
    return wide.astype(np.float32), narrow.astype(np.float32), bright.astype(np.float32)


def _by_region(values: NDArray[Any], keep: Mask, fill: Any) -> NDArray[Any]:
    """Return values of an image by region, shape (g, pixels); `fill` where not kept, or beyond."""
    (rows, columns), size = values.shape, REGION_PX
    padding = ((0, -rows % size), (0, -columns % size))
    padded = np.pad(np.where(keep, values, fill), padding, constant_values=fill)
    across = padded.shape[1] // size
    return padded.reshape(-1, size, across, size).swapaxes(1, 2).reshape(-1, size * size)


def bounding(
    wide: Floats, narrow: Floats, both: Floats, least: Floats, product: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return two boxes that with a factor are nowhere below any of some footprints.

    Where a kernel on the light is nowhere above another, times a number, nor is what it sees of the
    stripes. Two boxes w1 >= w2 are nowhere above two that are as wide or wider, W1 and W2, times
    W1 W2 / w1 w2; and nowhere above one box of W = w1 + w2 or more, times W / w1. The less counts.

    Parameters
    ----------
    wide, narrow, both : ndarray
        Greatest w1, w2 and w1 + w2, mm.
    least : ndarray
        Least w1, mm.
    product : ndarray
        Least w1 w2, mm^2.

    Returns
    -------
    wide, narrow, factor : ndarray
    """
    none = np.full(wide.shape, np.inf)
    two = np.divide(wide * narrow, product, out=none.copy(), where=product > 0)
    one = np.divide(both, least, out=none.copy(), where=least > 0)
    fewer = one < two
    factor = np.minimum(np.where(fewer, one, two), 1e6)
    return np.where(fewer, both, wide), np.where(fewer, 0.0, narrow), factor


def _nodes(span: range, size: int) -> NDArray[np.int64]:
    """Return pixels of a line about so far apart, first and last among them, two at least."""
    count = max(-(-(len(span) - 1) // size), 1) + 1
    return np.rint(np.linspace(span.start, span.stop - 1, count)).astype(np.int64)


def _corners(values: Any) -> Any:
    """Return what is at the four corners of each region, shape (4, ..., R - 1, C - 1)."""
    return np.stack(
        [values[..., :-1, :-1], values[..., :-1, 1:], values[..., 1:, :-1], values[..., 1:, 1:]]
    )


def _pairs(values: Any) -> Any:
    """Return the greater of neighbours along rows and along columns, shape (..., R - 1, C - 1)."""
    down = np.maximum(values[..., :-1, :], values[..., 1:, :])
    return np.maximum(down[..., :-1], down[..., 1:])


def _greatest(values: Floats) -> Floats:
    """Return by region what smooth quantities, given at the corners, are nowhere above.

    Between two points h apart a curve rises above its chord by h^2/8 of its second derivative: the
    second differences beside it tell.

    Parameters
    ----------
    values : ndarray, shape (n, R, C)
    """
    bulge = np.zeros_like(values)
    for axis in (1, 2):
        if values.shape[axis] > 2:
            padding = [(0, 0)] * 3
            padding[axis] = (1, 1)
            bulge += np.pad(np.abs(np.diff(values, 2, axis=axis)), padding, mode="edge")
    found: Floats = _pairs(values) + _BULGE * _pairs(bulge)
    return found
