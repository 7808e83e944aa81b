"""Noise in closed form: one device function after another, each a law."""

from __future__ import annotations

import numpy as np
import tolerances
from device import LANES, Device
from laws import IMAGE, Array, Draws, close, design_of, designs, holds, rounded, shared
from scipy.stats import norm

from gpuspec.light.constants import CELLS_COARSE, CELLS_FINE, CELLS_OFFSET
from gpuspec.light.float64 import normal_numbers, random_words
from gpuspec.light.float64_noise import ONE_DRAW
from gpuspec.light.sources import structs

TABLE = """STRUCT(Cells) { float last; };
DEVICE Four made_cell(REAL i) {
    Four cell;
    cell.a = 0.01f * i;
    cell.b = 0.25f + 0.0f * i;
    cell.c = 0.5f + 0.0f * i;
    cell.d = 0.75f + 0.0f * i;
    return cell;
}
#define CELL(cells, i) made_cell(i)"""
NO_TABLE = """STRUCT(Cells) { float last; };
DEVICE Four made_cell(REAL i) {
    Four cell;
    cell.a = 0.0f * i;
    cell.b = cell.c = cell.d = cell.a;
    return cell;
}
#define CELL(cells, i) made_cell(i)"""
NOISE = (*IMAGE, TABLE, "noise.h")
QUIET = (*IMAGE, NO_TABLE, "noise.h")
CELLS = "Cells cells; cells.last = 800.0f; "


def place(signal: Array) -> Array:
    return np.minimum(signal * CELLS_FINE, signal * CELLS_COARSE + CELLS_OFFSET)


def excess(signal: Array) -> tuple[Array, Array]:
    """Mean and variance of the made table."""
    at = np.clip(place(signal), 0, 800)
    share = at - np.floor(at)
    return 0.01 * np.floor(at) + 0.25 * share, 0.5 + 0.75 * share


def trapezoids(d: Draws) -> dict[str, Array]:
    """What a footprint may see: of narrow ones, and of wide ones that overlap."""
    luminous = d.shared(0.05, 0.9)
    wide = d.scales(0.005, 1.5)
    return {"REAL light": d.pixel(-30, 30), "REAL wide": wide,
            "REAL narrow": rounded(wide * d.pixel(0, 1)), **shared(luminous=luminous)}  # fmt: skip


SEEN = "Trapezoid t = lit_fraction(light, wide, narrow, luminous); "


@holds("normal_of", wrong=("column, row, ONE_DRAW", "column, row, FIXED_PATTERN"))
def test_a_pixel_s_normal_number_is_of_an_image_number_of_its_own(device: Device) -> None:
    d = Draws(90)
    design = designs(d, noise=True)
    column, row = d.rng.integers(0, 2**32, (2, d.groups, LANES), np.uint32)
    inputs = {"COUNTER column": column, "COUNTER row": row, "Design d": design}
    (got,) = device.call(IMAGE, "REAL z = normal_of(d, column, row);", inputs, ("z",))
    low, high = design_of(design, "seed_low", "seed_high")
    for group in range(0, d.groups, 25):
        seed = int(low[group, 0] + 65536 * high[group, 0])
        words = random_words(column[group], row[group], ONE_DRAW, seed)
        close(got[group], normal_numbers(words[0], words[1])[0], atol=tolerances.NORMAL)


@holds("place_of", wrong=("min(signal * CELLS_FINE", "max(signal * CELLS_FINE"))
@holds("saturates", wrong=(">= CELLS_COARSE + CELLS_OFFSET", "> CELLS_COARSE + CELLS_OFFSET"))
def test_a_cell_begins_where_the_sensor_saturates(device: Device) -> None:
    d = Draws(91)
    signal = d.pixel(0, 2)
    signal[:20], signal[20:40] = d.pixel(0, 0.1)[:20], 1.0
    code = "REAL p = place_of(signal); REAL one = 1.0f, none = 0.0f;"
    got, full = device.call(
        NOISE, code, {"REAL signal": signal}, ("p", "saturates(signal) ? one : none")
    )
    close(got, place(signal), rtol=tolerances.FLOAT_ROUNDING)
    off = np.abs(signal - 1) > 1e-6
    assert np.array_equal(full[off], (signal >= 1)[off])
    assert full[20:40].all()


@holds("cell_excess", wrong=("share * cell.d", "share"))
@holds("excess_at", wrong=("return n.in_dark;", "return no_excess();"))
@holds("no_excess", wrong=("e.mean = 0.0f", "e.mean = 1.0f"))
@holds("noise_of", wrong=("d.read_noise * d.read_noise", "d.read_noise"))
def test_the_excess_rises_evenly_in_a_cell_and_ends_in_the_last(device: Device) -> None:
    d = Draws(92)
    design = designs(d, noise=True)
    signal = d.pixel(0, 2)
    dark, saturation, read = design_of(design, "dark_signal", "saturation", "read_noise")
    code = (
        CELLS
        + """Noise n = noise_of(d, cells); Excess e = excess_at(cells, n, signal);
        Excess c = cell_excess(cells, place_of(signal)); REAL all = n.dark;
        Excess a = excess_at(cells, n, all); Excess o = no_excess();"""
    )
    inputs = {"REAL signal": signal, "Design d": design}
    outputs = ("e.mean", "e.variance", "c.mean", "c.variance", "a.mean", "a.variance", "o.mean",
               "o.variance", "n.spread")  # fmt: skip
    got = device.call(NOISE, code, inputs, outputs)
    expected = excess(signal) * 2 + excess(np.broadcast_to(dark / saturation, signal.shape))
    for values, wanted in zip(got, expected, strict=False):
        close(values, wanted, atol=tolerances.CELL)
    assert not got[6].any()
    assert not got[7].any()
    spread = np.hypot(np.sqrt(saturation), read) / saturation
    close(got[8], np.broadcast_to(spread, signal.shape), rtol=4 * tolerances.FLOAT_ROUNDING)


@holds("smooth_step", wrong=("3.0f - 2.0f * u", "2.0f - u"))
@holds("clipped_mean", wrong=("0.3976f * u * u", "0.3976f * u"))
@holds("clipped_below", wrong=("0.36440f * t", "0.26440f * t"))
@holds("clipped_variance", wrong=("0.40420f - 0.25427f * t", "0.40420f + 0.25427f * t"))
def test_clipping_lowers_mean_and_variance_of_a_normal_number(device: Device) -> None:
    d = Draws(93)
    t = d.pixel(-5, 5)
    code = """REAL s = smooth_step(t); REAL m = clipped_mean(t); REAL b = clipped_below(t);
        REAL v = clipped_variance(t);"""
    step, mean, below, variance = device.call(NOISE, code, {"REAL t": t}, tuple("smbv"))
    u = np.clip(t, 0, 1)
    close(step, u * u * (3 - 2 * u), atol=tolerances.FLOAT_ROUNDING)
    tail = np.abs(t)
    close(mean, norm.pdf(t) - tail * norm.sf(tail), atol=tolerances.CLIPPED_MEAN)
    # E of min(z, c), c = -t, and of its square.
    first = -norm.pdf(t) - t * norm.sf(-t)
    square = norm.cdf(-t) + t * norm.pdf(t) + t * t * norm.sf(-t)
    close(variance, square - first**2, atol=tolerances.CLIPPED_VARIANCE)
    # The integral of the first: by parts, (t^2 + 1) Q(t) and t phi(t).
    half = (norm.sf(tail) * (1 + tail**2) - tail * norm.pdf(t)) / 2
    close(below, np.where(t < 0, half, 0.5 - half), atol=tolerances.CLIPPED_VARIANCE)


@holds("moments_at", wrong=("signal < 1.0f ? even", "signal < 2.0f ? even"))
def test_the_moments_of_one_image_are_those_of_even_noise_and_the_excess(device: Device) -> None:
    d = Draws(98)
    design = designs(d, noise=True)
    signal = d.pixel(0, 2)
    code = CELLS + "Moments m = moments_at(cells, noise_of(d, cells), d, signal);"
    inputs = {"REAL signal": signal, "Design d": design}
    mean, variance = device.call(NOISE, code, inputs, ("m.mean", "m.variance"))
    names = "full_scale", "black_level", "saturation", "read_noise"
    full, black, capacity, read = design_of(design, *names)
    gain = (full - black) / capacity
    above, more = excess(signal)
    even = gain**2 * (capacity * signal + read**2) + 1 / 12
    close(mean, black + gain * capacity * np.minimum(signal, 1) + above, atol=tolerances.MOMENTS_DN)
    wanted = np.where(signal < 1, even, 0) + more
    close(variance, wanted, atol=tolerances.CELL, rtol=tolerances.MOMENTS_VARIANCE)


@holds("sensed", wrong=("t.base * own.gain", "t.base"))
@holds("response_of", wrong=("d.dsnu * pattern.second", "d.dsnu * pattern.first"))
@holds("sensed_alike", wrong=("t.base += d.dark_signal", "t.base += 2.0f * d.dark_signal"))
def test_a_pixel_has_a_gain_and_a_dark_signal_of_its_own(device: Device) -> None:
    d = Draws(94)
    design = designs(d, noise=True)
    seen = trapezoids(d)
    first, second = d.pixel(-4, 4), d.pixel(-4, 4)
    code = (
        SEEN
        + """t.base += 0.125f; Normals p; p.first = first; p.second = second;
        Trapezoid own = sensed(t, p, d); Trapezoid all = sensed_alike(t, d);
        Response r = response_of(p, d);"""
    )
    inputs = {**seen, "REAL first": first, "REAL second": second, "Design d": design}
    outputs = ("own.base", "own.slope", "all.base", "all.slope", "r.gain", "r.dark", "t.base",
               "t.slope")  # fmt: skip
    got = device.call(NOISE, code, inputs, outputs)
    base, slope = (values.astype(np.float64) for values in got[6:])
    names = "prnu", "dsnu", "dark_signal", "saturation"
    prnu, dsnu, dark, full = design_of(design, *names)
    gain = np.maximum(1 + prnu * first, 0)
    more = np.maximum(dark + dsnu * second, 0) / full
    for values, expected in zip(
        got,
        (base * gain + more, slope * gain, base + dark / full, slope, gain, more * full),
        strict=False,
    ):
        close(values, expected, atol=tolerances.SIDES, rtol=tolerances.SIDES)


@holds("images_within", wrong=("1.0f + 2.0f * shifts * x", "2.0f * shifts * x"))
def test_images_within_a_distance_are_counted(device: Device) -> None:
    d = Draws(95)
    seen = trapezoids(d)
    shifts = np.floor(d.shared(2, 60))
    x = d.pixel(0, 0.5)
    code = SEEN + "REAL n = images_within(t, x, shifts);"
    inputs = {**seen, "REAL x": x, **shared(shifts=shifts)}
    got, centre = device.call(NOISE, code, inputs, ("n", "t.centre"))
    k = np.arange(60)
    u = centre[..., None] - k / shifts[..., None]
    away = np.abs(u - np.rint(u))
    counted = ((away <= x[..., None]) & (k < shifts[..., None])).sum(axis=-1)
    nearest = np.where(k < shifts[..., None], np.abs(away - x[..., None]), 1).min(axis=-1)
    clear = nearest > 1e-5  # no image just there
    close(got[clear], counted[clear], atol=tolerances.COUNTED)


@holds("sides_of", wrong=("s.foot = t.edge;", "s.foot = t.edge - t.corner;"))
@holds("nearest_excess", wrong=("past * apart + beyond", "past * apart"))
def test_sides_end_in_plateaus_and_the_image_next_to_saturation_is_blurred(device: Device) -> None:
    d = Draws(96)
    seen = trapezoids(d)
    exposure = d.scales(0.3, 10)
    past, apart, beyond = d.pixel(-0.5, 0.5), d.pixel(3, 9), d.pixel(-1, 1)
    code = (
        SEEN
        + """t = exposed(t, exposure, 1.0f, 0.02f); Sides s = sides_of(t, 0.05f);
        REAL half_way = 0.5f * s.top; REAL beside = 0.5f * (s.foot + 0.5f);
        REAL top = at_distance(t, half_way); REAL foot = at_distance(t, beside);
        REAL edge = at_distance(t, s.edge); REAL o = t.overlap ? 1.0f : 0.0f + 0.0f * top;
        Excess e = nearest_excess(s, past, 0.0f, apart, beyond);"""
    )
    inputs = {**seen, "REAL exposure": exposure, "REAL past": past, "REAL apart": apart,
              "REAL beyond": beyond}  # fmt: skip
    outputs = ("s.high", "s.low", "top", "foot", "edge", "o", "e.mean", "e.variance", "s.edge",
               "s.top", "s.foot")  # fmt: skip
    high, low, top, foot, edge, overlap, mean, variance, x, begin, end = (
        values.astype(np.float64) for values in device.call(NOISE, code, inputs, outputs)
    )
    plain = overlap == 0
    close(top[plain], high[plain], rtol=tolerances.SIDES)
    close(foot[plain], low[plain], rtol=tolerances.SIDES, atol=tolerances.SIDES)
    crossed = (high > 1.01) & (low < 0.99)
    assert crossed.mean() > 0.3
    assert np.quantile(np.abs(edge[crossed] - 1), 0.99) < tolerances.SIDES * 100
    alone = (x > begin) & (x < end)
    off = past * apart + beyond
    blurred = np.where(alone, norm.pdf(off) - np.abs(off) * norm.sf(np.abs(off)), 0)
    close(mean, blurred, atol=tolerances.CLIPPED_MEAN)
    assert (np.abs(variance) <= 1).all()
    assert (variance[~alone] == 0).all()


@holds("noisy_mean_over_scan", wrong=("d.black_level + n.dn * mean", "n.dn * mean"))
@holds("one_draw", wrong=("sqrt(m.variance) * normal", "m.variance * normal"))
@holds("highest_draw", wrong=("NORMAL_MAX * sqrt(none + variance", "-NORMAL_MAX * sqrt(none + variance"))  # fmt: skip  # noqa: E501
def test_without_noise_the_moments_are_the_closed_form_and_rounding(device: Device) -> None:
    d = Draws(97)
    design = designs(d, noise=True)
    names = ("saturation", "read_noise", "dark_signal", "dsnu", "prnu", "images", "distinct_shifts")
    quiet = (1e9, 0.0, 0.0, 0.0, 0.0, 40.0, 20.0)
    for name, value in zip(names, quiet, strict=True):
        design[:, structs()["Design"].index(name)] = value
    seen, exposure, z = trapezoids(d), d.scales(0.3, 10), d.pixel(-3, 3)
    code = (
        CELLS
        + SEEN
        + """t = exposed(t, exposure, 1.0f, 0.02f);
        Moments m = noisy_mean_over_scan(t, d, noise_of(d, cells), cells);
        REAL mean = mean_over_scan(t, d.distinct_shifts); REAL y = one_draw(m, z, d.full_scale);
        REAL most = highest_draw(t, d, 0.0f, 4.0f);"""
    )
    inputs = {**seen, "REAL exposure": exposure, "REAL z": z, "Design d": design}
    outputs = ("m.mean", "m.variance", "mean", "y", "most")
    mean, variance, lit, drawn, most = (
        values.astype(np.float64) for values in device.call(QUIET, code, inputs, outputs)
    )
    black, full = design_of(design, "black_level", "full_scale")
    close(mean, black + (full - black) * lit, atol=tolerances.QUIET_DN)
    # Of 20 shifts, each taken twice, all those that do not saturate are rounded.
    assert (variance <= 1 / 12 / 40 * 20 / 20 + tolerances.QUIET_DN).all()
    close(drawn, np.clip(mean + np.sqrt(variance) * z, 0, full), atol=tolerances.QUIET_DN)
    assert (most > mean + 5 * np.sqrt(4 / 40)).all()
