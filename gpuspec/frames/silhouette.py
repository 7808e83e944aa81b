"""The part's outline, where the light ever comes, against the one that it should have.

The part is where the light passes over the sequence: its grey levels come and go. A place of the
nominal part is missing if it never gets bright, so that a defect at the edge, bright in every
frame, is no missing piece; a place beside it is extra if the light passes there, so that a mount,
bright or dark in every frame, is no burr.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # whose modules are imported when they are used
from numpy.typing import NDArray

from gpuspec.arrays import Image, Mask
from gpuspec.detection.score import Score, score
from gpuspec.errors import FrameError
from gpuspec.frames.region import largest, lit_region
from gpuspec.part.edges import Edges, straight, zones
from gpuspec.shown import array
from gpuspec.station.station import Station
from gpuspec.words import plural

TOLERANCE_PX = 1.5
"""Depth up to which an outline may differ: pixels at an edge see part of it."""
_POINTS = 2000  # of the outline by which the nominal part is laid on it
_TURNS_DEG = -6.0, 0.0, 6.0  # at which the search for it begins
_ALIKE = 0.8  # of both, the least share in which they overlap
KINDS = {-1: "missing", 1: "extra"}


@dataclass(frozen=True)
class Find:
    """A place where the part's outline differs from the nominal one.

    Attributes
    ----------
    kind : str
        missing or extra.
    x_mm, y_mm : float
        Its centre, from the image's, x to the right and y up.
    area_px : int
    area_mm2 : float
    width_mm, depth_mm : float
        Along the nominal outline, and its greatest distance from it.
    """

    kind: str
    x_mm: float
    y_mm: float
    area_px: int
    area_mm2: float
    width_mm: float
    depth_mm: float


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A part's outline against the nominal one.

    Attributes
    ----------
    outline : ndarray of bool, shape (M, N)
        Where the light passes: the part as it is.
    nominal : ndarray of bool, shape (M, N)
        The part as it should be, where it lies in the image.
    labels : ndarray of int32, shape (M, N)
        0 where they agree, i at the i-th of `finds`.
    finds : tuple of Find
        The largest first.
    tolerance_px : float
        What is not deeper is no find.
    shift_mm : tuple of float
        By which the nominal part was moved, x and y.
    turn_deg : float
        By which it was turned, anticlockwise.
    score : Score or None
        Against known chips and burrs; None: none are known.
    """

    outline: Mask
    nominal: Mask
    labels: NDArray[np.int32]
    finds: tuple[Find, ...]
    tolerance_px: float
    shift_mm: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0
    score: Score | None = None

    def __repr__(self) -> str:
        told = "; ".join(filter(None, (self.told, self.scored)))
        return f"Silhouette({told}; labels {array(self.labels)})"

    @property
    def told(self) -> str:
        """What was found, in a few words."""
        kinds = [one.kind for one in self.finds]
        said = [f"{kinds.count(kind)} {kind}" for kind in KINDS.values() if kind in kinds]
        return ", ".join(said) or "no difference"

    @property
    def scored(self) -> str:
        """How good that is, in a few words; empty where no chip or burr is known."""
        if self.score is None:
            return ""
        known = plural(self.score.defects, "edge defect")
        return f"{self.score.defects_hit} of {known} hit, {self.score.false_blobs} false"

    def as_dict(self) -> dict[str, Any]:
        """Return what JSON holds of it."""
        return {
            "tolerance_px": self.tolerance_px,
            "shift_mm": list(self.shift_mm),
            "turn_deg": self.turn_deg,
            "missing": sum(one.kind == "missing" for one in self.finds),
            "missing_mm2": sum(one.area_mm2 for one in self.finds if one.kind == "missing"),
            "extra": sum(one.kind == "extra" for one in self.finds),
            "extra_mm2": sum(one.area_mm2 for one in self.finds if one.kind == "extra"),
            "score": self.score and {
                "defects": self.score.defects,
                "defects_hit": self.score.defects_hit,
                "finds": self.score.blobs,
                "false_finds": self.score.false_blobs,
            },
        }  # fmt: skip


def silhouette(
    brightest: Image,
    darkest: Image,
    nominal: Mask,
    *,
    sampling_mm: float,
    laid: bool = True,
    tolerance_px: float = TOLERANCE_PX,
    known: NDArray[np.int32] | None = None,
) -> Silhouette:
    """Compare a part's outline with the nominal one.

    Parameters
    ----------
    brightest, darkest : ndarray of float32, shape (M, N)
        Highest and lowest grey level of each pixel over the sequence, DN.
    nominal : ndarray of bool, shape (M, N)
        The part as it should be.
    sampling_mm : float
        Distance of two pixels on the part.
    laid : bool
        Whether it lies in the image where the part does; else it is shifted and turned onto it.
    tolerance_px : float
        Depth of what is no find.
    known : ndarray of int32, shape (M, N), optional
        Zones of known edge defects, laid like `nominal`: 0 elsewhere, i in the i-th.

    Returns
    -------
    Silhouette

    Raises
    ------
    FrameError
        If the light changes nowhere, the part or the nominal one reaches the image's edge, or they
        are unlike.

    Examples
    --------
    >>> from gpuspec.frames.silhouette import silhouette
    >>> nominal = np.zeros((60, 90), bool)
    >>> nominal[10:50, 15:75] = True
    >>> bright = np.where(nominal, 200, 3).astype(np.float32)
    >>> bright[10:14, 30:38] = 3  # a chip
    >>> found = silhouette(bright, np.zeros_like(bright), nominal, sampling_mm=0.1)
    >>> found.finds[0].kind, found.finds[0].area_px, found.finds[0].depth_mm
    ('missing', 32, 0.4)
    """
    if not 0 <= tolerance_px < np.inf:
        raise FrameError(f"the silhouette's tolerance is {tolerance_px:g}; it is 0 px or more.")
    seed = lit_region(brightest - darkest, 0.0)
    level = float(np.median((brightest - darkest)[seed])) / 2
    outline = largest(brightest - darkest > level, seed)
    _check_inside(outline, "the part, as the light shows it,")
    down, right, turn = 0.0, 0.0, 0.0
    if not laid:
        pose = _fitted(outline, nominal)
        nominal = pose.moved(nominal)
        known = None if known is None else pose.moved(known)
        down, right = (pose.target - pose.middle).tolist()
        turn = float(np.rad2deg(pose.turn_rad))
    _check_inside(nominal, "the nominal part")
    _check_alike(outline, nominal, sampling_mm)
    dark = brightest < (np.median(brightest[outline]) + np.median(darkest[outline])) / 2
    kinds = np.where(nominal & ~outline & dark, np.int8(-1), (outline & ~nominal).astype(np.int8))
    labels, finds = _finds(kinds, nominal, tolerance_px, sampling_mm)
    scored = None
    if known is not None:
        scored = score(labels, known, np.ones(known.shape, np.bool_), int(known.max(initial=0)))
    shift = right * sampling_mm, -down * sampling_mm
    return Silhouette(outline, nominal, labels, finds, tolerance_px, shift, turn, scored)


def silhouette_of(
    station: Station,
    brightest: Image,
    darkest: Image,
    *,
    mask: Mask | None = None,
    laid: bool = True,
    tolerance_px: float = TOLERANCE_PX,
) -> Silhouette:
    """Compare a part's outline with a station's part; scored if it has edge defects.

    Parameters
    ----------
    station : Station
        Of images of that shape.
    brightest, darkest, laid, tolerance_px
        As of :func:`silhouette`.
    mask : ndarray of bool, shape (M, N), optional
        The nominal part; None: the rectangle that the station says.

    Raises
    ------
    FrameError
        As of :func:`silhouette`.
    """
    rows, columns = station.shape
    if mask is None:
        mask = straight(station, np.arange(columns)[None], np.arange(rows)[:, None])
    known = zones(Edges.of(station), station) if station.edges else None
    return silhouette(
        brightest, darkest, mask, sampling_mm=station.camera.sampling_mm, laid=laid,
        tolerance_px=tolerance_px, known=known,
    )  # fmt: skip


def _check_inside(mask: Mask, what: str) -> None:
    """Refuse a part of which the image does not show every edge."""
    for side, edge in (
        ("left", mask[:, :2]), ("right", mask[:, -2:]), ("top", mask[:2]), ("bottom", mask[-2:])
    ):  # fmt: skip
        if edge.any():
            raise FrameError(
                f"{what} reaches the {side} edge of the image, where its outline cannot be seen; "
                f"show more around it (camera.columns, camera.rows)."
            )
    if not mask.any():
        raise FrameError(f"{what} has no pixel in the image; check its size and place.")


def _check_alike(outline: Mask, nominal: Mask, sampling_mm: float) -> None:
    both = np.count_nonzero(outline & nominal) / np.count_nonzero(outline | nominal)
    if both < _ALIKE:
        sizes = " and ".join(
            f"{what} covers {np.count_nonzero(mask) * sampling_mm**2:.4g} mm²"
            for what, mask in (("the part", outline), ("the nominal one", nominal))
        )
        raise FrameError(
            f"the part is not like the nominal one: {sizes}, and {both:.0%} of both is common; "
            f"check camera.sampling_mm and the nominal part's size."
        )


def _finds(
    kinds: NDArray[np.int8], nominal: Mask, tolerance_px: float, sampling_mm: float
) -> tuple[NDArray[np.int32], tuple[Find, ...]]:
    """Return what differs by more than the tolerance, with the shallow pixels around it."""
    labels = np.zeros(nominal.shape, np.int32)
    found: list[tuple[Find, Any]] = []
    for kind, name in KINDS.items():
        differs = kinds == kind
        if not differs.any():
            continue
        # Distance from the nominal outline, and the nearest pixel on its other side.
        depth, nearest = scipy.ndimage.distance_transform_edt(
            nominal if kind < 0 else ~nominal, return_indices=True
        )
        deep = differs & (depth > tolerance_px)
        near = scipy.ndimage.binary_dilation(
            deep, np.ones((3, 3)), iterations=int(tolerance_px) + 1, mask=differs
        )
        groups, count = scipy.ndimage.label(near, np.ones((3, 3)))
        for number in range(1, count + 1):
            row, column = np.nonzero(groups == number)
            at = np.argmax(depth[row, column])
            across = np.array([row[at], column[at]]) - nearest[:, row[at], column[at]]
            along = np.array([-across[1], across[0]]) / np.hypot(*across)
            rows, columns = nominal.shape
            one = Find(
                name,
                float(column.mean() + 0.5 - columns / 2) * sampling_mm,
                float(rows / 2 - row.mean() - 0.5) * sampling_mm,
                len(row),
                len(row) * sampling_mm**2,
                float(np.ptp(row * along[0] + column * along[1]) + 1) * sampling_mm,
                float(depth[row, column].max()) * sampling_mm,
            )
            found.append((one, (row, column)))
    found.sort(key=lambda pair: -pair[0].area_px)
    for number, (_, pixels) in enumerate(found, 1):
        labels[pixels] = number
    return labels, tuple(one for one, _ in found)


@dataclass(frozen=True)
class _Pose:
    """How the nominal part is turned about its middle, and where that then lies.

    Attributes
    ----------
    turn_rad : float
        Anticlockwise, as the image is seen.
    middle, target : ndarray, shape (2,)
        Row and column, before and after.
    """

    turn_rad: float
    middle: NDArray[np.float64]
    target: NDArray[np.float64]

    def moved(self, labels: NDArray[Any]) -> NDArray[Any]:
        """Return a mask or labels so laid."""
        cosine, sine = np.cos(self.turn_rad), np.sin(self.turn_rad)
        back = np.array([[cosine, sine], [-sine, cosine]])
        there: NDArray[Any] = scipy.ndimage.affine_transform(
            labels.astype(np.int32), back, self.middle - back @ self.target, order=0
        )
        return there.astype(labels.dtype)


def _fitted(outline: Mask, nominal: Mask) -> _Pose:
    """Return how the nominal part is laid on an outline.

    The outline's pixels are brought onto the nominal one by least squares of their distances, of
    which chips and burrs, few and far, count little.
    """
    if not nominal.any():
        raise FrameError("the nominal part has no pixel; check its size.")
    inside, outside = (scipy.ndimage.distance_transform_edt(one) for one in (nominal, ~nominal))
    distance = (inside - outside).astype(np.float32)
    edge = np.argwhere(outline & ~scipy.ndimage.binary_erosion(outline)).astype(np.float64)
    edge = edge[:: max(len(edge) // _POINTS, 1)]
    middle, seen = (np.argwhere(one).mean(axis=0) for one in (nominal, outline))

    def misses(pose: NDArray[np.float64]) -> NDArray[np.float64]:
        away = edge - seen - pose[:2]
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        row = away[:, 0] * cosine + away[:, 1] * sine + middle[0]
        column = away[:, 1] * cosine - away[:, 0] * sine + middle[1]
        at: NDArray[np.float64] = scipy.ndimage.map_coordinates(
            distance, [row, column], order=1, mode="nearest"
        )
        return at - 1.0  # of a pixel on the edge

    size = max(float(np.ptp(edge, axis=0).max()) / 2, 1.0)
    found = [
        scipy.optimize.least_squares(
            misses, [0.0, 0.0, turn], loss="soft_l1", x_scale=[1, 1, 1 / size]
        )
        for turn in np.deg2rad(_TURNS_DEG)
    ]
    best = min(found, key=lambda one: float(one.cost)).x
    return _Pose(float(best[2]), middle, seen + best[:2])
