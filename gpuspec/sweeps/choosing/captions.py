"""What the pictures of a sweep say alike."""

from __future__ import annotations

from gpuspec import words
from gpuspec.sweeps.choosing.chosen import Choosing

_UNITS = {"mm": "mm", "um": "µm", "mm2": "mm²", "rad": "rad", "e": "e⁻", "dn": "DN"}


def label(key: str) -> str:
    """Return a key as an axis says it: ``tunnel.dark_mm`` is "tunnel dark, mm"."""
    name, _, suffix = key.rpartition("_")
    if suffix not in _UNITS:
        return key.replace(".", " ").replace("_", " ")
    return f"{name.replace('.', ' ').replace('_', ' ')}, {_UNITS[suffix]}"


def about(choice: Choosing) -> str:
    """Return what was swept and by which rule it is judged, in one line."""
    plan, there = choice.plan, choice.run.there()
    of = "" if there == plan.designs else f"{there:,} of "
    screened = "; P1 of screened designs is estimated" if plan.samples else ""
    return (
        f"{of}{words.plural(plan.designs, 'design')}, {plan.tries}, "
        f"{words.plural(choice.defects, 'defect')}  ·  rule: {choice.rule}{screened}"
    )
