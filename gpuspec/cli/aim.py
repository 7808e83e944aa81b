"""What `gpuspec front` does with goals and requirements: it chooses, prints, and draws."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpuspec import words
from gpuspec.cli.terminal import console, extra, progress

if TYPE_CHECKING:
    from gpuspec.files import Outputs
    from gpuspec.sweeps.aim import Aim
    from gpuspec.sweeps.choosing.aimed import AimChoice, Held
    from gpuspec.sweeps.keeping.folder import RunFolder

FILES = ("front.csv", "chosen.json", "front.png", "front.html")
RULES = (None, "paper", "p1", "p2", "f1")
"""Goals that are those of the paper's rule, where nothing else is required."""

NEXT = 3
_SHOWN = ("margin_dn", "margin_sigma", "hits", "false_blobs", "smallest_mm", "images", "light_e",
          "cycle_s")  # fmt: skip


@dataclass(frozen=True)
class Asked:
    """What was asked for beside the run.

    Attributes
    ----------
    aim : Aim
    over : tuple of str, or None
    min_area_mm2 : float or None
    """

    aim: Aim
    over: tuple[str, ...] | None
    min_area_mm2: float | None


def told_apart(
    given: Sequence[str], require: Sequence[str] | None, what: str
) -> tuple[Path, list[str]]:
    """Return what a command is about, and all requirements.

    One option takes one word: requirements after the first stand without.

    Parameters
    ----------
    given : sequence of str
        What stands without an option.
    require : sequence of str or None
        Of the option.
    what : str
        What the command is about, e.g. "folder of a sweep".

    Raises
    ------
    StationError
        If none or more than one is named.
    """
    from gpuspec.errors import StationError
    from gpuspec.sweeps.aim import is_requirement

    asked_for = [text for text in given if is_requirement(text) and not Path(text).exists()]
    places = [text for text in given if text not in asked_for]
    if len(places) != 1:
        raise StationError(
            f"name one {what}, not {len(places)}; a requirement is written with =, "
            f'<= or >=, e.g. --require "hits = all".'
        )
    return Path(places[0]), [*(require or ()), *asked_for]


def asked(
    given: Sequence[str],
    goal: str | None,
    require: Sequence[str] | None,
    over: str | None,
    min_area_mm2: float | None,
) -> tuple[Path, Asked | None]:
    """Return the folder of a run and what is asked for; None: the paper's rule.

    Parameters
    ----------
    given : sequence of str
        What stands without an option: the folder, and requirements after the first.
    goal, require, over, min_area_mm2
        Of the options.

    Raises
    ------
    StationError
        If no folder or more than one is named, or what is asked for cannot be.
    """
    from gpuspec.errors import StationError
    from gpuspec.sweeps.aim import Aim
    from gpuspec.sweeps.measures import measure
    from gpuspec.sweeps.rule import Rule

    place, required = told_apart(given, require, "folder of a sweep")
    if goal in RULES and not required:
        if over is None and min_area_mm2 is None:
            return place, None
        if over is None or goal is not None:  # the paper's rule stays, whatever is measured
            goal, required = goal or "paper", ["hits = all", f"p2 >= {Rule().p2_floor:g}"]
    names: tuple[str, ...] | None = None
    if over is not None:
        names = tuple(name.strip() for name in over.split(","))
        if not 2 <= len(names) <= 3 or len(set(names)) < len(names):
            raise StationError(
                f"--over {over} names no two or three measures; write --over margin_dn,images."
            )
        for name in names:
            measure(name)
    chosen = "margin_dn" if goal is None else "p1" if goal == "paper" else goal
    return place, Asked(Aim(chosen, tuple(required)), names, min_area_mm2)  # type: ignore[arg-type]


def check_no_floors(floors: Mapping[str, float]) -> None:
    """See that no floor of the paper's rule stands beside an aim.

    Raises
    ------
    StationError
        With what to write in its place.
    """
    from gpuspec.errors import StationError

    if floors:
        name, value = next(iter(floors.items()))
        means = {"p2_floor": f"p2 >= {value:g}", "p1_floor": f"p1 >= {value:g}"}
        raise StationError(
            f"--{name.replace('_', '-')} belongs to the paper's rule; beside other goals and "
            f'requirements write --require "{means.get(name, "hits >= NUMBER")}".'
        )


def check_beside(run: Path, place: Path, write: Path | None) -> None:
    """Refuse to write into the sweep itself.

    Parameters
    ----------
    run : Path
        The sweep's folder.
    place : Path
        Of the results.
    write : Path or None
        Of the chosen station.

    Raises
    ------
    OutputError
        If one of them would lie among what the sweep keeps.
    """
    from gpuspec.errors import OutputError

    own = (run / "designs").resolve()
    if place.resolve() == own or (write and write.resolve().parent in (run.resolve(), own)):
        raise OutputError(
            f"{run} holds the sweep itself; choose another place for what is made of it."
        )


def opened(
    run: Path, output: Path | None, write: Path | None, rule: str, files: tuple[str, ...], *,
    force: bool,
) -> tuple[RunFolder, Outputs]:  # fmt: skip
    """Read a sweep, and see that what is chosen from it can be written.

    Parameters
    ----------
    run : Path
    output, write : Path or None
        For the results, and for the chosen station.
    rule : str
        By which is chosen.
    files : tuple of str
        Names of what is written.
    force : bool

    Raises
    ------
    OutputError
        If the folder holds no sweep, or something is in the way.
    """
    from gpuspec.files import Outputs, check_new
    from gpuspec.sweeps.keeping.folder import RunFolder

    swept = RunFolder.read(run)
    inputs = swept.plan.station.inputs
    if write:
        check_new(write, force=force, inputs=inputs)
    of = {"rule": rule, "sweep": swept.name}
    results = Outputs(output or run / "front", "front", files, inputs, force=force, of=of)
    if output is None:
        results = results.apart()
    results.check()
    return swept, results


def by_aim(
    run: Path, what: Asked, floors: Mapping[str, float], output: Path | None, write: Path | None, *,
    force: bool, pictures: bool, backend: str, device: str | None,
) -> None:  # fmt: skip
    """Choose by goals and requirements, write what is chosen, and print it.

    Parameters
    ----------
    run : Path
    what : Asked
    floors : mapping
        Of the paper's rule, which are refused here.
    output, write : Path or None
    force, pictures : bool
    backend, device : str

    Raises
    ------
    OutputError
        If the place for the results is that of the sweep itself.
    """
    with extra("sweep"):
        from gpuspec.sweeps.choosing.aimed import choose_for
    from gpuspec.files import write_new
    from gpuspec.station.toml import to_toml

    check_no_floors(floors)
    check_beside(run, output or run / "front", write)
    with progress() as tell:
        tell("choosing")
        swept, results = opened(run, output, write, str(what.aim), FILES, force=force)
        choice = choose_for(
            swept, what.aim, what.over, min_area_mm2=what.min_area_mm2, backend=backend,
            device=device,
        )  # fmt: skip
        if write:
            text = to_toml(choice.station(), absolute=True)
            write_new(write, text, force=force, inputs=results.inputs)
        missing = ""
        with results.writing() as partial:
            _write_front(partial / "front.csv", choice)
            (partial / "chosen.json").write_text(_summary(choice), "utf-8")
            if pictures:
                tell("drawing")
                missing = _draw(partial, choice)
            written = [name for name in FILES if (partial / name).exists()]
    _print(choice)
    out = console()
    if missing:
        out.print(f"note: {missing}", soft_wrap=True)
    out.print(f"{', '.join(written)} in {results.folder}", soft_wrap=True)
    if write:
        out.print(f"{write} written; simulate it with: gpuspec simulate {write}", soft_wrap=True)


def _draw(folder: Path, choice: AimChoice) -> str:
    """Draw the front as a picture and as a page; return why there is no page, or ""."""
    from gpuspec.pictures.page import DPI
    from gpuspec.sweeps.choosing.aim_picture import aim_picture

    aim_picture(choice).savefig(folder / "front.png", dpi=DPI)
    try:
        from gpuspec.sweeps.choosing.aim_page import aim_page
    except ModuleNotFoundError as error:
        from gpuspec.errors import ExtraError

        return f"front.html is left out: {ExtraError.of(error, 'page')}"
    (folder / "front.html").write_text(aim_page(choice), "utf-8")
    return ""


def _write_front(path: Path, choice: AimChoice) -> None:
    keys = [a.key for a in choice.plan.axes]
    names = [name for name in choice.front.values if name != "room"]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["design", *keys, "threshold_dn", *names])
        for number, design in enumerate(choice.front.design.tolist()):
            values = [f"{choice.front.values[name][number]:.9g}" for name in names]
            table.writerow(
                [design, *choice.plan.values(design).values(),
                 choice.threshold_dn(choice.front, number), *values]
            )  # fmt: skip


def _summary(choice: AimChoice) -> str:
    from gpuspec.version import __version__

    def about(held: Held) -> dict[str, Any]:
        measures = {k: None if v != v else v for k, v in held.values.items()}
        return {
            "design": held.design, "values": choice.plan.values(held.design),
            "threshold_dn": held.threshold_dn, "measures": measures,
            "room_within_tolerances_dn": held.room_dn, "neighbours": held.tried,
            **held.confirmed.spread(),
        }  # fmt: skip

    content = {
        "gpuspec": __version__,
        "rule": str(choice.aim),
        "designs": choice.plan.designs,
        "meeting": len(choice.ranked.design),
        "parts": choice.plan.parts,
        "seeds": choice.plan.seeds,
        "defects": choice.all_of["hits"],
        "tolerances": dict(choice.tolerances.halves),
        "peak": about(choice.peak),
        "robust": about(choice.robust),
    }
    return json.dumps(content, indent=2) + "\n"


def _print(choice: AimChoice) -> None:
    from rich.text import Text

    from gpuspec.cli.tables import print_table
    from gpuspec.simulation.cautions.station import listed
    from gpuspec.sweeps.measures import MEASURES

    out, plan = console(), choice.plan
    count = len(choice.ranked.design)
    out.print(
        Text.assemble(
            (str(choice.run.path), "bold"),
            f": {words.plural(plan.designs, 'design')}, {count:,} of them meet what is required, "
            f"{len(choice.front.design):,} on the front of {listed(choice.over)}",
        ),
        soft_wrap=True,
    )
    out.print(f"aim: {choice.aim}", soft_wrap=True)
    out.print(f"tolerances: {choice.tolerances}", soft_wrap=True)
    pair = (choice.peak, choice.robust)
    keys = [(key, *(words.number(plan.values(one.design)[key]) for one in pair))
            for key in plan.values(0)]  # fmt: skip
    rows = [*keys, ("threshold, DN", *(f"{one.threshold_dn:.5g}" for one in pair))]
    names = dict.fromkeys([choice.aim.goal, *choice.over, *_SHOWN])
    values = [one.values for one in pair]
    for name in names:
        shown = [v[name] for v in values]
        if all(one == one for one in shown):
            of = f" of {choice.all_of[name]}" if name in choice.all_of else ""
            rows.append((name, *(f"{MEASURES[name].shown(one)}{of}" for one in shown)))
    rows.append(("room within tolerances", *(f"{one.room_dn:.1f} DN" for one in pair)))
    print_table(rows, ("", "peak", "robust"), title="chosen")
    for note in _notes(choice):
        out.print(Text.assemble(("note: ", "yellow"), note), soft_wrap=True)
    others = choice.next(NEXT)
    if len(others.design):
        told = dict.fromkeys([choice.aim.goal, *choice.over])
        heads = ("design", *plan.values(0), "DN", *told)
        lines = [
            (
                str(design), *(words.number(v) for v in plan.values(design).values()),
                f"{choice.threshold_dn(others, number):.5g}",
                *(f"{others.values[name][number]:.5g}" for name in told),
            )
            for number, design in enumerate(others.design.tolist())
        ]  # fmt: skip
        print_table(lines, heads, title="next", framed=False, right=True)


def _notes(choice: AimChoice) -> list[str]:
    found = []
    robust, peak = choice.robust, choice.peak
    if robust.design == peak.design and robust.room_dn < 0:
        found.append(
            "no design finds all that is required and nothing else within these tolerances, its "
            "threshold held; state smaller ones in [tolerance], or sweep a finer grid."
        )
    elif peak.room_dn < 0:
        found.append(
            f"within the tolerances the peak misses a defect that is required, or detects "
            f"something else at its threshold; the robust design {robust.design} does not, and is "
            f"what is written."
        )
    if robust.station.segmentation.min_area_mm2:
        found.append(
            "the room within the tolerances is one of levels: segmentation.min_area_mm2 leaves out "
            "a blob that is too small for it, however bright; gpuspec study tolerance looks at "
            "the blobs."
        )
    spread = robust.confirmed.spread()
    low, high = spread["hit_share_95"]
    if choice.plan.inspections > 1:
        mean, worst = spread["mean"], spread["worst"]
        found.append(
            f"over {choice.plan.tries} the robust design has P1 {mean['p1']:.3f} on average "
            f"and {worst['p1']:.3f} at worst, P2 {mean['p2']:.3f} and {worst['p2']:.3f}; it hits "
            f"{100 * spread['hit_share']:.1f} % of the defects ({100 * low:.1f} to "
            f"{100 * high:.1f} % with 95 % confidence)."
        )
    for number, expected in enumerate(spread.get("expected", ())[:1]):
        found.append(
            f"over all draws of its noise part {number} has P1 {expected['p1']:.3f} +- "
            f"{expected['p1_deviation']:.3f} and {expected['defects_hit']:.2f} +- "
            f"{expected['defects_hit_deviation']:.2f} defects hit."
        )
    return found
