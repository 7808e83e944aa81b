"""The phase of the light at every pixel: period, direction, bend, and how it steps on.

A pixel's grey levels over whole periods of the light are one turn of the same profile, each pixel
with a phase of its own. Over the image that phase is a steep plane and little more: the plane tells
the period in images of it, and what is left of it the part's shape. With the phases known all
samples fall on one curve, as fine as there are pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.restoration import unwrap_phase

from gpuspec.arrays import Mask
from gpuspec.errors import FrameError

Array = NDArray[np.float64]
BLOCKS_MIN = 12
"""Blocks of the region, at least, over which a plane of phase is told with its uncertainty."""
_BLOCK_PX = 8, 32
_ALIASES = 4.0
"""Of the ripples that few images leave on the phase, how many a block averages."""
_ORDER_MAX = 8  # periods in a sequence
_LEFT_OUT = 6.0  # robust sigmas of the modulation, beyond which a pixel is no even part's


@dataclass(frozen=True)
class Measured:
    """A number with its standard uncertainty.

    Attributes
    ----------
    value, uncertainty : float
    """

    value: float
    uncertainty: float

    def __str__(self) -> str:
        if not self.uncertainty > 0:
            return f"{self.value:.3g}"
        digits = max(0, 1 - int(np.floor(np.log10(self.uncertainty))))
        return f"{self.value:.{digits}f} ± {self.uncertainty:.{digits}f}"


@dataclass(frozen=True, eq=False)
class Fringes:
    """The light as it lies on the image.

    Attributes
    ----------
    periods : int
        Of the light, in the sequence.
    phase : ndarray of float64, shape (M, N)
        In periods, growing in the direction in which the light moves; averaged over blocks.
    modulation : ndarray of float32, shape (M, N)
        Amplitude of the first harmonic, DN.
    period_px : Measured
        Across the stripes.
    direction_deg : float
        In which the light moves in the image: 0 to the right, 90 up.
    bend : float
        Rms of the phase about a plane, in periods: the part's shape, its tilt, the lens.
    """

    periods: int
    phase: Array
    modulation: NDArray[np.float32]
    period_px: Measured
    direction_deg: float
    bend: float

    def even(self, region: Mask) -> Mask:
        """Return the pixels of a region that are an even part's: no scratch, no dust.

        Parameters
        ----------
        region : ndarray of bool, shape (M, N)
        """
        local = ndimage.uniform_filter(np.where(region, self.modulation, 0), 25)
        share = ndimage.uniform_filter(region.astype(np.float32), 25)
        ratio = self.modulation * share / np.maximum(local, 1e-6) - 1
        sigma = 1.4826 * float(np.median(np.abs(ratio[region])))
        kept: Mask = region & (np.abs(ratio) <= _LEFT_OUT * max(sigma, 1e-4))
        return kept


def periods_of(samples: NDArray[Any]) -> int:
    """Return how many periods of the light a sequence of whole ones holds.

    Parameters
    ----------
    samples : ndarray, shape (K, n)
        Some pixels of each frame, see :func:`gpuspec.frames.period.sampled`.

    Raises
    ------
    FrameError
        If the levels do not change, or there are fewer than three images to a period.

    Examples
    --------
    >>> from gpuspec.frames.fringes import periods_of
    >>> turns = np.arange(24)[:, None] / 12 + np.linspace(0, 3, 100)
    >>> periods_of(90 + 40 * np.cos(2 * np.pi * turns))
    2
    """
    power = (np.abs(np.fft.rfft(np.asarray(samples, np.float64), axis=0)) ** 2).mean(axis=1)
    order = 1 + int(np.argmax(power[1 : _ORDER_MAX + 1])) if len(power) > 1 else 0
    if not order or not power[order] > 0:
        raise FrameError("the grey levels do not change over the sequence; let the light move.")
    if len(samples) < 3 * order:
        raise FrameError(
            f"{len(samples)} images hold {order} periods of the light; a fit needs three images a "
            f"period, better eight."
        )
    return order


def fringes(frames: Iterable[NDArray[Any]], count: int, periods: int, region: Mask) -> Fringes:
    """Return the light's phase over the image.

    Parameters
    ----------
    frames : iterable of ndarray, shape (M, N)
        Whole periods of the light in equal steps; read once.
    count : int
        How many.
    periods : int
        Of the light in them.
    region : ndarray of bool, shape (M, N)
        Where the part is.

    Returns
    -------
    Fringes

    Raises
    ------
    FrameError
        If the region is too small for a plane of phase.

    Examples
    --------
    >>> from gpuspec.frames.fringes import fringes
    >>> x, turns = np.arange(300) + np.zeros((200, 1)), np.arange(12) / 12
    >>> frames = [100 + 80 * np.cos(2 * np.pi * (x / 25 - turn)) for turn in turns]
    >>> found = fringes(frames, 12, 1, np.full((200, 300), True))
    >>> round(found.period_px.value, 2), abs(round(found.direction_deg, 2)), round(found.bend, 3)
    (25.0, 0.0, 0.0)
    """
    sums = np.zeros(region.shape, np.complex64)
    for k, frame in enumerate(frames):
        sums += frame * np.complex64(np.exp(2j * np.pi * periods * k / count))
    sums = np.where(region, sums, 0)
    rows, columns = (slice(*_span(region.any(axis))) for axis in (1, 0))
    carrier = _carrier(sums[rows, columns])
    y, x = np.ogrid[: region.shape[0], : region.shape[1]]
    period = 1 / max(float(np.hypot(*carrier)), 1e-9)
    ripple = period * periods / count  # px, of what few images leave on the phase
    block = int(np.clip(np.ceil(_ALIASES * ripple), *_BLOCK_PX))
    for fine in (False, True):
        plane = np.exp(-2j * np.pi * (carrier[0] * y + carrier[1] * x)).astype(np.complex64)
        flat = sums * plane
        if fine:  # with the plane off, a Gaussian shifts no phase, not at the edges either
            flat = ndimage.gaussian_filter(flat, ripple)
        mean, weight = _blocks(flat, region, block)
        seen = _inner(weight > 0.5, int(abs(carrier[1]) > abs(carrier[0])))
        if np.count_nonzero(seen) < BLOCKS_MIN:
            raise FrameError(
                f"the region is too small to tell the light's phase; it holds {region.sum():,} px "
                f"and {BLOCKS_MIN * block**2:,} are needed."
            )
        turns = _unwrapped(np.angle(mean), seen) / (2 * np.pi)
        sides = ((np.arange(n) + 0.5) * block - 0.5 for n in seen.shape)
        centres = np.stack(np.meshgrid(*sides, indexing="ij"))
        slope, bend, spread = _plane(centres[:, seen], turns[seen])
        if not fine:
            carrier = carrier[0] + float(slope[0]), carrier[1] + float(slope[1])
    nearest = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    rest = turns[tuple(nearest)]
    phase = carrier[0] * y + carrier[1] * x + _between(rest, block, region.shape)
    gradient = np.array(carrier) + slope
    steep = float(np.hypot(*gradient))
    across = gradient / steep
    uncertain = float(np.hypot(*(across * spread)))
    return Fringes(
        periods, phase, (2 * np.abs(sums) / count).astype(np.float32),
        Measured(1 / steep, uncertain / steep**2),
        float(np.degrees(np.arctan2(-gradient[0], gradient[1]))), bend,
    )  # fmt: skip


def _span(used: Any) -> tuple[int, int]:
    places = np.flatnonzero(used)
    return int(places[0]), int(places[-1]) + 1


def _carrier(sums: NDArray[np.complex64]) -> tuple[float, float]:
    """Return the spatial frequency of a phase, in periods per pixel of a row and of a column."""
    size = [int(2 ** np.ceil(np.log2(n))) for n in sums.shape]
    power = np.abs(np.fft.fft2(sums, size))
    row, column = np.unravel_index(int(power.argmax()), power.shape)
    return float(np.fft.fftfreq(size[0])[row]), float(np.fft.fftfreq(size[1])[column])


def _blocks(
    values: NDArray[np.complex64], region: Mask, block: int
) -> tuple[NDArray[np.complex128], Array]:
    """Return the mean of each square of pixels, and which share of it the region is."""
    starts = [np.arange(0, n, block) for n in values.shape]

    def added(of: NDArray[Any]) -> NDArray[Any]:
        return np.add.reduceat(np.add.reduceat(of, starts[0], axis=0), starts[1], axis=1)

    counts = added(region.astype(np.float64))
    mean = added(values.astype(np.complex128)) / np.maximum(counts, 1)
    return mean, counts / block**2


def _inner(seen: Mask, axis: int) -> Mask:
    """Return the blocks that are at no edge: there no ripple is averaged whole.

    Of a narrow region it is those at no edge along the light's axis: a single row of blocks would
    not tell the direction.
    """
    along = np.zeros((3, 3), np.bool_)
    along[(1, slice(None)) if axis else (slice(None), 1)] = True
    for neighbours in (None, along):
        inner: Mask = ndimage.binary_erosion(seen, neighbours)
        lines = [np.count_nonzero(inner.any(axis=k)) for k in (0, 1)]
        if np.count_nonzero(inner) >= BLOCKS_MIN and min(lines) > 1:
            return inner
    return seen


def _unwrapped(angle: Array, seen: Mask) -> Array:
    masked = np.ma.masked_array(angle, ~seen)
    found: Array = np.ma.filled(unwrap_phase(masked), 0.0)  # type: ignore[no-untyped-call]
    return found


def _plane(at: Array, turns: Array) -> tuple[Array, float, Array]:
    """Return the slope of a plane through phases, their rms about it, and the slope's uncertainty.

    The part's shape is smooth, so that neighbours are off together: the uncertainty is that of as
    many numbers as there are blocks of correlated ones, by the correlation of neighbours.
    """
    # About the middle: of blocks in one row the slope across it is then 0, not any.
    design = np.column_stack([np.ones(turns.size), *(at - at.mean(axis=1, keepdims=True))])
    solution, *_ = np.linalg.lstsq(design, turns, rcond=None)
    rest = turns - design @ solution
    rms = float(np.sqrt(np.mean(rest**2)))
    order = np.lexsort((at[1], at[0]))
    along = rest[order]
    r = float(np.clip(np.dot(along[1:], along[:-1]) / max(np.dot(along, along), 1e-30), 0, 0.99))
    inflated = np.sqrt((1 + r) / (1 - r))
    spread = rms * inflated**2 / np.maximum(at.std(axis=1) * np.sqrt(turns.size), 1e-9)
    return solution[1:], rms, spread


def _between(rest: Array, block: int, shape: tuple[int, ...]) -> Array:
    """Interpolate between the centres of blocks, and beyond the outermost by their slope."""
    places = [(np.arange(n) + 0.5) / block - 0.5 for n in shape]
    for axis, place in enumerate(places):
        last = rest.shape[axis] - 1
        low = np.clip(np.floor(place).astype(np.intp), 0, max(last - 1, 0))
        share = place - low if last else np.zeros_like(place)
        share = share[:, None] if axis == 0 else share
        below, above = rest.take(low, axis), rest.take(np.minimum(low + 1, last), axis)
        rest = below + share * (above - below)
    return rest


def steps(
    frames: Iterable[NDArray[Any]], found: Fringes, region: Mask
) -> tuple[Measured, float, NDArray[np.float64]]:
    """Return the step between two images, from where the light lies in each.

    Parameters
    ----------
    frames : iterable of ndarray, shape (M, N)
        Of the same sequence.
    found : Fringes
    region : ndarray of bool, shape (M, N)

    Returns
    -------
    step : Measured
        In periods.
    uneven : float
        Rms of the images' places about equal steps, in periods.
    brightness : ndarray of float64, shape (K,)
        Mean of the light in each image, over that of all.
    """
    pixels = np.flatnonzero(region)
    pixels = pixels[:: max(1, pixels.size // (1 << 16))]
    turn = 2 * np.pi * found.phase.ravel()[pixels]
    waves = [np.ones_like(turn)]
    for order in (1, 2, 3):
        waves += [np.cos(order * turn), np.sin(order * turn)]
    solve = np.linalg.pinv(np.column_stack(waves))
    told = np.array([solve[:3] @ frame.ravel()[pixels].astype(np.float64) for frame in frames])
    places = np.unwrap(np.arctan2(told[:, 2], told[:, 1])) / (2 * np.pi)
    k = np.arange(len(places))
    (slope, _), rest = np.polyfit(k, places, 1), places - np.polyval(np.polyfit(k, places, 1), k)
    uneven = float(np.sqrt(np.sum(rest**2) / max(len(k) - 2, 1)))
    spread = uneven / float(np.sqrt(np.sum((k - k.mean()) ** 2)))
    return Measured(float(slope), spread), uneven, told[:, 0] / told[:, 0].mean()
