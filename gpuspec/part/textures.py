"""Waves and orange peel of a part, laid on it as maps."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import StationError
from gpuspec.part.maps import TopographyMap
from gpuspec.station.station import Station
from gpuspec.topographies.form import Heights
from gpuspec.units import MICRO

WAVE_POINTS = 32
"""Of the map of a wave, per wavelength: its slope is then off by 3e-4, its curvature by 3e-3."""
PEEL_POINTS = 16
"""The same of orange peel, whose shortest waves have half the wavelength."""
PEEL_WIDTH = 0.4
"""Of the ring of waves: twice the standard deviation of their power, over its frequency."""
POINTS_MAX = 20_000_000
_MARGIN = 12  # points beyond the part's edge: there the spline's natural ends are forgotten
_POINTS_MIN = 8


def textures(station: Station) -> tuple[TopographyMap, ...]:
    """Return the part's waviness and orange peel as maps that cover it.

    Parameters
    ----------
    station : Station
        Its part is used.

    Raises
    ------
    StationError
        If a wavelength is so short that its map has too many points.

    Examples
    --------
    >>> from gpuspec.part.textures import textures
    >>> peel = {"wavelength_mm": 2.0, "slope_rad": 0.002}
    >>> textures(gpuspec.example("trim").replace(part__orange_peel=peel))
    (TopographyMap(part.orange_peel: 425 x 1625 heights in mm, pitch 0.125 x 0.125 mm),)
    """
    made = []
    if station.part.waviness:
        made.append(_wave(station))
    if station.part.orange_peel:
        made.append(_peel(station))
    return tuple(made)


def _wave(station: Station) -> TopographyMap:
    wave = station.part.waviness
    assert wave
    angle, k = math.radians(wave.direction_deg), 2 * math.pi / wave.wavelength_mm
    kx, ky = k * math.cos(angle), k * math.sin(angle)
    pitches = [2 * math.pi / (WAVE_POINTS * max(abs(part), 1e-9 * k)) for part in (kx, ky)]
    x, y, pitch = _grid(station, (pitches[0], pitches[1]), "waviness")
    phase = math.radians(wave.phase_deg)
    relief = wave.amplitude_um * MICRO * np.cos(kx * x + ky * y + phase)
    corner = float(x[0, 0]), float(y[0, 0])
    return TopographyMap(
        relief, relief, pitch, corner, None, "part.waviness", (),
        partial(_faded, relief, kx**2 + ky**2),
    )  # fmt: skip


def _peel(station: Station) -> TopographyMap:
    peel = station.part.orange_peel
    assert peel
    step = peel.wavelength_mm / PEEL_POINTS
    x, y, pitch = _grid(station, (step, step), "orange_peel")
    shape = len(y), x.shape[1]
    fx = np.fft.rfftfreq(shape[1], pitch[0])
    fy = np.fft.fftfreq(shape[0], pitch[1])[:, None]
    square, f0 = fx**2 + fy**2, 1 / peel.wavelength_mm
    amplitude = np.exp(-(((np.sqrt(square) - f0) / (PEEL_WIDTH * f0)) ** 2))
    amplitude[square == 0] = 0.0
    white = np.random.default_rng(peel.seed).standard_normal(shape)
    waves = np.fft.rfft2(white) * amplitude
    # Of a real field's transform one half is kept: all but the first and an even last column count
    # twice in its mean square.
    twice = np.full(len(fx), 2.0)
    twice[0] = 1.0
    if shape[1] % 2 == 0:
        twice[-1] = 1.0
    power = (np.abs(waves) ** 2 * twice * (2 * math.pi) ** 2 * square).sum()
    waves *= peel.slope_rad * math.prod(shape) / math.sqrt(power)
    relief = np.fft.irfft2(waves, shape)
    corner = float(x[0, 0]), float(y[0, 0])
    return TopographyMap(
        relief, relief, pitch, corner, None, "part.orange_peel", (),
        partial(_peel_faded, waves, (2 * math.pi) ** 2 * square, shape),
    )  # fmt: skip


def _peel_faded(
    waves: NDArray[np.complex128], square: Heights, shape: tuple[int, int], variance: float
) -> Heights:
    return np.fft.irfft2(_faded(waves, square, variance), shape)


def _faded(waves: NDArray[Any], square: Heights | float, variance: float) -> NDArray[Any]:
    """Return what a Gaussian leaves of waves of a squared wave number, 1/mm^2."""
    left: NDArray[Any] = waves * np.exp(-np.asarray(square) * variance / 2)
    return left


def _grid(
    station: Station, coarsest: tuple[float, float], key: str
) -> tuple[Heights, Heights, tuple[float, float]]:
    """Return x (1, nx) and y (ny, 1) of points that cover the part and a margin, and their pitch.

    Raises
    ------
    StationError
        If there are too many.
    """
    part = station.part
    sides = part.length_mm, part.width_mm
    counts = [
        max(math.ceil(side / most), _POINTS_MIN) for side, most in zip(sides, coarsest, strict=True)
    ]
    points = math.prod(n + 1 + 2 * _MARGIN for n in counts)
    if points > POINTS_MAX:
        raise StationError(
            f"{station.file}: part.{key}.wavelength_mm = {getattr(part, key).wavelength_mm:g} "
            f"takes a map of {points:,} points over a part of {sides[0]:g} x {sides[1]:g} mm, over "
            f"{POINTS_MAX:,}; give a longer one or a smaller part."
        )
    pitch = sides[0] / counts[0], sides[1] / counts[1]
    x, y = (
        (np.arange(n + 1 + 2 * _MARGIN) - _MARGIN - n / 2) * p
        for n, p in zip(counts, pitch, strict=True)
    )
    across: NDArray[np.float64] = x[None, :].astype(np.float64)
    down: NDArray[np.float64] = y[:, None].astype(np.float64)
    return across, down, pitch
