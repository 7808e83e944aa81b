"""The way through: from a station to blobs, classes, score, and what the user is told."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from tolerances import FLAWLESS_DN, SCALED_SHARE, THRESHOLD_DN, THRESHOLD_STEP_DN

from gpuspec.arrays import BESIDE
from gpuspec.detection.inspection import class_rules, inspect
from gpuspec.detection.score import score
from gpuspec.detection.segmentation import automatic_threshold
from gpuspec.errors import BackendError, StationError
from gpuspec.light.ceiling import ceiling_of
from gpuspec.simulation import memory
from gpuspec.simulation import simulate as inspection
from gpuspec.simulation.memory import check_memory
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import simulate
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml

POPULATIONS = [
    {"kind": "dent", "count": 6, "seed": 4, "diameter_mm": [0.6, 1.5], "depth_um": [3, 12]},
    {"kind": "bump", "count": 6, "seed": 5, "diameter_mm": [0.6, 1.5], "depth_um": [3, 12]},
    {
        "kind": "scratch", "count": 4, "seed": 6, "width_mm": [0.3, 0.6], "length_mm": [2, 6],
        "depth_um": [1, 6],
    },
]  # fmt: skip
DENT = {"kind": "dent", "x_mm": 3.0, "y_mm": -2.0, "diameter_mm": 1.2, "depth_um": 8.0}


def station(**changes: Any) -> Station:
    base = Station.from_dict(
        {
            "part": {"length_mm": 40.0, "width_mm": 20.0},
            "camera": {"sampling_mm": 0.1},
            "populations": POPULATIONS,
        },
        "s.toml",
    )
    return base.replace(**changes)


def one_dent(**changes: Any) -> Station:
    return station(populations=[], defects=[DENT], **changes)


@pytest.fixture(scope="module")
def result(opencl) -> Result:
    return simulate(station(), opencl)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sequence.fusion": "max", "sensor.exposure": 1.0},
        {"camera.pupil_mm": 0.0, "sequence.images": 12},
        {"sensor.noise": True, "segmentation.threshold": 90.0},
    ],
)
def test_a_device_and_the_reference_come_to_the_same_score(opencl, changes: dict[str, Any]):
    device, reference = (simulate(station(**changes), b) for b in (opencl, "numpy"))
    assert np.array_equal(device.truth, reference.truth)
    assert np.array_equal(device.lost, reference.lost)
    # A pixel as good as on the threshold may be detected by one and not by the other.
    thresholds = np.array([device.threshold, reference.threshold])
    assert np.ptp(thresholds) <= THRESHOLD_STEP_DN
    near = np.abs(reference.aspect - thresholds.mean()) < np.ptp(thresholds) / 2 + THRESHOLD_DN
    flips = (device.labels > 0) != (reference.labels > 0)
    assert not (flips & ~near).any()
    # No more pixels are counted otherwise than are detected otherwise: none, as a rule.
    for name in ("hit_px", "false_px"):
        assert abs(getattr(device.score, name) - getattr(reference.score, name)) <= flips.sum()


def test_the_score_of_a_device_is_that_of_the_reference_field_by_field(opencl):
    device, reference = simulate(station(), opencl), simulate(station(), "numpy")
    assert device.score.as_dict() == reference.score.as_dict()
    assert np.array_equal(device.labels, reference.labels)
    assert device.confusion.rows == reference.confusion.rows
    assert np.array_equal(device.confusion.counts, reference.confusion.counts)
    assert device.warnings == reference.warnings


def test_defects_are_found_and_flawless_surface_is_not(result: Result):
    assert result.score.defects == 16
    assert result.score.defects_hit >= 14
    assert result.score.p1 > 0.5
    assert result.score.p2 > 0.4
    assert result.labels.max() == len(result.blobs) == len(result.classes)
    assert result.flawless_dn < result.threshold
    assert np.array_equal(result.labels > 0, (result.aspect > result.threshold) & result.valid)
    assert result.info.backend == "opencl"


def test_the_result_holds_what_its_score_comes_from(result: Result):
    again = score(result.labels, result.truth, result.valid, len(result.defects))
    assert again == result.score
    assert np.array_equal(result.light_map.aspect(), result.aspect)
    assert len(result.relief.defects) == len(result.defects)


def test_a_result_has_a_picture_of_itself(result: Result):
    assert result._repr_png_().startswith(b"\x89PNG\r\n\x1a\n")


def test_progress_is_told_in_a_few_words(opencl):
    told: list[str] = []
    simulate(one_dent(), opencl, progress=told.append)
    assert told[0] == "placing defects"
    assert told[-1] == "segmenting and scoring"
    assert any(opencl.info.device in words for words in told)


def test_it_is_told_how_many_defects_are_placed(monkeypatch):
    dents = {"kind": "dent", "count": 200_000, "diameter_mm": 0.01, "depth_um": 0.1}
    many = one_dent().replace(populations=[dents])
    monkeypatch.setattr(inspection, "Relief", None)  # before any work
    told: list[str] = []
    with pytest.raises(AttributeError):
        simulate(many, "numpy", progress=told.append)
    assert told == ["placing 200,001 defects, about 6 s"]


def test_a_station_file_is_simulated_by_its_path(opencl, tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(to_toml(one_dent()), encoding="utf-8")
    for given in (path, str(path)):
        assert simulate(given, opencl).score == simulate(one_dent(), opencl).score
    with pytest.raises(StationError, match=r"none\.toml: no such station file"):
        simulate(str(tmp_path / "none.toml"), opencl)


def test_a_backend_that_is_not_known_is_refused():
    with pytest.raises(BackendError, match="'openlc' is not known; choose one of auto, opencl"):
        simulate(one_dent(), "openlc")


def test_auto_takes_a_backend_and_says_which():
    assert simulate(one_dent()).info.backend in ("opencl", "numpy")


# ------------------------------------------------------------------------------- flawless, partly


@pytest.mark.parametrize("noise", [False, True])
def test_on_a_flawless_part_nothing_is_detected_and_p2_is_undefined(backend, noise: bool):
    found = simulate(station(populations=[], sensor__noise=noise), backend)
    assert not found.labels.any()
    assert found.score.p2 is None
    assert found.score.f1 is None
    assert (found.score.p1, found.score.blobs, found.score.defects) == (1.0, 0, 0)
    assert found.confusion.counts.sum() == 0
    assert found.warnings == ()


def test_a_part_narrower_than_the_image_is_alone_detected_and_scored(backend):
    wide = one_dent(
        camera__rows=240, camera__columns=451, sensor__noise=True, sensor__read_noise_e=300.0,
        segmentation__threshold=0.0,
    )  # fmt: skip
    found = simulate(wide, backend)
    beside = found.lost == BESIDE
    assert beside.sum() == 240 * 451 - 200 * 401
    assert (found.aspect[beside] > 0).any()  # noise lies above the threshold there, too
    assert not found.labels[beside].any()
    assert (found.labels > 0).sum() > 0.99 * 200 * 401
    assert found.score.hit_px + found.score.false_px == (found.labels > 0).sum()


def test_lost_pixels_in_a_zone_count_as_missed(backend):
    # The tunnel ends at x' = 3.8 on the light, 3.2 on the part: through the dent.
    dark = one_dent(tunnel__length_mm=7.6)
    found = simulate(dark, backend)
    lost_zone = (found.truth > 0) & (found.lost > BESIDE)
    assert lost_zone.any()
    assert found.score.zone_px == (found.truth > 0).sum()
    assert not found.labels[lost_zone].any()
    assert found.score.hit_px <= ((found.truth > 0) & (found.lost == 0)).sum()
    assert found.score.p2 < 1


def test_the_dark_of_lost_pixels_does_not_lower_the_flawless_level(backend):
    # More than half of the part sees no light.
    whole, dark = (simulate(one_dent(tunnel__length_mm=n), backend) for n in (1000.0, 15.0))
    assert (dark.lost > BESIDE).mean() > 0.5
    assert dark.flawless_dn == pytest.approx(whole.flawless_dn, abs=FLAWLESS_DN)
    assert dark.flawless_dn > 60


def test_a_part_without_any_light_has_no_detection(backend):
    found = simulate(
        one_dent(tunnel__length_mm=1e-3, camera__rows=200, camera__columns=400), backend
    )
    assert (found.lost > BESIDE).all()
    assert not found.labels.any()
    assert found.score.p2 == 0


def test_an_image_without_a_pixel_on_the_part_is_refused(backend):
    tiny = Station.from_dict(
        {
            "part": {"length_mm": 0.05, "width_mm": 0.05},
            "camera": {"sampling_mm": 1.0, "columns": 4, "rows": 4},
        },
        "s.toml",
    )
    with pytest.raises(StationError, match=r"^s\.toml: no pixel of the image sees the part; "):
        simulate(tiny, backend)


def test_of_a_camera_that_looks_aside_the_pose_is_named(backend):
    aside = Station.from_dict(
        {"part": {"length_mm": 4.0, "width_mm": 4.0}, "camera": {"sampling_mm": 0.5}}, "s.toml"
    ).replace(camera__pose={"tilt_y_deg": 60.0})
    with pytest.raises(StationError, match=r"sees the part; check camera\.pose, part\.length_mm"):
        simulate(aside, backend)


def test_a_part_smaller_than_a_pixel_has_one(backend):
    tiny = Station.from_dict(
        {"part": {"length_mm": 1e-6, "width_mm": 1e-6}, "camera": {"sampling_mm": 1000.0}}
    )
    assert simulate(tiny, backend).labels.shape == (1, 1)


# ------------------------------------------------------------------- thresholds, sizes and classes


def test_a_stated_threshold_is_taken_as_it_is(opencl):
    for level in (80.0, 100):
        found = simulate(station(segmentation__threshold=level), opencl)
        assert found.threshold == level
        assert np.array_equal(found.labels > 0, (found.aspect > level) & found.valid)


def test_an_automatic_threshold_is_above_the_ceiling_that_the_station_tells(result: Result):
    ceiling = ceiling_of(result.station)
    assert result.inspection.ceiling == ceiling
    assert result.inspection.rule == "ceiling"
    assert result.threshold == ceiling.threshold_dn(255)


def test_without_a_ceiling_the_spread_of_the_lit_pixels_is_the_threshold(opencl):
    found = simulate(
        station(part={"waviness": {"wavelength_mm": 9.0, "amplitude_um": 0.1}}), opencl
    )
    assert found.inspection.rule == "spread"
    assert found.threshold == automatic_threshold(
        found.aspect, found.lost == 0, full_scale_dn=255, images=40
    )


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_thresholds_scale_with_the_bits_of_the_sensor(opencl, result: Result, bits: int):
    deep = simulate(station(sensor__bit_depth=bits), opencl)
    scale = (2**bits - 1) / 255
    assert deep.threshold == pytest.approx(scale * result.threshold, rel=SCALED_SHARE)
    assert deep.flawless_dn == pytest.approx(scale * result.flawless_dn, rel=SCALED_SHARE)
    assert deep.score == result.score


def test_a_threshold_above_eight_bits_fits_twelve(opencl):
    found = simulate(station(sensor__bit_depth=12, segmentation__threshold=1500.0), opencl)
    assert found.threshold == 1500
    assert found.labels.any()


def test_blobs_smaller_than_the_least_area_are_dropped(opencl, result: Result):
    least = float(np.median(result.blobs.area_mm2))
    kept = simulate(station(segmentation__min_area_mm2=least), opencl)
    assert len(kept.blobs) == (result.blobs.area_mm2 >= least - 1e-9).sum()
    assert kept.blobs.area_mm2.min() >= least - 1e-9


@pytest.mark.parametrize(
    ("least_mm2", "kept"),
    [(0.0, 4), (0.01, 4), (0.011, 3), (0.02, 3), (0.021, 2), (0.03, 2), (0.034, 1), (0.04, 1),
     (0.041, 0)],
)  # fmt: skip
def test_a_blob_of_the_least_area_is_kept_and_none_that_is_smaller(least_mm2: float, kept: int):
    """Blobs of 1 to 4 pixels of 0.01 mm2, of which the least area need be no multiple."""
    aspect = np.zeros((9, 9), np.float32)
    for pixels in range(1, 5):
        aspect[2 * pixels - 1, 1 : 1 + pixels] = 200
    rule = one_dent(segmentation__min_area_mm2=least_mm2, segmentation__threshold=100.0)
    found = inspect(aspect, np.ones(aspect.shape, np.bool_), rule)
    assert found.blobs.area_px.tolist() == list(range(5 - kept, 5))
    assert found.labels.max() == kept


def test_classes_are_those_of_the_station_in_its_order(opencl, result: Result):
    rules = [
        {"name": "large", "area_min_mm2": 1.0},
        {"name": "long", "elongation_min": 2.0},
        {"name": "bright", "weight_min_dn": 500.0, "weight_max_dn": 1e9},
    ]
    found = simulate(station(classes=rules), opencl)
    want = [
        "large"
        if area >= 1
        else "long"
        if elongation >= 2
        else "bright"
        if weight >= 500
        else "unclassified"
        for area, elongation, weight in zip(
            found.blobs.area_mm2, found.blobs.elongation, found.blobs.net_weight_dn, strict=True
        )
    ]
    assert found.classes.tolist() == want
    assert len(set(want)) >= 3
    other = simulate(station(classes=rules[::-1]), opencl)
    assert other.classes.tolist() != want
    assert np.array_equal(other.labels, found.labels)


def test_without_rules_there_are_scratches_and_dents_or_bumps(result: Result):
    assert [rule.name for rule in class_rules(station())] == ["scratch", "dent or bump"]
    assert set(result.classes) <= {"scratch", "dent or bump"}


@pytest.mark.parametrize("fusion", ["mean", "max", "min", "std", "differential"])
def test_every_fusion_goes_all_the_way(opencl, fusion: str):
    exposure = {"max": 0.5, "min": 4.0}.get(fusion, 4.0)
    chosen = station(sequence__fusion=fusion, sensor__exposure=exposure, tunnel__dark_leak=0.05)
    found = simulate(chosen, opencl)
    assert np.array_equal(found.aspect, found.light_map.fuse()[fusion] if fusion != "mean" else
                          found.light_map.aspect())  # fmt: skip
    assert found.labels.shape == found.aspect.shape == (200, 400)
    assert np.isfinite(found.aspect).all()


def test_the_spread_over_the_images_shows_defects_to_an_unsaturated_sensor(opencl):
    found = simulate(one_dent(sequence__fusion="std", sensor__exposure=1.0), opencl)
    zone = found.truth > 0
    assert abs(np.median(found.aspect[zone]) - np.median(found.aspect[~zone])) > 3


def test_frames_of_a_camera_are_inspected_as_simulated_ones_are(result: Result):
    again = inspect(
        result.aspect, result.valid, result.station, result.lost == 0, result.inspection.ceiling
    )
    assert again.threshold == result.threshold
    assert np.array_equal(again.labels, result.labels)
    assert np.array_equal(again.classes, result.classes)


def test_what_sees_the_light_need_not_be_known(result: Result):
    unknown = inspect(result.aspect, result.valid, result.station)
    none = inspect(result.aspect, result.valid, result.station, np.zeros_like(result.valid))
    lit = inspect(result.aspect, result.valid, result.station, result.lost == 0)
    assert unknown.threshold == none.threshold == lit.threshold


# --------------------------------------------------------------------------------------- memory


def refused(chosen: Station, backend="numpy") -> str:
    with pytest.raises(StationError) as caught:
        simulate(chosen, backend)
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith(".")
    return message


def test_an_image_beyond_the_memory_is_refused_before_any_work(monkeypatch):
    monkeypatch.setattr(memory, "free_bytes", lambda: 2**30)
    for name in ("Relief", "Truth", "open_backend"):
        monkeypatch.setattr(inspection, name, None)
    message = refused(Station().replace(camera__sampling_mm=0.003))
    assert "66667 x 16667 pixels, which needs 41.4 GiB of memory while 1.0 GiB are free" in message


@pytest.mark.parametrize("size", [(200.0, 50.0), (199.7, 33.3), (1000.0, 3.0)])
@pytest.mark.parametrize("gigabytes", [0.05, 0.7, 1.0, 3.3])
def test_the_sampling_that_is_suggested_fits(monkeypatch, size, gigabytes: float):
    monkeypatch.setattr(memory, "free_bytes", lambda: int(gigabytes * 2**30))
    fine = Station().replace(
        part__length_mm=size[0], part__width_mm=size[1], camera__sampling_mm=0.0025
    )
    message = refused(fine)
    suggested = float(re.search(r"free; ([0-9.e-]+) or more fits", message)[1])
    check_memory(fine.replace(camera__sampling_mm=suggested))
    with pytest.raises(StationError):
        check_memory(fine.replace(camera__sampling_mm=0.85 * suggested))


def test_no_sampling_is_suggested_where_the_image_size_is_stated(monkeypatch):
    monkeypatch.setattr(memory, "free_bytes", lambda: 2**30)
    message = refused(Station().replace(camera__columns=40_000, camera__rows=40_000))
    assert "set smaller camera.columns and camera.rows." in message
    assert "fits" not in message


def test_this_machine_says_how_much_memory_is_free():
    assert 2**20 < memory.free_bytes() <= 2**63


@pytest.mark.parametrize("polarity", ["bright", "both"])
def test_a_blurred_rim_is_no_background_and_no_defect(opencl, polarity):
    """The lens looks beyond the part there: the rim is dark, what is beside it is not bright."""
    rimmed = one_dent(
        camera__blur_mm=0.15, sensor__noise=True, tunnel__luminous_mm=8.0, tunnel__dark_mm=8.0,
        tunnel__profile="sinusoid", segmentation={"background_mm": 2.0, "polarity": polarity},
    )  # fmt: skip
    found = simulate(rimmed, opencl)
    level = found.flawless_dn
    assert found.aspect[[0, -1]].mean() < level - 5
    assert found.score.false_blobs == 0
    assert found.score.defects_hit == 1
