"""The OpenCL backend: kernels of `kernels/*.cl` on a GPU, or on a CPU through PoCL."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.host import free_bytes
from gpuspec.light.backend import Backend, Settings
from gpuspec.light.levels import Sample, Zones
from gpuspec.light.opencl_device import FILES, INSTALL, INTEL, VECTOR, OpenCLDevice
from gpuspec.light.opencl_levels import OpenCLCounter
from gpuspec.light.records import (
    coefficients,
    design_block,
    geometry_block,
    groove_records,
    map_records,
)
from gpuspec.light.tiles import PlanarTile, TiledLightMap
from gpuspec.part.grooves import BLOCK, blocks
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

_BAND_BYTES = 1 << 26
"""Of an image on the device, which is made and brought home some rows at a time."""

_TILE_BYTES = 1 << 30
"""Of a light map that is not kept: larger tiles are no faster."""

_SHARE_OF_HOST = 4
"""What part of the host's free memory a light map may take there: a run takes 40 bytes a pixel
beside its 13."""

# Pixels of a REAL by kernel file, where `gpuspec devices --test` found another width faster than
# that of the device's type. Intel's compiler vectorises over work-items by itself, and its closed
# form is then 2.8 times as fast, but not its loop over images (0.03 times).
_MEASURED: dict[str, dict[str, int]] = {INTEL: {"aspect.cl": 1}}

# What a pixel costs, about, in units of one image in the mean. That rows differ matters more than
# how much they cost, see `OpenCLDevice.launches`.
_TRACE, _STEP, _PIECE, _MAP, _CLOSED, _FUSE, _NOISE = 20, 4, 5, 40, 2, 6, 16


class OpenCLBackend(OpenCLDevice, Backend):
    """One OpenCL device that traces stations.

    Parameters
    ----------
    device : str, optional
        Part of a device's name, or its number in `gpuspec devices`; None: the first GPU, else
        the first CPU.
    memory_bytes : int, optional
        Device memory one light map may take; None: half of the device's. Larger parts are done
        in tiles, with the same result to the bit.

    Raises
    ------
    BackendError
        No platform, no such device, or a kernel that does not build.
    """

    advice = f"Choose another --device or --backend (`gpuspec devices` lists them), or {INSTALL}."

    def __init__(self, device: str | None = None, memory_bytes: int | None = None) -> None:
        super().__init__(device)
        self.settle(self.candidates()[0])
        self.memory_bytes = memory_bytes or self.device.global_mem_size // 2

    def candidates(self) -> tuple[Settings, ...]:
        """See :meth:`Backend.candidates`: vectors suit a CPU, and single pixels always compile."""
        single, vectors = (dict.fromkeys(FILES, width) for width in (1, VECTOR))
        if not self.device.type & self.cl.device_type.CPU:
            return ({"widths": single},)
        vectors |= _MEASURED.get(self.info.driver, {})
        return {"widths": vectors}, {"widths": single}

    def trace(self, station: Station, relief: Relief | None = None) -> OpenCLLightMap:
        """Trace a station; see :meth:`Backend.trace`."""
        with self.failures():
            return OpenCLLightMap(self, station, relief or Relief.of(station))


_KERNELS = {
    "image": ("sequence.cl", "image_at"),
    "mean": ("sequence.cl", "mean_of_images"),
    "fuse": ("sequence.cl", "fuse_images"),
    "closed_form": ("aspect.cl", "aspect"),
}


class OpenCLLightMap(TiledLightMap[PlanarTile]):
    """A light map on an OpenCL device; rows are padded to whole vectors."""

    def __init__(self, backend: OpenCLBackend, station: Station, relief: Relief) -> None:
        self.backend = backend
        self.stride = -(-station.shape[1] // backend.width) * backend.width
        self._sub_rays = station.camera.subsampling**2
        first, pieces = blocks(relief.grooves, station)
        records = map_records(relief.maps, station)
        self._inputs: tuple[Any, ...] = (
            backend.constant(geometry_block(station)),
            backend.constant(groove_records(relief.grooves, station)),
            backend.constant(first),
            backend.constant(pieces),
            backend.constant(records),
            np.int32(len(records)),
            backend.constant(coefficients(relief.maps)),
        )
        near = np.diff(first).reshape(-(-station.shape[0] // BLOCK), -1).sum(axis=1)
        work = self.stride * (_TRACE + _MAP * len(records)) + BLOCK * _PIECE * near
        work *= self._sub_rays * (_STEP if station.part.surface == "height" else 1)
        self._work = np.repeat(work.astype(np.float64), BLOCK)[: station.shape[0]]
        super().__init__(station, self._rows_at_once(station.shape[0]))

    def _rows_at_once(self, rows: int) -> int:
        """Return how many rows are traced together: all, if the memory holds them."""
        b = self.backend
        row = self.stride * (12 * self._sub_rays + 1)
        room = b.memory_bytes
        if b.device.host_unified_memory:
            room = min(room, free_bytes() // _SHARE_OF_HOST)
        if rows * row > room:
            room = min(room, _TILE_BYTES)
        largest: int = b.device.max_mem_alloc_size
        return min(room // row, largest // (self.stride * 4 * self._sub_rays))

    def release(self) -> None:
        """See :meth:`LightMap.release`."""
        self._inputs = ()
        super().release()

    def failures(self) -> AbstractContextManager[None]:
        """See :meth:`OpenCLDevice.failures`."""
        return self.backend.failures()

    def counter(self, zones: Zones, sample: Sample | None = None) -> OpenCLCounter:
        """See :meth:`LightMap.counter`."""
        return OpenCLCounter(self, zones, sample)

    def trace_tile(self, first_row: int, rows: int) -> PlanarTile:
        """See :meth:`TiledLightMap.trace_tile`."""
        b = self.backend
        plane = rows * self.stride
        light, footprint, irradiance = (b.empty(4 * plane * self._sub_rays) for _ in range(3))
        tile = PlanarTile(first_row, rows, light, footprint, irradiance, b.empty(plane))
        for some in b.launches("trace", self._work[first_row : first_row + rows]):
            self._start(
                "trace.cl", "trace", some,
                tile.light, tile.footprint, tile.irradiance, tile.lost,
                *self._inputs, np.int32(first_row), np.int32(rows),
            )  # fmt: skip
        return tile

    def read_tile(
        self,
        tile: PlanarTile,
        maps: tuple[NDArray[np.float32], ...] | None,
        lost: NDArray[np.uint8],
    ) -> None:
        """See :meth:`TiledLightMap.read_tile`."""
        for out, buffer in zip(
            maps or (), (tile.light, tile.footprint, tile.irradiance), strict=maps is not None
        ):
            for i, plane in enumerate(out):
                self._copy_home(plane, buffer, i)
        self._copy_home(lost, tile.lost)

    def run_tile(self, tile: PlanarTile, what: str, station: Station, k: int, out: Image) -> None:
        """See :meth:`TiledLightMap.run_tile`."""
        b = self.backend
        design = b.constant(design_block(station))
        row = 4 * len(out) * self.stride
        most = min(max(min(_BAND_BYTES, b.memory_bytes) // row, 1), tile.rows)
        grey = b.empty(most * row)
        for some in b.launches(what, np.full(tile.rows, self._cost(what, station)), most):
            self._enqueue(tile, what, design, k, grey, some)
            for i, plane in enumerate(out):
                self._copy_home(plane[some], grey, i)

    def enqueue(self, tile: PlanarTile, what: str, design: Any, k: int, grey: Any) -> None:
        """Start a kernel on a whole tile; its planes go to the buffer `grey`.

        Parameters
        ----------
        tile : PlanarTile
        what : str
            See :meth:`TiledLightMap.run_tile`.
        design : Buffer
            The struct ``Design``.
        k : int
            Number of the image.
        grey : Buffer
        """
        self._enqueue(tile, what, design, k, grey, slice(0, tile.rows))

    def _enqueue(
        self, tile: PlanarTile, what: str, design: Any, k: int, grey: Any, rows: slice
    ) -> None:
        file, kernel = _KERNELS[what]
        more = [np.int32(tile.rows)] * (file == "sequence.cl") + [np.int32(k)] * (what == "image")
        self._start(
            file, kernel, rows,
            grey, tile.light, tile.footprint, tile.irradiance, design,
            np.int32(self._sub_rays), np.int32(tile.first_row), *more,
        )  # fmt: skip

    def _start(self, file: str, kernel: str, rows: slice, *arguments: Any) -> None:
        """Start a kernel on some rows of a tile."""
        b = self.backend
        size = self.stride // b.widths[file], rows.stop - rows.start
        # Left to itself PoCL takes rows together, and compiles anew for other numbers of rows.
        group = (b.group_of_row(file, kernel, size[0]), 1) if b.widths[file] > 1 else None
        b.start(file, kernel, size, *arguments, offset=(0, rows.start), group=group)

    def _cost(self, what: str, station: Station) -> float:
        """Return what a row of an image costs, see `OpenCLDevice.launches`."""
        if what == "closed_form":
            return self.stride * _CLOSED
        images = 1 if what == "image" else station.sequence.images
        dear = (_FUSE if what == "fuse" else 1) * (_NOISE if station.sensor.noise else 1)
        return float(self.stride) * self._sub_rays * images * dear

    def _copy_home(self, out: NDArray[Any], buffer: Any, plane: int = 0) -> None:
        """Copy a plane of a buffer, of rows as long as the stride, to out (rows, N)."""
        first = plane * len(out) * self.stride * out.itemsize
        if out.shape[1] == self.stride:
            self.backend.copy_home(out, buffer, first)
            return
        padded = np.empty((len(out), self.stride), out.dtype)
        self.backend.copy_home(padded, buffer, first)
        out[...] = padded[:, : out.shape[1]]
