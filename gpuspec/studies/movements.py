"""What of a chosen design can move: the part's pose, the tunnel, the camera.

Each is a station of its own. The model states no tilt of the part about x or y, and a measured
topography does not turn: neither is moved. A crown stays where it is when the part is moved aside
or turned, and what comes into view beyond the part's end is flawless.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from gpuspec.part.placement import place
from gpuspec.station.defects import Defect, Patch, Scratch
from gpuspec.station.station import Station

Moved = Callable[[Station, float], Station]


def frozen(station: Station) -> Station:
    """Return the station with its populations placed: defects that can be moved, one by one."""
    return _with_defects(station, place(station))


def movements(station: Station) -> Iterator[tuple[str, str, str, Moved]]:
    """Yield what of a station can be moved: name, unit, which reach it has, and how."""
    defects = station.defects
    if station.part.relief is None:  # which lies still
        yield "part along x", "mm", "offset", lambda s, v: shifted(s, v, 0.0)
        yield "part along y", "mm", "offset", lambda s, v: shifted(s, 0.0, v)
        if not any(isinstance(defect, Patch) for defect in defects):
            yield "part about z", "rad", "rotation", turned
    if station.tunnel.section != "arch":  # whose axis is in z = 0
        yield "part up", "mm", "offset", lambda s, v: camera_raised(tunnel_raised(s, -v), -v)
    yield "tunnel up", "mm", "height", tunnel_raised
    yield "camera up", "mm", "height", camera_raised


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

    Parameters
    ----------
    station : Station
    by_mm : float
        Negative: lowered.
    """
    rows, columns = station.shape
    height = station.camera.height_mm + by_mm
    return station.replace(
        **{
            "camera.height_mm": height,
            "camera.sampling_mm": station.camera.sampling_mm * height / station.camera.height_mm,
            "camera.rows": rows,
            "camera.columns": columns,
        }
    )


def shifted(station: Station, x_mm: float, y_mm: float) -> Station:
    """Move the part's defects aside; what comes into view beyond the part's end is flawless.

    Parameters
    ----------
    station : Station
    x_mm, y_mm : float
    """
    return _moved(station, lambda x, y: (x + x_mm, y + y_mm))


def turned(station: Station, angle_rad: float) -> Station:
    """Turn the part's defects about z, anticlockwise seen by the camera.

    Parameters
    ----------
    station : Station
    angle_rad : float
    """
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return _moved(station, lambda x, y: (cosine * x - sine * y, sine * x + cosine * y))


def _moved(station: Station, to: Callable[[float, float], tuple[float, float]]) -> Station:
    """Move every defect; the view stays, and the part reaches as far as its defects do."""
    moved: list[Defect] = []
    for defect in station.defects:
        if isinstance(defect, Scratch):
            points = tuple(to(x, y) for x, y in defect.points_mm)
            moved.append(defect.model_copy(update={"points_mm": points}))
        else:
            x, y = to(defect.x_mm, defect.y_mm)
            moved.append(defect.model_copy(update={"x_mm": x, "y_mm": y}))
    (rows, columns), part = station.shape, station.part
    half = part.length_mm / 2, part.width_mm / 2
    corners = [to(x, y) for x in (-half[0], half[0]) for y in (-half[1], half[1])]
    fixed = station.replace(
        **{
            "camera.rows": rows, "camera.columns": columns,
            "part.length_mm": 2 * max(half[0], *(abs(x) for x, _ in corners)),
            "part.width_mm": 2 * max(half[1], *(abs(y) for _, y in corners)),
        }
    )  # fmt: skip
    return _with_defects(fixed, tuple(moved))


def _with_defects(station: Station, defects: tuple[Defect, ...]) -> Station:
    known = [defect.model_dump(exclude_none=True) for defect in defects]
    return station.replace(defects=known, populations=[])
