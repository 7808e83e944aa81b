"""A part and a camera in any pose, and rays that meet the part twice: laws, then the oracle."""

from __future__ import annotations

import dataclasses

import numpy as np
import oracle
import pytest
import tolerances
from device import Device
from laws import LANES, Array, Draws, close, components, holds, named, stacked, struct
from scenes import check_station, oracle_scene
from scipy.spatial.transform import Rotation
from test_relief_on_devices import NO_GROOVE, NO_MAP, relief_headers

import gpuspec
from gpuspec.arrays import Lost
from gpuspec.part.grooves import Grooves
from gpuspec.part.maps import TopographyMap
from gpuspec.part.marches import march_of
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.station.station import Station

POSED = ("#define POSED", *relief_headers(NO_GROOVE, NO_MAP))
H = 400.0


def frames(d: Draws) -> tuple[Array, Array, Array, Array]:
    """Axes of camera and part, (groups, 3, 3), and where they are, (groups, 3)."""
    angles = d.rng.uniform(-0.4, 0.4, (2, d.groups, 3))
    angles[:, :20] = 0
    axes = [Rotation.from_euler("xyz", a).as_matrix() for a in angles]
    places = d.rng.uniform(-5, 5, (2, d.groups, 3))
    return axes[0], places[0], axes[1], places[1]


def geometry(d: Draws, view: Array, middle: Array, turn: Array, origin: Array, **more) -> Array:
    values = {}
    for name, axes, place in (("view", view - np.diag([1, 1, 0]), middle), ("pose", turn, origin)):
        for row, axis in enumerate("xyz"):
            values[f"{name}_{axis}"] = place[:, row, None]
            for column, of in enumerate("xyz"):
                values[f"{name}_{axis}{of}"] = axes[:, row, column, None]
    return struct("Geometry", d.groups, **{**values, **more})


@holds("turned", wrong=("g.pose_yx * v.x + g.pose_yy", "g.pose_xy * v.x + g.pose_yy"))
@holds("turned_back", wrong=("g.pose_xy * v.x + g.pose_yy", "g.pose_yx * v.x + g.pose_yy"))
def test_a_vector_is_turned_into_the_tunnel_s_frame_and_back(device: Device) -> None:
    d = Draws(71)
    view, middle, turn, origin = frames(d)
    v = d.vectors()
    code = "Vector v = vector(vx, vy, vz), t = turned(g, v), b = turned_back(g, v);"
    inputs = {**named("v", v), "Geometry g": geometry(d, view, middle, turn, origin)}
    got = stacked(device.call(POSED, code, inputs, (*components("t"), *components("b"))))
    close(got[:3], np.einsum("gij,jgl->igl", turn, v), tolerances.VECTOR)
    close(got[3:], np.einsum("gji,jgl->igl", turn, v), tolerances.VECTOR)


@holds("aim_at", wrong=("g.view_zx * u + g.view_zy * v + g.view_z", "g.view_zx * u + g.view_z"))
@holds("posed_ray", wrong=("1.0f + way * (1.0f", "1.0f - way * (1.0f"))
def test_a_posed_ray_leads_from_the_pupil_through_its_place(device: Device) -> None:
    d = Draws(72)
    view, middle, turn, origin = frames(d)
    g = geometry(d, view, middle, turn, origin, camera_height=H)
    u, v, way = d.pixel(-50, 50), d.pixel(-30, 30), d.pixel(-20, 20)
    code = "Aim aim = aim_at(g, u, v); CameraRay c = posed_ray(g, aim, u, v, way);"
    inputs = {"REAL u": u, "REAL v": v, "REAL way": way, "Geometry g": g}
    outputs = (*components("c.point"), *components("c.direction"), "c.share")
    got = stacked(device.call(POSED, code, inputs, outputs))
    to = np.einsum("gij,jgl->igl", view, np.stack([u, v, 0 * u - H]))
    pupil = (middle + H * view[:, :, 2]).T[:, :, None]
    close(got[3:6], to / H, tolerances.VECTOR)
    close(got[:3], pupil + (1 + way / H) * to, tolerances.POSED_PLACE_MM)
    close(got[6], 1 + way / H, tolerances.VECTOR)


@holds("part_at", wrong=("shape_at(g, x0 + at.shift_x", "shape_at(g, x0 - at.shift_x"))
def test_the_part_under_a_place_is_its_shape_and_its_relief(device: Device) -> None:
    d = Draws(73)
    groove = struct("Groove", 1, column=5.0, row=4.0, height=0.1, inverse_variance=0.5)
    headers = relief_headers(groove, NO_MAP)
    g = struct("Geometry", d.groups, curvature_x=1 / d.shared(80, 900), sampling=0.25)
    code = """Place place; place.column = column; place.row = row; place.sub_x = 0.5f;
        place.sub_y = 0.5f; place.shift_x = shift; place.shift_y = 0.0f * shift;
        Lists lists; lists.maps = 0;
        REAL x0 = column * 0.25f, y0 = row * 0.25f;
        Surface s = part_at(g, lists, 0, 1, place, x0, y0);
        Surface bare = shape_at(g, x0 + shift, y0);
        Surface t = grooves_at(bare, lists, 0, 1, place, g.sampling);"""
    inputs = {
        "REAL column": np.floor(d.pixel(0, 12)), "REAL row": np.floor(d.pixel(0, 9)),
        "REAL shift": d.pixel(-1, 1), "Geometry g": g,
    }  # fmt: skip
    names = ("height", "slope_x", "curve_xx")
    outputs = [f"{one}.{name}" for one in ("s", "t", "bare") for name in names]
    got = stacked(device.call(headers, code, inputs, outputs))
    assert np.abs(got[3:6] - got[6:]).max() > 0.05  # the groove counts
    close(got[:3], got[3:6], tolerances.VECTOR)


@holds("block_outline", wrong=("outline = outline_at(", "outline = -outline_at("))
def test_a_block_s_outline_is_that_of_its_edge_defects(device: Device) -> None:
    d = Draws(76)
    burr = struct(
        "Groove", 1, column=20.0, row=15.0, along_x=1.0, inverse_square=1.0, inverse_variance=1.0,
        outline=1.0,
    )  # fmt: skip
    code = """Place place; place.column = column; place.row = row; place.sub_x = 0.5f;
        place.sub_y = 0.5f; place.shift_x = 0.0f * row; place.shift_y = 0.0f * row;
        Lists lists; lists.maps = 0; REAL none = block_outline(lists, 1, 1, place, 0.1f);
        REAL said = block_outline(lists, 0, 1, place, 0.1f);"""
    column, row = np.floor(d.pixel(0, 40)), np.floor(d.pixel(0, 30))
    inputs = {"REAL column": column, "REAL row": row}
    got = stacked(device.call(relief_headers(burr, NO_MAP), code, inputs, ("said", "none")))
    inside = np.hypot(column - 19.5, row - 14.5) < 10
    assert 0.1 < inside.mean() < 0.9
    assert np.array_equal(got[0] == 1, inside)
    assert not got[1].any()


@holds("meets_part", wrong=("share * share * way", "0.5f * share * share * way"))
def test_a_ray_meets_a_hollow_cylinder_where_it_meets_its_circle(device: Device) -> None:
    d = Draws(74)
    radius, half = 60.0, 50.0
    x, angle = d.pixel(-0.9 * half, 0.9 * half), d.pixel(0.05, np.pi - 0.05)
    z = radius - np.sqrt(radius**2 - x**2)
    ray = np.cos(angle), np.sin(angle)
    way = -2 * (x * ray[0] + (z - radius) * ray[1])  # to the circle, again
    end = x + way * ray[0]
    expected = (way > 0) & (np.abs(end) < half) & (z + way * ray[1] < radius)
    g = struct(
        "Geometry", d.groups, curvature_x=-1 / radius, half_length=half, half_width=5.0,
        march_steps=96.0, march_slack=1e-3, sampling=0.1, spherical=0.0,
        highest=radius - np.sqrt(radius**2 - half**2),
    )  # fmt: skip
    code = """REAL zero = 0.0f * x; Place place; place.column = zero; place.row = zero;
        place.sub_x = 0.0f; place.sub_y = 0.0f; place.shift_x = x; place.shift_y = zero;
        Lists lists; lists.maps = 0;
        MASK met = meets_part(g, lists, 0, 0, place, zero, zero, vector(x, zero, z),
                              vector(rx, zero, rz));
        REAL one = 1.0f + zero; REAL said = met ? one : zero;"""
    inputs = {"REAL x": x, "REAL z": z, "REAL rx": ray[0], "REAL rz": ray[1], "Geometry g": g}
    (said,) = device.call(POSED, code, inputs, ("said",))
    clear = (way > 2) & (np.abs(np.abs(end) - half) > 2)
    assert 0.1 < expected[clear].mean() < 0.9
    assert np.array_equal(said[clear] == 1, expected[clear])


@holds("posed_sight", wrong=("turned(g, c.point)", "c.point"))
@holds("posed_sub_ray", wrong=("(begin - aim.away.z)", "(begin + aim.away.z)"))
def test_a_posed_ray_sees_what_differences_give(device: Device) -> None:
    d = Draws(75)
    view, middle, turn, origin = frames(d)
    p, top = 0.1, 150.0
    g = geometry(
        d, view, middle, turn, origin, camera_height=H, sampling=p, subsampling=1.0, columns=400.0,
        rows=300.0, tunnel_top=top, tunnel_half_length=1e6, half_length=1e3, half_width=1e3,
    )  # fmt: skip
    column, row = np.floor(d.pixel(0, 400)), np.floor(d.pixel(0, 300))

    def light(u: Array, v: Array) -> Array:
        """Where a flat part's rays meet the ceiling."""
        to = np.einsum("gij,jgl->igl", view, np.stack([u, v, 0 * u - H]))
        pupil = (middle + H * view[:, :, 2]).T[:, :, None]
        point = pupil - pupil[2] / to[2] * to
        point[2] = 0
        ray = np.einsum("gij,jgl->igl", turn, to * np.array([1, 1, -1])[:, None, None])
        point = np.einsum("gij,jgl->igl", turn, point) + origin.T[:, :, None]
        return np.where(ray[2] > 0, point[0] + (top - point[2]) / ray[2] * ray[0], np.nan)

    u, v, e = (column - 199.5) * p, (149.5 - row) * p, 1e-4
    moves = [light(u + e, v) - light(u - e, v), light(u, v + e) - light(u, v - e)]
    wide, narrow = -np.sort(-np.abs(moves), axis=0) * p / (2 * e)
    code = """Lists lists; lists.maps = 0; Sight s = sub_ray(g, lists, 0, 0, column, row, 0);
        Place place; place.column = column; place.row = row;
        place.sub_x = 0.5f; place.sub_y = 0.5f;
        Sight r = posed_sub_ray(g, lists, 0, 0, place, u, v);
        Aim aim = aim_at(g, u, v); REAL way = -aim.away.z / aim.direction.z;
        MASK none = way != way;
        CameraRay c = posed_ray(g, aim, u, v, way);
        Sight t = posed_sight(g, flat_surface(), c, 0.0f, 0.0f, 0.0f * u, none, none);"""
    inputs = {"REAL column": column, "REAL row": row, "REAL u": u, "REAL v": v, "Geometry g": g}
    outputs = [f"{one}.{name}" for one in "srt" for name in ("light", "wide", "narrow", "lost")]
    got = stacked(device.call(POSED, code, inputs, outputs)).reshape(3, 4, d.groups, LANES)
    seen = np.isfinite(light(u, v)) & (np.abs(light(u, v)) < 500)
    assert seen.mean() > 0.8
    for one in got:
        assert not one[3][seen].any()
        close(one[0][seen], light(u, v)[seen], tolerances.POSED_LIGHT_MM, 1e-5)
        close(one[1][seen], wide[seen], 1e-6, 1e-3)
        close(one[2][seen], narrow[seen], 1e-3 * wide[seen])


PART = {
    "shift_x_mm": 0.4, "shift_y_mm": -0.3, "shift_z_mm": 5.0, "tilt_x_deg": 6.0,
    "tilt_y_deg": -9.0, "turn_deg": 25.0,
}  # fmt: skip
CAMERA = {"shift_x_mm": 90.0, "shift_y_mm": 40.0, "tilt_x_deg": -2.9, "tilt_y_deg": 6.4}
CROWN = {"part__surface": "height", "part__crown_radius_x_mm": 60.0}
POSES = {
    "part": {"part__pose": PART},
    "camera": {"camera__pose": CAMERA},
    "crowned part": {"part__pose": PART, **CROWN},
    "both under an arch": {
        "part__pose": PART, "camera__pose": CAMERA, "tunnel__section": "arch",
        "tunnel__radius_mm": 120.0, **CROWN,
    },
}  # fmt: skip


def posed(name: str, **changes) -> Station:
    return check_station(**{"part__length_mm": 6.0, **POSES[name], **changes})


@pytest.mark.parametrize("name", POSES)
def test_rays_of_a_posed_station_go_where_the_oracle_s_go(name, backend):
    # Without the dent: the program averages it over a pixel, the oracle's central ray does not.
    station = posed(name, pupil=0.0, camera__subsampling=1, defects=())
    found = backend.trace(station).read()
    rays = oracle.central_rays(oracle_scene(station))
    assert np.array_equal(found.lost, rays.reason)
    seen = found.lost == 0
    assert seen.mean() > 0.9
    assert np.abs(found.light_mm[0] - rays.L[..., 0])[seen].max() < tolerances.POSED_LIGHT_MM


@pytest.mark.parametrize("pupil", [0.0, 12.0])
@pytest.mark.parametrize("name", POSES)
def test_images_of_a_posed_station_are_those_of_many_rays(name, pupil):
    station = posed(name, pupil=pupil, camera__columns=20, camera__rows=20)
    aspect = gpuspec.simulate(station, "opencl").aspect
    expected = oracle.aspect_image(oracle_scene(station), rays=1024)
    assert np.ptp(expected) > 20  # the dent is seen
    assert np.sqrt(np.mean((aspect - expected) ** 2)) < tolerances.POSED_RMS_DN


@pytest.mark.parametrize("name", POSES)
def test_devices_find_the_defects_of_a_posed_part_in_their_blocks(name, device_backend):
    many = [
        {"kind": "dent", "x_mm": x, "y_mm": y, "diameter_mm": 0.8, "depth_um": 5.0}
        for x in (-12.0, 1.0, 13.0) for y in (-8.0, 4.0)
    ]  # fmt: skip
    line = {"kind": "scratch", "points_mm": [[-14, -9], [3, 8], [9, -6]], "width_mm": 0.3,
            "depth_um": 3.0}  # fmt: skip
    station = posed(
        name, part__length_mm=30.0, part__width_mm=20.0, camera__columns=None, camera__rows=None,
        camera__subsampling=1, defects=[*many, line],
    )  # fmt: skip
    found, expected = (
        of.trace(station).read() for of in (device_backend, gpuspec.open_backend("numpy"))
    )
    same = (found.lost == 0) & (expected.lost == 0)
    assert (found.lost != expected.lost).mean() < 1e-3
    assert same.mean() > 0.7
    error = np.abs(found.light_mm - expected.light_mm)[:, same]
    assert error.max() < tolerances.POSED_DEFECT_MM


def test_zones_and_what_is_seen_of_defects_move_with_the_part():
    station = posed("crowned part", camera__columns=80, camera__rows=80)
    result = gpuspec.simulate(station, "opencl")
    zone = Truth.of(station, Relief.of(station)).labels == 1
    assert zone.sum() > 30
    # Where the oracle's rays meet the part within the dent's zone.
    place = oracle.posed_surface_point(
        oracle_scene(station), *oracle.pixel_centres(oracle_scene(station))
    )
    away = np.hypot(place[..., 0] - 0.03, place[..., 1] + 0.02)
    assert np.array_equal(zone, away <= 0.5)
    assert result.score.defects_hit == 1
    nominal = np.hypot(*oracle.pixel_centres(oracle_scene(station))) <= 0.5
    assert (zone & nominal).sum() < zone.sum()  # it is elsewhere than it was


def test_a_part_and_a_camera_moved_together_see_what_they_saw():
    """Shifted across the light they see the same of it."""
    moved = {"shift_y_mm": 7.0}
    station = check_station(pupil=0.0, camera__subsampling=1)
    there = station.replace(part__pose=moved, camera__pose=moved)
    first, second = (gpuspec.simulate(one, "numpy").aspect for one in (station, there))
    np.testing.assert_allclose(second, first, atol=1e-4)


RIDGE_MM = 6.0


def ridged(**changes) -> tuple[Station, Relief, oracle.Scene]:
    """A part with a ridge across that is as high as it is wide, as a map and as the oracle's."""
    pitch = 0.1
    x, y = np.arange(-20, 20.05, pitch), np.arange(-12, 12.05, pitch)
    z = np.broadcast_to(RIDGE_MM * np.exp(-(x**2) / 2), (len(y), len(x))).copy()
    ridge = TopographyMap(z, z, (pitch, pitch), (-20.0, -12.0), None, "ridge")
    station = Station.from_dict(
        {
            "part": {"length_mm": 30.0, "width_mm": 8.0, "surface": "height"},
            "camera": {"sampling_mm": 0.25, "height_mm": 400.0, "subsampling": 1},
            "tunnel": {"length_mm": 3000.0},
        }
    ).replace(**changes)
    scene = dataclasses.replace(
        oracle_scene(station), looks=1500,
        grooves=(oracle.Groove(((0.0, -50.0), (0.0, 50.0)), 1.0, RIDGE_MM),),
    )  # fmt: skip
    return station, Relief((), Grooves.of(()), (ridge,)), scene


def in_part(scene: oracle.Scene, rays: oracle.Rays) -> tuple[Array, Array]:
    """Points and reflected rays in the part's frame."""
    pose = scene.part_pose
    return (
        pose.turned(rays.S - np.array(pose.shift_mm), back=True),
        pose.turned(rays.R, back=True),
    )


def test_what_is_hidden_or_reflected_twice_is_lost_and_nothing_else_is_wrong(backend):
    station, relief, scene = ridged(part__pose={"tilt_y_deg": 35.0})
    found = backend.trace(station, relief).read()
    rays = oracle.central_rays(scene)  # to what they meet first
    again = oracle.meets_again(scene, *in_part(scene, rays), steps=1000)
    again &= (rays.reason != oracle.BESIDE_PART) & (rays.reason != oracle.DOWN)
    seen = found.lost == Lost.NOT
    # No pixel sees through the part: what is seen is what many looks find first.
    assert (rays.reason[seen] == oracle.SEEN).all()
    assert np.abs(found.light_mm[0] - rays.L[..., 0])[seen].max() < tolerances.RIDGE_MM
    # None of those seen meets the part again, but at the very edge of those that do.
    assert (seen & again).sum() <= 0.01 * again.sum() + 8
    assert (found.lost == Lost.AGAIN).sum() > 0.5 * again.sum() > 50
    assert (found.lost == Lost.HIDDEN).any()
    lost = np.isin(found.lost, (Lost.HIDDEN, Lost.AGAIN))
    assert lost.mean() < 0.2


def test_a_hollow_part_s_second_reflections_are_lost(backend):
    station = Station.from_dict(
        {
            "part": {"length_mm": 30.0, "width_mm": 4.0, "surface": "height",
                     "crown_radius_x_mm": -17.0},
            "camera": {"sampling_mm": 0.2, "height_mm": 400.0, "subsampling": 1, "pupil_mm": 0.0},
            "tunnel": {"length_mm": 3000.0},
        }
    )  # fmt: skip
    found = backend.trace(station).read()
    scene = oracle_scene(station)
    rays = oracle.central_rays(scene)
    again = oracle.meets_again(scene, rays.S, rays.R, steps=1000) & (rays.reason != oracle.DOWN)
    assert again.sum() > 200
    assert (again != (found.lost == Lost.AGAIN)).mean() <= 0.005


def test_gentle_parts_are_followed_but_once():
    station = check_station()
    for one in (
        station, station.replace(part__surface="height"),
        posed("crowned part"), station.replace(part__surface="height", part__sphere_radius_mm=-900),
    ):  # fmt: skip
        assert march_of(one, Relief.of(one)) is None
    station, relief, _ = ridged()
    assert march_of(station, relief) is not None
