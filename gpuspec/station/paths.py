"""Dotted paths into a station, ``defects[2].depth_um``, and values put in at one."""

from __future__ import annotations

import re
from typing import Any

from gpuspec.station.defects import Distribution, Section
from gpuspec.station.mistakes import choices

_PLACE = re.compile(r"([^\[\]]+)((?:\[\d{1,6}\])*)")


def places(path: str) -> list[str | int]:
    """Return the steps of a dotted path; entries of lists count from 1 in it, from 0 here.

    ``"defects[2].depth_um"`` gives ``["defects", 1, "depth_um"]``.

    Examples
    --------
    >>> from gpuspec.station.paths import places
    >>> places("defects[2].depth_um")
    ['defects', 1, 'depth_um']
    """
    steps: list[str | int] = []
    for part in path.split("."):
        found = _PLACE.fullmatch(part)
        if found is None:
            return list(path.split("."))
        steps.append(found[1])
        steps += [int(number) - 1 for number in re.findall(r"\d+", found[2])]
    return steps


def plain(value: Any) -> Any:
    """Return a value with NumPy's numbers and arrays in it as Python's."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(plain(inner) for inner in value)
    # Both have it, and nothing else that a station holds; NumPy need not be imported to know.
    return value.tolist() if hasattr(value, "tolist") else value


def at(station: Section, path: str) -> Any:
    """Return what a station holds at a path; None where there is nothing.

    Parameters
    ----------
    station : Station or a section of it
    path : str
        Dotted, as in ``defects[1].depth_um``; entries count from 1.
    """
    found: Any = station
    for place in places(path):
        if isinstance(place, int):
            found = found[place] if isinstance(found, tuple) and place < len(found) else None
        else:
            found = getattr(found, place, None) if isinstance(found, Section) else None
    return found


def merged(section: Any, old: Any, new: Any) -> Any:
    """Return a section's table with the keys of another put in; a value is replaced.

    Parameters
    ----------
    section : Section or value
        What stands at that place: a defect of another kind and a distribution are replaced whole.
    old : dict or value
        What the section holds, as TOML has it.
    new : dict or value
        What is put in; None unsets a key.
    """
    if not isinstance(section, Section) or isinstance(section, Distribution):
        return new
    if not isinstance(old, dict) or not isinstance(new, dict):
        return new
    if "kind" in new and new["kind"] not in choices(type(section), ["kind"]):
        return new
    table = dict(old)
    for key, value in new.items():
        if value is None:
            table.pop(key, None)
        else:
            table[key] = merged(getattr(section, key, None), old.get(key), value)
    return table
