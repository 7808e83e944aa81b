"""A sweep from plan to table: what is missing is done, and what was screened is made exact."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gpuspec.errors import OutputError, StationError
from gpuspec.files import folder_of
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.station.station import Station
from gpuspec.sweeps.choosing.front import Front
from gpuspec.sweeps.crew import Alone, Crew, Task
from gpuspec.sweeps.keeping.folder import RunFolder, check_space
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.bench import Bench

Progress = Callable[[str, int, int], None]
"""Told what is being done, how many designs are done, and of how many."""


def sweep(
    station: Plan | Station | str | Path,
    vary: Mapping[str, Any] | str | Path | None = None,
    folder: str | Path | None = None,
    *,
    parts: int | None = None,
    samples: int | None = None,
    seeds: int | None = None,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
    crew: Crew | None = None,
) -> RunFolder:
    """Try every design of a plan that the folder does not hold yet, or not as it was written.

    Parameters
    ----------
    station : Station, str, Path or Plan
        A station, the path of its file, or a plan, which says the rest but the folder.
    vary : mapping of str to str, number or list, optional
        Keys of the station and what each takes, e.g. ``{"tunnel.luminous_mm": "0.5:8:16"}``. None,
        or left out as in ``sweep(station, folder)``: the station's ``[sweep]`` table.
    folder : str or Path
        Of a new sweep, or of this one to go on with.
    parts : int, optional
        Random parts each design is tried on; None: as the ``[sweep]`` table says, or one.
    samples : int, optional
        Pixels of a part that screen the designs; None: every pixel is counted.
    seeds : int, optional
        Draws of the noise on each part; None: as the ``[sweep]`` table says, or one.
    backend : str or Backend
        A name for :func:`gpuspec.light.devices.open_backend`, or an open backend.
    device : str, optional
        Part of the device's name, or its number.
    progress : callable, optional
    crew : Crew, optional
        Others to do the work; then `backend` and `device` are not used.

    Returns
    -------
    RunFolder

    Raises
    ------
    OutputError
        If there is no folder, it holds another sweep, or cannot be written, or the disk is too
        small.
    StationError
        If there is nothing to vary, a key or range is wrong, or no design is a valid station.
    BackendError
        If the device is absent or fails.

    Examples
    --------
    >>> import gpuspec as gs, tempfile
    >>> station = gs.example("trim").replace(camera__sampling_mm=0.5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     run = gs.sweep(station, {"sensor.exposure": [2, 4]}, folder, backend="numpy")
    ...     gs.choose(run, goal="f1").station().sensor.exposure
    2.0
    """
    if isinstance(vary, (str, Path)) and folder is None:
        vary, folder = None, vary
    if folder is None:
        raise OutputError(
            'a sweep needs a folder for its results, e.g. sweep(station, vary, "run").'
        )
    plan = _plan(station, vary, parts, samples, seeds)
    folder = folder_of(folder)
    tell = progress or (lambda *_: None)
    RunFolder(folder, plan).check_folder()
    check_space(folder, plan)
    plan.check_some_valid()
    if crew is None:
        engine = open_backend(backend, device)
        crew = Alone(Bench(plan, engine))
    with RunFolder.writing(folder, plan) as run:
        run.repair()
        front = Front()
        missing = set(run.missing())
        for file in range(run.files) if plan.samples else ():
            if file not in missing:
                front.add(run.read_file(file))
        done = run.there()
        tasks = (Task(n, tuple(run.designs_of(n)), sampled=True) for n in sorted(missing))
        for task, table in crew.done(tasks):
            run.write(task.file, table)
            if plan.samples:
                front.add(table)
            done += len(table)
            tell("designs", done, plan.designs)
        if plan.samples:
            _make_exact(run, crew, front, tell)
        run.seal()
        run.check_valid()
    return run


def _plan(
    station: Plan | Station | str | Path, vary: Any, parts: int | None, samples: int | None,
    seeds: int | None,
) -> Plan:  # fmt: skip
    if not isinstance(station, Plan):
        return Plan.of(station, vary, parts, samples or 0, seeds)
    if (vary, parts, samples, seeds) != (None,) * 4:
        raise StationError(
            "a plan says already what is varied, on how many parts and by how many samples; give "
            "the station in its place to say so anew."
        )
    return station


def _make_exact(run: RunFolder, crew: Crew, front: Front, tell: Progress) -> None:
    """Count every pixel of the designs on the front until no bound is left on it.

    A bound is never less than what it bounds, so that what an exact front leaves behind is behind
    it for certain (with the bounds' confidence). Exact values only fall: which designs are made
    exact does not depend on the order, or on where an earlier run was stopped.
    """
    done = 0
    while True:
        points = front.points()
        wanted = np.unique(points.design[~points.exact])
        if not wanted.size:
            return
        tasks = []
        for file in np.unique(wanted // run.rows_per_file).tolist():
            inside = wanted[wanted // run.rows_per_file == file]
            tasks.append(Task(file, tuple(inside.tolist()), sampled=False))
        tell("designs on the front made exact", done, done + wanted.size)
        for task, table in crew.done(tasks):
            kept = run.read_file(task.file)
            kept = kept.filter(~np.isin(kept["design"].to_numpy(), task.designs))
            run.write(task.file, pa.concat_tables([kept, table]).sort_by("design"))
            front.add(table)
            done += len(table)
            tell("designs on the front made exact", done, done + wanted.size)
