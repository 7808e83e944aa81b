"""Which frames make whole periods, and which do not belong."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.errors import FrameError
from gpuspec.frames.period import whole_periods

PIXELS = np.linspace(0, 20, 900)


def sequence(images: int, period: float, exposure: float = 1.0, noise: float = 0.5) -> np.ndarray:
    """Samples of a saturated sinusoid that moves on by 1 / period an image."""
    turn = 2 * np.pi * np.arange(images)[:, None] / period
    light = np.minimum(exposure * (60 + 58 * np.cos(PIXELS + turn)), 255)
    return light + np.random.default_rng(images).normal(0, noise, light.shape)


def names(images: int) -> list[str]:
    return [f"{k:02}.png" for k in range(images)]


@pytest.mark.parametrize("exposure", [1.0, 4.0])
@pytest.mark.parametrize("images", [6, 15, 40])
def test_a_whole_period_is_taken_whole(images, exposure):
    found = whole_periods(sequence(images, images, exposure), names(images))
    assert (found.first, found.last, found.whole, found.why) == (0, images, True, {})


@pytest.mark.parametrize("more", [1, 2, 5])
def test_what_comes_after_a_whole_period_is_left_out(more):
    found = whole_periods(sequence(15 + more, 15), names(15 + more))
    assert (found.first, found.last, found.whole) == (0, 15, True)
    assert found.why[15] == "it repeats 00.png"
    assert sorted(found.why) == list(range(15, 15 + more))


def test_of_several_periods_all_whole_ones_are_taken():
    found = whole_periods(sequence(34, 10), names(34))
    assert (found.last, found.whole) == (30, True)
    thirds = whole_periods(sequence(40, 40 / 3), names(40))  # whole only after three
    assert (thirds.last, thirds.whole) == (40, True)


def test_a_sequence_that_never_begins_again_is_no_whole_period():
    found = whole_periods(sequence(9, 20), names(9))
    assert (found.first, found.last, found.whole) == (0, 9, False)


def test_frames_of_another_level_are_left_out_at_the_ends():
    samples = np.vstack([np.full((1, 900), 1.2), sequence(15, 15)])
    found = whole_periods(samples, names(16))
    assert (found.first, found.last, found.whole) == (1, 16, True)
    assert "its mean is 1.2 DN and that of the others" in found.why[0]


def test_a_frame_from_elsewhere_in_the_middle_is_refused_by_name():
    samples = sequence(15, 15)
    samples[7] = samples[7].mean() + np.random.default_rng(1).choice([-58, 58], 900)
    with pytest.raises(FrameError, match=r"07\.png does not belong to the sequence: it is unlike"):
        whole_periods(samples, names(15))


def test_few_frames_tell_nothing():
    assert whole_periods(sequence(3, 3), names(3)).whole is None
