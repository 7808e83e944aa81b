"""How fast a device is: what a run and a sweep are made of, at four megapixels.

Times are the shortest of some. The copy moves one light coordinate per pixel to another place in
the same memory: what the machine can move, in whose multiples devices are compared.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from gpuspec.light.backend import Backend
from gpuspec.light.light_map import LightMap
from gpuspec.light.records import design_block
from gpuspec.station.station import Station

Run = Callable[[], object]
Steps = tuple[Run, Run, Run, Callable[[str, Station], Run]]
"""What finishes, copies, traces, and starts what makes images of a station."""

COPY, TRACE, CLOSED_FORM, IMAGES, SWEEP = (
    "copy", "trace", "closed form", "40 images", "sweep, a design"
)  # fmt: skip
ROWS = (COPY, TRACE, CLOSED_FORM, IMAGES, SWEEP)
FILES = {
    TRACE: ("trace.cl", "listed.cl", "posed.cl", "posed_listed.cl", "sliced.cl", "refine.cl"),
    CLOSED_FORM: ("aspect.cl",),
    IMAGES: ("sequence.cl", "profiled.cl", "footprints.cl", "lookup.cl"),
    SWEEP: ("sweep.cl",),
}
"""Which kernel files are taken at the width that makes a row fastest on OpenCL."""

STATION: dict[str, Any] = {
    "camera": {"columns": 4000, "rows": 1000, "subsampling": 1},
    "populations": [{"kind": "dent", "count": 40, "diameter_mm": [0.4, 1.0], "depth_um": [1, 10]}],
}
_DESIGNS = 8
_SECONDS = 0.7  # after which a row is not timed again
_TIMES = 7


def best(run: Run, times: int = _TIMES, seconds: float = _SECONDS) -> float:
    """Return the shortest of some runs in seconds, after one to warm up.

    Parameters
    ----------
    run : callable
    times : int
        Runs at most.
    seconds : float
        After which no further run begins.
    """
    run()
    spans: list[float] = []
    while len(spans) < times and sum(spans) < seconds:
        start = time.perf_counter()
        run()
        spans.append(time.perf_counter() - start)
    return min(spans)


def measured(backend: Backend) -> dict[str, float]:
    """Return how long each of ``ROWS`` takes, in ms.

    Parameters
    ----------
    backend : Backend
        Settled.
    """
    from gpuspec.light.levels import Zones
    from gpuspec.part.relief import Relief
    from gpuspec.part.truth import Truth

    station = Station.from_dict(STATION)
    relief = Relief.of(station)
    light_map = backend.trace(station, relief)
    truth = Truth.of(station, relief)
    counter = light_map.counter(Zones.of(truth.labels, light_map.lost() == 0, len(truth.defects)))
    designs = [station.replace(sensor__exposure=2.0 + 0.5 * i) for i in range(_DESIGNS)]
    with light_map.failures():
        finish, copy, trace, start = steps(backend, light_map)

        def timed(run: Run) -> float:
            return 1e3 * best(lambda: (run(), finish()))

        return {
            COPY: timed(copy),
            TRACE: timed(trace),
            CLOSED_FORM: timed(start("closed_form", station)),
            IMAGES: timed(start("mean", station)),
            SWEEP: timed(lambda: counter.count(designs)) / _DESIGNS,
        }


def steps(backend: Backend, light_map: LightMap) -> Steps:
    """Return how a backend does each step, without bringing anything home.

    Parameters
    ----------
    backend : Backend
        Settled.
    light_map : LightMap
        Traced by it.
    """
    return _STEPS[backend.info.backend](backend, light_map)


def _opencl(b: Any, light_map: Any) -> Steps:
    ((tile, _),) = light_map.bands()
    size = light_map.stride * tile.rows
    grey = b.empty(4 * size)
    lanes = 8  # as wide as vectors get; rows are whole ones of eight on a CPU, and here on a GPU
    kernel = b.program(
        "__kernel void copy(__global const float8 *a, __global float8 *b)"
        "{ size_t i = get_global_id(0); b[i] = a[i]; }",
        "copy",
    ).copy

    def start(what: str, station: Station) -> Run:
        return partial(light_map.enqueue, tile, what, b.constant(design_block(station)), 0, grey)

    copy = partial(kernel, b.queue, (size // lanes,), None, tile.planes[0], grey)
    return b.queue.finish, copy, partial(light_map.trace_tile, 0, tile.rows), start


def _opengl(b: Any, light_map: Any) -> Steps:
    from gpuspec.light.sources import resolved_shader

    ((tile, _),) = light_map.bands()
    shape = light_map.station.shape
    grey, other = b.target(shape[::-1], 1), b.target(shape[::-1], 1)
    text = "uniform sampler2D a; out float b;"
    text += "void main() { b = texelFetch(a, ivec2(gl_FragCoord.xy), 0).x; }"
    program = b.build(*resolved_shader(text, "copy", 330))

    def start(what: str, station: Station) -> Run:
        return partial(light_map.draw, tile, what, station, 0, [grey])

    copy = partial(b.draw, program, [grey], np.zeros(4, np.float32), {"a": other})
    return b.context.finish, copy, partial(light_map.trace_tile, 0, tile.rows), start


def _vulkan(b: Any, light_map: Any) -> Steps:
    from gpuspec.light.constants import GROUP
    from gpuspec.light.sources import resolved_shader

    ((tile, _),) = light_map.bands()
    rows, columns = light_map.station.shape
    grey, one = b.empty(4 * rows * columns), np.empty(1, np.float32)
    text = f"""layout(local_size_x = {GROUP}) in;
        layout(std430, set = 0, binding = 0) readonly buffer A {{ float a[]; }};
        layout(std430, set = 0, binding = 1) buffer B {{ float b[]; }};
        void main() {{
            uint i = gl_GlobalInvocationID.y * {columns}u + gl_GlobalInvocationID.x;
            if (gl_GlobalInvocationID.x < {columns}u) b[i] = a[i];
        }}"""
    program = b.program(*resolved_shader(text, "copy", 450), ("read-only-storage", "storage"))

    def start(what: str, station: Station) -> Run:
        return partial(light_map.enqueue, tile, what, station, 0, grey)

    copy = partial(b.enqueue, program, (tile.rays, grey), columns, rows)
    trace = partial(light_map.trace_tile, 0, tile.rows)
    return partial(b.copy_home, one, grey), copy, trace, start


def _numpy(b: Any, light_map: Any) -> Steps:
    light = np.zeros(light_map.station.shape)
    other = np.empty_like(light)

    def start(what: str, station: Station) -> Run:
        return partial(getattr(light_map, what), station)

    def trace() -> object:
        return b.trace(light_map.station).lost()

    return lambda: None, partial(np.copyto, other, light), trace, start


_STEPS: dict[str, Callable[[Any, Any], Steps]] = {
    "opencl": _opencl,
    "opengl": _opengl,
    "vulkan": _vulkan,
    "numpy": _numpy,
}
