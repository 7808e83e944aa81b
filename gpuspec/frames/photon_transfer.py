"""Photon transfer: how the variance of grey levels grows with the level, and what that tells.

J. R. Janesick, Photon transfer, SPIE (2007); EMVA 1288, release 4, 6.6. A sample's variance is
K mu + (K sigma_d)^2 + 1/12 with K the gain in DN per electron and mu its level over black; near
black, where noise is cut, and where it is less than a grey level, rounding and clipping make it
another, which is worked out. What a camera's place or the part's trembling adds goes with the
square of the slope of the light, and what uneven gains add with that of the level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import FrameError
from gpuspec.frames.fringes import Measured

Array = NDArray[np.float64]
Noise = Callable[[Array, float, float], Array]
"""Variance of rounded and clipped grey levels, DN^2, at signals over black in DN, with the variance
of the dark and the gain."""
QUANTISED = 1 / 12
"""Variance of rounding to whole grey levels, DN^2."""
_BINS = 40
_LEAST = 0.02  # DN^2
_MAY_BE_NOTHING = np.array([True, False, True, True])
"""Of the terms of a variance: the dark's, trembling and uneven gain."""
_OF_LIGHT = np.array([False, False, True, True])
_LEVERAGE = 0.7
_STRANGE = 4.5  # standard deviations
_CLEAR = 4.0  # standard deviations from black and from full scale, nearer than which noise is cut
_ROUNDS = 6  # of variance and the weights that it gives
_LESS = 4.0  # times, at most, that the dark's variance becomes less in a round
_EVEN = 0.5  # DN^2, from which rounding adds 1/12 whatever the level
_KNOTS_MAX, _KNOTS_A_DN = 4096, 64


@dataclass(frozen=True, eq=False)
class Transfer:
    """Variance over level.

    Attributes
    ----------
    level_dn, variance_dn2, samples : ndarray, shape (n,)
        Of the samples of about one level: their mean level, variance less what the light's slope
        adds, and number.
    gain_dn_per_e : Measured
    dark_dn2 : Measured
        Variance at black level, without rounding; where it comes out below 0, the gain is that of a
        variance of 0.
    jitter : Measured
        Rms of the light's place from image to image, in periods.
    uneven : Measured or None
        Rms of the pixels' gain, where it was not taken off before.
    """

    level_dn: Array
    variance_dn2: Array
    samples: NDArray[np.int64]
    gain_dn_per_e: Measured
    dark_dn2: Measured
    jitter: Measured
    uneven: Measured | None

    def variance(self, level_dn: Array) -> Array:
        """Return the variance of grey levels, DN^2.

        Parameters
        ----------
        level_dn : ndarray
            Above black.
        """
        dark = max(self.dark_dn2.value, 0.0) + QUANTISED
        return dark + self.gain_dn_per_e.value * np.maximum(level_dn, 0)


def photon_transfer(
    levels: NDArray[Any],
    expected: Array,
    signal: Array,
    slope: Array,
    full_scale_dn: float,
    noise_of: Noise,
    *,
    own: bool = True,
) -> Transfer:
    """Return how variance grows with level, from samples about what is expected of them.

    Parameters
    ----------
    levels : ndarray, shape (n, K)
        Grey levels of n pixels in K images.
    expected : ndarray, shape (n, K)
        What a flawless pixel there would show, DN.
    signal : ndarray, shape (n, K)
        Its signal: what is over black, neither clipped nor rounded, DN.
    slope : ndarray, shape (n, K)
        By how much the level changes over a period of the light, DN.
    full_scale_dn : float
    noise_of : callable
        Variance of grey levels, see :data:`Noise`.
    own : bool
        Whether each pixel's own offset, gain and place on the light are taken off first: a part is
        never quite even. Without it, as under stripes that leave a pixel few levels between dark
        and saturated, what gains add goes with the square of the level.

    Returns
    -------
    Transfer

    Raises
    ------
    FrameError
        If too few samples are clear of black and of saturation, or their noise does not grow.

    Examples
    --------
    >>> from gpuspec.frames.photon_transfer import photon_transfer
    >>> rng, mean = np.random.default_rng(5), np.linspace(20, 220, 20) + np.zeros((5000, 1))
    >>> levels = np.rint(rng.normal(mean, np.sqrt(0.03 * mean + 1.0)))
    >>> even = lambda signal, dark, gain: dark + gain * signal + 1 / 12
    >>> found = photon_transfer(levels, mean, mean, np.zeros_like(mean), 255.0, even)
    >>> bool(abs(found.gain_dn_per_e.value - 0.03) < 3 * found.gain_dn_per_e.uncertainty)
    True
    """
    guess = float(np.median((levels - expected) ** 2) * 2.2) or 0.25
    solution = np.array([max(guess, 0.25), 0.0, 0.0, 0.0])
    for _ in range(_ROUNDS):
        shown, rises = _shown(solution, signal, full_scale_dn, noise_of)
        variance = np.maximum(shown + solution[2] * slope**2 + solution[3] * signal**2, _LEAST)
        noise = np.sqrt(variance)
        clear = expected < full_scale_dn - _CLEAR * noise
        rest: Array = levels - expected
        left: Callable[[Array], Array] = _all
        if own:
            rest, leverage, left = _own(rest, signal, slope, clear / variance)
            clear &= leverage < _LEVERAGE
        clear &= rest**2 < _STRANGE**2 * variance + 1  # dust, and what is no even part's
        cut = signal < _CLEAR * noise
        _check(clear, cut, expected >= full_scale_dn - _CLEAR * noise)
        at, steep = signal[clear], slope[clear] ** 2
        weight = 1 / np.maximum(left(variance)[clear], _LEAST / 4)
        # Levels of which few are not black vary more than normal numbers.
        weight = weight / np.sqrt(1 + np.where(cut[clear], weight, 0) / 2)
        square = rest[clear] ** 2
        design = np.column_stack([left(of)[clear] for of in (*rises, slope**2, signal**2)])
        beyond = left(shown)[clear] - design[:, :2] @ solution[:2]
        scale = np.maximum(design.max(axis=0), 1e-12)
        some = np.array([True, True, steep.max() > 1e-6, not own])
        before = solution[0]
        while True:  # without what comes out below 0
            scaled = (design / scale)[:, some] * weight[:, None]
            inverse = np.linalg.inv(scaled.T @ scaled)
            solution = np.zeros(4)
            told = inverse @ (scaled.T @ ((square - beyond) * weight))
            solution[some] = told / scale[some]
            if some[0]:  # a gain without a dark is no more certain for it
                # Of squares of normal numbers the variance is twice the square of theirs.
                spread = np.zeros(4)
                dark, spread[some] = solution[0], np.sqrt(2 * np.diag(inverse)) / scale[some]
            below = some & (solution < 0) & _MAY_BE_NOTHING
            if solution[1] <= 0 and not below.any():
                below = some & _OF_LIGHT if (some & _OF_LIGHT).any() else some & _MAY_BE_NOTHING
            if not below.any():
                break
            some &= ~below
        grows = solution[1] > 0
        solution[:2] = max(solution[0], before / _LESS), max(solution[1], 1e-9)
    if not grows:
        raise FrameError(
            "the noise of these frames does not grow with the grey level, so the photon transfer "
            "tells nothing; take single frames as the camera gives them, neither averaged nor "
            "noise-free."
        )
    square = (square - solution[2:] @ design[:, 2:].T) * variance[clear] / left(variance)[clear]
    edges = np.quantile(at, np.linspace(0, 1, _BINS + 1))
    bins = np.clip(np.searchsorted(edges, at, "right") - 1, 0, _BINS - 1)
    number = np.bincount(bins, minlength=_BINS)
    kept = number > 0

    def mean(of: Array) -> Array:
        found: Array = np.bincount(bins, of, _BINS)[kept] / number[kept]
        return found

    return Transfer(
        mean(at), mean(square), number[kept],
        Measured(float(solution[1]), float(spread[1])),
        Measured(float(dark), float(spread[0])),
        _root(solution[2], spread[2]), None if own else _root(solution[3], spread[3]),
    )  # fmt: skip


def _root(square: float, spread: float) -> Measured:
    """Return the root of a square that may have come out below 0."""
    root = float(np.sqrt(max(square, 0.0)))
    return Measured(root, float(spread) / (2 * root) if square > spread else float(spread) ** 0.5)


def _check(clear: NDArray[np.bool_], cut: NDArray[np.bool_], saturated: NDArray[np.bool_]) -> None:
    """Refuse levels of which too few tell how noise grows."""
    telling = clear & ~cut
    if np.count_nonzero(telling) >= 50 * _BINS:
        return
    dark, bright = (float(np.mean(which)) for which in (cut, saturated))
    advice = (
        "take the frames at a shorter exposure, or of a larger region."
        if bright > 0
        else "take frames of which more are lit, or of a larger region."
    )
    raise FrameError(
        f"too few grey levels tell the noise: {dark:.1%} are black, {bright:.1%} saturated, and "
        f"only {np.count_nonzero(telling):,} of the others are as the light would have them, where "
        f"{50 * _BINS:,} are needed; {advice}"
    )


def _shown(
    solution: Array, signal: Array, full_scale_dn: float, noise_of: Noise
) -> tuple[Array, list[Array]]:
    """Return the variance of grey levels as they are rounded and clipped at black, DN^2.

    Returns
    -------
    variance : ndarray, of the shape of `signal`
    rises : list of two ndarrays of that shape
        By how much it rises with the dark's variance and with the gain.
    """
    dark, gain = float(solution[0]), max(float(solution[1]), 1e-6)
    positive = np.maximum(signal, 0)
    reach = max((_EVEN - dark) / gain, 3 * _CLEAR * np.sqrt(dark) + 2 * _CLEAR**2 * gain)
    reach = min(reach, full_scale_dn)
    knots = np.linspace(0, reach, int(np.clip(reach * _KNOTS_A_DN, 16, _KNOTS_MAX)))

    def beyond(dark: float, gain: float) -> Array:
        """Return by how much more it is than that of normal numbers, rounded."""
        return noise_of(knots, dark, gain) - (dark + gain * knots + QUANTISED)

    more = beyond(dark, gain)
    by_dark = (beyond(dark + 0.02 * dark + 1e-4, gain) - more) / (0.02 * dark + 1e-4)
    by_gain = (beyond(dark, 1.02 * gain) - more) / (0.02 * gain)
    shown = dark + gain * positive + QUANTISED + np.interp(positive, knots, more, right=0)
    return shown, [
        1 + np.interp(positive, knots, by_dark, right=0),
        positive + np.interp(positive, knots, by_gain, right=0),
    ]


def _all(variance: Array) -> Array:
    """Return what is left of a variance where nothing was taken off: all of it."""
    return variance


def _own(
    rest: Array, signal: Array, slope: Array, weight: Array
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Take each pixel's offset, gain and place off what is left of its levels.

    Returns
    -------
    rest : ndarray, shape (n, K)
    leverage : ndarray, shape (n, K)
        By how much less each sample varies about the fit than by itself.
    left : callable
        Returns the variance that `rest` has of one that the levels have, each of shape (n, K): of
        (1 - H)_ij^2 of the others' too, whatever the weights. With weights that are wrong, 1 - H
        alone would be, and would make them so again.
    """
    design = np.stack([np.ones_like(signal), signal, slope], axis=2)
    design /= np.maximum(np.abs(design).max(axis=(0, 1)), 1e-12)
    weighted = design * weight[:, :, None]
    normal = np.einsum("nki,nkj->nij", weighted, design) + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(normal)
    solution = np.einsum("nij,nkj,nk->ni", inverse, weighted, rest, optimize=True)
    turned = design @ inverse
    leverage = np.einsum("nki,nki->nk", turned, weighted)

    def left(variance: Array) -> Array:
        shared = np.einsum("nki,nk,nkj->nij", weighted, variance, weighted, optimize=True)
        others = np.einsum("nki,nij,nkj->nk", turned, shared, turned, optimize=True)
        found: Array = variance * (1 - 2 * leverage) + others
        return found

    return rest - np.einsum("nki,ni->nk", design, solution), leverage, left
