"""What is inspected: said as a box, a polygon or a mask, or found from the light."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from PIL import Image as Picture

from gpuspec.errors import FrameError
from gpuspec.frames.outline import outlined
from gpuspec.frames.region import lit_region

SHAPE = (60, 80)


def boxed(top: int, bottom: int, left: int, right: int) -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[top:bottom, left:right] = True
    return mask


@pytest.mark.parametrize("said", ["10,20,30,45", " 10 , 20 , 30 , 45 ", "9.6,20.4,30,45"])
def test_a_box_is_left_top_right_bottom(said):
    assert np.array_equal(outlined(said, SHAPE), boxed(20, 45, 10, 30))


def test_what_a_box_has_beside_the_frames_is_left_out():
    assert np.array_equal(outlined("-5,-5,12,400", SHAPE), boxed(0, 60, 0, 12))


def test_a_polygon_has_the_pixels_whose_centres_are_in_it():
    found = outlined("10,10 50.3,10 10,50.3", SHAPE)
    row, column = np.mgrid[:60, :80] + 0.5
    assert np.array_equal(found, (row > 10) & (column > 10) & (row + column < 60.3))
    assert np.array_equal(outlined("10,20 30,20 30,45 10,45", SHAPE), boxed(20, 45, 10, 30))


@pytest.mark.parametrize("name", ["m.png", "m.tif"])
@pytest.mark.parametrize("level", [1, 255])
def test_a_mask_is_what_is_not_0(name, level, tmp_path):
    image = level * boxed(5, 50, 6, 70).astype(np.uint8)
    if name.endswith("png"):
        Picture.fromarray(image).save(tmp_path / name)
    else:
        tifffile.imwrite(tmp_path / name, image)
    assert np.array_equal(outlined(tmp_path / name, SHAPE), image > 0)
    assert np.array_equal(outlined(image > 0, SHAPE), image > 0)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("30,20,10,45", "30,20,10,45 is no box"),
        ("90,0,99,20", "90,0,99,20 holds no pixel of the frames"),
        ("200,200 210,200 210,210", "holds no pixel of the frames"),
        ("10,20", "neither a box left,top,right,bottom, nor a polygon"),
        ("nothing.png", "nothing.png is neither a box"),
        (np.ones((5, 6), bool), "the region has 6 x 5 pixels and the frames 80 x 60"),
        (np.zeros(SHAPE, bool), "the region holds no pixel of the frames"),
    ],
)
def test_a_region_that_is_none_is_refused(said, words):
    with pytest.raises(FrameError, match=words):
        outlined(said, SHAPE)


def test_a_file_that_is_no_mask_is_refused_by_name(tmp_path):
    Picture.new("RGB", (80, 60)).save(tmp_path / "rgb.png")
    with pytest.raises(FrameError, match=r"rgb\.png is no mask"):
        outlined(tmp_path / "rgb.png", SHAPE)
    (tmp_path / "text.png").write_text("text")
    with pytest.raises(FrameError, match=r"text\.png is neither PNG nor TIFF"):
        outlined(tmp_path / "text.png", SHAPE)
    Picture.new("L", (80, 60)).save(tmp_path / "empty.png")
    with pytest.raises(FrameError, match=r"empty\.png holds no pixel"):
        outlined(tmp_path / "empty.png", SHAPE)


def test_the_region_of_the_light_is_the_part_without_its_mount_and_its_margin():
    rng = np.random.default_rng(1)
    modulation = rng.uniform(0, 6, SHAPE)
    modulation[boxed(10, 50, 15, 65)] += 120
    modulation[boxed(2, 6, 2, 20)] += 140  # a glaring edge of the mount, apart
    modulation[boxed(28, 31, 30, 50)] = 0  # a scratch on the part
    assert np.array_equal(lit_region(modulation, 0), boxed(10, 50, 15, 65))
    assert lit_region(modulation, 5).sum() == 30 * 40
    assert np.array_equal(lit_region(modulation), boxed(10, 50, 15, 65))  # 60 / 64: under a pixel


@pytest.mark.parametrize("spread", [0.0, 4.0, 20.0])
def test_where_the_light_passes_over_the_whole_frame_all_of_it_is_the_region(spread):
    modulation = np.random.default_rng(1).normal(220, spread, SHAPE)
    assert lit_region(modulation, 0).all()


@pytest.mark.parametrize(
    ("modulation", "margin", "words"),
    [
        (np.zeros(SHAPE), None, "the light changes nowhere"),
        (90.0 * boxed(20, 40, 20, 40), 30, "nothing is left of the lit region within its margin"),
    ],
)
def test_where_no_light_passes_there_is_no_region(modulation, margin, words):
    with pytest.raises(FrameError, match=words):
        lit_region(modulation, margin)
