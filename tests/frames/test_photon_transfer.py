"""The variance of grey levels over the level tells gain and read noise."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.errors import FrameError
from gpuspec.frames.photon_transfer import Noise, _own, photon_transfer
from gpuspec.light.float64_noise import Excess, grey_moments, unclipped_mean
from gpuspec.station.sections import Sensor

ALL = 4.0
"""Standard uncertainties within which every number is. Measured: 2.2."""


def sensed(signal: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Return grey levels of a signal over saturation, and what they are on average."""
    rng = np.random.default_rng(7)
    electrons = rng.poisson(signal * sensor.saturation_e)
    electrons = electrons + sensor.read_noise_e * rng.standard_normal(signal.shape)
    levels = np.rint((electrons * sensor.gain_dn_per_e).clip(0, sensor.full_scale_dn))
    return levels, unclipped_mean(signal, sensor) + Excess.of(sensor).at(signal)[0]


def noise_of(sensor: Sensor) -> Noise:
    def variance(signal: np.ndarray, dark: float, gain: float) -> np.ndarray:
        known = {"saturation_e": 255 / gain, "read_noise_e": float(np.sqrt(dark)) / gain}
        return grey_moments(signal / gain, sensor.model_copy(update=known))[1]

    return variance


@pytest.mark.parametrize("read_e", [5.0, 10.0, 30.0])
@pytest.mark.parametrize("saturation_e", [10_000.0, 30_000.0])
@pytest.mark.parametrize("dark", [0.0, 0.02])
def test_a_dark_and_a_lit_level_tell_gain_and_read_noise_though_rounding_hides_it(
    read_e, saturation_e, dark
):
    sensor = Sensor(saturation_e=saturation_e, read_noise_e=read_e, noise=True)
    signal = np.where(np.arange(12) % 2, dark, 0.65) + np.zeros((20_000, 1))
    levels, expected = sensed(signal, sensor)
    found = photon_transfer(levels, expected, 255 * signal, 0 * signal, 255.0, noise_of(sensor))
    gain, noise = found.gain_dn_per_e, found.dark_dn2
    assert abs(gain.value - sensor.gain_dn_per_e) < ALL * gain.uncertainty
    assert gain.uncertainty < 0.01 * gain.value
    assert abs(noise.value - (read_e * sensor.gain_dn_per_e) ** 2) < ALL * noise.uncertainty


def test_levels_that_are_nearly_all_black_or_saturated_are_refused_with_their_shares():
    sensor = Sensor(noise=True)
    signal = np.where(np.arange(12) % 4, 0.0, 2.0) + np.zeros((5_000, 1))
    levels, expected = sensed(np.minimum(signal, 1), sensor)
    with pytest.raises(FrameError, match=r"75\.0% are black, 25\.0% saturated"):
        photon_transfer(levels, expected, 255 * signal, 0 * signal, 255.0, noise_of(sensor))


def test_of_a_single_level_gain_and_read_noise_are_not_told_apart_and_said_so():
    """Its noise may be all of the dark or grow with the level: the gain is at most all of it."""
    sensor = Sensor(noise=True)
    signal = np.full((5_000, 12), 0.12) + np.linspace(-1e-4, 1e-4, 12)
    levels, expected = sensed(signal, sensor)
    found = photon_transfer(levels, expected, 255 * signal, 0 * signal, 255.0, noise_of(sensor))
    gain = found.gain_dn_per_e
    assert gain.uncertainty > gain.value
    assert abs(gain.value - sensor.gain_dn_per_e) < ALL * gain.uncertainty


def test_what_a_pixels_own_fit_leaves_of_a_variance_is_told_whatever_its_weights():
    """Of six levels it takes off three; with weights that are wrong by a factor of five."""
    rng = np.random.default_rng(11)
    signal = np.sort(rng.uniform(10, 240, (40, 6)))
    slope = 300 * rng.standard_normal((40, 6))
    variance = 0.07 + 0.0255 * signal + 1e-6 * slope**2
    weight = rng.uniform(0.2, 1, signal.shape) / variance
    draws = np.sqrt(variance) * rng.standard_normal((4_000, *signal.shape))
    squares = np.mean([_own(one, signal, slope, weight)[0] ** 2 for one in draws], axis=0)
    _, leverage, left = _own(draws[0], signal, slope, weight)
    seen = leverage < 0.7
    assert seen.sum() > 100
    ratio = squares[seen] / left(variance)[seen]
    assert np.abs(ratio - 1).max() < 0.1  # of 4,000 draws: 0.022 standard deviations
    assert np.abs(squares[seen] / (variance * (1 - leverage))[seen] - 1).max() > 0.3
