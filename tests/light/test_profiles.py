"""A light that is no stripes: its harmonics, and what a footprint sees of them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import tolerances as tol
from numpy.typing import NDArray
from scenes import check_station

from gpuspec.arrays import BESIDE
from gpuspec.light.constants import HARMONICS
from gpuspec.light.devices import open_backend
from gpuspec.light.levels import Zones, levels_of
from gpuspec.light.light_map import LightMapArrays, has_closed_form, has_noisy_form
from gpuspec.light.patterns import Pattern
from gpuspec.light.profiles import harmonics, left_out, luminance
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.station.station import Station

SCREEN = {"tunnel__profile": "sinusoid", "tunnel__profile_gamma": 2.2}
TABLE = {"tunnel__profile": [0.1, 0.6, 1.0, 0.9, 0.3, 0.0, 0.05, 0.2], "tunnel__dark_leak": 0.05}
LIGHTS: dict[str, dict[str, Any]] = {
    "sinusoid": {"tunnel__profile": "sinusoid"},
    "screen": SCREEN,
    "table": TABLE,
}
NODES = 400  # of a box, for the brute force


def of_lights(name: str, **changes: Any) -> Station:
    """The model's check scene under one of the lights, of a period that footprints fill half."""
    period = {"tunnel__luminous_mm": 2.0, "tunnel__dark_mm": 1.0, "sequence__images": 12}
    return check_station(2.0, exposure=1.8, **period).replace(**LIGHTS[name]).replace(**changes)


def told(name: str, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """The luminance as a user would write it down, u in periods; of a table its interpolation."""
    if name != "table":
        return (0.5 + 0.5 * np.cos(2 * np.pi * u)) ** (2.2 if name == "screen" else 1.0)
    values = TABLE["tunnel__profile"]
    k = np.arange(len(values))
    # The interpolation of periodic values by the Dirichlet kernel of an even number of them.
    x = np.pi * (u[..., None] - k / len(values))
    with np.errstate(divide="ignore", invalid="ignore"):
        kernel = np.sin(len(values) * x) / np.tan(x) / len(values)
    return np.where(np.abs(np.sin(x)) < 1e-12, 1.0, kernel) @ np.array(values)


def brute_force(name: str, m: LightMapArrays, station: Station) -> NDArray[np.float64]:
    """The mean of all images, each pixel's two boxes put together of many points of the light."""
    period, full = station.tunnel.period_mm, station.sensor.full_scale_dn
    at = (np.arange(NODES) + 0.5) / NODES - 0.5
    leak = station.tunnel.dark_leak
    images = np.zeros(station.shape)
    for k in range(station.sequence.images):
        signal = np.zeros(station.shape)
        for ray in range(len(m.light_mm)):
            light, wide, narrow = (
                p[ray].astype(float) for p in (m.light_mm, m.wide_mm, m.narrow_mm)
            )
            # Folded boxes: the places of both add up. A third of the narrow one's are enough.
            seen = np.zeros(station.shape)
            for inner in np.array_split(at, NODES // 10):
                place = light - k * station.step_mm + inner.mean() * narrow
                seen += told(name, (place[..., None] + at * wide[..., None]) / period).mean(axis=-1)
            seen = (seen / (NODES // 10)).clip(0, 1)
            signal += m.irradiance[ray] * (leak + (1 - leak) * seen)
        images += np.minimum(station.sensor.exposure * signal / len(m.light_mm), 1)
    return full * images / station.sequence.images


def few_pixels(name: str, subsampling: int) -> Station:
    return of_lights(
        name, camera__columns=9 // subsampling, camera__rows=7 // subsampling,
        camera__subsampling=subsampling, part__roughness_rad=0.0005,
    )  # fmt: skip


@cache
def of_many_points(name: str, subsampling: int) -> NDArray[np.float64]:
    """What brute force makes of the float64 light map: once for all backends."""
    station = few_pixels(name, subsampling)
    return brute_force(name, open_backend("numpy").trace(station).read(), station)


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("subsampling", [1, 2])
def test_the_aspect_image_is_that_of_a_footprint_of_many_points(backend, name, subsampling):
    expected = of_many_points(name, subsampling)
    assert np.ptp(expected) > 1  # it is not all one level
    found = backend.trace(few_pixels(name, subsampling)).aspect()
    assert np.abs(found - expected).max() < tol.PROFILE_DN


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("fusion", ["mean", "std", "differential"])
def test_backends_agree_on_every_image_and_fusion(device_backend, name, fusion):
    station = of_lights(name, sequence__fusion=fusion, camera__subsampling="auto")
    here, there = (engine.trace(station) for engine in (device_backend, open_backend("numpy")))
    assert np.abs(here.aspect() - there.aspect()).max() < tol.PROFILE_DN
    assert np.abs(here.image(5) - there.image(5)).max() < tol.PROFILE_DN


@pytest.mark.parametrize("name", ["opengl", "vulkan"])
def test_a_sinusoid_is_the_shipped_pattern_of_that_name(name):
    # The pattern knows one box: through a pinhole a flat part's pixels are boxes.
    station = of_lights("sinusoid", camera__pupil_mm=0.0, defects=[], camera__subsampling=1)
    light_map = open_backend(name).trace(station)
    pattern = light_map.with_pattern(Pattern.read("sinusoidal"))
    for k in (0, 5):
        assert np.abs(pattern.image(k) - light_map.image(k)).max() < tol.PROFILE_DN


def test_unsaturated_images_of_a_light_of_few_harmonics_have_one_mean(backend):
    """The law of zero contrast: equal steps miss no harmonic below the number of images."""
    values = [
        0.2 + 0.6 * value for value in TABLE["tunnel__profile"]
    ]  # between them, too, of 0 to 1
    lit = {"tunnel__profile": values, "tunnel__dark_leak": 0.0, "sensor__exposure": 0.5}
    aspect = backend.trace(of_lights("table").replace(**lit)).aspect()
    mean = np.mean(values) * 255 / 2
    assert np.abs(aspect - mean).max() < tol.PROFILE_DN


@pytest.mark.parametrize("name", LIGHTS)
def test_noise_has_the_same_draws_on_every_backend(device_backend, name):
    station = of_lights(name, sensor__noise=True, sensor__prnu=0.01)
    here, there = (
        engine.trace(station).image(3) for engine in (device_backend, open_backend("numpy"))
    )
    assert np.mean(here != there) < tol.PROFILE_DRAWS_OTHER


def test_such_a_light_has_no_closed_form_with_noise_or_without():
    for name in LIGHTS:
        station = of_lights(name)
        assert not has_closed_form(station)
        assert not has_noisy_form(station.replace(sensor__noise=True))


@pytest.mark.parametrize("subsampling", [1, "auto"])
def test_sweeps_count_the_levels_of_its_images(backend, subsampling):
    station = of_lights("screen", camera__subsampling=subsampling)
    light_map = backend.trace(station)
    truth = Truth.of(station, Relief.of(station))
    zones = Zones.of(truth.labels, light_map.lost() != BESIDE, len(truth.defects))
    designs = [station.replace(sensor__exposure=e) for e in (2.0, 5.0)]
    designs.append(station.replace(tunnel__profile="stripes"))
    counted = light_map.counter(zones).count(designs)
    for i, design in enumerate(designs):
        expected = levels_of(light_map.aspect(design), zones, 255)
        # Level 0 has what fills the last vector, too; no threshold asks for it.
        assert np.array_equal(counted.inside[i][1:], expected.inside[0][1:])
        assert np.array_equal(counted.peaks[i], expected.peaks[0])


def test_a_light_map_serves_every_profile(backend):
    light_map = backend.trace(check_station())
    sinusoid = check_station(tunnel__profile="sinusoid")
    assert np.array_equal(light_map.aspect(sinusoid), backend.trace(sinusoid).aspect())


def test_a_sinusoid_has_one_harmonic_and_a_gamma_adds_others():
    assert harmonics(of_lights("sinusoid").tunnel).round(9).tolist() == [0.5, 0.5]
    squared = of_lights("sinusoid", tunnel__profile_gamma=2.0)  # ((1 + cos)/2)^2
    assert harmonics(squared.tunnel).round(9).tolist() == [0.375, 0.5, 0.125]


@pytest.mark.parametrize("count", [3, 4, 7, 2 * HARMONICS])
def test_a_light_passes_through_the_values_of_its_table(count):
    values = np.random.default_rng(count).uniform(0.2, 0.8, count)
    tunnel = check_station(tunnel__profile=values.tolist()).tunnel
    found = luminance(tunnel, np.arange(count) / count)
    assert np.abs(found - values).max() < 1e-6
    assert left_out(tunnel) < 1e-6


def test_what_a_long_table_has_beyond_the_harmonics_is_left_out_and_told():
    square = [1.0] * 31 + [0.0] * 97
    tunnel = check_station(tunnel__profile=square).tunnel
    assert len(harmonics(tunnel)) == HARMONICS + 1
    assert left_out(tunnel) > 0.3


def test_a_period_begins_with_the_first_value_at_shift_0_and_moves_with_the_light(backend):
    station = check_station(
        0.0, tunnel__profile=[1.0, 0.5, 0.0, 0.5], tunnel__luminous_mm=30.0, tunnel__dark_mm=30.0,
        sensor__exposure=1.0, sequence__images=4, defects=[],
    )  # fmt: skip
    light_map = backend.trace(station)
    pixel = 16, 16  # looks at 0.06 mm of the light
    levels = [float(light_map.image(k)[pixel]) for k in range(4)]
    assert levels == pytest.approx([255, 127.5, 0, 127.5], abs=1.0)
    assert levels[1] > levels[3]  # the light has moved to the right of it
