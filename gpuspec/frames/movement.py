"""What the movement of the light explains of the frames of a sequence.

Every pixel meets the same light, each in its own phase. So the frames tell the profile of the light
whatever they see of it at a time: the mean of all pixels at a phase. The mean of a frame of a
part shorter than the stripes swings as they pass it; held against the profile that the other frames
tell, the frame is as it should be.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["explained", "told_rate", "unexplained"]

_SHARE = 0.25
"""Of the light's change by which a frame may differ from its profile. Whole sequences of parts down
to a tenth of a period differ by at most 0.13, and black frames among 12 and more by 0.38."""
_MOVED = 0.25
"""Share of the strongest pixels' modulation from which on a pixel sees the light move."""
_PIXELS = 1 << 11
"""That are looked at."""
_AT_ONCE = 20  # frames of which one is left out at a time
_BINS = 128
"""Of a period, for the profile of the light."""


def explained(stack: NDArray[np.float32], rate: float | None) -> NDArray[np.bool_]:
    """Return which frames are as the movement of the light explains them.

    Parameters
    ----------
    stack : ndarray of float32, shape (K, n)
        Some pixels of each frame.
    rate : float or None
        Periods by which the light moves from frame to frame, as far as it is known; what the
        frames tell is tried, too, and the whole periods next to it.

    Returns
    -------
    ndarray of bool, shape (K,)

    Examples
    --------
    >>> from gpuspec.frames.movement import explained
    >>> turn = 2 * np.pi * (np.arange(12)[:, None] / 12 + np.linspace(0, 0.2, 500))
    >>> stack = np.float32(100 + 90 * np.sin(turn))  # a fifth of a period is seen at a time
    >>> float(np.ptp(stack.mean(axis=1)).round()), explained(stack, None).tolist() == [True] * 12
    (167.0, True)
    >>> stack[3] = 0
    >>> np.flatnonzero(~explained(stack, None))
    array([3])
    """
    told = told_rate(stack)
    rates = [told, max(round(told * len(stack)), 1) / len(stack), *([] if rate is None else [rate])]
    return np.asarray(np.any([_fitting(stack, one) for one in rates], axis=0))


def _fitting(stack: NDArray[np.float32], rate: float) -> NDArray[np.bool_]:
    """Return which frames fit each other, those that fit least left out until the rest do."""
    fits = np.full(len(stack), True)
    while 2 * np.count_nonzero(fits) > len(stack):
        at = np.flatnonzero(fits)
        rest = unexplained(stack[at], rate, at)
        if rest.max() <= _SHARE:
            break
        # The worst make the others worse: of few frames one is left out at a time, of many some.
        worst = np.argsort(rest)[-max(1, len(at) // _AT_ONCE) :]
        fits[at[worst[rest[worst] > _SHARE]]] = False
    return fits


def told_rate(stack: NDArray[np.float32]) -> float:
    """Return by how many periods the light moves from frame to frame, as the frames tell it.

    Parameters
    ----------
    stack : ndarray of float32, shape (K, n)

    Examples
    --------
    >>> from gpuspec.frames.movement import told_rate
    >>> turn = 2 * np.pi * (np.arange(12)[:, None] / 6 + np.linspace(0, 5, 500))
    >>> round(1 / told_rate(np.float32(100 + 90 * np.sin(turn))), 1)
    6.0
    """
    count, some = len(stack), _some(stack)
    rates = np.arange(4, 2 * count + 1) / (4 * count)
    waves = np.exp(-2j * np.pi * rates[:, None] * np.arange(count))
    strength = (np.abs(waves @ (some - some.mean(axis=0))) ** 2).sum(axis=1)
    return float(rates[strength.argmax()])


def unexplained(
    stack: NDArray[np.float32], rate: float, at: NDArray[np.intp] | None = None
) -> NDArray[np.float64]:
    """Return by which share of the light's change each frame differs from what the others tell.

    Pixels that do not see the light move are left out; each of the others counts over its own
    modulation, that of the weaker half over the usual one.

    Parameters
    ----------
    stack : ndarray of float32, shape (K, n)
    rate : float
        Periods by which the light moves from frame to frame.
    at : ndarray of int, shape (K,), optional
        Numbers of the frames, where some between them are left out.

    Returns
    -------
    ndarray, shape (K,)

    Examples
    --------
    >>> from gpuspec.frames.movement import unexplained
    >>> turn = 2 * np.pi * (np.arange(12)[:, None] / 12 + np.linspace(0, 5, 500))
    >>> stack = np.float32(100 + 90 * np.sin(turn))
    >>> [round(float(unexplained(stack, rate).mean()), 1) for rate in (1 / 12, 1 / 8)]
    [0.0, 0.7]
    """
    some = _some(stack)
    turns = 2 * np.pi * rate * (np.arange(len(some)) if at is None else at)
    waves = np.column_stack([np.ones_like(turns), np.cos(turns), np.sin(turns)])
    level, cosine, sine = np.linalg.pinv(waves) @ some
    swing = np.hypot(cosine, sine)
    moved = swing > _MOVED * np.percentile(swing, 95)
    if not moved.any():
        return np.zeros(len(some))
    gain = np.maximum(swing[moved], np.median(swing[moved]))
    seen = (some[:, moved] - level[moved]) / gain
    place = (turns[:, None] - np.arctan2(sine, cosine)[moved]) / (2 * np.pi) % 1
    apart = np.mean(np.abs(seen - _told_by_others(place, seen)) * gain, axis=1)
    return np.asarray(apart / np.mean(np.abs(seen) * gain))


def _told_by_others(place: NDArray[Any], seen: NDArray[Any]) -> NDArray[Any]:
    """Return the mean of what other frames see about each place in the period.

    Where none of them sees the light within a step, it is what the frame itself sees.
    """
    bins = (place * _BINS).astype(np.intp) % _BINS
    counts = np.array([np.bincount(one, minlength=_BINS) for one in bins])
    sums = np.array([np.bincount(one, some, _BINS) for one, some in zip(bins, seen, strict=True)])
    counts, sums = counts.sum(axis=0) - counts, sums.sum(axis=0) - sums
    reach = max(_BINS / len(place), 2)
    told = seen.copy()
    for number, known in enumerate(map(np.flatnonzero, counts)):
        if not known.size:
            continue
        at = place[number] * _BINS - 0.5
        after = np.searchsorted(known, at)
        around = np.concatenate([known[-1:] - _BINS, known, known[:1] + _BINS])
        near = around[after + 1] - around[after] <= reach
        means = sums[number, known] / counts[number, known]
        told[number, near] = np.interp(at[near], known, means, period=_BINS)
    return told


def _some(stack: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return some thousand pixels of each frame."""
    return stack[:, :: max(1, stack.shape[1] // _PIXELS)].astype(np.float64)
