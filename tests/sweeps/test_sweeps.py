"""Sweeps: what a plan is, that its table is exact, whole and the same however it came about."""

from __future__ import annotations

import hashlib
import json
import resource
import signal
import subprocess
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tolerances
from commandline import DEADLINE_S, PROGRAM, Command, content, program, said
from scipy.stats import binom
from tolerances import RISK

import gpuspec
from gpuspec.errors import OutputError, StationError
from gpuspec.light.levels import Levels, Sample, Zones, levels_of
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.station.station import Station
from gpuspec.sweeps import sweep as running
from gpuspec.sweeps.axes import axis
from gpuspec.sweeps.choosing.front import Front, curves
from gpuspec.sweeps.crew import Alone
from gpuspec.sweeps.estimate import estimate
from gpuspec.sweeps.keeping.checksums import Checksums
from gpuspec.sweeps.keeping.folder import RunFolder, differences, table_bytes
from gpuspec.sweeps.notes import of_plan, of_table
from gpuspec.sweeps.plan import SEED_STEP, Plan, with_part
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying import bench as bench_module
from gpuspec.sweeps.trying.bench import Bench
from gpuspec.sweeps.trying.parts import Parts, TracedPart

STATION: dict[str, Any] = {
    "part": {"length_mm": 14.0, "width_mm": 9.0},
    "tunnel": {"height_mm": 200.0, "luminous_mm": 2.0, "dark_mm": 6.0},
    "camera": {"sampling_mm": 0.1},
    "defects": [
        {"kind": "dent", "x_mm": 2.0, "y_mm": 1.0, "diameter_mm": 0.8, "depth_um": 5.0},
    ],
    "populations": [
        {"kind": "dent", "count": 3, "seed": 1, "diameter_mm": [0.4, 0.9], "depth_um": [2.0, 8.0]},
        {"kind": "scratch", "count": 2, "seed": 2, "width_mm": 0.3, "length_mm": [1, 3],
         "depth_um": 4.0},
    ],
}  # fmt: skip
GRID = {"tunnel.luminous_mm": "0.5:6:12", "sensor.exposure": "1:8:8", "sequence.images": "8:64:8"}


@pytest.fixture
def station() -> Station:
    return Station.from_dict(STATION, "part.toml")


def rows(run: RunFolder) -> list[dict[str, Any]]:
    return run.table().to_pylist()


# ------------------------------------------------------------------------------------------- axes


@pytest.mark.parametrize(
    ("key", "given", "values"),
    [
        ("tunnel.luminous_mm", "1:2:5", (1.0, 1.25, 1.5, 1.75, 2.0)),
        ("tunnel.luminous_mm", "0.1:0.9:9", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)),
        ("tunnel.luminous_mm", "4,1,2.5", (4.0, 1.0, 2.5)),
        ("tunnel.luminous_mm", [3, 5], (3.0, 5.0)),
        ("tunnel.luminous_mm", 3.0, (3.0,)),
        ("sequence.images", "8:40:5", (8, 16, 24, 32, 40)),
        ("sensor.bit_depth", "8,12", (8, 12)),
        ("sequence.step_mm", "0.5", (0.5,)),
        ("defects[1].depth_um", "1:3:3", (1.0, 2.0, 3.0)),
        ("populations[2].width_mm", "0.2,0.4", (0.2, 0.4)),
        ("populations[1].count", "7,9", (7, 9)),
        ("part.crown_radius_x_mm", "500,1000", (500.0, 1000.0)),
    ],
)
def test_an_axis_takes_ranges_and_values_of_any_numeric_key(station, key, given, values):
    found = axis(station, key, given)
    assert found.values == values
    assert [type(v) for v in found.values] == [type(v) for v in values]


@pytest.mark.parametrize(
    ("key", "given", "words"),
    [
        ("tunnel.lumious_mm", "1:2:3", "lumious_mm is not a known key (did you mean luminous_mm?)"),
        ("tunel.luminous_mm", "1:2:3", "tunel is not a known key (did you mean tunnel?)"),
        ("part.surface", "1:2:3", "part.surface is not a number"),
        ("sensor.noise", "0,1", "sensor.noise is not a number"),
        ("tunnel", "1,2", "tunnel is not a number"),
        ("defects[2].depth_um", "1,2", "there is no defects[2].depth_um to vary"),
        ("defects[1].points_mm", "1,2", "points_mm is not a known key"),
        ("segmentation.threshold", "1:9:3", "all 256 thresholds"),
        ("defects[0].depth_um", "1,2", "there is no defects[0].depth_um to vary"),
        ("tunnel__dark_mm", "1,2", "is not a known key (did you mean tunnel.dark_mm?)"),
        ("tunnel.dark_mm", "3:1:4", "is reversed; write 1:3:4"),
        ("tunnel.dark_mm", "1:3:0", "is empty"),
        ("tunnel.dark_mm", "1:3", "is not a range; write FROM:TO:COUNT"),
        ("tunnel.dark_mm", "1:3:2.5", "is not a range"),
        ("tunnel.dark_mm", "1:nan:3", "is not a range"),
        ("tunnel.dark_mm", "1:3:99999999999", "nothing could hold a sweep of them"),
        ("tunnel.dark_mm", "1:3:1", "asks for 1 value from 1 to 3"),
        ("tunnel.dark_mm", "3:3:4", "asks for 4 values from 3 to 3"),
        ("tunnel.dark_mm", [], "the list of values is empty"),
        ("tunnel.dark_mm", "1,x", "is not a list of numbers"),
        ("tunnel.dark_mm", [1, True], "is not a list of numbers"),
        ("tunnel.dark_mm", "inf", "only finite numbers"),
        ("tunnel.dark_mm", "2,1,2", "stands twice"),
        ("sequence.images", "8:80:7.5", "is not a range"),
        ("sequence.images", "8:81:10", "takes whole numbers"),
    ],
)
def test_a_wrong_axis_is_one_sentence(station, key, given, words):
    with pytest.raises(StationError) as error:
        axis(station, key, given)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


# ------------------------------------------------------------------------------------------- plan


def test_designs_of_one_light_map_are_neighbours(station):
    plan = Plan.of(station, {"sensor.exposure": "1,2", "tunnel.height_mm": "100,200,300"})
    assert [a.key for a in plan.axes] == ["tunnel.height_mm", "sensor.exposure"]
    assert (plan.designs, plan.geometries) == (6, 3)
    assert [plan.geometry_of(i) for i in range(6)] == [0, 0, 1, 1, 2, 2]
    assert plan.values(3) == {"tunnel.height_mm": 200.0, "sensor.exposure": 2.0}


def test_a_design_made_from_its_neighbour_is_the_one_made_from_scratch(station):
    plan = Plan.of(station, {**GRID, "tunnel.dark_mm": "1:9:3", "sensor.bit_depth": "8,10"})
    base = plan.station_of(0)
    for design in range(0, plan.designs, 97):
        assert plan.station_of(design, base) == plan.station_of(design)
        assert plan.station_of(design, base).shape == base.shape


def test_an_invalid_design_says_why_either_way(station):
    plan = Plan.of(station, {"sensor.exposure": "-1,4"})
    base = plan.station_of(1)
    for given in (None, base):
        with pytest.raises(StationError, match=r"sensor\.exposure = -1.* must be greater than 0"):
            plan.station_of(0, given)


def test_parts_differ_in_every_seed_and_the_first_is_the_stations_own(station):
    assert with_part(station, 0) is station
    other = with_part(station, 2)
    assert other.sensor.seed == 2 * SEED_STEP % 2**32
    assert [p.seed for p in other.populations] == [
        (1 + 2 * SEED_STEP) % 2**32, (2 + 2 * SEED_STEP) % 2**32
    ]  # fmt: skip
    assert other.defects == station.defects


def test_no_part_has_a_seed_of_another_s(station):
    """Populations with seeds 1 and 2, and noise: none is that of another part one further."""
    seeds = [p.seed for k in range(60) for p in with_part(station, k).populations]
    noise = [with_part(station, k).sensor.seed for k in range(60)]
    assert len(set(seeds)) == 2 * 60
    assert len(set(noise)) == 60


def test_noise_alone_makes_parts_different(station):
    noisy = station.replace(populations=(), sensor__noise=True)
    assert Plan.of(noisy, GRID, parts=3).parts == 3


@pytest.mark.parametrize("own", [{"threshold": 80.0}, {"min_area_mm2": 0.1}], ids=str)
def test_a_plan_leaves_out_the_station_s_own_threshold_and_size_filter(station, own):
    plan = Plan.of(station.replace(segmentation=own), GRID)
    assert plan.station.segmentation == station.segmentation


@pytest.mark.parametrize(
    ("change", "given", "words"),
    [
        ({}, {}, "nothing to vary"),
        ({"defects": (), "populations": ()}, {"vary": GRID}, "no defects, so there is nothing"),
        ({"populations": ()}, {"vary": GRID, "parts": 2}, "would be 2 times the same"),
        ({}, {"vary": GRID, "parts": 0}, "1 to 1000 parts"),
        ({}, {"vary": {"defects[1].x_mm": "1", "defects[01].x_mm": "2"}}, "is varied twice"),
        ({}, {"vary": {"tunnel.luminous_mm": "1:2:1000000", "tunnel.dark_mm": "1:2:1000000",
                       "sensor.exposure": "1:2:1000"}}, "more than could ever be done or stored"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_one_sentence(station, change, given, words):
    with pytest.raises(StationError, match=words):
        Plan.of(station.replace(**change), **given)


def test_a_plan_is_its_identity(station, tmp_path):
    plan = Plan.of(station, {**GRID, "tunnel.height_mm": "100,200"}, parts=3, samples=100)
    again = Plan.from_identity(json.loads(json.dumps(plan.identity())))
    assert again.identity() == plan.identity()
    for i in (0, 7):
        assert again.station_of(i).as_dict() == plan.station_of(i).as_dict()
    assert differences(plan.identity(), again.identity()) == []


def test_the_station_file_says_what_is_swept_and_simulate_leaves_it_alone(station):
    text = f"""
    {gpuspec.station.toml.to_toml(station)}
    [sweep]
    parts = 2
    [sweep.vary]
    "tunnel.luminous_mm" = "1:3:3"
    "sequence.images" = [8, 16]
    """
    read = Station.parse(text)
    plan = Plan.of(read)
    assert (plan.parts, plan.designs) == (2, 6)
    assert plan.station.as_dict() == station.as_dict()
    assert Station.parse(gpuspec.station.toml.to_toml(read)) == read


# ------------------------------------------------------------------------------------------- rows


def test_a_row_is_what_simulate_gives(station, opencl, tmp_path):
    """P1, P2 and hits of the row, at its threshold, are those of the station it stands for."""
    plan = Plan.of(station, {**GRID, "tunnel.height_mm": "150,250"}, parts=2)
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
    [{}, {"sequence.fusion": "std"}, {"camera.subsampling": 2}, {"sequence.step_mm": 0.31},
     {"sensor.noise": True}],
    ids=str,
)  # fmt: skip
def test_parts_of_a_population_are_counted_whatever_the_design(station, backend, change):
    """Each part is the one of its seed, with and without a closed form."""
    design = station.replace(**change)
    found, traced = Parts(backend, 2, 0).levels([design], sampled=False)
    for number, (levels, part) in enumerate(zip(found, traced, strict=True)):
        wanted = levels_of(backend.trace(with_part(design, number)).aspect(), part.zones, 255)
        assert np.array_equal(levels.outside[:, 1:], wanted.outside[:, 1:])
        assert np.array_equal(levels.peaks, wanted.peaks)


@pytest.mark.parametrize(("rays", "again"), [(1, 0), (3, 3)])
def test_light_maps_are_kept_as_long_as_they_fit_sub_rays_counted(station, opencl, rays, again):
    """A pixel of nine sub-rays takes nine times the memory: what held three parts holds one."""
    rows, columns = station.shape
    engine = OpenCLBackend(memory_bytes=int(3.5 * 13 * rows * columns))
    parts = Parts(engine, 3, 0)
    design = station.replace(**{"camera.subsampling": rays})
    parts.levels([design], sampled=False)
    assert parts.traced == 3
    parts.levels([design], sampled=False)
    assert parts.traced == 3 + again


def test_the_plan_tells_the_memory_of_every_sub_ray(station):
    rows, columns = station.shape
    for rays in (1, 3):
        plan = Plan.of(station.replace(**{"camera.subsampling": rays}), GRID, parts=2)
        assert estimate(plan, None, 1).device_bytes == 13 * rows * columns * rays**2 * 2


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


# -------------------------------------------------------------------------------------- screening


@pytest.mark.slow
@pytest.mark.parametrize("parts", [1, 2])
def test_screening_ends_in_the_front_of_the_exhaustive_sweep(station, opencl, tmp_path, parts):
    """Few strata, so that bounds are wide and many designs must be made exact."""
    fronts, made = [], []
    for samples in (0, 300):
        plan = Plan.of(station, GRID, parts=parts, samples=samples)
        run = sweep(plan, tmp_path / f"run{samples}", backend=opencl)
        front = Front()
        for table in run.batches():
            front.add(table)
        fronts.append(front.points())
        made.append(rows(run))
    exhaustive, screened = fronts
    assert screened.exact.all()
    for name in ("design", "level", "p1", "p2", "hits"):
        assert np.array_equal(getattr(screened, name), getattr(exhaustive, name)), name
    assert len(exhaustive.design) > 50
    assert 0 < sum(row["exact"] for row in made[1]) < 0.6 * len(made[1])
    for true, row in zip(*made, strict=True):
        assert row["p2"] == true["p2"]
        assert row["hits"] == true["hits"]
        if row["exact"]:
            assert row == true
        else:
            assert all(np.array(row["p1_low"]) <= true["p1"])
            assert all(np.array(row["p1_high"]) >= true["p1"])


STRATA, WEIGHT, TRIED, ZONE = 400, 50, 16, 10
"""Of a made-up screening: strata, pixels of each, designs, and pixels of its one zone."""


class MadeUp:
    """Parts of which the levels are drawn, in place of those of a traced part.

    In every stratum the levels 1 to 255 are equally frequent: strata as unlike each other as can
    be would be easier. What a threshold truly detects is then known without drawing.
    """

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        none, one = np.zeros(0, np.uint32), np.ones(1, np.float32)
        sample = Sample(none, np.zeros(STRATA, np.uint32), WEIGHT, one, one)
        valid = np.ones((1, 1), np.bool_)
        zones = Zones(np.arange(ZONE, dtype=np.uint32), np.array([0, ZONE]), valid)
        self.part = TracedPart(None, zones, sample)
        self.drawn: list[np.ndarray] = []

    def levels(self, stations: Any, *, sampled: bool) -> tuple[list[Levels], list[TracedPart]]:
        found = Levels.empty(len(stations), 1)
        for counts in found.sampled:
            counts[:] = np.bincount(self.random.integers(1, 256, STRATA), minlength=256)
        found.inside[:, 255], found.peaks[:], found.ceiling[:] = ZONE, 255, 255
        self.drawn.append(found.sampled)
        return [found], [self.part]


def made_up(opencl, seed: int = 0) -> Bench:
    plan = Plan.of(
        Station.from_dict({**STATION, "populations": []}),
        {"sensor.exposure": f"1:8:{TRIED}"},
        samples=STRATA,
    )
    bench = Bench(plan, opencl)
    bench.parts = MadeUp(seed)
    return bench


def sweeps_with_a_wrong_bound(bench: Bench, count: int) -> int:
    """Of many sweeps, those in which any bound of any design at any threshold is wrong."""
    outside = STRATA * WEIGHT * (255 - np.arange(255)) / 255
    true = ZONE / (ZONE + outside)
    wrong = 0
    for _ in range(count):
        table = bench.rows(range(TRIED), sampled=True)
        low, high = (curves(table, name)[:, :255] for name in ("p1_low", "p1_high"))
        wrong += bool(((true < low) | (true > high)).any())
    return wrong


def test_in_99_of_100_screened_sweeps_every_bound_holds(opencl):
    """All bounds of all designs at all thresholds together, as it is promised."""
    assert sweeps_with_a_wrong_bound(made_up(opencl), 300) <= tolerances.WRONG_SWEEPS * 300


@pytest.mark.parametrize("confidence", [0.5, 1 - 0.01 * 2 * 256], ids=["50 %", "not shared"])
def test_a_promise_that_is_not_kept_would_be_seen(opencl, monkeypatch, confidence):
    """The test above can fail: with a confidence of 50 %, and with a risk that is not shared."""
    monkeypatch.setattr(bench_module, "CONFIDENCE", confidence)
    assert sweeps_with_a_wrong_bound(made_up(opencl), 100) > 3 * tolerances.WRONG_SWEEPS * 100


def test_each_bound_of_a_sweep_has_its_share_of_a_risk_of_1_percent(opencl):
    """The bounds as Clopper and Pearson define them, by the distribution and not its inverse."""
    bench = made_up(opencl)
    table = bench.rows(range(TRIED), sampled=True)
    low, high = (curves(table, name) for name in ("p1_low", "p1_high"))
    share = 0.01 / (2 * 256 * TRIED)
    (sampled,) = bench.parts.drawn
    looked_at = 0
    for design in range(TRIED):
        for level in range(1, 250, 31):
            drawn = sampled[design, level + 1 :].sum()
            whole = STRATA * WEIGHT
            most, least = (ZONE / p1[design, level] - ZONE for p1 in (low, high))
            # Else the drawn pixels themselves are the bound.
            if least > drawn and most < whole - (STRATA - drawn):
                assert binom.sf(drawn - 1, STRATA, least / whole) == pytest.approx(share, rel=RISK)
                assert binom.cdf(drawn, STRATA, most / whole) == pytest.approx(share, rel=RISK)
                looked_at += 1
    assert looked_at > 5 * TRIED


def test_the_sample_of_every_part_is_drawn_anew(opencl):
    """Parts that differ in their noise alone: the same strata, other pixels of them."""
    noisy = Station.from_dict({**STATION, "populations": []}).replace(**{"sensor.noise": True})
    _, parts = Parts(opencl, 3, 300).levels([noisy], sampled=True)
    for one, other in combinations([part.sample for part in parts], 2):
        assert np.array_equal(one.near, other.near)
        assert (one.chosen != other.chosen).mean() > 0.8  # one of 40 pixels each


def test_designs_without_a_closed_form_are_exact_under_screening(station, opencl, tmp_path):
    plan = Plan.of(
        station.replace(**{"sensor.noise": True}), {"sensor.exposure": "2,4"}, samples=99
    )
    assert all(row["exact"] for row in rows(sweep(plan, tmp_path / "run", backend=opencl)))


# ------------------------------------------------------------------------------------------ store


class Stopped(BaseException):
    """Whatever ends a sweep in the middle."""


def stopping_after(count: int) -> Any:
    left = [count]

    def tell(*_: object) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise Stopped

    return tell


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of 64 rows, so that a small sweep has many."""
    monkeypatch.setattr(RunFolder, "rows_per_file", 64)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 300])
def test_a_sweep_stopped_anywhere_ends_with_the_same_table(
    station, opencl, tmp_path, samples, small_parts
):
    plan = Plan.of(station, GRID, samples=samples)
    undisturbed = sweep(plan, tmp_path / "whole", backend=opencl).table()
    steps = [1, 3, 11] + ([14, 17] if samples else [])
    for step in steps:
        for _ in range(3):
            try:
                sweep(plan, tmp_path / "cut", backend=opencl, progress=stopping_after(step))
            except Stopped:
                continue
        run = sweep(plan, tmp_path / "cut", backend=opencl)
        assert run.table().equals(undisturbed), step
        for path in (tmp_path / "cut" / "designs").iterdir():
            path.unlink()


def test_what_is_there_is_not_done_again(station, opencl, tmp_path, small_parts):
    plan = Plan.of(station, GRID)
    with pytest.raises(Stopped):
        sweep(plan, tmp_path / "run", backend=opencl, progress=stopping_after(5))
    there = content(tmp_path / "run" / "designs")
    assert len(there) == 5
    tried: list[int] = []

    class Watched(Alone):
        def done(self, tasks: Any) -> Any:
            for task, table in super().done(tasks):
                tried.extend(task.designs)
                yield task, table

    sweep(plan, tmp_path / "run", crew=Watched(Bench(plan, opencl)))
    assert tried == list(range(5 * 64, plan.designs))
    after = content(tmp_path / "run" / "designs")
    assert all(after[name] == data for name, data in there.items())


@pytest.mark.slow
def test_a_killed_process_leaves_whole_files_and_is_gone_on_with(tmp_path, opencl):
    """kill -9 while it writes, again and again."""
    (tmp_path / "s.toml").write_text(gpuspec.station.toml.to_toml(Station.from_dict(STATION)))
    command = ["sweep", "s.toml", "-o", "run", "--vary", "tunnel.luminous_mm=0.5:6:40",
               "--vary", "sensor.exposure=1:8:40", "--vary", "tunnel.dark_mm=1:20:10"]  # fmt: skip
    files = 0
    for wanted in (2, 6, 11):
        process = subprocess.Popen([*PROGRAM, *command], cwd=tmp_path, stdout=subprocess.PIPE)
        until = time.monotonic() + 60
        while files < wanted and time.monotonic() < until and process.poll() is None:
            time.sleep(0.005)
            files = len(list((tmp_path / "run").glob("designs/part-*.parquet")))
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=DEADLINE_S)
        assert process.returncode == -signal.SIGKILL
        for path in (tmp_path / "run").glob("designs/part-*.parquet"):
            assert len(pq.read_table(path)) == 512
    ran = program(*command, cwd=tmp_path)
    assert ran.code == 0
    assert "designs are there already" in ran.out
    plan = RunFolder.read(tmp_path / "run").plan
    assert not list((tmp_path / "run").rglob(".partial-*"))
    run = sweep(plan, tmp_path / "other", backend=opencl)
    assert run.table().equals(RunFolder.read(tmp_path / "run").table())


@pytest.mark.slow
def test_ctrl_c_says_that_the_same_command_goes_on(tmp_path):
    (tmp_path / "s.toml").write_text(gpuspec.station.toml.to_toml(Station.from_dict(STATION)))
    command = ["sweep", "s.toml", "-o", "run", "--vary", "tunnel.luminous_mm=0.5:6:100",
               "--vary", "sensor.exposure=1:8:400"]  # fmt: skip
    process = subprocess.Popen([*PROGRAM, *command], cwd=tmp_path, stderr=subprocess.PIPE,
                               stdout=subprocess.DEVNULL, text=True)  # fmt: skip
    until = time.monotonic() + 60
    while not list((tmp_path / "run").glob("designs/part-*.parquet")) and process.poll() is None:
        assert time.monotonic() < until, "nothing was written"
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "the same command goes on" in error
    assert "Traceback" not in error


def test_a_full_disk_leaves_what_was_finished(station, tmp_path, small_parts):
    """No file may be larger than this; NumPy, for PoCL writes larger ones of its own."""
    plan = Plan.of(station, {"tunnel.luminous_mm": "0.5:6:12", "sensor.exposure": "1:8:8"})
    whole = sweep(plan, tmp_path / "run", backend="numpy").table()
    run = RunFolder.read(tmp_path / "run")
    run.file(1).unlink()
    before = content(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, hard))
    try:
        with pytest.raises(OutputError, match="it goes on where it was") as error:
            sweep(plan, tmp_path / "run", backend="numpy")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert f"the sweep cannot be written to {tmp_path / 'run'}: " in str(error.value)
    assert content(tmp_path) == before
    assert sweep(plan, tmp_path / "run", backend="numpy").table().equals(whole)


def test_two_sweeps_are_never_mixed(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    sweep(plan, tmp_path / "run", backend=opencl)
    before = content(tmp_path)
    others = {
        "sensor.exposure is 1, 2, 3, 4, ... (8 values) there and 1, 8 here":
            Plan.of(station, {**GRID, "sensor.exposure": "1:8:2"}),
        "tunnel.dark_mm is not varied there and 3 here":
            Plan.of(station, {**GRID, "tunnel.dark_mm": "3"}),
        "parts is 1 there and 2 here": Plan.of(station, GRID, parts=2),
        "pixels of --screen is 0 there and 50 here": Plan.of(station, GRID, samples=50),
        "the station has sampling_mm = 0.1 there and sampling_mm = 0.2 here":
            Plan.of(station.replace(**{"camera.sampling_mm": 0.2}), GRID),
    }  # fmt: skip
    for words, other in others.items():
        with pytest.raises(OutputError) as error:
            sweep(other, tmp_path / "run", backend=opencl)
        assert words in str(error.value)
        assert "holds another sweep" in str(error.value)
    assert content(tmp_path) == before


def test_another_version_makes_another_sweep(station):
    here = Plan.of(station, GRID).identity()
    assert differences(here, here) == []
    assert differences({**here, "gpuspec": "0.0.1"}, here) == [
        f"gpuspec is 0.0.1 there and {gpuspec.__version__} here"
    ]


@pytest.mark.parametrize("samples", [0, 300])
def test_a_table_takes_no_more_disk_than_is_asked_for(station, opencl, tmp_path, samples):
    plan = Plan.of(station, GRID, samples=samples)
    run = sweep(plan, tmp_path / "run", backend=opencl)
    size = sum(path.stat().st_size for path in (run.path / "designs").iterdir())
    assert tolerances.TABLE_SHARE * table_bytes(plan) < size <= table_bytes(plan)
    # With bounds a row is twice as large.
    plain, screened = (replace(plan, samples=n) for n in (0, 300))
    assert table_bytes(screened) >= 2 * table_bytes(plain)


def test_what_a_killed_sweep_left_half_written_is_removed(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    (tmp_path / "run" / ".partial-one").mkdir()
    (tmp_path / "run" / ".partial-one" / "part").write_bytes(b"half")
    (tmp_path / "run" / "designs" / ".partial-two").write_bytes(b"half")
    assert sweep(plan, tmp_path / "run", backend=opencl).table().equals(whole)
    assert not list((tmp_path / "run").rglob(".partial-*"))


def test_what_is_left_of_a_sweep_is_estimated(station, opencl):
    """Two of five geometries, each traced for two parts; time for what is left, and its traces."""
    grid = {"tunnel.height_mm": "100:300:5", "sensor.exposure": "1:8:8"}
    plan = Plan.of(station, grid, parts=2)
    assert [estimate(plan, None, left).traces for left in (40, 16, 9, 8, 1, 0)] == [
        10,
        4,
        4,
        2,
        2,
        0,
    ]
    assert estimate(plan, None, 9).seconds is None
    bench = Bench(plan, opencl)
    some, more = (estimate(plan, bench, left) for left in (8, 4_000_000))
    assert 0 < some.seconds < more.seconds
    assert estimate(plan, bench, 0).seconds == 0


def test_the_time_of_tracing_is_part_of_the_estimate(station, opencl, monkeypatch):
    """A bench whose traces take a second and whose designs a hundredth."""
    plan = Plan.of(station, {"tunnel.height_mm": "100:300:5", "sensor.exposure": "1:8:8"})
    clock, traced = [0.0], set()

    class Slow(Bench):
        def rows(self, designs: Any, *, sampled: bool) -> Any:
            for design in designs:
                clock[0] += 0.01 + (plan.geometry_of(design) not in traced)
                traced.add(plan.geometry_of(design))

    monkeypatch.setattr("gpuspec.sweeps.estimate.time.perf_counter", lambda: clock[0])
    found = estimate(plan, Slow(plan, opencl), 40).seconds
    assert found == pytest.approx(40 * 0.01 + 5 * 1.0)


def test_a_table_without_its_identity_is_not_adopted(station, opencl, tmp_path):
    sweep(Plan.of(station, GRID), tmp_path / "run", backend=opencl)
    (tmp_path / "run" / "sweep.json").unlink()
    with pytest.raises(OutputError, match=r"holds other files \(part-.* and no sweep\.json"):
        sweep(Plan.of(station, GRID), tmp_path / "run", backend=opencl)


def test_a_named_file_that_changed_makes_another_sweep(station, tmp_path):
    (tmp_path / "zones.png").write_bytes(b"one")
    (tmp_path / "map.sur").write_bytes(b"map")
    patch = {
        "kind": "measured",
        "file": "map.sur",
        "zone_file": "zones.png",
        "x_mm": 0.0,
        "y_mm": 0.0,
    }
    measured = Station.from_dict({**STATION, "defects": [patch]}, "part.toml", tmp_path)
    plan = Plan.of(measured, GRID)
    before = plan.identity()
    assert differences(before, plan.identity()) == []
    (tmp_path / "zones.png").write_bytes(b"two")
    assert differences(before, plan.identity()) == ["zones.png holds something else than there"]


@pytest.mark.parametrize(
    "text",
    ["null", "[]", "{", '{"vary": 3}', *(
        json.dumps({"gpuspec": "0", "station": "", "files": {}, "vary": {"sensor.exposure": [1]},
                    "parts": 1, "samples": 0, **wrong})
        for wrong in ({"vary": [1]}, {"vary": {"sensor.exposure": 3}}, {"vary": {}},
                      {"vary": {"sensor.exposure": []}}, {"vary": {"foo.bar": [1, 2]}},
                      {"vary": {"sensor.exposure": ["x"]}}, {"parts": "x"}, {"parts": 0},
                      {"samples": -5}, {"station": 5}, {"station": "part = 3"})
    )],
)  # fmt: skip
def test_a_spoilt_identity_is_a_sentence(text, tmp_path):
    (tmp_path / "sweep.json").write_text(text)
    with pytest.raises(OutputError, match=r"sweep\.json"):
        RunFolder.read(tmp_path)


def spoilt(data: bytes, how: str) -> bytes:
    """A file with two bytes flipped somewhere, or cut off."""
    if how == "empty":
        return b""
    if how == "cut":
        return data[:-100]
    places = {
        "start": 0,
        "first page": 200,
        "middle": len(data) // 2,
        "last page": 9 * len(data) // 10,
        "footer": len(data) - 50,
        "end": len(data) - 2,
    }
    at = places[how]
    return data[:at] + bytes(255 - one for one in data[at : at + 2]) + data[at + 2 :]


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 300])
@pytest.mark.parametrize(
    "how", ["start", "first page", "middle", "last page", "footer", "end", "cut", "empty"]
)
def test_a_damaged_file_is_noticed_and_swept_again(
    station, opencl, tmp_path, small_parts, how, samples
):
    plan = Plan.of(station, GRID, samples=samples)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    run = RunFolder.read(tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("part-*")}
    run.file(3).write_bytes(spoilt(run.file(3).read_bytes(), how))
    for read in (run.table, lambda: list(run.batches(["reason"])), lambda: run.read_file(3)):
        with pytest.raises(OutputError, match=r"part-00000003\.parquet is damaged.*same `gpuspec"):
            read()
    assert run.damaged() == [3]
    tried: list[int] = []

    class Watched(Alone):
        def done(self, tasks: Any) -> Any:
            for task, table in super().done(tasks):
                tried.extend(task.designs)
                yield task, table

    again = sweep(plan, tmp_path / "run", crew=Watched(Bench(plan, backend=opencl)))
    assert set(tried) == set(run.designs_of(3))
    assert again.table().equals(whole)
    assert {path: path.read_bytes() for path in before} == before


def test_checksums_are_those_that_sha256sum_reads(station, opencl, tmp_path, small_parts):
    sweep(Plan.of(station, GRID, samples=300), tmp_path / "run", backend=opencl)
    lines = (tmp_path / "run" / "sweep.sha256").read_text("ascii").splitlines()
    for line in lines:
        found, _, name = line.partition("  ")
        assert hashlib.sha256((tmp_path / "run" / name).read_bytes()).hexdigest() == found
    files = list((tmp_path / "run" / "designs").iterdir())
    assert len({line.partition("  ")[2] for line in lines}) == len(lines) == len(files)


def test_a_damaged_line_of_checksums_costs_its_designs_and_no_more(
    station, opencl, tmp_path, small_parts
):
    plan = Plan.of(station, GRID)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    sums = tmp_path / "run" / "sweep.sha256"
    sums.write_bytes(b"\xff" + sums.read_bytes()[1:-9])  # the first line, and half of the last
    assert RunFolder.read(tmp_path / "run").damaged() == [0, 11]
    assert sweep(plan, tmp_path / "run", backend=opencl).table().equals(whole)
    assert RunFolder.read(tmp_path / "run").damaged() == []


def test_half_a_line_of_checksums_spoils_no_other(tmp_path):
    """A process was killed while it added one."""
    (tmp_path / "sweep.sha256").write_bytes(b"ab  designs/a\ncd  desi")
    sums = Checksums(tmp_path)
    sums.add(tmp_path / "designs" / "b", "cd")
    assert Checksums(tmp_path).hold(tmp_path / "designs" / "a", "ab")
    assert Checksums(tmp_path).hold(tmp_path / "designs" / "b", "cd")
    assert not Checksums(tmp_path).hold(tmp_path / "designs" / "b", "ab")


def test_a_sweep_of_before_there_were_checksums_gets_them(station, opencl, tmp_path, small_parts):
    plan = Plan.of(station, GRID)
    whole = sweep(plan, tmp_path / "run", backend=opencl).table()
    run = RunFolder.read(tmp_path / "run")
    (tmp_path / "run" / "sweep.sha256").unlink()
    pq.write_table(run.read_file(0)[:5], run.file(0))
    run.file(1).write_bytes(b"PAR1 no more")
    run.file(2).unlink()
    with pytest.raises(OutputError, match="5 rows of 64"):
        RunFolder.read(tmp_path / "run").table()
    assert sweep(plan, tmp_path / "run", backend=opencl).table().equals(whole)
    assert len((tmp_path / "run" / "sweep.sha256").read_text("ascii").splitlines()) == run.files


@pytest.mark.parametrize("stop", range(1, 4))
def test_a_file_written_anew_is_known_whenever_the_writing_is_cut_short(
    station, opencl, tmp_path, monkeypatch, stop
):
    """Killed before the checksum, between it and the file, or after both."""
    plan = Plan.of(station, GRID)
    run = sweep(plan, tmp_path / "run", backend=opencl)
    table = run.read_file(0)
    changed = table.set_column(
        table.schema.get_field_index("backend"), "backend", pa.array(["other"] * len(table))
    )
    with monkeypatch.context() as patch:
        left = [stop]

        def cut(real: Any) -> Any:
            def call(*arguments: Any) -> Any:
                left[0] -= 1
                if left[0] == 0:
                    raise Stopped
                return real(*arguments)

            return call

        patch.setattr(Checksums, "add", cut(Checksums.add))
        patch.setattr(Path, "replace", cut(Path.replace))
        if stop < 3:
            with pytest.raises(Stopped):
                run.write(0, changed)
        else:
            run.write(0, changed)
    again = RunFolder.read(tmp_path / "run")
    assert again.damaged() == []
    assert set(again.read_file(0)["backend"].to_pylist()) == {"opencl" if stop < 3 else "other"}


def test_a_folder_of_something_else_or_in_use_is_refused(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"holds other files \(note\.txt\)"):
        sweep(plan, tmp_path, backend=opencl)
    with pytest.raises(OutputError, match=r"note\.txt is a file; choose another folder"):
        sweep(plan, tmp_path / "note.txt", backend=opencl)
    with pytest.raises(OutputError, match="cannot be written"):
        sweep(plan, tmp_path / "note.txt" / "run", backend=opencl)
    with pytest.raises(OutputError, match="File name too long"):
        sweep(plan, tmp_path / ("a" * 300), backend=opencl)
    with (
        RunFolder.writing(tmp_path / "run", plan),
        pytest.raises(OutputError, match="being written by another gpuspec"),
    ):
        sweep(plan, tmp_path / "run", backend=opencl)
    with pytest.raises(OutputError, match="holds no sweep; `gpuspec sweep STATION"):
        RunFolder.read(tmp_path / "nothing")


def test_a_damaged_file_is_named_with_what_to_do(station, opencl, tmp_path):
    plan = Plan.of(station, GRID)
    run = sweep(plan, tmp_path / "run", backend=opencl)
    run.file(0).write_bytes(b"PAR1 no more")
    with pytest.raises(OutputError, match=r"part-00000000\.parquet is damaged.*the same `gpuspec"):
        list(run.batches())


def test_more_designs_than_the_disk_holds_are_refused_before_work(station, opencl, tmp_path):
    plan = Plan.of(station, {"tunnel.luminous_mm": "1:2:100000", "tunnel.dark_mm": "1:2:100000"})
    with pytest.raises(OutputError, match=r"10,000,000,000 designs need about .* GB on disk"):
        sweep(plan, tmp_path / "run", backend=opencl)
    assert not (tmp_path / "run").exists()


def test_pandas_polars_and_duckdb_read_the_folder(station, opencl, tmp_path):
    import duckdb
    import pandas as pd
    import polars as pl

    run = sweep(Plan.of(station, GRID), tmp_path / "run", backend=opencl)
    best = max(row["best_p1"] for row in rows(run))
    where = tmp_path / "run" / "designs"
    assert pd.read_parquet(where)["best_p1"].max() == best
    assert pl.read_parquet(where)["best_p1"].max() == best
    assert pl.read_parquet(where / "*.parquet")["best_p1"].max() == best
    found = duckdb.sql(f"select max(best_p1), len(p1) from '{where}/*.parquet' group by 2")
    assert found.fetchall() == [(best, 256)]
    kinds = run.table().schema
    for name in ("p1", "p2", "hits"):
        assert pa.types.is_fixed_size_list(kinds.field(name).type)
        assert kinds.field(name).type.list_size == 256


@pytest.mark.slow
def test_memory_does_not_grow_with_the_designs(tmp_path):
    """Ten times the designs, the same peak to within a tenth."""
    (tmp_path / "s.toml").write_text(gpuspec.station.toml.to_toml(Station.from_dict(STATION)))
    code = (
        "import resource, sys; from gpuspec.cli.main import main; sys.argv[0] = 'gpuspec'\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    peaks = []
    for count in (30, 300):
        done = subprocess.run(
            [PROGRAM[0], "-c", code, "sweep", "s.toml", "-o", f"run{count}", "--screen",
             "--vary", f"tunnel.luminous_mm=0.5:6:{count}", "--vary", "sensor.exposure=1:8:50"],
            cwd=tmp_path, capture_output=True, text=True, check=True, timeout=DEADLINE_S,
        )  # fmt: skip
        peaks.append(int(done.stdout.split("peak ")[1]))
    assert peaks[1] < 1.1 * peaks[0]


# ---------------------------------------------------------------------------------------- command


def test_sweep_prints_its_plan_and_what_to_do_next(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--vary",
                   "sensor.exposure=-1:4:6", "--vary", "tunnel.height_mm=100,150")  # fmt: skip
    assert ran.code == 0, ran.err
    for words in ("48 designs at 256 thresholds", "2 light maps", "exact", "time about",
                  "memory", "MiB", "16 designs are no valid station, e.g.: s.toml: sensor.exposure",
                  "gpuspec front sweep"):  # fmt: skip
        assert words in ran.out
    assert Path("sweep/sweep.json").exists()


def test_notes_are_in_the_table_where_they_are_true_and_nowhere_else(station, opencl, tmp_path):
    grid = {"tunnel.length_mm": [10.0, 400.0], "sensor.exposure": [1.0, 4.0],
            "sequence.step_mm": [0.2, 8.0]}  # fmt: skip
    for row in rows(sweep(Plan.of(station, grid), tmp_path / "run", backend=opencl)):
        notes = row["notes"] or ""
        assert ("of the part sees no light" in notes) == (row["tunnel.length_mm"] == 10)
        assert ("does not saturate" in notes) == (row["sensor.exposure"] == 1)
        assert ("all 40 images are the same" in notes) == (row["sequence.step_mm"] == 8)
        assert (row["notes"] is None) == (notes == "")


def test_what_is_said_of_every_design_already_is_told_again_only_of_some(station, opencl, tmp_path):
    grid = {"sensor.exposure": [0.8, 1.0, 4.0]}
    run = sweep(Plan.of(station, grid), tmp_path / "some", backend=opencl)
    told = of_table(run)
    assert len(told) == 2  # of two exposures, a note each
    line = told[0].partition(": ")[2]
    assert of_table(run, [line]) == told
    same = sweep(Plan.of(station, {"sensor.exposure": [0.8]}), tmp_path / "all", backend=opencl)
    (one,) = of_table(same)
    assert of_table(same, [one.partition(": ")[2]]) == []


def test_a_geometry_beyond_the_memory_is_refused_in_a_sentence(station, opencl, monkeypatch):
    monkeypatch.setattr("gpuspec.simulation.memory.free_bytes", lambda: 1000)
    with pytest.raises(StationError, match=r"of memory while"):
        Parts(opencl, 1, 0).levels([station], sampled=False)


def test_sweep_and_front_tell_what_is_wrong_with_designs(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.radius_mm=60,90", "--vary",
                   "tunnel.length_mm=6:200:4", "--set", "sensor.exposure=0.5")  # fmt: skip
    assert ran.code == 0, ran.err
    for words in (
        "note: tunnel.radius_mm is varied and has no effect with tunnel.section",
        "note: sensor.exposure = 0.5 does not saturate the sensor",
        "note: 2 of 8 designs: 58.6 % of the part sees no light",
        "assumed: the camera looks through the tunnel's top",
    ):
        assert ran.out.count(words) == 1
    ran = gpuspec_("front", "sweep", "--no-pictures", "--p2-floor", "0")
    assert "note: sensor.exposure = 0.5 does not saturate the sensor" in ran.out
    chosen = json.loads(Path("sweep/front/chosen.json").read_text("utf-8"))
    assert any("does not saturate" in note for note in chosen["notes"])


def test_what_is_said_of_every_design_is_true_of_every_design(station):
    # A stride through the grid would meet the first exposure and the first number of images alone.
    wide = {"tunnel.luminous_mm": "0.5:8:16", "tunnel.dark_mm": "2:24:12",
            "sensor.exposure": "1:8:8", "sequence.images": "8:80:10"}  # fmt: skip
    assert of_plan(Plan.of(station, wide)) == []
    (said,) = of_plan(Plan.of(station.replace(sensor__exposure=0.5), {
        key: values for key, values in wide.items() if key != "sensor.exposure"}))  # fmt: skip
    assert "does not saturate" in said


def test_a_sound_sweep_has_no_notes(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4")
    assert "note: " not in ran.out
    assert gpuspec_("front", "sweep", "--no-pictures", "--p2-floor", "0").code == 0
    assert json.loads(Path("sweep/front/chosen.json").read_text("utf-8"))["notes"] == []


def test_the_plan_alone_writes_nothing(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--plan")
    assert ran.code == 0
    assert "4 designs" in ran.out
    assert not Path("sweep").exists()


def test_a_plan_needs_no_empty_folder(gpuspec_: Command):
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("mine", encoding="utf-8")
    Path("spoilt").mkdir()
    Path("spoilt/sweep.json").write_text("{", encoding="utf-8")
    before = content(Path())
    for place in ("mine", "spoilt", "s.toml", "mine/notes.txt"):
        ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--plan", "-o",
                       place)  # fmt: skip
        assert (ran.code, ran.err) == (0, "")
        assert "4 designs" in ran.out
    assert content(Path()) == before


def test_a_plan_tells_what_the_disk_cannot_hold(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--plan", "--vary", "tunnel.dark_mm=1:2:100000", "--vary",
                   "tunnel.luminous_mm=1:2:100000")  # fmt: skip
    assert ran.code == 0
    assert "note: 10,000,000,000 designs need about" in ran.out


@pytest.mark.slow
def test_the_command_says_which_files_it_sweeps_again(gpuspec_: Command):
    command = "sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4"
    assert gpuspec_(*command).code == 0
    file = Path("sweep/designs/part-00000000.parquet")
    whole = file.read_bytes()
    file.write_bytes(spoilt(whole, "middle"))
    for more, word in (("--plan",), "4 designs"), ((), "designs/s"):
        ran = gpuspec_(*command, *more)
        assert ran.code == 0
        assert "note: damaged since they were written: part-00000000.parquet;" in ran.out
        assert word in ran.out
    assert file.read_bytes() == whole
    assert "damaged" not in gpuspec_(*command).out


def test_a_threshold_of_the_stations_own_is_left_out_and_told(gpuspec_: Command):
    ran = gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "--plan", "--set",
                   "segmentation.min_area_mm2=0.1")  # fmt: skip
    assert "threshold and size filter are left out" in ran.out


def test_another_sweeps_folder_is_refused_before_the_plan(gpuspec_: Command):
    assert gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4").code == 0
    told = said(gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:3"))
    assert "tunnel.luminous_mm is 1, 2, 3, 4 there and 1, 2.5, 4 here" in told


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--vary", "tunnel.luminous_mm"], "write KEY=FROM:TO:COUNT"),
        (["--vary", "tunnel.lumi=1:2:3"], "did you mean luminous_mm?"),
        (["--vary", "part.surface=1,2"], "is not a number"),
        (["--vary", "sensor.seed=1,2"], "another seed is another part or other noise, not another"),
        (["--vary", "populations[1].seed=1:9:9"], "--parts tries every design on several parts"),
        ([], "nothing to vary; give --vary"),
        (["--vary", "tunnel.dark_mm=9:1:3"], "is reversed"),
        (["--vary", "tunnel.dark_mm=1:3:2", "--vary", "tunnel.dark_mm=5"], "stands twice"),
        (["--vary", "sensor.exposure=-1,0"], "no design of the sweep is a valid station"),
        (["--vary", "tunnel.dark_mm=1:9:3", "--parts", "2"], "has no random [[populations]]"),
        (["--vary", "tunnel.dark_mm=1:2:100000", "--vary", "tunnel.luminous_mm=1:2:100000"],
         "GB on disk"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence_before_work_starts(gpuspec_: Command, options, words):
    assert words in said(gpuspec_("sweep", "s.toml", *options))
    assert not Path("sweep").exists()


def test_a_missing_package_is_named_with_its_extra(gpuspec_: Command, monkeypatch):
    import sys

    for name in [n for n in sys.modules if n.split(".")[0] == "pyarrow"]:
        monkeypatch.delitem(sys.modules, name)
    for name in [n for n in sys.modules if n.startswith("gpuspec.sweeps.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    text = said(gpuspec_("sweep", "s.toml", "--vary", "tunnel.dark_mm=1:9:3"))
    assert 'pip install "gpuspec[sweep]"' in text


def test_the_same_sweep_in_python_as_on_the_command_line(gpuspec_: Command, opencl):
    gpuspec_("sweep", "s.toml", "--vary", "tunnel.luminous_mm=1:4:4", "-o", "a")
    plan = Plan.of(Station.read("s.toml"), {"tunnel.luminous_mm": "1:4:4"})
    run = running.sweep(plan, "b", backend=opencl)
    assert run.table().equals(RunFolder.read("a").table())
