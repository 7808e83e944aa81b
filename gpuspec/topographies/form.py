"""A measured map made whole: its form, what stands out of it, and what fills its holes."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Heights = NDArray[np.float64]
Mask = NDArray[np.bool_]

SOLVED_MAX = 200_000  # missing points whose equations are solved directly: 2 s, 0.3 GB
_RELAXED = 30  # rounds
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
    rough = _harmonic(np.where(defined, heights - whole, 0.0), defined)
    return np.where(defined, heights, rough + whole)


def _harmonic(heights: Heights, defined: Mask) -> Heights:
    """Solve the Laplace equation where heights are missing: directly, or from half the points.

    A direct solution of a hole of n points takes n^1.5 operations; beyond `SOLVED_MAX` the holes
    of the map of every second point are filled, and what comes between them is relaxed.
    """
    row, column = np.nonzero(~defined)
    number = np.full(heights.shape, -1, np.int64)
    number[row, column] = own = np.arange(len(row))
    beside, on = [], []
    for down, along in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        j, i = row + down, column + along
        on.append((j >= 0) & (j < heights.shape[0]) & (i >= 0) & (i < heights.shape[1]))
        beside.append((np.where(on[-1], j, row), np.where(on[-1], i, column)))
    neighbours = sum(there.astype(float) for there in on)
    made = heights.copy()
    if len(row) > SOLVED_MAX:
        made[row, column] = _from_half(heights, defined)[row, column]
        for _ in range(_RELAXED):
            around = sum(np.where(a, made[at], 0) for a, at in zip(on, beside, strict=True))
            made[row, column] = around / neighbours
        return made
    right, rows, columns = np.zeros(len(row)), [own], [own]
    for there, at in zip(on, beside, strict=True):
        unknown = there & (number[at] >= 0)
        right += np.where(there & ~unknown, heights[at], 0)
        rows.append(own[unknown])
        columns.append(number[at][unknown])
    off = np.full(sum(map(len, rows[1:])), -1.0)
    from scipy import sparse  # slow to import
    from scipy.sparse.linalg import splu

    laplace = sparse.csc_matrix(
        (np.concatenate([neighbours, off]), (np.concatenate(rows), np.concatenate(columns)))
    )
    # Symmetric, so that half the time and memory of a general matrix are enough.
    factors = splu(
        laplace, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )  # fmt: skip
    made[row, column] = factors.solve(right)
    return made


def _from_half(heights: Heights, defined: Mask) -> Heights:
    """Fill the map of the means of 2 x 2 points, and interpolate it."""
    from scipy import ndimage  # slow to import

    ny, nx = heights.shape
    even = ((0, ny % 2), (0, nx % 2))
    blocks = (-(-ny // 2), 2, -(-nx // 2), 2)
    count = np.pad(defined, even).reshape(blocks).sum(axis=(1, 3))
    total = np.pad(np.where(defined, heights, 0), even).reshape(blocks).sum(axis=(1, 3))
    half = _harmonic(total / np.maximum(count, 1), count > 0)
    # Point j of the map lies at (j - 0.5) / 2 of the halves.
    at = np.ix_((np.arange(ny) - 0.5) / 2, (np.arange(nx) - 0.5) / 2)
    between: Heights = ndimage.map_coordinates(
        half, np.broadcast_arrays(*at), order=1, mode="nearest"
    )
    return between


def standing_out(heights: Heights, defined: Mask) -> Heights:
    """Return by how much each point differs from the median of the 5 x 5 points around it.

    A spike stands out by its whole height, an edge or a tilt by next to nothing. Missing points are
    filled first, and stand out by nothing.

    Parameters
    ----------
    heights : ndarray of float64, shape (ny, nx)
        Heights in mm.
    defined : ndarray of bool, shape (ny, nx)
        Points that were measured.

    Returns
    -------
    ndarray of float64, shape (ny, nx)
        In mm; 0 where missing.
    """
    from scipy import ndimage  # slow to import

    whole = filled(heights, defined)
    away = np.abs(whole - ndimage.median_filter(whole, AROUND, mode="nearest"))
    return np.where(defined, away, 0.0)
