"""The seeds of a part, known in one place."""

from __future__ import annotations

import gpuspec
from gpuspec.station.seeds import seeds_of, with_seeds

PEEL = {"wavelength_mm": 2.0, "slope_rad": 0.002, "seed": 5}


def paths_of_seeds(table, path=""):
    """Where a station's table, however deep, has a seed."""
    for key, value in table.items():
        if key == "seed":
            yield f"{path}.{key}".lstrip(".")
        elif isinstance(value, dict):
            yield from paths_of_seeds(value, f"{path}.{key}")
        elif isinstance(value, (list, tuple)):
            for number, one in enumerate(value, 1):
                if isinstance(one, dict):
                    yield from paths_of_seeds(one, f"{path}.{key}[{number}]")


def test_no_seed_of_a_station_is_forgotten():
    station = gpuspec.example("trim").replace(part__orange_peel=PEEL)
    assert set(seeds_of(station)) == set(paths_of_seeds(station.as_dict()))


def test_a_station_with_other_seeds_is_the_one_that_replace_gives():
    station = gpuspec.example("trim").replace(part__orange_peel=PEEL)
    other = {key: number for number, key in enumerate(seeds_of(station), 100)}
    assert with_seeds(station, other) == station.replace(**other)
    assert seeds_of(with_seeds(station, other)) == other
    assert with_seeds(station, seeds_of(station)) == station
