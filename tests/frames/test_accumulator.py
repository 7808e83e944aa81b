"""Frames added up as they come: exactly what all of them at once give."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.errors import FrameError
from gpuspec.frames.accumulator import Accumulator

FUSIONS = ("mean", "max", "min", "std", "differential")


def added(frames, fusion="mean", lag=1) -> Accumulator:
    sums = Accumulator(fusion, lag)
    for frame in frames:
        sums.add(frame)
    return sums


def at_once(frames: np.ndarray, fusion: str, lag: int) -> np.ndarray:
    frames = frames.astype(np.float64)
    if fusion == "differential":
        return np.abs(np.roll(frames, -lag, axis=0) - frames).mean(axis=0)
    return getattr(frames, fusion)(axis=0)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("fusion", FUSIONS)
@pytest.mark.parametrize("count", [5, 300])
def test_a_fusion_is_that_of_all_frames_at_once(fusion, kind, count):
    """300 frames of 8 bit no longer fit into a sum of 16 bit."""
    top = np.iinfo(kind).max
    frames = np.random.default_rng(count).integers(0, top, (count, 6, 9), kind, endpoint=True)
    frames[:, 0] = top
    frames[:, 1] = 0
    found = added(frames, fusion, lag=2).fused()
    assert found.dtype == np.float32
    assert found == pytest.approx(at_once(frames, fusion, 2), rel=2e-7, abs=2e-3)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_the_mean_is_rounded_once(kind):
    """300 frames of 16 bit add up to more than float32 counts to."""
    rng = np.random.default_rng(1)
    top = np.iinfo(kind).max
    frames = rng.integers(top - top // 10, top, (300, 30, 40), kind, endpoint=True)
    exact = (frames.sum(axis=0, dtype=np.int64) / 300).astype(np.float32)
    assert np.array_equal(added(frames).fused(), exact)


def test_a_differential_that_does_not_close_leaves_the_last_pairs_out():
    frames = np.random.default_rng(2).integers(0, 255, (9, 4, 4), np.uint8).astype(np.uint8)
    found = added(frames, "differential", 3).fused(periodic=False)
    expected = np.abs(frames[3:].astype(int) - frames[:-3]).mean(axis=0)
    assert found == pytest.approx(expected, rel=1e-6)
    with pytest.raises(FrameError, match=r"3 frames hold no pair sequence\.lag = 3 apart"):
        added(frames[:3], "differential", 3).fused()


@pytest.mark.parametrize("fusion", FUSIONS)
def test_a_camera_may_write_over_a_frame_that_was_added(fusion):
    frames = np.random.default_rng(3).integers(0, 255, (6, 5, 7), np.uint8).astype(np.uint8)
    sums, buffer = Accumulator(fusion), np.empty((5, 7), np.uint8)
    for frame in frames:
        buffer[:] = frame
        sums.add(buffer)
    assert np.array_equal(sums.fused(), added(frames, fusion).fused())


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (
            np.zeros((4, 6), np.uint8),
            r"shot 2 is uint8 of \(4, 6\) and the first uint8 of \(4, 5\)",
        ),
        (np.zeros((4, 5), np.uint16), "shot 2 is uint16"),
        (np.zeros((4, 5), np.float32), "shot 2 holds float32"),
        (np.zeros((4, 5, 3), np.uint8), r"shot 2 is not an image .*, but of \(4, 5, 3\)"),
        (np.zeros((0, 5), np.uint8), "shot 2 is not an image"),
        ([[1, 2], [3, 4]], "shot 2 is not an image of rows and columns, but list"),
        (None, "but NoneType"),
    ],
)
def test_a_frame_unlike_the_first_is_refused_and_not_added(frame, words):
    sums = Accumulator()
    sums.add(np.full((4, 5), 7, np.uint8))
    with pytest.raises(FrameError, match=words):
        sums.add(frame, "shot 2")
    assert sums.count == 1
    assert (sums.fused() == 7).all()


def test_no_frame_has_no_mean():
    with pytest.raises(FrameError, match="no frame was added"):
        Accumulator().fused()
