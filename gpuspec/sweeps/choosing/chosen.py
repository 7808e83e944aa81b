"""One design chosen at one threshold, and what a choice shows of itself."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from gpuspec.sweeps.choosing.front import Points
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.rule import Rule


@dataclass(frozen=True)
class Chosen:
    """One design at one threshold.

    Attributes
    ----------
    design : int
        Its number.
    values : dict of str to float or int
        The varied keys.
    threshold_dn : float
        The highest of those that detect the same pixels, DN.
    p1, p2, f1 : float
    hits : int
        Defects hit.
    exact : bool
        Whether P1 is that of every pixel, and not the most it may be: always, in a finished sweep.
    """

    design: int
    values: dict[str, float | int]
    threshold_dn: float
    p1: float
    p2: float
    f1: float
    hits: int
    exact: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the attributes as a dict that the json module can write."""
        return asdict(self)


class Choosing(Protocol):
    """A choice, as :class:`gpuspec.sweeps.choosing.choose.Choice` explains it."""

    @property
    def run(self) -> RunFolder:
        """The sweep's folder."""

    @property
    def plan(self) -> Plan:
        """The sweep's plan."""

    @property
    def rule(self) -> Rule:
        """By which it was chosen."""

    @property
    def defects(self) -> int:
        """Most defects that can be hit on any of the designs."""

    @property
    def front(self) -> Points:
        """What no other point beats."""

    @property
    def ranked(self) -> Points:
        """Each design of the front at its best threshold there, the best design first."""

    @property
    def best(self) -> Chosen:
        """The chosen design."""
