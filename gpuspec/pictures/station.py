"""The scale drawing of a station."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from gpuspec.arrays import LOST
from gpuspec.light.float64 import ray_paths
from gpuspec.light.profiles import luminance
from gpuspec.part.pose import Frames
from gpuspec.pictures.page import MARGIN, WIDTH, Sheet, essentials, text_width
from gpuspec.pictures.seen import Simulated
from gpuspec.station.sections import Pose, Tunnel
from gpuspec.station.station import Station

__all__ = ["RayPaths", "station_drawing"]
LUMINOUS, DARK, PART = "#FFC20A", "#404040", "#000000"
SEEN, LOST_RAY, VIEW = "#0072B2", "#D55E00", "#DCE9F2"
PANEL_PX = 9.0  # thickness of the tunnel as drawn
_HALF_PX_MIN = 115  # of a view
_LABEL_PT = 9.5
_NOTE_PX = 40  # between tunnel and camera, for a note of two lines
_CELLS = 24  # of even tone, in which a period of a light that is no stripes is drawn
STRIPE_PX_MIN = 1.5  # thinner stripes are drawn as an even tone
FARTHEST = 4.0  # half sizes of the part: rays that go farther leave the view


class RayPaths(Protocol):
    """Rays followed from the camera to the light."""

    @property
    def surface(self) -> NDArray[np.float64]:
        """Points on the part, (n, 3) mm."""

    @property
    def light(self) -> NDArray[np.float64]:
        """Points on the tunnel, (n, 3) mm."""

    @property
    def lost(self) -> NDArray[np.uint8]:
        """Why a ray sees no light, (n,): index into ``arrays.LOST``."""


@dataclass(frozen=True)
class _View:
    """One view of the station on the page: `axis` (0: x, 1: y) to the right, z up, to scale."""

    ax: Axes
    station: Station
    axis: int
    px_per_mm: float
    half: float

    @property
    def panel(self) -> float:
        """Thickness of the tunnel as drawn, mm."""
        return PANEL_PX / self.px_per_mm


def station_drawing(station: Station, side_paths: RayPaths, front_paths: RayPaths) -> Figure:
    """Draw a station to scale, from the side and the front, with some of its rays.

    Parameters
    ----------
    station : Station
        The tunnel is drawn at shift 0.
    side_paths, front_paths : RayPaths
        Rays through points along x at y = 0, and along y at x = 0.

    Returns
    -------
    Figure
    """
    tunnel = station.tunnel
    top, room, high = 126.0, 800.0, 880.0
    low = min(station.part.height_range_mm[0], 0.0, *_profile(station, 0)[:, 1])
    eye = _eye(station)
    halves = [_half_width(station, 0, side_paths), _half_width(station, 1, front_paths)]
    upright, across = (high - 110) / (eye[2] - low), (room - 90) / 2
    px_per_mm = min(upright, across / sum(halves))
    # A camera far above a small part, or a long part, leaves narrow views: keep room for ticks and
    # words, and the other view within what is left.
    if min(halves) * px_per_mm < _HALF_PX_MIN:
        px_per_mm = min(upright, (across - _HALF_PX_MIN) / max(halves))
    halves = [max(half, _HALF_PX_MIN / px_per_mm) for half in halves]

    z_range = (low - 45 / px_per_mm, eye[2] + 65 / px_per_mm)
    height = (z_range[1] - z_range[0]) * px_per_mm
    high = max(height, 620.0)
    sheet = Sheet(WIDTH, top + high + 60)
    sheet.heading("The station, to scale, at shift 0", essentials(station))
    sheet.legend(_handles(station, side_paths, front_paths), 76)
    left = float(MARGIN)
    for axis, (half, paths, name) in enumerate(
        zip(halves, (side_paths, front_paths), ("Side", "Front"), strict=True)
    ):
        width = 2 * half * px_per_mm
        ax = sheet.axes(left, top + high - height, width, height)
        view = _View(ax, station, axis, px_per_mm, half)
        _frame(view, z_range, name)
        _draw_station(view, paths)
        _draw_camera(view)
        _label_view(view)
        left += width + 80

    width = WIDTH - 20 - left
    _close_up(sheet, (left, top + 22, width, high - 300), station, side_paths, low)
    _light(sheet, (left, top + high - 180, width, 180), tunnel)
    return sheet.figure


def _half_width(station: Station, axis: int, paths: RayPaths) -> float:
    """Return how far a view reaches from the centre: the part, its light, and the walls, mm."""
    part, tunnel = station.part, station.tunnel
    half = (part.length_mm, part.width_mm)[axis] / 2
    view = station.shape[1 - axis] * station.camera.sampling_mm / 2
    light = np.abs(paths.light[paths.lost == 0, axis]).max(initial=0)
    walls = 0.0
    if axis == 1:
        walls = {"arch": tunnel.radius_mm, "box": (tunnel.width_mm or 0) / 2}.get(
            tunnel.section
        ) or 0.0
    farthest = max(half, view)
    if station.posed:
        farthest = max(farthest, abs(_eye(station)[axis]), *np.abs(_profile(station, axis)[:, 0]))
    return 1.15 * max(farthest, min(max(float(light), walls), FARTHEST * farthest))


def _handles(station: Station, side: RayPaths, front: RayPaths) -> list[Any]:
    through = "" if station.tunnel.opening_length_mm else " (tunnel taken as transparent to it)"
    reasons = sorted({int(i) for paths in (side, front) for i in np.unique(paths.lost)} - {0})
    stripe = " stripe" * station.tunnel.is_striped
    handles: list[Any] = [
        Patch(color=LUMINOUS, label=f"luminous{stripe}"),
        Patch(color=DARK, label=f"dark{stripe}"),
        Line2D([], [], color=PART, linewidth=4, label="part"),
        Patch(color=VIEW, label=f"field of view{through}"),
        Line2D([], [], color=SEEN, linewidth=1.2, label="ray, camera to light"),
    ]
    if reasons:
        why = ", ".join(LOST[i].partition(",")[0] for i in reasons)  # "reflected down" says enough
        handles.append(Line2D([], [], color=LOST_RAY, linestyle="--", label=f"lost ray: {why}"))
    return handles


def _frame(view: _View, z_range: tuple[float, float], name: str) -> None:
    ax, axis = view.ax, "xy"[view.axis]
    ax.set(xlim=(-view.half, view.half), ylim=z_range)
    ax.set_title(f"{name} ({axis}–z)", fontsize=11, loc="left", y=1)
    ax.set_xlabel(f"{axis}, mm", fontsize=10)
    ax.set_ylabel("z, mm", fontsize=10, labelpad=2)
    ax.tick_params(labelsize=9.5)
    ax.xaxis.set_major_locator(MaxNLocator(max(2, int(2 * view.half * view.px_per_mm / 70))))
    ax.spines[["top", "right"]].set_visible(False)


def _draw_station(view: _View, paths: RayPaths) -> None:
    """Draw field of view, tunnel, rays and part."""
    station, ax, axis = view.station, view.ax, view.axis
    eye = _eye(station)[[axis, 2]]
    field = station.shape[1 - axis] * station.camera.sampling_mm / 2
    frames = Frames.of(station)
    edges = [frames.middle + side * field * frames.view[:, axis] for side in (-1, 1)]
    left, right = frames.in_station(np.array(edges))[:, [axis, 2]]
    ax.add_patch(Polygon([left, eye, right], color=VIEW, linewidth=0))
    (_draw_tunnel_side if axis == 0 else _draw_tunnel_front)(view)

    lost = paths.lost != 0
    surface, light = paths.surface[:, [axis, 2]], paths.light[:, [axis, 2]]
    camera = np.broadcast_to(eye, surface.shape)
    for rays, colour, style in ((~lost, SEEN, "solid"), (lost, LOST_RAY, "dashed")):
        ends = [(camera[rays], surface[rays]), (surface[rays], light[rays])]
        pieces = np.concatenate([np.stack(pair, axis=1) for pair in ends])
        known = np.isfinite(pieces).all(axis=(1, 2))
        ax.add_collection(
            LineCollection(
                [*pieces[known]], colors=colour, linestyles=style, linewidths=1.1, zorder=3
            ),
            autolim=False,
        )
        lit = light[rays & (paths.lost != 1)]
        ax.plot(*lit.T, ".", color=colour, markersize=4, zorder=4)

    ax.plot(*_profile(station, axis).T, color=PART, linewidth=4, solid_capstyle="butt", zorder=5)


def _eye(station: Station) -> NDArray[np.float64]:
    """Return the middle of the camera's pupil, (3,) mm."""
    frames = Frames.of(station)
    return frames.in_station(frames.pupil(station))


def _profile(station: Station, axis: int) -> NDArray[np.float64]:
    """Return the part's profile through its centre along an axis: that coordinate and z, (n, 2)."""
    half = (station.part.length_mm, station.part.width_mm)[axis] / 2
    along, zero = np.linspace(-half, half, 101), np.zeros(101)
    x, y = (along, zero) if axis == 0 else (zero, along)
    points = np.stack([x, y, station.part.shape.height(x, y)], axis=1)
    return Frames.of(station).in_station(points)[:, [axis, 2]]


def _draw_tunnel_side(view: _View) -> None:
    station, ax, top = view.station, view.ax, view.station.tunnel.top_mm
    tunnel = station.tunnel
    ends = np.clip(np.array([-1, 1]) * tunnel.length_mm / 2, -view.half, view.half)
    stretches, shares = _luminous(ends[0], ends[1], tunnel)
    narrow = min(tunnel.luminous_mm, tunnel.dark_mm) if tunnel.is_striped else tunnel.period_mm / 2
    if narrow * view.px_per_mm < STRIPE_PX_MIN:
        even = luminance(tunnel, (np.arange(_CELLS * 16) + 0.5) / (_CELLS * 16)).mean()
        stretches, shares = ends[None], np.array([even])
    layers = [(top, top + view.panel, 1.0)]
    if tunnel.section != "ceiling":
        layers.append((0.0, top, 0.16))  # the inner wall, behind
    for bottom, upper, alpha in layers:
        box: dict[str, Any] = {"alpha": alpha, "linewidth": 0, "zorder": 2 if alpha == 1 else 1}
        ax.add_patch(
            Rectangle((ends[0], bottom), ends[1] - ends[0], upper - bottom, color=DARK, **box)
        )
        box["alpha"] = alpha * shares
        corners = [[(a, bottom), (b, bottom), (b, upper), (a, upper)] for a, b in stretches]
        ax.add_collection(PolyCollection(corners, facecolors=LUMINOUS, **box), autolim=False)
    _draw_opening(view, tunnel.opening_length_mm / 2, top)


def _draw_tunnel_front(view: _View) -> None:
    tunnel, ax, top = view.station.tunnel, view.ax, view.station.tunnel.top_mm
    if tunnel.section == "arch":
        angle = np.linspace(0, np.pi, 121)
        inner = np.stack([np.cos(angle), np.sin(angle)], axis=1) * top
        outer = inner * (1 + view.panel / top)
    else:
        walls = tunnel.section == "box"
        y = (tunnel.width_mm or 0) / 2 if walls else view.half
        thick = view.panel
        foot = 0.0 if walls else top
        inner = np.array([[y, foot], [y, top], [-y, top], [-y, foot]])
        outer = inner + np.array([[1, 0], [1, 1], [-1, 1], [-1, 0]]) * thick
    outline = np.concatenate([inner, outer[::-1]])
    ax.add_patch(Polygon(outline, facecolor=LUMINOUS, edgecolor=DARK, linewidth=1, zorder=2))
    _draw_opening(view, tunnel.opening_width_mm / 2, top)


def _draw_opening(view: _View, half: float, top: float) -> None:
    if half:
        size = (2 * half, 1.4 * view.panel)
        view.ax.add_patch(
            Rectangle(
                (-half, top - 0.2 * view.panel), *size, color="white", linewidth=0, zorder=2.5
            )
        )


def _luminous(
    low: float, high: float, tunnel: Tunnel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return stretches of the light between two ends, shape (n, 2), and their luminance, (n,).

    Of stripes the luminous ones, of another profile cells of a period.
    """
    period = tunnel.period_mm
    start = np.arange(math.floor(low / period), math.ceil(high / period)) * period
    first, last = np.zeros(1), np.array([tunnel.luminous_mm])
    if not tunnel.is_striped:
        first = np.arange(_CELLS) * period / _CELLS
        last = first + period / _CELLS
    ends = np.stack([np.add.outer(start, first).ravel(), np.add.outer(start, last).ravel()], axis=1)
    shares = np.ones(1)
    if not tunnel.is_striped:
        shares = luminance(tunnel, (first + last) / 2 / period)
    shares = np.tile(shares, len(start))
    stretches = ends.clip(low, high)
    kept = stretches[:, 1] > stretches[:, 0]
    return stretches[kept], shares[kept]


def _draw_camera(view: _View) -> None:
    """Draw the camera, its size a symbol, above its pupil, to scale but for a least width."""
    ax, camera, px = view.ax, view.station.camera, 1 / view.px_per_mm
    eye, axes = _eye(view.station)[[view.axis, 2]], np.array((camera.pose or Pose()).axes)
    up = axes[[view.axis, 2], 2] / np.hypot(*axes[[view.axis, 2], 2])
    upright = np.array([[up[1], up[0]], [-up[0], up[1]]])  # of the page, turned with the camera
    lens = [(-9, 0), (9, 0), (6, 10), (-6, 10)]
    body = [(-16, 10), (16, 10), (16, 32), (-16, 32)]
    for shape in (lens, body):
        ax.add_patch(Polygon(np.array(shape) * px @ upright.T + eye, color="#606060", zorder=4))
    pupil = max(camera.pupil_mm / 2, 1.5 * px)
    ends = np.array([[-pupil, 0], [pupil, 0]]) @ upright.T + eye
    ax.plot(*ends.T, color=LUMINOUS, linewidth=2.5, zorder=5)
    name = f"pupil ⌀ {camera.pupil_mm:g} mm" if camera.pupil_mm else "pinhole"
    if view.axis == 0:
        _note(ax, f"camera, {name}", (eye[0], eye[1] + 34 * px), (0, 2), "center")


def _label_view(view: _View) -> None:
    station, px = view.station, 1 / view.px_per_mm
    tunnel, h, edge = station.tunnel, float(_eye(station)[2]), view.half - 14 / view.px_per_mm
    size = (station.part.length_mm, station.part.width_mm)[view.axis]
    below = min(station.part.height_range_mm[0], 0, *_profile(station, view.axis)[:, 1]) - 20 * px
    _dimension(view.ax, (-size / 2, below), (size / 2, below), f"part {size:g} mm")
    if view.axis == 0:
        _height(view, -edge, h, f"camera height {h:g} mm")
        if tunnel.length_mm / 2 > view.half:
            end = f"to ±{tunnel.length_mm / 2:g} mm"
            if (h - tunnel.top_mm) * view.px_per_mm > _NOTE_PX:
                where = (view.half, tunnel.top_mm + view.panel)
                _note(view.ax, f"tunnel goes on\n{end}", where, (-2, 5), "right")
            else:  # the camera's name is there
                view.ax.set_xlabel(f"x, mm; tunnel goes on {end}", fontsize=10)
    elif tunnel.section == "box":
        above = tunnel.top_mm + view.panel + 14 * px
        width = tunnel.width_mm or 0
        _dimension(view.ax, (-width / 2, above), (width / 2, above), f"box {width:g} mm wide")


def _height(view: _View, x: float, height: float, text: str) -> None:
    """Draw an upright dimension line from z = 0; one too short for its text has it in the title."""
    room, wide = height * view.px_per_mm, text_width(text, _LABEL_PT) + 8
    if wide < room:
        at = 0.62 if 0.76 * room > wide else 0.5
        _dimension(view.ax, (x, 0), (x, height), text, at=at)
        return
    _dimension(view.ax, (x, 0), (x, height), "")
    view.ax.set_title(f"{view.ax.get_title(loc='left')}\n{text}", fontsize=11, loc="left", y=1)


def _dimension(
    ax: Axes, start: tuple[float, float], end: tuple[float, float], text: str, at: float = 0.5
) -> None:
    """Draw a dimension line with its text on it."""
    ax.annotate(
        "",
        start,
        end,
        arrowprops={"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0, "linewidth": 0.9},
        annotation_clip=False,
        zorder=6,
    )
    upright = start[0] == end[0]
    ax.annotate(
        text,
        (start[0] + at * (end[0] - start[0]), start[1] + at * (end[1] - start[1])),
        ha="center",
        va="center",
        rotation=90 if upright else 0,
        fontsize=_LABEL_PT,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.2, "alpha": 0.9},
        annotation_clip=False,
        zorder=7,
    )


def _note(
    ax: Axes,
    text: str,
    where: tuple[float, float],
    offset: tuple[float, float],
    ha: Literal["left", "center", "right"],
    va: Literal["bottom", "center"] = "bottom",
) -> None:
    """Write beside a point, `offset` typographic points away."""
    ax.annotate(
        text,
        where,
        xytext=offset,
        textcoords="offset points",
        ha=ha,
        va=va,
        fontsize=_LABEL_PT,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8},
        zorder=7,
    )


def _close_up(
    sheet: Sheet,
    box: tuple[float, float, float, float],
    station: Station,
    paths: RayPaths,
    low: float,
) -> None:
    """Draw part and tunnel from the side, larger."""
    left, top, width, height = box
    ceiling, camera = station.tunnel.top_mm, station.camera
    px_per_mm = (height - 80) / (ceiling - low)
    ax = sheet.axes(left, top, width, height)
    view = _View(ax, station, 0, px_per_mm, width / 2 / px_per_mm)
    _frame(view, (low - 45 / px_per_mm, ceiling + 35 / px_per_mm), "Part and tunnel, closer")
    if low < 0 and station.part.surface == "orientation":
        ax.set_title("Closer (x–z); rays meet z = 0", fontsize=11, loc="left", y=1)
        ax.axhline(0, color="#808080", linewidth=0.8, linestyle=":", zorder=2)
    _draw_station(view, paths)
    edge = -view.half + 16 / px_per_mm
    word = "radius" if station.tunnel.section == "arch" else "height"
    _height(view, edge, ceiling, f"tunnel {word} {ceiling:g} mm")
    rows, columns = station.shape
    p = camera.sampling_mm
    text = f"sampling {p:g} mm/px, {columns} × {rows} px"
    _note(ax, text, (0, low - 24 / px_per_mm), (0, 0), "center", "center")
    tunnel = station.tunnel
    if tunnel.opening_length_mm:
        size = f"{tunnel.opening_length_mm:g} × {tunnel.opening_width_mm:g} mm"
        _note(ax, f"opening {size}", (0, ceiling + view.panel), (0, 4), "center")


def _light(sheet: Sheet, box: tuple[float, float, float, float], tunnel: Tunnel) -> None:
    """Draw the light as it is seen from below, larger, with its widths."""
    left, top, width, height = box
    ax = sheet.axes(left, top, width, height)
    luminous, dark, period = tunnel.luminous_mm, tunnel.dark_mm, tunnel.period_mm
    low, high = -1.25 * period, 2.25 * period
    ax.add_patch(Rectangle((low, 0), high - low, 1, color=DARK, linewidth=0))
    for (a, b), share in zip(*_luminous(low, high, tunnel), strict=True):
        ax.add_patch(Rectangle((a, 0), b - a, 1, color=LUMINOUS, alpha=share, linewidth=0))
    ax.set(xlim=(low, high), ylim=(0, 2.2), yticks=[])
    striped = tunnel.is_striped
    widths = [(0.0, luminous, 1.35), (luminous, period, 1.35)] if striped else []
    for start, end, y in (*widths, (0.0, period, 1.8)):
        for x in (start, end):
            ax.plot([x, x], [1, y + 0.15], color="#808080", linewidth=0.8)
        _dimension(ax, (start, y), (end, y), "")
    if striped:
        _note(ax, f"a = {luminous:g} mm", (0, 1.35), (-5, 0), "right", "center")
        _note(ax, f"b = {dark:g} mm", (period, 1.35), (5, 0), "left", "center")
    else:
        u = np.linspace(low, high, 400)
        ax.plot(u, luminance(tunnel, u / period), color=SEEN, linewidth=1.2)
    _note(ax, f"period P = {period:g} mm", (period / 2, 1.8), (0, 9), "center", "center")
    name = "Stripes" if striped else "Light and its luminance, 0 to 1"
    ax.set_title(f"{name}, seen from below", fontsize=11, loc="left", y=1)
    ax.set_xlabel("light coordinate along x, mm", fontsize=10)
    ax.tick_params(labelsize=9.5)
    ax.spines[["top", "right", "left"]].set_visible(False)


def station_picture(result: Simulated) -> Figure:
    """Draw the station to scale, with rays of its own relief.

    Returns
    -------
    Figure
    """
    part = result.station.part
    along, across = (np.linspace(-0.48, 0.48, 7) * size for size in (part.length_mm, part.width_mm))
    side = ray_paths(result.station, result.relief, along, np.zeros(7))
    front = ray_paths(result.station, result.relief, np.zeros(7), across)
    return station_drawing(result.station, side, front)
