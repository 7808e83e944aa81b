"""Device functions of a footprint: of a pixel's square, and of the spot that a lens makes of it."""

from __future__ import annotations

import numpy as np
import tolerances
from device import Device
from laws import REFLECTION, Draws, close, holds, rounded, stacked

GRADIENT = "Gradient d; d.x = x; d.y = y; d.turn_x = turn_x; d.turn_y = turn_y;"
WIDTHS = ("w.wide", "w.narrow")


def draws(d: Draws) -> dict[str, np.ndarray]:
    """Gradients of the light coordinate, and shares of the way to the part."""
    inputs = {f"REAL {name}": d.pixel(-2, 2) for name in ("x", "y", "turn_x", "turn_y")}
    return inputs | {"REAL share": d.pixel(0.9, 1.1)}


@holds("spot_offset", wrong=("g.warp * t * t", "g.warp * t"))
def test_sub_rays_are_spread_by_an_odd_cubic(device: Device) -> None:
    d = Draws(3)
    inputs = {"REAL x": d.pixel(0, 1), "float t": d.rng.uniform(-0.5, 0.5, d.groups)}
    inputs["float t"] = rounded(inputs["float t"])
    code = "Geometry g; g.widening = 0.25f; g.warp = 1.5f; REAL r = spot_offset(g, t) + 0.0f * x;"
    (got,) = device.call(REFLECTION, code, inputs, ("r",))
    t = inputs["float t"][:, None] + np.zeros(got.shape)
    close(got, 0.25 * t + 1.5 * t**3, tolerances.SPOT_LAW)


@holds("footprint_under", wrong=("0.8660254f * g.pupil", "0.5f * g.pupil"))
def test_square_pupil_and_roughness_add_their_variances(device: Device) -> None:
    d = Draws(4)
    inputs = draws(d) | {"REAL path": d.pixel(50, 300), "REAL size": d.pixel(1, 1.2)}
    code = (
        GRADIENT
        + """ Geometry g; g.sampling = 0.1f; g.subsampling = 2.0f; g.pupil = 6.0f;
        g.camera_height = 500.0f; g.roughness = 0.002f; g.blur = 0.0f; g.focus = 0.0f;
        CameraRay c; c.share = share; Mirror m; m.ray = vector(0.0f * x, 0.0f * x, size);
        Hit hit; hit.path = path; Footprint w = footprint_under(g, d, c, m, hit);"""
    )
    wide, narrow = stacked(device.call(REFLECTION, code, inputs, WIDTHS))
    x, y, k = (inputs[f"REAL {name}"] for name in ("x", "y", "share"))
    t, r = inputs["REAL path"], inputs["REAL size"]
    square = 0.05**2 * (x**2 + y**2) / 12
    disc = (6 * t / (2 * k * 500)) ** 2 / 4  # a disc seen edge-on
    bell = (2 * 0.002 * t * r) ** 2
    close((wide**2 + narrow**2) / 12, square + disc + bell, rtol=tolerances.SPOT_LAW)


@holds("defocused_square", wrong=("inverse * d.turn_y", "d.turn_y"))
def test_off_focus_the_pupils_edge_says_how_wide_its_disc_is(device: Device) -> None:
    d = Draws(5)
    inputs = draws(d)
    code = (
        GRADIENT
        + """ Geometry g; g.pupil = 4.0f; g.camera_height = 500.0f; g.focus = 650.0f;
        REAL r = defocused_square(g, d, share);"""
    )
    (got,) = device.call(REFLECTION, code, inputs, ("r",))
    x, y, u, v, k = (inputs[f"REAL {name}"] for name in ("x", "y", "turn_x", "turn_y", "share"))
    furthest = np.zeros(x.shape)
    for angle in np.linspace(0, 2 * np.pi, 2880, endpoint=False):
        a, b = 2 * np.cos(angle), 2 * np.sin(angle)
        # The ray from (a, b) passes z = 0 at (a, b) (1 - h/F), and S beside the centre's ray.
        moved = (1 / k - 500 / 650) * (a * x + b * y) - (a * u + b * v) / k
        furthest = np.maximum(furthest, moved)
    close(got, 3 * furthest**2, tolerances.SPOT_LAW, rtol=tolerances.SPOT_DISC)


@holds("spot_square", wrong=("d.y * d.y) + disc", "d.y * d.y)"))
def test_what_a_spot_sees_is_of_pixel_lens_and_disc(device: Device) -> None:
    d = Draws(7)
    inputs = draws(d) | {"REAL disc": d.pixel(0, 4)}
    code = (
        GRADIENT
        + " Geometry g; g.sampling = 0.3f; g.blur = 0.2f; REAL r = spot_square(g, d, disc);"
    )
    (got,) = device.call(REFLECTION, code, inputs, ("r",))
    slope = inputs["REAL x"] ** 2 + inputs["REAL y"] ** 2
    close(got / 12, (0.3**2 / 12 + 0.2**2) * slope + inputs["REAL disc"] / 12, tolerances.SPOT_LAW)


@holds("lean_of", wrong=("one - g.least_lean", "one"))
def test_a_place_turns_rays_by_all_that_it_tells_where_the_spot_is_all_there_is(
    device: Device,
) -> None:
    """Of little that the spot tells by the least, and by as much more as it tells."""
    d = Draws(8)
    inputs = draws(d) | {"REAL square": d.pixel(0.1, 4)}
    code = (
        GRADIENT
        + """ Geometry g; g.spot = 0.6f; g.lean = -3.0f; g.least_lean = 0.2f;
        REAL r = lean_of(g, d, share, square);"""
    )
    (got,) = device.call(REFLECTION, code, inputs, ("r",))
    told = 0.36 * (inputs["REAL x"] ** 2 + inputs["REAL y"] ** 2) / inputs["REAL square"]
    assert (told < 0.1).any() and (told > 1).any()
    share = 0.2 + 0.8 * np.minimum(told, 1)
    close(got * inputs["REAL share"], -3 * share, tolerances.SPOT_LAW)


@holds("spot_footprint", wrong=("part * y, max", "part * x, max"))
def test_a_spot_has_the_variance_of_pixel_blur_and_disc(device: Device) -> None:
    d = Draws(6)
    inputs = draws(d) | {"REAL disc": d.pixel(0, 4), "REAL gauss": d.pixel(0, 4)}
    for side in (1, 4):
        code = (
            GRADIENT
            + f""" Geometry g; g.sampling = 0.3f; g.subsampling = {side}.0f;
            g.focus = 0.0f; g.blur = 0.2f; g.spot = 0.6f; g.lean = 0.0f; g.least_lean = 0.0f;
            g.pupil = 0.0f; g.camera_height = 500.0f;
            Footprint w = spot_footprint(g, d, share, disc, gauss);"""
        )
        wide, narrow = stacked(device.call(REFLECTION, code, inputs, WIDTHS))
        x, y = inputs["REAL x"], inputs["REAL y"]
        slope = x**2 + y**2
        whole = (0.3**2 + 12 * 0.2**2) * slope + inputs["REAL disc"] + inputs["REAL gauss"]
        # Sub-rays have what lies between them already: all of the square of the spot but their own.
        between = (1 - 1 / side**2) * 0.6**2 * slope if side > 1 else 0
        close(wide**2 + narrow**2 + between, whole, rtol=tolerances.SPOT_LAW)
