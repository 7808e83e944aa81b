"""Light maps and what comes from them: backend against backend, way against way."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from scenes import check_station
from tolerances import CREASE_FLIPS, DEVICE_DN, FOOTPRINT_SHARE, IMAGE_DN, LIGHT_MM, LOST_FLIPS

from gpuspec.arrays import Image
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.light_map import LightMapArrays
from gpuspec.station.station import Station

POPULATIONS = [
    {"kind": "dent", "count": 8, "seed": 4, "diameter_mm": [0.3, 1.5], "depth_um": [1, 12]},
    {"kind": "bump", "count": 8, "seed": 5, "diameter_mm": [0.3, 1.5], "depth_um": [1, 12]},
    {
        "kind": "scratch", "count": 6, "seed": 6, "width_mm": [0.1, 0.6], "length_mm": [2, 9],
        "depth_um": [1, 6], "vertices": 5, "bend_rad": 0.8,
    },
]  # fmt: skip

BASE = {
    "part": {"length_mm": 40.0, "width_mm": 20.0},
    "camera": {"sampling_mm": 0.1},
    "populations": POPULATIONS,
}

SCENES: dict[str, dict[str, Any]] = {
    "flat": {},
    "far from the axis": {
        "part.length_mm": 400.0, "camera.sampling_mm": 0.4, "tunnel.length_mm": 2000.0,
    },
    "crowned height surface": {
        "part.surface": "height", "part.crown_radius_x_mm": 300.0, "part.crown_radius_y_mm": 90.0,
    },
    "hollow orientation": {"part.crown_radius_x_mm": -500.0},
    "box": {"tunnel.section": "box", "tunnel.width_mm": 30.0, "tunnel.height_mm": 100.0},
    "arch": {"tunnel.section": "arch", "tunnel.radius_mm": 120.0},
    "opening": {"tunnel.opening_length_mm": 8.0, "tunnel.opening_width_mm": 8.0},
    "short tunnel": {"tunnel.length_mm": 40.0},
    "sub-rays, leak, cos4, chromium": {
        "camera.subsampling": 3, "tunnel.dark_leak": 0.1, "camera.vignetting": "cos4",
        "part.material": "chromium",
    },
    "rough, uneven steps, 16 bit": {
        "part.roughness_rad": 0.001, "sequence.step_mm": 0.7, "sensor.bit_depth": 16,
    },
    "part narrower than the image": {"camera.rows": 240, "camera.columns": 451},
}  # fmt: skip


def scene(name: str) -> Station:
    return Station.from_dict(BASE).replace(**SCENES[name])


@dataclass(frozen=True)
class Reference:
    """What the float64 reference makes of a scene: worked out once, for every device."""

    arrays: LightMapArrays
    aspect: Image
    image: Image
    fused: dict[str, Image]

    @classmethod
    @cache
    def of(cls, name: str) -> Reference:
        traced = NumpyBackend().trace(scene(name))
        return cls(traced.read(), traced.aspect(), traced.image(7), traced.fuse())


@pytest.mark.parametrize("name", SCENES)
def test_a_device_agrees_with_the_float64_reference(device_backend: Backend, name: str):
    station = scene(name)
    device, reference = device_backend.trace(station), Reference.of(name)
    got, want = device.read(), reference.arrays
    # Where float rounding flips a pixel between seen and lost it is counted, not averaged.
    same = got.lost == want.lost
    same &= ((got.irradiance > 0) == (want.irradiance > 0)).all(axis=0)
    assert (~same).sum() <= LOST_FLIPS
    # On the bend or the end of a scratch the curvature jumps: rounding may choose the other side.
    share = np.abs(got.footprint_mm / want.footprint_mm - 1).max(axis=0)
    assert (share[same] > FOOTPRINT_SHARE).sum() <= CREASE_FLIPS
    same &= share <= FOOTPRINT_SHARE
    light = np.abs(got.light_mm - want.light_mm) / np.maximum(np.abs(want.light_mm), 100)
    assert light[:, same].max() < LIGHT_MM / 100
    full = station.sensor.full_scale_dn / 255
    assert np.abs(device.aspect() - reference.aspect)[same].max() < DEVICE_DN * full
    assert np.abs(device.image(7) - reference.image)[same].max() < IMAGE_DN * full
    fused, exact = device.fuse(), reference.fused
    for fusion in ("mean", "std", "differential"):
        assert np.abs(fused[fusion] - exact[fusion])[same].max() < DEVICE_DN * full
    for fusion in ("max", "min"):
        assert np.abs(fused[fusion] - exact[fusion])[same].max() < IMAGE_DN * full


@pytest.mark.parametrize("images", [1, 5, 40, 77, 400])
@pytest.mark.parametrize("leak", [0.0, 0.1, 0.3])
def test_the_closed_form_is_the_mean_of_the_images(backend, images, leak):
    station = check_station(sequence__images=images, tunnel__dark_leak=leak)
    light_map = backend.trace(station)
    assert np.abs(light_map.closed_form() - light_map.mean()).max() < DEVICE_DN


def test_several_periods_in_equal_steps_have_the_closed_form_too(backend):
    # 12 images of 3/8 period visit 8 distinct shifts ... 24 cover 9 whole periods.
    station = check_station(sequence__images=24, sequence__step_mm=16 * 3 / 8)
    assert station.distinct_shifts == 8
    light_map = backend.trace(station)
    assert np.abs(light_map.closed_form() - light_map.mean()).max() < DEVICE_DN


@pytest.mark.parametrize("step", [1e-12, 0.3, 17.0])
def test_no_whole_period_has_no_closed_form(step: float):
    station = check_station(sequence__images=40, sequence__step_mm=step)
    assert station.distinct_shifts is None


@pytest.mark.parametrize("noise", [False, True])
def test_the_mean_is_that_of_the_single_images(backend, noise):
    station = check_station(sequence__images=7, camera__subsampling=2, sensor__noise=noise)
    light_map = backend.trace(station)
    images = np.stack([light_map.image(k) for k in range(7)]).astype(np.float64)
    fused = light_map.fuse()
    assert np.abs(images.mean(axis=0) - light_map.mean()).max() < DEVICE_DN
    assert np.abs(images.max(axis=0) - fused["max"]).max() < DEVICE_DN
    assert np.abs(images.min(axis=0) - fused["min"]).max() < DEVICE_DN
    assert np.abs(images.std(axis=0) - fused["std"]).max() < DEVICE_DN
    wrapped = np.abs(np.roll(images, -1, axis=0) - images).mean(axis=0)
    assert np.abs(wrapped - fused["differential"]).max() < DEVICE_DN


def test_pairs_of_the_differential_do_not_wrap_around_an_open_sequence(backend):
    station = check_station(sequence__images=9, sequence__step_mm=1.1, sequence__lag=3)
    light_map = backend.trace(station)
    images = np.stack([light_map.image(k) for k in range(9)]).astype(np.float64)
    pairs = np.abs(images[3:] - images[:-3]).mean(axis=0)
    assert np.abs(pairs - light_map.fuse()["differential"]).max() < DEVICE_DN


def test_another_design_needs_no_new_trace(backend):
    station = check_station()
    other = station.replace(
        tunnel__luminous_mm=2.0, tunnel__dark_mm=5.0, sensor__exposure=7.0, sequence__images=11
    )
    reused = backend.trace(station).aspect(other)
    assert np.array_equal(reused, backend.trace(other).aspect())
    assert not np.array_equal(reused, backend.trace(station).aspect())


def test_each_reason_of_loss_is_where_it_must_be(backend):
    station = Station.from_dict(
        {
            "part": {"length_mm": 90.0, "width_mm": 20.0},
            "tunnel": {
                "height_mm": 150.0, "length_mm": 100.0, "opening_length_mm": 10.0,
                "opening_width_mm": 6.0,
            },
            "camera": {
                "height_mm": 800.0, "sampling_mm": 0.25, "columns": 400, "rows": 100,
                "pupil_mm": 0.0, "subsampling": 1,
            },
            "defects": [
                {"kind": "dent", "x_mm": 20, "y_mm": 0, "diameter_mm": 4, "depth_um": 3000}
            ],
        }
    )  # fmt: skip
    lost = backend.trace(station).lost()
    x = (np.arange(400) + 0.5 - 200) * 0.25
    y = (50 - np.arange(100) - 0.5) * 0.25
    light = x * (1 + 150 / 800)
    row = lost[5]  # y = 11.1: beside
    assert (row == 1).all()
    row = lost[75]  # y = -6.4, away from dent and opening
    assert np.array_equal(row == 1, np.abs(x) > 45)
    assert np.array_equal(row == 3, (np.abs(light) > 50) & (np.abs(x) <= 45))
    inside = (np.abs(light) <= 5)[None, :] & (np.abs(y * (1 + 150 / 800)) <= 3)[:, None]
    assert np.array_equal(lost == 4, inside)
    near = np.hypot(x[None, :] - 20, y[:, None]) < 2
    assert (lost[near] == 2).any()  # slopes beyond 45 degrees send light down
    assert not (lost[:, x < 0] == 2).any()


@pytest.mark.parametrize("side", [2, 3])
@pytest.mark.parametrize(
    "changes",
    [
        {"tunnel.length_mm": 9.0},
        {"tunnel.opening_length_mm": 30.0, "tunnel.opening_width_mm": 5.0},
        {"tunnel.length_mm": 9.0, "tunnel.opening_length_mm": 7.0, "tunnel.opening_width_mm": 9.0},
    ],
    ids=["past the end", "opening", "all"],
)
def test_a_pixel_is_seen_if_any_sub_ray_is_else_lost_for_the_largest_reason(
    backend, side: int, changes: dict[str, Any]
):
    """On a flat part, every sub-ray worked out by hand; the outer pixels lie half beside it."""
    station = Station.from_dict(
        {
            "part": {"length_mm": 9.2, "width_mm": 4.1},
            "tunnel": {"height_mm": 100.0},
            "camera": {"height_mm": 800.0, "sampling_mm": 1.0, "subsampling": side, "columns": 10,
                       "rows": 5},
        }
    ).replace(**changes)  # fmt: skip
    part, tunnel = station.part, station.tunnel
    sub = (np.arange(side) + 0.5) / side
    x = ((np.arange(10)[:, None] + sub) - 5.0).ravel()[None, :]
    y = (2.5 - (np.arange(5)[:, None] + sub)).ravel()[:, None]
    across = (np.abs(x) * 1.125 <= tunnel.opening_length_mm / 2) & (
        np.abs(y) * 1.125 <= tunnel.opening_width_mm / 2
    )
    why = np.where(across & (tunnel.opening_length_mm > 0), 4, 0)
    why = np.where(np.abs(x) * 1.125 > tunnel.length_mm / 2, 3, why)
    why = np.where((np.abs(x) > part.length_mm / 2) | (np.abs(y) > part.width_mm / 2), 1, why)
    rays = why.reshape(5, side, 10, side).swapaxes(1, 2).reshape(5, 10, -1)
    want = np.where((rays == 0).any(axis=-1), 0, rays.max(axis=-1))
    # Pixels whose sub-rays differ, those lost altogether with the largest reason first and last.
    least, largest = rays.min(axis=-1), rays.max(axis=-1)
    differ = (least > 0) & (least < largest)
    assert (rays[..., 0] == largest)[differ].any()
    assert (rays[..., -1] == largest)[differ].any()
    assert np.array_equal(backend.trace(station).lost(), want)


def test_the_opening_is_cut_out_of_the_top_of_a_box_and_not_out_of_its_walls(backend):
    station = Station.from_dict(
        {
            "part": {"length_mm": 20.0, "width_mm": 29.0},
            "tunnel": {"section": "box", "height_mm": 100.0, "width_mm": 30.0,
                       "opening_length_mm": 9.0, "opening_width_mm": 31.0},
            "camera": {"height_mm": 800.0, "sampling_mm": 0.5, "subsampling": 1},
        }
    )  # fmt: skip
    rows, columns = station.shape
    x = (np.arange(columns) + 0.5 - columns / 2)[None, :] * 0.5
    y = (rows / 2 - np.arange(rows) - 0.5)[:, None] * 0.5
    top = np.abs(y) * 1.125 <= 15.0  # beyond, the mirrored ray meets a wall below the top
    under = np.abs(x) * 1.125 <= 4.5
    assert (under & ~top).any()
    assert np.array_equal(backend.trace(station).lost(), np.where(top & under, 4, 0))


def test_a_lost_pixel_is_dark(backend):
    station = scene("short tunnel")
    light_map = backend.trace(station)
    lost = light_map.lost() > 0
    assert lost.any()
    assert (light_map.aspect()[lost] == 0).all()
    assert (light_map.read().irradiance[:, lost] == 0).all()


ANOTHER_GEOMETRY: dict[str, tuple[dict[str, Any], str]] = {
    "tunnel": ({"tunnel.height_mm": 100.0}, "tunnel.height_mm is 100.0 and was 150.0 when it was"),
    "camera": ({"camera.pupil_mm": 0.0}, "camera.pupil_mm is 0.0 and was 3.0"),
    "image": ({"camera.columns": 30}, "camera.columns is 30 and was 32"),
    "part": ({"part.material": "gold"}, "part.material is gold and was ideal"),
    "defects": ({"defects[1].depth_um": 9.0}, "its defects are others than those traced"),
    "populations": ({"populations": POPULATIONS[:1]}, "its populations are others than those"),
}


@pytest.mark.parametrize("name", ANOTHER_GEOMETRY)
def test_a_light_map_takes_no_station_of_another_geometry(backend: Backend, name: str):
    changes, told = ANOTHER_GEOMETRY[name]
    light_map = backend.trace(check_station())
    other = check_station(**changes)
    for take in (
        light_map.aspect, light_map.mean, light_map.fuse, light_map.closed_form,
        lambda station: light_map.image(0, station),
    ):  # fmt: skip
        with pytest.raises(StationError, match=told):
            take(other)


def test_a_light_map_takes_other_stripes_sensors_and_sequences(backend: Backend):
    light_map = backend.trace(check_station())
    other = check_station(
        tunnel__luminous_mm=2.0, tunnel__dark_mm=5.0, tunnel__dark_leak=0.1, sequence__images=7,
        sensor__exposure=2.0, segmentation__threshold=80.0,
    )  # fmt: skip
    assert np.abs(light_map.aspect(other) - backend.trace(other).aspect()).max() < DEVICE_DN


@pytest.mark.parametrize("k", [40, 1000, -1, 2.5, 2.0, True, "3", None], ids=repr)
def test_an_image_that_is_not_there_is_not_given(backend: Backend, k: Any):
    light_map = backend.trace(check_station())
    with pytest.raises(StationError, match=r"there is no image .*images = 40, numbered 0 to 39"):
        light_map.image(k)


def test_images_are_those_of_the_station_asked_for_numpy_integers_are_numbers(backend: Backend):
    light_map = backend.trace(check_station())
    assert np.array_equal(light_map.image(np.int64(7)), light_map.image(7))
    light_map.image(79, check_station(sequence__images=80))
    with pytest.raises(StationError, match=r"no image 8; sequence\.images = 8"):
        light_map.image(8, check_station(sequence__images=8))
