"""One device function at a time: a program of a few lines that calls it on many inputs.

Inputs are declared as the function takes them: "REAL x" differs from pixel to pixel, "float cx"
and "Geometry g" are shared by the pixels that the widest REAL holds. A test body knows no more
than that, so it runs on every device of `DEVICES`, whatever its language and width.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.backend import Backend
from gpuspec.light.constants import GROUP
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.opengl import LIST_WIDTH, OpenGLBackend
from gpuspec.light.sources import resolved, resolved_shader, structs
from gpuspec.light.vulkan import VulkanBackend

LANES = 16
"""Pixels that share the inputs declared `float`: the widest REAL there is."""

Values = Mapping[str, Any]
Outputs = tuple[NDArray[Any], ...]


class Device(Protocol):
    """Where device functions run."""

    def call(
        self, headers: Sequence[str], code: str, inputs: Values, outputs: Sequence[str]
    ) -> Outputs: ...


@dataclass(frozen=True)
class OpenCLDevice:
    """Device functions as OpenCL C.

    Attributes
    ----------
    backend : OpenCLBackend
        Its `width` is that of REAL.
    edits : tuple of (str, str)
        Replacements in the source, each to be found there: how a test is shown to be able to fail.
    """

    backend: OpenCLBackend
    edits: tuple[tuple[str, str], ...] = ()

    def call(
        self, headers: Sequence[str], code: str, inputs: Values, outputs: Sequence[str]
    ) -> Outputs:
        """Run `code` on every input and return the values of expressions.

        Parameters
        ----------
        headers : sequence of str
            Files of `kernels/` after `portable.h`, in the order they need; or text that stands
            between them.
        code : str
            Statements, e.g. ``Surface s = crown(x, y, cx, cy);``.
        inputs : mapping of str to array_like
            Type and name to values: "REAL x" and "COUNTER word" (n, LANES), "float cx" (n,),
            "Geometry g" and the other structs of `station.h` (n, members).
        outputs : sequence of str
            Expressions of type REAL, or "COUNTER " and one of type COUNTER.

        Returns
        -------
        tuple of ndarray, shape (n, LANES)
            float32, or uint32.
        """
        b = self.backend
        parameters, load, store, arguments, count = [], [], [], [], 0
        for declared, values in inputs.items():
            kind, name = declared.split()
            array = _checked(declared, values)
            count = len(array)
            element = "uint" if kind == "COUNTER" else "float"
            parameters.append(f"__global const {element} *{name}_")
            if kind in _PER_PIXEL:
                load.append(f"{kind} {name} = *(__global const {kind} *)({name}_ + at);")
            else:
                load.append(_shared(declared, "{name}_[{index}]", "group"))
            arguments.append(b.constant(array))
        results = []
        for number, expression in enumerate(outputs):
            words = expression.startswith("COUNTER ")
            element, kind = ("uint", "COUNTER") if words else ("float", "REAL")
            parameters.append(f"__global {element} *out{number}")
            value = expression.removeprefix("COUNTER ")
            store.append(f"*(__global {kind} *)(out{number} + at) = {value};")
            results.append(np.empty((count, LANES), np.uint32 if words else np.float32))
            arguments.append(b.empty(results[-1].nbytes))
        lines = [
            '#include "portable.h"',
            *_included(headers),
            f"__kernel void check({', '.join(parameters)}) {{",
            f"size_t at = get_global_id(0) * WIDTH, group = at / {LANES};",
            *load, code, *store, "}",
        ]  # fmt: skip
        source = edited(resolved("\n".join(lines), "tests/device.py"), self.edits)
        kernel = b.cl.Kernel(b.program(source, "tests/device.py"), "check")
        kernel(b.queue, (count * LANES // b.width,), None, *arguments)
        for result, buffer in zip(results, arguments[len(inputs) :], strict=True):
            b.cl.enqueue_copy(b.queue, result, buffer)
        return tuple(results)


_TARGETS = 8
"""Targets that a fragment shader of OpenGL 3.3 can draw into."""

_PER_PIXEL = ("REAL", "COUNTER")


def _included(headers: Sequence[str]) -> list[str]:
    """Return lines that include headers, or are what stands between them."""
    return [f'#include "{text}"' if text.endswith(".h") else text for text in headers]


def _checked(declared: str, values: Any) -> NDArray[Any]:
    """Return an input's values as the device takes them, their shape as declared."""
    kind, _ = declared.split()
    shape = {"float": (), **dict.fromkeys(_PER_PIXEL, (LANES,))}.get(kind)
    shape = (len(structs()[kind]),) if shape is None else shape
    array = np.ascontiguousarray(values, np.uint32 if kind == "COUNTER" else np.float32)
    assert array.shape == (len(array), *shape), (declared, array.shape)
    return array


def _shared(declared: str, fetch: str, group: str) -> str:
    """Return code that loads a float or, member by member, a struct of `kernels/station.h`."""
    kind, name = declared.split()
    if kind == "float":
        return f"float {name} = {fetch.format(name=name, index=group)};"
    members = structs()[kind]
    loads = [f"{kind} {name};"]
    for number, member in enumerate(members):
        value = fetch.format(name=name, index=f"{group} * {len(members)} + {number}")
        loads.append(f"{name}.{member} = {value};")
    return " ".join(loads)


def edited(source: str, edits: tuple[tuple[str, str], ...]) -> str:
    """Return the source with replacements, each to be found there once."""
    for old, new in edits:
        if source.count(old) != 1:
            raise ValueError(f"{old!r} is {source.count(old)} times in the source, not once")
        source = source.replace(old, new)
    return source


@dataclass(frozen=True)
class OpenGLDevice:
    """Device functions as GLSL 330: a fragment per input, inputs and outputs in textures.

    Attributes
    ----------
    backend : OpenGLBackend
    edits : tuple of (str, str)
        As those of `OpenCLDevice`.
    """

    backend: OpenGLBackend
    edits: tuple[tuple[str, str], ...] = ()

    def call(
        self, headers: Sequence[str], code: str, inputs: Values, outputs: Sequence[str]
    ) -> Outputs:
        """See :meth:`OpenCLDevice.call`."""
        b = self.backend
        if len(outputs) > _TARGETS:
            head = self.call(headers, code, inputs, outputs[:_TARGETS])
            return head + self.call(headers, code, inputs, outputs[_TARGETS:])
        count = len(next(iter(inputs.values())))
        size = LIST_WIDTH, -(-count * LANES // LIST_WIDTH)
        with b.failures():
            uniforms, load, store, textures, targets = [], [], [], {}, []
            for declared, values in inputs.items():
                kind, name = declared.split()
                words = kind == "COUNTER"
                textures[f"{name}_"] = b.listed(_checked(declared, values).ravel())
                uniforms.append(f"uniform {'usampler2D' if words else 'sampler2D'} {name}_;")
                if kind in _PER_PIXEL:
                    load.append(f"{kind} {name} = ENTRY({name}_, at).x;")
                else:
                    fetch = "ENTRY({name}_, {index}).x"
                    load.append(_shared(declared, fetch, f"at / {LANES}"))
            for number, expression in enumerate(outputs):
                words = expression.startswith("COUNTER ")
                kind, dtype = ("COUNTER", "u4") if words else ("REAL", "f4")
                uniforms.append(f"layout(location = {number}) out {kind} out{number};")
                store.append(f"out{number} = {expression.removeprefix('COUNTER ')};")
                targets.append(b.target(size, 1, dtype))
            lines = [
                '#include "portable.h"',
                *_included(headers),
                f"#define ENTRY(list, i) texelFetch(list, ivec2((i) % {LIST_WIDTH}, "
                f"(i) / {LIST_WIDTH}), 0)",
                *uniforms,
                "void main() {",
                f"int at = int(gl_FragCoord.x) + {LIST_WIDTH} * int(gl_FragCoord.y);",
                *load, code, *store, "}",
            ]  # fmt: skip
            source, names = resolved_shader("\n".join(lines), "tests/device.py", 330)
            program = b.build(edited(source, self.edits), names)
            b.draw(program, targets, np.zeros(4, np.float32), textures)
            return tuple(
                np.frombuffer(target.read(), np.uint32 if target.dtype == "u4" else np.float32)
                .ravel()[: count * LANES]
                .reshape(count, LANES)
                for target in targets
            )


@dataclass(frozen=True)
class VulkanDevice:
    """Device functions as GLSL 450: an invocation per input, inputs and outputs in buffers.

    Attributes
    ----------
    backend : VulkanBackend
    edits : tuple of (str, str)
        As those of `OpenCLDevice`.
    """

    backend: VulkanBackend
    edits: tuple[tuple[str, str], ...] = ()

    def call(
        self, headers: Sequence[str], code: str, inputs: Values, outputs: Sequence[str]
    ) -> Outputs:
        """See :meth:`OpenCLDevice.call`."""
        b = self.backend
        declarations, load, store, buffers, kinds, results = [], [], [], [], [], []

        def declare(name: str, element: str, access: str) -> None:
            binding = f"layout(std430, set = 0, binding = {len(buffers)}) {access} buffer"
            declarations.append(f"{binding} Buffer{len(buffers)} {{ {element} {name}[]; }};")
            kinds.append("read-only-storage" if access else "storage")

        for declared, values in inputs.items():
            kind, name = declared.split()
            array = _checked(declared, values)
            count = len(array)
            declare(f"{name}_", kind if kind in _PER_PIXEL else "float", "readonly")
            if kind in _PER_PIXEL:
                load.append(f"{kind} {name} = {name}_[at];")
            else:
                load.append(_shared(declared, "{name}_[{index}]", f"at / {LANES}"))
            buffers.append(b.constant(array))
        for number, expression in enumerate(outputs):
            words = expression.startswith("COUNTER ")
            declare(f"out{number}", "COUNTER" if words else "REAL", "")
            store.append(f"out{number}[at] = {expression.removeprefix('COUNTER ')};")
            results.append(np.empty((count, LANES), np.uint32 if words else np.float32))
            buffers.append(b.empty(results[-1].nbytes))
        lines = [
            '#include "portable.h"',
            *_included(headers),
            *declarations,
            f"layout(local_size_x = {GROUP}) in;",
            "void main() {",
            f"int at = int(gl_GlobalInvocationID.x + {GROUP}u * gl_NumWorkGroups.x "
            "* gl_GlobalInvocationID.y);",
            f"if (at >= {count * LANES}) return;",
            *load, code, *store, "}",
        ]  # fmt: skip
        source, names = resolved_shader("\n".join(lines), "tests/device.py", 450)
        pipeline = b.program(edited(source, self.edits), names, kinds)
        columns = min(count * LANES, 1 << 20)
        b.enqueue(pipeline, buffers, columns, -(-count * LANES // columns))
        for result, buffer in zip(results, buffers[len(inputs) :], strict=True):
            b.copy_home(result, buffer)
        return tuple(results)


def open_backend(name: str) -> Backend:
    """Return the device's backend; "opencl-scalar" is a GPU's width of REAL on any device."""
    if name == "opengl":
        return OpenGLBackend()
    if name == "vulkan":
        return VulkanBackend()
    backend = OpenCLBackend()
    if name == "opencl-scalar":
        backend.settle({"widths": {}})
    return backend


def open_device(name: str) -> Device:
    """Return one of `DEVICES`."""
    backend = open_backend(name)
    if isinstance(backend, OpenGLBackend):
        return OpenGLDevice(backend)
    if isinstance(backend, VulkanBackend):
        return VulkanDevice(backend)
    assert isinstance(backend, OpenCLBackend)
    return OpenCLDevice(backend)


DEVICES = ("opencl", "opencl-scalar", "opengl", "vulkan")
