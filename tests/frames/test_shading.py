"""Dark and flat frames, taken off what the sequence is fused to."""

from __future__ import annotations

import numpy as np
import pytest

import gpuspec
from gpuspec.errors import FrameError
from gpuspec.frames.accumulator import Accumulator
from gpuspec.frames.shading import Shading

SHAPE = (20, 30)
REGION = np.full(SHAPE, True)
RNG = np.random.default_rng(7)
GAIN = RNG.uniform(0.5, 1.5, SHAPE)
DARK = RNG.integers(3, 9, SHAPE).astype(np.float32)
SCENE = RNG.uniform(20, 100, (8, *SHAPE))
FRAMES = np.rint(SCENE * GAIN + DARK).astype(np.uint8)
FLAT = (100 * GAIN + DARK).astype(np.float32)


@pytest.mark.parametrize("fusion", ["mean", "max", "min", "std", "differential"])
def test_what_is_done_once_is_what_is_done_to_every_frame(fusion):
    sums = Accumulator(fusion)
    for frame in FRAMES:
        sums.add(frame)
    found = Shading(DARK, FLAT).corrected(sums.fused(), fusion, REGION)
    gain = np.median(FLAT - DARK) / (FLAT - DARK)
    each = (FRAMES - DARK) * gain
    if fusion == "differential":
        expected = np.abs(np.roll(each, -1, axis=0) - each).mean(axis=0)
    else:
        expected = getattr(each, fusion)(axis=0)
    assert found == pytest.approx(expected, abs=1e-3)


def test_without_dark_and_flat_frames_nothing_changes():
    aspect = SCENE[0].astype(np.float32)
    assert np.array_equal(Shading().corrected(aspect, "mean", REGION), aspect)


def test_a_flat_frame_that_is_dark_where_it_matters_is_refused_and_elsewhere_not():
    flat = FLAT.copy()
    flat[2:4, 5:10] = DARK[2:4, 5:10]
    aspect = SCENE[0].astype(np.float32)
    with pytest.raises(FrameError, match="as dark as the dark one at 10 pixels"):
        Shading(DARK, flat).corrected(aspect, "mean", REGION)
    without = REGION.copy()
    without[2:4, 5:10] = False
    assert np.isfinite(Shading(DARK, flat).corrected(aspect, "mean", without)).all()


@pytest.mark.parametrize("name", ["dark", "flat"])
def test_shading_frames_of_another_size_or_of_a_missing_file_are_refused_by_name(name, tmp_path):
    with pytest.raises(FrameError, match=f"the {name} frame has 8 x 9 pixels and the frames 30 x"):
        gpuspec.inspect(FRAMES, **{name: np.ones((2, 9, 8), np.uint8)})
    with pytest.raises(FrameError, match=r"nothing\.png is not there"):
        gpuspec.inspect(FRAMES, **{name: tmp_path / "nothing.png"})
