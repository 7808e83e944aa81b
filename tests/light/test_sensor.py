"""Device functions of `kernels/sensor.h`, one by one, each a law."""

from __future__ import annotations

import numpy as np
import tolerances
from device import LANES, Device
from laws import GROUPS, Draws, close, holds, rounded, shared, stacked, struct
from scipy.stats import poisson

from gpuspec.light.levels import levels_per_dn, thresholds

SENSOR = ("station.h", "sensor.h")


def pcg4d(column: int, row: int, image: int, seed: int) -> tuple[int, ...]:
    """pcg4d in whole numbers, as Jarzynski and Olano print it."""
    mask = 0xFFFFFFFF
    x, y, z, w = ((v * 1664525 + 1013904223) & mask for v in (column, row, image, seed))
    for last in (False, True):
        x = (x + y * w) & mask
        y = (y + z * x) & mask
        z = (z + x * y) & mask
        w = (w + y * z) & mask
        if not last:
            x, y, z, w = (v ^ (v >> 16) for v in (x, y, z, w))
    return x, y, z, w


@holds("level_of", wrong=("-floor(-per_dn * grey)", "floor(per_dn * grey)"))
def test_a_level_is_how_many_thresholds_a_pixel_is_above(device: Device) -> None:
    d = Draws(29)
    for bits in (8, 12):
        scale = 2.0**bits - 1
        grey = d.pixel(-0.01 * scale, 1.01 * scale)
        grey[0, :2] = np.nan, 1e30
        grey[1:] = np.where(
            d.pixel(0, 1)[1:] < 0.2, thresholds(scale)[grey[1:].astype(int) % 256], grey[1:]
        )
        inputs = {"REAL grey": grey, **shared(per_dn=np.full((GROUPS, 1), levels_per_dn(scale)))}
        (got,) = device.call(
            ("level.h",), "REAL level = level_of(grey, per_dn);", inputs, ("level",)
        )
        above = (grey[..., None] > thresholds(scale)[:-1]).sum(axis=-1)
        np.testing.assert_array_equal(got, above)


@holds("random_words", wrong=("v.d ^= v.d >> 16u;", ""))
def test_random_words_are_pcg4d(device: Device) -> None:
    rng = np.random.default_rng(26)
    counters = rng.integers(0, 2**32, (4, 64, LANES), np.uint32)
    extremes = np.array([0, 1, 2, 2**31 - 1, 2**31, 2**32 - 1, 2**16, 12345], np.uint32)
    for axis in range(4):
        counters[axis, axis] = np.resize(extremes, LANES)
        counters[axis, 8:16] = extremes[rng.integers(0, 8, (8, LANES))]
    inputs = {f"COUNTER {n}": v for n, v in zip("xyzw", counters, strict=True)}
    outputs = [f"COUNTER r.{n}" for n in "abcd"]
    got = device.call(SENSOR, "Words r = random_words(x, y, z, w);", inputs, outputs)
    expected = [pcg4d(*map(int, c)) for c in counters.reshape(4, -1).T]
    np.testing.assert_array_equal(np.stack(got).reshape(4, -1).T, np.array(expected, np.uint32))


@holds("uniform_number", wrong=("+ 0.5f) * 1.1920929e-7f", ") * 1.1920929e-7f"))
def test_uniform_numbers_are_the_middles_of_equal_steps(device: Device) -> None:
    word = np.random.default_rng(27).integers(0, 2**32, (GROUPS, LANES), np.uint32)
    word[0, :8] = 0, 511, 512, 2**31, 2**31 - 1, 2**32 - 1, 2**32 - 512, 2**32 - 513
    (got,) = device.call(SENSOR, "REAL u = uniform_number(word);", {"COUNTER word": word}, ("u",))
    np.testing.assert_array_equal(got, ((word >> 9) + 0.5) / 2**23)
    assert got.min() > 0
    assert got.max() < 1


@holds("normal_numbers", wrong=("radius * sin(angle)", "radius * sin(2.0f * angle)"))
def test_normal_numbers_are_the_coordinates_of_box_and_mullers_point(device: Device) -> None:
    words = np.random.default_rng(28).integers(0, 2**32, (2, GROUPS, LANES), np.uint32)
    words[0, 0, :4] = words[1, 1, :4] = 0, 511, 2**32 - 1, 2**31
    inputs = {"COUNTER word": words[0], "COUNTER other": words[1]}
    code = "Normals n = normal_numbers(word, other);"
    first, second = stacked(device.call(SENSOR, code, inputs, ("n.first", "n.second")))
    u, v = ((w >> np.uint32(9)).astype(float) / 2**23 + 2.0**-24 for w in words)
    point = np.sqrt(-2 * np.log(u)) * np.exp(2j * np.pi * v)
    slack = tolerances.NORMAL + tolerances.LOG_NEAR_ONE / (np.abs(point) + 1e-4)
    close(first, point.real, slack)
    close(second, point.imag, slack)


@holds("poisson_number", wrong=("uniform_ > sum && term", "term"))
def test_poisson_numbers_are_the_quantiles_of_few_and_rounded_gaussians_of_many(
    device: Device,
) -> None:
    d = Draws(29)
    code = "REAL n = poisson_number(mu, u, g);"
    u, g = rounded((np.floor(d.pixel(0, 2**23 - 1)) + 0.5) / 2**23), d.pixel(-4, 4)
    mu = rounded(d.scales(0.01, 15.99))
    mu[:10], mu[10:20, ::2] = 0, 0
    many = rounded(d.scales(16, 1e5))
    mu[20:40, ::2] = many[20:40, ::2]
    mu[40:] = np.where((np.arange(d.groups) % 2 == 0)[40:, None], many[40:], mu[40:])
    (got,) = device.call(SENSOR, code, {"REAL mu": mu, "REAL u": u, "REAL g": g}, ("n",))
    few = mu < 16
    # A uniform number within rounding of a step of the distribution may fall on either side.
    slack = tolerances.POISSON_STEP
    low, high = poisson.ppf(u - slack, mu), poisson.ppf(np.minimum(u + slack, 1 - 1e-9), mu)
    low[mu == 0] = high[mu == 0] = 0
    assert ((got >= np.maximum(low, 0)) & (got <= high))[few].all()
    gauss = mu + np.sqrt(np.maximum(mu - 1 / 12, 0)) * g
    slack = 0.5 + tolerances.FLOAT_ROUNDING * 4 * mu
    assert (np.abs(got - np.maximum(gauss, 0)) <= slack)[~few].all()
    assert (got == np.floor(got)).all()
    assert not got[:10].any()


@holds("saturated", wrong=("full_scale * min(signal, 1.0f)", "full_scale * signal"))
def test_grey_levels_grow_with_the_signal_up_to_full_scale(device: Device) -> None:
    d = Draws(30)
    signal, full = d.pixel(0, 3), np.choose(np.arange(d.groups) % 4, [255, 1023, 4095, 65535])
    inputs = {"REAL signal": signal, **shared(full=full[:, None])}
    (got,) = device.call(SENSOR, "REAL y = saturated(signal, full);", inputs, ("y",))
    close(got, np.minimum(signal * full[:, None], full[:, None]), rtol=tolerances.FLOAT_ROUNDING)


@holds("noisy_grey_level", wrong=("d.read_noise * normal.second", "d.read_noise * normal.first"))
def test_noise_takes_the_formulas_of_emva_1288_in_their_order(device: Device) -> None:
    d = Draws(31, 4 * GROUPS)
    words = d.rng.integers(0, 2**32, (3, d.groups, LANES), np.uint32)
    signal = d.scales(1e-4, 1.5)
    pattern = d.pixel(-3, 3), d.pixel(-3, 3)
    full = np.choose(np.arange(d.groups) % 4, [255.0, 1023.0, 4095.0, 65535.0])[:, None]
    capacity, read = d.scales(2000, 50000, True), d.shared(0, 30)
    dark, dsnu, prnu = d.shared(0, 50), d.shared(0, 40), d.shared(0, 0.4)
    black = np.floor(d.shared(0, 60))
    # Neither signal nor noise: the black level, whatever the words.
    signal[:4], read[:4], dark[:4], dsnu[:4] = 0, 0, 0, 0
    design = struct(
        "Design", d.groups, full_scale=full, saturation=capacity, read_noise=read,
        dark_signal=dark, dsnu=dsnu, prnu=prnu, black_level=black,
    )  # fmt: skip
    inputs = {
        "REAL signal": signal, "REAL pattern_prnu": pattern[0], "REAL pattern_dsnu": pattern[1],
        **{f"COUNTER {name}": w for name, w in zip("abc", words, strict=True)},
        "Design d": design,
    }  # fmt: skip
    code = """Normals pattern; pattern.first = pattern_prnu; pattern.second = pattern_dsnu;
        Words w; w.a = a; w.b = b; w.c = c; w.d = c;
        REAL y = noisy_grey_level(signal, pattern, w, d);"""
    (got,) = device.call(SENSOR, code, inputs, ("y",))
    electrons = capacity * signal * np.maximum(1 + prnu * pattern[0], 0)
    electrons = electrons + np.maximum(dark + dsnu * pattern[1], 0)
    u, v, w = ((word >> np.uint32(9)).astype(float) / 2**23 + 2.0**-24 for word in words)
    gauss = np.sqrt(-2 * np.log(v)) * np.exp(2j * np.pi * w)
    spread = np.sqrt(np.maximum(electrons - 1 / 12, 0))
    many = np.maximum(np.floor(electrons + spread * gauss.real + 0.5), 0)
    taken = np.where(electrons < 16, np.maximum(poisson.ppf(u, electrons), 0), many)
    taken = np.minimum(taken + read * gauss.imag, capacity)
    gain = (full - black) / capacity
    expected = np.clip(np.rint(gain * taken + black), 0, full)
    # One electron more or less, where a number lies within float rounding of a half.
    off = np.abs(got - expected)
    assert (off <= np.ceil(gain)).all()
    assert (off > 0).mean() <= tolerances.ROUNDING_FLIPS
    assert (got == np.rint(got)).all()
    assert (got[:4] == black[:4]).all()
    assert (got == full).sum() > 100
