"""The seeds of a station: what makes one random part another, and one draw of the noise."""

from __future__ import annotations

from collections.abc import Mapping

from gpuspec.station.defects import Section
from gpuspec.station.station import Station

NOISE = "sensor.seed"
"""Of the noise: the one seed that is no part's."""

_PEEL = "part.orange_peel.seed"


def seeds_of(station: Station) -> dict[str, int]:
    """Return the seeds of a part and of its noise, by their paths.

    Parameters
    ----------
    station : Station

    Examples
    --------
    >>> from gpuspec.station.seeds import seeds_of
    >>> peel = {"wavelength_mm": 2.0, "slope_rad": 0.002, "seed": 5}
    >>> seeds_of(gpuspec.example("trim").replace(part__orange_peel=peel, sensor__seed=9))
    {'sensor.seed': 9, 'part.orange_peel.seed': 5, 'populations[1].seed': 1, ...}
    """
    peel = station.part.orange_peel
    return {
        NOISE: station.sensor.seed,
        **({_PEEL: peel.seed} if peel else {}),
        **{_population(n): p.seed for n, p in enumerate(station.populations, 1)},
    }


def with_seeds(station: Station, seeds: Mapping[str, int]) -> Station:
    """Return a station with other seeds, which are not checked: a hundredth of `replace`.

    Parameters
    ----------
    station : Station
    seeds : mapping of str to int
        All that :func:`seeds_of` tells of, by their paths.
    """

    def other(one: Section, key: str) -> Section:
        return one.model_copy(update={"seed": seeds[key]})

    part, peel = station.part, station.part.orange_peel
    if peel:
        part = part.model_copy(update={"orange_peel": other(peel, _PEEL)})
    return station.model_copy(
        update={
            "part": part,
            "sensor": other(station.sensor, NOISE),
            "populations": tuple(
                other(one, _population(n)) for n, one in enumerate(station.populations, 1)
            ),
        }
    )


def _population(number: int) -> str:
    return f"populations[{number}].seed"
