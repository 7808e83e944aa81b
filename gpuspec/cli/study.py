"""The command `gpuspec study`. Each study is one call in Python, too."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gpuspec.cli.options import (
    BackendOption,
    DeviceOption,
    ForceOption,
    OutputOption,
    SetOption,
    StationArgument,
    changed,
)
from gpuspec.cli.terminal import console, print_notes, progress

if TYPE_CHECKING:
    from gpuspec.files import Outputs
    from gpuspec.station.station import Station
    from gpuspec.studies.outcome import Outcome

app = typer.Typer(
    help="Study a station: signature, height, coverage, tolerance. "
    "Each writes a figure and a table.",
    no_args_is_help=True,
)

DiameterOption = Annotated[
    float | None, typer.Option("--diameter-mm", help="Of a dent to study, with --depth-um.")
]
DepthOption = Annotated[float | None, typer.Option("--depth-um", help="Of a dent to study.")]


@app.command()
def signature(
    station: Annotated[Path | None, typer.Argument(help="Station file (TOML).")] = None,
    output: OutputOption = Path("study"),
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    diameter_mm: DiameterOption = None,
    depth_um: DepthOption = None,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Signature of a defect over its distance to a transition."""
    from gpuspec.studies import signature
    from gpuspec.studies.deflection import described
    from gpuspec.studies.outcome import outputs

    described_station = _read(station, change) if station else None
    if described_station is None and change:
        from gpuspec.errors import StationError

        raise StationError("--set changes a station; name a station file, too.")
    dent = described(diameter_mm, depth_um)
    _leave(
        outputs("signature", described_station, output, force=force),
        lambda _: signature.study(described_station, dent, backend=backend, device=device),
    )


@app.command()
def height(
    station: StationArgument,
    output: OutputOption = Path("study"),
    diameter_mm: DiameterOption = None,
    depth_um: DepthOption = None,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """How far height and orientation move the light point. Over the camera's distance."""
    from gpuspec.studies import height
    from gpuspec.studies.deflection import described
    from gpuspec.studies.outcome import outputs

    read, dent = _read(station, change), described(diameter_mm, depth_um)
    _leave(outputs("height", read, output, force=force), lambda _: height.study(read, dent))


@app.command()
def coverage(
    station: StationArgument,
    output: OutputOption = Path("study"),
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    diameter_mm: DiameterOption = None,
    depth_um: DepthOption = None,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """How near a transition comes to each point, and which are blind."""
    from gpuspec.studies import coverage
    from gpuspec.studies.deflection import described
    from gpuspec.studies.outcome import outputs

    read, dent = _read(station, change), described(diameter_mm, depth_um)
    _leave(
        outputs("coverage", read, output, force=force),
        lambda _: coverage.study(read, dent, backend, device),
    )


@app.command()
def tolerance(
    station: StationArgument,
    output: OutputOption = Path("study"),
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    offset_mm: Annotated[
        float, typer.Option("--offset-mm", help="Part aside and up, so far each way.")
    ] = 1.0,
    rotation_rad: Annotated[
        float, typer.Option("--rotation-rad", help="Part about z, so far each way.")
    ] = 0.05,
    height_mm: Annotated[
        float, typer.Option("--height-mm", help="Tunnel and camera, so far up and down.")
    ] = 5.0,
    reflectivity: Annotated[
        float, typer.Option("--reflectivity", help="Relative change, up and down.")
    ] = 0.3,
    steps: Annotated[int, typer.Option("--steps", help="Values tried of each; odd.")] = 7,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Tolerance of a design to pose, heights and reflectivity. Its threshold is held."""
    from gpuspec.studies import tolerance
    from gpuspec.studies.outcome import outputs

    read = _read(station, change)
    _leave(
        outputs("tolerance", read, output, force=force),
        lambda tell: tolerance.study(
            read,
            offset_mm=offset_mm,
            rotation_rad=rotation_rad,
            height_mm=height_mm,
            reflectivity=reflectivity,
            steps=steps,
            backend=backend,
            device=device,
            progress=tell,
        ),
    )


def _read(station: Path, change: list[str] | None) -> Station:
    from gpuspec.station.station import Station

    return changed(Station.read(station), change)


def _leave(results: Outputs, study: Callable[[Any], Outcome]) -> None:
    """Do a study, write its files into the folder, and say what it found."""
    from gpuspec.studies.outcome import files

    with results.writing() as partial, progress() as tell:
        outcome = study(tell)
        tell("drawing")
        outcome.write_files(partial)
    print_notes(outcome.notes)
    out = console()
    out.print(f"{outcome.station.file}, {outcome.name}: {outcome.info}", soft_wrap=True)
    for finding in outcome.findings():
        out.print(finding, soft_wrap=True)
    out.print(f"{', '.join(files(outcome.name))} in {results.folder}", soft_wrap=True)
