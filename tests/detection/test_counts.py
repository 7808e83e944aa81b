"""A share of two counts against drawn events, from next to none to some hundred."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.detection import counts
from gpuspec.detection.counts import Count, share_of

DRAWS = 8000
SIGMAS = 4.0  # of some hundred comparisons none is as far off by chance
LEADING = 2e-4, 0.01  # what the leading orders leave out of a share and, relatively, its deviation


def chances(rng: np.random.Generator, events: int, mean: float, power: int) -> np.ndarray:
    """Probabilities of some events, of which so many are expected."""
    some = rng.random(events) ** power
    return np.minimum(some * mean / some.sum(), 1.0)


@pytest.mark.parametrize("power", [1, 8])  # all alike, or a few that are likely
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.95])
@pytest.mark.parametrize("expected", [0.01, 0.3, 1.0, 3.0, 30.0, 250.0])
def test_mean_and_spread_are_those_of_drawn_counts(expected, share, power):
    rng = np.random.default_rng(int(1000 * expected) + power)
    some = chances(rng, 300, expected * share, power)
    others = chances(rng, 400, expected * (1 - share), power)
    one, two = (
        sum((rng.random(DRAWS) < p).astype(np.int64) for p in events) for events in (some, others)
    )
    drawn = np.where(one + two > 0, one / np.maximum(one + two, 1), 1.0)
    mean, deviation = share_of(Count.of(some), Count.of(others))
    assert 0 <= mean <= 1
    assert deviation <= 0.5
    assert abs(drawn.mean() - mean) <= SIGMAS * deviation / DRAWS**0.5
    # The variance's own spread, of fourth moments.
    squares = (drawn - mean) ** 2
    assert abs(squares.mean() - deviation**2) <= SIGMAS * max(squares.std(), 1e-3) / DRAWS**0.5


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_many_events_are_told_alike_by_integrals_and_by_the_leading_orders(monkeypatch, share):
    rng = np.random.default_rng(7)
    some, others = (
        Count.of(chances(rng, 5000, counts._MANY * part, 3)) for part in (share, 1 - share)
    )
    told = []
    for many in (0.0, np.inf):
        monkeypatch.setattr(counts, "_MANY", many)
        told.append(share_of(some, others))
    (leading, spread), (exact, deviation) = told
    assert leading == pytest.approx(exact, abs=LEADING[0])
    assert spread == pytest.approx(deviation, rel=LEADING[1])


def test_events_that_are_sure_have_no_spread():
    sure, none = Count.of(np.ones(3)), Count.of(np.zeros(0))
    assert share_of(sure, Count.of(np.ones(1))) == (0.75, 0.0)
    assert share_of(sure, none) == (1.0, 0.0)
    assert share_of(none, none) == (1.0, 0.0)
    assert share_of(none, sure) == (0.0, 0.0)


def test_a_few_sure_events_among_rare_ones_are_kept():
    # Two are always there, a third once in two times: two thirds or the whole.
    mean, deviation = share_of(Count.of(np.ones(2)), Count.of(np.array([0.5])))
    assert mean == pytest.approx(5 / 6)
    assert deviation == pytest.approx(1 / 6)
