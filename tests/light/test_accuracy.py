"""Aspect images against the brute-force oracle: 4,096 rays per pixel, every image rendered."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import pytest
from scenes import TABLE, check_station, oracle_scene
from tolerances import (
    ANY_SCENE_RMS_DN,
    ONE_FOOTPRINT_MAX_DN,
    ONE_FOOTPRINT_RMS_DN,
    SUB_RAYS_MAX_DN,
    SUB_RAYS_RMS_DN,
    TABLE_MAXIMUM_DN,
    TABLE_MEDIAN_DN,
)

from gpuspec.light.opencl import OpenCLBackend
from gpuspec.station.station import Station

SCRATCH = {
    "kind": "scratch", "points_mm": [[-3.0, -2.1], [3.0, 2.5]], "width_mm": 0.6, "depth_um": 4.0,
}  # fmt: skip
BUMP = {"kind": "bump", "x_mm": 0.5, "y_mm": 0.4, "diameter_mm": 0.9, "depth_um": 5.0}

# Scenes past the table: each thing the trace knows, once.
OTHERS: dict[str, dict[str, Any]] = {
    "long scratch and bump": {"defects": [SCRATCH, BUMP]},
    "box": {"tunnel.section": "box", "tunnel.width_mm": 60.0, "tunnel.height_mm": 120.0},
    "arch": {"tunnel.section": "arch", "tunnel.radius_mm": 140.0},
    "crowned height surface": {
        "part.surface": "height", "part.crown_radius_x_mm": 400.0,
        "part.crown_radius_y_mm": -600.0,
    },
    "crowned orientation": {"part.crown_radius_x_mm": 500.0},
    "rough": {"part.roughness_rad": 0.002},
    "leak, cos4, 12 bit": {
        "tunnel.dark_leak": 0.05, "camera.vignetting": "cos4", "sensor.bit_depth": 12,
        "sensor.exposure": 3.0,
    },
    "uneven step": {"sequence.step_mm": 0.33, "sequence.images": 31},
}  # fmt: skip


def errors(opencl: OpenCLBackend, station: Station, truth: np.ndarray) -> tuple[float, float]:
    full = station.sensor.full_scale_dn / 255
    error = (opencl.trace(station).aspect() - truth) / full
    return float(np.sqrt((error**2).mean())), float(np.abs(error).max())


@pytest.fixture(scope="module")
def truths() -> dict[Any, np.ndarray]:
    return {}


def oracle_aspect(truths: dict[Any, np.ndarray], key: Any, station: Station) -> np.ndarray:
    if key not in truths:
        truths[key] = oracle.aspect_image(oracle_scene(station), rays=4096)
    return truths[key]


@pytest.mark.parametrize(("pupil", "sigma", "depth", "exposure", "median", "maximum"), TABLE)
def test_the_check_values_of_the_model_are_met_with_2_x_2_sub_rays(
    opencl, truths, pupil, sigma, depth, exposure, median, maximum
):
    station = check_station(pupil, sigma, depth, exposure, camera__subsampling=2)
    aspect = opencl.trace(station).aspect()
    assert np.median(aspect) == pytest.approx(median, abs=TABLE_MEDIAN_DN)
    assert aspect.max() == pytest.approx(maximum, abs=TABLE_MAXIMUM_DN)


@pytest.mark.slow
@pytest.mark.parametrize(("pupil", "sigma", "depth", "exposure"), [row[:4] for row in TABLE])
def test_one_footprint_per_pixel_is_close_to_4096_rays(
    opencl, truths, pupil, sigma, depth, exposure
):
    station = check_station(pupil, sigma, depth, exposure)
    rms, worst = errors(opencl, station, oracle_aspect(truths, station, station))
    assert rms <= ONE_FOOTPRINT_RMS_DN
    assert worst <= ONE_FOOTPRINT_MAX_DN


@pytest.mark.parametrize(("pupil", "sigma", "depth", "exposure"), [row[:4] for row in TABLE])
def test_2_x_2_sub_rays_are_closer_to_4096_rays(opencl, truths, pupil, sigma, depth, exposure):
    station = check_station(pupil, sigma, depth, exposure)
    truth = oracle_aspect(truths, station, station)
    rms, worst = errors(opencl, station.replace(camera__subsampling=2), truth)
    assert rms <= SUB_RAYS_RMS_DN
    assert worst <= SUB_RAYS_MAX_DN


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_every_kind_of_scene_is_close_to_4096_rays(opencl, name):
    station = check_station(sigma=0.2, depth=0.006).replace(**OTHERS[name])
    truth = oracle.aspect_image(oracle_scene(station), rays=4096)
    rms, worst = errors(opencl, station, truth)
    assert rms <= ANY_SCENE_RMS_DN
    assert worst <= ONE_FOOTPRINT_MAX_DN


@pytest.mark.slow
def test_a_bent_scratch_is_farther_from_4096_rays_only_at_its_vertices(opencl):
    # The groove's slope has a crease inside the bend, its curvature a jump at each rounded end:
    # one footprint cannot know what a pixel across them sees.
    points = [[-1.0, -0.7], [0.3, 0.2], [0.9, 1.1]]
    station = check_station(defects=[{**SCRATCH, "points_mm": points}])
    error = np.abs(opencl.trace(station).aspect() - oracle.aspect_image(oracle_scene(station)))
    row, column = np.nonzero(error > ONE_FOOTPRINT_MAX_DN)
    place = np.stack([(column + 0.5 - 16) * 0.1, (15.5 - row) * 0.1], axis=1)
    nearest = np.min([np.hypot(*(place - vertex).T) for vertex in points], axis=0)
    assert len(row) <= 8
    assert np.all(nearest < 0.3)


def test_the_oracle_sees_a_wrong_tunnel_height(opencl):
    station = check_station()
    truth = oracle.aspect_image(oracle_scene(station), rays=1024)
    rms, _ = errors(opencl, station.replace(tunnel__height_mm=160.0), truth)
    assert rms > 2 * ONE_FOOTPRINT_RMS_DN


@pytest.mark.slow
@pytest.mark.parametrize("k", [0, 13])
def test_a_single_image_is_close_to_4096_rays_away_from_transitions(opencl, k):
    station = check_station()
    error = np.abs(opencl.trace(station).image(k) - oracle.image(oracle_scene(station), k))
    assert np.median(error) < ONE_FOOTPRINT_RMS_DN
