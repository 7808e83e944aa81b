"""Noise in closed form against noise drawn image by image, in every parameter of the sensor.

Seeds are fixed, so every number here is the same at each run.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import tolerances

from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.float64 import grey_level
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.float64_noise import Excess, unclipped_mean, unclipped_variance
from gpuspec.light.levels import Zones
from gpuspec.light.light_map import has_closed_form, has_noisy_form
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.simulation.simulate import trace
from gpuspec.station.sections import Sensor
from gpuspec.station.station import Station

SENSORS: dict[str, dict[str, Any]] = {
    "usual": {},
    "few electrons": {"saturation_e": 100.0, "read_noise_e": 1.0},
    "a black level": {"saturation_e": 2000.0, "black_level_dn": 20.3},
    "dark signal": {"dark_e": 150.0, "saturation_e": 3000.0},
    "unlike pixels": {"prnu": 0.02, "dsnu_e": 20.0, "dark_e": 30.0, "saturation_e": 5000.0},
    "ten bits": {"bit_depth": 10, "saturation_e": 1000.0, "black_level_dn": 40.0},
    "twelve bits": {"bit_depth": 12, "saturation_e": 20_000.0, "read_noise_e": 2.0},
    "plateau at saturation": {"exposure": 1.0, "saturation_e": 500.0, "read_noise_e": 5.0},
    "nothing saturates": {"exposure": 0.5, "saturation_e": 2000.0},
    "all nearly saturates": {"exposure": 16.0, "saturation_e": 300.0, "read_noise_e": 3.0},
}


def station(**sensor: Any) -> Station:
    """A part of 24 x 30 pixels with a dent, 8 images."""
    leak = 0.06 if sensor.get("exposure") == 16.0 else 0.01
    return Station.from_dict(
        {
            "part": {"length_mm": 6.0, "width_mm": 4.8},
            "tunnel": {"height_mm": 150.0, "luminous_mm": 4.0, "dark_mm": 7.0, "dark_leak": leak},
            "camera": {"sampling_mm": 0.2, "pupil_mm": 3.0},
            "sensor": {"noise": True, "exposure": 3.0, **sensor},
            "sequence": {"images": 8},
            "defects": [
                {"kind": "dent", "x_mm": 0.4, "y_mm": -0.3, "diameter_mm": 2.0, "depth_um": 4.0},
            ],
        }
    )


def drawn_residuals(base: Station, draws: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Aspect images of as many seeds, less their mean; and their deviation, each of every seed."""
    light_map = OpenCLBackend().trace(base)
    images, means, deviations = [], [], []
    for seed in range(draws):
        one = base.replace(sensor__seed=seed)
        moments = light_map.moments(light_map.under(one))
        images.append(light_map.aspect(light_map.under(one)))
        means.append(moments.mean)
        deviations.append(moments.deviation)
    return tuple(np.array(values, np.float64) for values in (images, means, deviations))


@pytest.mark.parametrize("name", SENSORS)
def test_moments_are_those_of_drawn_images(name: str) -> None:
    base = station(**SENSORS[name])
    images, means, deviations = drawn_residuals(base, 100)
    grey = 255 / base.sensor.full_scale_dn
    spread = deviations.mean() / np.sqrt(images.size)
    assert abs((images - means).mean()) < 4 * spread + tolerances.NOISY_BIAS_DN / grey
    off = (images - means).mean(axis=0)
    error = np.sqrt((deviations**2).mean(axis=0) / len(images))
    assert (np.abs(off) < 5 * error + tolerances.NOISY_MEAN_DN / grey).all()
    seen = deviations.mean(axis=0) * grey > 0.02
    found = np.sqrt(((images - means) ** 2).mean(axis=0))[seen]
    told = np.sqrt((deviations**2).mean(axis=0))[seen]
    if seen.any():
        assert abs(np.sqrt((found**2).mean() / (told**2).mean()) - 1) < tolerances.NOISY_DEVIATION
        rms = np.sqrt(((found / told - 1) ** 2).mean())
        assert rms < tolerances.NOISY_DEVIATION + 1 / np.sqrt(2 * len(images))


@pytest.mark.parametrize("name", SENSORS)
def test_a_table_holds_mean_and_variance_of_a_grey_level(name: str) -> None:
    base = station(**{**SENSORS[name], "prnu": 0.0, "dsnu_e": 0.0})
    sensor = base.sensor
    column = np.arange(40_000)
    grey = 255 / sensor.full_scale_dn
    for signal in (0.0, 0.01, 0.03, 0.3, 0.97, 1.0, 1.04):
        light = max(signal - sensor.dark_e / sensor.saturation_e, 0)
        total = np.array([light + sensor.dark_e / sensor.saturation_e])
        drawn = grey_level(np.full(column.size, light), base, 5, column, 0)
        above, more = Excess.of(sensor).at(total)
        mean = unclipped_mean(total, sensor) + above
        variance = np.where(total < 1, unclipped_variance(total, sensor), 0) + more
        error = np.sqrt(max(variance[0], 0) / column.size)
        assert abs(drawn.mean() - mean[0]) < 5 * error + tolerances.NOISY_TABLE_DN / grey
        assert abs(drawn.std() - np.sqrt(max(variance[0], 0))) < (
            5 * error + tolerances.NOISY_TABLE_DN / grey
        )


def test_a_table_is_made_once_for_all_that_share_its_noise() -> None:
    assert Excess.of(Sensor(exposure=2.0)) is Excess.of(Sensor(exposure=5.0, seed=7, prnu=0.1))
    assert Excess.of(Sensor()) is not Excess.of(Sensor(read_noise_e=11.0))


@pytest.mark.parametrize("seed", range(3))
def test_the_closed_form_is_the_sum_over_all_images(seed: int) -> None:
    """Random stations and sensors: nearly all pixels within 0.05 grey levels of 255, and 5 %."""
    rng = np.random.default_rng(seed)
    base = station().replace(camera__subsampling=1)
    device, exact = OpenCLBackend().trace(base), NumpyBackend().trace(base)
    off, share = [], []
    for _ in range(20):
        capacity = float(np.exp(rng.uniform(np.log(100), np.log(20_000))))
        bits = int(rng.choice([8, 10, 12]))
        changed = base.replace(
            sensor__saturation_e=capacity, sensor__bit_depth=bits,
            sensor__read_noise_e=min(float(np.exp(rng.uniform(-0.7, 3.4))), capacity / 100),
            sensor__black_level_dn=float(rng.choice([0, rng.uniform(0, 0.1)])) * (2**bits - 1),
            sensor__dark_e=float(rng.choice([0, 0.01])) * capacity,
            sensor__prnu=float(rng.choice([0, 0.02])),
            sensor__dsnu_e=float(rng.choice([0, 0.002])) * capacity,
            sensor__exposure=float(np.exp(rng.uniform(np.log(0.5), np.log(16)))),
            sequence__images=int(np.exp(rng.uniform(np.log(8), np.log(400)))),
            tunnel__luminous_mm=float(rng.uniform(0.5, 8)),
            tunnel__dark_mm=float(rng.uniform(2, 24)),
            tunnel__dark_leak=float(rng.choice([0, rng.uniform(0, 0.3)])),
        )  # fmt: skip
        got, told = device.moments(changed), exact.moments(changed)
        grey = 255 / changed.sensor.full_scale_dn
        off.append(np.abs(got.mean - told.mean).ravel() * grey)
        seen = told.deviation * grey > 0.02
        share.append(np.abs(got.deviation / np.maximum(told.deviation, 1e-9) - 1)[seen])
    every, shares = np.concatenate(off), np.concatenate(share)
    assert (every > 0.05).mean() < tolerances.NOISY_BEYOND
    assert every.max() < tolerances.NOISY_WORST_DN
    assert (shares > 0.05).mean() < tolerances.NOISY_BEYOND * 2


def test_backends_tell_the_same_moments_and_draws(device_backend: Backend) -> None:
    base = station(**SENSORS["unlike pixels"])
    device, exact = device_backend.trace(base), NumpyBackend().trace(base)
    got, told = device.moments(), exact.moments()
    assert np.abs(got.mean - told.mean).max() < tolerances.NOISY_MEAN_DN
    assert np.abs(device.one_draw() - exact.one_draw()).max() < tolerances.NOISY_DRAW_DN


def test_without_noise_left_the_moments_are_the_closed_form() -> None:
    base = station(saturation_e=1e7, read_noise_e=0.0, bit_depth=16)
    light_map = OpenCLBackend().trace(base)
    moments = light_map.moments()
    closed = light_map.aspect(light_map.under(base.replace(sensor__noise=False)))
    assert np.abs(moments.mean - closed).max() * 255 / 65535 < tolerances.NOISY_BIAS_DN
    assert moments.deviation.max() * 255 / 65535 < 0.05


def test_what_sweeps_count_with_noise_agrees_with_drawn_sequences() -> None:
    """P1 and P2 at the thresholds that matter, on average over draws."""
    base = station(saturation_e=3000.0, read_noise_e=20.0)
    traced = trace(base, OpenCLBackend())
    zones = Zones.of(traced.truth.labels, traced.lost != 1, len(traced.truth.defects))
    seeds = [base.replace(sensor__seed=seed) for seed in range(60)]
    counted = traced.light_map.counter(zones).count(seeds)
    inside = counted.inside[:, ::-1].cumsum(axis=1)[:, ::-1].mean(axis=0)
    outside = counted.outside[:, ::-1].cumsum(axis=1)[:, ::-1].mean(axis=0)
    images = [traced.light_map.aspect(one) for one in seeds]
    truth = traced.truth.labels > 0
    for threshold in range(0, 255, 3):
        hit = np.mean([(image[truth] > threshold).sum() for image in images])
        false = np.mean([(image[~truth] > threshold).sum() for image in images])
        assert abs(inside[threshold + 1] - hit) / truth.sum() < tolerances.NOISY_SHARE
        assert abs(outside[threshold + 1] - false) / truth.size < tolerances.NOISY_SHARE


def test_pixels_beside_the_part_are_not_counted_by_their_black_level(opencl: Backend) -> None:
    base = station(black_level_dn=30.0).replace(camera__columns=45, camera__rows=40)
    traced = trace(base, opencl)
    valid = traced.lost != 1
    zones = Zones.of(traced.truth.labels, valid, len(traced.truth.defects))
    found = traced.light_map.counter(zones).count([traced.station])
    above = found.inside[0, 5:].sum() + found.outside[0, 5:].sum()
    assert above == np.count_nonzero(valid) < valid.size


@pytest.mark.parametrize(
    "changes",
    [{"sensor__noise": False}, {"sequence__images": 7}, {"sensor__saturation_e": 90.0},
     {"sensor__read_noise_e": 101.0}, {"sequence__step_mm": 0.31}, {"camera__subsampling": 2},
     {"sequence__fusion": "std"}],
    ids=str,
)  # fmt: skip
def test_noise_that_has_no_closed_form_is_drawn(changes: dict[str, Any]) -> None:
    base = station()
    assert has_noisy_form(base)
    assert not has_closed_form(base)
    other = base.replace(**changes)
    assert not has_noisy_form(other)
    light_map = NumpyBackend().trace(other)
    with pytest.raises(StationError, match="no closed form"):
        light_map.moments()
    assert np.array_equal(light_map.counted(), light_map.aspect())
