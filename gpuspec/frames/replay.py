"""Unsaturated frames taken again at other exposures: which one shows scratches best.

A saturated camera is the station's principle, and saturation can be had afterwards: min(full, g y),
frame by frame, then the mean. What a scratch's contrast is and how much the flawless surface varies
are then a curve over g.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gpuspec.arrays import Image, Mask
from gpuspec.detection.background import robust_sigma, smoothed
from gpuspec.errors import FrameError
from gpuspec.frames.region import lit_region

FINE_PX, WIDE_PX = 1.5, 25.0
"""Gaussians between which contrast and noise are measured: grain, and the slow background."""
SCRATCHED = 0.003
"""Share of the region that is taken for scratches: where the light's modulation is least."""
_APART = 6  # pixels about these that are not called flawless


@dataclass(frozen=True)
class Replay:
    """What other exposures would have shown.

    Attributes
    ----------
    exposure : ndarray, shape (n,)
        Over that of the frames.
    saturated : ndarray, shape (n,)
        Share of the samples within the region that are saturated.
    contrast_dn : ndarray, shape (n,)
        Mean of the scratches over the flawless surface, both above the slow background.
    noise_dn : ndarray, shape (n,)
        Robust standard deviation of the flawless surface.
    scratch_px : int
        Pixels taken for scratches.
    """

    exposure: NDArray[np.float64]
    saturated: NDArray[np.float64]
    contrast_dn: NDArray[np.float64]
    noise_dn: NDArray[np.float64]
    scratch_px: int

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Contrast over noise, shape (n,)."""
        return self.contrast_dn / self.noise_dn

    @property
    def best(self) -> float:
        """Exposure with the greatest ratio."""
        return float(self.exposure[int(np.argmax(self.ratio))])


def replay(
    frames: Iterable[NDArray[Any]],
    exposures: Sequence[float],
    full_scale_dn: float,
    region: Mask | None = None,
) -> Replay:
    """Saturate frames afterwards, and measure what each exposure shows.

    Scratches are the pixels whose modulation over mean, less its slow background, is lowest: that
    asks for no threshold and is the same for every exposure.

    Parameters
    ----------
    frames : iterable of ndarray, shape (M, N)
        Whole periods of the light; read once.
    exposures : sequence of float
        Over that of the frames.
    full_scale_dn : float
        Grey level of a saturated pixel.
    region : ndarray of bool, shape (M, N), optional
        What is looked at; None: where the light comes, less 25 px.

    Returns
    -------
    Replay

    Raises
    ------
    FrameError
        If there is no frame, an exposure is not above 0, or the light changes nowhere.

    Examples
    --------
    >>> from gpuspec.frames.replay import replay
    >>> x = np.arange(200) + np.zeros((120, 1))
    >>> rng, turns = np.random.default_rng(2), 2 * np.pi * np.arange(12) / 12
    >>> light = np.stack([60 + 58 * np.cos(x / 9 + turn) for turn in turns])
    >>> light[:, 60:62, 80:115] = 60.0  # a scratch has no modulation
    >>> found = replay(np.rint(light + rng.normal(0, 1, light.shape)).astype(np.uint8),
    ...                [1, 4], 255, np.full((120, 200), True))
    >>> bool(abs(found.contrast_dn[0]) < 1), bool(found.contrast_dn[1] > 20), found.best
    (True, True, 4.0)
    """
    given = np.asarray(exposures, np.float64)
    if given.ndim != 1 or not given.size or not (np.isfinite(given) & (given > 0)).all():
        raise FrameError(f"exposures are numbers above 0, not {exposures}.")
    sums: Image | None = None
    count = 0
    for frame in frames:
        if sums is None:
            sums = np.zeros((len(given), *frame.shape), np.float32)
            over = np.zeros((len(given), *frame.shape), np.uint32)
            low, high, total = frame.copy(), frame.copy(), np.zeros(frame.shape)
        levels = np.arange(int(np.iinfo(frame.dtype).max) + 1)
        for exposure, one, full in zip(given, sums, over, strict=True):
            one += np.minimum(exposure * levels, full_scale_dn).astype(np.float32)[frame]
            full += frame >= full_scale_dn / exposure
        np.minimum(low, frame, out=low)
        np.maximum(high, frame, out=high)
        total += frame
        count += 1
    if sums is None:
        raise FrameError("no frame was given; the camera gave none.")
    swing = high.astype(np.float64) - low
    inside = lit_region(swing, 25.0) if region is None else region
    (box,) = ndimage.find_objects(inside.astype(np.int8))
    inside, swing, total = inside[box], swing[box], total[box]
    loss = _detail((swing / np.maximum(total / count, 1)).astype(np.float32), inside)
    scratched = inside & (loss <= np.quantile(loss[inside], SCRATCHED))
    near = ndimage.binary_dilation(scratched, iterations=_APART)
    flawless = inside & ~near
    contrast, noise = [], []
    for one in sums:
        detail = _detail(one[box] / np.float32(count), inside)
        contrast.append(float(detail[scratched].mean() - np.median(detail[flawless])))
        noise.append(max(robust_sigma(detail[flawless]), 1e-6))
    return Replay(
        given,
        np.array([one[box][inside].mean() / count for one in over]),
        np.array(contrast),
        np.array(noise),
        int(scratched.sum()),
    )


def _detail(image: Image, region: Mask) -> Image:
    """Return what is finer than the slow background and coarser than grain."""
    return smoothed(image, region, FINE_PX) - smoothed(image, region, WIDE_PX)
