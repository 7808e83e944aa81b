"""Footprints added up once for all designs: as good as every sub-ray in every image."""

from __future__ import annotations

import gc
import weakref
from copy import copy
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
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

from gpuspec.errors import BackendError
from gpuspec.light import opencl_footprints
from gpuspec.light.constants import EXPOSURES, KINDS
from gpuspec.light.devices import open_backend
from gpuspec.light.levels import Zones, levels_of
from gpuspec.light.lists import Lists, Sets
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.refined import RefinedLightMap
from gpuspec.station.station import Station

Array = NDArray[Any]

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


def looked_at(light_map: RefinedLightMap) -> tuple[Array, Array]:
    """Places in the lists of the pixels in tables, and of those seen ray by ray."""
    lists: Any = light_map.lists
    held, *others = (batch.places for batch in lists.tables(light_map.station).batches)
    beyond = np.concatenate([np.zeros(0, int), *others])
    return np.unique(held), np.sort(beyond[beyond < len(light_map.places)])


def test_what_no_table_holds_is_seen_ray_by_ray(opencl):
    # A pinhole's sub-rays on a scratch: some are hundreds of times as narrow as all of them.
    light_map = traced(opencl)
    got = light_map.lists.means_of_exposures(light_map.station, [6.0])
    expected = Lists.means_of_exposures(light_map.lists, light_map.station, [6.0])
    held, beyond = looked_at(light_map)
    assert 0 < len(beyond) < len(held)
    assert np.array_equal(np.sort(np.concatenate([held, beyond])), np.arange(len(got[0])))
    close = np.abs(got[:, beyond] - expected[:, beyond]).max()
    assert close <= SAME_IMAGES_DN
    assert close < np.abs(got[:, held] - expected[:, held]).max()


@pytest.mark.parametrize(("bytes_", "some"), [(100_000, True), (8, False)])
def test_tables_take_no_more_memory_than_they_may(monkeypatch, bytes_, some):
    opencl = OpenCLBackend()
    light_map = traced(opencl, camera__pupil_mm=3.0)
    expected = light_map.closed_form()
    light_map.lists.release()
    monkeypatch.setattr(opencl, "memory_bytes", bytes_)
    # A list that would have to be traced in tiles is seen in tiles, too.
    assert np.abs(light_map.closed_form() - expected).max() <= FOOTPRINT_MAX_DN
    held, beyond = looked_at(light_map)
    assert (len(held) > 0) == some
    assert len(beyond) > 0


def test_tables_go_with_their_light_map(opencl):
    light_map = traced(opencl, camera__pupil_mm=3.0)
    light_map.closed_form()
    lists: Any = light_map.lists
    tables = weakref.ref(lists.tables(light_map.station))
    light_map.release()
    gc.collect()
    assert tables() is None
    with pytest.raises(BackendError, match="released"):
        lists.means_of_exposures(light_map.station, [1.0])


@pytest.mark.parametrize("engine", ["opencl", "numpy"])
def test_the_closed_form_of_a_noisy_station_has_no_noise(engine):
    light_map = traced(open_backend(engine))
    noisy = under(light_map, {"sensor.noise": True, "sequence.images": 8})
    quiet = under(light_map, {"sequence.images": 8})
    assert len(light_map.places)
    assert np.array_equal(light_map.closed_form(noisy), light_map.closed_form(quiet))


SENSORS = (
    {},
    {"sensor.prnu": 0.02, "sensor.dsnu_e": 5.0, "sensor.dark_e": 20.0, "sequence.images": 65},
    {"sensor.saturation_e": 300.0, "sensor.read_noise_e": 2.0, "sensor.black_level_dn": 5.0},
    {"sequence.images": 32, "sequence.step_mm": 3.0},  # six periods, and each shift twice
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


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("bits", [8, 12])
def test_the_device_counts_levels_as_the_host_does(opencl, bits, noise):
    changes = {"sensor__bit_depth": bits, "sensor__noise": noise}
    light_map = traced(opencl, camera__pupil_mm=3.0, **changes)
    random = np.random.default_rng(4)
    order = random.permutation(len(light_map.places))[: len(light_map.places) // 2]
    firsts = [
        np.array([0, 1, 40, 41, 300, len(order)]), np.array([0, 5, 9, 100, 101, len(order)])
    ]  # fmt: skip
    sets = [Sets(order, first, np.array([0, 2, 0, 1, 3]), np.arange(5)) for first in firsts]
    designs = [
        under(light_map, {**design, "sensor.exposure": exposure})
        for exposure in np.linspace(1.0, 8.0, EXPOSURES + 2)
        for design in DESIGNS[:3]
    ]
    counters = [light_map.lists.counter(own) for own in sets]
    for own, count in zip(sets, counters, strict=True):  # in turn
        got, told = count(designs), Lists.counter(as_host_does(light_map), own)(designs)
        assert np.array_equal(got.counts, told.counts)
        assert np.array_equal(got.highest, told.highest)
        assert got.counts.sum() == len(designs) * len(order)
        assert len(np.unique(got.highest)) > 5
        assert count([]).counts.shape == (0, KINDS, 256)


def as_host_does(light_map: RefinedLightMap) -> Any:
    """Lists whose images come from the device, and whose levels are counted by NumPy."""
    lists = copy(light_map.lists)
    lists._count = partial(Lists._count, lists)
    return lists


@pytest.mark.parametrize("images", [8, 65])
def test_zones_of_any_pixels_have_the_levels_of_the_image(opencl, images, monkeypatch):
    monkeypatch.setattr(opencl_footprints, "_STRETCH", 7)
    light_map = traced(opencl, camera__pupil_mm=3.0, sequence__images=images)
    random = np.random.default_rng(5)
    pixels = random.permutation(np.prod(light_map.shape)).astype(np.uint32)[:900]
    first = np.sort(random.integers(0, 900, 60))
    first = np.concatenate([[0], first, [900]])
    guard = random.permutation(np.setdiff1d(np.arange(np.prod(light_map.shape)), pixels))[:300]
    zones = Zones(pixels, first, np.ones(light_map.shape, bool), guard.astype(np.uint32))
    (got, told) = (
        light_map.counter(zones).count([light_map.station]),
        levels_of(light_map.aspect(), zones, 255.0),
    )
    own = np.isin(pixels, light_map.places)
    assert 0 < np.count_nonzero(own) < len(pixels)
    for name in ("inside", "outside", "guard"):  # level 0 is counted as it comes
        assert np.array_equal(getattr(got, name)[:, 1:], getattr(told, name)[:, 1:]), name
    assert np.array_equal(got.peaks, told.peaks)
