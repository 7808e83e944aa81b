"""The size that a map gives, what is said of it, and what makes it no mirror."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from maps import (
    grid,
    patch_station,
    plain_station,
    polished,
    rejected,
    relief_station,
    write_sur,
)
from scipy import ndimage
from tolerances import (
    MAP_FILLED_MM,
    MAP_PITCH,
    MAP_SOLVED_MM,
)

from gpuspec.errors import StationError, TopographyError
from gpuspec.part.maps import read_maps
from gpuspec.simulation import memory
from gpuspec.simulation.simulate import simulate
from gpuspec.station.defects import Topography
from gpuspec.station.sections import Part
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml
from gpuspec.topographies import form
from gpuspec.topographies.form import filled


def test_a_part_takes_the_size_of_its_map_where_it_states_none(folder):
    data = relief_station(folder).as_dict()
    for given, size in (
        ({}, (0.48, 0.4)),
        ({"length_mm": 0.3}, (0.3, 0.4)),
        ({"width_mm": 0.2}, (0.48, 0.2)),
    ):
        part = {"relief": {"file": "x.sur"}, **given}
        station = Station.from_dict({**data, "part": part}, "demo.toml", folder)
        np.testing.assert_allclose(
            (station.part.length_mm, station.part.width_mm), size, rtol=MAP_PITCH
        )
        (m,) = read_maps(station)
        assert m.name == "part.relief"
        again = Station.parse(to_toml(station), "again.toml", folder)
        assert again.part == station.part  # written as resolved


def test_a_map_that_cannot_be_read_is_told_before_the_size_it_would_have_given(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(memory, "free_bytes", lambda: 1000)
    for file, keys, why in (
        ("nowhere.npy", {}, 'part.relief.file = "nowhere.npy" is not there'),
        ("x.npy", {"height_unit": None}, "give part.relief.height_unit"),
        ("x.npy", {"pitch_um": None}, "give part.relief.pitch_um"),
    ):
        np.save(tmp_path / "x.npy", np.zeros((10, 20)))
        with pytest.raises(TopographyError, match=re.escape(why)):
            simulate(plain_station(tmp_path, file, **keys), "numpy")
    with pytest.raises(StationError, match="GiB"):
        simulate(plain_station(tmp_path, "x.npy"), "numpy")


def test_a_pitch_is_a_number_or_two(tmp_path):
    np.save(tmp_path / "x.npy", np.zeros((10, 20)))
    for pitch in (4, 4.5, [5, 4.0]):
        station = plain_station(tmp_path, "x.npy", pitch_um=pitch)
        assert Station.parse(to_toml(station), "demo.toml", tmp_path).part == station.part
    for wrong, why in (
        ("4", "must be a number, or must be a list"),
        ([1.0], "pitch_um"),
        ([1.0, 2.0, 3.0], "pitch_um"),
        (-1.0, "must be greater than 0"),
        ([0.0, 1.0], "must be greater than 0"),
    ):
        with pytest.raises(StationError) as caught:
            plain_station(tmp_path, "x.npy", pitch_um=wrong)
        assert why in str(caught.value)
        assert "part.relief.pitch_um" in str(caught.value)
        for jargon in ("tuple", "Field", "Input"):
            assert jargon not in str(caught.value), str(caught.value)


def test_a_station_made_in_python_has_its_maps_size_too():
    for part in ({"relief": {"file": "polished"}}, Part(relief=Topography(file="polished"))):
        station = Station(part=part)
        assert (station.part.length_mm, station.part.width_mm) == (1.96, 1.68)
        assert station.sides_of_map == ("length_mm", "width_mm")
    assert Station(part=Part(length_mm=1.0, relief={"file": "polished"})).part.length_mm == 1.0
    assert Station().sides_of_map == ()


def test_another_map_gives_the_part_another_size_and_none_leaves_it(folder):
    write_sur(folder / "y.sur", np.zeros((50, 60)))
    data = relief_station(folder).as_dict()
    part = {"relief": {"file": "nowhere.sur"}}
    station = Station.from_dict({**data, "part": part}, "demo.toml", folder)
    assert "is not there" in rejected(station)
    for file, length in (("x.sur", 0.48), ("y.sur", 0.24)):
        station = station.replace(part__relief__file=file)
        assert station.part.length_mm == pytest.approx(length)
    assert station.replace(part__relief=None).part.length_mm == pytest.approx(0.24)
    fixed = station.replace(part__length_mm=0.2)
    assert fixed.replace(part__relief__file="x.sur").part.length_mm == 0.2
    assert fixed.replace(part__length_mm=None).part.length_mm == pytest.approx(0.24)


def test_a_map_larger_than_the_part_is_cropped_with_a_word(folder):
    (m,) = read_maps(relief_station(folder, (0.24, 0.4)))
    (told,) = (r for r in m.remarks if "left out" in r)
    assert told.startswith("part.relief: 50 % of its map, 0.48 x 0.4 mm, lie beyond the part")
    (whole,) = read_maps(relief_station(folder))
    assert not any("left out" in r for r in whole.remarks)


def test_a_patch_beyond_the_edge_is_cropped_with_a_word(folder):
    (m,) = read_maps(patch_station(folder, x_mm=1.0))
    assert any(r.startswith("defects[2]: 50 % of its map") for r in m.remarks)
    (m,) = read_maps(patch_station(folder))
    assert not any("left out" in r for r in m.remarks)


def test_missing_points_are_told_with_their_share_and_place(folder):
    heights, missing = polished()
    missing[20:64, 10:70] = True
    write_sur(folder / "x.sur", heights, missing=missing)
    (m,) = read_maps(relief_station(folder))
    assert m.remarks == (
        "part.relief: 22 % of the map's points (2,641) are missing; they were filled smoothly from "
        "those around them and count as flawless (the largest hole, 0.24 x 0.176 mm, at "
        "x = -0.08, y = 0.032 mm).",
    )


def test_a_map_without_faults_is_passed_over_in_silence(folder):
    write_sur(folder / "x.sur", polished()[0])
    assert read_maps(relief_station(folder))[0].remarks == ()


def test_filling_needs_no_other_package_and_is_harmonic(tmp_path):
    x, y = grid(40, 30)
    saddle = 1e-3 * x * y + 2e-3 * (x * x - y * y) + 1e-3 * x
    defined = np.ones(saddle.shape, bool)
    defined[5:20, 8:25] = defined[28, 3] = False
    np.testing.assert_allclose(filled(saddle * defined, defined), saddle, atol=MAP_SOLVED_MM)
    defined[:, 30:] = False  # up to the edge
    found = filled(saddle * defined, defined)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[defined], saddle[defined])


def test_many_missing_points_are_filled_from_half_of_them(monkeypatch):
    x, y = grid(121, 101)
    random = np.random.default_rng(5)
    heights = 1e-3 * ndimage.gaussian_filter(random.normal(size=x.shape), 8)
    defined = np.hypot(x - 0.05, y) > 0.1
    defined[60:, 100:] = False
    solved = filled(heights, defined)
    monkeypatch.setattr(form, "SOLVED_MAX", 300)
    halved = filled(heights, defined)
    np.testing.assert_array_equal(halved[defined], heights[defined])
    # Measured 2.2 % of the heights' range, 0.45 % in the mean.
    np.testing.assert_allclose(halved, solved, rtol=0, atol=0.03 * np.ptp(heights))
    assert np.abs(halved - solved)[~defined].mean() < 0.01 * np.ptp(heights)


@pytest.mark.parametrize("times", [1000.0, 1e6])
def test_a_map_in_another_unit_than_its_file_says_is_refused(folder, times):
    heights, _ = polished()
    write_sur(folder / "x.sur", heights * times, pitch_mm=(0.004 * times,) * 2, step_mm=1e-5)
    told = rejected(relief_station(folder))
    assert "covers fewer than 4 of its points; check the unit of the map's pitch" in told


def test_a_size_that_the_map_gives_is_named_where_it_makes_the_station_impossible(folder):
    write_sur(folder / "x.sur", polished()[0], pitch_mm=(4.0, 4.0))
    with pytest.raises(StationError) as caught:
        plain_station(folder, "x.sur", height_unit=None, pitch_um=None)
    assert "makes an image of 120000 x 100000 pixels" in str(caught.value)
    assert "part.relief gives the part length_mm = 480 and width_mm = 400" in str(caught.value)


def test_points_many_pixels_apart_are_told(folder):
    station = relief_station(folder).replace(camera__sampling_mm=0.0004)
    assert "10 pixels apart, 0.004 mm" in " ".join(read_maps(station)[0].remarks)


def test_a_map_smaller_than_a_pixel_is_told(folder):
    (m,) = read_maps(patch_station(folder, sampling=0.5))
    assert any("is smaller than a pixel" in remark for remark in m.remarks)


def spiked(folder, *points, height_mm=0.25):
    heights, _ = polished()
    for row, column in points:
        heights[row, column] += height_mm
    write_sur(folder / "x.sur", heights)
    return relief_station(folder, form_removed="plane")


def test_a_spike_that_makes_a_map_no_mirror_is_named_with_the_way_out(folder):
    station = spiked(folder, (30, 100), height_mm=2.0)
    told = rejected(station)
    assert "one point stands far out of the surroundings, by 2000 um in line 31" in told
    assert "column 101 of the map, at x = 0.162 mm, y = 0.078 mm" in told
    assert "part.relief.outlier_um = 4 leaves out" in told
    (m,) = read_maps(station.replace(part__relief__outlier_um=4.0))
    write_sur(folder / "x.sur", polished()[0])
    (clean,) = read_maps(relief_station(folder))
    np.testing.assert_allclose(m.relief_mm, clean.relief_mm, atol=MAP_FILLED_MM)
    assert m.remarks == (
        "part.relief: 1 of the map's points stands more than outlier_um = 4 um out of its "
        "surroundings and was left out: by 2000 um in line 31, column 101 of the map, at "
        "x = 0.162 mm, y = 0.078 mm.",
    )


def test_a_filled_point_is_no_spike_however_steep_its_neighbours(tmp_path):
    """Two above and two below: what is filled between them lies in the middle."""
    heights = np.zeros((100, 120))
    heights[50, [59, 61]], heights[[49, 51], 60] = 0.02, -0.02
    missing = np.zeros(heights.shape, bool)
    missing[50, 60] = True
    write_sur(tmp_path / "x.sur", heights, missing=missing)
    (m,) = read_maps(relief_station(tmp_path, form_removed="none"))
    assert "part.relief: 4 points stand out, steeper than 45" in " ".join(m.remarks)


def test_outliers_are_left_out_of_the_form_and_of_the_zones(folder):
    station = spiked(folder, (30, 100), (31, 100), (0, 0), (99, 5))
    station = station.replace(part__relief__zone_height_um=0.3)
    (m,) = read_maps(station.replace(part__relief__outlier_um=10.0))
    write_sur(folder / "x.sur", polished()[0])
    (clean,) = read_maps(relief_station(folder, zone_height_um=0.3))
    np.testing.assert_array_equal(m.zone, clean.zone)
    assert "4 of the map's points stand more than" in m.remarks[0]


def test_pits_and_polish_are_no_outliers(folder):
    write_sur(folder / "x.sur", polished()[0])
    (m,) = read_maps(relief_station(folder, outlier_um=1.2))
    assert m.remarks == ()


def test_a_limit_that_leaves_nothing_is_refused(folder):
    rough = np.random.default_rng(0).normal(0, 1e-5, (100, 120))
    write_sur(folder / "x.sur", polished()[0] + rough)
    assert "give a larger one" in rejected(relief_station(folder, outlier_um=1e-4))


def test_a_rough_map_is_not_blamed_on_a_point(folder):
    write_sur(folder / "x.sur", np.random.default_rng(0).normal(size=(40, 40)))
    assert "check the units of its heights and pitch" in rejected(patch_station(folder))


def test_what_was_done_to_a_map_stands_beside_the_score(folder, opencl):
    result = simulate(relief_station(folder, zone_height_um=0.3), opencl)
    assert any(warning.startswith("part.relief: ") for warning in result.warnings)


def test_the_made_surface_is_read_without_a_file(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    data = {"part": {"relief": {"file": "polished", "form_removed": "curvature"}}}
    station = Station.from_dict(data, "demo.toml", tmp_path)
    assert (station.part.length_mm, station.part.width_mm) == (1.96, 1.68)
    (m,) = read_maps(station)
    slopes = np.gradient(m.relief_mm, 0.0035)
    assert 0.001 < np.sqrt(sum(np.mean(s**2) for s in slopes)) < 0.005
    assert m.remarks == ()
    np.save(tmp_path / "polished", np.zeros((4, 4)))
    (tmp_path / "polished.npy").rename(tmp_path / "polished")
    assert "polished" in rejected(station)  # a file of that name comes first


def test_a_spike_in_a_map_is_named_with_the_way_to_leave_it_out(tmp_path):
    heights = np.zeros((200, 200))
    heights[150, 60] = 0.5
    np.savetxt(tmp_path / "x.txt", heights)
    station = relief_station(tmp_path).replace(
        part__length_mm=10.0, part__width_mm=10.0, camera__sampling_mm=0.05,
        part__relief={"file": "x.txt", "pitch_um": 50.0, "height_unit": "mm"},
    )  # fmt: skip
    (m,) = read_maps(station)
    assert "part.relief: one point stands out, steeper than 45" in " ".join(m.remarks)
    assert "in line 151, column 61 of the map" in " ".join(m.remarks)
    (kept,) = read_maps(station.replace(part__relief__outlier_um=50.0))
    assert "steeper" not in " ".join(kept.remarks)


def test_heights_in_another_unit_are_suspected(tmp_path):
    heights = 0.02 * np.sin(np.arange(100) / 2)[:, None] * np.ones(100)
    np.savetxt(tmp_path / "x.txt", heights)
    station = relief_station(tmp_path).replace(
        part__length_mm=1.0, part__width_mm=1.0,
        part__relief={"file": "x.txt", "pitch_um": 9.0, "height_unit": "mm"},
    ).replace(part__length_mm=0.9, part__width_mm=0.9)  # fmt: skip
    (m,) = read_maps(station)
    assert "heights may be in another unit: check height_unit" in " ".join(m.remarks)
    (m,) = read_maps(station.replace(part__relief__height_unit="um"))
    assert "steeper" not in " ".join(m.remarks)
