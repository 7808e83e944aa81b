"""The slow background: as the level is, from whichever side it is looked at."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.detection.background import local_background

SIZES = [(157, 203), (160, 200), (60, 61), (7, 90)]
ROUNDING_DN = 1e-3  # of float32 sums of blocks of hundreds of grey levels, in another order
CUT_DN = 5e-3  # of a ramp of 0.5 DN a pixel: one that two blocks share is not flat


@pytest.mark.parametrize("window_px", [5.0, 12.0, 25.0, 37.5])
@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("whole", [True, False], ids=["all", "some"])
def test_the_background_of_a_turned_image_is_the_turned_background(shape, window_px, whole):
    rng = np.random.default_rng(3)
    image = rng.normal(90, 4, shape)
    y, x = (np.arange(n) / n - 0.5 for n in shape)
    region = np.full(shape, True) if whole else x**2 + 2 * y[:, None] ** 2 < 0.2
    found = local_background(image, region, window_px)
    turned = local_background(image[::-1, ::-1], region[::-1, ::-1], window_px)
    assert np.allclose(turned[::-1, ::-1], found, rtol=0, atol=ROUNDING_DN)


@pytest.mark.parametrize("window_px", [5.0, 12.0, 25.0, 37.5])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("shape", SIZES[:2])
def test_the_background_of_a_ramp_is_the_ramp(shape, axis, window_px):
    ramp = 0.5 * np.indices(shape)[axis]
    found = local_background(ramp, np.full(shape, True), window_px)
    inner = np.moveaxis(found - ramp, axis, 0)[int(window_px) : -int(window_px)]
    assert np.abs(inner).max() < CUT_DN


def test_a_ramp_is_followed_as_far_at_either_end():
    image = np.tile(np.arange(203.0), (157, 1))
    found = local_background(image, np.full(image.shape, True), 25.0)
    assert np.allclose(found + found[:, ::-1], 202, rtol=0, atol=ROUNDING_DN)
