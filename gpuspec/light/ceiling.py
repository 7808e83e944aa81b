"""The ceiling: the highest grey level that a flawless pixel of a station's aspect image can have.

Of few images the mean ripples: it depends on where the light's edge stands between two of them. So
a flawless pixel is tried at every such place, and the highest level counts. It is worked out in
float64 on the host, whatever traces the part, so that every backend has the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.detection.segmentation import NOISE_SIGMAS, Ceiling
from gpuspec.light.diffuse import diffuse_share
from gpuspec.light.float64_backend import NumpyLightMap
from gpuspec.light.float64_noise import Moments, noisy_moments
from gpuspec.light.float64_stripes import Exposure, lit_fraction, mean_over_scan
from gpuspec.light.light_map import has_closed_form, without_noise
from gpuspec.part.grooves import Grooves
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

__all__ = ["ceiling_of", "untold"]

Array = NDArray[np.float64]

_NODES = 13, 33
"""Rows and columns of places on the part that are tried; then as many about the best of them."""
_PHASES = 12
"""Of the stripes, beside those at which an image stands at an edge: there the mean bends down."""
_ZOOM = 25
_FLAWLESS = Relief((), Grooves.of(()), ())


def untold(station: Station) -> str:
    """Return why a station tells no ceiling, as the end of a sentence; "" if it does.

    Parameters
    ----------
    station : Station

    Examples
    --------
    >>> from gpuspec.light.ceiling import untold
    >>> untold(gpuspec.example("trim"))
    ''
    >>> untold(gpuspec.example("trim").replace(sequence__fusion="max"))
    'a ceiling is known of the mean of images, not of their max'
    """
    if station.sequence.fusion != "mean":
        return f"a ceiling is known of the mean of images, not of their {station.sequence.fusion}"
    if station.part.uneven:
        return "no shape tells how bright a part can be that is uneven by itself"
    return ""


def ceiling_of(station: Station) -> Ceiling | None:
    """Return the highest level that a flawless pixel of a station can have, and its noise.

    Of the part's shape as the file states it, without any defect: over the whole part that sees
    the light, for its footprint may vary, and over every phase of the stripes.

    Parameters
    ----------
    station : Station

    Returns
    -------
    Ceiling or None
        None if the station tells none, see :func:`untold`, or no pixel of the part sees the light.

    Examples
    --------
    >>> from gpuspec.light.ceiling import ceiling_of
    >>> station = gpuspec.example("trim")
    >>> ceiling_of(station)
    Ceiling(level_dn=87.29, noise_dn=0.00)
    >>> ceiling_of(station.replace(sequence__images=12, sensor__noise=True))
    Ceiling(level_dn=89.82, noise_dn=0.24)
    """
    if untold(station):
        return None
    ends = _outline(station)
    for _ in range(2):
        grid = [np.linspace(*span, count) for span, count in zip(ends, _NODES, strict=True)]
        planes, places = _seen(station, *grid)
        if not places.size:
            return None
        levels = _noiseless(_at(planes, _phases(planes, station)), station)
        best = int(levels.max(axis=1).argmax())
        at = np.unravel_index(places[best], _NODES)
        ends = [(nodes[max(i - 1, 0)], nodes[min(i + 1, len(nodes) - 1)])
                for nodes, i in zip(grid, at, strict=True)]  # fmt: skip
        planes = planes[:, :, best : best + 1]
    return _highest(planes, station)


def _outline(station: Station) -> list[tuple[float, float]]:
    """Return the first and the last row that see the part, and the columns; posed, all of them."""
    sizes = station.part.width_mm, station.part.length_mm
    if station.posed:
        return [(0, pixels - 1) for pixels in station.shape]
    p, h = station.camera.sampling_mm, station.camera.height_mm
    top = 0.0 if station.part.surface == "orientation" else station.part.height_range_mm[1]
    ends = []
    for pixels, size in zip(station.shape, sizes, strict=True):
        half = min(pixels / 2, size / 2 / (1 - top / h) / p)
        ends.append((max(pixels / 2 - half, 0), min(pixels / 2 + half, pixels) - 1))
    return ends


def _seen(station: Station, rows: Array, columns: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return what pixels at the nodes of a grid see, and which of them see all of it.

    Returns
    -------
    planes : ndarray, shape (4, n * n, N)
        Light coordinate, both widths and irradiance of their sub-rays.
    places : ndarray of intp, shape (N,)
        Flat numbers of the nodes.
    """
    row, column = (np.rint(nodes).astype(np.uint32) for nodes in (rows, columns))
    pixels = (row[:, None] * np.uint32(station.shape[1]) + column).ravel()
    arrays = NumpyLightMap(station, _FLAWLESS, pixels).read()
    lit = np.flatnonzero((arrays.irradiance > 0).all(axis=(0, 1)))
    planes = arrays.light_mm, arrays.wide_mm, arrays.narrow_mm, arrays.irradiance
    return np.stack([plane[:, 0, lit] for plane in planes]), lit


def _phases(planes: Array, station: Station) -> Array:
    """Return by how much to move the light past each of N pixels, mm, shape (N, J).

    Within one step of the tunnel, or a period where steps do not divide it.
    """
    period = station.tunnel.period_mm
    step = period / (station.distinct_shifts or 1)
    even = np.broadcast_to(np.arange(_PHASES) / _PHASES * step, (planes.shape[2], _PHASES))
    if len(planes[0]) > 1 or not station.tunnel.is_striped or not station.distinct_shifts:
        return even
    light, wide, narrow, irradiance = (plane[0] for plane in planes)
    e = Exposure.of(light, wide, narrow, irradiance, station)
    inner = e.edge - e.flank
    bends = np.stack([e.saturated_to(), e.edge, e.edge - e.corner, inner, inner - e.corner], axis=1)
    edges = np.concatenate([bends, -bends], axis=1) - e.centre[:, None]
    return np.concatenate([even, edges * period % step], axis=1)


def _at(planes: Array, phases: Array) -> Array:
    """Return the planes at every phase, shape (4, n * n, N, J)."""
    moved = np.repeat(planes[..., None], phases.shape[1], axis=-1)
    moved[0] += phases
    return moved


def _noiseless(planes: Array, station: Station) -> Array:
    """Return the aspect image without noise, DN."""
    quiet = without_noise(station)
    light, wide, narrow, irradiance = planes
    if has_closed_form(quiet):
        mean = mean_over_scan(light[0], wide[0], narrow[0], irradiance[0], station)
    else:
        mean = np.zeros(planes.shape[2:])
        for k in range(station.sequence.images):
            lit = lit_fraction(light, wide, narrow, k * station.step_mm, station)
            leak, scattered = station.tunnel.dark_leak, diffuse_share(station)
            seen = (irradiance * (leak + (1 - leak) * lit + scattered)).mean(axis=0)
            mean += np.minimum(station.sensor.exposure * seen, 1) / station.sequence.images
    return station.sensor.full_scale_dn * mean


def _noisy(planes: Array, station: Station) -> Moments:
    """Return mean and deviation of the aspect image of any pixel: their gains differ, too."""
    sensor = station.sensor

    def moments(gain: float = 1.0, dark_e: float = 0.0) -> Moments:
        alike = {
            "prnu": 0.0, "dsnu_e": 0.0, "dark_e": sensor.dark_e + dark_e,
            "exposure": sensor.exposure * gain,
        }  # fmt: skip
        own = station.model_copy(update={"sensor": sensor.model_copy(update=alike)})
        return noisy_moments(tuple(planes), own, 0, 0)

    found = moments()
    squares = (NOISE_SIGMAS * found.deviation) ** 2
    for key, most in (("gain", 1 + NOISE_SIGMAS * sensor.prnu),
                      ("dark_e", NOISE_SIGMAS * sensor.dsnu_e)):  # fmt: skip
        if sensor.prnu if key == "gain" else sensor.dsnu_e:
            squares = squares + (moments(**{key: most}).mean - found.mean) ** 2
    return Moments(found.mean, np.sqrt(squares) / NOISE_SIGMAS)


def _highest(planes: Array, station: Station) -> Ceiling:
    """Return the highest level of one pixel and its noise, over all phases and between them."""
    phases = _phases(planes, station)
    reach = station.tunnel.period_mm / (station.distinct_shifts or 1) / _PHASES
    for _ in range(3):
        moved = _at(planes, phases)
        if station.sensor.noise:
            found = _noisy(moved, station)
        else:
            mean = _noiseless(moved, station)
            found = Moments(mean, np.zeros_like(mean))
        best = int((found.mean + NOISE_SIGMAS * found.deviation).argmax())
        level, noise = float(found.mean[0, best]), float(found.deviation[0, best])
        phases = phases[0, best] + np.linspace(-reach, reach, _ZOOM)[None]
        reach /= _ZOOM // 2
    return Ceiling(level, noise)
