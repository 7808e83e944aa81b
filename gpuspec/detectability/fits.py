"""Fits: hits or misses over a size or two, and signals over size.

Of the models that apply, the one of the least AIC is taken: logit or probit, size or its logarithm,
for signals also the signal or its logarithm. Hits that a size separates from all misses have no
likeliest curve; Firth's penalised likelihood (Biometrika 80, 1993) has one.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpuspec.detectability.curve import Curve
from gpuspec.detectability.surface import Surface
from gpuspec.errors import ExtraError, TrialsError

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
LINKS = ("logit", "probit")
MODELS = ("auto", *(f"{link}{scale}" for scale in ("", "-log") for link in LINKS))
"""What may be fitted to hits: auto, or a link with the size or its logarithm."""

_SAME = 1 - 1e-9  # of the correlation of two sizes, either way
_WHICH = "first", "second"


def fit_hits(size: ArrayLike, hit: ArrayLike, model: str = "auto") -> Curve:
    """Fit hits and misses over size.

    Parameters
    ----------
    size : array_like, shape (n,)
        Not all equal.
    hit : array_like of bool, shape (n,)
        Some True, some not.
    model : str
        One of ``MODELS``; auto: the one of the least AIC.

    Returns
    -------
    Curve

    Raises
    ------
    TrialsError
        If the sizes are all equal, the hits too, or the model is not known or does not apply.

    Examples
    --------
    >>> from gpuspec.detectability.fits import fit_hits
    >>> size = np.linspace(0.1, 1.0, 40)
    >>> hit = (size + 0.15 * np.sin(37 * size)) > 0.5
    >>> curve = fit_hits(size, hit)
    >>> curve.method, round(curve.size(0.9), 3), round(curve.bound_size(0.9), 3)
    ('probit of log size', 0.643, 0.872)
    """
    a, y = _trials(size, hit)
    if model not in MODELS:
        raise TrialsError(f"there is no model {model!r}; choose one of {', '.join(MODELS)}.")
    if y.all() or not y.any():
        raise TrialsError("hits and misses are both needed for a curve.")
    scales = [log for log in (False, True) if not log or a.min() > 0]
    if model != "auto":
        link, _, scale = model.partition("-")
        if scale and len(scales) == 1:
            raise TrialsError(f"{model} takes the logarithm of sizes, and one is not above 0.")
        scales = [bool(scale)]
    links = LINKS if model == "auto" else (link,)
    ways = [((log,), _standard((a, log))) for log in scales]
    link, (log,), found, how = _best(ways, y, links, is_separated(a, y))
    c0, c1 = map(float, found.coefficients)
    method = f"{_named(link, log)}{how}"
    return Curve(link, log, c0, c1, found.covariance, method, found.aic, len(a))


def is_separated(size: Floats, hit: Bools) -> bool:
    """Whether some size has all misses on one side and all hits on the other.

    Parameters
    ----------
    size : ndarray of float64, shape (n,)
    hit : ndarray of bool, shape (n,)
    """
    hits, misses = size[hit], size[~hit]
    return bool(misses.max() <= hits.min() or hits.max() <= misses.min())


@dataclass(frozen=True)
class Line:
    """How signals grow with size: s = c0 + c1 x + t e, e standard normal.

    Attributes
    ----------
    log_size, log_signal : bool
        Whether x and s are natural logarithms.
    intercept, slope, scatter : float
        c0, c1 and t.
    noise, threshold, saturation : float
        As given.
    below, above : int
        How many signals are known only to be at or below the noise, and at or above saturation.
    """

    log_size: bool
    log_signal: bool
    intercept: float
    slope: float
    scatter: float
    noise: float
    threshold: float
    saturation: float
    below: int
    above: int

    def signal(self, size: ArrayLike, deviations: float = 0.0) -> Floats:
        """Return the signal of a size, so many standard deviations off.

        Parameters
        ----------
        size : array_like
        deviations : float
        """
        x = np.asarray(size, np.float64)
        found = self.intercept + self.slope * (np.log(x) if self.log_size else x)
        found = found + deviations * self.scatter
        return np.exp(found) if self.log_signal else found


def fit_signals(
    size: ArrayLike,
    signal: ArrayLike,
    threshold: float,
    noise: float = -np.inf,
    saturation: float = np.inf,
) -> tuple[Curve, Line]:
    """Fit signals over size: a straight line with normal scatter, censored at both ends.

    A signal at or below the noise is known to be there or below; at or above saturation, likewise.
    POD(a) is the chance of a signal above the threshold.

    Parameters
    ----------
    size, signal : array_like, shape (n,)
        Sizes not all equal; a signal that is NaN was not seen, and is at or below the noise.
    threshold : float
        Above which a signal is a hit.
    noise, saturation : float

    Returns
    -------
    curve : Curve
        Of the probability, always a probit.
    line : Line
        Of the signal.

    Raises
    ------
    TrialsError
        If the sizes are all equal, fewer than three signals are between noise and saturation, or
        the threshold is not between them.

    Examples
    --------
    >>> from gpuspec.detectability.fits import fit_signals
    >>> size = np.linspace(1, 10, 50)
    >>> signal = np.clip(3 * size + 2 * np.sin(37 * size), 6, 25)
    >>> curve, line = fit_signals(size, signal, threshold=12, noise=6, saturation=25)
    >>> line.below, line.above, round(line.slope, 1), round(curve.size(0.5), 1)
    (3, 11, 3.0, 4.0)
    """
    if not noise < threshold < saturation:
        raise TrialsError(
            f"the threshold is {threshold:g}; it must be above the noise, {noise:g}, and below "
            f"saturation, {saturation:g}."
        )
    s = np.asarray(signal, np.float64).ravel()
    s = np.where(np.isnan(s), noise, s)
    a, above = _trials(size, s >= saturation)
    below = s <= noise
    between = ~(below | above)
    if np.count_nonzero(between) < 3 or np.ptp(a[between]) == 0 or np.ptp(s[between]) == 0:
        raise TrialsError(
            f"{np.count_nonzero(between)} of {len(s)} signals are between noise and saturation; a "
            f"line needs three, of different sizes."
        )
    scales = [log for log in (False, True) if not log or a.min() > 0]
    positive = noise > 0 or (not below.any() and s[between].min() > 0 and threshold > 0)
    ends = noise, threshold, saturation
    found = [
        _line(a, s, below, above, ends, log_size, log_signal)
        for log_size, log_signal in product(scales, (False, True) if positive else (False,))
    ]
    return min(found, key=lambda pair: pair[0].aic or 0.0)


def fit_map(first: ArrayLike, second: ArrayLike, hit: ArrayLike, model: str = "auto") -> Surface:
    """Fit hits and misses over two sizes at once.

    Parameters
    ----------
    first, second : array_like, shape (n,)
        Neither all equal, nor one the line of the other.
    hit : array_like of bool, shape (n,)
        Some True, some not.
    model : str
        As of :func:`fit_hits`; auto tries each size and its logarithm, a named one takes both
        sizes, or both logarithms.

    Returns
    -------
    Surface

    Raises
    ------
    TrialsError
        As of :func:`fit_hits`, and if the sizes tell the same.

    Examples
    --------
    >>> from gpuspec.detectability.fits import fit_map
    >>> random = np.random.default_rng(1)
    >>> depth, diameter = random.uniform(0.2, 3, 400), random.uniform(0.3, 1.2, 400)
    >>> hit = depth / diameter + random.normal(0, 0.4, 400) > 2
    >>> found = fit_map(depth, diameter, hit)
    >>> [round(found.at(mm).size(0.9), 1) for mm in (0.4, 0.8)]
    [1.2, 1.9]
    """
    a, y = _trials(first, hit)
    b, _ = _trials(second, y)
    if model not in MODELS:
        raise TrialsError(f"there is no model {model!r}; choose one of {', '.join(MODELS)}.")
    if y.all() or not y.any():
        raise TrialsError("hits and misses are both needed for a map.")
    named, _, scale = model.partition("-")
    logs = [
        pair
        for pair in product((False, True), repeat=2)
        if all(not log or of.min() > 0 for log, of in zip(pair, (a, b), strict=True))
        and (model == "auto" or pair == (bool(scale),) * 2)
    ]
    if not logs:
        raise TrialsError(f"{model} takes the logarithm of sizes, and one is not above 0.")
    ways = [(pair, _standard((a, pair[0]), (b, pair[1]))) for pair in logs]
    if any(abs(float(x[:, 0] @ x[:, 1])) > _SAME * len(y) for _, (x, _) in ways):
        raise TrialsError("the two sizes tell the same, one by the other; choose another second.")
    separated = any(_firthmodels().detect_separation(x, y).separation for _, (x, _) in ways)
    links = LINKS if model == "auto" else (named,)
    link, pair, found, how = _best(ways, y, links, separated)
    names = [f"{'log ' * log}{which} size" for log, which in zip(pair, _WHICH, strict=True)]
    method = f"{link} of {' and '.join(names)}{how}"
    return Surface(link, pair, found.coefficients, found.covariance, method, found.aic, len(a))


def _best(
    ways: Sequence[tuple[tuple[bool, ...], tuple[Floats, Floats]]], y: Bools,
    links: Sequence[str], separated: bool,
) -> tuple[str, tuple[bool, ...], _Found, str]:  # fmt: skip
    """Return link, logarithms and fit of the least AIC; where separated, of the likeliest."""
    if separated:
        every = [("logit", logs, _firth(*x, y)) for logs, x in ways]
        best = max(every, key=lambda one: one[2].likelihood)
        return *best, " by Firth's penalised likelihood"
    every = [(link, logs, _glm(*x, y, link)) for link, (logs, x) in product(links, ways)]
    return *min(every, key=lambda one: one[2].aic or 0.0), ""


def _trials(size: ArrayLike, hit: ArrayLike) -> tuple[Floats, Bools]:
    a, y = np.asarray(size, np.float64).ravel(), np.asarray(hit, np.bool_).ravel()
    if len(a) != len(y) or not len(a):
        raise TrialsError(f"{len(a)} sizes and {len(y)} outcomes are no trials; give one of each.")
    if not np.isfinite(a).all():
        raise TrialsError("a size is not a finite number; leave such trials out.")
    if np.ptp(a) == 0:
        raise TrialsError(
            f"all {len(a):,} trials have the size {a[0]:g}, so no curve over size can be told; try "
            f"defects of different sizes."
        )
    return a, y


def _statsmodels() -> Any:
    """Return the package, which few need."""
    try:
        import statsmodels.api
    except ModuleNotFoundError as error:
        raise ExtraError.of(error, "pod") from None
    return statsmodels.api


def _firthmodels() -> Any:
    """Return the package, which few need."""
    try:
        import firthmodels
    except ModuleNotFoundError as error:
        raise ExtraError.of(error, "pod") from None
    return firthmodels


def _standard(*columns: tuple[Floats, bool]) -> tuple[Floats, Floats]:
    """Return each size, or its logarithm, with mean 0 and deviation 1: fits in any unit converge
    alike; and what turns coefficients of these into those per unit of x.
    """
    x = np.stack([np.log(a) if log else a for a, log in columns], axis=1)
    middle, spread = x.mean(axis=0), x.std(axis=0)
    turn = np.diag(np.append(1.0, 1 / spread))
    turn[0, 1:] = -middle / spread
    return (x - middle) / spread, turn


def _named(link: str, log: bool) -> str:
    return f"{link} of {'log ' * log}size"


@dataclass(frozen=True)
class _Found:
    """Coefficients per unit of x, the first of no size, and their covariance."""

    coefficients: Floats
    covariance: Floats
    likelihood: float
    aic: float | None


def _glm(x: Floats, turn: Floats, y: Bools, link: str) -> _Found:
    api = _statsmodels()
    links = api.families.links
    family = api.families.Binomial(links.Logit() if link == "logit" else links.Probit())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # all but separated: the AIC of another model is less
        found = api.GLM(y.astype(float), api.add_constant(x), family=family).fit(tol=1e-12)
    covariance = turn @ found.cov_params() @ turn.T
    return _Found(turn @ found.params, covariance, float(found.llf), float(found.aic))


def _firth(x: Floats, turn: Floats, y: Bools) -> _Found:
    """Fit a logit by the greatest penalised likelihood."""
    firthmodels = _firthmodels()
    model = firthmodels.FirthLogisticRegression(backend="numpy", max_iter=500, gtol=1e-5, xtol=1e-5)
    found = model.fit(x, y.astype(int))
    share = found.predict_proba(x)[:, 1]
    design = np.column_stack([np.ones(len(x)), x])
    covariance = np.linalg.inv((design * (share * (1 - share))[:, None]).T @ design)
    coefficients = np.append(found.intercept_, found.coef_)
    return _Found(turn @ coefficients, turn @ covariance @ turn.T, float(found.loglik_), None)


def _line(
    a: Floats,
    s: Floats,
    below: Bools,
    above: Bools,
    ends: tuple[float, float, float],
    log_size: bool,
    log_signal: bool,
) -> tuple[Curve, Line]:
    """Fit a line with censored ends by statsmodels' maximum likelihood of one's own likelihood."""
    api = _statsmodels()
    from scipy import special, stats
    from statsmodels.base.model import GenericLikelihoodModel

    between = ~(below | above)
    x, turn = _standard((a, log_size))
    design = api.add_constant(x)
    value = np.where(between, s, 1.0 if log_signal else 0.0)
    noise, threshold, saturation = ends
    if log_signal:
        value = np.log(value)
        with np.errstate(divide="ignore", invalid="ignore"):
            noise, threshold, saturation = np.log(np.array(ends))
    start = api.OLS(value[between], design[between]).fit()
    unit = max(float(np.sqrt(start.scale)), 1e-9 * float(np.ptp(value[between])))

    class Tobit(GenericLikelihoodModel):  # type: ignore[misc]
        def nloglikeobs(self, params: Floats) -> Floats:
            scatter = unit * np.exp(params[2])
            mean = design @ params[:2] * unit
            chance = stats.norm.logpdf(value, mean, scatter)
            if below.any():
                chance[below] = special.log_ndtr((noise - mean[below]) / scatter)
            if above.any():
                chance[above] = special.log_ndtr((mean[above] - saturation) / scatter)
            lost: Floats = -chance
            return lost

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = Tobit(value, design, extra_params_names=["log scatter"])
        first = np.append(start.params / unit, 0.0)
        found = model.fit(first, method="bfgs", maxiter=500, gtol=1e-6, disp=0)
        covariance = np.linalg.inv(-model.hessian(found.params))
    c0, c1 = found.params[:2] * unit
    scatter = float(unit * np.exp(found.params[2]))
    # b = (c0 - threshold, c1) / scatter, and how it changes with the parameters (delta method).
    b = np.array([c0 - threshold, c1]) / scatter
    change = np.array([[unit / scatter, 0, -b[0]], [0, unit / scatter, -b[1]]])
    (b0, b1), v = turn @ b, turn @ change @ covariance @ change.T @ turn.T
    aic = 2 * 3 - 2 * float(found.llf) + 2 * log_signal * float(value[between].sum())
    method = f"{'log ' * log_signal}signal over {'log ' * log_size}size"
    curve = Curve("probit", log_size, float(b0), float(b1), v, method, aic, len(a))
    intercept, slope = map(float, turn @ np.array([c0, c1]))
    count = int(below.sum()), int(above.sum())
    return curve, Line(log_size, log_signal, intercept, slope, scatter, *ends, *count)
