"""A camera from its data sheet: what follows, what contradicts, and how it is written."""

from __future__ import annotations

import math

import pytest

from gpuspec.errors import StationError
from gpuspec.station import optics
from gpuspec.station.sections import Camera
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml

SHEET = {"focal_mm": 25.0, "f_number": 8.0, "pixel_um": 3.45, "height_mm": 525.0}


def of(**camera: object) -> Station:
    return Station.from_dict({"camera": {**SHEET, **camera}}, "trim.toml")


def test_sampling_and_pupil_follow_from_the_data_sheet() -> None:
    camera = of(mtf50_lp_per_mm=100.0).camera
    assert camera.sampling_mm == pytest.approx(0.069)
    assert camera.pupil_mm == 3.125
    # Gaussian: exp(-2 (pi s f)^2) is 1/2 at 100 line pairs per mm.
    sigma = camera.blur_mm / 20  # magnified by 1/20
    assert math.exp(-2 * (math.pi * sigma * 100) ** 2) == pytest.approx(0.5)


def test_the_image_is_as_large_as_the_lens_makes_it() -> None:
    station = of(columns=2448, rows=2048)
    assert station.shape == (2048, 2448)
    assert station.shape[1] * station.camera.sampling_mm == pytest.approx(2448 * 3.45e-3 * 20)


@pytest.mark.parametrize(
    ("key", "value"), [("sampling_mm", 0.05), ("pupil_mm", 3.0), ("blur_mm", 0.0)]
)
def test_a_contradiction_names_both_sides(key: str, value: float) -> None:
    with pytest.raises(StationError, match=rf"{key} = {value:g} contradicts .* leave {key} out"):
        of(mtf50_lp_per_mm=100.0, **{key: value})


def test_what_follows_may_be_given_too() -> None:
    assert of(sampling_mm=0.069, pupil_mm=3.125) == of()


@pytest.mark.parametrize("key", ["focal_mm", "f_number", "pixel_um", "mtf50_lp_per_mm"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, 1e300, "8"])
def test_impossible_data_are_refused_in_a_sentence(key: str, value: object) -> None:
    with pytest.raises(StationError, match=rf"^trim.toml: camera.{key} = "):
        of(**{key: value})


def test_focused_elsewhere_the_lens_magnifies_as_it_is_focused() -> None:
    # The image is at 1/v = 1/25 - 1/500: a pixel is 3.45 um / v of an angle, 525 mm away.
    image = 1 / (1 / 25 - 1 / 500)
    assert of(focus_mm=500.0).camera.sampling_mm == pytest.approx(3.45e-3 / image * 525)
    assert of(focus_mm=525.0).camera.sampling_mm == of().camera.sampling_mm


def test_a_lens_is_not_focused_within_its_focal_length() -> None:
    with pytest.raises(StationError, match=r"focal_mm = 25 cannot be focused at focus_mm = 20"):
        of(focus_mm=20.0)


def test_a_spot_has_the_variance_of_pixel_lens_and_pupil() -> None:
    camera = of(mtf50_lp_per_mm=100.0, focus_mm=500.0).camera
    disc = 3.125 * (525 / 500 - 1)
    variance = camera.sampling_mm**2 / 12 + camera.blur_mm**2 + disc**2 / 16
    assert camera.spot_side_mm**2 / 12 == pytest.approx(variance)
    assert of().camera.spot_side_mm == of().camera.sampling_mm
    assert of().camera.spread == (0.0, 0.0)


def test_a_lens_makes_no_image_within_its_focal_length() -> None:
    with pytest.raises(StationError, match="further away than its focal length"):
        of(focal_mm=525.0)


def test_a_sampling_out_of_range_is_refused_with_what_it_comes_from() -> None:
    with pytest.raises(StationError, match=r"focal_mm = 0.001, .* make sampling_mm = 1811"):
        of(focal_mm=0.001)


def test_the_written_station_is_the_station() -> None:
    station = of(mtf50_lp_per_mm=100.0)
    text = to_toml(station)
    assert Station.parse(text) == station
    assert Station.from_dict(station.as_dict()) == station
    assert "# pupil_mm = 3.125 " in text
    assert "; follows from focal_mm, f_number" in text


def test_another_f_number_makes_another_pupil() -> None:
    station = of()
    assert station.replace(camera__f_number=4.0).camera.pupil_mm == 6.25
    again = Station.parse(to_toml(station)).replace(camera__focal_mm=50.0).camera
    assert again.sampling_mm == pytest.approx(3.45e-3 * 475 / 50)
    assert again.pupil_mm == 6.25


def test_a_station_without_lens_may_be_given_one() -> None:
    assert Station().replace(camera__focal_mm=25.0, camera__f_number=5.0).camera.pupil_mm == 5.0


def test_without_the_data_sheet_the_camera_stays_what_it_was() -> None:
    station = of(mtf50_lp_per_mm=100.0)
    plain = station.replace(**optics.NO_DATA_SHEET)
    for key in optics.FOLLOWS:
        assert getattr(plain.camera, key) == getattr(station.camera, key)
    assert plain.replace(camera__pupil_mm=0.0, camera__blur_mm=0.0).camera.pupil_mm == 0


def test_every_key_that_follows_is_one_of_the_camera() -> None:
    for key, sources in optics.FOLLOWS.items():
        assert {key, *sources} <= Camera.model_fields.keys()


def test_a_point_within_the_depth_of_field_is_a_spot_no_larger_than_asked() -> None:
    near, far = optics.depth_of_field_mm(6.0, 500.0, 0.1)
    # The cone from the pupil to a point in focus is D d / F wide; a spot at another distance looks
    # larger from nearby: it is measured where it is in focus.
    assert 6.0 * near / (500.0 - near) == pytest.approx(0.1)
    assert 6.0 * far / (500.0 + far) == pytest.approx(0.1)
    assert optics.depth_of_field_mm(0.0, 500.0, 0.1)[1] == math.inf
