"""Whether the host's memory holds what a station asks for."""

from __future__ import annotations

import math

from gpuspec.errors import StationError
from gpuspec.host import free_bytes
from gpuspec.station.station import Station
from gpuspec.topographies.file import size_mm

# Host memory at the peak, per pixel: aspect, labels, truth and nearest (4 bytes each), masks, and
# the temporaries of threshold and labelling.
_BYTES_PER_PIXEL = 40


def check_memory(station: Station) -> None:
    """Refuse an image that the host's memory cannot hold, before any work.

    Raises
    ------
    StationError
        With the sampling that would fit.
    TopographyError
        If the map that gives the part its size cannot be read.
    """
    relief = station.part.relief
    if relief and station.sides_of_map:  # a size that no map gave would be refused in its place
        size_mm(relief, station.locate(relief.file), station.file)
    rows, columns = station.shape
    needed = rows * columns * _BYTES_PER_PIXEL
    available = free_bytes()
    if needed > available:
        camera = station.camera
        if camera.columns or camera.rows:
            way = "set smaller camera.columns and camera.rows"
        else:
            fits = _two_digits_up(camera.sampling_mm * math.sqrt(needed / available) * 1.001)
            way = f"{fits:g} or more fits, or set camera.columns and camera.rows to see a piece"
        raise StationError(
            f"{station.file}: camera.sampling_mm = {camera.sampling_mm:g} makes an image "
            f"of {columns} x {rows} pixels, which needs {needed / 2**30:.1f} GiB of memory while "
            f"{available / 2**30:.1f} GiB are free; {way}."
        )


def _two_digits_up(value: float) -> float:
    exponent = 1 - math.floor(math.log10(value))
    return math.ceil(value * 10.0**exponent) / 10.0**exponent
