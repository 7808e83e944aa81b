"""NumPy in float64 as a backend: the reference that runs everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.light.backend import Backend, DeviceInfo, chosen
from gpuspec.light.diffuse import diffuse_share
from gpuspec.light.float64 import Array, Part, grey_level
from gpuspec.light.float64_rays import sub_rays
from gpuspec.light.float64_stripes import lit_fraction, mean_over_scan
from gpuspec.light.levels import Pixels
from gpuspec.light.light_map import FUSIONS, PLANES, LightMap, LightMapArrays, check_list
from gpuspec.light.records import differential_pairs
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

_BAND_PIXELS = 250_000


class NumpyBackend(Backend):
    """NumPy in float64, on the CPU."""

    def __init__(self, device: str | None = None) -> None:
        chosen("numpy", ["cpu"], device)
        self.info = DeviceInfo("numpy", "cpu", "NumPy float64", np.__version__)

    def traced(
        self, station: Station, relief: Relief, pixels: Pixels | None = None
    ) -> NumpyLightMap:
        """See :meth:`Backend.traced`."""
        return NumpyLightMap(station, relief, pixels)


class NumpyLightMap(LightMap):
    """A light map in float64; bands of rows keep the working memory small."""

    def __init__(self, station: Station, relief: Relief, pixels: Pixels | None = None) -> None:
        self.station = station
        self.pixels = pixels
        if pixels is not None:
            check_list(pixels, station)
        rows, columns = self.shape
        rays = station.camera.sub_rays
        part = Part(station, relief)
        arrays = [np.empty((rays, rows, columns)) for _ in range(PLANES)]
        lost = np.empty((rays, rows, columns), np.uint8)
        for band in self._bands():
            row, column = self._places(band)
            for i, paths in enumerate(sub_rays(part, station, relief, column, row)):
                seen = paths.lost == 0
                arrays[0][i, band] = np.where(seen, paths.light[..., 0], 0)
                arrays[1][i, band] = paths.wide
                arrays[2][i, band] = paths.narrow
                arrays[3][i, band] = paths.irradiance
                lost[i, band] = paths.lost
        reason = np.where((lost == 0).any(axis=0), 0, lost.max(axis=0)).astype(np.uint8)
        self._arrays = LightMapArrays(arrays[0], arrays[1], arrays[2], arrays[3], reason)

    def _places(self, band: slice) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the rows and columns of the image that some rows stand for."""
        if self.pixels is None:
            return np.arange(band.start, band.stop)[:, None], np.arange(self.shape[1])[None, :]
        row, column = np.divmod(self.pixels[None].astype(np.int64), self.station.shape[1])
        return row, column

    def _bands(self) -> Iterator[slice]:
        rows, columns = self.shape
        height = max(_BAND_PIXELS // max(columns, 1), 1)
        for first in range(0, rows, height):
            yield slice(first, min(first + height, rows))

    def release(self) -> None:
        """See :meth:`LightMap.release`."""
        if not self.released:
            del self._arrays
        super().release()

    def read(self) -> LightMapArrays:
        """See :meth:`LightMap.read`."""
        self.held()
        return self._arrays

    def lost(self) -> NDArray[np.uint8]:
        """See :meth:`LightMap.lost`."""
        self.held()
        return self._arrays.lost

    def _grey(self, band: slice, k: int, station: Station) -> Array:
        """Grey levels of image k in some rows, float64."""
        m = self._arrays
        shift = k * station.step_mm
        footprint = m.wide_mm[:, band], m.narrow_mm[:, band]
        lit = lit_fraction(m.light_mm[:, band], footprint[0], footprint[1], shift, station)
        leak, scattered = station.tunnel.dark_leak, diffuse_share(station)
        signal = (m.irradiance[:, band] * (leak + (1 - leak) * lit + scattered)).mean(axis=0)
        row, column = self._places(band)
        return grey_level(station.sensor.exposure * signal, station, k, column, row)

    def _by_band(self, work: Callable[[slice, Station], Array], station: Station | None) -> Image:
        station = self.lit_by(station)
        out = np.empty(self.shape, np.float32)
        for band in self._bands():
            out[band] = work(band, station)
        return out

    def image(self, k: int, station: Station | None = None) -> Image:
        """See :meth:`LightMap.image`."""
        number = self.image_number(k, self.lit_by(station))
        return self._by_band(lambda band, s: self._grey(band, number, s), station)

    def mean(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.mean`."""

        def work(band: slice, s: Station) -> Array:
            total: Array = sum(self._grey(band, k, s) for k in range(s.sequence.images))  # type: ignore[assignment]
            return total / s.sequence.images

        return self._by_band(work, station)

    def fuse(self, station: Station | None = None) -> dict[str, Image]:
        """See :meth:`LightMap.fuse`."""
        s = self.lit_by(station)
        fused = {name: np.empty(self.shape, np.float32) for name in FUSIONS}
        images, lag, pairs = s.sequence.images, s.sequence.lag, differential_pairs(s)
        for band in self._bands():
            stack = np.stack([self._grey(band, k, s) for k in range(images)])
            fused["mean"][band] = stack.mean(axis=0)
            fused["max"][band] = stack.max(axis=0)
            fused["min"][band] = stack.min(axis=0)
            fused["std"][band] = stack.std(axis=0)
            partner = (np.arange(pairs) + lag) % images
            gap = np.abs(stack[partner] - stack[:pairs]).sum(axis=0) / max(pairs, 1)
            fused["differential"][band] = gap
        return fused

    def closed_form(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.closed_form`."""

        def work(band: slice, s: Station) -> Array:
            m = self._arrays
            light, wide, narrow, irradiance = (
                plane[0, band] for plane in (m.light_mm, m.wide_mm, m.narrow_mm, m.irradiance)
            )
            mean = mean_over_scan(light, wide, narrow, irradiance, s)
            return s.sensor.full_scale_dn * np.minimum(mean, 1)

        return self._by_band(work, station)
