"""The memory of a light map: given back when asked, and not used after."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest
from scenes import check_station

from gpuspec.errors import BackendError
from gpuspec.light.devices import open_backend
from gpuspec.light.levels import Zones
from gpuspec.light.patterns import Pattern
from gpuspec.simulation.simulate import trace

NO_ZONE = np.zeros(check_station().shape, np.int32)


@pytest.mark.parametrize(
    "use",
    [
        "read", "lost", "aspect", "mean", "fuse", "closed_form", "faulty",
        lambda light_map: light_map.image(0),
        lambda light_map: light_map.lit_by(light_map.station),
        lambda light_map: light_map.counter(Zones.of(NO_ZONE, NO_ZONE == 0, 0)).count(
            [light_map.station]
        ),
    ],
)  # fmt: skip
def test_a_light_map_that_was_released_refuses_in_a_sentence(backend, use):
    with backend.trace(check_station()) as light_map:
        assert "read() gives" in repr(light_map)
    light_map.release()  # twice is once
    assert repr(light_map).endswith("; released)")
    assert light_map._repr_png_() is None
    with pytest.raises(BackendError, match=r"was released.*trace the station again"):
        use(light_map) if callable(use) else getattr(light_map, use)()


def test_a_counter_of_a_light_map_that_was_released_refuses_in_a_sentence(backend):
    light_map = backend.trace(check_station())
    counter = light_map.counter(Zones.of(NO_ZONE, NO_ZONE == 0, 0))
    light_map.release()
    with pytest.raises(BackendError, match="was released"):
        counter.count([light_map.station])


def test_the_memory_of_a_light_map_that_was_released_is_given_back(device_backend):
    light_map = device_backend.trace(check_station(camera__subsampling=1))
    ((tile, _),) = light_map.bands()
    buffers = [buffer for buffer in vars(tile).values() if not isinstance(buffer, int)]
    del tile
    nobody = users([object()])
    assert buffers
    assert min(users(buffers)) > nobody[0]
    light_map.release()
    gc.collect()
    assert set(users(buffers)) == set(nobody)


def users(buffers: list[object]) -> list[int]:
    """How many know each of some buffers, beside the list."""
    return [sys.getrefcount(buffer) for buffer in buffers]


def test_the_light_map_of_a_result_gives_back_what_its_device_holds(opencl):
    light_map = trace(check_station(), opencl).light_map
    own = light_map.traced
    with light_map:
        light_map.score()
    assert own.released
    with pytest.raises(BackendError, match="was released"):
        light_map.score()
    with pytest.raises(BackendError, match="was released"):
        light_map.image(0)


def test_what_another_pattern_lights_outlives_its_light_map():
    light_map = open_backend("vulkan").trace(check_station())
    lit = light_map.with_pattern(Pattern.read("binary"))
    other = lit.with_pattern(Pattern.read("sinusoidal"))
    expected = other.mean()
    light_map.release()
    lit.release()
    assert np.array_equal(other.mean(), expected)
    with pytest.raises(BackendError, match="was released"):
        lit.with_pattern(Pattern.read("sinusoidal"))
