"""Device functions of `kernels/image.h`, one by one, each a law."""

from __future__ import annotations

import numpy as np
import tolerances
from device import LANES, Device
from laws import GROUPS, IMAGE, Draws, close, design_of, designs, holds, overlap, rounded, shared

from gpuspec.light.float64 import random_words


@holds(
    "exposed_ray",
    wrong=("(q, ray.irradiance, d.exposure / FLOAT(sub_rays)", "(q, ray.irradiance, d.exposure"),
)
def test_sub_rays_share_a_pixel_and_see_the_lit_fraction_of_their_footprint(device: Device) -> None:
    d = Draws(40)
    design = designs(d, noise=False)
    light, wide = d.pixel(-60, 60), d.pixel(0.5, 30)
    narrow = rounded(wide * d.pixel(0, 1))
    seen, shift = d.pixel(0, 1), d.shared(0, 1)
    inputs = {"REAL light": light, "REAL wide": wide, "REAL narrow": narrow,
              "REAL seen": seen, **shared(shift=shift), "Design d": design}  # fmt: skip
    code = """Ray r; r.light = light; r.wide = wide; r.narrow = narrow; r.irradiance = seen;
        REAL e = at_shift(exposed_ray(d, r, 4), shift);"""
    (got,) = device.call(IMAGE, code, inputs, ("e",))
    a, per_mm, leak = design_of(design, "luminous_share", "periods_per_mm", "dark_leak")
    share = overlap(light * per_mm - shift, wide * per_mm, narrow * per_mm, a)
    (gain,) = design_of(design, "exposure")
    close(got, gain * seen / 4 * (leak + (1 - leak) * share), atol=tolerances.EXPOSED_RAY)


@holds("exposure_of", wrong=("(1.0f - d.dark_leak) * lit", "lit"))
def test_a_radiance_of_one_s_own_is_exposed_as_the_stripes_are(device: Device) -> None:
    d = Draws(45)
    design = designs(d, noise=False)
    lit, seen = d.pixel(0, 1), d.pixel(0, 1)
    code = "REAL e = exposure_of(d, lit, seen, 9);"
    (got,) = device.call(
        IMAGE, code, {"REAL lit": lit, "REAL seen": seen, "Design d": design}, ("e",)
    )
    leak, gain = design_of(design, "dark_leak", "exposure")
    close(got, gain * seen / 9 * (leak + (1 - leak) * lit), rtol=3 * tolerances.FLOAT_ROUNDING)


@holds("shift_of", wrong=("FLOAT(k) * d.step", "FLOAT(k) * d.images"))
def test_images_are_shifted_by_equal_steps(device: Device) -> None:
    d = Draws(41)
    design = designs(d, noise=False)
    k = np.broadcast_to(np.arange(d.groups, dtype=float)[:, None], (d.groups, LANES))
    inputs = {**shared(k=k[:, :1]), "Design d": design}
    code = "int n = 0; while (FLOAT(n) < k) { n++; } REAL s = shift_of(d, n);"
    (got,) = device.call(IMAGE, code, inputs, ("s",))
    close(got, k * design_of(design, "step")[0], rtol=tolerances.FLOAT_ROUNDING)


@holds("words_of", wrong=("65536u * UINT(d.seed_high)", "65535u * UINT(d.seed_high)"))
def test_words_belong_to_pixel_image_and_seed(device: Device) -> None:
    d = Draws(42)
    design = designs(d, noise=True)
    column, row = d.rng.integers(0, 2**32, (2, d.groups, LANES), np.uint32)
    inputs = {"COUNTER column": column, "COUNTER row": row, "Design d": design}
    code = "Words w = words_of(d, column, row, 7u);"
    got = device.call(IMAGE, code, inputs, ("COUNTER w.a", "COUNTER w.d"))
    low, high = design_of(design, "seed_low", "seed_high")
    seeds = (low + 65536 * high)[:, 0]
    for group in range(0, d.groups, 25):
        words = random_words(column[group], row[group], 7, int(seeds[group]))
        assert np.array_equal(got[0][group], words[0])
        assert np.array_equal(got[1][group], words[3])


@holds("fixed_pattern", wrong=("d.noise == 0.0f || (d.dsnu", "d.noise == 1.0f || (d.dsnu"))
def test_the_fixed_pattern_is_none_without_noise_and_normal_with_it(device: Device) -> None:
    d = Draws(43, 4 * GROUPS)
    column, row = d.rng.integers(0, 2**32, (2, d.groups, LANES), np.uint32)
    code = "Normals p = fixed_pattern(d, column, row);"
    for noise in (False, True):
        design = designs(d, noise)
        inputs = {"COUNTER column": column, "COUNTER row": row, "Design d": design}
        first, second = device.call(IMAGE, code, inputs, ("p.first", "p.second"))
        if not noise:
            assert (first == 0).all()
            assert (second == 0).all()
        else:
            count = first.size
            for values in (first, second):  # five standard errors
                assert abs(values.mean()) < 5 / np.sqrt(count)
                assert abs(values.var() - 1) < 5 * np.sqrt(2 / count)


@holds("grey_level", wrong=("words_of(d, column, row, UINT(k))", "words_of(d, column, row, 0u)"))
def test_a_grey_level_is_saturated_or_noisy_by_the_image_s_own_words(device: Device) -> None:
    d = Draws(44)
    column, row = d.rng.integers(0, 4000, (2, d.groups, LANES), np.uint32)
    signal = d.pixel(0, 1.5)
    code = """Normals none; none.first = 0.0f; none.second = 0.0f;
        REAL y = grey_level(signal, d, 5, column, row, none);
        REAL z = noisy_grey_level(signal, none, words_of(d, column, row, 5u), d);"""
    for noise in (False, True):
        inputs = {"REAL signal": signal, "COUNTER column": column, "COUNTER row": row,
                  "Design d": designs(d, noise)}  # fmt: skip
        got, noisy = device.call(IMAGE, code, inputs, ("y", "z"))
        if noise:
            assert np.array_equal(got, noisy)
        else:
            close(got, 4095 * np.minimum(signal, 1), rtol=tolerances.FLOAT_ROUNDING)
