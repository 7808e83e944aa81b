"""The OpenCL backend: kernels of `kernels/*.cl` on a GPU, or on a CPU through PoCL."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.backends import FUSIONS, Backend, DeviceInfo, Image, LightMap, LightMapArrays
from gpuspec.errors import BackendError
from gpuspec.parameters import design_block, geometry_block
from gpuspec.relief import Relief, blocks, groove_records
from gpuspec.sources import kernel_source
from gpuspec.station import Station
from gpuspec.topography import coefficients, map_records

INSTALL = "pip install pocl-binary-distribution (Linux), or your GPU's OpenCL driver"
_TILE_BYTES_MAX = 1 << 30
_FUSED_PLANES = len(FUSIONS)


def devices() -> list[Any]:
    """Return all OpenCL devices, GPUs first.

    Raises
    ------
    BackendError
        If pyopencl or every platform is missing.
    """
    try:
        import pyopencl as cl
    except ImportError as error:
        raise BackendError(f"opencl: pyopencl cannot be imported ({error}); {INSTALL}.") from None
    try:
        platforms = cl.get_platforms()
    except cl.Error as error:
        raise BackendError(f"opencl: no OpenCL platform found ({error}); {INSTALL}.") from None
    found = []
    for platform in platforms:
        try:
            found += platform.get_devices()
        except cl.Error:
            continue
    if not found:
        raise BackendError(f"opencl: no OpenCL device found; {INSTALL}.")
    return sorted(found, key=lambda d: not d.type & cl.device_type.GPU)


def describe(device: Any) -> DeviceInfo:
    """Return what is recorded of a device."""
    platform = device.platform
    return DeviceInfo("opencl", device.name.strip(), platform.name.strip(), device.driver_version)


class OpenCLBackend(Backend):
    """One OpenCL device with its queue and kernels.

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

    def __init__(self, device: str | None = None, memory_bytes: int | None = None) -> None:
        self.device = _chosen(devices(), device)  # says what to install where pyopencl is missing
        import pyopencl as cl

        self.cl = cl
        self.info = describe(self.device)
        on_cpu = bool(self.device.type & cl.device_type.CPU)
        self.width = 8 if on_cpu else 1
        self.memory_bytes = memory_bytes or self.device.global_mem_size // 2
        try:
            self.context = cl.Context([self.device])
            self.queue = cl.CommandQueue(self.context)
        except cl.Error as error:
            raise BackendError(f"opencl: {self.info.device} does not open ({error}).") from None

    @cached_property
    def trace_kernel(self) -> Any:
        """Kernel of `trace.cl`."""
        return self._kernel("trace.cl", "trace")

    @cached_property
    def image_kernel(self) -> Any:
        """Kernel of `sequence.cl` for one image."""
        return self._kernel("sequence.cl", "image_at")

    @cached_property
    def mean_kernel(self) -> Any:
        """Kernel of `sequence.cl` for the mean."""
        return self._kernel("sequence.cl", "mean_of_images")

    @cached_property
    def fuse_kernel(self) -> Any:
        """Kernel of `sequence.cl` for all fusions."""
        return self._kernel("sequence.cl", "fuse_images")

    @cached_property
    def aspect_kernel(self) -> Any:
        """Kernel of `aspect.cl`."""
        return self._kernel("aspect.cl", "aspect")

    def _kernel(self, file: str, name: str) -> Any:
        return self.cl.Kernel(self.program(kernel_source(file), file), name)

    def program(self, source: str, file: str) -> Any:
        """Build a program for the device; REAL has the width that suits it.

        Raises
        ------
        BackendError
            With the compiler's log, file and line kept.
        """
        try:
            return self.cl.Program(self.context, source).build([f"-DWIDTH={self.width}"])
        except self.cl.Error as error:
            log = str(error)
            if "error:" not in log:  # PoCL writes its programs to a folder, and is silent when full
                log += "\nThe compiler gave no reason; is the disk of ~/.cache/pocl full?"
            raise BackendError(f"kernels/{file} does not build with {self.info}:\n{log}") from None

    def constant(self, values: NDArray[Any]) -> Any:
        """Copy an array to the device, read-only; an empty one becomes one zero."""
        flags = self.cl.mem_flags.READ_ONLY | self.cl.mem_flags.COPY_HOST_PTR
        values = np.ascontiguousarray(values if values.size else np.zeros(16, values.dtype))
        return self.cl.Buffer(self.context, flags, hostbuf=values)

    def empty(self, size: int) -> Any:
        """Reserve bytes on the device."""
        return self.cl.Buffer(self.context, self.cl.mem_flags.READ_WRITE, size)

    def trace(self, station: Station, relief: Relief | None = None) -> OpenCLLightMap:
        """Trace a station; see :meth:`Backend.trace`."""
        with self.failures():
            return OpenCLLightMap(self, station, relief or Relief.of(station))

    @contextmanager
    def failures(self) -> Iterator[None]:
        """Say which device failed, and what to do, where the driver only has a code."""
        try:
            yield
        except self.cl.MemoryError as error:
            raise BackendError(
                f"opencl: {self.info.device} is out of memory ({error}); use a larger "
                f"camera.sampling_mm, another --device or --backend numpy."
            ) from None
        except self.cl.Error as error:
            raise BackendError(
                f"opencl: {self.info.device} failed ({error}); try another --device or "
                f"--backend numpy."
            ) from None


def _chosen(found: list[Any], wanted: str | None) -> Any:
    if wanted is None:
        return found[0]
    if wanted.isdecimal() and int(wanted) < len(found):
        return found[int(wanted)]
    for device in found:
        if not wanted.isdecimal() and wanted.lower() in device.name.lower():
            return device
    names = "; ".join(f"{i}: {d.name.strip()}" for i, d in enumerate(found))
    raise BackendError(f"opencl: no device {wanted!r}; there are {names}.")


@dataclass(frozen=True)
class _Tile:
    """Some rows of the light map, on the device."""

    first_row: int
    rows: int
    light: Any
    footprint: Any
    irradiance: Any
    lost: Any


class OpenCLLightMap(LightMap):
    """A light map on an OpenCL device, whole or, where memory is short, tile by tile."""

    def __init__(self, backend: OpenCLBackend, station: Station, relief: Relief) -> None:
        self.station = station
        self._backend = backend
        rows, columns = station.shape
        width = backend.width
        self._stride = -(-columns // width) * width
        self._sub_rays = station.camera.subsampling**2
        first, pieces = blocks(relief.grooves, station)
        records = map_records(relief.maps, station)
        self._inputs = (
            backend.constant(geometry_block(station)),
            backend.constant(groove_records(relief.grooves, station)),
            backend.constant(first),
            backend.constant(pieces),
            backend.constant(records),
            np.int32(len(records)),
            backend.constant(coefficients(relief.maps)),
        )
        per_row = self._stride * (12 * self._sub_rays + 1 + 4 * _FUSED_PLANES)
        largest = self._stride * 4 * max(self._sub_rays, _FUSED_PLANES)
        budget = min(backend.memory_bytes, _TILE_BYTES_MAX)
        fit = min(budget // per_row, backend.device.max_mem_alloc_size // largest)
        self._tile_rows = int(min(max(fit, 1), rows))
        self._kept: list[_Tile] = []
        if self._tile_rows == rows:
            self._kept = [self._traced(0, rows)]

    @property
    def tiles(self) -> int:
        """Number of tiles the part is done in."""
        return -(-self.station.shape[0] // self._tile_rows)

    def _traced(self, first_row: int, rows: int) -> _Tile:
        b = self._backend
        plane = rows * self._stride
        light, footprint, irradiance = (b.empty(4 * plane * self._sub_rays) for _ in range(3))
        tile = _Tile(first_row, rows, light, footprint, irradiance, b.empty(plane))
        geometry, *relief = self._inputs
        b.trace_kernel(
            b.queue, (self._stride // b.width, rows), None,
            tile.light, tile.footprint, tile.irradiance, tile.lost,
            geometry, *relief, np.int32(first_row),
        )  # fmt: skip
        return tile

    def _tiles(self) -> Iterator[_Tile]:
        if self._kept:
            yield from self._kept
            return
        total = self.station.shape[0]
        for first in range(0, total, self._tile_rows):
            yield self._traced(first, min(self._tile_rows, total - first))

    def _images(self, planes: int, run: Callable[[_Tile, Any], None]) -> Image:
        """Run a kernel on every tile and bring its planes home, shape (planes, M, N)."""
        rows, columns = self.station.shape
        b = self._backend
        images = np.empty((planes, rows, columns), np.float32)
        with b.failures():
            for tile in self._tiles():
                size = planes * tile.rows * self._stride
                grey = b.empty(4 * size)
                run(tile, grey)
                out = images[:, tile.first_row : tile.first_row + tile.rows]
                self._copy_home(out, grey, np.float32)
        return images

    def _image(self, run: Callable[[_Tile, Any], None]) -> Image:
        """Run a kernel of one plane on every tile and bring it home, shape (M, N)."""
        image: Image = self._images(1, run)[0]
        return image

    def _copy_home(self, out: NDArray[Any], buffer: Any, dtype: Any) -> None:
        """Copy planes (P, rows, stride) of a buffer to out (P, rows, N)."""
        b = self._backend
        if out.flags.c_contiguous and out.shape[-1] == self._stride:
            b.cl.enqueue_copy(b.queue, out, buffer)
            return
        padded = np.empty((*out.shape[:-1], self._stride), dtype)
        b.cl.enqueue_copy(b.queue, padded, buffer)
        out[...] = padded[..., : out.shape[-1]]

    def _run(
        self, kernel: Any, tile: _Tile, grey: Any, station: Station | None, *more: Any
    ) -> None:
        b = self._backend
        kernel(
            b.queue, (self._stride // b.width, tile.rows), None,
            grey, tile.light, tile.footprint, tile.irradiance,
            b.constant(design_block(station or self.station)),
            np.int32(self._sub_rays), np.int32(tile.first_row), *more,
        )  # fmt: skip

    def read(self) -> LightMapArrays:
        """Bring the light map home; see :class:`LightMapArrays`."""
        rows, columns = self.station.shape
        arrays = [np.empty((self._sub_rays, rows, columns), np.float32) for _ in range(3)]
        lost = np.empty((1, rows, columns), np.uint8)
        with self._backend.failures():
            for tile in self._tiles():
                band = np.s_[:, tile.first_row : tile.first_row + tile.rows]
                for array, buffer in zip(
                    arrays, (tile.light, tile.footprint, tile.irradiance), strict=True
                ):
                    self._copy_home(array[band], buffer, np.float32)
                self._copy_home(lost[band], tile.lost, np.uint8)
        light, footprint, irradiance = arrays
        return LightMapArrays(light, footprint, irradiance, lost[0])

    def lost(self) -> NDArray[np.uint8]:
        """See :meth:`LightMap.lost`."""
        lost = np.empty(self.station.shape, np.uint8)
        with self._backend.failures():
            for tile in self._tiles():
                out = lost[tile.first_row : tile.first_row + tile.rows]
                self._copy_home(out, tile.lost, np.uint8)
        return lost

    def image(self, k: int, station: Station | None = None) -> Image:
        """See :meth:`LightMap.image`."""
        kernel = self._backend.image_kernel
        return self._image(lambda tile, grey: self._run(kernel, tile, grey, station, np.int32(k)))

    def mean(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.mean`."""
        kernel = self._backend.mean_kernel
        return self._image(lambda tile, grey: self._run(kernel, tile, grey, station))

    def fuse(self, station: Station | None = None) -> dict[str, Image]:
        """See :meth:`LightMap.fuse`."""
        kernel = self._backend.fuse_kernel
        images = self._images(
            _FUSED_PLANES, lambda tile, grey: self._run(kernel, tile, grey, station)
        )
        return dict(zip(FUSIONS, images, strict=True))

    def closed_form(self, station: Station | None = None) -> Image:
        """See :meth:`LightMap.closed_form`."""
        b = self._backend
        design = b.constant(design_block(station or self.station))

        def run(tile: _Tile, grey: Any) -> None:
            b.aspect_kernel(
                b.queue, (tile.rows * self._stride // b.width,), None,
                grey, tile.light, tile.footprint, tile.irradiance, design,
            )  # fmt: skip

        return self._image(run)
