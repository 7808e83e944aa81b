"""What of a built station may be off, as its ``[tolerance]`` says, and designs that are off."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from itertools import product

import numpy as np

from gpuspec.errors import StationError
from gpuspec.station.numeric import check_design, takes_whole_numbers
from gpuspec.station.paths import at
from gpuspec.station.station import Station

CORNERS_MAX = 16
"""Corner designs of one design beside those that move one key alone; of more some at random."""

INSIDE = 4
"""Designs beside them that are off by less, at random: the worst need not be at a corner."""

_SIGNED = "x_mm", "y_mm", "z_mm", "_deg", "_rad"


def stated(station: Station, varied: Collection[str] = ()) -> dict[str, float]:
    """Return the tolerances of a station's ``[tolerance]``, each checked to be of a number.

    Parameters
    ----------
    station : Station
    varied : collection of str
        Keys that get their numbers elsewhere.

    Returns
    -------
    dict of str to float
        By key, how far it may be off each way; empty without such a table.

    Raises
    ------
    StationError
        If one is of no key, or of none that is a number.
    """
    given = station.tolerance.of if station.tolerance else {}
    for key in given:
        try:
            check_design(key)
            takes_whole_numbers(station, key)
        except StationError as error:
            raise StationError(f"[tolerance]: {error}") from None
        if key not in varied:
            _number(station, key)
    return dict(given)


def _number(station: Station, key: str) -> float | int:
    """Return what a key of a station is off from; of a pose that it does not state 0.

    Raises
    ------
    StationError
        If it has no number.
    """
    value = at(station, key)
    if value is None:
        with suppress(StationError):  # a section that cannot be left to its defaults
            value = at(station.replace(**{key.rpartition(".")[0]: {}}), key)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise StationError(
            f"[tolerance]: {key} has no number in {station.file}, so it cannot be off; set it, "
            f"or drop its tolerance."
        )
    return value


def corners(station: Station, halves: Mapping[str, float]) -> list[dict[str, float | int]]:
    """Return what keys take when each is off as far as it may be, one by one, then all at once.

    A few in which all are off by less, at random, follow.

    Parameters
    ----------
    station : Station
    halves : mapping of str to float
        By key.

    Raises
    ------
    StationError
        If a key is none.

    Examples
    --------
    >>> from gpuspec.station.corners import corners
    >>> station = gpuspec.example("trim")
    >>> corners(station, {"tunnel.dark_mm": 0.5})[:2]
    [{'tunnel.dark_mm': 5.5}, {'tunnel.dark_mm': 6.5}]
    >>> len(corners(station, {"tunnel.dark_mm": 0.5, "sensor.exposure": 0.2}))
    12
    """
    keys = list(halves)
    ends = []
    numbers = {key: _number(station, key) for key in keys}
    for key in keys:
        value, half = numbers[key], halves[key]
        low = value - half
        if low < 0 <= value and not key.endswith(_SIGNED):
            low = 0  # of a share, a width or a height there is no less
        ends.append((low, value + half))
    if not keys:
        return []
    random, every = np.random.default_rng(0), np.array(ends)
    picks = random.integers(0, 2, (CORNERS_MAX, len(keys))).astype(float)
    if 2 ** len(keys) <= CORNERS_MAX:
        all_of = product((0.0, 1.0), repeat=len(keys)) if len(keys) > 1 else ()
        picks = np.array([*all_of]).reshape(-1, len(keys))
    inside = np.round(random.random((INSIDE, len(keys))), 2)  # in hundredths, as one reads them
    picks = np.concatenate([picks, inside])
    together = every[:, 0] + picks * (every[:, 1] - every[:, 0])

    def taken(key: str, value: float) -> float | int:
        whole = isinstance(numbers[key], int)
        return round(value) if whole else float(f"{value:.9g}")

    found = [
        *({key: taken(key, end)} for key, own in zip(keys, ends, strict=True) for end in own),
        *({key: taken(key, v) for key, v in zip(keys, row, strict=True)} for row in together),
    ]
    return [one for number, one in enumerate(found) if one not in found[:number]]
