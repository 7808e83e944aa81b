"""A station is fitted to the frames of another: each number within its uncertainty."""

from __future__ import annotations

import json

import numpy as np
import pytest
from test_inspect import written

import gpuspec
from gpuspec.errors import FrameError, OutputError

MOST, ALL = 2.0, 4.5
"""Standard uncertainties within which most numbers are, and every one. Of 55 numbers of seven
random stations 51 were within 2 and all within 2.8."""
LEVEL_DN, NOISE = 0.1, 0.08
"""Between the aspect images of frames and twin: level, and noise relatively. Measured: 0.05 DN and
3 %, on images of 100,000 pixels; here they have 30,000."""
TABLE = [1.0, 0.8, 0.5, 0.2, 0.05, 0.1, 0.3, 0.7]


def real(seed: int, kind: str) -> gpuspec.Station:
    """Return a random station with noise."""
    draw = np.random.default_rng(seed).uniform
    period = draw(4, 8)
    tunnel = {"luminous_mm": period / 2, "dark_mm": period / 2}
    exposure = draw(0.5, 0.9)
    if kind == "stripes":
        duty, exposure = draw(0.2, 0.5), draw(1.5, 4)
        tunnel = {"luminous_mm": duty * period, "dark_mm": (1 - duty) * period}
    if kind == "table":
        tunnel["profile"] = TABLE
    else:
        tunnel["dark_leak"] = draw(0.02, 0.1)
    if kind == "sinusoid":
        tunnel |= {"profile": "sinusoid", "profile_gamma": draw(0.8, 2.6)}
        exposure = draw(0.6, 1.3)
    return gpuspec.Station(
        part={"length_mm": 20.0, "width_mm": 15.0},
        tunnel=tunnel,
        camera={"sampling_mm": 0.1, "pupil_mm": draw(3, 8)},
        sensor={
            "exposure": exposure, "noise": True, "seed": seed, "saturation_e": draw(4e3, 2e4),
            "read_noise_e": draw(20, 60), "prnu": draw(0.005, 0.01),
        },
        sequence={"images": int(draw(12, 24))},
    )  # fmt: skip


def taken(station: gpuspec.Station) -> np.ndarray:
    light_map = gpuspec.simulate(station, "numpy").light_map
    images = [np.rint(light_map.image(k)) for k in range(station.sequence.images)]
    return np.array(images, np.uint8)


def fitted(station: gpuspec.Station, **options) -> gpuspec.Fit:
    known = {"camera": {"sampling_mm": 0.1}}
    if not station.tunnel.is_striped:
        known["camera"]["pupil_mm"] = station.camera.pupil_mm
    return gpuspec.fit(
        taken(station), gpuspec.Station(**known), region="0,0,200,150", defects=False,
        backend="numpy", **options,
    )  # fmt: skip


def truth(station: gpuspec.Station) -> dict[str, float]:
    tunnel, sensor = station.tunnel, station.sensor
    found = {
        "period on the light": tunnel.period_mm,
        "step": 1 / station.sequence.images,
        "exposure": sensor.exposure,
        "saturation": sensor.saturation_e,
        "read noise": sensor.read_noise_e,
        "uneven gain": sensor.prnu,
    }
    if isinstance(tunnel.profile, str):
        found["leak"] = tunnel.dark_leak
    if tunnel.profile == "sinusoid":
        found["gamma"] = tunnel.profile_gamma
    if tunnel.is_striped:
        found |= {"duty": tunnel.luminous_mm / tunnel.period_mm, "pupil": station.camera.pupil_mm}
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("stripes", 3), ("sinusoid", 4), ("table", 5)])
def test_every_number_of_a_random_station_is_found_within_its_uncertainty(kind, seed):
    station = real(seed, kind)
    found = fitted(station)
    assert found.kind == kind
    off = {
        name: (found[name].value - value) / found[name].uncertainty
        for name, value in truth(station).items()
    }
    assert max(map(abs, off.values())) < ALL, off
    assert np.mean([abs(one) < MOST for one in off.values()]) > 0.6, off
    assert found.twin.level_dn == pytest.approx(found.real.level_dn, abs=LEVEL_DN)
    assert found.twin.noise_dn == pytest.approx(found.real.noise_dn, rel=NOISE)
    assert found.unknown


@pytest.mark.slow
@pytest.mark.parametrize("given", [True, False])
def test_of_stripes_that_saturate_the_pupil_is_taken_as_it_is_given_or_said_not_to_be_told(given):
    """Of an edge of the light only the foot is seen: exposure, width and pupil trade off."""
    station = gpuspec.Station(
        part={"length_mm": 20.0, "width_mm": 15.0}, tunnel={"luminous_mm": 2.0, "dark_mm": 6.0},
        camera={"sampling_mm": 0.1, "pupil_mm": 3.0}, sensor={"exposure": 4.0, "noise": True},
        sequence={"images": 40},
    )  # fmt: skip
    known = gpuspec.Station(camera={"sampling_mm": 0.1, **({"pupil_mm": 3.0} if given else {})})
    found = gpuspec.fit(taken(station), known, region="0,0,200,150", defects=False, backend="numpy")
    for name, value in (("exposure", 4.0), ("duty", 0.25), ("pupil", 3.0)):
        assert abs(found[name].value - value) <= ALL * found[name].uncertainty + 1e-4, name
    assert (found["exposure"].uncertainty < 0.04) == given
    assert any("pupil apart" in said for said in found.unknown) != given


@pytest.mark.slow
def test_the_command_writes_the_twin_its_numbers_and_the_smallest_defects(tmp_path, gpuspec_):
    station = real(4, "sinusoid").replace(sensor__exposure=0.9)
    shots = written(tmp_path / "shots", taken(station))
    arguments = (
        "fit", str(shots), "-o", str(tmp_path / "twin.toml"), "--set", "camera.sampling_mm=0.1",
        "--region", "0,0,200,150",
    )  # fmt: skip
    ran = gpuspec_(*arguments)
    assert ran.code == 0, ran.err
    told = json.loads((tmp_path / "twin.json").read_text("utf-8"))
    assert told["light"] == "sinusoid"
    unsaturated, saturated = told["smallest_defects"]
    assert not any(unsaturated["least_depth_um"]["dent"].values())
    assert all(saturated["least_depth_um"]["scratch"].values())
    twin = gpuspec.Station.read(tmp_path / "twin.toml")
    assert twin.tunnel.period_mm == pytest.approx(station.tunnel.period_mm, rel=0.01)
    assert (tmp_path / "twin.png").stat().st_size > 10_000
    assert "not told by these frames" in ran.out


def test_frames_that_are_no_whole_period_are_refused():
    frames = taken(real(4, "sinusoid"))
    with pytest.raises(FrameError, match="no whole period"):
        gpuspec.fit(frames[: len(frames) // 2], region="0,0,200,150")


def test_a_twin_is_written_to_a_station_file(tmp_path):
    from gpuspec.report.twin import outputs

    with pytest.raises(OutputError, match=r"NAME\.toml"):
        outputs(tmp_path / "twin")


@pytest.mark.slow
def test_of_saturated_stripes_through_a_pinhole_the_exposure_is_said_to_be_ill_told():
    """A quarter of a pixel of an edge is not saturated."""
    station = gpuspec.Station(
        part={"length_mm": 20.0, "width_mm": 15.0},
        tunnel={"luminous_mm": 3.4, "dark_mm": 6.6, "dark_leak": 0.03},
        camera={"sampling_mm": 0.1, "pupil_mm": 0.0}, sensor={"exposure": 4.0, "noise": True},
        sequence={"images": 16},
    )  # fmt: skip
    known = gpuspec.Station(camera={"sampling_mm": 0.1, "pupil_mm": 0.0})
    found = gpuspec.fit(taken(station), known, region="0,0,200,150", defects=False, backend="numpy")
    assert any("The exposure as well as" in said for said in found.unknown)
    assert any("Gain and read noise apart" in said for said in found.unknown)
    assert found["saturation"].uncertainty > 0.2 * found["saturation"].value
    assert found["pupil"].value == 0
