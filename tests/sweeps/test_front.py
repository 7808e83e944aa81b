"""Choosing from a sweep: the front, the rule's choice, and the command that shows it."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from commandline import STATION, Command, content, hidden, names, said
from hypothesis import given
from hypothesis import strategies as st
from legible import check_legible, drawn_texts
from matplotlib.figure import Figure
from PIL import Image

import gpuspec
from gpuspec.cli.front import _short
from gpuspec.errors import OutputError, StationError
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.simulation.simulate import simulate
from gpuspec.station.station import Station
from gpuspec.sweeps.choosing import diagrams
from gpuspec.sweeps.choosing.choose import Choice, choose, most_defects
from gpuspec.sweeps.choosing.diagrams import label
from gpuspec.sweeps.choosing.front import COLUMNS, Front, Points, dominated
from gpuspec.sweeps.choosing.front_picture import front_picture
from gpuspec.sweeps.choosing.maps import Map, Maps
from gpuspec.sweeps.choosing.scores import Scores
from gpuspec.sweeps.choosing.sensitivity import lines
from gpuspec.sweeps.keeping.folder import RunFolder
from gpuspec.sweeps.plan import Plan, with_part
from gpuspec.sweeps.rule import Rule
from gpuspec.sweeps.sweep import sweep
from gpuspec.sweeps.trying.bench import Bench
from gpuspec.words import BEST, P1, number

SCRATCH = """
[[defects]]
kind = "scratch"
points_mm = [[-4.0, -1.0], [-2.0, 2.0]]
width_mm = 0.3
depth_um = 1.0
"""
POPULATION = """
[[populations]]
kind = "dent"
count = 3
seed = 5
diameter_mm = [0.5, 0.9]
depth_um = [2.0, 9.0]
"""
# 640 designs: two files of the table.
VARY = {
    "tunnel.luminous_mm": "0.5:4:8",
    "tunnel.dark_mm": "2:10:5",
    "sensor.exposure": [1, 1.5, 2, 4],
    "sequence.images": [4, 7, 12, 24],
}
# No contrast: all is detected, or nothing.
EVEN = {"sensor.exposure": [0.5, 1], "tunnel.dark_mm": [4, 8]}
RULES = [
    Rule(),
    Rule(goal="f1"),
    Rule(goal="p2", p1_floor=0.3),
    Rule(p2_floor=0.9, hit_share=0.5),
    Rule(p2_floor=1.0, p1_floor=1.0),
    Rule(goal="f1", p2_floor=0, hit_share=0),
]
CHOSEN_FILES = {"front.csv", "chosen.json", "sensitivity.csv"}
PICTURES = {"front.png", "maps.png", "sensitivity.png"}


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory, opencl: OpenCLBackend) -> dict[str, RunFolder]:
    folder = tmp_path_factory.mktemp("runs")
    one, many = (Station.parse(STATION + more, "s.toml") for more in (SCRATCH, POPULATION))
    plans = {
        "exact": Plan.of(one, VARY),
        "screened": Plan.of(one, VARY, samples=512),
        "parts": Plan.of(many, {"sensor.exposure": [1, 2, 4], "tunnel.dark_mm": [2, 8]}, parts=3),
        "single": Plan.of(one, {"sensor.exposure": [3]}),
        "axis": Plan.of(one, {"sequence.images": [9, 5, 20]}),
        "even": Plan.of(one, EVEN),
        "even screened": Plan.of(one, EVEN, samples=512),
        "wide": Plan.of(
            one,
            {
                "tunnel.dark_leak": [0.000123, 0.00123, 0.0123],
                "sensor.saturation_e": [1000, 1234567, 9.9e6],
                "defects[1].depth_um": "1:8:13",
            },
        ),
        "five": Plan.of(
            one,
            {
                "tunnel.height_mm": [100, 300],
                "sensor.exposure": [2, 4],
                "tunnel.luminous_mm": [1, 2],
                "tunnel.dark_mm": [2, 4],
                "sequence.images": [8, 20],
            },
        ),
        "fine": Plan.of(one, {"sequence.images": "4:43:40"}),
        "bits": Plan.of(one, {"sensor.bit_depth": [12], "sequence.images": [24, 40]}),
        "invalid": Plan.of(one, {"tunnel.height_mm": [100, 300, 900], "sensor.exposure": [2, 4]}),
    }
    return {name: sweep(plan, folder / name, backend=opencl) for name, plan in plans.items()}


def everything(run: RunFolder) -> Scores:
    return Scores.of(run.table([*COLUMNS]).sort_by("design"))


def highest(left: np.ndarray, values: np.ndarray, floor: float = np.inf) -> np.ndarray:
    """Those left that reach the floor or, where none does, those that come nearest to it."""
    enough = left & (values >= floor)
    return enough if enough.any() else left & (values == values[left].max())


def asked_for(
    rule: Rule, p1: np.ndarray, p2: np.ndarray, hits: np.ndarray, defects: int
) -> np.ndarray:
    """The best points by the rule as it is told: one thing after another, the first things first.

    Nothing of the rule but what its user sets is asked.
    """
    needed = min(n for n in range(defects + 1) if n >= rule.hit_share * defects)
    left = highest(np.ones(p1.shape, np.bool_), hits, needed)
    left = highest(left, p2, rule.p2_floor)
    left = highest(left, p1, rule.p1_floor)
    if rule.goal == "f1":
        both = p1 + p2
        goal = np.divide(2 * p1 * p2, both, out=np.zeros_like(both), where=both > 0)
    else:
        goal = {"p1": p1, "p2": p2}[rule.goal]
    for values in (goal, p2, p1):
        left = highest(left, values)
    return left


def brute_force(run: RunFolder, rule: Rule, defects: int) -> tuple[int, float, float, int]:
    """The best of all designs at all thresholds, one list searched through."""
    scores = everything(run)
    p1, p2, hits = scores.p1.ravel(), scores.p2.ravel(), scores.hits.ravel()
    place = int(np.argmax(asked_for(rule, p1, p2, hits, defects)))
    return int(scores.design[place // 256]), float(p1[place]), float(p2[place]), int(hits[place])


def outcome(choice: Choice) -> tuple[int, float, float, int]:
    best = choice.best
    return best.design, best.p1, best.p2, best.hits


@given(st.lists(st.tuples(*3 * [st.integers(0, 4)]), max_size=30), st.integers(0, 30))
def test_dominated_agrees_with_comparing_every_pair(
    listed: list[tuple[int, int, int]], cut: int
) -> None:
    every = np.array(listed, float).reshape(-1, 3)
    place = np.arange(len(every))
    sure = np.ones(len(every), np.bool_)
    points = Points(place, place, every[:, 0], every[:, 1], every[:, 2].astype(np.int64), sure)
    by = points.only(place < cut)
    found = dominated(points, by)
    for n, one in enumerate(every):
        others = every[:cut]
        assert found[n] == any((o >= one).all() and (o > one).any() for o in others)


def test_the_front_is_what_nothing_beats(swept: dict[str, RunFolder]) -> None:
    scores = everything(swept["exact"])
    every = np.stack([scores.p1, scores.p2, scores.hits], axis=-1).reshape(-1, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        detected = scores.p2 * (1 / scores.p1 - 1)  # of what is flawless
    some = ~(detected > detected[:, :1] / 2).ravel()
    assert some.mean() > 0.5
    every = every[some]
    front = choose(swept["exact"]).front
    points = np.stack([front.p1, front.p2, front.hits], axis=-1)
    for point in points:
        assert not ((every >= point).all(axis=1) & (every > point).any(axis=1)).any()
    for point in np.unique(every, axis=0):
        at_least = (points >= point).all(axis=1)
        assert at_least.any()
    # By falling P2, then falling P1, the lowest designs and thresholds first.
    order = list(zip(-front.p2, -front.p1, front.design, front.level, strict=True))
    assert order == sorted(order)
    assert len(np.unique(front.p2)) > 5


ALL = 0.01
"""P1 where everything is detected."""


def bounded(*designs: tuple[int, float, float | None, float | None]) -> pa.Table:
    """Rows of designs, P1 and its bounds, all of one P2 and one hit at every threshold.

    At the lowest everything is detected.
    """
    numbers, p1, low, high = zip(*designs, strict=True)
    curves = [[x and [ALL, *[x] * 255] for x in of] for of in (p1, low, high)]
    columns: dict[str, Any] = {
        "design": numbers, "exact": [bound is None for bound in low], "p1": curves[0],
        "p2": [[1.0, *[0.9] * 255]] * len(p1), "hits": [[1] * 256] * len(p1),
        "p1_low": curves[1], "p1_high": curves[2],
    }  # fmt: skip
    kinds = {name: pa.list_(pa.float64(), 256) for name in ("p1", "p2", "p1_low", "p1_high")}
    kinds |= {"design": pa.int64(), "exact": pa.bool_(), "hits": pa.list_(pa.int32(), 256)}
    return pa.table({n: pa.array(list(v), kinds[n]) for n, v in columns.items()})


def test_what_may_be_on_the_front_is_what_none_beats_for_certain() -> None:
    """The greatest P1 one may have against the least of the others."""
    front = Front()
    front.add(bounded((0, 0.6, 0.4, 0.8), (1, 0.5, None, None), (2, 0.3, None, None)))
    assert sorted(front.pool.design) == [0, 1]
    assert front.points().design.tolist() == [0]
    assert not front.points().exact.any()
    # Made exact, it has less than was possible, and the other is on the front.
    front.add(bounded((0, 0.45, None, None)))
    assert front.points().design.tolist() == [1]
    assert front.points().exact.all()


def test_a_threshold_that_detects_most_of_what_is_flawless_is_no_point() -> None:
    """At P1 of 0.0175 half of it is, with this P2: 0.9 (1 / P1 - 1) of 1 / 0.01 - 1."""
    front = Front()
    front.add(bounded((0, 0.0179, None, None), (1, 0.0178, None, None)))
    assert front.points().design.tolist() == [0]
    front = Front()
    front.add(bounded((1, 0.0178, None, None)))
    assert not len(front.points().design)
    # Bounds of which one is on either side may be one, and beat nothing.
    front.add(bounded((2, 0.0178, 0.017, 0.03), (3, 0.0179, None, None)))
    assert front.pool.design.tolist() == [2, 3]


def test_of_heights_of_the_tunnel_not_all_are_counted_whole(
    opencl: OpenCLBackend, tmp_path: Path
) -> None:
    """All detect everything at low thresholds; made exact for that, none would be screened."""
    plan = Plan.of(gpuspec.example("trim"), {"tunnel.height_mm": "100:300:12"})
    runs = [sweep(replace(plan, samples=n), tmp_path / str(n), backend=opencl) for n in (0, 16_384)]
    assert 0 < runs[1].table(["exact"])["exact"].to_numpy().sum() < plan.designs / 2
    whole, screened = (choose(run).front for run in runs)
    for name in ("design", "level", "p1", "p2", "hits"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(screened, name))


def test_an_estimate_lies_within_its_bounds() -> None:
    scores = Scores.of(
        bounded((0, 0.9, 0.4, 0.8), (1, 0.1, 0.4, 0.8), (2, 0.5, 0.4, 0.8), (3, 0.9, None, None))
    )
    assert scores.p1[:, 7].tolist() == [0.8, 0.4, 0.5, 0.9]
    assert scores.exact[:, 7].tolist() == [False, False, False, True]


SHARES = st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])
"""Few values, so that many points are equal in something; no two F1 of them are equal but those of
the same pair."""


@given(
    st.lists(st.tuples(SHARES, SHARES, st.integers(0, 4)), min_size=1, max_size=20),
    st.sampled_from(["p1", "p2", "f1"]), SHARES, SHARES, SHARES,
)  # fmt: skip
def test_a_rule_asks_for_one_thing_after_another(
    points: list[tuple[float, float, int]], goal: Any, p2_floor: float, p1_floor: float,
    share: float,
) -> None:  # fmt: skip
    rule = Rule(goal, p2_floor, p1_floor, share)
    p1, p2, hits = (np.array(values) for values in zip(*points, strict=True))
    best = rule.best(p1, p2, hits, 4)
    assert best == np.argmax(asked_for(rule, p1, p2, hits, 4))
    fulfilled = hits[best] >= share * 4 and p2[best] >= p2_floor and p1[best] >= p1_floor
    assert rule.fulfilled(p1[best], p2[best], hits[best], 4) == fulfilled


@pytest.mark.parametrize(
    ("share", "seen", "needed"),
    [(0.5, 3, 2), (0.5, 4, 2), (0.34, 3, 2), (0.33, 3, 1), (0.7, 10, 7), (1.0, 7, 7), (0.0, 5, 0),
     (0.001, 5, 1)],
)  # fmt: skip
def test_a_share_of_the_defects_is_whole_defects_rounded_up(
    share: float, seen: int, needed: int
) -> None:
    rule = Rule(p2_floor=0.0, hit_share=share)
    assert rule.required(seen) == needed
    assert rule.fulfilled(1.0, 0.0, needed, seen)
    assert not needed or not rule.fulfilled(1.0, 1.0, needed - 1, seen)
    # Once enough are hit P1 decides, before that hits do.
    p1, hits = np.array([0.9, 0.8, 0.7]), np.array([max(needed - 1, 0), needed, needed + 1])
    assert rule.best(p1, p1, hits, seen) == (1 if needed else 0)


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        ((0.0, 0.0, 2), (1.0, 1.0, 1)),  # all defects are hit, whatever else is lost
        ((0.0, 0.85, 2), (1.0, 0.84, 2)),  # then P2 reaches its floor
        ((0.9, 0.85, 2), (0.8, 0.99, 2)),  # then P1 is the highest
        ((0.9, 0.95, 2), (0.9, 0.9, 2)),  # and P2 decides between equals
        ((0.1, 0.6, 2), (0.9, 0.5, 2)),  # a floor that none reaches is come near to
    ],
)
def test_the_paper_s_rule_is_all_defects_hit_then_a_floor_of_p2_then_the_highest_p1(
    better: tuple[float, float, int], worse: tuple[float, float, int]
) -> None:
    for pair, best in (((better, worse), 0), ((worse, better), 1)):
        assert Rule().best(*(np.array(values) for values in zip(*pair, strict=True)), 2) == best


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_the_choice_is_the_best_of_all_designs_at_all_thresholds(
    swept: dict[str, RunFolder], rule: Rule
) -> None:
    choice = choose(swept["exact"], rule)
    assert outcome(choice) == brute_force(swept["exact"], rule, choice.defects)


@pytest.mark.parametrize("name", ["exact", "even"])
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_a_screened_sweep_chooses_the_same(
    swept: dict[str, RunFolder], rule: Rule, name: str
) -> None:
    screened_name = {"exact": "screened", "even": "even screened"}[name]
    exact, screened = (choose(swept[n], rule) for n in (name, screened_name))
    assert screened.best == exact.best
    assert screened.best.exact
    others = range(min(len(exact.ranked.p1), 10))
    assert [screened.described(screened.ranked, n) for n in others] == [
        exact.described(exact.ranked, n) for n in others
    ]


def test_a_screened_sweep_leaves_designs_estimated(swept: dict[str, RunFolder]) -> None:
    """Else the test above would show nothing."""
    assert not everything(swept["screened"]).exact.all(axis=1).any()


@pytest.mark.parametrize("name", ["exact", "bits"])
@pytest.mark.parametrize("rule", RULES[:4], ids=str)
def test_the_chosen_station_reproduces_its_row(
    swept: dict[str, RunFolder], opencl: OpenCLBackend, rule: Rule, name: str
) -> None:
    choice = choose(swept[name], rule)
    score = gpuspec.simulate(choice.station(), opencl).score
    assert (score.p1, score.p2, score.defects_hit) == outcome(choice)[1:]
    assert 0.05 < score.p1 < 1  # neither all nor nothing is detected, whatever the threshold


def test_with_several_parts_the_station_has_the_first(
    swept: dict[str, RunFolder], opencl: OpenCLBackend
) -> None:
    choice = choose(swept["parts"])
    details = choice.details()
    score = gpuspec.simulate(choice.station(), opencl).score
    first = tuple(details[name][0] for name in ("part_p1", "part_p2", "part_hits"))
    assert (score.p1, score.p2, score.defects_hit) == first
    assert sum(details["part_hits"]) == choice.best.hits
    other = choose(swept["parts"], Rule(goal="p2", hit_share=0, p2_floor=0))
    assert "part_p1" not in other.details()  # the row is at another threshold


def test_a_threshold_that_detects_nothing_makes_no_station(swept: dict[str, RunFolder]) -> None:
    choice = choose(swept["even"], Rule(p2_floor=0, hit_share=0))
    assert choice.best.p2 == 0
    with pytest.raises(StationError, match="nothing is detected"):
        choice.station()


def test_maps_hold_the_best_of_each_pair(swept: dict[str, RunFolder]) -> None:
    run, rule = swept["exact"], Rule(goal="f1")
    choice = choose(run, rule)
    maps = Maps(run.plan, rule, choice.defects)
    for table in run.batches([*COLUMNS]):
        maps.add(table)
    (found,) = maps.of(["tunnel.dark_mm", "sequence.images"])
    points = everything(run).best(rule, choice.defects)
    assert found.goal.shape == (5, 4)
    for down, dark in enumerate(found.down.values):
        for across, images in enumerate(found.across.values):
            here = [
                n for n, design in enumerate(points.design)
                if run.plan.values(int(design))["tunnel.dark_mm"] == dark
                and run.plan.values(int(design))["sequence.images"] == images
            ]  # fmt: skip
            there = points.only(np.array(here))
            criteria = rule.criteria(there.p1, there.p2, there.hits, choice.defects)
            best = max(zip(*map(np.atleast_1d, criteria), strict=True))
            np.testing.assert_array_equal(found.criteria[down, across], best)


def test_a_map_tells_where_all_is_had_that_the_rule_asks_for(swept: dict[str, RunFolder]) -> None:
    down, across, *_ = swept["exact"].plan.axes
    rule = Rule(p2_floor=0.8, p1_floor=0.5)
    # Hits, P2 and P1, each cut off where it is enough; then what is to be highest.
    has = [(2, 0.8, 0.5), (1, 0.8, 0.5), (2, 0.7, 0.5), (2, 0.8, 0.4), (-np.inf,) * 3]
    criteria = np.array([[(*one, 0.9, 0.9, 0.9) for one in has]])
    kept = Map(down, across, criteria).kept(rule, 2)
    assert kept.tolist() == [[True, False, False, False, False]]


def pictures(run: RunFolder, rule: Rule) -> dict[str, Figure]:
    maps = Maps(run.plan, rule, most_defects(run))
    choice = choose(run, rule, maps.add)
    found = lines(choice)
    made = {
        "front": front_picture(choice),
        "sensitivity": diagrams.sensitivity_picture(choice, found),
    }
    mapped = maps.of([line.key for line in found if len(line.values) > 1])
    if mapped:
        made["maps"] = diagrams.maps_picture(choice, mapped)
    return made


OTHERS = ("screened", "single", "axis", "even", "wide", "five")
"""Sweeps beside the exact one, drawn under the usual rule, and under one that nothing fulfils."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rule"),
    [*product(["exact"], RULES), *product(OTHERS, [RULES[0], RULES[4]])],
    ids=str,
)
def test_every_picture_of_a_sweep_is_legible(
    swept: dict[str, RunFolder], name: str, rule: Rule
) -> None:
    for figure in pictures(swept[name], rule).values():
        check_legible(figure)


def test_a_picture_of_scores_says_which_way_is_good(swept: dict[str, RunFolder]) -> None:
    for figure in pictures(swept["exact"], Rule()).values():
        said = " ".join(text.get_text() for text in drawn_texts(figure))
        assert P1 in said
        assert BEST in said


@pytest.mark.slow
@pytest.mark.parametrize("lowest", [0.0, 0.5, 0.89, 0.996, 1.0])
def test_a_map_of_nearly_equal_designs_is_of_one_colour(
    swept: dict[str, RunFolder], lowest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A difference of 0.4 % is not drawn from one end of the colours to the other."""
    real = Map.goal.fget

    def squeezed(self: Map) -> np.ndarray:
        goal = real(self)
        span = np.nanmax(goal) - np.nanmin(goal)
        return 0.6 * (lowest + (1 - lowest) * (goal - np.nanmin(goal)) / span)

    monkeypatch.setattr(Map, "goal", property(squeezed))
    figure = pictures(swept["exact"], Rule(goal="f1", p2_floor=0.0, hit_share=0.0))["maps"]
    image = figure.axes[0].images[-1]
    low, high = image.get_clim()
    assert high == pytest.approx(0.6)
    assert low <= 0.9 * high + 1e-9
    assert low >= 0.75 * high - 1e-9
    said = " ".join(text.get_text() for text in drawn_texts(figure))
    assert f"{0.6 * lowest:.4f} to 0.6000 on these maps" in said


def test_lines_are_the_designs_that_differ_in_one_key(swept: dict[str, RunFolder]) -> None:
    choice = choose(swept["exact"])
    scores = everything(swept["exact"])
    level = int(choice.ranked.level[0])
    found = {line.key: line for line in lines(choice)}
    assert set(found) == set(VARY)
    changes = [np.ptp(line.own.p1) for line in lines(choice)]
    assert changes == sorted(changes, reverse=True)
    assert len(set(changes)) > 2
    for line in found.values():
        assert line.values[line.place] == choice.best.values[line.key]
        assert list(line.values) == sorted(line.values)
        own, held = line.own, line.held
        chosen = choice.best.p1, choice.best.p2, choice.best.hits
        for course in (own, held):
            assert (course.p1[line.place], course.p2[line.place], course.hits[line.place]) == chosen
        for place, value in enumerate(line.values):
            wanted = {**choice.best.values, line.key: value}
            (design,) = (n for n in scores.design if choice.plan.values(int(n)) == wanted)
            assert held.p1[place] == scores.p1[design, level]
            assert held.hits[place] == scores.hits[design, level]
            assert own.p1[place] in scores.p1[design]
        low, high = line.span(own)
        assert low <= line.values[line.place] <= high
        inside = (np.array(line.values) >= low) & (np.array(line.values) <= high)
        assert (own.p1[inside] >= 0.95 * choice.best.p1).all()
        assert (own.hits[inside] == choice.best.hits).all()


@pytest.mark.parametrize("rule", RULES[:3], ids=str)
def test_what_is_tolerated_reaches_from_the_chosen_value_to_the_first_that_falls_short(
    swept: dict[str, RunFolder], rule: Rule
) -> None:
    """Beyond a value that falls short others may do well again: a station set there would not."""
    choice = choose(swept["fine"], rule)
    best, (line,) = choice.best, lines(choice)
    again = False
    for course in (line.own, line.held):
        goal = {"p1": course.p1, "p2": course.p2, "f1": course.f1}[rule.goal]
        short = (course.hits < best.hits) | (goal < 0.95 * getattr(best, rule.goal))
        for name in ("p1", "p2"):
            floor = min(getattr(rule, f"{name}_floor"), getattr(best, name))
            short |= getattr(course, name) < 0.95 * floor
        places = np.arange(len(short))
        first = max(places[short & (places < line.place)], default=-1)
        last = min(places[short & (places > line.place)], default=len(short))
        assert np.array_equal(course.kept, (places > first) & (places < last))
        again |= not short[:first].all() if first > 0 else False
    assert again  # else a simpler rule would do


def test_a_design_whose_neighbours_all_fall_short_stands_alone(
    swept: dict[str, RunFolder],
) -> None:
    (line,) = lines(choose(swept["axis"]))
    assert line.alone
    assert line.tolerated(line.own) == f"only {line.values[line.place]}"
    (line,) = lines(choose(swept["single"]))
    assert not line.alone


@pytest.mark.parametrize(
    ("value", "text"),
    [(8, "8"), (2.5, "2.5"), (0.000123, "0.000123"), (12345678, "12345678"), (1e7, "10000000"),
     (4.333333333, "4.33333"), (1e-9, "1e-09"), (-3.0, "-3")],
)  # fmt: skip
def test_a_value_is_written_without_an_exponent_where_it_can(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.slow
@pytest.mark.parametrize("columns", [40, 60, 80])
@pytest.mark.parametrize("name", ["exact", "wide", "five"])
def test_front_breaks_no_number_on_a_narrow_terminal(
    gpuspec_: Command, swept: dict[str, RunFolder], name: str, columns: int, monkeypatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    arguments = ("front", swept[name].path, "-o", "out", "--no-pictures")
    wide = gpuspec_(*arguments).out
    monkeypatch.setenv("COLUMNS", str(columns))
    narrow = gpuspec_(*arguments).out
    told, again = (
        set(re.findall(r"\d[\d.]*", out.partition("next on the front")[0]))
        for out in (wide, narrow)
    )
    assert told == again
    assert "…" not in narrow
    rows = narrow.partition("hits \n")[2].splitlines()[:-1]
    assert len(rows) >= 2
    for row in rows:
        assert re.fullmatch(r"[\d.e+ -]+", row), row
        assert len(re.findall(r" [01]\.\d{3} ", row.replace(" ", "  "))) >= 3


def test_keys_of_one_name_keep_their_sections() -> None:
    keys = ["tunnel.height_mm", "camera.height_mm", "tunnel.dark_mm"]
    assert _short(keys) == [*keys[:2], "dark_mm"]


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("tunnel.dark_mm", "tunnel dark, mm"),
        ("defects[1].depth_um", "defects[1] depth, µm"),
        ("sensor.saturation_e", "sensor saturation, e⁻"),
        ("sensor.bit_depth", "sensor bit depth"),
        ("sequence.images", "sequence images"),
    ],
)
def test_axes_say_the_unit_of_their_key(key: str, text: str) -> None:
    assert label(key) == text


def front_of(gpuspec_: Command, run: RunFolder, *options: object) -> tuple[str, dict[str, Any]]:
    ran = gpuspec_("front", run.path, "-o", "out", "--force", *options)
    assert ran.code == 0, ran.err
    return ran.out, json.loads(Path("out/chosen.json").read_text("utf-8"))


def test_a_table_of_before_there_were_notes_is_chosen_from(swept, monkeypatch) -> None:
    choice = choose(swept["exact"])
    assert choice.notes == []

    read = RunFolder.read_file

    def without(self: RunFolder, part: int, columns: Any = None) -> Any:
        if "notes" in columns:
            raise OutputError("No match for FieldRef.Name(notes)")
        return read(self, part, columns)

    monkeypatch.setattr(RunFolder, "read_file", without)
    assert replace(choice).notes == []


@pytest.mark.slow
def test_front_writes_what_it_chose_and_simulate_reproduces_it(
    gpuspec_: Command, swept: dict[str, RunFolder]
) -> None:
    out, content = front_of(gpuspec_, swept["exact"], "--write", "best.toml", "--goal", "f1")
    chosen = content["chosen"]
    assert "all defects hit, P2 at least 0.85, then the highest F1" in out
    assert f"design {chosen['design']}" in out
    assert f"{chosen['p1']:.4f}" in out
    assert content["fulfilled"]
    assert content["backend"] == "opencl"
    assert names(Path("out")) == CHOSEN_FILES | PICTURES
    assert not hidden(Path())
    for name in PICTURES:
        with Image.open(Path("out", name)) as picture:
            assert picture.width == 1500
    again = gpuspec_("simulate", "best.toml", "--backend", "opencl", "--no-pictures")
    assert again.code == 0, again.err
    score = json.loads(Path("run/score.json").read_text("utf-8"))["score"]
    assert [score[k] for k in ("p1", "p2", "f1", "defects_hit")] == [
        chosen[k] for k in ("p1", "p2", "f1", "hits")
    ]
    assert "exists already" in said(gpuspec_("front", swept["exact"].path, "-o", "out", "--write",
                                             "best.toml", "--no-pictures"))  # fmt: skip


def test_front_writes_the_whole_front(gpuspec_: Command, swept: dict[str, RunFolder]) -> None:
    _, content = front_of(gpuspec_, swept["screened"], "--no-pictures")
    assert names(Path("out")) == CHOSEN_FILES
    with Path("out/front.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    front = Front()
    for table in swept["exact"].batches():
        front.add(table)
    points = front.points()
    assert [int(row["design"]) for row in rows] == points.design.tolist()
    assert [float(row["p1"]) for row in rows] == points.p1.tolist()
    assert {row["exact"] for row in rows} == {"yes"}
    chosen = content["chosen"]
    assert any(
        float(row["p1"]) == chosen["p1"] and float(row["threshold_dn"]) == chosen["threshold_dn"]
        for row in rows
    )
    with Path("out/sensitivity.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["key"] for row in rows if row["chosen"] == "yes"] == list(
        dict.fromkeys(row["key"] for row in rows)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single", "axis", "even", "invalid", "parts"])
def test_front_draws_whatever_was_swept(
    gpuspec_: Command, swept: dict[str, RunFolder], name: str
) -> None:
    out, _ = front_of(gpuspec_, swept[name])
    drawn = names(Path("out")) & PICTURES
    assert drawn == (PICTURES - {"maps.png"} if name in ("single", "axis") else PICTURES)
    assert ("no valid station" in out) == (name == "invalid")
    assert ("a station file holds the first part" in out) == (name == "parts")


def test_front_says_what_no_design_fulfils(gpuspec_: Command, swept: dict[str, RunFolder]) -> None:
    floors = "--p2-floor", 0.9, "--p1-floor", 1
    out, content = front_of(gpuspec_, swept["exact"], "--no-pictures", *floors)
    chosen = content["chosen"]
    note = "no design that hits all 2 defects and has P2 of 0.9 reaches P1 1; the highest"
    assert f"{note}, {chosen['p1']:.4f}, is chosen" in out
    assert not content["fulfilled"]
    suggested = out.partition("--p1-floor ")[2].partition(".\n")[0]
    floors = "--p2-floor", 0.9, "--p1-floor", suggested
    out, content = front_of(gpuspec_, swept["exact"], "--no-pictures", *floors)
    assert "no design" not in out
    assert content["chosen"] == chosen


def test_front_says_how_many_defects_can_be_hit(tmp_path: Path, opencl: OpenCLBackend) -> None:
    # The camera's opening in the tunnel hides the shallow dent, but not the whole scratch.
    station = Station.parse(STATION + SCRATCH, "s.toml")
    hidden_dent = station.replace(
        **{
            "tunnel.opening_length_mm": 8.0,
            "tunnel.opening_width_mm": 12.0,
            "defects[1].depth_um": 0.5,
        }
    )
    run = sweep(Plan.of(hidden_dent, {"sensor.exposure": [2, 4]}), tmp_path / "run", backend=opencl)
    choice = choose(run)
    assert choice.best.hits == 1
    assert choice.shortfall is not None
    assert "no design hits all 2 defects; the most is 1" in choice.shortfall
    assert choice.shortfall.endswith("--hit-share 0.5.")
    assert choose(run, Rule(hit_share=0.5, p2_floor=0)).shortfall is None


def test_front_says_how_many_defects_no_image_has(tmp_path: Path, opencl: OpenCLBackend) -> None:
    (dent,) = Station.parse(STATION, "s.toml").defects
    under = Station.parse(STATION, "s.toml").replace(defects=[dent, dent])
    assert simulate(under, opencl).score.unseen == 1
    run = sweep(Plan.of(under, {"sensor.exposure": [2, 4]}), tmp_path / "run", backend=opencl)
    told = [note for note in choose(run).notes if "no pixel of their own" in note]
    assert told[0].startswith("1 of 2 defects")


@pytest.mark.slow
def test_front_of_an_unfinished_sweep_says_what_is_missing(
    gpuspec_: Command, swept: dict[str, RunFolder]
) -> None:
    shutil.copytree(swept["exact"].path, "half")
    half = RunFolder.read("half")
    half.file(1).unlink()
    out, content = front_of(gpuspec_, half)
    assert "128 of 640 designs are missing" in out
    assert content["missing"] == 128
    assert content["chosen"]["design"] < 512
    half.file(0).unlink()
    assert "holds no designs yet" in said(gpuspec_("front", "half", "-o", "out"))


def test_front_of_a_screening_that_was_stopped_says_that_p1_is_a_bound(
    gpuspec_: Command, opencl: OpenCLBackend, swept: dict[str, RunFolder]
) -> None:
    plan = swept["even screened"].plan
    bench = Bench(plan, opencl)
    with RunFolder.writing("stopped", plan) as run:
        for part in range(run.files):
            run.write(part, bench.rows(run.designs_of(part), sampled=True))
    out, content = front_of(gpuspec_, run, "--no-pictures")
    exact = choose(swept["even"])
    assert "stopped before the front was made exact" in out
    assert content["chosen"]["p1"] >= exact.best.p1


def test_front_refuses_what_is_no_sweep_in_one_sentence(
    gpuspec_: Command, swept: dict[str, RunFolder]
) -> None:
    assert "holds no sweep" in said(gpuspec_("front", "nowhere"))
    shutil.copytree(swept["axis"].path, "damaged")
    damaged = RunFolder.read("damaged")
    damaged.file(0).write_bytes(b"PAR1")
    assert "is damaged" in said(gpuspec_("front", "damaged"))
    assert not Path("damaged/front").exists()
    wrong = said(gpuspec_("front", swept["axis"].path, "--goal", "p3"))
    assert "there is no 'p3' to choose by; did you mean p2?" in wrong
    assert "must be a number from 0 to 1" in said(
        gpuspec_("front", swept["axis"].path, "--p2-floor", "2")
    )


def test_front_writes_beside_the_sweep_and_leaves_it_as_it_was(
    gpuspec_: Command, swept: dict[str, RunFolder], opencl: OpenCLBackend
) -> None:
    shutil.copytree(swept["axis"].path, "run")
    before = {path.name for path in Path("run").iterdir()}
    ran = gpuspec_("front", "run", "--no-pictures")
    assert ran.code == 0, ran.err
    assert {path.name for path in Path("run").iterdir()} == before | {"front"}
    sweep(swept["axis"].plan, "run", backend=opencl)  # still the same sweep, and finished


def test_a_front_by_another_rule_or_of_another_sweep_is_not_replaced_without_a_word(
    gpuspec_: Command, swept: dict[str, RunFolder]
) -> None:
    command = "front", swept["axis"].path, "--no-pictures", "-o", "out"
    assert gpuspec_(*command).code == 0
    before = content(Path("out"))
    assert gpuspec_(*command).code == 0
    told = said(gpuspec_(*command, "--goal", "f1"))
    assert "out holds a front of another rule: all defects hit" in told
    assert "or --force" in told
    assert "a front of another sweep" in said(
        gpuspec_("front", swept["single"].path, "--no-pictures", "-o", "out")
    )
    assert content(Path("out")) == before
    ran = gpuspec_(*command, "--goal", "f1", "--force")
    assert ran.code == 0
    assert "F1" in json.loads(Path("out/chosen.json").read_text("utf-8"))["rule"]
    Path("best.toml").write_text("mine", encoding="utf-8")
    assert "best.toml exists already" in said(
        gpuspec_(*command, "--goal", "p2", "-o", "new", "--write", "best.toml")
    )
    assert not Path("new").exists()


def test_fronts_by_several_rules_stand_beside_each_other(
    gpuspec_: Command, swept: dict[str, RunFolder]
) -> None:
    shutil.copytree(swept["axis"].path, "run")
    rules = {"front": "p1", "front-2": "f1", "front-3": "p2"}
    for _ in range(2):
        for name, goal in rules.items():
            ran = gpuspec_("front", "run", "--no-pictures", "--goal", goal)
            assert ran.code == 0
            assert f"in run/{name}\n" in ran.out
            assert ("note: run/front holds a front by another rule" in ran.out) == (goal != "p1")
    for name, goal in rules.items():
        rule = json.loads(Path("run", name, "chosen.json").read_text("utf-8"))["rule"]
        assert goal.upper() in rule.rpartition("highest")[2]


def test_a_front_keeps_the_users_files(gpuspec_: Command, swept: dict[str, RunFolder]) -> None:
    Path("out").mkdir()
    Path("out/front.png").write_text("mine", encoding="utf-8")
    command = "front", swept["axis"].path, "--no-pictures", "-o", "out"
    assert "out/front.png is in the way" in said(gpuspec_(*command))
    assert gpuspec_(*command, "--force").code == 0
    assert Path("out/front.png").read_text("utf-8") == "mine"


def test_the_share_detected_by_chance_is_that_of_all_parts_together(
    swept: dict[str, RunFolder], opencl: OpenCLBackend
) -> None:
    choice = choose(swept["parts"], Rule(p2_floor=0.99))
    (told,) = [note for note in choice.notes if "hit by chance" in note]
    false = flawless = 0
    for part in range(3):
        result = simulate(with_part(choice.station(), part), opencl)
        false += result.score.false_px
        flawless += result.truth.size - result.score.zone_px
    assert told.startswith(f"{100 * false / flawless:.3g} % of the flawless surface")


def test_a_chosen_design_that_detects_nearly_everything_is_told_so(
    swept: dict[str, RunFolder],
) -> None:
    chosen = [choose(swept[name], Rule(p2_floor=0.5)) for name in ("even", "exact", "five")]
    told = {any("hit by chance" in note for note in choice.notes) for choice in chosen}
    assert told == {True, False}
    for choice in chosen:
        best, station = choice.best, choice.station()
        score = gpuspec.simulate(station).score
        share = score.false_px / (station.shape[0] * station.shape[1])
        assert any("hit by chance" in note for note in choice.notes) == (share > 0.1), best
