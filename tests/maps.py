"""Measured topographies, made up and written as an instrument writes them."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from gpuspec.errors import TopographyError
from gpuspec.part.maps import read_maps
from gpuspec.station.station import Station

# Heights in the files are whole multiples of this unless a test says otherwise.
UNIT_MM = 1e-8
MISSING = -(2**30)


def write_sur(path, heights_mm, missing=None, pitch_mm=(0.004, 0.004), step_mm=UNIT_MM):
    """Write Digital Surf's format; heights (ny, nx), first line the top of the picture."""
    ny, nx = heights_mm.shape
    values = np.round(heights_mm / step_mm).astype("<i4")
    if missing is not None:
        values[missing] = MISSING - 2  # the format marks a missing point by zmin - 2
    low, high = (MISSING, values.max()) if missing is not None else (values.min(), values.max())
    header = b"DIGITAL SURF" + struct.pack("<4H", 0, 1, 1, 2) + b" " * 60
    header += struct.pack(
        "<5H8xHiiiiI", 0, 0, 0, missing is not None, 1, 32, low, high, nx, ny, nx * ny
    )
    header += struct.pack("<fff", *pitch_mm, step_mm)
    header += b"".join(axis.ljust(16) for axis in (b"X", b"Y", b"Z")) + 6 * b"mm".ljust(16)
    header += struct.pack("<fff", 1, 1, 1)
    path.write_bytes(header.ljust(512, b"\0") + values.tobytes())


def grid(nx, ny, pitch=0.004):
    """x and y of the points, about the centre; first line the greatest y."""
    x = (np.arange(nx) - (nx - 1) / 2) * pitch
    y = ((ny - 1) / 2 - np.arange(ny)) * pitch
    return np.meshgrid(x, y)


def pit(x, y, centre, sigma, depth_um):
    return -depth_um * 1e-3 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 2 / sigma**2)


def polished(nx=120, ny=100):
    """A tilted, wavy polished surface with three pits, and what it misses."""
    x, y = grid(nx, ny)
    heights = 0.009 + 2e-3 * x - 1e-3 * y + 2e-5 * np.sin(20 * x) * np.cos(15 * y)
    for centre, depth in (((0.1, 0.05), 1.0), ((-0.15, -0.1), 0.6), ((0.02, -0.12), 0.4)):
        heights = heights + pit(x, y, centre, 0.006, depth)
    missing = np.zeros(x.shape, bool)
    missing[40:43, 60:63] = missing[0, 0] = True
    return heights, missing


def relief_station(folder, size=(0.48, 0.4), **relief):
    return Station.from_dict(
        {
            "part": {
                "length_mm": size[0],
                "width_mm": size[1],
                "relief": {"file": "x.sur", **relief},
            },
            "camera": {"sampling_mm": 0.004, "height_mm": 150.0, "pupil_mm": 0.0},
            "tunnel": {"height_mm": 80.0},
        },
        "demo.toml",
        folder,
    )


def patch_station(folder, sampling=0.01, subsampling=1, part=2.0, **patch):
    return Station.from_dict(
        {
            "part": {"length_mm": part, "width_mm": part},
            "camera": {
                "sampling_mm": sampling,
                "height_mm": 150.0,
                "pupil_mm": 0.0,
                "subsampling": subsampling,
            },
            "tunnel": {"height_mm": 80.0},
            "defects": [
                {"kind": "dent", "x_mm": 0.9, "y_mm": 0.9, "diameter_mm": 0.01, "depth_um": 1e-3},
                {"kind": "measured", "file": "x.sur", "x_mm": 0.0, "y_mm": 0.0, **patch},
            ],
        },
        "demo.toml",
        folder,
    )


def rejected(station):
    """The one sentence with which a station's topography is refused."""
    with pytest.raises(TopographyError) as caught:
        read_maps(station)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("demo.toml: ")
    assert message.endswith(".")
    return message


PLAIN = {"height_unit": "nm", "pitch_um": 4.0, "form_removed": "none"}


def plain_station(folder, file, **relief):
    part = {"relief": {"file": file, **PLAIN, **relief}}
    camera = {"sampling_mm": 0.004, "height_mm": 150.0}
    data = {"part": part, "camera": camera, "tunnel": {"height_mm": 80.0}}
    return Station.from_dict(data, "demo.toml", folder)
