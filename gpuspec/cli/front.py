"""The command that chooses from a sweep, and draws it."""

from __future__ import annotations

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
    PicturesOption,
    output_option,
)
from gpuspec.cli.terminal import console, extra, progress

if TYPE_CHECKING:
    from gpuspec.sweeps.choosing.choose import Choice
    from gpuspec.sweeps.choosing.sensitivity import Line

FILES = (
    "front.csv", "chosen.json", "sensitivity.csv", "front.png", "maps.png", "sensitivity.png",
)  # fmt: skip
NEXT = 10


def front(
    run: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN [REQUIREMENT]...", help="Folder of a sweep; requirements, too."
        ),
    ],
    output: Annotated[
        Path | None,
        output_option("For the results. Not given: RUN/front, or RUN/front-2 ... for other rules."),
    ] = None,
    goal: Annotated[str | None, typer.Option("--goal", help=GOAL_HELP)] = None,
    require: Annotated[list[str] | None, typer.Option("--require", help=REQUIRE_HELP)] = None,
    over: Annotated[
        str | None,
        typer.Option("--over", metavar="A,B[,C]", help="Two or three measures of the front."),
    ] = None,
    min_area_mm2: Annotated[
        float | None,
        typer.Option("--min-area-mm2", min=0, help="Size filter in place of the station's own."),
    ] = None,
    hit_share: Annotated[
        float | None,
        typer.Option("--hit-share", help="Least share of the defects that must be hit."),
    ] = None,
    p2_floor: Annotated[float | None, typer.Option("--p2-floor", help=P2_FLOOR_HELP)] = None,
    p1_floor: Annotated[float | None, typer.Option("--p1-floor", help=P1_FLOOR_HELP)] = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", help="Write the chosen station, e.g. best.toml, to simulate it."),
    ] = None,
    force: ForceOption = False,
    pictures: PicturesOption = True,
    backend: BackendOption = "auto",
    device: DeviceOption = None,
) -> None:
    """Choose the best design and its threshold from a sweep.

    By the paper's rule it draws recall P2 over precision P1, maps of the score, and how far each
    value may move; by other goals and requirements the front, and what holds within tolerances.
    """
    from gpuspec.cli.aim import asked

    place, aim = asked(run, goal, require, over, min_area_mm2)
    floors = {"p2_floor": p2_floor, "p1_floor": p1_floor, "hit_share": hit_share}
    given = {name: value for name, value in floors.items() if value is not None}
    if aim is None:
        rule = {"goal": goal, **given} if goal in ("p1", "p2", "f1") else given
        _by_rule(place, output, rule, write, force=force, pictures=pictures)
        return
    from gpuspec.cli.aim import by_aim

    by_aim(place, aim, given, output, write, force=force, pictures=pictures,
           backend=backend, device=device)  # fmt: skip


def _by_rule(
    run: Path, output: Path | None, asked: dict[str, Any], write: Path | None, *,
    force: bool, pictures: bool,
) -> None:  # fmt: skip
    """Choose by the paper's rule, or another of its kind."""
    with extra("sweep"):
        from gpuspec.sweeps.choosing.choose import choose, most_defects
        from gpuspec.sweeps.rule import Rule
    from gpuspec.cli.aim import check_beside, opened
    from gpuspec.files import write_new
    from gpuspec.station.toml import to_toml
    from gpuspec.sweeps.choosing.maps import Maps
    from gpuspec.sweeps.choosing.sensitivity import lines

    rule = Rule(**asked)
    place = output or run / "front"
    check_beside(run, place, write)
    with progress() as tell:
        tell("choosing")
        swept, results = opened(run, output, write, str(rule), FILES, force=force)
        maps = Maps(swept.plan, rule, most_defects(swept)) if pictures else None
        choice = choose(swept, rule, maps.add if maps else None)
        found = lines(choice)
        if write:
            text = to_toml(choice.station(), absolute=True)
            write_new(write, text, force=force, inputs=results.inputs)
        with results.writing() as partial:
            _write_tables(partial, choice, found)
            if maps:
                tell("drawing")
                _draw(partial, choice, found, maps)
            written = [name for name in FILES if (partial / name).exists()]
    _print_choice(choice, found)
    out = console()
    if results.folder != place:
        out.print(f"note: {place} holds a front by another rule, which stays.", soft_wrap=True)
    out.print(f"{', '.join(written)} in {results.folder}", soft_wrap=True)
    if write:
        out.print(f"{write} written; simulate it with: gpuspec simulate {write}", soft_wrap=True)


def _write_tables(folder: Path, choice: Choice, found: list[Line]) -> None:
    import csv
    import json

    from gpuspec.sweeps.choosing.sensitivity import write_csv
    from gpuspec.version import __version__

    write_csv(folder / "sensitivity.csv", choice, found)
    with (folder / "front.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        keys = [a.key for a in choice.plan.axes]
        names = ("threshold_dn", "p1", "p2", "f1", "hits", "exact")
        table.writerow(["design", *keys, *names])
        for number in range(len(choice.front.design)):
            point = choice.described(choice.front, number)
            cells = [getattr(point, name) for name in names[:-1]]
            table.writerow(
                [point.design, *point.values.values(), *cells, "yes" if point.exact else "no"]
            )
    plan = choice.plan
    content: dict[str, Any] = {
        "gpuspec": __version__,
        **choice.details(),
        "rule": str(choice.rule),
        "fulfilled": choice.shortfall is None,
        "designs": plan.designs,
        "missing": plan.designs - choice.run.there(),
        "parts": plan.parts,
        "seeds": plan.seeds,
        "defects": choice.defects,
        "chosen": choice.best.as_dict(),
        "notes": choice.notes,
        "tolerated": {line.key: line.span(line.own) for line in found},
        "tolerated_at_threshold": {line.key: line.span(line.held) for line in found},
    }
    (folder / "chosen.json").write_text(json.dumps(content, indent=2) + "\n", "utf-8")


def _draw(folder: Path, choice: Choice, found: list[Line], maps: Any) -> None:
    from gpuspec.pictures.page import DPI
    from gpuspec.sweeps.choosing import diagrams
    from gpuspec.sweeps.choosing.front_picture import front_picture

    sketches = {
        "front.png": front_picture(choice),
        "sensitivity.png": diagrams.sensitivity_picture(choice, found),
    }
    varied = [line.key for line in found if len(line.values) > 1]
    mapped = maps.of(varied[: diagrams.MAPPED_KEYS])
    if mapped:
        sketches["maps.png"] = diagrams.maps_picture(choice, mapped)
    for name, figure in sketches.items():
        figure.savefig(folder / name, dpi=DPI)


def _print_choice(choice: Choice, found: list[Line]) -> None:
    from rich.text import Text

    from gpuspec.cli.tables import print_score, print_table
    from gpuspec.sweeps.choosing.sensitivity import SHARE

    out = console()
    best = choice.best
    there = choice.run.there()
    out.print(
        Text.assemble(
            (str(choice.run.path), "bold"),
            f": {words.plural(there, 'design')}, {len(choice.ranked.design):,} on the front",
        ),
        soft_wrap=True,
    )
    out.print(f"rule: {choice.rule}", soft_wrap=True)
    for note in _notes(choice, found, there):
        out.print(Text.assemble(("note: ", "yellow"), note), soft_wrap=True)
    tolerated = {line.key: line for line in found}
    rows = []
    for key, value in best.values.items():
        line = tolerated[key]
        ranges = (line.tolerated(course) for course in (line.own, line.held))
        rows.append((key, words.number(value), *ranges))
    heads = (f"design {best.design}", "chosen", f"within {SHARE:.0%}", "within, threshold held")
    print_table(rows, heads, title="chosen")
    bound = "" if best.exact else "<= "
    print_score(
        f"{bound}{best.p1:.4f}", f"{best.p2:.4f}", f"{bound}{best.f1:.4f}",
        [
            ("defects hit", f"{best.hits} of {choice.defects}", ""),
            ("threshold", f"{best.threshold_dn:.6g} DN", ""),
        ],
    )  # fmt: skip
    _print_next(choice, [line.key for line in found])


def _print_next(choice: Choice, keys: list[str]) -> None:
    """Print the designs after the chosen one, with as many keys as fit, the first ones first."""
    from gpuspec.cli.tables import fits, print_table

    others = range(1, min(NEXT + 1, len(choice.ranked.p1)))
    if not others:
        return
    points = [choice.described(choice.ranked, number) for number in others]
    for count in range(len(keys), -1, -1):
        shown = [key for key in choice.best.values if key in keys[:count]]
        heads = ("design", *_short(shown), "DN", "P1", "P2", "F1", "hits")
        rows = [
            (
                str(one.design), *(words.number(one.values[key]) for key in shown),
                f"{one.threshold_dn:.5g}", *(f"{v:.3f}" for v in (one.p1, one.p2, one.f1)),
                str(one.hits),
            )
            for one in points
        ]  # fmt: skip
        if fits(rows, heads, framed=False):
            break
    left_out = "" if len(shown) == len(keys) else "; all keys in front.csv"
    print_table(rows, heads, title=f"next on the front, by the rule{left_out}", framed=False,
                right=True)  # fmt: skip


def _short(keys: list[str]) -> list[str]:
    """Return keys without their section, where none is meant twice."""
    last = [key.rpartition(".")[2] for key in keys]
    return [word if last.count(word) == 1 else key for word, key in zip(last, keys, strict=True)]


def _notes(choice: Choice, lines: list[Line], there: int) -> list[str]:
    from gpuspec.sweeps.choosing.sensitivity import SHARE

    plan, best = choice.plan, choice.best
    found = []
    if there < plan.designs:
        found.append(
            f"{plan.designs - there:,} of {plan.designs:,} designs are missing; the same `gpuspec "
            f"sweep` goes on with them, and another design may then be chosen."
        )
    if not choice.front.exact.all():
        found.append(
            "the sweep was stopped before the front was made exact: its P1 is the most it may be; "
            "the same `gpuspec sweep` makes it exact."
        )
    invalid = choice.run.invalid()
    if invalid:
        found.append(f"{words.none_valid(invalid[0])}, e.g.: {invalid[1]}")
    if choice.shortfall:
        found.append(choice.shortfall)
    found += choice.notes
    area = plan.station.segmentation.min_area_mm2
    if area:
        found.append(
            f"the rule counts pixels, and segmentation.min_area_mm2 = {area:g} is left out of what "
            f"--write writes, so that it scores the same; --min-area-mm2 {area:g} chooses with it."
        )
    alone = [line.key for line in lines if line.alone]
    if alone:
        found.append(
            f"a lone peak: at the next values of {', '.join(alone)} the score falls by more than "
            f"{SHARE:.0%}, even with the threshold chosen anew. Another goal, fewer hits or a "
            f"higher P2 may choose a design with more room."
        )
    if plan.inspections > 1:
        details = choice.details()
        first = ""
        if "part_p1" in details:
            p1, p2, hits = (details[f"part_{name}"][0] for name in ("p1", "p2", "hits"))
            first = f", on which it has P1 {p1:.4f}, P2 {p2:.4f} and hits {hits} defects"
        found.append(
            f"the scores are over {plan.tries}, with {best.hits} of {choice.defects} defects "
            f"hit; a station file holds the first part{first}."
        )
    return found
