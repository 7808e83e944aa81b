"""What a user is told: each note where it is true, and not where it is not."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest
from commandline import program
from tolerances import CHANCE_SHARE

from gpuspec.arrays import BESIDE
from gpuspec.pictures.detection import detection_picture
from gpuspec.simulation.cautions import station as cautions
from gpuspec.simulation.cautions.all import common
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import simulate
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml

DENT = {"kind": "dent", "x_mm": 3.0, "y_mm": -2.0, "diameter_mm": 1.2, "depth_um": 8.0}


def one_dent(**changes: Any) -> Station:
    base = Station.from_dict(
        {
            "part": {"length_mm": 40.0, "width_mm": 20.0},
            "camera": {"sampling_mm": 0.1},
            "defects": [DENT],
        },
        "s.toml",
    )
    return base.replace(**changes)


def told(chosen: Station, backend: Any) -> tuple[Result, str]:
    result = simulate(chosen, backend)
    for sentence in result.warnings:
        assert sentence.endswith(".")
        assert "\n" not in sentence
    return result, " ".join(result.warnings)


SAID: dict[str, tuple[dict[str, Any], str]] = {
    "least area above a defect": (
        {"segmentation.min_area_mm2": 2.0},
        r"min_area_mm2 = 2 may swallow 1 of 1 defects: the smallest zone has 1\.1 mm2\.",
    ),
    "every blob below the least area": (
        {"segmentation.min_area_mm2": 2.0},
        r"nothing is detected, so that P1 is 1 .* all 178 pixels .*min_area_mm2 = 2\.",
    ),
    "defect outside the image": (
        {"camera.columns": 20, "camera.rows": 10},
        r"1 of 1 defects have no pixel of their own",
    ),
    "no saturation": ({"sensor.exposure": 1.0}, r"sensor\.exposure = 1 does not saturate"),
    "a dull material": (
        {"sensor.exposure": 1.5, "part.material": "chromium"},
        r"sensor\.exposure = 1\.5, of which chromium reflects 5\d%, does not saturate",
    ),
    "open period": (
        {"sequence.images": 10, "sequence.step_mm": 1.0},
        r"the 10 images cover 0\.625 periods .* even only .*: this one goes frame by frame\. Leave",
    ),
    "an open period of another fusion": (
        {"sequence.images": 10, "sequence.step_mm": 1.0, "sequence.fusion": "max"},
        r"is even only over whole periods\. Leave",
    ),
    "narrow opening": (
        {"tunnel.opening_length_mm": 20.0, "tunnel.opening_width_mm": 30.0},
        r"not see all through its opening of 20 x 30 mm: .* is 33\.1 x 16\.8 mm there",
    ),
    "reflected opening": (
        {"tunnel.opening_length_mm": 33.0, "tunnel.opening_width_mm": 17.0},
        r"49\.3 % of the part sees no light: it reflects the camera opening of 33 x 17 mm",
    ),
    "short tunnel": (
        {"tunnel.length_mm": 24.0},
        r"49\.5 % of the part sees no light: its rays pass .*length_mm = 24; 47\.6 or more catches",
    ),
    "no light at all": (
        {"tunnel.length_mm": 1e-3, "camera.rows": 200, "camera.columns": 400},
        r"^no pixel of the part sees any light: its rays pass the tunnel's end",
    ),
    "a step of a whole period": (
        {"sequence.step_mm": 16.0},
        r"all 40 images are the same: sequence\.step_mm = 16.*a whole period; .* step is 0\.4 mm",
    ),
    "a step of three periods": (
        {"sequence.step_mm": 48.0},
        r"by 3 whole periods; their period is 16 mm",
    ),
    "a step of nothing": (
        {"sequence.step_mm": 1e-4},
        r"all 40 images are the same: .* next to noth",
    ),
    "a step of half a period": (
        {"sequence.step_mm": 8.0},
        r"only 2 of 40 images differ: sequence\.step_mm = 8 .* after 2\. Leave",
    ),
    "a step of a third of many periods": (
        {"sequence.step_mm": 16.0 * 4 / 3},
        r"only 3 of 40 images differ",
    ),
    "the deviation of one image": (
        {"sequence.images": 1, "sequence.fusion": "std"},
        r'sequence\.images = 1: the "std" of one image is black; [^.]*period\.$',
    ),
    "the deviation of equal images": (
        {"sequence.step_mm": 16.0, "sequence.fusion": "std"},
        r"^all 40 images are the same: [^:]*0\.4 mm\.$",
    ),
    "stripes instead of an aspect image": (
        {"sequence.step_mm": 16.0},
        r"^all 40 images are the same: [^:]*0\.4 mm\.( [^:]* is detected [^:]*: its [^:]* DN\.)?$",
    ),
    "the brightest of all images": (
        {"sequence.fusion": "max"},
        r'is itself at full scale, .* "max" every pixel has its brightest image: take "mean"\.$',
    ),
    "the darkest of all images": (
        {"sequence.fusion": "min"},
        r'the image is dark: .* "min" every pixel has its darkest: take "mean"\.$',
    ),
    "a defect too faint for any number of images": (
        {"defects": [{**DENT, "depth_um": 1.64}]},
        r"nothing is detected, .* DN\. Only deeper defects would stand out, or another light\.$",
    ),
    "a radius without an arch": (
        {"tunnel.radius_mm": 80.0},
        r'tunnel\.radius_mm = 80 has no effect with tunnel\.section = "ceiling": .* of an arch',
    ),
    "a height with an arch": (
        {"tunnel.section": "arch", "tunnel.radius_mm": 80.0, "tunnel.height_mm": 90.0},
        r"tunnel\.height_mm = 90 has no effect .* an arch has tunnel\.radius_mm",
    ),
    "noise that is off": (
        {"sensor.read_noise_e": 30.0, "sensor.prnu": 0.1},
        r"sensor\.read_noise_e = 30 and sensor\.prnu = 0\.1 have no effect without noise",
    ),
    "a lag without pairs": (
        {"sequence.lag": 4},
        r"sequence\.lag = 4 has no effect .*fusion = \"mean",
    ),
    "a threshold of nothing": (
        {"segmentation.threshold": 0.0},
        r"nearly all of the flawless surface is detected .* 0 DN, .* defects are hit by chance",
    ),
    "a threshold above everything": (
        {"segmentation.threshold": 200.0},
        r"nothing is detected, .* threshold is 200 DN, .* Set segmentation.threshold between 70",
    ),
    "a dark image": (
        {"sensor.exposure": 1e-3},
        r"the image is dark: its brightest pixel has 0\.064 DN",
    ),
    "an even, saturated image": (
        {"tunnel.luminous_mm": 15.9, "tunnel.dark_mm": 0.1},
        r"beyond full scale and detects nothing: the flawless level, 255\.0 DN, is itself at full",
    ),
    "few images": (
        {"sequence.images": 2, "tunnel.luminous_mm": 12.0},
        r"beyond full scale .*: by where .* in 2 images a flawless pixel can have 255 DN of 255",
    ),
    "few electrons": (
        {"sensor.noise": True, "sensor.saturation_e": 0.5},
        r"beyond full scale .*: it leaves room for noise above .* deviation of 2\d DN\. Take",
    ),
    "few images without a ceiling": (
        {"sequence.images": 2, "sequence.fusion": "std"},
        r"beyond full scale .*: of 2 images one more makes a flawless pixel brighter by 128 DN",
    ),
    "too few images for a faint defect": (
        {"sequence.images": 8},
        r"nothing is detected, .* A flawless pixel can have 95\.63 DN, .* mean of 8 images ripples",
    ),
    "steep sides": (
        {"defects": [{**DENT, "depth_um": 400.0}]},
        r"1 of 1 defects have slopes steeper than 30 degrees, up to 0\.81",
    ),
    "more defect than part": (
        {"defects": [{**DENT, "x_mm": 0.0, "y_mm": 0.0, "diameter_mm": 32.0, "depth_um": 20.0}]},
        r"the zones of the defects cover 7\d(\.\d)? % of the part",
    ),
}
NOT_SAID: list[dict[str, Any]] = [
    {},
    {"segmentation.min_area_mm2": 0.3},
    {"sensor.exposure": 1, "sequence.fusion": "min", "tunnel.dark_mm": 1.0},
    {"sequence.images": 20, "sequence.step_mm": 1.6},
    {"sequence.images": 40, "sequence.step_mm": 16.4},
    {"tunnel.height_mm": 790, "tunnel.opening_length_mm": 3.6, "tunnel.opening_width_mm": 3.4},
    {"tunnel.section": "arch", "tunnel.radius_mm": 150.0},
    {"tunnel.section": "box", "tunnel.width_mm": 90.0},
    {"sensor.noise": True, "sensor.read_noise_e": 5.0, "sensor.seed": 3},
    {"tunnel.length_mm": 47.6},
    {"segmentation.threshold": 85.0},
    {"sequence.images": 30},
    {"part.material": "chromium", "sensor.exposure": 5.0},
    {"defects": [{**DENT, "depth_um": 250.0}]},
]


@pytest.mark.parametrize("name", SAID)
def test_what_spoils_a_score_is_said(opencl, name: str):
    changes, says = SAID[name]
    said = told(one_dent(**changes), opencl)[1]
    assert re.search(says, said), said


@pytest.mark.parametrize("changes", NOT_SAID, ids=str)
def test_what_spoils_nothing_is_not_said(opencl, changes: dict[str, Any]):
    assert told(one_dent(**changes), opencl)[1] == ""


def test_all_images_are_the_same_where_it_is_said_and_only_there(opencl):
    for step, same in ((16.0, True), (48.0, True), (16.4, False), (0.4, False)):
        result, said = told(one_dent(sequence__step_mm=step), opencl)
        first, other = (result.light_map.image(k) for k in (0, 20))
        assert (np.abs(first - other).max() < 1) == same
        assert ("images are the same" in said) == same
        assert "Raise segmentation.threshold" not in said  # it is automatic


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"part.crown_radius_x_mm": 60.0},
        {"part.crown_radius_x_mm": -300.0, "part.surface": "height"},
        {"tunnel.section": "arch", "tunnel.radius_mm": 60.0, "part.crown_radius_y_mm": 90.0},
        {"camera.columns": 200},
    ],
    ids=str,
)
def test_the_length_that_is_suggested_loses_nothing(opencl, changes: dict[str, Any]):
    flawless = one_dent(**changes, defects=[], tunnel__length_mm=4.0)
    needed = float(re.search(r"length_mm = 4; ([0-9.]+) or more", told(flawless, opencl)[1])[1])
    whole = simulate(flawless.replace(tunnel__length_mm=needed), opencl)
    assert set(np.unique(whole.lost)) <= {0, BESIDE}
    assert (simulate(flawless.replace(tunnel__length_mm=0.97 * needed), opencl).lost > BESIDE).any()


def test_the_share_that_is_lost_is_that_of_the_part(opencl):
    wide = one_dent(tunnel__length_mm=24.0, camera__columns=800, camera__rows=300)
    result, said = told(wide, opencl)
    on_part = result.lost != BESIDE
    share = (result.lost[on_part] > 0).mean()
    assert f"{100 * share:.3g} % of the part sees no light" in said


def test_defects_out_of_view_do_not_lie_in_the_dark(opencl):
    """Of three one is dark, one is lit, and one no image has."""
    aside = [{**DENT, "x_mm": x} for x in (-13.0, 0.0, 19.0)]
    piece = one_dent(defects=aside, tunnel__length_mm=16.0, camera__columns=300)
    assert "1 of 3 defects lie in the dark." in told(piece, opencl)[1]


@pytest.mark.parametrize(("share", "by_chance"), [(0.3, True), (0.12, True), (0.08, False)])
def test_defects_are_hit_by_chance_from_a_tenth_of_the_surface_on(opencl, share, by_chance):
    """At a threshold above which that share of the noisy flawless surface is."""
    noisy = one_dent(sensor__noise=True, sensor__read_noise_e=300.0)
    result = simulate(noisy, opencl)
    level = float(np.quantile(result.aspect[result.truth == 0], 1 - share))
    found, said = told(noisy.replace(segmentation__threshold=level), opencl)
    outside = found.labels[found.truth == 0] > 0
    assert outside.mean() == pytest.approx(share, rel=CHANCE_SHARE)
    assert ("hit by chance" in said) == by_chance


def test_the_defects_smaller_than_the_least_area_are_counted(opencl):
    """Zones of 1.13 and 4.5 mm2."""
    both = [DENT, {**DENT, "x_mm": -8.0, "diameter_mm": 2.4}]
    for least, small in ((0.5, 0), (2.0, 1), (5.0, 2)):
        said = told(one_dent(defects=both, segmentation__min_area_mm2=least), opencl)[1]
        assert (f"may swallow {small} of 2 defects" in said) == (small > 0)
        assert ("may swallow" in said) == (small > 0)


def test_images_that_are_the_same_are_told_where_they_are_most_of_them(opencl):
    for images, differ, is_told in ((12, 5, True), (9, 5, False), (40, 8, False), (40, 5, True)):
        said = told(one_dent(sequence__images=images, sequence__step_mm=16.0 / differ), opencl)[1]
        assert (f"only {differ} of {images} images differ" in said) == is_told


def test_defects_in_the_dark_are_counted(opencl):
    aside = [{**DENT, "x_mm": x} for x in (-18.0, 0.0, 17.0)]
    said = told(one_dent(defects=aside, tunnel__length_mm=24.0), opencl)[1]
    assert "2 of 3 defects lie in the dark." in said
    assert "in the dark" not in told(one_dent(tunnel__length_mm=24.0), opencl)[1]


def test_a_crown_that_turns_rays_down_is_named(opencl):
    steep = one_dent(part__crown_radius_x_mm=20.5)
    said = told(steep, opencl)[1]
    assert re.search(r"% of the part sees no light: it is tilted by more than 45 degrees", said)
    assert "check part.crown_radius_x_mm and the defects' depth_um." in said
    assert "no length catches them all" in said


def test_an_even_image_is_not_called_uneven(opencl):
    for changes in (
        {"tunnel.luminous_mm": 15.9, "tunnel.dark_mm": 0.1},
        {"sequence.fusion": "max"},
        {"sensor.exposure": 1000.0},
    ):
        result, said = told(one_dent(**changes), opencl)
        flawless = result.aspect[result.truth == 0]  # beside the dent it is brighter
        assert np.ptp(np.quantile(flawless, (0.001, 0.999))) < 15
        assert "uneven" not in said


def test_an_uneven_image_is_called_uneven(opencl):
    part = {"orange_peel": {"slope_rad": 0.002, "wavelength_mm": 4.0}}
    result, said = told(one_dent(sequence__images=3, sequence__step_mm=2.0, part=part), opencl)
    assert result.threshold >= 255
    assert result.aspect.std() > 30
    assert "the flawless level is too uneven over the part" in said


def test_noise_that_keeps_the_threshold_high_is_named(opencl):
    faint = [{**DENT, "depth_um": 2.5}]
    noisy = {"noise": True, "saturation_e": 300.0}
    said = told(one_dent(defects=faint, sensor=noisy), opencl)[1]
    assert re.search(r"leaves room for noise, of a standard deviation of [0-9.]+ DN", said), said


def test_a_flawless_part_without_a_detection_is_as_it_should_be(opencl):
    assert told(one_dent(defects=[]), opencl)[1] == ""


def test_a_station_that_states_nothing_is_told_so(opencl):
    empty = Station.parse("", "empty.toml")
    small = {"camera.sampling_mm": 0.5}
    assert "every value of empty.toml is a default" in " ".join(simulate(empty, opencl).warnings)
    assert "is a default" not in told(empty.replace(**small), opencl)[1]
    for text in ("[part]\n", "[sweep.vary]\n"):
        assert cautions.unstated(Station.parse(text))
    for text in ("[part]\nlength_mm = 199.0\n", "[[defects]]\nkind = 'dent'\nx_mm = 0.0\n"
                 "y_mm = 0.0\ndiameter_mm = 1.0\ndepth_um = 3.0\n"):  # fmt: skip
        assert not cautions.unstated(Station.parse(text))


def test_keys_that_act_are_not_called_without_effect():
    acting = {
        "tunnel.radius_mm": {"tunnel.section": "arch", "tunnel.radius_mm": 90.0},
        "tunnel.width_mm": {"tunnel.section": "box", "tunnel.width_mm": 90.0},
        "tunnel.height_mm": {"tunnel.section": "box", "tunnel.width_mm": 90.0},
        "sequence.lag": {"sequence.fusion": "differential"},
        "sensor.seed": {"sensor.noise": True},
    }
    for key, changes in acting.items():
        assert key in cautions.ineffective(one_dent()) or key == "tunnel.height_mm"
        assert key not in cautions.ineffective(one_dent(**changes))


def test_keys_without_effect_have_none(opencl):
    plain = simulate(one_dent(), opencl).aspect
    for key in cautions.ineffective(one_dent()):
        value = 7 if key in ("sequence.lag", "sensor.seed") else 0.5
        value = 70.0 if key.startswith("tunnel") and key.endswith("_mm") else value
        value = 700.0 if key.endswith("_nm") else value
        changed = one_dent(**{key: value})
        assert np.array_equal(simulate(changed, opencl).aspect, plain)
        assert key in " ".join(cautions.without_effect(changed))


@pytest.mark.slow
@pytest.mark.parametrize("more", [{}, {"defects": []}], ids=str)
def test_where_nothing_is_detected_every_line_says_so_in_place(tmp_path, more: dict[str, Any]):
    above = one_dent(**{"segmentation.threshold": 200.0, "camera.sampling_mm": 0.2, **more})
    (tmp_path / "s.toml").write_text(to_toml(above))
    ran = program("simulate", "s.toml", "-o", "run", "--no-pictures", cwd=tmp_path)
    assert re.search(r"precision P1 \(overdetection\) +- \(nothing detected\)", ran.out)
    assert json.loads((tmp_path / "run/score.json").read_text())["score"]["p1"] == 1.0
    heading = " ".join(text.get_text() for text in detection_picture(simulate(above)).texts)
    assert "precision P1 (overdetection) - (nothing detected)" in heading
    ran = program("prototype", "s.toml", "--pattern", "binary", cwd=tmp_path)
    assert "precision P1 (overdetection) - (nothing detected), recall" in ran.out


def test_what_is_dropped_for_its_size_is_counted_where_it_is_brighter_than_the_surface():
    dark = one_dent(**{"segmentation.polarity": "dark", "segmentation.threshold": 80.0})
    result = simulate(dark)
    assert result.aspect.max() > 90, "what is brighter is no find"
    said = " ".join(result.warnings)
    assert "nothing is detected" in said
    assert "blobs smaller" not in said
    (brightest,) = re.findall(r"the brightest pixel ([\d.]+) DN", said)
    assert float(brightest) < 80


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"part__sphere_radius_mm": 25.0}, "tilt them less with part.sphere_radius_mm"),
        ({"part__sphere_radius_mm": -25.0}, "tilt them less with part.sphere_radius_mm"),
        (
            {"part__length_mm": 1e5, "camera__sampling_mm": 100.0},
            "no length catches them all, so look at less of the part",
        ),
        (
            {"part__waviness": {"amplitude_um": 2000.0, "wavelength_mm": 8.0}, "defects": []},
            "what tilts them so far is the relief: check part.waviness.",
        ),
    ],
    ids=str,
)
def test_what_tilts_rays_past_the_tunnels_end_is_named(changes, words):
    assert words in " ".join(simulate(one_dent(**changes)).warnings)


def test_what_is_taken_as_ideal_is_told_apart():
    (said,) = cautions.assumptions(one_dent())
    assert "looks through the tunnel's top as if it were not there" in said
    opened = one_dent(tunnel__opening_length_mm=30.0, tunnel__opening_width_mm=20.0)
    assert cautions.assumptions(opened) == ()


def test_notes_on_every_design_are_those_in_common():
    designs = [one_dent(sequence__lag=4, sensor__exposure=g) for g in (0.5, 1.0, 2.0)]
    lists = [cautions.of_station(design) for design in designs]
    assert len(lists[0]) == 2
    assert common(lists) == lists[2]
    assert common([]) == []


def test_what_keeps_a_threshold_high_is_said_of_the_image_without_its_background():
    faint = one_dent(
        defects=[DENT | {"depth_um": 0.1}], sequence__images=14, segmentation__background_mm=3.0
    )
    result = simulate(faint)
    assert result.inspection.rule == "background"
    # One image of 14, 20 DN, is no margin of it; the spread of its levels, here 1.7 DN, is.
    assert "nothing is detected" in " ".join(result.warnings)
    assert "It leaves room for an uneven flawless level" in " ".join(result.warnings)
