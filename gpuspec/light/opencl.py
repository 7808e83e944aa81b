"""The OpenCL backend: kernels of `kernels/*.cl` on a GPU, or on a CPU through PoCL."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec import cache
from gpuspec.arrays import Image
from gpuspec.errors import BackendError, DeviceError
from gpuspec.light import intel, pocl
from gpuspec.light.backend import Backend, DeviceInfo, Settings, chosen, failure
from gpuspec.light.levels import Sample, Zones
from gpuspec.light.light_map import FUSIONS
from gpuspec.light.opencl_levels import OpenCLCounter
from gpuspec.light.records import (
    coefficients,
    design_block,
    geometry_block,
    groove_records,
    map_records,
)
from gpuspec.light.sources import kernel_source
from gpuspec.light.tiles import PlanarTile, TiledLightMap
from gpuspec.part.grooves import blocks
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

INSTALL = (
    "install your GPU's OpenCL driver or, for the CPU, pip install pocl-binary-distribution "
    '(Linux), pip install "gpuspec[intel]" (Linux, Windows), or apt install pocl-opencl-icd '
    "(Debian, Ubuntu)"
)
INTEL = "Intel(R) OpenCL"
_TILE_BYTES_MAX = 1 << 30

# Pixels times images of one launch, about a second on two slow cores; what noise costs more, and
# how much more a GPU does in that time.
_AT_ONCE = 1_000_000_000
_NOISE_COST = 16
_GPU_SPEED = 50

VECTOR = 8
"""Pixels of a REAL where it is a vector; rows are padded to whole ones."""

FILES = ("trace.cl", "aspect.cl", "sequence.cl", "sweep.cl")

# Pixels of a REAL by kernel file, where `gpuspec devices --test` found another width faster than
# that of the device's type. Intel's compiler vectorises over work-items by itself, and its closed
# form is then 2.8 times as fast, but not its loop over images (0.03 times).
_MEASURED: dict[str, dict[str, int]] = {INTEL: {"aspect.cl": 1}}


def devices() -> list[Any]:
    """Return all OpenCL devices, GPUs first.

    Raises
    ------
    BackendError
        If pyopencl or every platform is missing.
    """
    cache.lend()
    try:
        import pyopencl as cl
    except ImportError as error:
        raise BackendError(f"opencl: pyopencl cannot be imported ({error}); {INSTALL}.") from None
    try:
        with intel.known_to_loader():
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
    for device in found:
        pocl.repair(device)
    return sorted(found, key=_late)


def _late(device: Any) -> int:
    """Return where a device comes: GPUs, other CPUs' drivers such as PoCL, Intel's for CPUs."""
    import pyopencl as cl

    if device.type & cl.device_type.GPU:
        return 0
    return 2 if device.platform.name.strip() == INTEL else 1


def gpu_count() -> int:
    """Return the number of GPUs among the devices, where they come first; 0 without OpenCL."""
    try:
        found = devices()
    except BackendError:
        return 0
    import pyopencl as cl

    return sum(bool(device.type & cl.device_type.GPU) for device in found)


def describe(device: Any) -> DeviceInfo:
    """Return what is recorded of a device."""
    platform = device.platform
    built_for = pocl.cpu(device)
    version = f"{device.driver_version} for {built_for}" if built_for else device.driver_version
    return DeviceInfo("opencl", device.name.strip(), platform.name.strip(), version)


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

    advice = f"Choose another --device or --backend (`gpuspec devices` lists them), or {INSTALL}."

    def __init__(self, device: str | None = None, memory_bytes: int | None = None) -> None:
        found = devices()  # says what to install where pyopencl is missing
        import pyopencl as cl

        self.cl = cl
        self.number = chosen("opencl", [d.name for d in found], device)
        self.device = found[self.number]
        self.info = describe(self.device)
        self.settle(self.candidates()[0])
        self.memory_bytes = memory_bytes or self.device.global_mem_size // 2
        try:
            self.context = cl.Context([self.device])
            self.queue = cl.CommandQueue(self.context)
        except cl.Error as error:
            raise DeviceError(f"opencl: {self.info.device} does not open ({error}).") from None

    def candidates(self) -> tuple[Settings, ...]:
        """See :meth:`Backend.candidates`: vectors suit a CPU, and single pixels always compile."""
        single, vectors = (dict.fromkeys(FILES, width) for width in (1, VECTOR))
        if not self.device.type & self.cl.device_type.CPU:
            return ({"widths": single},)
        vectors |= _MEASURED.get(self.info.driver, {})
        return {"widths": vectors}, {"widths": single}

    def settle(self, settings: Settings) -> None:
        """See :meth:`Backend.settle`; `widths` are the pixels of a REAL by kernel file."""
        self.widths: dict[str, int] = {**dict.fromkeys(FILES, 1), **settings.get("widths", {})}
        self._kernels: dict[str, Any] = {}

    @property
    def width(self) -> int:
        """The widest REAL of all kernels, of which rows hold a whole number."""
        return max(self.widths.values())

    def kernel(self, file: str, name: str) -> Any:
        """Return a kernel of `kernels/`, built when first asked for.

        Parameters
        ----------
        file : str
            In `kernels/`.
        name : str
            Of the kernel in it.

        Raises
        ------
        BackendError
            If it does not build.
        """
        if name not in self._kernels:
            program = self.program(kernel_source(file), file, self.widths[file])
            self._kernels[name] = self.cl.Kernel(program, name)
        return self._kernels[name]

    def program(self, source: str, file: str, width: int | None = None) -> Any:
        """Build a program for the device.

        Parameters
        ----------
        source : str
        file : str
            Named in messages.
        width : int, optional
            Pixels of a REAL; None: the widest of the kernels.

        Raises
        ------
        BackendError
            With the compiler's log, file and line kept.
        """
        options = [f"-DWIDTH={width or self.width}"]
        try:
            with warnings.catch_warnings():
                # Compilers that only say what they did (Intel's) are not to be quoted to a user.
                warnings.simplefilter("ignore", self.cl.CompilerWarning)
                return self.cl.Program(self.context, source).build(options)
        except self.cl.Error as error:
            noise = ("clBuildProgram failed", "Build on <", "(options:")
            lines = [line for line in str(error).splitlines() if line.strip()]
            log = "\n".join(line for line in lines if not line.startswith(noise)) or str(error)
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
            raise failure(self.info, error, memory=True) from None
        except self.cl.Error as error:
            raise failure(self.info, error) from None


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
        self._inputs = (
            backend.constant(geometry_block(station)),
            backend.constant(groove_records(relief.grooves, station)),
            backend.constant(first),
            backend.constant(pieces),
            backend.constant(records),
            np.int32(len(records)),
            backend.constant(coefficients(relief.maps)),
        )
        per_row = self.stride * (12 * self._sub_rays + 1 + 4 * len(FUSIONS))
        largest = self.stride * 4 * max(self._sub_rays, len(FUSIONS))
        budget = min(backend.memory_bytes, _TILE_BYTES_MAX)
        super().__init__(
            station, min(budget // per_row, backend.device.max_mem_alloc_size // largest)
        )

    def failures(self) -> AbstractContextManager[None]:
        """See :meth:`OpenCLBackend.failures`."""
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
        b.kernel("trace.cl", "trace")(
            b.queue, (self.stride // b.widths["trace.cl"], rows), None,
            tile.light, tile.footprint, tile.irradiance, tile.lost,
            *self._inputs, np.int32(first_row),
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
            self._copy_home(out, buffer)
        self._copy_home(lost, tile.lost)

    def run_tile(self, tile: PlanarTile, what: str, station: Station, k: int, out: Image) -> None:
        """See :meth:`TiledLightMap.run_tile`."""
        b = self.backend
        grey = b.empty(4 * len(out) * tile.rows * self.stride)
        design = b.constant(design_block(station))
        for rows in self._slices(what, station, tile.rows):
            self._enqueue(tile, what, design, k, grey, rows)
            if rows.stop < tile.rows:
                b.queue.finish()
        self._copy_home(out, grey)

    def enqueue(self, tile: PlanarTile, what: str, design: Any, k: int, grey: Any) -> None:
        """Start a kernel on a tile; its planes go to the buffer `grey`.

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
        b = self.backend
        file, kernel = _KERNELS[what]
        more = [np.int32(tile.rows)] * (file == "sequence.cl") + [np.int32(k)] * (what == "image")
        b.kernel(file, kernel)(
            b.queue, (self.stride // b.widths[file], rows.stop - rows.start), None,
            grey, tile.light, tile.footprint, tile.irradiance, design,
            np.int32(self._sub_rays), np.int32(tile.first_row), *more,
            global_offset=(0, rows.start),
        )  # fmt: skip

    def _slices(self, what: str, station: Station, rows: int) -> Iterator[slice]:
        """Yield rows that take about a second together, so that Ctrl-C is answered."""
        if what not in ("mean", "fuse"):
            yield slice(0, rows)
            return
        on_gpu = self.backend.device.type & self.backend.cl.device_type.GPU
        work = self.stride * station.sequence.images * self._sub_rays
        work *= _NOISE_COST if station.sensor.noise else 1
        at_once = max(_AT_ONCE * (_GPU_SPEED if on_gpu else 1) // work, 1)
        for first in range(0, rows, at_once):
            yield slice(first, min(first + at_once, rows))

    def _copy_home(self, out: NDArray[Any], buffer: Any) -> None:
        """Copy planes (..., rows, stride) of a buffer to out (..., rows, N)."""
        b = self.backend
        if out.flags.c_contiguous and out.shape[-1] == self.stride:
            b.cl.enqueue_copy(b.queue, out, buffer)
            return
        padded = np.empty((*out.shape[:-1], self.stride), out.dtype)
        b.cl.enqueue_copy(b.queue, padded, buffer)
        out[...] = padded[..., : out.shape[-1]]
