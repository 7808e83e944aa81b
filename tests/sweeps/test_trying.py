"""Rows of a sweep are what simulate gives."""

from __future__ import annotations

import gc
import subprocess
import sys
from itertools import combinations, product

import numpy as np
import pyarrow as pa
import pytest
from scenes import PIXEL_BYTES
from scipy.stats import binomtest
from sweeping import GRID, STATION, rows

import gpuspec
from gpuspec.detection.score import precision
from gpuspec.errors import StationError
from gpuspec.light.levels import levels_of
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.simulation.at_threshold import AtThreshold
from gpuspec.simulation.simulate import trace
from gpuspec.station.station import Station
from gpuspec.sweeps.choosing.measured import Measured
from gpuspec.sweeps.estimate import estimate
from gpuspec.sweeps.plan import SEED_STEP, Plan, with_part
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.bench import Bench
from gpuspec.sweeps.trying.columns import column
from gpuspec.sweeps.trying.parts import Parts


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        (np.arange(9), pa.int32()),
        (np.array([0.5, np.nan]), pa.float64()),
        (np.arange(11) % 3 == 0, pa.bool_()),
        (["µm", None, ""], pa.string()),
        (["b", "a", "b"], pa.dictionary(pa.int32(), pa.string())),
    ],
)
def test_a_column_of_buffers_is_arrows_own(values, kind):
    made = column(values, kind)
    made.validate(full=True)
    assert made.type == kind
    assert str(made.to_pylist()) == str(pa.array(values, kind).to_pylist())


def test_a_sweep_of_plain_defects_imports_nothing_slow(tmp_path):
    """Modules that take a tenth of a second each, and that no such sweep has a use for."""
    slow = ["pandas", "pyarrow.dataset", "scipy", "skimage", "matplotlib"]
    code = f"""
import sys, gpuspec
station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
gpuspec.sweep(station, {{"sensor.exposure": [2, 4]}}, sys.argv[1])
print([name for name in {slow} if name in sys.modules])
"""
    command = [sys.executable, "-c", code, str(tmp_path / "run")]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "[]\n"


def test_a_row_is_what_simulate_gives(refined, opencl, tmp_path):
    """P1, P2 and hits of the row, at its threshold, are those of the station it stands for."""
    plan = Plan.of(refined, {**GRID, "tunnel.height_mm": "150,250"}, parts=2)
    run = sweep(plan, tmp_path / "run", backend=opencl)
    found = rows(run)
    assert [row["design"] for row in found] == list(range(plan.designs))
    for row in found[:: plan.designs // 9]:
        assert {a.key: row[a.key] for a in plan.axes} == plan.values(row["design"])
        scores = []
        for part in range(2):
            design = with_part(plan.station_of(row["design"]), part)
            design = design.replace(**{"segmentation.threshold": row["threshold_dn"]})
            result = gpuspec.simulate(design, opencl).score
            scores.append(result)
            assert row["part_p1"][part] == result.p1
            assert row["part_p2"][part] == result.p2
            assert row["part_hits"][part] == result.defects_hit
        hit, false = (sum(getattr(s, name) for s in scores) for name in ("hit_px", "false_px"))
        assert row["best_p1"] == pytest.approx(hit / (hit + false) if false else 1, abs=1e-15)
        assert row["best_p2"] == pytest.approx(hit / row["zone_px"], abs=1e-15)
        assert row["best_hits"] == sum(s.defects_hit for s in scores)
        assert row["seeds"] == [0, SEED_STEP]
        level = round(row["threshold_dn"])
        assert (row["p1"][level], row["p2"][level]) == (row["best_p1"], row["best_p2"])
        assert (row["exact"], row["p1_low"], row["backend"]) == (True, None, "opencl")


def test_geometry_is_traced_once_for_each_part(station, opencl):
    plan = Plan.of(station, {**GRID, "tunnel.height_mm": "150,250"}, parts=3)
    bench = Bench(plan, opencl)
    bench.rows(range(plan.designs), sampled=True)
    assert bench.parts.traced == 6
    bench.rows(range(plan.designs - 5, plan.designs), sampled=True)
    assert bench.parts.traced == 6


@pytest.mark.parametrize("surface", ["orientation", "height"])
def test_what_is_kept_of_a_part_is_what_a_bench_of_its_own_finds(refined, opencl, surface):
    """Zones and lists that a crown or a camera leaves where they are, and those that they move."""
    varied = {"part.crown_radius_x_mm": "350,900", "camera.height_mm": "600,800"}
    station = refined.replace(part__surface=surface)
    plan = Plan.of(station, varied, samples=300, parts=2)
    together = Bench(plan, opencl).rows(range(plan.designs), sampled=True).to_pylist()
    assert len({str(row["p2"]) for row in together}) == plan.designs
    for design, row in enumerate(together):
        (alone,) = Bench(plan, opencl).rows([design], sampled=True).to_pylist()
        assert row == alone or str(row) == str(alone)  # NaN is as said


def test_every_part_has_noise_of_its_own(opencl):
    """That of the station it stands for, and no other part's: the same dent, another noise."""
    noisy = Station.from_dict({**STATION, "populations": []}).replace(
        **{"sensor.noise": True, "sensor.read_noise_e": 60.0, "sequence.images": 4}
    )
    designs = [noisy, noisy.replace(**{"sensor.exposure": 2.0})]
    found, traced = Parts(opencl, 3, 0).levels(designs, sampled=False)
    for number, (levels, part) in enumerate(zip(found, traced, strict=True)):
        for n, design in enumerate(designs):
            station = with_part(design, number)
            wanted = levels_of(opencl.trace(station).aspect(), part.zones, 255)
            assert np.array_equal(levels.inside[n, 1:], wanted.inside[0, 1:])
            assert np.array_equal(levels.outside[n, 1:], wanted.outside[0, 1:])
    for one, other in combinations(found, 2):
        assert (one.outside != other.outside).any(axis=1).all()


@pytest.mark.parametrize(
    "change",
    [{}, {"sequence.fusion": "std"}, {"camera.subsampling": 2}, {"camera.subsampling": "auto"},
     {"sequence.step_mm": 0.31}, {"sensor.noise": True},
     {"part.orange_peel": {"wavelength_mm": 2.0, "slope_rad": 0.004}}],
    ids=str,
)  # fmt: skip
def test_parts_of_a_population_are_counted_whatever_the_design(station, backend, change):
    """Each part is the one of its seed, with and without a closed form."""
    design = station.replace(**change)
    found, traced = Parts(backend, 2, 0).levels([design], sampled=False)
    for number, (levels, part) in enumerate(zip(found, traced, strict=True)):
        wanted = levels_of(backend.trace(with_part(design, number)).counted(), part.zones, 255)
        assert np.array_equal(levels.outside[:, 1:], wanted.outside[:, 1:])
        assert np.array_equal(levels.peaks, wanted.peaks)


@pytest.mark.parametrize(("rays", "again"), [(1, 0), (3, 3)])
def test_light_maps_are_kept_as_long_as_they_fit_sub_rays_counted(station, opencl, rays, again):
    """A pixel of nine sub-rays takes nine times the memory: what held three parts holds one."""
    rows, columns = station.shape
    engine = OpenCLBackend(memory_bytes=int(3.5 * PIXEL_BYTES * rows * columns))
    parts = Parts(engine, 3, 0)
    design = station.replace(**{"camera.subsampling": rays})
    parts.levels([design], sampled=False)
    assert parts.traced == 3
    parts.levels([design], sampled=False)
    assert parts.traced == 3 + again


@pytest.mark.parametrize("sampled", [False, True])
def test_what_a_device_holds_of_many_parts_is_bounded(refined, sampled):
    """Lists of sub-rays and their tables counted, and nothing left for Python to find."""
    memory, held = 4 << 20, []
    gc.disable()
    try:
        for parts in (1, 12):
            engine = OpenCLBackend(memory_bytes=memory)
            plan = Plan.of(refined, {"sensor.exposure": [2.0, 4.0]}, parts=parts, samples=2000)
            bench = Bench(plan, engine)
            bench.rows([0, 1], sampled=sampled)
            held.append(engine.held_bytes)
    finally:
        gc.enable()
    one, many = held
    assert memory - one < many <= memory + one


def test_what_is_drawn_of_an_uneven_part_needs_sub_rays_and_is_counted_whole(refined, opencl):
    uneven = refined.replace(part__orange_peel={"wavelength_mm": 0.6, "slope_rad": 0.002})
    vary = {"sensor.exposure": [2.0, 4.0]}
    plan = Plan.of(uneven, vary, samples=2000)
    assert Bench(plan, opencl).rows([0, 1], sampled=True)["exact"].to_pylist() == [True, True]
    plain = Plan.of(uneven.replace(camera__subsampling=1), vary, samples=2000)
    assert Bench(plain, opencl).rows([0, 1], sampled=True)["exact"].to_pylist() == [False, False]


@pytest.mark.parametrize("sampled", [False, True])
def test_every_part_has_orange_peel_of_its_own_counted_whole_or_screened(station, opencl, sampled):
    """Nothing else is random: what differs from part to part is the peel, and it is the part's."""
    peel = {"wavelength_mm": 2.0, "slope_rad": 0.004}
    design = station.replace(populations=(), part__orange_peel=peel)
    found, traced = Parts(opencl, 3, 300).levels([design], sampled=sampled)
    for number, (levels, part) in enumerate(zip(found, traced, strict=True)):
        own = design.replace(part__orange_peel={"seed": number * SEED_STEP % 2**32})
        whole, _ = Parts(opencl, 1, 0).levels([own], sampled=False)
        assert np.array_equal(levels.peaks, whole[0].peaks)
        assert (part.sample is not None) == sampled
    assert len({levels.peaks.tobytes() for levels in found}) == 3


def test_the_plan_tells_the_memory_of_every_sub_ray(station):
    rows, columns = station.shape
    for rays in (1, 3):
        plan = Plan.of(station.replace(**{"camera.subsampling": rays}), GRID, parts=2)
        assert estimate(plan, None, 1).device_bytes == PIXEL_BYTES * rows * columns * rays**2 * 2


def test_light_maps_beyond_the_memory_are_traced_again_with_the_same_rows(station, opencl):
    plan = Plan.of(station, {"sensor.exposure": "1:8:8"}, parts=3)
    small = OpenCLBackend(memory_bytes=400_000)
    assert (
        Bench(plan, small)
        .rows(range(8), sampled=False)
        .equals(Bench(plan, opencl).rows(range(8), sampled=False))
    )


def test_invalid_designs_have_a_reason_and_the_others_a_score(station, opencl, tmp_path):
    plan = Plan.of(station, {"sensor.exposure": "-2:3:6", "tunnel.height_mm": "200,900"})
    run = sweep(plan, tmp_path / "run", backend=opencl)
    for row in rows(run):
        exposure, height = row["sensor.exposure"], row["tunnel.height_mm"]
        valid = exposure > 0 and height < 800
        assert (row["reason"] is None) == valid
        assert (row["best_p1"] is not None) == valid
        if height == 900 and exposure > 0:
            assert "camera.height_mm = 800 must be above the tunnel" in row["reason"]
    assert run.invalid()[0] == 9


def test_no_valid_design_at_all_is_said(station, opencl, tmp_path):
    plan = Plan.of(station, {"sensor.exposure": "-3,-2"})
    with pytest.raises(StationError, match="no design of the sweep is a valid station"):
        sweep(plan, tmp_path / "run", backend=opencl)


def test_a_part_that_does_not_fit_is_a_reason(station, opencl, tmp_path):
    plan = Plan.of(station, {"populations[1].count": "3,100000"})
    good, bad = rows(sweep(plan, tmp_path / "run", backend=opencl))
    assert good["reason"] is None
    assert "populations[1]" in bad["reason"]


def test_seeds_draw_the_noise_anew_on_parts_that_are_traced_once(station, opencl, tmp_path):
    """Each draw is the inspection of a station with that seed, and the row holds all of them."""
    noisy = station.replace(**{"sensor.noise": True, "sensor.read_noise_e": 200.0})
    noisy = noisy.replace(sequence__images=6)  # drawn image by image, as an inspection is
    plan = Plan.of(noisy, {"sensor.exposure": [2, 3]}, parts=2, seeds=3)
    bench = Bench(plan, opencl)
    found = bench.rows(range(2), sampled=False).to_pylist()
    assert bench.parts.traced == 2
    for row in found:
        assert (row["draws"], len(row["part_p1"])) == (3, 6)
        assert len(set(row["part_p1"][:3])) > 1 < len(set(row["part_p1"][3:]))
        at = {"segmentation.threshold": row["threshold_dn"]}
        tries = product(range(2), range(3))
        for number, (part, draw) in enumerate(tries):
            own = with_part(plan.station_of(row["design"]), part, draw).replace(**at)
            seen = AtThreshold.of(trace(own, opencl), own)
            assert row["part_hits"][number] == seen.hits
            assert row["part_p1"][number] == precision(seen.hit_px, seen.false_zone_px)
        level = round(row["threshold_dn"])
        assert row["worst_hits"][level] == min(row["part_hits"])
        assert row["worst_p2"][level] == min(row["part_p2"])


def test_many_draws_have_the_mean_and_the_spread_of_the_closed_form(opencl, tmp_path):
    """Of 60: the mean is within three of its own deviations and a count, the spread as told."""
    noisy = Station.from_dict(STATION).replace(
        **{"sensor.noise": True, "sensor.read_noise_e": 100.0, "sequence.images": 20}
    )
    seeds = 60
    (row,) = Bench(Plan.of(noisy, {"sensor.exposure": [2]}, seeds=seeds), opencl).rows(
        range(1), sampled=False
    ).to_pylist()  # fmt: skip
    at = noisy.replace(**{"sensor.exposure": 2.0, "segmentation.threshold": row["threshold_dn"]})
    expected = AtThreshold.of(trace(at, opencl), at).expected
    assert expected is not None and expected.p1_deviation > 0
    for drawn, mean, deviation in (
        (row["part_p1"], expected.p1, expected.p1_deviation),
        (row["part_p2"], expected.p2, expected.p2_deviation),
    ):
        assert abs(np.mean(drawn) - mean) < 3 * deviation / np.sqrt(seeds) + 0.003
        assert 0.7 * deviation < np.std(drawn, ddof=1) < 1.4 * deviation


def test_a_screened_part_is_bounded_draw_by_draw(station, opencl):
    """No draw of the noise looks at another pixel: bounds are as wide for many as for one."""
    noisy = station.replace(
        **{"sensor.noise": True, "sensor.read_noise_e": 100.0, "sequence.images": 20}
    )
    widths = []
    for seeds in (1, 16):
        plan = Plan.of(noisy, {"sensor.exposure": [2]}, samples=300, seeds=seeds)
        (row,) = Bench(plan, opencl).rows(range(1), sampled=True).to_pylist()
        widths.append(np.subtract(row["p1_high"], row["p1_low"]))
    unsure = widths[0] > 0.02  # elsewhere all is known, whatever is drawn
    assert unsure.sum() >= 5
    assert (widths[1] >= widths[0])[unsure].all()


def test_the_worst_part_is_one_of_which_something_is_seen(opencl):
    """Of parts whose defects are all beside the image nothing is told."""
    small = Station.from_dict({**STATION, "defects": [], "populations": [
        {"kind": "dent", "count": 1, "seed": 1, "diameter_mm": 0.8, "depth_um": 6.0}]})  # fmt: skip
    small = small.replace(camera__columns=70)
    plan = Plan.of(small, {"sensor.exposure": [4]}, parts=8)
    (row,) = Bench(plan, opencl).rows(range(1), sampled=False).to_pylist()
    assert 0 < row["defects"] < 8
    assert row["worst_hits"][0] == 1
    assert row["worst_p2"][0] == 1


@pytest.mark.parametrize("least", [None, 40, 47, 48, 60])
def test_the_faintest_defect_that_must_be_hit_bounds_the_room(station, opencl, least):
    """Of each design by itself, its peaks sorted by hand."""
    bench = Bench(Plan.of(station, {"sensor.exposure": [1.5, 2, 4]}, parts=8), opencl)
    table = bench.rows(range(3), sampled=False)
    found = Measured.of(table, ["hits"], least)
    for row, weakest in zip(table.to_pylist(), found.weakest, strict=True):
        falling = sorted(row["peaks"], reverse=True)
        assert weakest == falling[min(least or len(falling), len(falling)) - 1]


def test_draws_of_one_defect_are_no_trials_of_another(opencl):
    """As sure of 36 hits under one draw of the noise as under 20 of them."""
    noisy = Station.from_dict(STATION).replace(
        **{"sensor.noise": True, "sensor.read_noise_e": 20.0, "sequence.images": 20}
    )
    for seeds in (1, 20):
        plan = Plan.of(noisy, {"sensor.exposure": [2]}, parts=4, seeds=seeds)
        table = Bench(plan, opencl).rows(range(1), sampled=False)
        (row,) = table.to_pylist()
        level = min(row["peaks"]) - 1
        assert row["hits"][level] == row["defects"] == 24 * seeds
        sure = Measured.of(table, ["sure_hit_share"]).values["sure_hit_share"][0, level]
        known = binomtest(24, 24, alternative="greater").proportion_ci(0.95, "exact")
        assert sure == pytest.approx(known.low, rel=1e-9)
