"""Light maps of lists of pixels: on every backend those of the whole image, to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.constants import LINE
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

SCENE: dict[str, Any] = {
    "part": {"length_mm": 40.0, "width_mm": 30.0, "crown_radius_x_mm": 500.0},
    "camera": {"sampling_mm": 0.4, "columns": 120},
    "defects": [
        {"kind": "dent", "x_mm": 2.0, "y_mm": 1.0, "diameter_mm": 3.0, "depth_um": 20.0},
        {
            "kind": "scratch",
            "points_mm": [[-15, 5], [0, 9], [12, -3]],
            "width_mm": 1,
            "depth_um": 9,
        },
    ],
}


def scene(**changes: Any) -> Station:
    return Station.model_validate(SCENE).replace(**changes)


def scattered(station: Station, count: int) -> np.ndarray:
    """Pixels of runs and of anywhere, none twice, in no order."""
    rows, columns = station.shape
    every = np.random.default_rng(3).permutation(rows * columns).astype(np.uint32)
    run = np.arange(2000, 2600, dtype=np.uint32)
    return np.concatenate([run, every[~np.isin(every, run)]])[:count]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"part__surface": "height", "camera__subsampling": 2},
        {"sensor__noise": True, "sensor__prnu": 0.05, "sensor__seed": 5, "sequence__images": 9},
    ],
)
def test_a_list_s_pixels_are_those_of_the_image(backend: Backend, changes: dict[str, Any]) -> None:
    station = scene(**changes)
    relief = Relief.of(station)
    pixels = scattered(station, LINE + 77)
    whole, listed = backend.trace(station, relief), backend.trace(station, relief, pixels)
    assert listed.shape == (1, len(pixels))
    arrays, mine = whole.read(), listed.read()
    for name in ("light_mm", "wide_mm", "narrow_mm", "irradiance"):
        plane = getattr(arrays, name)
        there = plane.reshape(len(plane), -1)[:, pixels]
        assert np.ptp(there) > 0
        assert np.array_equal(getattr(mine, name)[:, 0], there), name
    assert np.array_equal(mine.lost[0], arrays.lost.flat[pixels])
    assert np.array_equal(listed.lost(), mine.lost)
    images = [(whole.aspect(), listed.aspect()), (whole.image(3), listed.image(3))]
    fused = whole.fuse(), listed.fuse()
    images += [(fused[0][name], fused[1][name]) for name in fused[0]]
    for image, own in images:
        assert np.array_equal(own[0], image.flat[pixels])


def test_a_list_may_be_empty(backend: Backend) -> None:
    listed = backend.trace(scene(), pixels=np.empty(0, np.uint32))
    assert listed.aspect().shape == (1, 0)
    assert listed.read().light_mm.shape == (1, 1, 0)


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        (np.array([0, 9000], np.uint32), "there is no pixel 9000; the image has 9000"),
        (np.array([1.5]), "a row of numbers of 32 bits"),
        (np.zeros((2, 2), np.uint32), "a row of numbers of 32 bits"),
    ],
)
def test_a_list_of_other_pixels_is_refused(backend: Backend, pixels: Any, said: str) -> None:
    with pytest.raises(StationError, match=said):
        backend.trace(scene(), pixels=pixels)
