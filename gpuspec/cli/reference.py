"""The command that prints the reference of the station file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from gpuspec.cli import completion
from gpuspec.cli.terminal import console

if TYPE_CHECKING:
    from rich.console import Console

    from gpuspec.station.keys import Key


def reference(
    key: Annotated[
        str,
        typer.Argument(
            help="A section or key, e.g. tunnel; none: all.", autocompletion=completion.keys
        ),
    ] = "",
) -> None:
    """Print every key of the station file: range, choices, default."""
    from gpuspec.station.keys import keys, markdown

    chosen = keys(key)
    out = console()
    if out.is_terminal:
        _print_keys(chosen, out)
    else:
        print(markdown(chosen, head=not key), end="")


def _print_keys(keys: tuple[Key, ...], out: Console) -> None:
    from itertools import groupby

    from rich.table import Table
    from rich.text import Text

    for section, entries in groupby(keys, lambda key: key.section):
        out.print(Text(f"[{section}]"))
        table = Table.grid(padding=(0, 2))
        for key in entries:
            takes = " ".join(filter(None, (key.takes, key.unit)))
            told = Text.assemble(f"{takes}; ", (f"default {key.default}", "italic"))
            if key.default == "required":
                told = Text(f"{takes}; required")
            table.add_row(Text(f"  {key.name}", "bold"), told)
            table.add_row("", Text(key.meaning))
        out.print(table)
