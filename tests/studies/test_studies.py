"""The studies the paper speaks of: laws first, then the engine, then the commands."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import STATION, content, hidden, names, said
from legible import check_legible, drawn_texts
from scenes import check_station
from tolerances import (
    BACKEND_P2,
    CROWN_MOVED,
    DISTANCE_MM,
    EDGE_MM,
    FALLS_WITH_DISTANCE,
    FOLD,
    FORCE,
    GRADIENT,
    LEVELS_OFF,
    LIGHT_POINT,
    OPENING_AREA,
    SIGNATURE_DIGITS,
    SIGNATURE_IMAGES,
)

from gpuspec.errors import OutputError, StationError
from gpuspec.files import MANIFEST
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.simulation.at_threshold import AtThreshold
from gpuspec.simulation.simulate import simulate, trace
from gpuspec.station.corners import INSIDE
from gpuspec.station.examples import example
from gpuspec.station.materials import MATERIALS
from gpuspec.station.station import Station
from gpuspec.studies import coverage, height, movements, signature, threshold, tolerance
from gpuspec.studies.deflection import (
    Dent,
    dents,
    hardest,
    magnification,
    signature_width,
    strength,
)
from gpuspec.studies.outcome import files
from gpuspec.sweeps.trying.confirm import confirm_all
from gpuspec.words import BEST, P1, P2

PAPER = Dent(diameter_mm=1.0, depth_um=10.0)
STUDIES = ("signature", "height", "coverage", "tolerance", "threshold")


@pytest.fixture(scope="module")
def small() -> Station:
    """12 x 6 mm with one dent, 120 x 60 pixels."""
    return Station.parse(STATION, "s.toml")


# ------------------------------------------------------------------------------------- signature


@pytest.mark.parametrize(
    ("distance", "width"),
    [(0, 2.588), (1, 2.415), (2, 2.263), (4, 1.995), (8, 1.518), (12, 1.031), (16, 0.25), (18, 0)],
)
def test_the_closed_form_has_the_widths_of_the_model(distance, width):
    station = Station.from_dict({"tunnel": {"height_mm": 100.0}})
    force = strength(PAPER, station)
    assert force == pytest.approx(28.4, abs=FORCE)
    assert signature_width([distance], force)[0] == pytest.approx(width, abs=SIGNATURE_DIGITS)


@pytest.mark.parametrize("force", [5.0, 28.4, 300.0])
def test_a_signature_begins_at_the_fold_and_vanishes_near_a_over_root_e_less_one(force):
    fold = math.sqrt(2 * math.log(force))
    vanishing = force / math.sqrt(math.e) - 1
    begin, before, after = signature_width([0, vanishing - 0.01, 1.02 * vanishing + 0.1], force)
    assert begin == pytest.approx(fold, abs=FOLD)
    assert before > 0
    assert after == 0


def test_a_dent_that_does_not_fold_the_light_has_no_signature():
    assert not signature_width(np.linspace(0, 3, 20), 1.0).any()
    faint = Dent(4.0, 0.5)
    outcome = signature.study(check_station(), faint, 5, "numpy")
    assert outcome.strength < 1
    assert not outcome.simulated.any()
    assert "too faint" in outcome.findings()[0]


def test_widths_in_the_images_follow_the_closed_form(backend):
    outcome = signature.study(backend=backend, distances=23)
    assert outcome.dent == PAPER
    assert outcome.closed_form[0] > 2.5
    assert outcome.closed_form[-1] == outcome.simulated[-1] == 0
    assert outcome.largest_difference < SIGNATURE_IMAGES


@pytest.mark.parametrize("radius", [300.0, 2000.0, -2000.0])
@pytest.mark.parametrize("surface", ["orientation", "height"])
def test_a_crown_changes_the_scale_and_not_the_law(opencl, radius, surface):
    station = example("trim").replace(
        **{"part.crown_radius_x_mm": radius, "part.surface": surface}
    )  # fmt: skip
    outcome = signature.study(station, distances=12, backend=opencl)
    assert outcome.dent == hardest(station)
    assert outcome.largest_difference < SIGNATURE_IMAGES


def test_the_light_that_a_pixel_sees_does_not_change_the_signature(opencl):
    # Opening, pupil, roughness, exposure and noise are the sensor's and light's, not the dent's.
    station = example("trim").replace(
        **{
            "tunnel.opening_length_mm": 20.0, "tunnel.opening_width_mm": 20.0,
            "part.roughness_rad": 0.01, "part.material": "lacquer", "sensor.noise": True,
            "sequence.fusion": "differential", "sequence.lag": 3, "camera.subsampling": 2,
        }
    )  # fmt: skip
    outcome = signature.study(station, distances=6, backend=opencl)
    plain = signature.study(example("trim"), distances=6, backend=opencl)
    assert np.array_equal(outcome.simulated, plain.simulated)


@pytest.mark.parametrize(
    ("changes", "dent", "why"),
    [
        ({}, Dent(0.1, 100.0), "small slopes"),
        ({"part.length_mm": 2.0}, Dent(3.0, 10.0), "does not fit on part.length_mm = 2"),
        ({"defects": []}, None, "no dent, bump or scratch to study"),
        ({"part.crown_radius_x_mm": -200.0}, PAPER, "so hollow"),
    ],
)
def test_a_signature_that_has_no_law_is_refused(changes, dent, why):
    station = check_station().replace(**changes)
    with pytest.raises(StationError, match=why):
        signature.study(station, dent, 5, "numpy")


# ---------------------------------------------------------------------------------------- height


def test_far_away_the_light_point_moves_as_the_closed_form_says():
    outcome = height.study(example("trim"), distances=9)
    far = outcome.camera_mm > 4000
    assert far.any()
    for moved, estimate in (
        (outcome.by_slope_mm, outcome.slope_estimate_mm),
        (outcome.by_height_mm, outcome.height_estimate_mm),
    ):
        assert moved[far] == pytest.approx(estimate[far], rel=LIGHT_POINT)


def test_what_height_adds_falls_with_the_distance_of_the_camera():
    outcome = height.study(example("trim"), PAPER, distances=12)
    assert (np.diff(outcome.by_height_mm) < 0).all()
    # By slope it tends to a constant, by height to the field angle's share of it.
    first, last = outcome.by_height_mm[[-2, -1]]
    near, far = outcome.camera_mm[[-2, -1]]
    assert last / first == pytest.approx(near / far, rel=FALLS_WITH_DISTANCE)
    assert np.ptp(outcome.by_slope_mm[-2:]) < LEVELS_OFF * outcome.by_slope_mm[-1]


def test_the_claim_of_the_paper_is_judged_and_not_assumed():
    far, near = example("trim"), example("trim").replace(**{"camera.height_mm": 310.0})
    outcome = height.study(far, distances=9)
    assert outcome.negligible
    assert "holds for this station" in outcome.findings()[-1]
    outcome = height.study(near, distances=9)
    assert not outcome.negligible
    assert outcome.negligible_from_mm > 310
    # From there on at every height tried, not only at the next.
    ones, none = np.ones(5), np.zeros(5)
    uneven = replace(
        outcome, camera_mm=np.arange(200.0, 700.0, 100.0), by_slope_mm=ones,
        by_height_mm=np.array([0.5, 1e-6, 0.5, 1e-6, 1e-6]), shape_by_slope_mm=none,
        shape_by_height_mm=none,
    )  # fmt: skip
    assert uneven.negligible_from_mm == 500
    said = "of the camera heights tried it holds from 500 mm on, and not at 400 mm."
    assert said in uneven.findings()[-1]
    never = replace(uneven, by_height_mm=0.5 * ones)
    assert never.negligible_from_mm is None
    assert "it holds at none of the camera heights tried" in never.findings()[-1]
    # Where the dent moves the light by slope alone, a crown may still move it by height.
    plain = replace(uneven, by_height_mm=1e-6 * ones)
    crowned = replace(plain, shape_by_slope_mm=ones, shape_by_height_mm=0.5 * ones)
    assert plain.negligible
    assert not crowned.negligible
    assert "does not hold for this station" in outcome.findings()[-1]
    assert 'part.surface = "height"' in outcome.findings()[-1]


@pytest.mark.parametrize("camera_mm", [305.0, 800.0])
def test_where_the_claim_holds_at_every_height_tried_no_least_one_is_told(camera_mm):
    # By a thousandth: the lowest height that is tried says nothing of a limit.
    found = height.study(
        example("trim").replace(
            camera__height_mm=camera_mm, part__length_mm=20.0, defects=(), populations=()
        ),
        Dent(1.0, 1.0), distances=5,
    )  # fmt: skip
    assert found.worst_ratio.max() < height.NEGLIGIBLE / 10
    lowest = min(camera_mm, 315.0)
    said = f"it holds at every camera height tried, from {lowest:.0f} mm on."
    assert found.findings()[-1].endswith(said)


def test_a_crown_is_compared_with_a_flat_part():
    flat = height.study(example("trim"), PAPER, distances=3)
    assert not flat.crowned
    assert not any("crown" in finding for finding in flat.findings())
    crowned = height.study(
        example("trim").replace(**{"part.crown_radius_x_mm": 500.0}), PAPER, distances=3
    )
    assert crowned.crowned
    assert np.array_equal(crowned.by_height_mm, flat.by_height_mm)  # the dent lies on a flat part
    assert len(crowned.table()[0]) == len(flat.table()[0]) + 3
    # At x = L/2 the crown's slope moves the light by about 2 H x / R.
    moved = 2 * 300 * 98 / 500
    assert crowned.shape_by_slope_mm[-1] == pytest.approx(moved, rel=CROWN_MOVED)
    assert "crown moves it" in crowned.findings()[1]


# -------------------------------------------------------------------------------------- coverage


def test_distances_to_the_transitions_are_those_of_a_search_over_all():
    station = check_station(
        tunnel__luminous_mm=3.0, tunnel__dark_mm=7.3, sequence__images=6, sequence__step_mm=1.3
    )
    light = np.random.default_rng(1).uniform(-60, 60, 500)
    shifts = np.arange(6) * 1.3
    edges = np.concatenate([shifts, shifts + 3.0])[:, None] + 10.3 * np.arange(-10, 10)
    expected = np.abs(light[:, None] - edges.ravel()).min(axis=1)
    assert coverage.transition_distance(light, station) == pytest.approx(expected, abs=EDGE_MM)


def test_a_transition_lies_where_the_light_changes(backend):
    # Seen by the images themselves: a pixel is lit in part where an edge is within its footprint.
    station = example("trim").replace(
        **{"camera.columns": 400, "camera.rows": 1, "sequence.images": 1, "camera.pupil_mm": 0.0,
           "sequence.step_mm": 1.0, "defects": [], "populations": [], "sensor.exposure": 1.0}
    )  # fmt: skip
    light_map = backend.trace(station)
    share = light_map.image(0)[0] / 255
    distance = coverage.transition_distance(light_map.read().light_mm[0, 0], station)
    half = light_map.read().footprint_mm[0, 0] / 2
    assert (distance[(share > 0.01) & (share < 0.99)] < half.max()).all()
    assert np.isin(np.round(share[distance > half + DISTANCE_MM], 3), (0, 1)).all()


@pytest.mark.slow
def test_on_a_flat_part_the_distances_keep_one_scale(backend):
    station = example("trim").replace(**{"camera.sampling_mm": 0.5})
    outcome = coverage.study(station, backend=backend)
    assert magnification(station) == 1 + 300 / 800
    assert outcome.on_light_mm == pytest.approx(1.375 * outcome.on_part_mm, rel=GRADIENT)
    # 40 steps of 0.2 mm bring an edge within half a step of any point.
    assert 0.05 < outcome.on_light_mm.max() < 0.1 + DISTANCE_MM
    assert outcome.blind == 0
    assert outcome.counts == (400 * 100, 0, 0, 0)


def test_the_scan_rule_is_what_leaves_no_pixel_blind(opencl):
    # Equal stripes and an even number of steps per stripe: both edges pass the same places.
    station = example("trim").replace(
        **{"tunnel.luminous_mm": 4.0, "tunnel.dark_mm": 4.0, "camera.sampling_mm": 0.1}
    )
    blind = {}
    for images in (2, 4, 8):
        outcome = coverage.study(station.replace(**{"sequence.images": images}), backend=opencl)
        kept = 8.0 / images <= outcome.largest_step_mm
        assert kept == (images >= outcome.images_needed)
        assert kept == ("keep it" in outcome.findings()[-1])
        blind[images] = outcome.blind
    assert outcome.images_needed == 4
    assert blind[4] == blind[8] == 0
    assert blind[2] > 0.04


def test_pixels_are_blind_where_no_transition_comes_or_no_light_is_seen(opencl):
    station = example("trim").replace(
        **{
            "sequence.images": 4, "sequence.step_mm": 1.0, "camera.sampling_mm": 0.25,
            "tunnel.opening_length_mm": 40.0, "tunnel.opening_width_mm": 20.0,
            "camera.columns": 900,
        }
    )  # fmt: skip
    outcome = coverage.study(station, backend=opencl)
    scanned, far, lost, beside = outcome.counts
    assert beside == 100 * 200  # 12.5 mm on either side of the part
    opening = 40 * 20 / 1.375**2 / 0.25**2
    assert lost == pytest.approx(opening, rel=OPENING_AREA)
    assert far > 0
    assert scanned + far + lost == 800 * 200
    assert outcome.blind == (far + lost) / (800 * 200)
    assert np.isnan(outcome.on_part_mm[outcome.kind >= coverage.LOST_LIGHT]).all()
    assert (outcome.on_part_mm[outcome.kind == coverage.SCANNED] <= outcome.reach_mm).all()
    assert (outcome.on_part_mm[outcome.kind == coverage.TOO_FAR] > outcome.reach_mm).all()


def test_defects_do_not_change_the_coverage(opencl, small):
    dent = dents(small)[0]
    flawless = coverage.study(small.replace(defects=[]), dent, opencl)
    assert np.array_equal(flawless.on_light_mm, coverage.study(small, None, opencl).on_light_mm)


def test_no_step_is_small_enough_for_a_defect_too_faint(opencl, small):
    outcome = coverage.study(small, Dent(4.0, 0.5), opencl)
    assert outcome.reach_mm == 0
    assert outcome.images_needed is None
    assert outcome.blind > 0.99
    assert "allows no step" in outcome.findings()[-1]


# ------------------------------------------------------------------------------------- tolerance


@pytest.fixture(scope="module")
def populated(small) -> Station:
    """Two dents and a scratch, of populations, too; images enough for a low threshold."""
    return small.replace(
        sequence__images=40,
        populations=[
            {"kind": "dent", "count": 1, "seed": 3, "diameter_mm": 0.6, "depth_um": 6.0},
            {"kind": "scratch", "count": 1, "width_mm": 0.3, "length_mm": 2.0, "depth_um": 4.0},
        ],
    )


@pytest.fixture(scope="module")
def tolerated(populated) -> tolerance.Tolerance:
    return tolerance.study(populated, steps=3, offset_mm=0.5, height_mm=3.0, backend="numpy")


@pytest.mark.slow
@pytest.mark.parametrize("size", [(12.0, 6.0), (5.0, 150.0), (150.0, 5.0)], ids=str)
def test_every_study_s_picture_is_legible_whatever_the_part(small, size):
    station = small.replace(
        part__length_mm=size[0], part__width_mm=size[1], tunnel__height_mm=300.0,
        tunnel__luminous_mm=2.0, tunnel__dark_mm=6.0, sequence__images=20,
        defects=[{"kind": "dent", "x_mm": 0.1, "y_mm": 0.1, "diameter_mm": 1.0, "depth_um": 8.0}],
    )  # fmt: skip
    for found in (
        coverage.study(station), height.study(station, distances=5),
        signature.study(station, distances=5),
        tolerance.study(station, steps=3, offset_mm=0.1, rotation_rad=0.001),
        threshold.study(station, 20), threshold.study(station.replace(segmentation__threshold=99)),
    ):  # fmt: skip
        check_legible(found.figure())


def test_the_tolerance_says_which_way_is_good(tolerated):
    said = " ".join(text.get_text() for text in drawn_texts(tolerated.figure()))
    for told in (said, tolerated.findings()[0]):
        assert P1 in told
        assert P2 in told
        assert BEST in told


def test_the_nominal_score_is_that_of_the_station(populated, tolerated):
    result = simulate(populated, "numpy")
    assert tolerated.nominal == result.score
    assert tolerated.threshold_dn == result.threshold
    assert len(tolerated.station.defects) == 3
    assert not tolerated.station.populations


def test_nothing_moved_changes_nothing(tolerated):
    for perturbation in tolerated.perturbations:
        assert perturbation.scores[perturbation.nominal] == tolerated.nominal, perturbation.name


def test_each_thing_that_can_change_is_tried(tolerated):
    names = {perturbation.name: perturbation for perturbation in tolerated.perturbations}
    assert set(names) == {
        "part along x", "part along y", "part about x", "part about y", "part about z", "part up",
        "tunnel up", "camera up", "camera about x", "camera about y", "reflectivity", "material",
    }  # fmt: skip
    assert names["part along x"].values == (-0.5, 0.0, 0.5)
    assert names["camera up"].values == (-3.0, 0.0, 3.0)
    assert names["reflectivity"].values == pytest.approx((-30, 0, 30))
    assert names["material"].values == tuple(MATERIALS)
    assert len(tolerated.findings()) == 1 + len(names)
    least = tolerated.numbers()["least"]
    for name, one in names.items():
        p2 = [score.p2 for score in one.scores if score.p2 is not None]  # some out of the view
        expected = min(s.p1 for s in one.scores), min(p2), min(s.defects_hit for s in one.scores)
        assert tuple(least[name].values()) == expected
    assert any(len({score.p2 for score in one.scores}) > 1 for one in names.values())


def test_a_change_of_reflectivity_is_one_of_exposure(tolerated):
    (changed,) = [p for p in tolerated.perturbations if p.name == "reflectivity"]
    brighter = tolerated.station.replace(
        **{"sensor.exposure": 1.3 * tolerated.station.sensor.exposure}
    )
    assert simulate(brighter, "numpy").score == changed.scores[-1]
    darker, nominal, brighter = changed.scores
    assert darker.p2 <= nominal.p2 <= brighter.p2
    assert darker.p1 > nominal.p1 > brighter.p1  # ever more of what surrounds the zones is detected


def test_the_threshold_is_held(populated, tolerated):
    dull = populated.replace(**{"part.material": "lacquer"})
    (material,) = [p for p in tolerated.perturbations if p.name == "material"]
    assert simulate(dull, "numpy").threshold < tolerated.threshold_dn
    assert material.scores[material.values.index("lacquer")].p2 == 0


def test_a_part_moved_aside_keeps_its_view_and_its_defects(populated):
    station = movements.frozen(populated)
    moved = movements.posed(station, 5.0, "part", "shift_x_mm")
    assert moved.shape == station.shape
    assert moved.defects == station.defects
    zones, there = (Truth.of(one, Relief.of(one)).labels for one in (station, moved))
    columns = round(5.0 / station.camera.sampling_mm)
    assert np.array_equal(zones[:, :-columns], there[:, columns:])
    # One moved out of view is neither an error nor forgotten.
    assert simulate(moved, "numpy").score.defects == 3
    assert simulate(moved, "numpy").score.unseen >= 1


def test_a_movement_adds_to_the_pose_and_its_contrary_takes_it_back(populated):
    for name, unit, _, moved in movements.movements():
        by = 0.003 if unit == "rad" else 0.5
        there = moved(populated, by)
        assert there != populated, name
        for body in ("part", "camera"):
            pose = getattr(moved(there, -by), body).pose
            assert pose is None or not any(abs(v) > 1e-12 for v in pose.model_dump().values())
    twice = movements.posed(
        movements.posed(populated, 0.1, "part", "tilt_x_deg"), 0.2, "part", "tilt_x_deg"
    )
    assert twice.part.pose.tilt_x_deg == pytest.approx(np.degrees(0.3))


def test_a_tilted_part_is_scored_on_its_own_zones(tolerated):
    (tilt,) = [p for p in tolerated.perturbations if p.name == "part about y"]
    assert tilt.values == (-0.005, 0.0, 0.005)
    nominal = tolerated.nominal
    assert tilt.scores[1].p2 == pytest.approx(nominal.p2, abs=BACKEND_P2)
    assert tilt.scores[0] != tilt.scores[2]


def test_a_camera_raised_keeps_its_pixels_and_their_angles(small):
    raised = movements.camera_raised(small, 80.0)
    assert raised.shape == small.shape
    angles = [s.camera.sampling_mm / s.camera.height_mm for s in (raised, small)]
    assert angles[0] == pytest.approx(angles[1])


def test_an_arch_is_raised_by_its_radius(small):
    arch = small.replace(**{"tunnel.section": "arch", "tunnel.radius_mm": 150.0})
    assert movements.tunnel_raised(arch, 2.0).tunnel.radius_mm == 152


def test_a_design_keeps_its_score_on_every_backend(device_backend, tolerated):
    outcome = tolerance.study(
        tolerated.station, steps=3, offset_mm=0.5, height_mm=3.0, backend=device_backend
    )
    for mine, its in zip(outcome.perturbations, tolerated.perturbations, strict=True):
        assert mine.hit == pytest.approx(its.hit), mine.name
        assert mine.p2 == pytest.approx(its.p2, abs=BACKEND_P2, nan_ok=True), mine.name


@pytest.mark.parametrize(
    ("changes", "options", "why"),
    [
        ({"defects": []}, {}, "no defect in view, so that P2 is undefined"),
        ({"segmentation.threshold": 250.0}, {}, "detects no defect at its threshold of 250 DN"),
        ({}, {"steps": 4}, "steps = 4 must be odd"),
        ({}, {"offset_mm": 0.0}, "offset_mm = 0 must be greater"),
        ({}, {"reflectivity": 1.0}, "reflectivity = 1 must be greater than 0 and at most 0.99"),
        ({}, {"height_mm": 200.0}, "tunnel up by -200 mm is too far: s.toml: tunnel.height_mm"),
    ],
)
def test_a_tolerance_that_says_nothing_is_refused(small, changes, options, why):
    with pytest.raises(StationError, match=why):
        tolerance.study(small.replace(**changes), backend="numpy", **options)


@pytest.fixture(scope="module")
def off_by(populated, opencl) -> tolerance.Tolerance:
    station = populated.replace(
        tolerance={"tunnel.luminous_mm": 0.05, "tunnel.height_mm": 1.0}
    )  # fmt: skip
    return tolerance.study(station, steps=3, offset_mm=0.5, height_mm=3.0, backend=opencl)


def test_what_the_station_says_may_be_off_is_tried_at_both_ends_and_all_at_once(
    populated, off_by, opencl
):
    tried = off_by.off
    assert len(tried.values) == 9 + INSIDE
    assert tried.values[:9] == (
        "nominal", "luminous_mm 3.95", "luminous_mm 4.05", "height_mm 149", "height_mm 151",
        "luminous_mm 3.95, height_mm 149", "luminous_mm 3.95, height_mm 151",
        "luminous_mm 4.05, height_mm 149", "luminous_mm 4.05, height_mm 151",
    )  # fmt: skip
    corner = populated.replace(**{
        "tunnel.luminous_mm": 3.95, "tunnel.height_mm": 149.0,
        "segmentation.threshold": off_by.threshold_dn,
    })  # fmt: skip
    (seen,) = confirm_all([corner], 1, opencl)
    assert tried.scores[5] == simulate(corner, opencl).score
    assert tried.seen[5].hits == seen.values()["hits"]
    assert tried.seen[5].false_blobs == seen.values()["false_blobs"]
    assert tried.margin_dn[5] == pytest.approx(seen.values()["margin_dn"])


def test_one_line_says_whether_all_is_kept_within_the_stated_tolerances(off_by):
    told = off_by.numbers()["within_tolerance"]
    scores, seen = off_by.off.scores, off_by.off.seen
    assert told["defects_hit"] == min(score.defects_hit for score in scores)
    assert told["false_blobs"] == max(one.false_blobs for one in seen)
    assert told["margin_dn"] == min(min(one.peaks_dn) - one.flawless_dn for one in seen)
    assert told["keeps_all"] is (told["defects_hit"] == 3 and not told["false_blobs"])
    # Room within the stated ends, and nothing lost, are one statement.
    assert told["keeps_all"] is (told["room_dn"] >= 0)
    assert off_by.findings()[-1].startswith(
        "Ends, corners and designs between of [tolerance] (tunnel.luminous_mm +- 0.05, "
        "tunnel.height_mm +- 1) keep all hits and no false blob: "
        f"{'yes' if told['keeps_all'] else 'no'}; at the worst "
        f"{told['defects_hit']} of 3 defects hit"
    )


def test_what_is_off_too_far_is_said_to_lose_something(populated, opencl):
    station = populated.replace(tolerance={"sensor.exposure": 0.9 * populated.sensor.exposure})
    found = tolerance.study(station, steps=3, backend=opencl)
    told = found.numbers()["within_tolerance"]
    assert told["keeps_all"] is False
    assert told["room_dn"] < 0
    assert "no false blob: no; at the worst" in found.findings()[-1]


def test_how_far_it_moves_without_loss_ends_before_the_first_loss(tolerated):
    score, seen = tolerated.nominal, tolerated.perturbations[0].seen[1]
    less, false = replace(score, defects_hit=2), replace(seen, false_blobs=1)
    kept = tolerance.Perturbation(
        "part up", "mm", (-2.0, -1.0, 0.0, 1.0, 2.0), 2,
        (score, less, score, score, score), (seen, seen, seen, seen, false),
    )  # fmt: skip
    assert kept.kept == (2, 3)
    assert kept.reach == "nothing lost from +0 mm to +1 mm"
    bad = replace(kept, seen=(seen, seen, false, seen, seen))
    assert bad.kept is None
    assert bad.reach == "with a false blob already at nominal"


def test_the_camera_tilts_otherwise_than_the_part_if_told(small, opencl):
    found = tolerance.study(
        small, steps=3, tilt_rad=0.002, camera_tilt_rad=0.001, backend=opencl
    )  # fmt: skip
    ends = {p.name: p.values[-1] for p in found.perturbations}
    assert (ends["part about y"], ends["camera about x"]) == (0.002, 0.001)


@pytest.mark.parametrize(
    ("tolerances", "why"),
    [
        ({"tunnel.luminos_mm": 0.1}, r"\[tolerance\]: .*luminous_mm"),
        ({"tunnel.radius_mm": 0.1}, r"radius_mm has no number in s.toml"),
        ({"segmentation.threshold": 1.0}, "segmentation.threshold is not varied"),
    ],
)
def test_a_tolerance_of_no_number_is_refused_before_anything_is_traced(small, tolerances, why):
    with pytest.raises(StationError, match=why):
        tolerance.study(small.replace(tolerance={"of": tolerances}), backend="none such")


# ------------------------------------------------------------------------------------- threshold


@pytest.fixture(scope="module")
def over(populated) -> threshold.Threshold:
    return threshold.study(populated.replace(segmentation__threshold=150.0), 40, "numpy")


def test_over_the_threshold_the_marked_ones_are_what_a_simulation_finds(populated, over):
    for level, station in (
        (over.automatic.threshold, populated),
        (over.stated_dn, populated.replace(segmentation__threshold=150.0)),
        (over.found.best_dn, populated.replace(segmentation__threshold=over.found.best_dn)),
    ):
        found, result = over.at(level), simulate(station, "numpy")
        assert found["threshold_dn"] == result.threshold == level
        assert found["defects_hit"] == result.score.defects_hit
        assert (found["p1"], found["p2"]) == (result.score.p1, result.score.p2)


def test_the_best_threshold_finds_all_and_nothing_else(over):
    best = over.numbers()["best"]
    assert (best["defects_hit"], best["false_blobs"]) == (over.found.defects, 0)
    low, high = over.found.range_dn
    assert best["threshold_dn"] == pytest.approx((low + high) / 2)
    assert f"nothing else from {low:.2f} to {high:.2f} DN" in over.findings()[0]
    assert "The station's threshold, 150 DN, finds" in over.findings()[2]


def test_the_automatic_threshold_lies_where_all_is_found_and_nothing_else(over):
    low, high = over.found.range_dn
    assert low <= over.automatic.threshold < high
    assert over.automatic.rule == "ceiling"


def test_where_nothing_false_is_left_is_told_though_every_threshold_tried_is_above(small):
    # So few flawless levels that the lowest threshold worth a look is above them.
    station = small.replace(
        part={"length_mm": 20.0, "width_mm": 12.0}, sequence__images=24, tunnel__luminous_mm=0.8,
        tunnel__dark_mm=4.0, tunnel__height_mm=300.0,
        populations=[{"kind": "dent", "count": 5, "seed": 3, "depth_um": [1.0, 4.0],
                      "diameter_mm": [0.4, 1.0]}],
    )  # fmt: skip
    found = threshold.study(station, 40, "numpy")
    low, high = found.found.range_dn
    held = station.replace(segmentation__threshold=found.automatic.threshold)
    seen = AtThreshold.of(trace(held, "numpy"), held)
    assert (low, high) == (seen.flawless_dn, min(seen.peaks_dn))
    assert f"nothing else from {low:.2f} to {high:.2f} DN" in found.findings()[0]


def test_where_no_threshold_will_do_it_is_said_what_comes_nearest(populated):
    faint = {"kind": "dent", "x_mm": -4.0, "y_mm": 2.0, "diameter_mm": 1.0, "depth_um": 0.01}
    found = threshold.study(populated.replace(defects=[faint]), 20, "numpy")
    assert found.found.range_dn is None
    assert found.findings()[0].startswith("No threshold finds all 3 defects and nothing else: ")
    assert found.found.best_dn == found.found.clean_dn
    assert found.numbers()["range_dn"] is None


@pytest.mark.parametrize(
    ("changes", "levels", "why"),
    [
        ({"populations": [], "defects": []}, 20, "no defect in view"),
        ({}, 1, "levels = 1 must be from 2 to 10,000"),
    ],
)
def test_a_study_of_thresholds_that_means_nothing_is_refused(populated, changes, levels, why):
    with pytest.raises(StationError, match=why):
        threshold.study(populated.replace(**changes), levels, "numpy")


# -------------------------------------------------------------------------------------- commands


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_writes_its_figure_and_its_table(gpuspec_, name):
    ran = gpuspec_("study", name, "s.toml", *(["--steps", 3] if name == "tolerance" else []))
    assert (ran.code, ran.err) == (0, "")
    assert names(Path("study")) == set(files(name))
    assert f"s.toml, {name}: " in ran.out
    assert f"{name}.png, {name}.csv" in ran.out
    assert Path(f"study/{name}.png").read_bytes().startswith(b"\x89PNG")
    with Path(f"study/{name}.csv").open(encoding="utf-8", newline="") as file:
        heads, *rows = csv.reader(file)
    assert rows
    assert all(len(row) == len(heads) for row in rows)
    kept = json.loads(Path(f"study/{name}.json").read_text("utf-8"))
    assert kept["study"] == name
    assert all(kept[key] for key in ("gpuspec", "backend", "device", "driver", "version"))
    for finding in kept["findings"]:
        assert finding in ran.out
    Station.read(f"study/{name}.toml")
    assert not hidden(Path())


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_tells_what_is_wrong_with_its_station(gpuspec_, name):
    steps = ["--steps", 3] if name == "tolerance" else []
    short = ["--set", "tunnel.length_mm=10.0", "--set", "tunnel.radius_mm=80.0"]
    sound, wrong = (gpuspec_("study", name, "s.toml", *steps, *more) for more in ([], short))
    said = [
        "note: tunnel.radius_mm = 80 has no effect",
        *(["% of the part sees no light"] if name not in ("signature", "height") else []),
    ]
    assert "note: " not in sound.out
    assert all(words in wrong.out for words in said)
    notes = json.loads(Path(f"study/{name}.json").read_text("utf-8"))["notes"]
    assert len(notes) == len(said)


@pytest.mark.slow
def test_figure_7_needs_no_station(gpuspec_):
    ran = gpuspec_("study", "signature", "-o", "out", "--backend", "numpy")
    assert ran.code == 0
    assert "default station, signature: numpy on cpu" in ran.out
    assert "A = 28.4" in ran.out
    assert "vanishes 4.06 mm (16.3 sigma)" in ran.out


def results() -> dict[str, bytes]:
    found = content(Path("all"))
    del found[MANIFEST]
    return found


@pytest.mark.slow
def test_studies_share_a_folder_and_replace_only_their_own(gpuspec_):
    assert gpuspec_("simulate", "s.toml", "--no-pictures", "-o", "all").code == 0
    before = results()
    for name in ("signature", "coverage", "signature"):
        assert gpuspec_("study", name, "s.toml", "-o", "all").code == 0
    after = results()
    assert set(after) == {*before, *files("signature"), *files("coverage")}
    assert all(after[name] == before[name] for name in before)


@pytest.mark.slow
def test_a_study_keeps_the_users_files(gpuspec_, monkeypatch):
    Path("study").mkdir()
    Path("study/coverage.csv").write_text("mine", encoding="utf-8")
    Path("height.toml").write_text(STATION, encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(coverage, "study", lambda *_: pytest.fail("work was begun"))
        told = said(gpuspec_("study", "coverage", "s.toml"))
        assert "study/coverage.csv is in the way: it is not known to be of an earlier" in told
    for more in ((), ("--force",)):
        assert "height.toml is read here" in said(
            gpuspec_("study", "height", "height.toml", "-o", ".", *more)
        )
    assert content(Path("study")) == {"coverage.csv": b"mine"}
    assert gpuspec_("study", "coverage", "s.toml", "--force").code == 0
    assert gpuspec_("study", "coverage", "s.toml").code == 0


@pytest.mark.slow
def test_an_outcome_is_written_by_the_same_rules(small, tmp_path):
    found = height.study(small)
    found.write(tmp_path)
    found.write(tmp_path)
    (tmp_path / "height.csv").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r"height\.csv is in the way: it was changed since"):
        found.write(tmp_path)
    found.write(tmp_path, force=True)
    with pytest.raises(OutputError, match="has no name"):
        found.write("")


@pytest.mark.slow
def test_a_study_takes_a_dent_and_changes(gpuspec_):
    dent = ("--diameter-mm", 1.0, "--depth-um", 10)
    for name in ("signature", "height", "coverage"):
        change = ("--set", "tunnel.height_mm=100.0", "--set", "defects=[]")
        ran = gpuspec_("study", name, "s.toml", *dent, *change)
        assert ran.code == 0
        assert "dent of 1 mm, 10 µm deep" in ran.out
    assert "from every transition than 4.06 mm" in ran.out


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("signature", "none.toml"), "no such station file"),
        (("signature", "--set", "tunnel.height_mm=3"), "name a station file"),
        (("signature", "s.toml", "--depth-um", 1), "--diameter-mm and --depth-um together"),
        (("coverage", "s.toml", "--depth-um", 1, "--diameter-mm", -2), "--diameter-mm -2 must be"),
        (("coverage", "s.toml", "--backend", "cuda"), "'cuda' is not known"),
        (("coverage", "s.toml", "--set", "defects=[]"), "give --diameter-mm and --depth-um"),
        (("height", "s.toml", "--set", "defects=[]"), "has no dent, bump or scratch"),
        (("tolerance", "s.toml", "--set", "defects=[]"), "P2 is undefined"),
        (("tolerance", "s.toml", "--steps", 2), "must be odd"),
        (("tolerance", "s.toml", "-o", "s.toml"), "is a file"),
    ],
)
def test_a_study_that_cannot_be_says_so_and_leaves_nothing(gpuspec_, arguments, why):
    before = content(Path())
    assert why in said(gpuspec_("study", *arguments))
    assert content(Path()) == before


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_explains_itself(gpuspec_, name):
    assert name in gpuspec_("study", "--help").out
    assert f" {name} " in gpuspec_("study", name, "--help").out
