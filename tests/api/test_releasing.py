"""A result gives the memory of its device back, and keeps what is at home."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import check_station

import gpuspec as gs
from gpuspec.errors import BackendError


def test_a_result_keeps_what_is_at_home_when_its_light_map_is_released(backend):
    result = gs.simulate(check_station(), backend)
    own = result.light_map.traced
    with result.light_map as light_map:
        assert np.array_equal(light_map.aspect(), result.aspect)
    assert own.released
    assert np.array_equal(light_map.lost(), result.lost)
    for ask in (light_map.aspect, light_map.score, light_map.read, lambda: light_map.image(0)):
        with pytest.raises(BackendError, match=r"was released.*trace the station again"):
            ask()


def test_a_light_map_that_was_never_traced_again_is_released_without_a_trace(tmp_path):
    gs.simulate(check_station(), "numpy").save(tmp_path / "run", pictures=False)
    light_map = gs.load(tmp_path / "run").light_map
    light_map.release()
    assert light_map._traced is None
    with pytest.raises(BackendError, match="was released"):
        light_map.aspect()
