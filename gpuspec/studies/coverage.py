"""Scan coverage: how near a light transition comes to each point of the part over the sequence.

The scan rule, from the law of the signature: a transition must pass within (A / sqrt e - 1) sigma
of every point, so that the step on the part is at most twice that for the defect hardest to show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image, pooled
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, essentials, fitted
from gpuspec.pictures.place import draw_codes, millimetres, open_frame, place_image, reduction
from gpuspec.simulation.cautions.light import of_light
from gpuspec.simulation.cautions.station import of_station
from gpuspec.simulation.memory import check_memory
from gpuspec.station.optics import NO_DATA_SHEET
from gpuspec.station.station import Station
from gpuspec.studies.deflection import Dent, hardest, magnification, reach_mm
from gpuspec.studies.outcome import DARK, PALE, Outcome, percent

KINDS = ("scanned", "too far from a transition", "lost", "beside the part")
SCANNED, TOO_FAR, LOST_LIGHT, OFF_PART = range(4)
_BAND_PIXELS = 250_000


@dataclass(frozen=True, repr=False)
class Coverage(Outcome):
    """How near the nearest transition comes to each pixel over the sequence.

    Attributes
    ----------
    dent : Dent
        The defect to be shown.
    reach_mm : float
        Distance on the part from which a transition shows it, at the part's centre; 0: from none.
    magnification : float
        M = dl/dx at the part's centre.
    on_light_mm : ndarray of float32, shape (M, N)
        Smallest distance of the pixel's light coordinate to a transition, on the light; NaN where
        no light is seen.
    on_part_mm : ndarray of float32, shape (M, N)
        The same on the part, by the light map's gradient there.
    kind : ndarray of uint8, shape (M, N)
        Index into ``KINDS``; too far and lost are blind.
    """

    name: ClassVar[str] = "coverage"

    dent: Dent
    reach_mm: float
    magnification: float
    on_light_mm: Image
    on_part_mm: Image
    kind: NDArray[np.uint8]

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of pixels of each of ``KINDS``."""
        return tuple(np.bincount(self.kind.ravel(), minlength=len(KINDS)).tolist())

    @property
    def blind(self) -> float:
        """Share of the part's pixels that are lost, or too far from any transition."""
        scanned, far, lost, _ = self.counts
        return (far + lost) / (scanned + far + lost)

    @property
    def largest_step_mm(self) -> float:
        """Step of the tunnel that the scan rule allows, on the light."""
        return 2 * self.reach_mm * self.magnification

    @property
    def images_needed(self) -> int | None:
        """Images per period that the scan rule asks for; None: no number is enough."""
        step = self.largest_step_mm
        return math.ceil(self.station.tunnel.period_mm / step - 1e-9) if step > 0 else None

    def numbers(self) -> dict[str, Any]:
        """See :meth:`Outcome.numbers`."""
        scanned, far, lost, _ = self.counts
        step = self.station.step_mm
        seen = scanned + far > 0
        return {
            "diameter_mm": self.dent.diameter_mm,
            "depth_um": self.dent.depth_um,
            "part_px": scanned + far + lost,
            "lost_px": lost,
            "too_far_px": far,
            "blind_share": self.blind,
            "largest_distance_on_light_mm": float(np.nanmax(self.on_light_mm)) if seen else None,
            "largest_distance_on_part_mm": float(np.nanmax(self.on_part_mm)) if seen else None,
            "reach_on_part_mm": self.reach_mm,
            "magnification": self.magnification,
            "step_on_light_mm": step,
            "step_on_part_mm": step / self.magnification,
            "largest_step_on_light_mm": self.largest_step_mm,
            "largest_step_on_part_mm": 2 * self.reach_mm,
            "images": self.station.sequence.images,
            "periods": self.station.sequence.images * step / self.station.tunnel.period_mm,
            "images_needed_per_period": self.images_needed,
        }

    def findings(self) -> tuple[str, ...]:
        """See :meth:`Outcome.findings`."""
        found = self.numbers()
        part, lost, far = (found[key] for key in ("part_px", "lost_px", "too_far_px"))
        said = [
            f"{percent(self.blind)} of {part:,} pixels are blind: {lost:,} lost, {far:,} farther "
            f"from every transition than {self.reach_mm:.3g} mm, which shows a {self.dent}."
        ]
        if lost < part:
            said.append(
                f"The farthest pixel is {found['largest_distance_on_part_mm']:.3g} mm on the part "
                f"({found['largest_distance_on_light_mm']:.3g} mm on the light) from its nearest "
                f"transition."
            )
        if self.images_needed is None:
            said.append(
                "The scan rule allows no step: no transition, however near, shows this defect."
            )
        else:
            periods = f"{found['periods']:.3g} period{'' if found['periods'] == 1 else 's'}"
            kept = self.station.step_mm <= self.largest_step_mm * (1 + 1e-9)
            said.append(
                f"The scan rule allows steps of {2 * self.reach_mm:.3g} mm on the part, "
                f"{self.images_needed} images per period; this station's {found['images']} images "
                f"over {periods}, in steps of "
                f"{found['step_on_part_mm']:.3g} mm, {'keep' if kept else 'break'} it."
            )
        return tuple(said)

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """See :meth:`Outcome.table`."""
        rows = [(key, "" if value is None else value) for key, value in self.numbers().items()]
        return ("quantity", "value"), rows

    def figure(self) -> Figure:
        """See :meth:`Outcome.figure`."""
        pass

        return coverage_picture(self)


def study(
    station: Station,
    dent: Dent | None = None,
    backend: str | Backend = "auto",
    device: str | None = None,
) -> Coverage:
    """Map how near a transition comes to each point of the flawless part over the sequence.

    Parameters
    ----------
    station : Station
        Its defects and measured relief are left out of the light map.
    dent : Dent, optional
        To be shown everywhere; None: the station's defect that shows from the least distance. A
        scratch is taken as if across the light's movement: one along it is hardly moved.
    backend, device
        As for :func:`gpuspec.simulate`.

    Returns
    -------
    Coverage

    Raises
    ------
    StationError
        If the light is no stripes, the station has no dent, bump or scratch, the camera sees
        nothing of the part, or the image exceeds the memory.
    BackendError
        If the backend is absent or fails.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> found = gpuspec.study("coverage", station)
    >>> found.images_needed, found.blind
    (4, 0.0)
    """
    if not station.tunnel.is_striped:
        raise StationError(
            f"{station.file}: the study of coverage measures distances to the edges of stripes, "
            f'and this light has none; set tunnel.profile = "stripes".'
        )
    dent = dent or hardest(station)
    check_memory(station)
    engine = open_backend(backend, device)
    # Of a sharp pinhole the footprint is what one pixel's square covers of the light: its gradient.
    flawless = station.replace(
        **{
            "defects": [], "populations": [], "part.relief": None, "part.roughness_rad": 0.0,
            "camera.pupil_mm": 0.0, "camera.blur_mm": 0.0, "camera.subsampling": 1,
            **NO_DATA_SHEET,
        }
    )  # fmt: skip
    read = engine.trace(flawless).read()
    if (read.lost == BESIDE).all():
        raise StationError(
            f"{station.file}: no pixel of the image sees the part; check {station.seen_by}."
        )
    reach = max(reach_mm(dent, station), 0.0)
    on_light, on_part = (np.full(station.shape, np.nan, np.float32) for _ in range(2))
    height = max(_BAND_PIXELS // station.shape[1], 1)
    for first in range(0, station.shape[0], height):
        band = slice(first, first + height)
        seen = read.lost[band] == 0
        distance = transition_distance(read.light_mm[0, band][seen], station)
        gradient = read.footprint_mm[0, band][seen] / station.camera.sampling_mm
        on_light[band][seen] = distance
        on_part[band][seen] = distance / gradient
    kind = np.select(
        [read.lost == BESIDE, read.lost != 0, ~(on_part <= reach)],
        [OFF_PART, LOST_LIGHT, TOO_FAR],
        SCANNED,
    ).astype(np.uint8)
    notes = (*of_station(station), *of_light(station, read.lost))
    return Coverage(
        station, engine.info, dent, reach, magnification(station), on_light, on_part, kind,
        notes=notes,
    )  # fmt: skip


def transition_distance(light_mm: NDArray[Any], station: Station) -> NDArray[np.float64]:
    """Return the smallest distance of light coordinates to a transition over the sequence.

    Parameters
    ----------
    light_mm : ndarray, any shape
    station : Station
        Of its stripes, at shift s, the transitions lie at s + n P and s + a + n P.

    Returns
    -------
    ndarray, same shape
        In mm on the light.
    """
    period = station.tunnel.period_mm
    shifts = np.arange(station.sequence.images) * station.step_mm
    passed = np.unique(np.concatenate([shifts, shifts + station.tunnel.luminous_mm]) % period)
    passed = np.concatenate([passed[-1:] - period, passed, passed[:1] + period])
    phase = np.asarray(light_mm, np.float64) % period
    after = np.searchsorted(passed, phase)
    distance: NDArray[np.float64] = np.minimum(phase - passed[after - 1], passed[after] - phase)
    return distance


def coverage_picture(found: Coverage) -> Figure:
    """Draw the distance on the part and on the light, the blind pixels, and one row's course.

    Squares of pixels drawn as one show their largest distance, and any blind pixel of theirs.
    """
    station = found.station
    beside = station.shape[1] < 1.5 * station.shape[0]
    cell = (WIDTH - 2 * MARGIN) / (3 if beside else 1)
    width, height = fitted(station.shape, cell - (170 if beside else 110), 420)
    bar_height = max(height, 110)  # room for its label
    corners = [
        (MARGIN + cell * place, 170.0) if beside else (MARGIN, 170.0 + place * (bar_height + 96))
        for place in range(3)
    ]
    below = corners[-1][1] + (bar_height if beside else height) + 90
    sheet = Sheet(WIDTH, below + 320)
    sheet.heading(
        f"Scan coverage: {percent(found.blind)} of the part is blind to a {found.dent}",
        essentials(station),
        f"blue: the scan rule, {found.reach_mm:.3g} mm on the part  ·  {found.info}",
    )
    colours = ("#FFFFFF", VERMILION, DARK, PALE)
    handles = [
        Patch(facecolor=colour, edgecolor=DARK, linewidth=0.6, label=f"{kind} {n:,} px")
        for kind, colour, n in zip(KINDS, colours, found.counts, strict=True)
    ]
    sheet.legend(handles, 100)
    reaches = found.reach_mm, found.reach_mm * found.magnification
    maps = zip(corners, (found.on_part_mm, found.on_light_mm), ("part", "light"), reaches,
               strict=False)  # fmt: skip
    for (left, top), image, where, reach in maps:
        sheet.text(left, top - 24, f"Distance to the nearest transition on the {where}")
        ax = sheet.axes(left, top, width, height)
        factor = reduction(ax, image.shape)
        worst = pooled(np.nan_to_num(image, nan=-1.0), factor, np.maximum)
        # Up to the rule at least: distances far within it are to look alike.
        highest = max(float(worst.max()), 1.1 * reach)
        drawn = place_image(ax, np.ma.masked_less(worst, 0), factor, station, cmap="cividis",
                            vmin=0, vmax=highest, interpolation="nearest")  # fmt: skip
        ax.set_facecolor(PALE)
        lost = pooled(found.kind == LOST_LIGHT, factor, np.maximum)
        place_image(ax, np.ma.masked_equal(lost, 0), factor, station,
                    cmap=ListedColormap([DARK]), interpolation="nearest")  # fmt: skip
        millimetres(ax)
        bar = sheet.axes(left + width + 16, top, 16, bar_height)
        sheet.figure.colorbar(drawn, cax=bar).set_label(f"mm on the {where}", fontsize=10)
        bar.axhline(reach, color=SKY, linewidth=3)
    left, top = corners[-1]
    sheet.text(left, top - 24, "Blind pixels")
    ax = sheet.axes(left, top, width, height)
    # The highest code prevails in a square of pixels, and blind ones are to.
    codes = np.where(found.kind == OFF_PART, 0, found.kind + 1).astype(np.uint8)
    draw_codes(ax, codes, station, [colours[OFF_PART], *colours[:OFF_PART]])
    millimetres(ax)
    sheet.text(MARGIN, below, "About the farthest pixel, over one period")
    _draw_row(sheet.axes(MARGIN, below + 28, WIDTH - 2 * MARGIN, 220), found)
    return sheet.figure


def _draw_row(ax: Axes, found: Coverage) -> None:
    """Draw the distance on the part along the row of the farthest pixel, about it."""
    (rows, columns), p = found.station.shape, found.station.camera.sampling_mm
    row, column = np.unravel_index(
        np.nan_to_num(found.on_part_mm, nan=-1.0).argmax(), found.on_part_mm.shape
    )
    half = math.ceil(found.station.tunnel.period_mm / found.magnification / 2 / p)
    near = slice(max(int(column) - half, 0), int(column) + half + 1)
    x = (np.arange(columns)[near] + 0.5 - columns / 2) * p
    distance = found.on_part_mm[row, near]
    ax.plot(x, distance, ".-", color="black", markersize=4, label="distance to a transition")
    ax.axhline(found.reach_mm, color=SKY, linestyle="--",
               label=f"scan rule, {found.reach_mm:.3g} mm")  # fmt: skip
    highest = max(float(np.nanmax(distance, initial=0)), found.reach_mm)
    ax.set(xlim=(x[0], x[-1]) if len(x) > 1 else None, ylim=(0, 1.15 * highest or 1.0))
    y = (rows / 2 - row - 0.5) * p
    open_frame(ax, f"x, mm, in the row at y = {y:.3g} mm", "mm on the part")
    ax.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False, fontsize=10)
