"""Light maps on a device, whole or, where its memory is short, tile by tile."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.errors import BackendError, PatternError
from gpuspec.light.light_map import FUSIONS, LightMap, LightMapArrays
from gpuspec.light.patterns import Pattern
from gpuspec.light.shader_log import own_lines
from gpuspec.station.station import Station

Tile = TypeVar("Tile")


@dataclass(frozen=True)
class PlanarTile:
    """Some rows of a light map in buffers of the device, one for each of its quantities.

    Attributes
    ----------
    first_row : int
        From 0, the image's top.
    rows : int
    light, footprint, irradiance : Buffer
        Of every sub-ray, in mm, mm and 1.
    lost : Buffer
        Codes of ``LOST``; with a pattern, the light point's other coordinate of every sub-ray.
    """

    first_row: int
    rows: int
    light: Any
    footprint: Any
    irradiance: Any
    lost: Any


class TiledLightMap(LightMap, Generic[Tile]):
    """What every device backend has in common: rows are traced and fused some at a time.

    A device says how a tile is traced, read and run; every pixel depends on its place in the whole
    image alone, so tiles give the same result to the bit.

    Parameters
    ----------
    station : Station
    tile_rows : int
        Rows that fit into the device's memory. If all do, the light map is traced once and
        stays; else it is traced anew, tile by tile, for each use.
    """

    def __init__(self, station: Station, tile_rows: int) -> None:
        self.station = station
        rows = station.shape[0]
        self._tile_rows = min(max(int(tile_rows), 1), rows)
        self._kept = [self.trace_tile(0, rows)] if self._tile_rows == rows else []

    def release(self) -> None:
        """See :meth:`LightMap.release`. What another pattern lights still holds its own."""
        self._kept = []
        super().release()

    @abstractmethod
    def trace_tile(self, first_row: int, rows: int) -> Tile:
        """Trace some rows of the image; they stay on the device.

        Parameters
        ----------
        first_row : int
            From 0, the image's top.
        rows : int
        """

    @abstractmethod
    def read_tile(
        self,
        tile: Tile,
        maps: tuple[NDArray[np.float32], ...] | None,
        lost: NDArray[np.uint8],
    ) -> None:
        """Bring a tile home.

        Parameters
        ----------
        tile : Tile
        maps : tuple of ndarray of float32, each (n * n, rows, N), or None
            Written: light, footprint and irradiance of every sub-ray; None: they stay.
        lost : ndarray of uint8, shape (rows, N)
            Written.
        """

    @abstractmethod
    def run_tile(self, tile: Tile, what: str, station: Station, k: int, out: Image) -> None:
        """Make images of a tile and bring them home.

        Parameters
        ----------
        tile : Tile
        what : str
            "image" (number `k`), "mean", "fuse" (a plane each of ``FUSIONS``), "closed_form" or, of
            a pattern, "faulty" (share of samples that are none).
        station : Station
            Of the traced geometry.
        k : int
            Number of the image, from 0.
        out : ndarray of float32, shape (planes, rows, N)
            Written, in DN.
        """

    @property
    def tiles(self) -> int:
        """Number of tiles the part is done in."""
        return -(-self.station.shape[0] // self._tile_rows)

    def bands(self) -> Iterator[tuple[Tile, slice]]:
        """Yield each tile and its rows."""
        self.held()
        total = self.station.shape[0]
        if self._kept:
            yield self._kept[0], slice(0, total)
            return
        for first in range(0, total, self._tile_rows):
            rows = min(self._tile_rows, total - first)
            yield self.trace_tile(first, rows), slice(first, first + rows)

    def _made(self, what: str, station: Station | None, planes: int = 1, k: int = 0) -> list[Image]:
        station = self.lit_by(station)
        images = np.empty((planes, *self.station.shape), np.float32)
        with self.failures():
            for tile, band in self.bands():
                self.run_tile(tile, what, station, k, images[:, band])
        return list(images)

    def read(self) -> LightMapArrays:
        """See :meth:`LightMap.read`."""
        rows, columns = self.station.shape
        shape = (self.station.camera.subsampling**2, rows, columns)
        light, footprint, irradiance = (np.empty(shape, np.float32) for _ in range(3))
        lost = np.empty((rows, columns), np.uint8)
        with self.failures():
            for tile, band in self.bands():
                maps = (light[:, band], footprint[:, band], irradiance[:, band])
                self.read_tile(tile, maps, lost[band])
        return LightMapArrays(light, footprint, irradiance, lost)

    def lost(self) -> NDArray[np.uint8]:
        """See :meth:`LightMap.lost`."""
        lost = np.empty(self.station.shape, np.uint8)
        with self.failures():
            for tile, band in self.bands():
                self.read_tile(tile, None, lost[band])
        return lost

    def image(self, k: int, station: Station | None = None) -> Image:
        """See :meth:`LightMap.image`."""
        station = self.lit_by(station)
        return self._made("image", station, k=self.image_number(k, station))[0]

    def mean(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.mean`."""
        return self._made("mean", station)[0]

    def fuse(self, station: Station | None = None) -> dict[str, Image]:
        """See :meth:`LightMap.fuse`."""
        return dict(zip(FUSIONS, self._made("fuse", station, len(FUSIONS)), strict=True))

    def closed_form(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.closed_form`."""
        return self._made("closed_form", station)[0]


class ShaderLightMap(TiledLightMap[Tile]):
    """A light map whose light can be a user's pattern, for backends that speak GLSL.

    With a pattern, tiles hold the light point's other coordinate in place of the reason of loss.
    """

    @abstractmethod
    def build(self, what: str) -> None:
        """Compile the shader that makes `what`."""

    def with_pattern(self, pattern: Pattern) -> ShaderLightMap[Tile]:
        """See :meth:`LightMap.with_pattern`."""
        self.held()
        lit = copy(self)
        lit.pattern = pattern
        try:
            lit.build("mean")
        except BackendError as error:
            _, _, log = str(error).partition("\n")
            said = own_lines(log or str(error), pattern)
            raise PatternError(f"{pattern.file} does not compile:\n{said}") from None
        if self.pattern is None and self._kept:
            with self.failures():
                lit._kept = [lit.trace_tile(0, self.station.shape[0])]
        return lit

    def faulty(self) -> float:
        """See :meth:`LightMap.faulty`."""
        return float(self._made("faulty", None)[0].mean())
