"""How objects show themselves: a line for a person, never the arrays themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

ROWS = 20  # of a table in a notebook


def array(values: Any, unit: str = "") -> str:
    """Return an array's shape, type and unit, e.g. ``(1000, 4000) float32, DN``."""
    return f"{tuple(values.shape)} {values.dtype}" + (f", {unit}" if unit else "")


def object_of(name: str, said: str, parts: Mapping[str, str] | None = None) -> str:
    """Return an object's name with what is said of it, and a line for each of its parts."""
    lines = [f"  {part}: {what}" for part, what in (parts or {}).items()]
    return "\n".join([f"{name}({said})", *lines])


def html_table(rows: Iterable[Mapping[str, Any]], total: int) -> str:
    """Return the first rows of a table for a notebook."""
    shown = list(rows)[:ROWS]
    if not shown:
        return "<p>none</p>"
    heads = "".join(f"<th>{escape(name)}</th>" for name in shown[0])
    lines = "".join(
        f"<tr>{''.join(f'<td>{escape(cell(value))}</td>' for value in row.values())}</tr>"
        for row in shown
    )
    more = f"<p>{total - ROWS:,} more</p>" if total > ROWS else ""
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{lines}</tbody></table>{more}"


def cell(value: Any) -> str:
    """Return a value as a table shows it."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
