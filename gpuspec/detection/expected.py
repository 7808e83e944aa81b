"""What noise makes of a score: its expectation and spread over all draws, without drawing any."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import LabelImage, Mask, check_label_image, check_mask
from gpuspec.detection.counts import Count, share_of
from gpuspec.detection.false_blobs import least_pixels
from gpuspec.station.station import Station

_NEVER = 9.0  # standard deviations: of 1e18 normal numbers less than one is as far away


@dataclass(frozen=True)
class Expected:
    """Mean and standard deviation of a score over all draws of the noise.

    Attributes
    ----------
    p1, p1_deviation : float
        Precision, which is 1 where nothing is detected; beyond some hundred detected pixels to the
        leading orders of their counts.
    p2, p2_deviation : float or None
        Recall; None without a pixel in any zone.
    defects_hit, defects_hit_deviation : float
        Defects with at least one detected pixel.
    false_px, false_px_deviation : float
        Detected pixels outside the zones.
    """

    p1: float
    p1_deviation: float
    p2: float | None
    p2_deviation: float | None
    defects_hit: float
    defects_hit_deviation: float
    false_px: float
    false_px_deviation: float

    def __repr__(self) -> str:
        p2 = "undefined" if self.p2 is None else f"{self.p2:.3f} +- {self.p2_deviation:.4f}"
        return (
            f"Expected(P1 {self.p1:.3f} +- {self.p1_deviation:.4f}, P2 {p2}; "
            f"{self.defects_hit:.2f} +- {self.defects_hit_deviation:.2f} defects hit)"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
        return asdict(self)


def pixel_by_pixel(station: Station) -> bool:
    """Whether a pixel is detected by its own grey level, whatever is beside it.

    With a background, another polarity or a size filter it is not, and nothing is expected of a
    score.

    Parameters
    ----------
    station : Station

    Examples
    --------
    >>> from gpuspec.detection.expected import pixel_by_pixel
    >>> station = gpuspec.Station()
    >>> pixel_by_pixel(station), pixel_by_pixel(station.replace(segmentation__polarity="dark"))
    (True, False)
    """
    rule = station.segmentation
    plain = rule.polarity == "bright" and not rule.background_mm
    return plain and least_pixels(rule.min_area_mm2, station.camera.sampling_mm) <= 1


def expected_score(
    mean: NDArray[np.floating[Any]],
    deviation: NDArray[np.floating[Any]],
    truth: LabelImage,
    valid: Mask,
    defects: int,
    threshold: float,
    images: int | None = None,
) -> Expected:
    """Return what is expected of a score at a threshold, and how far draws are from it.

    A pixel's grey level is normal, the mean of many images that it is; pixels are independent. It
    is detected with the probability ``Phi((mean - threshold) / deviation)``, and counts are sums of
    such. Levels of `images` whole grey levels stand on steps of ``1 / images``: those above the
    threshold begin half a step below the first of them. Blobs are not formed: a size filter is not
    part of it.

    Parameters
    ----------
    mean, deviation : (M, N) array
        Of each pixel of the noisy aspect image, DN.
    truth : (M, N) integer array
        Zones: 0 where flawless, i in the zone of defect i, from 1.
    valid : (M, N) bool array
        Pixels that are scored.
    defects : int
        True defects on the part.
    threshold : float
        DN.
    images : int, optional
        Of whose grey levels, whole ones, the image is the mean; None: levels are continuous.

    Returns
    -------
    Expected

    Raises
    ------
    ValueError
        If the shapes disagree or `truth` holds no labels.

    Examples
    --------
    >>> from gpuspec.detection.expected import expected_score
    >>> mean, deviation = np.array([[90.0, 94.0, 60.0]]), np.full((1, 3), 2.0)
    >>> expected_score(mean, deviation, np.array([[1, 1, 0]]), np.full((1, 3), True), 1, 92.0)
    Expected(P1 1.000 +- 0.0000, P2 0.500 +- 0.2583; 0.87 +- 0.34 defects hit)
    """
    from scipy.special import ndtr  # slow to import

    check_label_image("truth", truth, mean.shape)
    check_mask("valid", valid, mean.shape)
    if images is not None:
        threshold = _between_levels(threshold, images)
    # All others are detected in no draw.
    places = np.flatnonzero((mean + _NEVER * deviation > threshold) & valid)
    with np.errstate(divide="ignore"):
        p = ndtr((mean.flat[places] - float(threshold)) / deviation.flat[places])
        zone = truth.flat[places].astype(np.intp)
        missed = np.exp(np.bincount(zone, np.log1p(-p), defects + 1)[1:])
    hit, false = Count.of(p[zone > 0]), Count.of(p[zone == 0])
    p1, p1_deviation = share_of(hit, false)
    pixels = int(np.count_nonzero((truth != 0) & valid))
    return Expected(
        p1=p1,
        p1_deviation=p1_deviation,
        p2=hit.mean / pixels if pixels else None,
        p2_deviation=math.sqrt(hit.variance) / pixels if pixels else None,
        defects_hit=float(np.sum(1 - missed)),
        defects_hit_deviation=float(np.sqrt(np.sum(missed * (1 - missed)))),
        false_px=false.mean,
        false_px_deviation=math.sqrt(false.variance),
    )


def _between_levels(threshold: float, images: int) -> float:
    """Return the middle between the highest level not above a threshold and the next."""
    step = math.floor(threshold * images)
    if np.float32((step + 1) / images) <= np.float32(
        threshold
    ):  # one level in an image's precision
        step += 1
    return (step + 0.5) / images
