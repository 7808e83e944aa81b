"""A map: the a90 of one size at each of a second one, and what may be said of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.detectability.curve import POD
from gpuspec.detectability.fits import fit_hits, fit_map
from gpuspec.detectability.sizes import Size
from gpuspec.detectability.surface import Surface
from gpuspec.detectability.verdict import RISK, likelihood, misfit, percent, tail

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_POINTS = 41  # of the second size
_NEAR = 20, 0.1  # trials nearest in the second size: so many at least, or this share


@dataclass(frozen=True)
class SizeMap:
    """Hits over two sizes, and the a90 of the first at each of the second.

    Attributes
    ----------
    first, second : Size
    a, b : ndarray of float64, shape (n,)
        Of the trials, the first size and the second.
    hit : ndarray of bool, shape (n,)
    surface : Surface
    at : ndarray of float64, shape (k,)
        Of the second size, evenly over what was tried.
    low, high : ndarray of float64, shape (k,)
        Of the first size, least and greatest tried near each.
    a90, a90_95 : ndarray of float64, shape (k,)
        Infinite where there is none, or none means anything.
    notes : tuple of str
        What is to be known, a sentence each.
    """

    first: Size
    second: Size
    a: Floats
    b: Floats
    hit: Bools
    surface: Surface
    at: Floats
    low: Floats
    high: Floats
    a90: Floats
    a90_95: Floats
    notes: tuple[str, ...]

    @classmethod
    def of(
        cls, first: Size, second: Size, a: Floats, b: Floats, hit: Bools, model: str = "auto"
    ) -> SizeMap:
        """Fit hits over two sizes.

        Parameters
        ----------
        first, second : Size
        a, b : ndarray of float64, shape (n,)
        hit : ndarray of bool, shape (n,)
        model : str
            See :func:`gpuspec.detectability.fits.fit_map`.

        Raises
        ------
        TrialsError
            If the trials tell of no map.

        Examples
        --------
        >>> from gpuspec.detectability.mapped import SizeMap
        >>> from gpuspec.detectability.sizes import SIZES
        >>> random = np.random.default_rng(1)
        >>> a, b = random.uniform(0.2, 3, 400), random.uniform(0.3, 1.2, 400)
        >>> hit = a / b + random.normal(0, 0.4, 400) > 2
        >>> SizeMap.of(SIZES["depth"], SIZES["diameter"], a, b, hit).said
        'a90 of the depth: 1.06 um at 0.302 mm, 1.76 um at 0.728 mm, 2.91 um at 1.15 mm'
        """
        surface = fit_map(a, b, hit, model)
        means, notes = _effects(first, second, a, b, hit, surface)
        at = np.linspace(b.min(), b.max(), _POINTS)
        low, high = _tried(a, b, at)
        curves = [surface.at(float(w)) for w in at]
        a90 = np.array([curve.size(POD) if means else np.inf for curve in curves])
        bounds = [curve.bound_size() if means else None for curve in curves]
        a90_95 = np.array([np.inf if bound is None else bound for bound in bounds])
        found = cls(first, second, a, b, hit, surface, at, low, high, a90, a90_95, notes)
        return found if not means else found._with_ends()

    @property
    def label(self) -> str:
        """What it is a map of."""
        return f"{self.first.name} at each {self.second.name}"

    @property
    def said(self) -> str:
        """A few values in a sentence."""
        shown, what = self.within(self.a90), f"a90 of the {self.first.name}"
        known = np.flatnonzero(np.isfinite(shown))
        if not len(known):
            return f"{what}: none within the sizes tried"
        some = dict.fromkeys(known[[0, len(known) // 2, -1]].tolist())
        told = (
            f"{shown[k]:.3g} {self.first.unit} at {self.at[k]:.3g} {self.second.unit}" for k in some
        )
        return f"{what}: {', '.join(told)}"

    def within(self, sizes: Floats) -> Floats:
        """Return a curve of the map, NaN where it leaves the sizes tried.

        Parameters
        ----------
        sizes : ndarray of float64, shape (k,)
            `a90` or `a90_95`.
        """
        return np.where((sizes >= self.low) & (sizes <= self.high), sizes, np.nan)

    def where(self, k: int) -> str:
        """Say where a90 is at a point of the second size: within, above, below or none.

        Parameters
        ----------
        k : int
        """
        if not np.isfinite(self.a90[k]):
            return "none"
        if self.a90[k] > self.high[k]:
            return "above"
        return "below" if self.a90[k] < self.low[k] else "within"

    def rows(self) -> list[dict[str, Any]]:
        """Return the table: a row for each point of the second size."""
        a90, bound = self.within(self.a90), self.within(self.a90_95)
        return [
            {
                f"{self.second.name}_{self.second.unit}": float(self.at[k]),
                "a90": _known(a90[k]), "a90_95": _known(bound[k]), "a90_is": self.where(k),
                "least_tried": float(self.low[k]), "greatest_tried": float(self.high[k]),
            }
            for k in range(len(self.at))
        ]  # fmt: skip

    def numbers(self) -> dict[str, Any]:
        """Return what JSON is to hold."""
        fit = self.surface
        return {
            "of": self.first.name, "unit": self.first.unit, "over": self.second.name,
            "over_unit": self.second.unit, "trials": len(self.a), "hits": int(self.hit.sum()),
            "surface": {
                "method": fit.method, "link": fit.link, "log_of": fit.logs[0],
                "log_over": fit.logs[1], "coefficients": fit.coefficients.tolist(),
                "covariance": fit.covariance.tolist(), "aic": fit.aic,
            },
            "table": self.rows(), "notes": list(self.notes),
        }  # fmt: skip

    def _with_ends(self) -> SizeMap:
        """Say where the curves leave the sizes tried."""
        said = []
        for name, sizes in (("a90", self.a90), ("a90/95", self.a90_95)):
            for off, word, what in (
                (sizes > self.high, "above the greatest", "larger"),
                (sizes < self.low, "below the least", "smaller"),
            ):
                if off.any():
                    said.append(
                        f"{name} is {word} {self.first.name} tried at {self._spans(off)}, and is "
                        f"left out there; try {what} ones."
                    )
        return SizeMap(**{**vars(self), "notes": self.notes + tuple(said)})

    def _spans(self, some: Bools) -> str:
        """Return where the second size is one of these, as ranges."""
        if some.all():
            return f"every {self.second.name}"
        edges = np.flatnonzero(np.diff(np.concatenate([[0], some.astype(int), [0]])))
        ends = self.at[edges - np.arange(len(edges)) % 2].reshape(-1, 2)
        spans = (f"{lo:.3g}" if lo == hi else f"{lo:.3g} to {hi:.3g}" for lo, hi in ends)
        return f"a {self.second.name} of {' and '.join(spans)} {self.second.unit}"


def _effects(
    first: Size, second: Size, a: Floats, b: Floats, hit: Bools, surface: Surface
) -> tuple[bool, tuple[str, ...]]:
    """Return whether a90 means anything, and say what has no effect, and what does not fit."""
    pod = surface.pod(a, b)
    full, said = likelihood(hit, pod), []
    first_log, second_log = ("-log" if log else "" for log in surface.logs)
    # A likelihood ratio: what is lost when one of both is left out.
    without_first = fit_hits(b, hit, surface.link + second_log)
    shown = tail(2 * (full - likelihood(hit, without_first.pod(b))), 1)
    if surface.coefficients[1] <= 0 or shown > RISK:
        what = (
            "more is found no more often" if surface.coefficients[1] <= 0
            else f"no dependence on it is shown (likelihood ratio, p = {shown:.2g})"
        )  # fmt: skip
        return False, (
            f"{first.name}: {what} at the same {second.name}, so there is no map of its a90; "
            f"choose another --size.",
        )
    without_second = fit_hits(a, hit, surface.link + first_log)
    shown = tail(2 * (full - likelihood(hit, without_second.pod(a))), 1)
    if shown > RISK:
        said.append(
            f"no effect of the {second.name} is shown (likelihood ratio, p = {shown:.2g}): take "
            f"a90 = {without_second.size(POD):.4g} {first.unit} for every {second.name}."
        )
    off = misfit(pod, pod, hit)
    if off is not None:
        said.append(
            f"the map does not follow the trials (Hosmer and Lemeshow, p = {off.chance:.1g}): "
            f"where it says {percent(off.told)}, {percent(off.seen)} are found; the two sizes do "
            f"not act apart, or something beside them decides."
        )
    return True, tuple(said)


def _tried(a: Floats, b: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Return least and greatest first size tried: of the trials nearest in the second, and what
    lies between such (by the logarithms, in which ranges of any two sizes have straight sides).
    """
    order = np.argsort(b, kind="stable")
    many = min(max(_NEAR[0], round(_NEAR[1] * len(a))), len(a))
    start = np.clip(np.searchsorted(b[order], at) - many // 2, 0, len(a) - many)
    near = a[order][start[:, None] + np.arange(many)]
    low, high = near.min(axis=1), near.max(axis=1)
    if a.min() > 0 and b.min() > 0:
        log_at = np.log(at)
        return np.exp(_under(log_at, np.log(low))), np.exp(-_under(log_at, -np.log(high)))
    return _under(at, low), -_under(at, -high)


def _under(x: Floats, y: Floats) -> Floats:
    """Return the greatest convex curve under some points."""
    span = x[None, :] - x[:, None]
    share = (x[None, None, :] - x[:, None, None]) / np.where(span == 0, np.nan, span)[:, :, None]
    chord = y[:, None, None] + share * (y[None, :] - y[:, None])[:, :, None]
    found: Floats = np.where((share >= 0) & (share <= 1), chord, np.inf).min(axis=(0, 1))
    return np.minimum(found, y)


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
