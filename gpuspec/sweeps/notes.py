"""What to know of a sweep's designs before trusting their scores."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from gpuspec.errors import StationError
from gpuspec.simulation.cautions.all import common
from gpuspec.simulation.cautions.station import assumptions, ineffective, of_station
from gpuspec.station.station import Station
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.plan import Plan

_LOOKED_AT = 128
_GOLDEN = (5**0.5 - 1) / 2
_TOLD = 3


def of_plan(plan: Plan) -> list[str]:
    """Return what is true of every design, before one is tried: those of some spread over the grid.

    Keys that are varied in vain are among it.
    """
    stations = _spread(plan)
    idle = [ineffective(station) for station in stations]
    vain = [
        f"{a.key} is varied and has no effect {idle[0][a.key]}."
        for a in plan.axes
        if idle and all(a.key in keys for keys in idle)
    ]
    return [*vain, *common(of_station(station) for station in stations)]


def ideals_of_plan(plan: Plan) -> list[str]:
    """Return what every design leaves to an ideal, see :func:`assumptions`."""
    return common(assumptions(station) for station in _spread(plan))


def _spread(plan: Plan) -> list[Station]:
    found: list[Station] = []
    designs: Sequence[int]
    if plan.designs <= _LOOKED_AT:
        designs = range(plan.designs)
    else:  # no multiple of any axis: a stride would meet some values only
        designs = [int(plan.designs * (n * _GOLDEN % 1)) for n in range(_LOOKED_AT)]
    for design in designs:
        try:
            found.append(plan.station_of(design))
        except StationError:
            continue
    return found


def of_table(run: RunFolder, known: Collection[str] = ()) -> list[str]:
    """Return the commonest notes in a sweep's table, each with how many designs have it.

    Parameters
    ----------
    run : RunFolder
    known : collection of str
        Said already of every design; told again where it is true of some only.
    """
    counts: Counter[str] = Counter()
    valid = 0
    for table in run.batches(["notes", "reason"]):
        valid += table["reason"].null_count
        for note, count in Counter(table["notes"].drop_null().to_pylist()).items():
            for line in note.splitlines():
                counts[line] += count
    for line in known:
        if counts[line] == valid:
            del counts[line]
    said = [f"{count:,} of {run.plan.designs:,} designs: {line}" for line, count in
            counts.most_common(_TOLD)]  # fmt: skip
    if len(counts) > _TOLD:
        said.append(f"{len(counts) - _TOLD:,} more notes stand in the table's column `notes`.")
    return said
