"""Backends: what all of them do alike, and who may know them."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import check_station

from gpuspec.errors import BackendError
from gpuspec.light import opencl as opencl_module
from gpuspec.light.backend import chosen
from gpuspec.light.light_map import LightMapArrays, has_closed_form
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.station.station import Station


@pytest.mark.parametrize(
    ("changes", "closed"),
    [
        ({}, True),
        ({"sequence__images": 1}, True),
        ({"sequence__step_mm": 16.0 * 3 / 40}, True),
        ({"sequence__step_mm": 0.7}, False),
        ({"sensor__noise": True}, False),
        ({"camera__subsampling": 2}, False),
        ({"sensor__bit_depth": 12}, True),
    ],
)
def test_the_closed_form_is_for_whole_periods_without_noise_or_sub_rays(changes, closed):
    assert has_closed_form(check_station(**changes)) is closed


@pytest.mark.parametrize("fusion", ["max", "min", "std", "differential"])
def test_other_fusions_than_the_mean_are_made_image_by_image(backend, fusion):
    station = check_station(sequence__images=5, sequence__fusion=fusion)
    light_map = backend.trace(station)
    assert np.array_equal(light_map.aspect(), light_map.fuse()[fusion])


def test_a_device_short_of_memory_works_in_tiles(opencl):
    station = check_station()
    whole = opencl.trace(station)
    assert whole.tiles == 1
    rows = station.shape[0]
    tiled = OpenCLBackend(memory_bytes=1).trace(station)
    assert tiled.tiles == rows
    some = OpenCLBackend(memory_bytes=10_000).trace(station)
    assert 1 < some.tiles < rows
    for light_map in (tiled, some):
        assert np.array_equal(light_map.aspect(), whole.aspect())
        assert np.array_equal(light_map.lost(), whole.lost())


@pytest.mark.parametrize("rays", [1, 3])
def test_a_tile_takes_no_more_memory_than_it_may(device_backend, rays, monkeypatch):
    """Bytes reserved while one tile is traced, of all its sub-rays."""
    station, limit = check_station(camera__subsampling=rays), 20_000
    short = type(device_backend)(memory_bytes=limit)
    light_map = short.trace(station)
    assert 1 < light_map.tiles < station.shape[0]
    reserved = []

    def watched(name, size):
        real = getattr(short, name)

        def call(*arguments):
            reserved.append(size(*arguments))
            return real(*arguments)

        monkeypatch.setattr(short, name, call)

    if hasattr(short, "target"):  # a texture of so many components, four bytes each
        watched("target", lambda shape, components, dtype="f4": 4 * np.prod(shape) * components)
    else:
        watched("empty", lambda size: size)
    with light_map.failures():
        next(iter(light_map.bands()))
    assert 0 < sum(reserved) <= limit
    assert sum(reserved) > limit / 5  # nor is it cut into far smaller ones


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("subsampling", [1, 2])
def test_many_images_are_worked_out_in_slices_with_the_same_result_to_the_bit(
    opencl, monkeypatch, noise, subsampling
):
    station = check_station(camera__subsampling=subsampling, sensor__noise=noise)
    light_map = opencl.trace(station)
    mean, fused = light_map.mean(), light_map.fuse()
    work = station.shape[1] * station.sequence.images * subsampling**2
    monkeypatch.setattr(opencl_module, "_AT_ONCE", 5 * work * (16 if noise else 1))
    assert len(list(light_map._slices("mean", station, station.shape[0]))) > 2
    assert np.array_equal(light_map.mean(), mean)
    for name, image in light_map.fuse().items():
        assert np.array_equal(image, fused[name])


@pytest.mark.parametrize("method", ["trace", "aspect", "read", "lost"])
def test_a_device_that_fails_says_so_in_a_sentence(method, monkeypatch):
    device = OpenCLBackend(memory_bytes=1)
    light_map = device.trace(check_station())

    def full(size: int) -> None:
        raise device.cl.MemoryError("create_buffer", device.cl.status_code.OUT_OF_RESOURCES)

    monkeypatch.setattr(device, "empty", full)
    monkeypatch.setattr(device, "memory_bytes", 1 << 30)
    with pytest.raises(BackendError, match=r"is out of memory .*sampling_mm"):
        device.trace(light_map.station) if method == "trace" else getattr(light_map, method)()


def test_a_backend_that_opened_keeps_its_device_on_record(backend):
    record = backend.info.as_dict()
    assert set(record) == {"backend", "device", "driver", "version"}
    assert all(record.values())
    assert record["backend"] in str(backend.info)


def test_a_light_map_comes_home_as_arrays_of_the_image(backend):
    station: Station = check_station(camera__subsampling=2)
    arrays = backend.trace(station).read()
    assert isinstance(arrays, LightMapArrays)
    for array in (arrays.light_mm, arrays.footprint_mm, arrays.irradiance):
        assert array.shape == (4, *station.shape)
    assert arrays.lost.shape == station.shape
    assert arrays.lost.dtype == np.uint8


@pytest.mark.parametrize(("wanted", "number"), [(None, 0), ("1", 1), ("radeon", 1), ("GeForce", 0)])
def test_a_device_is_chosen_by_number_or_by_part_of_its_name(wanted, number):
    assert chosen("vulkan", ["NVIDIA GeForce", "AMD Radeon"], wanted) == number


def test_a_number_is_a_device_s_own_and_not_one_of_its_name():
    assert chosen("vulkan", ["GeForce GTX 1080", "GeForce GTX 0"], "1") == 1
    assert chosen("vulkan", ["GeForce GTX 1080", "GeForce GTX 0"], "gtx 0") == 1


@pytest.mark.parametrize("wanted", ["2", "-1", "²", "intel"])
def test_a_device_that_is_not_there_is_answered_with_those_that_are(wanted):
    with pytest.raises(BackendError, match=r"no device .* from 0 \(NVIDIA GeForce\), 1 \(AMD"):
        chosen("vulkan", ["NVIDIA GeForce", "AMD Radeon"], wanted)
