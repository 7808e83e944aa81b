"""Meshes: triangles of a file, and the height of what is seen of them from above, on a grid.

The heights between a triangle's corners are cubic: they go through the corners with the slopes of
smooth normals there. So a sphere of triangles reflects like a sphere.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import TopographyError
from gpuspec.topographies.file import brief, silence
from gpuspec.topographies.form import Heights, Mask

INSTALL = 'pip install "gpuspec[mesh]"'
KINDS = (".stl", ".obj", ".ply")
UNITS_MM = {"mm": 1.0, "m": 1e3, "inch": 25.4}
BYTES_MAX = 2**30
FACES_MAX = 20_000_000
_HITS_AT_ONCE = 4_000_000
_NOWHERE = -1
_FLAT = 1e-12  # of a triangle's box: seen from above, it is a line
_TOUCH = 1e-7  # of a triangle's height: a line of the grid that touches it
_STEEPEST = 1e3

Triangles = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with smooth normals.

    Attributes
    ----------
    corners : ndarray of float64, shape (F, 3, 3)
        x, y and z of the three corners of each, mm.
    normals : ndarray of float64, shape (F, 3, 3)
        Of the surface there, of any length, outward as the file's order of corners has it.
    """

    corners: Triangles
    normals: Triangles

    @property
    def box_mm(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Least and greatest x, y and z, each of shape (3,)."""
        points = self.corners.reshape(-1, 3)
        return points.min(axis=0), points.max(axis=0)

    def moved(self, by: tuple[float, float, float]) -> Mesh:
        """Return it moved by x, y and z in mm."""
        return Mesh(self.corners + np.array(by), self.normals)


def read_mesh(path: Path, unit: str, smooth_deg: float, says: str) -> Mesh:
    """Read triangles from a file of STL, OBJ or PLY.

    Parameters
    ----------
    path : Path
    unit : str
        Of the file's numbers: a key of ``UNITS_MM``.
    smooth_deg : float
        Edges at which the faces turn by more stay sharp.
    says : str
        File and key, to begin an error with.

    Raises
    ------
    TopographyError
        If the file is absent, damaged, too large or no mesh; or trimesh is not installed.
    """
    if path.is_dir():
        raise TopographyError(f"{says} is a folder; name a mesh in it.")
    if not path.is_file():
        raise TopographyError(f"{says} is not there; looked for {path}.")
    if path.suffix.lower() not in KINDS:
        raise TopographyError(f"{says} is no .stl, .obj or .ply; export the mesh as one of them.")
    size = path.stat().st_size
    if size > BYTES_MAX:
        raise TopographyError(
            f"{says} has {size / 2**30:.1f} GiB, more than {BYTES_MAX / 2**30:g}; export fewer "
            f"triangles."
        )
    data = path.read_bytes()
    claimed = _claimed(data, path.suffix.lower())
    if claimed > size:  # no vertex and no face takes less than a byte
        raise TopographyError(
            f"{says} claims {claimed:,} vertices or faces in a file of {size:,} bytes; it is "
            f"damaged: export it again."
        )
    try:
        import trimesh
    except ImportError as error:
        raise TopographyError(f"{says} cannot be read without trimesh ({error}); {INSTALL}.") from (
            None
        )
    with silence():
        # A reader given damaged bytes may raise anything.
        try:
            loaded = trimesh.load_mesh(io.BytesIO(data), file_type=path.suffix[1:].lower())
            faces, points = len(loaded.faces), len(loaded.vertices)
        except Exception as error:
            raise TopographyError(
                f"{says} cannot be read ({brief(error)}); it may be damaged: export it again."
            ) from None
        if not faces:
            held = f"{points:,} points but no faces" if points else "nothing"
            raise TopographyError(f"{says} holds {held}; export its triangles.")
        if faces > FACES_MAX:
            raise TopographyError(
                f"{says} has {faces:,} faces, more than {FACES_MAX:,}; export fewer triangles."
            )
        if not np.isfinite(loaded.vertices).all():
            raise TopographyError(
                f"{says} has vertices that are no finite numbers; export it again."
            )
        shaded = trimesh.graph.smooth_shade(
            loaded, angle=math.radians(smooth_deg), facet_minarea=None
        )
    points_mm = np.asarray(shaded.vertices, np.float64) * UNITS_MM[unit]
    of = np.asarray(shaded.faces, np.int64)
    return Mesh(points_mm[of], _normals(points_mm, of)[of])


def _claimed(data: bytes, kind: str) -> int:
    """Return how many vertices or faces a file says it has, where its head says so."""
    if kind == ".ply":
        head = data[:100_000].partition(b"end_header")[0]
        return max(map(int, re.findall(rb"element \w+ (\d{1,30})", head)), default=0)
    if kind == ".stl" and not data.startswith(b"solid") and len(data) >= 84:
        return 50 * int.from_bytes(data[80:84], "little")
    return 0


def _normals(points: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return a normal of each vertex, of any length: exact where they lie on a sphere.

    N. Max, Weights for computing vertex normals from facet normals, J. Graphics Tools 4(2), 1999:
    of the two edges a, b of a face that meet there, a x b / (a.a)(b.b).
    """
    normals = np.zeros_like(points)
    for nth in range(3):
        here, after, before = (faces[:, (nth + k) % 3] for k in range(3))
        a, b = points[after] - points[here], points[before] - points[here]
        squares = (a**2).sum(axis=1) * (b**2).sum(axis=1)
        weighed = np.cross(a, b) / np.maximum(squares, 1e-300)[:, None]
        for axis in range(3):
            normals[:, axis] += np.bincount(here, weighed[:, axis], len(points))
    return normals


@dataclass(frozen=True, eq=False)
class Sampled:
    """What is seen of a mesh from above at points of a grid.

    Attributes
    ----------
    heights_mm : ndarray of float64, shape (ny, nx)
        0 where nothing is seen. Row 0 has the least y.
    defined : ndarray of bool, shape (ny, nx)
        Where something is.
    backs : float
        Share of these points at which the back of a face is seen.
    """

    heights_mm: Heights
    defined: Mask
    backs: float


def sampled(mesh: Mesh, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> Sampled:
    """Return the highest surface over the points of a grid.

    Parameters
    ----------
    mesh : Mesh
    x_mm : ndarray of float64, shape (nx,)
        Ascending, in equal steps.
    y_mm : ndarray of float64, shape (ny,)
        The same.
    """
    a, b, c = mesh.corners[:, 0], mesh.corners[:, 1], mesh.corners[:, 2]
    twice = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    face = np.full(len(y_mm) * len(x_mm), _NOWHERE, np.int64)
    highest = np.full(face.shape, -np.inf)
    for hit, of in _hits(mesh.corners, twice, x_mm, y_mm):
        row, column = np.divmod(hit, len(x_mm))
        shares = _shares(mesh.corners[of], twice[of], x_mm[column], y_mm[row])
        z = (shares * mesh.corners[of][..., 2]).sum(axis=1)
        order = np.argsort(z, kind="stable")
        higher = order[z[order] > highest[hit[order]]]
        # Of several writes to one place the last counts: the highest.
        highest[hit[higher]], face[hit[higher]] = z[higher], of[higher]
    seen = np.flatnonzero(face != _NOWHERE)
    heights = np.zeros(face.shape)
    for part in np.array_split(seen, len(seen) // _HITS_AT_ONCE + 1):
        row, column = np.divmod(part, len(x_mm))
        of = face[part]
        shares = _shares(mesh.corners[of], twice[of], x_mm[column], y_mm[row])
        heights[part] = _cubic(mesh.corners[of], mesh.normals[of], shares)
    backs = float((twice[face[seen]] < 0).mean()) if len(seen) else 0.0
    shape = len(y_mm), len(x_mm)
    return Sampled(heights.reshape(shape), (face != _NOWHERE).reshape(shape), backs)


def _hits(
    corners: Triangles, twice: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield flat indices of points of the grid under triangles, and which triangles, in pieces.

    Row by row: a line of the grid crosses a triangle between two of its edges.
    """
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    there = np.abs(twice) > _FLAT * (high - low).max(axis=1) ** 2
    step_x, step_y = x[1] - x[0], y[1] - y[0]
    touch = _TOUCH * (high[:, 1] - low[:, 1])
    first = np.clip(np.ceil((low[:, 1] - touch - y[0]) / step_y), 0, len(y)).astype(np.int64)
    last = np.clip(np.floor((high[:, 1] + touch - y[0]) / step_y) + 1, 0, len(y)).astype(np.int64)
    rows = np.where(there, np.maximum(last - first, 0), 0)
    which = np.flatnonzero(rows)
    for some in np.split(
        which, np.flatnonzero(np.diff(np.cumsum(rows[which]) // _HITS_AT_ONCE)) + 1
    ):
        face = np.repeat(some, rows[some])
        row = first[face] + _counted(rows[some])
        line = y[row]
        left, right = np.full(len(face), np.inf), np.full(len(face), -np.inf)
        for i, j in ((0, 1), (1, 2), (2, 0)):
            start, end = corners[face, i], corners[face, j]
            rise = end[:, 1] - start[:, 1]
            share = np.divide(
                line - start[:, 1], rise, out=np.full(len(face), np.nan), where=rise != 0
            )
            slack = np.divide(touch[face], np.abs(rise), out=np.zeros(len(face)), where=rise != 0)
            crosses = (share >= -slack) & (share <= 1 + slack)
            at = start[:, 0] + np.clip(share, 0, 1) * (end[:, 0] - start[:, 0])
            left = np.where(crosses, np.fmin(left, at), left)
            right = np.where(crosses, np.fmax(right, at), right)
        meets = right >= left
        face, row, left, right = face[meets], row[meets], left[meets], right[meets]
        near = _TOUCH * (high[face, 0] - low[face, 0])
        begin = np.clip(np.ceil((left - near - x[0]) / step_x), 0, len(x)).astype(np.int64)
        stop = np.clip(np.floor((right + near - x[0]) / step_x) + 1, 0, len(x)).astype(np.int64)
        count = np.maximum(stop - begin, 0)
        for piece in np.split(
            np.arange(len(face)), np.flatnonzero(np.diff(np.cumsum(count) // _HITS_AT_ONCE)) + 1
        ):
            of = np.repeat(piece, count[piece])
            yield row[of] * len(x) + begin[of] + _counted(count[piece]), face[of]


def _counted(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return 0, 1, 2 ... for each of some counts, one after another."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _shares(
    corners: Triangles, twice: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return barycentric coordinates (n, 3) of points, within their triangles."""
    shares = np.empty((len(x), 3))
    for k in range(3):
        p, q = corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]
        shares[:, k] = (p[:, 0] - x) * (q[:, 1] - y) - (p[:, 1] - y) * (q[:, 0] - x)
    shares = np.clip(shares / twice[:, None], 0, 1)
    within: NDArray[np.float64] = shares / shares.sum(axis=1, keepdims=True)
    return within


def _cubic(
    corners: Triangles, normals: Triangles, shares: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return heights (n,) of the cubic through three corners with their slopes.

    Its Bezier points on the edges follow from the slopes, the middle one so that a parabola stays
    one: A. Vlachos et al., Curved PN triangles, ACM I3D 2001, over the plane.
    """
    up = np.where(np.abs(normals[..., 2]) > 1e-300, normals[..., 2], 1e-300)
    slopes = np.clip(-normals[..., :2] / up[..., None], -_STEEPEST, _STEEPEST)
    z = corners[..., 2]
    heights, edges = np.zeros(len(z)), np.zeros(len(z))
    for i in range(3):
        heights += shares[:, i] ** 3 * z[:, i]
        for j in ((i + 1) % 3, (i + 2) % 3):
            course = corners[:, j, :2] - corners[:, i, :2]
            third = z[:, i] + (slopes[:, i] * course).sum(axis=1) / 3
            heights += 3 * shares[:, i] ** 2 * shares[:, j] * third
            edges += third
    middle: Any = edges / 4 - z.sum(axis=1) / 6
    found: NDArray[np.float64] = heights + 6 * shares.prod(axis=1) * middle
    return found
