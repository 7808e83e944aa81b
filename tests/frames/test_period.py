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


def short(images: int, span: float, more: int = 0) -> np.ndarray:
    """Samples of a part that shows a share of the period, under stripes that saturate."""
    turn = np.arange(images + more)[:, None] / images
    from_edge = np.abs((np.linspace(0, span, 900) + turn) % 1 - 0.5)
    light = 255 * np.clip((0.16 - from_edge) / 0.08 + 0.5, 0, 1)
    return light + np.random.default_rng(images).normal(0, 0.5, light.shape)


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


@pytest.mark.parametrize("span", [0.1, 0.3, 0.7, 1.3])
@pytest.mark.parametrize(("images", "known"), [(8, True), (16, True), (16, False), (40, False)])
def test_a_part_shorter_than_the_stripes_shows_frames_of_every_level(images, span, known):
    samples = short(images, span)
    assert np.ptp(samples.mean(axis=1)) > 0.3 * samples.mean()
    found = whole_periods(samples, names(images), rate=1 / images if known else None)
    assert (found.first, found.last, found.whole, found.why) == (0, images, True, {})


@pytest.mark.parametrize("spoilt", [0.0, 0.5])
@pytest.mark.parametrize("span", [0.3, 0.7])
@pytest.mark.parametrize("images", [16, 40])
def test_a_dark_frame_of_such_a_part_is_refused_where_light_is_due(images, span, spoilt):
    samples = short(images, span)
    lit = int(samples.mean(axis=1)[1:-1].argmax()) + 1
    samples[lit] *= spoilt
    for rate in (None, 1 / images):
        with pytest.raises(FrameError, match=rf"{lit:02}\.png does not belong"):
            whole_periods(samples, names(images), rate=rate)


def test_a_known_rate_tells_the_period_of_frames_that_are_alike():
    samples = short(40, 0.1, more=2)
    assert whole_periods(samples, names(42)).last == 42  # all dark, as others of them
    found = whole_periods(samples, names(42), rate=1 / 40)
    assert (found.last, found.whole, found.why[40]) == (40, True, "it repeats 00.png")


def test_a_rate_that_frames_contradict_is_not_believed():
    found = whole_periods(sequence(16, 15), names(16), rate=1 / 16)
    assert (found.last, found.whole, found.why) == (15, True, {15: "it repeats 00.png"})
