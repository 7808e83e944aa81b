"""Where a curve over size says nothing, or less than it seems, and what would settle it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.detectability.curve import POD, Curve
from gpuspec.detectability.fits import Line
from gpuspec.detection.chances import CONFIDENCE, greatest_share, least_share, trials_all_hit

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RISK = 0.05
"""Of taking a curve for one that rises with size where hits do not depend on it."""

MISFIT_RISK = 0.01
"""Of saying of a curve that is right that it does not follow the trials."""

NEAR = 1.1
"""a90/95 over a90 that is near enough."""

_GROUPS = 10
_MANY = 1000  # times the trials: nobody tries so many more


@dataclass(frozen=True)
class Verdict:
    """What may be said of some trials.

    Attributes
    ----------
    applies : bool
        Whether a90 and a90/95 are to be believed.
    said : tuple of str
        What is to be known, a sentence each.
    more : int or None
        Trials of the same kind that would settle it, beside those there are; 0: it is settled;
        None: no number of them would.
    depends : bool
        Whether hits are known to depend on size at all; if not, no size means anything.
    """

    applies: bool
    said: tuple[str, ...]
    more: int | None
    depends: bool = True


def verdict(size: Floats, hit: Bools, curve: Curve | None, unit: str) -> Verdict:
    """Judge a curve by the trials it is of.

    Parameters
    ----------
    size : ndarray of float64, shape (n,)
    hit : ndarray of bool, shape (n,)
    curve : Curve or None
        None: there is none, as all are hit, or all missed.
    unit : str
        Of sizes.

    Examples
    --------
    >>> from gpuspec.detectability.verdict import verdict
    >>> found = verdict(np.linspace(1, 2, 20), np.full(20, True), None, "mm")
    >>> found.more, found.said[0]
    (9, 'All 20 trials from 1 to 2 mm are hits, so there is no curve: with 95 % confidence POD is
        at least 0.861 there; 9 more, all hits, would show 90/95.')
    """
    if curve is None:
        return _alike(size, hit, unit)
    said: list[str] = []
    trials, low, high = len(size), float(size.min()), float(size.max())
    ratio = 2 * (likelihood(hit, curve.pod(size)) - likelihood(hit, np.full(trials, hit.mean())))
    if curve.slope <= 0 or tail(ratio, 1) > RISK:
        return _even(trials, curve, ratio)
    said += _misfit(size, hit, curve)
    a90, bound = curve.size(POD), curve.bound_size(POD)
    settled = bound is not None and bound <= high
    if a90 > high:
        said.append(
            f"a90 = {a90:.4g} {unit} is beyond the largest size tried, {high:.4g} {unit}: it is "
            f"guessed from smaller ones; try larger defects."
        )
        return Verdict(False, tuple(said), None)
    needed = curve.trials_for(high if not settled else min(NEAR * a90, high))
    more = max((needed or 0) - trials, 0)
    if bound is None:
        said.append(
            f"the lower bound comes to {percent(POD)} nowhere, so there is no a90/95; about "
            f"{more:,} more such trials would give one within the sizes tried."
        )
    elif not settled:
        said.append(
            f"a90/95 = {bound:.4g} {unit} is beyond the largest size tried, {high:.4g} {unit}; "
            f"about {more:,} more such trials would bring it within."
        )
    elif a90 < low:
        said.append(
            f"a90 = {a90:.4g} {unit} is below the smallest size tried, {low:.4g} {unit}: it is "
            f"guessed from larger ones; try smaller defects."
        )
        return Verdict(False, tuple(said), None)
    elif bound > NEAR * a90:
        said.append(
            f"a90/95 is {percent(bound / a90 - 1)} above a90; about {more:,} more such trials "
            f"would bring it within {percent(NEAR - 1)}."
        )
    else:
        more = 0
    return Verdict(settled, tuple(said), more)


def _alike(size: Floats, hit: Bools, unit: str) -> Verdict:
    trials, sure = len(size), percent(CONFIDENCE)
    span = f"from {size.min():.4g} to {size.max():.4g} {unit}"
    if not hit.any():
        most = greatest_share(0, trials)
        return Verdict(
            False,
            (f"All {trials:,} trials {span} are misses, so there is no curve: with {sure} "
             f"confidence POD is at most {most:.3f} there; try larger defects.",),
            None,
        )  # fmt: skip
    least, more = least_share(trials, trials), max(trials_all_hit() - trials, 0)
    what = (
        f"{more} more, all hits, would show 90/95." if more
        else "that is 90/95 for all of them together; try smaller defects to find a90."
    )  # fmt: skip
    return Verdict(
        False,
        (f"All {trials:,} trials {span} are hits, so there is no curve: with {sure} confidence "
         f"POD is at least {least:.3f} there; {what}",),
        more,
    )  # fmt: skip


def _even(trials: int, curve: Curve, ratio: float) -> Verdict:
    if curve.slope <= 0:
        said = (
            "larger defects are found no more often than smaller ones, so a90 means nothing; try a "
            "wider range of sizes, or another size, e.g. the slope."
        )
        return Verdict(False, (said,), None, depends=False)
    from scipy import special  # slow to import

    needed = trials * special.chdtri(1, RISK) / max(ratio, 1e-12)
    more = max(int(np.ceil(needed)) - trials, 1) if needed < _MANY * trials else None
    what = (
        "try a wider range of sizes." if more is None
        else f"about {more:,} more such trials would show it if it is what it seems, or try a "
        f"wider range of sizes."
    )  # fmt: skip
    said = (
        f"no dependence on size is shown (likelihood ratio, p = {tail(ratio, 1):.2g}), so a90 "
        f"means nothing; {what}"
    )
    return Verdict(False, (said,), more, depends=False)


@dataclass(frozen=True)
class Misfit:
    """Where trials and a model disagree most.

    Attributes
    ----------
    chance : float
        Of as much by chance alone.
    group : ndarray of int
        Which trials.
    told, seen : float
        Share of hits there by the model, and of the trials.
    """

    chance: float
    group: NDArray[np.intp]
    told: float
    seen: float


def misfit(key: Floats, pod: Floats, hit: Bools) -> Misfit | None:
    """Test a model by Hosmer and Lemeshow's test in groups alike; None: the trials follow it.

    Parameters
    ----------
    key : ndarray of float64, shape (n,)
        By which trials are alike.
    pod : ndarray of float64, shape (n,)
        Chance of each, by the model.
    hit : ndarray of bool, shape (n,)
    """
    if len(key) < 10 * _GROUPS:
        return None
    groups = np.array_split(np.argsort(key, kind="stable"), _GROUPS)
    seen = np.array([hit[group].mean() for group in groups])
    told = np.array([pod[group].mean() for group in groups])
    count = np.array([len(group) for group in groups])
    square = count * (seen - told) ** 2 / np.maximum(told * (1 - told), 1e-9)
    chance = tail(float(square.sum()), _GROUPS - 2)
    worst = int(np.argmax(square))
    if chance > MISFIT_RISK:
        return None
    return Misfit(chance, groups[worst], float(told[worst]), float(seen[worst]))


def _misfit(size: Floats, hit: Bools, curve: Curve) -> list[str]:
    """Say where trials and curve disagree, in groups of like size."""
    off = misfit(size, curve.pod(size), hit)
    if off is None:
        return []
    at = size[off.group]
    return [
        f"the curve does not follow the trials (Hosmer and Lemeshow, p = {off.chance:.1g}): from "
        f"{at.min():.4g} to {at.max():.4g} it says {percent(off.told)} and "
        f"{percent(off.seen)} are found; something beside this size decides, e.g. depth."
    ]


def percent(share: float) -> str:
    """Return a share in percent, three digits."""
    return f"{100 * share:.3g} %"


def straight(size: Floats, signal: Floats, line: Line) -> str | None:
    """Say where signals leave their line; None: they follow it.

    The means of groups of like size are off it by more than their scatter lets them.

    Parameters
    ----------
    size, signal : ndarray of float64, shape (n,)
    line : Line
        Fitted to them.
    """
    between = (signal > line.noise) & (signal < line.saturation)
    # What is censored draws the mean of the rest of its size: only sizes free of it are looked at.
    low = size[signal <= line.noise].max(initial=-np.inf)
    high = size[signal >= line.saturation].min(initial=np.inf)
    between &= (size > low) & (size < high)
    if np.count_nonzero(between) < 10 * _GROUPS:
        return None
    a, s = size[between], signal[between]
    off = (np.log(s) - np.log(line.signal(a))) if line.log_signal else s - line.signal(a)
    groups = np.array_split(np.argsort(a, kind="stable"), _GROUPS)
    square = [len(g) * (off[g].mean() / line.scatter) ** 2 for g in groups]
    chance = tail(float(sum(square)), _GROUPS - 2)
    if chance > MISFIT_RISK:
        return None
    worst = a[groups[int(np.argmax(square))]]
    return (
        f"the signals leave their straight line (p = {chance:.1g}), most from {worst.min():.4g} to "
        f"{worst.max():.4g}, so their a90 and a90/95 are not to be trusted; take those of the hits."
    )


def likelihood(hit: Bools, pod: Floats) -> float:
    """Return the logarithm of how likely hits are.

    Parameters
    ----------
    hit : ndarray of bool, shape (n,)
    pod : ndarray of float64, shape (n,)
        Chance of each.
    """
    chance = np.where(hit, pod, 1 - pod)
    return float(np.log(np.maximum(chance, 1e-300)).sum())


def tail(square: float, degrees: int) -> float:
    """Return the chance of so much or more under chi squared.

    Parameters
    ----------
    square : float
    degrees : int
        Of freedom.
    """
    from scipy import special  # slow to import

    return float(special.chdtrc(degrees, max(square, 0.0)))
