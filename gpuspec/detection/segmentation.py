"""From the aspect image to the label image: what is detected, and as which blob.

The flawless surface of the aspect image is even and dark, a defect is bright (Seulin, Merienne,
Gorria): one grey level separates them, and each connected set of detected pixels is a blob. The
paper does not say how its threshold is chosen; the rule of `automatic_threshold` is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gpuspec.arrays import GreyLevels, Mask, check_label_image, check_mask
from gpuspec.detection.connected import connected

__all__ = [
    "Margins",
    "automatic_threshold",
    "check_label_image",
    "check_mask",
    "flawless_level",
    "segment",
    "threshold_margins",
]
SIGMA_PER_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
GRID = 1 / 2040
"""Automatic thresholds are rounded up to whole steps of this share of full scale, 0.125 DN of 255,
so that backends that differ by a float's rounding take the same."""
MARGIN = 0.1
"""Share of one image left for its noise: 7 sigma of the shot noise of 5,000 electrons. Float32 sums
add 2e-4 of it at most (images² · 2⁻²⁴ while one image is above the floor, images < 50)."""
NOISE_SIGMAS = 7.0
"""Standard deviations above the ceiling: no noise of millions of flawless pixels is as high."""
CEILING_FLOOR = 0.005
"""Share of full scale that a threshold is at least above the ceiling: more than rounding, and than
what sub-rays make of a flawless pixel that one footprint does not tell."""
_SAMPLE = 16384
_BRACKET = 8192 - 320, 8192 + 320
"""Ranks of a sample between which the median lies: five standard deviations, √n / 2 each."""
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Ceiling:
    """The highest level that a flawless pixel can have, as a station or a sequence tells it.

    Attributes
    ----------
    level_dn : float
        Without noise, DN.
    noise_dn : float
        Standard deviation of that pixel in the aspect image, DN.
    """

    level_dn: float
    noise_dn: float

    def __repr__(self) -> str:
        return f"Ceiling(level_dn={self.level_dn:.2f}, noise_dn={self.noise_dn:.2f})"

    @property
    def said(self) -> str:
        """It in words."""
        noise = f", noise {self.noise_dn:.2g} DN" if self.noise_dn else ""
        return f"ceiling {self.level_dn:.1f} DN{noise}"

    def threshold_dn(self, full_scale_dn: float) -> float:
        """Return the threshold above which no pixel of a flawless part comes, in DN.

        ``T = ceiling + max(7 sigma, 0.005 full_scale_dn)``, rounded up to a step of ``GRID``.

        Parameters
        ----------
        full_scale_dn : float
            Grey level of a saturated pixel, DN.

        Examples
        --------
        >>> from gpuspec.detection.segmentation import Ceiling
        >>> Ceiling(80.0, 0.5).threshold_dn(255.0)
        83.5
        """
        margin = max(NOISE_SIGMAS * self.noise_dn, CEILING_FLOOR * full_scale_dn)
        return rounded_up(self.level_dn + margin, full_scale_dn)


@dataclass(frozen=True)
class Margins:
    """What an automatic threshold is made of, in DN.

    Attributes
    ----------
    flawless_dn : float
        Median of the flawless surface.
    uneven_dn, one_image_dn, floor_dn : float
        What it must be above that: seven robust sigmas, one image, a share of full scale.
    """

    flawless_dn: float
    uneven_dn: float
    one_image_dn: float
    floor_dn: float

    @property
    def threshold_dn(self) -> float:
        """The median and the largest of them."""
        return self.flawless_dn + max(self.uneven_dn, self.one_image_dn, self.floor_dn)

    def rounded_dn(self, full_scale_dn: float) -> float:
        """Return the threshold, rounded up to a step of ``GRID``, in DN."""
        return rounded_up(self.threshold_dn, full_scale_dn)


def rounded_up(level_dn: float, full_scale_dn: float) -> float:
    """Return a level rounded up to a step of ``GRID``, in DN.

    Parameters
    ----------
    level_dn : float
        Off by a float's rounding it is the same.
    full_scale_dn : float
        Grey level of a saturated pixel.
    """
    step = GRID * full_scale_dn
    return math.ceil(level_dn / step - 1e-6) * step


def flawless_level(aspect: GreyLevels, valid: Mask) -> float:
    """Return the grey level of the flawless surface: the median of the valid pixels.

    Parameters
    ----------
    aspect, valid
        As of :func:`automatic_threshold`.

    Returns
    -------
    float
        Flawless level, DN.

    Raises
    ------
    ValueError
        If the shapes disagree, no pixel is valid, or a valid pixel is not a finite number.

    Examples
    --------
    >>> from gpuspec.detection.segmentation import flawless_level
    >>> aspect = np.array([[60.0, 62.0, 61.0, 255.0]])
    >>> flawless_level(aspect, valid=np.array([[True, True, True, False]]))
    61.0
    """
    return median(_valid_pixels(aspect, valid))


def automatic_threshold(
    aspect: GreyLevels, valid: Mask, *, full_scale_dn: float, images: int
) -> float:
    """Return the threshold above which no pixel of a flawless part comes.

    ``T = median + max(7 · 1.4826 · MAD, full_scale_dn / images, 0.02 · full_scale_dn)``, over the
    valid pixels. Seven sigmas, so that not one of millions of flawless pixels passes; one image,
    because a flawless pixel may be luminous in one image more than its neighbour (plus a tenth of
    it, for such pixels sit exactly on the bound and that image has noise); 2 % of full scale, as a
    floor under perfectly even backgrounds. It is rounded up to a step of ``GRID``. Defects are
    taken to cover less than half of the part.

    Parameters
    ----------
    aspect : (M, N) array
        Aspect image, DN.
    valid : (M, N) bool array
        Pixels that lie on the part and see the light.
    full_scale_dn : float
        Grey level of a saturated pixel, DN.
    images : int
        Images in the sequence.

    Returns
    -------
    float
        Threshold, DN.

    Raises
    ------
    ValueError
        If the shapes disagree, no pixel is valid, a valid pixel is not a finite number, or
        `full_scale_dn` or `images` is not positive.

    Examples
    --------
    >>> from gpuspec.detection.segmentation import automatic_threshold
    >>> aspect = np.full((4, 4), 64.0)  # even: one image in 40 is the margin
    >>> automatic_threshold(aspect, np.full((4, 4), True), full_scale_dn=255.0, images=40)
    71.125
    """
    margins = threshold_margins(aspect, valid, full_scale_dn=full_scale_dn, images=images)
    return margins.rounded_dn(full_scale_dn)


def threshold_margins(
    aspect: GreyLevels, valid: Mask, *, full_scale_dn: float, images: int
) -> Margins:
    """Return what :func:`automatic_threshold` is made of; parameters and errors as there."""
    if not (np.isfinite(full_scale_dn) and full_scale_dn > 0):
        raise ValueError(f"full_scale_dn is {full_scale_dn}; it must be finite and above 0.")
    if images < 1:
        raise ValueError(f"images is {images}; a sequence has at least 1 image.")
    pixels = _valid_pixels(aspect, valid)
    level = median(pixels)
    pixels -= level
    np.abs(pixels, out=pixels)
    robust_sigma = SIGMA_PER_MAD * median(pixels)
    one_image = full_scale_dn / images * (1 + MARGIN)
    return Margins(level, 7 * robust_sigma, one_image, 0.02 * full_scale_dn)


def median(values: npt.NDArray[np.floating[Any]]) -> float:
    """Return the median, exactly as ``np.median``, several times as fast where there are millions.

    A small sample tells between which two values the median lies; only what is between them is
    put in order. Should it lie elsewhere, all are.

    Parameters
    ----------
    values : (n,) array of float
        At least one; none of them NaN.

    Examples
    --------
    >>> from gpuspec.detection.segmentation import median
    >>> median(np.array([3.0, 1.0, 2.0, 10.0]))
    2.5
    """
    if values.size < _SAMPLE:
        return float(np.median(values))
    low, high = np.partition(values[sampled_places(values.size)], _BRACKET)[list(_BRACKET)]
    ranks = np.array([(values.size - 1) // 2, values.size // 2]) - np.count_nonzero(values < low)
    if ranks[0] < 0 or ranks[1] >= np.count_nonzero((values >= low) & (values <= high)):
        return float(np.median(values))
    # An even surface has one grey level a million times: it is counted, not put in order.
    between = np.r_[low, values[(values > low) & (values < high)], high]
    ranks = np.clip(ranks - np.count_nonzero(values == low) + 1, 0, between.size - 1)
    return float(np.mean(np.partition(between, ranks)[ranks]))


def sampled_places(size: int) -> npt.NDArray[np.intp]:
    """Return places of a sample: multiples of the golden ratio, in step with no row of an image."""
    return (np.arange(_SAMPLE) * _GOLDEN % 1 * size).astype(np.intp)


def segment(
    aspect: GreyLevels, valid: Mask, threshold: float, *, min_area_px: int = 0
) -> npt.NDArray[np.int32]:
    """Label the blobs: the 8-connected sets of valid pixels above the threshold.

    Parameters
    ----------
    aspect : (M, N) array
        Aspect image, DN.
    valid : (M, N) bool array
        Pixels that lie on the part and see the light; no other is detected.
    threshold : float
        A pixel is detected if its grey level is above this, DN.
    min_area_px : int
        Blobs of fewer pixels are removed.

    Returns
    -------
    (M, N) int32 array
        Label image: 0 where nothing is detected, else 1 to the number of blobs without a gap, in
        the order in which a row-by-row scan meets them.

    Raises
    ------
    ValueError
        If the shapes disagree, a valid pixel is not a finite number, or the threshold is NaN.

    Examples
    --------
    >>> from gpuspec.detection.segmentation import segment
    >>> aspect = np.array([[90, 90, 60, 60], [60, 60, 60, 60], [60, 60, 60, 95]])
    >>> segment(aspect, np.full((3, 4), True), 80.0).tolist()
    [[1, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 2]]
    >>> segment(aspect, np.full((3, 4), True), 80.0, min_area_px=2).tolist()
    [[1, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]
    """
    _check_grey_levels(aspect, valid)
    if np.isnan(threshold):
        raise ValueError("The threshold is not a number.")
    return connected((aspect > float(threshold)) & valid, min_area_px)


def _check_grey_levels(aspect: GreyLevels, valid: Mask) -> None:
    if aspect.ndim != 2 or aspect.dtype.kind not in "iuf":
        raise ValueError(
            f"aspect must be an (M, N) array of grey levels, not {aspect.dtype} of {aspect.shape}."
        )
    check_mask("valid", valid, aspect.shape)
    bad = np.count_nonzero(~np.isfinite(aspect) & valid)
    if bad:
        raise ValueError(f"aspect is not a finite number at {bad} valid pixel(s).")


def _valid_pixels(aspect: GreyLevels, valid: Mask) -> npt.NDArray[np.floating[Any]]:
    """Return a new 1-d array of the valid pixels; float32 holds 8- and 16-bit levels exactly."""
    _check_grey_levels(aspect, valid)
    if not valid.any():
        raise ValueError("No pixel is valid, so the flawless level is undefined.")
    pixels: npt.NDArray[np.floating[Any]] = aspect[valid].astype(
        np.result_type(aspect, np.float32), copy=False
    )
    return pixels
