"""Masks as COCO's compressed run lengths, which keep every pixel; boxes and areas are theirs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco


@dataclass(frozen=True)
class Mask:
    """The mask of one defect.

    Attributes
    ----------
    number : int
        Of the defect, as in the label image.
    area : int
        Pixels.
    box : tuple of int
        Left, top, width and height in pixels.
    segmentation : dict
        ``size`` and ``counts``, as COCO has them.
    """

    number: int
    area: int
    box: tuple[int, int, int, int]
    segmentation: dict[str, Any]


def masks(labels: NDArray[np.int32]) -> list[Mask]:
    """Return the mask of every label that is there, in their order.

    Parameters
    ----------
    labels : ndarray of int32, shape (M, N)
        0: no defect.

    Examples
    --------
    >>> from gpuspec.datasets.rle import masks
    >>> labels = np.zeros((4, 5), np.int32)
    >>> labels[1:3, 2:5] = 7
    >>> masks(labels)
    [Mask(number=7, area=6, box=(2, 1, 3, 2), segmentation={'size': [4, 5], 'counts': '922000O'})]
    """
    rows, columns = labels.shape
    row, column = np.nonzero(labels)
    number = labels[row, column]
    place = column * rows + row  # COCO counts down the columns
    order = np.lexsort((place, number))
    number, place = number[order], place[order]
    ends = np.flatnonzero(np.diff(number)) + 1
    firsts = number[np.r_[0, ends]] if number.size else number
    found = []
    for name, own in zip(firsts.tolist(), np.split(place, ends), strict=False):
        encoded = _encoded(own, rows, columns)
        left, top, width, height = (round(side) for side in coco.toBbox(encoded).tolist())
        counts = encoded["counts"].decode("ascii")
        segmentation = {"size": [rows, columns], "counts": counts}
        area = int(coco.area(encoded))
        found.append(Mask(name, area, (left, top, width, height), segmentation))
    return found


def _encoded(places: NDArray[np.int64], rows: int, columns: int) -> Any:
    """Return pixels, counted down the columns, ascending, as run lengths."""
    begins = np.flatnonzero(np.diff(places, prepend=-2) != 1)
    lengths = np.diff(begins, append=places.size)
    starts = places[begins]
    stops = starts + lengths
    gaps = starts - np.r_[0, stops[:-1]]
    counts = np.stack([gaps, lengths], axis=1).ravel().tolist()
    counts.append(rows * columns - int(stops[-1]))
    return coco.frPyObjects({"size": [rows, columns], "counts": counts}, rows, columns)
