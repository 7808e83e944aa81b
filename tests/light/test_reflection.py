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


@holds("unit_change", wrong=("-inner(unit, change), unit", "inner(unit, change), unit"))
def test_the_change_of_a_unit_vector_is_its_derivative(device: Device) -> None:
    d = Draws(10)
    n = d.units() * d.scales(0.5, 900)
    change = d.vectors()
    size = np.sqrt(dot(n, n))
    unit = rounded(n / size)
    size = rounded(size)
    inputs = {**named("u", unit), **named("c", change), "REAL size": size}
    code = "Vector r = unit_change(vector(ux, uy, uz), size, vector(cx, cy, cz));"
    got = stacked(device.call(REFLECTION, code, inputs, components("r")))
    e = 1e-5 * size
    ahead, behind = unit * size + e * change, unit * size - e * change
    difference = ahead / np.sqrt(dot(ahead, ahead)) - behind / np.sqrt(dot(behind, behind))
    close(got * size, difference / (2 * e) * size, tolerances.DERIVATIVE)


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


@holds("reflect_direction", wrong=("(incident, normal), normal)", "(incident, normal), incident)"))
def test_the_angle_out_is_the_angle_in_and_the_three_are_coplanar(device: Device) -> None:
    d = Draws(12)
    i, n = d.units(), d.units()
    n[:, 0], n[:, 1] = -i[:, 0], i[:, 1]
    i[:, 2], n[:, 2] = np.array([0, 0, -1])[:, None], np.array([0, 0, 1])[:, None]
    i[:, 3], n[:, 3] = np.array([1, 0, 0])[:, None], np.array([0, 0, 1])[:, None]
    inputs = {**named("i", i), **named("n", n)}
    code = "Vector r = reflect_direction(vector(ix, iy, iz), vector(nx, ny, nz));"
    r = stacked(device.call(REFLECTION, code, inputs, components("r")))
    close(dot(r, n), -dot(i, n), tolerances.VECTOR)
    close(dot(r, r), np.ones_like(r[0]), tolerances.VECTOR)
    close(dot(i, np.cross(n, r, axis=0)), 0 * r[0], tolerances.VECTOR)
    # What lies in the surface goes on as it came.
    close(np.cross(n, r, axis=0), np.cross(n, i, axis=0), tolerances.VECTOR)


@holds("reflect_change", wrong=("inner(d_incident, normal) + inner(incident", "inner(incident"))
def test_the_change_of_a_reflected_ray_is_its_derivative(device: Device) -> None:
    d = Draws(13)
    i, n, di, dn = d.units(), d.units(), d.vectors(), d.vectors()
    inputs = {**named("i", i), **named("n", n), **named("di", di), **named("dn", dn)}
    code = """Vector r = reflect_change(vector(ix, iy, iz), vector(nx, ny, nz),
                                       vector(dix, diy, diz), vector(dnx, dny, dnz));"""
    got = stacked(device.call(REFLECTION, code, inputs, components("r")))
    e = 1e-5

    def reflected(step: float) -> Array:
        ray, normal = i + step * di, n + step * dn
        return ray - 2 * dot(ray, normal) * normal

    close(got, (reflected(e) - reflected(-e)) / (2 * e), tolerances.DERIVATIVE)


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
        for (int i = 0; i < NEWTON_STEPS; i++) {
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


@holds("surface_change", wrong=("vector(k * dx - x0 * dz / h", "vector(k * dx + x0 * dz / h"))
def test_the_change_of_the_surface_point_is_its_derivative(device: Device) -> None:
    d = Draws(15)
    hill = Hill(d)
    x0, y0, h = d.pixel(-50, 50), d.pixel(-25, 25), d.shared(300, 2000)
    dx, dy = d.shared(-1, 1), d.shared(-1, 1)
    rises = np.where(np.arange(d.groups) % 2 == 0, 1.0, 0.0)[:, None]
    z = rounded(rises * hill.meet(x0, y0, h))
    inputs = {"REAL x0": x0, "REAL y0": y0, "REAL z": z, **shared(h=h, dx=dx, dy=dy, rises=rises)}
    fields = hill.fields(x0 * (1 - z / h), y0 * (1 - z / h))
    inputs |= {f"REAL {name}": v for name, v in zip(FIELDS, fields, strict=True)}
    code = SET_SURFACE + " Vector v = surface_change(s, x0, y0, z, h, dx, dy, rises);"
    got = stacked(device.call(REFLECTION, code, inputs, components("v")))
    e = 1e-3

    def point(step: float) -> Array:
        x, y = x0 + step * dx, y0 + step * dy
        z = rises * hill.meet(x, y, h)
        return np.stack([x * (1 - z / h), y * (1 - z / h), z])

    close(got, (point(e) - point(-e)) / (2 * e), tolerances.DERIVATIVE)


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
    assert 200 < wall.sum() < 1800
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
    for group, (index, extinction) in enumerate(MATERIALS.values()):
        n[group], k[group] = rounded(index), rounded(extinction)
    k[10:60], n[10:60] = 0, d.shared(1.2, 4)[10:60]
    inputs = {"REAL cosine": cosine, **shared(n=n, k=k)}
    (got,) = device.call(REFLECTION, "REAL r = fresnel_reflectance(cosine, n, k);", inputs, ("r",))
    ideal = (n == 0) & (k == 0)
    expected = np.where(ideal, 1, reflectance(cosine, np.where(ideal, 2, n), k))
    close(got, expected, tolerances.REFLECTANCE)
    assert (got[ideal[:, 0]] == 1).all()
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


@holds("camera_ray", wrong=("vector(x0 * k, y0 * k, z)", "vector(x0, y0 * k, z)"))
def test_a_camera_ray_leads_from_the_pinhole_through_its_pixel(device: Device) -> None:
    scene = Scene(46)
    code = "CameraRay c = camera_ray(x0, y0, z, g.camera_height);" + SET_SURFACE
    outputs = (*components("c.point"), *components("c.direction"), "c.distance")
    got = stacked(device.call(REFLECTION, code, scene.inputs(), outputs))
    point, direction, distance = got[:3], got[3:6], got[6]
    pinhole = np.stack([0 * scene.x0, 0 * scene.x0, scene.h + 0 * scene.x0])
    pixel = np.stack([scene.x0, scene.y0, 0 * scene.x0])
    seen = np.cross(pixel - pinhole, point - pinhole, axis=0) / scene.h**2
    close(seen, 0 * seen, tolerances.VECTOR)
    np.testing.assert_array_equal(point[2], scene.z)
    close(direction * distance, point - pinhole, tolerances.VECTOR * scene.h)
    close(dot(direction, direction), np.ones_like(distance), tolerances.VECTOR)


@holds("mirror_of", wrong=("m.length = sqrt(inner(upright, upright))", "m.length = upright.z"))
def test_the_part_mirrors_a_ray_about_its_normal(device: Device) -> None:
    scene = Scene(47)
    outputs = (*components("c.direction"), *components("m.normal"), *components("m.ray"))
    code = (
        SET_SURFACE
        + """CameraRay c = camera_ray(x0, y0, z, g.camera_height);
        Mirror m = mirror_of(c, s); REAL scaled_z = m.normal.z * m.length;"""
    )
    got = stacked(device.call(REFLECTION, code, scene.inputs(), (*outputs, "scaled_z")))
    incident, normal, ray = got[:3], got[3:6], got[6:9]
    k = 1 - scene.z / scene.h
    _, zx, zy, *_ = scene.hill.fields(scene.x0 * k, scene.y0 * k)
    close(normal[0] + zx * normal[2], 0 * zx, tolerances.VECTOR)
    close(normal[1] + zy * normal[2], 0 * zy, tolerances.VECTOR)
    close(got[9], np.ones_like(zx), tolerances.VECTOR)
    close(dot(normal, normal), np.ones_like(zx), tolerances.VECTOR)
    close(dot(ray, normal), -dot(incident, normal), tolerances.VECTOR)
    close(dot(incident, np.cross(normal, ray, axis=0)), 0 * zx, tolerances.VECTOR)


@holds("light_change", wrong=("moved.x + dt * m.ray.x", "moved.x"))
def test_the_change_of_the_light_coordinate_is_its_derivative(device: Device) -> None:
    scene = Scene(48)
    d = Draws(49, len(scene.h))
    dx, dy = d.shared(-1, 1), d.shared(-1, 1)
    code = (
        WAY
        + """REAL dl = light_change(g, s, c, m, hit, dx, dy);
        REAL lost = loss_of(g, c, m, hit, met);"""
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


@holds("loss_of", wrong=("m.ray.z <= 0.0f ? LOST_DOWN", "m.ray.z <= -2.0f ? LOST_DOWN"))
@holds("footprint_of", wrong=("0.8660254f * g.pupil", "0.5f * g.pupil"))
@holds("irradiance_of", wrong=("cosine * cosine * cosine * cosine", "cosine * cosine"))
def test_loss_footprint_and_irradiance_are_those_of_the_ray_s_path(device: Device) -> None:
    scene = Scene(21)
    code = (
        WAY
        + """REAL lost = loss_of(g, c, m, hit, met);
        REAL w = footprint_of(g, s, c, m, hit); REAL e = irradiance_of(g, c, m);"""
    )
    light, footprint, irradiance, lost = stacked(
        device.call(REFLECTION, code, scene.inputs(), ("met.x", "w", "e", "lost"))
    )
    lit = lost == 0
    check_sight(scene, light * lit, np.where(lit, footprint, 1), np.where(lit, irradiance, 0), lost)


@holds("sight", wrong=("v.footprint = (lit ? footprint : 1.0f)", "v.footprint = 1.0f"))
def test_a_ray_sees_the_light_it_meets_over_the_footprint_that_differences_give(
    device: Device,
) -> None:
    scene = Scene(21)
    code = SET_SURFACE + " Sight v = sight(g, s, x0, y0, z);"
    outputs = ("v.light", "v.footprint", "v.irradiance", "v.lost")
    check_sight(scene, *stacked(device.call(REFLECTION, code, scene.inputs(), outputs)))


def check_sight(
    scene: Scene, light: Array, footprint: Array, irradiance: Array, lost: Array
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
    for value, blind in ((light, 0), (footprint, 1), (irradiance, 0)):
        assert (value[~seen] == blind).all()

    # Where the ray hardly rises, path and light grow beyond all bounds, and their error with them.
    reach = 1 / np.maximum(ray[2], 1e-9) ** 2
    close(light[seen], met[0][seen], (tolerances.SIGHT_MM * np.maximum(reach, 1))[seen])

    p = scene.sampling / scene.sub
    e = 1e-3
    square = np.zeros_like(light)
    smooth = seen.copy()
    for dx, dy in ((e, 0.0), (0.0, e)):
        ahead = scene.follow(scene.x0 + dx, scene.y0 + dy)
        behind = scene.follow(scene.x0 - dx, scene.y0 - dy)
        smooth &= ahead["wall"] == behind["wall"]
        square += ((ahead["light"][0] - behind["light"][0]) / (2 * e) * p) ** 2
    # The box of the variance of a uniform disc (D^2/16), and of a tilt of 2 alpha rms.
    square += 12 * (scene.pupil / 4 * paths["path"] / paths["distance"]) ** 2
    square += 12 * (2 * scene.rough * paths["path"]) ** 2
    assert smooth.sum() > 0.99 * seen.sum()
    steep = 1 + 0.01 * reach
    close((footprint / np.maximum(np.sqrt(square), 1e-4))[smooth], np.ones(smooth.sum()),
          (tolerances.FOOTPRINT * steep)[smooth])  # fmt: skip

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
