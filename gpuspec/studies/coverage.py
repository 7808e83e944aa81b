"""Scan coverage: how near a light transition comes to each point of the part over the sequence.

The scan rule, from the law of the signature: a transition must pass within (A / sqrt e - 1) sigma
of every point, so that the step on the part is at most twice that for the defect hardest to show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gpuspec.backends import BESIDE, Backend, DeviceInfo, Image
from gpuspec.cautions import of_light, of_station
from gpuspec.devices import open_backend
from gpuspec.errors import StationError
from gpuspec.inspection import check_memory
from gpuspec.station import Station
from gpuspec.studies.deflection import Dent, hardest, magnification, reach_mm
from gpuspec.studies.outcome import Outcome, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("scanned", "too far from a transition", "lost", "beside the part")
SCANNED, TOO_FAR, LOST_LIGHT, OFF_PART = range(4)
_BAND_PIXELS = 250_000


@dataclass(frozen=True, repr=False)
class Coverage(Outcome):
    """How near the nearest transition comes to each pixel over the sequence.

    Attributes
    ----------
    station : Station
    info : DeviceInfo
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
    notes : tuple of str
        What is wrong with the station, see :mod:`gpuspec.cautions`.
    """

    name: ClassVar[str] = "coverage"

    station: Station
    info: DeviceInfo
    dent: Dent
    reach_mm: float
    magnification: float
    on_light_mm: Image
    on_part_mm: Image
    kind: NDArray[np.uint8]
    notes: tuple[str, ...] = ()

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
        from gpuspec.studies.drawing import coverage_picture

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
        If the station has no dent, bump or scratch, the camera sees nothing of the part, or the
        image exceeds the memory.
    BackendError
        If the backend is absent or fails.
    """
    dent = dent or hardest(station)
    check_memory(station)
    engine = open_backend(backend, device) if isinstance(backend, str) else backend
    # Of a sharp pinhole the footprint is what one pixel's square covers of the light: its gradient.
    flawless = station.replace(
        **{
            "defects": [], "populations": [], "part.relief": None, "part.roughness_rad": 0.0,
            "camera.pupil_mm": 0.0, "camera.subsampling": 1,
        }
    )  # fmt: skip
    read = engine.trace(flawless).read()
    if (read.lost == BESIDE).all():
        raise StationError(
            f"{station.file}: no pixel of the image sees the part; check part.length_mm, "
            f"part.width_mm and camera.sampling_mm."
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
        station, engine.info, dent, reach, magnification(station), on_light, on_part, kind, notes
    )


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
