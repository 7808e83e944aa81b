"""From the measures of a blob to its class, and how often the class is right.

The aspect image shows *where* the surface bends, not which way: a dent and a bump of the same size
give the same image, so that no rule on it can tell them apart and one class covers both. A scratch
is told by its elongation. The paper (Seulin, Merienne, Gorria) classifies by size and weight; the
rules and their bounds here are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpuspec.arrays import LabelImage, check_label_image
from gpuspec.detection.measures import Blobs
from gpuspec.shown import html_table

__all__ = ["DEFAULT_RULES", "ClassRule", "Confusion", "classify", "confusion"]

UNCLASSIFIED = "unclassified"
MISSED = "missed"
FALSE = "false"

Range = tuple[float | None, float | None]


@dataclass(frozen=True)
class ClassRule:
    """A class by the ranges of its measures, each half-open: min ≤ value < max.

    Attributes
    ----------
    name : str
        Class name; any but 'missed', which `confusion` keeps for itself.
    area_mm2, weight_dn, elongation : (min, max)
        Bounds on area (mm²), net weight (DN) and elongation; None is no bound.

    Raises
    ------
    ValueError
        If the name is empty or kept, or a range holds no value.

    Examples
    --------
    >>> from gpuspec.detection.classes import ClassRule
    >>> ClassRule("small", area_mm2=(None, 0.05))
    ClassRule(name='small', area_mm2=(None, 0.05), weight_dn=(None, None), elongation=(None,
        None))
    >>> ClassRule("none", area_mm2=(1.0, 0.5))
    Traceback (most recent call last):
        ...
    ValueError: Class 'none': area_mm2 from 1.0 to below 0.5 holds no value.
    """

    name: str
    area_mm2: Range = (None, None)
    weight_dn: Range = (None, None)
    elongation: Range = (None, None)

    def __post_init__(self) -> None:
        """Check the name, and that every range can hold a value."""
        if self.name in ("", MISSED):
            raise ValueError(f"A class cannot be named {self.name!r}.")
        for measure in ("area_mm2", "weight_dn", "elongation"):
            low, high = _bounds(getattr(self, measure))
            if not low < high:
                raise ValueError(
                    f"Class {self.name!r}: {measure} from {low} to below {high} holds no value."
                )

    def matches(self, blobs: Blobs) -> npt.NDArray[np.bool_]:
        """Return, for each of the n blobs, whether all its measures are in range: (n,) bool."""
        matching = np.ones(len(blobs), np.bool_)
        for values, limits in (
            (blobs.area_mm2, self.area_mm2),
            (blobs.net_weight_dn, self.weight_dn),
            (blobs.elongation, self.elongation),
        ):
            low, high = _bounds(limits)
            matching &= (low <= values) & (values < high)
        return matching


def _bounds(limits: Range) -> tuple[float, float]:
    low, high = limits
    return -np.inf if low is None else low, np.inf if high is None else high


DEFAULT_RULES = (ClassRule("scratch", elongation=(3.0, None)), ClassRule("dent or bump"))
"""Three times as long as wide is a scratch, the rest a dent or a bump, which look alike."""


def classify(blobs: Blobs, rules: Sequence[ClassRule] = DEFAULT_RULES) -> npt.NDArray[np.str_]:
    """Name the class of each blob: that of the first rule it matches, else 'unclassified'.

    Parameters
    ----------
    blobs : Blobs
        Table of n blobs.
    rules : sequence of ClassRule
        In order of precedence. A name may come twice, for a class of several ranges.

    Returns
    -------
    (n,) str array
        Class names.

    Examples
    --------
    >>> from gpuspec.detection.classes import ClassRule, classify
    >>> from gpuspec.detection.measures import measure_blobs
    >>> labels = np.array([[1, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 2]])
    >>> blobs = measure_blobs(labels, 80.0 * (labels > 0), sampling_mm=0.1, flawless_dn=60.0)
    >>> classify(blobs).tolist()
    ['scratch', 'dent or bump']
    >>> classify(blobs, [ClassRule("large", area_mm2=(0.02, None))]).tolist()
    ['large', 'unclassified']
    """
    names = np.array([*(rule.name for rule in rules), UNCLASSIFIED])
    everything = np.ones(len(blobs), np.bool_)
    matches = np.array([*(rule.matches(blobs) for rule in rules), everything])
    classes: npt.NDArray[np.str_] = names[matches.argmax(axis=0)]
    return classes


@dataclass(frozen=True, eq=False)
class Confusion:
    """How many defects of each kind were taken for which class.

    Attributes
    ----------
    rows : tuple of str
        The true kinds, as first met, and 'false'.
    columns : tuple of str
        The classes, in alphabetical order, and 'missed'.
    counts : (rows, columns) int64 array
        Each true defect once in the row of its kind, each false blob once in the row 'false'.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    counts: npt.NDArray[np.int64]

    def __repr__(self) -> str:
        said = []
        for kind, counts in zip(self.rows, self.counts.tolist(), strict=True):
            found = [f"{n} {c}" for n, c in zip(counts, self.columns, strict=True) if n]
            said += [f"{kind}: {', '.join(found)}"] if found else []
        return f"Confusion({'; '.join(said)})"

    def _repr_html_(self) -> str:
        """Show itself in a notebook: kinds down, classes across."""
        rows = [
            {"known \\ found": kind, **dict(zip(self.columns, counts, strict=True))}
            for kind, counts in zip(self.rows, self.counts.tolist(), strict=True)
        ]
        return html_table(rows, len(rows))


def confusion(
    truth_kinds: Sequence[str],
    truth_labels: LabelImage,
    labels: LabelImage,
    blob_classes: Sequence[str] | npt.NDArray[np.str_],
) -> Confusion:
    """Count the true defects by kind and by the class of their blob.

    A defect's blob is the one that covers most pixels of its zone (on a tie, the lowest label);
    without any it is 'missed'. A blob that touches no zone is false. One blob may be the blob of
    several defects.

    Parameters
    ----------
    truth_kinds : sequence of str
        Kind of each true defect.
    truth_labels : (M, N) integer array
        Zones: 0 where flawless, i in the zone of defect ``truth_kinds[i - 1]``.
    labels : (M, N) integer array
        Label image, 1 to the number of blobs without a gap.
    blob_classes : sequence of str
        Class of each blob, by label.

    Returns
    -------
    Confusion
        The counts.

    Raises
    ------
    ValueError
        If the shapes disagree, the label images are not integers from 0, a zone has no kind, there
        is not one class per blob, or a kind or class has a name kept for the table.

    Examples
    --------
    >>> from gpuspec.detection.classes import confusion
    >>> truth = np.array([[1, 1, 0, 2, 0, 0]])
    >>> labels = np.array([[1, 0, 0, 0, 0, 2]])
    >>> confusion(["dent", "scratch"], truth, labels, ["dent or bump", "scratch"])
    Confusion(dent: 1 dent or bump; scratch: 1 missed; false: 1 scratch)
    """
    check_label_image("truth_labels", truth_labels)
    check_label_image("labels", labels, truth_labels.shape)
    defects, blobs = len(truth_kinds), len(blob_classes)
    if truth_labels.max(initial=0) > defects:
        raise ValueError(f"truth_labels holds {truth_labels.max()} but {defects} kinds are given.")
    if labels.max(initial=0) != blobs:
        raise ValueError(f"labels go up to {labels.max(initial=0)} but {blobs} classes are given.")
    if FALSE in truth_kinds or MISSED in blob_classes:
        raise ValueError(f"No kind can be named {FALSE!r} and no class {MISSED!r}.")

    both = np.flatnonzero((truth_labels != 0) & (labels != 0))
    zone = truth_labels.ravel()[both].astype(np.int64)
    pairs, pixels = np.unique(zone * (blobs + 1) + labels.ravel()[both], return_counts=True)
    zone, blob = np.divmod(pairs, blobs + 1)
    best_last = np.lexsort((-blob, pixels, zone))
    blob_of_defect = np.zeros(defects + 1, np.int64)
    blob_of_defect[zone[best_last]] = blob[best_last]
    is_false = np.ones(blobs, np.bool_)
    is_false[blob - 1] = False

    rows = (*dict.fromkeys(map(str, truth_kinds)), FALSE)
    columns = (*sorted(set(map(str, blob_classes))), MISSED)
    column_of_blob = np.array([-1, *(columns.index(str(name)) for name in blob_classes)])
    row_of_defect = np.array([rows.index(str(kind)) for kind in truth_kinds], np.int64)
    counts = np.zeros((len(rows), len(columns)), np.int64)
    np.add.at(counts, (row_of_defect, column_of_blob[blob_of_defect[1:]]), 1)
    np.add.at(counts[-1], column_of_blob[1:][is_false], 1)
    return Confusion(rows, columns, counts)
