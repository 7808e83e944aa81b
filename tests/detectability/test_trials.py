"""Trials of random parts: what is traced tells what whole parts would."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SMALL

import gpuspec
from gpuspec.arrays import BESIDE
from gpuspec.detectability.bench import TrialBench
from gpuspec.detectability.false_calls import FalseCalls
from gpuspec.detectability.plan import TrialPlan
from gpuspec.detectability.sizes import SIZES, chosen
from gpuspec.detectability.telling import tried
from gpuspec.detection.inspection import inspect
from gpuspec.detection.score import score
from gpuspec.errors import StationError, TrialsError
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.station.station import Station
from gpuspec.sweeps.crew import Alone
from gpuspec.sweeps.plan import with_part

PARTS = 4


def rows(station, engine, parts=PARTS):
    return TrialBench(TrialPlan.of(station, parts), engine).rows(range(parts), sampled=True)


def whole(station, engine, part, threshold):
    """A part traced pixel by pixel: its score, and its aspect image."""
    own = with_part(station, part).replace(segmentation__threshold=threshold)
    relief = Relief.of(own)
    truth = Truth.of(own, relief)
    light_map = engine.trace(own, relief)
    aspect, on_part = light_map.counted(), light_map.lost() != BESIDE
    found = inspect(aspect, on_part, own)
    return score(found.labels, truth.labels, on_part, len(truth.defects)), aspect, truth


@pytest.mark.parametrize(
    ("changes", "threshold"),
    [
        ({"sequence__images": 6}, 84.9),
        ({"sequence__images": 6, "segmentation__min_area_mm2": 0.3}, 84.9),
        ({"part__orange_peel": {"wavelength_mm": 4.0, "slope_rad": 0.004}}, 70.4),
        ({"part__waviness": {"wavelength_mm": 6.0, "amplitude_um": 1.0}}, 70.13),
    ],
    ids=str,
)
def test_a_false_blob_that_reaches_beyond_what_is_near_is_counted_once(
    station, engine, changes, threshold
):
    """As of the whole image: near defects and away from them there are as many as there are."""
    uneven = station.replace(**{**changes, "segmentation__threshold": threshold})
    (row,) = rows(uneven, engine, 1).to_pylist()
    there = gpuspec.simulate(uneven, engine).score.false_blobs
    assert row["near_false"] + row["drawn_false"] == there > 0


@pytest.mark.parametrize(
    "changes",
    [
        {"sequence__fusion": "max"},
        {"sensor": {"noise": True, "saturation_e": 3.0, "exposure": 8.0}, "sequence__images": 4},
    ],
    ids=str,
)
def test_an_automatic_threshold_beyond_full_scale_is_told_as_simulate_does(
    station, engine, changes
):
    """First, and in place of what its misses and its signals would tell."""
    blind = station.replace(**changes)
    (why,) = [said for said in gpuspec.simulate(blind, engine).warnings if "beyond full" in said]
    found = gpuspec.pod(blind, parts=2, backend=engine)
    assert found.cautions() == (f"hits: {why}",)
    assert found.threshold_dn > 255
    assert found.signals is None
    with pytest.raises(TrialsError, match="is beyond full scale and detects nothing"):
        gpuspec.pod(blind, parts=2, vary={"sensor.exposure": [8.0]}, backend=engine)


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize(
    "changes",
    [{}, {"segmentation__min_area_mm2": 0.06}, {"part__pose": {"tilt_y_deg": 1.0}},
     {"part__orange_peel": {"wavelength_mm": 2.0, "slope_rad": 0.0005}}],
    ids=str,
)  # fmt: skip
def test_a_trial_is_what_the_whole_part_tells(station, engine, noise, changes):
    station = station.replace(sensor__noise=noise, **changes)
    seen = 0
    for part, row in enumerate(rows(station, engine).to_pylist()):
        scored, aspect, truth = whole(station, engine, part, row["threshold_dn"])
        own = len(station.defects)
        assert row["hit"] == [hit > 0 for hit in scored.defect_hit_px[own:]]
        assert row["zone_px"] == list(scored.defect_zone_px[own:])
        peaks = [aspect[truth.labels == i].max() for i in range(own + 1, scored.defects + 1)]
        assert np.add(row["signal_dn"], row["flawless_dn"]) == pytest.approx(peaks, abs=1e-3)
        assert [row["kind"][i] for i in (0, -1)] == ["dent", "scratch"]
        seen += sum(row["hit"])
    assert 0 < seen < 14 * PARTS  # some are found, and some are not


def test_the_threshold_is_that_of_simulate(station, engine):
    row = rows(station, engine, 1).to_pylist()[0]
    assert row["threshold_dn"] == gpuspec.simulate(station, engine).threshold
    held = station.replace(segmentation__threshold=99.0)
    assert rows(held, engine, 1)["threshold_dn"][0].as_py() == 99.0


def test_no_false_call_is_certain_where_the_light_says_so(station, engine):
    found = rows(station, engine)
    assert found["clear"].to_pylist() == [engine.screens] * PARTS
    low = station.replace(segmentation__threshold=found["flawless_dn"][0].as_py())
    assert rows(low, engine)["clear"].to_pylist() == [False] * PARTS


def test_the_sample_tells_how_many_blobs_whole_parts_have(station, engine):
    # A threshold within the noise, so that flawless pixels pass it, some as neighbours.
    noisy = station.replace(
        sensor__noise=True, sensor__read_noise_e=1500.0, populations=[
            {"kind": "dent", "count": 1, "diameter_mm": [0.5, 0.6], "depth_um": 2.0}
        ],
    )  # fmt: skip
    flawless = rows(noisy, engine, 1).to_pylist()[0]
    level = flawless["flawless_dn"] + 0.45 * flawless["noise_dn"]
    noisy = noisy.replace(segmentation__threshold=level)
    found = rows(noisy, engine, 12).to_pydict()
    counted = [whole(noisy, engine, part, level)[0].false_blobs for part in range(12)]
    near, false, drawn, rest = (np.array(found[name], float) for name in (
        "near_false", "drawn_false", "drawn", "rest_px"))  # fmt: skip
    assert near[0] + false[0] == pytest.approx(counted[0], abs=1)  # the first is seen whole
    told = FalseCalls.of(near, false, drawn, rest, False)
    drawn_calls = false[1:].sum()
    assert drawn_calls > 20
    estimate = near.mean() + false.sum() / drawn.sum() * rest.mean()
    assert told.per_part == pytest.approx(estimate)
    deviation = estimate / np.sqrt(drawn_calls)
    assert abs(np.mean(counted) - estimate) < 4 * deviation
    assert np.mean(counted) < told.bound


def test_bounds_of_false_calls_are_those_of_their_laws():
    none = FalseCalls.of([0] * 10, [0] * 10, [1000] * 10, [5000] * 10, True)
    assert (none.per_part, none.bound) == (0, pytest.approx(0.29957, abs=1e-4))  # 3 over n
    drawn = FalseCalls.of([0] * 10, [0] * 10, [1000] * 10, [5000] * 10, False)
    assert drawn.bound == pytest.approx((1 - 0.025 ** (1 / 10_000)) * 5000 + 3.6889 / 10, rel=1e-3)
    crowded = FalseCalls.of([0] * 9 + [10], [0] * 10, [1000] * 10, [5000] * 10, True)
    spread = FalseCalls.of([1] * 10, [0] * 10, [1000] * 10, [5000] * 10, True)
    assert crowded.per_part == spread.per_part == 1
    assert crowded.bound > 2 * spread.bound  # ten on one part tell less than one on each of ten


def test_the_same_trials_come_whatever_the_order_and_noise_has_a_seed(station, engine):
    noisy = station.replace(sensor__noise=True, sensor__read_noise_e=60.0)
    bench = TrialBench(TrialPlan.of(noisy, PARTS), engine)
    there = bench.rows([0, 1, 2, 3], sampled=True)
    back = bench.rows([3, 1, 2, 0], sampled=True).sort_by("design")
    assert there.equals(back)
    alone = tried(TrialPlan.of(noisy, PARTS), Alone(bench), None, lambda *_: None)
    assert alone.equals(there)
    other = rows(noisy.replace(sensor__seed=9), engine, 2)
    assert other["size_mm"][0] == there["size_mm"][0]
    assert other["signal_dn"][0] != there["signal_dn"][0]


def test_defects_that_stand_on_every_part_alike_are_no_trials(station, engine):
    for row in rows(station, engine).to_pylist():
        assert len(row["kind"]) == 14  # the populations', without the dent of the station itself
    left = station.replace(camera__columns=120)
    seen = rows(left, engine).to_pylist()
    assert 0 < sum(len(row["x_mm"]) for row in seen) < 14 * PARTS
    assert all(abs(x) <= 6 for row in seen for x in row["x_mm"])


def test_sizes_are_what_they_are_called(station):
    a, d = np.array([0.5, 1.0]), np.array([2.0, 4.0])
    sigma, r = 0.5 / 4, np.linspace(0, 0.5, 20001)
    steepest = np.abs(np.gradient(2.0 * np.exp(-(r**2) / 2 / sigma**2), r)).max()
    assert SIZES["slope"].of(a, d)[0] == pytest.approx(steepest, rel=1e-6)
    assert SIZES["depth"].of(a, d) is d and SIZES["diameter"].of(a, d) is a
    assert chosen(station)[1] == ("dent", "scratch")
    assert chosen(station, "width")[1] == ("scratch",)
    assert chosen(station, "depth", ["dent"])[1] == ("dent",)


def test_a_station_without_trials_is_refused(station):
    def refused(text, size="slope", kinds=()):
        with pytest.raises(StationError) as caught:
            chosen(Station.parse(text, "s.toml"), size, kinds)
        return str(caught.value)

    assert "no random defects" in refused(SMALL.split("[[populations]]")[0])
    even = SMALL.replace("diameter_mm = [0.3, 1.2]", "diameter_mm = 0.5")
    assert "is 0.5 mm" in refused(even, "diameter")
    assert "choose one of" in refused(SMALL, "volume")
    assert "choose one of" in refused(SMALL, kinds=["pit"])
    assert "none of bump has a slope" in refused(SMALL, kinds=["bump"])
    for parts in (0, True, 10**6):
        with pytest.raises(StationError, match="parts are asked for"):
            TrialPlan.of(station, parts)
    with pytest.raises(StationError, match="whole images"):
        TrialPlan.of(station.replace(segmentation__background_mm=3.0))
    with pytest.raises(StationError, match=r"low = 1\.2 must not exceed high"):
        Station.parse(SMALL.replace("[0.3, 1.2]", "[1.2, 0.3]"), "s.toml")
