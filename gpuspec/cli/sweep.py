"""The command that sweeps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gpuspec.cli.options import (
    BackendOption,
    DeviceOption,
    OutputOption,
    SchedulerOption,
    SetOption,
    StationArgument,
    WorkersOption,
    changed,
)
from gpuspec.cli.terminal import console, counted, extra, kept_in, print_assumptions, print_notes

if TYPE_CHECKING:
    from gpuspec.sweeps.crew import Crew
    from gpuspec.sweeps.estimate import Estimate
    from gpuspec.sweeps.keeping.folder import RunFolder
    from gpuspec.sweeps.plan import Plan

VaryOption = Annotated[
    list[str] | None,
    typer.Option(
        "--vary",
        metavar="KEY=FROM:TO:COUNT",
        help="Vary a key of the station file, e.g. tunnel.luminous_mm=1:12:23, or over values, "
        "e.g. sequence.images=8,16,40. Not given: the file's [sweep] table.",
    ),
]
PartsOption = Annotated[
    int | None,
    typer.Option("--parts", min=1, help="Random parts each design is tried on, from other seeds."),
]
SeedsOption = Annotated[
    int | None,
    typer.Option("--seeds", min=1, help="Draws of the sensor's noise on each part."),
]


def sweep(
    station: StationArgument,
    vary: VaryOption = None,
    output: OutputOption = Path("sweep"),
    parts: PartsOption = None,
    seeds: SeedsOption = None,
    screen: Annotated[
        bool,
        typer.Option(
            "--screen", help="Sample the flawless pixels first; make exact what may be the best."
        ),
    ] = False,
    samples: Annotated[
        int | None,
        typer.Option("--samples", min=1, help="Pixels of a part that --screen draws."),
    ] = None,
    plan_only: Annotated[bool, typer.Option("--plan", help="Only print the plan.")] = False,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = "",
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    change: SetOption = None,
) -> None:
    """Try every design of a grid at every threshold. Run again to go on where it was."""
    with extra("sweep"):
        from gpuspec.sweeps.axes import vary_options
        from gpuspec.sweeps.keeping.folder import RunFolder, check_space
        from gpuspec.sweeps.notes import ideals_of_plan, of_plan, of_table
        from gpuspec.sweeps.plan import Plan
        from gpuspec.sweeps.trying.screening import STRATA
    from gpuspec.station.station import Station

    described = changed(Station.read(station), change)
    plan = Plan.of(
        described,
        vary_options(vary) if vary else None,
        parts,
        (samples or STRATA) if screen or samples else 0,
        seeds,
    )
    there = RunFolder(output, plan)
    if not plan_only:
        there.check_folder()
        check_space(output, plan)
    plan.check_some_valid()
    damaged = there.damaged() if there.is_begun() else []
    done = there.there() if there.is_begun() else 0
    done -= sum(len(there.designs_of(file)) for file in damaged)
    with _crew(plan, plan.designs - done, workers, scheduler, backend, device) as (crew, told):
        _print_plan(plan, told, done, output)
        _print_damage(there, damaged)
        known = of_plan(plan)
        print_notes(known)
        print_assumptions(ideals_of_plan(plan))
        rule = described.segmentation
        if rule.threshold != "auto" or rule.min_area_mm2:
            console().print(
                "note: the station's own threshold and size filter are left out: every design is "
                "scored at all thresholds, pixel by pixel; of false blobs the filter counts again.",
                soft_wrap=True,
            )
        if plan_only:
            _print_space(plan, output)
            return
        run, seconds = _swept(plan, output, crew)
    _print_end(run, plan.designs - done, seconds)
    print_notes(of_table(run, known))
    console().print(f"choose: gpuspec front {run.path} --write best.toml", soft_wrap=True)


@contextmanager
def _crew(
    plan: Plan, left: int, workers: int, scheduler: str, backend: str, device: str | None
) -> Iterator[tuple[Crew, Estimate]]:
    from gpuspec.sweeps.estimate import estimate

    if workers or scheduler:
        with extra("cluster"):
            from gpuspec.sweeps.cluster.crew import crew as cluster

        with cluster(
            plan, workers=workers, scheduler=scheduler, backend=backend, device=device
        ) as crew:
            yield crew, estimate(plan, None, left)
        return
    from gpuspec.light.devices import open_backend
    from gpuspec.sweeps.crew import Alone
    from gpuspec.sweeps.trying.bench import Bench

    bench = Bench(plan, open_backend(backend, device))
    yield Alone(bench), estimate(plan, bench, left)


def _swept(plan: Plan, output: Path, crew: Crew) -> tuple[RunFolder, float]:
    import time

    from gpuspec.sweeps import sweep as run

    start = time.perf_counter()
    with kept_in(output), counted(plan.designs) as tell:
        made = run.sweep(plan, output, progress=tell, crew=crew)
    return made, time.perf_counter() - start


def _print_plan(plan: Plan, told: Estimate, done: int, output: Path) -> None:
    from gpuspec.cli.tables import print_table
    from gpuspec.sweeps.trying.parts import counted_whole
    from gpuspec.words import number, plural

    out = console()
    rows = [(a.key, number(min(a.values)), number(max(a.values)), str(len(a.values)))
            for a in plan.axes]  # fmt: skip
    print_table(rows, ("key", "from", "to", "values"), title=f"sweep of {plan.station.file}")
    way = f"screening, {plan.samples:,} pixels of a part" if plan.samples else "exact"
    if plan.samples and counted_whole(plan.station):
        way = "exact: of a part that is posed or uneven every pixel is counted"
    out.print(
        f"{plural(told.designs, 'design')} at 256 thresholds, on {plan.tries}; "
        f"{plural(told.traces, 'light map')} to trace; {way}",
        soft_wrap=True,
    )
    time_ = "not known yet" if told.seconds is None else f"about {_duration(told.seconds)}"
    out.print(
        f"time {time_}; memory {told.device_bytes / 2**20:,.0f} MiB on the device; disk "
        f"{told.disk_bytes / 1e6:,.0f} MB in {output}",
        soft_wrap=True,
    )
    if done:
        out.print(f"{done:,} designs are there already; only the others are done.")


def _print_space(plan: Plan, output: Path) -> None:
    from gpuspec.errors import OutputError
    from gpuspec.sweeps.keeping.folder import check_space

    try:
        check_space(output, plan)
    except OutputError as error:
        console().print(f"note: {error}", soft_wrap=True)


def _print_damage(there: RunFolder, damaged: list[int]) -> None:
    if damaged:
        more = f" and {len(damaged) - 3} more" if len(damaged) > 3 else ""
        names = ", ".join(there.file(number).name for number in damaged[:3])
        console().print(
            f"note: damaged since they were written: {names}{more}; their designs are tried again.",
            soft_wrap=True,
        )


def _print_end(run: RunFolder, tried: int, seconds: float) -> None:
    from gpuspec.words import none_valid

    invalid = run.invalid()
    out = console()
    rate = f", {tried / seconds:,.0f} designs/s" if tried else ""
    out.print(f"{run.plan.designs:,} designs in {run.path} ({seconds:.1f} s{rate})", soft_wrap=True)
    if invalid:
        (count, reason) = invalid
        out.print(f"note: {none_valid(count)}, e.g.: {reason}", soft_wrap=True)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
