"""Chips and burrs: what they take of the part and what they add, on every backend alike."""

from __future__ import annotations

import numpy as np
import pytest

import gpuspec
from gpuspec.arrays import BESIDE
from gpuspec.errors import StationError
from gpuspec.light.float64 import ray_paths
from gpuspec.part.edges import Edges, straight, zones
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

CHIP = {"kind": "chip", "side": "top", "at_mm": 3.0, "width_mm": 2.03, "depth_mm": 0.53}
BURR = {"kind": "burr", "side": "left", "at_mm": -1.0, "width_mm": 1.51, "depth_mm": 0.41}
CORNER = {"kind": "chip", "side": "right", "at_mm": 3.0, "width_mm": 1.5, "depth_mm": 0.61}


def part(*edges: dict[str, object], **changes: object) -> Station:
    """A part of 12 x 6 mm with a margin around it, and a dent that a chip cuts."""
    station = Station(
        part={"length_mm": 12.0, "width_mm": 6.0},
        camera={"sampling_mm": 0.05, "columns": 280, "rows": 160, "subsampling": 1},
        sequence={"images": 16},
        defects=[{"kind": "dent", "x_mm": 3.0, "y_mm": 2.4, "diameter_mm": 1.0, "depth_um": 5.0}],
        edges=list(edges),
    )
    return station.replace(**changes)


@pytest.mark.parametrize(
    ("edge", "half_ellipses"), [(CHIP, 1), (BURR, 1), (CORNER, 0.5)], ids=["chip", "burr", "corner"]
)
def test_a_zone_has_the_area_of_half_an_ellipse(edge, half_ellipses):
    station = part(edge)
    area = np.count_nonzero(zones(Edges.of(station), station)) * 0.05**2
    expected = half_ellipses * np.pi / 4 * edge["width_mm"] * edge["depth_mm"]
    assert area == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera__subsampling": 3},
        {"part__surface": "height", "part__crown_radius_x_mm": 60.0, "part__crown_radius_y_mm": 40},
    ],
    ids=["flat", "sub-rays", "crowned"],
)
def test_backends_see_chips_as_beside_the_part_and_burrs_as_of_it(backend, changes):
    station = part(CHIP, BURR, CORNER, **changes)
    light_map = backend.trace(station)
    reference = gpuspec.open_backend("numpy").trace(station)
    lost = light_map.lost()
    assert np.array_equal(lost, reference.lost())
    assert np.abs(light_map.aspect() - reference.aspect()).max() < 1e-3
    column, row = np.arange(280)[None], np.arange(160)[:, None]
    zone = zones(Edges.of(station), station)
    plain = straight(station, column, row)
    if station.camera.side == 1:  # else a pixel is of the part if any of its rays is
        expected = np.where(zone > 0, np.isin(zone, (1, 3)), ~plain)
        assert np.array_equal(lost == BESIDE, expected)
    black = light_map.image(3)[(zone == 1) & (lost == BESIDE)]
    assert len(black) > 100
    assert (black == 0).all()


def test_chips_and_burrs_move_with_a_part_that_is_shifted_and_turned(backend):
    pose = {"shift_x_mm": 0.513, "turn_deg": 7.0, "tilt_y_deg": 2.0}
    station = part(CHIP, BURR, CORNER, part__pose=pose)
    lost = backend.trace(station).lost()
    zone = zones(Edges.of(station), station)
    plain = straight(station, np.arange(280)[None], np.arange(160)[:, None])
    assert [np.count_nonzero(zone == n) * 0.05**2 for n in (1, 2)] == pytest.approx(
        [np.pi / 4 * one["width_mm"] * one["depth_mm"] for one in (CHIP, BURR)], rel=0.04
    )
    expected = np.where(zone > 0, np.isin(zone, (1, 3)), ~plain)
    assert np.count_nonzero((lost == BESIDE) != expected) <= 2  # on the edge, but for rounding


def test_nothing_else_of_the_light_map_changes(device_backend):
    """A chip goes to a device among the grooves, and cuts a dent here."""
    with_edges = device_backend.trace(part(CHIP, BURR, CORNER))
    without = device_backend.trace(part())
    both = (with_edges.lost() != BESIDE) & (without.lost() != BESIDE)
    assert both.sum() > 25_000
    assert np.array_equal(with_edges.aspect()[both], without.aspect()[both])


def test_a_list_of_pixels_has_the_outline_of_the_image(device_backend):
    station = part(CHIP, BURR, CORNER)
    pixels = np.flatnonzero(zones(Edges.of(station), station)).astype(np.uint32)
    pixels = np.random.default_rng(3).permutation(np.concatenate([pixels, pixels + 3]))
    found = device_backend.trace(station, None, pixels).lost()
    assert np.array_equal(found[0], device_backend.trace(station).lost().flat[pixels])


def test_the_first_of_two_that_overlap_says():
    over = {**CHIP, "kind": "burr", "depth_mm": 1.0}
    for edges, kept in (((CHIP, over), False), ((over, CHIP), True)):
        station = part(*edges)
        paths = ray_paths(station, Relief.of(station), [3.0, 3.0], [2.9, 3.8])
        assert (paths.lost != BESIDE).tolist() == [kept, True]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"at_mm": 6.1}, r"edges\[1\].at_mm = 6.1 is beside the part's top edge.*±6 mm"),
        ({"depth_mm": 7.0}, r"edges\[1\].depth_mm = 7 is larger than the part"),
        ({"width_mm": 13.0}, r"edges\[1\].width_mm = 13 is larger than the part"),
        ({"side": "front"}, "side"),
        ({"kind": "dent"}, "kind"),
    ],
)
def test_what_is_no_chip_of_the_part_is_refused(change, words):
    with pytest.raises(StationError, match=words):
        part({**CHIP, **change})


def test_a_light_map_is_not_used_for_other_edges():
    light_map = gpuspec.open_backend("numpy").trace(part(CHIP))
    with pytest.raises(StationError, match="its edges are others than those traced"):
        light_map.aspect(part(BURR))


def test_a_sweep_refuses_edges(gpuspec_, tmp_path):
    part(CHIP).write(tmp_path / "chipped.toml")
    ran = gpuspec_("sweep", "chipped.toml", "--vary", "sensor.exposure=2:4:2", "-o", "sweep")
    assert ran.code == 1
    assert "leave them out of what is swept (--set edges=none)" in " ".join(ran.err.split())
