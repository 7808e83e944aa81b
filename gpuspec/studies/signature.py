"""The signature of a defect against its distance to the light transition: the paper's figure 7.

One transition is moved away from a dent, image by image; the width of what the dent makes bright
beside it is measured along the dent's row, and held against the closed form.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.pictures.page import MARGIN, VERMILION, WIDTH, Sheet
from gpuspec.pictures.place import open_frame
from gpuspec.simulation.cautions.station import of_station
from gpuspec.station.station import Station
from gpuspec.studies.deflection import (
    PIXELS_PER_SIGMA,
    STEEP,
    Dent,
    hardest,
    magnification,
    signature_width,
    strength,
)
from gpuspec.studies.outcome import GREY, Outcome, percent

Array = NDArray[np.float64]
_BEYOND = 1.15  # of the distance at which the signature vanishes


@dataclass(frozen=True, repr=False)
class Signature(Outcome):
    """Width of a dent's signature over the distance of one light transition.

    Attributes
    ----------
    station : Station
        The row of the dent as it was simulated: image k has the transition at the k-th distance.
    dent : Dent
    strength : float
        A of the dent.
    distance : ndarray, shape (K,)
        Of the transition from the dent's centre, on the part, in sigmas.
    closed_form, simulated : ndarray, shape (K,)
        Width of the signature in sigmas, by the law and from the images.
    """

    name: ClassVar[str] = "signature"

    dent: Dent
    strength: float
    distance: Array
    closed_form: Array
    simulated: Array

    @property
    def vanishing(self) -> float:
        """Distance near which the signature vanishes, A / sqrt e - 1, in sigmas; 0: never there."""
        return max(self.strength / math.sqrt(math.e) - 1, 0.0)

    @property
    def largest_difference(self) -> float:
        """Between images and law, in sigmas."""
        return float(np.abs(self.simulated - self.closed_form).max())

    def numbers(self) -> dict[str, Any]:
        """See :meth:`Outcome.numbers`."""
        return {
            "diameter_mm": self.dent.diameter_mm,
            "depth_um": self.dent.depth_um,
            "strength": self.strength,
            "vanishing_sigma": self.vanishing,
            "vanishing_mm": self.vanishing * self.dent.sigma_mm,
            "largest_difference_sigma": self.largest_difference,
        }

    def findings(self) -> tuple[str, ...]:
        """See :meth:`Outcome.findings`."""
        if not self.closed_form.any():
            return (
                f"{self.dent}: A = {self.strength:.3g}; too faint to show at any distance of a "
                f"transition.",
            )
        gone = self.vanishing * self.dent.sigma_mm
        return (
            f"{self.dent}: A = {self.strength:.3g}; its signature is "
            f"{percent(self.closed_form[0] / 4)} of its diameter at a transition and vanishes "
            f"{gone:.3g} mm ({self.vanishing:.3g} sigma) from one.",
            f"The images differ from the closed form by {self.largest_difference:.3f} sigma at "
            f"most; a pixel is {1 / PIXELS_PER_SIGMA:g} sigma.",
        )

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """See :meth:`Outcome.table`."""
        heads = ("distance_sigma", "distance_mm", "closed_form_sigma", "simulated_sigma",
                 "closed_form_percent", "simulated_percent")  # fmt: skip
        columns = (
            self.distance,
            self.distance * self.dent.sigma_mm,
            self.closed_form,
            self.simulated,
            self.closed_form * 25,
            self.simulated * 25,
        )
        return heads, list(np.stack(columns, axis=1).tolist())

    def figure(self) -> Figure:
        """See :meth:`Outcome.figure`."""
        pass

        return signature_picture(self)


def study(
    station: Station | None = None,
    dent: Dent | None = None,
    distances: int = 41,
    backend: str | Backend = "auto",
    device: str | None = None,
) -> Signature:
    """Measure a dent's signature while one light transition moves away from it.

    Parameters
    ----------
    station : Station, optional
        Tunnel, camera and crown are taken from it; None: a tunnel at 100 mm, a camera at 800 mm.
    dent : Dent, optional
        None: the station's defect that shows from the least distance, or without a station one
        of 1 mm, 10 µm deep.
    distances : int
        Number of distances, from 0 to a little beyond where the signature vanishes.
    backend, device
        As for :func:`gpuspec.simulate`.

    Returns
    -------
    Signature

    Raises
    ------
    StationError
        If the station has no dent, bump or scratch, or the dent is larger than the part or too
        steep for the law.
    BackendError
        If the backend is absent or fails.

    Examples
    --------
    >>> found = gpuspec.study("signature", distances=5)
    >>> print(found.findings()[0])
    dent of 1 mm, 10 µm deep: A = 28.4; its signature is 64.7 % of its diameter at a
        transition and vanishes 4.06 mm (16.3 sigma) from one.
    """
    notes = () if station is None else tuple(of_station(station))
    if station is None:
        station = Station.from_dict({"tunnel": {"height_mm": 100.0}}, "default station")
        dent = dent or Dent(1.0, 10.0)
    dent = dent or hardest(station)
    if distances < 2:
        raise StationError(f"a curve over {distances} distances is none; ask for 2 or more.")
    row = moved_transition(station, dent, distances)
    engine = open_backend(backend, device)
    light_map = engine.trace(row)
    p, sigma = row.camera.sampling_mm, dent.sigma_mm
    columns = row.shape[1]
    u = (np.arange(columns) + 0.5 - columns / 2) * p / sigma
    distance: Array = np.arange(distances, dtype=np.float64) * row.step_mm
    distance /= magnification(station) * sigma
    half = row.sensor.full_scale_dn / 2
    bright = [light_map.image(k)[0] > half for k in range(distances)]
    lit = [(u < far) & image for far, image in zip(distance, bright, strict=True)]
    width: Array = np.count_nonzero(lit, axis=1) * p / sigma
    force = strength(dent, station)
    law = signature_width(distance, force)
    return Signature(row, engine.info, dent, force, distance, law, width, notes=notes)


def moved_transition(station: Station, dent: Dent, distances: int) -> Station:
    """Return one row of pixels across a dent, under two stripes wider than all it shows.

    Image k of its sequence has the transition, dark to luminous, at the k-th distance. The sensor
    does not saturate, so that half of full scale is where the transition passes.

    Parameters
    ----------
    station : Station
        What else it takes: tunnel, camera, part.
    dent : Dent
    distances : int
        Number of images.

    Raises
    ------
    StationError
        If the dent is steeper than the law holds, or does not fit on the part.
    """
    sigma, along = dent.sigma_mm, magnification(station)
    if dent.slope > STEEP:
        raise StationError(
            f"a {dent} has slopes up to {dent.slope:.2g}; the law is for small slopes, up to "
            f"{STEEP:g}: give a shallower or wider one."
        )
    force = strength(dent, station)
    far = _BEYOND * max(force / math.sqrt(math.e) - 1, 1.0)
    half_row = math.sqrt(2 * math.log(max(force, math.e))) + 1
    if half_row * sigma > station.part.length_mm / 2:
        raise StationError(
            f"{station.file}: a {dent} does not fit on part.length_mm = "
            f"{station.part.length_mm:g}; give a smaller one."
        )
    stripe = 4 * (far + half_row) * sigma * along
    return dent.alone_on(station).replace(
        **{
            "part.material": "ideal", "part.roughness_rad": 0.0, "part.diffuse": 0.0,
            "tunnel.profile": "stripes",
            "tunnel.luminous_mm": stripe, "tunnel.dark_mm": stripe, "tunnel.dark_leak": 0.0,
            "camera.pupil_mm": 0.0, "camera.blur_mm": 0.0,
            "camera.focus_mm": None, "camera.vignetting": "none",
            "camera.columns": 2 * math.ceil(half_row * PIXELS_PER_SIGMA),
            "sensor.exposure": 1.0, "sensor.noise": False,
            "sequence.images": distances, "sequence.lag": 1,
            "sequence.step_mm": far * sigma * along / (distances - 1),
        }
    )  # fmt: skip


def signature_picture(found: Signature) -> Figure:
    """Draw both widths over the distance."""
    sheet = Sheet(WIDTH, 770)
    tunnel, camera = found.station.tunnel, found.station.camera
    sheet.heading(
        "Signature of a dent against its distance to the light transition",
        f"{found.dent} (σ = {found.dent.sigma_mm:.3g} mm)  ·  {tunnel.section} at "
        f"{tunnel.top_mm:g} mm, camera at {camera.height_mm:g} mm  ·  A = {found.strength:.3g}",
        str(found.info),
    )
    ax = sheet.axes(MARGIN, 174, WIDTH - 2 * MARGIN, 520)
    open_frame(
        ax, "distance of the transition from the dent's centre, σ", "width of the signature, σ"
    )
    far = float(found.distance[-1])
    fine = np.linspace(0, far, 500)
    law = signature_width(fine, found.strength)
    curve = ax.plot(fine, law, color="black", label="closed form")
    dots = ax.plot(found.distance, found.simulated, "o", color=VERMILION, markersize=6,
                   label="measured in the simulated images")  # fmt: skip
    handles = [*curve, *dots]
    if found.vanishing:
        name = f"A/√e − 1 = {found.vanishing:.3g}"
        handles.append(ax.axvline(found.vanishing, color=GREY, linestyle="--", label=name))
    top = max(1.08 * float(law.max()), 0.5)
    ax.set(xlim=(0, far), ylim=(-0.02 * top, top))
    sheet.legend(handles, 100)
    across = ax.secondary_xaxis("top", functions=_times(found.dent.sigma_mm))
    across.set_xlabel("distance on the part, mm", fontsize=10)
    share = ax.secondary_yaxis("right", functions=_times(25.0))
    share.set_ylabel("share of the diameter, %", fontsize=10)
    return sheet.figure


def _times(factor: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return what turns an axis into one in another unit, and back."""
    return lambda value: value * factor, lambda value: value / factor
