"""gpuspec: simulate, test and optimise an inspection station for specular parts.

>>> import gpuspec
>>> station = gpuspec.Station.read("trim.toml")
>>> result = gpuspec.simulate(station)
>>> result.score.p1, result.score.p2
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from gpuspec.devices import open_backend
    from gpuspec.errors import GpuspecError
    from gpuspec.inspection import Result, simulate
    from gpuspec.report import write
    from gpuspec.station import Station
    from gpuspec.stationfile import example

__all__ = ["GpuspecError", "Result", "Station", "example", "open_backend", "simulate", "write"]

_HOME = {
    "GpuspecError": "errors",
    "Result": "inspection",
    "Station": "station",
    "example": "stationfile",
    "open_backend": "devices",
    "simulate": "inspection",
    "write": "report",
}


def __getattr__(name: str) -> Any:
    # Imported when first used, so that `gpuspec --help` starts at once.
    if name not in _HOME:
        raise AttributeError(f"module 'gpuspec' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"gpuspec.{_HOME[name]}"), name)
