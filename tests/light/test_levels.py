"""All thresholds at once: counts of levels are what segmenting and scoring an image gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import part_with
from scipy.stats import beta, chi2
from tolerances import (
    BOUND,
    BOUND_STEP,
    FLOAT_ROUNDING,
    MEAN_ESTIMATE,
    P_VALUE,
    PRINTED_BOUND,
    STEP_OFF,
)

from gpuspec.detection.score import score
from gpuspec.detection.segmentation import segment
from gpuspec.light.backend import Backend
from gpuspec.light.constants import LEVELS
from gpuspec.light.levels import Levels, Sample, Zones, levels_of, levels_per_dn, thresholds
from gpuspec.light.light_map import LightMapArrays
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.records import design_block
from gpuspec.simulation.simulate import Traced, trace
from gpuspec.station.station import Station
from gpuspec.sweeps.trying.curves import Curves
from gpuspec.sweeps.trying.parts import TracedPart
from gpuspec.sweeps.trying.screening import Bounds, draw

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
            "camera": {"sampling_mm": 0.1, "columns": 137, "rows": 90},
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
    aspect = traced.light_map.aspect(design)
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
        labels = segment(traced.light_map.aspect(design), valid, 60.0)
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
            image = traced.light_map.aspect(design)
            expected = levels_of(image, zones, design.sensor.full_scale_dn)
            one = Levels(*(getattr(got, name)[i : i + 1] for name in Levels.__dataclass_fields__))
            assert_same(one, expected)


def test_tiles_and_batches_count_the_same(opencl, monkeypatch):
    tried = designs(station())[:5] * 3
    whole, tiled = (
        (traced.light_map, traced.light_map.counter(zones_of(traced)).count(tried))
        for traced in (
            trace(station(), opencl), trace(station(), OpenCLBackend(memory_bytes=60_000))
        )
    )  # fmt: skip
    assert OpenCLBackend(memory_bytes=60_000).trace(station()).tiles > 1
    assert_same(tiled[1], whole[1])
    for engine in (OpenCLBackend(), scalar()):
        traced = trace(station(), engine)
        monkeypatch.setattr("gpuspec.light.opencl_levels._AT_ONCE", 4000)
        monkeypatch.setattr("gpuspec.light.opencl_levels._STRETCH", 1000)
        monkeypatch.setattr("gpuspec.light.opencl_levels._BYTES", 100)
        monkeypatch.setattr("gpuspec.light.opencl_device.LAUNCH_SECONDS", 1e-7)
        monkeypatch.setattr("gpuspec.light.opencl_device._FIRST_WORK", 1.0)
        monkeypatch.setattr(engine, "_work", {})
        assert_same(traced.light_map.counter(zones_of(traced)).count(tried), whole[1])


def test_peaks_and_ceilings_have_a_budget_of_memory(monkeypatch):
    device = OpenCLBackend()
    traced, zones, drawn = sampled(device, station(), 700)
    counter = traced.light_map.counter(zones, drawn)
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
    light = np.tile(np.array([np.nan, np.inf, -np.inf, 1e30], np.float32), counter._inside.count)
    counter._inside = replace(counter._inside, irradiance=device.constant(light))
    block = design_block(station())[None]
    for per_dn in (np.float32(1), np.float32(1e6), np.float32(np.nan)):
        found = counter._counted(block, per_dn)
        assert found.inside.sum() == counter._inside.count
        assert ((found.peaks >= 0) & (found.peaks < LEVELS)).all()
    assert found.inside[0, 0] == counter._inside.count


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


def sampled(engine: Backend, base: Station, strata: int, seed: int = 0):
    traced = trace(base, engine)
    flawless = engine.trace(base.replace(defects=(), populations=())).read().footprint_mm[0]
    zones = zones_of(traced)
    drawn = draw(zones, traced.light_map.read(), flawless, strata, seed)
    assert drawn is not None
    return traced, zones, drawn


@pytest.mark.parametrize("radius", [None, 400.0])
def test_sample_and_zones_stand_for_every_pixel_once(opencl, radius):
    _, zones, drawn = sampled(opencl, station(**{"part.crown_radius_x_mm": radius}), 700)
    taken = np.concatenate([zones.pixels, drawn.near, drawn.chosen])
    assert np.unique(taken).size == taken.size
    assert zones.valid.flat[taken].all()
    stand_for = zones.pixels.size + drawn.near.size + drawn.weight * drawn.chosen.size
    assert stand_for == np.count_nonzero(zones.valid)


@pytest.mark.parametrize("radius", [None, 400.0, -900.0])
def test_no_pixel_of_a_stratum_is_above_the_ceiling(opencl, radius):
    base = station(**{"part.crown_radius_x_mm": radius, "camera.vignetting": "cos4"})
    for engine in (opencl, scalar()):
        traced, zones, drawn = sampled(engine, base, 700)
        rng = np.random.default_rng(5)
        tried = [
            base.replace(**{
                "tunnel.luminous_mm": rng.uniform(0.3, 8), "tunnel.dark_mm": rng.uniform(0.3, 20),
                "sensor.exposure": rng.uniform(0.5, 20), "sequence.images": int(k),
                "tunnel.dark_leak": rng.choice([0, 0.02]),
            })
            for k in rng.integers(2, 90, 60)
        ]  # fmt: skip
        whole = traced.light_map.counter(zones).count(tried)
        part = traced.light_map.counter(zones, drawn).count(tried)
        assert_same(
            Levels(whole.inside, part.outside, part.sampled, part.peaks, part.ceiling),
            Levels(part.inside, part.outside, part.sampled, whole.peaks, part.ceiling),
        )
        rest = (whole.outside - part.outside)[:, 1:]
        assert (rest >= part.sampled[:, 1:]).all()
        highest = np.array([np.flatnonzero(row).max(initial=-1) + 1 for row in rest])
        assert (highest <= part.ceiling).all()
        # It is worth having: on most designs not more than a level above.
        assert np.median(part.ceiling - highest) <= 1
        assert (part.ceiling > 0).all()


def test_bounds_hold_the_true_number_and_estimates_are_near(opencl):
    """Over many draws of the sample, at every threshold of some designs."""
    base = station()
    traced, zones, drawn = sampled(opencl, base, 700)
    tried = designs(base)[:5]
    truth = traced.light_map.counter(zones).count(tried)
    risk = 0.02
    outside, count = 0, 0
    sums = np.zeros((5, LEVELS))
    for seed in range(40):
        drawn = draw(zones, traced.light_map.read(), traced.light_map.read().footprint_mm[0], 700,
                     seed)  # fmt: skip
        part = TracedPart(traced.light_map.counter(zones, drawn), zones, drawn)
        curves = Curves.of([part.counter.count(tried)], [part], risk)
        true = Curves.of([truth], [TracedPart(part.counter, zones, None)], risk).false_px[0]
        below, above = true < curves.false_low, true > curves.false_high
        outside += int(below.sum() + above.sum())
        count += true.size
        sums += curves.false_px[0]
        assert (curves.p1_low <= curves.p1).all()
        assert (curves.p1 <= curves.p1_high).all()
    assert outside <= 2 * risk * count
    assert np.abs(sums / 40 - true).max() < MEAN_ESTIMATE * zones.valid.size


def drawn_alone(strata: int, level: int, ceiling: int) -> tuple[Levels, TracedPart]:
    """A part of which a sample was drawn that has one level throughout."""
    found = Levels.empty(1, 1)
    found.sampled[0, level], found.ceiling[0] = strata, ceiling
    none, one = np.zeros(0, np.uint32), np.ones(1, np.float32)
    sample = Sample(none, np.zeros(strata, np.uint32), 10, one, one)
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


def made_up(rows: int, columns: int, seed: int = 0) -> tuple[Zones, LightMapArrays]:
    """An image with one zone of a few pixels, of which every footprint and irradiance differs."""
    random = np.random.default_rng(seed)
    truth = np.zeros((rows, columns), np.int32)
    truth[20:24, 30:35] = 1
    footprint = random.uniform(0.2, 2.0, (1, rows, columns)).astype(np.float32)
    irradiance = random.uniform(0.1, 1.0, (1, rows, columns)).astype(np.float32)
    lost = np.zeros((rows, columns), np.uint8)
    zones = Zones.of(truth, np.ones(truth.shape, np.bool_), 1)
    return zones, LightMapArrays(footprint.copy(), footprint, irradiance, lost)


def test_pixels_next_to_a_zone_and_those_that_are_no_flawless_ones_stand_for_themselves():
    zones, arrays = made_up(90, 80)
    flawless = arrays.footprint_mm[0].copy()
    flawless[50, 60] *= 1.01
    drawn = draw(zones, arrays, flawless, 700, 0)
    assert drawn is not None
    near = np.zeros((90, 80), np.bool_)
    near.flat[drawn.near] = True
    wanted = np.zeros((90, 80), np.bool_)
    wanted[18:26, 28:37] = True  # two pixels around
    wanted[20:24, 30:35] = False
    wanted[50, 60] = True
    assert near[wanted].all()
    assert not near[20:24, 30:35].any()
    # The rest are fewer than a stratum's pixels: those left over after the last.
    assert np.count_nonzero(near & ~wanted) < drawn.weight


def test_one_pixel_of_each_stratum_is_drawn_and_each_as_often():
    """Chi-square over 60 seeds; another seed draws others, the same seed the same."""
    zones, arrays = made_up(90, 80)
    flawless = arrays.footprint_mm[0]
    counts = np.zeros(10)
    for seed in range(60):
        drawn = draw(zones, arrays, flawless, 720, seed)
        assert drawn is not None
        assert drawn.weight == 10
        every = np.ones(90 * 80, np.bool_)
        every[zones.pixels] = False
        every[18 * 80 : 26 * 80] &= np.tile((np.arange(80) < 28) | (np.arange(80) > 36), 8)
        place = np.searchsorted(np.flatnonzero(every), drawn.chosen)
        assert np.array_equal(place // 10, np.arange(len(place)))
        counts += np.bincount(place % 10, minlength=10)
        again = draw(zones, arrays, flawless, 720, seed)
        assert again is not None
        assert np.array_equal(again.chosen, drawn.chosen)
    assert chi2.sf(((counts - counts.mean()) ** 2 / counts.mean()).sum(), 9) > P_VALUE


def test_a_region_s_bound_is_above_every_pixel_s_exposure():
    """q(w) w rises with w: an exposure V q(w) is not above V1 q(w1) if w <= w1, V / w <= V1 / w1.

    Footprints of a region differ by ten to one here, those of a real part by much less.
    """
    zones, arrays = made_up(100, 70)
    drawn = draw(zones, arrays, arrays.footprint_mm[0], 700, 0)
    assert drawn is not None
    assert len(drawn.footprint_mm) == 4  # regions of 64 x 64 pixels
    corners = ((0, 0), (0, 64), (64, 0), (64, 64))
    for (row, column), w1, v1 in zip(corners, drawn.footprint_mm, drawn.irradiance, strict=True):
        region = np.s_[0, row : row + 64, column : column + 64]
        rest = np.ones((100, 70), np.bool_)
        rest[18:26, 28:37] = False
        kept = rest[region[1:]]
        w, v = arrays.footprint_mm[region][kept], arrays.irradiance[region][kept]
        assert w1 >= w.max()
        assert v1 / w1 >= (v / w).max() * (1 - FLOAT_ROUNDING * 4)


def test_a_part_all_of_zones_has_no_sample(opencl):
    dent = {"kind": "dent", "x_mm": 0.0, "y_mm": 0.0, "diameter_mm": 9.0, "depth_um": 1.0}
    base = part_with([dent], 0.1)
    base = base.replace(**{"camera.columns": 12, "camera.rows": 12})
    traced = trace(base, opencl)
    zones = zones_of(traced)
    arrays = traced.light_map.read()
    assert draw(zones, arrays, arrays.footprint_mm[0], 100, 0) is None
