"""What noise makes of a score, against scores of drawn sequences and of drawn normal numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from tolerances import NOISY_SHARE

import gpuspec
from gpuspec.detection.expected import expected_score
from gpuspec.detection.score import score
from gpuspec.detection.segmentation import segment
from gpuspec.simulation.simulate import trace

DRAWS = 20
FEW_DRAWS = 100
TAIL = 0.15  # a hundred draws of a P1 that is 0 or 1, and a tail that is no bell's
RARE = 1e-6  # what the sums of p and p² leave out of 1,200 events of 0.004


def test_without_spread_it_is_the_score():
    rng = np.random.default_rng(3)
    aspect = rng.integers(50, 150, (40, 60)).astype(np.float32)
    truth = np.where(rng.random((40, 60)) < 0.2, rng.integers(1, 6, (40, 60)), 0)
    valid = rng.random((40, 60)) < 0.9
    found = expected_score(aspect, np.zeros_like(aspect), truth, valid, 5, 100.0)
    real = score(segment(aspect, valid, 100.0), truth, valid, 5)
    assert (found.p1, found.p2, found.false_px) == (real.p1, real.p2, real.false_px)
    assert found.defects_hit == real.defects_hit
    assert found.p1_deviation == found.p2_deviation == found.defects_hit_deviation == 0


def test_it_is_mean_and_spread_of_the_scores_of_many_draws():
    rng = np.random.default_rng(5)
    mean = rng.normal(90, 5, (30, 40))
    deviation = rng.uniform(0.5, 3, mean.shape)
    truth = np.zeros(mean.shape, np.int32)
    for defect in range(8):
        truth[3 * defect + 1, 2 : 6 + defect] = defect + 1
    valid = np.full(mean.shape, True)
    scores = []
    for _ in range(2000):
        labels = segment(rng.normal(mean, deviation), valid, 96.0)
        one = score(labels, truth, valid, 8)
        scores.append((one.p1, one.p2, one.defects_hit, one.false_px))
    found = expected_score(mean, deviation, truth, valid, 8, 96.0)
    ours = np.array([found.p1, found.p2, found.defects_hit, found.false_px])
    spread = np.array(
        [found.p1_deviation, found.p2_deviation, found.defects_hit_deviation,
         found.false_px_deviation]
    )  # fmt: skip
    sampled = np.std(scores, axis=0)
    assert np.abs(np.mean(scores, axis=0) - ours).max() < 0.2 * sampled.max()
    assert (np.abs(np.mean(scores, axis=0) - ours) < 0.15 * sampled).all()
    assert sampled == pytest.approx(spread, rel=0.06)


@pytest.mark.parametrize("threshold", [64.0, 65.0, 66.0, 70.0])
def test_precision_is_one_where_next_to_nothing_is_detected(threshold):
    mean, valid = np.full((30, 40), 60.0), np.full((30, 40), True)
    truth = np.zeros(mean.shape, np.int32)
    truth[3:6, 4:9] = 1
    found = expected_score(mean, np.full(mean.shape, 1.5), truth, valid, 1, threshold)
    nothing = (1 - norm.sf(threshold, 60.0, 1.5)) ** mean.size
    share = 15 / mean.size  # of what is detected, pixels being alike
    assert found.p1 == pytest.approx(nothing + (1 - nothing) * share, abs=RARE)
    assert found.p1_deviation <= 0.5
    if threshold == 70.0:
        assert found.p1 > 1 - 1e-7
        assert found.p1_deviation < 1e-3


@pytest.mark.parametrize("images", [8, 40])
@pytest.mark.parametrize("steps", [0.0, 1e-9, -1e-9, 0.4, 0.9])  # above a level
def test_means_of_whole_grey_levels_stand_on_steps(images, steps):
    """Of a threshold between two steps, or at one, as automatic ones are, it is all the same."""
    rng = np.random.default_rng(images)
    shape, signal = (200, 200), 60.3
    frames = np.rint(rng.normal(signal, 1.2, (images, *shape)))
    aspect = frames.mean(0, dtype=np.float32)
    mean = np.full(shape, signal)
    deviation = np.full(shape, np.sqrt((1.2**2 + 1 / 12) / images))
    truth, valid = np.zeros(shape, np.int32), np.full(shape, True)
    threshold = 60.5 + steps / images
    drawn = int(segment(aspect, valid, threshold).astype(bool).sum())
    found = expected_score(mean, deviation, truth, valid, 0, threshold, images)
    assert abs(drawn - found.false_px) < 4 * found.false_px_deviation
    continuous = expected_score(mean, deviation, truth, valid, 0, 60.5)
    assert abs(drawn - continuous.false_px) > 4 * found.false_px_deviation


@pytest.mark.parametrize("threshold", [75.625, 76.0, 76.25, 76.5])  # 30 to 0.06 pixels
def test_precision_is_that_of_sequences_of_which_few_pixels_are_detected(opencl, threshold):
    station = gpuspec.example("trim").replace(
        part__length_mm=12.0, part__width_mm=6.0, camera__sampling_mm=0.2, populations=(),
        defects=[{"kind": "dent", "x_mm": 0.0, "y_mm": 0.0, "diameter_mm": 1.0, "depth_um": 0.03}],
        sensor__noise=True, sensor__saturation_e=300.0, sensor__read_noise_e=2.0,
        sensor__exposure=1.5, sequence__images=80, segmentation__threshold=threshold,
    )  # fmt: skip
    traced = trace(station, opencl)
    drawn = [
        traced.light_map.score(station.replace(sensor__seed=seed)).p1 for seed in range(FEW_DRAWS)
    ]
    found = traced.light_map.expected(threshold)
    assert found.p1 == pytest.approx(np.mean(drawn), abs=TAIL)
    assert found.p1_deviation == pytest.approx(np.std(drawn), abs=TAIL)


@pytest.mark.slow
def test_it_is_that_of_sequences_drawn_image_by_image():
    station = gpuspec.example("trim").replace(
        part__length_mm=60.0, part__width_mm=25.0, camera__sampling_mm=0.2, defects=(),
        populations=(), sensor__noise=True, sensor__saturation_e=500.0, sensor__read_noise_e=4.0,
        segmentation__threshold=95.0,
    ).replace(
        populations=({"kind": "dent", "count": 9, "seed": 2, "diameter_mm": [0.3, 1.2],
                      "depth_um": [1, 5]},),
    )  # fmt: skip
    scores = []
    for seed in range(DRAWS):
        one = gpuspec.simulate(station.replace(sensor__seed=seed)).score
        scores.append((one.p1, one.p2))
    result = gpuspec.simulate(station)
    found = result.expected
    assert found is not None
    spread = np.array([found.p1_deviation, found.p2_deviation])
    gap = np.abs(np.mean(scores, axis=0) - (found.p1, found.p2))
    assert (gap < NOISY_SHARE + 3 * spread / DRAWS**0.5).all()
    assert np.std(scores, axis=0, ddof=1) == pytest.approx(spread, rel=3 / (2 * DRAWS) ** 0.5)
    assert gpuspec.simulate(station.replace(sensor__noise=False)).expected is None
