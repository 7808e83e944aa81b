"""Measured topographies: read with their units, filled, form removed, ready for the device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.station import Station


@dataclass(frozen=True)
class TopographyMap:
    """A map of relief on a regular grid, laid on the part."""


def read_maps(station: Station) -> tuple[TopographyMap, ...]:
    """Read the part's relief and the measured patches."""
    return ()


def map_records(maps: tuple[TopographyMap, ...], station: Station) -> NDArray[np.float32]:
    """Return the structs ``Map`` of `kernels/station.h`, shape (n, 3, 4)."""
    return np.zeros((0, 3, 4), np.float32)


def coefficients(maps: tuple[TopographyMap, ...]) -> NDArray[np.float32]:
    """Return the spline coefficients of all maps, one after another."""
    return np.zeros(0, np.float32)
