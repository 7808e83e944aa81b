"""The station as the kernels see it: the structs of `kernels/station.h`, filled by name."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpuspec.light.constants import HARMONICS, SECTIONS
from gpuspec.light.diffuse import diffuse_share
from gpuspec.light.profiles import harmonics
from gpuspec.light.sources import structs
from gpuspec.part.edges import Edges
from gpuspec.part.grooves import Grooves, averaged
from gpuspec.part.maps import TopographyMap
from gpuspec.part.marches import MARCH_STEPS, March
from gpuspec.part.pose import Frames
from gpuspec.part.relief import Relief
from gpuspec.part.view import pixel_position
from gpuspec.shapes import Sphere
from gpuspec.station.materials import optical_constants
from gpuspec.station.sections import Pose, Tunnel
from gpuspec.station.station import Station

_END = 16  # points after which the spline forgets what follows: 0.27^16 = 7e-10


def packed(struct: str, **members: ArrayLike) -> NDArray[np.float32]:
    """Return records of a struct of `kernels/station.h`.

    Parameters
    ----------
    struct : str
        Its name.
    members : array_like
        Values of every member by its name, but of those named `unused`; of one shape.

    Returns
    -------
    ndarray of float32, shape (..., members of the struct)
        The bytes as the device reads them.

    Raises
    ------
    TypeError
        If a member is missing, or none of the struct's.
    """
    names, needed = _members(struct)
    if members.keys() != needed:
        raise TypeError(f"{struct}: its members are {names}, not {tuple(members)}")
    first = next(iter(members.values()))
    nothing = np.zeros_like(first) if isinstance(first, np.ndarray) else 0.0
    values = np.array([members.get(name, nothing) for name in names], np.float32)
    return np.ascontiguousarray(values.T)


@cache
def _members(struct: str) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return all members of a struct in order, and those that need a value."""
    names = structs()[struct]
    return names, frozenset(name for name in names if not name.startswith("unused"))


def geometry_block(station: Station, march: March | None = None) -> NDArray[np.float32]:
    """Return the struct ``Geometry``: everything a light map depends on but the relief.

    Parameters
    ----------
    station : Station
    march : March, optional
        How rays are followed over the part; None: none meets it twice.

    Returns
    -------
    ndarray of float32, shape (56,)
        Lengths in mm.
    """
    part, tunnel, camera = station.part, station.tunnel, station.camera
    rows, columns = station.shape
    # A device knows crown and sphere, by their curvatures at the top.
    curve_xx, _, curve_yy = part.shape.curvature(0.0, 0.0)
    refractive_index, extinction = optical_constants(part.material, tunnel.wavelength_nm)
    return packed(
        "Geometry",
        camera_height=camera.height_mm,
        pupil=camera.pupil_mm,
        sampling=camera.sampling_mm,
        subsampling=camera.side,
        columns=columns,
        rows=rows,
        rises=part.surface == "height",
        vignetting=camera.vignetting == "cos4",
        half_length=part.length_mm / 2,
        half_width=part.width_mm / 2,
        curvature_x=-curve_xx,
        curvature_y=-curve_yy,
        section=SECTIONS[tunnel.section],
        tunnel_top=tunnel.top_mm,
        tunnel_half_width=(tunnel.width_mm or 0) / 2,
        tunnel_half_length=tunnel.length_mm / 2,
        opening_half_length=tunnel.opening_length_mm / 2,
        opening_half_width=tunnel.opening_width_mm / 2,
        roughness=part.roughness_rad,
        refractive_index=refractive_index,
        extinction=extinction,
        spherical=isinstance(part.shape, Sphere),
        focus=(camera.focus_mm or 0) if camera.pupil_mm else 0,
        blur=camera.blur_mm,
        spot=camera.spot_side_mm,
        widening=camera.spread[0],
        warp=camera.spread[1],
        lean=camera.lean,
        least_lean=camera.least_lean,
        march_steps=MARCH_STEPS if march else 0,
        march_slack=march.slack_mm if march else 0,
        highest=march.highest_mm if march else 0,
        **_frames(part.pose, camera.pose, camera.height_mm),
    )


@lru_cache(maxsize=64)
def _frames(part: Pose | None, camera: Pose | None, height_mm: float) -> dict[str, float]:
    """Return the members of ``Geometry`` that are the poses of camera and part."""
    frames = Frames.between(part, camera, height_mm)
    members: dict[str, float] = {}
    view = frames.view - np.diag([1.0, 1.0, 0.0])  # what is small of a small pose
    for name, axes, middle in (
        ("view", view, frames.middle), ("pose", frames.turn, frames.origin)
    ):  # fmt: skip
        for row, place, axis in zip(axes, middle, "xyz", strict=True):
            members |= {f"{name}_{axis}{of}": value for of, value in zip("xyz", row, strict=True)}
            members[f"{name}_{axis}"] = place
    return members


def differential_pairs(station: Station) -> int:
    """Return the number of pairs of the differential fusion.

    Pairs wrap around where the shifts fill whole periods; else the last images begin none.
    """
    sequence = station.sequence
    if station.distinct_shifts:
        return sequence.images
    return max(sequence.images - sequence.lag, 0)


def design_block(station: Station) -> NDArray[np.float32]:
    """Return the struct ``Design``: light, sequence and sensor, which never retrace a light map.

    Returns
    -------
    ndarray of float32, shape (56,)
        Lengths in mm, signals in electrons and DN.
    """
    tunnel, sensor, sequence = station.tunnel, station.sensor, station.sequence
    return packed(
        "Design",
        luminous_share=tunnel.luminous_mm / tunnel.period_mm,
        periods_per_mm=1 / tunnel.period_mm,
        dark_leak=tunnel.dark_leak,
        diffuse=diffuse_share(station),
        images=sequence.images,
        step=station.step_mm / tunnel.period_mm,
        distinct_shifts=station.distinct_shifts or 0,
        lag=sequence.lag,
        pairs=differential_pairs(station),
        exposure=sensor.exposure,
        full_scale=sensor.full_scale_dn,
        saturation=sensor.saturation_e,
        read_noise=sensor.read_noise_e,
        dark_signal=sensor.dark_e,
        dsnu=sensor.dsnu_e,
        prnu=sensor.prnu,
        black_level=sensor.black_level_dn,
        noise=sensor.noise,
        seed_low=sensor.seed & 0xFFFF,
        seed_high=sensor.seed >> 16,
        **_profile(tunnel),
    )


def _profile(tunnel: Tunnel) -> dict[str, float]:
    """Return the members of ``Design`` that tell the profile of a light that is no stripes."""
    return _STRIPES if tunnel.is_striped else _harmonic(harmonics(tunnel))


def _harmonic(own: NDArray[np.complex128]) -> dict[str, float]:
    """Return the members for amplitudes from the mean on."""
    found = np.zeros(HARMONICS + 1, complex)
    found[: len(own)] = own
    members = {"harmonics": float(len(own) - 1), "mean_luminance": float(found[0].real)}
    for order, amplitude in enumerate(found[1:], 1):
        members |= {f"cosine_{order}": amplitude.real, f"sine_{order}": amplitude.imag}
    return members


_STRIPES = _harmonic(np.zeros(1, complex))


def map_records(maps: tuple[TopographyMap, ...], station: Station) -> NDArray[np.float32]:
    """Return the structs ``Map`` of `kernels/station.h`.

    Parameters
    ----------
    maps : tuple of TopographyMap, n of them
        Laid on the part.
    station : Station
        Its sampling and image shape are used.

    Returns
    -------
    ndarray of float32, shape (n, 12)
    """
    start = pixel_position(np.array([m.corner_mm for m in maps]).reshape(-1, 2), station)
    points = np.array([m.heights_mm.shape[::-1] for m in maps], int).reshape(-1, 2)
    pitch = np.array([m.pitch_mm for m in maps]).reshape(-1, 2)
    entries = (points + 2).prod(axis=1)
    first = np.cumsum(entries) - entries
    whole = np.floor(start)
    fraction = start - whole
    return packed(
        "Map",
        column=whole[:, 0],
        row=whole[:, 1],
        column_fraction=fraction[:, 0],
        row_fraction=fraction[:, 1],
        points_x=points[:, 0],
        points_y=points[:, 1],
        first_low=first & 0xFFFF,
        first_high=first >> 16,
        points_per_mm_x=1 / pitch[:, 0],
        points_per_mm_y=1 / pitch[:, 1],
    )


def coefficients(maps: tuple[TopographyMap, ...]) -> NDArray[np.float32]:
    """Return the cubic B-spline coefficients of all maps, one after another.

    Each map has one more coefficient on each side than it has points, row by row: point (j, i) is
    entry (j + 1, i + 1). Heights mirrored through their end points give the spline natural ends.

    Returns
    -------
    ndarray of float32, shape (sum of (ny + 2) (nx + 2),)
    """
    if not maps:
        return np.zeros(0, np.float32)
    from scipy import ndimage  # slow to import

    parts = []
    for m in maps:
        extended = np.pad(m.heights_mm, _END, mode="reflect", reflect_type="odd")
        spline = ndimage.spline_filter(extended, order=3, mode="mirror")
        inner = slice(_END - 1, 1 - _END)
        parts.append(spline[inner, inner].astype(np.float32).ravel())
    return np.concatenate(parts)


def groove_records(grooves: Grooves, station: Station) -> NDArray[np.float32]:
    """Return the structs ``Groove`` of `kernels/station.h`, as the pixels average them.

    Parameters
    ----------
    grooves : Grooves
        S pieces.
    station : Station
        Its sampling and image shape are used.

    Returns
    -------
    ndarray of float32, shape (S, 12)
    """
    grooves = averaged(grooves, station)
    start = pixel_position(grooves.ends[:, :2], station)
    whole = np.floor(start)
    fraction = start - whole
    course = grooves.ends[:, 2:] - grooves.ends[:, :2]
    length = np.hypot(course[:, 0], course[:, 1])
    inverse = np.divide(1, length, out=np.zeros_like(length), where=length > 0)
    return packed(
        "Groove",
        column=whole[:, 0],
        row=whole[:, 1],
        column_fraction=fraction[:, 0],
        row_fraction=fraction[:, 1],
        along_x=course[:, 0],
        along_y=course[:, 1],
        inverse_square=inverse**2,
        inverse_length=inverse,
        height=grooves.depth,
        inverse_variance=1 / grooves.sigma**2,
        defect=grooves.owner,
        outline=np.zeros(len(grooves)),
    )


def piece_records(relief: Relief, station: Station) -> NDArray[np.float32]:
    """Return the structs ``Groove`` of all that blocks list: grooves, then edge defects.

    Parameters
    ----------
    relief : Relief
        Of S pieces of grooves and E edge defects.
    station : Station
        That it is of.

    Returns
    -------
    ndarray of float32, shape (S + E, 12)
    """
    return np.concatenate(
        [
            groove_records(relief.grooves, station),
            edge_records(relief.edges, station, len(relief.defects)),
        ]
    )


def edge_records(edges: Edges, station: Station, first: int = 0) -> NDArray[np.float32]:
    """Return the structs ``Groove`` of `kernels/station.h` that are edge defects.

    Parameters
    ----------
    edges : Edges
        E of them.
    station : Station
        Its sampling and image shape are used.
    first : int
        Number of the first: those of the grooves' defects are below it.

    Returns
    -------
    ndarray of float32, shape (E, 12)
    """
    start = pixel_position(edges.middle, station)
    whole = np.floor(start)
    fraction = start - whole
    inverse = 1 / np.hypot(*edges.along.T)
    return packed(
        "Groove",
        column=whole[:, 0],
        row=whole[:, 1],
        column_fraction=fraction[:, 0],
        row_fraction=fraction[:, 1],
        along_x=edges.along[:, 0],
        along_y=edges.along[:, 1],
        inverse_square=inverse**2,
        inverse_length=inverse,
        height=np.zeros(len(edges)),
        inverse_variance=1 / edges.depth**2,
        defect=first + np.arange(len(edges)),
        outline=edges.signs,
    )
