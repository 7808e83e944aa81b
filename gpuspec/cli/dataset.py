"""The command that makes data sets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gpuspec.cli.options import (
    BackendOption,
    DeviceOption,
    OutputOption,
    SetOption,
    StationArgument,
    changed,
)
from gpuspec.cli.terminal import (
    console,
    counted,
    extra,
    kept_in,
    note_space,
    print_assumptions,
    print_notes,
)

if TYPE_CHECKING:
    from gpuspec.datasets.dataset import DataSetMade
    from gpuspec.datasets.plan import DataSetPlan


def dataset(
    station: StationArgument,
    parts: Annotated[int, typer.Option("-n", "--parts", min=1, help="Parts, an image each.")] = 100,
    output: OutputOption = Path("dataset"),
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="KEY=FROM:TO",
            help="Draw a key anew for each part, e.g. sensor.exposure=2:6, or one of some values, "
            "e.g. part.material=silver,gold. Not given: the file's [dataset.vary] table.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Of the parts; else the file's.")
    ] = None,
    format_: Annotated[str, typer.Option("--format", help="Of the images: png or tif.")] = "png",
    bits: Annotated[
        int, typer.Option("--bits", help="A pixel: 8, 16, or 32, floats in a tif.")
    ] = 8,
    fusions: Annotated[
        bool, typer.Option("--fusions", help="Write the other fusions of the sequence, too.")
    ] = False,
    frames: Annotated[
        bool, typer.Option("--frames", help="Write every image of the sequence, too.")
    ] = False,
    licence: Annotated[
        str, typer.Option("--licence", "--license", help="Of the data set, e.g. CC-BY-4.0.")
    ] = "",
    backend: BackendOption = "auto",
    device: DeviceOption = None,
    change: SetOption = None,
) -> None:
    """Make images to train and test detectors on. Run again to go on where it was."""
    with extra("dataset"):
        from gpuspec.datasets.draws import VARY
        from gpuspec.datasets.folder import DataSetFolder
        from gpuspec.datasets.plan import DataSetPlan, Kept
    from gpuspec.simulation.cautions.station import assumptions
    from gpuspec.station.station import Station
    from gpuspec.sweeps.axes import vary_options

    plan = DataSetPlan.of(
        changed(Station.read(station), change),
        vary_options(vary, VARY) if vary else None,
        seed,
        Kept(format_, bits, fusions, frames, licence),  # type: ignore[arg-type]
    )
    folder = DataSetFolder(output, plan)
    folder.check(parts)
    note_space(folder.outputs(parts))
    print_notes(plan.notes)
    print_assumptions(assumptions(plan.station))
    made, seconds = _made(plan, parts, output, backend, device)
    _summarise(made, seconds)


def _made(
    plan: DataSetPlan, parts: int, output: Path, backend: str, device: str | None
) -> tuple[DataSetMade, float]:
    import time

    with extra("dataset"):
        from gpuspec.datasets.dataset import dataset as make

    start = time.perf_counter()
    with kept_in(output), counted(parts) as tell:
        made = make(plan, parts, output, backend=backend, device=device, progress=tell)
    return made, time.perf_counter() - start


def _summarise(made: DataSetMade, seconds: float) -> None:
    from rich.text import Text

    from gpuspec.cli.tables import print_table
    from gpuspec.words import plural

    out = console()
    rows = [(f"annotations/{split}.json", f"{count:,}") for split, count in made.parts.items()]
    print_table(rows, ("split", "images"))
    every = sum(made.defects.values())
    kinds = ", ".join(f"{count:,} {name}" for name, count in made.defects.items())
    out.print(f"{plural(every, 'defect')}: {kinds}; the station's own threshold finds "
              f"{made.found:,}", soft_wrap=True)  # fmt: skip
    total = sum(made.parts.values())
    rate = f", {made.made / seconds:,.1f} a second" if made.made else ""
    there = f"{total - made.made:,} were there already; " if made.made < total else ""
    out.print(
        Text.assemble(
            f"{plural(total, 'part')} ({there}{seconds:.1f} s{rate}); data sheet ",
            (str(made.folder / "README.md"), "bold"),
        ),
        soft_wrap=True,
    )
