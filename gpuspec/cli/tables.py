"""Tables on the terminal, in which no word and no number is ever broken."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from gpuspec import words
from gpuspec.cli.terminal import console

if TYPE_CHECKING:
    from gpuspec.detection.inspection import Inspection

_FRAME, _PADDING = 1, 2  # columns of a terminal: a rule, and the blanks about a cell


def print_table(
    rows: Sequence[Sequence[str]],
    heads: Sequence[str] = (),
    *,
    title: str = "",
    whole: Collection[int] = (),
    framed: bool = True,
    right: bool = False,
) -> None:
    """Print a table as wide as the terminal; one that does not fit, as lines of "head: cell".

    Parameters
    ----------
    rows : sequence of sequence of str
    heads : sequence of str
        Of the columns; none: lines then say "first cell: second cell", and others below.
    title : str
    whole : collection of int
        Columns whose cells stay in one line.
    framed : bool
        Whether rules are drawn.
    right : bool
        Whether cells end at the right, as numbers do.
    """
    from rich.table import Table
    from rich.text import Text

    out = console()
    columns = list(zip(*([heads] if heads else []), *rows, strict=True))
    widest = [max(len(cell) for cell in column) for column in columns]
    longest = [
        wide if number in whole else max(len(w) for cell in column for w in (cell.split() or [""]))
        for number, (column, wide) in enumerate(zip(columns, widest, strict=True))
    ]
    room = _room(len(columns), framed)
    if sum(longest) > room:
        if title:
            out.print(Text(title, "italic"), soft_wrap=True)
        for row in rows:
            _print_lines(row, heads)
        return
    table = Table(
        show_header=bool(heads),
        title=title or None,
        title_justify="left",
        **({} if framed else {"box": None}),  # type: ignore[arg-type]
    )
    for number, width in enumerate(_widths(longest, widest, room)):
        table.add_column(heads[number] if heads else "", width=width,
                         justify="right" if right else "left")  # fmt: skip
    for row in rows:
        table.add_row(*row)
    out.print(table)


def fits(rows: Sequence[Sequence[str]], heads: Sequence[str], *, framed: bool = True) -> bool:
    """Whether a table fits the terminal with every cell in one line.

    Parameters
    ----------
    rows : sequence of sequence of str
    heads : sequence of str
        One for each column.
    framed : bool
        Whether lines are drawn around the cells.
    """
    columns = zip(heads, *rows, strict=True)
    return sum(max(map(len, column)) for column in columns) <= _room(len(heads), framed)


def print_score(p1: str, p2: str, f1: str, others: Sequence[Sequence[str]] = ()) -> None:
    """Print scores with what they are called and mean, and other rows of three cells below.

    Parameters
    ----------
    p1, p2, f1 : str
        As they are printed.
    others : sequence of sequence of str
        Rows of three cells.
    """
    values = {"p1": p1, "p2": p2, "f1": f1}
    rows = [(words.SCORES[key], value, words.MEANINGS[key]) for key, value in values.items()]
    print_table([*rows, *others], whole=[1], framed=False)


def threshold_row(found: Inspection) -> tuple[str, str, str]:
    """Return a row of three cells: the threshold, and how it came about."""
    how = "" if found.rule == "stated" else f", {found.threshold_said}"
    return "threshold", f"{found.threshold:.1f} DN", f"flawless {found.flawless_dn:.1f} DN{how}"


def _room(columns: int, framed: bool) -> int:
    """Return what the terminal has for cells."""
    return console().width - columns * (_PADDING + _FRAME * framed) - _FRAME * framed


def _widths(longest: Sequence[int], widest: Sequence[int], room: int) -> list[int]:
    """Share the room out: no column narrower than its longest word or wider than its cells."""
    widths = list(longest)
    for _ in range(room - sum(longest)):
        number = max(range(len(widths)), key=lambda n: widest[n] / max(widths[n], 1))
        if widths[number] >= widest[number]:
            break
        widths[number] += 1
    return widths


def _print_lines(row: Sequence[str], heads: Sequence[str]) -> None:
    """Print a row as lines."""
    from rich.text import Text

    out = console()
    if heads:
        out.print(Text.assemble(f"{heads[0]}: ", (row[0], "bold")), soft_wrap=True)
        said = [f"{head}: {cell}" if head else cell
                for head, cell in zip(heads[1:], row[1:], strict=True) if cell]  # fmt: skip
    else:
        out.print(f"{row[0]}: {row[1]}", soft_wrap=True)
        said = [cell for cell in row[2:] if cell]
    for line in said:
        out.print(f"  {line}", soft_wrap=True)
