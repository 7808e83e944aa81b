"""The Vulkan backend: compute shaders of `shaders/*.comp`, through wgpu.

Where a machine has no Vulkan but Metal or Direct3D 12, wgpu runs the same shaders there.
"""

from __future__ import annotations

import logging
import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.errors import BackendError, DeviceError
from gpuspec.light.backend import Backend, DeviceInfo, chosen, failure
from gpuspec.light.constants import GROUP, NO_PIXEL
from gpuspec.light.levels import Pixels
from gpuspec.light.light_map import FUSIONS, PLANES
from gpuspec.light.patterns import Pattern
from gpuspec.light.records import (
    coefficients,
    design_block,
    geometry_block,
    map_records,
    piece_records,
)
from gpuspec.light.sources import shader_source
from gpuspec.light.tiles import RayTile, ShaderLightMap, light_words
from gpuspec.part.maps import averaged
from gpuspec.part.marches import march_of
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

INSTALL_WGPU = "pip install wgpu"
INSTALL_DRIVER = (
    "install your GPU's Vulkan driver, or on Debian and Ubuntu the software driver: "
    "apt install mesa-vulkan-drivers libvulkan1"
)
_TILE_BYTES_MAX = 1 << 30
_GROUPS_MAX = 65535  # workgroups along an axis, in every implementation
_KINDS = ("DiscreteGPU", "IntegratedGPU", "CPU")
_GLSL = 450
_TRACE_BINDINGS = ("uniform",) * 2 + ("read-only-storage",) * 5 + ("storage",)
_IMAGE_BINDINGS = ("uniform",) * 2 + ("read-only-storage", "storage")


def adapters() -> list[Any]:
    """Return wgpu's adapters, the best first; see `preferred`.

    Raises
    ------
    BackendError
        If wgpu, the Vulkan loader or every driver is missing.
    """
    try:
        import wgpu
        import wgpu.backends.wgpu_native as native
    except (ImportError, OSError, RuntimeError) as error:
        raise BackendError(f"vulkan: wgpu cannot be imported ({error}); {INSTALL_WGPU}.") from None
    # Starting OpenGL drivers, too, would take longer than all the rest. The first choice in a
    # process counts; a later one, or one in a wgpu that cannot choose, is an error of no weight.
    with suppress(Exception):
        native.set_instance_extras(backends=["Vulkan", "Metal", "DX12"])
    try:
        with _runtime_folder():
            found = list(wgpu.gpu.enumerate_adapters_sync())
    except Exception as error:
        raise BackendError(f"vulkan: no adapter found ({error}); {INSTALL_DRIVER}.") from None
    order = preferred([adapter.info for adapter in found])
    if not order:
        raise BackendError(f"vulkan: no Vulkan loader or device found; {INSTALL_DRIVER}.")
    return [found[i] for i in order]


def preferred(infos: Sequence[Mapping[str, Any]]) -> list[int]:
    """Return the numbers of usable adapters, the best first.

    Those of Vulkan alone, if there are any, else of Metal or Direct3D 12, never of OpenGL; discrete
    GPUs before integrated ones, and these before CPUs.
    """
    usable = [i for i, info in enumerate(infos) if "OpenGL" not in info["backend_type"]]
    vulkan = [i for i in usable if infos[i]["backend_type"] == "Vulkan"]

    def rank(i: int) -> int:
        kind = infos[i]["adapter_type"]
        return _KINDS.index(kind) if kind in _KINDS else len(_KINDS)

    return sorted(vulkan or usable, key=rank)


def describe(info: Mapping[str, Any]) -> DeviceInfo:
    """Return what is recorded of an adapter."""
    import wgpu

    kind = info["backend_type"]
    native = kind == "Vulkan" and (info["description"] or info["vendor"])
    driver = native or f"{kind} through wgpu"
    return DeviceInfo("vulkan", info["device"].strip(), driver, f"{kind}, wgpu {wgpu.__version__}")


@contextmanager
def _runtime_folder() -> Iterator[None]:
    """Give Mesa the folder without which it complains on the terminal."""
    if os.environ.get("XDG_RUNTIME_DIR"):
        yield
        return
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        try:
            yield
        finally:
            del os.environ["XDG_RUNTIME_DIR"]


class VulkanBackend(Backend):
    """One device of wgpu with its pipelines.

    Parameters
    ----------
    device : str, optional
        Part of a device's name, or its number in `gpuspec devices`; None: the first.
    memory_bytes : int, optional
        Device memory one light map may take; None: 1 GiB. Larger parts are done in tiles, with
        the same result to the bit.

    Raises
    ------
    BackendError
        No wgpu, no driver, no such device, or a shader that does not compile.
    """

    def __init__(self, device: str | None = None, memory_bytes: int | None = None) -> None:
        found = adapters()  # says what to install where wgpu is missing
        self.number = chosen("vulkan", [a.info["device"] for a in found], device)
        adapter = found[self.number]
        import wgpu

        self.wgpu = wgpu
        self.info = describe(adapter.info)
        self.memory_bytes = memory_bytes or _TILE_BYTES_MAX
        self.limits = {name.replace("_", "-"): n for name, n in adapter.limits.items()}
        try:
            with _runtime_folder():
                self.device = adapter.request_device_sync(required_limits=adapter.limits)
        except Exception as error:
            raise DeviceError(f"vulkan: {self.info.device} does not open ({error}).") from None
        self._pipelines: dict[tuple[str, tuple[str, ...], Pattern | None], Any] = {}
        self._staging: Any = None
        self._turn = Lock()

    def pipeline(self, file: str, *defines: str, pattern: Pattern | None = None) -> Any:
        """Return the pipeline of a shader of `shaders/`, compiled when first asked for.

        Parameters
        ----------
        file : str
            In `shaders/`.
        *defines : str
            Words to define, e.g. ``"NOISE"`` or ``"SUB_RAYS 4"``.
        pattern : Pattern, optional
            Put in where the shader leaves room for one.

        Raises
        ------
        BackendError
            If it does not compile.
        """
        key = (file, defines, pattern)
        if key not in self._pipelines:
            given = (pattern.file, pattern.text) if pattern else None
            layout: tuple[str, ...] = _TRACE_BINDINGS if file == "trace.comp" else _IMAGE_BINDINGS
            layout += ("read-only-storage",) * ("LISTED" in defines)
            source = shader_source(file, _GLSL, defines, pattern=given)
            self._pipelines[key] = self.program(*source, layout)
        return self._pipelines[key]

    def program(self, source: str, names: tuple[str, ...], bindings: Sequence[str]) -> Any:
        """Compile a compute shader.

        Parameters
        ----------
        source : str
        names : tuple of str
            The files that its ``#line`` directives number.
        bindings : sequence of str
            What kind of buffer is at each binding: "uniform", "read-only-storage", "storage".

        Raises
        ------
        BackendError
            With the compiler's message, file and line kept.
        """
        logger = logging.getLogger("wgpu")  # of a failure it says less than the error
        was, logger.disabled = logger.disabled, True
        try:
            module = self.device.create_shader_module(label="compute", code=source)
            entries = [
                {
                    "binding": i,
                    "visibility": self.wgpu.ShaderStage.COMPUTE,
                    "buffer": {"type": kind},
                }
                for i, kind in enumerate(bindings)
            ]
            layout = self.device.create_bind_group_layout(entries=entries)
            return self.device.create_compute_pipeline(
                layout=self.device.create_pipeline_layout(bind_group_layouts=[layout]),
                compute={"module": module, "entry_point": "main"},
            )
        except self.wgpu.GPUError as error:
            message = located(str(error), source, names)
            raise BackendError(f"{names[0]} does not build with {self.info}:\n{message}") from None
        finally:
            logger.disabled = was

    def constant(self, values: NDArray[Any], uniform: bool = False) -> Any:
        """Copy an array to the device, read-only; an empty one becomes one zero.

        Parameters
        ----------
        values : ndarray
        uniform : bool
            Whether it is a uniform block, and not a storage buffer.
        """
        usage = self.wgpu.BufferUsage.UNIFORM if uniform else self.wgpu.BufferUsage.STORAGE
        values = np.ascontiguousarray(values if values.size else np.zeros(16, values.dtype))
        return self.device.create_buffer_with_data(data=values, usage=usage)

    def empty(self, size: int) -> Any:
        """Reserve bytes on the device."""
        usage = self.wgpu.BufferUsage.STORAGE | self.wgpu.BufferUsage.COPY_SRC
        return self.device.create_buffer(size=size, usage=usage)

    def enqueue(self, pipeline: Any, buffers: Sequence[Any], columns: int, rows: int) -> None:
        """Start a pipeline on columns x rows invocations.

        Parameters
        ----------
        pipeline : GPUComputePipeline
        buffers : sequence of GPUBuffer
            In the order of bindings.
        columns, rows : int
        """
        entries = [
            {"binding": i, "resource": {"buffer": buffer, "offset": 0, "size": buffer.size}}
            for i, buffer in enumerate(buffers)
        ]
        group = self.device.create_bind_group(
            layout=pipeline.get_bind_group_layout(0), entries=entries
        )
        encoder = self.device.create_command_encoder()
        work = encoder.begin_compute_pass()
        work.set_pipeline(pipeline)
        work.set_bind_group(0, group)
        work.dispatch_workgroups(-(-columns // GROUP), rows)
        work.end()
        self.device.queue.submit([encoder.finish()])

    def copy_home(self, out: NDArray[Any], buffer: Any) -> None:
        """Wait for a buffer of floats or uints, and copy its beginning home.

        Parameters
        ----------
        out : ndarray of float32 or of an integer type
            Written.
        buffer : GPUBuffer
        """
        size = out.size * 4
        with self._turn:
            staging, self._staging = self._staging, None  # one left mapped by Ctrl-C is lost
        if staging is None or staging.size < size:
            usage = self.wgpu.BufferUsage.MAP_READ | self.wgpu.BufferUsage.COPY_DST
            staging = self.device.create_buffer(size=size, usage=usage)
        encoder = self.device.create_command_encoder()
        encoder.copy_buffer_to_buffer(buffer, 0, staging, 0, size)
        self.device.queue.submit([encoder.finish()])
        staging.map_sync(self.wgpu.MapMode.READ, 0, size)
        kind = np.float32 if out.dtype == np.float32 else np.uint32
        values = np.frombuffer(staging.read_mapped(0, size, copy=False), kind)
        out[...] = values.reshape(out.shape)
        staging.unmap()
        self._staging = staging

    def traced(
        self, station: Station, relief: Relief, pixels: Pixels | None = None
    ) -> VulkanLightMap:
        """See :meth:`Backend.traced`."""
        with self.failures():
            return VulkanLightMap(self, station, relief, pixels)

    @contextmanager
    def failures(self) -> Iterator[None]:
        """Say which device failed, and what to do, where the driver only has a code."""
        try:
            yield
        except self.wgpu.GPUOutOfMemoryError as error:
            raise failure(self.info, error, memory=True) from None
        except self.wgpu.GPUError as error:
            raise failure(self.info, error) from None


_SPAN = re.compile(r"Error \{ kind: (.*?), meta: Span \{ start: (\d+), end: \d+ \} \}")
_LINE = re.compile(r"#line (\d+) (\d+)")


def located(message: str, source: str, names: tuple[str, ...]) -> str:
    """Return a message of wgpu's GLSL compiler with file and line for its offsets in bytes.

    Parameters
    ----------
    message : str
    source : str
        The text that was compiled.
    names : tuple of str
        Of the files by number, as :func:`gpuspec.light.sources.shader_source` returns them.
    """

    def place(found: re.Match[str]) -> str:
        before = source.encode()[: int(found[2])].decode(errors="ignore").split("\n")
        for back, line in enumerate(reversed(before)):
            directive = _LINE.match(line)
            if directive:
                return f"{names[int(directive[2])]}:{int(directive[1]) + back - 1}: {found[1]}"
        return found[0]

    spans = list(_SPAN.finditer(message))
    return "\n".join(place(span) for span in spans) if spans else message


_SHADERS = {
    "image": ("sequence.comp", "IMAGE"),
    "mean": ("sequence.comp", "MEAN"),
    "fuse": ("sequence.comp", "FUSE"),
    "closed_form": ("aspect.comp",),
    "lost": ("aspect.comp", "LOST"),
    "faulty": ("sequence.comp", "FAULTY"),
}


class VulkanLightMap(ShaderLightMap):
    """A light map in a storage buffer."""

    def __init__(
        self,
        backend: VulkanBackend,
        station: Station,
        relief: Relief,
        pixels: Pixels | None = None,
    ) -> None:
        super().__init__(station, pixels)
        self._backend = backend
        self._columns = self.grid[1]
        self._sub_rays = station.camera.sub_rays
        first, pieces = relief.blocks(station)
        records = map_records(relief.maps, station)
        self._maps = len(records)
        inputs = (
            piece_records(relief, station),
            first,
            pieces,
            records,
            coefficients(averaged(relief.maps, station)),
        )
        binding = min(
            backend.limits["max-storage-buffer-binding-size"], backend.limits["max-buffer-size"]
        )
        largest = max(values.nbytes for values in inputs)
        if largest > binding:
            raise BackendError(
                f"vulkan: the defects' {largest:,} bytes exceed the {binding:,} that "
                f"{backend.info.device} binds; use fewer or smaller defects and maps, or "
                f"--backend numpy."
            )
        self._inputs: tuple[Any, ...] = tuple(backend.constant(values) for values in inputs)
        march = march_of(station, relief)
        self._geometry = backend.constant(geometry_block(station, march), uniform=True)
        self._tracer = (
            *(("GROOVES",) if len(pieces) else ()),
            *(("MAPS",) if self._maps else ()),
            *("NEWTON_STEPS 0", "POSED_STEPS 0") * (station.part.surface == "orientation"),
            *("POSED",) * (station.posed or march is not None),
            *("SLICED",) * station.camera.sliced,
        )
        per_row = 4 * self._columns * (PLANES * self._sub_rays + 2 * len(FUSIONS))
        largest_row = 4 * self._columns * max(PLANES * self._sub_rays, len(FUSIONS))
        budget = min(backend.memory_bytes, _TILE_BYTES_MAX)
        self._listed: tuple[Any, ...] = ()
        if pixels is not None:
            numbers = self.listed()
            self._listed = (backend.constant(np.where(numbers == NO_PIXEL, 0, numbers)),)
        self.begin(min(budget // per_row, binding // largest_row, _GROUPS_MAX))

    def release(self) -> None:
        """See :meth:`LightMap.release`."""
        self._inputs = ()
        super().release()

    def failures(self) -> AbstractContextManager[None]:
        """See :meth:`VulkanBackend.failures`."""
        return self._backend.failures()

    def trace_tile(self, first_row: int, rows: int) -> RayTile:
        """See :meth:`TiledLightMap.trace_tile`."""
        b = self._backend
        rays = b.empty(4 * PLANES * rows * self._columns * self._sub_rays)
        tile = RayTile(first_row, rows, rays)
        across = ("ACROSS",) * (self.pattern is not None)
        b.enqueue(
            b.pipeline("trace.comp", *self._tracer, *across, *self._list),
            (self._geometry, self._call(tile, 0), *self._inputs, rays, *self._listed),
            self._columns, rows,
        )  # fmt: skip
        return tile

    def read_rays(self, tile: RayTile, out: NDArray[np.float32]) -> None:
        """See :meth:`ShaderLightMap.read_rays`."""
        self._backend.copy_home(out, tile.rays)

    def run_tile(self, tile: RayTile, what: str, station: Station, k: int, out: Image) -> None:
        """See :meth:`TiledLightMap.run_tile`."""
        b = self._backend
        grey = b.empty(4 * out.size)
        self.enqueue(tile, what, station, k, grey)
        b.copy_home(out, grey)

    def enqueue(self, tile: RayTile, what: str, station: Station, k: int, grey: Any) -> None:
        """Start a shader on a tile; its planes go to the buffer `grey`.

        Parameters
        ----------
        tile : RayTile
        what : str
            See :meth:`TiledLightMap.run_tile`.
        station : Station
        k : int
            Number of the image.
        grey : GPUBuffer
        """
        b = self._backend
        block = design_block(station)
        if self.pattern:
            block = np.concatenate([block, geometry_block(station)])
        design = b.constant(block, uniform=True)
        b.enqueue(
            self._pipeline(what, station),
            (design, self._call(tile, k), tile.rays, grey, *self._listed),
            self._columns, tile.rows,
        )  # fmt: skip

    def build(self, what: str) -> None:
        """See :meth:`ShaderLightMap.build`."""
        self._pipeline(what, self.station)

    @property
    def _list(self) -> tuple[str, ...]:
        return ("LISTED",) * (self.pixels is not None)

    def _pipeline(self, what: str, station: Station) -> Any:
        light = light_words(self.pattern, what, station)
        one = ("ONE_RAY",) * (self._sub_rays == 1)
        noise = ("NOISE",) * station.sensor.noise
        defines = (*_SHADERS[what][1:], *one, *noise, *light, *self._list)
        return self._backend.pipeline(_SHADERS[what][0], *defines, pattern=self.pattern)

    def _call(self, tile: RayTile, k: int) -> Any:
        """What changes from call to call, as the shaders' uniform block."""
        size = [self._columns, tile.rows, tile.first_row, self._sub_rays]
        more = [k, self._maps, self.station.shape[1], 0]
        return self._backend.constant(np.array([size, more], np.int32), True)
