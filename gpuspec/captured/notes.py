"""What a user of real frames should know of his light and his part, and what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.measure import block_reduce

from gpuspec.arrays import Image, Mask
from gpuspec.detection.inspection import Inspection
from gpuspec.detection.segmentation import NOISE_SIGMAS

_DARK = 0.2  # of what the light changes at most places, below which it never comes
_SHARE = 0.05  # of a frame that may be so without a word
_BLOCK = 16  # pixels on a side over which scratches and noise are averaged away
_ENDS = 5, 95  # percentiles between which the flawless level varies


def unlit(samples: Sequence[NDArray[Any]]) -> tuple[str, ...]:
    """Say that the light does not come everywhere, if it does not.

    Parameters
    ----------
    samples : sequence of ndarray, shape (n,)
        The same places of each frame.
    """
    if len(samples) < 3:
        return ()
    stack = np.stack(list(samples)).astype(np.float32)
    change = np.ptp(stack, axis=0)
    share = float(np.mean(change < _DARK * np.percentile(change, _ENDS[1])))
    if share < _SHARE:
        return ()
    said = (
        f"over {100 * share:.0f} % of the frame the light never passes: mounts and edges there may "
        f"become blobs. Name what is inspected, e.g. --region found."
    )
    return (said,)


def uneven(aspect: Image, inside: Mask, found: Inspection) -> tuple[str, ...]:
    """Say that the flawless level varies by as much as what is detected stands out, if it does.

    Parameters
    ----------
    aspect : ndarray of float32, shape (M, N)
        DN.
    inside : ndarray of bool, shape (M, N)
        What is inspected.
    found : Inspection
        In it.
    """
    above_dn = found.threshold - found.flawless_dn
    if min(aspect.shape) < 4 * _BLOCK:
        return ()
    full = block_reduce(inside, _BLOCK, np.min)  # type: ignore[no-untyped-call]
    levels = block_reduce(aspect, _BLOCK, np.median)[full]  # type: ignore[no-untyped-call]
    if len(levels) < 4:
        return ()
    low, high = np.percentile(levels, _ENDS)
    # Seven robust sigmas of an even slope are 2.6 times what it rises.
    if high - low < above_dn / 4:
        return ()
    # What the phase of the stripes explains is the ripple of few frames, which no window takes off.
    if found.ceiling and NOISE_SIGMAS * found.ceiling.noise_dn < 2 * (high - low):
        return ()
    said = (
        f"the flawless level varies from {low:.0f} to {high:.0f} DN over the part, and what is "
        f"detected stands {above_dn:.0f} DN above it. Take levels above a local background: "
        f"--set segmentation.background_mm=..., some times as wide as a scratch."
    )
    return (said,)
