"""Every kernel of the OpenCL backend on small odd scenes; prints which ran.

A program of its own, for `oclgrind`, which stands in for the OpenCL loader of a whole process.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gpuspec.light import opencl_device
from gpuspec.light.levels import Sample, Zones, levels_of
from gpuspec.light.light_map import LightMap, has_noisy_form
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.refined import with_cut
from gpuspec.light.refinement import Neighbourhood
from gpuspec.part.maps import TopographyMap
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.station.station import Station

DENT = {"kind": "dent", "x_mm": 0.1, "y_mm": -0.1, "diameter_mm": 0.5, "depth_um": 4.0}
SCRATCH = {
    "kind": "scratch", "points_mm": [[-0.7, -0.2], [0.1, 0.2], [0.6, 0.2]], "width_mm": 0.2,
    "depth_um": 2.0,
}  # fmt: skip
STRAIGHT = {**SCRATCH, "points_mm": [[-0.7, 0.0], [0.7, 0.3]]}
CHIP = {"kind": "chip", "side": "top", "at_mm": 0.2, "width_mm": 0.7, "depth_mm": 0.3}


class Counting(OpenCLBackend):
    """The backend as a GPU runs it, in many short launches; it knows which kernels it started."""

    def __init__(self) -> None:
        super().__init__()
        self.settle({"widths": {}})
        self.ran: set[str] = set()
        self.files: set[str] = set()

    def start(self, file: str, name: str, *arguments: object, **places: object) -> None:
        self.ran.add(name)
        self.files.add(file)
        super().start(file, name, *arguments, **places)


def scenes() -> Iterator[tuple[Station, Relief]]:
    """Yield stations of 1 to 200 odd pixels, of every kind that takes another way in a kernel."""
    base = Station.from_dict(
        {
            "part": {"length_mm": 1.7, "width_mm": 1.1},
            "camera": {"sampling_mm": 0.1, "subsampling": 1},
            "sequence": {"images": 9},
            "defects": [DENT, SCRATCH],
        }
    )
    seen = {"camera__columns": 19, "camera__rows": 13}  # more than the part: pixels beside it
    # Of up to 64 sub-rays, or in slices.
    few = {"camera__subsampling": "auto", "camera__columns": 5, "camera__rows": 4,
           "camera__pupil_mm": 0.0, "defects": (DENT,)}  # fmt: skip
    sliced = {**few, "defects": (STRAIGHT,)}
    for changes in (
        seen,
        {"defects": (), **seen},
        {"edges": (CHIP,), **seen},
        {"camera__columns": 1, "camera__rows": 1},
        {"part__pose": {"tilt_y_deg": 2.0}, "camera__columns": 3, "camera__rows": 2},
        {
            "part__surface": "height", "part__crown_radius_x_mm": 30.0, "tunnel__section": "arch",
            "tunnel__radius_mm": 150.0, "sensor__noise": True, "sensor__prnu": 0.01,
            **few,
        },
        {
            "camera__subsampling": 2, "tunnel__section": "box", "tunnel__width_mm": 80.0,
            "part__material": "iron", "sequence__fusion": "std", "camera__columns": 9,
            "camera__rows": 7,
        },
        sliced,
        {"tunnel__profile": "sinusoid", "tunnel__profile_gamma": 2.2, **seen},
    ):  # fmt: skip
        station = base.replace(**changes)
        yield station, Relief.of(station)
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(-0.4, 0.4, 9))
    heights = 1e-3 * np.sin(9 * x) * np.cos(7 * y)
    topography = TopographyMap(heights, heights, (0.1, 0.1), (-0.5, -0.4), None, "part.relief")
    station = base.replace(part__surface="height", **seen)
    yield station, replace(Relief.of(station), maps=(topography,))


def run(device: Counting, station: Station, relief: Relief) -> None:
    """Trace a station, take all its images and count their levels, whole and by a sample."""
    light_map = device.trace(station, relief)
    light_map.read()
    light_map.image(3)
    light_map.mean()
    light_map.fuse()
    if has_noisy_form(station):
        light_map.moments()
    truth = Truth.of(station, Relief.of(station))
    zones = Zones.of(truth.labels, light_map.lost() == 0, len(truth.defects))
    pixels = np.arange(station.shape[0] * station.shape[1], dtype=np.uint32)
    wide = np.linspace(0.5, 3.0, 7, dtype=np.float32)
    bounds = wide, wide / 3, np.ones(7, np.float32)
    sample = Sample(pixels[::5], pixels[1::3], 3, *bounds)
    for exposure, bits in ((2, 8), (4, 10)):
        design = station.replace(sensor__exposure=exposure, sensor__bit_depth=bits)
        expected = levels_of(light_map.counted(design), zones, design.sensor.full_scale_dn)
        whole, part = (
            light_map.counter(zones, by).count([design, station]) for by in (None, sample)
        )
        assert np.array_equal(whole.inside[:1], expected.inside)
        assert np.array_equal(whole.outside[:1, 1:], expected.outside[:, 1:])
        for counts in (whole, part):
            assert np.array_equal(counts.inside[:1], expected.inside)
            assert np.array_equal(counts.peaks[:1], expected.peaks)
    listed = device.traced(with_cut(station, 1), relief, pixels)
    around = Neighbourhood(pixels.astype(np.int64), station.shape)
    sides = listed.sides_beside(around, pixels.astype(np.int64))
    assert np.array_equal(sides, LightMap.sides_beside(listed, around, pixels.astype(np.int64)))
    assert not device.without(listed, pixels[::3]).read().irradiance[0, 0, ::3].any()


def seed_fault(old: str, new: str) -> None:
    """Make a fault in the kernel files that have the words `old`, once each."""
    real = opencl_device.kernel_source

    def faulty(*arguments: str) -> str:
        return real(*arguments).replace(old, new)

    assert {real(file).count(old) for file in opencl_device.FILES} == {0, 1}, old
    opencl_device.kernel_source = faulty


def main(what: str = "all", *fault: str) -> None:
    device = Counting()
    every = list(scenes())
    if fault:
        seed_fault(*fault)
    for station, relief in every if what == "all" else every[:1]:
        run(device, station, relief)
    opencl_device.LAUNCH_SECONDS, opencl_device._FIRST_WORK = 1e-9, 1.0
    device._work = {}
    device.memory_bytes = 3000  # some rows a tile
    for station, relief in every[::3] if what == "all" else ():
        run(device, station, relief)
    assert what != "all" or {"sliced.cl", "posed.cl"} <= device.files
    print(*sorted(device.ran))


if __name__ == "__main__":
    main(*sys.argv[1:])
