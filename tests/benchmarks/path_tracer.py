"""Prints how far aspect images are from two path tracers on random scenes nobody has tuned to.

    python tests/benchmarks/path_tracer.py [--seed 1 --scenes 6 --pupil 0 --rays 16384]

The same seed gives the same scenes; take another for a hold-out. Both references follow rays of
pixel x pupil to the tunnel, one by one, and every image is exposed and saturated after its pixels
are averaged. *Brute force* is float64, on the surface itself, and shares no line with the program.
*Mitsuba* 3 (`pip install mitsuba`, Debian's libllvm) brings camera, mesh, mirror and tunnel of its
own; of the mesh, MESH vertices a pixel with the surface's normals, it is as good as that. A ray's
light coordinate serves all images: the tunnel's translation does not change the ray.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

import oracle
from scenes import oracle_scene

from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.light.speed import best
from gpuspec.station.station import Station

PIXELS = 96  # on a side
CHUNK = 1 << 22  # rays at a time
MESH = 8  # vertices of Mitsuba's mesh along a pixel's side
SUBSAMPLINGS = (1, 2, 4, 8, "auto")


def hold_out(seed: int, pupil_mm: float) -> Station:
    """A random scene: every section, surface and shape; seven defects of 0.3 to 1.2 mm."""
    draw = np.random.default_rng(seed)
    sampling = float(draw.uniform(0.05, 0.06))
    side = PIXELS * sampling
    section = str(draw.choice(["ceiling", "box", "arch"]))
    tunnel = {
        "section": section,
        "luminous_mm": float(draw.uniform(2, 5)),
        "dark_mm": float(draw.uniform(6, 14)),
        "radius_mm" if section == "arch" else "height_mm": float(draw.uniform(80, 250)),
    }
    part = {
        "length_mm": 2 * side,
        "width_mm": 2 * side,
        "surface": str(draw.choice(["orientation", "height"])),
    }
    if section == "box":
        tunnel["width_mm"] = float(draw.uniform(60, 120))
    if draw.random() < 0.5:
        part["crown_radius_x_mm"] = float(draw.uniform(500, 3000))
        part["crown_radius_y_mm"] = float(draw.uniform(-3000, -500))
    return Station.from_dict(
        {
            "part": part,
            "tunnel": tunnel,
            "camera": {
                "height_mm": float(draw.uniform(500, 900)), "sampling_mm": sampling,
                "columns": PIXELS, "rows": PIXELS, "pupil_mm": pupil_mm,
            },
            "sensor": {"exposure": float(draw.uniform(4, 8))},
            "sequence": {"images": int(draw.integers(12, 80))},
            "defects": [_defect(draw, side) for _ in range(7)],
        }
    )  # fmt: skip


def _defect(draw: np.random.Generator, side: float) -> dict[str, object]:
    """A dent, a bump or a scratch, of slopes up to some 2 %."""
    size = float(np.exp(draw.uniform(math.log(0.3), math.log(1.2))))
    depth = float(np.exp(draw.uniform(math.log(1), math.log(10 * size))))
    x, y = draw.uniform(-0.4, 0.4, 2) * side
    kind = str(draw.choice(["dent", "bump", "scratch"]))
    if kind != "scratch":
        return {"kind": kind, "x_mm": x, "y_mm": y, "diameter_mm": size, "depth_um": depth}
    turn = draw.uniform(0, 2 * math.pi) + np.array([0.0, draw.uniform(-0.5, 0.5)])
    steps = size * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.array([x, y]) + np.cumsum([[0.0, 0.0], *steps], axis=0)
    return {"kind": kind, "points_mm": points.tolist(), "width_mm": size / 2, "depth_um": depth / 3}


# ------------------------------------------------------------------------------------ brute force


@numba.njit
def _surface(x, y, radius_x, radius_y, pieces):
    """Height and slopes of crown and grooves; the nearest piece of a groove counts."""
    z, zx, zy = 0.0, 0.0, 0.0
    if radius_x != 0:
        root = math.sqrt(radius_x * radius_x - x * x)
        z += math.copysign(root, radius_x) - radius_x
        zx -= math.copysign(x / root, radius_x * x)
    if radius_y != 0:
        root = math.sqrt(radius_y * radius_y - y * y)
        z += math.copysign(root, radius_y) - radius_y
        zy -= math.copysign(y / root, radius_y * y)
    i = 0
    while i < len(pieces):
        best, best_x, best_y = math.inf, 0.0, 0.0
        owner, sigma, depth = pieces[i, 4], pieces[i, 5], pieces[i, 6]
        while i < len(pieces) and pieces[i, 4] == owner:
            ax, ay = pieces[i, 0], pieces[i, 1]
            bx, by = pieces[i, 2] - ax, pieces[i, 3] - ay
            square = bx * bx + by * by
            share = ((x - ax) * bx + (y - ay) * by) / square if square > 0 else 0.0
            share = min(max(share, 0.0), 1.0)
            px, py = x - ax - share * bx, y - ay - share * by
            if px * px + py * py < best:
                best, best_x, best_y = px * px + py * py, px, py
            i += 1
        if best < 72 * sigma * sigma:  # 12 sigma
            groove = depth * math.exp(-best / (2 * sigma * sigma))
            z += groove
            zx -= groove * best_x / (sigma * sigma)
            zy -= groove * best_y / (sigma * sigma)
    return z, zx, zy


@numba.njit
def _path(y, z, ry, rz, section, height, half_width):
    """Path from (y, z) along (ry, rz) to the tunnel's ceiling (0), box (1) or arch (2)."""
    if section == 2:
        a, b, c = ry * ry + rz * rz, y * ry + z * rz, y * y + z * z - height * height
        return (math.sqrt(b * b - a * c) - b) / a
    top = (height - z) / rz
    if section == 1 and ry != 0:
        return min(top, (math.copysign(half_width, ry) - y) / ry)
    return top


@numba.njit(parallel=True)
def _follow(x, y, px, py, h, rises, radius_x, radius_y, pieces, section, height, half_width, light):
    """Light coordinate of the rays from pupil points through (x, y, 0); NaN where they go down."""
    for i in numba.prange(x.size):
        z = 0.0
        if rises:  # the ray from O through (x, y, 0) meets the surface: fixed-point iteration
            for _ in range(100):
                k = 1 - z / h
                before, z = z, _surface(x[i] * k, y[i] * k, radius_x, radius_y, pieces)[0]
                if abs(z - before) < 1e-12:
                    break
        sx, sy = x[i] * (1 - z / h), y[i] * (1 - z / h)
        _, zx, zy = _surface(sx, sy, radius_x, radius_y, pieces)
        ix, iy, iz = sx - px[i], sy - py[i], z - h
        twice = 2 * (iz - zx * ix - zy * iy) / (1 + zx * zx + zy * zy)
        rx, ry, rz = ix + twice * zx, iy + twice * zy, iz - twice
        light[i] = math.nan
        if rz > 0:
            light[i] = sx + rx * _path(sy, z, ry, rz, section, height, half_width)


def brute_force(scene: oracle.Scene) -> Callable[..., np.ndarray]:
    """What follows rays in float64, from points (x, y) on z = 0 and (u, v) of the lens, 0 to 1."""
    pieces = [
        (*a, *b, owner, groove.sigma_mm, groove.depth_mm)
        for owner, groove in enumerate(scene.grooves)
        for a, b in zip(groove.points, groove.points[1:] or groove.points, strict=False)
    ]

    def follow(x, y, u, v):
        light, radius = np.empty_like(x), scene.pupil_mm / 2 * np.sqrt(u)
        px, py = radius * np.cos(2 * np.pi * v), radius * np.sin(2 * np.pi * v)
        _follow(
            x, y, px, py, scene.camera_height_mm, scene.surface == "height",
            scene.crown_radius_x_mm or 0.0, scene.crown_radius_y_mm or 0.0,
            np.array(pieces).reshape(-1, 7), ["ceiling", "box", "arch"].index(scene.section),
            scene.tunnel_height_mm, (scene.tunnel_width_mm or 0.0) / 2, light,
        )  # fmt: skip
        return light

    return follow


# ---------------------------------------------------------------------------------------- Mitsuba


def mitsuba_scene(scene: oracle.Scene) -> Callable[..., np.ndarray] | None:
    """The same from Mitsuba's own thin lens, mesh, mirror and tunnel; None without it."""
    try:
        import mitsuba as mi

        mi.set_variant("llvm_ad_mono")
        import drjit as dr

        dr.eval(mi.Float([1.0]))
    except Exception as error:
        print(f"no Mitsuba ({error}): pip install mitsuba, and Debian's libllvm")
        return None
    h, side = scene.camera_height_mm, PIXELS * scene.sampling_mm
    number = MESH * PIXELS + 3
    u = (np.arange(number) - (number - 1) / 2) * scene.sampling_mm / MESH
    x, y = (a.ravel() for a in np.meshgrid(u, u))
    z = oracle.height(scene, x, y) if scene.surface == "height" else 0 * x
    zx, zy = oracle.slopes(scene, x, y)
    corner = (np.arange(number - 1)[:, None] * number + np.arange(number - 1)).ravel()
    faces = [
        (corner, corner + 1, corner + number + 1),
        (corner, corner + number + 1, corner + number),
    ]
    mirror = {"type": "conductor", "material": "none"}
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(mirror)
    mesh = mi.Mesh("part", number**2, 2 * len(corner), has_vertex_normals=True, props=properties)
    values = mi.traverse(mesh)
    values["vertex_positions"] = np.stack([x, y, z], 1).ravel().astype(np.float32)
    values["vertex_normals"] = (
        oracle.unit(np.stack([-zx, -zy, 1 + 0 * x], 1)).ravel().astype(np.float32)
    )
    values["faces"] = np.concatenate([np.stack(f, 1) for f in faces]).ravel().astype(np.uint32)
    values.update()
    T, H = mi.ScalarTransform4f, scene.tunnel_height_mm
    tunnel = {
        "type": "rectangle",
        "to_world": T().translate([0, 0, H]).rotate([1, 0, 0], 180).scale(1e3),
    }
    shapes = {"part": mesh, "tunnel": tunnel}
    if scene.section == "arch":
        shapes["tunnel"] = {"type": "cylinder", "p0": [-1e3, 0, 0], "p1": [1e3, 0, 0], "radius": H}
    if scene.section == "box":
        for name, sign in (("left", -1), ("right", 1)):
            at = T().translate([0, sign * scene.tunnel_width_mm / 2, 0])
            shapes[name] = {"type": "rectangle", "to_world": at.rotate([1, 0, 0], 90).scale(1e3)}
    lens = {"type": "thinlens", "aperture_radius": scene.pupil_mm / 2, "focus_distance": h}
    camera = mi.load_dict({
        **(lens if scene.pupil_mm > 0 else {"type": "perspective"}),
        "fov": math.degrees(2 * math.atan(side / 2 / h)), "near_clip": h / 2, "far_clip": 1e5,
        "to_world": T().look_at(origin=[0, 0, h], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": PIXELS, "height": PIXELS, "pixel_format": "luminance"},
    })  # fmt: skip
    world = mi.load_dict({"type": "scene", **shapes})
    only_part = mi.load_dict({"type": "scene", "part": mesh})

    def follow(x, y, u, v):
        film = mi.Point2f((0.5 + x / side).astype(np.float32), (0.5 - y / side).astype(np.float32))
        lens = mi.Point2f(u.astype(np.float32), v.astype(np.float32))
        ray, _ = camera.sample_ray(0.0, 0.5, film, lens)
        met = only_part.ray_intersect(ray)  # the tunnel is transparent to the camera
        sample, _ = met.bsdf().sample(mi.BSDFContext(), met, 0.5, lens)
        light = world.ray_intersect(met.spawn_ray(met.to_world(sample.wo)))
        return np.array(dr.select(met.is_valid() & light.is_valid(), light.p.x, dr.nan), np.float64)

    return follow


# ----------------------------------------------------------------------------------------- images


@numba.njit(parallel=True)
def _aspect(light, step, luminous, images, exposure, aspect):
    """Mean of all images, each exposed and saturated, of each pixel's rays."""
    for i in numba.prange(len(light)):
        seen = np.zeros(images + 1)  # of how many rays an image is luminous: its differences
        for ray in light[i]:
            if math.isnan(ray):
                continue
            u = ray / step
            u -= images * math.floor(u / images)
            last = min(math.floor(u), images - 1)
            first = math.floor(u - luminous / step) + 1
            if first < 0:  # it began in the period before
                seen[first + images] += 1
                seen[images] -= 1
                first = 0
            seen[first] += 1
            seen[last + 1] -= 1
        total, now = 0.0, 0.0
        for k in range(images):
            now += seen[k]
            total += min(exposure * now / light.shape[1], 1.0)
        aspect[i] = total / images


def aspect_image(scene: oracle.Scene, follow: Callable[..., np.ndarray], rays: int, seed: int):
    """Aspect image by a path tracer: every pixel has the same even points, shifted at random."""
    centre_x, centre_y = (c.ravel() for c in oracle.pixel_centres(scene))
    points = oracle.even_points(rays, 4 if scene.pupil_mm > 0 else 2)
    shifts = np.random.default_rng([seed, 1]).random((centre_x.size, 1, points.shape[1]))
    aspect = np.empty(centre_x.size)
    step = scene.period_mm / scene.images
    for first in range(0, centre_x.size, max(CHUNK // rays, 1)):
        some = slice(first, first + max(CHUNK // rays, 1))
        uniform = np.mod(points + shifts[some], 1.0)
        x = centre_x[some, None] + (uniform[..., 0] - 0.5) * scene.sampling_mm
        y = centre_y[some, None] + (uniform[..., 1] - 0.5) * scene.sampling_mm
        u, v = uniform[..., -2], uniform[..., -1]
        light = follow(x.ravel(), y.ravel(), u.ravel(), v.ravel()).reshape(x.shape)
        _aspect(light, step, scene.luminous_mm, scene.images, scene.exposure, aspect[some])
    return scene.full_scale * aspect.reshape(scene.rows, scene.columns)


def twice(scene, follow, rays: int, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean of two aspect images of other random rays, half their difference, and the seconds."""
    start = time.perf_counter()
    one, two = (aspect_image(scene, follow, rays, 2 * seed + i) for i in range(2))
    return (one + two) / 2, (one - two) / 2, time.perf_counter() - start


def judged(
    seed: int, backend: Backend, pupil_mm: float, rays: int, mitsuba_rays: Sequence[int]
) -> Iterator[tuple[str, np.ndarray, float]]:
    """Every image of a scene with its error, after the noise of the reference: name, error, s."""
    station = hold_out(seed, pupil_mm)
    scene = oracle_scene(station)
    print(
        f"{seed:5} {scene.section}, {scene.surface}, period {scene.period_mm:.1f} mm, "
        f"{scene.images} images, exposure {scene.exposure:.1f}, "
        f"{'crowned' if scene.crown_radius_x_mm else 'flat'}, "
        f"{1e3 * scene.sampling_mm:.0f} um per pixel"
    )
    truth, noise, seconds = twice(scene, brute_force(scene), rays, seed)
    yield f"brute force, 2 x {rays} rays: its own noise", noise, seconds
    follow = mitsuba_scene(scene) if mitsuba_rays else None
    for fewer in mitsuba_rays if follow is not None else ():
        image, noise, seconds = twice(scene, follow, fewer, seed)
        yield f"Mitsuba, 2 x {fewer} rays", image - truth, seconds
        yield f"Mitsuba, 2 x {fewer} rays: its own noise", noise, seconds
    for value in SUBSAMPLINGS:
        design = station.replace(camera__subsampling=value)
        seconds = best(lambda s=design: backend.trace(s).aspect())
        yield f"gpuspec, subsampling {value}", backend.trace(design).aspect() - truth, seconds


def print_row(name: str, seconds: float, rms: float, worst: float) -> None:
    print(f"{'':6}{name:44}{seconds:9.3f}{rms:8.3f}{worst:8.2f}", flush=True)


def main() -> None:
    """Measure and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seed", type=int, default=1, help="of the first scene")
    options.add_argument("--scenes", type=int, default=6)
    options.add_argument("--pupil", type=float, default=0.0, help="diameter in mm; 0: pinhole")
    options.add_argument("--rays", type=int, default=1024, help="per pixel, of either image of two")
    options.add_argument("--mitsuba-rays", type=int, nargs="*", default=[16, 1024], help="likewise")
    options.add_argument("--backend", default="opencl")
    given = options.parse_args()
    backend = open_backend(given.backend)
    print(f"{backend.info}; pupil {given.pupil:g} mm, {PIXELS} x {PIXELS} pixels\n")
    print(f"{'seed':>5} {'errors in grey levels of 255':45}{'seconds':>8}{'rms':>8}{'max':>8}")
    every: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(given.seed, given.seed + given.scenes):
        for name, error, seconds in judged(
            seed, backend, given.pupil, given.rays, given.mitsuba_rays
        ):
            found = (seconds, np.sqrt((error**2).mean()), np.abs(error).max())
            print_row(name, *found)
            every.setdefault(name, []).append(found)
    print(f"  all: mean seconds, rms over {given.scenes} scenes, largest")
    for name, rows in every.items():
        seconds, rms, worst = np.array(rows).T
        print_row(name, seconds.mean(), np.sqrt((rms**2).mean()), worst.max())


if __name__ == "__main__":
    main()
