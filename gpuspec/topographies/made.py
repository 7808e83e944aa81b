"""Surfaces that are made, not measured: something to try a measured relief with.

Named in place of a file: ``part.relief.file = "polished"``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SURFACES = ("polished",)


@dataclass(frozen=True, eq=False)
class Surface:
    """A relief.

    Attributes
    ----------
    heights_mm : ndarray of float64, shape (ny, nx)
        First line the top, read-only.
    pitch_mm : float
        Along x and y.
    """

    heights_mm: NDArray[np.float64]
    pitch_mm: float


def is_made(name: str, path: Path) -> bool:
    """Whether a file named in a station, to be found at `path`, is a surface that is made.

    Parameters
    ----------
    name : str
        As the station names it.
    path : Path
        Where such a file would be.
    """
    return name in SURFACES and not path.is_file()


@cache
def surface(name: str) -> Surface:
    """Return a surface by name.

    ``polished`` is like what an interferometer measures of a polished metal: 1.96 x 1.68 mm, waves
    of 2.2 mrad rms slope, a slight bow, and 19 pits, 0.08 to 1.2 um deep and 4 to 20 um wide.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    return {"polished": _polished}[name]()


def _polished() -> Surface:
    pitch, (ny, nx), random = 0.0035, (480, 560), np.random.default_rng(11)
    x = (np.arange(nx) - (nx - 1) / 2) * pitch
    y = ((ny - 1) / 2 - np.arange(ny))[:, None] * pitch
    fx = np.fft.rfftfreq(nx, pitch)
    frequency = np.hypot(fx, np.fft.fftfreq(ny, pitch)[:, None])
    spectrum = np.exp(-(((frequency - 25) / 10) ** 2))  # waves of 30 to 60 um: some 15 nm high
    waves = np.fft.irfft2(np.fft.rfft2(random.standard_normal((ny, nx))) * spectrum, (ny, nx))
    slope = np.hypot(*np.gradient(waves, pitch))
    heights = waves * (0.0022 / np.sqrt(np.mean(slope**2))) - 2e-4 * (x**2 + y**2)
    depth = 1e-3 * np.geomspace(0.08, 1.2, 19)
    width = np.geomspace(0.004, 0.02, 19) * random.uniform(0.8, 1.25, 19)
    # One pit in each field of a grid of 5 x 4, so that no two meet.
    fields = random.permutation(20)[:19]
    px = ((fields % 5 + random.uniform(0.2, 0.8, 19)) / 5 - 0.5) * nx * pitch
    py = ((fields // 5 + random.uniform(0.2, 0.8, 19)) / 4 - 0.5) * ny * pitch
    for d, w, cx, cy in zip(depth, width, px, py, strict=True):
        heights -= d * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2 / (w / 4) ** 2)
    heights.setflags(write=False)
    return Surface(heights, pitch)
