"""The pixels that screen a part: which they are, and that nothing else is above what bounds it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from tolerances import P_VALUE

from gpuspec.arrays import BESIDE
from gpuspec.light.constants import LEVELS, NO_PIXEL
from gpuspec.light.levels import levels_of
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.part.guard import near as near_
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.station.station import Station
from gpuspec.sweeps.trying import flawless as flawless_module
from gpuspec.sweeps.trying.flawless import Flawless
from gpuspec.sweeps.trying.listing import Listing, listed
from gpuspec.sweeps.trying.parts import Placed, Screen

SCENE: dict[str, Any] = {
    "part": {"length_mm": 38.0, "width_mm": 25.0},
    "tunnel": {"height_mm": 120.0, "luminous_mm": 2.0, "dark_mm": 6.0},
    "camera": {"height_mm": 400.0, "sampling_mm": 0.1, "columns": 391, "rows": 257,
               "subsampling": 1},
    "defects": [
        {"kind": "dent", "x_mm": 2.0, "y_mm": 1.0, "diameter_mm": 0.8, "depth_um": 8.0},
        {"kind": "bump", "x_mm": -18.8, "y_mm": 12.2, "diameter_mm": 1.0, "depth_um": 6.0},
        {"kind": "scratch", "points_mm": [[-12, -9], [0, -5], [3, 8]], "width_mm": 0.3,
         "depth_um": 3.0},
    ],
}  # fmt: skip

CASES: dict[str, dict[str, Any]] = {
    "flat": {},
    "pinhole": {"camera.pupil_mm": 0.0},
    "a pupil as wide as a pixel": {"camera.pupil_mm": 0.35},
    "convex": {"part.crown_radius_x_mm": 300.0, "part.crown_radius_y_mm": 900.0},
    "concave": {"part.crown_radius_x_mm": -1200.0},
    "heights": {"part.surface": "height", "part.crown_radius_x_mm": 250.0},
    "concave heights": {"part.surface": "height", "part.crown_radius_y_mm": -400.0},
    "rough": {"part.roughness_rad": 0.002, "camera.pupil_mm": 0.5},
    "box": {"tunnel.section": "box", "tunnel.width_mm": 28.0, "part.crown_radius_y_mm": 200.0},
    "wide box": {"tunnel.section": "box", "tunnel.width_mm": 30.0, "camera.pupil_mm": 0.0},
    "arch": {"tunnel.section": "arch", "tunnel.radius_mm": 90.0, "camera.vignetting": "cos4"},
    "short": {"tunnel.length_mm": 60.0, "part.crown_radius_x_mm": 300.0},
    "opening": {"tunnel.opening_length_mm": 12.0, "tunnel.opening_width_mm": 9.0},
    "lacquer": {"part.material": "lacquer", "camera.vignetting": "cos4"},
    "refined": {"camera.subsampling": "auto"},
    "refined at the edge of the image": {"camera.subsampling": "auto", "camera.columns": 376,
                                         "part.crown_radius_x_mm": 400.0, "part.surface": "height"},
    "blurred": {"camera.blur_mm": 0.07},
    "off focus": {"camera.focus_mm": 420.0, "part.crown_radius_x_mm": 400.0},
    "off focus, refined": {"camera.focus_mm": 380.0, "camera.subsampling": "auto"},
    "dull": {"part.diffuse": 0.2},
    "beyond the part": {"part.length_mm": 38.2, "part.width_mm": 25.05},
}  # fmt: skip


def scene(name: str) -> Station:
    return Station.from_dict(SCENE).replace(**CASES[name])


def screened(station: Station, opencl: OpenCLBackend, strata: int = 500):
    """A screen of the station's part, and it under its tunnel."""
    screen = Screen.of(station, Placed.of(station), strata, 0)
    return screen, screen.under(station, opencl, Flawless(station, opencl), first=True)


def stands_for(listing: Listing, size: int) -> np.ndarray:
    """How often each pixel of the image is in the list."""
    return np.bincount(listing.pixels[listing.pixels != NO_PIXEL], minlength=size)


@pytest.mark.parametrize("name", CASES)
def test_zones_near_and_strata_are_all_pixels_of_the_part_once(opencl, name):
    station = scene(name)
    relief = Relief.of(station)
    truth = Truth.of(station, relief)
    listing = listed(station, relief, truth, 500, 0)
    times = stands_for(listing, truth.labels.size)
    if listing.refinable is None:
        assert times.max() == 1
    lost = opencl.trace(station, relief).lost()
    valid = lost.ravel() != BESIDE
    zones = listing.zones.only(listing.pixels[None] != NO_PIXEL)
    inside = valid & (truth.labels.ravel() != 0)
    found = listing.pixels[zones.pixels]
    assert np.array_equal(np.sort(found[valid[found]]), np.flatnonzero(inside))
    for number, (first, last) in enumerate(zip(zones.first[:-1], zones.first[1:], strict=True), 1):
        assert (truth.labels.flat[found[first:last]] == number).all()
    guard = listing.pixels[zones.guard]
    wanted = near_(station, relief, truth)
    assert np.array_equal(np.sort(guard), wanted[truth.labels.flat[wanted] == 0])
    near = np.concatenate([guard, listing.pixels[listing.near]])
    assert not truth.labels.flat[near].any()
    assert valid[listing.pixels[listing.chosen]].all()
    standing = len(listing.chosen) * listing.weight
    assert standing + np.count_nonzero(valid[near]) == np.count_nonzero(valid) - inside.sum()
    assert len(near) < 0.35 * valid.sum()


@pytest.mark.parametrize("name", CASES)
def test_no_pixel_that_is_not_listed_is_above_the_ceiling(opencl, name):
    """Many designs of each geometry: whatever the stripes and the exposure."""
    station = scene(name)
    screen, part = screened(station, opencl)
    light_map = opencl.trace(station, screen.relief)
    rest = light_map.lost() != BESIDE
    rest.flat[screen.listing.itself] = False
    random = np.random.default_rng(5)
    tried = [
        station.replace(**{
            "tunnel.luminous_mm": random.uniform(0.3, 8), "tunnel.dark_mm": random.uniform(0.3, 20),
            "sensor.exposure": random.uniform(0.5, 20), "sequence.images": int(images),
            "tunnel.dark_leak": random.choice([0, 0.02]),
        })
        for images in random.integers(2, 90, 40)
    ]  # fmt: skip
    found = part.counter.count(tried)
    above = []
    for i, design in enumerate(tried):
        level = np.ceil(light_map.aspect(design)[rest]).clip(0, LEVELS - 1)
        assert level.max(initial=0) <= found.ceiling[i], design
        above.append(found.ceiling[i] - level.max(initial=0))
        zones = part.zones
        image = levels_of(light_map.aspect(design), zones_of(screen, light_map), 255)
        assert np.array_equal(found.inside[i, 1:], image.inside[0, 1:])
        assert np.array_equal(found.peaks[i], image.peaks[0])
        assert np.array_equal(found.guard[i, 1:], image.guard[0, 1:])
        assert np.array_equal(zones.sizes, zones_of(screen, light_map).sizes)
    # They are worth having: of most designs not more than two levels above.
    assert np.median(above) <= (20 if "box" in name else 3 if name == "dull" else 2), above


def test_the_sample_of_every_part_is_drawn_anew():
    """The same strata, other pixels of them: one of 40 each."""
    station = scene("flat")
    relief = Relief.of(station)
    truth = Truth.of(station, relief)
    one, other, again = (listed(station, relief, truth, 2000, seed) for seed in (0, 1, 0))
    assert np.array_equal(one.pixels[one.near], other.pixels[other.near])
    assert (one.pixels[one.chosen] != other.pixels[other.chosen]).mean() > 0.8
    assert np.array_equal(one.pixels, again.pixels)


def test_one_pixel_of_each_stratum_is_drawn_and_each_as_often():
    """Chi-square over 60 seeds."""
    station = scene("flat")
    relief = Relief.of(station)
    truth = Truth.of(station, relief)
    counts = np.zeros(10)
    for seed in range(60):
        listing = listed(station, relief, truth, truth.labels.size // 10, seed)
        assert listing.weight == 10
        x = (np.arange(391) + 0.5 - 391 / 2) * 0.1
        y = (np.arange(257) + 0.5 - 257 / 2) * 0.1
        every = np.logical_and.outer(np.abs(y) < 12.5 - 1e-4, np.abs(x) < 19 - 1e-4)
        itself = listing.itself
        left = np.setdiff1d(itself, listed(station, relief, truth, 10**6, 0).itself)
        every.flat[np.setdiff1d(itself, left)] = False
        place = np.searchsorted(np.flatnonzero(every), listing.pixels[listing.chosen])
        assert np.array_equal(place // 10, np.arange(len(place)))
        counts += np.bincount(place % 10, minlength=10)
    assert chi2.sf(((counts - counts.mean()) ** 2 / counts.mean()).sum(), 9) > P_VALUE


def test_a_part_all_of_zones_has_no_sample(opencl):
    dent = {"kind": "dent", "x_mm": 0.0, "y_mm": 0.0, "diameter_mm": 9.0, "depth_um": 1.0}
    station = Station.from_dict(
        {**SCENE, "defects": [dent], "camera": {**SCENE["camera"], "columns": 12, "rows": 12}}
    )
    _, part = screened(station, opencl)
    assert part.sample is None
    found = part.counter.count([station])
    assert found.inside.sum() == 144
    assert not found.outside[:, 1:].any()
    assert not found.ceiling.any()


def test_a_part_of_measured_relief_is_bounded_by_all_its_pixels(opencl, tmp_path):
    """No shape tells of it: waves of 1 mm and a pit."""
    x, y = np.meshgrid(np.arange(400) * 0.1, np.arange(260) * 0.1)
    waves = 0.2 * np.sin(2 * np.pi * x / 9) - 4 * np.exp(-((x - 20) ** 2 + (y - 13) ** 2) / 0.1)
    np.savetxt(tmp_path / "map.csv", waves, delimiter=",")
    station = Station.from_dict(
        {
            **SCENE, "defects": [],
            "part": {"relief": {"file": "map.csv", "height_unit": "um", "pitch_um": 100.0,
                                "zone_height_um": 1.0}},
        }, folder=tmp_path,
    )  # fmt: skip
    screen, part = screened(station, opencl)
    light_map = opencl.trace(station, screen.relief)
    rest = light_map.lost() != BESIDE
    rest.flat[screen.listing.itself] = False
    level = np.ceil(light_map.aspect()[rest]).max()
    assert level <= part.counter.count([station]).ceiling[0] <= level + 20


def zones_of(screen: Screen, light_map):
    station = light_map.station
    placed = Placed.of(station)
    return placed.zones.only(light_map.lost() != BESIDE)


def test_a_bound_without_its_margins_would_be_seen(opencl, monkeypatch):
    """The test above can fail: corners alone, as if nothing were left of the defects."""
    monkeypatch.setattr(flawless_module, "_BULGE", -0.5)
    monkeypatch.setattr(flawless_module, "_ROUNDING", -0.02)
    with pytest.raises(AssertionError):
        for name in ("arch", "convex", "pinhole"):
            test_no_pixel_that_is_not_listed_is_above_the_ceiling(opencl, name)
