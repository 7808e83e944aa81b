"""The highest level that a flawless pixel can have, as the frames of a sequence themselves tell it.

Of few frames the mean ripples with the phase in which a pixel meets the stripes, and a spread that
counts the ripple as noise puts the threshold far above it. But the frames tell the phase of every
pixel: pixels of one phase have one level, whatever the ripple, and half of them are flawless. So
the median of each phase is the flawless level there, the highest of these is the ceiling, and what
pixels differ by from the median of their own phase is noise and unevenness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.detection.background import robust_sigma
from gpuspec.detection.segmentation import NOISE_SIGMAS, Ceiling

__all__ = ["told_ceiling"]

_PHASES = 16
"""Into which a step of the light is divided: within one the ripple changes by some percent."""
_PIXELS_MIN = 40
"""Of a phase, of which a median is taken: its own error is then a fifth of the spread."""
_MODULATED = 0.5
"""Share of the usual modulation from which on a pixel sees the light move."""
_FRAMES_MIN = 4


def told_ceiling(
    samples: Sequence[NDArray[Any]], levels: NDArray[Any], inside: NDArray[np.bool_]
) -> tuple[Ceiling | None, str]:
    """Return the ceiling that frames tell, and why they tell none.

    Parameters
    ----------
    samples : sequence of ndarray, shape (n,)
        Some pixels of each frame, see :func:`gpuspec.frames.period.sampled`; the frames are whole
        periods of the light in equal steps.
    levels : ndarray, shape (n,)
        The same pixels of the aspect image, their mean, DN.
    inside : ndarray of bool, shape (n,)
        Which of them are inspected.

    Returns
    -------
    Ceiling or None
        The median of the phase at which it is the highest, its noise counted, and that noise: the
        robust standard deviation there.
    str
        Why there is none, as the end of a sentence; "" if there is one.

    Examples
    --------
    >>> from gpuspec.frames.ceiling import told_ceiling
    >>> phase = np.linspace(0, 40, 5000)  # steps, of 8 to a period
    >>> frames = [255.0 * ((phase - k) % 8 < 2.3) for k in range(8)]
    >>> mean = np.mean(frames, axis=0)
    >>> told_ceiling(frames, mean, np.full(5000, True))
    (Ceiling(level_dn=95.62, noise_dn=0.00), '')
    """
    if len(samples) < _FRAMES_MIN:
        return None, "few frames tell no period of the light"
    stack = np.stack([np.asarray(one, np.float64)[inside] for one in samples])
    waves = np.fft.rfft(stack, axis=0)[1:]
    strength = np.abs(waves)
    periods = int((strength**2).sum(axis=1).argmax()) + 1
    shifts = len(samples) // math.gcd(periods, len(samples))
    moved = strength[periods - 1] >= _MODULATED * np.median(strength[periods - 1])
    place = np.angle(waves[periods - 1, moved]) / (2 * np.pi) * shifts % 1 * _PHASES
    phase = np.floor(place).astype(np.intp) % _PHASES
    found = levels[inside][moved].astype(np.float64)
    own = [found[phase == number] for number in range(_PHASES)]
    known = [number for number, some in enumerate(own) if len(some) >= _PIXELS_MIN]
    if not known:
        return None, "too few pixels see the light move"
    flawless = np.array([np.median(own[number]) for number in known])
    # Between the medians the level goes over from one to the next.
    rest = found - np.interp(place, np.array(known) + 0.5, flawless, period=_PHASES)
    # A phase in which every image is dark or saturated has next to no noise, and its pixels have.
    spread = np.array([robust_sigma(rest[phase == number]) for number in known])
    spread = np.maximum(spread, robust_sigma(rest))
    best = int((flawless + NOISE_SIGMAS * spread).argmax())
    return Ceiling(float(flawless[best]), float(spread[best])), ""
