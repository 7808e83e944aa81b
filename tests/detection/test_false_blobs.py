"""False blobs, and the guard bands around the zones."""

import numpy as np
import pytest

from gpuspec.detection.false_blobs import GUARD_MIN_PX, false_blobs, guarded, least_pixels


def discs(shape: tuple[int, int], *places: tuple[float, float, float]) -> np.ndarray:
    row, column = np.indices(shape)
    labels = np.zeros(shape, np.int32)
    for number, (y, x, radius) in enumerate(places, 1):
        labels[np.hypot(row - y, column - x) <= radius] = number
    return labels


def test_a_guard_band_is_as_wide_as_half_its_own_zone() -> None:
    truth = discs((80, 160), (40, 40, 12.0), (40, 120, 4.0))
    row, column = np.indices(truth.shape)
    guard = guarded(truth)
    for x, radius in ((40, 12.0), (120, 4.0)):
        away = np.hypot(row - 40, column - x)
        assert guard[away <= 2 * radius - 0.5].all()
        assert not guard[(away > 2 * radius + 2) & (abs(column - x) < 40)].any()


def test_a_zone_of_one_pixel_has_a_guard_band_and_one_at_the_edge_keeps_it_inside() -> None:
    truth = np.zeros((9, 9), np.int32)
    truth[0, 0] = 1
    row, column = np.indices(truth.shape)
    np.testing.assert_array_equal(guarded(truth), np.hypot(row, column) <= GUARD_MIN_PX)


def test_a_part_without_zones_has_no_guard_band() -> None:
    assert not guarded(np.zeros((5, 7), np.int32)).any()


def test_the_rim_of_a_found_defect_is_no_error_and_what_is_beyond_is() -> None:
    truth = discs((60, 60), (30, 30, 6.0))
    detected = discs((60, 60), (30, 30, 10.0)) > 0
    assert false_blobs(detected, guarded(truth)).max() == 0
    detected[5, 5:8] = detected[50, 50] = True
    found = false_blobs(detected, guarded(truth))
    assert found.max() == 2
    assert np.count_nonzero(found) == 4
    assert false_blobs(detected, guarded(truth), min_area_px=2).max() == 1


def test_a_threshold_under_the_flawless_level_is_not_free_of_error() -> None:
    truth = discs((60, 60), (30, 30, 6.0))
    assert false_blobs(np.full(truth.shape, True), guarded(truth)).max() == 1


@pytest.mark.parametrize(("area", "pixels"), [(0.0, 0), (0.01, 1), (0.03, 3), (0.031, 4)])
def test_the_least_area_is_whole_pixels(area: float, pixels: int) -> None:
    assert least_pixels(area, 0.1) == pixels
