"""Trials with what was fitted to them, of one origin: simulated, or of a file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.detectability.curve import POD, Curve
from gpuspec.detectability.fits import Line, fit_hits, fit_signals
from gpuspec.detectability.verdict import Verdict, straight, verdict
from gpuspec.detection.chances import trials_all_hit

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Fitted:
    """Trials, their curve, and what may be said of it.

    Attributes
    ----------
    name : str
        Of the trials, for a legend.
    unit : str
        Of sizes.
    size : ndarray of float64, shape (n,)
    hit : ndarray of bool, shape (n,)
    curve : Curve or None
        None: all are hit, or all missed.
    verdict : Verdict
    signal : ndarray of float64, shape (n,), or None
    line : Line or None
        Of the signals, where the curve is fitted to them.
    """

    name: str
    unit: str
    size: Floats
    hit: Bools
    curve: Curve | None
    verdict: Verdict
    signal: Floats | None = None
    line: Line | None = None

    def __repr__(self) -> str:
        return f"Fitted({self.name}: {self.said})"

    @property
    def sizes(self) -> dict[str, float | None]:
        """a50, a90 and a90/95; None where there is none."""
        if self.curve is None or not self.verdict.depends:
            return {"a50": None, "a90": None, "a90_95": None}
        return {
            "a50": self.curve.size(0.5),
            "a90": self.curve.size(POD),
            "a90_95": self.curve.bound_size(),
        }

    @property
    def rank(self) -> float | None:
        """a90/95 by which stations are compared; None: it is not known.

        Where all trials are hits, and enough of them, it is at most the smallest size tried.
        """
        low, high = float(self.size.min()), float(self.size.max())
        if self.curve is None:
            return low if self.hit.all() and len(self.hit) >= trials_all_hit() else None
        bound = self.sizes["a90_95"]
        return max(bound, low) if bound is not None and bound <= high else None

    @property
    def said(self) -> str:
        """The three sizes in a sentence, with how they were found."""
        if self.curve is None:
            return f"{self.hit.sum():,} of {len(self.hit):,} trials are hits"
        if not self.verdict.depends:
            return "no a50, a90 and a90/95, as hits do not depend on this size"
        told = ", ".join(
            f"{name.replace('_', '/')} = {self.amount(value)}" for name, value in self.sizes.items()
        )
        return f"{told} ({self.curve.method})"

    def amount(self, value: float | None) -> str:
        """Return a size with its unit.

        Parameters
        ----------
        value : float or None
        """
        return "none" if value is None else f"{value:.4g} {self.unit}".rstrip()

    def numbers(self) -> dict[str, Any]:
        """Return what JSON is to hold."""
        curve, line = self.curve, self.line
        found: dict[str, Any] = {
            "trials": len(self.size),
            "hits": int(self.hit.sum()),
            "least_size": float(self.size.min()),
            "greatest_size": float(self.size.max()),
            **self.sizes,
            "applies": self.verdict.applies,
            "more_trials": self.verdict.more,
            "notes": list(self.verdict.said),
        }
        if curve is not None:
            found["curve"] = {
                "method": curve.method, "link": curve.link, "log_size": curve.log,
                "intercept": curve.intercept, "slope": curve.slope,
                "covariance": curve.covariance.tolist(), "aic": curve.aic,
            }  # fmt: skip
        if line is not None:
            found["line"] = {
                "log_size": line.log_size, "log_signal": line.log_signal,
                "intercept": line.intercept, "slope": line.slope, "scatter": line.scatter,
                "noise": _finite(line.noise), "threshold": line.threshold,
                "saturation": _finite(line.saturation),
                "at_noise": line.below, "at_saturation": line.above,
            }  # fmt: skip
        return found


def fitted_hits(name: str, size: Floats, hit: Bools, unit: str, model: str = "auto") -> Fitted:
    """Fit hits and misses.

    Parameters
    ----------
    name : str
        Of the trials.
    size : ndarray of float64, shape (n,)
    hit : ndarray of bool, shape (n,)
    unit : str
    model : str
        See :func:`gpuspec.detectability.fits.fit_hits`.

    Raises
    ------
    TrialsError
        If the sizes are all equal, or the model is not known or does not apply.
    """
    curve = None if hit.all() or not hit.any() else fit_hits(size, hit, model)
    return Fitted(name, unit, size, hit, curve, verdict(size, hit, curve, unit))


def fitted_signals(
    name: str, size: Floats, signal: Floats, unit: str, threshold: float,
    noise: float = -np.inf, saturation: float = np.inf,
) -> Fitted:  # fmt: skip
    """Fit signals; parameters beside those of `fitted_hits`, and errors, as of `fit_signals`.

    Parameters
    ----------
    name : str
    size, signal : ndarray of float64, shape (n,)
    unit : str
    threshold, noise, saturation : float
    """
    curve, line = fit_signals(size, signal, threshold, noise, saturation)
    hit = signal > threshold  # of NaN: a miss
    found, bent = verdict(size, hit, curve, unit), straight(size, signal, line)
    if bent:
        found = replace(found, applies=False, said=(bent, *found.said), more=None)
    return Fitted(name, unit, size, hit, curve, found, signal, line)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
