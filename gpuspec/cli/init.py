"""`gpuspec init` and `gpuspec schema`: a station file to start from, and its schema for editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from gpuspec.cli import completion


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
    from gpuspec.station.examples import example

    if path.name in ("", ".."):
        raise OutputError(f"{path} is a folder; name a file in it, e.g. {path / 'station.toml'}.")
    if not path.suffix:
        path = path.with_suffix(".toml")
    example(name).write(path, force=force, sized=False)
    print(f"{path} written; simulate it with: gpuspec simulate {path}")


def schema() -> None:
    """Print the JSON schema of the station file, for editors."""
    from gpuspec.station.station import Station

    print(json.dumps(Station.model_json_schema(), indent=2))
