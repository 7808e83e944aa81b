"""The automatic threshold of frames: they tell the ceiling by the phase of each pixel."""

from __future__ import annotations

import numpy as np
import pytest
from random_stations import flawless
from tolerances import TOLD_CEILING_DN

import gpuspec
from gpuspec.detection.segmentation import automatic_threshold
from gpuspec.light.ceiling import ceiling_of

DENTS = [
    {"kind": "dent", "x_mm": x, "y_mm": y, "diameter_mm": size, "depth_um": depth}
    for x, y, size, depth in (
        (-15, -9, 0.6, 3), (-7, 6, 0.8, 5), (0, -4, 0.9, 8), (8, 8, 1.2, 30), (15, -8, 1.5, 50),
    )
]  # fmt: skip
FEW = gpuspec.Station.from_dict(
    {
        "part": {"length_mm": 40.0, "width_mm": 30.0},
        "tunnel": {"height_mm": 150.0, "luminous_mm": 4.0, "dark_mm": 12.0},
        "camera": {"sampling_mm": 0.1, "pupil_mm": 5.0},
        "sensor": {"exposure": 4.0, "noise": True},
        "sequence": {"images": 12},
        "defects": DENTS,
    },
    "few.toml",
)
"""Twelve noisy images, whose mean ripples by 20 grey levels."""
UNKNOWN = gpuspec.Station(camera={"sampling_mm": 0.1})
"""A station of which nothing but the scale is stated."""


def frames_of(light_map: gpuspec.LightMap) -> np.ndarray:
    images = light_map.station.sequence.images
    return np.stack([np.rint(light_map.image(k)).astype(np.uint8) for k in range(images)])


@pytest.fixture(scope="module")
def few(opencl) -> tuple[gpuspec.Result, np.ndarray]:
    result = gpuspec.simulate(FEW, opencl)
    return result, frames_of(result.light_map)


@pytest.mark.parametrize("station", [UNKNOWN, FEW], ids=["frames alone", "with their station"])
def test_the_ripple_of_few_images_hides_no_defect(few, station) -> None:
    result, frames = few
    found = gpuspec.inspect(frames, station, truth=result.truth)
    assert found.inspection.rule == "ceiling"
    assert found.warnings == ()
    assert (found.score.defects_hit, found.score.false_blobs) == (5, 0)
    spread = automatic_threshold(found.aspect, found.region, full_scale_dn=255, images=12)
    above = np.unique(result.truth[found.aspect > spread])
    assert above.tolist() == [4, 5]  # two of five: the ripple was taken for noise
    assert found.threshold < spread - 50


def test_frames_of_a_station_are_held_against_its_own_ceiling(few) -> None:
    result, frames = few
    found = gpuspec.inspect(frames, FEW)
    assert found.threshold == result.threshold == ceiling_of(FEW).threshold_dn(255)
    assert np.array_equal(found.labels, result.labels)


def test_frames_are_believed_where_the_station_says_another_light(few) -> None:
    _, frames = few
    other = FEW.replace(tunnel__luminous_mm=8.0, tunnel__dark_mm=8.0)
    found = gpuspec.inspect(frames, other)
    assert found.threshold == gpuspec.inspect(frames, UNKNOWN).threshold
    (note,) = found.warnings
    assert "by few.toml up to" in note
    assert "is not that of the frames" in note


def test_a_line_has_the_same_threshold_as_an_inspection(few) -> None:
    _, frames = few
    bare = gpuspec.Station(camera={"sampling_mm": 0.1}, sequence={"images": 12})
    for station in (FEW, bare):
        line = gpuspec.Line(station)
        for frame in frames:
            line.add(frame)
        assert line.decide().inspection.threshold == gpuspec.inspect(frames, station).threshold


@pytest.mark.parametrize(
    ("length_mm", "images"), [(10.0, 16), (10.0, 40), (21.0, 40)], ids=["10-16", "10-40", "21-40"]
)
def test_frames_of_a_part_shorter_than_the_stripes_are_inspected_as_simulated(
    opencl, length_mm: float, images: int
) -> None:
    station = FEW.replace(
        part={"length_mm": length_mm, "width_mm": 8.0}, camera__sampling_mm=0.05,
        sequence__images=images, defects=({**DENTS[1], "x_mm": 2.0, "y_mm": 1.0},),
    )  # fmt: skip
    result = gpuspec.simulate(station, opencl)
    frames = frames_of(result.light_map)
    assert np.ptp(frames.mean(axis=(1, 2))) > 0.5 * frames.mean()
    found = gpuspec.inspect(frames, station, truth=result.truth)
    line = gpuspec.Line(station)
    for frame in frames:
        line.add(frame)
    for one in (found, line.decide()):
        assert np.array_equal(one.aspect, result.aspect)
        assert one.inspection.threshold == result.threshold
        assert np.array_equal(one.inspection.labels, result.labels)


def test_a_ceiling_that_frames_and_station_tell_is_taken_where_phases_tell_no_better(
    opencl,
) -> None:
    station = FEW.replace(
        part={"length_mm": 17.94, "width_mm": 8.0}, camera={"sampling_mm": 0.05, "pupil_mm": 3.0},
        tunnel={"luminous_mm": 4.67, "dark_mm": 8.26}, sequence__images=16,
        defects=({**DENTS[0], "x_mm": 2.0, "y_mm": 1.0, "depth_um": 1.5},),
    )  # fmt: skip
    result = gpuspec.simulate(station, opencl)
    found = gpuspec.inspect(frames_of(result.light_map), station)
    assert found.inspection.rule == "ceiling"
    assert found.threshold == result.threshold


@pytest.mark.parametrize("seed", [0, 4, 5, 8, 10, 12, 17, 19, 20, 21])
def test_nothing_is_detected_in_frames_of_a_flawless_part(opencl, seed: int) -> None:
    frames = frames_of(opencl.trace(flawless(seed, noise=True)))
    assert len(gpuspec.inspect(frames, UNKNOWN).blobs) == 0


@pytest.mark.parametrize("seed", [11, 14, 16, 17, 18])
def test_frames_tell_the_ceiling_that_their_station_has(opencl, seed: int) -> None:
    station = flawless(seed, noise=True)
    found = gpuspec.inspect(frames_of(opencl.trace(station)), UNKNOWN)
    told, true = found.inspection.ceiling, ceiling_of(station)
    assert told.level_dn == pytest.approx(true.level_dn, abs=TOLD_CEILING_DN)


@pytest.mark.parametrize(
    ("used", "why"),
    [(slice(0, 3), "so few frames tell no period"), (slice(0, 9), "are no whole periods")],
)
def test_frames_that_tell_no_ceiling_say_so(few, used: slice, why: str) -> None:
    found = gpuspec.inspect(few[1][used], UNKNOWN, every_frame=True)
    assert found.inspection.rule == "spread"
    assert why in found.inspection.untold
    assert f"median and spread of levels, for {found.inspection.untold}." in found.warnings[-1]
