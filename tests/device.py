"""One device function at a time: a program of a few lines that calls it on many inputs.

Inputs are declared as the function takes them: "REAL x" differs from pixel to pixel, "float cx"
and "float4 tunnel" are shared by the eight pixels that a CPU's REAL holds. A test body knows no
more than that, so it runs on every device of `DEVICES`, whatever its language and width.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec.opencl import OpenCLBackend
from gpuspec.sources import resolved

LANES = 8
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
            Files of `kernels/` after `portable.h`, in the order they need.
        code : str
            Statements, e.g. ``Surface s = crown(x, y, cx, cy);``.
        inputs : mapping of str to array_like
            Type and name to values: "REAL x" and "COUNTER word" (n, 8), "float cx" (n,),
            "float4 tunnel" (n, 4).
        outputs : sequence of str
            Expressions of type REAL, or "COUNTER " and one of type COUNTER.

        Returns
        -------
        tuple of ndarray, shape (n, 8)
            float32, or uint32.
        """
        b = self.backend
        parameters, load, store, arguments, count = [], [], [], [], 0
        for declared, values in inputs.items():
            kind, name = declared.split()
            dtype = np.uint32 if kind == "COUNTER" else np.float32
            array = np.ascontiguousarray(values, dtype)
            count = len(array)
            assert array.shape == (count, *_SHAPES[kind]), (declared, array.shape)
            element = "uint" if kind == "COUNTER" else "float"
            parameters.append(f"__global const {element} *{name}_")
            load.append(f"{kind} {name} = {_LOADS[kind].format(name=name)};")
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
            *(f'#include "{header}"' for header in headers),
            f"__kernel void check({', '.join(parameters)}) {{",
            f"size_t at = get_global_id(0) * WIDTH, group = at / {LANES};",
            *load, code, *store, "}",
        ]  # fmt: skip
        source = resolved("\n".join(lines), "tests/device.py")
        for old, new in self.edits:
            if source.count(old) != 1:
                raise ValueError(f"{old!r} is {source.count(old)} times in the source, not once")
            source = source.replace(old, new)
        kernel = b.cl.Kernel(b.program(source, " ".join(headers)), "check")
        kernel(b.queue, (count * LANES // b.width,), None, *arguments)
        for result, buffer in zip(results, arguments[len(inputs) :], strict=True):
            b.cl.enqueue_copy(b.queue, result, buffer)
        return tuple(results)


_SHAPES = {"REAL": (LANES,), "COUNTER": (LANES,), "float": (), "float4": (4,)}
_LOADS = {
    "REAL": "*(__global const REAL *)({name}_ + at)",
    "COUNTER": "*(__global const COUNTER *)({name}_ + at)",
    "float": "{name}_[group]",
    "float4": "vload4(group, {name}_)",
}


def open_backend(name: str) -> OpenCLBackend:
    """Return the device's backend; "opencl-scalar" is a GPU's width of REAL on any device."""
    backend = OpenCLBackend()
    if name == "opencl-scalar":
        backend.width = 1
    return backend


DEVICES = ("opencl", "opencl-scalar")
