"""Axes and plans: every design by its number."""

from __future__ import annotations

import json

import pytest
from sweeping import GRID

import gpuspec
from gpuspec.errors import StationError
from gpuspec.station.station import Station
from gpuspec.sweeps.axes import axis
from gpuspec.sweeps.keeping.folder import differences
from gpuspec.sweeps.plan import SEED_STEP, Plan, scored_at, with_part


@pytest.mark.parametrize(
    ("key", "given", "values"),
    [
        ("tunnel.luminous_mm", "1:2:5", (1.0, 1.25, 1.5, 1.75, 2.0)),
        ("tunnel.luminous_mm", "0.1:0.9:9", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)),
        ("tunnel.luminous_mm", "4,1,2.5", (4.0, 1.0, 2.5)),
        ("tunnel.luminous_mm", [3, 5], (3.0, 5.0)),
        ("tunnel.luminous_mm", 3.0, (3.0,)),
        ("sequence.images", "8:40:5", (8, 16, 24, 32, 40)),
        ("sensor.bit_depth", "8,12", (8, 12)),
        ("sequence.step_mm", "0.5", (0.5,)),
        ("defects[1].depth_um", "1:3:3", (1.0, 2.0, 3.0)),
        ("populations[2].width_mm", "0.2,0.4", (0.2, 0.4)),
        ("populations[1].count", "7,9", (7, 9)),
        ("part.crown_radius_x_mm", "500,1000", (500.0, 1000.0)),
    ],
)
def test_an_axis_takes_ranges_and_values_of_any_numeric_key(station, key, given, values):
    found = axis(station, key, given)
    assert found.values == values
    assert [type(v) for v in found.values] == [type(v) for v in values]


@pytest.mark.parametrize(
    ("key", "given", "words"),
    [
        ("tunnel.lumious_mm", "1:2:3", "lumious_mm is not a known key (did you mean luminous_mm?)"),
        ("tunel.luminous_mm", "1:2:3", "tunel is not a known key (did you mean tunnel?)"),
        ("part.surface", "1:2:3", "part.surface is not a number"),
        ("sensor.noise", "0,1", "sensor.noise is not a number"),
        ("tunnel", "1,2", "tunnel is not a number"),
        ("defects[2].depth_um", "1,2", "there is no defects[2].depth_um to vary"),
        ("defects[1].points_mm", "1,2", "points_mm is not a known key"),
        ("segmentation.threshold", "1:9:3", "all 256 thresholds"),
        ("defects[0].depth_um", "1,2", "there is no defects[0].depth_um to vary"),
        ("tunnel__dark_mm", "1,2", "is not a known key (did you mean tunnel.dark_mm?)"),
        ("tunnel.dark_mm", "3:1:4", "is reversed; write 1:3:4"),
        ("tunnel.dark_mm", "1:3:0", "is empty"),
        ("tunnel.dark_mm", "1:3", "is not a range; write FROM:TO:COUNT"),
        ("tunnel.dark_mm", "1:3:2.5", "is not a range"),
        ("tunnel.dark_mm", "1:nan:3", "is not a range"),
        ("tunnel.dark_mm", "1:3:99999999999", "nothing could hold a sweep of them"),
        ("tunnel.dark_mm", "1:3:1", "asks for 1 value from 1 to 3"),
        ("tunnel.dark_mm", "3:3:4", "asks for 4 values from 3 to 3"),
        ("tunnel.dark_mm", [], "the list of values is empty"),
        ("tunnel.dark_mm", "1,x", "is not a list of numbers"),
        ("tunnel.dark_mm", [1, True], "is not a list of numbers"),
        ("tunnel.dark_mm", "inf", "only finite numbers"),
        ("tunnel.dark_mm", "2,1,2", "stands twice"),
        ("sequence.images", "8:80:7.5", "is not a range"),
        ("sequence.images", "8:81:10", "takes whole numbers"),
    ],
)
def test_a_wrong_axis_is_one_sentence(station, key, given, words):
    with pytest.raises(StationError) as error:
        axis(station, key, given)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_designs_of_one_light_map_are_neighbours(station):
    plan = Plan.of(station, {"sensor.exposure": "1,2", "tunnel.height_mm": "100,200,300"})
    assert [a.key for a in plan.axes] == ["tunnel.height_mm", "sensor.exposure"]
    assert (plan.designs, plan.geometries) == (6, 3)
    assert [plan.geometry_of(i) for i in range(6)] == [0, 0, 1, 1, 2, 2]
    assert plan.values(3) == {"tunnel.height_mm": 200.0, "sensor.exposure": 2.0}


def test_a_design_made_from_its_neighbour_is_the_one_made_from_scratch(station):
    plan = Plan.of(station, {**GRID, "tunnel.dark_mm": "1:9:3", "sensor.bit_depth": "8,10"})
    base = plan.station_of(0)
    for design in range(0, plan.designs, 97):
        assert plan.station_of(design, base) == plan.station_of(design)
        assert plan.station_of(design, base).shape == base.shape


def test_an_invalid_design_says_why_either_way(station):
    plan = Plan.of(station, {"sensor.exposure": "-1,4"})
    base = plan.station_of(1)
    for given in (None, base):
        with pytest.raises(StationError, match=r"sensor\.exposure = -1.* must be greater than 0"):
            plan.station_of(0, given)


def test_parts_differ_in_every_seed_and_the_first_is_the_stations_own(station):
    assert with_part(station, 0) is station
    other = with_part(station, 2)
    assert other.sensor.seed == 2 * SEED_STEP % 2**32
    assert [p.seed for p in other.populations] == [
        (1 + 2 * SEED_STEP) % 2**32, (2 + 2 * SEED_STEP) % 2**32
    ]  # fmt: skip
    assert other.defects == station.defects


def test_every_part_has_orange_peel_of_its_own(station):
    peel = {"wavelength_mm": 2.0, "slope_rad": 0.002, "seed": 7}
    peeled = station.replace(part__orange_peel=peel, populations=())
    seeds = [with_part(peeled, k, 1).part.orange_peel.seed for k in range(3)]
    assert seeds == [7, (7 + SEED_STEP) % 2**32, (7 + 2 * SEED_STEP) % 2**32]
    assert with_part(peeled, 2).part.shape == peeled.part.shape
    assert Plan.of(peeled, GRID, parts=3).parts == 3


def test_no_part_has_a_seed_of_another_s(station):
    """Populations with seeds 1 and 2, and noise: none is that of another part one further."""
    seeds = [p.seed for k in range(60) for p in with_part(station, k).populations]
    noise = [with_part(station, k, d).sensor.seed for k in range(60) for d in range(60)]
    assert len(set(seeds)) == 2 * 60
    assert len(set(noise)) == 60 * 60


def test_noise_alone_makes_parts_different(station):
    noisy = station.replace(populations=(), sensor__noise=True)
    assert Plan.of(noisy, GRID, parts=3).parts == 3


@pytest.mark.parametrize("own", [{"threshold": 80.0}, {"min_area_mm2": 0.1}], ids=str)
def test_a_plan_leaves_out_the_station_s_own_threshold_and_size_filter(station, own):
    """The threshold at once, the filter where pixels are scored."""
    plan = Plan.of(station.replace(segmentation=own), GRID)
    assert plan.station.segmentation.threshold == "auto"
    scored = scored_at(plan.station, 90.0).segmentation
    assert (scored.threshold, scored.min_area_mm2) == (90.0, 0.0)


@pytest.mark.parametrize(
    ("change", "given", "words"),
    [
        ({}, {}, "nothing to vary"),
        ({"defects": (), "populations": ()}, {"vary": GRID}, "no defects, so there is nothing"),
        ({"populations": ()}, {"vary": GRID, "parts": 2}, "would be 2 times the same"),
        ({}, {"vary": GRID, "parts": 0}, "1 to 1000 parts"),
        ({}, {"vary": GRID, "seeds": 2}, "has no noise, so 2 seeds would be 2 times the same"),
        ({"sensor__noise": True}, {"vary": GRID, "seeds": 0}, "1 to 1000 times, not 0"),
        ({}, {"vary": {"defects[1].x_mm": "1", "defects[01].x_mm": "2"}}, "is varied twice"),
        ({}, {"vary": {"tunnel.luminous_mm": "1:2:1000000", "tunnel.dark_mm": "1:2:1000000",
                       "sensor.exposure": "1:2:1000"}}, "more than could ever be done or stored"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_one_sentence(station, change, given, words):
    with pytest.raises(StationError, match=words):
        Plan.of(station.replace(**change), **given)


def test_a_plan_is_its_identity(station, tmp_path):
    plan = Plan.of(station, {**GRID, "tunnel.height_mm": "100,200"}, parts=3, samples=100)
    again = Plan.from_identity(json.loads(json.dumps(plan.identity())))
    assert again.identity() == plan.identity()
    for i in (0, 7):
        assert again.station_of(i).as_dict() == plan.station_of(i).as_dict()
    assert differences(plan.identity(), again.identity()) == []


def test_the_station_file_says_what_is_swept_and_simulate_leaves_it_alone(station):
    text = f"""
    {gpuspec.station.toml.to_toml(station)}
    [sweep]
    parts = 2
    [sweep.vary]
    "tunnel.luminous_mm" = "1:3:3"
    "sequence.images" = [8, 16]
    """
    read = Station.parse(text)
    plan = Plan.of(read)
    assert (plan.parts, plan.designs) == (2, 6)
    assert plan.station.as_dict() == station.as_dict()
    assert Station.parse(gpuspec.station.toml.to_toml(read)) == read


@pytest.mark.parametrize(
    ("key", "value"), [("background_mm", 3.0), ("polarity", "dark"), ("polarity", "both")]
)
def test_what_needs_whole_images_is_not_swept(key, value):
    station = gpuspec.example("trim").replace(**{f"segmentation__{key}": value})
    with pytest.raises(StationError, match=f"segmentation.{key} = {value} needs whole images"):
        Plan.of(station, {"sensor.exposure": [2, 4]})
