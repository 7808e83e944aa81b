"""Real frames are told of what makes them hard to inspect, and even ones are left alone."""

from __future__ import annotations

import numpy as np

import gpuspec
from gpuspec.captured.notes import unlit

X = np.arange(320) + np.zeros((200, 1))


def mirror(*, mount: bool = False, slope_dn: float = 0.0) -> np.ndarray:
    """Twelve saturated frames of a sinusoid, on a mirror in its mount or all over the frame."""
    turns = 2 * np.pi * np.arange(12) / 12
    light = np.stack([120 + 200 * np.cos(X / 9 + turn) for turn in turns]).clip(0, 255)
    light += slope_dn * X / 320 - slope_dn / 2
    if mount:
        light[:, :, 200:] = 8.0
    noise = np.random.default_rng(3).normal(0, 1, light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def said(frames: np.ndarray, **more: object) -> str:
    return " ".join(gpuspec.inspect(frames, gpuspec.Station(), **more).warnings)


def test_where_the_light_never_comes_is_said_unless_a_region_is_named():
    frames = mirror(mount=True)
    assert "over 38 % of the frame the light never passes" in said(frames)
    assert "never passes" not in said(frames, region="0,0,190,200")
    assert "never passes" not in said(mirror())
    assert unlit([np.zeros(9, np.uint8)] * 2) == ()  # two frames tell nothing


def test_a_slow_background_is_said_unless_it_is_taken_off():
    assert "take levels above a local background" in said(mirror(slope_dn=60)).lower()
    assert "local background" not in said(mirror())
    local = gpuspec.Station(segmentation={"background_mm": 2.0})
    found = gpuspec.inspect(mirror(slope_dn=60), local)
    assert "local background" not in " ".join(found.warnings)
