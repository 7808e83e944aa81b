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
    from gpuspec.station.station import Station
    from gpuspec.studies.deflection import Dent
    from gpuspec.studies.outcome import Outcome

app = typer.Typer(
    help="Study a station: signature, coverage, threshold and more. "
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

    described_station = _read(station, change) if station else None
    if described_station is None and change:
        from gpuspec.errors import StationError

        raise StationError("--set changes a station; name a station file, too.")
    dent = _dent(diameter_mm, depth_um)
    _leave(
        "signature", described_station, output, force,
        lambda _: signature.study(described_station, dent, backend=backend, device=device),
    )  # fmt: skip


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

    read, dent = _read(station, change), _dent(diameter_mm, depth_um)
    _leave("height", read, output, force, lambda _: height.study(read, dent))


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

    read, dent = _read(station, change), _dent(diameter_mm, depth_um)
    _leave("coverage", read, output, force, lambda _: coverage.study(read, dent, backend, device))


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
    tilt_rad: Annotated[
        float, typer.Option("--tilt-rad", help="Part and camera about x and y, so far each way.")
    ] = 0.005,
    camera_tilt_rad: Annotated[
        float | None, typer.Option("--camera-tilt-rad", help="The camera, if another way.")
    ] = None,
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
    """Tolerance of a design to pose, heights, light and [tolerance].

    Its threshold is held.
    """
    from gpuspec.studies import tolerance

    read = _read(station, change)
    _leave(
        "tolerance", read, output, force,
        lambda tell: tolerance.study(
            read, offset_mm=offset_mm, rotation_rad=rotation_rad, tilt_rad=tilt_rad,
            camera_tilt_rad=camera_tilt_rad, height_mm=height_mm, reflectivity=reflectivity,
            steps=steps, backend=backend, device=device, progress=tell,
        ),
    )  # fmt: skip


@app.command()
def threshold(
    station: StationArgument,
    output: OutputOption = Path("study"),
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    levels: Annotated[int, typer.Option("--levels", help="Thresholds tried.")] = 200,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """What each threshold finds, and which find all and nothing else."""
    from gpuspec.studies import threshold

    read = _read(station, change)
    _leave(
        "threshold", read, output, force,
        lambda tell: threshold.study(read, levels, backend, device, tell),
    )  # fmt: skip


def _read(station: Path, change: list[str] | None) -> Station:
    from gpuspec.station.station import Station

    return changed(Station.read(station), change)


def _dent(diameter_mm: float | None, depth_um: float | None) -> Dent | None:
    from gpuspec.studies.deflection import described

    return described(diameter_mm, depth_um)


def _leave(
    name: str,
    station: Station | None,
    folder: Path,
    force: bool,
    study: Callable[[Any], Outcome],
) -> None:
    """Do a study, write its files into the folder, and say what it found."""
    from gpuspec.studies.outcome import files, outputs

    results = outputs(name, station, folder, force=force)
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
