"""What materials reflect over the wavelength."""

from __future__ import annotations

import numpy as np
import pytest

from gpuspec.errors import StationError
from gpuspec.light.float64 import fresnel_reflectance
from gpuspec.light.records import geometry_block
from gpuspec.station.materials import MATERIALS, TABLES, optical_constants, reflectance
from gpuspec.station.optics import diffraction_mtf50
from gpuspec.station.station import Station


def of(**part: object) -> Station:
    return Station.from_dict({"part": part}, "trim.toml")


@pytest.mark.parametrize("material", MATERIALS)
def test_without_a_word_on_wavelength_constants_are_those_at_550_nm(material: str) -> None:
    assert optical_constants(material) == MATERIALS[material]
    assert of().tunnel.wavelength_nm == 550


@pytest.mark.parametrize("material", TABLES)
def test_a_table_covers_400_to_1000_nm_in_rising_order(material: str) -> None:
    rows = np.array(TABLES[material].split(), float).reshape(-1, 3)
    assert (np.diff(rows[:, 0]) > 0).all()
    assert rows[0, 0] <= 400 < 1000 <= rows[-1, 0]
    for nm, n, k in rows[1:-1]:
        assert optical_constants(material, nm) == pytest.approx((n, k))


@pytest.mark.parametrize("material", TABLES)
def test_between_rows_constants_are_between_theirs(material: str) -> None:
    steps = np.array([optical_constants(material, nm) for nm in np.arange(400, 1000.5, 0.5)])
    assert np.abs(np.diff(steps, axis=0)).max() < 0.03  # nowhere a jump
    at = optical_constants(material, 549.999), optical_constants(material, 550.001)
    assert at[0] == pytest.approx(MATERIALS[material], abs=1e-3)
    assert at[1] == pytest.approx(MATERIALS[material], abs=1e-3)


@pytest.mark.parametrize("material", MATERIALS)
def test_looked_at_straight_the_reflectance_is_fresnels(material: str) -> None:
    for nm in (400.0, 550.0, 777.0, 1000.0):
        straight = fresnel_reflectance(np.ones(1), *optical_constants(material, nm))[0]
        assert reflectance(material, nm) == pytest.approx(straight)


def test_gold_and_copper_are_red_and_aluminium_has_its_dip() -> None:
    assert reflectance("gold", 450) < 0.45 and reflectance("gold", 650) > 0.95
    assert reflectance("copper", 500) < 0.6 and reflectance("copper", 700) > 0.95
    assert reflectance("aluminium", 825) < reflectance("aluminium", 650) - 0.03


def test_the_light_map_has_the_constants_of_the_wavelength() -> None:
    red = of(material="gold").replace(tunnel__wavelength_nm=659.5)
    n, k = geometry_block(red)[[19, 20]]
    assert (n, k) == pytest.approx((0.14, 3.697))


@pytest.mark.parametrize("nm", [399.0, 1001.0, float("nan"), "red"])
def test_a_wavelength_beyond_the_tables_is_refused_in_a_sentence(nm: object) -> None:
    with pytest.raises(StationError, match=r"^trim.toml: tunnel.wavelength_nm = "):
        of().replace(tunnel__wavelength_nm=nm)


def test_longer_waves_are_diffracted_more() -> None:
    assert diffraction_mtf50(8.0, 0.05, 850.0) == pytest.approx(
        diffraction_mtf50(8.0, 0.05) * 550 / 850
    )
