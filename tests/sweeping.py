"""What the tests of sweeps share."""

from __future__ import annotations

from typing import Any

from gpuspec.sweeps.keeping.folder import RunFolder

STATION: dict[str, Any] = {
    "part": {"length_mm": 14.0, "width_mm": 9.0},
    "tunnel": {"height_mm": 200.0, "luminous_mm": 2.0, "dark_mm": 6.0},
    "camera": {"sampling_mm": 0.1, "subsampling": 1},  # as fast as sweeps can be
    "defects": [
        {"kind": "dent", "x_mm": 2.0, "y_mm": 1.0, "diameter_mm": 0.8, "depth_um": 5.0},
    ],
    "populations": [
        {"kind": "dent", "count": 3, "seed": 1, "diameter_mm": [0.4, 0.9], "depth_um": [2.0, 8.0]},
        {"kind": "scratch", "count": 2, "seed": 2, "width_mm": 0.3, "length_mm": [1, 3],
         "depth_um": 4.0},
    ],
}  # fmt: skip
GRID = {"tunnel.luminous_mm": "0.5:6:12", "sensor.exposure": "1:8:8", "sequence.images": "8:64:8"}


def rows(run: RunFolder) -> list[dict[str, Any]]:
    return run.table().to_pylist()


def spoilt(data: bytes, how: str) -> bytes:
    """A file with two bytes flipped somewhere, or cut off."""
    if how == "empty":
        return b""
    if how == "cut":
        return data[:-100]
    places = {
        "start": 0,
        "first page": 200,
        "middle": len(data) // 2,
        "last page": 9 * len(data) // 10,
        "footer": len(data) - 50,
        "end": len(data) - 2,
    }
    at = places[how]
    return data[:at] + bytes(255 - one for one in data[at : at + 2]) + data[at + 2 :]
