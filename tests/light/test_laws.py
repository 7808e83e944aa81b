"""Laws of the model, on every backend."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenes import check_station
from tolerances import (
    BUMP_DENT,
    EQUAL_MEAN_DN,
    HANDBOOK_PERCENT,
    POINT_SAMPLED_DN,
    SHIFTED_DN,
    SIGNATURE_WIDTH,
    SYMMETRY_MM,
)

from gpuspec.light.backend import Backend
from gpuspec.simulation.simulate import simulate
from gpuspec.station.station import Station


def test_point_sampled_pixels_give_no_contrast(backend):
    # Sampled so finely that a footprint is a thousandth of a step of the light.
    station = check_station(pupil=0.0, camera__sampling_mm=2e-4, sequence__images=16)
    aspect = backend.trace(station).aspect()
    assert np.ptp(aspect) < POINT_SAMPLED_DN
    assert np.median(aspect) == pytest.approx(255 * 4 / 16, abs=POINT_SAMPLED_DN)


@pytest.mark.parametrize("exposure", [0.3, 1.0])
@pytest.mark.parametrize("pupil", [0.0, 3.0])
def test_an_unsaturated_sensor_gives_no_contrast(backend, exposure, pupil):
    aspect = backend.trace(check_station(pupil, exposure=exposure)).aspect()
    assert np.ptp(aspect) < EQUAL_MEAN_DN
    assert aspect.mean() == pytest.approx(exposure * 255 * 4 / 16, abs=EQUAL_MEAN_DN)


def test_saturation_makes_a_dent_brighter_than_the_flawless_part(backend):
    aspect = backend.trace(check_station()).aspect()
    assert aspect.max() > np.median(aspect) + 40


@pytest.mark.parametrize(
    ("delta", "width"),
    [(0, 2.588), (1, 2.415), (2, 2.263), (4, 1.995), (8, 1.518), (12, 1.031), (16, 0.25), (18, 0)],
)
def test_a_signature_shrinks_with_the_distance_of_the_transition(backend, delta, width):
    # The paper's figure 7 in one dimension: a groove across x, one transition at delta sigma.
    sigma, height, camera = 0.25, 100.0, 800.0
    station = Station.from_dict(
        {
            "tunnel": {"height_mm": height},
            "camera": {
                "height_mm": camera, "sampling_mm": 0.001, "columns": 16000, "rows": 1,
                "pupil_mm": 0.0,
            },
            "defects": [
                {
                    "kind": "scratch", "points_mm": [[0, -20], [0, 20]], "width_mm": 4 * sigma,
                    "depth_um": 10.0,
                }
            ],
        }
    )  # fmt: skip
    light = backend.trace(station).read().light_mm[0, 0]
    x = (np.arange(16000) - 7999.5) * 0.001
    transition = delta * sigma * (1 + height / camera)
    signature = (x < delta * sigma) & (light > transition)
    assert signature.sum() * 0.001 / sigma == pytest.approx(width, abs=SIGNATURE_WIDTH)


def test_a_shift_by_a_whole_period_changes_nothing(backend):
    light_map = backend.trace(check_station(sequence__step_mm=16.0, sequence__images=3))
    assert np.abs(light_map.image(2) - light_map.image(0)).max() < SHIFTED_DN


def test_a_bump_is_a_dent_seen_from_the_other_side_of_the_light(backend):
    # On an orientation-only flat part, turning z round is turning the slopes round: with the ray
    # straight down the middle the light coordinate changes sign of its deflection.
    dent = check_station()
    data = dent.as_dict()["defects"][0]
    bump = dent.replace(defects=[{**data, "kind": "bump"}])
    flat = dent.replace(defects=[])
    light = [backend.trace(s).read().light_mm[0] for s in (dent, bump, flat)]
    assert np.abs(light[0] + light[1] - 2 * light[2]).max() < BUMP_DENT * np.abs(light[0]).max()


def test_a_mirrored_part_gives_the_mirrored_light_map(backend):
    station = check_station()
    data = station.as_dict()["defects"][0]
    mirrored = station.replace(defects=[{**data, "x_mm": -data["x_mm"]}])
    light = backend.trace(station).read().light_mm[0]
    assert np.abs(light + backend.trace(mirrored).read().light_mm[0][:, ::-1]).max() < SYMMETRY_MM


flawless = st.fixed_dictionaries(
    {
        "tunnel": st.fixed_dictionaries(
            {
                "luminous_mm": st.floats(0.5, 8),
                "dark_mm": st.floats(2, 30),
                "dark_leak": st.sampled_from([0.0, 0.1]),
            }
        ),
        "camera": st.fixed_dictionaries(
            {
                "sampling_mm": st.just(0.5),
                "pupil_mm": st.floats(0, 20),
                "vignetting": st.sampled_from(["none", "cos4"]),
            }
        ),
        "sensor": st.fixed_dictionaries(
            {"exposure": st.floats(1, 16), "noise": st.booleans(), "seed": st.integers(0, 99)}
        ),
        "sequence": st.fixed_dictionaries({"images": st.integers(4, 100)}),
    }
)


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=flawless)
def test_nothing_is_detected_on_a_flawless_part(opencl: Backend, data):
    result = simulate(Station.from_dict(data), opencl)
    assert len(result.blobs) == 0
    assert result.score.p1 == 1
    assert result.score.p2 is None


@pytest.mark.parametrize(
    ("material", "percent"),
    [("ideal", 100), ("aluminium", 92), ("silver", 98), ("gold", 79), ("copper", 63),
     ("chromium", 56), ("nickel", 64), ("iron", 52), ("lacquer", 4)],
)  # fmt: skip
def test_metals_reflect_what_handbooks_say(backend, material: str, percent: float):
    """Straight down, near 550 nm: R = ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2), in percent."""
    station = check_station(part__material=material, camera__sampling_mm=0.001)
    seen = backend.trace(station).read().irradiance[0]
    assert 100 * seen.mean() == pytest.approx(percent, abs=HANDBOOK_PERCENT)
