"""What every threshold finds is what segmentation finds at each, and the range is where it says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from gpuspec.detection.false_blobs import false_blobs
from gpuspec.detection.over_threshold import OverThreshold, over_threshold
from gpuspec.detection.score import score
from gpuspec.detection.segmentation import segment

SHAPE = (60, 90)
VALID = np.ones(SHAPE, np.bool_)
VALID[:, -5:] = False


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray]:
    """Four defects of different height on a noisy ground, with a few stains."""
    rng = np.random.default_rng(3)
    row, column = np.indices(SHAPE)
    image, truth = rng.normal(60, 2, SHAPE), np.zeros(SHAPE, np.int32)
    for number, (y, x, height) in enumerate(
        ((12, 15, 40), (40, 30, 25), (20, 60, 18), (45, 75, 60))
    ):
        away = np.hypot(row - y, column - x)
        image += height * np.exp(-((away / 5) ** 2))
        truth[away <= 5] = number + 1
    image[5, 40:44] += 9
    image[30, 50] += 14
    return image.astype(np.float32), truth


def guard_of(truth: np.ndarray) -> np.ndarray:
    return ndimage.binary_dilation(truth > 0, iterations=4)


def along(scene: tuple[np.ndarray, np.ndarray], least: int) -> OverThreshold:
    thresholds, guard = np.linspace(50, 110, 25), guard_of(scene[1])
    return over_threshold(*scene, VALID, guard, thresholds, min_area_px=least)


@pytest.mark.parametrize("least", [0, 3])
def test_every_threshold_finds_what_segmentation_finds_at_it(scene, least: int) -> None:
    image, truth = scene
    found = along(scene, least)
    for i, level in enumerate(found.threshold_dn):
        one = score(segment(image, VALID, level, min_area_px=least), truth, VALID, 4)
        assert (found.p1[i], found.p2[i], found.hits[i]) == (one.p1, one.p2, one.defects_hit)
        assert found.f1[i] == pytest.approx(one.f1)
        labels = false_blobs((image > level) & VALID, guard_of(truth), min_area_px=least)
        assert found.false_blobs[i] == labels.max()
        assert found.false_px[i] == np.count_nonzero(labels)


def test_a_threshold_that_rounds_to_a_pixel_s_level_does_not_detect_it(scene) -> None:
    image, truth = scene
    level = float(np.sort(image[truth > 0])[-20])  # a float32
    just = np.nextafter(np.float32(level), np.float32(0)).item()
    nearer = level - (level - just) / 4
    found = over_threshold(image, truth, VALID, guard_of(truth), np.array([just, nearer, level]))
    for i, threshold in enumerate((just, nearer, level)):
        one = score(segment(image, VALID, threshold), truth, VALID, 4)
        assert (found.p1[i], found.p2[i]) == (one.p1, one.p2)
    assert found.p2[0] > found.p2[1] == found.p2[2]


@pytest.mark.parametrize("least", [0, 3])
def test_within_the_range_all_is_found_and_nothing_else_and_beyond_it_not(scene, least) -> None:
    image, truth = scene
    (low, high), guard = along(scene, least).range_dn, guard_of(truth)

    def at(level: float) -> tuple[int, int]:
        one = over_threshold(image, truth, VALID, guard, np.array([level]), min_area_px=least)
        return int(one.hits[0]), int(one.false_blobs[0])

    just = 1e-3
    assert at(low) == at(high - just) == (4, 0)
    assert at(low - just)[1] > 0
    assert at(high)[0] == 3


@pytest.mark.parametrize("least", [0, 3])
def test_the_range_is_that_of_the_image_and_not_of_the_thresholds_tried(scene, least) -> None:
    image, truth = scene
    low, high = along(scene, least).range_dn
    for tried in ([(low + high) / 2], [high + 1, high + 9], [high + 100], [low - 10]):
        found = over_threshold(
            image, truth, VALID, guard_of(truth), np.array(tried), min_area_px=least
        )
        assert found.range_dn == (low, high)


def test_what_is_found_at_no_threshold_has_no_level(scene) -> None:
    image, truth = scene
    none = VALID & False
    least = image.size + 1  # a blob that no part is large enough for
    found = over_threshold(image, truth, VALID, guard_of(truth), np.array([60]), min_area_px=least)
    assert np.isnan(found.found_dn)
    assert found.clean_dn == image[VALID].min()
    assert over_threshold(image, truth, none, truth > 0, np.array([60])).clean_dn == 60


def test_a_smaller_filter_widens_the_range(scene) -> None:
    assert along(scene, 3).clean_dn < along(scene, 0).clean_dn


def test_where_a_stain_is_brighter_than_a_defect_there_is_no_range(scene) -> None:
    image, truth = scene
    stained = image.copy()
    stained[55, 5] = 100
    found = over_threshold(stained, truth, VALID, guard_of(truth), np.linspace(50, 110, 25))
    assert found.range_dn is None
    assert found.clean_dn == 100
    assert "at no threshold" in repr(found)


def test_without_zones_only_false_blobs_are_counted(scene) -> None:
    image, _ = scene
    none = np.zeros(SHAPE, np.int32)
    found = over_threshold(image, none, VALID, none > 0, np.array([70.0, 80.0]))
    assert found.defects == 0
    assert np.isnan(found.p2).all()
    assert np.isnan(found.found_dn)
    assert found.range_dn is None
    assert found.false_blobs[0] == ndimage.label((image > 70) & VALID, np.ones((3, 3)))[1]


def test_there_must_be_a_threshold(scene) -> None:
    with pytest.raises(ValueError, match="no threshold"):
        over_threshold(*scene, VALID, scene[1] > 0, np.array([]))
