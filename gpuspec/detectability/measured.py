"""Trials of elsewhere: a table with columns x and y."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import TrialsError

Floats = NDArray[np.float64]


def read_trials(path: str | Path) -> tuple[Floats, Floats]:
    r"""Read a table of trials.

    Parameters
    ----------
    path : str or Path
        Of a CSV file with the columns x, sizes, and y, hits as 1 and misses as 0, or signals.

    Returns
    -------
    x, y : ndarray of float64, shape (n,)

    Raises
    ------
    TrialsError
        If it cannot be read, has no such columns, or a value is no number.

    Examples
    --------
    >>> from pathlib import Path
    >>> from gpuspec.detectability.measured import read_trials
    >>> _ = Path("trials.csv").write_text("x,y\n0.2,0\n0.4,1\n")
    >>> x, y = read_trials("trials.csv")
    >>> x.tolist(), y.tolist()
    ([0.2, 0.4], [0.0, 1.0])
    """
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            table = csv.DictReader(file)
            heads = [head.strip() for head in table.fieldnames or ()]
            table.fieldnames = heads
            rows = list(table)
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise TrialsError(f"{path} cannot be read: {reason}; name a CSV file of trials.") from None
    if not {"x", "y"} <= set(heads):
        raise TrialsError(
            f"{path} has the columns {', '.join(heads) or '(none)'}; trials have x, the size, and "
            f"y, 1 for a hit and 0 for a miss, or the signal."
        )
    values = np.empty((len(rows), 2))
    for number, row in enumerate(rows):
        for column, name in enumerate("xy"):
            try:
                values[number, column] = float(row[name] or "")
            except ValueError:
                raise TrialsError(
                    f"{path}, row {number + 2}: {name} is {row[name]!r}, which is no number."
                ) from None
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise TrialsError(f"{path}, row {first + 2}: a value is not a finite number.")
    if len(values) < 2:
        raise TrialsError(f"{path} holds {len(values)} trials; a curve needs more.")
    return values[:, 0], values[:, 1]
