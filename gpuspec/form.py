"""A measured map made whole: its form, what stands out of it, and what fills its holes."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

Heights = NDArray[np.float64]
Mask = NDArray[np.bool_]

AROUND = 5  # points on a side of the square whose median a point is compared with


def form(
    heights: Heights,
    defined: Mask,
    removed: Literal["none", "mean", "plane", "curvature"],
) -> Heights:
    """Return the least-squares polynomial of degree 0, 1 or 2 in x and y over the defined points.

    The products of sums along rows and columns stand in for the (points x terms) matrix.

    Parameters
    ----------
    heights : ndarray of float64, shape (ny, nx)
    defined : ndarray of bool, shape (ny, nx)
    removed : str
        ``"none"`` gives zeros.

    Returns
    -------
    ndarray of float64, shape (ny, nx)
    """
    if removed == "none":
        return np.zeros_like(heights)
    degree = ("mean", "plane", "curvature").index(removed)
    py, px = (
        np.polynomial.legendre.legvander(np.linspace(-1, 1, n), degree) for n in heights.shape
    )
    a, b = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]).T
    qy, qx = ((p[:, :, None] * p[:, None, :]).reshape(len(p), -1) for p in (py, px))
    moments = (qy.T @ defined @ qx).reshape((degree + 1,) * 4)
    gram = moments[a[:, None], a, b[:, None], b]
    right = (py.T @ np.where(defined, heights, 0) @ px)[a, b]
    terms = np.zeros((degree + 1, degree + 1))
    terms[a, b] = np.linalg.lstsq(gram, right, rcond=None)[0]
    fitted: Heights = py @ terms @ px.T
    return fitted


def filled(heights: Heights, defined: Mask) -> Heights:
    """Fill missing points by the harmonic function that meets the defined points around them.

    Each missing point is the mean of its neighbours (the discrete Laplace equation; at the map's
    edge, of those it has). The form is taken off meanwhile: holes at the edge then follow it too.

    Parameters
    ----------
    heights : ndarray of float64, shape (ny, nx)
    defined : ndarray of bool, shape (ny, nx)
        True somewhere.

    Returns
    -------
    ndarray of float64, shape (ny, nx)
    """
    if defined.all():
        return heights
    whole = form(heights, defined, "curvature")
    rough = np.where(defined, heights - whole, 0.0)
    row, column = np.nonzero(~defined)
    number = np.full(heights.shape, -1, np.int64)
    number[row, column] = own = np.arange(len(row))
    neighbours = np.zeros(len(row))
    right = np.zeros(len(row))
    pairs = []
    for down, along in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        j, i = row + down, column + along
        on = (j >= 0) & (j < heights.shape[0]) & (i >= 0) & (i < heights.shape[1])
        neighbours += on
        j, i = np.where(on, j, row), np.where(on, i, column)
        beside = number[j, i]
        right += np.where(on & (beside < 0), rough[j, i], 0)
        unknown = on & (beside >= 0)
        pairs.append((own[unknown], beside[unknown]))
    rows, columns = (np.concatenate(side) for side in zip(*pairs, strict=True))
    laplace = sparse.csc_matrix(
        (
            np.concatenate([neighbours, np.full(len(rows), -1.0)]),
            (np.concatenate([own, rows]), np.concatenate([own, columns])),
        )
    )
    made = heights.copy()
    made[row, column] = spsolve(laplace, right) + whole[row, column]
    return made


def standing_out(heights: Heights, defined: Mask) -> Heights:
    """Return by how much each point differs from the median of the 5 x 5 points around it.

    A spike stands out by its whole height, an edge or a tilt by next to nothing. Missing points are
    filled first, and stand out by nothing.

    Returns
    -------
    ndarray of float64, shape (ny, nx)
    """
    whole = filled(heights, defined)
    away = np.abs(whole - ndimage.median_filter(whole, AROUND, mode="nearest"))
    return np.where(defined, away, 0.0)
