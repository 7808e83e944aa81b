"""Laws of the class rules and of the confusion table."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpuspec.detection.classes import DEFAULT_RULES, ClassRule, classify, confusion
from gpuspec.detection.measures import Blobs, measure_blobs


def bars(*lengths: int, grey: float = 1.0) -> Blobs:
    """Measure bars one pixel wide: area in mm² = net weight / grey = elongation = length."""
    labels = np.zeros((2 * len(lengths), max(lengths, default=1)), np.int32)
    for i, length in enumerate(lengths):
        labels[2 * i, :length] = i + 1
    aspect = np.full(labels.shape, 10 + grey)
    return measure_blobs(labels, aspect, sampling_mm=1, flawless_dn=10)


def test_three_times_as_long_as_wide_is_a_scratch_by_default() -> None:
    assert classify(bars(1, 2, 4, 50), DEFAULT_RULES).tolist() == [
        "dent or bump", "dent or bump", "scratch", "scratch",
    ]  # fmt: skip


def test_the_first_matching_rule_wins() -> None:
    small, any_size = ClassRule("small", area_mm2=(None, 3)), ClassRule("any")
    assert classify(bars(2, 5), [small, any_size]).tolist() == ["small", "any"]
    assert classify(bars(2, 5), [any_size, small]).tolist() == ["any", "any"]


def test_a_bound_includes_its_minimum_and_not_its_maximum() -> None:
    rule = ClassRule("middle", area_mm2=(2, 4))
    assert classify(bars(1, 2, 3, 4), [rule]).tolist() == [
        "unclassified", "middle", "middle", "unclassified",
    ]  # fmt: skip


def test_weight_is_counted_above_the_flawless_level() -> None:
    rule = ClassRule("heavy", weight_dn=(6.0, None))
    assert classify(bars(2, 3, grey=2.0), [rule]).tolist() == ["unclassified", "heavy"]


def test_every_bound_of_a_rule_has_to_hold() -> None:
    rule = ClassRule("x", area_mm2=(2, None), weight_dn=(None, 50), elongation=(None, 6.5))
    assert classify(bars(1, 4, 7, grey=10), [rule]).tolist() == [
        "unclassified", "x", "unclassified",
    ]  # fmt: skip


def test_without_rules_every_blob_is_unclassified_and_without_blobs_there_is_no_class() -> None:
    assert classify(bars(1, 2), []).tolist() == ["unclassified"] * 2
    assert classify(bars(), DEFAULT_RULES).shape == (0,)


def test_a_rule_that_nothing_can_match_is_refused() -> None:
    with pytest.raises(ValueError, match="'x': area_mm2 from 2 to below 2 holds no value"):
        ClassRule("x", area_mm2=(2, 2))
    with pytest.raises(ValueError, match="elongation"):
        ClassRule("x", elongation=(float("nan"), None))
    for name in ("", "missed"):
        with pytest.raises(ValueError, match="cannot be named"):
            ClassRule(name)


def test_every_defect_and_every_false_blob_is_counted_once() -> None:
    truth = np.array(
        [
            [1, 1, 0, 2, 2, 0, 3],
            [1, 1, 0, 2, 2, 0, 3],
            [0, 0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0, 0],
        ]
    )
    labels = np.array(
        [
            [1, 1, 0, 2, 3, 0, 0],
            [1, 1, 0, 0, 3, 0, 0],
            [0, 0, 0, 0, 0, 0, 0],
            [0, 4, 4, 0, 5, 0, 6],
        ]
    )
    table = confusion(["dent", "scratch", "dent"], truth, labels, ["b", "b", "a", "a", "b", "a"])
    assert table.rows == ("dent", "scratch", "false")
    assert table.columns == ("a", "b", "missed")
    # Defect 1 is blob 1 (b), 2 is mostly blob 3 (a), 3 is missed; blobs 4, 5, 6 touch no zone.
    # Blob 2 touches a zone without being its blob: it is neither false nor counted.
    np.testing.assert_array_equal(table.counts, [[0, 1, 1], [1, 0, 0], [2, 1, 0]])


def test_on_a_tie_the_lowest_label_is_the_blob_of_the_defect() -> None:
    table = confusion(["dent"], np.array([[1, 1]]), np.array([[2, 1]]), ["first", "second"])
    assert table.columns == ("first", "second", "missed")
    np.testing.assert_array_equal(table.counts, [[1, 0, 0], [0, 0, 0]])


def test_one_blob_may_cover_two_defects() -> None:
    table = confusion(["dent", "bump"], np.array([[1, 2]]), np.array([[1, 1]]), ["c"])
    np.testing.assert_array_equal(table.counts, [[1, 0], [1, 0], [0, 0]])


def test_a_defect_without_zone_pixels_is_missed() -> None:
    table = confusion(["dent", "dent"], np.array([[1, 0]]), np.array([[1, 0]]), ["c"])
    np.testing.assert_array_equal(table.counts, [[1, 1], [0, 0]])


def test_without_defects_and_blobs_the_table_has_one_empty_cell() -> None:
    nothing = np.zeros((2, 2), np.int32)
    table = confusion([], nothing, nothing, [])
    assert (table.rows, table.columns) == (("false",), ("missed",))
    np.testing.assert_array_equal(table.counts, [[0]])


images = st.tuples(*[hnp.arrays(np.int32, (4, 5), elements=st.integers(0, 4))] * 2)


@given(images)
def test_counts_agree_with_one_defect_and_one_blob_at_a_time(
    pair: tuple[np.ndarray, np.ndarray],
) -> None:
    truth, labels = pair
    kinds = ["dent", "scratch", "dent", "bump"]
    classes = ["a", "b", "a", "c"][: labels.max()]
    table = confusion(kinds, truth, labels, classes)
    expected = np.zeros_like(table.counts)
    for i, kind in enumerate(kinds, start=1):
        covering = np.bincount(labels[truth == i], minlength=2)[1:]
        name = classes[int(covering.argmax())] if covering.any() else "missed"
        expected[table.rows.index(kind), table.columns.index(name)] += 1
    for b, name in enumerate(classes, start=1):
        if not truth[labels == b].any():
            expected[-1, table.columns.index(name)] += 1
    np.testing.assert_array_equal(table.counts, expected)


def test_what_cannot_be_compared_is_refused_in_a_sentence() -> None:
    truth = np.array([[1, 0]])
    with pytest.raises(ValueError, match="labels is"):
        confusion(["dent"], truth, truth.T, ["c"])
    with pytest.raises(ValueError, match="truth_labels must be"):
        confusion(["dent"], truth * 1.0, truth, ["c"])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="truth_labels holds 1 but 0 kinds"):
        confusion([], truth, truth, ["c"])
    with pytest.raises(ValueError, match="labels go up to 1 but 2 classes"):
        confusion(["dent"], truth, truth, ["c", "c"])
    with pytest.raises(ValueError, match="can be named"):
        confusion(["false"], truth, truth, ["c"])
    with pytest.raises(ValueError, match="can be named"):
        confusion(["dent"], truth, truth, ["missed"])
