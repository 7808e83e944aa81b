"""Light that is not seen, or is not radiance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image, Lost, Mask
from gpuspec.light.float64 import ray_paths
from gpuspec.light.light_map import LightMap
from gpuspec.part.grooves import Grooves
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.simulation.cautions.detection import EVEN
from gpuspec.simulation.cautions.station import listed, percent
from gpuspec.simulation.view import view_mm
from gpuspec.station.station import Station

LOST_SHARE = 0.01
"""Share of the part without light from which on it is said."""
_DOWN, _PAST, _OPENING = Lost.DOWN, Lost.END, Lost.OPENING
_TWICE = {
    Lost.HIDDEN: "another piece of it is before it, seen from the camera",
    Lost.AGAIN: "its rays meet the part again, and a second reflection is not followed",
}
_SOME = 251  # pixels from one that is looked at first to the next
_GRID = 33  # points along each side of the part, for rays to the tunnel's end


def of_pattern(light_map: LightMap, lit: Mask, aspect: Image) -> list[str]:
    """Say where a user's pattern cannot show anything.

    Parameters
    ----------
    light_map : LightMap
        Lit by the pattern.
    lit : ndarray of bool, shape (M, N)
        Pixels that see the light.
    aspect : ndarray of float32, shape (M, N)
        DN.
    """
    station, pattern = light_map.station, light_map.pattern
    assert pattern is not None
    images, full = station.sequence.images, station.sensor.full_scale_dn
    if not lit.any():
        return []
    said = []
    if images > 1 and not station.sensor.noise:
        # The first image, as a mean: the program of means is built already.
        alone = station.sequence.model_copy(update={"images": 1})
        first = light_map.mean(station.model_copy(update={"sequence": alone}))

        def same(other: Image) -> bool:
            # Some pixels mostly tell that it is not.
            for some in (slice(None, None, _SOME), slice(None)):
                apart = np.abs(other.flat[some] - first.flat[some])
                if float((apart * lit.flat[some]).max(initial=0.0)) >= 1e-3 * full:
                    return False
            return True

        # The mean of all is there, and mostly tells.
        still = station.sequence.fusion != "mean" or same(aspect)
        others = {1, images // 2, images - 1} - {0}
        if still and all(same(light_map.image(k)) for k in others):
            moved = "k" if pattern.kind == "picture" else "shift"
            said.append(
                f"all {images} images are the same: {pattern.file} does not change with its "
                f"`{moved}`, or comes round to the same within each step."
            )
    levels = aspect[lit]
    if float(levels.max()) - float(levels.min()) < EVEN * full:
        said.append(
            f"the aspect image is even, {levels.mean():.1f} DN everywhere: under {pattern.file} "
            f"nothing stands out."
        )
    return said


def of_light(station: Station, lost: NDArray[np.uint8], truth: Truth | None = None) -> list[str]:
    """Say how much of the part sees no light, and why.

    Parameters
    ----------
    station : Station
    lost : ndarray of uint8, shape (M, N)
        Index into ``arrays.LOST``.
    truth : Truth, optional
        To say how many defects are wholly dark.
    """
    # By bincount, which makes whole numbers of bytes, it takes ten times as long.
    codes = np.array([np.count_nonzero(lost == code) for code in range(int(lost.max()) + 1)])
    return of_losses(station, np.pad(codes, (0, len(Lost) - len(codes))), lost, truth)


def of_losses(
    station: Station,
    codes: NDArray[Any],
    lost: NDArray[np.uint8] | None = None,
    truth: Truth | None = None,
) -> list[str]:
    """Say the same from how many pixels are lost for each reason.

    Parameters
    ----------
    station : Station
    codes : ndarray, shape (reasons,)
        Number of pixels by index into ``arrays.LOST``; it may be an estimate.
    lost : ndarray of uint8, shape (M, N), optional
        Those of each pixel.
    truth : Truth, optional
        With `lost`, to say how many defects are wholly dark.
    """
    part = codes.sum() - codes[BESIDE]
    if not part:
        return []
    counts = {reason: codes[reason] for reason in (_PAST, _DOWN, _OPENING, *_TWICE)}
    dark = sum(counts.values())
    said = []
    for reason, count in counts.items():
        if count < LOST_SHARE * part:
            continue
        seen = "no pixel of the part sees any light" if count == part else (
            f"{percent(count / part)} of the part sees no light"
        )  # fmt: skip
        said.append(f"{seen}: {_why_lost(station, reason)}")
    if said and truth is not None and lost is not None and dark < part:
        hidden = _hidden(truth, lost)
        if hidden:
            said[-1] += f" {hidden} of {len(truth.defects)} defects lie in the dark."
    if dark == part and not said:
        said.append("no pixel of the part sees any light; lost.png shows why.")
    return said


def _why_lost(station: Station, reason: Lost) -> str:
    part, tunnel = station.part, station.tunnel
    if reason == _OPENING:
        size = tunnel.opening_length_mm, tunnel.opening_width_mm
        view = view_mm(station)
        way = (
            f"make it smaller, the camera's own view needs {view[0]:.3g} x {view[1]:.3g} mm"
            if size[0] > view[0] and size[1] > view[1]
            else "a tunnel whose top is nearer to the camera needs a smaller one"
        )
        return f"it reflects the camera opening of {size[0]:g} x {size[1]:g} mm; {way}."
    shape = ["part.mesh"] * (part.mesh is not None) + station.poses
    round_ = ("crown_radius_x_mm", "crown_radius_y_mm", "sphere_radius_mm")
    crown = [f"part.{key}" for key in round_ if getattr(part, key)] + shape
    laid = [f"part.{key}" for key in ("waviness", "orange_peel", "relief") if getattr(part, key)]
    if station.defects or station.populations or not laid:
        laid.append("the defects' depth_um")
    if reason in _TWICE:
        return f"{_TWICE[reason]}; check {listed([*crown, *laid])}."
    if reason == _DOWN:
        return (
            f"it is tilted by more than 45 degrees there and reflects the camera's rays down; "
            f"check {listed([*crown, *laid])}."
        )
    needed = _length_needed_mm(station)
    said = f"its rays pass the tunnel's end, tunnel.length_mm = {tunnel.length_mm:g}; "
    if needed is None:
        way = f"tilt them less with {listed(crown)}" if crown else "look at less of the part"
        return said + f"no length catches them all, so {way}."
    if needed <= tunnel.length_mm:
        return said + f"what tilts them so far is the relief: check {listed(laid)}."
    return said + f"{needed:g} or more catches those of the flawless part."


def _length_needed_mm(station: Station) -> float | None:
    """Return the tunnel's length that every ray of the flawless part meets; None: none does."""
    part, p, (rows, columns) = station.part, station.camera.sampling_mm, station.shape
    bare = station.model_copy(
        update={
            "part": part.model_copy(update=dict.fromkeys(("relief", "waviness", "orange_peel"))),
            "tunnel": station.tunnel.model_copy(
                update={"length_mm": 1e9, "opening_length_mm": 0.0}
            ),
        }
    )
    half = columns * p / 2, rows * p / 2
    if not station.posed:
        half = min(part.length_mm / 2, half[0]), min(part.width_mm / 2, half[1])
    x, y = (np.linspace(-h, h, _GRID) * (1 - 1e-9) for h in half)
    paths = ray_paths(bare, Relief((), Grooves.of(()), ()), x[None, :], y[:, None])
    if (paths.lost == _DOWN).any():
        return None
    seen = np.abs(paths.light[..., 0][paths.lost == 0])
    needed = _three_digits_up(2 * float(seen.max(initial=0.0)) * (1 + 1e-6))
    return needed if needed <= 1e5 else None  # the most that tunnel.length_mm takes


def _three_digits_up(value: float) -> float:
    if value <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.ceil(value / step) * step:.6g}")


def _hidden(truth: Truth, lost: NDArray[np.uint8]) -> int:
    """Return how many defects have pixels on the part and all of them dark."""
    size = len(truth.defects) + 1
    there = np.bincount(truth.labels[lost != BESIDE], minlength=size)[1:]
    lit = np.bincount(truth.labels[lost == 0], minlength=size)[1:]
    return int(np.count_nonzero((there > 0) & (lit == 0)))
