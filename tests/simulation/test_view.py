"""What is said of a camera: its numbers, and where they cannot be."""

from __future__ import annotations

import pytest

from gpuspec.simulation.cautions.camera import of_camera
from gpuspec.simulation.cautions.station import assumptions, without_effect
from gpuspec.simulation.view import depth_mm, facts, view_mm
from gpuspec.station.station import Station

SHEET = {"focal_mm": 25.0, "f_number": 8.0, "pixel_um": 3.45, "height_mm": 525.0}


def station(opening: tuple[float, float] = (0.0, 0.0), **camera: object) -> Station:
    tunnel = {"opening_length_mm": opening[0], "opening_width_mm": opening[1], "height_mm": 105.0}
    return Station.from_dict(
        {
            "camera": {k: v for k, v in {**SHEET, **camera}.items() if v is not None},
            "tunnel": tunnel,
        }
    )


def test_every_fact_of_the_data_sheet_is_told() -> None:
    told = {fact.name: fact.value for fact in facts(station(mtf50_lp_per_mm=60.0))}
    assert told["sampling"] == "0.069 mm per pixel"
    assert told["magnification"] == "0.05"
    assert told["pupil"] == "3.12 mm"
    assert told["depth of field"] == "11.3 mm above, 11.9 below"
    assert told["diffraction"] == "87.4 lp/mm"
    assert set(told) == {
        "sampling", "pupil", "field", "magnification", "on the sensor", "depth of field", "blur",
        "diffraction", "cone of sight", "opening",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ({"part": {"shift_z_mm": 100.0}}, (425.0, 425.0)),
        ({"camera": {"shift_z_mm": 100.0}}, (625.0, 625.0)),
        # 100 mm sin 10 degrees farther at one end; at the other the image ends first.
        ({"part": {"tilt_y_deg": 10.0}}, (525 - 17.06, 525 + 17.36)),
    ],
    ids=str,
)
def test_a_posed_part_is_as_far_from_the_pupil_as_its_pose_puts_it(pose, expected) -> None:
    moved = station().replace(**{f"{name}__pose": one for name, one in pose.items()})
    nearest, farthest, _ = depth_mm(moved)
    assert (nearest, farthest) == pytest.approx(expected, abs=0.1)
    focused = moved.replace(camera__focus_mm=farthest)
    assert depth_mm(focused)[2] == pytest.approx(3.125 * (1 - nearest / farthest), rel=0.02)


def test_the_cone_of_sight_has_the_pupil_at_its_top_and_the_part_at_its_foot() -> None:
    # A fifth of the way up: 0.8 of 200 x 50 mm and 0.2 of 3.125 mm.
    assert view_mm(station()) == pytest.approx((160.625, 40.625), abs=0.01)


@pytest.mark.parametrize(("opening", "said"), [((161.0, 41.0), 0), ((161.0, 40.0), 1)])
def test_an_opening_smaller_than_the_cone_of_sight_is_told(
    opening: tuple[float, float], said: int
) -> None:
    assert len(of_camera(station(opening))) == said


def test_focused_elsewhere_the_plane_and_the_spot_are_told() -> None:
    told = {fact.name: fact.value for fact in facts(station(focus_mm=500.0))}
    assert told["plane in focus"] == "25 mm above z = 0"
    # The pupil's cone, 3.125 mm wide, is 25/500 of that on the part; a pixel there is 525/500 of
    # one in focus.
    assert told["defocus"] == f"0.156 mm, {0.15625 / 0.068828:.3g} pixels"
    assert told["sampling"] == "0.06883 mm per pixel"
    (said,) = of_camera(station(focus_mm=500.0))
    assert "out of focus: it is 525 mm from the pupil" in said
    assert not of_camera(station(focus_mm=520.0))


def test_a_part_deeper_than_the_depth_of_field_is_told() -> None:
    crowned = station().replace(
        part__surface="height", part__crown_radius_x_mm=-200.0, part__length_mm=150.0
    )
    (said,) = of_camera(crowned)
    assert "deeper than the depth of field: it is 510.405 to 525 mm" in said
    assert "camera.focus_mm = 525 blurs it" in said
    (said,) = of_camera(crowned.replace(camera__focus_mm=525.0))
    assert "it is 510.405 to 525 mm from the pupil" in said
    assert not of_camera(crowned.replace(part__surface="orientation"))


def test_whether_it_sees_through_its_opening_is_told() -> None:
    told = [
        {fact.name: fact for fact in facts(station(size))}["opening"]
        for size in ((0.0, 0.0), (161.0, 41.0), (161.0, 40.0))
    ]
    assert [fact.value for fact in told] == ["none", "161 x 41 mm", "161 x 40 mm"]
    assert [fact.source for fact in told] == [
        "the tunnel is transparent to the camera",
        "the camera sees through it",
        "the camera does not see all through it",
    ]


def test_a_wavelength_that_nothing_asks_for_is_told() -> None:
    plain = Station().replace(tunnel__wavelength_nm=650.0)
    (said,) = without_effect(plain)
    assert said.startswith("tunnel.wavelength_nm = 650 has no effect with part.material = ")
    assert not without_effect(plain.replace(part__material="gold"))
    assert not without_effect(plain.replace(camera__focal_mm=25.0, camera__f_number=8.0))


def test_a_lens_sharper_than_diffraction_is_told() -> None:
    (said,) = of_camera(station(mtf50_lp_per_mm=90.0))
    assert "diffraction leaves half the contrast at 87.4 lp/mm" in said
    assert not of_camera(station(mtf50_lp_per_mm=85.0))


def test_data_from_which_nothing_follows_are_told() -> None:
    said = without_effect(station(focal_mm=None))
    assert said == [
        "camera.f_number = 8 has no effect without camera.focal_mm.",
        "camera.pixel_um = 3.45 has no effect without camera.focal_mm or camera.mtf50_lp_per_mm.",
    ]


def test_a_lens_without_blur_is_an_ideal() -> None:
    assert any("perfect" in said for said in assumptions(station()))
    assert not any("perfect" in said for said in assumptions(station(mtf50_lp_per_mm=60.0)))
