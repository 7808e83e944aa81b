"""The sections of a station file but its defects; every key with its unit.

Every default is gpuspec's own choice: the paper (Seulin, Merienne, Gorria) prints no camera
distance, stripe width or image count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from gpuspec.shapes import Crown, Shape, Sphere
from gpuspec.station.defects import Coordinate, Length, Section, Seed, Topography
from gpuspec.station.materials import WAVELENGTH_NM
from gpuspec.station.optics import FOLLOWS, blur_um, sampling_mm, spread

_SAME = 1e-6
"""Share by which a value may differ from what follows from others: as both are written."""

MOST_SIDES = 8
"""Sub-rays on each side of a pixel that is refined the most."""
OUTERMOST = 0.45
"""Of a pixel: where the outermost of so many is, and float32's doubt."""


class OwnRelief(Topography):
    """A measured topography of the part itself: of all or of a piece that lies on its shape."""

    x_mm: Coordinate = Field(0.0, description="centre of the map on the part")
    y_mm: Coordinate = Field(0.0, description="centre of the map on the part")
    blend_mm: float = Field(
        0.0,
        ge=0,
        le=1e5,
        description="over this width at its border a map smaller than the part fades into the "
        "part's shape; 0: the map must reach as far as the part",
    )
    repeat: bool = Field(
        False,
        description="true: a map smaller than the part is laid again and again, each time mirrored",
    )


class Waviness(Section):
    """A wave on the part: z = amplitude cos(2 pi u / wavelength + phase), u along its direction."""

    amplitude_um: float = Field(gt=0, le=1e4, description="half of what it rises and falls")
    wavelength_mm: Length = Field(description="from crest to crest")
    direction_deg: float = Field(
        0.0, ge=-180, le=180, description="in which it runs, from x anticlockwise"
    )
    phase_deg: float = Field(0.0, ge=-360, le=360, description="at the part's centre; 0: a crest")


class OrangePeel(Section):
    """A random surface of a wavelength and slope: a seeded Gaussian field with a ring of waves.

    Its power at the spatial frequency f is exp(-2 ((f - f0) / 0.4 f0)^2), f0 = 1 / wavelength, the
    same in every direction.
    """

    wavelength_mm: Length = Field(description="at which its power is greatest")
    slope_rad: float = Field(gt=0, le=0.2, description="rms of the slope's size")
    seed: Seed = Field(0, description="of the surface")


class MeshFile(Section):
    """The part's shape as triangles, of which the camera sees what lies highest.

    The middle of the mesh, seen from above, is the part's centre, and its surface there is at
    z = 0.
    """

    file: str = Field(
        min_length=1, description=".stl, .obj or .ply file, relative to the station file"
    )
    unit: Literal["mm", "m", "inch"] = Field(description="of the file's numbers, which state none")
    resolution_mm: Length = Field(
        0.5, description="distance of the points at which the mesh is sampled"
    )
    smooth_deg: float = Field(
        30.0, ge=0, le=90, description="edges at which faces turn by more stay sharp"
    )


Angle = Annotated[float, Field(ge=-60, le=60)]


class Pose(Section):
    """Where a part or a camera really is: turned about x, then y, then z, then shifted."""

    shift_x_mm: Coordinate = Field(0.0, description="along x of the station")
    shift_y_mm: Coordinate = Field(0.0, description="along y")
    shift_z_mm: Coordinate = Field(0.0, description="up")
    tilt_x_deg: Angle = Field(0.0, description="about x, right-handed: what is at y > 0 rises")
    tilt_y_deg: Angle = Field(0.0, description="about y, right-handed: what is at x > 0 sinks")
    turn_deg: float = Field(
        0.0, ge=-180, le=180, description="about z, anticlockwise as the camera sees it"
    )

    @property
    def moves(self) -> bool:
        """Whether anything is moved."""
        return any(getattr(self, key) for key in type(self).model_fields)

    @property
    def shift_mm(self) -> tuple[float, float, float]:
        """Along x, y and z."""
        return self.shift_x_mm, self.shift_y_mm, self.shift_z_mm

    @property
    def axes(self) -> tuple[tuple[float, float, float], ...]:
        """Rows of the rotation matrix Rz(turn) Ry(tilt_y) Rx(tilt_x)."""
        angles = self.tilt_x_deg, self.tilt_y_deg, self.turn_deg
        (cx, sx), (cy, sy), (cz, sz) = (
            (math.cos(math.radians(a)), math.sin(math.radians(a))) for a in angles
        )
        return (
            (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
            (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
            (-sy, cy * sx, cy * cx),
        )


class Part(Section):
    """The part: its outline, shape, relief and reflectance."""

    length_mm: Length = Field(
        200.0,
        description="along x, the direction in which the light moves; "
        "not given beside a relief: its map's",
    )
    width_mm: Length = Field(50.0, description="along y; not given beside a relief: its map's")
    crown_radius_x_mm: Annotated[float, Field(ge=-1e7, le=1e7)] | None = Field(
        None,
        description="radius of the crown along x, > 0 convex; alone a cylinder about y; none: flat",
    )
    crown_radius_y_mm: Annotated[float, Field(ge=-1e7, le=1e7)] | None = Field(
        None,
        description="radius of the crown along y, > 0 convex; alone a cylinder about x; none: flat",
    )
    sphere_radius_mm: Annotated[float, Field(ge=-1e7, le=1e7)] | None = Field(
        None, description="radius of a sphere in the crown's place, > 0 convex; none: no sphere"
    )
    surface: Literal["orientation", "height"] = Field(
        "orientation",
        description="orientation: the ray meets z = 0, only the normal carries the shape "
        "(the paper's); height: the ray meets the surface itself",
    )
    material: Literal[
        "ideal", "aluminium", "silver", "gold", "copper", "chromium", "nickel", "iron", "lacquer"
    ] = Field("ideal", description="Fresnel reflectance of this material; ideal: 1")
    diffuse: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the light falling on the part that it scatters evenly to all sides, "
        "beside what it reflects as a mirror; lit by the whole tunnel",
    )
    roughness_rad: float = Field(
        0.0, ge=0, le=0.2, description="rms slope of micro-roughness; 0: the paper's mirror"
    )
    waviness: Waviness | None = Field(None, description="a wave on the part")
    orange_peel: OrangePeel | None = Field(None, description="a random surface on the part")
    relief: OwnRelief | None = Field(None, description="measured topography of the part")

    mesh: MeshFile | None = Field(None, description="the part's shape as triangles")
    pose: Pose | None = Field(
        None, description="of the part and its defects, about the centre of its base plane"
    )

    @field_validator("relief", mode="before")
    @classmethod
    def _own(cls, relief: Any) -> Any:
        """Take a plain topography, too."""
        if isinstance(relief, Topography) and not isinstance(relief, OwnRelief):
            return relief.model_dump(exclude_unset=True)
        return relief

    @cached_property
    def shape(self) -> Shape:
        """Its shape without relief, if it is no mesh: see :func:`gpuspec.part.shape.shape_of`."""
        if self.sphere_radius_mm:
            return Sphere(1 / self.sphere_radius_mm)
        return Crown.of_radii(self.crown_radius_x_mm, self.crown_radius_y_mm)

    @property
    def uneven(self) -> bool:
        """Whether something lies on its shape everywhere: waves, orange peel, a relief, a mesh."""
        return bool(self.waviness or self.orange_peel or self.relief or self.mesh)

    @cached_property
    def height_range_mm(self) -> tuple[float, float]:
        """Lowest and highest point of the shape (without relief), in mm."""
        return self.shape.height_range(self.length_mm, self.width_mm)


def _lit(values: tuple[float, ...]) -> tuple[float, ...]:
    if max(values) == min(values):
        raise ValueError("must have a bright and a dark place")
    return values


Luminances = Annotated[
    tuple[Annotated[float, Field(ge=0, le=1)], ...],
    Field(min_length=3, max_length=1024, strict=False),
    AfterValidator(_lit),
]
"""Relative, of a period."""


class Tunnel(Section):
    """Luminous panels extruded along x, shaded by opaque stripes perpendicular to x."""

    section: Literal["ceiling", "box", "arch"] = Field(
        "ceiling", description="ceiling: plane; box: ceiling and two walls; arch: half cylinder"
    )
    height_mm: Length = Field(150.0, description="height of the ceiling (ceiling and box)")
    width_mm: Length | None = Field(None, description="distance of the box's walls")
    radius_mm: Length | None = Field(None, description="radius of the arch, about the x axis")
    length_mm: Length = Field(1000.0, description="extent along x, centred on the part")
    luminous_mm: Length = Field(4.0, description="width of the luminous stripes")
    dark_mm: Length = Field(12.0, description="width of the dark stripes")
    dark_leak: float = Field(
        0.0, ge=0, lt=1, description="radiance of the dark stripes, luminous = 1"
    )
    profile: Literal["stripes", "sinusoid"] | Luminances = Field(
        "stripes",
        description="luminance over a period, luminous_mm + dark_mm: stripes; sinusoid: a "
        "screen's fringes, brightest at the start of the period; a list: from the start of the "
        "period at equal steps, between them up to 16 harmonics",
    )
    profile_gamma: float = Field(
        1.0, ge=0.2, le=10, description="of the screen: a sinusoid's luminance to this power"
    )
    wavelength_nm: float = Field(
        WAVELENGTH_NM,
        ge=400,
        le=1000,
        description="of the light: what the part's material reflects, and diffraction",
    )
    opening_length_mm: float = Field(
        0.0, ge=0, le=1e5, description="camera opening along x, above the origin; 0: none"
    )
    opening_width_mm: float = Field(0.0, ge=0, le=1e5, description="camera opening along y")

    @property
    def period_mm(self) -> float:
        """Period P = a + b of the stripes."""
        return self.luminous_mm + self.dark_mm

    @property
    def is_striped(self) -> bool:
        """Whether the light is stripes, luminous or dark and nothing between."""
        return self.profile == "stripes"

    @property
    def light(self) -> str:
        """What moves, in a few words: ``"stripes 4 + 12 mm"``."""
        if self.is_striped:
            return f"stripes {self.luminous_mm:g} + {self.dark_mm:g} mm"
        gamma = f" to the power {self.profile_gamma:g}" if self.profile_gamma != 1 else ""
        kind = f"sinusoid{gamma}" if self.profile == "sinusoid" else "profile"
        return f"{kind}, period {self.period_mm:g} mm"

    @property
    def brightest(self) -> float:
        """Luminance of the brightest place, of 1."""
        return 1.0 if isinstance(self.profile, str) else max(self.profile)

    @property
    def top_mm(self) -> float:
        """Height of the tunnel's highest point above z = 0."""
        return self.radius_mm or 0.0 if self.section == "arch" else self.height_mm


class Camera(Section):
    """A camera above the origin, looking down, focused on the part."""

    height_mm: Length = Field(
        800.0, description="height of the pupil above z = 0: the working distance, from the pupil"
    )
    focal_mm: Annotated[float, Field(gt=0, le=1e4)] | None = Field(
        None, description="focal length of the lens; none: sampling_mm and pupil_mm say enough"
    )
    f_number: Annotated[float, Field(ge=0.5, le=1000)] | None = Field(
        None, description="focal length over pupil; with focal_mm, pupil_mm follows"
    )
    pixel_um: Annotated[float, Field(ge=0.1, le=1000)] | None = Field(
        None, description="pitch of the sensor's pixels; with focal_mm, sampling_mm follows"
    )
    mtf50_lp_per_mm: Annotated[float, Field(ge=0.1, le=1e4)] | None = Field(
        None,
        description="frequency on the sensor, line pairs per mm, at which the lens has half its "
        "contrast; with pixel_um, blur_mm follows",
    )
    sampling_mm: float = Field(0.05, ge=1e-5, le=1e3, description="distance of two pixels on z = 0")
    pupil_mm: float = Field(3.0, ge=0, le=1e3, description="diameter of the lens pupil; 0: pinhole")
    blur_mm: float = Field(
        0.0,
        ge=0,
        le=1e3,
        description="standard deviation of the lens's spot, a Gaussian, on z = 0; 0: perfect",
    )
    focus_mm: Annotated[float, Field(gt=0, le=1e5)] | None = Field(
        None,
        description="distance from the pupil at which the camera is focused; what is nearer or "
        "farther is blurred by the pupil; none: on the part, everywhere",
    )
    columns: Annotated[int, Field(gt=0, le=1_000_000)] | None = Field(
        None, description="image width; none: the whole part"
    )
    rows: Annotated[int, Field(gt=0, le=1_000_000)] | None = Field(
        None, description="image height; none: the whole part"
    )
    subsampling: Literal["auto"] | Annotated[int, Field(ge=1, le=16)] = Field(
        "auto",
        description="n x n sub-rays per pixel, each with its own footprint; auto: as many as it "
        "takes where one footprint does not tell what the pixel sees",
    )
    vignetting: Literal["none", "cos4"] = Field("none", description="fall-off over the field")
    pose: Pose | None = Field(
        None, description="of the camera, turned about its pupil; sampling_mm is across its axis"
    )

    @model_validator(mode="after")
    def _of_data_sheet(self) -> Camera:
        """Resolve what follows from the data sheet, and refuse what contradicts it."""
        if self.focal_mm is not None and self.focal_mm >= self.height_mm:
            raise ValueError(
                f"focal_mm = {self.focal_mm:g} makes no image of a part at height_mm = "
                f"{self.height_mm:g}: the camera must be further away than its focal length"
            )
        if self.focal_mm is not None and self.focus_mm and self.focal_mm >= self.focus_mm:
            raise ValueError(
                f"focal_mm = {self.focal_mm:g} cannot be focused at focus_mm = {self.focus_mm:g}: "
                f"no lens is on what is nearer than its focal length"
            )
        for key in self.following:
            value = self._following(key)
            sources = ", ".join(f"{name} = {getattr(self, name):g}" for name in FOLLOWS[key])
            low, high = (0.0, 1e3) if key != "sampling_mm" else (1e-5, 1e3)
            if not low <= value <= high:
                raise ValueError(f"{sources} make {key} = {value:g}; {low:g} to {high:g} is taken")
            given = getattr(self, key)
            if key in self.model_fields_set and abs(given - value) > _SAME * value:
                raise ValueError(
                    f"{key} = {given:g} contradicts {sources}, from which {value:.6g} follows: "
                    f"leave {key} out, or one of the others"
                )
            self.__dict__[key] = value  # frozen for everyone but validation
            self.model_fields_set.discard(key)
        return self

    @property
    def following(self) -> tuple[str, ...]:
        """Keys that follow from others of the data sheet."""
        return tuple(
            key
            for key, sources in FOLLOWS.items()
            if all(getattr(self, name) is not None for name in sources)
        )

    def _following(self, key: str) -> float:
        focal, pixel = self.focal_mm or 0.0, self.pixel_um or 0.0
        if key == "sampling_mm":
            return sampling_mm(focal, pixel, self.height_mm, self.focus_mm)
        if key == "pupil_mm":
            return focal / (self.f_number or 1.0)
        return blur_um(self.mtf50_lp_per_mm or 1.0) / pixel * self.sampling_mm

    @property
    def off_focus(self) -> float:
        """How far a pupil's points look apart on z = 0, over their own distance: 0 in focus."""
        return 0.0 if self.focus_mm is None else 1 - self.height_mm / self.focus_mm

    @property
    def spotted(self) -> bool:
        """Whether pixels look at spots wider than themselves, be it where the part is not flat."""
        return self.blur_mm > 0 or (self.focus_mm is not None and self.pupil_mm > 0)

    @property
    def spot_side_mm(self) -> float:
        """Side of a square on z = 0 of the variance of where a pixel looks.

        Of the pixel itself, the lens's blur, and off focus the pupil's disc.
        """
        more = 12 * self.blur_mm**2 + 0.75 * (self.off_focus * self.pupil_mm) ** 2
        return math.sqrt(self.sampling_mm**2 + more) if more else self.sampling_mm

    @property
    def spread(self) -> tuple[float, float]:
        """How much further than the pixel's own its sub-rays are from its centre, two shares.

        Of their distance in pixels and of its cube; see :func:`gpuspec.station.optics.spread`.
        """
        return self._spread(self.side)

    def _spread(self, n: int) -> tuple[float, float]:
        side = self.spot_side_mm
        if side == self.sampling_mm:
            return 0.0, 0.0
        disc = self.off_focus * self.pupil_mm / 2
        cumulant = -(self.sampling_mm**4) / 120 - disc**4 / 16
        first, third = spread(cumulant / (side**2 / 12) ** 2, n)
        return side / self.sampling_mm * first - 1, side / self.sampling_mm * third

    @property
    def reach_px(self) -> float:
        """How far from a pixel's centre its sub-rays look at most, in pixels; with auto of any."""
        first, third = self._spread(MOST_SIDES)
        return OUTERMOST * (1 + first + third * OUTERMOST**2)

    @property
    def beyond_px(self) -> int:
        """How many pixels beside a pixel its sub-rays look at; 0: none but its own."""
        return max(math.ceil(self.reach_px - 0.5), 0)

    @property
    def sub_ray_variance(self) -> float:
        """Variance along x and y of what a sub-ray averages the relief over, mm^2: of a square."""
        return (self.spot_side_mm / self.side) ** 2 / 12

    @property
    def lean(self) -> float:
        """How far from the pupil's centre, on average, are its points that look at a place.

        Over that place's distance from the pixel's centre on z = 0, in mm of pupil a mm: what
        regression gives of two random numbers of these variances.
        """
        return 0.75 * self.off_focus * self.pupil_mm**2 / self.spot_side_mm**2

    @property
    def least_lean(self) -> float:
        """What share of that counts where the part is nearly flat, see ``lean_of`` in the kernels.

        The square of what a place tells of the pupil's variance: nothing nearly in focus, all far
        from it.
        """
        return (self.lean * self.off_focus) ** 2

    @property
    def cut(self) -> int:
        """How pixels are cut: into n x n squares or, below 0, -n slices along a groove.

        With auto of one that is not refined. No file asks for slices: they are of lists, see
        :mod:`gpuspec.light.refinement`.
        """
        return 1 if self.subsampling == "auto" else self.subsampling

    @property
    def sliced(self) -> bool:
        """Whether pixels are in slices, a sub-ray each."""
        return self.cut < 0

    @property
    def side(self) -> int:
        """Sub-rays on each side of a pixel, or its slices."""
        return abs(self.cut)

    @property
    def sub_rays(self) -> int:
        """Sub-rays of a pixel; with auto of one that is not refined."""
        return self.side if self.sliced else self.side**2


class Sensor(Section):
    """The sensor, in the words of EMVA 1288."""

    bit_depth: Literal[8, 10, 12, 16] = Field(8, description="bits per pixel")
    exposure: float = Field(
        4.0,
        gt=0,
        le=1e4,
        description="signal of a fully luminous footprint over saturation; > 1: the paper's way",
    )
    saturation_e: float = Field(10_000.0, gt=0, le=1e7, description="saturation capacity")
    read_noise_e: float = Field(10.0, ge=0, le=1e5, description="rms temporal noise of the dark")
    dark_e: float = Field(0.0, ge=0, le=1e6, description="mean dark signal")
    prnu: float = Field(0.0, ge=0, lt=1, description="photo response non-uniformity, rms of gain 1")
    dsnu_e: float = Field(0.0, ge=0, le=1e5, description="dark signal non-uniformity, rms")
    black_level_dn: float = Field(0.0, ge=0, le=65535, description="grey level of no signal")
    light_e_per_s: Annotated[float, Field(gt=0, le=1e12)] | None = Field(
        None,
        description="electrons per second in a pixel that sees luminous stripes alone, from which "
        "the exposure time follows; none: it is not told",
    )
    noise: bool = Field(False, description="true: shot, read and quantisation noise")
    seed: Seed = Field(0, description="of the noise")

    @property
    def full_scale_dn(self) -> int:
        """Highest grey level, 2^bits - 1."""
        return int(2**self.bit_depth - 1)

    @property
    def gain_dn_per_e(self) -> float:
        """System gain K: saturation reaches full scale."""
        return (self.full_scale_dn - self.black_level_dn) / self.saturation_e

    @property
    def light_e(self) -> float:
        """Electrons that an image takes of a fully luminous footprint, saturated or not."""
        return self.exposure * self.saturation_e

    @property
    def exposure_s(self) -> float | None:
        """Exposure time of an image; None: the light's strength is not told."""
        return None if self.light_e_per_s is None else self.light_e / self.light_e_per_s


class Sequence(Section):
    """The images taken while the tunnel is translated, and what is made of them."""

    images: int = Field(40, ge=1, le=100_000, description="number of images K")
    step_mm: Length | None = Field(
        None, description="translation between two images; none: period / images"
    )
    fusion: Literal["mean", "max", "min", "std", "differential"] = Field(
        "mean", description="how the sequence becomes the aspect image; mean: the paper's"
    )
    lag: int = Field(1, ge=1, le=100_000, description="images between the pairs of differential")
    frame_rate_hz: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        None,
        description="most images per second that the camera takes, from which the cycle time "
        "follows; none: it is not told",
    )


class Segmentation(Section):
    """From the aspect image to blobs."""

    threshold: Literal["auto"] | Annotated[float, Field(ge=0, le=65535)] = Field(
        "auto", description="grey level above which a pixel is detected, or auto"
    )
    min_area_mm2: float = Field(0.0, ge=0, le=1e6, description="smaller blobs are dropped; 0: none")
    background_mm: Annotated[float, Field(gt=0, le=1e5)] | None = Field(
        None,
        description="side of the window whose median is the background that levels are above; "
        "a blurred rim is left out; none: one level for the whole part",
    )
    smoothing_mm: float = Field(
        0.0,
        ge=0,
        le=100,
        description="standard deviation of a Gaussian against noise, taken before the background; "
        "needs background_mm",
    )
    polarity: Literal["bright", "dark", "both"] = Field(
        "bright", description="which blobs are detected: those above the flawless level, or below"
    )


class ClassRule(Section):
    """A class of blobs; the first rule that holds names the blob. Bounds are [from, to)."""

    name: str = Field(min_length=1, max_length=60, description="of the class")
    area_min_mm2: float | None = Field(None, ge=0, description="least area")
    area_max_mm2: float | None = Field(None, ge=0, description="area below this")
    weight_min_dn: float | None = Field(None, ge=0, description="least net weight")
    weight_max_dn: float | None = Field(None, ge=0, description="net weight below this")
    elongation_min: float | None = Field(None, ge=0, description="least ratio of the axes")
    elongation_max: float | None = Field(None, ge=0, description="ratio of the axes below this")

    @model_validator(mode="after")
    def _holds_something(self) -> ClassRule:
        if self.name == "missed":
            raise ValueError('name = "missed" is kept for defects without a blob')
        for measure, unit in (("area", "_mm2"), ("weight", "_dn"), ("elongation", "")):
            ends = [f"{measure}_{end}{unit}" for end in ("min", "max")]
            low, high = (getattr(self, end) for end in ends)
            if low is not None and high is not None and low >= high:
                raise ValueError(f"{ends[0]} = {low:g} must be less than {ends[1]} = {high:g}")
        return self


class RejectRule(Section):
    """A reason to reject a part: too many blobs of a kind, or too large an area of them."""

    of: str | None = Field(None, max_length=60, description="class of the blobs; none: every class")
    area_min_mm2: float | None = Field(None, ge=0, description="blobs of at least this area")
    length_min_mm: float | None = Field(
        None, ge=0, description="blobs of at least this length, their major axis"
    )
    weight_min_dn: float | None = Field(None, ge=0, description="blobs of at least this net weight")
    count_max: Annotated[int, Field(ge=0, le=1_000_000)] | None = Field(
        None,
        description="most such blobs on an accepted part; none: 0, or any number beside an area",
    )
    total_area_max_mm2: float | None = Field(
        None, ge=0, description="largest area of all such blobs on an accepted part"
    )


def _leaves(table: dict[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{path}{key}.")
        else:
            yield path + key, value


def _flat(vary: Any) -> Any:
    """Take keys without quotes, of which TOML makes tables in tables."""
    if not isinstance(vary, dict):
        return vary
    flat: dict[str, Any] = {}
    for key, values in _leaves(vary):
        if key in flat:
            raise ValueError(f"{key} stands twice, with and without quotes; vary it once")
        flat[key] = values
    return flat


class Tolerance(Section):
    """By how much keys of a built station may be off: a choice of a sweep holds within them."""

    of: dict[str, Annotated[float, Field(gt=0, le=1e9)]] = Field(
        {},
        description='key = how far it may be off each way, e.g. "tunnel.luminous_mm" = 0.05; they '
        "may stand in [tolerance] itself",
    )

    @model_validator(mode="before")
    @classmethod
    def _own(cls, table: Any) -> Any:
        """Take keys in the section itself, with quotes or without."""
        if not isinstance(table, dict):
            return table
        own = {key: value for key, value in table.items() if key != "of"}
        inner = table.get("of", {})
        if not isinstance(inner, dict):
            return table
        return {"of": {**dict(_leaves(inner)), **dict(_leaves(own))}}


class Sweep(Section):
    """What `gpuspec sweep` varies; every other command leaves it alone."""

    parts: int = Field(
        1, ge=1, le=1000, description="random parts each design is tried on, from other seeds"
    )
    seeds: int = Field(1, ge=1, le=1000, description="draws of the sensor's noise on each part")
    vary: dict[str, str | float | list[float]] = Field(
        {},
        description='key = "FROM:TO:COUNT" or a list of values, e.g. '
        '"tunnel.luminous_mm" = "1:12:23"; a key with [1] in it in quotes',
    )

    _dotted = field_validator("vary", mode="before")(_flat)


class DataSet(Section):
    """What `gpuspec dataset` draws for each part; every other command leaves it alone."""

    seed: Seed = Field(0, description="of the parts, and of what is drawn for each")
    split: Annotated[
        tuple[Annotated[float, Field(ge=0, le=1)], ...],
        Field(min_length=3, max_length=3, strict=False),
    ] = Field((0.7, 0.15, 0.15), description="shares of the parts to train on, validate and test")
    vary: dict[str, str | float | list[str | bool | float]] = Field(
        {},
        description='key = [FROM, TO] or "FROM:TO", any number between them, or three or more '
        'values or "VALUE,VALUE", one of them, e.g. "sensor.exposure" = [2, 6]; a key with [1] in '
        "it in quotes",
    )

    _dotted = field_validator("vary", mode="before")(_flat)

    @field_validator("split")
    @classmethod
    def _whole(cls, split: tuple[float, ...]) -> tuple[float, ...]:
        if abs(sum(split) - 1) > _SAME:
            raise ValueError("must add up to 1")
        return split
