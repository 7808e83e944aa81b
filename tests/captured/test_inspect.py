"""Frames from files to blobs: the image of the simulation that wrote them, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image as Picture

import gpuspec
from gpuspec.errors import FrameError

SIZE = (120, 200)


def station(**changes):
    return gpuspec.example("trim").replace(
        part__length_mm=20.0, part__width_mm=12.0, camera__sampling_mm=0.1, populations=(),
        sequence__images=16,
        defects=({"kind": "dent", "x_mm": 2.0, "y_mm": 1.0, "diameter_mm": 1.5, "depth_um": 6.0},),
        **changes,
    )  # fmt: skip


def scene(images: int = 12, noise: float = 0.6, slope: float = 0.0) -> np.ndarray:
    """Frames of a mirror in a dark mount: a stripe pattern moves, thin scratches stay bright."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    rng = np.random.default_rng(4)
    frames = []
    for k in range(images):
        level = 90 + slope * x + 80 * np.sign(np.cos(0.25 * x + 2 * np.pi * k / images))
        level[(np.abs(y - 60) < 2) & (np.abs(x - 100) < 25)] += 12.0
        level[(x < 30) | (x > 170) | (y < 20) | (y > 100)] = 4.0
        frames.append(np.clip(np.rint(level + rng.normal(0, noise, SIZE)), 0, 255))
    return np.array(frames, np.uint8)


def written(folder: Path, frames: np.ndarray, name: str = "f_{}.png") -> Path:
    folder.mkdir(exist_ok=True)
    for k, frame in enumerate(frames):
        Picture.fromarray(frame).save(folder / name.format(k))
    return folder


@pytest.mark.parametrize("bits", [8, 12])
def test_written_frames_give_back_the_mean_to_the_last_bit(bits, tmp_path):
    result = gpuspec.simulate(station(sensor__noise=True, sensor__bit_depth=bits))
    result.save(tmp_path / "run", frames=True, pictures=False)
    found = gpuspec.inspect(
        tmp_path / "run/frames.tif", tmp_path / "run/station.toml",
        truth=tmp_path / "run/truth.tif",
    )  # fmt: skip
    assert np.array_equal(found.aspect, result.aspect)
    assert np.array_equal(found.labels, result.labels)
    assert found.score.defects_hit == result.score.defects_hit == 1
    assert found.score.p2 == result.score.p2


def test_only_whole_periods_of_files_and_arrays_are_used_and_it_is_said(tmp_path):
    frames = scene()
    more = np.concatenate([np.full((1, *SIZE), 1, np.uint8), frames, frames[:1]])
    for given in (more, list(more), written(tmp_path / "shots", more)):
        found = gpuspec.inspect(given)
        assert np.array_equal(found.aspect, frames.mean(axis=0, dtype=np.float64).astype("f4"))
        assert [row.used for row in found.frames] == [False, *[True] * 12, False]
        assert "are whole periods of the light" in " ".join(found.warnings)
    every = gpuspec.inspect(more, every_frame=True)
    assert len(every.used) == 14
    with pytest.raises(FrameError, match="cannot be had twice"):
        gpuspec.inspect(iter(more))


def test_a_strange_frame_among_others_is_refused_and_every_frame_takes_it():
    frames = scene()
    frames[5] = 1
    with pytest.raises(FrameError, match=r"frame 6 does not belong .* take them with --every-fr"):
        gpuspec.inspect(frames)
    assert len(gpuspec.inspect(frames, every_frame=True).used) == 12


def test_natural_order_is_that_of_numbers(tmp_path):
    found = gpuspec.inspect(written(tmp_path / "shots", scene()))
    assert [row.name for row in found.frames] == [f"f_{k}.png" for k in range(12)]


def test_scratches_stand_above_a_local_background_in_the_region_of_the_light():
    frames = scene(slope=0.3)  # the background rises by far more than a scratch
    plain = gpuspec.Station(camera={"sampling_mm": 0.1})
    local = plain.replace(segmentation__background_mm=3.0, segmentation__min_area_mm2=0.2)
    assert len(gpuspec.inspect(frames, plain, region="found:5").blobs) == 0
    found = gpuspec.inspect(frames, local, region="found:5")
    assert len(found.blobs) == 1
    assert found.labels[59:62, 80:120].all()
    inside = found.lost == 0
    assert not inside[:, :33].any()
    assert inside[40:80, 50:150].all()
    darker = gpuspec.inspect(
        255 - frames, local.replace(segmentation__polarity="dark"), region=inside
    )
    assert (darker.labels > 0).sum() == pytest.approx((found.labels > 0).sum(), rel=0.05)


REFUSED = {
    "a hole in the numbers": (lambda d: (d / "f_5.png").unlink(), "f_5.png is missing between"),
    "a truncated file": (
        lambda d: (d / "f_5.png").write_bytes((d / "f_5.png").read_bytes()[:900]), "f_5.png",
    ),
    "a damaged file": (
        lambda d: (d / "f_5.png").write_bytes(
            (d / "f_5.png").read_bytes()[:900] + bytes(40) + (d / "f_5.png").read_bytes()[940:]
        ),
        "f_5.png cannot be decoded",
    ),
    "another size": (
        lambda d: Picture.fromarray(np.zeros((9, 9), np.uint8)).save(d / "f_5.png"), "f_5.png",
    ),
    "another depth": (
        lambda d: Picture.fromarray(np.zeros(SIZE, np.uint16)).save(d / "f_5.png"), "f_5.png",
    ),
    "colour": (
        lambda d: [Picture.new("RGB", SIZE[::-1]).save(p) for p in d.iterdir()], "colour",
    ),
    "other pictures": (
        lambda d: Picture.new("L", (9, 9)).save(d / "map.png"), "pictures of several names",
    ),
    "no frames": (lambda d: [p.unlink() for p in d.iterdir()], "holds no PNG or TIFF"),
    "black frames": (
        lambda d: [Picture.new("L", SIZE[::-1]).save(p) for p in d.iterdir()], "frames are black",
    ),
    "white frames": (
        lambda d: [Picture.new("L", SIZE[::-1], 255).save(p) for p in d.iterdir()],
        "saturated everywhere",
    ),
}  # fmt: skip


@pytest.mark.parametrize("spoil", REFUSED)
def test_what_cannot_be_inspected_is_refused_in_a_sentence(spoil, tmp_path, gpuspec_):
    shots = written(tmp_path / "shots", scene())
    do, words = REFUSED[spoil]
    do(shots)
    ran = gpuspec_("inspect", str(shots), "-o", str(tmp_path / "out"))
    assert ran.code == 1
    assert words in " ".join(ran.err.split())
    assert "Traceback" not in ran.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("region", "words"),
    [("0,0,0,0", "region"), ("found:none", "margin in pixels"), ("nothing.png", "nothing.png")],
)
def test_a_region_that_is_none_is_refused(region, words):
    with pytest.raises(FrameError, match=words):
        gpuspec.inspect(scene(), region=region)


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_a_station_of_more_bits_than_the_frames_have_is_refused(bits):
    deeper = gpuspec.Station(camera={"sampling_mm": 0.1}, sensor={"bit_depth": bits})
    with pytest.raises(FrameError, match=rf"numbers of 8 bit, and .* sensor\.bit_depth = {bits}"):
        gpuspec.inspect(scene(), deeper)


def test_a_mask_of_another_size_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "mask.tif", np.ones((5, 5), np.uint8))
    with pytest.raises(FrameError, match="5 x 5 pixels and the frames 200 x 120"):
        gpuspec.inspect(scene(), region=tmp_path / "mask.tif")


def test_the_command_writes_a_folder_that_tells_of_every_frame(tmp_path, gpuspec_):
    shots = written(tmp_path / "shots", np.concatenate([scene(), scene()[:1]]))
    ran = gpuspec_("inspect", str(shots), "-o", str(tmp_path / "out"), "--region", "found:5")
    assert ran.code == 0, ran.err
    table = (tmp_path / "out/frames.csv").read_text("utf-8")
    assert "it repeats f_0.png" in table
    assert (tmp_path / "out/detection.png").stat().st_size > 10_000


def test_the_command_replays_frames_at_other_exposures(tmp_path, gpuspec_):
    shots = written(tmp_path / "shots", scene() // 3)
    out = tmp_path / "out"
    arguments = "inspect", str(shots), "-o", str(out), "--region", "found:5", "--no-pictures"
    ran = gpuspec_(*arguments, "--exposure", "1:8:4")
    assert ran.code == 0, ran.err
    table = (out / "exposure.csv").read_text("utf-8").splitlines()
    assert [line.split(",")[0] for line in table[1:]] == ["1", "2", "4", "8"]
    assert "shows scratches best" in ran.out
    refused = gpuspec_(*arguments, "--exposure", "4:1:3")
    assert refused.code == 1
    assert "write FROM:TO:COUNT" in refused.err
