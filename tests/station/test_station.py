"""Stations: every wrong value is one sentence, every valid station survives a round trip."""

from __future__ import annotations

import json
import math
import tomllib
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from gpuspec.errors import StationError
from gpuspec.station.defects import Section
from gpuspec.station.examples import example, example_text, examples
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml

DENT = '[[defects]]\nkind = "dent"\nx_mm = 1\ny_mm = 2\ndiameter_mm = 1\ndepth_um = 5\n'
SCRATCH = '[[defects]]\nkind = "scratch"\nwidth_mm = 1\ndepth_um = 5\npoints_mm = '
DENTS = '[[populations]]\nkind = "dent"\ncount = 5\ndepth_um = 5\ndiameter_mm = '
HUGE = "1" + 400 * "0"


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


# One wrong value each: the text, and what its sentence says after the file's name.
WRONG = {
    "NaN": ("[part]\nlength_mm = nan", "part.length_mm = nan must be a finite number."),
    "infinite": ("[part]\nwidth_mm = -inf", "part.width_mm = -inf must be a finite number."),
    "zero": ("[tunnel]\nluminous_mm = 0", "tunnel.luminous_mm = 0 must be greater than 0."),
    "negative": ("[camera]\npupil_mm = -0.5", "camera.pupil_mm = -0.5 must be at least 0."),
    "too large": ("[camera]\nsubsampling = 17", "camera.subsampling = 17 must be at most 16."),
    "not below": ("[tunnel]\ndark_leak = 1", "tunnel.dark_leak = 1 must be less than 1."),
    "text for a number": ('[part]\nlength_mm = "9"', 'part.length_mm = "9" must be a number.'),
    "bool for a number": ("[part]\nlength_mm = true", "part.length_mm = true must be a number."),
    "list for a number": ("[part]\nlength_mm = [1]", "part.length_mm = [1] must be a number."),
    "table for a number": (
        "[part]\nlength_mm = {a = 1}",
        "part.length_mm = {...} must be a number.",
    ),
    "date for a number": (
        "[part]\nlength_mm = 1979-05-27",
        "part.length_mm = 1979-05-27 must be a number.",
    ),
    "number for a bool": ("[sensor]\nnoise = 1", "sensor.noise = 1 must be true or false."),
    "number for a text": (
        "[part.relief]\nfile = 3",
        "part.relief.file = 3 must be a text in quotes.",
    ),
    "fraction for a count": (
        "[sequence]\nimages = 40.5",
        "sequence.images = 40.5 must be a whole number.",
    ),
    "huge number": (
        f"[part]\nlength_mm = {HUGE}",
        f"part.length_mm = {HUGE[:57]}... must be a number.",
    ),
    "huge count": (
        f"[sequence]\nimages = {HUGE}",
        f"sequence.images = {HUGE[:57]}... must be at most 100000.",
    ),
    "number beyond all printing": (
        "[sequence]\nimages = 0x" + 5000 * "f",
        "sequence.images = (too long to show) must be at most 100000.",
    ),
    "choice": (
        '[part]\nsurface = "flat"',
        "part.surface = \"flat\" must be 'orientation' or 'height'.",
    ),
    "bit depth": ("[sensor]\nbit_depth = 9", "sensor.bit_depth = 9 must be 8, 10, 12 or 16."),
    "empty text": ('[[classes]]\nname = ""', 'classes[1].name = "" must not be empty.'),
    "long text": (
        f'[[classes]]\nname = "{70 * "a"}"',
        f'classes[1].name = "{56 * "a"}... must have at most 60 characters.',
    ),
    "threshold of another word": (
        '[segmentation]\nthreshold = "Auto"',
        "segmentation.threshold = \"Auto\" must be 'auto', or must be a number.",
    ),
    "threshold below zero": (
        "[segmentation]\nthreshold = -1",
        "segmentation.threshold = -1 must be 'auto', or must be at least 0.",
    ),
    "threshold NaN": (
        "[segmentation]\nthreshold = nan",
        "segmentation.threshold = nan must be 'auto', or must be a finite number.",
    ),
    "section as a number": ("part = 3", "part = 3 must be a table."),
    "section as a date": ("part = 1979-05-27", "part = 1979-05-27 must be a table."),
    "relief as a number": ("[part]\nrelief = 3", "part.relief = 3 must be a table."),
    "defects as a table": ("[defects]\nx_mm = 3", "defects = {...} must be a list."),
    "defect as a number": ("defects = [3]", "defects[1] = 3 must be a table."),
    "unknown section": ("[tunel]\nx = 3", "tunel is not a known key (did you mean tunnel?)."),
    "unknown key": (
        "[part]\nlenght_mm = 3",
        "part.lenght_mm is not a known key (did you mean length_mm?).",
    ),
    "another unit": (
        "[camera]\nheight_m = 3",
        "camera.height_m is not a known key (did you mean height_mm?).",
    ),
    "unknown key of a defect": (
        DENT + "depth_mm = 1",
        "defects[1].depth_mm is not a known key (did you mean depth_um?).",
    ),
    "unknown key of a scratch": (
        SCRATCH + "[[0, 0], [1, 1]]\nwidht_mm = 1",
        "defects[1].widht_mm is not a known key (did you mean width_mm?).",
    ),
    "unknown key of a population": (
        DENTS + "1\nsed = 1",
        "populations[1].sed is not a known key (did you mean seed?).",
    ),
    "unknown key of a distribution": (
        DENTS + "{low = 1, high = 2, hihg = 3}",
        "populations[1].diameter_mm.hihg is not a known key (did you mean high?).",
    ),
    "unknown key of a class": (
        '[[classes]]\nname = "a"\narea_mm2 = 3',
        "classes[1].area_mm2 is not a known key (did you mean area_min_mm2?).",
    ),
    "unknown key of the relief": (
        '[part.relief]\nfile = "a"\nzone_hight_um = 3',
        "part.relief.zone_hight_um is not a known key (did you mean zone_height_um?).",
    ),
    "unknown key like a kind": (
        DENT + "dent = 1",
        "defects[1].dent is not a known key (did you mean depth_um?).",
    ),
    "unknown key with nothing near": (
        "xyz = 1",
        "xyz is not a known key; known here are camera, classes, defects, part, populations, "
        "segmentation, sensor, sequence, sweep, tunnel.",
    ),
    "unknown key of two lines": (
        '[part]\n"a\\nb" = 1',
        'part."a\\nb" is not a known key; known here are crown_radius_x_mm, crown_radius_y_mm, '
        "length_mm, material, relief, roughness_rad, surface, width_mm.",
    ),
    "missing key": (DENT.replace("y_mm = 2\n", ""), "defects[1].y_mm is missing."),
    "missing file": ("[part.relief]", "part.relief.file is missing."),
    "missing name": ("[[classes]]\narea_min_mm2 = 1", "classes[1].name is missing."),
    "wrong kind": (
        '[[defects]]\nkind = "crater"',
        "defects[1].kind = \"crater\" must be one of 'dent', 'bump', 'scratch', 'measured'.",
    ),
    "kind as a number": (
        "[[populations]]\nkind = 3",
        "populations[1].kind = 3 must be one of 'dent', 'bump', 'scratch'.",
    ),
    "no kind": (
        "[[defects]]\nx_mm = 1",
        "defects[1] = {...} must say its kind, such as kind = 'dent'.",
    ),
    "one point": (SCRATCH + "[[0, 0]]", "defects[1].points_mm = [[0, 0]] must have at least 2"),
    "point without y": (SCRATCH + "[[0, 0], [1]]", "defects[1].points_mm[2][2] is missing."),
    "point with z": (
        SCRATCH + "[[0, 0], [0, 1, 2]]",
        "defects[1].points_mm[2] = [0, 1, 2] must have at most 2 entries.",
    ),
    "point NaN": (
        SCRATCH + "[[nan, 0], [0, 1]]",
        "defects[1].points_mm[1][1] = nan must be a finite number.",
    ),
    "points as a text": (SCRATCH + '"ab"', 'defects[1].points_mm = "ab" must be a list.'),
    "range reversed": (
        DENTS + "[2, 1]",
        "populations[1].diameter_mm: low = 2 must not exceed high = 1.",
    ),
    "range of three": (
        DENTS + "[1, 2, 3]",
        "populations[1].diameter_mm = [1, 2, 3] must be a number, [low, high] or {median, spread}.",
    ),
    "size negative": (
        DENTS + "-1",
        "populations[1].diameter_mm = -1 must be greater than 0 and at most 100000.",
    ),
    "size as a bool": (
        DENTS + "true",
        "populations[1].diameter_mm = true must be a number, [low, high] or {median, spread}.",
    ),
    "range from a negative size": (
        DENTS + "[-1, 2]",
        "populations[1].diameter_mm.low = -1 must be greater than 0.",
    ),
    "range to NaN": (
        DENTS + "[1, nan]",
        "populations[1].diameter_mm.high = nan must be a finite number.",
    ),
    "log-normal without spread": (
        DENTS + "{median = 1}",
        "populations[1].diameter_mm = {...} must have both median and spread (> 1) for a "
        "log-normal.",
    ),
    "spread without median": (
        DENTS + "{spread = 2, low = 1, high = 2}",
        "populations[1].diameter_mm = {...} must have both median and spread (> 1) for a "
        "log-normal.",
    ),
    "spread too small": (
        DENTS + "{median = 1, spread = 1}",
        "populations[1].diameter_mm.spread = 1 must be greater than 1.",
    ),
    "spread beyond a float": (
        DENTS + "{median = 1, spread = 1e300}",
        "populations[1].diameter_mm.spread = 1e+300 must be at most 100.",
    ),
    "median negative": (
        DENTS + "{median = -1, spread = 2}",
        "populations[1].diameter_mm.median = -1 must be greater than 0.",
    ),
    "depths deeper than a defect's": (
        DENTS.replace("depth_um = 5", "depth_um = [1, 20000]") + "1",
        "populations[1].depth_um.high = 20000 must be at most 10000.",
    ),
    "neither count nor density": (
        DENTS.replace("count = 5\n", "") + "1",
        "populations[1]: give either count or density_per_cm2.",
    ),
    "count and density": (
        DENTS + "1\ndensity_per_cm2 = 1",
        "populations[1]: give either count or density_per_cm2.",
    ),
    "seed negative": (DENTS + "1\nseed = -1", "populations[1].seed = -1 must be at least 0."),
    "class of an empty range": (
        '[[classes]]\nname = "a"\nweight_min_dn = 3\nweight_max_dn = 3',
        "classes[1]: weight_min_dn = 3 must be less than weight_max_dn = 3.",
    ),
    "class of a kept name": (
        '[[classes]]\nname = "missed"',
        'classes[1]: name = "missed" is kept for defects without a blob.',
    ),
    "tunnel as high as the camera": (
        "[tunnel]\nheight_mm = 800",
        "camera.height_mm = 800 must be above the tunnel, whose tunnel.height_mm is 800.",
    ),
    "arch that cuts a hollow part": (
        '[part]\nwidth_mm = 50\nsurface = "height"\ncrown_radius_y_mm = -40\n'
        '[tunnel]\nsection = "arch"\nradius_mm = 26',
        "tunnel.radius_mm = 26 must be larger than the part's half width and height, 26.4",
    ),
    "tunnel above the camera": (
        "[tunnel]\nheight_mm = 900",
        "camera.height_mm = 800 must be above the tunnel, whose tunnel.height_mm is 900.",
    ),
    "arch above the camera": (
        '[tunnel]\nsection = "arch"\nradius_mm = 900',
        "camera.height_mm = 800 must be above the tunnel, whose tunnel.radius_mm is 900.",
    ),
    "tunnel below the part": (
        "[part]\ncrown_radius_y_mm = -26\n[tunnel]\nheight_mm = 10",
        "tunnel.height_mm = 10 must be above the part's highest point, 18.8586.",
    ),
    "box without width": (
        '[tunnel]\nsection = "box"',
        'tunnel.width_mm is missing: section = "box" needs it.',
    ),
    "box narrower than the part": (
        '[tunnel]\nsection = "box"\nwidth_mm = 50',
        "tunnel.width_mm = 50 must be larger than part.width_mm = 50 when section",
    ),
    "arch without radius": (
        '[tunnel]\nsection = "arch"',
        'tunnel.radius_mm is missing: section = "arch" needs it.',
    ),
    "arch narrower than the part": (
        '[tunnel]\nsection = "arch"\nradius_mm = 25',
        "tunnel.radius_mm = 25 must be larger than the part's half width and height, 25.",
    ),
    "crown narrower than the part": (
        "[part]\ncrown_radius_x_mm = 100",
        "part.crown_radius_x_mm = 100 must be larger than half the part's length_mm (100), or",
    ),
    "crown of no radius": (
        "[part]\ncrown_radius_y_mm = 0",
        "part.crown_radius_y_mm = 0 must be larger than half the part's width_mm (25), or",
    ),
    "dent deeper than wide": (
        DENT.replace("depth_um = 5", "depth_um = 5000").replace("r_mm = 1", "r_mm = 0.1"),
        "defects[1].depth_um = 5000 is more than its diameter_mm = 0.1: a hole with sides steeper",
    ),
    "scratch deeper than wide": (
        SCRATCH.replace("depth_um = 5", "depth_um = 1001") + "[[0, 0], [1, 0]]",
        "defects[1].depth_um = 1001 is more than its width_mm = 1: a hole with sides steeper than",
    ),
    "population deeper than wide": (
        DENTS.replace("depth_um = 5", "depth_um = [3000, 4000]") + "[0.1, 2.0]",
        "populations[1].depth_um = 3000 is more than its diameter_mm = 2: a hole with sides",
    ),
    "dent larger than the part": (
        DENT.replace("diameter_mm = 1", "diameter_mm = 300"),
        "defects[1].diameter_mm = 300 is larger than the part, 200 x 50 mm; so wide a shape is the",
    ),
    "dent outside the part": (
        DENT.replace("y_mm = 2", "y_mm = 25.5"),
        "defects[1] (dent) at (1, 25.5) mm is outside the part, which reaches ±100 mm along x "
        "and ±25 mm along y.",
    ),
    "scratch out of the part": (
        SCRATCH + "[[0, 0], [-101, 0]]",
        "defects[1] (scratch) at (-101, 0) mm is outside the part",
    ),
    "threshold of full scale": (
        "[segmentation]\nthreshold = 255",
        "segmentation.threshold = 255 must be below full scale, 255, or",
    ),
    "black level of full scale": (
        "[sensor]\nblack_level_dn = 255",
        "sensor.black_level_dn = 255 must be below full scale, 255.",
    ),
    "opening of one side": (
        "[tunnel]\nopening_width_mm = 3",
        "tunnel.opening_length_mm and tunnel.opening_width_mm must both be zero",
    ),
    "image too large": (
        "[camera]\nsampling_mm = 1e-4",
        "camera.sampling_mm = 0.0001 makes an image of 2000000 x 500000 pixels, more than",
    ),
    "columns beyond float32": (
        "[part]\nlength_mm = 20000\nwidth_mm = 0.01\n[camera]\nsampling_mm = 0.001",
        "camera.sampling_mm = 0.001 makes an image of 20000000 x 10 pixels, more than 16,777,216",
    ),
    "lag of all images": (
        '[sequence]\nfusion = "differential"\nlag = 40',
        "sequence.lag = 40 must be smaller than sequence.images = 40.",
    ),
    "not TOML": ("[part\n", "not a valid TOML file: "),
    "key twice": ("[part]\nwidth_mm = 1\nwidth_mm = 2", "not a valid TOML file: "),
    "lists too deep": ("a = " + 5000 * "[", "not a valid TOML file: "),
    "tables too deep": ("[part]\nlength_mm = {" + 3000 * "a." + "a = 1}", "part.length_mm = {...}"),
    "list of tables too deep": (
        "[part]\nlength_mm = [{" + 3000 * "a." + "a = 1}]",
        "part.length_mm = [{...}] must be a number.",
    ),
    "decimal beyond Python": ("[part]\nlength_mm = " + 5000 * "1", "not a valid TOML file: "),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_value_is_one_sentence_with_file_key_value_and_what_is_allowed(name: str):
    text, says = WRONG[name]
    (line,) = sentences(text)
    assert line.startswith(f"s.toml: {says}")


def test_every_wrong_value_has_its_own_sentence():
    text = f'[tunnel]\nheight_mm = -1\ndark_mm = "a"\nheigth_mm = 3\n{DENT}depht = 1\n[x]\n'
    assert len(sentences(text)) == 5


@pytest.mark.parametrize("key", ["dent", "float", "constrained-float", '"x(y)"', '"a[0]"', '""'])
def test_a_key_with_the_name_of_a_branch_is_still_named(key: str):
    (line,) = sentences(f"{key} = 1")
    assert line.startswith(f"s.toml: {key} is not a known key")


@pytest.mark.parametrize(
    "data",
    [
        '[part]\nmaterial = "é"'.encode("latin-1"),
        b"\xff\xfe[\x00p\x00",
        b"[part]\n\x00",
        b"\xef\xbb\xbf[part]\nlength_mm = 0",
    ],
)
def test_bytes_that_are_no_station_are_one_sentence(tmp_path, data: bytes):
    path = tmp_path / "s.toml"
    path.write_bytes(data)
    with pytest.raises(StationError) as caught:
        Station.read(path)
    message = str(caught.value)
    assert "s.toml: " in message
    assert message.endswith(".")
    assert "\n" not in message


def test_a_folder_and_an_absent_file_are_one_sentence(tmp_path):
    for path in (tmp_path, tmp_path / "absent.toml"):
        with pytest.raises(StationError) as caught:
            Station.read(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


def test_an_empty_file_is_the_default_station(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("")
    station = Station.read(path)
    assert station.as_dict() == Station().as_dict()
    assert station.file == "s.toml"
    assert station.locate("x.sur") == tmp_path.resolve() / "x.sur"


def test_numbers_need_no_point_but_counts_may_have_none():
    assert Station.parse("[part]\nlength_mm = 30").part.length_mm == 30.0
    assert sentences("[sequence]\nimages = 40.0")


# ---------------------------------------------------------------------- anything TOML can hold


def _known_keys(model: type[BaseModel]) -> list[str]:
    keys = set(model.model_fields)
    for inner in Section.__subclasses__():
        keys |= set(inner.model_fields)
    return sorted(keys)


KEYS = st.sampled_from(
    [*_known_keys(Station), "kind", "count", "diameter_mm", "width_mm", "points_mm"]
) | st.text(max_size=5)
SCALARS = (
    st.none().map(lambda _: "dent")
    | st.booleans()
    | st.integers()
    | st.integers(min_value=-3, max_value=300)
    | st.floats()
    | st.floats(min_value=0.01, max_value=30)
    | st.text(max_size=8)
    | st.sampled_from(["dent", "scratch", "measured", "auto", "height", "box", "arch"])
    | st.dates()
    | st.datetimes()
    | st.just(10**400)
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=6),
    max_leaves=20,
)
TABLES = st.dictionaries(KEYS, VALUES, max_size=8)
FILES = TABLES | st.fixed_dictionaries(
    {},
    optional={
        name: st.lists(TABLES, max_size=3)
        if name in ("defects", "populations", "classes")
        else TABLES
        for name in Station.model_fields
    },
)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(FILES)
def test_anything_toml_can_hold_is_a_station_or_a_station_error(data: dict[str, Any]):
    try:
        station = Station.from_dict(data)
    except StationError as error:
        for line in str(error).split("\n"):
            assert line.startswith("station: ")
            assert line.endswith(".")
    else:
        assert Station.from_dict(station.as_dict()) == station


# --------------------------------------------------------------------------------- round trips


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


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(STATIONS, st.booleans())
def test_a_station_survives_being_written_and_read(data: dict[str, Any], comments: bool):
    station = Station.from_dict(data)
    text = to_toml(station, comments=comments)
    assert Station.parse(text) == station
    assert Station.from_dict(station.as_dict()) == station
    assert station.replace() == station


@pytest.mark.parametrize("name", examples())
def test_an_example_is_a_station_and_so_is_its_text(name: str):
    station = example(name)
    assert Station.parse(example_text(name), f"{name}.toml").as_dict() == station.as_dict()
    for comments in (True, False):
        again = Station.parse(to_toml(station, comments=comments), f"{name}.toml")
        assert again.as_dict() == station.as_dict()


def test_an_example_that_is_not_there_names_those_that_are():
    with pytest.raises(StationError, match=r"no example 'tirm'; choose one of .*trim.*\.$"):
        example("tirm")


def test_the_written_station_holds_every_key_and_every_default():
    written = tomllib.loads(to_toml(Station()))
    assert set(written) == {"part", "tunnel", "camera", "sensor", "sequence", "segmentation"}
    text = to_toml(Station())
    for section in written:
        for key in type(getattr(Station(), section)).model_fields:
            assert f"\n{key} = " in text or f"\n# {key} = (none)" in text or key == "relief"


def test_files_are_written_as_they_are_named_or_with_their_whole_path(tmp_path):
    station = Station.parse('[part.relief]\nfile = "x.sur"', "s.toml", tmp_path)
    assert Station.parse(to_toml(station)).part.relief.file == "x.sur"
    anchored = Station.parse(to_toml(station, absolute=True))
    assert anchored.part.relief.file == (tmp_path / "x.sur").resolve().as_posix()


# ------------------------------------------------------------------------------- changed values


def test_a_value_is_changed_by_its_path_and_the_rest_stays():
    station = Station.parse(DENT, "s.toml", "/somewhere")
    changed = station.replace(tunnel__dark_mm=8.0, **{"camera.rows": 7})
    assert changed.tunnel.dark_mm == 8.0
    assert changed.shape == (7, 4000)
    assert changed.defects == station.defects
    assert (changed.file, changed.locate("x")) == ("s.toml", station.locate("x"))
    assert station.tunnel.dark_mm == 12.0
    assert changed.replace(camera__rows=None, tunnel__dark_mm=12.0) == station


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("tunnel.drak_mm", "station: tunnel.drak_mm is not a known key (did you mean dark_mm?)."),
        ("tunnel.dark_mm.x", "station: tunnel.dark_mm.x cannot be changed: dark_mm is not a table"),
        ("defects.x_mm", "station: defects.x_mm cannot be changed: defects is not a table of keys"),
        ("self", "station: self is not a known key"),
        ("tunnel.dark_mm", "station: tunnel.dark_mm = -1 must be greater than 0."),
    ],
)
def test_a_change_that_cannot_be_is_one_sentence(path: str, says: str):
    with pytest.raises(StationError) as caught:
        Station().replace(**{path: -1})
    assert str(caught.value).startswith(says)


def test_a_station_made_in_python_has_the_same_sentences():
    for wrong, says in (
        ({"tunel": {}}, "station: tunel is not a known key (did you mean tunnel?)."),
        ({"tunnel": {"hight_mm": 3.0}}, "tunnel.hight_mm is not a known key (did you mean height"),
        ({"sensor": {"exposure": -1.0}}, "station: sensor.exposure = -1.0 must be greater than 0."),
        ({"tunnel": {"section": "arch"}}, "station: tunnel.radius_mm is missing"),
    ):
        with pytest.raises(StationError) as caught:
            Station(**wrong)
        assert says in str(caught.value)
    made = Station(tunnel=Station().tunnel, camera={"height_mm": 700.0})
    assert made.as_dict() == Station.parse("[camera]\nheight_mm = 700.0").as_dict()


def test_numbers_of_numpy_are_numbers():
    numbers = {
        "camera.columns": np.int64(30), "camera.height_mm": np.float32(700.0),
        "sensor.noise": np.bool_(True), "tunnel.dark_mm": np.float64(3.0),
        "defects": [{"kind": "scratch", "points_mm": np.array([[0.0, 1.0], [2.0, 3.0]]),
                     "width_mm": np.float32(0.5), "depth_um": np.int8(3)}],
    }  # fmt: skip
    changed = Station().replace(**numbers)
    assert changed.camera.columns == 30
    assert changed.defects[0].points_mm == ((0.0, 1.0), (2.0, 3.0))
    assert Station.parse(to_toml(changed)).as_dict() == changed.as_dict()
    assert Station(sequence={"images": np.int32(8)}).sequence.images == 8
    with pytest.raises(StationError, match=r"sequence\.images = 8\.5 must be a whole number"):
        Station().replace(sequence__images=np.float64(8.5))


def test_a_station_is_frozen():
    station = Station.parse(DENT)
    for target, name in (
        (station, "part"),
        (station.part, "length_mm"),
        (station.defects[0], "x_mm"),
    ):
        with pytest.raises(ValidationError, match="frozen"):
            setattr(target, name, 3.0)
    with pytest.raises(TypeError):
        station.defects[0] = station.defects[0]


# -------------------------------------------------------------------------------------- schema


def schema_properties(schema: dict[str, Any], node: dict[str, Any]) -> dict[str, Any]:
    """Properties of a schema node, through references and alternatives."""
    if "$ref" in node:
        return schema_properties(schema, schema["$defs"][node["$ref"].rsplit("/", 1)[1]])
    found = dict(node.get("properties", {}))
    for inner in [*node.get("anyOf", ()), *node.get("oneOf", ())]:
        found |= schema_properties(schema, inner)
    return found | (schema_properties(schema, node["items"]) if "items" in node else {})


def test_the_json_schema_explains_every_key():
    schema = json.loads(json.dumps(Station.model_json_schema()))
    tables = {name: table for name, table in schema["$defs"].items()}
    assert len(tables) >= 14
    for name, table in tables.items():
        assert table.get("description"), name
        for key, node in schema_properties(schema, table).items():
            assert node.get("description"), f"{name}.{key}"
    for key, node in schema["properties"].items():
        assert "$ref" in node or node.get("description"), key


def test_every_length_in_the_schema_carries_its_unit():
    bare = {"low", "high", "median", "spread", "taper", "exposure", "prnu", "dark_leak",
            "threshold", "elongation_min", "elongation_max", "vary", "height_scale"}  # fmt: skip
    schema = Station.model_json_schema()
    for table in schema["$defs"].values():
        for key, node in schema_properties(schema, table).items():
            if '"type": "number"' in json.dumps(node):
                units = ("_mm", "_um", "_rad", "_e", "_dn", "_mm2", "_cm2")
                assert key.endswith(units) or key in bare, key


@pytest.mark.slow
@settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
@given(STATIONS)
def test_the_schema_knows_every_key_of_a_station(data: dict[str, Any]):
    schema = Station.model_json_schema()

    def check(value: Any, node: dict[str, Any]) -> None:
        if isinstance(value, dict):
            known = schema_properties(schema, node)
            assert set(value) <= set(known)
            for key, inner in value.items():
                check(inner, known[key])
        elif isinstance(value, (list, tuple)):
            for inner in value:
                check(inner, node)

    check(Station.from_dict(data).as_dict(), schema)


def test_the_schema_allows_each_form_of_a_distribution():
    table = Station.model_json_schema()["$defs"]["Distribution"]
    kinds = [form["type"] for form in table["anyOf"]]
    assert kinds == ["number", "array", "object"]
    assert "low" in table["anyOf"][2]["properties"]


# -------------------------------------------------------------------------------- derived values


@pytest.mark.parametrize(
    ("text", "shape"),
    [
        ("", (1000, 4000)),
        ("[camera]\nsampling_mm = 0.3", (167, 667)),
        ("[part]\nlength_mm = 0.3\nwidth_mm = 0.1\n[camera]\nsampling_mm = 0.1", (1, 3)),
        ("[camera]\nrows = 3", (3, 4000)),
        ("[camera]\ncolumns = 3", (1000, 3)),
        ("[part]\nlength_mm = 1e-6\nwidth_mm = 1e-6\n[camera]\nsampling_mm = 1000.0", (1, 1)),
    ],
)
def test_the_image_covers_the_part_unless_told_otherwise(text: str, shape: tuple[int, int]):
    assert Station.parse(text).shape == shape


@pytest.mark.parametrize(
    ("images", "step", "distinct"),
    [
        (40, None, 40),
        (1, None, 1),
        (8, 2.0, 8),
        (8, 4.0, 4),
        (8, 16.0, 1),
        (24, 6.0, 8),
        (7, 2.0, None),
        (8, 2.0001, None),
        (8, 0.1, None),
    ],
)
def test_shifts_are_counted_modulo_the_period(images: int, step: float | None, distinct):
    # The period is 4 + 12 = 16 mm.
    station = Station().replace(sequence__images=images, sequence__step_mm=step)
    assert station.step_mm == (step or 16 / images)
    assert station.distinct_shifts == distinct


def test_the_shapes_height_is_that_of_the_crowns_circle():
    assert Station().part.height_range_mm == (0, 0)
    round_ = Station.parse("[part]\nlength_mm = 60.0\nwidth_mm = 16.0").replace(
        part__crown_radius_x_mm=50.0, part__crown_radius_y_mm=-10.0
    )
    # 50 - sqrt(50^2 - 30^2) = 10 down, 10 - sqrt(10^2 - 8^2) = 4 up.
    low, high = round_.part.height_range_mm
    assert math.isclose(low, -10, rel_tol=1e-14)
    assert math.isclose(high, 4, rel_tol=1e-14)


def test_the_tunnels_top_and_period_and_the_sensors_gain():
    station = Station.parse('[tunnel]\nsection = "arch"\nradius_mm = 120.0')
    assert station.tunnel.top_mm == 120
    assert Station().tunnel.top_mm == 150
    assert Station().tunnel.period_mm == 16
    sensor = Station().replace(sensor__bit_depth=12, sensor__black_level_dn=95.0).sensor
    assert sensor.full_scale_dn == 4095
    assert sensor.gain_dn_per_e == 0.4


# ------------------------------------------------------------------------------------ changes


def test_a_table_changes_the_keys_it_names_and_leaves_the_others():
    station = Station.parse(DENT).replace(tunnel__luminous_mm=2.0)
    changed = station.replace(tunnel={"height_mm": 5.0})
    assert (changed.tunnel.height_mm, changed.tunnel.luminous_mm) == (5.0, 2.0)
    changed = station.replace(**{"defects[1]": {"depth_um": 7.0}})
    assert changed.defects[0] == station.defects[0].model_copy(update={"depth_um": 7.0})
    assert station.replace(tunnel=None).tunnel == Station().tunnel
    assert station.replace(tunnel={"luminous_mm": None}).tunnel == Station().tunnel


def test_an_entry_of_another_kind_replaces_the_old_one_and_a_bump_is_a_dent_upwards():
    station = Station.parse(DENT)
    bump = station.replace(**{"defects[1]": {"kind": "bump"}}).defects[0]
    assert (bump.kind, bump.x_mm, bump.depth_um) == ("bump", 1, 5)
    scratch = {"kind": "scratch", "points_mm": [[0, 0], [1, 1]], "width_mm": 1.0, "depth_um": 2.0}
    assert station.replace(**{"defects[1]": scratch}).defects[0].kind == "scratch"


def test_a_distribution_and_a_list_are_values_and_replaced_whole():
    station = Station.parse(DENTS + "{ median = 1, spread = 2, low = 0.5, high = 1.5 }")
    changed = station.replace(**{"populations[1].diameter_mm": {"low": 1.0, "high": 2.0}})
    assert changed.populations[0].diameter_mm.median is None
    changed = station.replace(**{"populations[1]": {"diameter_mm": {"median": 2.0, "spread": 1.1}}})
    assert changed.populations[0].diameter_mm.high > 2
    swept = station.replace(sweep={"vary": {"tunnel.dark_mm": [1, 2]}})
    swept = swept.replace(sweep__vary={"tunnel.luminous_mm": [1, 2]})
    assert set(swept.sweep.vary) == {"tunnel.luminous_mm"}


def test_an_entry_of_a_list_is_not_unset_alone():
    with pytest.raises(StationError, match=r"give the whole list, e\.g\. defects = \[\]\."):
        Station.parse(DENT).replace(**{"defects[1]": None})


@pytest.mark.parametrize("key", ["a." * 5000 + "b", "defects" + "[1]" * 5000, "x" * 5000])
def test_an_endless_key_is_answered_in_a_line(key):
    with pytest.raises(StationError) as caught:
        Station.parse(DENT).replace(**{key: 1})
    assert "is not a known key" in str(caught.value)
    assert len(str(caught.value)) < 200


def test_keys_to_vary_need_no_quotes():
    written = """
    [sweep.vary]
    tunnel.luminous_mm = "1:12:23"
    tunnel.dark_mm = [1, 2]
    "sensor.exposure" = 2
    "populations[1]".seed = "1,2"
    """
    quoted = {
        "tunnel.luminous_mm": "1:12:23", "tunnel.dark_mm": [1.0, 2.0], "sensor.exposure": 2.0,
        "populations[1].seed": "1,2",
    }  # fmt: skip
    station = Station.parse(DENTS + "1\n" + written)
    assert station.sweep.vary == quoted
    assert Station.parse(to_toml(station)) == station


def test_a_key_to_vary_stands_once_with_quotes_or_without():
    text = '[sweep.vary]\ntunnel.dark_mm = "1"\n"tunnel.dark_mm" = "2"'
    (told,) = sentences(text)
    assert "tunnel.dark_mm stands twice, with and without quotes; vary it once." in told


def test_an_entry_to_vary_without_quotes_is_told_to_need_them():
    (told,) = sentences('[sweep.vary]\ndefects[1].depth_um = "1:2:3"')
    assert told.endswith('a key with [1] in it needs quotes: "defects[1].depth_um".')


def test_a_size_left_to_the_map_is_written_as_such_for_a_file_to_start_from():
    station = example("measured")
    assert station.sides_of_map == ("length_mm", "width_mm")
    start = Station.parse(to_toml(station, sized=False))
    assert start.as_dict() == station.as_dict()
    assert start.sides_of_map == ("length_mm", "width_mm")
    assert Station.parse(to_toml(station)).sides_of_map == ()


def test_a_box_without_its_width_is_asked_for_it():
    with pytest.raises(StationError, match='width_mm is missing: section = "box" needs it'):
        Station.from_dict({"tunnel": {"section": "box"}})
