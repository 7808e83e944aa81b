"""Laws of P1 and P2, and of the counts beside them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpuspec.detection.score import Score, score

TRUTH = np.array(
    [
        [1, 1, 0, 0, 2, 2],
        [1, 1, 0, 0, 2, 2],
        [0, 0, 0, 0, 0, 0],
    ]
)
EVERYWHERE = np.ones(TRUTH.shape, np.bool_)
NOTHING = np.zeros_like(TRUTH)


def test_a_score_is_as_counted_by_hand() -> None:
    labels = np.array(
        [
            [1, 1, 1, 0, 0, 0],
            [0, 1, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 2],
        ]
    )
    assert score(labels, TRUTH, EVERYWHERE, 2) == Score(
        p1=3 / 5, p2=3 / 8, f1=2 * (3 / 5) * (3 / 8) / (3 / 5 + 3 / 8),
        zone_px=8, hit_px=3, false_px=2,
        defects=2, defects_hit=1, unseen=0, blobs=2, false_blobs=1,
        defect_zone_px=(4, 4), defect_hit_px=(3, 0),
    )  # fmt: skip


def test_detecting_the_zones_exactly_is_perfect() -> None:
    perfect = score(TRUTH, TRUTH, EVERYWHERE, 2)
    assert (perfect.p1, perfect.p2, perfect.f1) == (1, 1, 1)
    assert (perfect.defects_hit, perfect.false_blobs) == (2, 0)


def test_an_empty_detection_is_precise_and_finds_nothing() -> None:
    empty = score(NOTHING, TRUTH, EVERYWHERE, 2)
    assert (empty.p1, empty.p2, empty.f1) == (1, 0, 0)
    assert (empty.blobs, empty.defects_hit) == (0, 0)


def test_detecting_only_elsewhere_has_every_figure_at_zero() -> None:
    wrong = score(np.where(TRUTH == 0, 1, 0), TRUTH, EVERYWHERE, 2)
    assert (wrong.p1, wrong.p2, wrong.f1) == (0, 0, 0)


def test_on_a_flawless_part_recall_is_undefined() -> None:
    clean = score(NOTHING, NOTHING, EVERYWHERE, 0)
    assert (clean.p1, clean.p2, clean.f1) == (1, None, None)
    assert "the part is flawless" in clean.summary
    noisy = score(TRUTH, NOTHING, EVERYWHERE, 0)
    assert (noisy.p1, noisy.p2, noisy.false_blobs) == (0, None, 2)


def test_pixels_that_are_not_valid_are_never_scored() -> None:
    valid = EVERYWHERE.copy()
    valid[0], valid[2] = False, False
    labels = np.array(
        [
            [1, 1, 1, 0, 3, 0],
            [0, 1, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 2],
        ]
    )
    s = score(labels, TRUTH, valid, 2)
    assert (s.zone_px, s.hit_px, s.false_px) == (4, 1, 0)
    assert (s.blobs, s.false_blobs, s.defects_hit) == (1, 0, 1)
    assert (s.defect_zone_px, s.defect_hit_px) == ((2, 2), (1, 0))


def test_an_unseen_defect_counts_and_is_not_hit() -> None:
    s = score(TRUTH, TRUTH, TRUTH != 2, 3)
    assert (s.defects, s.defects_hit, s.unseen) == (3, 1, 2)
    assert (s.p2, s.defect_zone_px) == (1, (4, 0, 0))
    assert "1 of 3 defects hit (2 unseen)" in s.summary
    assert s.hits == ("1 of 3", "2 without a pixel in the image")
    none_seen = score(NOTHING, TRUTH, TRUTH == 0, 2)
    assert (none_seen.p2, none_seen.unseen) == (None, 2)
    assert "no defect's zone has a pixel in the image" in none_seen.summary


def test_a_single_detected_pixel_has_an_f1() -> None:
    one = np.zeros_like(TRUTH)
    one.flat[np.flatnonzero(TRUTH)[0]] = 1
    s = score(one, TRUTH, EVERYWHERE, 2)
    assert (s.p1, s.p2, s.f1) == (1, 1 / 8, pytest.approx(2 / 9))


def test_a_blob_across_a_zone_and_its_surroundings_is_not_false() -> None:
    assert score(np.ones_like(TRUTH), TRUTH, EVERYWHERE, 2).false_blobs == 0


def test_the_summary_is_a_sentence() -> None:
    labels = np.where(TRUTH == 1, 1, 0)
    labels[2, 5] = 2
    assert score(labels, TRUTH, EVERYWHERE, 2).summary == (
        "Precision P1 0.800 (1 of 5 detected pixels outside the zones), recall P2 0.500 (4 of 8 "
        "zone pixels detected), 1 of 2 defects hit, 1 of 2 blobs false."
    )


def test_a_score_survives_json() -> None:
    for s in (score(TRUTH, TRUTH, EVERYWHERE, 2), score(NOTHING, NOTHING, EVERYWHERE, 0)):
        back = json.loads(json.dumps(s.as_dict()))
        for name in ("defect_zone_px", "defect_hit_px"):
            back[name] = tuple(back[name])
        assert Score(**back) == s


image = hnp.arrays(np.int32, (5, 6), elements=st.integers(0, 4))
mask = hnp.arrays(np.bool_, (5, 6))


@given(image, image, mask)
def test_every_figure_is_within_its_bounds(
    labels: np.ndarray, truth: np.ndarray, valid: np.ndarray
) -> None:
    s = score(labels, truth, valid, 4)
    assert 0 <= s.p1 <= 1
    assert (s.p2 is None) == (s.f1 is None) == (s.zone_px == 0)
    if s.p2 is not None and s.f1 is not None:
        assert 0 <= s.p2 <= 1 and 0 <= s.f1 <= 1
    assert s.hit_px + s.false_px == np.count_nonzero(labels[valid])
    assert (sum(s.defect_zone_px), sum(s.defect_hit_px)) == (s.zone_px, s.hit_px)
    assert s.defects_hit + s.unseen <= s.defects == len(s.defect_zone_px) == 4
    assert s.false_blobs <= s.blobs


@given(image, image, mask, st.permutations(range(1, 5)), st.integers(0, 100))
def test_relabelling_the_blobs_changes_no_score(
    labels: np.ndarray, truth: np.ndarray, valid: np.ndarray, order: list[int], gap: int
) -> None:
    relabelled = np.array([0, *(gap + i for i in order)])[labels]
    assert score(relabelled, truth, valid, 4) == score(labels, truth, valid, 4)


@given(image, image, mask)
def test_turning_the_part_changes_no_score(
    labels: np.ndarray, truth: np.ndarray, valid: np.ndarray
) -> None:
    turned = score(np.rot90(labels), np.rot90(truth), np.rot90(valid), 4)
    assert turned == score(labels, truth, valid, 4)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.int64])
def test_the_integer_type_of_a_label_image_changes_no_score(dtype: type) -> None:
    assert score(TRUTH.astype(dtype), TRUTH.astype(dtype), EVERYWHERE, 2) == score(
        TRUTH, TRUTH, EVERYWHERE, 2
    )


def test_what_cannot_be_scored_is_refused_in_a_sentence() -> None:
    with pytest.raises(ValueError, match="truth is"):
        score(TRUTH, TRUTH.T, EVERYWHERE, 2)
    with pytest.raises(ValueError, match="valid must be an array of bool"):
        score(TRUTH, TRUTH, EVERYWHERE.T, 2)
    with pytest.raises(ValueError, match="valid must be an array of bool"):
        score(TRUTH, TRUTH, EVERYWHERE.astype(int), 2)
    with pytest.raises(ValueError, match="labels must be an"):
        score(TRUTH * 1.0, TRUTH, EVERYWHERE, 2)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="truth holds -2"):
        score(TRUTH, -TRUTH, EVERYWHERE, 2)
    with pytest.raises(ValueError, match="truth holds the label 2 but the part has 1 defects"):
        score(TRUTH, TRUTH, EVERYWHERE, 1)
