"""What every threshold would find: hits, false blobs, P1 and P2 over the grey level.

As the threshold rises what is detected shrinks, so that two levels tell most of a station: the
lowest at which nothing false is left, and the highest at which every defect is still found. Between
them everything is found and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import GreyLevels, LabelImage, Mask, check_label_image, check_mask
from gpuspec.detection.connected import Integers, connected_pixels
from gpuspec.detection.inspection import Inspection
from gpuspec.detection.score import precision, recall
from gpuspec.detection.segmentation import sampled_places

__all__ = ["OverThreshold", "over_threshold", "thresholds_of"]

_FLOODED = 0.98
"""Share of the pixels that the lowest threshold that is worth a look leaves out."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OverThreshold:
    """What is found at each of n thresholds.

    Attributes
    ----------
    threshold_dn : ndarray of float64, shape (n,)
        Ascending.
    p1, p2, f1 : ndarray of float64, shape (n,)
        As of :class:`gpuspec.detection.score.Score`; P2 and F1 NaN without a zone in view.
    hits : ndarray of int64, shape (n,)
        Defects hit.
    false_blobs, false_px : ndarray of int64, shape (n,)
        Outside zones and guard bands, see :mod:`gpuspec.detection.false_blobs`, and their pixels.
    defects : int
        Those with a pixel in view.
    clean_dn : float
        The lowest level from which on no threshold has a false blob.
    found_dn : float
        The level below which every threshold finds all these defects; NaN if none does.
    """

    threshold_dn: Array
    p1: Array
    p2: Array
    f1: Array
    hits: NDArray[np.int64]
    false_blobs: NDArray[np.int64]
    false_px: NDArray[np.int64]
    defects: int
    clean_dn: float
    found_dn: float

    @property
    def range_dn(self) -> tuple[float, float] | None:
        """From where to where all is found and nothing else; None: nowhere."""
        return (self.clean_dn, self.found_dn) if self.clean_dn < self.found_dn else None

    @property
    def best_dn(self) -> float:
        """The middle of the range; without one the lowest level without a false blob."""
        return sum(self.range_dn) / 2 if self.range_dn else self.clean_dn

    def __repr__(self) -> str:
        there = self.range_dn
        said = f"from {there[0]:.1f} to {there[1]:.1f} DN" if there else "at no threshold"
        return (
            f"OverThreshold({len(self.threshold_dn)} thresholds, {self.defects} defects; all found "
            f"and nothing else {said})"
        )


def thresholds_of(
    image: GreyLevels, valid: Mask, inspected: Inspection, count: int
) -> NDArray[np.float64]:
    """Return thresholds worth a look: from where most is detected to where nothing is.

    Parameters
    ----------
    image : (M, N) array
        DN.
    valid : (M, N) bool array
    inspected : Inspection
        Its threshold is among them, and about half-way to the flawless level they begin.
    count : int
        How many, beside that.

    Returns
    -------
    (n,) float64 array
        Ascending, DN.
    """
    levels = image[valid]
    sample = levels[sampled_places(levels.size)]
    flawless, threshold = inspected.flawless_dn, inspected.threshold
    low = max(min(float(np.quantile(sample, _FLOODED)), (flawless + threshold) / 2), flawless)
    # Close to each other where the flawless levels end, and all that matters is decided.
    steps = np.linspace(0, 1, count) ** 2 * max(float(levels.max()) - low, 0)
    return np.unique([*(low + steps), threshold])


def over_threshold(
    image: GreyLevels,
    truth: LabelImage,
    valid: Mask,
    guard: Mask,
    thresholds: NDArray[np.floating],
    *,
    min_area_px: int = 0,
) -> OverThreshold:
    """Segment and score an image at each of some thresholds.

    Parameters
    ----------
    image : (M, N) array
        Aspect image, DN.
    truth : (M, N) integer array
        Zones: 0 where flawless, i in the zone of defect i, from 1.
    valid : (M, N) bool array
        Pixels that are scored.
    guard : (M, N) bool array
        Zones and their guard bands, as of :func:`gpuspec.part.guard.guarded`: what is detected
        beyond them is false.
    thresholds : (n,) array
        DN. Time goes with what is above the lowest: take none far below the flawless level.
    min_area_px : int
        Smaller blobs are left out, see :func:`gpuspec.detection.false_blobs.least_pixels`.

    Returns
    -------
    OverThreshold

    Raises
    ------
    ValueError
        If the shapes disagree or there is no threshold.

    Examples
    --------
    >>> from gpuspec.detection.over_threshold import over_threshold
    >>> image, truth = np.full((9, 40), 60.0), np.zeros((9, 40), np.int32)
    >>> truth[4, 5], truth[4, 20] = 1, 2
    >>> image[4, 5], image[4, 20], image[2, 33] = 90.0, 75.0, 68.0  # two defects and a stain
    >>> found = over_threshold(image, truth, truth >= 0, truth > 0, np.array([62, 70, 80]))
    >>> found
    OverThreshold(3 thresholds, 2 defects; all found and nothing else from 68.0 to 75.0 DN)
    >>> found.hits.tolist(), found.false_blobs.tolist()
    ([2, 2, 1], [1, 0, 0])
    """
    check_label_image("truth", truth, image.shape)
    check_mask("valid", valid, image.shape)
    check_mask("guard", guard, image.shape)
    levels = np.unique(np.asarray(thresholds, np.float64))
    if not levels.size:
        raise ValueError("There is no threshold to score at.")

    def seen_at(detected: Mask) -> _Seen:
        place = np.flatnonzero(detected)
        return _Seen(
            place, image.flat[place], truth.flat[place].astype(np.intp),
            ~guard.flat[place], image.shape[1], min_area_px,
        )  # fmt: skip

    whole = cache(lambda: seen_at(valid))
    seen = seen_at((image > float(levels[0])) & valid)
    sizes = np.bincount(truth[valid].astype(np.intp))[1:]
    defects = int(np.count_nonzero(sizes))
    above = [seen := seen.above(level) for level in levels]
    counts = np.array([(*some.counts(), *some.false()) for some in above])
    zone_px, out_px, hits, blobs, false_px = counts.T
    p1, p2 = precision(zone_px, out_px), recall(zone_px, np.asarray(sizes.sum()))
    f1 = np.divide(2 * p1 * p2, p1 + p2, out=np.zeros_like(p1), where=p1 + p2 > 0)
    f1[np.isnan(p2)] = np.nan
    clean = _edge(lambda some: some.false()[0] == 0, levels, above, whole)
    found = np.nan
    if defects and (hits[0] == defects or whole().counts()[2] == defects):
        found = _edge(lambda some: some.counts()[2] < defects, levels, above, whole)
    return OverThreshold(levels, p1, p2, f1, hits, blobs, false_px, defects, clean, found)


@dataclass(frozen=True)
class _Seen:
    """The pixels above the lowest threshold: place, level, zone, and whether outside the guard."""

    place: Integers
    level: NDArray[Any]
    zone: NDArray[np.intp]
    outside: Mask
    columns: int
    least: int

    def above(self, threshold: float) -> _Seen:
        """Return those above a threshold, by the levels' own precision, as they are segmented."""
        kept = np.flatnonzero(self.level > float(threshold))
        if len(kept) == len(self.level):
            return self
        return replace(
            self, place=self.place[kept], level=self.level[kept], zone=self.zone[kept],
            outside=self.outside[kept],
        )  # fmt: skip

    def counts(self) -> tuple[int, int, int]:
        """Return detected pixels within zones and outside, and how many defects are hit."""
        zone = self.zone
        if self.least > 1:
            zone = zone[connected_pixels(self.place, self.columns, self.least) > 0]
        hit = np.bincount(zone, minlength=1)
        return int(hit[1:].sum()), int(hit[0]), int(np.count_nonzero(hit[1:]))

    def false(self) -> tuple[int, int]:
        """Return false blobs and their pixels."""
        labels = connected_pixels(self.place[self.outside], self.columns, self.least)
        return int(labels.max(initial=0)), int(np.count_nonzero(labels))


def _edge(
    holds: Callable[[_Seen], bool],
    levels: Array,
    above: Sequence[_Seen],
    whole: Callable[[], _Seen],
) -> float:
    """Return the level from which on something holds: the lowest such level that a pixel has.

    Parameters
    ----------
    holds : callable
        Of what is above a level; once it holds it holds at every higher one.
    levels : ndarray of float64, shape (n,)
        Ascending.
    above : sequence of _Seen
        What is above each.
    whole : callable
        Returns every pixel: where it holds at the lowest of the levels, the edge is below that.
    """
    low, high = -1, len(levels)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(above[middle]) else (middle, high)
    some = whole() if low < 0 else above[low]
    rest = np.unique(some.level)  # of these one is the edge: above the last there is nothing
    if not rest.size:
        return float(levels[0])
    first, last = -1, len(rest) - 1
    while last - first > 1:
        middle = (first + last) // 2
        first, last = (first, middle) if holds(some.above(rest[middle])) else (middle, last)
    return float(rest[last])
