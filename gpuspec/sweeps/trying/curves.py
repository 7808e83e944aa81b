"""How a design does at every threshold, over all its parts: P1, P2, hits, false pixels, margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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

KINDS = ("dent", "bump", "scratch", "measured", "pit")
"""Of defects, as :class:`gpuspec.part.truth.KnownDefect` has them."""


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
    peaks : ndarray of uint8, shape (D, n)
        Level of the brightest pixel of each defect in view, of all parts one after another.
    kinds : ndarray of uint8, shape (n,)
        Of these defects, index into `KINDS`.
    sizes_mm : ndarray of float32, shape (n,)
        Their size: diameter, or width.
    stray_low, stray_high : ndarray of float64, shape (D, 256)
        Bounds of the detected pixels outside zones and guard band, over all parts.
    flawless_low, flawless_high : ndarray of int64, shape (D,)
        Bounds of the highest level there.
    """

    hit_px: Ints
    false_px: Floats
    hits: Ints
    zone_px: Ints
    seen: Ints
    false_low: Floats
    false_high: Floats
    exact: NDArray[np.bool_]
    peaks: NDArray[np.uint8]
    kinds: NDArray[np.uint8]
    sizes_mm: NDArray[np.float32]
    stray_low: Floats
    stray_high: Floats
    flawless_low: Ints
    flawless_high: Ints

    @classmethod
    def of(
        cls, levels: Sequence[Levels], parts: Sequence[TracedPart], risk: float, seeds: int = 1
    ) -> Curves:
        """Add up levels.

        Parameters
        ----------
        levels : sequence of Levels
            Of each part, under the same designs.
        parts : sequence of TracedPart
        risk : float
            Greatest chance of each bound to be wrong, see :class:`Bounds`.
        seeds : int
            Draws of the noise on each part, which have the same sample.
        """
        hit = np.stack([_above(part.inside) for part in levels])
        near = np.stack([_above(part.outside) for part in levels])
        drawn = np.stack([_above(part.sampled) for part in levels])
        samples = [part.sample for part in parts if part.sample is not None]
        ceiling = np.max([part.ceiling for part in levels], axis=0)
        false = near.astype(np.float64)
        low = high = false.sum(axis=0)
        rim = np.sum([_above(part.guard) for part in levels], axis=0)
        # Thresholds at which something beyond the guard band is detected, of those counted.
        least = ((low - rim + drawn.sum(axis=0)) > 0).sum(axis=1)
        if samples:
            weight = samples[0].weight
            strata = sum(len(s.chosen) for s in samples) // seeds
            bounds = Bounds(strata, weight, risk / seeds)
            false += drawn * weight
            # From its ceiling on nothing that was not counted is detected.
            certain = np.arange(LEVELS) >= ceiling[:, None]
            for draw in range(seeds):
                together = drawn[draw::seeds].sum(axis=0)
                low = low + np.where(certain, together, bounds.low(together))
                high = high + np.where(certain, together, bounds.high(together))
        seen = [part.zones.sizes > 0 for part in parts]
        known = [
            defect
            for part, there in zip(parts, seen, strict=True)
            for defect, is_there in zip(part.known, there, strict=False)
            if is_there
        ]
        peaks = [of.peaks[:, there] for of, there in zip(levels, seen, strict=True)]
        return cls(
            hit, false, np.stack([_hits(part.peaks) for part in levels]),
            np.array([part.zones.sizes.sum() for part in parts]),
            np.array([np.count_nonzero(there) for there in seen]),
            low, high, ceiling == 0,
            np.concatenate(peaks, axis=1).astype(np.uint8),
            np.array([KINDS.index(defect.kind) for defect in known], np.uint8),
            np.array([defect.size_mm for defect in known], np.float32),
            low - rim, high - rim, least, np.maximum(least, ceiling),
        )  # fmt: skip

    @classmethod
    def together(cls, parts: Sequence[Curves]) -> Curves:
        """Put the curves of designs side by side that see the same pixels of the same zones.

        Parameters
        ----------
        parts : sequence of Curves
            At least one, of one `view`.
        """
        first = parts[0]
        if len(parts) == 1:
            return first

        def all_of(name: str, axis: int) -> Any:
            return np.concatenate([getattr(part, name) for part in parts], axis=axis)

        side_by_side = {name: all_of(name, 1) for name in ("hit_px", "false_px", "hits")}
        one_per_row = ("false_low", "false_high", "exact", "peaks", "stray_low", "stray_high",
                       "flawless_low", "flawless_high")  # fmt: skip
        return replace(first, **side_by_side, **{name: all_of(name, 0) for name in one_per_row})

    @property
    def view(self) -> tuple[Any, ...]:
        """What is in view: pixels of the zones and defects of each part, and which these are."""
        which = self.kinds.tobytes(), self.sizes_mm.tobytes()
        return (*self.zone_px.tolist(), *self.seen.tolist(), *which)

    @property
    def weakest(self) -> Ints:
        """Level of the defect that is the faintest under each design, shape (D,)."""
        found: Ints = self.peaks.min(axis=1, initial=LEVELS - 1).astype(np.int64)
        return found

    @property
    def worst_p2(self) -> Floats:
        """Recall on the part or draw where it is the lowest, shape (D, 256)."""
        there = self.zone_px > 0
        found: Floats = recall(self.hit_px[there], self.zone_px[there, None, None]).min(axis=0)
        return found

    @property
    def worst_hits(self) -> Ints:
        """Defects hit on the part or draw where they are the fewest, shape (D, 256)."""
        found: Ints = self.hits[self.seen > 0].min(axis=0)
        return found

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
