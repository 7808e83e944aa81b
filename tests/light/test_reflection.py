"""Device functions of `kernels/reflection.h`, one by one, each a law."""

from __future__ import annotations

import numpy as np
import tolerances
from device import LANES, Device
from laws import (
    FIELDS,
    GROUPS,
    RAY,
    REFLECTION,
    Array,
    Draws,
    close,
    components,
    dot,
    holds,
    named,
    rounded,
    sagitta,
    shared,
    stacked,
    struct,
)

from gpuspec.station.materials import MATERIALS

SET_SURFACE = "Surface s; " + " ".join(f"s.{field} = {field};" for field in FIELDS)


@holds("vector", wrong=("v.z = z;", "v.z = y;"))
@holds("inner", wrong=("a.y * b.y + a.z * b.z", "a.y * b.y - a.z * b.z"))
@holds("along", wrong=("a.y + k * b.y", "a.y - k * b.y"))
@holds("scaled", wrong=("vector(k * a.x, k * a.y, k * a.z)", "vector(k * a.x, k * a.y, a.z)"))
def test_vectors_add_scale_and_project(device: Device) -> None:
    d = Draws(9)
    a, b, k = d.vectors(), d.vectors(), d.pixel(-3, 3)
    code = """Vector a = vector(ax, ay, az), b = vector(bx, by, bz);
        Vector sum = along(a, k, b), times = scaled(k, a); REAL product = inner(a, b);"""
    inputs = {**named("a", a), **named("b", b), "REAL k": k}
    outputs = (*components("sum"), *components("times"), "product")
    got = stacked(device.call(REFLECTION, code, inputs, outputs))
    close(got[:3], a + k * b, tolerances.VECTOR)
    close(got[3:6], k * a, tolerances.VECTOR)
    close(got[6], dot(a, b), tolerances.VECTOR)


@holds(
    "surface_normal",
    wrong=("vector(-s.slope_x, -s.slope_y, 1.0f)", "vector(s.slope_x, s.slope_y, 1.0f)"),
)
def test_the_normal_is_perpendicular_to_the_surface_and_points_up(device: Device) -> None:
    d = Draws(11)
    zx, zy = d.pixel(-1, 1), d.pixel(-1, 1)
    code = (
        "Surface s = flat_surface(); s.slope_x = zx; s.slope_y = zy; Vector n = surface_normal(s);"
    )
    n = stacked(device.call(REFLECTION, code, {"REAL zx": zx, "REAL zy": zy}, components("n")))
    close(n[0] + zx * n[2], 0 * zx, tolerances.VECTOR)
    close(n[1] + zy * n[2], 0 * zx, tolerances.VECTOR)
    assert (n[2] == 1).all()


@holds("newton_height", wrong=("(z - s.height) / (1.0f + ", "(z - s.height) / (1.0f - "))
def test_one_newton_step_meets_a_plane_and_a_few_a_crown(device: Device) -> None:
    d = Draws(14)
    x0, y0, guess = d.pixel(-100, 100), d.pixel(-25, 25), d.pixel(-5, 5)
    level, zx, zy = d.pixel(-5, 5), d.pixel(-0.5, 0.5), d.pixel(-0.5, 0.5)
    h = d.shared(300, 2000)
    k = 1 - guess / h
    height = rounded(level + zx * x0 * k + zy * y0 * k)
    inputs = {
        "REAL x0": x0, "REAL y0": y0, "REAL guess": guess, "REAL height": height,
        "REAL zx": zx, "REAL zy": zy, **shared(h=h),
    }  # fmt: skip
    code = """Surface s = flat_surface(); s.height = height; s.slope_x = zx; s.slope_y = zy;
        REAL z = newton_height(guess, s, x0, y0, h);"""
    (z,) = device.call(REFLECTION, code, inputs, ("z",))
    k = 1 - z.astype(float) / h
    plane = height + zx * x0 * (k - (1 - guess / h)) + zy * y0 * (k - (1 - guess / h))
    close(z, plane, tolerances.HEIGHT_MM)
    cx, cy = rounded(1 / d.shared(150, 1000)), rounded(-1 / d.shared(40, 1000))
    inputs = {"REAL x0": x0, "REAL y0": y0, **shared(h=h, cx=cx, cy=cy)}
    code = """REAL z = 0.0f * x0;
        for (int i = 0; i < 3; i++) {
            Surface s = crown(x0 * (1.0f - z / h), y0 * (1.0f - z / h), cx, cy);
            z = newton_height(z, s, x0, y0, h);
        }"""
    (z,) = device.call(REFLECTION, code, inputs, ("z",))
    k = 1 - z.astype(float) / h
    close(z, sagitta(x0 * k, cx) + sagitta(y0 * k, cy), tolerances.HEIGHT_MM)


class Hill:
    """A smooth surface of which all derivatives are known: the part of `sight`'s test."""

    def __init__(self, d: Draws) -> None:
        self.slope = d.shared(-0.05, 0.05), d.shared(-0.05, 0.05)
        self.bend = tuple(d.shared(-2e-3, 2e-3) for _ in range(3))
        self.cubic = d.shared(-2e-5, 2e-5)

    def fields(self, x: Array, y: Array) -> list[Array]:
        (a, b), (xx, xy, yy), c = self.slope, self.bend, self.cubic
        return [
            a * x + b * y + xx * x * x / 2 + xy * x * y + yy * y * y / 2 + c * x**3 / 6,
            a + xx * x + xy * y + c * x * x / 2,
            b + xy * x + yy * y,
            xx + c * x,
            xy + 0 * x,
            yy + 0 * x,
        ]

    def meet(self, x0: Array, y0: Array, h: Array) -> Array:
        """Height at which the camera ray of (x0, y0, 0) meets the surface, by bisection."""
        low, high = np.full(x0.shape, -30.0), np.full(x0.shape, 30.0)
        for _ in range(60):
            z = (low + high) / 2
            above = z > self.fields(x0 * (1 - z / h), y0 * (1 - z / h))[0]
            low, high = np.where(above, low, z), np.where(above, z, high)
        return (low + high) / 2


def rays_up(d: Draws) -> tuple[Array, Array]:
    """Points on the part and rays that go up, the first ones vertical, along x, and grazing."""
    origin = np.stack([d.pixel(-100, 100), d.pixel(-25, 25), d.pixel(-3, 3)])
    ray = d.units()
    ray[2] = np.abs(ray[2])
    ray[:, 0] = np.array([0, 0, 1])[:, None]
    ray[:, 1] = rounded(np.array([0.6, 0, 0.8])[:, None])
    ray[:, 2] = rounded(np.array([1, 0, 1e-3])[:, None])
    ray[:, 3] = rounded(np.array([0, -1, 1e-4])[:, None])
    return origin, ray


HIT = ("hit.path", *components("hit.normal"))


def hits(device: Device, code: str, origin: Array, ray: Array, **sizes: Array) -> tuple[Array, ...]:
    """Path, normal, point, and the rounding to expect of the point."""
    inputs = {**named("o", origin), **named("r", ray), **shared(**sizes)}
    path, *normal = stacked(device.call(REFLECTION, RAY + code, inputs, HIT))
    scale = path + np.abs(origin).max(axis=0) + max(np.max(size) for size in sizes.values())
    return path, np.stack(normal), origin + path * ray, tolerances.HIT * scale


@holds("hit_ceiling", wrong=("(height - origin.z) / max", "(height + origin.z) / max"))
def test_rays_meet_the_ceiling_at_its_height(device: Device) -> None:
    d = Draws(16)
    origin, ray = rays_up(d)
    height = d.shared(50, 500)
    _, normal, point, limit = hits(
        device, "Hit hit = hit_ceiling(o, r, height);", origin, ray, height=height
    )
    close(point[2], np.broadcast_to(height, point[2].shape), limit)
    assert (normal == np.array([0, 0, 1])[:, None, None]).all()


@holds("hit_box", wrong=("first ? side : hit.normal.y", "first ? -side : hit.normal.y"))
def test_rays_meet_the_box_where_they_first_leave_it(device: Device) -> None:
    d = Draws(17)
    origin, ray = rays_up(d)
    height, width = d.shared(50, 500), d.shared(30, 200)
    # Rays to the very corner, where wall and ceiling tie, all numbers exact.
    origin[:, 4] = 0
    height[4], width[4] = 64, 64
    ray[:, 4] = np.array([0, 0.5, 0.5])[:, None]
    ray[1, 4, ::2] *= -1
    code = "Hit hit = hit_box(o, r, height, half_width);"
    path, normal, point, limit = hits(device, code, origin, ray, height=height, half_width=width)
    assert (path > 0).all()
    assert (point[2] <= height + limit).all()
    assert (np.abs(point[1]) <= width + limit).all()
    wall = normal[2] == 0
    close(np.where(wall, np.abs(point[1]), point[2]), np.where(wall, width, height), limit)
    np.testing.assert_array_equal(normal[1], np.where(wall, np.sign(ray[1]), 0))
    np.testing.assert_array_equal(normal[2], np.where(wall, 0, 1))
    assert not normal[0].any()
    assert 0.1 < wall.mean() < 0.9
    assert (path[4] == 128).all()
    # Straight up along a wall the ceiling is met, not the wall.
    assert not wall[0].any()


@holds("hit_arch", wrong=("0.0f)) - b) / a", "0.0f)) + b) / a"))
def test_rays_meet_the_arch_on_its_circle(device: Device) -> None:
    d = Draws(18)
    origin, ray = rays_up(d)
    radius = d.shared(60, 500)
    code = "Hit hit = hit_arch(o, r, radius);"
    path, normal, point, limit = hits(device, code, origin, ray, radius=radius)
    assert (path > 0).all()
    # Where a ray runs along the axis, its path is long and its place on the circle uncertain.
    close(np.hypot(point[1], point[2]), np.broadcast_to(radius, path.shape), limit)
    close(normal * radius, np.stack([0 * path, point[1], point[2]]), limit)


@holds("hit_tunnel", wrong=("g.section == SECTION_BOX", "g.section == 3.0f"))
def test_the_tunnel_is_met_in_its_own_section(device: Device) -> None:
    d = Draws(19)
    origin, ray = rays_up(d)
    section = (np.arange(d.groups) % 3)[:, None]
    sizes = d.shared(50, 500), d.shared(30, 200), d.shared(200, 900)
    tunnel = {
        "section": section, "tunnel_top": sizes[0], "tunnel_half_width": sizes[1],
        "tunnel_half_length": sizes[2],
    }  # fmt: skip
    g = struct("Geometry", d.groups, **tunnel)
    inputs = {**named("o", origin), **named("r", ray), "Geometry g": g}
    code = (
        RAY
        + """Hit hit = hit_tunnel(o, r, g), c = hit_ceiling(o, r, g.tunnel_top),
        b = hit_box(o, r, g.tunnel_top, g.tunnel_half_width), a = hit_arch(o, r, g.tunnel_top);"""
    )
    outputs = [name.replace("hit", hit, 1) for hit in ("hit", "c", "b", "a") for name in HIT]
    got = stacked(device.call(REFLECTION, code, inputs, outputs)).reshape(4, 4, *ray.shape[1:])
    np.testing.assert_array_equal(got[0], np.choose(section, got[1:]))


def reflectance(cosine: Array, n: Array, k: Array) -> Array:
    """Reflectance of unpolarised light from Fresnel's complex amplitudes, Snell's law with them."""
    index = n - 1j * k
    sine = np.sqrt(1 - cosine**2) / index
    inside = np.sqrt(1 - sine**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    result: Array = (np.abs(s) ** 2 + np.abs(p) ** 2) / 2
    return result


@holds("fresnel_reflectance", wrong=("c2 * modulus + s2 * s2", "c2 * modulus + s2"))
def test_reflectance_is_that_of_fresnels_complex_amplitudes(device: Device) -> None:
    d = Draws(20)
    cosine, n, k = d.pixel(0, 1), d.shared(0.05, 4), d.shared(0, 7)
    cosine[:, 0], cosine[:, 1], cosine[:, 2] = 0, 1, rounded(1e-3)
    metals = [material for material in MATERIALS.values() if material != MATERIALS["ideal"]]
    for group, (index, extinction) in enumerate(metals):
        n[group], k[group] = rounded(index), rounded(extinction)
    k[10:60], n[10:60] = 0, d.shared(1.2, 4)[10:60]
    inputs = {"REAL cosine": cosine, **shared(n=n, k=k)}
    (got,) = device.call(REFLECTION, "REAL r = fresnel_reflectance(cosine, n, k);", inputs, ("r",))
    close(got, reflectance(cosine, n, k), tolerances.REFLECTANCE)
    close(got[:, 0], np.ones(d.groups), tolerances.REFLECTANCE)


class Scene:
    """What `sight` is called with, and the same rays followed in float64 without its formulas."""

    def __init__(self, seed: int) -> None:
        d = Draws(seed, 3 * GROUPS)
        self.hill = Hill(d)
        n = d.groups
        section = (np.arange(n) % 3)[:, None]
        self.section = section
        self.x0, self.y0 = d.pixel(-60, 60), d.pixel(-20, 20)
        self.x0[:3], self.y0[:3] = 0, 0
        self.h = d.shared(500, 1500)
        self.rises = (np.arange(n) // 3 % 2)[:, None].astype(float)
        self.top, self.width = d.shared(80, 200), d.shared(35, 60)
        self.length = d.shared(60, 400)
        self.pupil = np.where(d.shared(0, 1) < 0.3, 0, d.shared(0, 10))
        self.rough = np.where(d.shared(0, 1) < 0.5, 0, d.shared(0, 0.02))
        self.sampling = d.scales(0.005, 0.2, True)
        self.sub = np.floor(d.shared(1, 5))
        self.part = d.shared(40, 60), d.shared(12, 20)
        self.opening = d.shared(5, 30), d.shared(5, 30)
        closed = d.shared(0, 1) < 0.5
        self.opening = tuple(np.where(closed, 0, size) for size in self.opening)
        self.cos4 = (d.shared(0, 1) < 0.5).astype(float)
        materials = np.array(list(MATERIALS.values()))
        self.n, self.k = rounded(materials[np.arange(n) % len(materials)]).T[..., None]
        # Some parts so steep that rays go down.
        self.hill.slope[0][9:60] = rounded(d.shared(0.7, 1.1)[9:60])
        # The first parts flat and seen from straight above, their rays vertical.
        for field in (*self.hill.slope, *self.hill.bend, self.hill.cubic):
            field[:3] = 0
        # The camera's opening above the origin, not above what is tilted.
        self.opening[0][:3] = self.opening[1][:3] = 0
        self.z = rounded(self.rises * self.hill.meet(self.x0, self.y0, self.h))

    def inputs(self) -> dict[str, Array]:
        k = 1 - self.z / self.h
        fields = self.hill.fields(self.x0 * k, self.y0 * k)
        g = struct(
            "Geometry",
            len(self.h),
            camera_height=self.h,
            pupil=self.pupil,
            sampling=self.sampling,
            subsampling=self.sub,
            rises=self.rises,
            vignetting=self.cos4,
            half_length=self.part[0],
            half_width=self.part[1],
            section=self.section,
            tunnel_top=self.top,
            tunnel_half_width=self.width,
            tunnel_half_length=self.length,
            opening_half_length=self.opening[0],
            opening_half_width=self.opening[1],
            roughness=self.rough,
            refractive_index=self.n,
            extinction=self.k,
        )
        return {
            "REAL x0": self.x0, "REAL y0": self.y0, "REAL z": self.z,
            **{f"REAL {name}": v for name, v in zip(FIELDS, fields, strict=True)},
            "Geometry g": g,
        }  # fmt: skip

    def follow(self, x0: Array, y0: Array) -> dict[str, Array]:
        """Follow the camera rays of (x0, y0, 0); meet the tunnel by bisection."""
        z = self.rises * self.hill.meet(x0, y0, self.h)
        k = 1 - z / self.h
        point = np.stack([x0 * k, y0 * k, z])
        _, zx, zy, *_ = self.hill.fields(point[0], point[1])
        incident = point - np.stack([0 * z, 0 * z, 0 * z + self.h])
        distance = np.sqrt(dot(incident, incident))
        incident = incident / distance
        normal = np.stack([-zx, -zy, np.ones_like(z)])
        normal = normal / np.sqrt(dot(normal, normal))
        ray = incident - 2 * dot(incident, normal) * normal
        low, high = np.zeros_like(z), np.full(z.shape, 1e6)
        for _ in range(80):
            path = (low + high) / 2
            y, top = point[1] + path * ray[1], point[2] + path * ray[2]
            outside = np.where(self.section == 2, np.hypot(y, top) > self.top, top > self.top)
            outside |= (self.section == 1) & (np.abs(y) > self.width)
            low, high = np.where(outside, low, path), np.where(outside, path, high)
        light = point + path * ray
        wall = (self.section == 1) & (np.abs(light[1]) > self.width - 1e-6)
        return {
            "point": point, "ray": ray, "path": path, "light": light, "distance": distance,
            "wall": wall, "cosine": -dot(incident, normal),
        }  # fmt: skip


WAY = (
    SET_SURFACE
    + """CameraRay c = camera_ray(x0, y0, z, g.camera_height);
    Mirror m = mirror_of(c, s); Hit hit = hit_tunnel(c.point, m.ray, g);
    Vector met = along(c.point, hit.path, m.ray);"""
)


@holds("camera_ray", wrong=("vector(x0 * c.share, y0", "vector(x0, y0"))
def test_a_camera_ray_leads_from_the_pinhole_through_its_pixel(device: Device) -> None:
    scene = Scene(46)
    code = "CameraRay c = camera_ray(x0, y0, z, g.camera_height);" + SET_SURFACE
    outputs = (*components("c.point"), *components("c.direction"), "c.share")
    got = stacked(device.call(REFLECTION, code, scene.inputs(), outputs))
    point, direction, share = got[:3], got[3:6], got[6]
    pinhole = np.stack([0 * scene.x0, 0 * scene.x0, scene.h + 0 * scene.x0])
    pixel = np.stack([scene.x0, scene.y0, 0 * scene.x0])
    seen = np.cross(pixel - pinhole, point - pinhole, axis=0) / scene.h**2
    close(seen, 0 * seen, tolerances.VECTOR)
    np.testing.assert_array_equal(point[2], scene.z)
    close(direction * share * scene.h, point - pinhole, tolerances.VECTOR * scene.h)
    close(direction[2], -np.ones_like(share), tolerances.VECTOR)


@holds("mirror_of", wrong=("-m.twice, m.normal", "-m.facing, m.normal"))
def test_the_angle_out_is_the_angle_in_and_the_three_are_coplanar(device: Device) -> None:
    scene = Scene(47)
    outputs = (
        *components("c.direction"), *components("m.normal"), *components("m.ray"), "m.facing",
        "m.inverse_square",
    )  # fmt: skip
    code = (
        SET_SURFACE
        + """CameraRay c = camera_ray(x0, y0, z, g.camera_height);
        Mirror m = mirror_of(c, s);"""
    )
    got = stacked(device.call(REFLECTION, code, scene.inputs(), outputs))
    incident, normal, ray, facing, inverse_square = got[:3], got[3:6], got[6:9], got[9], got[10]
    k = 1 - scene.z / scene.h
    _, zx, zy, *_ = scene.hill.fields(scene.x0 * k, scene.y0 * k)
    close(normal[0] + zx * normal[2], 0 * zx, tolerances.VECTOR)
    close(normal[1] + zy * normal[2], 0 * zy, tolerances.VECTOR)
    close(inverse_square * dot(normal, normal), np.ones_like(zx), tolerances.VECTOR)
    close(facing, dot(incident, normal), tolerances.VECTOR)
    # The angle out is the angle in; the ray keeps its length, and what lies in the surface.
    close(dot(ray, normal), -dot(incident, normal), tolerances.VECTOR)
    close(np.sqrt(dot(ray, ray)), np.sqrt(dot(incident, incident)), tolerances.VECTOR)
    close(np.cross(normal, ray, axis=0), np.cross(normal, incident, axis=0), tolerances.VECTOR)
    close(dot(incident, np.cross(normal, ray, axis=0)), 0 * zx, tolerances.VECTOR)


@holds("light_gradient", wrong=("turn * m.normal.x", "turn * m.ray.x"))
def test_the_gradient_of_the_light_coordinate_is_its_derivative(device: Device) -> None:
    scene = Scene(48)
    d = Draws(49, len(scene.h))
    dx, dy = d.shared(-1, 1), d.shared(-1, 1)
    code = (
        WAY
        + """Gradient slope = light_gradient(g, s, c, m, hit);
        REAL dl = slope.x * dx + slope.y * dy;
        REAL lost = loss_of(g, c, m, hit, met, 0.0f * x0);"""
    )
    inputs = {**scene.inputs(), **shared(dx=dx, dy=dy)}
    got, lost = device.call(REFLECTION, code, inputs, ("dl", "lost"))
    e = 1e-3
    ahead, behind = (scene.follow(scene.x0 + i * dx, scene.y0 + i * dy) for i in (e, -e))
    paths = scene.follow(scene.x0, scene.y0)
    change = (ahead["light"][0] - behind["light"][0]) / (2 * e)
    bend = ahead["light"][0] - 2 * paths["light"][0] + behind["light"][0]
    # Where wall and ceiling meet the light coordinate has a crease.
    smooth = (lost == 0) & (np.abs(bend) < 1e-4) & (np.abs(scene.z) < 29)  # met, by bisection
    assert smooth.sum() > 0.98 * (lost == 0).sum() > 1000
    # It grows with the path and with the ray's obliquity, and its error with it.
    limit = tolerances.FOOTPRINT * (np.abs(change) + 1) * (1 + 0.01 / paths["ray"][2] ** 2)
    close(got[smooth], change[smooth], limit[smooth])


@holds("loss_of_both", wrong=("LOST_NOT : max(a, b)", "LOST_NOT : min(a, b)"))
def test_a_pixel_is_seen_if_any_sub_ray_is_else_lost_for_the_largest_reason(device: Device) -> None:
    a, b, c = (rounded(v) for v in np.indices((5, 5, 5)).reshape(3, -1))
    pad = -len(a) % LANES
    a, b, c = (np.pad(v, (0, pad)).reshape(-1, LANES) for v in (a, b, c))
    code = "REAL r = loss_of_both(loss_of_both(loss_of_both(LOST_BESIDE + 0.0f * a, a), b), c);"
    inputs = {"REAL a": a, "REAL b": b, "REAL c": c}
    (got,) = device.call(REFLECTION, code, inputs, ("r",))
    rays = np.stack([a, b, c])
    np.testing.assert_array_equal(got, np.where((rays == 0).any(axis=0), 0, rays.max(axis=0)))


def cumulants(places: Array, weights: Array) -> Array:
    """Variance and fourth cumulant of a distribution about 0."""
    weights = weights / weights.sum()
    variance = weights @ places**2
    return np.array([variance, weights @ places**4 - 3 * variance**2])


@holds("two_boxes", wrong=("+ u * u / 6.0f + v * v;", "+ u * u / 2.0f + v * v;"))
def test_two_boxes_have_the_variance_and_fourth_cumulant_of_pixel_pupil_and_roughness(
    device: Device,
) -> None:
    d = Draws(50)
    across, down, radius, spread = (d.scales(1e-3, 3) for _ in range(4))
    across[::3], down[::4], radius[::2], spread[1::2] = 0, 0, 0, 0
    inputs = {"REAL p": rounded(across**2), "REAL q": rounded(down**2),
              "REAL u": rounded(3 * radius**2), "REAL v": rounded(12 * spread**2)}  # fmt: skip
    code = "Footprint w = two_boxes(p, q, u, v);"
    wide, narrow = stacked(device.call(REFLECTION, code, inputs, ("w.wide", "w.narrow")))
    assert (wide >= narrow).all()
    # Of a width of 1, a radius of 1, a standard deviation of 1, by quadrature.
    x, weights = np.polynomial.legendre.leggauss(8)
    box = cumulants(x / 2, weights)
    angle = np.arange(1, 20) * np.pi / 20
    disc = cumulants(np.cos(angle), np.sin(angle) ** 2)
    bell = cumulants(*np.polynomial.hermite_e.hermegauss(8))
    sizes = ((across, box), (down, box), (radius, disc), (spread, bell))
    variance, fourth = (
        sum(size ** (2 + 2 * i) * kernel[i] for size, kernel in sizes) for i in (0, 1)
    )
    seen = variance > 1e-8
    got, expected = ((wide**2 + narrow**2) * box[0])[seen], variance[seen]
    close(got, expected, rtol=tolerances.TWO_BOXES)
    # Two boxes of one width are as much like a bell as two boxes can be.
    most_like_a_bell = 2 * (variance / 2 / box[0]) ** 2 * box[1]
    fourth = np.minimum(fourth, most_like_a_bell)[seen]
    close((wide**4 + narrow**4)[seen] * box[1], fourth, rtol=tolerances.TWO_BOXES)
    # The narrow one, however narrow: from the square of both widths.
    product = (
        np.maximum(
            (variance / box[0]) ** 2
            - np.minimum((sum(size**4 * kernel[1] for size, kernel in sizes)), most_like_a_bell)
            / box[1],
            0,
        )[seen]
        / 2
    )
    close((wide * narrow)[seen] ** 2, product, tolerances.TWO_BOXES * 1e-3 * variance[seen] ** 2,
          rtol=tolerances.TWO_BOXES)  # fmt: skip


@holds("loss_of", wrong=("m.ray.z <= 0.0f ? LOST_DOWN", "m.ray.z <= -2.0f ? LOST_DOWN"))
@holds(
    "footprint_of",
    wrong=(
        "(g, light_gradient(g, s, c, m, hit), c,",
        "(g, light_gradient(g, flat_surface(), c, m, hit), c,",
    ),
)
@holds("irradiance_of", wrong=("1.0f / (square * square)", "1.0f / square"))
def test_loss_footprint_and_irradiance_are_those_of_the_ray_s_path(device: Device) -> None:
    scene = Scene(21)
    code = (
        WAY
        + """REAL lost = loss_of(g, c, m, hit, met, 0.0f * x0);
        Footprint w = footprint_of(g, s, c, m, hit); REAL e = irradiance_of(g, c, m);"""
    )
    outputs = ("met.x", "w.wide", "w.narrow", "e", "lost")
    light, wide, narrow, irradiance, lost = stacked(
        device.call(REFLECTION, code, scene.inputs(), outputs)
    )
    lit = lost == 0
    widths = np.where(lit, wide, 1), np.where(lit, narrow, 0)
    check_sight(scene, light * lit, *widths, np.where(lit, irradiance, 0), lost)


@holds("sight", wrong=("sight_from(g, s, x0, y0, z, 0.0f", "sight_from(g, s, y0, y0, z, 0.0f"))
@holds(
    "sight_from", wrong=("v.narrow = (lit ? footprint.narrow", "v.narrow = (lit ? footprint.wide")
)
def test_a_ray_sees_the_light_it_meets_over_the_footprint_that_differences_give(
    device: Device,
) -> None:
    scene = Scene(21)
    outputs = ("v.light", "v.wide", "v.narrow", "v.irradiance", "v.lost")
    for call in ("sight(g, s, x0, y0, z,", "sight_from(g, s, x0, y0, z, 0.0f, 0.0f,"):
        code = f"{SET_SURFACE} Sight v = {call} 0.0f * x0);"
        check_sight(scene, *stacked(device.call(REFLECTION, code, scene.inputs(), outputs)))


def check_sight(
    scene: Scene, light: Array, wide: Array, narrow: Array, irradiance: Array, lost: Array
) -> None:
    """Hold what rays see against the same rays followed without the functions' formulas."""
    paths = scene.follow(scene.x0, scene.y0)
    point, ray, met = paths["point"], paths["ray"], paths["light"]

    expected = np.zeros(lost.shape)
    half_length, half_width = scene.opening
    open_ = (half_length > 0) & ~paths["wall"]
    expected[open_ & (np.abs(met[0]) <= half_length) & (np.abs(met[1]) <= half_width)] = 4
    expected[np.abs(met[0]) > scene.length] = 3
    expected[ray[2] <= 0] = 2
    expected[(np.abs(point[0]) > scene.part[0]) | (np.abs(point[1]) > scene.part[1])] = 1
    # Within this of a border either side is right.
    margin = tolerances.SIGHT_MM
    edges = [
        (np.abs(met[0]), scene.length), (np.abs(met[0]), half_length),
        (np.abs(met[1]), half_width), (np.abs(point[0]), scene.part[0]),
        (np.abs(point[1]), scene.part[1]),
    ]  # fmt: skip
    clear = np.abs(ray[2]) > 1e-5
    for place, border in edges:
        clear &= np.abs(place - border) > margin
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(lost[clear], expected[clear])
    assert {0, 1, 2, 3, 4} == set(np.unique(lost[clear]))

    seen = lost == 0
    assert seen.mean() > 0.3
    for value, blind in ((light, 0), (wide, 1), (narrow, 0), (irradiance, 0)):
        assert (value[~seen] == blind).all()

    # Where the ray hardly rises, path and light grow beyond all bounds, and their error with them.
    reach = 1 / np.maximum(ray[2], 1e-9) ** 2
    close(light[seen], met[0][seen], (tolerances.SIGHT_MM * np.maximum(reach, 1))[seen])

    p = scene.sampling / scene.sub
    e = 1e-3
    square, fourth = np.zeros((2, *light.shape))
    smooth = seen.copy()
    for dx, dy in ((e, 0.0), (0.0, e)):
        ahead = scene.follow(scene.x0 + dx, scene.y0 + dy)
        behind = scene.follow(scene.x0 - dx, scene.y0 - dy)
        smooth &= ahead["wall"] == behind["wall"]
        change = (ahead["light"][0] - behind["light"][0]) / (2 * e) * p
        square += change**2
        fourth += change**4
    # Variance and fourth cumulant of a box are w^2/12 and -w^4/120; of a disc seen edge-on, r^2/4
    # and -r^4/16; of a tilt of 2 alpha rms the fourth is none.
    radius = scene.pupil / 2 * paths["path"] / paths["distance"]
    square += 12 * radius**2 / 4 + 12 * (2 * scene.rough * paths["path"]) ** 2
    fourth += 120 * radius**4 / 16
    assert smooth.sum() > 0.99 * seen.sum()
    steep = 1 + 0.01 * reach
    limit = (2 * tolerances.FOOTPRINT * steep)[smooth]
    square, product = np.maximum(square, 1e-8), np.maximum((square**2 - fourth) / 2, 0)
    close(((wide**2 + narrow**2) / square)[smooth], np.ones(smooth.sum()), limit)
    share = np.minimum(np.sqrt(product) / square, 0.5)
    close((wide * narrow / square)[smooth], share[smooth], limit)

    field = np.arctan(np.hypot(scene.x0, scene.y0) / scene.h)
    vignetting = np.where(scene.cos4 == 1, np.cos(field) ** 4, 1)
    ideal = (scene.n == 0) & (scene.k == 0)
    rho = np.where(
        ideal, 1, reflectance(np.abs(paths["cosine"]), np.where(ideal, 2, scene.n), scene.k)
    )
    close(irradiance[seen], (rho * vignetting)[seen], tolerances.REFLECTANCE)
    # Seen from straight above, a flat part sends the ray straight up.
    vertical = seen[:3]
    assert vertical.all()
    assert (light[:3] == 0).all()
