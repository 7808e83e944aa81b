"""Which design to try next: Optuna's sampler explores, steps from the best one refine."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import optuna

from gpuspec.sweeps.axes import Axis
from gpuspec.sweeps.rule import Rule

optuna.logging.set_verbosity(optuna.logging.ERROR)

Values = dict[str, float | int]

EXPLORED_FIRST = 24
"""Trials before the first step; the earlier half of them at random."""

_EXPLORED_THEN = 4  # after them, every fourth trial explores and the others are steps

# Steps in shares of the bounds' distance: the first, the least and the greatest; what a step that
# found something better, and one that did not, makes of the next. Of eight settings, the one that
# reached the known optimum of `tests/test_optimise.py` most often.
_STEP, _STEP_MIN, _STEP_MAX = 0.3, 1e-3, 0.5
_LONGER, _SHORTER = 1.5, 0.9
_MOVED = 0.6  # chance of each key to be moved by a step


@dataclass(frozen=True)
class Trial:
    """A design that was tried, at its best threshold.

    Attributes
    ----------
    values : dict
        Keys and their values.
    step : bool
        Whether it was a step from the best one; else the sampler's choice.
    reason : str or None
        Why it is no valid station; then the rest is 0.
    threshold_dn, p1, p2 : float
    hits, defects : int
        Defects hit, and those with a pixel in view.
    notes : str or None
        What to know before trusting it, a line each.
    """

    values: Values
    step: bool
    reason: str | None = None
    threshold_dn: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    hits: int = 0
    defects: int = 0
    notes: str | None = None


def best_of(trials: Sequence[Trial], rule: Rule) -> int | None:
    """Return the number of the best trial by the rule, None if none is valid.

    Parameters
    ----------
    trials : sequence of Trial
    rule : Rule
    """
    valid = [number for number, trial in enumerate(trials) if trial.reason is None]
    if not valid:
        return None
    found = [[getattr(trials[n], name) for n in valid] for name in ("p1", "p2", "hits", "defects")]
    return valid[rule.best(*(np.array(values) for values in found))]


class Search:
    """Chooses trials within bounds.

    What comes next depends on the seed and on the trials so far, and on nothing else: a search
    that was stopped goes on as if it had not been.

    Parameters
    ----------
    axes : sequence of Axis
        Keys with their two ends.
    rule : Rule
    seed : int
    """

    def __init__(self, axes: Sequence[Axis], rule: Rule, seed: int) -> None:
        self.axes = axes
        self.rule = rule
        self.seed = seed
        self.trials: list[Trial] = []
        self.distributions = {a.key: _distribution(*a.values) for a in axes}
        self._study = optuna.create_study(directions=["maximize"] * 2)
        self._best: Trial | None = None
        self._step = _STEP

    def add(self, trial: Trial) -> None:
        """Learn from a trial."""
        self._study.add_trial(self.frozen(trial))
        self.trials.append(trial)
        pair = [trial] if self._best is None else [self._best, trial]
        if best_of(pair, self.rule) == len(pair) - 1:
            self._best = trial
            self._step = min(self._step * _LONGER, _STEP_MAX) if trial.step else _STEP
        elif trial.step:
            self._step = max(self._step * _SHORTER, _STEP_MIN)

    def propose(self) -> tuple[Values, bool]:
        """Return the next design's values, and whether it is a step from the best one."""
        number = len(self.trials)
        random = np.random.default_rng([self.seed, number])
        if self._best is not None and number >= EXPLORED_FIRST and number % _EXPLORED_THEN:
            return self._stepped(self._best, random), True
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            self._study.sampler = optuna.samplers.TPESampler(
                n_startup_trials=EXPLORED_FIRST // 2,
                multivariate=True,
                seed=int(random.integers(2**32)),
            )
        asked = self._study.ask(self.distributions)
        self._study.tell(asked, state=optuna.trial.TrialState.FAIL)  # `add` brings what comes of it
        return dict(asked.params), False

    def frozen(self, trial: Trial) -> optuna.trial.FrozenTrial:
        """Return a trial as Optuna stores it, to be maximised in P1 and P2."""
        told = {name: value for name, value in vars(trial).items() if name != "values"}
        state = optuna.trial.TrialState
        return optuna.create_trial(
            params=trial.values,
            distributions=self.distributions,
            values=None if trial.reason else self.objectives(trial),
            state=state.FAIL if trial.reason else state.COMPLETE,
            user_attrs=told,
        )

    def objectives(self, trial: Trial) -> list[float]:
        """Return what Optuna is to make high."""
        return [trial.p1, trial.p2]

    def _stepped(self, best: Trial, random: np.random.Generator) -> Values:
        moved = random.random(len(self.axes)) < _MOVED
        moved[random.integers(len(self.axes))] = True
        steps = self._step * moved * random.standard_normal(len(self.axes))
        found: Values = {}
        for a, step in zip(self.axes, steps, strict=True):
            low, high = a.values
            value = min(max(best.values[a.key] + step * (high - low), low), high)
            found[a.key] = round(value) if isinstance(low, int) else float(value)
        return found


def _distribution(low: float | int, high: float | int) -> optuna.distributions.BaseDistribution:
    if isinstance(low, int) and isinstance(high, int):
        return optuna.distributions.IntDistribution(low, high)
    return optuna.distributions.FloatDistribution(low, high)
