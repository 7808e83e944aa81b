"""`gpuspec simulate` and `gpuspec demo`: a station from part to score."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gpuspec import words
from gpuspec.cli import completion
from gpuspec.cli.options import (
    BackendOption,
    DeviceOption,
    ForceOption,
    FramesOption,
    OutputOption,
    PicturesOption,
    SetOption,
    StationArgument,
    changed,
)
from gpuspec.cli.terminal import console, note_space, print_assumptions, print_notes, progress

if TYPE_CHECKING:
    from gpuspec.simulation.result import Result
    from gpuspec.station.station import Station


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
    from gpuspec.station.station import Station

    _run(changed(Station.read(station), change), output, backend, device, frames, pictures, force)


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
    from gpuspec.station.examples import example

    _run(changed(example(name), change), output, backend, device, frames, pictures, force)


def _run(
    station: Station, output: Path, backend: str, device: str | None, frames: bool, pictures: bool,
    force: bool,
) -> None:  # fmt: skip
    from gpuspec.report.folder import outputs, write_files
    from gpuspec.simulation.memory import check_memory
    from gpuspec.simulation.simulate import simulate

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

    from gpuspec.cli.tables import print_score, print_table, threshold_row
    from gpuspec.light.devices import BACKENDS

    score = result.score
    rows, columns = result.station.shape
    refined = []
    if result.station.camera.subsampling == "auto":
        pixels, rays = result.refined["pixels"], result.refined["sub_rays"]
        refined = [("refined pixels", f"{pixels:,}", words.plural(rays, "sub-ray"))]
    outline = []
    if result.silhouette is not None:
        outline = [("outline", result.silhouette.told, result.silhouette.scored)]
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
            ("defects hit", *score.hits),
            ("blobs", f"{score.blobs}", f"{score.false_blobs} false"),
            threshold_row(result.inspection),
            *refined,
            *outline,
        ],
    )
    if score.defects or score.blobs:
        found = zip(result.confusion.rows, result.confusion.counts, strict=True)
        table = [(name, *map(str, counts)) for name, counts in found]
        print_table(table, ["known \\ found", *result.confusion.columns], title="classes")
    if e := result.expected:
        recall = "" if e.p2 is None else f", P2 {e.p2:.3f} ± {e.p2_deviation:.4f}"
        out.print(
            f"over all draws of the noise: P1 {e.p1:.3f} ± {e.p1_deviation:.4f}{recall}, "
            f"{e.defects_hit:.1f} ± {e.defects_hit_deviation:.1f} defects hit", soft_wrap=True,
        )  # fmt: skip
    print_notes(result.warnings)
    print_assumptions(result.assumptions)
    out.print(Text.assemble("results in ", (str(output), "bold")), soft_wrap=True)
