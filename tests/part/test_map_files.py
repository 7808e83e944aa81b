"""Files of measured heights: formats, units, pitch; what is refused."""

from __future__ import annotations

import struct
import sys

import numpy as np
import pytest
import tifffile
from maps import (
    UNIT_MM,
    patch_station,
    plain_station,
    polished,
    rejected,
    relief_station,
    write_sur,
)
from PIL import Image

from gpuspec.errors import TopographyError
from gpuspec.part.maps import read_maps
from gpuspec.station.station import Station


def test_a_missing_file_is_named_with_the_place_looked_for(folder):
    message = rejected(relief_station(folder).replace(part__relief__file="nowhere.sur"))
    assert message.startswith(
        'demo.toml: part.relief.file = "nowhere.sur" is not there; looked for'
    )
    message = rejected(patch_station(folder, file="nowhere.sur"))
    assert message.startswith('demo.toml: defects[2].file = "nowhere.sur" is not there')


def test_a_file_without_unit_is_refused(folder):
    np.savetxt(folder / "x.sur", np.random.default_rng(0).normal(size=(9, 9)))
    told = rejected(patch_station(folder))
    assert "carries no length unit" in told
    assert "defects[2].height_unit" in told
    assert "defects[2].pitch_um" in told


@pytest.mark.slow
def test_unknown_formats_and_damaged_files_are_refused_in_silence(folder, capfd):
    whole = (folder / "x.sur").read_bytes()
    random = np.random.default_rng(3)
    flipped = [
        bytes(b ^ (random.random() < 0.05) * int(random.integers(1, 256)) for b in whole[:512])
        + whole[512:]
        for _ in range(20)
    ]
    truncated = [whole[:n] for n in (0, 1, 12, 100, 511, 512, 600, len(whole) - 1)]
    noise = [random.bytes(n) for n in (3, 300, 3000)]
    text = [
        b"not a topography\n",
        b"1 2 3\n4 5\n",
        b"PK\x03\x04" + b"\0" * 60,
        b"\x89HDF\r\n\x1a\n",
    ]
    refused = 0
    for content in flipped + truncated + noise + text:
        (folder / "x.sur").write_bytes(content)
        try:
            read_maps(patch_station(folder))
        except TopographyError as error:
            refused += 1
            assert str(error).startswith('demo.toml: defects[2].file = "x.sur" ')
            assert "\n" not in str(error)
    assert refused >= len(truncated + noise + text)
    assert capfd.readouterr() == ("", "")


def test_a_line_scan_is_refused(folder):
    np.savetxt(folder / "x.sur", np.stack([np.arange(20.0), np.zeros(20)], axis=1))
    assert "is a line scan, not an area" in rejected(patch_station(folder))


def test_too_few_points_are_refused(folder):
    write_sur(folder / "x.sur", np.zeros((3, 9)))
    assert "has 9 x 3 points; at least 4 x 4" in rejected(patch_station(folder))


def test_a_huge_map_is_refused_before_it_is_read(folder):
    write_sur(folder / "x.sur", np.zeros((4, 4)))
    content = bytearray((folder / "x.sur").read_bytes())
    content[108:120] = struct.pack("<iiI", 20_000, 20_000, 400_000_000)
    (folder / "x.sur").write_bytes(content)
    assert "400,000,000 points, more than 100,000,000" in rejected(patch_station(folder))


@pytest.mark.parametrize(("rows", "share"), [(100, "all"), (60, "60%")])
def test_a_map_that_misses_most_of_its_points_is_refused(folder, rows, share):
    heights, missing = polished()
    missing[:] = False
    missing[:rows] = True
    write_sur(folder / "x.sur", heights, missing=missing)
    assert f"misses {share} of its points" in rejected(patch_station(folder))


def test_infinite_heights_are_refused(folder, monkeypatch):
    import SurfaceTopography

    read = SurfaceTopography.open_topography

    def with_infinity(path):
        reader = read(path)
        measured = reader.topography()
        heights = measured.heights().copy()
        heights[50, 50] = np.inf
        unit, size = measured.unit, measured.physical_sizes
        measured = SurfaceTopography.Topography(heights, size, unit=unit)
        monkeypatch.setattr(reader, "topography", lambda: measured)
        return reader

    monkeypatch.setattr(SurfaceTopography, "open_topography", with_infinity)
    assert "holds infinite heights" in rejected(patch_station(folder))


def test_absurd_slopes_are_refused(folder):
    write_sur(folder / "x.sur", np.random.default_rng(0).normal(size=(40, 40)))
    assert "rms slope" in rejected(patch_station(folder))


def test_heights_too_far_from_zero_for_single_precision_are_refused(folder):
    heights, _ = polished()
    write_sur(folder / "x.sur", heights + 5)
    assert "reaches 5.0" in rejected(relief_station(folder, form_removed="none"))
    read_maps(relief_station(folder, form_removed="mean"))


def test_smoothing_that_leaves_nothing_is_refused(folder):
    assert "nothing is left" in rejected(patch_station(folder, smoothing_um=500.0))


def test_zone_files_that_cannot_be_used_are_refused(folder):
    assert 'zone_file = "z.png" is not there' in rejected(patch_station(folder, zone_file="z.png"))
    (folder / "z.png").write_bytes(b"nothing")
    assert "is not an image" in rejected(patch_station(folder, zone_file="z.png"))
    Image.fromarray(np.zeros((120, 100), np.uint8)).save(folder / "z.png")
    message = rejected(patch_station(folder, zone_file="z.png"))
    assert message.startswith('demo.toml: defects[2].zone_file = "z.png" has 120 x 100 pixels')
    both = patch_station(folder, zone_file="z.png", zone_height_um=1.0)
    assert "stands beside zone_height_um" in rejected(both)


def test_without_surface_topography_the_extra_is_named(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    assert 'pip install "gpuspec[topography]"' in rejected(patch_station(folder))


def test_a_station_without_topography_needs_no_reader(monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    assert read_maps(Station()) == ()


def as_text(heights, apart, number="{:.3f}"):
    return "".join(apart.join(number.format(h) for h in line) + "\n" for line in heights)


@pytest.mark.parametrize("name", ["x.npy", "x.tif", "x.txt", "x.csv", "x.asc", "x.dat"])
def test_a_matrix_without_units_takes_those_of_the_station_file(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)  # none of these needs it
    heights, missing = polished()
    nanometres = np.where(missing, np.nan, heights * 1e6)
    path = tmp_path / name
    if name == "x.npy":
        np.save(path, nanometres)
    elif name == "x.tif":
        tifffile.imwrite(path, nanometres.astype(np.float32))
    else:
        path.write_text(as_text(nanometres, "," if name == "x.csv" else " "), encoding="utf-8")
    (m,) = read_maps(plain_station(tmp_path, name))
    np.testing.assert_allclose(m.relief_mm[::-1][~missing], heights[~missing], atol=UNIT_MM / 2)
    assert m.pitch_mm == (0.004, 0.004)
    assert "(10) are missing" in m.remarks[0]


@pytest.mark.parametrize(
    ("lines", "apart", "number"),
    [
        ("\ufeff% exported\n", "\t", "{:.3f}"),
        ("# heights\n\n", ";", "{:.3f}"),
        ("", ", ", "{:.6e}"),
        ("", "   ", "{:g}"),
    ],
)
def test_text_is_read_however_its_numbers_stand_apart(tmp_path, lines, apart, number):
    heights, _ = polished()
    text = lines + as_text(heights * 1e6, apart, number)
    (tmp_path / "x.txt").write_text(text, encoding="utf-8")
    (m,) = read_maps(plain_station(tmp_path, "x.txt"))
    np.testing.assert_allclose(m.relief_mm[::-1], heights, atol=UNIT_MM)
    assert m.remarks == ()


def test_decimal_commas_empty_cells_and_a_separator_at_the_end_are_read(tmp_path):
    heights, missing = polished()
    lines = as_text(heights * 1e6, ";").replace(".", ",").splitlines()
    cells = [line.split(";") for line in lines]
    for row, column in np.argwhere(missing):
        cells[row][column] = "" if column else "Bad"
    text = "\r\n".join(";".join(line) + ";" for line in cells)
    (tmp_path / "x.csv").write_text(text, encoding="utf-8")
    (m,) = read_maps(plain_station(tmp_path, "x.csv"))
    np.testing.assert_allclose(m.relief_mm[::-1][~missing], heights[~missing], atol=UNIT_MM / 2)
    assert "(10) are missing" in m.remarks[0]


def test_a_header_that_states_units_is_believed(tmp_path):
    heights, _ = polished()
    header = "# Width: 0.48 mm\n# Height: 0.4 mm\n# Value units: nm\n"
    text = header + as_text(heights * 1e6, "\t")
    (tmp_path / "x.txt").write_text(text, encoding="utf-8")
    station = plain_station(tmp_path, "x.txt", height_unit=None, pitch_um=None)
    (m,) = read_maps(station)
    np.testing.assert_allclose(m.relief_mm[::-1], heights, atol=UNIT_MM / 2)
    assert station.part.length_mm == pytest.approx(0.48)


def test_grey_levels_are_heights_times_their_scale(tmp_path):
    heights, _ = polished()
    levels = np.round(heights * 1e6 / 0.5).astype(np.uint16)  # half a nanometre each
    tifffile.imwrite(tmp_path / "x.tif", levels)
    (m,) = read_maps(plain_station(tmp_path, "x.tif", height_scale=0.5))
    np.testing.assert_allclose(m.relief_mm[::-1], heights, atol=2.6e-7)


def test_a_pitch_may_differ_along_x_and_y(tmp_path):
    np.save(tmp_path / "x.npy", np.zeros((10, 20)))
    station = plain_station(tmp_path, "x.npy", pitch_um=[5, 8.0])
    (m,) = read_maps(station)
    np.testing.assert_allclose(m.pitch_mm, (0.005, 0.008))
    np.testing.assert_allclose((station.part.length_mm, station.part.width_mm), (0.1, 0.08))


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"height_unit": None}, "give part.relief.height_unit"),
        ({"pitch_um": None}, "give part.relief.pitch_um, a number or [along x, along y]"),
    ],
)
def test_a_unit_or_pitch_that_neither_file_nor_station_gives_is_named(tmp_path, keys, why):
    np.save(tmp_path / "x.npy", np.zeros((10, 20)))
    assert why in rejected(plain_station(tmp_path, "x.npy", **keys))


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"height_unit": "um"}, 'part.relief.height_unit = "um" another than its "mm"'),
        ({"pitch_um": 5.0}, "states a pitch of 4 x 4 um itself, and part.relief.pitch_um another"),
    ],
)
def test_units_that_contradict_those_of_the_file_are_refused(folder, keys, why):
    assert why in rejected(relief_station(folder, **keys))


def test_units_that_repeat_those_of_the_file_are_taken(folder):
    read_maps(relief_station(folder, height_unit="mm", pitch_um=4.0))


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (np.zeros((4, 20, 20)), "holds 4 x 20 x 20 values of type float64, not one matrix"),
        (np.zeros((20, 20), complex), "of type complex128, not one matrix"),
        (np.zeros(20), "holds 20 values"),
        (np.zeros((20, 3)), "has 3 x 20 points"),
        (np.full((20, 20), np.inf), "holds infinite heights"),
        (np.full((20, 20), np.nan), "misses all of its points"),
        (np.array([["a"] * 20] * 20), "of type <U1, not one matrix"),
        (np.array([[{}] * 20] * 20), "cannot be read"),
    ],
)
def test_arrays_that_are_no_map_of_heights_are_refused(tmp_path, values, why):
    np.save(tmp_path / "x.npy", values)
    assert why in rejected(plain_station(tmp_path, "x.npy"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x.npy", "x.tif", "x.txt"])
def test_a_damaged_matrix_is_refused_in_a_sentence(tmp_path, name, capfd):
    for content in (b"", b"\x93NUMPY\x01\x00", b"II*\0\x08\0\0\0", bytes(range(256)), b"1 2\n3"):
        (tmp_path / name).write_bytes(content)
        rejected(plain_station(tmp_path, name))
    assert capfd.readouterr() == ("", "")
