"""How noisy the flawless surface of an aspect image is, in closed form: a measure of margins."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gpuspec.light.diffuse import diffuse_share
from gpuspec.light.float64_backend import NumpyLightMap
from gpuspec.light.float64_noise import Excess, unclipped_variance
from gpuspec.light.float64_stripes import lit_fraction
from gpuspec.part.relief import Relief
from gpuspec.station.station import Station

PLACES = 0.15, 0.4, 0.85
"""Across the image and along it, where it is looked at."""

_PIXELS = 9
_STEPS = 64  # over what an edge of a stripe needs to move in; over a period, where that is less


class Noise:
    """The noise of one geometry's flawless surface under any stripes, sensor and sequence.

    Of nine pixels the variance of one grey level is taken over a whole period, its clipping and
    rounding included; the mean of K images has a K-th of it. It is what the sensor would add,
    whether ``sensor.noise`` is true or not.

    Parameters
    ----------
    wide, narrow, irradiance : ndarray, shape (n,)
        Of some pixels: both boxes of their footprints, mm, and their irradiance, 0 where lost.
    """

    def __init__(self, wide: Any, narrow: Any, irradiance: Any) -> None:
        seen = np.flatnonzero(irradiance > 0)
        some = seen[np.linspace(0, len(seen) - 1, min(_PIXELS, len(seen))).astype(int)]
        self._planes = [
            np.asarray(plane[some], np.float64)[:, None] for plane in (wide, narrow, irradiance)
        ]
        self._lit: dict[Any, Any] = {}
        self._share: Any = 0.0
        self._known: dict[Any, float] = {}
        self._last: tuple[Any, ...] | None = None  # of the same objects it is not looked up
        self._variance = 0.0

    @classmethod
    def traced(cls, station: Station, relief: Relief) -> Noise:
        """Trace a few pixels in float64.

        Parameters
        ----------
        station : Station
            Its geometry.
        relief : Relief
            Of it.
        """
        camera = station.camera.model_copy(update={"subsampling": 1})
        rows, columns = station.shape
        row, column = (np.array([int(size * at) for at in PLACES]) for size in (rows, columns))
        pixels = (row[:, None] * columns + column).ravel().astype(np.uint32)
        one = station.model_copy(update={"camera": camera})
        arrays = NumpyLightMap(one, relief, pixels).read()
        lit = np.where(arrays.lost[0] == 0, arrays.irradiance[0, 0], 0)
        return cls(arrays.wide_mm[0, 0], arrays.narrow_mm[0, 0], lit)

    def of(self, station: Station) -> float:
        """Return the standard deviation in DN; NaN where no pixel is seen, or no mean is taken.

        Parameters
        ----------
        station : Station
            Of the geometry.
        """
        if station.sequence.fusion != "mean" or not len(self._planes[0]):
            return math.nan
        light = station.tunnel, station.sensor
        if self._last is None or any(a is not b for a, b in zip(self._last, light, strict=True)):
            self._last, self._variance = light, self._variance_under(station)
        return math.sqrt(self._variance / station.sequence.images)

    def _variance_under(self, station: Station) -> float:
        """Return the variance of one grey level under a light and a sensor."""
        sensor, key = station.sensor, (station.tunnel, station.sensor)
        if key not in self._known:
            seen = self._seen(station)
            signal = sensor.exposure * seen + sensor.dark_e / sensor.saturation_e
            _, more = Excess.of(sensor).at(signal)
            variance = np.where(signal < 1, unclipped_variance(signal, sensor), 0) + more
            by_pixel = (self._share * variance).sum(axis=1)
            self._known[key] = float(np.median(np.maximum(by_pixel, 0)))
        return self._known[key]

    def _seen(self, station: Station) -> Any:
        """Return the radiance that the pixels see at phases of a period, shape (pixels, phases)."""
        tunnel = station.tunnel
        if tunnel not in self._lit:
            wide, narrow, irradiance = self._planes
            phase, self._share = _phases(station, wide + narrow)
            lit = lit_fraction(phase, wide, narrow, 0.0, station)
            least = tunnel.dark_leak + diffuse_share(station)
            self._lit = {tunnel: irradiance * (least + (1 - tunnel.dark_leak) * lit)}
        return self._lit[tunnel]


def _phases(station: Station, reach: Any) -> tuple[Any, Any]:
    """Return light coordinates over a period, and the share of it that each stands for.

    Where the light is all dark or all luminous one of each is enough; where an edge of a stripe
    moves through the footprint they lie close.

    Parameters
    ----------
    station : Station
    reach : ndarray, shape (pixels, 1)
        Width of the footprint, mm.
    """
    tunnel = station.tunnel
    period, luminous = tunnel.period_mm, tunnel.luminous_mm
    middle = (np.arange(_STEPS) + 0.5) / _STEPS
    if not tunnel.is_striped or reach.max() >= min(luminous, tunnel.dark_mm):
        return np.broadcast_to(middle * period, (len(reach), _STEPS)), 1 / _STEPS
    edge = (middle - 0.5) * reach
    lit, dark = np.full_like(reach, luminous / 2), np.full_like(reach, (luminous + period) / 2)
    phase = np.concatenate([edge, luminous + edge, lit, dark], axis=1)
    each = np.repeat(reach / _STEPS, 2 * _STEPS, axis=1)
    share = np.concatenate([each, luminous - reach, tunnel.dark_mm - reach], axis=1)
    return phase, share / period
