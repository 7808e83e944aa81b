"""What a station's camera sees: sampling, field, pupil, depth of field, blur, in numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpuspec.part.pose import Frames
from gpuspec.part.shape import shape_of
from gpuspec.part.view import seen_at, surface_points
from gpuspec.station.optics import (
    FOLLOWS,
    depth_of_field_mm,
    diffraction_mtf50,
    magnification,
)
from gpuspec.station.station import Station

_PLACES = 17  # rows and columns of the image, and of a posed part, at which its distance is asked


@dataclass(frozen=True)
class Fact:
    """Something that follows of a camera.

    Attributes
    ----------
    name, value : str
        What it is, and its value with its unit.
    source : str
        What it follows from, or what it means.
    """

    name: str
    value: str
    source: str


def view_mm(station: Station) -> tuple[float, float]:
    """Return the sides of the camera's cone of sight where it passes the tunnel's top.

    It leads from the whole pupil to what of the part is in the image.

    Parameters
    ----------
    station : Station

    Returns
    -------
    tuple of float
        Along x and along y, mm.
    """
    camera, part = station.camera, station.part
    if station.posed:
        return _posed_view_mm(station)
    share = station.tunnel.top_mm / camera.height_mm
    rows, columns = station.shape
    seen = (
        min(part.length_mm, columns * camera.sampling_mm),
        min(part.width_mm, rows * camera.sampling_mm),
    )
    return tuple((1 - share) * side + share * camera.pupil_mm for side in seen)  # type: ignore[return-value]


def depth_mm(station: Station) -> tuple[float, float, float]:
    """Return how near and how far from the pupil the part's shape is, and its widest spot on it.

    Parameters
    ----------
    station : Station

    Returns
    -------
    nearest, farthest : float
        Along the optical axis, mm.
    spot : float
        Diameter of the image of a point of it, measured on the part, mm, where the lens is focused
        at ``camera.focus_mm``, or on z = 0.

    Examples
    --------
    >>> from gpuspec.simulation.view import depth_mm
    >>> camera = {"height_mm": 600.0, "focus_mm": 500.0, "pupil_mm": 3.0}
    >>> nearest, farthest, spot = depth_mm(gpuspec.Station(camera=camera))
    >>> nearest, farthest, round(spot, 3)
    (600.0, 600.0, 0.6)
    """
    camera, part = station.camera, station.part
    low, high = part.height_range_mm if part.surface == "height" else (0.0, 0.0)
    ends = camera.height_mm - high, camera.height_mm - low
    if station.posed:
        ends = _posed_depth_mm(station)
    focus = camera.height_mm if camera.focus_mm is None else camera.focus_mm
    return (*ends, camera.pupil_mm * max(abs(end / focus - 1) for end in ends))


def _posed_depth_mm(station: Station) -> tuple[float, float]:
    """Return how near and how far from the pupil what is seen of a posed station's part is."""
    part = station.part
    rows, columns = station.shape
    half = np.array([part.length_mm, part.width_mm]) / 2
    # What is seen ends where the image does, or where the part does.
    row, column = (np.linspace(0, size - 1, _PLACES) for size in (rows, columns))
    points = np.stack(surface_points(station, column, row[:, None]), axis=-1)
    seen = points[(np.abs(points) <= half).all(axis=-1)]
    x, y = (np.linspace(-side, side, _PLACES) for side in half)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    at = seen_at(points, station)
    inside = points[((at >= 0) & (at <= [columns, rows])).all(axis=-1)]
    found = np.concatenate([seen, inside])
    x, y = (found if len(found) else np.zeros((1, 2))).T
    z = shape_of(station).height(x, y) if part.surface == "height" else np.zeros(x.shape)
    nearer = Frames.of(station).in_camera(np.stack([x, y, z], axis=-1))[:, 2]
    depth = station.camera.height_mm - nearer
    return float(depth.min()), float(depth.max())


def _posed_view_mm(station: Station) -> tuple[float, float]:
    """Return the same of a posed station: of what is seen, the part or less."""
    camera, frames = station.camera, Frames.of(station)
    size = station.part.length_mm, station.part.width_mm
    image = np.array(station.shape[::-1]) * camera.sampling_mm
    x, y = (np.array([-0.5, 0.5]) * side for side in image)
    start, look = frames.rays(station, x[None, :], y[:, None])
    seen = (start - start[2] / look[2] * look).reshape(3, -1).T
    whole = np.stack(np.meshgrid(*(np.array([-0.5, 0.5]) * side for side in size), [0.0]), -1)
    found = []
    for points in (seen, whole.reshape(-1, 3)):
        ends, eye = frames.in_station(points), frames.in_station(frames.pupil(station))
        share = (station.tunnel.top_mm - ends[:, 2:]) / (eye[2] - ends[:, 2:])
        at = ends + share * (eye - ends)
        found.append(np.ptp(at[:, :2], axis=0) + share.max() * camera.pupil_mm)
    across, along = np.minimum(*found).tolist()
    return across, along


def facts(station: Station) -> tuple[Fact, ...]:
    """Return what the camera of a station sees.

    Parameters
    ----------
    station : Station

    Examples
    --------
    >>> from gpuspec.simulation.view import facts
    >>> camera = {"focal_mm": 25.0, "f_number": 8.0, "pixel_um": 3.45, "height_mm": 525.0}
    >>> for fact in facts(gpuspec.Station(camera=camera))[:3]:
    ...     print(f"{fact.name}: {fact.value}")
    sampling: 0.069 mm per pixel
    pupil: 3.12 mm
    field: 200 x 50.03 mm, 2899 x 725 pixels
    """
    camera, part = station.camera, station.part
    rows, columns = station.shape
    p = camera.sampling_mm
    found = [
        Fact("sampling", f"{p:.4g} mm per pixel", _source(station, "sampling_mm")),
        Fact("pupil", f"{camera.pupil_mm:.3g} mm", _source(station, "pupil_mm")),
        Fact(
            "field",
            f"{columns * p:.4g} x {rows * p:.4g} mm, {columns} x {rows} pixels",
            f"the part is {part.length_mm:g} x {part.width_mm:g} mm",
        ),
    ]
    if camera.focal_mm and camera.pixel_um:
        factor = camera.pixel_um / 1e3 / p
        chip = columns * camera.pixel_um / 1e3, rows * camera.pixel_um / 1e3
        found.append(Fact("magnification", f"{factor:.4g}", "size of the image over the part's"))
        found.append(Fact("on the sensor", f"{chip[0]:.3g} x {chip[1]:.3g} mm", "of the image"))
    focus = camera.focus_mm or camera.height_mm
    near, far = depth_of_field_mm(camera.pupil_mm, focus, p * focus / camera.height_mm)
    behind = "endless" if math.isinf(far) else f"{far:.3g}"
    found.append(
        Fact("depth of field", f"{near:.3g} mm above, {behind} below",
             "the plane in focus: a spot within one pixel")
    )  # fmt: skip
    if camera.focus_mm is not None:
        off = camera.height_mm - camera.focus_mm
        where = (
            "at z = 0" if not off else f"{abs(off):.4g} mm {'above' if off > 0 else 'below'} z = 0"
        )
        found.append(Fact("plane in focus", where, "from height_mm and focus_mm"))
        spot = depth_mm(station)[2]
        found.append(
            Fact("defocus", f"{spot:.3g} mm, {spot / p:.3g} pixels",
                 "diameter of a point's image on the part, at most")
        )  # fmt: skip
    if camera.blur_mm:
        found.append(
            Fact("blur", f"{camera.blur_mm:.3g} mm rms, {camera.blur_mm / p:.3g} pixels",
                 _source(station, "blur_mm"))
        )  # fmt: skip
    if camera.f_number and camera.focal_mm:
        nm = station.tunnel.wavelength_nm
        limit = diffraction_mtf50(camera.f_number, magnification(camera.focal_mm, focus), nm)
        found.append(
            Fact("diffraction", f"{limit:.3g} lp/mm",
                 f"where a perfect lens has half its contrast, at {nm:g} nm")
        )  # fmt: skip
    x, y = view_mm(station)
    found.append(Fact("cone of sight", f"{x:.3g} x {y:.3g} mm", "where it passes the tunnel's top"))
    tunnel = station.tunnel
    size = f"{tunnel.opening_length_mm:g} x {tunnel.opening_width_mm:g} mm"
    fits = tunnel.opening_length_mm >= x and tunnel.opening_width_mm >= y
    found.append(
        Fact("opening", size, f"the camera {'sees' if fits else 'does not see all'} through it")
        if tunnel.opening_length_mm
        else Fact("opening", "none", "the tunnel is transparent to the camera")
    )
    return tuple(found)


def _source(station: Station, key: str) -> str:
    if key not in station.camera.following:
        return f"camera.{key}"
    values = (f"{name} = {getattr(station.camera, name):g}" for name in FOLLOWS[key])
    return "from " + ", ".join(values)
