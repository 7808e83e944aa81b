"""What of a chosen design can move: the part's pose, the tunnel, the camera.

Each is a station of its own. The part moves with its defects and its shape; where it leaves the
view, or the view leaves it, nothing is seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Literal

from gpuspec.part.placement import place
from gpuspec.station.defects import Defect
from gpuspec.station.optics import NO_DATA_SHEET
from gpuspec.station.sections import Pose
from gpuspec.station.station import Station

Moved = Callable[[Station, float], Station]


def frozen(station: Station) -> Station:
    """Return the station with its populations placed: the part keeps them as it moves."""
    return _with_defects(station, place(station))


def movements() -> Iterator[tuple[str, str, str, Moved]]:
    """Yield what of a station can be moved: name, unit, which reach it has, and how."""
    yield "part along x", "mm", "offset", partial(posed, body="part", key="shift_x_mm")
    yield "part along y", "mm", "offset", partial(posed, body="part", key="shift_y_mm")
    yield "part up", "mm", "offset", partial(posed, body="part", key="shift_z_mm")
    yield "part about x", "rad", "tilt", partial(posed, body="part", key="tilt_x_deg")
    yield "part about y", "rad", "tilt", partial(posed, body="part", key="tilt_y_deg")
    yield "part about z", "rad", "rotation", partial(posed, body="part", key="turn_deg")
    yield "tunnel up", "mm", "height", tunnel_raised
    yield "camera up", "mm", "height", camera_raised
    yield "camera about x", "rad", "camera tilt", partial(posed, body="camera", key="tilt_x_deg")
    yield "camera about y", "rad", "camera tilt", partial(posed, body="camera", key="tilt_y_deg")


def posed(station: Station, by: float, body: Literal["part", "camera"], key: str) -> Station:
    """Move the part or the camera by more than its pose has.

    Parameters
    ----------
    station : Station
    by : float
        In mm, or in radians of what is turned.
    body : str
    key : str
        Of its pose.
    """
    pose = getattr(station, body).pose or Pose()
    more = math.degrees(by) if key.endswith("_deg") else by
    return station.replace(**{f"{body}.pose.{key}": getattr(pose, key) + more})


def tunnel_raised(station: Station, by_mm: float) -> Station:
    """Raise the tunnel; an arch gets a larger radius.

    Parameters
    ----------
    station : Station
    by_mm : float
        Negative: lowered.
    """
    key = "radius_mm" if station.tunnel.section == "arch" else "height_mm"
    return station.replace(**{f"tunnel.{key}": station.tunnel.top_mm + by_mm})


def camera_raised(station: Station, by_mm: float) -> Station:
    """Raise the camera, its pixels and their angles kept: it then sees more of the part.

    Parameters as :func:`tunnel_raised`.
    """
    rows, columns = station.shape
    height = station.camera.height_mm + by_mm
    return station.replace(
        **{
            **NO_DATA_SHEET,
            "camera.height_mm": height,
            "camera.sampling_mm": station.camera.sampling_mm * height / station.camera.height_mm,
            "camera.rows": rows,
            "camera.columns": columns,
        }
    )


def _with_defects(station: Station, defects: tuple[Defect, ...]) -> Station:
    known = [defect.model_dump(exclude_none=True) for defect in defects]
    return station.replace(defects=known, populations=[])
