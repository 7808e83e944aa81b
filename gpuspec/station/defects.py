"""What is wrong with a part: dents, bumps, scratches, measured patches, random populations, edges.

Relief, with r the distance to the defect's centre or centre line: a Gaussian
z = -+d exp(-r^2 / 2 sigma^2), sigma a quarter of diameter or width. They stay mirrors.
"""

from __future__ import annotations

import sys
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_serializer,
    model_validator,
)

_LENGTH = {"gt": 0, "le": 1e5}
Length = Annotated[float, Field(**_LENGTH)]
Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
Depth = Annotated[float, Field(gt=0, le=1e4)]
Seed = Annotated[int, Field(ge=0, le=2**32 - 1)]
Points = Annotated[
    tuple[tuple[Coordinate, Coordinate], ...],
    Field(min_length=2, max_length=10_000, strict=False),
    BeforeValidator(
        lambda v: (
            tuple(tuple(p) if isinstance(p, list) else p for p in v) if isinstance(v, list) else v
        )
    ),
]
Pitch = Annotated[float, Field(gt=0, le=1e6)]


class Section(BaseModel):
    """Frozen values: no unknown key, no coercion, no NaN."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        ignored_types=(cached_property,),
    )


class Topography(Section):
    """A measured topography."""

    file: str = Field(
        min_length=1,
        description='topography file, relative to the station file; "polished": one made to try',
    )
    height_unit: Literal["m", "mm", "um", "nm"] | None = Field(
        None, description="of the file's heights, where it states none (.npy, .tif, text)"
    )
    height_scale: float = Field(
        1.0, gt=0, le=1e9, description="the file's heights times this, e.g. units per grey level"
    )
    pitch_um: Pitch | Annotated[tuple[Pitch, Pitch], Field(strict=False)] | None = Field(
        None, description="distance of two points, or [along x, along y], where the file has none"
    )
    outlier_um: float | None = Field(
        None,
        gt=0,
        le=1e6,
        description="points further than this from the median of the 5 x 5 around them count as "
        "missing; none: all are kept",
    )
    form_removed: Literal["none", "mean", "plane", "curvature"] = Field(
        "plane", description="least-squares form taken off: nothing, mean, plane or curvature"
    )
    smoothing_um: float = Field(
        0.0, ge=0, le=1e4, description="sigma of a Gaussian low-pass over the heights; 0: none"
    )
    zone_height_um: float | None = Field(
        None,
        gt=0,
        le=1e4,
        description="|relief| above this is a defect's zone; none: the map holds no known defect",
    )
    zone_file: str | None = Field(
        None, description="image of the zones instead (non-zero: defect), same shape as the map"
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _any_form(schema: dict[str, Any]) -> None:
    """Tell editors that a distribution may be a number or two, and what its table needs."""
    table = {key: schema.pop(key) for key in list(schema) if key not in ("title", "description")}
    table["required"] = []
    table["anyOf"] = [{"required": ["low", "high"]}, {"required": ["median", "spread"]}]
    number = {key: table["properties"]["low"][key] for key in ("exclusiveMinimum", "maximum")}
    number["type"] = "number"
    pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    schema["anyOf"] = [number, pair, table]


class Distribution(Section):
    """A number, [low, high] (uniform), or {median, spread, low, high} (log-normal, truncated)."""

    model_config = ConfigDict(json_schema_extra=_any_form)
    largest: ClassVar[float] = 1e5

    low: float = Field(gt=0, le=1e5, description="least value")
    high: float = Field(gt=0, le=1e5, description="greatest value")
    median: float | None = Field(None, gt=0, le=1e5, description="of the log-normal")
    spread: float | None = Field(None, gt=1, le=100, description="geometric standard deviation")

    @model_validator(mode="before")
    @classmethod
    def _short_forms(cls, value: Any) -> Any:
        if isinstance(value, (list, tuple)) and len(value) == 2:
            return {"low": value[0], "high": value[1]}
        if isinstance(value, dict):
            if ("median" in value) != ("spread" in value):
                raise ValueError("must have both median and spread (> 1) for a log-normal")
            return {**cls._ends(value.get("median"), value.get("spread")), **value}
        if not _is_number(value):
            raise ValueError("must be a number, [low, high] or {median, spread}")
        if not 0 < value <= cls.largest:
            raise ValueError(f"must be greater than 0 and at most {cls.largest:g}")
        return {"low": value, "high": value}

    @classmethod
    def _ends(cls, median: Any, spread: Any) -> dict[str, float]:
        """Ends of a log-normal that states none: four standard deviations, within the allowed."""
        if median is None:
            return {}
        if not (_is_number(median) and _is_number(spread)) or not (
            0 < median <= cls.largest and 1 < spread <= 100
        ):
            return {"low": 1.0, "high": 1.0}  # median or spread is refused, not what follows
        low, high = median / spread**4, median * spread**4
        return {"low": max(low, sys.float_info.min), "high": min(high, cls.largest)}

    @model_validator(mode="after")
    def _ordered(self) -> Distribution:
        if self.low > self.high:
            raise ValueError(f"low = {self.low:g} must not exceed high = {self.high:g}")
        return self

    @model_serializer
    def _short(self) -> Any:
        if self.median is not None:
            return {name: getattr(self, name) for name in ("median", "spread", "low", "high")}
        return self.low if self.low == self.high else [self.low, self.high]


class Depths(Distribution):
    """A distribution of depths: a number, [low, high], or {median, spread, low, high}."""

    largest: ClassVar[float] = 1e4

    low: float = Field(gt=0, le=1e4, description="least value")
    high: float = Field(gt=0, le=1e4, description="greatest value")
    median: float | None = Field(None, gt=0, le=1e4, description="of the log-normal")


class Spot(Section):
    """A dent or a bump, Gaussian: sigma = diameter / 4; its zone reaches 2 sigma."""

    kind: Literal["dent", "bump"] = Field(description="dent: down; bump: up")
    x_mm: Coordinate = Field(description="centre")
    y_mm: Coordinate = Field(description="centre")
    diameter_mm: Length = Field(description="of its zone")
    depth_um: Depth = Field(description="depth of a dent, height of a bump")


class Scratch(Section):
    """A groove of Gaussian section along a polyline with rounded ends: sigma = width / 4."""

    kind: Literal["scratch"] = Field(description="scratch")
    points_mm: Points = Field(description="[[x, y], ...] of the centre line")
    width_mm: Length = Field(description="of its zone")
    depth_um: Depth = Field(description="of the groove")


class Patch(Topography):
    """A measured defect: a piece of topography laid on the part."""

    kind: Literal["measured"] = Field(description="measured")
    x_mm: Coordinate = Field(description="centre")
    y_mm: Coordinate = Field(description="centre")
    taper: float = Field(
        0.1, ge=0, le=0.5, description="share of each side over which the relief fades to zero"
    )


class EdgeDefect(Section):
    """A chip or a burr on the part's edge: half an ellipse into the part, or out of it."""

    kind: Literal["chip", "burr"] = Field(
        description="chip: a piece of the part is missing; burr: there is more than the part"
    )
    side: Literal["left", "right", "bottom", "top"] = Field(
        description="edge of the part, as its picture shows it: x to the right, y up"
    )
    at_mm: Coordinate = Field(description="place along this edge, from its middle")
    width_mm: Length = Field(description="along the edge")
    depth_mm: Length = Field(description="across it, where it is deepest")


Defect = Annotated[Spot | Scratch | Patch, Field(discriminator="kind")]


class _Population(Section):
    count: Annotated[int, Field(gt=0, le=1_000_000)] | None = Field(
        None, description="number of defects; or give density_per_cm2"
    )
    density_per_cm2: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        None, description="defects per square centimetre, instead of count"
    )
    seed: Seed = Field(0, description="the same seed gives the same part everywhere")
    spacing_mm: float = Field(0.0, ge=0, le=1e5, description="least distance between two zones")
    depth_um: Depths = Field(description="depth or height")

    @model_validator(mode="after")
    def _one_amount(self) -> _Population:
        if (self.count is None) == (self.density_per_cm2 is None):
            raise ValueError("give either count or density_per_cm2")
        return self


class SpotPopulation(_Population):
    """Dents or bumps at random places."""

    kind: Literal["dent", "bump"] = Field(description="dent or bump")
    diameter_mm: Distribution = Field(description="diameter of the zones")


class ScratchPopulation(_Population):
    """Scratches at random places, in random directions."""

    kind: Literal["scratch"] = Field(description="scratch")
    width_mm: Distribution = Field(description="width of the zones")
    length_mm: Distribution = Field(description="length of the centre line")
    vertices: int = Field(3, ge=2, le=100, description="points of the centre line")
    bend_rad: float = Field(0.3, ge=0, le=3.0, description="largest turn at an inner point")


Population = Annotated[SpotPopulation | ScratchPopulation, Field(discriminator="kind")]
