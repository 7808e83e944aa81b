"""The station as the kernels see it: the structs of `kernels/station.h`, float4 by float4."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gpuspec.part.grooves import Grooves, averaged
from gpuspec.part.maps import TopographyMap
from gpuspec.part.view import pixel_position
from gpuspec.station.materials import MATERIALS
from gpuspec.station.station import Station

SECTIONS = {"ceiling": 0, "box": 1, "arch": 2}


def geometry_block(station: Station) -> NDArray[np.float32]:
    """Return the struct ``Geometry``: everything a light map depends on but the relief.

    Returns
    -------
    ndarray of float32, shape (6, 4)
        Lengths in mm.
    """
    part, tunnel, camera = station.part, station.tunnel, station.camera
    rows, columns = station.shape
    # A device knows the crown, by its curvatures at the top.
    curve_xx, _, curve_yy = part.shape.curvature(0.0, 0.0)
    return np.array(
        [
            [camera.height_mm, camera.pupil_mm, camera.sampling_mm, camera.subsampling],
            [columns, rows, part.surface == "height", camera.vignetting == "cos4"],
            [part.length_mm / 2, part.width_mm / 2, -curve_xx, -curve_yy],
            [
                SECTIONS[tunnel.section],
                tunnel.top_mm,
                (tunnel.width_mm or 0) / 2,
                tunnel.length_mm / 2,
            ],
            [tunnel.opening_length_mm / 2, tunnel.opening_width_mm / 2, 0, part.roughness_rad],
            [*MATERIALS[part.material], 0, 0],
        ],
        np.float32,
    )


def differential_pairs(station: Station) -> int:
    """Return the number of pairs of the differential fusion.

    Pairs wrap around where the shifts fill whole periods; else the last images begin none.
    """
    sequence = station.sequence
    if station.distinct_shifts:
        return sequence.images
    return max(sequence.images - sequence.lag, 0)


def design_block(station: Station) -> NDArray[np.float32]:
    """Return the struct ``Design``: stripes, sequence and sensor, which never retrace a light map.

    Returns
    -------
    ndarray of float32, shape (5, 4)
        Lengths in mm, signals in electrons and DN.
    """
    tunnel, sensor, sequence = station.tunnel, station.sensor, station.sequence
    return np.array(
        [
            [tunnel.luminous_mm / tunnel.period_mm, 1 / tunnel.period_mm, tunnel.dark_leak, 0],
            [
                sequence.images,
                station.step_mm / tunnel.period_mm,
                station.distinct_shifts or 0,
                sequence.lag,
            ],
            [sensor.exposure, sensor.full_scale_dn, sensor.saturation_e, sensor.read_noise_e],
            [sensor.dark_e, sensor.dsnu_e, sensor.prnu, sensor.black_level_dn],
            [
                sensor.noise,
                sensor.seed & 0xFFFF,
                sensor.seed >> 16,
                differential_pairs(station),
            ],
        ],
        np.float32,
    )


_END = 16  # points after which the spline forgets what follows: 0.27^16 = 7e-10


def map_records(maps: tuple[TopographyMap, ...], station: Station) -> NDArray[np.float32]:
    """Return the structs ``Map`` of `kernels/station.h`.

    Parameters
    ----------
    maps : tuple of TopographyMap, n of them
        Laid on the part.
    station : Station
        Its sampling and image shape are used.

    Returns
    -------
    ndarray of float32, shape (n, 3, 4)
    """
    from gpuspec.part.view import pixel_position

    records = np.zeros((len(maps), 3, 4), np.float32)
    first = 0
    for record, m in zip(records, maps, strict=True):
        ny, nx = m.heights_mm.shape
        start = pixel_position(np.array([m.corner_mm]), station)[0]
        whole = np.floor(start)
        record[0] = [*whole, *(start - whole)]
        record[1] = [nx, ny, first & 0xFFFF, first >> 16]
        record[2, :2] = 1 / np.array(m.pitch_mm)
        first += (nx + 2) * (ny + 2)
    return records


def coefficients(maps: tuple[TopographyMap, ...]) -> NDArray[np.float32]:
    """Return the cubic B-spline coefficients of all maps, one after another.

    Each map has one more coefficient on each side than it has points, row by row: point (j, i) is
    entry (j + 1, i + 1). Heights mirrored through their end points give the spline natural ends.

    Returns
    -------
    ndarray of float32, shape (sum of (ny + 2) (nx + 2),)
    """
    parts = [np.zeros(0, np.float32)]
    for m in maps:
        extended = np.pad(m.heights_mm, _END, mode="reflect", reflect_type="odd")
        spline = ndimage.spline_filter(extended, order=3, mode="mirror")
        inner = slice(_END - 1, 1 - _END)
        parts.append(spline[inner, inner].astype(np.float32).ravel())
    return np.concatenate(parts)


def groove_records(grooves: Grooves, station: Station) -> NDArray[np.float32]:
    """Return the structs ``Groove`` of `kernels/station.h`, as the pixels average them.

    Parameters
    ----------
    grooves : Grooves
        S pieces.
    station : Station
        Its sampling and image shape are used.

    Returns
    -------
    ndarray of float32, shape (S, 3, 4)
    """
    grooves = averaged(grooves, station)
    records = np.zeros((len(grooves), 3, 4), np.float32)
    start = pixel_position(grooves.ends[:, :2], station)
    whole = np.floor(start)
    course = grooves.ends[:, 2:] - grooves.ends[:, :2]
    length = np.hypot(course[:, 0], course[:, 1])
    inverse = np.divide(1, length, out=np.zeros_like(length), where=length > 0)
    records[:, 0, :2], records[:, 0, 2:] = whole, start - whole
    records[:, 1, :2], records[:, 1, 2], records[:, 1, 3] = course, inverse**2, inverse
    records[:, 2, 0], records[:, 2, 1] = grooves.depth, 1 / grooves.sigma**2
    records[:, 2, 2] = grooves.owner
    return records
