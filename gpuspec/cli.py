"""The command line. Each command is one call in Python, too."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gpuspec import __version__, completion, words
from gpuspec.devices_command import devices
from gpuspec.errors import GpuspecError
from gpuspec.keys_command import reference
from gpuspec.studies import commands as studies
from gpuspec.sweeps.commands import sweep
from gpuspec.sweeps.front_command import front
from gpuspec.sweeps.optimise_command import optimise
from gpuspec.terminal import (
    BackendOption,
    DeviceOption,
    ForceOption,
    FramesOption,
    OutputOption,
    PicturesOption,
    SetOption,
    StationArgument,
    changed,
    console,
    note_space,
    output_option,
    print_assumptions,
    print_notes,
    progress,
    show_warnings_as_notes,
    standard_output,
)

if TYPE_CHECKING:
    from gpuspec.inspection import Result
    from gpuspec.station import Station

app = typer.Typer(
    name="gpuspec",
    help="Design, test and optimise inspection stations for specular parts before building them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # of a help text no word is markup: [sweep] is the file's table
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(studies.app, name="study")


@app.command()
def simulate(
    station: StationArgument,
    output: OutputOption = Path("run"),
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    frames: FramesOption = False,
    pictures: PicturesOption = True,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Simulate a station: images, segmentation, score, pictures."""
    from gpuspec.station import Station

    _run(changed(Station.read(station), change), output, backend, device, frames, pictures, force)


@app.command()
def demo(
    name: Annotated[
        str, typer.Argument(help="trim or measured.", autocompletion=completion.examples)
    ] = "trim",
    output: OutputOption = Path("demo"),
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    frames: FramesOption = False,
    pictures: PicturesOption = True,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Simulate a station that comes with gpuspec."""
    from gpuspec.stationfile import example

    _run(changed(example(name), change), output, backend, device, frames, pictures, force)


@app.command()
def prototype(
    station: StationArgument,
    pattern: Annotated[
        str,
        typer.Option(
            "--pattern",
            help="GLSL file, or the name of a shipped pattern.",
            autocompletion=completion.patterns,
        ),
    ],
    output: Annotated[
        Path | None,
        output_option("For the results. Not given: prototype, or watch with --watch."),
    ] = None,
    backend: Annotated[
        str, typer.Option("--backend", help="opengl or vulkan; auto takes the first that computes.")
    ] = "auto",
    device: DeviceOption = None,
    frames: Annotated[
        str, typer.Option("--frames", help="Write the sequence: a .gif, or a folder for PNGs.")
    ] = "",
    watching: Annotated[bool, typer.Option("--watch", help="Render again on each save.")] = False,
    limit: Annotated[
        float, typer.Option("--limit", help="Longest a pattern may run, in seconds.", min=0.1)
    ] = 20.0,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Try a light of your own. Its images, aspect image, segmentation and score come at once."""
    from gpuspec.patterns import Pattern
    from gpuspec.prototype import bench, planned, watch
    from gpuspec.station import Station

    described = changed(Station.read(station), change)
    where = output or Path("watch" if watching else "prototype")
    plan = planned(described, where, Path(pattern), frames, glance=watching, force=force)
    note_space(*filter(None, (plan.results, plan.sequence)))

    def render() -> None:
        light = Pattern.read(pattern)
        rendered = made.written(light, plan)
        made_by, score = rendered.summary, rendered.summary["score"]
        p1 = words.precision(score["p1"], score["hit_px"] + score["false_px"])
        p2 = "undefined" if score["p2"] is None else f"{score['p2']:.3f}"
        print(
            f"{light.file}: {words.P1} {p1}, {words.P2} {p2} ({words.BEST}), "
            f"{score['defects_hit']} of {score['defects']} defects hit, {score['false_blobs']} "
            f"false blobs; {rendered.seconds:.2f} s, {made_by['backend']} on {made_by['device']}, "
            f"results in {where}"
        )
        print_notes(rendered.summary["warnings"])
        print_assumptions(rendered.summary["assumptions"])
        if rendered.faulty:
            print(
                f"note: {light.file} gave NaN or values outside [0, 1] in {rendered.faulty:.1%} of "
                f"the samples; they count as 0 and as the nearer bound."
            )

    def render_again() -> None:
        try:
            render()
        except GpuspecError as error:
            print(f"error: {error}\nthe last good picture stays.", file=sys.stderr)

    with bench(described, backend, device, limit) as made:
        if watching:
            print(f"watching {pattern}; Ctrl-C ends.", file=sys.stderr)
            watch(Path(pattern), render_again)
        else:
            render()


app.command()(sweep)
app.command()(front)
app.command()(optimise)
app.command()(devices)
app.command()(reference)


@app.command()
def init(
    path: Annotated[Path, typer.Argument(help="Station file to write, e.g. my_station.toml.")],
    name: Annotated[
        str,
        typer.Option(
            "--example",
            help="What to start from: trim or measured.",
            autocompletion=completion.examples,
        ),
    ] = "trim",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a station file to start from, every key explained."""
    from gpuspec.errors import OutputError
    from gpuspec.files import write_new
    from gpuspec.stationfile import example, to_toml

    if path.name in ("", ".."):
        raise OutputError(f"{path} is a folder; name a file in it, e.g. {path / 'station.toml'}.")
    if not path.suffix:
        path = path.with_suffix(".toml")
    write_new(path, to_toml(example(name), sized=False), force=force)
    print(f"{path} written; simulate it with: gpuspec simulate {path}")


@app.command()
def schema() -> None:
    """Print the JSON schema of the station file, for editors."""
    from gpuspec.station import Station

    print(json.dumps(Station.model_json_schema(), indent=2))


def _version(asked: bool) -> None:
    if asked:
        print(f"gpuspec {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    from gpuspec import cache

    cache.lend()


def _run(
    station: Station, output: Path, backend: str, device: str | None, frames: bool, pictures: bool,
    force: bool,
) -> None:  # fmt: skip
    from gpuspec.inspection import check_memory, simulate
    from gpuspec.report import outputs, write_files

    results = outputs(station, output, frames=frames, force=force)
    results.check()
    check_memory(station)
    note_space(results)
    with results.writing() as partial, progress() as tell:
        result = simulate(station, backend, device, tell)
        write_files(result, partial, frames=frames, pictures=pictures, progress=tell)
    _summarise(result, output, backend == "auto")


def _summarise(result: Result, output: Path, chosen: bool) -> None:
    from rich.text import Text

    from gpuspec.devices import BACKENDS
    from gpuspec.tables import print_score, print_table

    score = result.score
    rows, columns = result.station.shape
    out = console()
    out.print(
        Text.assemble(
            (result.station.file, "bold"),
            f": {columns} x {rows} pixels, {result.station.sequence.images} images, {result.info}",
            f", the first of {', '.join(BACKENDS)} that computes" if chosen else "",
        ),
        soft_wrap=True,
    )
    print_score(
        words.precision(score.p1, score.hit_px + score.false_px),
        f"undefined ({score.undefined})" if score.p2 is None else f"{score.p2:.3f}",
        "-" if score.f1 is None else f"{score.f1:.3f}",
        [
            ("defects hit", f"{score.defects_hit} of {score.defects}", ""),
            ("blobs", f"{score.blobs}", f"{score.false_blobs} false"),
            ("threshold", f"{result.threshold:.1f} DN", f"flawless {result.flawless_dn:.1f} DN"),
        ],
    )
    if score.defects or score.blobs:
        found = zip(result.confusion.rows, result.confusion.counts, strict=True)
        table = [(name, *map(str, counts)) for name, counts in found]
        print_table(table, ["known \\ found", *result.confusion.columns], title="classes")
    print_notes(result.warnings)
    print_assumptions(result.assumptions)
    out.print(Text.assemble("results in ", (str(output), "bold")), soft_wrap=True)


class _Stopped(BaseException):
    """Ctrl-C or SIGTERM; typer would answer a KeyboardInterrupt itself, each version otherwise."""


def _stop(*_: object) -> None:
    raise _Stopped


def main() -> None:
    """Run the command line; a user's mistake ends in one sentence and exit code 1."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop)
    show_warnings_as_notes()
    try:
        with standard_output():
            app()
    except GpuspecError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except (_Stopped, KeyboardInterrupt):
        print("stopped; nothing half-written was left.", file=sys.stderr)
        sys.exit(130)
    except MemoryError:
        print("error: out of memory; use a larger camera.sampling_mm, or fewer camera.columns and "
              "camera.rows.", file=sys.stderr)  # fmt: skip
        sys.exit(1)
