"""A study by its name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from gpuspec.station.station import Station
    from gpuspec.studies.outcome import Outcome

STUDIES = ("signature", "height", "coverage", "tolerance", "threshold")


def study(name: str, station: Station | str | Path | None = None, **options: Any) -> Outcome:
    """Run a study by its name.

    Parameters
    ----------
    name : str
        One of ``STUDIES``.
    station : Station, str or Path, optional
        Or the path of a station file. Only ``signature`` does without.
    **options
        What the study of that name takes, e.g. ``steps=9`` of ``tolerance``.

    Returns
    -------
    Outcome

    Raises
    ------
    StationError
        If there is no study of that name, it needs a station, or takes no such option.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> coverage = gpuspec.study("coverage", station)
    >>> print(coverage.findings()[0])
    0 % of 40,000 pixels are blind: 0 lost, 0 farther from every transition than 0.944 mm,
        which shows a dent of 0.933 mm, 1.04 µm deep.
    >>> gpuspec.study("covrage", station)
    Traceback (most recent call last):
        ...
    gpuspec.errors.StationError: there is no study 'covrage'; choose one of signature,
        height, coverage, tolerance, threshold.
    """
    from importlib import import_module
    from inspect import signature

    from gpuspec.errors import StationError

    if name not in STUDIES:
        raise StationError(f"there is no study {name!r}; choose one of {', '.join(STUDIES)}.")
    if station is None and name != "signature":
        raise StationError(f"the study of {name} needs a station.")
    from gpuspec.station.station import Station

    run = import_module(f"gpuspec.studies.{name}").study
    known = list(signature(run).parameters)[1:]
    for option in options:
        if option not in known:
            raise StationError(
                f"the study of {name} takes no {option}; it takes {', '.join(known)}."
            )
    found: Outcome = run(None if station is None else Station.of(station), **options)
    return found
