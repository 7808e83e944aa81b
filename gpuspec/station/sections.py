"""The sections of a station file but its defects; every key with its unit.

Every default is gpuspec's own choice: the paper (Seulin, Merienne, Gorria) prints no camera
distance, stripe width or image count.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from gpuspec.shapes import Crown, Shape
from gpuspec.station.defects import Length, Section, Seed, Topography


class Part(Section):
    """The part: its outline, shape, relief and reflectance."""

    length_mm: Length = Field(
        200.0,
        description="along x, the direction in which the light moves; "
        "not given beside a relief: its map's",
    )
    width_mm: Length = Field(50.0, description="along y; not given beside a relief: its map's")
    crown_radius_x_mm: Annotated[float, Field(ge=-1e7, le=1e7)] | None = Field(
        None, description="radius of the crown along x, > 0 convex; none: flat"
    )
    crown_radius_y_mm: Annotated[float, Field(ge=-1e7, le=1e7)] | None = Field(
        None, description="radius of the crown along y, > 0 convex; none: flat"
    )
    surface: Literal["orientation", "height"] = Field(
        "orientation",
        description="orientation: the ray meets z = 0, only the normal carries the shape "
        "(the paper's); height: the ray meets the surface itself",
    )
    material: Literal[
        "ideal", "aluminium", "silver", "gold", "copper", "chromium", "nickel", "iron", "lacquer"
    ] = Field("ideal", description="Fresnel reflectance of this material; ideal: 1")
    roughness_rad: float = Field(
        0.0, ge=0, le=0.2, description="rms slope of micro-roughness; 0: the paper's mirror"
    )
    relief: Topography | None = Field(None, description="measured topography of the whole part")

    @property
    def shape(self) -> Shape:
        """Its shape without relief."""
        return Crown.of_radii(self.crown_radius_x_mm, self.crown_radius_y_mm)

    @property
    def height_range_mm(self) -> tuple[float, float]:
        """Lowest and highest point of the shape (without relief), in mm."""
        return self.shape.height_range(self.length_mm, self.width_mm)


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
    opening_length_mm: float = Field(
        0.0, ge=0, le=1e5, description="camera opening along x, above the origin; 0: none"
    )
    opening_width_mm: float = Field(0.0, ge=0, le=1e5, description="camera opening along y")

    @property
    def period_mm(self) -> float:
        """Period P = a + b of the stripes."""
        return self.luminous_mm + self.dark_mm

    @property
    def top_mm(self) -> float:
        """Height of the tunnel's highest point above z = 0."""
        return self.radius_mm or 0.0 if self.section == "arch" else self.height_mm


class Camera(Section):
    """A camera above the origin, looking down, focused on the part."""

    height_mm: Length = Field(800.0, description="height of the pupil above z = 0")
    sampling_mm: float = Field(0.05, ge=1e-5, le=1e3, description="distance of two pixels on z = 0")
    pupil_mm: float = Field(3.0, ge=0, le=1e3, description="diameter of the lens pupil; 0: pinhole")
    columns: Annotated[int, Field(gt=0, le=1_000_000)] | None = Field(
        None, description="image width; none: the whole part"
    )
    rows: Annotated[int, Field(gt=0, le=1_000_000)] | None = Field(
        None, description="image height; none: the whole part"
    )
    subsampling: int = Field(
        1, ge=1, le=16, description="n x n sub-rays per pixel, each with its own footprint"
    )
    vignetting: Literal["none", "cos4"] = Field("none", description="fall-off over the field")


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


class Segmentation(Section):
    """From the aspect image to blobs."""

    threshold: Literal["auto"] | Annotated[float, Field(ge=0, le=65535)] = Field(
        "auto", description="grey level above which a pixel is detected, or auto"
    )
    min_area_mm2: float = Field(0.0, ge=0, le=1e6, description="smaller blobs are dropped; 0: none")


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


def _leaves(table: dict[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{path}{key}.")
        else:
            yield path + key, value


class Sweep(Section):
    """What `gpuspec sweep` varies; every other command leaves it alone."""

    parts: int = Field(
        1, ge=1, le=1000, description="random parts each design is tried on, from other seeds"
    )
    vary: dict[str, str | float | list[float]] = Field(
        {},
        description='key = "FROM:TO:COUNT" or a list of values, e.g. '
        '"tunnel.luminous_mm" = "1:12:23"; a key with [1] in it in quotes',
    )

    @field_validator("vary", mode="before")
    @classmethod
    def _dotted(cls, vary: Any) -> Any:
        """Take keys without quotes, of which TOML makes tables in tables."""
        if not isinstance(vary, dict):
            return vary
        flat: dict[str, Any] = {}
        for key, values in _leaves(vary):
            if key in flat:
                raise ValueError(f"{key} stands twice, with and without quotes; vary it once")
            flat[key] = values
        return flat
