"""The OpenCL backend: kernels of `kernels/*.cl` on a GPU, or on a CPU through PoCL."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.host import free_bytes
from gpuspec.light import pocl
from gpuspec.light.backend import Backend, Settings, without
from gpuspec.light.constants import NO_PIXEL, STRIP_ROWS, STRIP_VECTORS
from gpuspec.light.float64_noise import Moments
from gpuspec.light.levels import Pixels, Sample, Zones
from gpuspec.light.light_map import PLANES, LightMap
from gpuspec.light.lists import Lists
from gpuspec.light.opencl_device import FILES, INSTALL, INTEL, VECTORS, OpenCLDevice
from gpuspec.light.opencl_footprints import FootprintLists, can_be_tables
from gpuspec.light.opencl_levels import OpenCLCounter, device_noise
from gpuspec.light.opencl_refinement import Surroundings
from gpuspec.light.records import (
    coefficients,
    design_block,
    geometry_block,
    map_records,
    piece_records,
)
from gpuspec.light.refinement import WIDTH_MM, Neighbourhood, bend_of
from gpuspec.light.tiles import PlanarTile, TiledLightMap
from gpuspec.part.grooves import BLOCK
from gpuspec.part.maps import averaged
from gpuspec.part.marches import MARCH_STEPS, march_of
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

_BAND_BYTES = 1 << 26
"""Of an image on the device, which is made and brought home some rows at a time."""

_TILE_BYTES = 1 << 30
"""Of a light map that is not kept: larger tiles are no faster."""

_SHARE_OF_HOST = 4
"""What part of the host's free memory a light map may take there: a run takes 40 bytes a pixel
beside its 17."""

# Pixels of a REAL by kernel file, where `gpuspec devices --test` found another width faster than
# that of the device's type. Intel's compiler vectorises over work-items by itself, and its closed
# form is then 2.8 times as fast, but not its loop over images (0.03 times). Sixteen pixels were
# not measured with it.
_MEASURED: dict[str, dict[str, int]] = {INTEL: {**dict.fromkeys(FILES, 8), "aspect.cl": 1}}

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

    screens = True
    advice = f"Choose another --device or --backend (`gpuspec devices` lists them), or {INSTALL}."

    def __init__(self, device: str | None = None, memory_bytes: int | None = None) -> None:
        super().__init__(device)
        self.settle(self.candidates()[0])
        self.memory_bytes = memory_bytes or self.device.global_mem_size // 2

    @property
    def held_bytes(self) -> int:
        """See :attr:`Backend.held_bytes`."""
        return int(self._pool.active_bytes)

    def candidates(self) -> tuple[Settings, ...]:
        """See :meth:`Backend.candidates`: vectors suit a CPU, and single pixels always compile."""
        widths: tuple[int, ...] = (1,)
        if self.device.type & self.cl.device_type.CPU:
            widths = (*(VECTORS if pocl.wide(self.device) else VECTORS[1:]), 1)
        best, *others = (dict.fromkeys(FILES, width) for width in widths)
        if others:
            best |= _MEASURED.get(self.info.driver, {})
        return tuple({"widths": found} for found in (best, *others))

    def traced(
        self, station: Station, relief: Relief, pixels: Pixels | None = None
    ) -> OpenCLLightMap:
        """See :meth:`Backend.traced`."""
        with self.failures():
            return OpenCLLightMap(self, station, relief, pixels)

    def trace_again(
        self, light_map: LightMap, station: Station, pixels: Pixels | None = None
    ) -> OpenCLLightMap:
        """See :meth:`Backend.trace_again`."""
        assert isinstance(light_map, OpenCLLightMap)
        light_map.held()
        with self.failures():
            return light_map.again(station, pixels)

    def without(self, light_map: LightMap, places: Pixels) -> LightMap:
        """See :meth:`Backend.without`."""
        assert isinstance(light_map, OpenCLLightMap)
        if light_map.tiles > 1 or not len(places):
            return super().without(light_map, places)
        with self.failures():
            return light_map.put_out(places)


_KERNELS = {
    "image": ("sequence.cl", "image_at"),
    "mean": ("sequence.cl", "mean_of_images"),
    "fuse": ("sequence.cl", "fuse_images"),
    "closed_form": ("aspect.cl", "aspect"),
    "noisy": ("sequence.cl", "noisy_mean"),
}


def _file(station: Station, file: str) -> str:
    """Return the kernel file that makes images under a station's light."""
    stripes = station.tunnel.is_striped
    return file if stripes or file != "sequence.cl" else "profiled.cl"


class OpenCLLightMap(TiledLightMap[PlanarTile]):
    """A light map on an OpenCL device; rows are padded to whole vectors."""

    def __init__(
        self,
        backend: OpenCLBackend,
        station: Station,
        relief: Relief,
        pixels: Pixels | None = None,
    ) -> None:
        self.backend = backend
        self._sub_rays = station.camera.sub_rays
        first, pieces = relief.blocks(station)
        records = map_records(relief.maps, station)
        self._march = march_of(station, relief)
        self._posed = station.posed or self._march is not None
        self._inputs: tuple[Any, ...] = (
            backend.constant(geometry_block(station, self._march)),
            backend.constant(piece_records(relief, station)),
            backend.constant(first),
            backend.constant(pieces),
            backend.constant(records),
            np.int32(len(records)),
            backend.constant(coefficients(averaged(relief.maps, station))),
        )
        self._pieces_met = np.diff(first)
        self._surroundings: Surroundings | None = None
        self._lay(station, pixels)

    def _lay(self, station: Station, pixels: Pixels | None) -> None:
        """Trace the image of a station, or a list of its pixels."""
        super().__init__(station, pixels)
        backend, near = self.backend, self._pieces_met
        rows, columns = self.grid
        self.stride = -(-columns // backend.width) * backend.width
        self._listed: tuple[Any, np.uint32] = (self._inputs[0], np.uint32(0))
        if pixels is None:
            near = near.reshape(-(-rows // BLOCK), -1).sum(axis=1).repeat(BLOCK)[:rows]
            pieces_met = BLOCK * near
        else:
            padded = np.full((rows, self.stride), NO_PIXEL, np.uint32)
            padded[:, :columns] = self.listed()
            self._listed = (backend.constant(padded), np.uint32(station.shape[1]))
            pieces_met = np.full(rows, self.stride * int(near.max(initial=0)))
        work = self.stride * (_TRACE + _MAP * int(self._inputs[5])) + _PIECE * pieces_met
        work = work * self._sub_rays * (_STEP if station.part.surface == "height" else 1)
        work = work * (MARCH_STEPS if self._march else 1)
        self._work = work.astype(np.float64)
        self.begin(self._rows_at_once(rows))

    def _rows_at_once(self, rows: int) -> int:
        """Return how many rows are traced together: all, if the memory holds them."""
        b = self.backend
        row = self.stride * (4 * PLANES * self._sub_rays + 1)
        room = b.memory_bytes
        if b.device.host_unified_memory and rows * row > _BAND_BYTES:
            room = min(room, free_bytes() // _SHARE_OF_HOST)
        if rows * row > room:
            room = min(room, _TILE_BYTES)
        largest: int = b.device.max_mem_alloc_size
        return min(room // row, largest // (self.stride * 4 * self._sub_rays))

    def again(self, station: Station, pixels: Pixels | None = None) -> OpenCLLightMap:
        """Return a light map of the same part and camera, what the device knows of them kept.

        Parameters
        ----------
        station : Station
            Another tunnel, or another crown where rays meet the part at z = 0.
        pixels : ndarray of uint32, shape (n,), optional
            Those of a list; None: the same as before.
        """
        other = copy(self)
        other._inputs = (
            self.backend.constant(geometry_block(station, self._march)),
            *self._inputs[1:],
        )
        if pixels is not None:
            other._lay(station, pixels)
        else:
            other.station = station
            other.begin(self._tile_rows)
        return other

    def release(self) -> None:
        """See :meth:`LightMap.release`."""
        self._inputs = ()
        super().release()
        self.backend.give_back()

    def failures(self) -> AbstractContextManager[None]:
        """See :meth:`OpenCLDevice.failures`."""
        return self.backend.failures()

    def moments(self, station: Station | None = None) -> Moments:
        """See :meth:`LightMap.moments`."""
        mean, deviation, _ = self._made("noisy", self.noisy(station), 3)
        return Moments(mean, deviation)

    def one_draw(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.one_draw`."""
        return self._made("noisy", self.noisy(station), 3)[2]

    def counter(self, zones: Zones, sample: Sample | None = None) -> OpenCLCounter:
        """See :meth:`LightMap.counter`."""
        return OpenCLCounter(self, zones, sample)

    def trace_tile(self, first_row: int, rows: int) -> PlanarTile:
        """See :meth:`TiledLightMap.trace_tile`."""
        b = self.backend
        plane = rows * self.stride
        planes = tuple(b.empty(4 * plane * self._sub_rays) for _ in range(PLANES))
        tile = PlanarTile(first_row, rows, planes, b.empty(plane))
        self.trace_into(tile)
        return tile

    def trace_into(self, tile: PlanarTile) -> None:
        """Trace a tile's rows into its buffers.

        Parameters
        ----------
        tile : PlanarTile
        """
        b, first_row, rows = self.backend, tile.first_row, tile.rows
        whole, listed = (
            ("posed.cl", "posed_listed.cl") if self._posed else ("trace.cl", "listed.cl")
        )
        listed = "sliced.cl" if self.station.camera.sliced else listed
        for some in b.launches("trace", self._work[first_row : first_row + rows]):
            if self.pixels is None:
                kernel = "trace" if self._sub_rays == 1 else "trace_sub_rays"
                self._start(
                    whole, kernel, some, *tile.planes, tile.lost,
                    *self._inputs, np.int32(first_row), np.int32(rows),
                )  # fmt: skip
            else:
                self._start(
                    listed, "trace_listed", some, *tile.planes, tile.lost,
                    *self._inputs, self._listed[0], np.int32(first_row), np.int32(rows),
                )  # fmt: skip

    def sides_needed(self) -> NDArray[np.uint8]:
        """See :meth:`LightMap.sides_needed`."""
        if not self._kept or self.pixels is not None:
            return super().sides_needed()
        b, tile = self.backend, self._kept[0]
        rows, columns = self.grid
        with self.failures():
            sides = b.empty(rows * self.stride)
            strip = STRIP_VECTORS * b.widths["refine.cl"]
            size = -(-self.stride // strip), -(-rows // STRIP_ROWS)
            b.start(
                "refine.cl", "sides_needed", size, sides, tile.planes[0], tile.planes[1],
                np.int32(rows), np.int32(columns), np.int32(self.stride),
                np.float32(bend_of(self.station.camera)), np.float32(WIDTH_MM),
                group=(1, 1),
            )  # fmt: skip
            found = np.empty((rows, columns), np.uint8)
            self._copy_home(found, sides)
        return found

    def sides_beside(self, around: Neighbourhood, places: NDArray[np.int64]) -> NDArray[np.uint8]:
        """See :meth:`LightMap.sides_beside`."""
        if not self._kept:
            return super().sides_beside(around, places)
        with self.failures():
            if self._surroundings is None or self._surroundings.around is not around:
                self._surroundings = Surroundings(self.backend, around, places)
            light, wide, *_ = self._kept[0].planes
            return self._surroundings.sides_needed(light, wide, bend_of(self.station.camera))

    def put_out(self, places: Pixels) -> OpenCLLightMap:
        """See :meth:`Backend.without`, of a list that is held whole.

        Parameters
        ----------
        places : ndarray of uint32
            At least one.
        """
        fewer = copy(self)
        fewer.pixels = without(self, places)
        irradiance, chosen = self._kept[0].planes[3], self.backend.constant(places)
        self.backend.start("refine.cl", "put_out", (len(places),), irradiance, chosen)
        return fewer

    def together(self, parts: Sequence[LightMap]) -> Lists[LightMap]:
        """See :meth:`LightMap.together`."""
        return FootprintLists(parts) if parts and can_be_tables(parts) else Lists(parts)

    def read_tile(
        self,
        tile: PlanarTile,
        maps: tuple[NDArray[np.float32], ...] | None,
        lost: NDArray[np.uint8],
    ) -> None:
        """See :meth:`TiledLightMap.read_tile`."""
        for out, buffer in zip(maps or (), tile.planes, strict=maps is not None):
            for i, plane in enumerate(out):
                self._copy_home(plane, buffer, i, wait=False)
        self._copy_home(lost, tile.lost)

    def run_tile(self, tile: PlanarTile, what: str, station: Station, k: int, out: Image) -> None:
        """See :meth:`TiledLightMap.run_tile`."""
        b = self.backend
        design = b.constant(design_block(station))
        table = device_noise(station.sensor, b)[:2] if what == "noisy" else ()
        row = 4 * len(out) * self.stride
        most = min(max(min(_BAND_BYTES, b.memory_bytes) // row, 1), tile.rows)
        grey = b.empty(most * row)
        for some in b.launches(what, np.full(tile.rows, self._cost(what, station)), most):
            self._enqueue(tile, what, design, k, grey, some, station, table)
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
        self._enqueue(tile, what, design, k, grey, slice(0, tile.rows), self.station)

    def _enqueue(
        self,
        tile: PlanarTile,
        what: str,
        design: Any,
        k: int,
        grey: Any,
        rows: slice,
        station: Station,
        table: tuple[Any, ...] = (),
    ) -> None:
        file, kernel = _KERNELS[what]
        more: list[Any] = [np.int32(self._sub_rays), np.int32(tile.first_row)]
        if file == "sequence.cl":
            more = [*self._listed, *more, np.int32(tile.rows)] + [np.int32(k)] * (what == "image")
        self._start(_file(station, file), kernel, rows, grey, *tile.planes, design, *more, *table)

    def _start(self, file: str, kernel: str, rows: slice, *arguments: Any) -> None:
        """Start a kernel on some rows of a tile."""
        b = self.backend
        size = self.stride // b.widths[file], rows.stop - rows.start
        # Left to itself PoCL takes rows together, and compiles anew for other numbers of rows.
        group = (b.group_of_row(file, kernel, size[0]), 1) if b.widths[file] > 1 else None
        b.start(file, kernel, size, *arguments, offset=(0, rows.start), group=group)

    def _cost(self, what: str, station: Station) -> float:
        """Return what a row of an image costs, see `OpenCLDevice.launches`."""
        if what in ("closed_form", "noisy"):
            return self.stride * _CLOSED
        images = 1 if what == "image" else station.sequence.images
        dear = (_FUSE if what == "fuse" else 1) * (_NOISE if station.sensor.noise else 1)
        return float(self.stride) * self._sub_rays * images * dear

    def _copy_home(
        self, out: NDArray[Any], buffer: Any, plane: int = 0, *, wait: bool = True
    ) -> None:
        """Copy a plane of a buffer, of rows as long as the stride, to out (rows, N)."""
        first = plane * len(out) * self.stride * out.itemsize
        if out.shape[1] == self.stride and out.flags.c_contiguous:
            self.backend.copy_home(out, buffer, first, wait=wait)
            return
        padded = np.empty((len(out), self.stride), out.dtype)
        self.backend.copy_home(padded, buffer, first)
        out[...] = padded[:, : out.shape[1]]
