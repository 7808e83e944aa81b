"""Laws of the threshold and of the label image."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.measure import label as skimage_label
from tolerances import THRESHOLD_STEP_DN

from gpuspec.detection import segmentation
from gpuspec.detection.segmentation import automatic_threshold, flawless_level, median, segment

EVERYWHERE = np.ones((4, 6), np.bool_)

masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12))


def drawing(*lines: str) -> np.ndarray:
    return np.array([[100.0 if c == "#" else 10.0 for c in line] for line in lines], np.float32)


def test_the_flawless_level_is_the_median_of_the_valid_pixels() -> None:
    aspect = np.array([[1, 2, 9], [200, 200, 200]], np.float32)
    valid = np.array([[True] * 3, [False] * 3])
    assert flawless_level(aspect, valid) == 2.0


@pytest.mark.parametrize("n", [1, 2, 99_999, 100_000])
@pytest.mark.parametrize(
    "levels",
    [
        lambda rng, n: rng.normal(80, 3, n),
        lambda rng, n: rng.integers(0, 4, n),
        lambda rng, n: np.full(n, 61.5),
        lambda rng, n: np.where(rng.random(n) < 0.5, 60, 200),
        lambda rng, n: np.concatenate([np.full(n // 2, 0.5), rng.random(n - n // 2)]),
    ],
    ids=["noise", "few levels", "one level", "two levels", "half even"],
)
def test_the_median_is_numpys_to_the_bit(levels: Callable[..., np.ndarray], n: int) -> None:
    values = levels(np.random.default_rng(n), n).astype(np.float32)
    assert median(values) == np.median(values)


def test_a_sample_that_misleads_does_not_move_the_median() -> None:
    values = np.arange(100_000.0)
    places = segmentation.sampled_places(values.size)
    values[places] = 1e6
    assert median(values) == np.median(values)


def test_the_median_and_the_threshold_leave_the_image_as_it_was() -> None:
    aspect = np.arange(24, dtype=np.float32).reshape(4, 6)[::-1].copy()
    before = aspect.copy()
    flawless_level(aspect, EVERYWHERE)
    automatic_threshold(aspect, EVERYWHERE, full_scale_dn=255, images=40)
    np.testing.assert_array_equal(aspect, before)


def test_on_an_even_background_the_threshold_is_two_percent_of_full_scale_above() -> None:
    aspect = np.full((4, 6), 60.0, np.float32)
    threshold = automatic_threshold(aspect, EVERYWHERE, full_scale_dn=255, images=1000)
    assert threshold == pytest.approx(60 + 5.125)  # 5.1, rounded up to an eighth


def test_with_few_images_the_threshold_is_one_image_and_its_noise_above() -> None:
    aspect = np.full((4, 6), 60.0, np.float32)
    threshold = automatic_threshold(aspect, EVERYWHERE, full_scale_dn=255, images=10)
    assert threshold == pytest.approx(60 + 28.125)  # 25.5 and a tenth of it, rounded up


def test_on_a_noisy_background_the_threshold_is_seven_robust_sigmas_above() -> None:
    aspect = np.array([[50, 60, 60, 70, 70, 80, 80, 90, 255]], np.float32)
    # Median 70; deviations 20 10 10 0 0 10 10 20 185, whose median is 10.
    threshold = automatic_threshold(aspect, aspect > 0, full_scale_dn=255, images=1000)
    assert threshold == pytest.approx(70 + 7 * 14.826, abs=THRESHOLD_STEP_DN)
    assert threshold >= 70 + 7 * 14.826


def test_defects_on_a_third_of_the_part_hardly_move_the_threshold() -> None:
    aspect = np.full((30, 30), 60.0, np.float32)
    aspect[:10] = 200
    threshold = automatic_threshold(aspect, aspect > 0, full_scale_dn=255, images=100)
    assert threshold == pytest.approx(60 + 0.02 * 255, abs=THRESHOLD_STEP_DN)


def test_invalid_pixels_move_no_threshold() -> None:
    aspect = np.full((4, 6), 60.0, np.float32)
    aspect[:2] = np.nan
    threshold = automatic_threshold(aspect, aspect > 0, full_scale_dn=255, images=1000)
    assert threshold == pytest.approx(65.125)


@pytest.mark.parametrize("sigma_dn", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_detected_on_a_noisy_flawless_part(sigma_dn: float, seed: int) -> None:
    noise = np.random.default_rng(seed).normal(0, sigma_dn, (500, 1000))
    aspect = (70 + noise).astype(np.float32)
    valid = np.ones(aspect.shape, np.bool_)
    threshold = automatic_threshold(aspect, valid, full_scale_dn=255, images=40)
    assert not segment(aspect, valid, threshold).any()


@pytest.mark.parametrize("images", range(1, 60))
def test_pixels_luminous_in_one_image_more_are_not_detected_even_with_float32_sums(
    images: int,
) -> None:
    luminous = np.arange(images + 1)
    total, running = np.zeros((2, images + 1), np.float32)
    for k in range(images):
        level = np.where(k < luminous, np.float32(255), np.float32(0))
        total += level
        running += (level - running) / np.float32(k + 1)
    for mean in (total * np.float32(1 / images), running):
        for one_less, one_more in itertools.pairwise(mean):
            aspect = np.array([[one_less, one_less, one_more]])
            valid = np.ones(aspect.shape, np.bool_)
            threshold = automatic_threshold(aspect, valid, full_scale_dn=255, images=images)
            assert not segment(aspect, valid, threshold).any()


def test_integer_grey_levels_are_segmented_like_reals() -> None:
    aspect = drawing("..##..", "......", "#.....", "......")
    of_bytes = aspect.astype(np.uint8)
    threshold = automatic_threshold(of_bytes, EVERYWHERE, full_scale_dn=255, images=40)
    assert threshold == automatic_threshold(aspect, EVERYWHERE, full_scale_dn=255, images=40)
    np.testing.assert_array_equal(
        segment(of_bytes, EVERYWHERE, threshold), segment(aspect, EVERYWHERE, threshold)
    )


def test_blobs_touching_at_a_corner_are_one_and_labels_follow_the_scan() -> None:
    aspect = drawing("...#.#", "#.#..#", "......", "..##..")
    labels = segment(aspect, EVERYWHERE, 50)
    expected = [
        [0, 0, 0, 1, 0, 2],
        [3, 0, 1, 0, 0, 2],
        [0, 0, 0, 0, 0, 0],
        [0, 0, 4, 4, 0, 0],
    ]
    assert labels.dtype == np.int32
    np.testing.assert_array_equal(labels, expected)


def test_small_blobs_leave_no_gap_in_the_labels() -> None:
    aspect = drawing("...#.#", "#.#..#", "......", "..###.")
    labels = segment(aspect, EVERYWHERE, 50, min_area_px=2)
    expected = [
        [0, 0, 0, 1, 0, 2],
        [0, 0, 1, 0, 0, 2],
        [0, 0, 0, 0, 0, 0],
        [0, 0, 3, 3, 3, 0],
    ]
    np.testing.assert_array_equal(labels, expected)
    assert segment(aspect, EVERYWHERE, 50, min_area_px=3).max() == 1
    assert segment(aspect, EVERYWHERE, 50, min_area_px=4).max() == 0


def test_a_pixel_at_the_threshold_is_not_detected() -> None:
    assert not segment(np.full((4, 6), 50.0), EVERYWHERE, 50).any()


def test_an_invalid_pixel_is_not_detected_and_parts_a_blob() -> None:
    aspect = drawing("###")
    for invalid in (100, np.inf, np.nan):
        aspect[0, 1] = invalid
        labels = segment(aspect, np.array([[True, False, True]]), 50)
        np.testing.assert_array_equal(labels, [[1, 0, 2]])


@given(masks)
def test_labels_are_those_of_scikit_image(detected: np.ndarray) -> None:
    labels = segment(detected.astype(np.float32), np.ones_like(detected), 0.5)
    expected = skimage_label(detected, connectivity=2)  # type: ignore[no-untyped-call, unused-ignore]
    np.testing.assert_array_equal(labels, expected)


@given(masks, st.integers(0, 8))
def test_the_size_filter_keeps_the_large_blobs_and_their_order(
    detected: np.ndarray, min_area_px: int
) -> None:
    aspect, valid = detected.astype(np.float32), np.ones_like(detected)
    every = segment(aspect, valid, 0.5)
    areas = np.bincount(every.ravel())[1:]
    kept = segment(aspect, valid, 0.5, min_area_px=min_area_px)
    np.testing.assert_array_equal(np.bincount(kept.ravel())[1:], areas[areas >= min_area_px])
    assert set(np.unique(every[kept > 0])) == set(np.flatnonzero(areas >= min_area_px) + 1)


def test_memory_order_changes_no_label() -> None:
    aspect = drawing("...#.#", "#.#..#", "......", "..##..")
    np.testing.assert_array_equal(
        segment(np.asfortranarray(aspect), np.asfortranarray(EVERYWHERE), 50),
        segment(aspect, EVERYWHERE, 50),
    )


def test_without_a_valid_pixel_there_is_no_level_and_no_threshold() -> None:
    aspect, nowhere = drawing("..."), np.zeros((1, 3), np.bool_)
    with pytest.raises(ValueError, match="No pixel is valid"):
        flawless_level(aspect, nowhere)
    with pytest.raises(ValueError, match="No pixel is valid"):
        automatic_threshold(aspect, nowhere, full_scale_dn=255, images=40)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_valid_pixel_that_is_not_a_number_is_refused(bad: float) -> None:
    aspect = drawing("...")
    aspect[0, 1] = bad
    with pytest.raises(ValueError, match="finite number at 1 valid"):
        segment(aspect, np.ones((1, 3), np.bool_), 50)
    with pytest.raises(ValueError, match="finite number at 1 valid"):
        flawless_level(aspect, np.ones((1, 3), np.bool_))


def test_what_cannot_be_segmented_is_refused_in_a_sentence() -> None:
    aspect, valid = drawing("..."), np.ones((1, 3), np.bool_)
    with pytest.raises(ValueError, match="valid must be an array of bool"):
        segment(aspect, valid.astype(np.uint8), 50)
    with pytest.raises(ValueError, match="valid must be an array of bool"):
        segment(aspect, valid.T, 50)
    with pytest.raises(ValueError, match="aspect must be an"):
        segment(aspect[0], valid[0], 50)
    with pytest.raises(ValueError, match="aspect must be an"):
        segment(aspect.astype(np.complex64), valid, 50)
    with pytest.raises(ValueError, match="threshold is not a number"):
        segment(aspect, valid, np.nan)
    with pytest.raises(ValueError, match="full_scale_dn"):
        automatic_threshold(aspect, valid, full_scale_dn=0, images=40)
    with pytest.raises(ValueError, match="images"):
        automatic_threshold(aspect, valid, full_scale_dn=255, images=0)
