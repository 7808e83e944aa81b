"""Where the light ever comes: the part, without its mount and its edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy  # whose modules are imported when they are used
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.errors import FrameError

_ALIKE = 0.5
"""Share of the grey levels' change where the light passes, above which the rest changes as much."""

_MARGIN = 64
"""What part of a frame's smaller side is left at the region's edge, where mounts glare."""


def lit_region(modulation: NDArray[np.floating[Any]], margin_px: float | None = None) -> Mask:
    """Return the largest region over which the light passes, less a margin.

    A pixel belongs to it if its grey level changes over the sequence by more than Otsu's threshold
    over the frame, or at all where both sides of that change much alike; holes in it, scratches and
    dust, belong to it too.

    Parameters
    ----------
    modulation : ndarray, shape (M, N)
        Greatest less least grey level of each pixel over the sequence, DN.
    margin_px : float, optional
        What is left at its edge; None: a 64th of the smaller side.

    Returns
    -------
    ndarray of bool, shape (M, N)

    Raises
    ------
    FrameError
        If the light changes nowhere, or nothing is left within the margin.

    Examples
    --------
    >>> from gpuspec.frames.region import lit_region
    >>> modulation = np.zeros((60, 80))
    >>> modulation[10:40, 20:60] = 90
    >>> int(lit_region(modulation, 5).sum())
    600
    """
    from skimage.filters import threshold_otsu  # slow to import

    if not modulation.max(initial=0) > 0:
        raise FrameError("the light changes nowhere over the sequence; name a region instead.")
    level = float(threshold_otsu(modulation))  # type: ignore[no-untyped-call]
    more, less = modulation[modulation > level], modulation[modulation <= level]
    if not more.size or (less.size and less.mean() > _ALIKE * more.mean()):
        level = 0.0  # no two kinds of pixel: the light passes over all of them
    whole = largest(modulation > level)
    margin = min(modulation.shape) / _MARGIN if margin_px is None else margin_px
    inside: Mask = scipy.ndimage.distance_transform_edt(np.pad(whole, 1))[1:-1, 1:-1] > margin
    if not inside.any():
        raise FrameError(
            f"nothing is left of the lit region within its margin of {margin:g} px; give a smaller "
            f"one, or name a region instead."
        )
    return inside


def largest(mask: Mask, among: Mask | None = None) -> Mask:
    """Return the largest connected region of a mask, its holes filled.

    Parameters
    ----------
    mask : ndarray of bool, shape (M, N)
        With at least one pixel.
    among : ndarray of bool, shape (M, N), optional
        Pixels by which sizes are told; None: all.

    Returns
    -------
    ndarray of bool, shape (M, N)
    """
    labels, _ = scipy.ndimage.label(mask)
    told = labels.ravel() if among is None else labels[among]
    counts = np.bincount(told, minlength=2)
    whole: Mask = scipy.ndimage.binary_fill_holes(labels == 1 + int(counts[1:].argmax()))
    return whole
