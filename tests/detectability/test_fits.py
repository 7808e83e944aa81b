"""Curves of detection: published answers, likelihoods maximised anew, bounds that hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from documents import CHECKOUT
from scipy import optimize, stats

from gpuspec.detectability.fits import MODELS, fit_hits, fit_signals
from gpuspec.detectability.measured import read_trials
from gpuspec.detectability.verdict import verdict
from gpuspec.detection.chances import (
    greatest_mean,
    greatest_share,
    least_share,
    trials_all_hit,
)
from gpuspec.errors import TrialsError

PUBLISHED = next(
    (
        path
        for above in CHECKOUT.parents
        for path in [above / "shared" / "measured" / "pod" / "hit_miss.csv"]
        if path.exists()
    ),
    Path("hit_miss.csv"),
)
PUBLISHED_TO = 1e-5
"""To which the published sizes are to be met."""
LIKELIEST_TO = 1e-4
"""Relative, of coefficients that another optimiser finds: it stops at a flat top."""
Z = 1.6448536


def hit_miss(trials: int = 300, seed: int = 3):
    random = np.random.default_rng(seed)
    size = random.uniform(0.1, 1.0, trials)
    return size, random.random(trials) < stats.logistic.cdf(12 * (size - 0.45))


@pytest.mark.skipif(not PUBLISHED.exists(), reason="the published trials are not here")
def test_the_published_sizes_come_out():
    size, hit = read_trials(PUBLISHED)
    curve = fit_hits(size, hit == 1, "logit")
    assert abs(curve.size(0.5) - 0.261167) < PUBLISHED_TO
    assert abs(curve.size(0.9) - 0.309664) < PUBLISHED_TO
    assert abs(curve.bound_size(0.9) - 0.381497) < PUBLISHED_TO
    assert abs(curve.intercept + 11.83265) < PUBLISHED_TO
    assert abs(curve.slope - 45.30678) < PUBLISHED_TO
    assert abs(curve.aic - 28.4567) < 5e-5
    # By least AIC another model is taken, whose criterion is less.
    assert fit_hits(size, hit == 1).aic < curve.aic


@pytest.mark.parametrize("model", MODELS[1:])
def test_a_curve_is_the_likeliest_one(model):
    size, hit = hit_miss()
    x = np.log(size) if model.endswith("log") else size
    share = stats.logistic.cdf if model.startswith("logit") else stats.norm.cdf

    def unlikely(b):
        return -np.log(share(np.where(hit, 1, -1) * (b[0] + b[1] * x))).sum()

    best = optimize.minimize(unlikely, (0.0, 1.0), method="Nelder-Mead",
                             options={"xatol": 1e-9, "fatol": 1e-11, "maxiter": 4000})  # fmt: skip
    curve = fit_hits(size, hit, model)
    assert (curve.intercept, curve.slope) == pytest.approx(best.x, rel=LIKELIEST_TO)
    assert curve.aic == pytest.approx(4 + 2 * best.fun, rel=1e-8)


def test_the_bound_is_of_the_likelihoods_curvature():
    size, hit = hit_miss()
    curve = fit_hits(size, hit, "logit")
    share = curve.pod(size)
    design = np.stack([np.ones_like(size), size])
    inverse = np.linalg.inv((design * share * (1 - share)) @ design.T)
    assert curve.covariance == pytest.approx(inverse, rel=1e-6)
    at = curve.bound_size(0.9)
    v = np.array([1, at])
    line = curve.intercept + curve.slope * at - Z * np.sqrt(v @ inverse @ v)
    assert stats.logistic.cdf(line) == pytest.approx(0.9, abs=1e-6)
    assert curve.bound(at) == pytest.approx(0.9, abs=1e-6)
    assert curve.size(0.9) < at


def test_the_least_aic_is_taken():
    size, hit = hit_miss()
    assert fit_hits(size, hit).aic == min(fit_hits(size, hit, m).aic for m in MODELS[1:])


def test_bounds_hold_as_often_as_they_say():
    # Of 200 sets a bound of 95 % fails 10 times on average; 20 would be three deviations more.
    true = 0.45 + np.log(9) / 12
    low = 0
    for seed in range(200):
        curve = fit_hits(*hit_miss(120, seed), "logit")
        low += (curve.bound_size(0.9) or np.inf) < true
    assert 2 <= low <= 20


def test_separated_trials_have_firths_curve():
    size = np.linspace(0.1, 1.0, 30)
    hit = size > 0.52
    curve = fit_hits(size, hit, "logit")
    assert "Firth" in curve.method and curve.aic is None
    # The likelihood times the root of its information's determinant is greatest there.
    design = np.stack([np.ones_like(size), size])

    def unlikely(b):
        share = stats.logistic.cdf(b @ design)
        information = (design * share * (1 - share)) @ design.T
        return -(np.log(np.where(hit, share, 1 - share)).sum()
                 + np.linalg.slogdet(information)[1] / 2)  # fmt: skip

    best = optimize.minimize(unlikely, (-10, 20), method="Nelder-Mead",
                             options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000})  # fmt: skip
    assert (curve.intercept, curve.slope) == pytest.approx(best.x, rel=1e-3)
    assert 0.5 < curve.size(0.5) < 0.54 < curve.size(0.9) < curve.bound_size(0.9)


def signals(trials=400, seed=5):
    random = np.random.default_rng(seed)
    size = random.uniform(1, 10, trials)
    return size, 3 * size + 2 * random.normal(size=trials)


def test_signals_censored_at_both_ends_give_the_line_they_are_of():
    size, signal = signals()
    clipped = np.clip(signal, 9, 24)
    curve, line = fit_signals(size, clipped, threshold=14, noise=9, saturation=24)
    assert (line.below, line.above) == ((signal <= 9).sum(), (signal >= 24).sum())
    assert line.slope == pytest.approx(3, abs=0.2)
    assert line.scatter == pytest.approx(2, abs=0.2)
    assert curve.size(0.9) == pytest.approx((14 + stats.norm.ppf(0.9) * 2) / 3, abs=0.15)
    assert curve.size(0.9) < curve.bound_size(0.9) < curve.size(0.9) + 0.4
    # Taken for what they are not, signals at the ends bend the line.
    _, taken = fit_signals(size, clipped, threshold=14)
    assert taken.slope < 0.9 * line.slope


def test_the_censored_line_is_the_likeliest_one():
    size, signal = signals()
    s = np.clip(signal, 9, 24)
    curve, line = fit_signals(size, s, 14, 9, 24)
    assert not line.log_size and not line.log_signal

    def unlikely(p):
        mean, scatter = p[0] + p[1] * size, np.exp(p[2])
        return -np.where(
            s <= 9, stats.norm.logcdf(9, mean, scatter),
            np.where(s >= 24, stats.norm.logsf(24, mean, scatter),
                     stats.norm.logpdf(s, mean, scatter)),
        ).sum()  # fmt: skip

    best = optimize.minimize(unlikely, (0, 3, 0.5), method="Nelder-Mead",
                             options={"xatol": 1e-9, "fatol": 1e-11, "maxiter": 4000})  # fmt: skip
    found = line.intercept, line.slope, np.log(line.scatter)
    assert found == pytest.approx(best.x, rel=1e-3, abs=1e-3)
    assert curve.aic == pytest.approx(6 + 2 * best.fun, rel=1e-6)


def test_signals_and_hits_of_one_station_agree():
    size, signal = signals(3000)
    by_signals, _ = fit_signals(size, signal, 14)
    by_hits = fit_hits(size, signal > 14)
    assert by_signals.size(0.9) == pytest.approx(by_hits.size(0.9), abs=0.15)
    # A signal tells more than a hit: its bound is nearer.
    assert by_signals.bound_size() - by_signals.size(0.9) < by_hits.bound_size() - by_hits.size(0.9)


def test_bounds_of_counts_are_exact():
    assert least_share(28, 28) < 0.9 <= least_share(29, 29)
    assert trials_all_hit() == 29
    for hits, trials in ((0, 5), (3, 10), (57, 60)):
        at = least_share(hits, trials)
        assert hits == 0 or stats.binom.sf(hits - 1, trials, at) == pytest.approx(0.05)
        at = greatest_share(hits, trials)
        assert stats.binom.cdf(hits, trials, at) == pytest.approx(0.05)
    for events in (0, 1, 12):
        assert stats.poisson.cdf(events, greatest_mean(events)) == pytest.approx(0.05)


def test_what_tells_of_no_curve_is_refused():
    size, hit = hit_miss()
    for arguments, said in (
        ((np.full(9, 0.5), np.arange(9) > 4), "have the size 0.5"),
        ((size, np.full(300, True)), "both needed"),
        ((size, hit[1:]), "300 sizes and 299 outcomes"),
        ((np.append(size[1:], np.nan), hit), "not a finite number"),
        ((size - 0.2, hit, "logit-log"), "logarithm"),
        ((size, hit, "cubic"), "no model"),
    ):
        with pytest.raises(TrialsError, match=said):
            fit_hits(*arguments)
    with pytest.raises(TrialsError, match="above the noise"):
        fit_signals(size, size, threshold=1, noise=2)
    with pytest.raises(TrialsError, match="between noise and saturation"):
        fit_signals(size, np.full(300, 9.0), threshold=5, noise=2, saturation=8)


def judged(size, hit):
    curve = None if hit.all() or not hit.any() else fit_hits(size, hit)
    return verdict(size, hit, curve, "mm")


def test_a_verdict_says_where_no_curve_applies():
    size, hit = hit_miss()
    assert judged(size, hit).applies
    for trials, more, said in ((20, 9, "9 more"), (29, 0, "90/95"), (40, 0, "90/95")):
        found = judged(size[:trials], np.full(trials, True))
        assert (found.applies, found.more) == (False, more)
        assert said in found.said[0]
    none = judged(size, np.full(300, False))
    assert not none.applies and none.more is None and "larger" in none.said[0]
    even = judged(size, np.arange(300) % 2 == np.digitize(size, [0.02 * k for k in range(50)]) % 2)
    assert not even.applies
    assert "dependence on size" in even.said[0] or "no more often" in even.said[0]
    assert "no more often" in judged(size, ~hit).said[0]
    small = size < 0.5
    beyond = judged(size[small], hit[small])
    assert not beyond.applies and "beyond the largest size" in " ".join(beyond.said)


def test_as_many_more_trials_as_a_verdict_asks_for_settle_it():
    size, hit = hit_miss(60)
    found = judged(size, hit)
    assert found.more > 0 and "more such trials" in found.said[-1]
    times = 1 + found.more / 60
    curve = fit_hits(size, hit)
    again = fit_hits(np.repeat(size, 20), np.repeat(hit, 20))  # 20 times the same: s falls by 20^.5
    near = again.trials_for(1.1 * again.size(0.9))
    assert near == pytest.approx(60 * times, rel=0.01)
    assert curve.trials_for(1.1 * curve.size(0.9)) == near


def test_a_curve_that_leaves_its_trials_is_said():
    # A third of all is never found, however large: no curve that rises to 1 says so.
    random = np.random.default_rng(2)
    size = random.uniform(0.1, 1.0, 2000)
    hit = (size > 0.3) & (random.random(2000) < 0.67)
    assert "does not follow" in " ".join(judged(size, hit).said)
    assert "does not follow" not in " ".join(judged(*hit_miss(2000)).said)


def test_tables_of_trials_are_read_or_refused(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text("y, x\n1,0.4\n0,0.2\n", "utf-8-sig")
    x, y = read_trials(file)
    assert (x.tolist(), y.tolist()) == ([0.4, 0.2], [1, 0])
    for text, said in (
        ("a,b\n1,2\n", "has the columns a, b"), ("", "(none)"), ("x,y\n1,one\n2,0\n", "row 2"),
        ("x,y\n1,1\n2\n", "row 3"), ("x,y\n1,1\n2,nan\n", "finite"), ("x,y\n1,1\n", "1 trials"),
    ):  # fmt: skip
        file.write_text(text)
        with pytest.raises(TrialsError, match=said.replace("(", r"\(").replace(")", r"\)")):
            read_trials(file)
    with pytest.raises(TrialsError, match="cannot be read"):
        read_trials(tmp_path / "none.csv")
