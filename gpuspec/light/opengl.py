"""The OpenGL backend: fragment shaders of `shaders/` on a GPU, or on a CPU through Mesa.

An OpenGL context works in one thread at a time: use a backend and its light maps in one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from itertools import count
from threading import RLock
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image
from gpuspec.errors import BackendError, DeviceError
from gpuspec.light.backend import Backend, DeviceInfo, chosen, failure
from gpuspec.light.constants import NO_PIXEL
from gpuspec.light.levels import Pixels
from gpuspec.light.light_map import FUSIONS
from gpuspec.light.patterns import Pattern
from gpuspec.light.records import (
    coefficients,
    design_block,
    geometry_block,
    map_records,
    piece_records,
)
from gpuspec.light.sources import named_files, numbered_lines, shader_source
from gpuspec.light.tiles import RayTile, ShaderLightMap, light_words
from gpuspec.part.maps import averaged
from gpuspec.part.marches import march_of
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

INSTALL = (
    "an OpenGL 3.3 driver of your GPU, or Mesa's software driver "
    "(Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri)"
)
_TILE_BYTES_MAX = 1 << 30
LIST_WIDTH = 4096  # a power of two, so that % and / are cheap


def devices() -> list[DeviceInfo]:
    """Return all OpenGL devices.

    Raises
    ------
    BackendError
        If moderngl is missing or no context can be made.
    """
    found: list[DeviceInfo] = []
    for number in count():
        try:
            context = _context(number)
        except BackendError:
            if number == 0:
                raise
            return found
        found.append(_describe(context))
        context.release()
    return found


def _context(number: int) -> Any:
    """Open a context without a window: EGL's, which needs no display, else the platform's own."""
    try:
        import moderngl
    except ImportError as error:
        raise BackendError(
            f'opengl: moderngl cannot be imported ({error}); pip install "gpuspec[opengl]".'
        ) from None
    reasons = []
    ways: list[dict[str, Any]] = [{"backend": "egl", "device_index": number}]
    for way in ways + [{}] * (number == 0):
        try:
            context = moderngl.create_context(require=330, standalone=True, **way)
        except Exception as error:  # each platform's loader raises its own
            reasons.append(f"{way.get('backend', 'default')}: {error}")
        else:
            context.gc_mode = "context_gc"
            return context
    raise BackendError(
        f"opengl: no context of OpenGL 3.3 can be made ({'; '.join(reasons)}); install {INSTALL}."
    )


def _describe(context: Any) -> DeviceInfo:
    """Return what is recorded of a device."""
    info = context.info
    return DeviceInfo("opengl", info["GL_RENDERER"], info["GL_VENDOR"], info["GL_VERSION"])


class OpenGLBackend(Backend):
    """One OpenGL context with its programs; threads take turns.

    Parameters
    ----------
    device : str, optional
        Part of a device's name, or its number in `gpuspec devices`; None: the first.
    memory_bytes : int, optional
        Device memory one light map may take; None: 1 GiB. Larger parts are done in tiles, with
        the same result to the bit.
    texture_columns : int, optional
        Width from which on an image's rows wrap; None: the longest side of a texture.

    Raises
    ------
    BackendError
        No moderngl, no OpenGL 3.3, no float targets or no such device.
    """

    def __init__(
        self,
        device: str | None = None,
        memory_bytes: int | None = None,
        texture_columns: int | None = None,
    ) -> None:
        self.number = _chosen(device)
        self.context = _context(self.number)  # says what to install where moderngl is missing
        import moderngl

        self.gl = moderngl
        self._entered = False
        self._turn = RLock()
        finalize(self, self.context.release)
        self.info = _describe(self.context)
        self.memory_bytes = memory_bytes or _TILE_BYTES_MAX
        limits = self.context.info
        self.texture_size = min(limits["GL_MAX_TEXTURE_SIZE"], *limits["GL_MAX_VIEWPORT_DIMS"])
        self.texture_columns = min(texture_columns or self.texture_size, self.texture_size)
        self._programs: dict[tuple[str, tuple[str, ...], Pattern | None], tuple[Any, Any]] = {}
        with self.failures():
            try:
                self.context.framebuffer([self.target((1, 1), 4)])
            except moderngl.Error as error:
                raise DeviceError(
                    f"opengl: {self.info.device} cannot draw into float targets ({error}); "
                    f"install {INSTALL}."
                ) from None

    def program(self, file: str, *defines: str, pattern: Pattern | None = None) -> tuple[Any, Any]:
        """Return a program of a fragment shader of `shaders/` and its vertex array.

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
            If it does not build, with the compiler's log, file and line kept.
        """
        key = file, defines, pattern
        if key not in self._programs:
            given = (pattern.file, pattern.text) if pattern else None
            self._programs[key] = self.build(*shader_source(file, 330, defines, pattern=given))
        return self._programs[key]

    def build(self, text: str, names: tuple[str, ...]) -> tuple[Any, Any]:
        """Build a program of a fragment shader's text.

        Parameters
        ----------
        text : str
            As :func:`gpuspec.light.sources.shader_source` returns it.
        names : tuple of str
            Its files by their number.

        Raises
        ------
        BackendError
            If it does not build, with the compiler's log, file and line kept.
        """
        vertex, _ = shader_source("fullscreen.vert", 330)
        with self._current():
            try:
                program = self.context.program(
                    vertex_shader=vertex, fragment_shader=numbered_lines(text)
                )
            except self.gl.Error as error:
                log = named_files(str(error), names)
                raise BackendError(f"{names[0]} does not build with {self.info}:\n{log}") from None
            return program, self.context.vertex_array(program, [])

    def target(self, size: tuple[int, int], components: int, dtype: str = "f4") -> Any:
        """Reserve a texture on the device.

        Parameters
        ----------
        size : tuple of int
            Columns and rows.
        components : int
            1 to 4 a pixel.
        dtype : str
            As moderngl names it.
        """
        return self.context.texture(size, components, dtype=dtype)

    def listed(self, values: NDArray[Any]) -> Any:
        """Copy rows of an array to a texture, ``LIST_WIDTH`` a line.

        Raises
        ------
        BackendError
            If they do not fit a texture.
        """
        length = -(-max(len(values), 1) // LIST_WIDTH)
        if max(length, LIST_WIDTH) > self.texture_size:
            raise BackendError(
                f"opengl: {len(values):,} values of relief do not fit a texture of "
                f"{self.info.device}, {self.texture_size} on a side; use --backend opencl."
            )
        padded = np.zeros((length * LIST_WIDTH, *values.shape[1:]), values.dtype)
        padded[: len(values)] = values
        components = values.shape[1] if values.ndim > 1 else 1
        dtype = f"{values.dtype.kind}4"
        return self.context.texture((LIST_WIDTH, length), components, padded, dtype=dtype)

    def draw(
        self,
        program: tuple[Any, Any],
        targets: list[Any],
        block: NDArray[np.float32],
        textures: dict[str, Any],
        **uniforms: int,
    ) -> None:
        """Start a fragment shader over whole targets.

        Parameters
        ----------
        program : tuple
            Of :meth:`program`.
        targets : list of texture
            All of one size.
        block : ndarray
            The shader's uniform block.
        textures, uniforms
            By their names in the shader; those it has no use for are passed over.
        """
        words, array = program
        framebuffer = self.context.framebuffer(targets)
        buffer = self.context.buffer(block)
        buffer.bind_to_uniform_block(0)
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            uniforms[name] = unit
        for name, value in uniforms.items():
            if name in words:
                words[name] = value
        framebuffer.use()
        array.render(self.gl.TRIANGLES, vertices=3)

    def traced(
        self, station: Station, relief: Relief, pixels: Pixels | None = None
    ) -> OpenGLLightMap:
        """See :meth:`Backend.traced`."""
        with self.failures():
            return OpenGLLightMap(self, station, relief, pixels)

    @contextmanager
    def _current(self) -> Iterator[None]:
        """Make the context current. A second time within would leave none current after it."""
        with self._turn:  # a context is current in one thread at a time
            if self._entered:
                yield
                return
            with self.context:
                self._entered = True
                try:
                    yield
                finally:
                    self._entered = False

    @contextmanager
    def failures(self) -> Iterator[None]:
        """Make the context current, free what is no longer used, say which device failed."""
        with self._current():
            self.context.gc()
            try:
                yield
            except self.gl.Error as error:
                raise failure(self.info, error) from None
            code = self.context.error
            if code != "GL_NO_ERROR":
                raise failure(self.info, code, memory=code == "GL_OUT_OF_MEMORY")


def _chosen(wanted: str | None) -> int:
    """Return the number of the device asked for."""
    names = [] if wanted is None else [info.device for info in devices()]
    return chosen("opengl", names, wanted)


_SHADERS = {
    "image": ("sequence.frag", "IMAGE"),
    "mean": ("sequence.frag", "MEAN"),
    "fuse": ("sequence.frag", "FUSE"),
    "closed_form": ("aspect.frag",),
    "lost": ("aspect.frag", "LOST"),
    "faulty": ("sequence.frag", "FAULTY"),
}


class OpenGLLightMap(ShaderLightMap):
    """A light map in float textures; rows wider than a texture wrap (`shaders/texels.glsl`)."""

    def __init__(
        self,
        backend: OpenGLBackend,
        station: Station,
        relief: Relief,
        pixels: Pixels | None = None,
    ) -> None:
        super().__init__(station, pixels)
        self._backend = backend
        columns = self.grid[1]
        self._wraps = -(-columns // backend.texture_columns)
        self._width = -(-columns // self._wraps)
        self._sub_rays = station.camera.sub_rays
        first, pieces = relief.blocks(station)
        records = map_records(relief.maps, station)
        self._map_count = len(records)
        march = march_of(station, relief)
        self._geometry = geometry_block(station, march)
        self._tracer = (
            *("GROOVES",) * (len(pieces) > 0),
            *("MAPS",) * (len(records) > 0),
            *("NEWTON_STEPS 0", "POSED_STEPS 0") * (station.part.surface == "orientation"),
            *("POSED",) * (station.posed or march is not None),
            *("SLICED",) * station.camera.sliced,
        )
        self._lists = {
            "grooves": backend.listed(piece_records(relief, station).reshape(-1, 4)),
            "block_first": backend.listed(first),
            "pieces": backend.listed(pieces),
            "maps": backend.listed(records.reshape(-1, 4)),
            "coefficients": backend.listed(coefficients(averaged(relief.maps, station))),
        }
        self._listed = {}
        if pixels is not None:
            numbers = self.listed().ravel()
            known = np.where(numbers == NO_PIXEL, 0, numbers).astype(np.int32)
            self._listed = {"pixels": backend.listed(known)}
        per_row = self._width * self._wraps * (16 * self._sub_rays + 1 + 4 * len(FUSIONS))
        budget = min(backend.memory_bytes, _TILE_BYTES_MAX)
        longest = backend.texture_size // (self._wraps * self._sub_rays)
        self.begin(min(budget // per_row, longest))

    def release(self) -> None:
        """See :meth:`LightMap.release`."""
        self._lists = {}
        super().release()
        b = self._backend
        with self.failures():  # the context holds what was drawn last
            b.context.framebuffer([b.target((1, 1), 1)]).use()
            b.context.gc()

    def failures(self) -> AbstractContextManager[None]:
        """See :meth:`OpenGLBackend.failures`."""
        return self._backend.failures()

    def trace_tile(self, first_row: int, rows: int) -> RayTile:
        """See :meth:`TiledLightMap.trace_tile`."""
        b = self._backend
        b.context.gc()
        tile = RayTile(first_row, rows, b.target(self._size(rows, self._sub_rays), 4))
        across = ("ACROSS",) * (self.pattern is not None)
        program = b.program("trace.frag", *self._defines(), *self._tracer, *across)
        b.draw(
            program, [tile.rays], self._geometry, self._lists | self._listed,
            **self._place(tile), width=self._width, map_count=self._map_count,
        )  # fmt: skip
        return tile

    def read_rays(self, tile: RayTile, out: NDArray[np.float32]) -> None:
        """See :meth:`ShaderLightMap.read_rays`."""
        self._copy_home(out, tile.rays)

    def run_tile(self, tile: RayTile, what: str, station: Station, k: int, out: Image) -> None:
        """See :meth:`TiledLightMap.run_tile`."""
        grey = [self._backend.target(self._size(tile.rows), 1) for _ in out]
        self.draw(tile, what, station, k, grey)
        for plane, texture in zip(out, grey, strict=True):
            self._copy_home(plane, texture)

    def draw(self, tile: RayTile, what: str, station: Station, k: int, targets: list[Any]) -> None:
        """Start a shader on a tile; its planes go to the targets.

        Parameters
        ----------
        tile : Tile
        what : str
            See :meth:`TiledLightMap.run_tile`.
        station : Station
        k : int
            Number of the image.
        targets : list of Texture
        """
        block = design_block(station)
        if self.pattern:
            block = np.concatenate([block, self._geometry])
        program = self._program(what, station)
        place = self._place(tile)
        textures = {"rays": tile.rays} | self._listed
        self._backend.draw(program, targets, block, textures, **place, k=k)

    def build(self, what: str) -> None:
        """See :meth:`ShaderLightMap.build`."""
        with self.failures():
            self._program(what, self.station)

    def _program(self, what: str, station: Station) -> tuple[Any, Any]:
        noise = ("NOISE",) * station.sensor.noise
        light = light_words(self.pattern, what, station)
        defines = (*_SHADERS[what][1:], *self._defines(), *noise, *light)
        return self._backend.program(_SHADERS[what][0], *defines, pattern=self.pattern)

    def _defines(self) -> tuple[str, ...]:
        """What the compiler must know to leave loops and divisions out."""
        listed = ("LISTED",) * (self.pixels is not None)
        one = ("ONE_RAY",) * (self._sub_rays == 1)
        return f"WRAPS {self._wraps}", f"LIST_WIDTH {LIST_WIDTH}", *one, *listed

    def _place(self, tile: RayTile) -> dict[str, int]:
        return {
            "first_row": tile.first_row, "rows": tile.rows, "sub_rays": self._sub_rays,
            "line_length": self.grid[1], "image_columns": self.station.shape[1],
        }  # fmt: skip

    def _size(self, rows: int, planes: int = 1) -> tuple[int, int]:
        """Width and height of a texture of so many planes of rows."""
        return self._width, rows * self._wraps * planes

    def _copy_home(self, out: NDArray[Any], texture: Any) -> None:
        """Copy a texture's planes to out (..., rows, N), of four components (..., rows, N, 4)."""
        columns = self.grid[1]
        across = -1 if texture.components == 1 else -2
        if out.flags.c_contiguous and self._width * self._wraps == columns:
            texture.read_into(out, alignment=1)
            return
        shape = list(out.shape)
        shape[across] = self._width * self._wraps
        padded = np.empty(shape, out.dtype)
        texture.read_into(padded, alignment=1)
        out[...] = padded[..., :columns] if across == -1 else padded[..., :columns, :]
