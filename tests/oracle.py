"""Brute-force float64 oracle: many rays per pixel, every image rendered, no closed form.

It is written from the model alone and shares no line with the program it judges. Every ray is
followed: pixel area x lens pupil (x roughness), surface, reflection, tunnel, stripe (0 or 1).
The rays of a pixel are averaged, *then* exposed and saturated, *then* the images are averaged.

Frame: x along the translation of the light, y across, z up; the part's base plane is z = 0 and the
camera is at O = (0, 0, h). Units: mm, radians, grey levels. Arrays are (row, column) = (M, N).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SEEN, BESIDE_PART, DOWN, PAST_END, OPENING = range(5)
"""Why a ray sees no light; `SEEN` is 0: it sees the tunnel."""

DIFFERENCE_MM = 1e-4
"""Half base of the central differences that give the slopes."""


@dataclass(frozen=True)
class Groove:
    """Gaussian groove, z = depth exp(-r^2 / 2 sigma^2), r the distance to the polyline `points`.

    One point is a dent (depth_mm < 0) or a bump (> 0); several are a scratch with rounded ends.
    """

    points: tuple[tuple[float, float], ...]
    sigma_mm: float
    depth_mm: float


@dataclass(frozen=True)
class Pose:
    """A body turned about the axes of the station, x first, then y, then z, and then shifted."""

    angles_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def turned(self, v: Floats, *, back: bool = False) -> Floats:
        """Vectors, last axis 3, of the body's frame in the station's, or back."""
        rotation = Rotation.from_euler("xyz", self.angles_deg, degrees=True)
        shape = np.shape(v)
        turned: Floats = rotation.apply(np.reshape(v, (-1, 3)), inverse=back).reshape(shape)
        return turned


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Part, tunnel, camera and sequence. None means endless, or flat for a radius.

    The arch is the cylinder y^2 + z^2 = tunnel_height_mm^2; the walls of the box are at
    y = +-tunnel_width_mm / 2. Both are taken to go on below z = 0, where only a ray from a point
    below the base plane can meet them. The opening exists when its two sides are > 0.
    """

    camera_height_mm: float = 800.0
    sampling_mm: float = 0.1
    rows: int = 32
    columns: int = 32
    pupil_mm: float = 0.0
    focus_mm: float | None = None  # from the pupil to the plane in focus; None: the part
    blur_mm: float = 0.0  # rms of the lens's spot, on z = 0
    part_length_mm: float | None = None
    part_width_mm: float | None = None
    crown_radius_x_mm: float | None = None
    crown_radius_y_mm: float | None = None
    surface: Literal["orientation", "height"] = "orientation"
    section: Literal["ceiling", "box", "arch"] = "ceiling"
    tunnel_height_mm: float = 150.0
    tunnel_width_mm: float | None = None
    tunnel_length_mm: float | None = None
    opening_length_mm: float = 0.0
    opening_width_mm: float = 0.0
    luminous_mm: float = 4.0
    dark_mm: float = 12.0
    dark_leak: float = 0.0
    exposure: float = 4.0
    images: int = 40
    step_mm: float | None = None
    full_scale: float = 255.0
    roughness_rad: float = 0.0
    vignetting: Literal["none", "cos4"] = "none"
    scattered: float = 0.0  # radiance of what the part scatters, see `scattered`
    grooves: tuple[Groove, ...] = ()
    part_pose: Pose = Pose()
    camera_pose: Pose = Pose()
    looks: int = 1

    @property
    def period_mm(self) -> float:
        """P = a + b."""
        return self.luminous_mm + self.dark_mm

    def shift_mm(self, k: int) -> float:
        """Shift of the tunnel in image `k`: s_k = k step, by default k P / K."""
        return k * (self.period_mm / self.images if self.step_mm is None else self.step_mm)


class Rays(NamedTuple):
    """What rays met; vectors have a last axis of 3 (x, y, z)."""

    S: Floats  # surface point, mm
    I: Floats  # noqa: E741  incident direction, from the camera
    N: Floats  # surface normal
    R: Floats  # reflected direction
    L: Floats  # light point on the tunnel, mm; NaN for the reasons BESIDE_PART and DOWN
    t: Floats  # path from S to L, mm; NaN likewise
    reason: NDArray[np.int64]  # SEEN, BESIDE_PART, DOWN, PAST_END or OPENING


# ---------------------------------------------------------------------------------------- surface


def sag(u: Floats, radius: float | None) -> Floats:
    """Height of a circle of signed `radius` through 0 at u = 0; convex (falling) for radius > 0.

    Past 0.999 |radius| it is held constant: no part is there (see `beside_part`).
    """
    if radius is None:
        return np.zeros_like(u)
    u = np.clip(u, -0.999 * abs(radius), 0.999 * abs(radius))
    z: Floats = -(radius - np.sign(radius) * np.sqrt(radius**2 - u**2))
    return z


def squared_distance(x: Floats, y: Floats, points: tuple[tuple[float, float], ...]) -> Floats:
    """Squared distance, mm^2, from (x, y) to the nearest point of a polyline (or single point)."""
    nearest = np.full(np.broadcast(x, y).shape, np.inf)
    for (ax, ay), (bx, by) in zip(points, points[1:] or points, strict=False):
        length_squared = (bx - ax) ** 2 + (by - ay) ** 2
        if length_squared > 0:
            along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length_squared
            along = np.clip(along, 0.0, 1.0)
            squared = (x - ax - along * (bx - ax)) ** 2 + (y - ay - along * (by - ay)) ** 2
        else:
            squared = (x - ax) ** 2 + (y - ay) ** 2
        nearest = np.minimum(nearest, squared)
    return nearest


def height(scene: Scene, x: Floats, y: Floats) -> Floats:
    """z(x, y) = shape + relief, mm."""
    z = sag(x, scene.crown_radius_x_mm) + sag(y, scene.crown_radius_y_mm)
    for groove in scene.grooves:
        squared = squared_distance(x, y, groove.points)
        z = z + groove.depth_mm * np.exp(-squared / (2 * groove.sigma_mm**2))
    return z


def slopes(scene: Scene, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """(dz/dx, dz/dy) by central differences of `height`.

    Differences and not derivatives on paper, so that no sign or factor can be wrong here in the
    way it could be wrong in the program. For sigma >= 0.1 mm and |depth| <= 0.02 mm they are
    within 5e-8 of the derivative: 2e-5 mm on a light 150 mm away. A scratch's crease (where the
    nearest segment changes) is smoothed over 2e-4 mm.
    """
    e = DIFFERENCE_MM
    along_x = (height(scene, x + e, y) - height(scene, x - e, y)) / (2 * e)
    along_y = (height(scene, x, y + e) - height(scene, x, y - e)) / (2 * e)
    return along_x, along_y


def beside_part(scene: Scene, x: Floats, y: Floats) -> Bools:
    """Whether (x, y) is off the part: past its length or width, or past the end of its crown."""
    beside = np.zeros(np.broadcast(x, y).shape, dtype=bool)
    for u, size, radius in (
        (x, scene.part_length_mm, scene.crown_radius_x_mm),
        (y, scene.part_width_mm, scene.crown_radius_y_mm),
    ):
        if size is not None:
            beside |= np.abs(u) > size / 2
        if radius is not None:
            beside |= np.abs(u) > 0.999 * abs(radius)
    return beside


def surface_point(scene: Scene, x: Floats, y: Floats, pupil: Floats | float = 0.0) -> Floats:
    """S, where the ray from O through (x, y, 0) meets the surface; shape (..., 3), mm.

    At height z that ray is at (1 - z/h) (x, y); for a height surface z = z(x, y) is iterated. Where
    the lens is focused at F and not on the part, the ray from the point a of the pupil passes the
    one from O there: at the depth u below the pupil, both are a (1 - u/F) apart.
    """
    h = scene.camera_height_mm
    a, b = np.moveaxis(np.broadcast_to(pupil, (*np.broadcast(x, y).shape, 2)), -1, 0)

    def at(z: Floats) -> tuple[Floats, Floats]:
        shrink = 1 - z / h
        apart = 0.0 if scene.focus_mm is None else 1 - (h - z) / scene.focus_mm
        return x * shrink + a * apart, y * shrink + b * apart

    z = np.zeros(np.broadcast(x, y).shape)
    if scene.part_pose != Pose() or scene.camera_pose != Pose() or scene.looks > 1:
        assert scene.focus_mm is None, "the oracle tells no plane in focus of a posed camera"
        return posed_surface_point(scene, x, y)
    if scene.surface == "height":
        for _ in range(200):
            before, z = z, height(scene, *at(z))
            if np.max(np.abs(z - before)) < 1e-12:
                break
        else:
            raise ValueError("the camera ray's meeting with the surface did not converge")
    return np.stack([*at(z), z], axis=-1)


def pupil_points(scene: Scene, pupil: Floats | float, like: Floats) -> Floats:
    """Points of the pupil in the station's frame: the camera is turned about the pupil's centre."""
    own = np.zeros_like(like)
    own[..., :2] += pupil
    centre = np.array(scene.camera_pose.shift_mm)
    centre[2] += scene.camera_height_mm
    return scene.camera_pose.turned(own) + centre


def posed_surface_point(scene: Scene, x: Floats, y: Floats) -> Floats:
    """S in the part's frame: the ray from the pupil's centre, bisected for where it meets z(x, y).

    The plane in focus is at the camera's height before its pupil, across its axis.
    """
    x, y = np.broadcast_arrays(x, y)
    before = np.stack([x, y, np.full(x.shape, -scene.camera_height_mm)], axis=-1)
    part = scene.part_pose
    origin = pupil_points(scene, 0.0, np.zeros(3)) - np.array(part.shift_mm)
    origin = part.turned(origin, back=True)
    ray = part.turned(scene.camera_pose.turned(before), back=True)
    # Between 50 mm above the part's base plane and 50 mm below.
    near, far = ((level - origin[2]) / ray[..., 2] for level in (50.0, -50.0))
    if scene.looks > 1:  # the first of several places at which the ray meets the part
        first = np.zeros(x.shape, dtype=bool)
        for share in np.linspace(0, 1, scene.looks + 1)[1:]:
            way = (50.0 - 100.0 * share - origin[2]) / ray[..., 2]
            point = origin + way[..., None] * ray
            below = point[..., 2] < height(scene, point[..., 0], point[..., 1])
            below &= ~beside_part(scene, point[..., 0], point[..., 1])
            far = np.where(below & ~first, way, far)
            near = np.where(first | below, near, way)
            first |= below
    for _ in range(90):
        middle = (near + far) / 2
        point = origin + middle[..., None] * ray
        level = height(scene, point[..., 0], point[..., 1]) if scene.surface == "height" else 0.0
        above = point[..., 2] > level
        near, far = np.where(above, middle, near), np.where(above, far, middle)
    met: Floats = origin + ((near + far) / 2)[..., None] * ray
    return met


def meets_again(scene: Scene, S: Floats, R: Floats, steps: int = 4000) -> Bools:
    """Whether rays from S along R, all in the part's frame, go below the part; by many points."""
    again = np.zeros(S.shape[:-1], dtype=bool)
    reach = np.hypot(scene.part_length_mm or 1e3, scene.part_width_mm or 1e3)
    for share in np.linspace(0, 1, steps + 1)[1:]:
        x, y, z = np.moveaxis(S + share * reach * R, -1, 0)
        again |= (z < height(scene, x, y)) & ~beside_part(scene, x, y)
    return again


# ---------------------------------------------------------------------------------------- one ray


def unit(v: Floats) -> Floats:
    """v / |v| along the last axis."""
    length: Floats = np.sqrt(np.sum(v * v, axis=-1, keepdims=True))
    return v / length


def path_to_tunnel(scene: Scene, S: Floats, R: Floats) -> tuple[Floats, Bools]:
    """Path t from S along R to the tunnel, mm, and whether it ends on a wall of the box.

    Meaningful where R_z > 0 only.
    """
    (_, y, z), (_, ry, rz) = np.moveaxis(S, -1, 0), np.moveaxis(R, -1, 0)
    H = scene.tunnel_height_mm
    if scene.section == "arch":  # |(y, z) + t (ry, rz)| = H, the root ahead
        a, b, c = ry**2 + rz**2, y * ry + z * rz, y**2 + z**2 - H**2
        return (-b + np.sqrt(b**2 - a * c)) / a, np.zeros(y.shape, dtype=bool)
    top = (H - z) / rz
    if scene.section == "ceiling":
        return top, np.zeros(y.shape, dtype=bool)
    if scene.tunnel_width_mm is None:
        raise ValueError("a box needs tunnel_width_mm")
    wall = (np.copysign(scene.tunnel_width_mm / 2, ry) - y) / ry
    return np.where(wall < top, wall, top), wall < top


def trace(scene: Scene, x: Floats, y: Floats, pupil: Floats | float, tilt: Floats | float) -> Rays:
    """Follow rays from pupil points, through the surface point seen at (x, y, 0), to the tunnel.

    Parameters
    ----------
    x, y : (...)
        Where the ray from the pupil's centre O crosses the plane z = 0, mm.
    pupil : (..., 2) or 0
        Point of the pupil, mm from O. Focused on the part, all of them see the same S.
    tilt : (..., 2) or 0
        What roughness adds to the slopes dz/dx and dz/dy.
    """
    S = surface_point(scene, x, y, pupil)
    origin = pupil_points(scene, pupil, S)
    # A surface without height still has the orientation of the shape, at the point looked at.
    slope = np.stack(slopes(scene, S[..., 0], S[..., 1]), axis=-1) + tilt
    N = unit(np.concatenate([-slope, np.ones_like(slope[..., :1])], axis=-1))
    beside = beside_part(scene, S[..., 0], S[..., 1])
    # From here on in the station's frame.
    S = scene.part_pose.turned(S) + np.array(scene.part_pose.shift_mm)
    N = scene.part_pose.turned(N)
    I = unit(S - origin)  # noqa: E741
    R = I - 2 * np.sum(I * N, axis=-1, keepdims=True) * N

    down = R[..., 2] <= 0
    with np.errstate(divide="ignore", invalid="ignore"):
        t, on_wall = path_to_tunnel(scene, S, R)
    t = np.where(beside | down, np.nan, t)
    if not np.all((t > 0) | beside | down):
        raise ValueError("the part is not inside the tunnel")
    L = S + t[..., None] * R

    reason = np.full(t.shape, SEEN)
    if scene.opening_length_mm > 0 and scene.opening_width_mm > 0:
        inside = np.abs(L[..., 0]) <= scene.opening_length_mm / 2
        inside &= np.abs(L[..., 1]) <= scene.opening_width_mm / 2
        reason[inside & ~on_wall] = OPENING
    if scene.tunnel_length_mm is not None:
        reason[np.abs(L[..., 0]) > scene.tunnel_length_mm / 2] = PAST_END
    reason[down] = DOWN
    reason[beside] = BESIDE_PART
    return Rays(S, I, N, R, L, t, reason)


# --------------------------------------------------------------------------------- rays per pixel


def pixel_centres(scene: Scene) -> tuple[Floats, Floats]:
    """(x, y) of the pixel centres on the plane z = 0, mm, two arrays (M, N)."""
    x = (np.arange(scene.columns) + 0.5 - scene.columns / 2) * scene.sampling_mm
    y = (scene.rows / 2 - np.arange(scene.rows) - 0.5) * scene.sampling_mm
    grid_x, grid_y = np.meshgrid(x, y)
    return grid_x, grid_y


def central_rays(scene: Scene) -> Rays:
    """The ray from O through each pixel's centre, no roughness: fields (M, N, 3) or (M, N)."""
    return trace(scene, *pixel_centres(scene), pupil=0.0, tilt=0.0)


def even_points(count: int, dimensions: int) -> Floats:
    """Evenly spread points of the unit cube, (count, dimensions): Roberts' R_d sequence.

    Point i is (i / phi^j mod 1), j = 1..d, with phi the positive root of phi^(d+1) = phi + 1.
    """
    phi = 2.0
    for _ in range(100):
        phi = (1 + phi) ** (1 / (dimensions + 1))
    steps = phi ** -np.arange(1.0, dimensions + 1)
    points: Floats = np.mod(np.arange(count)[:, None] * steps, 1.0)
    return points


def light_coordinates(
    scene: Scene, rays: int = 4096, seed: int = 0, rows: slice = slice(None)
) -> tuple[Floats, Bools]:
    """Light coordinate of every ray of every pixel of some `rows` (by default all).

    All pixels use the same even points, each pixel shifting them (modulo 1) by its own random
    amount, so that the errors of two pixels are independent.

    Returns
    -------
    light : (M, N, rays)
        L_x, mm; NaN where the ray misses the part or goes down.
    lit : (M, N, rays)
        Whether the ray sees the tunnel at all.
    """
    x, y = (centres[rows, :, None] for centres in pixel_centres(scene))
    numbers = range(scene.rows)[rows]
    # Dimensions left unused would only make the others less even.
    blurred, rough = scene.blur_mm > 0, scene.roughness_rad > 0
    dimensions = 2 + 2 * (scene.pupil_mm > 0) + 2 * blurred + 2 * rough
    shape = (scene.columns, 1, dimensions)
    shifts = np.stack([np.random.default_rng([seed, r]).random(shape) for r in numbers])
    uniform = np.mod(even_points(rays, dimensions) + shifts, 1.0)  # (M, N, rays, dimensions)

    x = x + (uniform[..., 0] - 0.5) * scene.sampling_mm
    y = y + (uniform[..., 1] - 0.5) * scene.sampling_mm
    pupil: Floats | float = 0.0
    tilt: Floats | float = 0.0
    if blurred:  # where on z = 0 it looks, two independent Gaussians (Box and Muller)
        first = 2 + 2 * (scene.pupil_mm > 0)
        radius = scene.blur_mm * np.sqrt(-2 * np.log1p(-uniform[..., first]))
        spot = polar(radius, uniform[..., first + 1])
        x, y = x + spot[..., 0], y + spot[..., 1]
    if scene.pupil_mm > 0:  # a disc, evenly: radius ~ sqrt(u)
        radius = scene.pupil_mm / 2 * np.sqrt(uniform[..., 2])
        pupil = polar(radius, uniform[..., 3])
    if rough:  # and two more
        radius = scene.roughness_rad * np.sqrt(-2 * np.log1p(-uniform[..., -2]))
        tilt = polar(radius, uniform[..., -1])
    traced = trace(scene, x, y, pupil, tilt)
    return traced.L[..., 0], traced.reason == SEEN


def polar(radius: Floats, turns: Floats) -> Floats:
    """(radius cos, radius sin) of an angle in turns, on a new last axis."""
    angle = 2 * np.pi * turns
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


# ----------------------------------------------------------------------------------------- images


def irradiance(scene: Scene, light: Floats, lit: Bools, k: int) -> Floats:
    """Mean radiance over the rays of each pixel in image `k`: luminous 1, dark beta, lost 0."""
    periods = (light - scene.shift_mm(k)) / scene.period_mm
    phase = periods - np.floor(periods)  # np.mod takes five times as long
    luminous = np.count_nonzero((phase < scene.luminous_mm / scene.period_mm) & lit, axis=-1)
    dark = np.count_nonzero(lit, axis=-1) - luminous
    mean: Floats = (luminous + scene.dark_leak * dark) / light.shape[-1]
    return mean


def scattered(
    scene: Scene, albedo: float, x: float, y: float, k: int = 0, rays: int = 2**16
) -> float:
    """Radiance of a Lambertian point of the part in image `k`: rays over its whole hemisphere.

    Drawn by the cosine from the normal, they have their mean radiance as the irradiance over pi.
    """
    u, v = even_points(rays, 2).T
    sine, turn = np.sqrt(u), 2 * np.pi * v
    S = np.broadcast_to(surface_point(scene, np.array(x), np.array(y)), (rays, 3))
    slope = np.array([float(s) for s in slopes(scene, S[0, 0], S[0, 1])])
    N = unit(np.array([*-slope, 1.0]))
    across = unit(np.cross(N, [0.0, 1.0, 0.0]))
    R = sine[:, None] * (
        np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(N, across)
    )
    R = R + np.sqrt(1 - u)[:, None] * N
    with np.errstate(divide="ignore", invalid="ignore"):
        t, on_wall = path_to_tunnel(scene, S, R)
        L = S + t[:, None] * R
    seen = R[:, 2] > 0
    if scene.tunnel_length_mm is not None:
        seen &= np.abs(L[:, 0]) <= scene.tunnel_length_mm / 2
    if scene.opening_length_mm > 0:
        hole = np.abs(L[:, 0]) <= scene.opening_length_mm / 2
        seen &= ~(hole & (np.abs(L[:, 1]) <= scene.opening_width_mm / 2) & ~on_wall)
    light = np.where(seen, L[:, 0], 0.0)
    return albedo * float(irradiance(scene, light[None], seen[None], k)[0])


def vignetting(scene: Scene) -> Floats:
    """cos^4 of the angle between each pixel's central ray and the optical axis, or 1; (M, N)."""
    x, y = pixel_centres(scene)
    h = scene.camera_height_mm
    cosine: Floats = h / np.sqrt(x**2 + y**2 + h**2)
    return cosine**4 if scene.vignetting == "cos4" else np.ones_like(cosine)


def images(scene: Scene, numbers: range, rays: int, seed: int) -> Floats:
    """Mean of the images `numbers`, each exposed and saturated first; (M, N), grey levels."""
    total = np.zeros((scene.rows, scene.columns))
    gain = scene.exposure * vignetting(scene)
    for r in range(scene.rows):  # row by row: little memory, and it stays in the cache
        light, lit = light_coordinates(scene, rays, seed, slice(r, r + 1))
        for k in numbers:
            exposed = gain[r] * (irradiance(scene, light, lit, k)[0] + scene.scattered)
            total[r] += scene.full_scale * np.minimum(exposed, 1.0)
    return total / len(numbers)


def image(scene: Scene, k: int, rays: int = 4096, seed: int = 0) -> Floats:
    """Image `k` of the sequence, noise-free and not quantised: (M, N), grey levels."""
    return images(scene, range(k, k + 1), rays, seed)


def aspect_image(scene: Scene, rays: int = 4096, seed: int = 0) -> Floats:
    """Mean of all the images of the sequence: (M, N), grey levels."""
    return images(scene, range(scene.images), rays, seed)
