"""One OpenCL device: which there are, and its queue, programs, buffers and launches."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import RLock
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec import cache
from gpuspec.errors import BackendError, DeviceError
from gpuspec.light import intel, pocl
from gpuspec.light.backend import DeviceInfo, Settings, chosen, failure
from gpuspec.light.sources import kernel_source

INSTALL = (
    "install your GPU's OpenCL driver or, for the CPU, pip install pocl-binary-distribution "
    '(Linux), pip install "gpuspec[intel]" (Linux, Windows), or apt install pocl-opencl-icd '
    "(Debian, Ubuntu)"
)
INTEL = "Intel(R) OpenCL"

VECTORS = (16, 8)
"""Pixels of a REAL where it is a vector, the first with AVX-512; rows are padded to whole ones."""

FILES = (
    "trace.cl", "listed.cl", "posed.cl", "posed_listed.cl", "sliced.cl", "refine.cl",
    "aspect.cl", "sequence.cl", "profiled.cl", "footprints.cl", "lookup.cl", "sweep.cl",
)  # fmt: skip

SINGLE = ("gather_pixels", "put_out")
"""Kernels whose work-items are single pixels, in files whose others are vectors."""

LAUNCH_SECONDS = 0.5
"""How long a launch is meant to last. Nothing stops one that has begun: Ctrl-C waits for it, and a
desktop's watchdog ends the driver after two seconds, or five."""

# Work of a kernel's first launch, in pixels times images of the mean: about that long on two slow
# cores. A launch shorter than meant lets the next be longer, by this factor at most; one longer
# lets it be shorter, down to this share: what takes so long is a driver that compiles as it starts.
_FIRST_WORK = 5e8
_GROWTH = 8.0
_LEAST = 0.01
# Share of it below which all the work there is takes no time worth knowing.
_SHORT = 1 / 64

# A pool has memory in sizes that are so much apart, and may keep so much of a device's that nobody
# uses now, whatever was asked for before.
_ROUNDED, _UNUSED = 1 / 8, 1 / 16

LOCAL_BYTES_MIN = 2048
"""Local memory that counting levels takes at least: one set of counters, and some to spare."""


def devices() -> list[Any]:
    """Return all OpenCL devices, GPUs first.

    Raises
    ------
    BackendError
        If pyopencl or every platform is missing.
    """
    cache.lend()
    pocl.compile_once()
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


def lack(device: Any) -> str:
    """Return what a device lacks to compute, as the end of a sentence; "" if nothing."""
    if not device.available:
        return "is not available: its driver names it, but lends it to nobody now"
    if not device.compiler_available:
        return "has no compiler: its driver runs programs that were built elsewhere alone"
    if device.local_mem_size < LOCAL_BYTES_MIN:
        return (
            f"has {device.local_mem_size:,} bytes of local memory, and counting levels takes "
            f"{LOCAL_BYTES_MIN:,}"
        )
    return ""


class OpenCLDevice:
    """One OpenCL device with its queue and kernels; any thread may use it.

    Parameters
    ----------
    device : str, optional
        Part of a device's name, or its number in `gpuspec devices`; None: the first GPU, else
        the first CPU.

    Raises
    ------
    BackendError
        No platform, no such device; `DeviceError` for one that does not open.
    """

    def __init__(self, device: str | None = None) -> None:
        found = devices()  # says what to install where pyopencl is missing
        import pyopencl as cl
        from pyopencl.tools import ImmediateAllocator, MemoryPool

        self.cl = cl
        self.number = chosen("opencl", [d.name for d in found], device)
        self.device = found[self.number]
        self.info = describe(self.device)
        lacking = lack(self.device)
        if lacking:
            raise DeviceError(f"opencl: {self.info.device} {lacking}.")
        self._lock = RLock()
        self._work: dict[str, float] = {}
        self.settle({})
        try:
            self.context = cl.Context([self.device])
            self.queue = cl.CommandQueue(self.context)
            # What was given back is taken again: a system gives fresh memory page by page.
            self._pool = MemoryPool(ImmediateAllocator(self.queue))
        except cl.Error as error:
            raise DeviceError(f"opencl: {self.info.device} does not open ({error}).") from None

    def settle(self, settings: Settings) -> None:
        """See :meth:`Backend.settle`; `widths` are the pixels of a REAL by kernel file."""
        self.widths: dict[str, int] = {**dict.fromkeys(FILES, 1), **settings.get("widths", {})}
        self._programs: dict[str, Any] = {}
        self._kernels: dict[tuple[str, str], Any] = {}

    @property
    def width(self) -> int:
        """The widest REAL of all kernels, of which rows hold a whole number."""
        return max(self.widths.values())

    def kernel(self, file: str, name: str) -> Any:
        """Return a kernel of `kernels/`, its file built when first asked for.

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
        with self._lock:
            if file not in self._programs:
                self._programs[file] = self.program(kernel_source(file), file, self.widths[file])
            if (file, name) not in self._kernels:
                self._kernels[file, name] = self.cl.Kernel(self._programs[file], name)
            return self._kernels[file, name]

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
        options = [
            f"-DWIDTH={width or self.width}", f"-DLOCAL_BYTES={self.device.local_mem_size}"
        ]  # fmt: skip
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
        """Copy an array to the device, read-only for kernels; an empty one becomes zeros."""
        return self._copied(values, self.cl.mem_flags.READ_ONLY)

    def counters(self, *shape: int) -> Any:
        """Reserve uints on the device that begin at 0."""
        return self._copied(np.zeros(shape, np.uint32), self.cl.mem_flags.READ_WRITE)

    def _copied(self, values: NDArray[Any], access: int) -> Any:
        values = np.ascontiguousarray(values if values.size else np.zeros(16, values.dtype))
        flags = access | self.cl.mem_flags.COPY_HOST_PTR
        return self.cl.Buffer(self.context, flags, hostbuf=values)

    def kept(self, values: NDArray[Any]) -> Any:
        """Copy an array to memory that counts as held, see :attr:`OpenCLBackend.held_bytes`."""
        buffer = self.empty(max(values.nbytes, 4))
        if values.size:
            self.cl.enqueue_copy(self.queue, buffer, np.ascontiguousarray(values))
        return buffer

    def empty(self, size: int) -> Any:
        """Reserve bytes on the device."""
        largest = self.device.max_mem_alloc_size
        if size > largest * (1 - _ROUNDED):  # the pool's next size may be too large
            return self.cl.Buffer(self.context, self.cl.mem_flags.READ_WRITE, size)
        unused = self._pool.managed_bytes - self._pool.active_bytes
        if unused > self.device.global_mem_size * _UNUSED:
            self.give_back()
        return self._pool.allocate(size)

    def give_back(self) -> None:
        """Give the driver back the memory that nobody uses now."""
        self._pool.free_held()

    def copy_home(
        self, out: NDArray[Any], buffer: Any, first: int = 0, *, wait: bool = True
    ) -> None:
        """Wait for a buffer, and fill a contiguous array with its bytes from `first` on.

        Parameters
        ----------
        out : ndarray
            Contiguous.
        buffer : Buffer
        first : int
            Byte of the buffer.
        wait : bool
            Whether to wait for it; else the array is filled when the queue is done.
        """
        self.cl.enqueue_copy(self.queue, out, buffer, src_offset=first, is_blocking=wait)

    def start(
        self,
        file: str,
        name: str,
        size: tuple[int, ...],
        *arguments: Any,
        offset: tuple[int, ...] | None = None,
        group: tuple[int, ...] | None = None,
    ) -> None:
        """Start a kernel, and do not wait for it.

        Parameters
        ----------
        file, name : str
            Of :meth:`kernel`.
        size : tuple of int
            Work-items.
        *arguments
            Buffers and NumPy numbers, in the kernel's order.
        offset : tuple of int, optional
            Number of the first work-item; None: 0.
        group : tuple of int, optional
            Work-items of a group; None: one, where they are vectors, for a CPU's driver gives each
            a stack of its own; else the driver's choice.
        """
        if group is None and self.widths[file] > 1 and name not in SINGLE:
            group = (1,) * len(size)
        with self._lock:  # a kernel holds its arguments until it is started, for all threads
            self.kernel(file, name)(self.queue, size, group, *arguments, global_offset=offset)

    def group(self, file: str, name: str, wanted: int) -> int:
        """Return how many work-items a group of a kernel may have, `wanted` at most.

        Other parameters as :meth:`kernel`.
        """
        most = self.kernel(file, name).get_work_group_info(
            self.cl.kernel_work_group_info.WORK_GROUP_SIZE, self.device
        )
        return max(min(wanted, int(most), *map(int, self.device.max_work_item_sizes[:2])), 1)

    def group_of_row(self, file: str, name: str, items: int) -> int:
        """Return the most work-items of a group that divide a row of `items`.

        Other parameters as :meth:`kernel`.
        """
        most = self.group(file, name, items)
        return next(size for size in range(most, 0, -1) if items % size == 0)

    def launches(
        self, name: str, work: Sequence[float] | NDArray[Any], most: int | None = None
    ) -> Iterator[slice]:
        """Yield rows that a launch of a kernel can do in about `LAUNCH_SECONDS`.

        Each slice is waited for and timed before the next, which is made longer or shorter by what
        it took: drivers do not say how fast a device is. One that is short for certain is not.

        Parameters
        ----------
        name : str
            Under which it is remembered how much work the kernel does at once.
        work : sequence of float
            Of each row, in whatever unit.
        most : int, optional
            Rows of a launch, at most.
        """
        done, every = 0.0, np.cumsum(work)
        first, rows = 0, len(every)
        while first < rows:
            at_once = self._work.get(name, _FIRST_WORK)
            last = int(np.searchsorted(every, done + at_once, "right"))
            last = min(max(last, first + 1), first + (most or rows), rows)
            begun = perf_counter()
            yield slice(first, last)
            if every[-1] < at_once * _SHORT:
                first, done = last, float(every[last - 1])
                continue
            self.queue.finish()
            seconds = max(perf_counter() - begun, 1e-9)
            given, done = float(every[last - 1]) - done, float(every[last - 1])
            # A launch that was short for want of work says nothing on how long one may be.
            if seconds > LAUNCH_SECONDS or given > at_once / 2:
                fitting = given * min(LAUNCH_SECONDS / seconds, _GROWTH)
                self._work[name] = max(fitting, _FIRST_WORK * _LEAST)
            first = last

    @contextmanager
    def failures(self) -> Iterator[None]:
        """Say which device failed, and what to do, where the driver only has a code."""
        try:
            yield
        except self.cl.MemoryError as error:
            raise failure(self.info, error, memory=True) from None
        except self.cl.Error as error:
            raise failure(self.info, error) from None
