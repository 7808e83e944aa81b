"""Laws of the blob table, and its agreement with scikit-image."""

from __future__ import annotations

import csv
import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.measure import label as skimage_label
from skimage.measure import regionprops_table
from tolerances import BLOB, BLOB_ANGLE, NINE_DIGITS

from gpuspec.detection.measures import Blobs, measure_blobs


def measured(
    labels: object, aspect: object = None, *, sampling_mm: float = 1.0, flawless_dn: float = 0.0
) -> Blobs:
    labels = np.asarray(labels, np.int32)
    aspect = np.ones(labels.shape) if aspect is None else np.asarray(aspect, np.float64)
    return measure_blobs(labels, aspect, sampling_mm=sampling_mm, flawless_dn=flawless_dn)


def random_blobs(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    detected = rng.random((60, 90)) < 0.35
    labels = skimage_label(detected, connectivity=2)  # type: ignore[no-untyped-call, unused-ignore]
    return labels, rng.uniform(0, 255, labels.shape).astype(np.float32)


small_labels = hnp.arrays(
    np.int32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.integers(0, 4)
)


def test_a_blob_is_measured_as_counted_by_hand() -> None:
    labels = [[0, 0, 0, 0], [0, 2, 2, 0], [0, 2, 2, 1]]
    aspect = [[9, 9, 9, 9], [9, 20, 30, 9], [9, 40, 50, 60]]
    blobs = measured(labels, aspect, sampling_mm=0.5, flawless_dn=10)
    assert len(blobs) == 2
    one, two = blobs.rows()
    assert two == pytest.approx(
        {
            "label": 2, "area_px": 4, "area_mm2": 1.0,
            "weight_dn": 140, "net_weight_dn": 100, "peak_dn": 50,
            "row": 1.5, "column": 1.5,
            "x_mm": 0.0,  # (1.5 + 0.5 - 2) · 0.5
            "y_mm": -0.25,  # (1.5 - 1.5 - 0.5) · 0.5
            "top": 1, "left": 1, "bottom": 3, "right": 3,
            # A square of side 2 px: variance 4/12, axes 4·√(1/3) px.
            "major_mm": 2 / np.sqrt(3), "minor_mm": 2 / np.sqrt(3),
            "orientation_rad": 0, "elongation": 1,
        }
    )  # fmt: skip
    assert (one["label"], one["row"], one["column"], one["peak_dn"]) == (1, 2, 3, 60)


def test_the_rows_hold_plain_ints_and_floats() -> None:
    (row,) = measured([[1]]).rows()
    assert {type(v) for v in row.values()} == {int, float}
    assert type(row["area_px"]) is int and type(row["area_mm2"]) is float


def test_a_single_pixel_has_the_axes_of_a_square() -> None:
    blobs = measured([[0, 1]], sampling_mm=2.0)
    assert blobs.major_mm[0] == blobs.minor_mm[0] == pytest.approx(2.0 * 4 / np.sqrt(12))
    assert blobs.elongation[0] == 1 and blobs.orientation_rad[0] == 0


def test_a_bar_is_as_elongated_as_it_is_long() -> None:
    for length in (2, 3, 10, 1000):
        assert measured(np.ones((1, length))).elongation[0] == pytest.approx(length)


@pytest.mark.parametrize(
    ("drawn", "expected"),
    [
        (np.ones((1, 5)), 0.0),
        (np.ones((5, 1)), np.pi / 2),
        (np.eye(5)[::-1], np.pi / 4),
        (np.eye(5), -np.pi / 4),
    ],
    ids=["along x", "along y", "rising", "falling"],
)
def test_orientation_is_counter_clockwise_from_x_with_y_up(
    drawn: np.ndarray, expected: float
) -> None:
    assert measured(drawn).orientation_rad[0] == pytest.approx(expected)


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=8)))
@example(np.array([[c == "#" for c in row] for row in (".##", ".##", ".##", ".#.", "###")]))
def test_rounding_chooses_no_orientation(half: np.ndarray) -> None:
    for mirrored in (np.hstack([half, half[:, ::-1]]), np.vstack([half, half[::-1]])):
        assert set(measured(mirrored).orientation_rad) <= {0.0, np.pi / 2}


def test_the_part_frame_has_its_origin_at_the_centre_and_y_up() -> None:
    labels = np.zeros((4, 6))
    labels[0, 0], labels[3, 5] = 1, 2
    blobs = measured(labels, sampling_mm=0.1)
    np.testing.assert_allclose(blobs.x_mm, [-0.25, 0.25], rtol=BLOB)
    np.testing.assert_allclose(blobs.y_mm, [0.15, -0.15], rtol=BLOB)


def test_labels_may_have_gaps() -> None:
    blobs = measured([[7, 0, 3, 3]])
    np.testing.assert_array_equal(blobs.label, [3, 7])
    np.testing.assert_array_equal(blobs.area_px, [2, 1])
    np.testing.assert_array_equal(blobs.left, [2, 0])


@pytest.mark.parametrize("shape", [(3, 4), (0, 4), (3, 0)])
def test_without_a_blob_the_table_is_empty(shape: tuple[int, int]) -> None:
    blobs = measured(np.zeros(shape))
    assert len(blobs) == 0 and blobs.rows() == []


@pytest.mark.parametrize("seed", range(5))
def test_measures_agree_with_scikit_image(seed: int) -> None:
    labels, aspect = random_blobs(seed)
    p = 0.05
    blobs = measured(labels, aspect, sampling_mm=p)
    expected = regionprops_table(  # type: ignore[no-untyped-call, unused-ignore]
        labels,
        aspect.astype(np.float64),
        properties=(
            "label", "area", "centroid", "bbox", "intensity_mean", "intensity_max",
            "inertia_tensor_eigvals", "orientation",
        ),
    )  # fmt: skip
    assert len(blobs) > 50
    np.testing.assert_array_equal(blobs.label, expected["label"])
    np.testing.assert_array_equal(blobs.area_px, expected["area"])
    for name, k in (("top", 0), ("left", 1), ("bottom", 2), ("right", 3)):
        np.testing.assert_array_equal(getattr(blobs, name), expected[f"bbox-{k}"])
    np.testing.assert_allclose(blobs.area_mm2, expected["area"] * p**2, rtol=BLOB)
    np.testing.assert_allclose(blobs.row, expected["centroid-0"], rtol=BLOB)
    np.testing.assert_allclose(blobs.column, expected["centroid-1"], rtol=BLOB)
    np.testing.assert_array_equal(blobs.peak_dn, expected["intensity_max"])
    np.testing.assert_allclose(
        blobs.weight_dn, expected["intensity_mean"] * expected["area"], rtol=BLOB
    )
    # scikit-image takes a pixel for a point: it leaves out the pixel's own 1/12 px².
    major, minor = (expected[f"inertia_tensor_eigvals-{k}"] for k in (0, 1))
    np.testing.assert_allclose(blobs.major_mm, 4 * p * np.sqrt(major + 1 / 12), rtol=BLOB)
    np.testing.assert_allclose(blobs.minor_mm, 4 * p * np.sqrt(minor + 1 / 12), rtol=BLOB)
    # scikit-image measures from the row axis, y down; the two differ by a quarter turn, modulo π.
    has_axis = major - minor > 1e-3 * major
    turn = blobs.orientation_rad - (expected["orientation"] + np.pi / 2)
    np.testing.assert_allclose(np.sin(turn[has_axis]), 0, atol=BLOB_ANGLE)


def test_axes_far_from_the_origin_do_not_cancel() -> None:
    near, far = np.zeros((4, 8)), np.zeros((4, 200_000))
    near[1, 1:4] = near[2, 2] = far[1, -4:-1] = far[2, -3] = 1
    for name in ("major_mm", "minor_mm"):
        np.testing.assert_allclose(
            getattr(measured(far), name), getattr(measured(near), name), rtol=BLOB
        )


@given(small_labels, st.integers(0, 5), st.integers(0, 5))
def test_translation_moves_the_place_only(labels: np.ndarray, down: int, right: int) -> None:
    rows, columns = labels.shape
    before = np.zeros((rows + down, columns + right), np.int32)
    after = before.copy()
    before[:rows, :columns] = after[down:, right:] = labels
    aspect = before * 3.0
    moved = measured(after, after * 3.0, flawless_dn=1)
    still = measured(before, aspect, flawless_dn=1)
    shifts = {
        "row": down, "column": right, "x_mm": right, "y_mm": -down,
        "top": down, "bottom": down, "left": right, "right": right,
    }  # fmt: skip
    for field in dataclasses.fields(Blobs):
        np.testing.assert_allclose(
            getattr(moved, field.name),
            getattr(still, field.name) + shifts.get(field.name, 0),
            rtol=BLOB,
            atol=BLOB,
        )


@given(small_labels)
def test_transposition_exchanges_rows_and_columns(labels: np.ndarray) -> None:
    aspect = labels * 3.0
    blobs, transposed = measured(labels, aspect), measured(labels.T, aspect.T)
    for name, other in (
        ("row", "column"), ("column", "row"), ("top", "left"), ("bottom", "right"),
        ("area_px", "area_px"), ("weight_dn", "weight_dn"), ("peak_dn", "peak_dn"),
        ("major_mm", "major_mm"), ("minor_mm", "minor_mm"),
    ):  # fmt: skip
        np.testing.assert_allclose(
            getattr(blobs, name), getattr(transposed, other), rtol=BLOB, atol=BLOB
        )
    np.testing.assert_allclose(blobs.x_mm, -transposed.y_mm, atol=BLOB)
    # Rows run down and y up, so that transposing is a mirror across the falling diagonal.
    has_axis = blobs.elongation > 1 + 1e-6
    turn = blobs.orientation_rad + transposed.orientation_rad + np.pi / 2
    np.testing.assert_allclose(np.sin(turn[has_axis]), 0, atol=BLOB_ANGLE)


@given(small_labels)
def test_every_measure_is_within_its_bounds(labels: np.ndarray) -> None:
    blobs = measured(labels)
    assert (blobs.orientation_rad > -np.pi / 2).all()
    assert (blobs.orientation_rad <= np.pi / 2).all()
    assert (blobs.elongation >= 1).all()
    assert (blobs.minor_mm >= 4 / np.sqrt(12) - BLOB).all()
    assert (blobs.top <= blobs.row).all() and (blobs.row <= blobs.bottom - 1).all()
    assert (blobs.left <= blobs.column).all() and (blobs.column <= blobs.right - 1).all()


@given(small_labels, st.floats(0.01, 10))
def test_lengths_scale_with_the_sampling(labels: np.ndarray, p: float) -> None:
    unit, scaled = measured(labels), measured(labels, sampling_mm=p)
    for name in ("x_mm", "y_mm", "major_mm", "minor_mm"):
        np.testing.assert_allclose(getattr(scaled, name), p * getattr(unit, name), rtol=BLOB)
    np.testing.assert_allclose(scaled.area_mm2, p**2 * unit.area_mm2, rtol=BLOB)
    np.testing.assert_allclose(scaled.elongation, unit.elongation, rtol=BLOB)


def test_weights_are_summed_in_float64() -> None:
    aspect = np.full((1000, 1000), 0.1, np.float32)
    blobs = measure_blobs(
        np.ones(aspect.shape, np.int32), aspect, sampling_mm=1, flawless_dn=float(aspect[0, 0])
    )
    assert blobs.weight_dn[0] == pytest.approx(1e6 * float(aspect[0, 0]), rel=BLOB)
    assert blobs.net_weight_dn[0] == 0


def test_a_level_outside_the_blobs_need_not_be_a_number() -> None:
    assert measured([[0, 1]], [[np.nan, 5]]).weight_dn[0] == 5


def test_the_csv_reads_back_as_the_table(tmp_path: Path) -> None:
    labels, aspect = random_blobs(0)
    blobs = measured(labels, aspect, sampling_mm=0.05)
    path = tmp_path / "blobs.csv"
    blobs.write_csv(path, classes=["dent, or bump"] * len(blobs))
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(blobs)
    assert {row["class"] for row in rows} == {"dent, or bump"}
    for column, name in (("row_px", "row"), ("x_mm", "x_mm"), ("weight_dn", "weight_dn")):
        np.testing.assert_allclose(
            [float(row[column]) for row in rows], getattr(blobs, name), rtol=NINE_DIGITS
        )


def test_the_csv_header_names_every_unit() -> None:
    file = io.StringIO()
    measured([[1]]).write_csv(file)
    header, row, *rest = file.getvalue().splitlines()
    assert header == (
        "label,area_px,area_mm2,weight_dn,net_weight_dn,peak_dn,row_px,column_px,x_mm,y_mm,"
        "top_px,left_px,bottom_px,right_px,major_mm,minor_mm,orientation_rad,elongation"
    )
    assert row.startswith("1,1,1,1,1,1,0,0,0,0,0,0,1,1,1.15470054,") and not rest
    assert not file.closed


def test_what_cannot_be_measured_is_refused_in_a_sentence() -> None:
    labels, aspect = np.ones((2, 3), np.int32), np.ones((2, 3))
    with pytest.raises(ValueError, match="aspect must be an array"):
        measured(labels, aspect.T)
    with pytest.raises(ValueError, match="labels must be an"):
        measure_blobs(labels > 0, aspect, sampling_mm=1, flawless_dn=0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="labels must be an"):
        measure_blobs(labels[0], aspect[0], sampling_mm=1, flawless_dn=0)
    with pytest.raises(ValueError, match="labels holds -1"):
        measured(-labels, aspect)
    with pytest.raises(ValueError, match="finite number"):
        measured(labels, aspect * np.nan)
    with pytest.raises(ValueError, match="sampling_mm"):
        measured(labels, aspect, sampling_mm=0)
    with pytest.raises(ValueError, match="flawless_dn"):
        measured(labels, aspect, flawless_dn=np.nan)
    blobs = measured(labels, aspect)
    with pytest.raises(ValueError, match="2 classes for 1 blobs"):
        blobs.write_csv(io.StringIO(), classes=["a", "b"])
    with pytest.raises(ValueError, match="Column area_px"):
        dataclasses.replace(blobs, area_px=np.array([1, 2]))
