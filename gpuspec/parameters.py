"""The station as the kernels see it: the structs of `kernels/station.h`, float4 by float4."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpuspec.station import Station

SECTIONS = {"ceiling": 0, "box": 1, "arch": 2}

# Refractive index n and extinction k near 550 nm, rounded: Johnson and Christy, Phys. Rev. B 6
# (1972) and 9 (1974); aluminium after Smith, Shiles, Inokuti in Palik's handbook (1985); the
# lacquer is a clear coat of index 1.5.
MATERIALS = {
    "ideal": (0.0, 0.0),
    "aluminium": (0.96, 6.7),
    "silver": (0.06, 3.6),
    "gold": (0.43, 2.5),
    "copper": (1.0, 2.6),
    "chromium": (3.2, 3.3),
    "nickel": (1.9, 3.6),
    "iron": (2.9, 3.0),
    "lacquer": (1.5, 0.0),
}


def geometry_block(station: Station) -> NDArray[np.float32]:
    """Return the struct ``Geometry``: everything a light map depends on but the relief.

    Returns
    -------
    ndarray of float32, shape (6, 4)
        Lengths in mm.
    """
    part, tunnel, camera = station.part, station.tunnel, station.camera
    rows, columns = station.shape
    return np.array(
        [
            [camera.height_mm, camera.pupil_mm, camera.sampling_mm, camera.subsampling],
            [columns, rows, part.surface == "height", camera.vignetting == "cos4"],
            [part.length_mm / 2, part.width_mm / 2, *curvatures(station)],
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


def curvatures(station: Station) -> tuple[float, float]:
    """Return the crown's curvatures along x and y in 1/mm, 0 where flat."""
    radii = station.part.crown_radius_x_mm, station.part.crown_radius_y_mm
    return 1 / radii[0] if radii[0] else 0.0, 1 / radii[1] if radii[1] else 0.0


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
