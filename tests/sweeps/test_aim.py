"""Choosing by goals and requirements: what meets them, what holds, what is said where none does."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from commandline import Command, said
from hypothesis import given
from hypothesis import strategies as st
from legible import check_legible, drawn_texts
from sweeping import STATION, rows

import gpuspec
from gpuspec.cli import aim as command
from gpuspec.detection.chances import share_within
from gpuspec.errors import StationError
from gpuspec.station.corners import corners
from gpuspec.station.paths import at
from gpuspec.station.station import Station
from gpuspec.sweeps.aim import Aim, Requirement, best_of
from gpuspec.sweeps.axes import Axis
from gpuspec.sweeps.choosing.aim_page import aim_page
from gpuspec.sweeps.choosing.aim_picture import aim_picture
from gpuspec.sweeps.choosing.aimed import AimChoice, choose_for
from gpuspec.sweeps.choosing.robust import Tolerances, windows
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.plan import Plan, with_part
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.confirm import confirm_all

VARY = {
    "tunnel.luminous_mm": [0.5, 1, 1.5, 2],
    "sensor.exposure": [2, 3, 4, 5, 6],
    "sequence.images": [6, 12, 24, 48],
}
FOUND = ("hits = all", "false_blobs = 0")
OFF = {"tunnel.luminous_mm": 0.05, "sensor.exposure": 0.3, "tunnel.dark_leak": 0.01}


@pytest.fixture(scope="module")
def base() -> Station:
    return Station.from_dict(STATION, "part.toml").replace(
        tolerance=OFF, sequence__frame_rate_hz=20.0
    )


@pytest.fixture(scope="module")
def swept(base, opencl, tmp_path_factory) -> dict[str, RunFolder]:
    folder = tmp_path_factory.mktemp("aims")
    plans = {
        "exact": Plan.of(base, VARY),
        "screened": Plan.of(base, VARY, samples=256),
        "steps": Plan.of(base.replace(tolerance=None), VARY),
    }
    return {name: sweep(plan, folder / name, backend=opencl) for name, plan in plans.items()}


@pytest.fixture(scope="module")
def cheapest(swept, opencl) -> AimChoice:
    aim = Aim("images", (*FOUND, "margin_sigma >= 6"))
    return choose_for(swept["exact"], aim, backend=opencl)


def meeting(run: RunFolder) -> list[dict]:
    """Rows that find every defect and nothing else at some threshold."""
    return [row for row in rows(run) if row["margin_dn"] > 0]


def test_the_cheapest_station_is_that_of_the_fewest_images_with_the_largest_margin(swept, cheapest):
    found = meeting(swept["exact"])
    assert 0 < len(found) < 80
    fewest = min(row["images"] for row in found if row["margin_sigma"] >= 6)
    best = max(row["margin_dn"] for row in found if row["images"] == fewest)
    assert cheapest.peak.values["images"] == fewest
    row = rows(swept["exact"])[cheapest.peak.design]
    assert row["margin_dn"] == best
    assert len(cheapest.ranked.design) == sum(row["margin_sigma"] >= 6 for row in found)


def test_what_is_chosen_is_confirmed_as_simulate_sees_it(cheapest, opencl):
    for held in (cheapest.peak, cheapest.robust):
        result = gpuspec.simulate(held.station, opencl)
        values = held.values
        assert values["p1"] == result.score.p1
        assert values["p2"] == result.score.p2
        assert values["hits"] == result.score.defects_hit == cheapest.all_of["hits"]
        assert values["false_blobs"] == 0
        # In the middle: as far from the flawless surface as from the faintest defect.
        middle = (held.confirmed.faintest_dn() + held.confirmed.flawless_dn) / 2
        if held is cheapest.peak:
            assert held.threshold_dn == pytest.approx(middle, abs=1.5)


def test_the_front_is_what_no_design_that_meets_the_aim_beats(swept, opencl):
    choice = choose_for(swept["exact"], Aim("margin_dn", FOUND), backend=opencl)
    assert choice.over == ("margin_dn", "images")
    points = {(row["images"], row["margin_dn"]) for row in meeting(swept["exact"])}
    best = {
        (images, margin)
        for images, margin in points
        if not any((i <= images and m >= margin and (i, m) != (images, margin)) for i, m in points)
    }
    front = zip(choice.front.values["images"], choice.front.values["margin_dn"], strict=True)
    assert set(front) == best
    assert len(best) > 1


def test_a_front_of_p1_and_p2_is_over_all_thresholds(swept, opencl):
    choice = choose_for(swept["exact"], Aim("f1"), ("p1", "p2"), backend=opencl)
    every = np.array([(a, b) for row in rows(swept["exact"])
                      for a, b in zip(row["p1"], row["p2"], strict=True)])  # fmt: skip
    front = np.column_stack([choice.front.values[name] for name in ("p1", "p2")])
    for point in front:
        assert not ((every >= point).all(axis=1) & (every > point).any(axis=1)).any()
    assert len(front) > 5


def test_a_front_of_three_measures_is_what_no_threshold_of_a_design_beats(swept, opencl):
    """By brute force over the table: P1 and P2 high, images few."""
    over = ("p1", "p2", "images")
    choice = choose_for(swept["exact"], Aim("f1"), over, backend=opencl)
    every = {(a, b, -float(row["images"])) for row in rows(swept["exact"])
             for a, b in zip(row["p1"], row["p2"], strict=True)}  # fmt: skip
    table = np.array(sorted(every))
    best = {
        point
        for point in every
        if not ((table >= point).all(axis=1) & (table > point).any(axis=1)).any()
    }
    front = np.column_stack([choice.front.values[name] for name in over]) * (1, 1, -1)
    assert {tuple(point) for point in front.tolist()} == best
    assert len(front) == len(best) > 20
    figure = aim_picture(choice)
    check_legible(figure)
    texts = " ".join(text.get_text() for text in drawn_texts(figure))
    assert "coloured by images" in texts and "images; less is better" in texts
    assert "ColorBar" in aim_page(choice)


def test_a_screened_sweep_chooses_no_worse_than_its_bounds_tell(swept, opencl):
    aim = Aim("margin_dn", (*FOUND, "images <= 24"))
    exact, screened = (choose_for(swept[n], aim, backend=opencl) for n in ("exact", "screened"))
    assert screened.peak.values["margin_dn"] >= exact.peak.values["margin_dn"] - 2
    assert screened.peak.values["hits"] == exact.all_of["hits"]
    assert screened.peak.values["false_blobs"] == 0


def test_the_robust_choice_keeps_all_where_everything_is_off(cheapest, opencl):
    """Every corner of the tolerances, and some designs within: simulated at its threshold."""
    assert cheapest.robust.room_dn > 0
    station = cheapest.robust.station
    random = np.random.default_rng(1)
    within = [
        {key: float(np.clip(at(station, key) + random.uniform(-h, h), 0, 99))
         for key, h in OFF.items()}
        for _ in range(4)
    ]  # fmt: skip
    for off in [*corners(station, OFF), *within]:
        found = confirm_all([station.replace(**off)], 1, opencl)[0].values()
        assert found["hits"] == cheapest.all_of["hits"], off
        assert found["false_blobs"] == 0, off


def test_what_may_be_missed_gives_the_threshold_more_room(swept, cheapest, opencl):
    """Where one defect fewer is required the faintest does not bound what is held."""
    every = cheapest.all_of["hits"]
    aims = [Aim("images", (f"hits >= {every - n}", "false_blobs = 0")) for n in (0, 1)]
    assert [aim.least_hits for aim in aims] == [every, every - 1]
    all_hit, one_missed = (choose_for(swept["exact"], aim, backend=opencl) for aim in aims)
    held = one_missed.robust
    assert held.room_dn > 0
    levels = []
    for off in corners(held.station, OFF):
        (found,) = confirm_all([held.station.replace(**off)], 1, opencl)
        assert found.values()["hits"] >= every - 1, off
        assert found.values()["false_blobs"] == 0, off
        levels.append((found.faintest_dn(), found.faintest_dn(every - 1)))
    assert min(two for _, two in levels) >= held.threshold_dn + held.room_dn - 1e-3
    assert all(one < two for one, two in levels)
    assert held.values["images"] <= all_hit.robust.values["images"]


def test_the_worst_of_the_neighbours_counts_with_the_threshold_held(swept, opencl):
    """Where no tolerances are stated: the next values of the grid on both sides, all keys at once,
    whole numbers as they are."""
    choice = choose_for(swept["steps"], Aim("margin_dn", FOUND), backend=opencl)
    plan = swept["steps"].plan
    assert choice.tolerances.halves == {"tunnel.luminous_mm": None, "sensor.exposure": None}
    table = {tuple(plan.values(row["design"]).values()): row for row in rows(swept["steps"])}
    for held in (choice.peak, choice.robust):
        own = plan.values(held.design)
        low, high = 0.0, 255.0
        for (luminous, exposure, images), row in table.items():
            steps = [
                abs(sorted(VARY[key]).index(value) - sorted(VARY[key]).index(own[key]))
                for key, value in (("tunnel.luminous_mm", luminous), ("sensor.exposure", exposure))
            ]
            if images == own["sequence.images"] and max(steps) <= 1:
                low = max(low, row["flawless_dn"])
                high = min(high, min(row["peaks"]))
        assert held.room_dn == pytest.approx(min(high - held.threshold_dn, held.threshold_dn - low))


@given(st.integers(0, 4), st.lists(st.integers(0, 9), min_size=15, max_size=15))
def test_windows_are_the_worst_over_the_neighbours(design, levels):
    plan = Plan(Station(), (Axis("a.b", (1.0, 2.0, 4.0, 8.0, 9.0)), Axis("c.d", (1, 2, 3))))
    weakest = np.array(levels)
    low, high = windows(plan, Tolerances({"a.b": 2.0}), weakest, weakest[::-1].copy())
    grid = weakest.reshape(5, 3)
    near = [abs(v - plan.axes[0].values[design]) <= 2.0 for v in plan.axes[0].values]
    assert high.reshape(5, 3)[design].tolist() == grid[near].min(axis=0).tolist()
    flawless = weakest[::-1].reshape(5, 3)
    assert low.reshape(5, 3)[design].tolist() == flawless[near].max(axis=0).tolist()


def test_a_requirement_that_none_meets_says_which_came_nearest_and_why(swept, opencl):
    with pytest.raises(StationError) as error:
        choose_for(swept["exact"], Aim("images", ("margin_dn >= 250", "images <= 12")),
                   backend=opencl)  # fmt: skip
    told = str(error.value)
    best = max((r for r in rows(swept["exact"]) if r["images"] <= 12), key=lambda r: r["margin_dn"])
    assert f"Design {best['design']} (" in told
    assert f"margin_dn is {best['margin_dn']:.1f} DN, not margin_dn >= 250" in told
    assert "images is" not in told


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["images <= 16", "images >= 20"], "images >= 20 contradicts images <= 16"),
        (["hits = 3", "hits = all"], "hits = all contradicts hits = 3"),
        (["false_blob = 0"], "did you mean false_blobs?"),
        (["zzz = 0"], "there are p1, p2"),
        (["images"], "cannot be read; write NAME = VALUE"),
        (["images < 3"], "has <; write NAME = VALUE"),
        (["images <= many"], "many is no number"),
        (["images <= nan"], "nan is no number"),
        (["p2 >= 85"], "is from 0 to 1"),
    ],
)
def test_a_requirement_that_cannot_be_is_one_sentence(texts, words):
    with pytest.raises(StationError, match=re.escape(words)):
        Aim("images", tuple(texts))


def test_a_cost_that_the_station_does_not_tell_is_refused(swept, opencl):
    with pytest.raises(StationError, match=r"does not tell exposure_s: set sensor\.light_e_per_s"):
        choose_for(swept["exact"], Aim("exposure_s"), backend=opencl)
    told = choose_for(swept["exact"], Aim("cycle_s", FOUND), backend=opencl)
    assert told.peak.values["cycle_s"] == pytest.approx(told.peak.values["images"] / 20)


@pytest.mark.parametrize(
    ("goal", "require", "over"),
    [("hits.bump", (), None), ("images", ("hits.bump = all",), None),
     ("images", (), ("hits.bump", "images"))],
)  # fmt: skip
def test_hits_of_a_kind_of_which_there_is_none_are_nothing_to_choose_by(
    base, swept, opencl, tmp_path, goal, require, over
):
    told = (
        r"there are no bumps on the part, .* hits\.bump tells nothing; there are hits, hits\.dent"
    )
    with pytest.raises(StationError, match=told):
        choose_for(swept["exact"], Aim(goal, require), over, backend=opencl)
    if over is None:
        plan = gpuspec.search_plan(base, {"sensor.exposure": "2:6"})
        with pytest.raises(StationError, match=told):
            gpuspec.optimise(plan, tmp_path / "search", 2, Aim(goal, require), backend=opencl)
        assert not (tmp_path / "search").exists()
    found = choose_for(swept["exact"], Aim("hits.scratch", ("hits.dent = all",)), backend=opencl)
    assert found.all_of["hits.scratch"] == 2


@pytest.mark.parametrize("key", ["tunnel.dark", "tunnel.section", "nothing.at_all"])
def test_a_tolerance_of_no_number_is_refused(base, key):
    wrong = base.replace(tolerance={key: 1.0})
    with pytest.raises(StationError, match=r"\[tolerance\]"):
        Tolerances.of(Plan(wrong, Plan.of(base, VARY).axes))
    with pytest.raises(StationError, match=r"\[tolerance\]"):
        Plan.of(wrong, VARY)


def test_a_tolerance_of_a_key_without_a_number_is_refused_before_the_sweep(base):
    unset = base.replace(tolerance=None).replace(tolerance={"sequence.step_mm": 0.01})
    with pytest.raises(StationError, match=r"step_mm has no number in part\.toml"):
        Plan.of(unset, VARY)
    plan = Plan.of(unset, {"sequence.step_mm": [0.1, 0.2]})
    assert Tolerances.of(plan).halves == {"sequence.step_mm": 0.01}


def test_a_pose_that_is_not_stated_may_be_off_from_0(base, opencl, tmp_path):
    off = {"part.pose.tilt_x_deg": 0.1, "camera.pose.shift_z_mm": 2.0}
    own = base.replace(tolerance=None).replace(tolerance=off)
    ends = corners(own, off)[:4]
    assert ends == [{key: end} for key, half in off.items() for end in (-half, half)]
    run = gpuspec.sweep(own, {"sensor.exposure": [3, 4]}, tmp_path / "run", backend=opencl)
    choice = choose_for(run, Aim("margin_dn"), backend=opencl)
    held = choice.peak
    corner = [held.station.replace(**one) for one in corners(own, off)]
    seen = confirm_all(corner, 1, opencl)
    low, high = max(one.flawless_dn for one in seen), min(one.faintest_dn() for one in seen)
    assert held.room_dn <= min(high - held.threshold_dn, held.threshold_dn - low) + 1e-3
    assert held.tried == len(corner)


@given(st.lists(st.tuples(*3 * [st.integers(0, 2)]), min_size=1, max_size=9))
def test_the_best_is_that_of_the_first_criterion_in_which_points_differ(points):
    order = [np.array(column, float) for column in zip(*points, strict=True)]
    assert best_of(order) == max(range(len(points)), key=lambda n: (points[n], -n))


def test_how_far_a_value_misses_what_is_required_is_a_share_of_it():
    values = np.array([0.0, 6.0, 12.0, np.nan])
    assert Requirement.of("images >= 6").short_of(values, 0).tolist() == [1, 0, 0, 1]
    assert Requirement.of("images <= 6").short_of(values, 0).tolist() == [0, 0, 1, 1]
    assert Requirement.of("hits = all").short_of(values, 12).tolist() == [1, 0.5, 0, 1]


def test_a_share_of_hits_has_the_interval_of_clopper_and_pearson():
    assert share_within(5, 20) == pytest.approx((0.0866, 0.4910), abs=1e-4)  # as in tables
    assert share_within(0, 20) == pytest.approx((0, 0.1684), abs=1e-4)


def test_parts_and_noise_are_told_as_mean_worst_and_spread(base, opencl):
    noisy = base.replace(
        sensor={"noise": True, "saturation_e": 500.0, "read_noise_e": 2.0},
        sequence={"images": 16}, segmentation={"threshold": 80.0},
    )  # fmt: skip
    (found,) = confirm_all([noisy], 3, opencl)
    spread = found.spread()
    p1 = [gpuspec.simulate(with_part(noisy, n), opencl).score.p1
          for n in range(3)]  # fmt: skip
    assert spread["worst"]["p1"] == min(p1)
    assert spread["mean"]["p1"] == pytest.approx(np.mean(p1))
    expected = spread["expected"]
    assert len(expected) == 3
    for one, draw in zip(expected, p1, strict=True):
        assert one["p1"] == pytest.approx(draw, abs=6 * one["p1_deviation"] + 0.01)


@pytest.mark.parametrize("dsnu_e", [0.0, 2.0])
def test_what_is_looked_at_undrawn_has_the_levels_of_every_draw(base, opencl, dsnu_e):
    """They are those of the noise's mean, and what it is off by is told once a part."""
    noisy = base.replace(
        sensor={"noise": True, "saturation_e": 500.0, "read_noise_e": 2.0, "dark_e": 2.0,
                "dsnu_e": dsnu_e},
        sequence={"images": 16}, segmentation={"threshold": 80.0},
    )  # fmt: skip
    drawn, undrawn = (confirm_all([noisy], 2, opencl, 3, drawn=way)[0] for way in (True, False))
    assert len(drawn.parts) == 6
    assert len(undrawn.parts) == (6 if dsnu_e else 2)  # without, draws differ in nothing else
    assert undrawn.flawless_dn == drawn.flawless_dn
    assert undrawn.faintest_dn() == drawn.faintest_dn()
    assert [seen.expected is None for seen in drawn.parts] == [False, True, True] * 2
    assert drawn.parts[0].false_zone_px != undrawn.parts[0].false_zone_px


def test_the_command_chooses_writes_and_draws(gpuspec_: Command, swept, opencl):
    run = swept["exact"].path
    ran = gpuspec_("front", run, "--goal", "images", "--require", *FOUND, "margin_sigma >= 6",
                   "-o", "out", "--write", "best.toml")  # fmt: skip
    assert ran.code == 0, ran.err
    assert "aim: hits = all, false_blobs = 0, margin_sigma >= 6, then the least images" in ran.out
    assert {p.name for p in Path("out").iterdir()} >= {"front.csv", "chosen.json", "front.png",
                                                       "front.html"}  # fmt: skip
    told = json.loads(Path("out/chosen.json").read_text("utf-8"))
    assert told["robust"]["measures"]["false_blobs"] == 0
    score = gpuspec.simulate("best.toml", opencl).score
    assert score.p1 == told["robust"]["measures"]["p1"]
    with Path("out/front.csv").open(encoding="utf-8") as file:
        assert [float(row["images"]) for row in csv.DictReader(file)]


def test_the_page_of_a_front_needs_no_network(gpuspec_: Command, swept):
    ran = gpuspec_("front", swept["exact"].path, "--goal", "images", "--require", *FOUND, "-o", "o")
    assert ran.code == 0, ran.err
    page = Path("o/front.html").read_text("utf-8")
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=", page)
    assert len(page) < 3e6
    assert "images; less is better" in page


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--goal", "p3"], "there is no 'p3' to choose by; did you mean p2?"),
        (["--goal", "margin"], "did you mean margin_dn?"),
        (["--goal", "a90"], "gpuspec pod STATION --vary"),
        (["--require", "images <= 1"], "comes nearest"),
        (["--over", "p1"], "--over p1 names no two or three measures"),
        (["--over", "p1,p2,f1,hits"], "no two or three measures"),
        (["--over", "p1,p2,p1"], "no two or three measures"),
        (["--over", "p1,image"], "did you mean images?"),
        (["--goal", "images", "--p2-floor", "0.9"], '--require "p2 >= 0.9"'),
        (["another"], "name one folder of a sweep, not 2"),
    ],
)
def test_a_mistake_is_one_sentence(gpuspec_: Command, swept, options, words):
    assert words in said(gpuspec_("front", swept["exact"].path, "-o", "out", *options))
    assert not Path("out").exists()


def test_the_picture_of_an_aim_is_legible_and_says_which_way_is_better(cheapest):
    figure = aim_picture(cheapest)
    check_legible(figure)
    texts = " ".join(text.get_text() for text in drawn_texts(figure))
    assert "images; less is better" in texts
    assert "margin, DN; more is better" in texts
    for name in ("peak", "robust", "next three", "front"):
        assert name in texts


def test_false_blobs_are_counted_by_the_station_s_own_size_filter(station, opencl, tmp_path):
    """Whatever the sweep counted pixel by pixel; another filter may be asked for, or none."""
    own = station.replace(segmentation={"min_area_mm2": 0.05, "threshold": 200.0})
    run = gpuspec.sweep(own, {"sensor.exposure": [2, 4]}, tmp_path / "run", backend=opencl)
    for asked, filtered in ((None, 0.05), (0.02, 0.02), (0.0, 0.0)):
        choice = choose_for(run, Aim("p2"), min_area_mm2=asked, backend=opencl)
        assert choice.station().segmentation.min_area_mm2 == filtered
    by_pixel = gpuspec.choose(run).station().segmentation
    assert (by_pixel.min_area_mm2, by_pixel.threshold != 200.0) == (0.0, True)


def looked_at(run: RunFolder, engine, **rule) -> list[dict[str, float]]:
    """The measures of every design, looked at whole."""
    plan = run.plan
    stations = [plan.station_of(design).replace(**rule) for design in range(plan.designs)]
    return [one.values() for one in confirm_all(stations, 1, engine)]


@pytest.fixture(scope="module")
def margins(swept, opencl) -> np.ndarray:
    found = looked_at(swept["exact"], opencl, segmentation__threshold=90.0)
    return np.array([one["margin_dn"] for one in found])


def test_the_most_margin_is_that_of_the_image_and_not_of_a_table_s_whole_levels(
    swept, margins, opencl
):
    """Of designs that the table tells to be alike, or nearly, the best is found."""
    table = np.array([row["margin_dn"] for row in rows(swept["exact"])])
    assert 0.5 < np.abs(table - margins).max() < 1
    # Among each few designs whose margins are within a level, as if no others were required.
    for most in np.unique(table[table > 0])[-12:]:
        aim = Aim("margin_dn", (f"margin_dn <= {most:g}", *FOUND))
        peak = choose_for(swept["exact"], aim, backend=opencl).peak
        assert peak.values["margin_dn"] == margins[margins <= most].max()


def test_a_margin_that_is_required_is_refused_only_where_it_cannot_be(swept, margins, opencl):
    table = np.array([row["margin_dn"] for row in rows(swept["exact"])])
    design = int(np.argmax(margins))
    assert table[design] < margins[design]
    between = (table.max() + margins[design]) / 2
    choice = choose_for(swept["exact"], Aim("images", (f"margin_dn >= {between}",)), backend=opencl)
    assert choice.peak.design == design
    assert choice.ranked.design.tolist() == [design]
    beyond = margins[design] + 0.1
    told = rf"when it is looked at whole\. Design {design} \(.* in its way stands: margin_dn is 106"
    with pytest.raises(StationError, match=told):
        choose_for(swept["exact"], Aim("images", (f"margin_dn >= {beyond}",)), backend=opencl)


@pytest.mark.parametrize("area", [0.1, 0.3])
def test_with_a_size_filter_the_threshold_is_one_at_which_all_is_large_enough(swept, opencl, area):
    """In the middle of those at which every defect is hit and nothing else, by the filter."""
    aim = Aim("margin_dn", FOUND)
    choice = choose_for(swept["exact"], aim, min_area_mm2=area, backend=opencl)
    peak = choice.peak
    levels = [peak.station.replace(segmentation__threshold=float(dn)) for dn in range(255)]
    found = [one.values() for one in confirm_all(levels, 1, opencl)]
    met = [dn for dn, one in enumerate(found)
           if (one["hits"], one["false_blobs"]) == (choice.all_of["hits"], 0)]  # fmt: skip
    assert met == [*range(met[0], met[-1] + 1)]
    assert abs(peak.threshold_dn - (met[0] + met[-1]) / 2) <= 1
    assert met[-1] < (peak.confirmed.faintest_dn() + peak.confirmed.flawless_dn) / 2
    assert peak.design == choose_for(swept["exact"], aim, backend=opencl).peak.design


def test_the_best_p1_by_a_size_filter_is_that_of_all_thresholds(station, opencl, tmp_path):
    run = gpuspec.sweep(station, {"sensor.exposure": [4]}, tmp_path / "run", backend=opencl)
    peak = choose_for(run, Aim("p1", ("hits = all",)), min_area_mm2=0.3, backend=opencl).peak
    every = [peak.station.replace(segmentation__threshold=float(dn)) for dn in range(255)]
    found = [one.values() for one in confirm_all(every, 1, opencl)]
    most = max(one["p1"] for one in found if one["hits"] == 6)
    assert peak.values["p1"] == pytest.approx(most, abs=1e-12)


def test_the_paper_s_rule_says_that_it_leaves_out_the_size_filter(
    gpuspec_: Command, station, opencl, tmp_path
):
    filtered = station.replace(segmentation__min_area_mm2=0.05)
    for number, own in enumerate((station, filtered)):
        run = gpuspec.sweep(own, {"sensor.exposure": [2, 4]}, tmp_path / f"{number}",
                            backend=opencl)  # fmt: skip
        ran = gpuspec_("front", run.path, "--no-pictures")
        assert ("--min-area-mm2 0.05 chooses with it" in ran.out) == (number == 1)
        ran = gpuspec_("front", run.path, "--goal", "hits", "--no-pictures")
        assert ("a blob that is too small for it" in ran.out) == (number == 1)


@pytest.mark.parametrize(
    ("goal", "over", "area", "aim"),
    [
        (None, None, 0.1, "hits = all, p2 >= 0.85, then the most p1"),
        ("paper", None, 0.1, "hits = all, p2 >= 0.85, then the most p1"),
        ("f1", "margin_dn,images", None, "hits = all, p2 >= 0.85, then the most f1"),
        (None, "margin_dn,images", None, "then the most margin_dn"),
        ("margin_dn", None, 0.1, "then the most margin_dn"),
    ],
)
def test_the_papers_rule_stays_with_a_size_filter_and_over_other_measures(goal, over, area, aim):
    place, found = command.asked(["run"], goal, None, over, area)
    assert (str(place), str(found.aim), found.min_area_mm2) == ("run", aim, area)


def test_without_either_the_papers_rule_is_its_own():
    assert command.asked(["run"], "paper", None, None, None) == (Path("run"), None)


def test_where_nothing_need_be_hit_the_threshold_is_below_full_scale(swept, opencl):
    """P1 is 1 where nothing is detected, which no station may ask for."""
    choice = choose_for(swept["exact"], Aim("p1", ("images <= 100",)), backend=opencl)
    for held in (choice.peak, choice.robust):
        assert held.threshold_dn < swept["exact"].plan.station.sensor.full_scale_dn
