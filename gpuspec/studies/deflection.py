"""How strongly a defect deflects the light, and from how far it shows: the closed form.

In one dimension, along the row through a dent's centre, with H the tunnel's height, h the camera's,
d the depth, sigma a quarter of the diameter: a flat part shows the light coordinate x M,
M = 1 + H/h, and the dent adds -2 H z'(x). In units of sigma on the part, u = x / sigma, it shows
u - A u exp(-u^2 / 2), with A = 2 H d / (sigma^2 M). A crown along x, of curvature c, adds 2 H c
to M. Slopes are taken as small. It is the law behind figure 7 of Seulin, Merienne, Gorria; the
formula is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpuspec.errors import StationError
from gpuspec.part.placement import place
from gpuspec.station.defects import Patch, Scratch
from gpuspec.station.optics import NO_DATA_SHEET
from gpuspec.station.station import Station
from gpuspec.units import MICRO

Array = NDArray[np.float64]

PIXELS_PER_SIGMA = 250
STEEP = 0.5  # slope above which light does not move in proportion to it
_OFFSETS = np.linspace(-8.0, 0.0, 16_001)  # sigmas; a Gaussian slope is below 1e-13 beyond


@dataclass(frozen=True)
class Dent:
    """A Gaussian dent; a bump shows alike, and so does a scratch across the light's movement.

    Attributes
    ----------
    diameter_mm : float
        Of its zone, 4 sigma.
    depth_um : float

    Examples
    --------
    >>> from gpuspec.studies.deflection import Dent
    >>> dent = Dent(diameter_mm=0.8, depth_um=5.0)
    >>> dent.sigma_mm, round(dent.slope, 4)
    (0.2, 0.0152)
    """

    diameter_mm: float
    depth_um: float

    def __str__(self) -> str:
        return f"dent of {self.diameter_mm:.3g} mm, {self.depth_um:.3g} µm deep"

    @property
    def sigma_mm(self) -> float:
        """Of the Gaussian."""
        return self.diameter_mm / 4

    @property
    def depth_mm(self) -> float:
        """Depth in mm."""
        return self.depth_um * MICRO

    @property
    def slope(self) -> float:
        """Greatest slope, d / (sigma sqrt e)."""
        return self.depth_mm / self.sigma_mm / math.sqrt(math.e)

    def alone_on(self, station: Station, x_mm: float = 0.0) -> Station:
        """Return a station whose only defect is this dent at (x, 0), seen by one row of pixels.

        Its tunnel reaches as far as any ray, without an opening; a pixel is so small, sigma / 250,
        that it does not average the dent.

        Parameters
        ----------
        station : Station
            What else it takes: tunnel, camera, part.
        x_mm : float
            Where the dent lies.
        """
        known = {"kind": "dent", "x_mm": x_mm, "y_mm": 0.0, "diameter_mm": self.diameter_mm,
                 "depth_um": self.depth_um}  # fmt: skip
        return without_defects(station).replace(
            **{
                **NO_DATA_SHEET,
                "camera.sampling_mm": self.sigma_mm / PIXELS_PER_SIGMA, "camera.rows": 1,
                "camera.columns": 1, "defects": [known],
            }
        )  # fmt: skip


def without_defects(station: Station) -> Station:
    """Return the station's shape alone, under a tunnel that reaches as far as any ray."""
    return station.replace(
        **{
            "part.relief": None, "defects": [], "populations": [],
            "tunnel.length_mm": 1e5, "tunnel.opening_length_mm": 0.0,
            "tunnel.opening_width_mm": 0.0, "camera.subsampling": 1, **NO_DATA_SHEET,
        }
    )  # fmt: skip


def magnification(station: Station) -> float:
    """Return M = dl/dx at the part's centre: how far on the light a step on the part leads.

    Raises
    ------
    StationError
        If a hollow crown turns the light round or gathers it in a point.
    """
    top = station.tunnel.top_mm
    crown = -float(station.part.shape.curvature(0.0, 0.0)[0])
    turned = 1 + top / station.camera.height_mm + 2 * top * crown
    if turned < 1e-3:
        raise StationError(
            f"{station.file}: part.crown_radius_x_mm = {station.part.crown_radius_x_mm:g} is so "
            f"hollow that the part shows the light reversed, or one point of it; the law of the "
            f"signature is for dl/dx > 0, a radius of less curvature."
        )
    return turned


def strength(dent: Dent, station: Station) -> float:
    """Return A = 2 H d / (sigma^2 M), the dent's slope in units of the part's own image.

    Parameters
    ----------
    dent : Dent
        Taken to lie at the part's centre.
    station : Station
        Its tunnel, camera and shape are used.
    """
    deflection = 2 * station.tunnel.top_mm * dent.depth_mm / dent.sigma_mm**2
    return deflection / magnification(station)


def reach_mm(dent: Dent, station: Station) -> float:
    """Return the distance on the part from which a transition still shows the dent.

    It is (A / sqrt e - 1) sigma; zero or less where no transition shows it.

    Parameters
    ----------
    dent : Dent
    station : Station

    Examples
    --------
    >>> from gpuspec.studies.deflection import Dent, reach_mm
    >>> round(reach_mm(Dent(diameter_mm=0.8, depth_um=5.0), gpuspec.example("trim")), 3)
    6.417
    """
    return (strength(dent, station) / math.sqrt(math.e) - 1) * dent.sigma_mm


def signature_width(distance: ArrayLike, strength: float) -> Array:
    """Return the width of a dent's signature, in sigmas.

    Parameters
    ----------
    distance : array_like, shape (n,)
        Of the transition from the dent's centre, delta >= 0, in sigmas.
    strength : float
        A of the dent.

    Returns
    -------
    ndarray, shape (n,)
        Length of {u < delta : u - A u exp(-u^2 / 2) > delta}, all of it in u < 0; zero from near
        delta = A / sqrt e - 1 on.
    """
    shown = _OFFSETS - strength * _OFFSETS * np.exp(-(_OFFSETS**2) / 2)
    beyond = shown - np.atleast_1d(np.asarray(distance, np.float64))[:, None]
    left, right = beyond[:, :-1], beyond[:, 1:]
    # Of each piece the share above zero, its ends joined by a straight line.
    share = np.maximum(np.maximum(left, right), 0) / np.maximum(np.abs(left - right), 1e-300)
    width: Array = np.minimum(share, 1).sum(axis=1) * (_OFFSETS[1] - _OFFSETS[0])
    return width


def dents(station: Station) -> tuple[Dent, ...]:
    """Return the station's dents, bumps and scratches as dents of their size and depth.

    Measured defects have no such size and are left out.

    Raises
    ------
    StationError
        If there is none, or a population does not fit.
    """
    known = tuple(
        Dent(d.width_mm if isinstance(d, Scratch) else d.diameter_mm, d.depth_um)
        for d in place(station)
        if not isinstance(d, Patch)
    )
    if not known:
        raise StationError(
            f"{station.file} has no dent, bump or scratch to study; add one under [[defects]], or "
            f"give --diameter-mm and --depth-um."
        )
    return known


def hardest(station: Station) -> Dent:
    """Return the station's defect that shows from the least distance; errors as :func:`dents`."""
    return min(dents(station), key=lambda dent: reach_mm(dent, station))


def described(diameter_mm: float | None, depth_um: float | None) -> Dent | None:
    """Return the dent of a size and depth; None if neither is given.

    Parameters
    ----------
    diameter_mm : float or None
        Of its zone, 4 sigma.
    depth_um : float or None

    Raises
    ------
    StationError
        If only one is given, or one is no possible length.
    """
    if diameter_mm is None and depth_um is None:
        return None
    if diameter_mm is None or depth_um is None:
        raise StationError("give --diameter-mm and --depth-um together, or neither.")
    for key, value, largest in (("diameter-mm", diameter_mm, 1e5), ("depth-um", depth_um, 1e4)):
        if not 0 < value <= largest:
            raise StationError(f"--{key} {value:g} must be greater than 0 and at most {largest:g}.")
    return Dent(diameter_mm, depth_um)
