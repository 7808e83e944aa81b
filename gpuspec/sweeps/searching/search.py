"""Which design to try next: Optuna's sampler explores, steps from the best one refine."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import optuna

from gpuspec.sweeps.aim import Aim
from gpuspec.sweeps.aim import best_of as best_by
from gpuspec.sweeps.axes import Axis
from gpuspec.sweeps.measures import MEASURES
from gpuspec.sweeps.rule import Rule

optuna.logging.set_verbosity(optuna.logging.ERROR)

Values = dict[str, Any]

EXPLORED_FIRST = 24
"""Trials before the first step; the earlier half of them at random."""

_EXPLORED_THEN = 4  # after them, every fourth trial explores and the others are steps

# Steps in shares of the bounds' distance: the first, the least and the greatest; what a step that
# found something better, and one that did not, makes of the next. Of eight settings, the one that
# reached the known optimum of `tests/sweeps/test_optimise.py` most often.
_STEP, _STEP_MIN, _STEP_MAX = 0.3, 1e-3, 0.5
_LONGER, _SHORTER = 1.5, 0.9
_MOVED = 0.6  # chance of each key to be moved by a step
_SWITCHED = 0.3  # chance of each choice to be made anew by it
# Optuna 5 reads what `frozen` says of them; earlier ones only where there is such a function.
_BY_FUNCTION = not hasattr(optuna.trial.FrozenTrial, "set_constraint")
_WORST = -1e300  # of a goal that is no number


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
    measures : dict of str to float or None
        What an aim looks at, by name, and how many defects there are of each of its ``hits``.
    missed : list of float
        By how much each of an aim's requirements is missed.
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
    measures: dict[str, float | None] = field(default_factory=dict)
    missed: list[float] = field(default_factory=list)


def best_of(trials: Sequence[Trial], rule: Rule | Aim) -> int | None:
    """Return the number of the best trial by the rule, None if none is valid.

    Parameters
    ----------
    trials : sequence of Trial
    rule : Rule or Aim
    """
    valid = [number for number, trial in enumerate(trials) if trial.reason is None]
    if not valid:
        return None
    if isinstance(rule, Aim):
        told = [trials[n].measures for n in valid]
        # As JSON keeps them: what is no number is none.
        values = {
            name: np.array([np.nan if one[name] is None else one[name] for one in told], float)
            for name in told[0]
        }
        all_of = {name[4:]: own.max() for name, own in values.items() if name.startswith("all ")}
        return valid[int(best_by(rule.order(values, all_of)))]
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
    rule : Rule or Aim
    seed : int
    choices : mapping of str to tuple, optional
        Keys that take one of some values, and these.
    """

    def __init__(
        self,
        axes: Sequence[Axis],
        rule: Rule | Aim,
        seed: int,
        choices: Mapping[str, tuple[Any, ...]] | None = None,
    ) -> None:
        self.choices = dict(choices or {})
        self.axes = axes
        self.rule = rule
        self.seed = seed
        self.trials: list[Trial] = []
        self.distributions = {a.key: _distribution(*a.values) for a in axes} | {
            key: optuna.distributions.CategoricalDistribution(values)
            for key, values in self.choices.items()
        }
        self._study = optuna.create_study(directions=directions(rule))
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
                constraints_func=_missed if isinstance(self.rule, Aim) and _BY_FUNCTION else None,
            )
        asked = self._study.ask(self.distributions)
        self._study.tell(asked, state=optuna.trial.TrialState.FAIL)  # `add` brings what comes of it
        return dict(asked.params), False

    def frozen(self, trial: Trial) -> optuna.trial.FrozenTrial:
        """Return a trial as Optuna stores it: to be maximised in P1 and P2, or as an aim wants."""
        told = {name: value for name, value in vars(trial).items() if name != "values"}
        state = optuna.trial.TrialState
        return optuna.create_trial(
            params=trial.values,
            distributions=self.distributions,
            values=None if trial.reason else self.objectives(trial),
            state=state.FAIL if trial.reason else state.COMPLETE,
            user_attrs=told,
            system_attrs={"constraints": trial.missed} if isinstance(self.rule, Aim) else None,
        )

    def objectives(self, trial: Trial) -> list[float]:
        """Return what Optuna is to make high."""
        if not isinstance(self.rule, Aim):
            return [trial.p1, trial.p2]
        goal = trial.measures[self.rule.goal]
        return [_WORST if goal is None else goal if MEASURES[self.rule.goal].high else -goal]

    def _stepped(self, best: Trial, random: np.random.Generator) -> Values:
        moved = random.random(len(self.axes)) < _MOVED
        moved[random.integers(len(self.axes))] = True
        steps = self._step * moved * random.standard_normal(len(self.axes))
        found: Values = {}
        for a, step in zip(self.axes, steps, strict=True):
            low, high = a.values
            value = min(max(best.values[a.key] + step * (high - low), low), high)
            found[a.key] = round(value) if isinstance(low, int) else float(value)
        for key, values in self.choices.items():
            found[key] = best.values[key]
            if random.random() < _SWITCHED:
                found[key] = values[random.integers(len(values))]
        return found


def directions(rule: Rule | Aim | None) -> list[Any]:
    """Return Optuna's directions: P1 and P2, or the goal of an aim."""
    return ["maximize"] * (1 if isinstance(rule, Aim) else 2)


def _missed(trial: optuna.trial.FrozenTrial) -> Sequence[float]:
    found: Sequence[float] = trial.user_attrs["missed"]
    return found


def _distribution(low: float | int, high: float | int) -> optuna.distributions.BaseDistribution:
    if isinstance(low, int) and isinstance(high, int):
        return optuna.distributions.IntDistribution(low, high)
    return optuna.distributions.FloatDistribution(low, high)
