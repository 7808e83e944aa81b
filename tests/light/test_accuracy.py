"""Aspect images against the brute-force oracle: 4,096 rays per pixel, every image rendered."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import pytest
from laws import Array, overlap
from scenes import TABLE, check_station, oracle_scene
from tolerances import (
    AUTOMATIC_MAX_DN,
    AUTOMATIC_RMS_DN,
    CREASE_MAX_DN,
    LENS_RMS_DN,
    ONE_FOOTPRINT_MAX_DN,
    ONE_FOOTPRINT_RMS_DN,
    ROUGH_MAX_DN,
    ROUGH_RMS_DN,
    TABLE_MAXIMUM_DN,
    TABLE_MEDIAN_DN,
)

from gpuspec.light.float64_stripes import mean_over_scan
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


@pytest.mark.parametrize(("pupil", "sigma", "depth", "exposure", "median", "maximum"), TABLE)
def test_the_check_values_of_the_model_are_met_with_2_x_2_sub_rays(
    opencl, pupil, sigma, depth, exposure, median, maximum
):
    station = check_station(pupil, sigma, depth, exposure, camera__subsampling=2)
    aspect = opencl.trace(station).aspect()
    assert np.median(aspect) == pytest.approx(median, abs=TABLE_MEDIAN_DN)
    assert aspect.max() == pytest.approx(maximum, abs=TABLE_MAXIMUM_DN)


@pytest.mark.slow
@pytest.mark.parametrize(("pupil", "sigma", "depth", "exposure"), [row[:4] for row in TABLE])
def test_one_footprint_per_pixel_is_close_to_4096_rays(
    opencl, check_truth, pupil, sigma, depth, exposure
):
    station = check_station(pupil, sigma, depth, exposure, camera__subsampling=1)
    rms, worst = errors(opencl, station, check_truth(pupil, sigma, depth, exposure))
    assert rms <= ONE_FOOTPRINT_RMS_DN
    assert worst <= ONE_FOOTPRINT_MAX_DN


@pytest.mark.parametrize(("pupil", "sigma", "depth", "exposure"), [row[:4] for row in TABLE])
def test_automatic_sub_rays_are_closer_to_4096_rays(
    opencl, check_truth, pupil, sigma, depth, exposure
):
    station = check_station(pupil, sigma, depth, exposure)
    rms, worst = errors(opencl, station, check_truth(pupil, sigma, depth, exposure))
    assert rms <= AUTOMATIC_RMS_DN
    assert worst <= AUTOMATIC_MAX_DN


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_every_kind_of_scene_is_close_to_4096_rays(opencl, name):
    station = check_station(sigma=0.2, depth=0.006).replace(**OTHERS[name])
    truth = oracle.aspect_image(oracle_scene(station), rays=4096)
    rms, worst = errors(opencl, station, truth)
    assert rms <= (ROUGH_RMS_DN if name == "rough" else AUTOMATIC_RMS_DN)
    assert worst <= (ROUGH_MAX_DN if name == "rough" else AUTOMATIC_MAX_DN)


@pytest.mark.slow
def test_a_bent_scratch_is_farther_from_4096_rays_only_at_its_vertices(opencl):
    # The groove's slope has a crease inside the bend, its curvature a jump at each rounded end:
    # one footprint cannot know what a pixel across them sees. Sub-rays do.
    points = [[-1.0, -0.7], [0.3, 0.2], [0.9, 1.1]]
    station = check_station(defects=[{**SCRATCH, "points_mm": points}])
    truth = oracle.aspect_image(oracle_scene(station))
    one = opencl.trace(station.replace(camera__subsampling=1)).aspect()
    row, column = np.nonzero(np.abs(one - truth) > ONE_FOOTPRINT_MAX_DN)
    place = np.stack([(column + 0.5 - 16) * 0.1, (15.5 - row) * 0.1], axis=1)
    nearest = np.min([np.hypot(*(place - vertex).T) for vertex in points], axis=0)
    assert 0 < len(row) <= 8
    assert np.all(nearest < 0.3)
    assert errors(opencl, station, truth)[1] <= CREASE_MAX_DN


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


def lenses(count: int) -> list[Station]:
    """Flat parts under random stripes, seen by random lenses whose pupil rules the footprint."""
    rng = np.random.default_rng(20)
    stations = []
    for _ in range(count):
        luminous, images = rng.uniform(2, 10), int(rng.integers(8, 60))
        station = check_station(
            rng.uniform(1, 8), exposure=rng.uniform(1.5, 6), defects=[],
            tunnel__height_mm=rng.uniform(80, 300), tunnel__luminous_mm=luminous,
            tunnel__dark_mm=luminous * rng.uniform(1, 4), camera__height_mm=rng.uniform(400, 1500),
            camera__sampling_mm=rng.uniform(0.05, 0.3), camera__rows=1, camera__columns=64,
            sequence__images=images,
        )  # fmt: skip
        stations.append(station)
    return stations


def seen_by_a_lens(station: Station) -> tuple[Array, Array, Array]:
    """Aspect image of a flat part by the true kernel, in DN; light coordinate and one box, in mm.

    Behind the mirror the light of a point (x, y) of the part lies where the straight line from a
    point of the pupil goes on to: the pixel is a box, the pupil a disc seen edge-on.
    """
    height, camera, period = station.tunnel.height_mm, station.camera, station.tunnel.period_mm
    beyond = height / camera.height_mm
    columns, pitch = station.shape[1], camera.sampling_mm
    light = (np.arange(columns) + 0.5 - columns / 2) * pitch * (1 + beyond)
    box, radius = pitch * (1 + beyond), camera.pupil_mm / 2 * beyond
    angle = np.arange(1, 64)[:, None] * np.pi / 64
    weights = np.sin(angle) ** 2 / (np.sin(angle) ** 2).sum()
    share = np.array(station.tunnel.luminous_mm / period)
    total = np.zeros(columns)
    for k in range(station.sequence.images):
        places = (light + radius * np.cos(angle)) / period - k / station.sequence.images
        lit = (weights * overlap(places, np.array(box / period), np.array(0.0), share)).sum(axis=0)
        total += np.minimum(station.sensor.exposure * lit, 1)
    one = np.sqrt(box**2 + 12 * radius**2 / 4)
    return 255 * total / station.sequence.images, light, np.full(columns, one)


def test_a_flat_part_seen_through_a_lens_is_close_to_the_true_kernel(opencl):
    boxes, one_box = [], []
    for station in lenses(20):
        truth, light, width = seen_by_a_lens(station)
        boxes.append(opencl.trace(station).aspect()[0] - truth)
        one = mean_over_scan(light, width, 0 * width, np.ones_like(width), station)
        one_box.append(255 * one - truth)
    rms, rms_of_one = (float(np.sqrt(np.mean(np.square(e)))) for e in (boxes, one_box))
    print(f"rms of two boxes {rms:.3f} DN, of one of the same variance {rms_of_one:.3f} DN")
    assert rms <= LENS_RMS_DN
    assert rms_of_one > 2 * LENS_RMS_DN
