"""A station: values changed by path, schema, and what follows from its sections."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from pydantic import ValidationError
from stations import DENT, DENTS, STATIONS, sentences

from gpuspec.errors import StationError
from gpuspec.station.examples import example
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml


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
            "threshold", "elongation_min", "elongation_max", "vary", "height_scale",
            "f_number", "diffuse", "profile", "profile_gamma", "of_more_than", "of",
            "split"}  # fmt: skip
    schema = Station.model_json_schema()
    for table in schema["$defs"].values():
        for key, node in schema_properties(schema, table).items():
            if '"type": "number"' in json.dumps(node):
                units = ("_mm", "_um", "_rad", "_e", "_dn", "_mm2", "_cm2", "_lp_per_mm", "_deg",
                         "_nm", "_hz", "_e_per_s")  # fmt: skip
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
