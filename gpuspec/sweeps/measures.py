"""What a design can be chosen by: the names of its scores and costs, and which way is better."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from gpuspec import words
from gpuspec.errors import StationError


@dataclass(frozen=True)
class Measure:
    """One score or cost.

    Attributes
    ----------
    name : str
    said : str
        What it is, as an axis says it.
    unit : str
    high : bool
        Whether more is better.
    digits : int
        As it is printed, after the point.
    """

    name: str
    said: str
    unit: str = ""
    high: bool = True
    digits: int = 0

    @property
    def axis(self) -> str:
        """Label of an axis: name, unit, and which way is better."""
        unit = f", {self.unit}" if self.unit else ""
        return f"{self.said}{unit}; {'more' if self.high else 'less'} is better"

    def shown(self, value: float) -> str:
        """Return a value as it is printed, with its unit."""
        return f"{value:,.{self.digits}f}{' ' if self.unit else ''}{self.unit}"


_KNOWN = (
    Measure("p1", words.P1, digits=4),
    Measure("p2", words.P2, digits=4),
    Measure("f1", words.F1, digits=4),
    Measure("hits", "defects hit"),
    Measure("hits.dent", "dents hit"),
    Measure("hits.bump", "bumps hit"),
    Measure("hits.scratch", "scratches hit"),
    Measure("hits.measured", "measured defects hit"),
    Measure("hits.pit", "pits hit"),
    Measure("worst_hits", "defects hit on the worst part or draw"),
    Measure("worst_p2", f"{words.P2} on the worst part or draw", digits=4),
    Measure("sure_hit_share", "share of defects hit, with 95 % confidence", digits=4),
    Measure("false_px", "false pixels beyond the guard bands", high=False),
    Measure("false_blobs", "false blobs beyond the guard bands", high=False),
    Measure("margin_dn", "margin", "DN", digits=1),
    Measure("margin_sigma", "margin", "sigmas of noise", digits=1),
    Measure("noise_dn", "noise of the flawless surface", "DN", high=False, digits=3),
    Measure("smallest_mm", "smallest defect found for certain", "mm", high=False, digits=3),
    Measure("images", "images", high=False),
    Measure("tunnel_mm", "length of the tunnel", "mm", high=False),
    Measure("light_e", "light per image", "e⁻", high=False),
    Measure("exposure_s", "exposure time", "s", high=False, digits=4),
    Measure("cycle_s", "time per part", "s", high=False, digits=2),
)
MEASURES = {measure.name: measure for measure in _KNOWN}
"""By name."""

NEEDS = {
    "exposure_s": "sensor.light_e_per_s",
    "cycle_s": "sequence.frame_rate_hz or sensor.light_e_per_s",
}
"""Keys of the station from which a measure follows, where it is not always known."""


def measure(name: str) -> Measure:
    """Return a measure by its name.

    Raises
    ------
    StationError
        If there is none, with the nearest.

    Examples
    --------
    >>> from gpuspec.sweeps.measures import measure
    >>> measure("margin_sigma").high
    True
    >>> measure("margin_sigmas")
    Traceback (most recent call last):
        ...
    gpuspec.errors.StationError: there is no 'margin_sigmas' to choose by; did you mean
        margin_sigma?
    """
    if name in MEASURES:
        return MEASURES[name]
    if name in ("a50", "a90", "a90_95"):
        raise StationError(
            f"{name} is fitted to many random parts: gpuspec pod STATION --vary KEY=FROM:TO:COUNT "
            f"finds the station with the smallest a90/95."
        )
    close = difflib.get_close_matches(name, MEASURES, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(MEASURES)}."
    raise StationError(f"there is no {name!r} to choose by; {hint}")


def check_kinds(names: Iterable[str], there: Collection[str]) -> None:
    """See that there are defects of the kinds whose hits are counted.

    Parameters
    ----------
    names : iterable of str
        Of measures.
    there : collection of str
        Of those ``hits.KIND`` of which there is a defect.

    Raises
    ------
    StationError
        If there is none: all of none are hit by any station.
    """
    for name in names:
        if name.startswith("hits.") and name not in there:
            what = MEASURES[name].said.removesuffix(" hit")
            known = ", ".join(m for m in MEASURES if m == "hits" or m in there)
            raise StationError(
                f"there are no {what} on the part, so that {name} tells nothing; there are {known}."
            )
