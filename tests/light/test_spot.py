"""Where a pixel looks at a spot: a lens's blur, a plane in focus that is not the part."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import pytest
import tolerances
from scenes import check_station, oracle_scene
from scipy.ndimage import gaussian_filter, uniform_filter

from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.part.truth import ZONE
from gpuspec.station.optics import spread
from gpuspec.station.station import Station

SPOTS: dict[str, dict[str, Any]] = {
    "blur of half a pixel": {"camera.blur_mm": 0.05},
    "focused behind the part": {"camera.focus_mm": 900.0},
    "focused before it, and blurred": {
        "camera.focus_mm": 760.0, "camera.blur_mm": 0.05, "camera.pupil_mm": 6.0,
    },
}  # fmt: skip


def small(**changes: Any) -> Station:
    return check_station(camera__rows=14, camera__columns=20, **changes)


@pytest.mark.parametrize("name", SPOTS)
@pytest.mark.parametrize(("sigma", "depth"), [(0.25, 0.010), (0.1, 0.002)])
def test_an_image_is_near_that_of_many_rays(name: str, sigma: float, depth: float) -> None:
    station = small(sigma=sigma, depth=depth, **SPOTS[name])
    truth = oracle.aspect_image(oracle_scene(station), rays=1024)
    found = open_backend("opencl").trace(station).aspect()
    assert np.sqrt(np.mean((found - truth) ** 2)) < tolerances.SPOT_RMS_DN
    assert np.abs(found - truth).max() < tolerances.SPOT_MAX_DN
    sharp = station.replace(camera__focus_mm=None, camera__blur_mm=0.0)
    assert np.abs(open_backend("opencl").trace(sharp).aspect() - truth).max() > 25


@pytest.mark.parametrize("focus_mm", [790.0, 810.0])
@pytest.mark.parametrize(("sigma", "depth"), [(0.25, 0.010), (0.1, 0.002), (0.6, 0.010)])
def test_a_little_off_focus_an_image_is_nearer(sigma: float, depth: float, focus_mm: float) -> None:
    """A place of the part tells little of the pupil's point: nearly all of it looks there."""
    station = small(sigma=sigma, depth=depth, camera__focus_mm=focus_mm, camera__pupil_mm=8.0)
    truth = oracle.aspect_image(oracle_scene(station), rays=1024)
    found = open_backend("opencl").trace(station).aspect()
    assert np.sqrt(np.mean((found - truth) ** 2)) < tolerances.SPOT_NEARER_RMS_DN


@pytest.mark.parametrize("subsampling", [2, 8])
@pytest.mark.parametrize(
    ("height_mm", "focus_mm", "pupil_mm"), [(506, 502, 8), (413, 408.5, 8), (600, 605, 5)]
)
def test_of_a_flat_part_sub_rays_see_what_one_footprint_does(
    height_mm: float, focus_mm: float, pupil_mm: float, subsampling: int
) -> None:
    flat = small(
        defects=[], camera__height_mm=height_mm, camera__focus_mm=focus_mm,
        camera__pupil_mm=pupil_mm, sequence__images=8,
    )  # fmt: skip
    one, many = (
        open_backend("opencl").trace(flat.replace(camera__subsampling=n)).aspect()
        for n in (1, subsampling)
    )
    assert np.abs(many - one).max() < tolerances.SPOT_FLAT_DN


@pytest.mark.parametrize("name", SPOTS)
def test_the_flawless_level_is_that_of_many_rays(name: str) -> None:
    station = check_station(camera__rows=3, defects=[], **SPOTS[name])
    truth = oracle.aspect_image(oracle_scene(station), rays=4096)
    found = open_backend("opencl").trace(station).aspect()
    assert np.median(found) == pytest.approx(np.median(truth), abs=tolerances.SPOT_LEVEL_DN)
    sharp = station.replace(camera__focus_mm=None, camera__blur_mm=0.0)
    by = np.abs(open_backend("opencl").trace(sharp).aspect() - found)
    assert by.max() > 2 * tolerances.SPOT_LEVEL_DN


@pytest.mark.parametrize("subsampling", [1, 4])
@pytest.mark.parametrize("name", SPOTS)
def test_every_device_sees_what_float64_sees(
    device_backend: Backend, name: str, subsampling: int
) -> None:
    station = small(
        camera__subsampling=subsampling, part__surface="height", part__crown_radius_x_mm=300.0,
        part__crown_radius_y_mm=-200.0, **SPOTS[name],
    )  # fmt: skip
    expected = open_backend("numpy").trace(station).read()
    found = device_backend.trace(station).read()
    for plane in ("light_mm", "footprint_mm"):
        gap = np.abs(getattr(found, plane) - getattr(expected, plane))
        assert gap.max() < tolerances.SPOT_PLANE_MM, plane
    images = (open_backend("numpy").trace(station).aspect(), device_backend.trace(station).aspect())
    assert np.abs(images[0] - images[1]).max() < tolerances.SPOT_PLANE_DN


def test_sub_rays_have_the_variance_of_one_footprint() -> None:
    for name, changes in SPOTS.items():
        flat = small(defects=[], camera__subsampling=1, **changes)
        one = open_backend("numpy").trace(flat).read()
        many = open_backend("numpy").trace(flat.replace(camera__subsampling=8)).read()
        whole = (one.wide_mm**2 + one.narrow_mm**2)[0] / 12
        own = ((many.wide_mm**2 + many.narrow_mm**2) / 12).mean(axis=0)
        between = many.light_mm.var(axis=0)
        assert own + between == pytest.approx(whole, rel=tolerances.SUB_RAY_VARIANCE), name


def test_focused_on_the_lights_image_the_pupil_sees_a_point_of_it() -> None:
    flat = small(defects=[], camera__pupil_mm=8.0, camera__subsampling=1)
    mirrored = flat.replace(camera__focus_mm=flat.camera.height_mm + flat.tunnel.height_mm)
    pinhole = flat.replace(camera__pupil_mm=0.0)
    light = [open_backend("numpy").trace(s).read() for s in (flat, mirrored, pinhole)]
    sharp, plain = light[1].footprint_mm, light[2].footprint_mm
    assert sharp == pytest.approx(plain, rel=1e-5)
    assert (light[0].footprint_mm > 5 * plain).all()


def test_focused_on_a_flat_part_is_in_focus() -> None:
    flat = small(defects=[], camera__subsampling=1)
    there = flat.replace(camera__focus_mm=flat.camera.height_mm)
    a, b = (open_backend("numpy").trace(s).read() for s in (flat, there))
    np.testing.assert_allclose(a.footprint_mm, b.footprint_mm, rtol=1e-9)


def test_a_pinhole_is_sharp_wherever_it_is_focused(backend: Backend) -> None:
    station = small(camera__pupil_mm=0.0)
    there = station.replace(camera__focus_mm=500.0)
    assert np.array_equal(backend.trace(station).aspect(), backend.trace(there).aspect())


@pytest.mark.parametrize("excess", [-1.2, -0.6, 0.0])
@pytest.mark.parametrize("n", [2, 4, 8, 16])
def test_points_and_their_boxes_have_one_variance(excess: float, n: int) -> None:
    t = (np.arange(n) + 0.5) / n - 0.5
    first, third = spread(excess, n)
    x = first * t + third * t**3
    assert x.var() + 1 / 12 / n**2 == pytest.approx(1 / 12, rel=1e-9)
    assert (np.diff(x) > 0).all()
    if n > 4:  # towards the middle, as the bell's quantiles do
        assert np.mean(x**4) / x.var() ** 2 == pytest.approx(
            {-1.2: 1.8, -0.6: 2.1, 0: 2.3}[excess], abs=0.15
        )


BLURS = {0.25: 0.4, 0.5: 0.4, 1.0: 0.5, 2.0: 0.8}
"""Standard deviation of a blur in pixels, and the largest rms error beside it, grey levels: 0.28,
0.26, 0.34 and 0.61 measured."""


@pytest.mark.parametrize("blur", BLURS)
@pytest.mark.parametrize(("diameter", "depth"), [(0.4, 0.5), (1.0, 2.0), (2.0, 2.0)])
def test_a_blurred_image_is_that_of_fine_pixels_blurred_one_by_one(
    opencl: Backend, blur: float, diameter: float, depth: float
) -> None:
    """Each image of a pinhole's fine pixels, before it saturates; no footprint is asked."""
    fine, exposure, images = 9, 4.0, 80
    dent = {"kind": "dent", "x_mm": 0.03, "y_mm": 0.02, "diameter_mm": diameter, "depth_um": depth}
    station = Station.from_dict(
        {
            "part": {"length_mm": 16.0, "width_mm": 9.0},
            "tunnel": {"height_mm": 150.0, "luminous_mm": 2.0, "dark_mm": 6.0},
            "camera": {"sampling_mm": 0.1, "columns": 60, "rows": 50, "pupil_mm": 0.0},
            "sequence": {"images": images},
            "defects": [dent],
        }
    )
    sharp = opencl.trace(
        station.replace(
            camera__sampling_mm=0.1 / fine, camera__columns=60 * fine, camera__rows=50 * fine,
            camera__subsampling=1, sensor__exposure=1.0,
        )
    )  # fmt: skip
    expected = np.zeros((50, 60))
    for k in range(images):
        seen = gaussian_filter(sharp.image(k).astype(np.float64), blur * fine, truncate=5)
        seen = uniform_filter(seen, fine)[fine // 2 :: fine, fine // 2 :: fine]
        expected += np.minimum(exposure * seen, 255) / images
    found = opencl.trace(station.replace(camera__blur_mm=0.1 * blur, sensor__exposure=exposure))
    inner = np.s_[8:-8, 8:-8]  # beyond the image the filters see none
    gap = (found.aspect() - expected)[inner]
    assert np.sqrt((gap**2).mean()) < BLURS[blur]
    assert np.abs(gap).max() < 3  # 2.6 measured


def test_a_wide_spot_reaches_the_grooves_of_other_blocks() -> None:
    """A pixel beside a defect sees it through its blur, on whichever side of a block it is."""
    assert ZONE == 2
    station = Station.from_dict(
        {
            "part": {"length_mm": 6.4, "width_mm": 6.4},
            "camera": {"blur_mm": 0.4, "sampling_mm": 0.1, "subsampling": 4},
            "sequence": {"images": 8},
            "defects": [
                {"kind": "dent", "x_mm": 0.02, "y_mm": 0.05, "diameter_mm": 0.2, "depth_um": 2.0}
            ],
        }
    )
    a, b = (open_backend(name).trace(station).aspect() for name in ("opencl", "numpy"))
    assert np.abs(a - b).max() < tolerances.SPOT_PLANE_DN
