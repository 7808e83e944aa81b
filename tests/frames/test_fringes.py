"""The light's phase over an image: period and direction."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.frames.fringes import fringes

DIRECTION_DEG = 0.05
"""Measured: 0.001. With the direction left open it was 15."""


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.4])
@pytest.mark.parametrize("rows", [60, 80, 200])
def test_the_direction_of_stripes_is_found_in_a_narrow_region_wherever_they_lie(rows, offset):
    """Blocks at no edge of it are a single row, which does not tell the slope across."""
    turn = np.arange(400) / 69.08 + offset + np.zeros((rows, 1))
    frames = [np.where((turn - k / 12) % 1 < 0.5, 160.0, 5.0) for k in range(12)]
    found = fringes(frames, 12, 1, np.full((rows, 400), True))
    assert abs(found.direction_deg) < DIRECTION_DEG
    assert found.period_px.value == pytest.approx(69.08, abs=0.02)
