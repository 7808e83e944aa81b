"""How objects show themselves: a line for a person, never the arrays themselves."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import pooled
from gpuspec.errors import ExtraError

ROWS = 20  # of a table in a notebook


def array(values: Any, unit: str = "") -> str:
    """Return an array's shape, type and unit, e.g. ``(1000, 4000) float32, DN``.

    Parameters
    ----------
    values : ndarray
    unit : str
        Said after the type; "": none.
    """
    return f"{tuple(values.shape)} {values.dtype}" + (f", {unit}" if unit else "")


def object_of(name: str, said: str, parts: Mapping[str, str] | None = None) -> str:
    """Return an object's name with what is said of it, and a line for each of its parts.

    Parameters
    ----------
    name : str
        Of the class.
    said : str
        What stands in the brackets.
    parts : mapping of str to str, optional
        Name of each part, and what is said of it.
    """
    lines = [f"  {part}: {what}" for part, what in (parts or {}).items()]
    return "\n".join([f"{name}({said})", *lines])


def html_table(rows: Iterable[Mapping[str, Any]], total: int) -> str:
    """Return the first rows of a table for a notebook.

    Parameters
    ----------
    rows : iterable of mapping
        Name of the column to value, all with the same names.
    total : int
        Number of rows of the whole table.
    """
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


def html_page(thing: object, *pictures: bytes) -> str:
    """Return what an object says of itself, and pictures of it as PNG, for a notebook.

    Parameters
    ----------
    thing : object
    *pictures : bytes
        PNG files.
    """
    images = "".join(
        f'<img style="max-width:100%" src="data:image/png;base64,{b64encode(png).decode()}">'
        for png in pictures
    )
    return f"<pre>{escape(repr(thing))}</pre>{images}"


def data_frame(columns: Mapping[str, Any]) -> Any:
    """Return columns as a pandas table.

    Raises
    ------
    ExtraError
        If pandas is not installed.
    """
    try:
        import pandas
    except ModuleNotFoundError:
        raise ExtraError("this needs pandas, which is not installed; pip install pandas.") from None
    return pandas.DataFrame(dict(columns))


def cell(value: Any) -> str:
    """Return a value as a table shows it."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def grey_png(image: NDArray[Any], full: float, width: int = 1200) -> bytes:
    """Return an image as a PNG, reduced to a width, black at 0 and white at `full`.

    Parameters
    ----------
    image : ndarray, shape (M, N)
    full : float
        What is white, in the image's unit.
    width : int
        Greatest side of the picture, in pixels.
    """
    from io import BytesIO

    from PIL import Image

    factor = max(1, math.ceil(max(image.shape) / width))
    grey = pooled(image, factor, np.add) * (255 / full)
    file = BytesIO()
    Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save(file, "PNG")
    return file.getvalue()
