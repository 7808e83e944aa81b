"""From blobs and classes to what a line asks for: whether the part is accepted, and why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpuspec.detection.classes import UNCLASSIFIED
from gpuspec.detection.inspection import class_rules
from gpuspec.detection.measures import Blobs
from gpuspec.errors import StationError
from gpuspec.station.sections import RejectRule
from gpuspec.station.station import Station

EVERY_BLOB = (RejectRule(),)
"""What holds where a station has no rule: a part is rejected for any blob."""


@dataclass(frozen=True)
class Decision:
    """Whether a part is accepted.

    Attributes
    ----------
    accepted : bool
    reasons : tuple of str
        Why it is not, a sentence for each rule that it breaks.
    blobs : tuple of int
        Labels of the blobs because of which it is not.
    """

    accepted: bool
    reasons: tuple[str, ...] = ()
    blobs: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"Decision({self})"

    def __str__(self) -> str:
        return "accept" if self.accepted else f"reject: {'; '.join(self.reasons)}"


def decision_rules(station: Station) -> tuple[RejectRule, ...]:
    """Return the station's rules of decision, each of a class that there is.

    Raises
    ------
    StationError
        If a rule names a class that no blob can have: it would never reject a part.
    """
    names = {rule.name for rule in class_rules(station)} | {UNCLASSIFIED}
    for number, rule in enumerate(station.decision, 1):
        if rule.of is not None and rule.of not in names:
            raise StationError(
                f"{station.file}: decision[{number}].of = {rule.of!r} is no class of blobs, so no "
                f"part would be rejected for it; classes: {', '.join(sorted(names))}."
            )
    return station.decision


def decide(
    blobs: Blobs, classes: npt.NDArray[np.str_], rules: tuple[RejectRule, ...] = ()
) -> Decision:
    """Accept or reject a part by its blobs.

    Parameters
    ----------
    blobs : Blobs
        Table of n blobs.
    classes : (n,) str array
    rules : tuple of RejectRule
        A station's ``decision``; none: every blob is a reason.

    Returns
    -------
    Decision

    Examples
    --------
    >>> from gpuspec.detection.decision import decide
    >>> from gpuspec.detection.measures import measure_blobs
    >>> from gpuspec.station.sections import RejectRule
    >>> labels = np.array([[1, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 2]])
    >>> blobs = measure_blobs(labels, 80.0 * (labels > 0), sampling_mm=0.1, flawless_dn=60.0)
    >>> classes = np.array(["scratch", "dent or bump"])
    >>> decide(blobs, classes, (RejectRule(of="scratch", length_min_mm=0.4),))
    Decision(reject: 1 scratch of at least 0.4 mm, 0 allowed)
    >>> decide(blobs, classes, (RejectRule(count_max=2),))
    Decision(accept)
    """
    reasons: list[str] = []
    guilty: set[int] = set()
    for rule in rules or EVERY_BLOB:
        chosen = np.ones(len(blobs), np.bool_) if rule.of is None else classes == rule.of
        for values, least in (
            (blobs.area_mm2, rule.area_min_mm2),
            (blobs.major_mm, rule.length_min_mm),
            (blobs.net_weight_dn, rule.weight_min_dn),
        ):
            if least is not None:
                chosen = chosen & (values >= least * (1 - _ROUNDING))
        count, total = int(chosen.sum()), float(blobs.area_mm2[chosen].sum())
        most = rule.count_max
        if most is None and rule.total_area_max_mm2 is None:
            most = 0
        said = []
        if most is not None and count > most:
            said.append(f"{count:,} {_such(rule, count)}, {most:,} allowed")
        if rule.total_area_max_mm2 is not None and total > rule.total_area_max_mm2:
            allowed = rule.total_area_max_mm2
            said.append(f"{total:.4g} mm² of {_such(rule, 2)}, {allowed:g} mm² allowed")
        if said:
            reasons += said
            guilty.update(blobs.label[chosen].tolist())
    return Decision(not reasons, tuple(reasons), tuple(sorted(guilty)))


_ROUNDING = 1e-9  # relative: areas are sums of squares of the sampling distance


def _such(rule: RejectRule, count: int) -> str:
    """Return the blobs of a rule in words."""
    name = rule.of or ("blob" if count == 1 else "blobs")
    bounds = [
        f"{value:g} {unit}"
        for value, unit in (
            (rule.area_min_mm2, "mm²"),
            (rule.length_min_mm, "mm"),
            (rule.weight_min_dn, "DN"),
        )
        if value is not None
    ]
    return f"{name} of at least {' and '.join(bounds)}" if bounds else name
