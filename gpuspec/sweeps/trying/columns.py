"""NumPy's arrays as Arrow's, by their buffers.

``pyarrow.array`` imports pandas wherever that is installed, to see whether it is given one of its
own: a third of a second before the first design of a sweep is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike


def column(values: ArrayLike | pa.Array, kind: pa.DataType) -> pa.Array:
    """Return a column of a table.

    Parameters
    ----------
    values : array_like or pyarrow.Array
        One-dimensional; an Arrow array is returned as it is.
    kind : pyarrow.DataType
        A number, a bool or a string, which may be None, or a dictionary of strings.

    Examples
    --------
    >>> import pyarrow as pa
    >>> from gpuspec.sweeps.trying.columns import column
    >>> column([1, 2], pa.float64()).to_pylist()
    [1.0, 2.0]
    >>> column(["even", None], pa.string()).to_pylist()
    ['even', None]
    """
    if isinstance(values, pa.Array):
        return values
    if pa.types.is_dictionary(kind):
        words, code = np.unique(np.asarray(values), return_inverse=True)
        codes = column(code, kind.index_type)
        return pa.DictionaryArray.from_arrays(codes, _words(words.tolist()))
    if pa.types.is_string(kind):
        return _words(np.asarray(values, object).tolist())
    if pa.types.is_boolean(kind):
        return pa.Array.from_buffers(kind, np.size(values), [None, _bits(values)])
    numbers = np.ascontiguousarray(values, kind.to_pandas_dtype())
    return pa.Array.from_buffers(kind, numbers.size, [None, pa.py_buffer(numbers)])


def known(values: Sequence[float | None]) -> pa.Array:
    """Return a column of float64, null where a number is none.

    Parameters
    ----------
    values : sequence of float or None
        NaN and infinity are none.

    Examples
    --------
    >>> from gpuspec.sweeps.trying.columns import known
    >>> known([1.5, float("nan"), None]).to_pylist()
    [1.5, None, None]
    """
    numbers = np.array([np.nan if value is None else value for value in values], np.float64)
    there = [None if np.isfinite(numbers).all() else _bits(np.isfinite(numbers))]
    return pa.Array.from_buffers(pa.float64(), len(numbers), [*there, pa.py_buffer(numbers)])


def _bits(values: ArrayLike) -> pa.Buffer:
    return pa.py_buffer(np.packbits(np.asarray(values, np.bool_), bitorder="little"))


def _words(values: Sequence[str | None]) -> pa.Array:
    data: list[Any] = [(word or "").encode() for word in values]
    ends = np.cumsum([0, *map(len, data)]).astype(np.int32)
    there = _bits([word is not None for word in values])
    return pa.StringArray.from_buffers(
        len(data), pa.py_buffer(ends), pa.py_buffer(b"".join(data)), there
    )
