"""A light is found again from samples of it, whatever it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gpuspec.captured.light_fit import LightFit, Samples, fit_light
from gpuspec.light.float64 import two_boxes
from gpuspec.light.float64_stripes import lit_fraction
from gpuspec.station.station import Station

EXPOSURE, DUTY, PUPIL = 0.01, 5e-4, 2e-3
"""Relatively, and of a period. Measured: 0.004, 1e-4, 4e-4."""
NOISE_DN = 2.5
"""Of the highest level, which is lit most of the time."""
EXPLAINED = 0.02
"""Relatively, between what is left of levels and their noise. Measured: 0.003."""
PIXEL = 1 / 70
STATION = Station(sensor={"noise": True})
SENSOR = STATION.sensor


def samples(exposure: float, duty: float, leak: float, pupil: float, images: int = 12) -> Samples:
    """Return noisy grey levels of stripes, lengths in periods."""
    rng = np.random.default_rng(3)
    turn = rng.uniform(0, 5, (20_000, 1)) - np.arange(images) / images
    boxes = two_boxes(*(np.full(1, length) for length in (PIXEL, 0.0, pupil, 0.0)))
    wide, narrow = (box[0] + 0 * turn for box in boxes)
    station = STATION.replace(tunnel={"luminous_mm": duty, "dark_mm": 1 - duty})
    lit = lit_fraction(turn - 0.3, wide, narrow, 0.0, station)
    signal = exposure * (leak + (1 - leak) * lit)
    noise = np.sqrt(signal * SENSOR.saturation_e + SENSOR.read_noise_e**2) / SENSOR.saturation_e
    levels = np.rint(255 * (signal + noise * rng.standard_normal(turn.shape)).clip(0, 1))
    return Samples(levels, turn, rng.uniform(-1, 1, (20_000, 2)), PIXEL, 0.0)


def fitted(taken: Samples, **known: Any) -> LightFit:
    return fit_light(taken, SENSOR, lambda y: np.full_like(y, 1.6), **known)


@pytest.mark.parametrize("exposure", [0.6, 0.9])
@pytest.mark.parametrize("duty", [0.1, 0.22, 0.5, 0.8])
@pytest.mark.parametrize("pupil", [0.0, 0.06, 0.15])
def test_stripes_of_any_width_through_any_pupil_are_found_though_it_is_not_given(
    exposure, duty, pupil
):
    """Of a pupil wider than the stripe no level tells exposure and width by itself."""
    found = fitted(samples(exposure, duty, 0.03, pupil))
    assert found.kind == "stripes"
    numbers = {name: one.value for name, one in found.numbers.items()}
    if 2 * pupil < min(duty, 1 - duty):  # else one of them goes for another
        assert numbers["exposure"] == pytest.approx(exposure, rel=EXPOSURE)
        assert numbers["duty"] == pytest.approx(duty, abs=DUTY)
        if pupil:  # of a pinhole the square alone is seen
            assert numbers["pupil"] == pytest.approx(pupil, abs=PUPIL)
    assert found.rms_dn < NOISE_DN


@pytest.mark.parametrize("exposure", [2.0, 4.0, 8.0])
@pytest.mark.parametrize("pupil", [0.0, 0.06])
def test_stripes_that_saturate_are_found_with_the_pupil_that_is_given(exposure, pupil):
    """A pinhole is a pupil, too."""
    found = fitted(samples(exposure, 0.48, 0.03, pupil), pupil=pupil)
    assert found.kind == "stripes"
    assert found.numbers["pupil"].value == pupil
    assert found.numbers["pupil"].uncertainty == 0
    assert found.numbers["exposure"].value == pytest.approx(exposure, rel=3 * EXPOSURE)
    assert found.numbers["duty"].value == pytest.approx(0.48, abs=3 * DUTY)


def test_a_light_that_does_not_explain_the_levels_says_so_and_so_does_a_number_at_its_limit():
    found = fitted(samples(0.9, 0.1, 0.03, 0.0), kind="sinusoid")
    unexplained, at_limit = found.doubts
    assert "does not explain" in unexplained
    assert "gamma ends at 10" in at_limit


def test_a_table_that_explains_the_levels_raises_no_doubt():
    """Its numbers have no limit."""
    turn = np.linspace(0, 5, 20_000)[:, None] - np.arange(12) / 12
    mean = 90 + 60 * np.cos(2 * np.pi * turn) + 20 * np.cos(4 * np.pi * (turn - 0.1))
    levels = np.rint(np.random.default_rng(5).normal(mean, 1.6))
    taken = Samples(levels, turn, np.zeros((20_000, 2)), PIXEL, 0.0)
    found = fitted(taken)
    assert found.kind == "table"
    assert not found.doubts


def test_a_light_that_explains_the_levels_raises_no_doubt():
    found = fitted(samples(0.65, 0.22, 0.0, 0.06), pupil=0.06)
    assert not found.doubts
    assert found.rms_dn == pytest.approx(found.noise_dn, rel=EXPLAINED)
