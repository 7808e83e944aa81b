"""gpuspec: simulate, test and optimise an inspection station for specular parts.

>>> import gpuspec as gs
>>> station = gs.example("trim")  # your own: gs.Station.read("my_station.toml")
>>> station = station.replace(camera__sampling_mm=0.5)
>>> result = gs.simulate(station)
>>> result.score
Score(P1 0.240, P2 1.000, F1 0.388; 33 of 36 defects hit, 3 of 36 blobs false)
>>> result.picture("histogram"), result.extent_mm, result.blobs.to_pandas().shape
(<Figure size ...>, (-100.0, 100.0, -25.0, 25.0), (36, 18))
>>> result.light_map.score(station.replace(sensor__exposure=2))  # another design, no new trace
Score(P1 0.256, P2 1.000, F1 0.407; 33 of 36 defects hit, 3 of 36 blobs false)
>>> result.save("run")
>>> gs.load("run").score == result.score
True

What the command line does is here by the same names: `simulate`, `inspect`, `fit`, `sweep`,
`front`, `optimise`, `study`, `pod`, `dataset`, `devices`, `example` (`choose` is what `front` is
elsewhere). What they take and give: `Station`, `Result`, `Captured`, `Fit`, `Plan`, `Rule`,
`RunFolder`, `Choice`, `Optimum`, `Pod`, `DataSetPlan`, `DataSetMade`; `load` reads a run or a sweep
back from its folder. `Line` takes a camera's frames one at a time.

>>> run = gs.sweep(station, {"tunnel.luminous_mm": "1:3:3", "sensor.exposure": [2, 4]}, "sweep")
>>> best = gs.choose(run, goal="f1").station()
>>> best.tunnel.luminous_mm
1.0
>>> best.write("best.toml").name
'best.toml'
>>> gs.study("coverage", station).images_needed  # of a period, to show every defect
4
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gpuspec.captured.captured import Captured
    from gpuspec.captured.fit import Fit, fit
    from gpuspec.captured.inspect import inspect
    from gpuspec.captured.line import Line
    from gpuspec.datasets.dataset import DataSetMade, dataset
    from gpuspec.datasets.plan import DataSetPlan
    from gpuspec.detectability.outcome import Pod
    from gpuspec.detectability.pod import pod
    from gpuspec.errors import GpuspecError
    from gpuspec.light.devices import open_backend, survey
    from gpuspec.light.devices import survey as devices
    from gpuspec.light.patterns import Pattern
    from gpuspec.loading import load
    from gpuspec.report.folder import write
    from gpuspec.simulation.result import Result
    from gpuspec.simulation.simulate import simulate
    from gpuspec.station.examples import example
    from gpuspec.station.station import Station
    from gpuspec.station.toml import to_toml
    from gpuspec.studies.study import study
    from gpuspec.sweeps.aim import Aim
    from gpuspec.sweeps.choosing.aimed import AimChoice, choose_for
    from gpuspec.sweeps.choosing.choose import Choice, choose
    from gpuspec.sweeps.choosing.choose import choose as front
    from gpuspec.sweeps.keeping.folder import RunFolder
    from gpuspec.sweeps.plan import Plan
    from gpuspec.sweeps.rule import Rule
    from gpuspec.sweeps.searching.optimise import Optimum, optimise
    from gpuspec.sweeps.searching.optimise import plan_of as search_plan
    from gpuspec.sweeps.sweep import sweep
    from gpuspec.version import __version__ as __version__

__all__ = [
    "Aim",
    "AimChoice",
    "Captured",
    "Choice",
    "DataSetMade",
    "DataSetPlan",
    "Fit",
    "GpuspecError",
    "Line",
    "Optimum",
    "Pattern",
    "Plan",
    "Pod",
    "Result",
    "Rule",
    "RunFolder",
    "Station",
    "choose",
    "choose_for",
    "dataset",
    "devices",
    "example",
    "fit",
    "front",
    "inspect",
    "load",
    "open_backend",
    "optimise",
    "pod",
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
    "Captured": "captured.captured",
    "Fit": "captured.fit",
    "fit": "captured.fit",
    "inspect": "captured.inspect",
    "Aim": "sweeps.aim",
    "AimChoice": "sweeps.choosing.aimed",
    "Choice": "sweeps.choosing.choose",
    "DataSetMade": "datasets.dataset",
    "DataSetPlan": "datasets.plan",
    "GpuspecError": "errors",
    "Line": "captured.line",
    "Optimum": "sweeps.searching.optimise",
    "Pattern": "light.patterns",
    "Plan": "sweeps.plan",
    "Pod": "detectability.outcome",
    "Result": "simulation.result",
    "Rule": "sweeps.rule",
    "RunFolder": "sweeps.keeping.folder",
    "Station": "station.station",
    "example": "station.examples",
    "choose": "sweeps.choosing.choose",
    "choose_for": "sweeps.choosing.aimed",
    "dataset": "datasets.dataset",
    "devices": "light.devices:survey",
    "front": "sweeps.choosing.choose:choose",
    "load": "loading",
    "open_backend": "light.devices",
    "optimise": "sweeps.searching.optimise",
    "pod": "detectability.pod",
    "search_plan": "sweeps.searching.optimise:plan_of",
    "simulate": "simulation.simulate",
    "study": "studies.study",
    "survey": "light.devices",
    "sweep": "sweeps.sweep",
    "to_toml": "station.toml",
    "write": "report.folder",
    "__version__": "version",
}
_PACKAGES = ("studies", "sweeps")


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

        extra = {
            "sweeps.searching.optimise": "optimise", "datasets.dataset": "dataset",
            "detectability.pod": "pod",
        }.get(file, "sweep")  # fmt: skip
        raise ExtraError.of(error, extra) from None
    return getattr(module, there or name)


def __dir__() -> list[str]:
    return sorted([*__all__, *_PACKAGES, "__version__"])
