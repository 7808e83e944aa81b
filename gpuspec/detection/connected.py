"""The 8-connected sets of a mask, by its runs: time goes with what is set, not with the image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpuspec.arrays import Mask

Integers = npt.NDArray[np.int64]


def connected(mask: Mask, least_px: int = 0) -> npt.NDArray[np.int32]:
    """Label the 8-connected sets of a mask.

    Parameters
    ----------
    mask : (M, N) bool array
    least_px : int
        Sets of fewer pixels are left out.

    Returns
    -------
    (M, N) int32 array
        0 where nothing is set, else 1 to the number of sets without a gap, in the order in which a
        row-by-row scan meets them.

    Notes
    -----
    The mask is cut into runs of neighbours within a row. Runs of adjacent rows that touch are
    joined: of two sets the one that begins later takes the number of the other, until none touch.

    Examples
    --------
    >>> from gpuspec.detection.connected import connected
    >>> connected(np.array([[True, False, True], [False, True, False]])).tolist()
    [[1, 0, 1], [0, 1, 0]]
    """
    pixel = np.flatnonzero(mask)
    labels = np.zeros(mask.shape, np.int32)
    labels.ravel()[pixel] = connected_pixels(pixel, mask.shape[1], least_px)
    return labels


def connected_pixels(pixel: Integers, columns: int, least_px: int = 0) -> Integers:
    """Label the 8-connected sets of some pixels of an image, without the image.

    Parameters
    ----------
    pixel : (n,) integer array
        Flat numbers, ascending.
    columns : int
        Of the image.
    least_px : int
        Sets of fewer pixels are left out.

    Returns
    -------
    (n,) int64 array
        Labels as :func:`connected` gives them.

    Examples
    --------
    >>> from gpuspec.detection.connected import connected_pixels
    >>> connected_pixels(np.array([0, 2, 9]), 4).tolist()
    [1, 2, 3]
    """
    first = pixel % columns == 0
    first[:1] = True
    first[1:] |= np.diff(pixel) != 1
    begin = np.flatnonzero(first)
    length = np.diff(begin, append=pixel.size)
    start = pixel[begin]
    joined = _joined(len(start), *_touching(start, start + length, columns))
    kept = np.bincount(joined, length, len(start)) >= max(least_px, 1)
    number = np.cumsum(kept) * kept
    return np.repeat(number[joined], length)


def _touching(start: Integers, end: Integers, columns: int) -> tuple[Integers, Integers]:
    """Return pairs of runs that touch, a run and one in the row above; runs are [start, end)."""
    above = (start // columns - 1) * columns
    low = np.searchsorted(end, np.maximum(start - columns - 1, above), "right")
    high = np.searchsorted(start, np.minimum(end - columns + 1, above + columns))
    count = np.maximum(high - low, 0)
    run = np.repeat(np.arange(len(start)), count)
    return run, np.arange(len(run)) - np.repeat(np.cumsum(count) - count - low, count)


def _joined(runs: int, one: Integers, other: Integers) -> Integers:
    """Return of every run the first one of its set."""
    root = np.arange(runs)
    while len(one):
        a, b = root[one], root[other]
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while not np.array_equal(further := root[root], root):
            root = further
        apart = root[one] != root[other]
        one, other = one[apart], other[apart]
    return root
