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
from gpuspec.light.constants import LINE, LINE_MIN, LINE_SHORT, NO_PIXEL
from gpuspec.light.levels import Pixels
from gpuspec.light.light_map import FUSIONS, PLANES, LightMap, LightMapArrays, check_list
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
    planes : tuple of four Buffers
        Of every sub-ray: light coordinate, both widths, irradiance, see `kernels/light_map.h`.
    lost : Buffer
        Codes of ``LOST``; with a pattern, the light point's other coordinate of every sub-ray.
    """

    first_row: int
    rows: int
    planes: tuple[Any, ...]
    lost: Any


@dataclass(frozen=True)
class RayTile:
    """Some rows of a light map in one texture or buffer of the device, four floats a sub-ray.

    Attributes
    ----------
    first_row : int
        From 0, the image's top.
    rows : int
    rays : Texture or Buffer
        Of every sub-ray, as `shaders/ray.glsl` reads it.
    """

    first_row: int
    rows: int
    rays: Any


class TiledLightMap(LightMap, Generic[Tile]):
    """What every device backend has in common: rows are traced and fused some at a time.

    A device says how a tile is traced, read and run; every pixel depends on its place in the whole
    image alone, so tiles give the same result to the bit.

    Parameters
    ----------
    station : Station
    pixels : ndarray of uint32, shape (n,), optional
        Those of a list; None: all of the image.
    """

    def __init__(self, station: Station, pixels: Pixels | None = None) -> None:
        self.station = station
        self.pixels = pixels
        rows, columns = station.shape
        if pixels is not None:
            check_list(pixels, station)
            # Few lengths of rows: a driver may compile anew for each.
            line = LINE if len(pixels) >= 8 * LINE else LINE_SHORT
            columns = min(max(1 << (len(pixels) - 1).bit_length(), LINE_MIN), line)
            rows = -(-max(len(pixels), 1) // columns)
        self.grid = rows, columns

    def begin(self, tile_rows: int) -> None:
        """Trace what fits.

        Parameters
        ----------
        tile_rows : int
            Rows that fit into the device's memory. If all do, the light map is traced once and
            stays; else it is traced anew, tile by tile, for each use.
        """
        rows = self.grid[0]
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
            Written: the four planes of every sub-ray; None: they stay.
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
            "image" (number `k`), "mean", "fuse" (a plane each of ``FUSIONS``), "closed_form"; of
            shaders "lost" (why pixels see no light) or, of a pattern, "faulty" (share of samples
            that are none).
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
        return -(-self.grid[0] // self._tile_rows)

    def bands(self) -> Iterator[tuple[Tile, slice]]:
        """Yield each tile and its rows."""
        self.held()
        total = self.grid[0]
        if self._kept:
            yield self._kept[0], slice(0, total)
            return
        for first in range(0, total, self._tile_rows):
            rows = min(self._tile_rows, total - first)
            yield self.trace_tile(first, rows), slice(first, first + rows)

    def _made(self, what: str, station: Station | None, planes: int = 1, k: int = 0) -> list[Image]:
        station = self.lit_by(station)
        images = np.empty((planes, *self.grid), np.float32)
        with self.failures():
            for tile, band in self.bands():
                self.run_tile(tile, what, station, k, images[:, band])
        return [self._shaped(image) for image in images]

    def listed(self) -> NDArray[np.uint32]:
        """Return the pixels of a list as they lie on the device, shape `grid`.

        What fills the last row is ``NO_PIXEL``.
        """
        assert self.pixels is not None
        filled = np.full(self.grid, NO_PIXEL, np.uint32)
        filled.flat[: len(self.pixels)] = self.pixels
        return filled

    def _shaped(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return planes as they lie on the device, (..., *grid), as those of an image or a list."""
        if self.pixels is None:
            return plane
        flat = plane.reshape(*plane.shape[:-2], 1, -1)
        return flat[..., : len(self.pixels)]

    def read(self) -> LightMapArrays:
        """See :meth:`LightMap.read`."""
        shape = (self.station.camera.sub_rays, *self.grid)
        planes = [np.empty(shape, np.float32) for _ in range(PLANES)]
        lost = np.empty(self.grid, np.uint8)
        with self.failures():
            for tile, band in self.bands():
                self.read_tile(tile, tuple(plane[:, band] for plane in planes), lost[band])
        light, wide, narrow, irradiance = (self._shaped(plane) for plane in planes)
        return LightMapArrays(light, wide, narrow, irradiance, self._shaped(lost))

    def lost(self) -> NDArray[np.uint8]:
        """See :meth:`LightMap.lost`."""
        lost = np.empty(self.grid, np.uint8)
        with self.failures():
            for tile, band in self.bands():
                self.read_tile(tile, None, lost[band])
        return self._shaped(lost)

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


def light_words(pattern: Pattern | None, what: str, station: Station) -> tuple[str, ...]:
    """Return the words that tell a shader which light there is; none of stripes.

    Parameters
    ----------
    pattern : Pattern or None
        A user's, which takes the place of the station's light.
    what : str
        Of :meth:`TiledLightMap.run_tile`.
    station : Station
    """
    if pattern is not None:
        return pattern.defines
    made = what in ("image", "mean", "fuse") and not station.tunnel.is_striped
    return ("PROFILE",) * made


class ShaderLightMap(TiledLightMap[RayTile]):
    """A light map whose light can be a user's pattern, for backends that speak GLSL.

    With a pattern, tiles hold one width and the light point's other coordinate in place of two.
    """

    @abstractmethod
    def read_rays(self, tile: RayTile, out: NDArray[np.float32]) -> None:
        """Bring the entries of every sub-ray home.

        Parameters
        ----------
        tile : RayTile
        out : ndarray of float32, shape (n * n, rows, N, 4)
            Written.
        """

    def read_tile(
        self,
        tile: RayTile,
        maps: tuple[NDArray[np.float32], ...] | None,
        lost: NDArray[np.uint8],
    ) -> None:
        """See :meth:`TiledLightMap.read_tile`."""
        reason = np.empty((1, *lost.shape), np.float32)
        self.run_tile(tile, "lost", self.station, 0, reason)
        lost[...] = reason[0]
        if maps is not None:
            home = np.empty((*maps[0].shape, PLANES), np.float32)
            self.read_rays(tile, home)
            for number, out in enumerate(maps):
                np.maximum(home[..., number], -np.inf if number == 0 else 0, out=out)

    @abstractmethod
    def build(self, what: str) -> None:
        """Compile the shader that makes `what`."""

    def with_pattern(self, pattern: Pattern) -> ShaderLightMap:
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
                lit._kept = [lit.trace_tile(0, self.grid[0])]
        return lit

    def faulty(self) -> float:
        """See :meth:`LightMap.faulty`."""
        return float(self._made("faulty", None)[0].mean())
