"""The words of `kernels/portable.h` that are functions where a REAL is a vector."""

from __future__ import annotations

import numpy as np
from device import LANES, Device
from laws import Draws, holds, stacked


@holds("greater", wrong=("a > b ? a : b", "a > b ? b : a"))
@holds("lesser", wrong=("a < b ? a : b", "a < b ? b : a"))
@holds("least_of", wrong=("two.x < two.y ? two.x : two.y", "two.x"))
def test_least_and_greatest_are_exact_and_no_number_is_the_bound(device: Device) -> None:
    """`max` is greater(a, b), `min` is lesser(a, b) and `LEAST` is least_of(x) in vectors."""
    d = Draws(70)
    a, b = d.pixel(-3, 3), d.pixel(-3, 3)
    a[::7] = b[::7]
    code = """REAL high = max(a, b), low = min(a, b), one = 1.0f, least = one * LEAST(a);
        REAL zero = a - a, nan = zero / zero, bounded = max(nan, one), below = min(nan, one);"""
    outputs = ("high", "low", "least", "bounded", "below")
    high, low, least, bounded, below = stacked(
        device.call((), code, {"REAL a": a, "REAL b": b}, outputs)
    )
    np.testing.assert_array_equal(high, np.maximum(a, b))
    np.testing.assert_array_equal(low, np.minimum(a, b))
    assert (bounded == 1).all()
    assert (below == 1).all()
    # Of as many pixels as the device takes at once: of one, of eight, or of all that share a value.
    least_of = [
        a.reshape(len(a), -1, lanes).min(axis=2).repeat(lanes, 1) for lanes in (1, 8, LANES)
    ]
    assert any(np.array_equal(least, expected) for expected in least_of)
