"""Sub-rays where they matter: which pixels get them, and what is left at those that do not."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import check_station
from tolerances import LEFT_AT_ONE_FOOTPRINT_DN, REFINED_MAX_DN, REFINED_RMS_DN

from gpuspec.light.constants import AT_LOSS, NO_PIXEL
from gpuspec.light.levels import Zones, levels_of
from gpuspec.light.light_map import LightMap
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.light.opencl_refinement import Surroundings
from gpuspec.light.refinement import CREASED, SIDES, SLICES, Neighbourhood, by_cut, sides_needed
from gpuspec.part.crossings import CREASE, GROOVE

DEFECTS = [
    {"kind": "dent", "x_mm": -1.9, "y_mm": 1.7, "diameter_mm": 0.8, "depth_um": 6.0},
    {"kind": "bump", "x_mm": 1.6, "y_mm": 1.2, "diameter_mm": 0.5, "depth_um": 3.0},
    {
        "kind": "scratch", "points_mm": [[-2.0, -1.8], [0.1, -1.4], [1.5, -2.2]],
        "width_mm": 0.3, "depth_um": 2.0,
    },
]  # fmt: skip
CHIP = {"kind": "chip", "side": "right", "at_mm": 0.4, "width_mm": 1.1, "depth_mm": 0.37}
FEW = {"camera.columns": 61, "camera.rows": 53, "sequence.images": 12}
"""Few images, where a bend of the light counts most; columns that fill no vectors."""
SCENES = {
    "ceiling": {},
    "lens": {"camera.pupil_mm": 5.0},
    "height in a box": {
        "part.surface": "height", "part.crown_radius_x_mm": 700.0, "part.width_mm": 6.0,
        "tunnel.section": "box", "tunnel.width_mm": 6.1, "tunnel.height_mm": 120.0,
    },
    "edges of loss": {"tunnel.length_mm": 5.0, "tunnel.opening_length_mm": 1.0,
                      "tunnel.opening_width_mm": 2.0},
}  # fmt: skip


def scene(**changes):
    """A pinhole's view of a dent, a bump and a scratch."""
    station = check_station(pupil=0.0, exposure=6.0)
    return station.replace(**{**FEW, "defects": DEFECTS, **changes})


def needed_on_host(backend, station):
    arrays = backend.trace(station.replace(camera__subsampling=1)).read()
    return sides_needed(arrays.light_mm[0], arrays.wide_mm[0]), arrays


@pytest.mark.parametrize("changes", SCENES.values(), ids=SCENES)
def test_a_device_refines_the_pixels_that_the_host_does(opencl, changes):
    station = scene(**changes)
    on_host, _ = needed_on_host(opencl, station)
    with opencl.trace(station.replace(camera__subsampling=1)) as light_map:
        assert np.array_equal(light_map.sides_needed(), on_host)
    expected = {1, *SIDES} | ({AT_LOSS} if opencl.trace(station).lost().any() else set())
    assert set(np.unique(on_host)) == expected


def test_a_single_pixel_needs_what_it_does_in_the_image(opencl):
    needed, arrays = needed_on_host(opencl, scene())
    light, wide = arrays.light_mm[0], arrays.wide_mm[0]
    random = np.random.default_rng(1)
    for share in (0.0, 0.01, 0.4, 1.0):
        own = np.flatnonzero(random.random(needed.shape) < share)
        around = Neighbourhood(own, needed.shape)
        assert np.isin(own, around.pixels).all()
        assert len(around.pixels) <= 25 * len(own)
        found = around.sides_needed(light.flat[around.pixels], wide.flat[around.pixels])
        assert np.array_equal(found, needed.flat[own])


@pytest.mark.parametrize("changes", SCENES.values(), ids=SCENES)
def test_a_device_tells_of_lists_what_it_does_of_the_image(opencl, changes):
    station = scene(**changes, camera__subsampling=1)
    needed, _ = needed_on_host(opencl, station)
    random = np.random.default_rng(2)
    every = np.arange(needed.size)
    border = np.zeros(needed.shape, bool)
    border[[0, 1, -2, -1]] = border[:, [0, 1, -2, -1]] = True
    for own in (every, np.flatnonzero(border), every[random.random(len(every)) < 0.1], every[:0]):
        around = Neighbourhood(own, needed.shape)
        # Anywhere in the list, and others among them.
        pixels = np.append(around.pixels, random.integers(0, needed.size, 37)).astype(np.uint32)
        order = random.permutation(len(pixels))
        places = np.argsort(order)[: len(around.pixels)]
        light_map = opencl.trace(station, pixels=pixels[order])
        found = light_map.sides_beside(around, places)
        assert np.array_equal(found, needed.flat[own])
        assert np.array_equal(found, LightMap.sides_beside(light_map, around, places))


@pytest.mark.parametrize("shape", [(3, 3), (5, 40), (21, 17)])
def test_a_device_tells_of_any_light_what_the_host_does_borders_included(opencl, shape):
    random = np.random.default_rng(4)
    around = Neighbourhood(np.arange(np.prod(shape)), shape)
    light, wide = random.uniform(0.0, 2.0, (2, *shape)).astype(np.float32)
    every = np.arange(light.size)
    told = Surroundings(opencl, around, every)
    found = told.sides_needed(opencl.kept(light), opencl.kept(wide), 0.2)
    assert np.array_equal(found, sides_needed(light, wide, 0.2).ravel())
    assert found.max() > 1


@pytest.mark.parametrize("memory_bytes", [None, 20_000])
def test_a_list_without_some_pixels_sees_the_others(memory_bytes):
    backend = OpenCLBackend(memory_bytes=memory_bytes)
    station = scene(camera__subsampling=1, sensor__black_level_dn=9)
    pixels = np.random.default_rng(3).permutation(np.prod(station.shape)).astype(np.uint32)
    light_map = backend.trace(station, pixels=pixels)
    before = light_map.aspect()[0]
    gone = np.arange(0, len(pixels), 7, dtype=np.uint32)
    fewer = backend.without(light_map, gone)
    left = np.ones(len(pixels), bool)
    left[gone] = False
    assert (fewer.tiles > 1) == (memory_bytes is not None)
    assert np.array_equal(fewer.pixels == NO_PIXEL, ~left)
    assert np.array_equal(fewer.aspect()[0, left], before[left])
    assert not fewer.read().irradiance[0, 0, gone].any()


@pytest.mark.parametrize("exposure", [1.2, 4.0])
def test_by_the_images_border_the_parts_edge_is_told_as_far_as_a_blurred_pixel_looks(
    opencl, exposure
):
    """The part ends just beyond the image, and no neighbour there tells of it."""
    station = check_station(pupil=0.0, exposure=exposure).replace(
        part={"length_mm": 5.04, "width_mm": 5.04}, camera__sampling_mm=0.1, camera__columns=50,
        camera__rows=50, camera__blur_mm=0.15,
    )  # fmt: skip
    auto, everywhere = (
        opencl.trace(station.replace(camera__subsampling=n)).aspect() for n in ("auto", 8)
    )
    inner = np.zeros(station.shape, bool)
    inner[3:-3, 3:-3] = True
    assert station.camera.reach_px == pytest.approx(2.7, abs=0.01)
    assert np.abs(auto - everywhere)[~inner].max() < 0.01  # tables round: 0.005 measured
    assert everywhere[25, 25] - everywhere[25, -2] > 1  # what is beyond counts


@pytest.mark.parametrize(
    "camera", [{"blur_mm": 0.2}, {"pupil_mm": 6.0, "focus_mm": 650.0}], ids=["blur", "focus"]
)
def test_of_a_wide_spot_an_edge_within_the_image_is_told_as_far_as_it_looks(backend, camera):
    """Pixels beside the part see it, and those on it what is beside, in the image as in a list."""
    station = check_station(pupil=0.0).replace(
        part={"length_mm": 3.0, "width_mm": 2.5}, camera={"sampling_mm": 0.1, "columns": 50,
        "rows": 40, **camera}, defects=[],
    )  # fmt: skip
    auto, everywhere = (
        backend.trace(station.replace(camera__subsampling=n)).aspect() for n in ("auto", 8)
    )
    lost = backend.trace(station.replace(camera__subsampling=1)).lost() > 0
    assert (everywhere[lost] > 0).sum() > 300
    gap = np.abs(auto - everywhere)
    assert gap[lost].max() < 0.01
    assert gap.max() < 1.5  # beyond an edge's reach one footprint is taken: 1.0 measured
    pixels = np.random.default_rng(3).permutation(station.shape[0] * station.shape[1])[:600]
    listed = backend.trace(station, pixels=pixels.astype(np.uint32))
    np.testing.assert_array_equal(listed.aspect()[0], auto.flat[pixels])


def test_a_crease_is_cut_finely_where_four_squares_seem_enough():
    """Where a scratch 2 pixels wide bends its footprint is wide, and the bound with it."""
    sides = np.array([1, 2, 4, 8, 4, 8, AT_LOSS], np.uint8)
    across = np.array([CREASE, CREASE, CREASE, CREASE, GROOVE, GROOVE, CREASE], np.uint8)
    found = by_cut(sides, lambda some: across[some])
    assert {cut: places.tolist() for cut, places in found.items()} == {
        2: [1], 4: [4], CREASED: [2, 3], -SLICES: [5], 8: [6],
    }  # fmt: skip


@pytest.mark.parametrize("changes", [SCENES["ceiling"], SCENES["height in a box"]])
def test_what_is_left_at_one_footprint_is_as_good_as_8_by_8(opencl, changes):
    station = scene(**changes)
    needed, _ = needed_on_host(opencl, station)
    one, all_refined, chosen = (
        opencl.trace(station.replace(camera__subsampling=n)).aspect() for n in (1, 8, "auto")
    )
    left = needed == 1
    assert left.mean() > 0.5
    assert np.array_equal(chosen[left], one[left])
    assert np.abs(one - all_refined)[left].max() <= LEFT_AT_ONE_FOOTPRINT_DN
    error = chosen - all_refined
    assert np.sqrt((error**2).mean()) <= REFINED_RMS_DN
    assert np.abs(error).max() <= REFINED_MAX_DN
    assert np.abs(one - all_refined).max() > 10 * REFINED_MAX_DN


def test_a_dent_thinner_than_its_pixel_is_refined(opencl):
    # In the middle of a pixel: the light coordinates around know nothing of it.
    dent = {"kind": "dent", "x_mm": 0.05, "y_mm": -0.05, "diameter_mm": 0.03, "depth_um": 0.3}
    needed, arrays = needed_on_host(opencl, check_station(0.0).replace(defects=[dent]))
    light, wide = arrays.light_mm[0], arrays.wide_mm[0]
    assert np.all(sides_needed(light, np.full_like(wide, wide[0, 0])) == 1)
    assert needed[16, 16] > 1


def test_a_flat_part_needs_no_sub_rays(opencl):
    needed, _ = needed_on_host(opencl, scene(defects=[]))
    assert np.all(needed == 1)


@pytest.mark.parametrize("edges", [(), (CHIP,)], ids=["whole", "a chip"])
def test_the_part_s_edge_is_seen_where_the_image_ends_with_the_part(opencl, edges):
    """That it cuts a pixel the neighbours beyond would tell, and of the default image are none."""
    station = scene(**{
        "part.length_mm": 6.12, "part.width_mm": 5.32, "camera.columns": 62, "camera.rows": 54,
        "edges": edges,
    })  # fmt: skip
    larger = station.replace(camera__columns=66, camera__rows=58)
    own, beyond = (opencl.trace(s.replace(camera__subsampling="auto")) for s in (station, larger))
    border = np.ones(station.shape, bool)
    border[1:-1, 1:-1] = False
    expected = beyond.aspect()[2:-2, 2:-2]
    assert np.array_equal(own.aspect()[border], expected[border])
    one = opencl.trace(station.replace(camera__subsampling=1)).aspect()
    assert np.abs(one - expected)[border].max() > 2 * REFINED_MAX_DN
    listed = np.flatnonzero(border).astype(np.uint32)
    auto = station.replace(camera__subsampling="auto")
    assert np.array_equal(opencl.trace(auto, pixels=listed).aspect()[0], expected[border])


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("lines", [1, 2])
def test_an_image_of_few_lines_is_refined_as_those_in_the_middle_of_more(backend, lines, axis):
    scratch = {"kind": "scratch", "points_mm": [[-4.0, -4.1], [4.0, 4.2]], "width_mm": 0.3,
               "depth_um": 2.0}  # fmt: skip
    size = ("camera__rows", "camera__columns")[axis]
    few, more = (
        scene(defects=[scratch]).replace(**{"camera__subsampling": "auto", size: count})
        for count in (lines, lines + 4)
    )
    own, middle = (
        np.moveaxis(backend.trace(station).aspect(), axis, 0)[cut]
        for station, cut in ((few, np.s_[:]), (more, np.s_[2:-2]))
    )
    assert np.array_equal(own[:, 2:-2], middle[:, 2:-2])
    one = np.moveaxis(backend.trace(few.replace(camera__subsampling=1)).aspect(), axis, 0)
    assert np.abs(own - one).max() > 3 * REFINED_MAX_DN


def test_a_list_with_what_is_no_pixel_is_refined(opencl):
    station = scene(camera__subsampling="auto")
    image = opencl.trace(station)
    pixels = np.sort(np.concatenate([part.pixels for part in image.lists.parts]))
    listed = np.append(pixels, np.uint32(NO_PIXEL))
    found = opencl.trace(station, pixels=listed)
    assert found.refined == image.refined
    assert np.array_equal(found.aspect()[0, :-1], image.aspect().flat[pixels])


def test_levels_of_a_refined_list_are_those_of_its_image(opencl):
    station = scene(camera__subsampling="auto")
    pixels = np.arange(0, np.prod(station.shape), 3, dtype=np.uint32)
    listed = opencl.trace(station, pixels=pixels)
    zones = Zones.none(listed.shape)
    found = listed.counter(zones).count([station])
    expected = levels_of(listed.aspect(), zones, station.sensor.full_scale_dn)
    assert np.array_equal(found.outside, expected.outside)
