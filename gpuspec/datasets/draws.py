"""What is drawn anew for each part: a key of the station file, between two ends or of a list."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gpuspec.errors import StationError
from gpuspec.station.numeric import takes_whole_numbers
from gpuspec.station.paths import places
from gpuspec.station.station import Station
from gpuspec.sweeps.axes import varied

_HOW = "write [FROM, TO], e.g. [2, 6], or three or more values, or VALUE,VALUE as text"
VARY = "KEY=FROM:TO, e.g. sensor.exposure=2:6, or KEY=VALUE,VALUE"
"""What `--vary` of a data set takes."""
Value = str | bool | int | float


@dataclass(frozen=True)
class Draw:
    """A key and what it may be.

    Attributes
    ----------
    key : str
        Dotted path in the station file.
    values : tuple
        Two ends, between which each value is as likely; or the values, each as likely.
    between : bool
        Whether they are ends.
    whole : bool
        Whether it takes whole numbers only.
    """

    key: str
    values: tuple[Value, ...]
    between: bool
    whole: bool = False

    def __str__(self) -> str:
        if self.between:
            return f"{self.values[0]:g} to {self.values[1]:g}"
        return ", ".join(str(value) for value in self.values)

    def value(self, uniform: float) -> Value:
        """Return the value that belongs to a uniform number in [0, 1).

        Parameters
        ----------
        uniform : float

        Examples
        --------
        >>> from gpuspec.datasets.draws import Draw
        >>> Draw("sensor.exposure", (2.0, 6.0), between=True).value(0.25)
        3.0
        >>> Draw("sequence.images", (20, 22), between=True, whole=True).value(0.99)
        22
        >>> Draw("part.material", ("gold", "silver"), between=False).value(0.5)
        'silver'
        """
        if not self.between:
            return self.values[int(uniform * len(self.values))]
        low, high = float(self.values[0]), float(self.values[1])
        if self.whole:
            return int(low) + int(uniform * (int(high) - int(low) + 1))
        # Rounded, so that a part's station can be read; the ends stay the ends.
        return min(max(float(f"{low + (high - low) * uniform:.6g}"), low), high)


def draws(station: Station, vary: Mapping[str, Any]) -> tuple[Draw, ...]:
    """Return what is drawn, checked: each end and value makes a valid station.

    Parameters
    ----------
    station : Station
    vary : mapping of str to str or list
        Keys and what they take, as the ``[dataset.vary]`` table has it.

    Raises
    ------
    StationError
        An unknown key, a reversed or unreadable range, a value that is not allowed.

    Examples
    --------
    >>> from gpuspec.datasets.draws import draws
    >>> vary = {"sensor.exposure": [2, 6], "sensor.noise": [True, False]}
    >>> vary["sequence.images"] = "20:40"
    >>> for draw in draws(gpuspec.example("trim"), vary):
    ...     print(draw.key, "is", draw)
    sensor.exposure is 2 to 6
    sensor.noise is True, False
    sequence.images is 20 to 40
    """
    found: list[Draw] = []
    for key, given in varied(vary).items():
        if any(places(key) == places(other.key) for other in found):
            raise StationError(f"{key} is varied twice; vary each key once.")
        found.append(_draw(station, key, given))
    return tuple(found)


def _draw(station: Station, key: str, given: Any) -> Draw:
    first, last = places(key)[0], places(key)[-1]
    if last == "seed":
        raise StationError(
            f"{key} is not varied: every part has seeds of its own; dataset.seed gives other parts."
        )
    if first in ("sweep", "dataset", "classes", "decision"):
        raise StationError(f"{station.file}: {key} makes no other image, so it is not varied.")
    entries = _entries(key, given)
    numbers = all(isinstance(e, (int, float)) and not isinstance(e, bool) for e in entries)
    between = numbers and len(entries) == 2 and not (isinstance(given, str) and "," in given)
    if between and entries[0] > entries[1]:
        raise StationError(
            f"{key}: {_shown(given)} is reversed; write {entries[1]:g}:{entries[0]:g}."
        )
    whole = numbers and takes_whole_numbers(station, key)
    if whole and any(entry != round(entry) for entry in entries):
        raise StationError(
            f"{key} takes whole numbers, and {_shown(given)} has others; choose whole ones."
        )
    if numbers:
        entries = [round(entry) if whole else float(entry) for entry in entries]
    for number, entry in enumerate(entries):
        if entry in entries[:number] and not (between and number):
            raise StationError(f"{key}: a value stands twice in {_shown(given)}; name it once.")
    _check_each(station, key, entries)
    return Draw(key, tuple(entries), between, whole)


def _check_each(station: Station, key: str, entries: Sequence[Value]) -> None:
    """Refuse what is no value of the key."""
    for entry in entries:
        station.replace(**{key: entry})


def _entries(key: str, given: Any) -> list[Any]:
    if isinstance(given, str) and ":" in given:
        try:
            entries: list[Any] = [float(part) for part in given.split(":")]
            if len(entries) != 2:
                raise ValueError
        except ValueError:
            raise StationError(f"{key}: {_shown(given)} is not a range; {_HOW}.") from None
    elif isinstance(given, str):
        entries = [_word(part.strip()) for part in given.split(",")]
    else:
        entries = list(given) if isinstance(given, (list, tuple)) else [given]
    if not entries or not all(isinstance(entry, (str, bool, int, float)) for entry in entries):
        raise StationError(f"{key}: {_shown(given)} is neither a range nor values; {_HOW}.")
    if any(isinstance(entry, float) and not math.isfinite(entry) for entry in entries):
        raise StationError(f"{key}: {_shown(given)} holds a number that is not finite; {_HOW}.")
    return entries


def _word(text: str) -> Value:
    """Return what a word on the command line stands for."""
    if text in ("true", "false"):
        return text == "true"
    try:
        return int(text) if text.lstrip("+-").isdecimal() else float(text)
    except ValueError:
        return text


def _shown(given: object) -> str:
    text = str(given)
    return text if len(text) <= 60 else text[:57] + "..."
