"""Backends: what all of them do alike, and who may know them."""

from __future__ import annotations

import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scenes import PIXEL_BYTES, check_station

from gpuspec.errors import BackendError
from gpuspec.light.backend import chosen
from gpuspec.light.levels import Zones
from gpuspec.light.light_map import LightMapArrays, has_closed_form
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.opencl_device import FILES, LAUNCH_SECONDS
from gpuspec.light.refinement import SLICES
from gpuspec.station.station import Station

SCRATCH = {"kind": "scratch", "points_mm": [[-2.0, -0.7], [2.0, 0.4]], "width_mm": 0.2,
           "depth_um": 2.0}  # fmt: skip


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
    station = check_station(camera__subsampling=1)
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


def launches_of(device: OpenCLBackend, monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count the launches of a device from now on, kernel by kernel."""
    counted: Counter[str] = Counter()
    real = device.start

    def start(file: str, name: str, *arguments, **places) -> None:
        counted[name] += 1
        real(file, name, *arguments, **places)

    monkeypatch.setattr(device, "start", start)
    return counted


@pytest.mark.parametrize("rays", [1, 3])
def test_a_tile_takes_no_more_memory_than_it_may(device_backend, rays, monkeypatch):
    """Bytes reserved while one tile is traced, of all its sub-rays."""
    station, limit = check_station(camera__subsampling=rays), 12_000
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
def test_work_is_done_launch_by_launch_with_the_same_result_to_the_bit(
    monkeypatch, noise, subsampling
):
    station = check_station(camera__subsampling=subsampling, sensor__noise=noise)
    device = OpenCLBackend()

    def made() -> list[np.ndarray]:
        light_map = device.trace(station)
        arrays = light_map.read()
        images = [light_map.mean(), *light_map.fuse().values(), light_map.image(3)]
        if subsampling == 1:
            images.append(light_map.closed_form())
        return [
            arrays.light_mm,
            arrays.wide_mm,
            arrays.narrow_mm,
            arrays.irradiance,
            arrays.lost,
            *images,
        ]

    whole = made()
    monkeypatch.setattr("gpuspec.light.opencl_device.LAUNCH_SECONDS", 1e-7)
    monkeypatch.setattr(device, "_work", {})
    monkeypatch.setattr("gpuspec.light.opencl_device._FIRST_WORK", 5.0)
    counted = launches_of(device, monkeypatch)
    for one, other in zip(whole, made(), strict=True):
        assert np.array_equal(one, other)
    tracing = "trace" if subsampling == 1 else "trace_sub_rays"
    for kernel in (tracing, "image_at", "mean_of_images", "fuse_images"):
        assert counted[kernel] == station.shape[0]
    assert counted["aspect"] == (station.shape[0] if subsampling == 1 else 0)


def test_a_program_is_built_once_a_file(monkeypatch):
    device = OpenCLBackend()
    built = []
    real = device.program

    def program(source: str, file: str, *width: int):
        built.append(file)
        return real(source, file, *width)

    monkeypatch.setattr(device, "program", program)
    station = check_station()
    for _ in range(2):
        light_map = device.trace(station)
        light_map.image(0), light_map.mean(), light_map.fuse(), light_map.closed_form()
        light_map.mean(check_station(tunnel__profile="sinusoid"))
        device.trace(check_station(part__pose={"tilt_y_deg": 1.0}))
        assert -SLICES in device.trace(check_station(pupil=0.0, defects=[SCRATCH])).refined
        zone = np.ones(station.shape, np.int32)
        light_map.counter(Zones.of(zone, zone == 1, 1)).count([station])
    assert sorted(built) == sorted(FILES)


def test_an_image_is_made_in_bands_of_a_light_map_that_is_kept(opencl, monkeypatch):
    """The light map takes the memory it takes; its images take none beside it to speak of."""
    station = check_station(camera__subsampling=1)
    whole = opencl.trace(station)
    device = OpenCLBackend(memory_bytes=PIXEL_BYTES * opencl.width * np.prod(station.shape))
    light_map = device.trace(station)
    monkeypatch.setattr("gpuspec.light.opencl._BAND_BYTES", 3 * 5 * 4 * light_map.stride)
    counted = launches_of(device, monkeypatch)
    assert light_map.tiles == 1
    for name, image in light_map.fuse().items():
        assert np.array_equal(image, whole.fuse()[name])
    assert counted == {"fuse_images": -(-station.shape[0] // 3)}
    assert np.array_equal(light_map.closed_form(), whole.closed_form())
    assert counted["trace"] == 0


def test_a_light_map_is_kept_whatever_its_size_as_far_as_the_memory_allows():
    station = check_station(camera__subsampling=1)
    rows = station.shape[0]
    device = OpenCLBackend()
    stride = device.trace(station).stride
    for missing in (0, 1):
        device.memory_bytes = PIXEL_BYTES * stride * rows - missing
        assert device.trace(station).tiles == 1 + missing


def test_a_light_map_in_the_hosts_memory_leaves_a_run_the_rest(opencl, monkeypatch):
    """On a CPU; a light map that does not fit is done in tiles of at most a gibibyte."""
    station = check_station(camera__subsampling=1)
    rows, stride = station.shape[0], opencl.trace(station).stride
    monkeypatch.setattr("gpuspec.light.opencl._BAND_BYTES", 0)  # nothing is too little to be asked
    assert opencl.device.host_unified_memory
    for missing in (0, 1):
        free = 4 * (PIXEL_BYTES * stride * rows - missing)
        monkeypatch.setattr("gpuspec.light.opencl.free_bytes", lambda free=free: free)
        assert opencl.trace(station).tiles == 1 + missing
    monkeypatch.setattr("gpuspec.light.opencl._TILE_BYTES", PIXEL_BYTES * stride * 5)
    assert opencl.trace(station).tiles == -(-rows // 5)


def test_a_launch_lasts_about_as_long_as_it_should(opencl, monkeypatch):
    """By a clock under which a unit of work takes as long as is said here."""
    now = [0.0]
    monkeypatch.setattr("gpuspec.light.opencl_device.perf_counter", lambda: now[0])
    for speed in (1e8, 1e10, 1e12):
        monkeypatch.setattr(opencl, "_work", {})
        spans = []
        rows = np.full(200_000, speed / 1000)
        for some in opencl.launches("a kernel", rows):
            spans.append(float(rows[some].sum()) / speed)
            now[0] += spans[-1]
        assert sum(spans) == pytest.approx(200)
        settled = spans[5:-1]  # growth is eightfold at most
        assert min(settled) > 0.9 * LAUNCH_SECONDS
        assert max(settled) < 1.1 * LAUNCH_SECONDS


def test_a_short_launch_says_how_long_one_may_be_only_if_it_lasted(opencl, monkeypatch):
    """A launch of little work takes its time to start, which is no measure of the device.

    One of hardly any is not waited for at all.
    """
    now = [0.0]
    monkeypatch.setattr("gpuspec.light.opencl_device.perf_counter", lambda: now[0])
    monkeypatch.setattr(opencl, "_work", {})

    def first_of_many() -> float:
        rows = np.full(10_000, 1e6)
        return 1e6 * next(opencl.launches("a kernel", rows)).stop

    def little(seconds: float, work: float = 1e7) -> None:
        for _ in opencl.launches("a kernel", [work, work]):
            now[0] += seconds

    unknown = first_of_many()
    little(1e-3)
    assert first_of_many() == unknown
    little(2.0, 10.0)
    assert first_of_many() == unknown
    little(2.0)
    assert first_of_many() == unknown / 100  # and no less, whatever was waited for


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
    for array in (arrays.light_mm, arrays.wide_mm, arrays.narrow_mm, arrays.irradiance):
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


def test_threads_share_a_device(device_backend):
    """Each gets its own images, though all start the same kernels on one light map."""
    station = check_station(sequence__images=7)
    light_map = device_backend.trace(station)

    def made(exposure: float) -> list[np.ndarray]:
        design = station.replace(sensor__exposure=exposure)
        own = device_backend.trace(design)
        return [
            light_map.closed_form(design), light_map.image(3, design), own.mean(), own.lost(),
            *light_map.fuse(design).values(),
        ]  # fmt: skip

    exposures = np.linspace(0.5, 6.0, 36)
    alone = [made(exposure) for exposure in exposures]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(6) as threads:
            together = list(threads.map(made, exposures))
    finally:
        sys.setswitchinterval(interval)
    for ours, theirs in zip(alone, together, strict=True):
        for one, other in zip(ours, theirs, strict=True):
            assert np.array_equal(one, other)
