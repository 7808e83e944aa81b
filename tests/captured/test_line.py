"""A line decides on each part as its frames come."""

from __future__ import annotations

import numpy as np
import pytest
from test_inspect import scene

import gpuspec
from gpuspec.captured.cameras import Grabbed
from gpuspec.errors import FrameError

STATION = gpuspec.Station.parse(
    """
    [camera]
    sampling_mm = 0.1
    [sequence]
    images = 12
    [segmentation]
    background_mm = 3.0
    [[decision]]
    length_min_mm = 2.0
    """
)


def test_a_scratched_part_is_rejected_and_a_flawless_one_accepted():
    line = gpuspec.Line(STATION, region="40,30,160,90")
    decisions = []
    for frames in (
        scene(),
        np.where(scene() > 0, np.median(scene(), axis=(1, 2))[:, None, None], 0),
    ):
        for frame in frames.astype(np.uint8):
            line.add(frame)
        decisions.append(line.decide())
    assert [one.accepted for one in decisions] == [False, True]
    assert len(decisions[0].reasons) == 1


def test_a_lost_frame_is_named():
    line = gpuspec.Line(STATION)
    line.add(scene()[0], number=7)
    with pytest.raises(FrameError, match="frame 8 was lost"):
        line.add(scene()[2], number=9)


def test_a_part_of_too_few_frames_is_not_decided_on():
    line = gpuspec.Line(STATION)
    line.add(scene()[0])
    with pytest.raises(FrameError, match="1 of 12 frames came"):
        line.decide()


@pytest.mark.parametrize(
    ("spoiled", "words"),
    [
        (
            Grabbed(None, 5, 0.5, "no buffer was free."),
            "part 1: frame 5 could not be grabbed: no buf",
        ),
        (None, "part 1: frame 5 was lost, for frame 6 came after frame 4"),
        (Grabbed(scene()[5][:9], 5, 0.5), r"part 1: frame 5 is uint8 of \(9, 200\)"),
        (Grabbed(scene()[5], 5, 0.9), r"part 1: frame 5 is late: it came 0\.500 s after"),
    ],
    ids=["failed", "lost", "cut", "late"],
)
def test_a_part_with_a_wrong_frame_is_passed_over_and_the_next_is_whole(spoiled, words):
    shots = scene()
    frames = [Grabbed(shots[k % 12], k, 0.1 * k) for k in range(24)]
    frames[5:6] = [spoiled] if spoiled else []
    camera = iter(frames)
    line = gpuspec.Line(STATION, gap_s=0.3)
    with pytest.raises(FrameError, match=words):
        line.take(camera)
    decided = line.take(camera)
    assert decided.part == 2
    assert np.array_equal(decided.aspect, shots.mean(axis=0, dtype=np.float64).astype("f4"))
    assert next(camera, None) is None


SAID = {
    "by the camera": {"camera": {"rows": 120, "columns": 200}},
    "by the part": {"part": {"length_mm": 20.0, "width_mm": 12.0}},
}


@pytest.mark.parametrize("said", SAID)
@pytest.mark.parametrize("shape", [(1, 1), (40, 40), (200, 120), (120, 202)])
def test_frames_of_another_size_than_the_station_says_are_refused(said, shape):
    line = gpuspec.Line(STATION.replace(**SAID[said]))
    words = rf"part 1: frame 1 has {shape[1]} x {shape[0]} pixels, .* the image has 200 x 120; take"
    with pytest.raises(FrameError, match=words):
        line.add(np.full(shape, 60, np.uint8))
    line.begin()
    for frame in scene():
        line.add(frame)
    assert line.decide().aspect.shape == (120, 200)


def test_what_follows_from_the_parts_size_is_a_pixel_more_or_less():
    for rows, columns in ((119, 200), (120, 201)):
        line = gpuspec.Line(STATION.replace(**SAID["by the part"]))
        line.add(np.full((rows, columns), 60, np.uint8))
        assert len(line) == 1
    stated = gpuspec.Line(STATION.replace(**SAID["by the camera"]))
    with pytest.raises(FrameError, match="200 x 119 pixels"):
        stated.add(np.full((119, 200), 60, np.uint8))


def test_frames_larger_than_the_part_are_taken_where_the_camera_says_so():
    part = {"length_mm": 10.0, "width_mm": 5.0}
    line = gpuspec.Line(STATION.replace(part=part, camera={"rows": 120, "columns": 200}))
    line.add(scene()[0])
    assert len(line) == 1


def test_a_camera_that_stops_leaves_a_part_undecided():
    line = gpuspec.Line(STATION)
    with pytest.raises(FrameError, match="part 1: 3 of 12 frames came, so 9 were lost"):
        line.take([Grabbed(scene()[k], k, 0.1 * k) for k in range(3)])
    assert (line.part, len(line)) == (2, 0)
