"""Light that the part scatters: its form factor against rays over a hemisphere, its images."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import oracle
import pytest
import tolerances
from scenes import check_station, members, oracle_scene

from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.diffuse import diffuse_share, form_factor, mean_luminance, ripple
from gpuspec.light.levels import Zones
from gpuspec.light.records import design_block
from gpuspec.simulation.cautions.station import of_diffuse
from gpuspec.station.station import Station

TUNNELS: dict[str, dict[str, Any]] = {
    "ceiling": {"tunnel.length_mm": 400.0},
    "box": {"tunnel.section": "box", "tunnel.width_mm": 120.0, "tunnel.length_mm": 300.0},
    "arch": {"tunnel.section": "arch", "tunnel.radius_mm": 150.0, "tunnel.length_mm": 350.0},
    "opening": {"tunnel.opening_length_mm": 80.0, "tunnel.opening_width_mm": 60.0},
    "leak": {"tunnel.dark_leak": 0.2},
}


def of(**changes: Any) -> Station:
    return check_station(defects=[], part__diffuse=0.3, **changes)


def scattered(station: Station, x: float = 0.0, k: int = 0, rays: int = 2**16) -> float:
    return oracle.scattered(oracle_scene(station), station.part.diffuse, x, 0.0, k, rays)


@pytest.mark.parametrize("x", [0.0, 60.0])
@pytest.mark.parametrize("name", TUNNELS)
def test_the_form_factor_is_what_rays_over_the_hemisphere_meet(name: str, x: float) -> None:
    station = of(**TUNNELS[name] | {"tunnel.dark_leak": 0.99})  # as good as even
    expected = 0.3 * form_factor(station.tunnel, x) * mean_luminance(station.tunnel)
    assert scattered(station, x) == pytest.approx(expected, rel=tolerances.HEMISPHERE)


@pytest.mark.parametrize("name", TUNNELS)
def test_a_part_is_as_bright_at_every_shift(name: str) -> None:
    station = of(**TUNNELS[name])
    for k in (0, 13):
        found = scattered(station, k=k, rays=2**17)
        assert found == pytest.approx(diffuse_share(station), rel=tolerances.HEMISPHERE_OF_STRIPES)


def test_a_tilted_point_gets_the_light_of_its_upper_half() -> None:
    groove = oracle.Groove(((0.0, 0.0),), 0.25, -0.2)  # at sigma its slope is 0.2/0.25 e^-0.5
    scene = replace(oracle_scene(of()), grooves=(groove,), tunnel_length_mm=1e5)
    tilt = np.arctan(0.2 / 0.25 * np.exp(-0.5))
    radiance = oracle.scattered(scene, 0.3, 0.25, 0.0, rays=2**18)
    expected = 0.3 / 4 * (1 + np.cos(tilt)) / 2
    assert radiance == pytest.approx(expected, rel=tolerances.HEMISPHERE_OF_STRIPES)
    assert expected < 0.96 * 0.3 / 4


def test_stripes_as_coarse_as_the_tunnel_is_high_show_in_it() -> None:
    station = of(tunnel__luminous_mm=150.0, tunnel__dark_mm=150.0, tunnel__length_mm=1e5,
                 sequence__images=16)  # fmt: skip
    values = np.array([scattered(station, k=k) for k in range(16)])
    amplitude = np.abs(np.fft.rfft(values)[1]) / 8 / values.mean()
    assert ripple(station.tunnel) == pytest.approx(amplitude, rel=tolerances.RIPPLE)
    assert ripple(of().tunnel) < 1e-20
    (said,) = of_diffuse(station)
    assert "a period of 300 mm is coarse at 150 mm" in said
    assert not of_diffuse(of())


def test_a_short_tunnel_is_told() -> None:
    (said,) = of_diffuse(of(tunnel__length_mm=220.0))
    assert "at its ends it gets" in said


def test_its_image_is_the_oracles(backend: Backend) -> None:
    station = check_station(part__diffuse=0.3, camera__rows=12, camera__columns=16)
    scene = replace(oracle_scene(station), scattered=scattered(station))
    truth = oracle.aspect_image(scene, rays=1024)
    found = backend.trace(station).aspect()
    assert np.sqrt(np.mean((found - truth) ** 2)) < tolerances.SCATTERED_RMS_DN
    without = backend.trace(station.replace(part__diffuse=0.0)).aspect()
    assert np.median(found - without) > 5  # more light everywhere, in the dark most


def test_all_ways_to_an_image_have_it(backend: Backend) -> None:
    station = check_station(
        part__diffuse=0.3, sensor__noise=True, camera__subsampling=1, part__material="lacquer"
    )
    light_map = backend.trace(station)
    moments = light_map.moments()
    truth = light_map.summed_moments(station)
    assert np.abs(moments.mean - truth.mean).max() < tolerances.SCATTERED_MOMENT_DN
    quiet = station.replace(sensor__noise=False)
    closed, by_image = light_map.closed_form(quiet), light_map.mean(quiet)
    assert np.abs(closed - by_image).max() < tolerances.SCATTERED_CLOSED_DN
    assert np.abs(light_map.fuse(quiet)["mean"] - by_image).max() < tolerances.SCATTERED_CLOSED_DN


def test_counts_of_a_sweep_have_it(backend: Backend) -> None:
    station = check_station(part__diffuse=0.2)
    light_map = backend.trace(station)
    zones = Zones.of(np.zeros(station.shape, np.int32), np.ones(station.shape, bool), 0)
    designs = [station.replace(sensor__exposure=g) for g in (2.0, 3.0, 6.0)]
    for design, counts in zip(
        designs, light_map.counter(zones).count(designs).outside, strict=True
    ):
        level = np.ceil(light_map.aspect(design)).clip(0, 255).astype(int)
        assert np.abs(np.bincount(level.ravel(), minlength=256) - counts).sum() <= 4


def test_a_sinusoid_is_scattered_too(backend: Backend) -> None:
    station = check_station(
        part__diffuse=0.3, tunnel__profile="sinusoid", sensor__exposure=1.0, defects=[]
    )
    plain = backend.trace(station.replace(part__diffuse=0.0)).mean()
    more = backend.trace(station).mean()
    unsaturated = 0.3 * form_factor(station.tunnel) * 0.5 * 255
    assert np.median(more - plain) < unsaturated  # some images saturate
    dim = station.replace(sensor__exposure=0.5)
    gained = backend.trace(dim).mean() - backend.trace(dim.replace(part__diffuse=0.0)).mean()
    assert gained == pytest.approx(unsaturated / 2, rel=1e-4)


def test_without_it_a_design_is_what_it_was() -> None:
    assert members("Design", design_block(check_station()))["diffuse"] == 0


def test_more_light_than_falls_on_it_is_refused_in_a_sentence() -> None:
    with pytest.raises(
        StationError, match=r"part.diffuse = 0.2 is more than silver leaves: .* 0.017"
    ):
        check_station(part__material="silver", part__diffuse=0.2)
    assert check_station(part__material="lacquer", part__diffuse=0.9).part.diffuse == 0.9
