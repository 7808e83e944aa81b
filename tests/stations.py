"""What the tests of stations share: small files, and strategies that make stations."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import strategies as st

from gpuspec.errors import StationError
from gpuspec.station.station import Station

DENT = '[[defects]]\nkind = "dent"\nx_mm = 1\ny_mm = 2\ndiameter_mm = 1\ndepth_um = 5\n'
DENTS = '[[populations]]\nkind = "dent"\ncount = 5\ndepth_um = 5\ndiameter_mm = '


def sentences(text: str) -> list[str]:
    """The sentences with which a station is refused."""
    with pytest.raises(StationError) as caught:
        Station.parse(text, "s.toml")
    lines = str(caught.value).split("\n")
    for line in lines:
        assert line.startswith("s.toml: ")
        assert line.endswith(".")
        assert not line.endswith("..")
        for jargon in ("pydantic", "Traceback", "Value error", "Input should"):
            assert jargon not in line
    return lines


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high)


def some(**keys: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({}, optional=keys)


SIZES = (
    number(0.1, 5.0)
    | st.tuples(number(0.1, 1.0), number(1.0, 5.0)).map(list)
    | st.fixed_dictionaries({"median": number(0.1, 2.0), "spread": number(1.01, 4.0)})
    | st.fixed_dictionaries({"low": number(0.1, 1.0), "high": number(1.0, 5.0)})
)
PLACE = {"x_mm": number(-4, 4), "y_mm": number(-4, 4)}
NAMES = st.text(min_size=1, max_size=9).filter(lambda name: name != "missed")
SPOT = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["dent", "bump"]),
        **PLACE,
        "diameter_mm": number(0.1, 8),
        "depth_um": number(0.1, 90),
    }
)
LINE = st.fixed_dictionaries(
    {
        "kind": st.just("scratch"),
        "points_mm": st.lists(
            st.tuples(number(-4, 4), number(-4, 4)).map(list), min_size=2, max_size=5
        ),
        "width_mm": number(0.1, 8),
        "depth_um": number(0.1, 90),
    }
)
PATCH = st.fixed_dictionaries(
    {"kind": st.just("measured"), **PLACE, "file": st.just("/tmp/ä ö.sur")},
    optional={"taper": number(0, 0.5), "zone_height_um": number(0.1, 3)},
)
POPULATION = st.fixed_dictionaries(
    {"kind": st.sampled_from(["dent", "bump"]), "diameter_mm": SIZES, "depth_um": SIZES},
    optional={"seed": st.integers(0, 2**32 - 1), "spacing_mm": number(0, 9)},
) | st.fixed_dictionaries(
    {"kind": st.just("scratch"), "width_mm": SIZES, "length_mm": SIZES, "depth_um": SIZES},
    optional={"vertices": st.integers(2, 9), "bend_rad": number(0, 3)},
)
AMOUNT = st.fixed_dictionaries({"count": st.integers(1, 9)}) | st.fixed_dictionaries(
    {"density_per_cm2": number(0.1, 9)}
)
POPULATIONS = st.tuples(POPULATION, AMOUNT).map(lambda two: {**two[0], **two[1]})
STATIONS = some(
    part=some(
        length_mm=number(8, 300),
        width_mm=number(8, 60),
        crown_radius_x_mm=number(200, 1e7) | number(-1e7, -200),
        surface=st.sampled_from(["orientation", "height"]),
        material=st.sampled_from(["ideal", "gold", "lacquer"]),
        relief=st.fixed_dictionaries({"file": st.just("/tmp/'\"x\\.sur")}),
    ),
    tunnel=some(
        section=st.sampled_from(["ceiling"]), height_mm=number(80, 300), dark_mm=number(0.1, 30)
    ),
    camera=some(sampling_mm=number(0.05, 9), rows=st.integers(1, 999), subsampling=st.just(2)),
    sensor=some(bit_depth=st.sampled_from([8, 10, 12, 16]), noise=st.booleans()),
    sequence=some(images=st.integers(2, 999), step_mm=number(0.1, 9)),
    defects=st.lists(SPOT | LINE | PATCH, max_size=4),
    populations=st.lists(POPULATIONS, max_size=3),
    segmentation=some(threshold=st.just("auto") | number(0, 254)),
    classes=st.lists(
        st.fixed_dictionaries({"name": NAMES}, optional={"area_min_mm2": number(0, 9)}), max_size=3
    ),
)
