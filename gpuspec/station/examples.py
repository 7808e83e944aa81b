"""Stations that come with gpuspec."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from gpuspec.errors import StationError
from gpuspec.station.station import Station


def examples() -> tuple[str, ...]:
    """Return the names of the stations that come with the package.

    Examples
    --------
    >>> from gpuspec.station.examples import examples
    >>> examples()
    ('measured', 'trim')
    """
    folder = resources.files("gpuspec") / "examples"
    return tuple(
        sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))
    )


def example(name: str) -> Station:
    """Return an example station by name.

    Raises
    ------
    StationError
        If there is none of that name.

    Examples
    --------
    >>> gpuspec.example("trim")
    Station(trim.toml: part 200 x 50 mm, 2 defects, 3 populations; ceiling at 300 mm,
        stripes 2 + 6 mm; 4000 x 1000 pixels, 40 images)
    >>> gpuspec.example("demo")
    Traceback (most recent call last):
        ...
    gpuspec.errors.StationError: there is no example 'demo'; choose one of measured, trim.
    """
    return Station.parse(example_text(name), f"{name}.toml", Path.cwd())


def example_text(name: str) -> str:
    """Return the TOML text of an example station.

    Raises
    ------
    StationError
        If there is none of that name.
    """
    if name not in examples():
        raise StationError(f"there is no example {name!r}; choose one of {', '.join(examples())}.")
    return (resources.files("gpuspec") / "examples" / f"{name}.toml").read_text(encoding="utf-8")
