"""Rays that may meet the part twice: whether there are any, and how far they are followed.

A camera ray may be hidden by another piece of the part, and a reflected ray may meet the part
again. A straight line that leaves a surface and comes back to it is nowhere steeper than the
surface, so of gentle parts it is known without following any ray.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpuspec.part.relief import Relief
from gpuspec.part.shape import steepest
from gpuspec.part.view import widest
from gpuspec.station.station import Station

MARCH_STEPS = 96
"""Places on a ray where it is compared with the part: the n-th is (n/96)^2 of its length away."""

_GENTLE = math.radians(5)  # slope of a relief that never rises above a convex shape's tangent
_RIGHT = math.radians(90)
_PEAK = math.exp(-0.5)  # of a Gaussian's slope, in depths over sigma
_SLACK_PX = 0.01
_ROUNDING = 2e-6  # of a height, in floats


@dataclass(frozen=True)
class March:
    """How a ray is followed over the part.

    Attributes
    ----------
    highest_mm : float
        Highest point of the part, in its frame: above it no ray is followed.
    slack_mm : float
        A ray so far below the surface has met it.
    """

    highest_mm: float
    slack_mm: float


def march_of(station: Station, relief: Relief) -> March | None:
    """Return how rays are followed over a part; None: no ray can meet it twice.

    Parameters
    ----------
    station : Station
    relief : Relief
        The station's.

    Examples
    --------
    >>> from gpuspec.part.marches import march_of
    >>> from gpuspec.part.relief import Relief
    >>> station = gpuspec.example("trim")
    >>> print(march_of(station, Relief.of(station)))
    None
    """
    part = station.part
    if part.surface == "orientation":
        return None
    own = math.atan(steepest(part.shape, station))
    relief_slope = sum(m.steepest for m in relief.maps)
    grooves = relief.grooves
    if len(grooves):
        relief_slope += _PEAK * float(np.abs(grooves.depth / grooves.sigma).max())
    more, view = math.atan(relief_slope), widest(station)
    convex = part.shape.convex
    if convex and more < _GENTLE and (own + view < _RIGHT or not station.posed):
        return None
    if own * (1 if convex else 3) + 3 * more + view < _RIGHT:
        return None
    low, high = part.height_range_mm
    tall = sum(float(m.relief_mm.max(initial=0)) for m in relief.maps)
    tall += float(grooves.depth.max(initial=0))
    return March(
        high + tall,
        max(_SLACK_PX * station.camera.sampling_mm, _ROUNDING * (high + tall - low)),
    )
