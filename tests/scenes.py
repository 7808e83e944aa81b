"""Stations for tests, and the same scenes as the oracle takes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle

from gpuspec.light.sources import structs
from gpuspec.station.sections import Pose
from gpuspec.station.station import Station

PIXEL_BYTES = 17
"""Of a light map of one sub-ray: four planes of floats and why a pixel is lost."""

# Pupil D, sigma, depth d (mm), exposure g, flawless median, maximum: the check values of the model,
# the pinhole's maxima after 262,144 rays per pixel.
TABLE = (
    (3.0, 0.25, 0.010, 1.0, 63.75, 63.75),
    (3.0, 0.25, 0.010, 4.0, 70.1, 118.1),
    (3.0, 0.10, 0.002, 4.0, 70.1, 120.6),
    (0.0, 0.25, 0.010, 4.0, 63.75, 118.0),
    (0.0, 0.15, 0.005, 4.0, 63.75, 134.6),
)


def check_station(
    pupil: float = 3.0,
    sigma: float = 0.25,
    depth: float = 0.010,
    exposure: float = 4.0,
    **changes: Any,
) -> Station:
    """The model's check scene: one dent seen by 32 x 32 pixels of 0.1 mm under a ceiling."""
    station = Station.from_dict(
        {
            "tunnel": {"height_mm": 150.0, "luminous_mm": 4.0, "dark_mm": 12.0},
            "camera": {
                "height_mm": 800.0, "sampling_mm": 0.1, "columns": 32, "rows": 32,
                "pupil_mm": pupil,
            },
            "sensor": {"exposure": exposure},
            "sequence": {"images": 40},
            "defects": [
                {
                    "kind": "dent", "x_mm": 0.03, "y_mm": -0.02, "diameter_mm": 4 * sigma,
                    "depth_um": depth * 1e3,
                }
            ],
        }
    )  # fmt: skip
    return station.replace(**changes)


SURFACES: dict[str, dict[str, Any]] = {
    "flat": {},
    "orientation only": {"part.crown_radius_x_mm": 35.0},
    "crowned": {
        "part.surface": "height", "part.crown_radius_x_mm": 300.0, "part.crown_radius_y_mm": 90.0,
    },
    "hollow": {
        "part.surface": "height", "part.crown_radius_y_mm": -30.0, "camera.height_mm": 200.0,
    },
    "wider than the part": {"camera.rows": 301, "camera.columns": 333},
}  # fmt: skip
"""Of a `part_with` defects."""


def part_with(defects: list[dict[str, Any]], sampling: float) -> Station:
    """A part of 60 x 50 mm under a low ceiling, where perspective and crowns count."""
    return Station.from_dict(
        {
            "part": {"length_mm": 60.0, "width_mm": 50.0},
            "tunnel": {"height_mm": 30.0},
            "camera": {"sampling_mm": sampling},
            "defects": defects,
        }
    )


def members(struct: str, records: Any) -> dict[str, Any]:
    """Records of a struct of `kernels/station.h`, (..., members), by its members' names."""
    values = np.moveaxis(np.asarray(records, np.float64), -1, 0)
    return dict(zip(structs()[struct], values, strict=True))


def oracle_scene(station: Station) -> oracle.Scene:
    """What the oracle must be told to judge a station with dents, bumps and scratches."""
    part, tunnel, camera, sensor = station.part, station.tunnel, station.camera, station.sensor
    rows, columns = station.shape
    grooves = []
    for defect in station.defects:
        if defect.kind == "scratch":
            points, size = defect.points_mm, defect.width_mm
        else:
            points, size = ((defect.x_mm, defect.y_mm),), defect.diameter_mm
        depth = defect.depth_um * (1e-3 if defect.kind == "bump" else -1e-3)
        grooves.append(oracle.Groove(points, size / 4, depth))
    return oracle.Scene(
        camera_height_mm=camera.height_mm,
        sampling_mm=camera.sampling_mm,
        rows=rows,
        columns=columns,
        pupil_mm=camera.pupil_mm,
        focus_mm=camera.focus_mm,
        blur_mm=camera.blur_mm,
        part_length_mm=part.length_mm,
        part_width_mm=part.width_mm,
        crown_radius_x_mm=part.crown_radius_x_mm,
        crown_radius_y_mm=part.crown_radius_y_mm,
        surface=part.surface,
        section=tunnel.section,
        tunnel_height_mm=tunnel.top_mm,
        tunnel_width_mm=tunnel.width_mm,
        tunnel_length_mm=tunnel.length_mm,
        opening_length_mm=tunnel.opening_length_mm,
        opening_width_mm=tunnel.opening_width_mm,
        luminous_mm=tunnel.luminous_mm,
        dark_mm=tunnel.dark_mm,
        dark_leak=tunnel.dark_leak,
        exposure=sensor.exposure,
        images=station.sequence.images,
        step_mm=station.sequence.step_mm,
        full_scale=sensor.full_scale_dn,
        roughness_rad=part.roughness_rad,
        vignetting=camera.vignetting,
        grooves=tuple(grooves),
        part_pose=_pose(part.pose),
        camera_pose=_pose(camera.pose),
    )


def _pose(pose: Pose | None) -> oracle.Pose:
    pose = pose or Pose()
    return oracle.Pose((pose.tilt_x_deg, pose.tilt_y_deg, pose.turn_deg), pose.shift_mm)
