"""All thresholds at once: counts of levels are what segmenting and scoring an image gives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import beta
from tolerances import (
    BOUND,
    BOUND_STEP,
    FLOAT_ROUNDING,
    MEAN_ESTIMATE,
    PRINTED_BOUND,
    STEP_OFF,
)

from gpuspec.detection.score import score
from gpuspec.detection.segmentation import segment
from gpuspec.light.constants import LEVELS
from gpuspec.light.levels import Levels, Sample, Zones, levels_of, levels_per_dn, thresholds
from gpuspec.light.light_map import LightMapArrays
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.records import design_block
from gpuspec.simulation.simulate import Traced, trace
from gpuspec.station.station import Station
from gpuspec.sweeps.trying.curves import Curves
from gpuspec.sweeps.trying.flawless import Flawless, surveyed
from gpuspec.sweeps.trying.listing import WHOLE
from gpuspec.sweeps.trying.parts import Placed, Screen, TracedPart
from gpuspec.sweeps.trying.screening import Bounds

DEFECTS = {
    "populations": [
        {"kind": "dent", "count": 4, "diameter_mm": [0.4, 0.9], "depth_um": [2.0, 8.0]},
        {"kind": "scratch", "count": 2, "seed": 1, "width_mm": 0.3, "length_mm": [1, 3],
         "depth_um": 4.0},
    ]
}  # fmt: skip


def station(**changes: object) -> Station:
    """A part of 14 x 9 mm with six defects; rows of 137 pixels are no whole vectors."""
    base = Station.from_dict(
        {
            "part": {"length_mm": 14.0, "width_mm": 9.0},
            "tunnel": {"height_mm": 200.0, "luminous_mm": 2.0, "dark_mm": 6.0},
            "camera": {"sampling_mm": 0.1, "columns": 137, "rows": 90, "subsampling": 1},
            **DEFECTS,
        }
    )
    return base.replace(**changes) if changes else base


def zones_of(traced: Traced) -> Zones:
    return Zones.of(traced.truth.labels, traced.lost != 1, len(traced.truth.defects))


def designs(base: Station) -> list[Station]:
    """Stripes, exposures, images and depths; some without a closed form."""
    changes = [
        {},
        {"tunnel.luminous_mm": 0.7, "tunnel.dark_mm": 1.9, "sequence.images": 13},
        {"sensor.exposure": 1.0},
        {"sensor.exposure": 0.2},
        {"sensor.exposure": 37.5, "tunnel.dark_leak": 0.01},
        {"sensor.bit_depth": 10},
        {"sensor.bit_depth": 12, "sensor.exposure": 2.5},
        {"sensor.bit_depth": 16, "sequence.images": 7},
        {"sequence.step_mm": 0.31},
        {"sequence.fusion": "std"},
        {"sensor.noise": True, "sensor.read_noise_e": 40.0, "sensor.black_level_dn": 8.0},
    ]
    return [base.replace(**change) for change in changes]


def scored_one_by_one(traced: Traced, design: Station) -> tuple[list[int], list[int], list[int]]:
    """Detected pixels inside and outside zones, and defects hit, at every threshold."""
    aspect = traced.light_map.counted(design)
    valid = traced.lost != 1
    hit, false, hits = [], [], []
    for threshold in thresholds(design.sensor.full_scale_dn):
        found = score(
            segment(aspect, valid, threshold), traced.truth.labels, valid, len(traced.truth.defects)
        )
        hit.append(found.hit_px)
        false.append(found.false_px)
        hits.append(found.defects_hit)
    return hit, false, hits


def assert_same(got: Levels, expected: Levels) -> None:
    """Equal but for level 0, which no threshold detects."""
    assert np.array_equal(got.inside[:, 1:], expected.inside[:, 1:])
    assert np.array_equal(got.outside[:, 1:], expected.outside[:, 1:])
    assert np.array_equal(got.peaks, expected.peaks)


# ------------------------------------------------------------------------------------- thresholds


@pytest.mark.parametrize("full_scale", [255, 1023, 4095, 65535])
def test_a_pixel_is_above_a_threshold_if_its_level_is(full_scale):
    steps = thresholds(full_scale)
    assert steps.dtype == np.float32
    assert (np.diff(steps) > 0).all()
    assert np.abs(steps - np.arange(LEVELS) * full_scale / 255).max() < STEP_OFF * full_scale
    beside = [steps, np.nextafter(steps, np.float32(np.inf)), np.nextafter(steps, np.float32(-1))]
    pixels = np.clip(np.concatenate(beside), 0, full_scale).astype(np.float32)
    pixels[pixels < 1e-30] = 0  # a subnormal grey level is none
    level = np.ceil(pixels * levels_per_dn(full_scale)).astype(int)
    assert np.array_equal(pixels[:, None] > steps, level[:, None] > np.arange(LEVELS))


def test_thresholds_of_eight_bits_are_the_whole_grey_levels():
    assert np.array_equal(thresholds(255), np.arange(256))


# ---------------------------------------------------------------------------------------- counting


def test_p1_p2_and_defects_hit_at_all_thresholds_are_those_of_segmenting_and_scoring(backend):
    """On every backend; on OpenCL they come from histograms on the device."""
    traced = trace(station(), backend)
    zones = zones_of(traced)
    tried = designs(traced.station)
    part = TracedPart(traced.light_map.counter(zones), zones, None)
    curves = Curves.of([part.counter.count(tried)], [part], 1e-3)
    valid = traced.lost != 1
    for i, design in enumerate(tried):
        hit, false, hits = scored_one_by_one(traced, design)
        assert curves.hit_px[0, i].tolist() == hit
        assert curves.false_px[0, i].tolist() == false
        assert curves.hits[0, i].tolist() == hits
        labels = segment(traced.light_map.counted(design), valid, 60.0)
        expected = score(labels, traced.truth.labels, valid, 6)
        if design.sensor.bit_depth == 8:
            assert (curves.p1[i, 60], curves.p2[i, 60]) == (expected.p1, expected.p2)
    assert curves.exact.all()
    assert np.array_equal(curves.p1_low, curves.p1_high)


def scalar(memory_bytes: int | None = None) -> OpenCLBackend:
    """The kernels as a GPU runs them: a pixel per work-item, counters in local memory."""
    engine = OpenCLBackend(memory_bytes=memory_bytes)
    engine.settle({"widths": {}})
    return engine


@pytest.mark.parametrize("part", ["flat", "beside", "crowned", "no defect in view"])
def test_device_counts_are_those_of_the_image(opencl, part):
    changes = {
        "flat": {},
        "beside": {"camera.columns": 150, "camera.rows": 101},
        "crowned": {"part.crown_radius_x_mm": 300.0, "part.surface": "height"},
        "no defect in view": {"camera.columns": 9, "camera.rows": 3},
    }
    base = station(**changes[part])
    for engine in (opencl, scalar()):
        traced = trace(base, engine)
        zones = zones_of(traced)
        tried = designs(base)[:8]
        got = traced.light_map.counter(zones).count(tried)
        for i, design in enumerate(tried):
            image = traced.light_map.counted(design)
            expected = levels_of(image, zones, design.sensor.full_scale_dn)
            one = Levels(*(getattr(got, name)[i : i + 1] for name in Levels.__dataclass_fields__))
            assert_same(one, expected)


def test_tiles_and_batches_count_the_same(opencl, monkeypatch):
    tried = designs(station())[:5] * 3
    short = OpenCLBackend(memory_bytes=60_000)
    assert short.trace(station()).tiles > 1
    whole, tiled = (
        traced.light_map.counter(zones_of(traced)).count(tried)
        for traced in (trace(station(), engine) for engine in (opencl, short))
    )
    assert_same(tiled, whole)
    for engine in (OpenCLBackend(), scalar()):
        traced = trace(station(), engine)
        monkeypatch.setattr("gpuspec.light.opencl_levels._AT_ONCE", 4000)
        monkeypatch.setattr("gpuspec.light.opencl_levels._STRETCH", 960)  # whole vectors
        monkeypatch.setattr("gpuspec.light.opencl_levels._BYTES", 100)
        monkeypatch.setattr("gpuspec.light.opencl_device.LAUNCH_SECONDS", 1e-7)
        monkeypatch.setattr("gpuspec.light.opencl_device._FIRST_WORK", 1.0)
        monkeypatch.setattr(engine, "_work", {})
        assert_same(traced.light_map.counter(zones_of(traced)).count(tried), whole)


def test_peaks_and_ceilings_have_a_budget_of_memory(monkeypatch):
    device = OpenCLBackend()
    base = station()
    screen = Screen.of(base, Placed.of(base), 700, 0)
    counter = screen.under(base, device, Flawless(base, device), first=True).counter
    tried = [station()] * 7
    expected = counter.count(tried)
    budget = 2 * 4 * len(tried) * device.width  # of two zones, or of two vectors of regions
    monkeypatch.setattr("gpuspec.light.opencl_levels._BYTES", budget)
    taken = []
    real = device.empty
    monkeypatch.setattr(device, "empty", lambda size: taken.append(size) or real(size))
    assert_same(counter.count(tried), expected)
    assert taken
    assert max(taken) <= budget


@pytest.mark.parametrize("engine", [OpenCLBackend, scalar])
def test_no_level_leaves_the_counters(engine):
    """Whatever a pixel's grey level: what is no number counts as dark, what is too high as 255."""
    device = engine()
    traced = trace(station(), device)
    counter = traced.light_map.counter(zones_of(traced))
    light = np.tile(np.array([np.nan, np.inf, -np.inf, 1e30], np.float32), counter._inside[0].count)
    *others, _ = counter._inside[0].planes
    counter._inside = [replace(counter._inside[0], planes=(*others, device.constant(light)))]
    block = design_block(station())[None]
    for per_dn in (np.float32(1), np.float32(1e6), np.float32(np.nan)):
        found = counter._counted(block, per_dn, station().sensor)
        assert found.inside.sum() == counter._inside[0].count
        assert ((found.peaks >= 0) & (found.peaks < LEVELS)).all()
    assert found.inside[0, 0] == counter._inside[0].count


@pytest.mark.parametrize("images", [8, 9, 12])
def test_what_fills_a_vector_is_no_pixel_of_a_noisy_image(opencl, images):
    """Without light, dark levels are all alike: their variance may be 0, and they are above 0."""
    noisy = station(
        sensor__noise=True, sensor__saturation_e=10_000.0, sensor__read_noise_e=2.0,
        sensor__black_level_dn=5.0, sequence__images=images, tunnel__luminous_mm=4.0,
        tunnel__dark_mm=12.0,
    )  # fmt: skip
    screen = Screen.of(noisy, Placed.of(noisy), 450, 0)
    screened = screen.under(noisy, opencl, Flawless(noisy, opencl), first=True)
    assert screened.sample is not None
    counted = screened.counter.count([noisy])
    assert len(screened.sample.chosen) % WHOLE
    assert counted.sampled[0, 1:].sum() == len(screened.sample.chosen)
    assert counted.inside[0, 1:].sum() == screened.zones.sizes.sum()


def test_a_mean_a_last_bit_above_full_scale_has_the_highest_level():
    zones = Zones.of(np.ones((1, 3), np.int32), np.ones((1, 3), np.bool_), 1)
    aspect = np.array([[65535.93, 65535, 0]], np.float32)  # as 5,000 images at 16 bits add up to
    found = levels_of(aspect, zones, 65535)
    assert (found.inside[0, 255], found.inside[0, 0], found.peaks[0, 0]) == (2, 1, 255)


def test_counts_fail_where_the_level_is_rounded_otherwise(opencl):
    """The comparison can fail: levels that are rounded down are others."""
    traced = trace(station(), opencl)
    zones = zones_of(traced)
    got = traced.light_map.counter(zones).count([traced.station])
    image = np.floor(traced.light_map.aspect())
    with pytest.raises(AssertionError):
        assert_same(got, levels_of(image, zones, 255))


def test_only_keeps_the_valid_pixels_of_each_zone():
    truth = np.array([[1, 1, 2], [0, 3, 2]], np.int32)
    zones = Zones.of(truth, np.ones((2, 3), np.bool_), 4)
    assert zones.sizes.tolist() == [2, 2, 1, 0]
    valid = np.array([[True, False, True], [True, False, True]])
    assert zones.only(valid).sizes.tolist() == [1, 2, 0, 0]
    assert np.array_equal(zones.only(valid).pixels, Zones.of(truth, valid, 4).pixels)
    again = zones.only(valid).only(np.array([[True, True, False], [False, True, True]]))
    assert again.valid.tolist() == [[True, False, False], [False, False, True]]


# ---------------------------------------------------------------------------------------- sampling


def test_bounds_hold_the_true_number_and_estimates_are_near(opencl):
    """Over many draws of the sample, at every threshold of some designs."""
    base = station()
    traced = trace(base, opencl)
    zones = zones_of(traced)
    tried = designs(base)[:5]
    truth = traced.light_map.counter(zones).count(tried)
    risk = 0.02
    outside, count = 0, 0
    sums = np.zeros((5, LEVELS))
    flawless, placed = Flawless(base, opencl), Placed.of(base)
    for seed in range(60):
        part = Screen.of(base, placed, 700, seed).under(base, opencl, flawless, first=True)
        curves = Curves.of([part.counter.count(tried)], [part], risk)
        true = Curves.of([truth], [TracedPart(part.counter, zones, None)], risk).false_px[0]
        below, above = true < curves.false_low, true > curves.false_high
        outside += int(below.sum() + above.sum())
        count += true.size
        sums += curves.false_px[0]
        assert (curves.p1_low <= curves.p1).all()
        assert (curves.p1 <= curves.p1_high).all()
    assert outside <= 2 * risk * count
    assert np.abs(sums / 60 - true).max() < MEAN_ESTIMATE * zones.valid.size


def drawn_alone(strata: int, level: int, ceiling: int) -> tuple[Levels, TracedPart]:
    """A part of which a sample was drawn that has one level throughout."""
    found = Levels.empty(1, 1)
    found.sampled[0, level], found.ceiling[0] = strata, ceiling
    none, one = np.zeros(0, np.uint32), np.ones(1, np.float32)
    sample = Sample(none, np.zeros(strata, np.uint32), 10, one, one, one)
    zones = Zones(none, np.array([0, 0]), np.ones((1, 1), np.bool_))
    return found, TracedPart(None, zones, sample)


def test_the_strata_of_several_parts_are_bounded_together():
    """30 and 50 strata, of which those of the second alone are above 100: 50 of 80 drawn."""
    drawn = [drawn_alone(30, 100, 150), drawn_alone(50, 200, 220)]
    curves = Curves.of([levels for levels, _ in drawn], [part for _, part in drawn], 0.01)
    bounds, fifty = Bounds(80, 10, 0.01), np.array([50])
    assert curves.false_px.sum(axis=0)[0, [50, 150, 210]].tolist() == [800, 500, 0]
    assert curves.false_low[0, 150] == bounds.low(fifty)[0]
    assert curves.false_high[0, 150] == bounds.high(fifty)[0]
    # From the higher of both ceilings on nothing that was not drawn is detected, below it may be.
    assert curves.false_high[0, 219] > 0
    assert (curves.false_high[0, 220:] == 0).all()
    assert not curves.exact[0]


def test_the_interval_is_that_of_clopper_and_pearson():
    """5 of 20 at 2.5 % to either side: 0.0866 to 0.4910, as printed in tables."""
    bounds = Bounds(20, 10, 0.025)
    x = np.array([0, 5, 20])
    assert bounds.low(x) / 200 == pytest.approx([0, 0.0866, 0.8316], abs=PRINTED_BOUND)
    assert bounds.high(x)[:2] / 200 == pytest.approx([0.1684, 0.4910], abs=PRINTED_BOUND)
    assert bounds.high(x)[2] == 200


def test_between_worked_out_numbers_the_bounds_are_those_further_out():
    """Of 5,000 strata not every interval is worked out: against scipy's, number by number."""
    strata, x, risk = 5000, np.arange(5001), 1e-4
    low, high = np.zeros(5001), np.ones(5001)
    low[1:] = beta.ppf(risk, x[1:], strata - x[1:] + 1)
    high[:-1] = beta.isf(risk, x[:-1] + 1, strata - x[:-1])
    bounds = Bounds(strata, 1000, risk)
    found_low, found_high = bounds.low(x) / (strata * 1000), bounds.high(x) / (strata * 1000)
    # What is drawn is certain, and so is what is not.
    low = np.maximum(low, x / (strata * 1000))
    high = np.minimum(high, 1 - (strata - x) / (strata * 1000))
    assert (found_low <= low * (1 + BOUND)).all()
    assert (found_high >= high * (1 - BOUND)).all()
    assert np.abs(found_low - low).max() < BOUND_STEP
    assert np.abs(found_high - high).max() < BOUND_STEP


def test_what_is_drawn_is_detected_for_certain_and_what_is_not_is_not():
    """Strata of one pixel are no sample: the number is known. The last one is all drawn but one."""
    x = np.arange(21)
    assert Bounds(20, 1, 0.01).low(x).tolist() == x.tolist()
    assert Bounds(20, 1, 0.01).high(x).tolist() == x.tolist()
    two = Bounds(20, 2, 1e-9)
    assert (two.low(x) >= x).all()
    assert (two.high(x) <= 40 - (20 - x)).all()
    assert two.low(x)[1] == 1
    assert two.high(x)[19] == 39


def kernel(wide: Any, narrow: Any, x: Any) -> Any:
    """Weight of two boxes folded, a trapezoid, at x from its middle."""
    outer = (wide + narrow) / 2 - np.abs(x)
    return np.clip(outer / np.maximum(narrow, 1e-9), 0, 1) / wide


@pytest.mark.parametrize("narrowest", [0.0, 0.6])
def test_a_region_s_bound_is_above_every_pixel_s_exposure(narrowest):
    """A kernel on the light that is nowhere below another sees no less of the stripes.

    Footprints of a region differ by ten to one here, those of a real part by much less.
    """
    random = np.random.default_rng(0)
    wide, irradiance = random.uniform(0.2, 2, (1, 100, 70)), random.uniform(0.1, 1, (1, 100, 70))
    narrow = wide * np.maximum(random.uniform(0, 1, wide.shape), narrowest)
    planes = [plane.astype(np.float32) for plane in (wide, narrow, irradiance)]
    arrays = LightMapArrays(planes[0], *planes, np.zeros((100, 70), np.uint8))
    of_rest = np.ones((100, 70), np.bool_)
    of_rest[18:26, 28:37] = False
    bounds = surveyed(arrays, of_rest)
    assert len(bounds[0]) == 4  # regions of 64 x 64 pixels
    corners = ((0, 0), (0, 64), (64, 0), (64, 64))
    x = np.linspace(0, 2.5, 500)[:, None]
    for (row, column), w1, w2, v1 in zip(corners, *bounds, strict=True):
        region = np.s_[0, row : row + 64, column : column + 64]
        kept = of_rest[region[1:]]
        planes = arrays.wide_mm, arrays.narrow_mm, arrays.irradiance
        wide, narrow, v = (plane[region][kept].astype(float) for plane in planes)
        bound = v1 * kernel(float(w1), float(w2), x)
        assert (bound >= v * kernel(wide, narrow, x) * (1 - FLOAT_ROUNDING * 8)).all()
