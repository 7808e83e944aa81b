"""What a sweep varies: keys of the station file, each over a range or a list of values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpuspec.errors import StationError
from gpuspec.light.light_map import LIGHT
from gpuspec.station.numeric import check_design, takes_whole_numbers
from gpuspec.station.station import Station
from gpuspec.words import plural

DESIGN_SECTIONS = ("sensor", "sequence")
DESIGN_KEYS = tuple(f"{section}.{key}" for section, key in LIGHT)
"""Keys that leave the light map as it is."""

VALUES_MAX = 1_000_000
_HOW = "write FROM:TO:COUNT, e.g. 1:12:23, or values, e.g. 1,2,4"
_BOUNDS = "write FROM:TO, e.g. 1:12"
VARY = "KEY=FROM:TO:COUNT, e.g. tunnel.luminous_mm=1:12:23, or KEY=VALUE,VALUE"
VARY_BETWEEN = "KEY=FROM:TO, e.g. tunnel.luminous_mm=1:12"
"""What `--vary` of a sweep takes, and that of a search."""


@dataclass(frozen=True)
class Axis:
    """One key and the values it takes, in rising order or as listed.

    Attributes
    ----------
    key : str
        Dotted path in the station file.
    values : tuple of float or int
    """

    key: str
    values: tuple[float | int, ...]

    def __repr__(self) -> str:
        first, last = self.values[0], self.values[-1]
        return f"Axis({self.key}: {len(self.values):,} values, {first:g} to {last:g})"

    @property
    def retraces(self) -> bool:
        """Whether another value needs another light map."""
        return not (self.key in DESIGN_KEYS or self.key.split(".")[0] in DESIGN_SECTIONS)


def varied(vary: Mapping[str, Any]) -> dict[str, Any]:
    """Return keys and what they take, checked to be a mapping of words.

    Raises
    ------
    StationError
        If it is none.
    """
    if not isinstance(vary, Mapping) or not all(isinstance(key, str) for key in vary):
        raise StationError(
            'what is varied is a dictionary of keys, e.g. {"tunnel.luminous_mm": "1:12:23"}.'
        )
    return dict(vary)


def axis(station: Station, key: str, given: str | float | Sequence[float]) -> Axis:
    """Return an axis from what a station file or a command says.

    Parameters
    ----------
    station : Station
        Whose key it is.
    key : str
        Dotted path, e.g. ``"tunnel.luminous_mm"`` or ``"defects[1].depth_um"``.
    given : str, number or list of numbers
        ``"1:12:23"``: 23 values from 1 to 12 in equal steps; ``"1,2,4"`` or a list: these.

    Raises
    ------
    StationError
        Unknown or non-numeric key; empty, reversed or unreadable range.

    Examples
    --------
    >>> from gpuspec.sweeps.axes import axis
    >>> station = gpuspec.example("trim")
    >>> axis(station, "tunnel.luminous_mm", "1:4:4").values
    (1.0, 2.0, 3.0, 4.0)
    >>> axis(station, "sequence.images", [20, 40]).retraces
    False
    """
    check_design(key)
    whole = takes_whole_numbers(station, key)
    values = _range(key, given) if isinstance(given, str) and ":" in given else _list(key, given)
    if len(set(values)) < len(values):
        raise StationError(f"{key}: a value stands twice in {_shown(given)}; name it once.")
    if not whole:
        return Axis(key, tuple(values))
    for value in values:
        if abs(value - round(value)) > 1e-9 * max(abs(value), 1):
            raise StationError(
                f"{key} takes whole numbers, and {_shown(given)} gives {value:g}; choose FROM, TO "
                f"and COUNT so that the step is whole, or list the values."
            )
    return Axis(key, tuple(round(value) for value in values))


def bounds(station: Station, key: str, given: str | float | Sequence[float]) -> Axis:
    """Return the two ends between which a key may lie.

    Parameters
    ----------
    station, key
        As of :func:`axis`.
    given : str or list of numbers
        ``"1:12"``, or ``"1:12:23"`` as a sweep's table has it, or a list, whose least and greatest
        value are the ends. Text with commas is refused: it lists values, and a search takes what
        lies between, too.

    Raises
    ------
    StationError
        Unknown or non-numeric key; unreadable, reversed or empty interval.
    """
    check_design(key)
    whole = takes_whole_numbers(station, key)
    low, high = _ends(key, given)
    if not whole:
        return Axis(key, (low, high))
    for end in (low, high):
        if abs(end - round(end)) > 1e-9 * max(abs(end), 1):
            raise StationError(
                f"{key} takes whole numbers, and {_shown(given)} has {end:g}; choose whole bounds."
            )
    return Axis(key, (round(low), round(high)))


def _ends(key: str, given: str | float | Sequence[float]) -> tuple[float, float]:
    """Return the ends of an interval."""
    if isinstance(given, str) and ":" not in given and "," in given:
        numbers = _list(key, given, _BOUNDS)
        raise StationError(
            f"{key}: {_shown(given)} lists values, and a search takes all between two bounds; "
            f"write {min(numbers):g}:{max(numbers):g}."
        )
    if not isinstance(given, str) or ":" not in given:
        numbers = _list(key, given, _BOUNDS)
        low, high = min(numbers), max(numbers)
    else:
        parts = given.split(":")
        try:
            low, high, *count = map(float, parts)
        except ValueError:
            count = [math.nan] * 2
        if len(count) > 1 or not all(map(math.isfinite, (low, high, *count))):
            raise StationError(f"{key}: {_shown(given)} is no interval; {_BOUNDS}.")
        if low > high:
            raise StationError(f"{key}: {_shown(given)} is reversed; write {parts[1]}:{parts[0]}.")
    if low == high:
        raise StationError(f"{key}: {_shown(given)} leaves nothing to search; {_BOUNDS}.")
    return low, high


def vary_options(texts: Sequence[str], how: str = VARY) -> dict[str, str]:
    """Return keys and what they take, as ``--vary`` gives them.

    Parameters
    ----------
    texts : sequence of str
        Each ``KEY=RANGE``.
    how : str
        What the message says to write.

    Raises
    ------
    StationError
        If one has another form, or a key stands twice.
    """
    found: dict[str, str] = {}
    for key, given in (vary_option(text, how) for text in texts):
        if key in found:
            raise StationError(f"--vary {key} stands twice; vary each key once.")
        found[key] = given
    return found


def vary_option(text: str, how: str = VARY) -> tuple[str, str]:
    """Split ``KEY=RANGE`` as ``--vary`` takes it.

    Parameters
    ----------
    text : str
    how : str
        What the message says to write.

    Raises
    ------
    StationError
        If it has another form.
    """
    key, equals, given = text.partition("=")
    if not equals or not key.strip() or not given.strip():
        raise StationError(f"--vary {text}: write {how}.")
    return key.strip(), given.strip()


def axis_values(key: str, given: str) -> list[Any]:
    """Return values of which a key takes one: numbers, words, true or false.

    Parameters
    ----------
    key : str
    given : str
        ``FROM:TO:COUNT``, or values with commas between them.

    Raises
    ------
    StationError
        If a range cannot be read.

    Examples
    --------
    >>> from gpuspec.sweeps.axes import axis_values
    >>> axis_values("sensor.noise", "true,false"), axis_values("tunnel.dark_mm", "2:4:3")
    ([True, False], [2, 3, 4])
    >>> axis_values("tunnel.section", "ceiling, arch"), axis_values("sensor.bit_depth", "8,12")
    (['ceiling', 'arch'], [8, 12])
    """
    if ":" in given:
        values = _range(key, given)
        whole = all(value.is_integer() for value in values)
        return [round(value) for value in values] if whole else list(values)
    found: list[Any] = []
    for word in (part.strip() for part in given.split(",")):
        for read in (int, float):
            try:
                found.append(read(word))
                break
            except ValueError:
                continue
        else:
            found.append({"true": True, "false": False}.get(word, word))
    return found


def _range(key: str, given: str) -> list[float]:
    parts = given.split(":")
    try:
        low, high = (float(part) for part in parts[:2])
        count = int(parts[2]) if len(parts) == 3 else -1
        if len(parts) != 3 or not (math.isfinite(low) and math.isfinite(high)):
            raise ValueError
    except ValueError:
        raise StationError(f"{key}: {_shown(given)} is not a range; {_HOW}.") from None
    if count < 1:
        raise StationError(f"{key}: {_shown(given)} is empty: COUNT must be at least 1; {_HOW}.")
    if count > VALUES_MAX:
        raise StationError(
            f"{key}: {_shown(given)} has {count:,} values, more than {VALUES_MAX:,}; nothing could "
            f"hold a sweep of them."
        )
    if low > high:
        raise StationError(
            f"{key}: {_shown(given)} is reversed; write {parts[1]}:{parts[0]}:{count}."
        )
    if (count == 1 and low != high) or (count > 1 and low == high):
        raise StationError(
            f"{key}: {_shown(given)} asks for {plural(count, 'value')} from {low:g} to {high:g}; "
            f"{_HOW}."
        )
    # Rounded, so that 0.1 steps are written 0.3 and not 0.30000000000000004.
    return [float(f"{value:.12g}") for value in np.linspace(low, high, count)]


def _list(key: str, given: str | float | Sequence[float], how: str = _HOW) -> list[float]:
    entries = given.split(",") if isinstance(given, str) else given
    entries = entries if isinstance(entries, Iterable) else [entries]
    values = []
    for entry in entries:
        try:
            if isinstance(entry, bool):
                raise ValueError
            values.append(float(entry))
        except (TypeError, ValueError):
            raise StationError(f"{key}: {_shown(given)} is not a list of numbers; {how}.") from None
        if not math.isfinite(values[-1]):
            raise StationError(f"{key}: {_shown(given)} holds {entry}; only finite numbers can be.")
    if not values:
        raise StationError(f"{key}: the list of values is empty; {how}.")
    return values


def _shown(given: object) -> str:
    text = str(given)
    return text if len(text) <= 60 else text[:57] + "..."
