"""How well the defects are detected: precision P1 (overdetection), recall P2 (misdetection).

The paper's two figures (Seulin, Merienne, Gorria), with n_Z the detected pixels inside the zones,
n_0 those outside, N_Z the pixels of the zones: P1 = n_Z/(n_Z + n_0), P2 = n_Z/N_Z. 1 is best for
both: the paper calls them by what they guard against. What they become where nothing is detected or
nothing is there to detect is ours, and so are the counts of defects and blobs.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gpuspec.arrays import LabelImage, Mask, check_label_image, check_mask

__all__ = ["Score", "precision", "recall", "score"]


@dataclass(frozen=True)
class Score:
    """How well the defects of one part are detected, over its valid pixels.

    Attributes
    ----------
    p1 : float
        Precision n_Z/(n_Z + n_0), the paper's overdetection; 1, the best, if no pixel is detected
        outside the zones.
    p2 : float or None
        Recall n_Z/N_Z, the paper's misdetection, 1 the best; None, undefined, if no valid pixel is
        in a zone.
    f1 : float or None
        2·P1·P2/(P1 + P2); 0 if both are 0, None if P2 is.
    zone_px, hit_px, false_px : int
        N_Z, n_Z and n_0.
    defects, defects_hit, unseen : int
        True defects; those with a detected pixel in their zone; those without a valid pixel in
        their zone, which count among the defects and cannot be hit.
    blobs, false_blobs : int
        Blobs with a valid pixel; those of them with no valid pixel in a zone.
    defect_zone_px, defect_hit_px : tuple of int
        Valid and detected pixels in the zone of each defect.
    """

    p1: float
    p2: float | None
    f1: float | None
    zone_px: int
    hit_px: int
    false_px: int
    defects: int
    defects_hit: int
    unseen: int
    blobs: int
    false_blobs: int
    defect_zone_px: tuple[int, ...]
    defect_hit_px: tuple[int, ...]

    def __repr__(self) -> str:
        p2, f1 = ("undefined" if v is None else f"{v:.3f}" for v in (self.p2, self.f1))
        return (
            f"Score(P1 {self.p1:.3f}, P2 {p2}, F1 {f1}; {self.defects_hit} of {self.defects} "
            f"defects hit, {self.false_blobs} of {self.blobs} blobs false)"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the attributes as a dict that the json module can write."""
        return asdict(self)

    @property
    def hits(self) -> tuple[str, str]:
        """Defects hit, and what to know of those that cannot be."""
        beyond = f"{self.unseen} without a pixel in the image" if self.unseen else ""
        return f"{self.defects_hit} of {self.defects}", beyond

    @property
    def undefined(self) -> str:
        """Why P2 is undefined; empty where it is defined."""
        if self.p2 is not None:
            return ""
        if not self.defects:
            return "the part is flawless"
        return "no defect's zone has a pixel in the image"

    @property
    def summary(self) -> str:
        """The score in one sentence."""
        p2 = (
            f"recall P2 undefined ({self.undefined})"
            if self.p2 is None
            else f"recall P2 {self.p2:.3f} ({self.hit_px} of {self.zone_px} zone pixels detected)"
        )
        unseen = f" ({self.unseen} unseen)" if self.unseen else ""
        return (
            f"Precision P1 {self.p1:.3f} ({self.false_px} of {self.hit_px + self.false_px} "
            f"detected pixels outside the zones), {p2}, {self.defects_hit} of {self.defects} "
            f"defects hit{unseen}, {self.false_blobs} of {self.blobs} blobs false."
        )


def precision(hit_px: npt.ArrayLike, false_px: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return P1 = n_Z/(n_Z + n_0), 1 where n_0 is 0.

    Parameters
    ----------
    hit_px, false_px : array_like
        Detected pixels inside (n_Z) and outside (n_0) the zones.

    Examples
    --------
    >>> from gpuspec.detection.score import precision
    >>> precision([80, 0], [20, 0]).tolist()
    [0.8, 1.0]
    """
    hit, false = np.asarray(hit_px, np.float64), np.asarray(false_px, np.float64)
    return np.where(false > 0, hit / np.maximum(hit + false, 1), 1.0)


def recall(hit_px: npt.ArrayLike, zone_px: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return P2 = n_Z/N_Z, NaN where there is no pixel in a zone.

    Parameters
    ----------
    hit_px : int or array
        Detected pixels in zones, n_Z.
    zone_px : int or array
        Pixels in zones, N_Z, of a shape that broadcasts with `hit_px`.

    Returns
    -------
    ndarray of float64, of their common shape

    Examples
    --------
    >>> from gpuspec.detection.score import recall
    >>> recall([80, 0], [100, 0]).tolist()
    [0.8, nan]
    """
    hit, zone = np.asarray(hit_px, np.float64), np.asarray(zone_px, np.float64)
    return np.where(zone > 0, hit / np.maximum(zone, 1), np.nan)


def score(labels: LabelImage, truth: LabelImage, valid: Mask, defects: int) -> Score:
    """Compare the detected pixels with the zones of the true defects.

    Parameters
    ----------
    labels : (M, N) integer array
        Label image of the detected blobs; 0 where nothing is detected.
    truth : (M, N) integer array
        Zones: 0 where flawless, i in the zone of defect i, from 1.
    valid : (M, N) bool array
        Pixels that are scored; the others count nowhere.
    defects : int
        True defects on the part, those without any pixel in `truth` included.

    Returns
    -------
    Score
        P1, P2 and the counts behind them.

    Raises
    ------
    ValueError
        If the shapes disagree, `labels` or `truth` are not integers from 0, `valid` is not bool, or
        `truth` holds a label above `defects`.

    Examples
    --------
    >>> from gpuspec.detection.score import score
    >>> truth = np.array([[1, 1, 0, 2, 0, 0]])
    >>> labels = np.array([[1, 0, 0, 0, 0, 2]])
    >>> score(labels, truth, np.full((1, 6), True), defects=2)
    Score(P1 0.500, P2 0.333, F1 0.400; 1 of 2 defects hit, 1 of 2 blobs false)
    """
    check_label_image("labels", labels)
    check_label_image("truth", truth, labels.shape)
    check_mask("valid", valid, labels.shape)
    if truth.max(initial=0) > defects:
        raise ValueError(f"truth holds the label {truth.max()} but the part has {defects} defects.")

    # Places of the few that are set: taking these is faster than a mask of all.
    zone = truth.flat[np.flatnonzero((truth != 0) & valid)].astype(np.intp)
    detected = np.flatnonzero((labels != 0) & valid)
    blob = labels.flat[detected].astype(np.intp)
    zone_hit = truth.flat[detected].astype(np.intp)

    defect_zone_px = np.bincount(zone, minlength=defects + 1)[1:]
    defect_hit_px = np.bincount(zone_hit, minlength=defects + 1)[1:]
    blobs = np.count_nonzero(np.bincount(blob))
    true_blobs = np.count_nonzero(np.bincount(blob[zone_hit != 0]))

    zone_px, hit_px = zone.size, int(defect_hit_px.sum())
    false_px = blob.size - hit_px
    p1 = float(precision(hit_px, false_px))
    p2 = float(recall(hit_px, zone_px)) if zone_px else None
    return Score(
        p1=p1,
        p2=p2,
        f1=None if p2 is None else 2 * p1 * p2 / (p1 + p2) if hit_px else 0.0,
        zone_px=zone_px,
        hit_px=hit_px,
        false_px=false_px,
        defects=defects,
        defects_hit=int(np.count_nonzero(defect_hit_px)),
        unseen=int(np.count_nonzero(defect_zone_px == 0)),
        blobs=int(blobs),
        false_blobs=int(blobs - true_blobs),
        defect_zone_px=tuple(defect_zone_px.tolist()),
        defect_hit_px=tuple(defect_hit_px.tolist()),
    )
