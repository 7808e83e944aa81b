"""Prints what tracing a pixel costs, beside what its bytes and its operations cost alone.

    python tests/benchmarks/trace.py [--columns 4000 --rows 1000]

On the first device of OpenCL. "copy" moves one plane of floats to another place in the same memory.
The limits are measured on the same device in the same run: the planes of a light map written with
nothing to work out, and as many operations as a flat part takes with nothing to read or write.
Traces go into planes that are there; where the system has to find the memory first, its pages cost
more than the rays.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from gpuspec.light.devices import open_backend
from gpuspec.light.speed import Run, best, steps
from gpuspec.station.station import Station

OPERATIONS = 118
"""Sums, products (a product and a sum in one count once), comparisons and choices of a pixel whose
part is flat, whose tunnel is a ceiling, and which is seen through a pupil; read off the kernels."""

ROOTS = 8
"""Of the same pixel: three square roots and five divisions, which a CPU does one after another."""

BYTES = 17
"""Written for a pixel: light coordinate, two widths, irradiance, and why it is lost."""

SOURCE = """
#include "portable.h"
#define AT ((get_global_id(1) * get_global_size(0) + get_global_id(0)) * WIDTH)
__kernel void written(__global float *a, __global float *b, __global float *c, __global float *d,
                      __global uchar *e) {
    REAL x = (float)get_global_id(0);
    STORE(x, a, AT);
    STORE(x, b, AT);
    STORE(x, c, AT);
    STORE(x, d, AT);
    STORE_BYTE(x, e, AT);
}
/* Eight chains beside each other, as the device can have them. */
#define EACH(step) step(0) step(1) step(2) step(3) step(4) step(5) step(6) step(7)
#define WORK(name, step, times)                                       \\
    __kernel void name(__global float *out) {                                \\
        REAL v[8];                                                           \\
        for (int i = 0; i < 8; i++) v[i] = 1.0f + (float)get_global_id(i % 2) * (i + 1);  \\
        for (int k = 0; k < times; k++) { EACH(step) }                       \\
        REAL sum = v[0] + v[1] + v[2] + v[3] + v[4] + v[5] + v[6] + v[7];    \\
        if (ANY(sum == -1.0f)) out[0] = 1.0f;                                \\
    }
#define MULTIPLY(i) v[i] = v[i] * 0.999f + 0.5f;
#define ROOT(i) v[i] = sqrt(v[i]);
WORK(worked, MULTIPLY, 16)
WORK(rooted, ROOT, 1)
"""


def main() -> None:
    """Measure and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--columns", type=int, default=4000)
    options.add_argument("--rows", type=int, default=1000)
    given = options.parse_args()
    backend: Any = open_backend("opencl")
    flat = Station.from_dict(
        {"camera": {"columns": given.columns, "rows": given.rows, "subsampling": 1}}
    )
    dents = {"kind": "dent", "count": 40, "diameter_mm": [0.4, 1.0], "depth_um": [1, 10]}
    stations = {
        "trace, flat": flat,
        "trace, 40 dents": Station.from_dict({**flat.as_dict(), "populations": [dents]}),
        "trace, mirror of iron, cos4": flat.replace(
            part__material="iron", camera__vignetting="cos4"
        ),
        "trace, crowned": flat.replace(part__crown_radius_x_mm=400.0),
        "trace, crowned, its height too": flat.replace(
            part__crown_radius_x_mm=400.0, part__surface="height"
        ),
        "trace, box": flat.replace(tunnel__section="box", tunnel__width_mm=120.0),
        "trace, 2 x 2 sub-rays": flat.replace(camera__subsampling=2),
    }
    print(f"{backend.info}, {given.columns} x {given.rows} pixels\n")
    rows = {}
    for name, station in stations.items():
        light_map: Any = backend.trace(station)
        finish, copy, trace, _ = steps(backend, light_map)
        ((tile, _),) = light_map.bands()
        if not rows:
            rows["copy of a plane"] = timed(copy, finish)
            rows |= limits(backend, light_map)
            fresh = timed(lambda: (backend.give_back(), trace()), finish)  # noqa: B023
            rows["trace, flat, into memory never touched"] = fresh
        rows[name] = timed(partial(light_map.trace_into, tile), finish)
        light_map.release()
    for name, seconds in rows.items():
        copies = seconds / rows["copy of a plane"]
        print(f"{name:38}{seconds * 1e3:9.2f} ms{copies:9.1f} copies")


def timed(run: Run, finish: Run) -> float:
    """Return the shortest time of a run in seconds, until the device has finished."""
    return best(lambda: (run(), finish()), 15)


def limits(backend: Any, light_map: Any) -> dict[str, float]:
    """Return what a light map's bytes, a flat part's operations and its roots take, in seconds."""
    from gpuspec.light.sources import resolved

    ((tile, _),) = light_map.bands()
    program = backend.program(resolved(SOURCE, "trace.py"), "trace.py", backend.widths["trace.cl"])
    size = light_map.stride // backend.widths["trace.cl"], tile.rows
    group = (size[0], 1) if backend.widths["trace.cl"] > 1 else None
    first = tile.planes[0]

    def took(kernel: Any, *arguments: Any) -> float:
        run = partial(kernel, backend.queue, size, group, *arguments)
        return timed(run, backend.queue.finish)

    return {
        f"its {BYTES} bytes": took(program.written, *tile.planes, tile.lost),
        f"its {OPERATIONS} operations": took(program.worked, first) * OPERATIONS / 128,
        f"its {ROOTS} roots and divisions": took(program.rooted, first) * ROOTS / 8,
    }


if __name__ == "__main__":
    main()
