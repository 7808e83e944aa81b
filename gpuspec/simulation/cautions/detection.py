"""Whether what is detected can be trusted, and why not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gpuspec.arrays import Image, Mask
from gpuspec.detection.score import Score
from gpuspec.detection.segmentation import (
    CEILING_FLOOR,
    NOISE_SIGMAS,
    Ceiling,
    threshold_margins,
)
from gpuspec.light.light_map import LightMap
from gpuspec.simulation.cautions.station import DIFFERENCES, percent
from gpuspec.station.station import Station

if TYPE_CHECKING:  # it imports SciPy, of which a sweep has no use
    from gpuspec.detection.inspection import Inspection

BY_CHANCE = 0.1
"""Share of the flawless surface detected from which on defects are hit by chance."""
EVEN = 0.005  # share of full scale within which an image has no contrast


def of_detection(
    light_map: LightMap,
    aspect: Image,
    lit: Mask,
    valid: Mask,
    inspected: Inspection,
    scored: Score,
    *,
    basic: bool,
) -> list[str]:
    """Say why nothing, or everything, is detected.

    Parameters
    ----------
    light_map : LightMap
    aspect : ndarray of float32, shape (M, N)
        DN.
    lit, valid : ndarray of bool, shape (M, N)
        Pixels that see the light, and those on the part.
    inspected : Inspection
    scored : Score
    basic : bool
        Whether a more basic cause was said.
    """
    station, threshold = light_map.station, inspected.threshold
    full, automatic = station.sensor.full_scale_dn, station.segmentation.threshold == "auto"
    found = scored.hit_px + scored.false_px
    flawless = int(np.count_nonzero(valid)) - scored.zone_px
    if flawless and scored.false_px > BY_CHANCE * flawless:
        way = (
            " It is too uneven for any one threshold."
            if automatic
            else ' Raise segmentation.threshold, or set it to "auto".'
        )
        return [
            f"{percent(scored.false_px / flawless)} of the flawless surface is detected at the "
            f"threshold of {threshold:.4g} DN, so that defects are hit by chance: its median level "
            f"is {inspected.flawless_dn:.4g} DN.{'' if basic else way}"
        ]
    if basic:
        return []
    brightest = float(np.max(aspect, where=lit, initial=0.0))
    if brightest < full / 255:
        return [
            f"the image is dark: its brightest pixel has {brightest:.2g} DN of {full}. "
            f"{_why_dark(light_map, lit)}"
        ]
    beyond = automatic and threshold >= full
    if not beyond and (found or not scored.defects):
        return []
    from gpuspec.detection.inspection import levelled

    held = levelled(aspect, valid, station, lit)
    if beyond:
        return [why_beyond(station, held, lit, inspected)]
    nothing = "nothing is detected, so that P1 is 1 by definition and says nothing"
    above = int(np.count_nonzero((held > threshold) & valid))
    if above:
        return [
            f"{nothing}: all {above:,} pixels above the threshold are in blobs smaller than "
            f"segmentation.min_area_mm2 = {station.segmentation.min_area_mm2:g}."
        ]
    level, brightest = float(np.median(held[lit])), float(np.max(held, where=lit, initial=0.0))
    if brightest - level < EVEN * full:
        way = "The image is even: no defect stands out in it."
    elif not automatic:
        way = f'Set segmentation.threshold between {level:.4g} and {brightest:.4g}, or to "auto".'
    else:
        way = _why_high(station, held, lit, inspected)
    return [
        f"{nothing}: the threshold is {threshold:.4g} DN, the flawless level {level:.4g} DN and "
        f"the brightest pixel {brightest:.4g} DN. {way}"
    ]


def _why_dark(light_map: LightMap, lit: Mask) -> str:
    station = light_map.station
    fusion = station.sequence.fusion
    if fusion in (*DIFFERENCES, "min"):
        brightest = float(light_map.image(0)[lit].max())
        if brightest >= station.sensor.full_scale_dn / 255:
            if fusion == "min":
                return 'With sequence.fusion = "min" every pixel has its darkest: take "mean".'
            lag = " Check sequence.lag." if fusion == "differential" else ""
            return f'Its images are not, but "{fusion}" finds next to no difference.{lag}'
    way = "widen tunnel.luminous_mm" if light_map.pattern is None else "make the pattern brighter"
    return f"Raise sensor.exposure, or {way}."


def _why_high(station: Station, held: Image, lit: Mask, inspected: Inspection) -> str:
    """Say what keeps an automatic threshold above every defect, and what to change."""
    images, full = station.sequence.images, station.sensor.full_scale_dn
    if inspected.ceiling is not None:
        return _why_above(inspected.ceiling, inspected.flawless_dn, images, full)
    margins = threshold_margins(held, lit, full_scale_dn=full, images=images)
    if inspected.rule == "background":  # which leaves no room for one image
        margins = replace(margins, one_image_dn=0.0)
    always = max(margins.uneven_dn, margins.floor_dn)  # however many images there are
    if margins.one_image_dn >= always:
        if float(held[lit].max()) > margins.flawless_dn + always:
            return (
                f"It leaves room for one image of {images}, {full / images:.3g} DN: take more "
                f"sequence.images."
            )
    elif margins.uneven_dn >= always:
        return (
            f"It leaves room for an uneven flawless level, of which the spread (robust sigma) is "
            f"{always / 7:.2g} DN: take more images, over whole periods."
        )
    return "Only deeper defects would stand out, or another light."


def _why_above(ceiling: Ceiling, flawless_dn: float, images: int, full: int) -> str:
    """Say what lifts a ceiling, and the threshold above it: noise, or the ripple of few images."""
    noise, ripple = NOISE_SIGMAS * ceiling.noise_dn, ceiling.level_dn - flawless_dn
    if max(noise, ripple) < CEILING_FLOOR * full:
        return "Only deeper defects would stand out, or another light."
    if noise > ripple:
        return (
            f"It leaves room for noise, of a standard deviation of {ceiling.noise_dn:.2g} DN: take "
            f"more sequence.images."
        )
    return (
        f"A flawless pixel can have {ceiling.level_dn:.4g} DN, for the mean of {images} images "
        f"ripples or the part is uneven: take more sequence.images."
    )


def why_beyond(station: Station, held: Image, lit: Mask, inspected: Inspection) -> str:
    """Say why the automatic threshold is beyond full scale: which of its terms put it there.

    Parameters
    ----------
    station : Station
    held : ndarray of float32, shape (M, N)
        Levels that a threshold is held against, DN.
    lit : ndarray of bool, shape (M, N)
        Pixels that see the light.
    inspected : Inspection
        With that threshold.
    """
    full, images, threshold = (
        station.sensor.full_scale_dn, station.sequence.images, inspected.threshold
    )  # fmt: skip
    margins = threshold_margins(held, lit, full_scale_dn=full, images=images)
    room = full - margins.flawless_dn
    head = f"the automatic threshold, {threshold:.0f} DN, is beyond full scale and detects nothing"
    if margins.floor_dn >= room:
        way = (
            'With sequence.fusion = "max" every pixel has its brightest image: take "mean".'
            if station.sequence.fusion == "max"
            else "Lower sensor.exposure, or make the light darker."
        )
        return (
            f"{head}: the flawless level, {margins.flawless_dn:.1f} DN, is itself at full scale, "
            f"{full} DN, and leaves no room above it. {way}"
        )
    if inspected.ceiling is not None:
        level, noise = inspected.ceiling.level_dn, inspected.ceiling.noise_dn
        if NOISE_SIGMAS * noise > full - level > CEILING_FLOOR * full:
            return (
                f"{head}: it leaves room for noise above the {level:.0f} DN of {full} that a "
                f"flawless pixel can have, of a standard deviation of {noise:.2g} DN. Take more "
                f"sequence.images, or a larger sensor.saturation_e."
            )
        return (
            f"{head}: by where the stripes stand in {images} image{'s' if images > 1 else ''} a "
            f"flawless pixel can have {level:.0f} DN of {full}, and half of them have no more than "
            f"{margins.flawless_dn:.0f}. Take more images, over whole periods, or a lower "
            f"sensor.exposure."
        )
    if margins.uneven_dn >= room:
        return (
            f"{head}: the flawless level is too uneven over the part, {margins.flawless_dn:.0f} DN "
            f"with a spread (robust sigma) of {margins.uneven_dn / 7:.0f} DN. Take more images, "
            f"over whole periods, or state segmentation.threshold."
        )
    return (
        f"{head}: of {images} image{'s' if images > 1 else ''} one more makes a flawless pixel "
        f"brighter by {full / images:.0f} DN, and its level is {margins.flawless_dn:.0f} DN "
        f"already. Take more images, or a lower sensor.exposure."
    )
