"""False blobs: what is detected where nothing is, the bright rim of a found defect apart.

A defect bends the surface beyond its zone, too, and the aspect image shows it. So a *guard band* is
laid around each zone, see :mod:`gpuspec.part.guard`. What is detected in it is neither a hit nor an
error; what is detected beyond it is an error.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask, check_mask
from gpuspec.detection.connected import connected


def least_pixels(min_area_mm2: float, sampling_mm: float) -> int:
    """Return how many pixels a blob of the least area has, ``segmentation.min_area_mm2``.

    Parameters
    ----------
    min_area_mm2 : float
    sampling_mm : float
        Side of a pixel.

    Examples
    --------
    >>> from gpuspec.detection.false_blobs import least_pixels
    >>> least_pixels(0.02, 0.1)
    2
    """
    return math.ceil(min_area_mm2 / sampling_mm**2 - 1e-9)


def false_blobs(detected: Mask, guard: Mask, *, min_area_px: int = 0) -> NDArray[np.int32]:
    """Label the false blobs: connected sets of detected pixels outside zones and guard bands.

    What reaches out of a guard band is counted by what is outside, so that a threshold below the
    flawless level, where the whole part is one blob that touches every zone, is not free of error.

    Parameters
    ----------
    detected : (M, N) bool array
        Pixels above a threshold, on the part.
    guard : (M, N) bool array
        Zones and their guard bands.
    min_area_px : int
        Sets of fewer pixels are left out, see :func:`least_pixels`.

    Returns
    -------
    (M, N) int32 array
        0 where there is none, else 1 to their number, which is ``labels.max()``; false pixels are
        ``np.count_nonzero(labels)``.

    Raises
    ------
    ValueError
        If the shapes disagree or one is not bool.

    Examples
    --------
    >>> from gpuspec.detection.false_blobs import false_blobs
    >>> guard = np.zeros((1, 12), bool)
    >>> guard[0, :6] = True
    >>> detected = np.zeros((1, 12), bool)
    >>> detected[0, [2, 3, 8, 9, 11]] = True  # the defect, its rim, and two errors
    >>> false_blobs(detected, guard).tolist()
    [[0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 0, 2]]
    >>> int(false_blobs(detected, guard, min_area_px=2).max())
    1
    """
    check_mask("detected", detected, detected.shape)
    check_mask("guard", guard, detected.shape)
    return connected(detected & ~guard, min_area_px)
