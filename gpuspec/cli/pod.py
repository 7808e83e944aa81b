"""The command that tells how probably a defect is found."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gpuspec.cli.options import (
    BackendOption,
    DeviceOption,
    ForceOption,
    OutputOption,
    SchedulerOption,
    SetOption,
    WorkersOption,
    changed,
)
from gpuspec.cli.terminal import console, counted, extra, kept_in, print_notes

if TYPE_CHECKING:
    from gpuspec.detectability.outcome import Pod
    from gpuspec.detectability.plan import TrialPlan
    from gpuspec.sweeps.crew import Crew


def pod(
    station: Annotated[
        Path | None, typer.Argument(help="Station file (TOML) with random populations.")
    ] = None,
    trials: Annotated[
        list[Path] | None,
        typer.Option(
            "--trials",
            metavar="FILE.csv",
            help="Trials of elsewhere: columns x, size, and y, 1 or 0, or the signal.",
        ),
    ] = None,
    output: OutputOption = Path("pod"),
    parts: Annotated[
        int, typer.Option("--parts", min=1, help="Random parts of the station; more go on.")
    ] = 64,
    size: Annotated[
        str | None, typer.Option("--size", help="slope, depth, diameter or width.")
    ] = None,
    over: Annotated[
        str | None,
        typer.Option("--over", help="A second size: a map of a90, e.g. depth over diameter."),
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", help="Only dents, bumps or scratches: dent ...")
    ] = None,
    model: Annotated[
        str,
        typer.Option("--model", help="auto (least AIC), logit, probit, logit-log or probit-log."),
    ] = "auto",
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=FROM:TO:COUNT",
            help="Try several stations on the same parts; the smallest a90/95 is chosen.",
        ),
    ] = None,
    false_calls: Annotated[
        float | None,
        typer.Option("--false-calls", min=0, help="Of --vary: at most so many per part."),
    ] = None,
    tolerance: Annotated[
        bool,
        typer.Option("--tolerance", help="Find the worst within the station's [tolerance], too."),
    ] = False,
    threshold: Annotated[
        float | None, typer.Option("--threshold", help="Of the signals in files.")
    ] = None,
    noise: Annotated[
        float | None, typer.Option("--noise", help="Signals of files up to it may be noise.")
    ] = None,
    saturation: Annotated[
        float | None, typer.Option("--saturation", help="Signals of files end there.")
    ] = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = "",
    force: ForceOption = False,
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    change: SetOption = None,
) -> None:
    """Tell how probably defects are found, over their size."""
    with extra("pod"):
        from gpuspec.detectability.outcome import outputs
        from gpuspec.detectability.pod import pod as find
    from gpuspec.errors import StationError
    from gpuspec.station.station import Station

    if station is None and change:
        raise StationError("--set changes a station; name a station file, too.")
    if station is None and vary:
        raise StationError("--vary varies a station; name a station file, too.")
    if station is None and tolerance:
        raise StationError("--tolerance is of a station; name a station file, too.")
    if station is None and over:
        raise StationError("--over maps a station's defects; name a station file, too.")
    described = changed(Station.read(station), change) if station else None
    given = trials or []
    results = outputs(described, output, tuple(given), force=force)
    asked: dict[str, Any] = {
        "size": size, "over": over, "kinds": kind or (), "model": model, "threshold": threshold,
        "noise": noise, "saturation": saturation, "trials": given,
    }  # fmt: skip
    if described is None:
        with results.writing() as partial:
            found = find(**asked)
            found.write_files(partial)
        _print(found, output)
        return
    from gpuspec.detectability.fits import MODELS
    from gpuspec.detectability.plan import TrialPlan
    from gpuspec.detectability.sizes import both, chosen
    from gpuspec.detectability.worst import tolerances_of
    from gpuspec.errors import TrialsError
    from gpuspec.sweeps.axes import vary_options

    # What can be refused is, before any device is opened.
    if over:
        both(described, size or "slope", over, kind or ())
    else:
        chosen(described, size or "slope", kind or ())
    if model not in MODELS:
        raise TrialsError(f"there is no model {model!r}; choose one of {', '.join(MODELS)}.")
    if tolerance:
        tolerances_of(described)
    several = vary_options(vary) if vary else None
    plan = TrialPlan.of(described, parts, several)
    results.check()
    with _crew(plan, workers, scheduler, backend, device) as crew, kept_in(output):
        with counted(plan.designs) as tell:
            found = find(
                described, parts=parts, folder=output, crew=crew, progress=tell, vary=several,
                false_calls=false_calls, tolerance=tolerance, backend=backend, device=device,
                **asked
            )  # fmt: skip
        with results.writing() as partial:
            found.write_files(partial)
    _print(found, output)


@contextmanager
def _crew(
    plan: TrialPlan, workers: int, scheduler: str, backend: str, device: str | None
) -> Iterator[Crew]:
    from gpuspec.detectability.bench import TrialBench, bench_of

    if workers or scheduler:
        with extra("cluster"):
            from gpuspec.sweeps.cluster.crew import crew_of

        with crew_of(
            bench_of, plan.message(), workers=workers, scheduler=scheduler, backend=backend,
            device=device,
        ) as crew:  # fmt: skip
            yield crew
        return
    from gpuspec.light.devices import open_backend
    from gpuspec.sweeps.crew import Alone

    yield Alone(TrialBench(plan, open_backend(backend, device)))


def _print(found: Pod, output: Path) -> None:
    from gpuspec.detectability.outcome import written

    print_notes(found.cautions())
    out = console()
    if found.info:
        out.print(str(found.info), soft_wrap=True)
    for finding in found.findings():
        out.print(finding, soft_wrap=True)
    out.print(f"{', '.join(written(found))} in {output}", soft_wrap=True)
