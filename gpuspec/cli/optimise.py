"""The command that searches between bounds, and draws what it tried."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gpuspec import words
from gpuspec.cli.options import (
    GOAL_HELP,
    P1_FLOOR_HELP,
    P2_FLOOR_HELP,
    REQUIRE_HELP,
    BackendOption,
    DeviceOption,
    ForceOption,
    OutputOption,
    SetOption,
    changed,
)
from gpuspec.cli.sweep import SeedsOption
from gpuspec.cli.terminal import console, extra, print_notes, progress

if TYPE_CHECKING:
    from gpuspec.station.station import Station
    from gpuspec.sweeps.plan import Plan
    from gpuspec.sweeps.searching.optimise import Optimum
    from gpuspec.sweeps.searching.search import Trial


def optimise(
    station: Annotated[
        list[str],
        typer.Argument(
            metavar="STATION [REQUIREMENT]...", help="Station file (TOML); requirements, too."
        ),
    ],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=FROM:TO",
            help="A key and its bounds. Not given: the ends of the ranges in [sweep].",
        ),
    ] = None,
    trials: Annotated[
        int, typer.Option("--trials", min=1, help="Designs to try, earlier ones included.")
    ] = 200,
    parts: Annotated[
        int | None, typer.Option("--parts", help="Parts that each design is tried on.")
    ] = None,
    seeds: SeedsOption = None,
    choose: Annotated[
        list[str] | None,
        typer.Option(
            "--choose",
            metavar="KEY=VALUE,VALUE",
            help="A key that takes one of some values: makeable widths, materials, true and false.",
        ),
    ] = None,
    goal: Annotated[str, typer.Option("--goal", help=GOAL_HELP)] = "p1",
    require: Annotated[list[str] | None, typer.Option("--require", help=REQUIRE_HELP)] = None,
    hit_share: Annotated[
        float | None, typer.Option("--hit-share", help="Least share of defects to be hit.")
    ] = None,
    p2_floor: Annotated[float | None, typer.Option("--p2-floor", help=P2_FLOOR_HELP)] = None,
    p1_floor: Annotated[float | None, typer.Option("--p1-floor", help=P1_FLOOR_HELP)] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the search.")] = 0,
    output: OutputOption = Path("optimum"),
    write: Annotated[
        Path | None, typer.Option("--write", help="Write the best station, e.g. best.toml.")
    ] = None,
    force: ForceOption = False,
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    change: SetOption = None,
) -> None:
    """Search between bounds for the best design. The same command with more trials goes on."""
    with extra("optimise"):
        from gpuspec.sweeps.searching.optimise import WRITTEN, outputs, plan_of
        from gpuspec.sweeps.searching.optimise import optimise as search
    from gpuspec.cli.aim import RULES, check_no_floors, told_apart
    from gpuspec.errors import StationError
    from gpuspec.files import check_new, write_new
    from gpuspec.station.station import Station
    from gpuspec.station.toml import to_toml
    from gpuspec.sweeps.aim import Aim
    from gpuspec.sweeps.axes import VARY_BETWEEN, vary_options
    from gpuspec.sweeps.rule import Rule
    from gpuspec.sweeps.searching.picture import optimise_picture, write_trials

    place, required = told_apart(station, require, "station file")
    floors = {"p2_floor": p2_floor, "p1_floor": p1_floor, "hit_share": hit_share}
    told_floors = {k: v for k, v in floors.items() if v is not None}
    rule: Rule | Aim
    if required or goal not in RULES:
        check_no_floors(told_floors)
        rule = Aim("p1" if goal == "paper" else goal, tuple(required))  # type: ignore[arg-type]
    else:
        rule = Rule(**{"goal": "p1" if goal == "paper" else goal, **told_floors})  # type: ignore[arg-type]
    choices = choices_of(choose)
    described = changed(Station.read(place), change)
    between = vary_options(vary, VARY_BETWEEN) if vary else None
    for key, given in (between or {}).items():
        if given.count(":") == 2:
            raise StationError(
                f"--vary {key}={given} counts values, and a search takes all between two bounds; "
                f"write {given.rpartition(':')[0]}."
            )
    plan = plan_of(described, between, parts, seeds)
    results = outputs(plan, output, force=force)
    results.check()
    if write:
        check_new(write, force=force, inputs=results.inputs)
    if not vary:
        _note_lists(described, plan)
    began, done = time.monotonic(), 0
    with progress() as tell:

        def told(trial: Trial, number: int) -> None:
            nonlocal done
            done += 1
            tell(f"trial {number} of {trials}")

        found = search(plan, output, trials, rule, seed, backend, device, told, choices)
        seconds = time.monotonic() - began
        with results.writing() as partial:
            write_trials(partial / WRITTEN[0], found)
            (partial / WRITTEN[1]).write_bytes(optimise_picture(found))
    if write:
        write_new(
            write, to_toml(found.station(), absolute=True), force=force, inputs=results.inputs
        )
    _print(found, done, seconds)
    out = console()
    out.print(f"{', '.join(WRITTEN)} in {output}", soft_wrap=True)
    if write:
        out.print(f"{write} written; simulate it with: gpuspec simulate {write}", soft_wrap=True)


def choices_of(texts: list[str] | None) -> dict[str, list[Any]]:
    """Return keys and the values of which each takes one, as ``--choose`` gives them.

    Raises
    ------
    StationError
        If one has another form, or a key stands twice.
    """
    from gpuspec.errors import StationError
    from gpuspec.sweeps.axes import axis_values

    found: dict[str, list[Any]] = {}
    for text in texts or ():
        key, equals, given = (part.strip() for part in text.partition("="))
        if not (equals and key and given):
            raise StationError(
                f"--choose {text}: write KEY=VALUE,VALUE, e.g. tunnel.section=ceiling,arch, or "
                f"KEY=FROM:TO:COUNT."
            )
        if key in found:
            raise StationError(f"--choose {key} stands twice; choose each key once.")
        found[key] = axis_values(key, given)
    return found


def _note_lists(station: Station, plan: Plan) -> None:
    """Say of which keys a sweep would take listed values alone, and a search what lies between."""
    given = station.sweep.vary if station.sweep else {}
    for a in plan.axes:
        if isinstance(given.get(a.key), list):
            low, high = a.values
            console().print(
                f"note: [sweep] lists values of {a.key}; searched is all from {words.number(low)} "
                f"to {words.number(high)}.",
                soft_wrap=True,
            )


def _print(found: Optimum, done: int, seconds: float) -> None:
    from gpuspec.cli.tables import print_score, print_table
    from gpuspec.simulation.cautions.defects import out_of_view
    from gpuspec.simulation.cautions.station import without_effect
    from gpuspec.sweeps.measures import MEASURES
    from gpuspec.sweeps.rule import Rule, f1_of
    from gpuspec.sweeps.searching.optimise import shown

    out, best = console(), found.trials[found.best]
    rate = f", {done} of them now, {done / seconds:.1f} a second" if done else ", none of them now"
    out.print(f"{len(found.trials):,} trials{rate}; {found.info}", soft_wrap=True)
    out.print(f"rule: {found.rule}", soft_wrap=True)
    if isinstance(found.rule, Rule):
        kept = found.rule.fulfilled(best.p1, best.p2, best.hits, best.defects)
    else:
        kept = not sum(best.missed)
    if not kept:
        out.print("note: no trial fulfils the rule; this one comes nearest.", soft_wrap=True)
    invalid = [trial.reason for trial in found.trials if trial.reason]
    if invalid:
        out.print(
            f"note: {len(invalid)} trials are no valid station, e.g.: {invalid[0]}", soft_wrap=True
        )
    tried = found.plan.station.replace(**best.values)
    hidden = out_of_view(tried, found.plan.inspections, best.defects or 0)
    print_notes([*(best.notes or "").splitlines(), *hidden, *without_effect(tried)])
    rows = [(key, shown(value)) for key, value in best.values.items()]
    if found.confirmed and not isinstance(found.rule, Rule):
        values = found.confirmed.values()
        names = dict.fromkeys([*found.rule.names, "margin_dn", "margin_sigma", "images"])
        rows += [(name, MEASURES[name].shown(values[name])) for name in names]
    print_table(rows, title=f"best trial, number {found.best + 1}", framed=False)
    print_score(
        f"{best.p1:.4f}", f"{best.p2:.4f}",
        f"{f1_of(best.p1, best.p2):.4f}",  # type: ignore[arg-type]
        [
            ("defects hit", f"{best.hits} of {best.defects}", ""),
            ("threshold", f"{best.threshold_dn:.6g} DN", ""),
        ],
    )  # fmt: skip
