"""The sensor's noise: its random numbers, their distributions, and the images they make.

Seeds are fixed, so every number here is the same at each run: the bounds cannot be crossed by bad
luck, yet they are those of a statistical test (`tolerances.P_VALUE`, `tolerances.SIGMAS`).
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
import tolerances
from device import DEVICES, LANES, Device, open_backend, open_device
from numpy.typing import NDArray
from scipy.stats import chi2, kstest, norm, poisson

from gpuspec.light import float64 as reference
from gpuspec.light.backend import Backend
from gpuspec.light.float64_backend import NumpyBackend
from gpuspec.light.light_map import LightMap
from gpuspec.light.opengl import OpenGLBackend
from gpuspec.light.tiles import TiledLightMap
from gpuspec.station.station import Station

Words = NDArray[np.uint32]
Array = NDArray[np.float64]

HEADERS = ("station.h", "sensor.h")
MANY = 2**20
AXES = ("column", "row", "image", "seed")


@pytest.fixture(scope="module", params=DEVICES)
def device(request: pytest.FixtureRequest) -> Device:
    return open_device(request.param)


def counters(**axes: Any) -> dict[str, Words]:
    """Counters of random numbers, zero where not given, as inputs of a device function."""
    size = max(np.size(values) for values in axes.values())
    arrays = [np.broadcast_to(np.asarray(axes.get(name, 0), np.uint32), size) for name in AXES]
    return {f"COUNTER {n}": a.reshape(-1, LANES) for n, a in zip(AXES, arrays, strict=True)}


RANDOM_WORDS = "Words w = random_words(column, row, image, seed); "


def numbers(device: Device, code: str, expressions: tuple[str, ...], **inputs: Any) -> Array:
    outputs = device.call(HEADERS, RANDOM_WORDS + code, inputs, expressions)
    return np.stack([output.ravel() for output in outputs])


def uniforms(device: Device, **axes: Any) -> Array:
    """Uniform numbers of all four words, shape (4, n)."""
    names = tuple(f"uniform_number(w.{word})" for word in "abcd")
    return numbers(device, "", names, **counters(**axes)).astype(np.float64)


def lag_correlation(a: Array, b: Array) -> float:
    """Correlation of two sequences in standard deviations of that of independent ones."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1] * np.sqrt(a.size))


def z_mean(sample: Array, mean: float, variance: float) -> float:
    return float((sample.mean(dtype=np.float64) - mean) / np.sqrt(variance / sample.size))


def z_variance(sample: Array, variance: float) -> float:
    """Deviation of the sample's variance, in standard deviations (from its fourth moment)."""
    gap = sample.astype(np.float64) - sample.mean(dtype=np.float64)
    found = (gap**2).mean()
    return float((found - variance) / np.sqrt(((gap**4).mean() - found**2) / sample.size))


# ---------------------------------------------------------------------------------- random words


def test_random_words_are_the_same_integers_on_device_and_host(device: Device) -> None:
    rng = np.random.default_rng(1)
    extremes = np.array([0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1, 1_000_000])
    values = rng.integers(0, 2**32, (4, 4096))
    values[:, :1024] = extremes[rng.integers(0, len(extremes), (4, 1024))]
    inputs = counters(**dict(zip(AXES, values, strict=True)))
    outputs = tuple(f"COUNTER w.{word}" for word in "abcd")
    got = numbers(device, "", outputs, **inputs)
    for n in range(0, values.shape[1], 7):
        column, row, image, seed = (int(v) for v in values[:, n])
        words = reference.random_words(column, row, image, seed)
        assert [int(w) for w in words] == got[:, n].tolist()


def pcg4d(*counter: int) -> tuple[int, ...]:
    """pcg4d in whole numbers, as Jarzynski and Olano print it (JCGT 9(3), 2020)."""
    mask = 2**32 - 1
    x, y, z, w = ((c * 1664525 + 1013904223) & mask for c in counter)
    x, y = (x + y * w) & mask, y
    y = (y + z * x) & mask
    z = (z + x * y) & mask
    w = (w + y * z) & mask
    x, y, z, w = (v ^ (v >> 16) for v in (x, y, z, w))
    x = (x + y * w) & mask
    y = (y + z * x) & mask
    z = (z + x * y) & mask
    w = (w + y * z) & mask
    return x, y, z, w


KNOWN = {
    (0, 0, 0, 0): (251852841, 760645481, 850445371, 3542436074),
    (1, 2, 3, 4): (908250390, 4044648920, 3775961919, 45698095),
    (2**32 - 1,) * 4: (2538526866, 3222658151, 2677364576, 2713428488),
}
"""Words of counters, worked out once by `pcg4d`: no later version may change a part's noise."""


@pytest.mark.parametrize("counter", KNOWN)
def test_random_words_never_change(counter: tuple[int, ...], device: Device) -> None:
    assert pcg4d(*counter) == KNOWN[counter]
    assert tuple(int(w) for w in reference.random_words(*counter)) == KNOWN[counter]
    inputs = counters(**{a: np.full(LANES, c) for a, c in zip(AXES, counter, strict=True)})
    words = numbers(device, "", tuple(f"COUNTER w.{word}" for word in "abcd"), **inputs)
    assert (words == np.array(KNOWN[counter], np.uint32)[:, None]).all()


@pytest.mark.slow
@pytest.mark.parametrize("axis", AXES)
def test_uniform_numbers_fill_256_bins_evenly_along_every_counter(
    axis: str, device: Device
) -> None:
    fixed = {"column": 321, "row": 123, "image": 7, "seed": 5}
    for word in uniforms(device, **{**fixed, axis: np.arange(MANY)}):
        assert word.min() > 0
        assert word.max() < 1
        counts = np.bincount((word * 256).astype(int), minlength=256)
        square = ((counts - MANY / 256) ** 2 / (MANY / 256)).sum()
        # Neither uneven nor, as a plain counter would be, too even.
        assert tolerances.P_VALUE < chi2.sf(square, 255) < 1 - tolerances.P_VALUE


def test_neighbouring_pixels_images_seeds_and_words_are_uncorrelated(device: Device) -> None:
    side = np.arange(512)
    row, column = (index.ravel() for index in np.meshgrid(side, side, indexing="ij"))
    shape = (4, 512, 512)
    here = uniforms(device, column=column, row=row, image=3, seed=11).reshape(shape)
    pairs = [
        (here[:, :, :-1], here[:, :, 1:]),
        (here[:, :, :-8], here[:, :, 8:]),
        (here[:, :-1], here[:, 1:]),
        (here[:, :-1, 1:], here[:, 1:, :-1]),
        (here, np.swapaxes(here, 1, 2)),
    ]
    others = [(4, 11), (2**31, 11), (0xFFFFFFFF, 11), (3, 12), (3, 11 + 65536), (11, 3)]
    for image, seed in others:
        other = uniforms(device, column=column, row=row, image=image, seed=seed).reshape(shape)
        pairs.append((here, other))
    for first, second in pairs:
        for a, b in zip(first, second, strict=True):
            assert abs(lag_correlation(a, b)) < tolerances.SIGMAS
            # Nor do large values attract large or small ones.
            assert abs(lag_correlation((a - 0.5) ** 2, (b - 0.5) ** 2)) < tolerances.SIGMAS
    for a, b in combinations(here, 2):
        assert abs(lag_correlation(a, b)) < tolerances.SIGMAS
        assert abs(lag_correlation((a - 0.5) ** 2, (b - 0.5) ** 2)) < tolerances.SIGMAS


# --------------------------------------------------------------------------------- distributions


@pytest.mark.slow
def test_normal_numbers_are_normal(device: Device) -> None:
    axes = counters(column=np.arange(MANY) % 1024, row=np.arange(MANY) // 1024, image=1, seed=2)
    code = "Normals n = normal_numbers(w.b, w.c);"
    pair = numbers(device, code, ("n.first", "n.second"), **axes).astype(np.float64)
    for sample in pair:
        # Mean, variance, skewness and kurtosis; their errors are 1, 2, 6 and 24 over n.
        assert abs(z_mean(sample, 0, 1)) < tolerances.SIGMAS
        assert abs(z_variance(sample, 1)) < tolerances.SIGMAS
        assert abs((sample**3).mean()) < tolerances.SIGMAS * np.sqrt(15 / MANY)
        assert abs((sample**4).mean() - 3) < tolerances.SIGMAS * np.sqrt(96 / MANY)
        assert kstest(sample, "norm").pvalue > tolerances.P_VALUE
        edges = np.r_[-np.inf, norm.ppf(np.arange(1, 256) / 256), np.inf]
        counts = np.histogram(sample, edges)[0]
        square = ((counts - MANY / 256) ** 2 / (MANY / 256)).sum()
        assert chi2.sf(square, 255) > tolerances.P_VALUE
        beyond = np.count_nonzero(np.abs(sample) > 4)
        assert poisson.sf(beyond - 1, MANY * 2 * norm.sf(4)) > tolerances.P_VALUE
        assert poisson.cdf(beyond, MANY * 2 * norm.sf(4)) > tolerances.P_VALUE
    assert abs(lag_correlation(pair[0], pair[1])) < tolerances.SIGMAS
    assert abs(lag_correlation(pair[0] ** 2, pair[1] ** 2)) < tolerances.SIGMAS


def poisson_numbers(device: Device, mu: float, seed: int) -> Array:
    axes = counters(column=np.arange(MANY) % 1024, row=np.arange(MANY) // 1024, seed=seed)
    inputs = {**axes, "REAL mu": np.full((MANY // LANES, LANES), mu)}
    code = """Normals g = normal_numbers(w.b, w.c);
        REAL n = poisson_number(mu, uniform_number(w.a), g.first);"""
    return numbers(device, code, ("n",), **inputs)[0].astype(np.float64)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.05, 0.5, 3, 10, 15.9])
def test_few_electrons_follow_poisson_exactly(mu: float, device: Device) -> None:
    sample = poisson_numbers(device, mu, 3)
    assert abs(z_mean(sample, mu, mu)) < tolerances.SIGMAS
    assert abs(z_variance(sample, mu)) < tolerances.SIGMAS
    counts = np.bincount(sample.astype(int), minlength=60)
    expected = MANY * poisson.pmf(np.arange(len(counts)), mu)
    rare = expected < 10
    counts = np.append(counts[~rare], counts[rare].sum())
    expected = np.append(expected[~rare], MANY - expected[~rare].sum())
    square = ((counts - expected) ** 2 / expected).sum()
    assert chi2.sf(square, len(counts) - 1) > tolerances.P_VALUE


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.05, 0.5, 3.0, 7.0, 15.9])
def test_every_uniform_number_there_is_gives_its_quantile_of_poisson(
    mu: float, device: Device
) -> None:
    mu = float(np.float32(mu))
    u = ((np.arange(2**23) + 0.5) / 2**23).reshape(-1, LANES)
    inputs = {"REAL u": u, "REAL mu": np.full(u.shape, mu)}
    (n,) = device.call(HEADERS, "REAL n = poisson_number(mu, u, 0.0f * u);", inputs, ("n",))
    counts = np.bincount(n.ravel().astype(int), minlength=60)
    below = np.rint(poisson.cdf(np.arange(-1, len(counts)), mu) * 2**23)
    assert np.abs(counts - np.diff(below)).max() <= tolerances.POISSON_STEPS
    # No sum that stalls short of one lets a lone pixel count on to the loop's end.
    assert n.max() <= poisson.isf(2.0**-24, mu) + 2


@pytest.mark.slow
@pytest.mark.parametrize("mu", [16.0, 16.5, 20.0, 50.0, 300.0, 10_000.0])
def test_many_electrons_have_poissons_mean_and_variance(mu: float, device: Device) -> None:
    sample = poisson_numbers(device, mu, 4)
    assert abs(z_mean(sample, mu, mu)) < tolerances.SIGMAS
    assert abs(z_variance(sample, mu)) < tolerances.SIGMAS
    assert (sample == np.floor(sample)).all()
    assert sample.min() >= 0


@pytest.mark.parametrize("mu", [16.0, 16.3, 25.5, 100.0])
def test_rounding_to_whole_electrons_adds_no_variance(mu: float, device: Device) -> None:
    # The quantiles of a normal distribution in place of random numbers: nothing is left to chance.
    g = norm.ppf((np.arange(MANY) + 0.5) / MANY).reshape(-1, LANES)
    inputs = {"REAL g": g, "REAL mu": np.full(g.shape, mu)}
    (n,) = device.call(HEADERS, "REAL n = poisson_number(mu, 0.5f + 0.0f * g, g);", inputs, ("n",))
    assert n.mean(dtype=np.float64) == pytest.approx(mu, rel=tolerances.POISSON_MOMENTS)
    assert n.var(dtype=np.float64) == pytest.approx(mu, rel=tolerances.POISSON_MOMENTS)


def test_mean_and_variance_do_not_jump_where_the_method_changes(device: Device) -> None:
    exact = poisson_numbers(device, np.nextafter(np.float32(16), np.float32(0)), 5)
    gauss = poisson_numbers(device, 16.0, 6)
    assert abs(gauss.mean() - exact.mean()) < tolerances.SIGMAS * np.sqrt(2 * 16 / MANY)
    fourth = 16 + 3 * 16**2 - 16**2
    assert abs(gauss.var() - exact.var()) < tolerances.SIGMAS * np.sqrt(2 * fourth / MANY)


# ------------------------------------------------------------------------------------ whole images


def flat_field(**changes: Any) -> Station:
    """A flat part that sees one luminous stripe only, in every image but image 0.

    At shift 0 the stripes begin at x = 0; 100 mm on and more, no footprint reaches a dark stripe.
    """
    station = Station.from_dict(
        {
            "tunnel": {"luminous_mm": 50_000.0, "dark_mm": 1.0},
            "camera": {"columns": 256, "rows": 256},
            "sequence": {"images": 64, "step_mm": 100.0},
            "sensor": {"noise": True, "seed": 1, "saturation_e": 10_000.0, "bit_depth": 12},
        }
    )
    return station.replace(**changes)


def images(light: LightMap, station: Station, first: int, last: int) -> Array:
    return np.stack([light.image(k, station) for k in range(first, last)]).astype(np.float64)


@pytest.fixture(scope="module", params=DEVICES)
def field(request: pytest.FixtureRequest) -> LightMap:
    """The flat field's light map; stations of other sensors share it."""
    return open_backend(request.param).trace(flat_field())


@pytest.mark.slow
@pytest.mark.parametrize("exposure", [0.0003, 0.003, 0.05, 0.5, 0.9])
@pytest.mark.parametrize(("bits", "black"), [(8, 20.0), (10, 60.0), (12, 100.0), (16, 1000.0)])
def test_grey_levels_have_emvas_mean_and_variance(
    bits: int, black: float, exposure: float, field: LightMap
) -> None:
    station = flat_field(
        sensor__bit_depth=bits, sensor__black_level_dn=black, sensor__exposure=exposure,
        sensor__read_noise_e=30.0, sensor__dark_e=4.0, sensor__seed=bits,
    )  # fmt: skip
    grey = images(field, station, 1, 5)
    gain = station.sensor.gain_dn_per_e
    electrons = 10_000 * exposure + 4
    variance = gain**2 * (30**2 + electrons) + 1 / 12
    assert abs(z_mean(grey, gain * electrons + black, variance)) < tolerances.SIGMAS
    assert abs(z_variance(grey, variance)) < tolerances.SIGMAS


def test_grey_levels_are_whole_numbers_of_the_sensors_range(field: LightMap) -> None:
    for bits in (8, 10, 12, 16):
        station = flat_field(sensor__bit_depth=bits, sensor__exposure=0.999)
        grey = images(field, station, 1, 3)
        assert (grey == np.rint(grey)).all()
        assert grey.max() == 2**bits - 1
        assert grey.min() > 0
    dark = flat_field(sensor__exposure=1e-9, sensor__read_noise_e=40.0)
    grey = images(field, dark, 1, 3)
    assert (grey == np.rint(grey)).all()
    assert grey.min() == 0
    # Half of a noise about zero is clipped to zero, with what rounds to it.
    expected = norm.cdf(0.5 / (40 * dark.sensor.gain_dn_per_e))
    share = (grey == 0).astype(np.float64)
    assert abs(z_mean(share, expected, expected * (1 - expected))) < tolerances.SIGMAS


def test_noise_is_clipped_at_saturation(field: LightMap) -> None:
    grey = images(field, flat_field(sensor__exposure=4.0, sensor__black_level_dn=100.0), 1, 3)
    assert (grey == 4095).all()
    # At saturation on the average, half the pixels saturate, with what rounds up to it.
    station = flat_field(sensor__exposure=1.0, sensor__read_noise_e=20.0)
    share = (images(field, station, 1, 5) == 4095).astype(np.float64)
    half_dn = 0.5 / station.sensor.gain_dn_per_e
    expected = norm.cdf(half_dn / np.sqrt(10_000 + 20**2))
    assert abs(z_mean(share, expected, expected * (1 - expected))) < tolerances.SIGMAS


def test_noise_differs_between_images_and_seeds(field: LightMap) -> None:
    taken = [
        field.image(k, flat_field(sensor__exposure=0.5, sensor__seed=seed)).astype(np.float64)
        for seed in (0, 1, 65_536, 2**32 - 1)
        for k in (1, 2, 9)
    ]
    for a, b in combinations(taken, 2):
        assert abs(lag_correlation(a, b)) < tolerances.SIGMAS
    again = field.image(2, flat_field(sensor__exposure=0.5, sensor__seed=65_536))
    np.testing.assert_array_equal(again, taken[7])


def covariance(a: Array, b: Array) -> float:
    return float(((a - a.mean()) * (b - b.mean())).mean())


def test_prnu_and_dsnu_are_fixed_maps_of_their_rms(field: LightMap) -> None:
    fixed: dict[str, Any] = {
        "sensor__prnu": 0.02, "sensor__dsnu_e": 8.0, "sensor__dark_e": 60.0,
        "sensor__read_noise_e": 5.0, "sensor__black_level_dn": 100.0,
    }  # fmt: skip
    bright = flat_field(sensor__exposure=0.5, **fixed)
    dark = flat_field(sensor__exposure=1e-9, **fixed)
    other = flat_field(sensor__exposure=0.5, **{**fixed, "sensor__seed": 2})
    gain = bright.sensor.gain_dn_per_e
    halves = {
        name: [images(field, station, first, first + 8).mean(axis=0) for first in (1, 9)]
        for name, station in (("bright", bright), ("dark", dark), ("other", other))
    }
    pixels = halves["bright"][0].size
    # What two sets of images share is their pattern: noise does not add to its variance.
    expected = {
        "bright": gain**2 * ((0.02 * 5000) ** 2 + 8**2),
        "dark": gain**2 * 8**2,
    }
    for name, variance in expected.items():
        a, b = halves[name]
        error = np.sqrt((variance**2 + a.var() * b.var()) / pixels)
        assert abs(covariance(a, b) - variance) < tolerances.SIGMAS * error
    assert abs(lag_correlation(halves["bright"][0], halves["other"][0])) < tolerances.SIGMAS
    # PRNU and DSNU are two maps: bright and dark share the DSNU alone.
    a, b = halves["bright"][0], halves["dark"][1]
    error = np.sqrt((expected["dark"] ** 2 + a.var() * b.var()) / pixels)
    assert abs(covariance(a, b) - expected["dark"]) < tolerances.SIGMAS * error


def test_a_sensor_without_noise_has_neither_noise_nor_pattern(field: LightMap) -> None:
    station = flat_field(
        sensor__noise=False, sensor__exposure=0.5, sensor__prnu=0.1, sensor__dsnu_e=50.0,
        sensor__read_noise_e=20.0,
    )  # fmt: skip
    grey = field.image(1, station)
    np.testing.assert_allclose(grey, 0.5 * 4095, rtol=tolerances.FLOAT_ROUNDING * 4)


# --------------------------------------------------------------------------------- tiles, backends


def striped(**changes: Any) -> Station:
    """A dented part under stripes, 67 pixels wide (no multiple of eight), with every noise."""
    station = Station.from_dict(
        {
            "part": {"length_mm": 6.1, "width_mm": 3.7, "crown_radius_x_mm": 300.0},
            "tunnel": {"length_mm": 300.0, "opening_length_mm": 1.0, "opening_width_mm": 1.0},
            "camera": {"sampling_mm": 0.1, "columns": 67, "rows": 42},
            "sequence": {"images": 11},
            "sensor": {
                "noise": True, "seed": 3_000_000_000, "bit_depth": 12, "prnu": 0.02, "dark_e": 30.0,
                "dsnu_e": 5.0, "black_level_dn": 40.0,
            },
            "defects": [
                {"kind": "dent", "x_mm": 0.3, "y_mm": -0.4, "diameter_mm": 1.0, "depth_um": 6.0},
            ],
        }
    )  # fmt: skip
    return station.replace(**changes)


def everything(light: LightMap, station: Station) -> dict[str, NDArray[Any]]:
    """Every array that a light map gives."""
    home = light.read()
    results = {f"image {k}": light.image(k) for k in (0, 1, 10)}
    results |= {f"fused {name}": image for name, image in light.fuse().items()}
    results |= {"mean": light.mean(), "lost": light.lost(), "lost read": home.lost}
    results |= {"light": home.light_mm, "footprint": home.footprint_mm}
    results["irradiance"] = home.irradiance
    if station.camera.subsampling == 1:
        results["closed form"] = light.closed_form()
    return results


@pytest.mark.slow
@pytest.mark.parametrize("subsampling", [1, 2])
@pytest.mark.parametrize("noise", [True, False])
def test_tiles_change_no_bit(subsampling: int, noise: bool, device_backend: Backend) -> None:
    station = striped(camera__subsampling=subsampling, sensor__noise=noise)
    light = device_backend.trace(station)
    assert isinstance(light, TiledLightMap)
    assert light.tiles == 1
    whole = everything(light, station)
    assert len(np.unique(whole["lost"])) > 2
    for memory in (1, 30_000):
        short: Any = type(device_backend)
        tiled = short(memory_bytes=memory).trace(station)
        assert tiled.tiles == station.shape[0] if memory == 1 else 1 < tiled.tiles < 40
        for name, array in everything(tiled, station).items():
            np.testing.assert_array_equal(array, whole[name], err_msg=name)


@pytest.mark.parametrize("subsampling", [1, 2])
def test_rows_wider_than_a_texture_wrap_and_change_no_bit(subsampling: int) -> None:
    station = striped(camera__subsampling=subsampling)
    whole = everything(OpenGLBackend().trace(station), station)
    for columns in (67, 34, 10):
        for memory in (None, 30_000):
            backend = OpenGLBackend(texture_columns=columns, memory_bytes=memory)
            for name, array in everything(backend.trace(station), station).items():
                np.testing.assert_array_equal(array, whole[name], err_msg=name)


def test_a_pixel_has_no_dark_signal_below_zero(device_backend: Backend) -> None:
    """DSNU wider than the dark signal is cut off there; what the light adds is not taken from."""
    station = flat_field(
        sensor__exposure=0.002, sensor__dark_e=10.0, sensor__dsnu_e=60.0,
        sensor__read_noise_e=0.0, sensor__black_level_dn=100.0,
    )  # fmt: skip
    grey = device_backend.trace(station).image(1).astype(np.float64)
    electrons = (grey - 100) / station.sensor.gain_dn_per_e
    dark = 10 * norm.cdf(10 / 60) + 60 * norm.pdf(10 / 60)
    square = (10**2 + 60**2) * norm.cdf(10 / 60) + 10 * 60 * norm.pdf(10 / 60)
    step = 1 / station.sensor.gain_dn_per_e
    variance = square - dark**2 + 20 + dark + step**2 / 12
    assert abs(z_mean(electrons, 20 + dark, variance)) < tolerances.SIGMAS
    share, _ = flips(grey, NumpyBackend().trace(station).image(1))
    assert share <= tolerances.FLAT_FLIPS


def flips(first: NDArray[Any], second: NDArray[Any]) -> tuple[float, float]:
    """Share of pixels that differ, and the largest difference in DN."""
    gap = np.abs(first.astype(np.float64) - second)
    return float((gap > 0).mean()), float(gap.max())


@pytest.mark.slow
@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("exposure", [0.0005, 0.003, 0.5, 0.95])
def test_backends_make_the_same_noise_but_for_rare_flips_of_one_grey_level(
    exposure: float, name: str
) -> None:
    station = flat_field(
        sensor__exposure=exposure, sensor__seed=4_000_000_001, sensor__prnu=0.01,
        sensor__dark_e=3.0, sensor__dsnu_e=1.0, sensor__black_level_dn=100.0,
    )  # fmt: skip
    one: Backend = open_backend(name)
    a, b = one.trace(station), NumpyBackend().trace(station)
    for k in (1, 63):
        share, largest = flips(a.image(k), b.image(k))
        assert share <= tolerances.FLAT_FLIPS
        assert largest <= 1


def test_backends_agree_on_a_noisy_striped_part(device_backend: Backend) -> None:
    station = striped()
    a, b = device_backend.trace(station), NumpyBackend().trace(station)
    for k in (0, 5, 10):
        share, largest = flips(a.image(k), b.image(k))
        assert share <= tolerances.STRIPED_FLIPS
        assert largest <= tolerances.STRIPED_FLIP_DN
    fused, expected = a.fuse(), b.fuse()
    for name, image in expected.items():
        assert np.abs(fused[name] - image).max() <= tolerances.STRIPED_FLIP_DN, name
