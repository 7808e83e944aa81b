"""Frames replayed at other exposures show the paper's claim: no contrast unless they saturate."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.errors import FrameError
from gpuspec.frames.replay import replay

REGION = np.full((120, 200), True)


def frames(images: int = 15) -> np.ndarray:
    """Unsaturated frames of a sinusoid on a mirror with two scratches that see all of it."""
    x = np.arange(200) + np.zeros((120, 1))
    turns = 2 * np.pi * np.arange(images) / images
    light = np.stack([60 + 58 * np.cos(x / 9 + turn) for turn in turns])
    light[:, 30:32, 60:95] = light[:, 80:82, 110:145] = 60.0
    noise = np.random.default_rng(2).normal(0, 1, light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def test_what_does_not_saturate_has_no_contrast_and_what_does_has():
    found = replay(frames(), [1.0, 2.0, 4.0, 8.0], 255, REGION)
    assert found.saturated[0] == 0
    assert (np.diff(found.saturated) >= 0).all()
    assert abs(found.contrast_dn[0]) < 1.0
    assert (found.contrast_dn[2:] > 20).all()
    assert found.best > 1
    assert found.scratch_px == pytest.approx(72, abs=4)


def test_a_saturated_mean_is_that_of_saturated_frames():
    """Checked against saturating every frame by itself."""
    shots = frames()
    found = replay(shots, [4.0], 255, REGION)
    direct = np.minimum(4.0 * shots, 255)
    assert found.saturated[0] == pytest.approx((direct == 255).mean(), abs=1e-9)
    again = replay(direct.astype(np.uint8), [1.0], 255, REGION)
    assert again.noise_dn == pytest.approx(found.noise_dn, rel=0.02)


@pytest.mark.parametrize("exposures", [[], [0.0], [-1.0], [np.nan], [np.inf]])
def test_an_exposure_is_a_number_above_0(exposures):
    with pytest.raises(FrameError, match="numbers above 0"):
        replay(frames(4), exposures, 255, REGION)


def test_no_frame_is_refused():
    with pytest.raises(FrameError, match="no frame"):
        replay([], [1.0], 255, REGION)
