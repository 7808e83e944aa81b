"""What is asked of a station: requirements that it must meet, and what is then to be the best."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import StationError
from gpuspec.sweeps.measures import MEASURES, Measure, measure

Floats = NDArray[np.float64]
Sign = Literal["=", "<=", ">="]
_FORM = re.compile(r"^\s*([\w.]+)\s*(<=|>=|==|=|<|>)\s*(\S+)\s*$")
_SHARES = "p1", "p2", "f1", "worst_p2", "sure_hit_share"
KNOWN: Mapping[str, Any] = {}
"""Of measures that are all known exactly."""

_HOW = 'write NAME = VALUE, NAME >= VALUE or NAME <= VALUE, e.g. "margin_sigma >= 6"'


def is_requirement(text: str) -> bool:
    """Whether a text has a sign between two others, as a requirement does."""
    return bool(re.search(r"[<>=]", text))


@dataclass(frozen=True)
class Requirement:
    """One thing that a station must have.

    Attributes
    ----------
    name : str
        Of a measure.
    sign : "=", "<=" or ">="
    value : float
        Infinite: all defects there are, of ``hits``.

    Examples
    --------
    >>> from gpuspec.sweeps.aim import Requirement
    >>> str(Requirement.of("margin_sigma>=6")), str(Requirement.of("hits = all"))
    ('margin_sigma >= 6', 'hits = all')
    """

    name: str
    sign: Sign
    value: float

    @classmethod
    def of(cls, text: str) -> Requirement:
        """Read one.

        Raises
        ------
        StationError
            If it has another form, or names no measure.
        """
        found = _FORM.match(text)
        if not found:
            raise StationError(f"the requirement {text!r} cannot be read; {_HOW}.")
        name, sign, value = found.groups()
        measure(name)
        if sign in ("<", ">"):
            raise StationError(f"the requirement {text!r} has {sign}; {_HOW}.")
        if value == "all" and name.startswith("hits"):
            return cls(name, ">=" if sign == ">=" else "=", math.inf)
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise StationError(f"the requirement {text!r}: {value} is no number; {_HOW}.")
        if name in _SHARES and not 0 <= number <= 1:
            raise StationError(f"the requirement {text!r} cannot be met: {name} is from 0 to 1.")
        return cls(name, cast(Sign, sign.replace("==", "=")), number)

    @property
    def measure(self) -> Measure:
        """What is required."""
        return MEASURES[self.name]

    def short_of(self, values: Any, most: Any, span: tuple[Any, Any] | None = None) -> Floats:
        """Return by how much values miss what is required, 0 where they do not.

        As a share of what is required, so that shortfalls of different things compare.

        Parameters
        ----------
        values : array
            Of the measure; NaN: not known, which misses it by 1.
        most : array
            What ``all`` is, of a shape that broadcasts.
        span : two arrays, optional
            Between which the values are, where they are not known exactly: by what of that is the
            nearest to what is required.
        """
        wanted = most if math.isinf(self.value) else self.value
        if span is not None:
            values = np.clip(wanted, *span)
        more, less = np.maximum(wanted - values, 0), np.maximum(values - wanted, 0)
        missing = {"=": more + less, ">=": more, "<=": less}[self.sign]
        share: Floats = missing / np.maximum(np.abs(wanted), 1.0)
        return np.where(np.isnan(share), 1.0, share)

    def __str__(self) -> str:
        return f"{self.name} {self.sign} {'all' if math.isinf(self.value) else f'{self.value:g}'}"


@dataclass(frozen=True)
class Aim:
    """What a station must have, and what is then to be the best.

    Of what is equally good that with the larger margin is taken, then that with fewer images, and
    of its thresholds that in the middle between the flawless surface and the faintest defect.

    Attributes
    ----------
    goal : str
        Name of a measure.
    require : tuple of Requirement
        Or their texts.

    Examples
    --------
    >>> aim = gpuspec.Aim("margin_dn", ["hits = all", "false_blobs = 0", "images <= 16"])
    >>> print(aim)
    hits = all, false_blobs = 0, images <= 16, then the most margin_dn
    >>> gpuspec.Aim("images", ["images <= 16", "images >= 20"])
    Traceback (most recent call last):
        ...
    gpuspec.errors.StationError: images >= 20 contradicts images <= 16: no station can meet
        both; drop one of them.
    """

    goal: str = "margin_dn"
    require: tuple[Requirement, ...] = ()

    def __post_init__(self) -> None:
        measure(self.goal)
        given = [self.require] if isinstance(self.require, str) else self.require
        found = tuple(r if isinstance(r, Requirement) else Requirement.of(r) for r in given)
        object.__setattr__(self, "require", found)
        for number, one in enumerate(found):
            for other in found[:number]:
                if _contradict(one, other):
                    raise StationError(
                        f"{one} contradicts {other}: no station can meet both; drop one of them."
                    )

    @property
    def names(self) -> tuple[str, ...]:
        """The measures it looks at, each once."""
        return tuple(dict.fromkeys([self.goal, *(r.name for r in self.require)]))

    def shortfalls(
        self, values: Mapping[str, Any], all_of: Mapping[str, Any], spans: Mapping[str, Any] = KNOWN
    ) -> list[Floats]:
        """Return by how much each requirement is missed, see :meth:`Requirement.short_of`.

        Parameters
        ----------
        values : mapping of str to array
            By the name of the measure.
        all_of : mapping of str to array
            What ``all`` means of some of them.
        spans : mapping of str to two arrays
            Between which some of them are, that are not known exactly.
        """
        return [
            r.short_of(values[r.name], all_of.get(r.name, math.nan), spans.get(r.name))
            for r in self.require
        ]

    @property
    def least_hits(self) -> int | None:
        """How many defects must be hit; None: all, or it is not said by their number alone."""
        of_hits = [r for r in self.require if r.name.split(".")[0] == "hits"]
        least = max((r.value for r in of_hits if r.sign != "<="), default=math.inf)
        by_kind = any(r.name != "hits" for r in of_hits)
        return None if by_kind or math.isinf(least) else math.ceil(least)

    def order(
        self, values: Mapping[str, Any], all_of: Mapping[str, Any], spans: Mapping[str, Any] = KNOWN
    ) -> list[Floats]:
        """Return what is to be high, one after another, of points of any shape.

        Parameters
        ----------
        values : mapping of str to array
            By the name of the measure; both margins, ``images`` and ``room`` among them, the last
            the thresholds between a point's own and the nearer of flawless surface and defect.
        all_of : mapping of str to array
            What ``all`` is of each of the ``hits``.
        spans : mapping of str to two arrays
            See :meth:`shortfalls`.
        """
        missed = self.shortfalls(values, all_of, spans)
        unmet = sum((m > 0).astype(np.float64) for m in missed) if missed else 0.0
        goal = np.asarray(values[self.goal], np.float64)
        goal = goal if MEASURES[self.goal].high else -goal
        return [
            -np.asarray(unmet, np.float64),
            -np.asarray(sum(missed) if missed else 0.0, np.float64),
            np.where(np.isnan(goal), -np.inf, goal),
            np.nan_to_num(values["margin_dn"], nan=-np.inf),
            np.nan_to_num(values["margin_sigma"], nan=-np.inf),
            -np.asarray(values["images"], np.float64),
            np.asarray(values["room"], np.float64),
        ]

    def __str__(self) -> str:
        way = "most" if MEASURES[self.goal].high else "least"
        return ", ".join([*map(str, self.require), f"then the {way} {self.goal}"])


def _contradict(one: Requirement, other: Requirement) -> bool:
    """Whether two requirements of one measure leave nothing between them."""
    if one.name != other.name:
        return False

    def ends(r: Requirement) -> tuple[float, float]:
        return (
            -math.inf if r.sign == "<=" else r.value,
            math.inf if r.sign == ">=" else r.value,
        )

    (low, high), (least, most) = ends(one), ends(other)
    return max(low, least) > min(high, most)


def best_of(order: Sequence[Floats], axis: int = -1) -> NDArray[np.intp]:
    """Return where along an axis is the best by an :meth:`Aim.order`, the first of equals.

    Parameters
    ----------
    order : sequence of ndarray
        Of shapes that broadcast.
    axis : int
    """
    every = np.broadcast_arrays(*order)
    left = np.ones(every[0].shape, np.bool_)
    for criterion in every:
        value = np.where(left, criterion, -np.inf)
        left &= value == value.max(axis=axis, keepdims=True)
    found: NDArray[np.intp] = left.argmax(axis=axis)
    return found
