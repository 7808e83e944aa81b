"""What is typed wrongly in Python is done right, or refused in a sentence: never in silence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gpuspec as gs
from gpuspec.errors import GpuspecError, OutputError, StationError
from gpuspec.light.light_map import LightMap

DENT = {"kind": "dent", "x_mm": 3.0, "y_mm": -2.0, "diameter_mm": 1.2, "depth_um": 8.0}
STATION = gs.Station.from_dict(
    {
        "part": {"length_mm": 20.0, "width_mm": 10.0},
        "camera": {"sampling_mm": 0.1},
        "defects": [DENT],
        "populations": [
            {"kind": "bump", "count": 3, "seed": 5, "diameter_mm": 1.0, "depth_um": [3, 9]}
        ],
    },
    "s.toml",
)
ASKED = {
    "aspect": lambda m, s: m.aspect(s),
    "mean": lambda m, s: m.mean(s),
    "fuse": lambda m, s: m.fuse(s),
    "closed_form": lambda m, s: m.closed_form(s),
    "image": lambda m, s: m.image(0, s),
}
GEOMETRIES: dict[str, dict[str, Any]] = {
    "tunnel.height_mm is 120.0 and was 150.0": {"tunnel.height_mm": 120.0},
    "tunnel.section is arch and was ceiling": {
        "tunnel": {"section": "arch", "radius_mm": 200.0}
    },
    "tunnel.opening_length_mm is 20.0": {
        "tunnel": {"opening_length_mm": 20.0, "opening_width_mm": 20.0}
    },
    "camera.sampling_mm is 0.2": {"camera.sampling_mm": 0.2},
    "camera.pupil_mm is 0.0": {"camera.pupil_mm": 0.0},
    "camera.subsampling is 2": {"camera.subsampling": 2},
    "camera.vignetting is cos4": {"camera.vignetting": "cos4"},
    "part.material is gold and was ideal": {"part.material": "gold"},
    "part.roughness_rad is 0.01": {"part.roughness_rad": 0.01},
    "part.surface is height": {"part.surface": "height"},
    "part.crown_radius_x_mm is 900.0 and was None": {"part.crown_radius_x_mm": 900.0},
    "its part.relief is another": {
        "part.relief": {"file": "polished", "height_unit": "um", "pitch_um": 10.0}
    },
    "its defects are others": {"defects[1].depth_um": 3.0},
    "its defects are other": {"defects": []},
    "its populations are others": {"populations[1].seed": 6},
    "its populations are other": {"populations": []},
}  # fmt: skip


@pytest.fixture(scope="module")
def light_maps(backend) -> tuple[LightMap, LightMap]:
    """A backend's own light map, and that of a result."""
    return backend.trace(STATION), gs.simulate(STATION, backend).light_map


@pytest.mark.parametrize("asked", ASKED)
def test_an_image_of_another_geometry_is_refused_with_what_differs(light_maps, asked):
    for words, change in GEOMETRIES.items():
        for light_map in light_maps:
            with pytest.raises(StationError) as caught:
                ASKED[asked](light_map, STATION.replace(**change))
            text = str(caught.value)
            assert text.startswith("s.toml: ")
            assert words in text
            assert text.endswith("trace the station anew, e.g. by gpuspec.simulate.")


def test_every_key_of_the_geometry_is_watched():
    """A key that is added to part, camera or tunnel belongs to it, unless it is named as light."""
    light_map = gs.simulate(STATION, "numpy").light_map
    for section in ("part", "camera", "tunnel"):
        model = getattr(STATION, section)
        for key in type(model).model_fields:
            other = model.model_copy(update={key: "another"})
            station = STATION.model_copy(update={section: other})
            if (section, key) in (("tunnel", "luminous_mm"), ("tunnel", "dark_mm"),
                                  ("tunnel", "dark_leak"), ("tunnel", "profile"),
                                  ("tunnel", "profile_gamma")):  # fmt: skip
                assert light_map.lit_by(station) is station
                continue
            with pytest.raises(StationError, match=f"{section}.{key}"):
                light_map.lit_by(station)


def test_a_map_of_the_same_name_in_another_folder_is_another_geometry(tmp_path):
    def measured(folder: Path) -> gs.Station:
        folder.mkdir()
        (folder / "map.npy").touch()
        relief = {"file": "map.npy", "height_unit": "um", "pitch_um": 10.0}
        part = {"length_mm": 5.0, "width_mm": 5.0, "relief": relief}
        return gs.Station.from_dict({"part": part}, "s.toml", folder)

    class Traced(LightMap):
        read = lost = image = mean = fuse = closed_form = None  # type: ignore[assignment]

    light_map = Traced()
    light_map.station = measured(tmp_path / "a")
    same = light_map.station.replace(sensor__exposure=2)
    assert light_map.lit_by(same) is same
    with pytest.raises(StationError, match=r"map\.npy is .*b.map\.npy and was .*a.map\.npy"):
        light_map.lit_by(measured(tmp_path / "b"))


def test_another_light_on_the_same_geometry_is_no_other_geometry(light_maps):
    other = STATION.replace(
        tunnel__luminous_mm=2.0, tunnel__dark_mm=6.0, tunnel__dark_leak=0.1, sensor__exposure=2.0,
        sensor__bit_depth=12, sequence__images=16, segmentation__threshold=900.0,
    )  # fmt: skip
    own, scored = light_maps
    assert np.array_equal(own.aspect(other), scored.aspect(other))
    assert own.aspect(other).max() > 255


# -------------------------------------------------------------------------------- image numbers


@pytest.mark.parametrize(
    "k", [1000, 40, -1, 2.5, np.float64(3), "3", None, True, np.True_, [1], np.array([1, 2])]
)
def test_there_is_no_such_image(light_maps, k):
    for light_map in light_maps:
        with pytest.raises(StationError, match=r"there is no image .*; sequence\.images = 40"):
            light_map.image(k)


@pytest.mark.parametrize("k", [3, np.int64(3), np.uint8(3), np.array(3)])
def test_an_image_has_one_number_whatever_its_type(light_maps, k):
    for light_map in light_maps:
        assert np.array_equal(light_map.image(k), light_maps[0].image(3))


# ----------------------------------------------------------------------------- stations as given


@pytest.mark.parametrize("given", ["file", "trim", "no/such.toml", Path("file")])
def test_a_file_that_is_not_there_is_named(given):
    with pytest.raises(StationError, match=f"{given}: no such station file; `gpuspec init`"):
        gs.simulate(given)


@pytest.mark.parametrize(
    ("key", "value", "plain"),
    [
        ("sequence.images", np.int64(8), 8),
        ("sequence.images", np.array(8), 8),
        ("camera.columns", np.uint8(7), 7),
        ("sensor.exposure", np.float32(2.5), 2.5),
        ("sensor.exposure", np.int32(3), 3.0),
        ("sensor.noise", np.True_, True),
        ("part.material", np.str_("gold"), "gold"),
        ("defects[1].depth_um", np.float64(3), 3.0),
        ("populations[1].diameter_mm", np.array([0.5, 1.0]), [0.5, 1.0]),
        ("sensor", {"exposure": np.float64(3)}, {"exposure": 3.0}),
        ("defects", np.array([DENT, DENT]), [DENT, DENT]),
        ("sweep", {"vary": {"sensor.exposure": np.array([2.0, 4.0])}},
         {"vary": {"sensor.exposure": [2.0, 4.0]}}),
    ],
)  # fmt: skip
def test_numbers_of_numpy_are_numbers(key, value, plain):
    assert STATION.replace(**{key: value}) == STATION.replace(**{key: plain}) != STATION
    section, _, name = key.partition(".")
    if name and "[" not in section:
        made = gs.Station(**{section: {name: value}})
        assert made == gs.Station.from_dict({section: {name: value}})
        assert made == gs.Station(**{section: {name: plain}})


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("sequence.images", np.float64(8.5), "must be a whole number"),
        ("sequence.images", np.True_, "must be a whole number"),
        ("sequence.images", np.array([8, 9]), "must be a whole number"),
        ("sensor.exposure", np.nan, "must be a finite number"),
        ("sensor.exposure", np.array(["a"]), "must be a number"),
        ("sensor.noise", np.int64(1), "must be true or false"),
        ("defects", np.zeros((2, 2)), r"defects\[1\] = \[0.0, 0.0\] must be a table"),
        ("tunnel", 5, "tunnel = 5 must be a table"),
        ("tunel", {}, "tunel is not a known key .did you mean tunnel"),
        ("tunnel.dark", 5, "tunnel.dark is not a known key .did you mean dark_mm"),
        ("camera.tunnel.dark_mm", 5, "camera.tunnel is not a known key"),
        ("defects[2].depth_um", 5, "no such entry"),
        ("", 5, "is not a known key"),
    ],
)
def test_a_wrong_value_or_key_is_refused(key, value, why):
    with pytest.raises(StationError, match=why):
        STATION.replace(**{key: value})
    if "." not in key and "[" not in key and key:
        for make in (lambda data: gs.Station(**data), gs.Station.from_dict):
            with pytest.raises(StationError, match=why):
                make({key: value})


@pytest.mark.parametrize("wrong", [None, [1], "part", 5, [("part", {})]])
def test_a_station_is_made_of_a_dictionary(wrong):
    with pytest.raises(StationError, match="a station is made of a dictionary of its sections"):
        gs.Station.from_dict(wrong)


def test_stations_are_equal_by_what_they_say_and_not_where_they_were_read(tmp_path):
    read = gs.Station.read(STATION.write(tmp_path / "a.toml"))
    assert read == STATION
    assert hash(read) == hash(STATION)
    assert read != STATION.replace(sensor__exposure=2)
    assert (read == "a.toml") is False
    relief = {"file": "map.npy", "height_unit": "um", "pitch_um": 10.0}
    part = {"length_mm": 5.0, "width_mm": 5.0, "relief": relief}
    (tmp_path / "b").mkdir()
    one, other = (
        gs.Station.from_dict({"part": part}, "s.toml", f) for f in (tmp_path, tmp_path / "b")
    )
    assert one != other


# --------------------------------------------------------------------------- names and options


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda: gs.study("covrage", STATION), "there is no study 'covrage'; choose one of"),
        (lambda: gs.study(5, STATION), "there is no study 5"),
        (lambda: gs.study("coverage", STATION, steps=3), "coverage takes no steps; it takes dent"),
        (lambda: gs.study("height", STATION, backend="numpy"), "height takes no backend"),
        (lambda: gs.simulate(STATION, 5), "a backend is an open Backend or one of auto, opencl"),
        (lambda: gs.simulate(STATION, "cuda"), "'cuda' is not known; choose one of auto"),
        (lambda: gs.simulate(STATION, "numpy", 5), "no device '5'; choose by number or name"),
        (lambda: gs.example("trims"), "there is no example 'trims'; choose one of"),
        (lambda: gs.sweep(STATION, ["sensor.exposure=2"], "run"), "a dictionary of keys"),
        (lambda: gs.sweep(STATION, {"sensor.exposur": [2]}, "run"), "is not a known key"),
        (lambda: gs.sweep(STATION, {"sensor.exposure": [2, 4]}, 5), "named by its path"),
        (lambda: gs.choose("nowhere"), "nowhere holds no sweep"),
        (lambda: gs.load("nowhere"), "nowhere is not there"),
    ],
)
def test_a_wrong_name_or_option_is_refused_in_a_sentence(call, why, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(GpuspecError, match=why):
        call()
    assert not list(tmp_path.iterdir())


def test_a_picture_by_its_name_is_no_way_to_write_a_file(tmp_path):
    result = gs.simulate(STATION, "numpy")
    with pytest.raises(StationError, match="there is no picture"):
        result.picture(tmp_path / "aspect.png")
    with pytest.raises(OutputError, match="named by its path"):
        result.save(3.5)
