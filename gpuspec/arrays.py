"""The arrays' words: images, label images, masks and the codes of lost light; their checks."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pooled(image: NDArray[Any], factor: int, by: np.ufunc) -> NDArray[Any]:
    """Reduce squares of `factor` pixels by np.add (to their mean), np.maximum or np.minimum.

    Parameters
    ----------
    image : ndarray of float32, shape (M, N)
    factor : int
        Side of a square, in pixels; 1 returns the image itself.
    by : np.ufunc
        np.add, np.maximum or np.minimum.

    Returns
    -------
    ndarray, shape (ceil(M / factor), ceil(N / factor))

    Examples
    --------
    >>> from gpuspec.arrays import pooled
    >>> pooled(np.arange(6, dtype=np.float32).reshape(2, 3), 2, np.maximum).tolist()
    [[4.0, 5.0]]
    """
    if factor == 1:
        return image
    # Whole slices, rows then columns: far faster than reduceat, and the last square may be small.
    for _ in range(2):
        length = image.shape[0]
        reduced = image[::factor].copy()
        for start in range(1, factor):
            others = image[start::factor]
            by(reduced[: len(others)], others, out=reduced[: len(others)])
        if by is np.add:
            counts = np.minimum(factor, length - np.arange(0, length, factor))
            reduced /= counts.astype(np.float32)[:, None]
        image = reduced.T
    return image


GreyLevels = NDArray[np.floating[Any] | np.integer[Any]]
LabelImage = NDArray[np.integer[Any]]
Mask = NDArray[np.bool_]


def check_label_image(name: str, labels: LabelImage, shape: tuple[int, ...] | None = None) -> None:
    """See that labels are an (M, N) array of integers from 0, and of a shape.

    Parameters
    ----------
    name : str
        What the array is called, for the message.
    labels : (M, N) integer array
    shape : tuple of int, optional
        Of the image beside it; None: any.

    Raises
    ------
    ValueError
        If they are not.
    """
    if labels.ndim != 2 or labels.dtype.kind not in "iu":
        raise ValueError(
            f"{name} must be an (M, N) array of integers, not {labels.dtype} of {labels.shape}."
        )
    if shape is not None and labels.shape != shape:
        raise ValueError(f"{name} is {labels.shape} but the image beside it is {shape}.")
    if labels.size and labels.min() < 0:
        raise ValueError(f"{name} holds {labels.min()}; labels start at 0.")


def check_mask(name: str, mask: Mask, shape: tuple[int, ...]) -> None:
    """See that a mask is an array of bool of a shape.

    Parameters
    ----------
    name : str
        What the array is called, for the message.
    mask : (M, N) bool array
    shape : tuple of int
        Of the image beside it.

    Raises
    ------
    ValueError
        If it is not.
    """
    if mask.dtype != np.bool_ or mask.shape != shape:
        raise ValueError(
            f"{name} must be an array of bool of {shape}, not {mask.dtype} of {mask.shape}."
        )


Image = NDArray[np.float32]


class Lost(IntEnum):
    """Why a ray sees no light; of a pixel's several reasons the largest counts."""

    NOT = 0
    BESIDE = 1
    DOWN = 2
    END = 3
    OPENING = 4
    HIDDEN = 5
    AGAIN = 6


LOST = (
    "seen",
    "beside the part",
    "reflected down, away from the tunnel",
    "past the tunnel's end",
    "in the camera's opening",
    "hidden from the camera by the part",
    "reflected onto the part again",
)
BESIDE = int(Lost.BESIDE)
