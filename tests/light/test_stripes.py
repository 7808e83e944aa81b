"""Device functions of `kernels/stripes.h`, one by one, each a law."""

from __future__ import annotations

import numpy as np
import pytest
import tolerances
from device import Device
from laws import GROUPS, Array, Draws, close, holds, overlap, rounded, shared

STRIPES = ("stripes.h",)


class Stripes:
    """Random footprints, in periods, over random stripes: every order of size, every share."""

    def __init__(self, seed: int) -> None:
        d = Draws(seed, 2 * GROUPS)
        self.light = d.pixel(-30, 30)
        self.footprint = d.scales(1e-5, 60)
        self.footprint[:20] = 1
        self.footprint[20:30] = 3
        self.footprint[30:40] = rounded(1e-4)
        self.luminous = d.shared(0.02, 0.98)
        self.luminous[40:60], self.luminous[60:80] = rounded(1e-4), rounded(1 - 1e-4)
        self.irradiance = d.pixel(0.2, 1)
        self.irradiance[80:90] = 0
        self.gain = d.scales(0.05, 100, True)
        self.leak = np.where(d.shared(0, 1) < 0.4, 0, d.shared(0, 0.9))
        self.gain[90:110], self.leak[90:110] = 8, 0.5
        self.draws = d
        self.inputs = {
            "REAL light": self.light, "REAL footprint": self.footprint,
            "REAL irradiance": self.irradiance,
            **shared(luminous=self.luminous, gain=self.gain, leak=self.leak),
        }  # fmt: skip

    @property
    def rounding(self) -> Array:
        """Uncertainty of the place of the footprint's ends: the last bit of where they are."""
        return tolerances.LIGHT_ROUNDING * (np.abs(self.light) + self.footprint + 1)

    def exposure(self, light: Array) -> Array:
        lit = overlap(light, self.footprint, self.luminous)
        return self.gain * self.irradiance * (self.leak + (1 - self.leak) * lit)


@holds("lit_fraction", wrong=("max(luminous + rest - 1.0f, 0.0f)", "0.0f * rest"))
@holds("at_shift", wrong=("fabs(u - rint(u))", "fabs(u - floor(u))"))
def test_the_lit_fraction_is_the_share_of_the_footprint_on_luminous_stripes(device: Device) -> None:
    s = Stripes(22)
    shift = s.draws.shared(0, 40)
    shift[::4] = 0
    code = "Trapezoid q = lit_fraction(light, footprint, luminous); REAL lit = at_shift(q, shift);"
    (got,) = device.call(STRIPES, code, {**s.inputs, **shared(shift=shift)}, ("lit",))
    limit = tolerances.LIT + (s.rounding + tolerances.LIGHT_ROUNDING * shift) / s.footprint
    close(got, overlap(s.light - shift, s.footprint, s.luminous), limit)
    inside = (got >= -limit) & (got <= 1 + limit)
    assert inside.all()


@holds("exposed", wrong=("q.slope *= full * (1.0f - leak)", "q.slope *= full"))
def test_exposure_is_gain_times_irradiance_times_what_is_lit_or_leaks(device: Device) -> None:
    s = Stripes(23)
    code = """Trapezoid q = lit_fraction(light, footprint, luminous);
        REAL e = at_shift(exposed(q, irradiance, gain, leak), 0.0f);"""
    (got,) = device.call(STRIPES, code, s.inputs, ("e",))
    full = s.gain * s.irradiance
    close(got, s.exposure(s.light), full * (tolerances.LIT + s.rounding / s.footprint) + 1e-30)
    assert not got[80:90].any()


@holds("series_side", wrong=("0.5f * (n0 + n1 - 1.0f)", "0.5f * (n0 + n1 + 1.0f)"))
def test_a_side_of_the_series_is_the_direct_sum_of_its_samples(device: Device) -> None:
    d = Draws(24)
    steps = d.scales(1, 800, True)
    o, reach = d.pixel(0, 1), rounded(d.pixel(0, 0.5) * steps)
    h = rounded(reach * d.pixel(0, 1))
    k = rounded(h * np.maximum(d.pixel(-1, 1), 0))
    k[:10] = h[:10]
    inputs = {"REAL o": o, "REAL reach": reach, "REAL h": h, "REAL k": k}
    (got,) = device.call(STRIPES, "REAL sum = series_side(o, reach, h, k);", inputs, ("sum",))
    distance = np.arange(420)[:, None, None] + o
    expected = (np.clip(reach - distance, k, h) - k).sum(axis=0)
    close(got, expected, tolerances.SERIES * (reach + 1) * (reach + 1))


@holds("mean_over_scan", wrong=("1.0f - phase, t.reach", "phase, t.reach"))
def test_the_mean_over_a_scan_is_the_mean_of_the_saturated_images(device: Device) -> None:
    s = Stripes(25)
    choices = np.array([1, 2, 3, 7, 8, 40, 100])
    shifts = choices[np.arange(s.draws.groups) % len(choices)][:, None]
    code = """REAL mean = mean_over_scan(exposed(lit_fraction(light, footprint, luminous),
                                             irradiance, gain, leak), shifts);"""
    (got,) = device.call(STRIPES, code, {**s.inputs, **shared(shifts=shifts)}, ("mean",))
    expected = np.zeros(got.shape)
    limit = np.zeros(got.shape)
    for k in range(int(shifts.max())):
        # Each image may be wrong by what the light's last bits are worth to it.
        taken = (k < shifts) / shifts
        here, *near = (
            np.minimum(s.exposure(s.light - k / shifts + e * s.rounding), 1) for e in (0, -1, 1)
        )
        expected += taken * here
        limit += taken * sum(np.abs(beside - here) for beside in near)
    # What is cut off above saturation was there: its last bit is lost.
    full = s.gain * s.irradiance
    close(got, expected, limit + tolerances.SCAN * full + 1e-30)
    # Dark stripes that leak enough saturate every image; no irradiance is dark.
    close(
        got[90:110],
        np.minimum(expected[90:110], 1),
        limit[90:110] + (tolerances.SCAN * full)[90:110],
    )
    assert not got[80:90].any()


@pytest.mark.slow
@holds("highest_mean_over_scan", wrong=("t.centre = t.reach - min", "t.centre = 0.0f * min"))
def test_no_light_coordinate_has_a_higher_mean_over_a_scan(device: Device) -> None:
    s = Stripes(29)
    choices = np.array([1, 2, 3, 7, 12])
    shifts = choices[np.arange(s.draws.groups) % len(choices)][:, None]
    code = """REAL mean = highest_mean_over_scan(exposed(lit_fraction(light, footprint, luminous),
                                             irradiance, gain, leak), shifts);"""
    (got,) = device.call(STRIPES, code, {**s.inputs, **shared(shifts=shifts)}, ("mean",))
    phases = 400
    highest = np.zeros(got.shape)
    for phase in np.arange(phases) / phases:
        mean = np.zeros(got.shape)
        for k in range(int(shifts.max())):
            light = s.light + (phase - k) / shifts
            mean += (k < shifts) / shifts * np.minimum(s.exposure(light), 1)
        highest = np.maximum(highest, mean)
    # What is cut off above saturation was there: its last bit is lost.
    lost = tolerances.SCAN * s.gain * s.irradiance + 1e-6
    assert (got >= highest - lost).all()
    # It is reached: between two phases no image changes by more than its flank is steep.
    steep = s.gain * s.irradiance / s.footprint * (1 / (phases * shifts) + 2e-6)
    assert (got <= highest + lost + np.minimum(steep, 1)).all()
