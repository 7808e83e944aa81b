"""Which defects a design finds for certain: those that stand above all that is flawless."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def smallest_found(
    peaks: NDArray[Any], sizes_mm: NDArray[Any], flawless: NDArray[Any]
) -> tuple[Floats, Floats]:
    """Return from which size on every defect stands above the flawless surface, and by how much.

    Parameters
    ----------
    peaks : ndarray, shape (D, n)
        Highest level of each defect.
    sizes_mm : ndarray, shape (n,)
        Of the defects.
    flawless : ndarray, shape (D,)
        Highest level of what is flawless.

    Returns
    -------
    smallest_mm : ndarray of float64, shape (D,)
        Size of the smallest of those which, with all that are as large or larger, are found; NaN if
        not even all of the largest are.
    margin : ndarray of float64, shape (D,)
        By how much the faintest of these stands above the flawless surface.

    Examples
    --------
    >>> from gpuspec.sweeps.trying.found import smallest_found
    >>> peaks = np.array([[40, 60, 90], [10, 60, 90], [90, 90, 10]])
    >>> size, margin = smallest_found(peaks, np.array([0.2, 0.3, 0.5]), np.array([20, 20, 20]))
    >>> size.tolist(), margin.tolist()
    ([0.2, 0.3, nan], [20.0, 40.0, nan])
    """
    if not len(sizes_mm):
        return np.full(len(peaks), np.nan), np.full(len(peaks), np.nan)
    order = np.argsort(-sizes_mm, kind="stable")
    sizes = sizes_mm[order]
    faintest = np.minimum.accumulate(peaks[:, order].astype(np.float64), axis=1)
    last = np.append(np.flatnonzero(np.diff(sizes)), len(sizes) - 1)  # of each size
    faintest = faintest[:, last]
    count = (faintest > flawless[:, None]).sum(axis=1)  # sizes found: the faintest only falls
    at = np.maximum(count - 1, 0)
    margin = faintest[np.arange(len(peaks)), at] - flawless
    there = count > 0
    return np.where(there, sizes[last][at], np.nan), np.where(there, margin, np.nan)
