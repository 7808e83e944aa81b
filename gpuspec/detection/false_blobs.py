"""False blobs: what is detected where nothing is, the bright rim of a found defect apart.

A defect bends the surface beyond its zone, too: relief ends at about twice the zone's radius, and
with it what the aspect image shows of it. So a *guard band* as wide as half the zone is laid around
each. What is detected in it is neither a hit nor an error; what is detected beyond it is an error.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gpuspec.arrays import LabelImage, Mask, check_label_image, check_mask
from gpuspec.detection.connected import connected

__all__ = ["GUARD_MIN_PX", "false_blobs", "guarded", "least_pixels"]

GUARD_MIN_PX = 3
"""Least width of a guard band: of scratches four pixels wide, what shows beyond the zone by more
than a few tenths of a grey level ends within three."""


def guarded(truth: LabelImage) -> Mask:
    """Return which pixels are in a zone or in the guard band around it.

    The band is as wide as half the zone at its widest: around a dent, whose zone ends at 2 sigma,
    it ends at 4, where 0.03 % of the depth is left.

    Parameters
    ----------
    truth : (M, N) integer array
        Zones: 0 where flawless, i in the zone of defect i, from 1.

    Returns
    -------
    (M, N) bool array

    Raises
    ------
    ValueError
        If `truth` is no label image.

    Examples
    --------
    >>> from gpuspec.detection.false_blobs import guarded
    >>> truth = np.zeros((1, 12), np.int32)
    >>> truth[0, 5] = 1
    >>> guarded(truth).astype(int).tolist()  # three pixels each way
    [[0, 0, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0]]
    """
    check_label_image("truth", truth)
    found: Mask = truth != 0
    for number, box in enumerate(ndimage.find_objects(truth), 1):
        if box is None:
            continue
        zone = np.pad(truth[box] == number, 1)
        width = max(math.ceil(ndimage.distance_transform_edt(zone).max()), GUARD_MIN_PX)
        wider = tuple(slice(max(s.start - width, 0), s.stop + width) for s in box)
        away = ndimage.distance_transform_edt(truth[wider] != number)
        found[wider] |= away <= width
    return found


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
        As of :func:`guarded`.
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
    >>> from gpuspec.detection.false_blobs import false_blobs, guarded
    >>> truth = np.zeros((1, 12), np.int32)
    >>> truth[0, 2] = 1
    >>> detected = np.zeros((1, 12), bool)
    >>> detected[0, [2, 3, 8, 9, 11]] = True  # the defect, its rim, and two errors
    >>> false_blobs(detected, guarded(truth)).tolist()
    [[0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 0, 2]]
    >>> int(false_blobs(detected, guarded(truth), min_area_px=2).max())
    1
    """
    check_mask("detected", detected, detected.shape)
    check_mask("guard", guard, detected.shape)
    return connected(detected & ~guard, min_area_px)
