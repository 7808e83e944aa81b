"""False blobs: what is detected beyond the guard bands around zones."""

import numpy as np
import pytest

from gpuspec.detection.false_blobs import false_blobs, least_pixels


def discs(shape: tuple[int, int], *places: tuple[float, float, float]) -> np.ndarray:
    row, column = np.indices(shape)
    labels = np.zeros(shape, np.int32)
    for number, (y, x, radius) in enumerate(places, 1):
        labels[np.hypot(row - y, column - x) <= radius] = number
    return labels


def test_the_rim_of_a_found_defect_is_no_error_and_what_is_beyond_is() -> None:
    guard = discs((60, 60), (30, 30, 12.0)) > 0
    detected = discs((60, 60), (30, 30, 10.0)) > 0
    assert false_blobs(detected, guard).max() == 0
    detected[5, 5:8] = detected[50, 50] = True
    found = false_blobs(detected, guard)
    assert found.max() == 2
    assert np.count_nonzero(found) == 4
    assert false_blobs(detected, guard, min_area_px=2).max() == 1


def test_a_threshold_under_the_flawless_level_is_not_free_of_error() -> None:
    guard = discs((60, 60), (30, 30, 12.0)) > 0
    assert false_blobs(np.full(guard.shape, True), guard).max() == 1


@pytest.mark.parametrize(("area", "pixels"), [(0.0, 0), (0.01, 1), (0.03, 3), (0.031, 4)])
def test_the_least_area_is_whole_pixels(area: float, pixels: int) -> None:
    assert least_pixels(area, 0.1) == pixels
