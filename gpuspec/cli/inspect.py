"""`gpuspec inspect`: the frames that a camera took, from files to blobs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gpuspec import words
from gpuspec.cli.options import (
    ColourOption,
    DarkOption,
    ForceOption,
    FramesArgument,
    GapsOption,
    OutputOption,
    PicturesOption,
    SetOption,
    changed,
)
from gpuspec.cli.terminal import console, print_notes, progress

if TYPE_CHECKING:
    from gpuspec.captured.captured import Captured


def inspect(
    frames: FramesArgument,
    station: Annotated[
        Path | None, typer.Option("--station", help="Station file: scale, classes, threshold.")
    ] = None,
    output: OutputOption = Path("inspection"),
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Label image of known defects, to score with.")
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(
            "--region",
            help="What is inspected: left,top,right,bottom in pixels, a polygon 'x,y x,y x,y', or "
            "the file of a mask, or found[:MARGIN]: where the light comes.",
        ),
    ] = None,
    dark: DarkOption = None,
    flat: Annotated[
        str | None, typer.Option("--flat", help="Frames of an evenly lit surface.")
    ] = None,
    colour: ColourOption = None,
    gaps: GapsOption = False,
    every_frame: Annotated[
        bool, typer.Option("--every-frame", help="Take all frames, whole periods or not.")
    ] = False,
    exposure: Annotated[
        str | None,
        typer.Option(
            "--exposure",
            help="Replay at exposures FROM:TO:COUNT times the frames' own, e.g. 1:16:9.",
        ),
    ] = None,
    silhouette: Annotated[
        str | None,
        typer.Option(
            "--silhouette",
            help="Compare the outline with the station's part: part; or with a polygon or mask; "
            "part:2.5 with a tolerance in pixels.",
        ),
    ] = None,
    pictures: PicturesOption = True,
    change: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Inspect a camera's frames."""
    from gpuspec.captured.inspect import inspect as inspected
    from gpuspec.captured.inspect import replayed
    from gpuspec.report.captured import outputs, write_files, write_replay
    from gpuspec.station.station import Station

    given = None if station is None else Station.read(station)
    if change:
        given = changed(given or Station(), change)
    exposures = None if exposure is None else _exposures(exposure)
    with progress() as tell:
        from gpuspec.frames.readers import sources

        found = sources(frames, colour=colour, gaps=gaps)  # type: ignore[arg-type]
        results = outputs(given or Station(), output, found.files, force=force)
        with results.writing() as partial:
            result = inspected(
                frames, given, truth=truth, region=region, dark=dark, flat=flat,
                colour=colour, gaps=gaps, every_frame=every_frame, silhouette=silhouette,  # type: ignore[arg-type]
                progress=tell,
            )  # fmt: skip
            write_files(result, partial, pictures=pictures, progress=tell)
            shown = None
            if exposures is not None:
                tell("replaying at other exposures")
                shown = replayed(frames, result, exposures, colour=colour, gaps=gaps)  # type: ignore[arg-type]
                write_replay(shown, f"{result.made}  ·  {result.about}", partial)
    _summarise(result, output)
    if shown is not None:
        ratio = shown.ratio.max()
        console().print(
            f"exposure {shown.best:.3g} times that of the frames shows scratches best: contrast is "
            f"{ratio:.1f} times the noise (exposure.png)", soft_wrap=True,
        )  # fmt: skip


def _exposures(text: str) -> list[float]:
    """Return exposures at equal ratios between two ends."""
    from gpuspec.errors import FrameError

    try:
        first, last, count = text.split(":")
        ends, number = (float(first), float(last)), int(count)
    except ValueError:
        ends, number = (0.0, 0.0), 0
    if not (0 < ends[0] < ends[1] <= 1e4 and 2 <= number <= 100):
        raise FrameError(
            f"--exposure {text} is no range; write FROM:TO:COUNT with 0 < FROM < TO and 2 to 100 "
            f"exposures, e.g. 1:16:9."
        )
    step = (ends[1] / ends[0]) ** (1 / (number - 1))
    return [ends[0] * step**k for k in range(number)]


def _summarise(result: Captured, output: Path) -> None:
    from rich.text import Text

    from gpuspec.cli.tables import print_score, print_table, threshold_row
    from gpuspec.report.folder import classes_of

    out = console()
    out.print(f"{result.made}: {result.about}", soft_wrap=True)
    classes = ", ".join(f"{count:,} {name}" for name, count in classes_of(result).items())
    rows = [
        ("blobs", f"{len(result.blobs):,}", classes),
        threshold_row(result.inspection),
    ]
    if result.silhouette is not None:
        rows.append(("outline", result.silhouette.told, result.silhouette.scored))
    if result.station.decision:
        verdict = "accept" if result.decision.accepted else "reject"
        rows.append(("decision", verdict, "; ".join(result.decision.reasons)))
    score = result.score
    if score:
        print_score(
            words.precision(score.p1, score.hit_px + score.false_px),
            f"undefined ({score.undefined})" if score.p2 is None else f"{score.p2:.3f}",
            "-" if score.f1 is None else f"{score.f1:.3f}",
            [("defects hit", *score.hits), *rows],
        )
    else:
        print_table(rows, whole=[1], framed=False)
    print_notes(result.warnings)
    out.print(Text.assemble("results in ", (str(output), "bold")), soft_wrap=True)
