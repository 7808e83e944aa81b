"""`gpuspec prototype`: a light of the user's own."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from gpuspec import words
from gpuspec.cli import completion
from gpuspec.cli.options import (
    DeviceOption,
    ForceOption,
    SetOption,
    StationArgument,
    changed,
    output_option,
)
from gpuspec.cli.terminal import note_space, print_assumptions, print_notes
from gpuspec.errors import GpuspecError


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
    from gpuspec.light.patterns import Pattern
    from gpuspec.prototype import bench, planned, watch
    from gpuspec.station.station import Station

    described = changed(Station.read(station), change)
    where = output or Path("watch" if watching else "prototype")
    plan = planned(described, where, Path(pattern), frames, glance=watching, force=force)
    note_space(*filter(None, (plan.results, plan.sequence)))

    def render() -> None:
        light = Pattern.read(pattern)
        made.previewed(light, plan)
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
        faulty = made.faulty(light)
        if faulty:
            print(
                f"note: {light.file} gave NaN or values outside [0, 1] in {faulty:.1%} of "
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
