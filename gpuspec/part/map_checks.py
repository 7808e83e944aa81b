"""What is wrong with a measured map, and what its owner should know of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpuspec.errors import TopographyError
from gpuspec.station.station import Station
from gpuspec.topographies.file import SIDE_MIN, Measured
from gpuspec.topographies.form import Heights, Mask, filled, standing_out
from gpuspec.units import MICRO

_SLOPE_MAX = 1.0  # rms; beyond, heights and pitch are not of the same unit
_ROUNDING_SLOPE_MAX = 1e-5  # rad, of float32 heights over one pitch
_FEW = 0.05  # of the points may be outliers
_STEEP = 0.01  # of the map may be steeper than 45 degrees
_SPIKES = 5  # points that are named as spikes; more are the surface's own
_COARSE = 8  # pixels between two points, from which on it is said


@dataclass(frozen=True)
class Laid:
    """A measured map, where a station lays it.

    Attributes
    ----------
    measured : Measured
        Heights and pitch, as its file has them.
    key : str
        Of the map in the station, e.g. ``part.relief``.
    says : str
        File and key, to begin an error with.
    corner : tuple of float
        x and y of its first point on the part, mm.
    """

    measured: Measured
    key: str
    says: str
    corner: tuple[float, float]


def check_pitch(station: Station, laid: Laid) -> None:
    """Refuse a map of which the part sees next to nothing: its unit is another.

    Parameters
    ----------
    station : Station
    laid : Laid

    Raises
    ------
    TopographyError
        If the part covers fewer than ``SIDE_MIN`` points of the map along a side.
    """
    measured = laid.measured
    part = station.part.length_mm, station.part.width_mm
    if any(side < SIDE_MIN * p for side, p in zip(part, measured.pitch_mm, strict=True)):
        size, pitch = (
            " x ".join(f"{v:.4g}" for v in pair) for pair in (measured.size_mm, measured.pitch_mm)
        )
        raise TopographyError(
            f"{laid.says} has a pitch of {pitch} mm and is {size} mm large: the part of "
            f"{part[0]:.4g} x {part[1]:.4g} mm covers fewer than {SIDE_MIN} of its points; check "
            f"the unit of the map's pitch (m for mm?), or part.length_mm and part.width_mm."
        )


def check_relief(relief: Heights, laid: Laid) -> None:
    """Refuse relief that is no mirror's, or that single precision cannot hold.

    Parameters
    ----------
    relief : ndarray of float64, shape (ny, nx)
        Without its form, mm.
    laid : Laid

    Raises
    ------
    TopographyError
        If it is too steep, or too high for its pitch.
    """
    pitch = laid.measured.pitch_mm
    slope = _rms_slope(relief, pitch)
    highest = float(np.abs(relief).max())
    if not slope <= _SLOPE_MAX:
        why = f"has an rms slope of {slope:.3g}, more than {_SLOPE_MAX:g}: no mirror"
        way = "check the units of its heights and pitch, or smooth it (smoothing_um)"
    elif highest * np.finfo(np.float32).eps > _ROUNDING_SLOPE_MAX * min(pitch):
        why = (
            f"reaches {highest:.3g} mm from zero, too far for slopes in single precision at a "
            f"pitch of {min(pitch):.3g} mm"
        )
        way = 'remove more form (form_removed = "curvature")'
    else:
        return
    raise TopographyError(f"{laid.says} {why}; {_outliers(laid) or way}.")


def _outliers(laid: Laid) -> str | None:
    """Name the points without which a map is a mirror, and how to leave them out; None: none.

    They stand out by more than a pitch: steeper than 45 degrees, where no light of a mirror comes
    back to an instrument above it.
    """
    measured, key = laid.measured, laid.key
    steepest = min(measured.pitch_mm)
    away = standing_out(measured.heights_mm, measured.defined)
    out = away > steepest
    count = np.count_nonzero(out)
    if not 0 < count < _FEW * out.size:
        return None
    kept = filled(measured.heights_mm, measured.defined & ~out)
    if _rms_slope(kept, measured.pitch_mm) > _SLOPE_MAX:
        return None
    stand = "one point stands" if count == 1 else f"{count:,} points stand"
    furthest = "," if count == 1 else ", the furthest"
    limit = float(f"{steepest / MICRO:.3g}")
    return (
        f"{stand} far out of the surroundings{furthest} by {away.max() / MICRO:.4g} um "
        f"{_place(away, laid)}; {key}.outlier_um = {limit:g} leaves out what stands "
        f"out by more than a pitch"
    )


def without_outliers(laid: Laid, limit_um: float) -> tuple[Mask, list[str]]:
    """Return the points that are kept, and what is said of the others.

    Parameters
    ----------
    laid : Laid
    limit_um : float
        How far a point may stand out of its surroundings, µm.

    Returns
    -------
    defined : ndarray of bool, shape (ny, nx)
        Points that are kept.
    said : list of str

    Raises
    ------
    TopographyError
        If fewer than half of the points are left.
    """
    measured, key = laid.measured, laid.key
    away = standing_out(measured.heights_mm, measured.defined)
    out = away > limit_um * MICRO
    count = np.count_nonzero(out)
    defined = measured.defined & ~out
    if np.count_nonzero(defined) < 0.5 * defined.size:
        raise TopographyError(
            f"{laid.says}: outlier_um = {limit_um:g} leaves out {_percent(out.mean())} of its "
            f"points; give a larger one."
        )
    if not count:
        return defined, []
    furthest = f"{away.max() / MICRO:.4g} um {_place(away, laid)}"
    beyond = f"more than outlier_um = {limit_um:g} um out of"
    if count == 1:
        told = f"1 of the map's points stands {beyond} its surroundings and was left out: by"
    else:
        told = (
            f"{count:,} of the map's points stand {beyond} their surroundings and were left out; "
            f"the furthest by"
        )
    return defined, [f"{key}: {told} {furthest}."]


def remarks(station: Station, laid: Laid) -> list[str]:
    """Say what of a map is missing, and what of it the part and the camera do not take.

    Parameters
    ----------
    station : Station
    laid : Laid

    Returns
    -------
    list of str
    """
    measured, key, corner = laid.measured, laid.key, laid.corner
    said = []
    pitch, size = measured.pitch_mm, measured.size_mm
    missing = ~measured.defined
    if missing.any():
        from scipy import ndimage  # slow to import

        holes, _ = ndimage.label(missing)
        ys, xs = ndimage.find_objects(holes)[np.bincount(holes[missing]).argmax() - 1]
        x = corner[0] + (xs.start + xs.stop - 1) / 2 * pitch[0]
        y = corner[1] + (ys.start + ys.stop - 1) / 2 * pitch[1]
        wide, high = (xs.stop - xs.start) * pitch[0], (ys.stop - ys.start) * pitch[1]
        said.append(
            f"{key}: {_percent(missing.mean())} of the map's points "
            f"({np.count_nonzero(missing):,}) are missing; they were filled smoothly from "
            f"those around them and count as flawless (the largest "
            f"hole, {wide:.3g} x {high:.3g} mm, at x = {x:.4g}, y = {y:.4g} mm)."
        )
    part = station.part.length_mm, station.part.width_mm
    taken = 1.0
    for start, p, n, side in zip(corner, pitch, missing.shape[::-1], part, strict=True):
        low, high = max(start - p / 2, -side / 2), min(start + (n - 0.5) * p, side / 2)
        if high - low < (n - 1) * p:  # a pitch is left for rounding
            taken *= max(high - low, 0) / (n * p)
    if taken < 1:
        said.append(
            f"{key}: {_percent(1 - taken)} of its map, {size[0]:.4g} x {size[1]:.4g} mm, lie "
            f"beyond the part of {part[0]:.4g} x {part[1]:.4g} mm and are left out"
            + (
                "; without part.length_mm and part.width_mm the part takes the map's size."
                if key == "part.relief"
                else "."
            )
        )
    sampling = station.camera.sampling_mm
    if max(pitch) > _COARSE * sampling:
        said.append(
            f"{key}: the map's points lie {max(pitch) / sampling:.3g} pixels apart, "
            f"{max(pitch):.3g} mm: no smaller defect can be in it; check the unit of its pitch."
        )
    if min(size) < sampling:
        said.append(
            f"{key}: the whole map, {size[0]:.3g} x {size[1]:.3g} mm, is smaller than a pixel of "
            f"camera.sampling_mm = {sampling:g}; check the unit of its pitch."
        )
    return said


def steepness(relief: Heights, defined: Mask, laid: Laid) -> list[str]:
    """Say what is steeper than 45 degrees, which no mirror is: a few points, or much of the map.

    Parameters
    ----------
    relief : ndarray of float64, shape (ny, nx)
        Without its form and before any smoothing, mm.
    defined : ndarray of bool, shape (ny, nx)
        Points that were measured and are kept.
    laid : Laid

    Returns
    -------
    list of str
    """
    measured, key = laid.measured, laid.key
    along, down = (
        np.abs(np.diff(relief, axis=axis)) / p
        for axis, p in zip((1, 0), measured.pitch_mm, strict=True)
    )
    if max((along > 1).mean(), (down > 1).mean()) > _STEEP:
        return [
            f"{key}: more than {_percent(_STEEP)} of its map is steeper than 45 degrees, which no "
            f"mirror is; the heights may be in another unit: check height_unit."
        ]
    least = np.full(relief.shape, np.inf)
    for slopes, axis in ((along, 1), (down, 0)):
        for before, after in ((0, 1), (1, 0)):
            pad = [(0, 0), (0, 0)]
            pad[axis] = before, after
            least = np.minimum(least, np.pad(slopes, pad, constant_values=np.inf))
    spikes = (least > 1) & defined
    count = np.count_nonzero(spikes)
    if not 0 < count <= _SPIKES:
        return []
    away = np.where(spikes, standing_out(relief, defined), 0.0)
    stand = "one point stands" if count == 1 else f"{count} points stand"
    furthest = "" if count == 1 else "; the furthest"
    return [
        f"{key}: {stand} out, steeper than 45 degrees to all neighbours{furthest}: by "
        f"{away.max() / MICRO:.4g} um {_place(away, laid)}. {key}.outlier_um = "
        f"{min(measured.pitch_mm) / MICRO:.3g} leaves out what stands out by more than a pitch."
    ]


def _rms_slope(heights: Heights, pitch: tuple[float, float]) -> float:
    slopes = [np.diff(heights, axis=1) / pitch[0], np.diff(heights, axis=0) / pitch[1]]
    return float(np.sqrt(sum(np.mean(s**2) for s in slopes)))


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _place(values: Heights, laid: Laid) -> str:
    """Say where the greatest value is: in the file, and on the part."""
    row, column = np.unravel_index(int(values.argmax()), values.shape)
    (x, y), pitch = laid.corner, laid.measured.pitch_mm
    return (
        f"in line {len(values) - row}, column {column + 1} of the map, at "
        f"x = {x + column * pitch[0]:.4g} mm, y = {y + row * pitch[1]:.4g} mm"
    )
