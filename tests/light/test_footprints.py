"""Footprints added up once for all designs: as good as every sub-ray in every image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import check_station
from test_refinement import DEFECTS, SCENES
from tolerances import (
    DRAWN_SPREAD,
    FOOTPRINT_MAX_DN,
    FOOTPRINT_RMS_DN,
    REFINED_DEVIATION,
    REFINED_MEAN_DN,
    SAME_IMAGES_DN,
)

from gpuspec.light.constants import EXPOSURES
from gpuspec.light.lists import Lists, Sets
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.refined import RefinedLightMap
from gpuspec.station.station import Station

# Stripes from a tenth of a footprint to many of them, single images to more than are added up
# together, and shifts that fill several periods.
DESIGNS = (
    {},
    {"tunnel.luminous_mm": 0.4, "tunnel.dark_mm": 0.7, "sequence.images": 8},
    {"tunnel.luminous_mm": 9.0, "tunnel.dark_mm": 1.5, "sequence.images": 65},
    {"tunnel.luminous_mm": 3.0, "tunnel.dark_mm": 30.0, "sequence.images": 200},
    {"tunnel.dark_leak": 0.2, "sensor.exposure": 0.7, "sequence.images": 1},
    {"sensor.exposure": 8.0, "sequence.step_mm": 3.0, "sequence.images": 16},
    {"part.diffuse": 0.1, "sequence.images": 7},
)


def traced(backend: OpenCLBackend, **changes: Any) -> RefinedLightMap:
    station = check_station(pupil=0.0, exposure=6.0)
    station = station.replace(**{"camera.columns": 61, "camera.rows": 53, "defects": DEFECTS})
    light_map = backend.trace(station.replace(**changes))
    assert isinstance(light_map, RefinedLightMap)
    return light_map


def under(light_map: RefinedLightMap, design: dict[str, Any]) -> Station:
    return light_map.station.replace(**design)


@pytest.mark.parametrize("changes", SCENES.values(), ids=SCENES)
def test_tables_give_what_every_sub_ray_in_every_image_does(opencl, changes):
    errors = []
    for design in DESIGNS:
        retraced = {k: v for k, v in design.items() if k.startswith("part.")}
        light_map = traced(opencl, **changes, **retraced)
        station = under(light_map, design)
        exposures = [station.sensor.exposure]
        got = light_map.lists.means_of_exposures(station, exposures)
        expected = Lists.means_of_exposures(light_map.lists, station, exposures)
        assert got.shape == expected.shape == (1, len(light_map.places))
        errors.append((got - expected)[0])
    assert np.abs(np.concatenate(errors)).max() <= FOOTPRINT_MAX_DN
    assert np.sqrt((np.concatenate(errors) ** 2).mean()) <= FOOTPRINT_RMS_DN


def test_a_pixel_s_value_does_not_depend_on_those_beside_it(opencl):
    light_map = traced(opencl, camera__pupil_mm=3.0)
    some = light_map.places[np.random.default_rng(3).permutation(len(light_map.places))[:97]]
    whole, few = light_map.closed_form(), opencl.trace(light_map.station, pixels=some).aspect()
    assert np.array_equal(few[0], whole.flat[some])


def test_exposures_are_worked_out_together_as_one_by_one(opencl):
    light_map = traced(opencl, camera__pupil_mm=3.0)
    exposures = np.linspace(0.3, 9.0, EXPOSURES + 5)
    together = light_map.lists.means_of_exposures(light_map.station, exposures)
    for exposure, own in zip(exposures, together, strict=True):
        (alone,) = light_map.lists.means_of_exposures(light_map.station, [exposure])
        assert np.array_equal(own, alone)
    assert np.all(np.diff(together.mean(axis=1)) > 0)


def test_what_no_table_holds_is_seen_ray_by_ray(opencl):
    # A pinhole's sub-rays on a scratch: some are hundreds of times as narrow as all of them.
    light_map = traced(opencl)
    got = light_map.lists.means_of_exposures(light_map.station, [6.0])
    expected = Lists.means_of_exposures(light_map.lists, light_map.station, [6.0])
    lists: Any = light_map.lists
    held, *others = (np.unique(batch.places) for batch in lists._known.batches)
    beyond = np.concatenate(others)[:-1]  # the last is none
    assert 0 < len(beyond) < len(held)
    assert np.array_equal(np.sort(np.concatenate([held, beyond])), np.arange(len(got[0])))
    print(np.abs(got[:, beyond] - expected[:, beyond]).max())
    close = np.abs(got[:, beyond] - expected[:, beyond]).max()
    assert close <= SAME_IMAGES_DN
    assert close < np.abs(got[:, held] - expected[:, held]).max()


SENSORS = (
    {},
    {"sensor.prnu": 0.02, "sensor.dsnu_e": 5.0, "sensor.dark_e": 20.0, "sequence.images": 65},
    {"sensor.saturation_e": 300.0, "sensor.read_noise_e": 2.0, "sensor.black_level_dn": 5.0},
)


@pytest.mark.parametrize("pupil", [0.0, 3.0])
@pytest.mark.parametrize("changes", SENSORS)
def test_noise_is_what_a_sum_over_the_images_tells(opencl, changes, pupil):
    light_map = traced(opencl, camera__pupil_mm=pupil)
    station = under(light_map, {"sensor.noise": True, **changes})
    got, told = light_map.lists.moments(station), Lists.moments(light_map.lists, station)
    assert np.abs(got.mean - told.mean).max() <= REFINED_MEAN_DN
    seen = told.deviation > 0.02
    assert np.abs(got.deviation / told.deviation - 1)[seen].max() <= REFINED_DEVIATION
    draw = light_map.lists.one_draw(station)
    assert np.array_equal(light_map.one_draw(station).flat[light_map.places], draw)
    if not station.sensor.prnu:  # gain and dark signal are drawn with the seed
        others = [light_map.lists.one_draw(station.replace(sensor__seed=k)) for k in range(1, 41)]
        spread = np.std(others, axis=0)[seen] / told.deviation[seen]
        assert abs(np.sqrt((spread**2).mean()) - 1) <= DRAWN_SPREAD


@pytest.mark.parametrize("bits", [8, 12])
def test_the_device_counts_levels_as_the_host_does(opencl, bits):
    light_map = traced(opencl, camera__pupil_mm=3.0, sensor__bit_depth=bits)
    random = np.random.default_rng(4)
    order = random.permutation(len(light_map.places))[: len(light_map.places) // 2]
    first = np.array([0, 1, 40, 41, 300, len(order)])
    sets = Sets(order, first, np.array([0, 2, 0, 1, 2]), np.arange(5))
    designs = [
        under(light_map, {**design, "sensor.exposure": exposure})
        for exposure in np.linspace(1.0, 8.0, EXPOSURES + 2)
        for design in DESIGNS[:3]
    ]
    got = light_map.lists.count(designs, sets)
    expected = Lists.count(light_map.lists, designs, sets)
    assert np.array_equal(got.counts, expected.counts)
    assert np.array_equal(got.highest, expected.highest)
    assert got.counts.sum() == len(designs) * len(order)
    assert len(np.unique(got.highest)) > 5
