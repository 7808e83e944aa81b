"""NumPy in float64 as a backend: the reference that runs everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.light.backend import Backend, DeviceInfo, chosen
from gpuspec.light.float64 import Array, Part, follow, grey_level, lit_fraction, mean_over_scan
from gpuspec.light.light_map import FUSIONS, LightMap, LightMapArrays
from gpuspec.light.records import differential_pairs
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

_BAND_PIXELS = 250_000


class NumpyBackend(Backend):
    """NumPy in float64, on the CPU."""

    def __init__(self, device: str | None = None) -> None:
        chosen("numpy", ["cpu"], device)
        self.info = DeviceInfo("numpy", "cpu", "NumPy float64", np.__version__)

    def trace(self, station: Station, relief: Relief | None = None) -> NumpyLightMap:
        """Trace a station; see :meth:`Backend.trace`."""
        return NumpyLightMap(station, relief or Relief.of(station))


class NumpyLightMap(LightMap):
    """A light map in float64; bands of rows keep the working memory small."""

    def __init__(self, station: Station, relief: Relief) -> None:
        self.station = station
        rows, columns = station.shape
        n, p = station.camera.subsampling, station.camera.sampling_mm
        part = Part(station, relief)
        arrays = [np.empty((n * n, rows, columns)) for _ in range(3)]
        lost = np.empty((n * n, rows, columns), np.uint8)
        column = np.arange(columns, dtype=np.float64)[None, :]
        for band in self._bands():
            row = np.arange(band.start, band.stop, dtype=np.float64)[:, None]
            for i in range(n * n):
                x0: Array = (column + (i % n + 0.5) / n - columns / 2) * p
                y0: Array = (rows / 2 - row - (i // n + 0.5) / n) * p
                paths = follow(part, station, x0, y0)
                seen = paths.lost == 0
                arrays[0][i, band] = np.where(seen, paths.light[..., 0], 0)
                arrays[1][i, band] = paths.footprint
                arrays[2][i, band] = paths.irradiance
                lost[i, band] = paths.lost
        reason = np.where((lost == 0).any(axis=0), 0, lost.max(axis=0)).astype(np.uint8)
        self._arrays = LightMapArrays(arrays[0], arrays[1], arrays[2], reason)

    def _bands(self) -> Iterator[slice]:
        rows, columns = self.station.shape
        height = max(_BAND_PIXELS // columns, 1)
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
        lit = lit_fraction(m.light_mm[:, band], m.footprint_mm[:, band], shift, station)
        leak = station.tunnel.dark_leak
        signal = (m.irradiance[:, band] * (leak + (1 - leak) * lit)).mean(axis=0)
        column = np.arange(self.station.shape[1])[None, :]
        row = np.arange(band.start, band.stop)[:, None]
        return grey_level(station.sensor.exposure * signal, station, k, column, row)

    def _by_band(self, work: Callable[[slice, Station], Array], station: Station | None) -> Image:
        station = self.lit_by(station)
        out = np.empty(self.station.shape, np.float32)
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
        fused = {name: np.empty(self.station.shape, np.float32) for name in FUSIONS}
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
            light, footprint, irradiance = (
                a[0, band] for a in (m.light_mm, m.footprint_mm, m.irradiance)
            )
            mean = mean_over_scan(light, footprint, irradiance, s)
            return s.sensor.full_scale_dn * np.minimum(mean, 1)

        return self._by_band(work, station)
