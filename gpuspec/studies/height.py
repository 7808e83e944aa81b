"""Height against orientation: how far each moves the light point, over the camera's distance.

The paper takes the surface as flat and only oriented, having shown in its prototype that height is
negligible beside orientation for a camera far away. Here that is a question, with an answer for
each station.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from gpuspec.errors import StationError
from gpuspec.light.float64 import ray_paths
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.part.relief import Relief
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet
from gpuspec.pictures.place import open_frame
from gpuspec.simulation.cautions.station import of_station
from gpuspec.station.station import Station
from gpuspec.studies.deflection import Dent, dents, without_defects
from gpuspec.studies.outcome import GREY, Outcome, percent

Array = NDArray[np.float64]
NEGLIGIBLE = 0.05
"""Ratio of the two movements up to which height is called negligible; our choice."""
_NEAREST, _FARTHEST_MM = 1.05, 10_000.0
_CAMERA_MAX_MM = 1e5  # of camera.height_mm
_GRID = 101  # points across a dent, and across the part
_PART_SEEN = 0.98  # of a crowned part: height moves the outermost rays beside it


@dataclass(frozen=True, repr=False)
class Height(Outcome):
    """How far height and orientation move the light point.

    Attributes
    ----------
    info : DeviceInfo
        The float64 reference: float32 would lose the movement by height in rounding.
    dent : Dent
    place_mm : float
        x of the dent's centre; y is 0.
    camera_mm : ndarray, shape (n,)
        Heights of the camera, the station's own among them.
    by_slope_mm, by_height_mm : ndarray, shape (n,)
        Greatest movement of the light point over the dent, on the light: by its slope alone, and
        what its height adds.
    slope_estimate_mm, height_estimate_mm : ndarray, shape (n,)
        The same by the closed form.
    shape_by_slope_mm, shape_by_height_mm : ndarray, shape (n,)
        The same of the part's crown, over the whole part; 0 where it is flat.
    """

    name: ClassVar[str] = "height"

    dent: Dent
    place_mm: float
    camera_mm: Array
    by_slope_mm: Array
    by_height_mm: Array
    slope_estimate_mm: Array
    height_estimate_mm: Array
    shape_by_slope_mm: Array
    shape_by_height_mm: Array

    @property
    def crowned(self) -> bool:
        """Whether the part has a shape of its own."""
        return bool(self.shape_by_slope_mm.any())

    @property
    def ratio(self) -> Array:
        """Movement of the dent by height over that by slope, shape (n,)."""
        return self.by_height_mm / self.by_slope_mm

    @property
    def shape_ratio(self) -> Array:
        """The same of the crown, shape (n,); 0 where the part is flat."""
        flat = np.zeros_like(self.camera_mm)
        by_slope = self.shape_by_slope_mm
        ratio: Array = np.divide(self.shape_by_height_mm, by_slope, out=flat, where=by_slope > 0)
        return ratio

    @property
    def _own(self) -> int:
        return int(np.abs(self.camera_mm - self.station.camera.height_mm).argmin())

    @property
    def worst_ratio(self) -> Array:
        """The greater of the dent's ratio and the crown's, shape (n,)."""
        return np.maximum(self.ratio, self.shape_ratio)

    @property
    def negligible(self) -> bool:
        """Whether the paper's claim holds for this station, for its dent and its crown."""
        return bool(self.worst_ratio[self._own] <= NEGLIGIBLE)

    @property
    def negligible_from_mm(self) -> float | None:
        """Height of the camera from which it is negligible at all that are tried; None: at none."""
        above = np.flatnonzero(self.worst_ratio > NEGLIGIBLE)
        first = above[-1] + 1 if len(above) else 0
        return float(self.camera_mm[first]) if first < len(self.camera_mm) else None

    @property
    def parallax_mm(self) -> float:
        """How far on the part the dent's depth moves the point that a pixel sees."""
        return self.dent.depth_mm * self.place_mm / self.station.camera.height_mm

    def numbers(self) -> dict[str, Any]:
        """See :meth:`Outcome.numbers`."""
        own = self._own
        return {
            "diameter_mm": self.dent.diameter_mm,
            "depth_um": self.dent.depth_um,
            "place_mm": self.place_mm,
            "camera_mm": float(self.camera_mm[own]),
            "by_slope_mm": float(self.by_slope_mm[own]),
            "by_height_mm": float(self.by_height_mm[own]),
            "ratio": float(self.ratio[own]),
            "shape_ratio": float(self.shape_ratio[own]) if self.crowned else None,
            "parallax_mm": self.parallax_mm,
            "negligible_up_to": NEGLIGIBLE,
            "negligible": self.negligible,
            "negligible_from_mm": self.negligible_from_mm,
        }

    def findings(self) -> tuple[str, ...]:
        """See :meth:`Outcome.findings`."""
        own, h = self._own, self.station.camera.height_mm
        said = [
            f"{self.dent}, {self.place_mm:.3g} mm off the axis, camera at {h:g} mm: the light "
            f"point moves {self.by_slope_mm[own]:.3g} mm by slope and "
            f"{self.by_height_mm[own]:.2g} mm by height, {percent(self.ratio[own])} of it. "
            f"Height displaces what a pixel sees by {self.parallax_mm * 1e3:.2g} µm on the part, "
            f"{self.parallax_mm / self.station.camera.sampling_mm:.2g} of a pixel."
        ]
        if self.crowned:
            said.append(
                f"The crown moves it {self.shape_by_slope_mm[own]:.3g} mm by slope and "
                f"{self.shape_by_height_mm[own]:.2g} mm by height, "
                f"{percent(self.shape_ratio[own])} of it."
            )
        verdict = "holds" if self.negligible else "does not hold"
        said.append(
            f"The paper's claim that height is negligible {verdict} for this station, "
            f"{percent(NEGLIGIBLE)} of the movement by slope taken as the limit; {self._holds()}."
            + ("" if self.negligible else ' part.surface = "height" takes it into account.')
        )
        return tuple(said)

    def _holds(self) -> str:
        """Say at which of the heights tried it holds: no more is known of those between."""
        first = self.negligible_from_mm
        if first is None:
            return "it holds at none of the camera heights tried"
        lower = self.camera_mm[self.camera_mm < first]
        if not lower.size:
            return f"it holds at every camera height tried, from {first:.3g} mm on"
        return (
            f"of the camera heights tried it holds from {first:.3g} mm on, and not at "
            f"{lower[-1]:.3g} mm"
        )

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """See :meth:`Outcome.table`."""
        columns = {
            "camera_mm": self.camera_mm,
            "by_slope_mm": self.by_slope_mm,
            "by_height_mm": self.by_height_mm,
            "ratio": self.ratio,
            "slope_estimate_mm": self.slope_estimate_mm,
            "height_estimate_mm": self.height_estimate_mm,
        }
        if self.crowned:
            columns |= {
                "shape_by_slope_mm": self.shape_by_slope_mm,
                "shape_by_height_mm": self.shape_by_height_mm,
                "shape_ratio": self.shape_ratio,
            }
        return tuple(columns), list(np.stack([*columns.values()], axis=1).tolist())

    def figure(self) -> Figure:
        """See :meth:`Outcome.figure`."""
        pass

        return height_picture(self)


def study(station: Station, dent: Dent | None = None, distances: int = 31) -> Height:
    """Compare how far height and orientation move the light point, over the camera's distance.

    Rays are followed in float64 through the same points of the plane z = 0, to a part with the
    dent's slopes alone (an orientation surface), to one with its height, and to a flawless one.
    The dent lies at the end of the part's main axis, where the camera looks most aslant. A crown
    is compared with a flat part, on its own. Measured relief is left out.

    Parameters
    ----------
    station : Station
    dent : Dent, optional
        None: the one of the station's defects for which the closed form gives the largest ratio.
    distances : int
        Number of camera heights, from just above the tunnel to 10 m or more.

    Returns
    -------
    Height

    Raises
    ------
    StationError
        If the station has no dent, bump or scratch, or no ray meets the light.

    Examples
    --------
    >>> from gpuspec.studies import height
    >>> found = height.study(gpuspec.example("trim"), distances=5)
    >>> print(found.findings()[0])
    dent of 0.143 mm, 4.34 µm deep, 99.9 mm off the axis, camera at 800 mm: the light point
        moves 45.7 mm by slope and 1.1 mm by height, 2.43 % of it. Height displaces what a
        pixel sees by 0.54 µm on the part, 0.011 of a pixel.
    """
    if distances < 2:
        raise StationError(f"a curve over {distances} distances is none; ask for 2 or more.")
    h, top = station.camera.height_mm, station.tunnel.top_mm
    place = station.part.length_mm / 2
    dent = dent or max(dents(station), key=lambda d: _ratio_estimate(d, top, h, place))
    place = max(place - dent.diameter_mm / 2, 0.0)
    nearest = min(_NEAREST * top, h)
    camera = np.geomspace(nearest, max(_FARTHEST_MM, min(4 * h, _CAMERA_MAX_MM)), distances)
    camera[np.abs(np.log(camera / h)).argmin()] = h
    room = 10 * dent.diameter_mm  # for the rays that height moves beyond the part's end
    alone = dent.alone_on(
        station.replace(
            **{
                "part.crown_radius_x_mm": None, "part.crown_radius_y_mm": None,
                "part.length_mm": station.part.length_mm + room,
            }
        ),
        place,
    )  # fmt: skip
    across = 4 * dent.sigma_mm * np.linspace(-1, 1, _GRID)
    crowned = bool(station.part.crown_radius_x_mm or station.part.crown_radius_y_mm)
    shape = without_defects(station)
    x, y = (_PART_SEEN * size / 2 * np.linspace(-1, 1, _GRID)
            for size in (station.part.length_mm, station.part.width_mm))  # fmt: skip
    moved = [
        (
            *_moved(alone, height, place + across[None, :], across[:, None]),
            _slope_estimate(dent, top),
            _height_estimate(dent, top, height, place),
            *(_moved(shape, height, x[None, :], y[:, None]) if crowned else (0.0, 0.0)),
        )
        for height in camera.tolist()
    ]
    by = np.array(moved).T
    return Height(
        station, NumpyBackend().info, dent, place, camera, by[0], by[1], by[2], by[3], by[4], by[5],
        notes=tuple(of_station(station)),
    )  # fmt: skip


def _moved(station: Station, camera_mm: float, x: Array, y: Array) -> tuple[float, float]:
    """Return the greatest movement of the light point by a part's slopes, and by its height."""
    light, seen = {}, np.ones(np.broadcast_shapes(x.shape, y.shape), bool)
    flat: dict[str, Any] = {
        "part.crown_radius_x_mm": None,
        "part.crown_radius_y_mm": None,
        "defects": [],
    }
    for name, changes in (
        ("flat", flat),
        ("orientation", {"part.surface": "orientation"}),
        ("height", {"part.surface": "height"}),
    ):
        changed = station.replace(**{"camera.height_mm": camera_mm, **changes})
        paths = ray_paths(changed, Relief.of(changed), *np.broadcast_arrays(x, y))
        light[name] = paths.light[..., 0]
        seen &= paths.lost == 0
    if not seen.any():
        raise StationError(
            f"{station.file}: with the camera at {camera_mm:g} mm no ray from the part meets the "
            f"light; the slopes are too steep."
        )
    by_slope = np.abs(light["orientation"] - light["flat"])[seen].max()
    by_height = np.abs(light["height"] - light["orientation"])[seen].max()
    return float(by_slope), float(by_height)


def _slope_estimate(dent: Dent, top: float) -> float:
    """2 H d / (sigma sqrt e)."""
    return 2 * top * dent.slope


def _height_estimate(dent: Dent, top: float, h: float, place: float) -> float:
    """Greatest |2 z z' + 2 z (H z'' - 1) x / h| along the dent's row.

    The ray through (x, 0) meets the surface at height z and x (1 - z/h), and goes up H - z from
    there: l = x (1 - z/h) + (H - z)(x/h - 2 z'). To first order in z, that is what z adds to
    l = x + H (x/h - 2 z').
    """
    u = np.linspace(-4, 4, 2001)
    z = -dent.depth_mm * np.exp(-(u**2) / 2)
    first, second = -z * u / dent.sigma_mm, z * (u**2 - 1) / dent.sigma_mm**2
    field = (place + u * dent.sigma_mm) / h
    return float(np.abs(2 * z * first + 2 * z * (top * second - 1) * field).max())


def _ratio_estimate(dent: Dent, top: float, h: float, place: float) -> float:
    return _height_estimate(dent, top, h, place) / _slope_estimate(dent, top)


def height_picture(found: Height) -> Figure:
    """Draw the movements, and their ratio, over the camera's height."""
    sheet = Sheet(WIDTH, 770)
    tunnel = found.station.tunnel
    verdict = "is" if found.negligible else "is not"
    sheet.heading(
        f"Movement of the light point: for this station, height {verdict} negligible beside "
        f"orientation",
        f"{found.dent}, {found.place_mm:.3g} mm off the axis  ·  {tunnel.section} at "
        f"{tunnel.top_mm:g} mm",
        str(found.info),
    )
    width = (WIDTH - 2 * MARGIN - 100) / 2
    moved, ratio = (sheet.axes(MARGIN + n * (width + 100), 150, width, 540) for n in range(2))
    for ax, label in (
        (moved, "greatest movement of the light point, mm"),
        (ratio, "movement by height over movement by slope, %"),
    ):
        open_frame(ax, "height of the camera, mm", label)
        ends = found.camera_mm[0] / 1.05, found.camera_mm[-1] * 1.05
        ax.set(xscale="log", yscale="log", xlim=ends)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
            axis.set_minor_formatter(NullFormatter())
    x = found.camera_mm
    handles = []
    curves = [("dent", "o", found.by_slope_mm, found.by_height_mm, found.ratio)]
    if found.crowned:
        shape = found.shape_by_slope_mm, found.shape_by_height_mm, found.shape_ratio
        curves.append(("crown", "s", *shape))
    for name, marker, by_slope, by_height, share in curves:
        colour = VERMILION if name == "dent" else SKY
        style: dict[str, Any] = {"marker": marker, "markersize": 5, "linestyle": "none"}
        for values, of, tint in ((by_slope, "slope", "black"), (by_height, "height", colour)):
            handles += moved.plot(x, values, color=tint, label=f"{name}, by {of}", **style)
        ratio.plot(x, 100 * share, color=colour, **style)
    for estimate in (found.slope_estimate_mm, found.height_estimate_mm):
        (law,) = moved.plot(x, estimate, color=GREY, label="dent, closed form")
    bound = ratio.axhline(100 * NEGLIGIBLE, color=GREY, linestyle="--",
                          label=f"negligible up to {percent(NEGLIGIBLE)}")  # fmt: skip
    for ax in (moved, ratio):
        own = ax.axvline(found.station.camera.height_mm, color="black", linestyle=":",
                         label="this station's camera")  # fmt: skip
    sheet.legend([*handles, law, bound, own], 100)
    return sheet.figure
