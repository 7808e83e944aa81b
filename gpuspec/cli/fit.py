"""`gpuspec fit`: the frames of an even part, and the station that would take them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gpuspec.cli.options import (
    ColourOption,
    DarkOption,
    ForceOption,
    FramesArgument,
    GapsOption,
    SetOption,
    changed,
)
from gpuspec.cli.terminal import console, print_notes, progress

if TYPE_CHECKING:
    from gpuspec.captured.fit import Fit
    from gpuspec.captured.smallest import Smallest
    from gpuspec.station.station import Station


def fit(
    frames: FramesArgument,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="FILE",
            help="Station file of the twin; beside it its numbers (.json) and a picture (.png).",
        ),
    ] = Path("twin.toml"),
    station: Annotated[
        Path | None,
        typer.Option("--station", help="Station file with what is known: scale, heights, lens."),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(
            "--region",
            help="Where the part is: left,top,right,bottom in pixels, a polygon 'x,y x,y x,y', or "
            "the file of a mask; else it is found.",
        ),
    ] = None,
    dark: DarkOption = None,
    colour: ColourOption = None,
    gaps: GapsOption = False,
    defects: Annotated[
        bool, typer.Option("--defects/--no-defects", help="Ask which defects the twin finds.")
    ] = True,
    backend: Annotated[str, typer.Option("--backend", help="What simulates the twin.")] = "auto",
    device: Annotated[
        str | None, typer.Option("--device", help="Part of the device's name, or its number.")
    ] = None,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:  # fmt: skip
    """Fit a station to the frames of an even part: its twin."""
    from gpuspec.captured.fit import fit as fitted
    from gpuspec.frames.readers import sources
    from gpuspec.report.twin import outputs, write_files

    known = _known(station, change)
    with progress() as tell:
        found = sources(frames, colour=colour, gaps=gaps)  # type: ignore[arg-type]
        results = outputs(output, (*known.inputs, *found.files), force=force)
        with results.writing() as partial:
            result = fitted(
                frames, known, region=region, dark=dark, colour=colour, gaps=gaps,  # type: ignore[arg-type]
                defects=defects, backend=backend, device=device, progress=tell,
            )  # fmt: skip
            write_files(result, partial, output.stem)
    _summarise(result, output)


def _known(path: Path | None, change: list[str] | None) -> Station:
    """Return what is known of the station, and nothing besides as if it were said."""
    from gpuspec.station.station import Station

    read = Station() if path is None else Station.read(path)
    if not change:
        return read
    whole = changed(read, change)
    said = {
        section: set(getattr(read, section).model_fields_set)
        for section in ("part", "tunnel", "camera", "sensor", "sequence", "segmentation")
    }
    for one in change:
        section, _, key = one.partition("=")[0].strip().partition(".")
        said.get(section, set()).add(key.partition(".")[0])
    data: dict[str, Any] = whole.as_dict()
    for section, keys in said.items():
        data[section] = {key: value for key, value in data[section].items() if key in keys}
    return Station.from_dict(data, whole.file, path.parent if path else ".")


def _summarise(result: Fit, output: Path) -> None:
    from rich.text import Text

    from gpuspec.cli.tables import print_table
    from gpuspec.report.twin import compared

    out = console()
    out.print(f"{result.kind} fitted to {result.about}", soft_wrap=True)
    rows = [(one.name, f"{one.measured} {one.unit}".strip(), one.meaning) for one in result.numbers]
    print_table(rows, ("", "standard uncertainty", "key or meaning"), framed=False)
    print_table(
        compared(result.real, result.twin), ("aspect image", "frames", "twin"), framed=False
    )
    out.print("not told by these frames:", soft_wrap=True)
    for one in result.unknown:
        out.print(f"- {one}", soft_wrap=True)
    if result.smallest:
        _print_defects(result.smallest)
    print_notes(result.warnings)
    names = ", ".join(str(output.with_suffix(end)) for end in (".toml", ".json", ".png"))
    out.print(Text.assemble("results in ", (names, "bold")), soft_wrap=True)


def _print_defects(found: Smallest) -> None:
    out = console()
    for exposure, threshold in found.threshold_dn.items():
        for kind in dict.fromkeys(one.kind for one in found.rows):
            rows = [one for one in found.rows if (one.kind, one.exposure) == (kind, exposure)]
            depths = ", ".join(
                f"{one.size_mm:.3g} mm "
                + ("not" if one.depth_um is None else f"from {one.depth_um:g} µm")
                for one in rows
            )
            least = found.of(kind, exposure)
            said = "none" if least is None else f"{least.size_mm:.3g} mm, {least.depth_um:g} µm"
            measure = "diameter" if kind == "dent" else "width"
            out.print(
                f"smallest {kind} found at exposure {exposure:.3g} (threshold {threshold:.1f} DN): "
                f"{said}; by {measure}: {depths}", soft_wrap=True,
            )  # fmt: skip
