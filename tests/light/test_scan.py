"""Device functions of `kernels/scan.h`, one by one, each a law."""

from __future__ import annotations

import numpy as np
import tolerances
from device import LANES, Device
from laws import (
    SCAN,
    Array,
    Draws,
    close,
    design_of,
    holds,
    overlap,
    rounded,
    shared,
    stacked,
    struct,
)

PIXEL = """Pixels px; px.sub_rays = 3; px.first.light = light; px.first.wide = wide;
    px.first.narrow = narrow; px.first.irradiance = irradiance;"""


class Scanned:
    """Pixels of three sub-rays under designs without noise, and their signals in float64."""

    def __init__(self, seed: int, images: int = 13) -> None:
        d = self.draws = Draws(seed)
        self.images = images
        self.design = struct(
            "Design",
            d.groups,
            luminous_share=d.shared(0.1, 0.9),
            periods_per_mm=d.shared(0.1, 0.5),
            dark_leak=d.shared(0, 0.5),
            images=float(images),
            step=1 / images,
            exposure=d.shared(1, 4),
            full_scale=255.0,
            lag=2.0,
            pairs=np.where(np.arange(d.groups) % 2, images, images - 2)[:, None],
        )
        self.light, self.wide = d.pixel(-20, 20), d.pixel(0.5, 30)
        self.narrow = rounded(self.wide * d.pixel(0, 1))
        self.irradiance = d.pixel(0.2, 1)
        self.inputs = {
            "REAL light": self.light, "REAL wide": self.wide, "REAL narrow": self.narrow,
            "REAL irradiance": self.irradiance, "Design d": self.design,
        }  # fmt: skip

    def signal(self, k: int) -> Array:
        a, per_mm, leak, gain, step = design_of(
            self.design, "luminous_share", "periods_per_mm", "dark_leak", "exposure", "step"
        )
        total = np.zeros_like(self.light)
        for i in range(3):
            light = (self.light + 0.75 * i) * per_mm - k * step
            lit = overlap(light, self.wide * per_mm, self.narrow * per_mm, a)
            total += gain * self.irradiance / 3 * (leak + (1 - leak) * lit)
        return total

    def levels(self) -> Array:
        return np.stack([255 * np.minimum(self.signal(k), 1) for k in range(self.images)])


@holds("exposed_at", wrong=("RAY(px, i), px.sub_rays)", "RAY(px, i), 1)"))
@holds("signal_of", wrong=("signal += EXPOSED_AT(", "signal = EXPOSED_AT("))
@holds("signals_from", wrong=("shift_of(d, first + j)", "shift_of(d, j)"))
def test_the_signals_of_images_are_the_sums_of_their_sub_rays(device: Device) -> None:
    s = Scanned(60)
    code = (
        PIXEL
        + """REAL one = at_shift(exposed_at(d, px, 1), 0.0f), k5 = signal_of(d, px, 5);
        Signals some = signals_from(d, px, 4);"""
    )
    outputs = ("one", "k5", "some.value[0]", "some.value[1]", "some.value[7]")
    one, *got = device.call(SCAN, code, s.inputs, outputs)
    for value, k in zip(got, (5, 4, 5, 11), strict=True):
        close(value, s.signal(k), atol=tolerances.EXPOSED_RAY)
    a, per_mm, leak, gain = design_of(
        s.design, "luminous_share", "periods_per_mm", "dark_leak", "exposure"
    )
    lit = overlap((s.light + 0.75) * per_mm, s.wide * per_mm, s.narrow * per_mm, a)
    close(one, gain * s.irradiance / 3 * (leak + (1 - leak) * lit), atol=tolerances.EXPOSED_RAY)


@holds("mean_over_images", wrong=("return sum / FLOAT(images)", "return sum / FLOAT(images + 1)"))
@holds("fusion_over_images", wrong=("if (k < pairs)", "if (k < images)"))
def test_what_images_are_fused_to_is_what_numpy_makes_of_them(device: Device) -> None:
    s = Scanned(61)
    column, row = s.draws.rng.integers(0, 4000, (2, s.draws.groups, LANES), np.uint32)
    inputs = {**s.inputs, "COUNTER column": column, "COUNTER row": row}
    code = (
        PIXEL
        + """REAL mean = mean_over_images(d, px, column, row);
        Fusion f = fusion_over_images(d, px, column, row);"""
    )
    outputs = ("mean", "f.mean", "f.high", "f.low", "f.deviation", "f.difference")
    mean, f_mean, high, low, deviation, difference = stacked(
        device.call(SCAN, code, inputs, outputs)
    )
    y = s.levels()
    atol = 255 * tolerances.EXPOSED_RAY
    for got in (mean, f_mean):
        close(got, y.mean(axis=0), atol)
    close(high, y.max(axis=0), atol)
    close(low, y.min(axis=0), atol)
    close(deviation, y.std(axis=0), atol)
    gap = np.abs(np.roll(y, -2, axis=0) - y)
    wraps = design_of(s.design, "pairs")[0] == s.images
    close(difference, np.where(wraps, gap.mean(axis=0), gap[:-2].mean(axis=0)), 2 * atol)


@holds("fusion_of_none", wrong=("f.low = d.full_scale", "f.low = 0.0f"))
@holds("with_image", wrong=("gap * (y - f.mean)", "gap * gap"))
@holds("fusion_of_all", wrong=("f.deviation / FLOAT(images)", "f.deviation"))
def test_images_are_fused_one_by_one_without_cancelling(device: Device) -> None:
    d = Draws(62)
    # Of 65,535 DN a deviation of some DN: its square's difference from the mean square is lost.
    images = np.stack([rounded(65_000 + d.pixel(-3, 3)) for _ in range(6)])
    code = """Fusion f = fusion_of_none(d);
        f = with_image(f, a, 0); f = with_image(f, b, 1); f = with_image(f, c, 2);
        f = with_image(f, e, 3); f = with_image(f, p, 4); f = with_image(f, q, 5);
        f.difference = 6.0f; f = fusion_of_all(f, 6, 3);"""
    inputs = {f"REAL {name}": y for name, y in zip("abcepq", images, strict=True)}
    inputs["Design d"] = struct("Design", d.groups, full_scale=65_535.0)
    outputs = ("f.mean", "f.high", "f.low", "f.deviation", "f.difference")
    mean, high, low, deviation, difference = stacked(device.call(SCAN, code, inputs, outputs))
    close(mean, images.mean(axis=0), 4 * 65_000 * tolerances.FLOAT_ROUNDING)
    np.testing.assert_array_equal(high, images.max(axis=0))
    np.testing.assert_array_equal(low, images.min(axis=0))
    close(deviation, images.std(axis=0), 4 * 65_000 * tolerances.FLOAT_ROUNDING)
    assert (difference == 2).all()


@holds("sum_of_images", wrong=("part += min(at_shift", "part = min(at_shift"))
@holds("mean_of_ray", wrong=("bright += end - all", "bright += end - all + 1"))
def test_images_that_are_only_counted_are_those_in_which_a_pixel_does_not_change(
    device: Device,
) -> None:
    """mean_of_ray( and sum_of_images( against every image, one by one, on the same device."""
    d = Draws(63)
    n = d.groups
    images = np.floor(d.scales(1, 300, True))
    design = struct(
        "Design", n,
        luminous_share=d.shared(0.03, 0.97), images=images, full_scale=255.0,
        step=np.where(d.shared(0, 1) < 0.5, 1 / images, d.scales(1e-3, 3, True)),
        dark_leak=np.where(d.shared(0, 1) < 0.5, 0, d.shared(0, 0.5)),
    )  # fmt: skip
    # Neighbours see nearly the same; some groups anything.
    light = np.where(d.shared(0, 1) < 0.8, d.shared(-3, 3) + d.pixel(0, 0.08), d.pixel(-3, 3))
    wide = d.scales(1e-4, 0.7, True) * d.pixel(0.9, 1.1)
    inputs = {
        "REAL light": light, "REAL wide": wide, "REAL narrow": wide * d.shared(0, 1),
        "REAL irradiance": d.pixel(0, 1) * (d.pixel(0, 1) < 0.95), "Design d": design,
        **shared(gain=d.shared(0.5, 8)),
    }  # fmt: skip
    code = """Trapezoid t = exposed(lit_fraction(light, wide, narrow, d.luminous_share), irradiance,
                                    gain, d.dark_leak);
        int images = INT(d.images);
        REAL mean = mean_of_ray(d, t), sum = sum_of_images(d, t, 0, images), each = 0.0f;
        REAL steepest = t.slope;
        for (int k = 0; k < images; k++) each += min(at_shift(t, shift_of(d, k)), 1.0f);"""
    mean, total, each, slope = stacked(
        device.call(SCAN, code, inputs, ("mean", "sum", "each", "steepest"))
    )
    # Where a side passes, a shift's last bit is worth as much as the side is steep.
    shift = images * np.maximum(design[:, 4:5], 1 / images)
    limit = tolerances.FLOAT_ROUNDING * (4 + images**0.5 + slope * (shift + 2))
    close(total / images, each / images, limit)
    close(mean, each / images, limit)


@holds("image_from", wrong=("-floor(-shift / d.step)", "floor(shift / d.step)"))
def test_a_side_begins_to_pass_in_the_first_image_whose_shift_is_not_below_it(
    device: Device,
) -> None:
    d = Draws(64)
    design = struct("Design", d.groups, step=2.0 ** -np.floor(d.shared(1, 9)))
    step = design_of(design, "step")[0]
    shift = np.floor(d.shared(-20, 300)) * step / 2  # halves: between two images, or on one
    code = "REAL zero = 0.0f, k = zero + FLOAT(image_from(d, shift, 3, 90));"
    (got,) = device.call(SCAN, code, {"Design d": design, **shared(shift=shift)}, ("k",))
    np.testing.assert_array_equal(
        got, np.broadcast_to(np.clip(np.ceil(shift / step), 3, 90), got.shape)
    )
