"""The float64 reference of the stripes: what a footprint sees of them, and its mean over a scan.

Told another way than `kernels/stripes.h`: by integrals of the stripes, and by one sum over all
sides whether they overlap or not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.diffuse import diffuse_share
from gpuspec.light.float64_profile import profile_seen
from gpuspec.station.station import Station

Array = NDArray[np.float64]
_NARROW_MIN = 1e-5
_EDGE = 1e-12  # periods
_STEPS_MAX = 52
_SIDES = ((-1, 0), (-1, -1), (1, -1), (1, 0))


def lit_fraction(
    light: Array, wide: Array, narrow: Array, shift_mm: float, station: Station
) -> Array:
    """Return the luminous share of the footprint, by the integral of the stripes.

    Of a profile that is no stripes it is the mean luminance.

    Parameters
    ----------
    light, wide, narrow : ndarray
        Light coordinate and widths of the footprint's two boxes in mm, of one shape.
    shift_mm : float
        Of the tunnel.
    station : Station
        Its stripes are used.

    Returns
    -------
    ndarray of float64, of the same shape
        From 0 to 1.

    Examples
    --------
    >>> from gpuspec.light.float64_stripes import lit_fraction
    >>> station = gpuspec.Station(tunnel={"luminous_mm": 4.0, "dark_mm": 12.0})
    >>> light = np.array([2.0, 4.0, 8.0])  # in the stripe, on its edge, in the dark
    >>> lit_fraction(light, np.full(3, 1.0), np.full(3, 0.5), 0.0, station).tolist()
    [1.0, 0.5, 0.0]
    """
    period = station.tunnel.period_mm
    a = station.tunnel.luminous_mm / period
    u, w1, w2 = (light - shift_mm) / period, wide / period, _finite(narrow / period)
    if not station.tunnel.is_striped:
        return profile_seen(u, w1, w2, station.tunnel)

    def twice_integrated(u: Array) -> Array:
        """Of the stripes less their mean: periodic, so that nothing grows."""
        r = u - np.floor(u)
        return (r - a) / 2 * np.minimum((1 - a) * r, a * (1 - r))

    outer, inner = (w1 + w2) / 2, (w1 - w2) / 2
    ends = twice_integrated(u + outer) + twice_integrated(u - outer)
    ends -= twice_integrated(u + inner) + twice_integrated(u - inner)
    return np.clip(a + ends / (w1 * w2), 0, 1)


def _finite(narrow: Array) -> Array:
    return np.maximum(narrow, _NARROW_MIN)


@dataclass(frozen=True)
class Exposure:
    """Signal over saturation as a function of the shift, lengths in periods.

    A luminous stretch seen through two boxes is three boxes folded; the widest is a stripe, the
    other two make its sides.

    Attributes
    ----------
    centre : ndarray
        Of a stripe.
    edge : ndarray
        Distance of a side's foot from it.
    flank, corner : ndarray
        The two boxes of a side, `flank` the wider.
    base, slope : ndarray
        The exposure is base + slope times how far all sides have risen.
    """

    centre: Array
    edge: Array
    flank: Array
    corner: Array
    base: Array
    slope: Array

    @classmethod
    def of(
        cls, light: Array, wide: Array, narrow: Array, irradiance: Array, station: Station
    ) -> Exposure:
        """Return what pixels see.

        Parameters
        ----------
        light, wide, narrow, irradiance : ndarray
            Light coordinate and widths of the footprint's boxes in mm, and relative irradiance.
        station : Station
            Its stripes and exposure are used.
        """
        period, leak = station.tunnel.period_mm, station.tunnel.dark_leak
        a = station.tunnel.luminous_mm / period
        w1, w2 = wide / period, _finite(narrow / period)
        n1, n2 = np.floor(w1), np.floor(w2)
        boxes = np.sort(np.stack([w1 - n1, w2 - n2, np.broadcast_to(a, w1.shape)]), axis=0)
        corner, flank, widest = np.maximum(boxes[0], 1e-9), boxes[1], boxes[2]
        lit = a * (n2 * w1 + (w2 - n2) * n1) / (w1 * w2)
        gain = station.sensor.exposure * irradiance
        return cls(
            light / period - a / 2 - (n1 + n2) / 2,
            (widest + flank + corner) / 2,
            flank,
            corner,
            gain * (leak + (1 - leak) * lit + diffuse_share(station)),
            gain * (1 - leak) * corner / (w1 * w2),
        )

    def rise(self, y: Array, degree: int) -> Array:
        """Return how far a side has risen at y from its foot; its slope or its integral.

        Parameters
        ----------
        y : ndarray
        degree : int
            0 for the slope, 1 for the height, 2 for the integral of the height.
        """
        ends = ((0, 1), (self.corner, -1), (self.flank, -1), (self.flank + self.corner, 1))
        total = np.zeros_like(y)
        for end, sign in ends:
            beyond = np.maximum(y - end, 0)
            total += sign * (beyond, beyond * beyond, beyond * beyond * beyond)[degree]
        return total / (self.corner * (1, 2, 6)[degree])

    def sides(self, d: Array, degree: int) -> Array:
        """Return the sum of all sides at a distance from a stripe's centre, 0 to 1/2.

        Parameters
        ----------
        d : ndarray
        degree : int
            Of :meth:`rise`.
        """
        total = -self.flank * (0, 1, d)[degree]
        for sign, offset in _SIDES:
            term = self.rise(self.edge + sign * d + offset, degree)
            total = total + (1 if degree == 1 else sign) * term
        return total

    def saturated_to(self) -> Array:
        """Return the distance from a stripe's centre up to which it saturates.

        By Newton's method, and by halves where it leaves what is known to hold the edge.
        """

        def excess(x: Array) -> Array:
            return self.base + self.slope * self.sides(x, 1) - 1

        zero, half = np.zeros_like(self.edge), np.full_like(self.edge, 0.5)
        low, high = np.where(excess(half) >= 0, half, 0), np.where(excess(zero) <= 0, 0, half)
        x = np.clip(self.edge - (self.flank + self.corner) / 2, low, high)
        for _ in range(_STEPS_MAX):
            over = excess(x)
            low, high = np.where(over > 0, x, low), np.where(over > 0, high, x)
            fall = self.slope * self.sides(x, 0)
            step = np.divide(over, fall, out=np.full_like(x, 2.0), where=fall < 0)
            inside = (x - step >= low) & (x - step <= high)
            following = np.where(inside, x - step, (low + high) / 2)
            moved, x = np.abs(following - x), following
            if moved.max(initial=0) < _EDGE:
                break
        return np.where(x < 1e-9, 0.0, np.where(x > 0.5 - 1e-9, 0.5, x))


def mean_over_scan(
    light: Array, wide: Array, narrow: Array, irradiance: Array, station: Station
) -> Array:
    """Return the mean of min(E, 1) over a whole period in equal steps, in closed form.

    By the formula of Euler and Maclaurin, which is exact for pieces of polynomials.

    Parameters
    ----------
    light, wide, narrow : ndarray
        Light coordinate and widths of the footprint's two boxes in mm, of one shape.
    irradiance : ndarray
        Relative, of the same shape.
    station : Station
        Its shifts fill whole periods in equal steps.

    Returns
    -------
    ndarray of float64, of the same shape
        From 0 to 1, full scale.
    """
    assert station.distinct_shifts is not None
    shifts = station.distinct_shifts
    e = Exposure.of(light, wide, narrow, irradiance, station)
    x = e.saturated_to()
    area = e.sides(np.full_like(x, 0.5), 2) - e.sides(x, 2)
    mean = 2 * (x + e.base * (0.5 - x) + e.slope * area)
    fall = np.where((x > 0) & (x < 0.5), e.slope * e.sides(x, 0), 0)
    for mirrored in (-1, 1):
        phase = (x + mirrored * e.centre) * shifts
        r = phase - np.floor(phase)
        mean = mean - fall * (r * r - r + 1 / 6) / (2 * shifts**2)
    for sign, offset in _SIDES:
        for foot, bend in ((0.0, 1), (e.flank, -1)):
            ends = sign * (foot - e.edge - offset), sign * (foot + e.corner - e.edge - offset)
            first, last = np.minimum(*ends), np.maximum(*ends)
            length = np.minimum(last, 0.5) - np.maximum(first, x)
            first = np.clip(first, x, 0.5)
            for mirrored in (-1, 1):
                phase = (first + mirrored * e.centre) * shifts
                change = _b3(phase + np.maximum(length, 0) * shifts) - _b3(phase)
                mean = mean - bend * e.slope / e.corner * change / (6 * shifts**3)
    return np.minimum(mean, 1)


def _b3(x: Array) -> Array:
    """Return the periodic Bernoulli polynomial of the third degree."""
    t = x - np.floor(x)
    return t * (t - 0.5) * (t - 1)
