"""gpuspec: simulate, test and optimise an inspection station for specular parts.

>>> import gpuspec
>>> station = gpuspec.Station.read("trim.toml")
>>> result = gpuspec.simulate(station)
>>> result.score.p1, result.score.p2

What the command line does is here by the same names: `simulate`, `sweep`, `front`, `optimise`,
`study`, `example`, `write` (`choose` is what `front` is elsewhere); `survey` lists the devices.
What they take and give: `Station`, `Result`, `Plan`, `Rule`, `RunFolder`, `Choice`, `Optimum`.

>>> plan = gpuspec.Plan.of(station, {"tunnel.luminous_mm": "0.5:8:16", "sensor.exposure": [2, 4]})
>>> choice = gpuspec.front(gpuspec.sweep(plan, "sweep"), gpuspec.Rule(goal="f1"))
>>> choice.station()
>>> gpuspec.study("coverage", station)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from gpuspec.devices import open_backend, survey
    from gpuspec.errors import GpuspecError
    from gpuspec.inspection import Result, simulate
    from gpuspec.patterns import Pattern
    from gpuspec.report import write
    from gpuspec.station import Station
    from gpuspec.stationfile import example, to_toml
    from gpuspec.studies import study
    from gpuspec.sweeps.choice import Rule
    from gpuspec.sweeps.chosen import Choice, choose
    from gpuspec.sweeps.chosen import choose as front
    from gpuspec.sweeps.optimise import Optimum, optimise
    from gpuspec.sweeps.optimise import plan_of as search_plan
    from gpuspec.sweeps.plan import Plan
    from gpuspec.sweeps.run import sweep
    from gpuspec.sweeps.store import RunFolder

__all__ = [
    "Choice",
    "GpuspecError",
    "Optimum",
    "Pattern",
    "Plan",
    "Result",
    "Rule",
    "RunFolder",
    "Station",
    "choose",
    "example",
    "front",
    "open_backend",
    "optimise",
    "search_plan",
    "simulate",
    "study",
    "survey",
    "sweep",
    "to_toml",
    "write",
]

# Name: where it is, and its name there if it is another.
_HOME = {
    "Choice": "sweeps.chosen",
    "GpuspecError": "errors",
    "Optimum": "sweeps.optimise",
    "Pattern": "patterns",
    "Plan": "sweeps.plan",
    "Result": "inspection",
    "Rule": "sweeps.choice",
    "RunFolder": "sweeps.store",
    "Station": "station",
    "example": "stationfile",
    "choose": "sweeps.chosen",
    "front": "sweeps.chosen:choose",
    "open_backend": "devices",
    "optimise": "sweeps.optimise",
    "search_plan": "sweeps.optimise:plan_of",
    "simulate": "inspection",
    "study": "studies",
    "survey": "devices",
    "sweep": "sweeps.run",
    "to_toml": "stationfile",
    "write": "report",
}
_PACKAGES = ("devices", "studies", "sweeps")


def __getattr__(name: str) -> Any:
    # Imported when first used, so that `gpuspec --help` starts at once.
    from importlib import import_module

    if name in _PACKAGES:
        return import_module(f"gpuspec.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'gpuspec' has no attribute {name!r}")
    file, _, there = _HOME[name].partition(":")
    try:
        module = import_module(f"gpuspec.{file}")
    except ModuleNotFoundError as error:
        from gpuspec.errors import ExtraError

        raise ExtraError.of(error, "optimise" if "optimise" in file else "sweep") from None
    return getattr(module, there or name)


def __dir__() -> list[str]:
    return sorted([*__all__, *_PACKAGES, "__version__"])
