"""Real interfaces of cameras, with the emulated cameras that come with them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_inspect import SIZE, scene, written
from test_line import STATION

import gpuspec
from gpuspec.captured.cameras import harvester_frames, pylon_frames
from gpuspec.errors import FrameError

ROWS, COLUMNS = SIZE


@pytest.fixture
def pylon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Basler's emulated camera, replaying a folder of frames."""
    monkeypatch.setenv("PYLON_CAMEMU", "1")
    from pypylon import pylon

    info = pylon.DeviceInfo()
    info.SetDeviceClass("BaslerCamEmu")
    camera = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateFirstDevice(info))
    camera.Open()
    camera.ImageFilename.Value = str(written(tmp_path / "shots", scene(), "f_{:02}.png"))
    camera.ImageFileMode.Value = "On"
    camera.TestImageSelector.Value = "Off"
    camera.PixelFormat.Value = "Mono8"
    camera.Width.Value, camera.Height.Value = COLUMNS, ROWS
    camera.AcquisitionFrameRateEnable.Value = True
    camera.AcquisitionFrameRateAbs.Value = 200.0
    yield camera
    camera.Close()


@pytest.fixture
def viky() -> Iterator[Any]:
    """The GenTL producer that comes with GenICam's package: a ball that bounces."""
    import genicam
    from harvesters.core import Harvester

    harvester = Harvester()
    harvester.add_file(str(Path(genicam.__file__).parent / "viky.cti"))
    harvester.update()
    acquirer = harvester.create(0)
    acquirer.remote_device.node_map.PixelFormat.value = "Mono8"
    yield acquirer
    acquirer.destroy()
    harvester.reset()


def test_a_basler_camera_s_frames_are_decided_on_as_their_files_are(pylon, tmp_path):
    line = gpuspec.Line(STATION, region="40,30,160,90")
    frames = pylon_frames(pylon)
    decisions = [line.take(frames) for _ in range(2)]
    frames.close()
    assert not pylon.IsGrabbing()
    files = gpuspec.inspect(tmp_path / "shots", STATION, region="40,30,160,90")
    for number, decided in enumerate(decisions, 1):
        assert decided.part == number
        assert np.array_equal(decided.aspect, files.aspect)
        assert decided.decision == files.decision
        assert not decided.accepted


def test_a_frame_that_the_camera_failed_to_grab_is_named_and_the_next_part_is_whole(pylon):
    line = gpuspec.Line(STATION)
    frames = pylon_frames(pylon)
    line.take(frames)
    pylon.ForceFailedBufferCount.Value = 1
    pylon.ForceFailedBuffer.Execute()
    words = (
        r"part \d: frame \d+ could not be grabbed: The buffer was incompletely grabbed; take the"
    )
    with pytest.raises(FrameError, match=words):
        for _ in range(3):  # some frames were grabbed before it was told to fail
            line.take(frames)
    decided = line.take(frames)
    frames.close()
    assert len(line) == 0
    assert decided.part == line.part - 1


def test_a_frame_that_comes_late_or_never_is_named(pylon):
    pylon.AcquisitionFrameRateAbs.Value = 10.0
    line = gpuspec.Line(STATION, gap_s=0.03)
    frames = pylon_frames(pylon)
    with pytest.raises(FrameError, match=r"part 1: frame 1 is late: it came 0\.\d+ s after"):
        line.take(frames)
    frames.close()
    pylon.TriggerSelector.Value = "FrameStart"
    pylon.TriggerMode.Value = "On"
    pylon.TriggerSource.Value = "Software"
    with pytest.raises(FrameError, match=r"the first frame did not come within 0\.2 s; check"):
        gpuspec.Line(STATION).take(pylon_frames(pylon, timeout_s=0.2))
    assert not pylon.IsGrabbing()


def test_a_genicam_camera_s_frames_come_whole_and_in_their_order(viky):
    frames = harvester_frames(viky)
    grabbed = list(islice(frames, 6))
    assert [one.number for one in grabbed] == list(range(1, 7))
    assert all(one.frame.shape == (400, 400) for one in grabbed)
    assert all(one.frame.dtype == np.uint8 for one in grabbed)
    assert any((one.frame != grabbed[0].frame).any() for one in grabbed[1:])  # the ball moves
    times = [one.time_s for one in grabbed]
    assert times == sorted(times)
    line = gpuspec.Line(gpuspec.Station(sequence={"images": 4}))
    decided = line.take(frames)
    assert decided.aspect.shape == (400, 400)
    with pytest.raises(FrameError, match="frame 12 was lost, for frame 13 came after frame 11"):
        line.take(one for one in frames if one.number != 12)
    frames.close()
    again = harvester_frames(viky)  # numbers begin anew
    assert line.take(again).part == 3
    again.close()


def test_coloured_frames_of_a_camera_are_refused(viky):
    viky.remote_device.node_map.PixelFormat.value = "RGBa8"
    frames = harvester_frames(viky)
    with pytest.raises(FrameError, match=r"not an image of rows and columns, but of \(400, 400, 4"):
        gpuspec.Line(STATION).take(frames)
    frames.close()


def test_a_genicam_camera_that_gives_no_frame_is_told(viky):
    frames = harvester_frames(viky, timeout_s=0.001)
    with pytest.raises(FrameError, match=r"did not come within 0\.001 s"):
        list(islice(frames, 200))
