"""The EMVA 1288 group's own program measures the simulated sensor and finds what was put in."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
import tolerances
from emva1288.process import routines
from emva1288.process.data import Data1288
from emva1288.process.loader import LoadImageData
from emva1288.process.parser import ParseEmvaDescriptorFile
from emva1288.process.results import Results1288

from gpuspec.light.light_map import LightMap
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.station.station import Station

QUANTUM_EFFICIENCY = 0.5
"""Electrons per photon: the station's exposure is in electrons, EMVA 1288's in photons."""

EXPOSURE_NS = 1e6
PIXELS = 192
STACK = 16
"""Images of each spatial stack."""


def sensor(exposure: float) -> Station:
    """A flat part that sees one luminous stripe only, in every image but image 0.

    EMVA 1288's dark image is one with next to no exposure.
    """
    return Station.from_dict(
        {
            "tunnel": {"luminous_mm": 50_000.0, "dark_mm": 1.0},
            "camera": {"columns": PIXELS, "rows": PIXELS},
            "sequence": {"images": 200, "step_mm": 100.0},
            "sensor": {
                "noise": True, "seed": 1288, "bit_depth": 12, "black_level_dn": 100.0,
                "saturation_e": 10_000.0, "read_noise_e": 20.0, "dark_e": 50.0,
                "prnu": 0.01, "dsnu_e": 6.0, "exposure": exposure,
            },
        }
    )  # fmt: skip


def series(light: LightMap, folder: Path) -> Path:
    """Write images and descriptor file: pairs for every exposure, two stacks at half and dark."""
    lines = [f"v 4.0\nn 12 {PIXELS} {PIXELS}"]
    taken = 0

    def add(exposure: float, count: int) -> None:
        nonlocal taken
        photons = exposure * 10_000 / QUANTUM_EFFICIENCY
        dark = exposure < 1e-6
        lines.append(f"d {EXPOSURE_NS:.1f}" if dark else f"b {EXPOSURE_NS:.1f} {photons:.3f}")
        for _ in range(count):
            taken += 1
            name = f"image{taken}.tif"
            image = light.image(taken, sensor(exposure))
            tifffile.imwrite(folder / name, image.astype(np.uint16))
            lines.append(f"i {name}")

    for exposure in (1e-9, *np.linspace(0.02, 1.1, 55)):
        add(float(exposure), 2)
    for exposure in (1e-9, 0.5):
        add(exposure, STACK)
    descriptor = folder / "descriptor.txt"
    descriptor.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return descriptor


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    """What emva1288 finds, from files as a camera's owner would give them to it."""
    descriptor = series(OpenCLBackend().trace(sensor(1.0)), tmp_path_factory.mktemp("emva"))
    # emva1288 1.0.2 calls np.asfarray, which NumPy 2 dropped: its own namespace gets it back.
    numpy = SimpleNamespace(**{**vars(np), "asfarray": lambda a: np.asarray(a, np.float64)})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(routines, "np", numpy)
        info = ParseEmvaDescriptorFile(str(descriptor), loglevel=logging.WARNING)
        images = LoadImageData(info.images, loglevel=logging.WARNING, fload=tifffile.imread)
        results = Results1288(Data1288(images.data).data, loglevel=logging.WARNING)
        names = ("K", "QE", "sigma_d", "u_e_sat", "DSNU1288", "PRNU1288", "LE_min", "LE_max")
        return {name: float(getattr(results, name)) for name in names} | {
            "black": float(results.temporal["u_ydark"][0])
        }


def test_the_system_gain_is_found(found: dict[str, float]) -> None:
    gain = sensor(1.0).sensor.gain_dn_per_e
    assert found["K"] == pytest.approx(gain, rel=tolerances.EMVA_GAIN)
    assert found["QE"] == pytest.approx(100 * QUANTUM_EFFICIENCY, rel=tolerances.EMVA_GAIN)


def test_the_dark_noise_is_read_noise_with_the_dark_signals_shot_noise(
    found: dict[str, float],
) -> None:
    expected = np.sqrt(20.0**2 + 50.0)
    assert found["sigma_d"] == pytest.approx(expected, rel=tolerances.EMVA_DARK_NOISE)


def test_the_dark_level_is_black_level_and_dark_signal(found: dict[str, float]) -> None:
    expected = 100 + 50 * sensor(1.0).sensor.gain_dn_per_e
    assert found["black"] == pytest.approx(expected, abs=tolerances.EMVA_BLACK_DN)


def test_the_saturation_capacity_is_found(found: dict[str, float]) -> None:
    # The dark signal takes its part of the capacity; EMVA's point of largest variance lies where
    # the first pixels saturate, some standard deviations below.
    assert found["u_e_sat"] == pytest.approx(10_000 - 50, rel=tolerances.EMVA_CAPACITY)
    assert found["u_e_sat"] < 10_000 - 50


def test_the_response_is_linear(found: dict[str, float]) -> None:
    assert found["LE_min"] > -tolerances.EMVA_LINEARITY_PERCENT
    assert found["LE_max"] < tolerances.EMVA_LINEARITY_PERCENT


def test_the_fixed_patterns_are_found(found: dict[str, float]) -> None:
    assert found["DSNU1288"] == pytest.approx(6.0, rel=tolerances.EMVA_PATTERN)
    assert found["PRNU1288"] == pytest.approx(1.0, rel=tolerances.EMVA_PATTERN)
