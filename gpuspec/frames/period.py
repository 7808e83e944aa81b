"""Which frames of a sequence make whole periods, and which do not belong to it.

Only a mean over whole periods of the light is even: one frame too many leaves its stripes in it.
Frames are compared with each other by a few thousand of their pixels. Frame N that is like frame 0
begins the period again; the last frame ends one if it is as far from frame 0 as neighbours are from
each other.

The frames of a part shorter than the stripes have means that swing as these pass, and are nearly
alike while none does. So a frame of another level, or unlike the others, is strange only if the
movement of the light does not explain it; and where the rate of that movement is known, it is asked
whether it explains the frames as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import FrameError
from gpuspec.frames.movement import explained, told_rate, unexplained

_SAMPLES = 1 << 14
"""Pixels of a frame that are compared."""
_REPEATS = 0.5
"""A frame nearer to the first than this share of a step repeats it."""
_STEPS = 0.6, 1.4
"""Shares of the least and the greatest step between which the one from the last frame to the first
lies."""
_LEVEL = 0.25
"""Share of the usual mean by which that of a frame may differ."""
_ALIEN = 3.0
"""How many times further from its nearest than others a frame is that is of something else."""
_WHOLE = 1e-6
"""Periods by which whole ones may be off for rounding."""
_AS_WELL = 0.008
"""Share of the light's change within which two counts explain frames as well: those of which all
are dark at the ends differ by up to 0.006, and one frame too many of 41 by 0.01."""


@dataclass(frozen=True)
class Periods:
    """Frames from `first` to before `last` are used.

    Attributes
    ----------
    first, last : int
    whole : bool or None
        Whether they are whole periods; None: too few to tell.
    why : dict of int to str
        Why a frame is left out.
    """

    first: int
    last: int
    whole: bool | None
    why: dict[int, str] = field(default_factory=dict)


def sampled(frame: NDArray[Any]) -> NDArray[Any]:
    """Return a few thousand pixels of a frame, spread over it.

    Parameters
    ----------
    frame : ndarray, shape (M, N)

    Returns
    -------
    ndarray, shape (n,)
        The same places of every frame of a shape.
    """
    step = max(1, int((frame.size / _SAMPLES) ** 0.5))
    return frame[step // 2 :: step, step // 2 :: step].ravel()


def whole_periods(
    samples: Sequence[NDArray[Any]], names: Sequence[str], *, rate: float | None = None
) -> Periods:
    """Return which frames are whole periods of the light.

    Parameters
    ----------
    samples : sequence of ndarray, shape (n,)
        Of each frame, see :func:`sampled`.
    names : sequence of str
        Of the frames.
    rate : float, optional
        Periods by which the light moves from frame to frame, as far as it is known; the frames
        are asked, too.

    Returns
    -------
    Periods

    Raises
    ------
    FrameError
        If a frame in the middle of the sequence does not belong to it.

    Examples
    --------
    >>> from gpuspec.frames.period import whole_periods
    >>> turn = 2 * np.pi * np.arange(9)[:, None] / 8  # the ninth repeats the first
    >>> samples = 100 + 90 * np.sin(turn + np.linspace(0, 12, 500))
    >>> whole_periods(samples, [f"{k}.png" for k in range(9)])
    Periods(first=0, last=8, whole=True, why={8: 'it repeats 0.png'})
    """
    stack = np.stack([np.asarray(one, np.float32) for one in samples])
    why = _strangers(stack, rate)
    own = [k for k in range(len(stack)) if k not in why]
    if not own:
        return Periods(0, len(stack), None)
    first, last = own[0], own[-1] + 1
    for k, reason in why.items():
        if first < k < last:
            raise FrameError(
                f"{names[k]} does not belong to the sequence: {reason}. Without it the mean is not "
                f"over whole periods; take the sequence again, or name the frames that are meant."
            )
    stack = stack[first:last]
    if len(stack) < 4:
        return Periods(first, last, None, why)
    count, whole = _counted(stack)
    if whole and rate is not None:
        count = _better(stack, count, rate)
    end = first + count
    beyond = {k: "it begins a period that is not finished" for k in range(end + 1, last)}
    if end < last:
        beyond[end] = f"it repeats {names[first]}"
    return Periods(first, end, whole, why | beyond)


def _counted(stack: NDArray[np.float32]) -> tuple[int, bool]:
    """Return how many frames are used, and whether they are whole periods, as the frames tell."""
    steps = _distances(stack[1:], stack[:-1])
    to_first = _distances(stack, stack[:1])
    second = _distances(stack[2:], stack[:-2])
    if _among(to_first[-1], steps) and _among(to_first[-2], second):
        return len(stack), True
    repeats = np.flatnonzero(to_first < _REPEATS * np.median(steps))
    repeats = repeats[repeats > 1]
    return (int(repeats[-1]), True) if repeats.size else (len(stack), False)


def _better(stack: NDArray[np.float32], count: int, rate: float) -> int:
    """Return that of whole periods at a known rate, or `count` if it explains frames better."""
    counts = np.arange(2, len(stack) + 1)
    turns = counts * rate
    known = counts[(np.abs(turns - np.rint(turns)) < _WHOLE) & (turns > 0.5)]
    if not known.size or known[-1] == count:
        return count
    told = max(round(told_rate(stack) * count), 1) / count
    worse = unexplained(stack, rate).mean() - unexplained(stack, told).mean()
    return int(known[-1]) if worse < _AS_WELL else count


def _among(one: float, steps: NDArray[np.float64]) -> bool:
    """Whether a distance is one of some, nearly."""
    return bool(_STEPS[0] * steps.min() < one < _STEPS[1] * steps.max())


def _distances(some: NDArray[np.float32], others: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return root mean squares of the differences, DN."""
    return np.sqrt(np.mean((some - others) ** 2, axis=1, dtype=np.float64))


def _strangers(stack: NDArray[np.float32], rate: float | None) -> dict[int, str]:
    """Return which frames are of another level, or unlike every other, and what they are."""
    if len(stack) < 4:
        return {}
    means = stack.mean(axis=1)
    usual = float(np.median(means))
    other = np.abs(means - usual) > _LEVEL * usual
    unusual, due = np.count_nonzero(other), explained(stack, rate) if other.any() else None
    if due is not None:
        other &= ~due
    if 2 * unusual > len(stack) and 4 * np.count_nonzero(other) > len(stack):
        return {}  # the light itself changes
    why = {
        int(k): f"its mean is {means[k]:.1f} DN and that of the others {usual:.1f}"
        for k in np.flatnonzero(other)
    }
    near = np.full(len(stack), np.inf)
    for k, one in enumerate(stack):
        apart = _distances(stack, one[None])
        apart[[k, *(stranger for stranger in why if stranger != k)]] = np.inf
        near[k] = apart.min()
    unlike = near > max(_ALIEN * float(np.median(near[~other])), 1.0)
    if unlike.any():
        unlike &= ~(explained(stack, rate) if due is None else due)
    for alien in np.flatnonzero(unlike):
        why.setdefault(int(alien), "it is unlike every other frame")
    return why
