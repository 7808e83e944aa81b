"""What is wrong with a station file is told in a sentence."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel
from stations import DENT, DENTS, sentences

from gpuspec.errors import StationError
from gpuspec.station.defects import Section
from gpuspec.station.station import Station

SCRATCH = '[[defects]]\nkind = "scratch"\nwidth_mm = 1\ndepth_um = 5\npoints_mm = '
HUGE = "1" + 400 * "0"
# One wrong value each: the text, and what its sentence says after the file's name.
WRONG = {
    "NaN": ("[part]\nlength_mm = nan", "part.length_mm = nan must be a finite number."),
    "infinite": ("[part]\nwidth_mm = -inf", "part.width_mm = -inf must be a finite number."),
    "zero": ("[tunnel]\nluminous_mm = 0", "tunnel.luminous_mm = 0 must be greater than 0."),
    "negative": ("[camera]\npupil_mm = -0.5", "camera.pupil_mm = -0.5 must be at least 0."),
    "too large": ("[part]\nroughness_rad = 1", "part.roughness_rad = 1 must be at most 0.2."),
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
        "segmentation.threshold = \"Auto\" must be 'auto', or a number from 0 to 65535.",
    ),
    "threshold below zero": (
        "[segmentation]\nthreshold = -1",
        "segmentation.threshold = -1 must be 'auto', or a number from 0 to 65535.",
    ),
    "threshold NaN": (
        "[segmentation]\nthreshold = nan",
        "segmentation.threshold = nan must be 'auto', or a number from 0 to 65535.",
    ),
    **{
        f"sub-rays {value}": (
            f"[camera]\nsubsampling = {value}",
            f"camera.subsampling = {value} must be 'auto', or a whole number from 1 to 16.",
        )
        for value in ('"automatic"', "0", "17", "true", "1.5", "nan", "[2]")
    },
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
        "xyz is not a known key; known here are camera, classes, dataset, decision, defects, "
        "edges, part, populations, segmentation, sensor, sequence, sweep, tolerance, tunnel.",
    ),
    "unknown key of two lines": (
        '[part]\n"a\\nb" = 1',
        'part."a\\nb" is not a known key; known here are crown_radius_x_mm, crown_radius_y_mm, '
        "diffuse, length_mm, material, mesh, orange_peel, pose, relief, roughness_rad, "
        "sphere_radius_mm, surface, waviness, width_mm.",
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
