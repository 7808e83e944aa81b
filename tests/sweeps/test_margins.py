"""What a sweep keeps beside P1 and P2: margin, noise, false pixels, the smallest found, costs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sweeping import rows

from gpuspec.arrays import BESIDE
from gpuspec.light.levels import thresholds
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.part.guard import near
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.station.costs import COSTS, costs
from gpuspec.station.station import Station
from gpuspec.sweeps.plan import Plan, with_part
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.bench import Bench
from gpuspec.sweeps.trying.found import smallest_found
from gpuspec.sweeps.trying.noise import Noise

VARY = {"tunnel.luminous_mm": "0.5:4:4", "sensor.exposure": [2, 4], "sequence.images": [8, 24, 64]}
NOISE_SHARE = 0.1  # largest of the nine below: 0.06


@pytest.fixture(scope="module")
def tried(opencl, tmp_path_factory):
    """One grid on two parts, exact and screened, with sub-rays where they are needed."""
    from sweeping import STATION

    station = Station.from_dict(STATION, "part.toml").replace(camera__subsampling="auto")
    plans = [Plan.of(station, VARY, parts=2, samples=samples) for samples in (0, 256)]
    folder = tmp_path_factory.mktemp("margins")
    return [sweep(plan, folder / str(plan.samples), backend=opencl) for plan in plans]


def looked_at(station: Station, opencl: OpenCLBackend):
    """Levels of an image, which pixels belong to which defect, and which are flawless."""
    relief = Relief.of(station)
    truth = Truth.of(station, relief)
    light_map = opencl.trace(station, relief)
    level = np.ceil(light_map.aspect() * np.float32(255 / station.sensor.full_scale_dn))
    flawless = light_map.lost() != BESIDE
    flawless.flat[near(station, relief, truth.labels)] = False
    return level, truth, flawless


@pytest.mark.parametrize("design", [0, 5, 13, 23])
def test_the_margin_is_that_of_the_images(tried, opencl, design):
    run = tried[0]
    row = rows(run)[design]
    peaks, sizes, highest, false = [], [], 0.0, np.zeros(256, int)
    for part in range(2):
        station = with_part(run.plan.station_of(design), part)
        level, truth, flawless = looked_at(station, opencl)
        peaks += [level[truth.labels == n].max() for n in range(1, len(truth.defects) + 1)]
        sizes += [np.float32(defect.size_mm) for defect in truth.defects]
        highest = max(highest, level[flawless].max())
        false += [(level[flawless] > t).sum() for t in range(256)]
    assert row["peaks"] == peaks
    assert row["sizes_mm"] == sizes
    assert row["margin_dn"] == min(peaks) - highest == row["margin_high_dn"]
    assert row["flawless_dn"] == highest
    assert row["margin_sigma"] == pytest.approx(row["margin_dn"] / row["noise_dn"])
    assert row["false_px"] == false.tolist()
    assert (np.array(row["hits"]) == [sum(p > t for p in peaks) for t in range(256)]).all()


def test_a_screened_margin_is_no_more_than_it_is_and_its_bound_no_less(tried):
    exact, screened = (rows(run) for run in tried)
    estimated = 0
    for one, other in zip(exact, screened, strict=True):
        assert other["margin_dn"] <= one["margin_dn"] <= other["margin_high_dn"]
        assert (np.array(other["false_px"]) >= one["false_px"]).all()
        assert other["peaks"] == one["peaks"]
        estimated += not other["exact"]
    assert estimated > 6


def test_beyond_the_guard_band_a_part_looks_as_one_without_defects(station, opencl):
    """To the share of the light that the band is made for; its rims are brighter by far."""
    design = station.replace(sequence__images=48, sensor__exposure=4)
    _, truth, flawless = looked_at(design, opencl)
    bare = opencl.trace(design.replace(defects=[], populations=[])).aspect()
    seen = opencl.trace(design).aspect()
    assert np.abs(seen - bare)[flawless].max() < 1
    rim = ~flawless & (truth.labels == 0)
    assert np.abs(seen - bare)[rim].max() > 20


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(1, 4)), min_size=1, max_size=8),
    st.integers(0, 9),
)
def test_the_smallest_found_is_that_above_which_all_are(defects, flawless):
    peaks, sizes = (np.array(values) for values in zip(*defects, strict=True))
    found, margin = smallest_found(peaks[None], sizes, np.array([flawless]))
    kept = [s for s in set(sizes.tolist()) if (peaks[sizes >= s] > flawless).all()]
    if not kept:
        assert np.isnan(found[0]) and np.isnan(margin[0])
        return
    assert found[0] == min(kept)
    assert margin[0] == peaks[sizes >= min(kept)].min() - flawless


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sensor.exposure": 2.0},
        {"sensor.saturation_e": 1000.0},
        {"sensor.bit_depth": 12},
        {"camera.pupil_mm": 0.0},
        {"tunnel.dark_leak": 0.05},
        {"part.diffuse": 0.5},
        {"sequence.images": 160},
        {"tunnel.luminous_mm": 0.5, "tunnel.dark_mm": 1.5},
        {"tunnel.luminous_mm": 8.0, "tunnel.dark_mm": 20.0, "sequence.images": 400},
    ],
    ids=str,
)
def test_the_noise_is_that_of_the_aspect_image_of_a_noisy_sensor(station, opencl, changes):
    noisy = station.replace(sensor__noise=True, defects=[], populations=[], **changes)
    found = Noise.traced(noisy, Relief.of(noisy)).of(noisy.replace(sensor__noise=False))
    deviation = opencl.trace(noisy).moments().deviation
    assert found == pytest.approx(np.sqrt((deviation**2).mean()), rel=NOISE_SHARE)


def test_a_screened_box_has_the_noise_of_ceiling_and_walls(station, opencl):
    box = {"tunnel.section": "box", "tunnel.width_mm": 60.0, "part.crown_radius_y_mm": 10.0}
    plan = Plan.of(station.replace(**box), VARY, samples=256)
    exact, screened = (
        np.array(Bench(plan, opencl).rows([0, 13], sampled=sampled)["noise_dn"])
        for sampled in (False, True)
    )
    assert screened == pytest.approx(exact, rel=NOISE_SHARE)
    assert not np.array_equal(screened, exact)  # by other pixels


def test_a_cost_that_the_station_does_not_tell_is_none_and_others_follow():
    station = Station(sensor={"exposure": 4.0, "saturation_e": 1e4}, sequence={"images": 20})
    bare = costs(station)
    assert tuple(bare) == COSTS
    assert bare["exposure_s"] is bare["cycle_s"] is None
    lit = station.replace(sensor__light_e_per_s=4e6)  # 10 ms
    assert costs(lit)["exposure_s"] == pytest.approx(0.01)
    assert costs(lit)["cycle_s"] == pytest.approx(0.2)
    for rate, cycle in ((1000.0, 0.2), (50.0, 0.4)):  # whichever takes longer
        timed = lit.replace(sequence__frame_rate_hz=rate)
        assert costs(timed)["cycle_s"] == pytest.approx(cycle)


def test_levels_of_twelve_bits_are_told_in_their_grey_levels(station, opencl, tmp_path):
    deep = station.replace(sensor__bit_depth=12, sequence__images=40)
    (row,) = rows(sweep(Plan.of(deep, {"sensor.exposure": [4]}), tmp_path / "r", backend=opencl))
    scale = thresholds(4095)
    weakest = min(row["peaks"])
    assert row["margin_dn"] == pytest.approx(scale[weakest] - row["flawless_dn"], abs=1e-3)
    assert row["flawless_dn"] > 255
