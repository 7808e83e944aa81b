"""P1, P2 and defects hit of a design at every threshold, over all its parts; and the best one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.detection.score import precision, recall
from gpuspec.light.constants import LEVELS
from gpuspec.light.levels import Levels
from gpuspec.sweeps.trying.parts import TracedPart
from gpuspec.sweeps.trying.screening import Bounds

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Curves:
    """How D designs do at each of 256 thresholds.

    Attributes
    ----------
    hit_px, false_px : ndarray, shape (parts, D, 256)
        Detected pixels inside and outside the zones; outside, with a sample, an estimate.
    hits : ndarray of int64, shape (parts, D, 256)
        Defects hit.
    zone_px, seen : ndarray of int64, shape (parts,)
        Pixels of the zones; defects with a pixel in their zone.
    false_low, false_high : ndarray of float64, shape (D, 256)
        Bounds of the detected pixels outside, over all parts.
    exact : ndarray of bool, shape (D,)
        Whether nothing was sampled.
    """

    hit_px: Ints
    false_px: Floats
    hits: Ints
    zone_px: Ints
    seen: Ints
    false_low: Floats
    false_high: Floats
    exact: NDArray[np.bool_]

    @classmethod
    def of(cls, levels: Sequence[Levels], parts: Sequence[TracedPart], risk: float) -> Curves:
        """Add up levels.

        Parameters
        ----------
        levels : sequence of Levels
            Of each part, under the same designs.
        parts : sequence of TracedPart
        risk : float
            Greatest chance of each bound to be wrong, see :class:`Bounds`.
        """
        hit = np.stack([_above(part.inside) for part in levels])
        near = np.stack([_above(part.outside) for part in levels])
        drawn = np.stack([_above(part.sampled) for part in levels])
        samples = [part.sample for part in parts if part.sample is not None]
        ceiling = np.max([part.ceiling for part in levels], axis=0)
        false = near.astype(np.float64)
        low = high = false.sum(axis=0)
        if samples:
            weight = samples[0].weight
            bounds = Bounds(sum(len(s.chosen) for s in samples), weight, risk)
            false += drawn * weight
            together = drawn.sum(axis=0)
            # From its ceiling on nothing that was not counted is detected.
            certain = np.arange(LEVELS) >= ceiling[:, None]
            low = low + np.where(certain, together, bounds.low(together))
            high = high + np.where(certain, together, bounds.high(together))
        return cls(
            hit, false, np.stack([_hits(part.peaks) for part in levels]),
            np.array([part.zones.sizes.sum() for part in parts]),
            np.array([np.count_nonzero(part.zones.sizes) for part in parts]),
            low, high, ceiling == 0,
        )  # fmt: skip

    @property
    def p1(self) -> Floats:
        """Precision over all parts, shape (D, 256)."""
        return precision(self.hit_px.sum(axis=0), self.false_px.sum(axis=0))

    @property
    def p1_low(self) -> Floats:
        """Least P1 there may be, shape (D, 256)."""
        return precision(self.hit_px.sum(axis=0), self.false_high)

    @property
    def p1_high(self) -> Floats:
        """Greatest P1 there may be, shape (D, 256)."""
        return precision(self.hit_px.sum(axis=0), self.false_low)

    @property
    def p2(self) -> Floats:
        """Recall over all parts, shape (D, 256)."""
        return recall(self.hit_px.sum(axis=0), self.zone_px.sum())


def _above(counts: Ints) -> Ints:
    """Return, from how often each level comes, how many pixels are above each threshold."""
    above = np.zeros_like(counts)
    above[:, :-1] = counts[:, :0:-1].cumsum(axis=1)[:, ::-1]
    return above


def _hits(peaks: Ints) -> Ints:
    counts: Any = np.zeros((len(peaks), 256), np.int64)
    row = np.broadcast_to(np.arange(len(peaks))[:, None], peaks.shape)
    np.add.at(counts, (row, peaks), 1)
    return _above(counts)
