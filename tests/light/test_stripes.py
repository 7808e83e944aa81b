"""Device functions of `kernels/stripes.h`, one by one, each a law."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import tolerances
from device import Device
from laws import GROUPS, Array, Draws, close, holds, overlap, rounded, shared, stacked

STRIPES = ("stripes.h",)
LIT = "Trapezoid q = lit_fraction(light, wide, narrow, luminous); "
EXPOSED = LIT + "Trapezoid t = exposed(q, irradiance, gain, leak); "
OVERLAPS = "REAL none = 0.0f, one = 1.0f, overlaps = (t.overlap ? one : none); "


class Stripes:
    """Random footprints, in periods, over random stripes: every order of size, every share."""

    def __init__(self, seed: int, images: tuple[int, ...] = (1,)) -> None:
        d = Draws(seed, 2 * GROUPS)
        self.light = d.pixel(-30, 30)
        self.wide = d.scales(1e-5, 60)
        self.wide[:20] = 1
        self.wide[20:30] = 3
        self.wide[30:40] = rounded(1e-4)
        self.narrow = rounded(self.wide * d.scales(1e-4, 1))
        self.narrow[::5] = 0
        self.narrow[1::5] = self.wide[1::5]
        self.luminous = d.shared(0.02, 0.98)
        self.luminous[40:60], self.luminous[60:80] = rounded(1e-4), rounded(1 - 1e-4)
        self.irradiance = d.pixel(0.2, 1)
        self.irradiance[80:90] = 0
        self.gain = d.scales(0.05, 100, True)
        self.leak = np.where(d.shared(0, 1) < 0.4, 0, d.shared(0, 0.9))
        self.gain[90:110], self.leak[90:110] = 8, 0.5
        self.shifts = np.array(images)[np.arange(d.groups) % len(images)][:, None].astype(float)
        self.draws = d
        self.inputs = {
            "REAL light": self.light, "REAL wide": self.wide, "REAL narrow": self.narrow,
            "REAL irradiance": self.irradiance,
            **shared(luminous=self.luminous, gain=self.gain, leak=self.leak, shifts=self.shifts),
        }  # fmt: skip

    @property
    def rounding(self) -> Array:
        """Uncertainty of the place of the footprint's ends: the last bit of where they are."""
        return tolerances.LIGHT_ROUNDING * (np.abs(self.light) + self.wide + self.narrow + 1)

    @property
    def full(self) -> Array:
        return self.gain * self.irradiance

    @property
    def lost(self) -> Array:
        """What rounding leaves of a mean: what is cut off above saturation was there; and the mean
        is a polynomial in the places of kinks, whether an image is near them or not.
        """
        place = tolerances.LIGHT_ROUNDING * (self.wide + self.narrow + 1)
        kinks = tolerances.KINKS * place * self.full / (self.wide * self.shifts)
        return tolerances.SCAN * self.full + kinks + 1e-30

    def lit(self, light: Array) -> Array:
        return overlap(light, self.wide, self.narrow, self.luminous)

    def exposure(self, light: Array) -> Array:
        return self.full * (self.leak + (1 - self.leak) * self.lit(light))

    def mean(self) -> tuple[Array, Array]:
        """Mean of the saturated images, and what the light's last bits are worth to it."""
        mean, limit = np.zeros((2, *self.light.shape))
        for k in range(int(self.shifts.max())):
            taken = (k < self.shifts) / self.shifts
            here, *near = (
                np.minimum(self.exposure(self.light - k / self.shifts + e * self.rounding), 1)
                for e in (0, -1, 1)
            )
            mean += taken * here
            limit += taken * sum(np.abs(beside - here) for beside in near)
        return mean, limit


@holds("lit_fraction", wrong=("(n2 * wide + rest2 * n1)", "(n2 * wide)"))
@holds("at_shift", wrong=("fabs(u - rint(u))", "fabs(u - floor(u))"))
def test_the_lit_fraction_is_the_share_of_the_footprint_on_luminous_stripes(device: Device) -> None:
    s = Stripes(22)
    shift = s.draws.shared(0, 40)
    shift[::4] = 0
    code = """Trapezoid q = lit_fraction(light, wide, narrow, luminous);
        REAL lit = at_shift(q, shift);"""
    (got,) = device.call(STRIPES, code, {**s.inputs, **shared(shift=shift)}, ("lit",))
    limit = tolerances.LIT + (s.rounding + tolerances.LIGHT_ROUNDING * shift) / s.wide
    close(got, s.lit(s.light - shift), limit)
    inside = (got >= -limit) & (got <= 1 + limit)
    assert inside.all()


@holds("at_distance", wrong=("sum + (t.overlap ? risen_of_others(t, d) : none)", "sum"))
@holds("risen_of_others", wrong=("far * far - lacking * lacking", "far * far"))
def test_all_sides_that_reach_a_place_add_up_there(device: Device) -> None:
    s = Stripes(30)
    d = s.draws.pixel(0, 0.5)
    code = (
        LIT
        + """REAL centre = q.centre, here = at_distance(q, d);
        REAL sum = q.base + q.slope * (risen(q, q.edge - d) + risen_of_others(q, d));"""
    )
    centre, *got = stacked(
        device.call(STRIPES, code, {**s.inputs, "REAL d": d}, ("centre", "here", "sum"))
    )
    limit = tolerances.LIT + s.rounding / s.wide
    for way in (-1, 1):  # the stripes move by the shift, and d is seen on either side of a centre
        for value in got:
            close(value, s.lit(s.light - centre + way * d), limit)


@holds("exposed", wrong=("q.slope *= full * (1.0f - leak)", "q.slope *= full"))
def test_exposure_is_gain_times_irradiance_times_what_is_lit_or_leaks(device: Device) -> None:
    s = Stripes(23)
    code = LIT + "REAL e = at_shift(exposed(q, irradiance, gain, leak), 0.0f);"
    (got,) = device.call(STRIPES, code, s.inputs, ("e",))
    close(got, s.exposure(s.light), s.full * (tolerances.LIT + s.rounding / s.wide) + 1e-30)
    assert not got[80:90].any()


class Sides:
    """Sides of every shape, and places on them from before the foot to beyond the shoulder."""

    def __init__(self, seed: int) -> None:
        d = self.draws = Draws(seed)
        self.flank = d.scales(1e-4, 1)
        self.corner = rounded(self.flank * d.scales(1e-4, 1))
        self.corner[:20] = self.flank[:20]
        self.sides = self.flank + self.corner
        self.y = rounded(self.sides * d.pixel(-0.2, 1.2))
        self.y[20:40] = rounded(self.corner[20:40] * d.pixel(0, 1)[20:40])
        self.edge = rounded(d.pixel(0, 0.5) + self.sides)
        self.centre = d.pixel(0, 1)
        self.inputs = {
            "REAL flank": self.flank, "REAL corner": self.corner, "REAL y": self.y,
            "REAL edge": self.edge, "REAL centre": self.centre,
        }  # fmt: skip

    SET = """Trapezoid t; t.flank = flank; t.corner = corner; t.bend = 0.5f / corner;
        t.edge = edge; t.centre = centre; t.base = 0.0f * y; t.slope = 1.0f + 0.0f * y; """

    def folded(self, values: Callable[[Array], Array]) -> Array:
        """Mean over the corner's box, ending at y, of what is a parabola from 0 to the flank."""
        breaks = [np.zeros_like(self.y), self.y - self.flank, self.y, self.corner]
        places = np.sort([np.clip(b, 0, self.corner) for b in breaks], axis=0)
        total = np.zeros_like(self.y)
        for begin, end in pairwise(places):
            weights = ((0, 1), (0.5, 4), (1, 1))  # Simpson's rule
            total += sum(
                (end - begin) / 6 * weight * values(self.y - begin - share * (end - begin))
                for share, weight in weights
            )
        return total / self.corner


@holds("risen", wrong=("(toe * toe - shoulder * shoulder)", "(toe * toe)"))
@holds("rising", wrong=("clamp(y - t.flank, 0.0f, t.corner)) * (2.0f", "0.0f) * (2.0f"))
@holds("under_ramp", wrong=("0.5f * rest * (t.corner + rest);\n}", "0.5f * rest * rest;\n}"))
@holds("under_side", wrong=("under_ramp(t, y - t.flank)", "under_ramp(t, y - t.corner)"))
def test_a_side_rises_as_one_box_folded_with_another(device: Device) -> None:
    s = Sides(31)
    code = (
        s.SET
        + """REAL height = risen(t, y), slope = rising(t, y), ramp = under_ramp(t, y),
        area = under_side(t, y);"""
    )
    outputs = ("height", "slope", "ramp", "area")
    height, slope, ramp, area = stacked(device.call(STRIPES, code, s.inputs, outputs))
    place = tolerances.LIGHT_ROUNDING * (np.abs(s.y) + s.sides)
    close(height, s.folded(lambda y: np.clip(y, 0, s.flank)), 2 * place)
    overlap_of_both = np.minimum(s.y, s.corner) - np.maximum(s.y - s.flank, 0)
    close(slope, np.maximum(overlap_of_both, 0) / s.corner, 2 * place / s.corner)
    parabola = s.folded(lambda y: np.maximum(y, 0) ** 2 / 2)
    close(ramp, parabola, 2 * place * s.sides)
    below = parabola - s.folded(lambda y: np.maximum(y - s.flank, 0) ** 2 / 2)
    close(area, below, 4 * place * s.sides)


@holds("from_foot", wrong=("(side < 2 ? -d : d)", "(side < 1 ? -d : d)"))
def test_four_sides_reach_a_stripe_s_period(device: Device) -> None:
    s = Sides(32)
    d = s.draws.pixel(0, 0.5)
    for side, (stripe, way) in enumerate(((0, 1), (-1, 1), (0, -1), (1, -1))):
        code = s.SET + f"REAL y0 = from_foot(t, d, {side});"
        (got,) = device.call(STRIPES, code, {**s.inputs, "REAL d": d}, ("y0",))
        foot = stripe + way * s.edge
        close(got, way * (foot - d), 2 * tolerances.LIGHT_ROUNDING * (s.edge + 1))


@holds("unsaturated", wrong=("high ? (t.flank + t.corner)", "high ? t.flank"))
def test_a_side_saturates_where_it_has_risen_as_far_as_saturation(device: Device) -> None:
    s = Sides(33)
    height = rounded(s.flank * s.draws.pixel(-0.2, 1.2))
    code = s.SET + "t.base = 1.0f - height; REAL height2 = 1.0f - t.base, y2 = unsaturated(t);"
    inputs = {**s.inputs, "REAL height": height}
    height, s.y = stacked(device.call(STRIPES, code, inputs, ("height2", "y2")))
    place = tolerances.LIGHT_ROUNDING * (s.flank + s.corner)
    risen = s.folded(lambda y: np.clip(y, 0, s.flank))
    close(risen, np.clip(height, 0, s.flank), 4 * place)
    np.testing.assert_array_equal(s.y[height <= 0], 0)
    never = height >= s.flank
    close(s.y[never], (s.flank + s.corner)[never], place[never])


def bernoulli(x: Array, degree: int) -> Array:
    """Of the fractional part; the polynomials as tables give them."""
    polynomial = {2: (1 / 6, -1, 1), 3: (0, 0.5, -1.5, 1)}[degree]
    result: Array = np.polynomial.Polynomial(polynomial)(x - np.floor(x))
    return result


@holds("fraction_of", wrong=("return x - floor(x);", "return x - rint(x);"))
@holds("bernoulli_change", wrong=("- 3.0f * past * past", ""))
@holds("bend_change", wrong=("(d + t.centre) * shifts), over", "(d - t.centre) * shifts), over"))
@holds("kink_change", wrong=("REAL b = fraction_of((d + ", "REAL b = fraction_of((d - "))
def test_kinks_and_bends_of_a_sampled_curve_weigh_what_bernoulli_s_polynomials_say(
    device: Device,
) -> None:
    s = Sides(34)
    d = s.draws
    at, start, over, far = d.pixel(0, 1), d.pixel(0, 0.5), d.scales(1e-6, 0.5), d.scales(1e-6, 300)
    at[at == 1] = 0
    shifts = np.floor(d.scales(1, 400, True))
    inputs = {**s.inputs, "REAL from": at, "REAL start": start, "REAL over": over, "REAL far": far,
              **shared(shifts=shifts)}  # fmt: skip
    code = (
        s.SET
        + """REAL part = fraction_of(far - 100.0f), change = bernoulli_change(from, far),
        bend = bend_change(t, start, over, shifts), kink = kink_change(t, start, shifts);"""
    )
    outputs = ("part", "change", "bend", "kink")
    part, change, bend, kink = stacked(device.call(STRIPES, code, inputs, outputs))
    moved = rounded(far - 100)
    close(part, moved - np.floor(moved), tolerances.FLOAT_ROUNDING)
    # A short change has a small error: it is no difference of near values.
    h = far - np.floor(far)
    expected = bernoulli(at + far, 3) - bernoulli(at, 3)
    close(change, expected, tolerances.BERNOULLI * h + 1e-15)
    places = ((start + way * s.centre) * shifts for way in (-1, 1))
    pairs = [(bernoulli(x + over * shifts, 3) - bernoulli(x, 3), bernoulli(x, 2)) for x in places]
    off = tolerances.LIGHT_ROUNDING * shifts * 2
    length = over * shifts
    limit = (3 * off + tolerances.BERNOULLI) * np.minimum(length, 1)
    close(bend, pairs[0][0] + pairs[1][0], limit + tolerances.LIGHT_ROUNDING * length)
    close(kink, pairs[0][1] + pairs[1][1], 2 * off + tolerances.BERNOULLI)


@cache
def scanned(seed: int) -> tuple[Stripes, Array, Array]:
    """Stripes under scans of 1 to 100 images, and their means: the same for every device."""
    s = Stripes(seed, (1, 2, 3, 7, 8, 40, 100))
    return s, *s.mean()


@holds(
    "mean_over_scan", wrong=("min(mean_of_sides(t, y, shifts), 1.0f)", "mean_of_sides(t, y, 1.0f)")
)
@holds("mean_of_sides", wrong=("bent * kink_change(t, x, shifts)", "bent"))
def test_the_mean_over_a_scan_is_the_mean_of_the_saturated_images(device: Device) -> None:
    s, expected, limit = scanned(25)
    code = (
        EXPOSED
        + OVERLAPS
        + """REAL mean = mean_over_scan(t, shifts);
        REAL alone = mean_of_sides(t, unsaturated(t), shifts);"""
    )
    mean, alone, overlaps = stacked(
        device.call(STRIPES, code, s.inputs, ("mean", "alone", "overlaps"))
    )
    limit = limit + s.lost
    close(mean, expected, limit)
    apart = overlaps == 0
    assert 0.3 < apart.mean() < 0.8
    close(np.minimum(alone, 1)[apart], expected[apart], limit[apart])
    # Dark stripes that leak enough saturate every image; no irradiance is dark.
    close(mean[90:110], np.minimum(expected[90:110], 1), limit[90:110])
    assert not mean[80:90].any()


@holds("saturated_to", wrong=("return from + share * (to - from)", "return from + share"))
@holds("mean_overlapping", wrong=("(end, other) - 0.5f, 0.0f)", "(end, other) - 9.0f, 0.0f)"))
def test_where_sides_overlap_the_mean_over_a_scan_is_the_same(device: Device) -> None:
    s, expected, limit = scanned(26)
    code = (
        EXPOSED
        + OVERLAPS
        + """REAL x = saturated_to(t), centre = t.centre, mean = mean_overlapping(t, x, shifts);"""
    )
    outputs = ("x", "centre", "mean", "overlaps", "t.corner")
    x, centre, mean, overlaps, corner = stacked(device.call(STRIPES, code, s.inputs, outputs))
    both = overlaps == 1
    # It is a sum over ends of bends; the shorter a bend, the more of it is lost.
    long = both & (corner > 1e-2)
    assert long.mean() > 0.1
    close(np.minimum(mean, 1)[long], expected[long], (limit + s.lost)[long])
    # Nearer to the centre all is saturated, beyond it nothing is.
    steep = s.full * (s.rounding / s.wide + tolerances.LIT)
    here = s.exposure(s.light - centre + x)
    assert (here >= 1 - steep)[both & (x > 0)].all()
    assert (here <= 1 + steep)[both & (x < 0.5)].all()


@cache
def highest_of_phases() -> tuple[Stripes, int, Array]:
    """Stripes, a number of phases within a step, and the highest mean over a scan of all."""
    s, phases = Stripes(29, (1, 2, 3, 7, 12)), 100
    highest = np.zeros(s.light.shape)
    for phase in np.arange(phases) / phases:
        mean = np.zeros(s.light.shape)
        for k in range(int(s.shifts.max())):
            light = s.light + (phase - k) / s.shifts
            mean += (k < s.shifts) / s.shifts * np.minimum(s.exposure(light), 1)
        highest = np.maximum(highest, mean)
    return s, phases, highest


@pytest.mark.slow
@holds("highest_of_sharp", wrong=("t.centre = t.edge - y + EDGE", "t.centre = 0.0f * y + EDGE"))
@holds(
    "highest_mean_over_scan",
    wrong=("(rounded ? (together ? tried", "(rounded ? (rounded ? 0.9f * tried"),
)
def test_no_light_coordinate_has_a_higher_mean_over_a_scan(device: Device) -> None:
    s, phases, highest = highest_of_phases()
    code = (
        EXPOSED
        + OVERLAPS
        + """REAL highest = highest_mean_over_scan(t, shifts);
        REAL sharp = highest_of_sharp(t, shifts);"""
    )
    got, sharp, overlaps = stacked(
        device.call(STRIPES, code, s.inputs, ("highest", "sharp", "overlaps"))
    )
    # What is cut off above saturation was there: its last bit is lost.
    lost = s.lost + 1e-6
    assert (got >= highest - lost).all()
    assert (sharp >= highest - lost)[overlaps == 0].all()
    # It is reached: between two phases no image changes by more than its flank is steep; between
    # the sixteen that the kernel tries, a curve is not farther above its chord than bends allow.
    steep = s.full / s.wide * (1 / (phases * s.shifts) + 2e-6)
    chord = (np.minimum(s.wide, 1) * s.shifts + 1.1) / (2 * 16 * s.shifts**2)
    steep += s.full / s.wide * chord
    assert (got <= highest + lost + np.minimum(steep, 1)).all()
