"""What a user should know before trusting a score: what, why, and which key to change.

What the images can tell is read off them; the rest are laws of the model that a station breaks. A
wrong diagnosis is worse than none: each is said only where it is true.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image, LabelImage, Mask
from gpuspec.detection.score import Score
from gpuspec.detection.segmentation import threshold_margins
from gpuspec.light.float64 import fresnel_reflectance, ray_paths
from gpuspec.light.light_map import LightMap
from gpuspec.part.grooves import Grooves
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect, Truth
from gpuspec.station.materials import MATERIALS
from gpuspec.station.station import Station

LOST_SHARE = 0.01
"""Share of the part without light from which on it is said."""
BY_CHANCE = 0.1
"""Share of the flawless surface detected from which on defects are hit by chance."""
SAME_SHIFT = 0.01
"""Share of a period within which all shifts lie when the images are as good as equal."""
FEW_SHIFTS = 8
"""Distinct shifts of the stripes below which it is said, if they are less than half the images."""
TWICE = math.tan(math.pi / 6)
"""Slope of the sides of a groove in which light is reflected a second time."""

_DOWN, _PAST, _OPENING = 2, 3, 4
_GRID = 33  # points along each side of the part, for rays to the tunnel's end
_EVEN = 0.005  # share of full scale within which an image has no contrast
_EQUAL = 1e-6  # of a period, between equal shifts
_DIFFERENCES = "std", "differential"  # fusions that are zero where the images do not differ
_SHOWN = 5


def cautions(
    station: Station,
    relief: Relief,
    truth: Truth,
    lost: NDArray[np.uint8],
    light_map: LightMap,
    aspect: Image,
    labels: LabelImage,
    threshold: float,
    scored: Score,
) -> tuple[str, ...]:
    """Return what is to be known of one simulated inspection.

    Parameters
    ----------
    station : Station
    relief, truth : Relief, Truth
        Of the station.
    lost : ndarray of uint8, shape (M, N)
        Index into ``backends.LOST``.
    light_map : LightMap
        From which the aspect image is; its pattern, if it has one, is the light.
    aspect : ndarray of float32, shape (M, N)
        DN.
    labels : ndarray of int32, shape (M, N)
        Blobs.
    threshold : float
        DN.
    scored : Score

    Returns
    -------
    tuple of str
        A note each, of one or two sentences; most basic first.
    """
    lit = lost == 0
    said = [*unstated(station), *without_effect(station), *relief.remarks]
    said += of_light(station, lost, truth)
    if light_map.pattern is None:
        said += of_stripes(station)
        basic = bool(_of_shifts(station))
    else:
        under = _of_pattern(light_map, lit, aspect)
        said += under
        basic = bool(under)
    said += _of_view(station)
    said += _of_defects(station, relief, truth, scored, lost)
    if lit.any():
        valid = lost != BESIDE
        said += _of_detection(light_map, aspect, lit, valid, threshold, scored, basic=basic)
    return tuple(said)


def of_station(station: Station) -> list[str]:
    """Return what the station tells without an image: keys, stripes, shifts, opening."""
    return [*unstated(station), *without_effect(station), *of_design(station)]


def of_design(station: Station) -> list[str]:
    """Return what is wrong with a design whatever its part: stripes, shifts, opening."""
    return [*of_stripes(station), *_of_view(station)]


def assumptions(station: Station) -> tuple[str, ...]:
    """Return what the station leaves to an ideal that no real one has."""
    if station.tunnel.opening_length_mm:
        return ()
    return (
        "the camera looks through the tunnel's top as if it were not there; "
        "tunnel.opening_length_mm and tunnel.opening_width_mm cut an opening into it, which the "
        "part then reflects as a blind zone.",
    )


# ------------------------------------------------------------------------------------- the file


def unstated(station: Station) -> list[str]:
    """Say so where a station is all defaults: an empty file."""
    fields = {name: field for name, field in type(station).model_fields.items() if name != "sweep"}
    if any(getattr(station, name) != field.default for name, field in fields.items()):
        return []
    return [
        f"every value of {station.file} is a default, and the part has no defects; `gpuspec init` "
        f"writes a station to start from."
    ]


def ineffective(station: Station) -> dict[str, str]:
    """Return the keys that change nothing in this station, each with the reason."""
    tunnel, sensor = station.tunnel, station.sensor
    found = {}
    section = f'with tunnel.section = "{tunnel.section}"'
    if tunnel.section != "arch":
        found["tunnel.radius_mm"] = f"{section}: it is that of an arch"
    if tunnel.section != "box":
        found["tunnel.width_mm"] = f"{section}: it is that of a box"
    if tunnel.section == "arch":
        found["tunnel.height_mm"] = f"{section}: an arch has tunnel.radius_mm"
    if station.sequence.fusion != "differential":
        found["sequence.lag"] = (
            f'with sequence.fusion = "{station.sequence.fusion}": it is for "differential"'
        )
    if not sensor.noise:
        for name in ("saturation_e", "read_noise_e", "dark_e", "prnu", "dsnu_e",
                     "black_level_dn", "seed"):  # fmt: skip
            found[f"sensor.{name}"] = "without noise: sensor.noise = true turns it on"
    return found


def without_effect(station: Station) -> list[str]:
    """Name the keys that are set to something and change nothing, those of one reason together."""
    together: dict[str, list[str]] = {}
    for key, why in ineffective(station).items():
        section, name = key.split(".")
        table = getattr(station, section)
        value = getattr(table, name)
        if value != type(table).model_fields[name].default:
            together.setdefault(why, []).append(f"{key} = {value:g}")
    return [
        f"{_listed(keys)} {'has' if len(keys) == 1 else 'have'} no effect {why}."
        for why, keys in together.items()
    ]


def _listed(words: Sequence[str]) -> str:
    shown = [*words[:_SHOWN], *([f"{len(words) - _SHOWN} more"] if len(words) > _SHOWN else [])]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


# ---------------------------------------------------------------------------------- the light


def of_stripes(station: Station) -> list[str]:
    """Say where stripes, shifts and exposure cannot give an aspect image."""
    period, images, step = station.tunnel.period_mm, station.sequence.images, station.step_mm
    said = _of_shifts(station)
    if not said and station.distinct_shifts is None:
        said.append(
            f"the {images} images cover {images * step / period:.6g} periods of the stripes: the "
            f"flawless level is even only over whole periods. Leave sequence.step_mm out, or "
            f"choose images and step so that they fill whole ones."
        )
    said += _unsaturated(station)
    return said


def _of_shifts(station: Station) -> list[str]:
    """Say where there is no sequence: one image, or images that are the same."""
    period, images, step = station.tunnel.period_mm, station.sequence.images, station.step_mm
    if images == 1:
        shows = (
            f'the "{station.sequence.fusion}" of one image is black'
            if station.sequence.fusion in _DIFFERENCES
            else "one image shows the stripes themselves and their edges count as defects"
        )
        return [
            f"sequence.images = 1: {shows}; an aspect image takes a sequence over a whole period."
        ]
    way = f"Leave sequence.step_mm out, and the step is {period / images:.3g} mm."
    if abs(step / period - round(step / period)) * (images - 1) < SAME_SHIFT:
        whole = round(step / period)
        by = "a whole period" if whole == 1 else f"{whole} whole periods"
        why = f"{by if whole else 'next to nothing'}; their period is {period:g} mm"
        return [
            f"all {images} images are the same: sequence.step_mm = {step:g} moves the stripes by "
            f"{why}. {way}"
        ]
    shifts = np.round(np.arange(images) * step / period / _EQUAL) % round(1 / _EQUAL)
    differ = len(np.unique(shifts))
    if differ < min(FEW_SHIFTS, images / 2):
        return [
            f"only {differ} of {images} images differ: sequence.step_mm = {step:g} brings the "
            f"stripes, of a period of {period:g} mm, back to where they were after {differ}. {way}"
        ]
    return []


def _unsaturated(station: Station) -> list[str]:
    material, exposure = station.part.material, station.sensor.exposure
    reflected = _reflected(material)
    if exposure * reflected > 1 or station.sequence.fusion != "mean":
        return []
    dull = f", of which {material} reflects {reflected:.0%}," if reflected < 1 else ""
    return [
        f"sensor.exposure = {exposure:g}{dull} does not saturate the sensor: the mean over a whole "
        f"period then has no contrast. Take {2 / reflected:.2g} to {4 / reflected:.2g}."
    ]


@cache
def _reflected(material: str) -> float:
    return float(fresnel_reflectance(np.ones(1), *MATERIALS[material])[0])


def _of_pattern(light_map: LightMap, lit: Mask, aspect: Image) -> list[str]:
    """Say where a user's pattern cannot show anything."""
    station, pattern = light_map.station, light_map.pattern
    assert pattern is not None
    images, full = station.sequence.images, station.sensor.full_scale_dn
    if not lit.any():
        return []
    said = []
    if images > 1 and not station.sensor.noise:
        first = light_map.image(0)[lit]
        others = {1, images // 2, images - 1} - {0}
        if all(np.abs(light_map.image(k)[lit] - first).max() < 1e-3 * full for k in others):
            moved = "k" if pattern.kind == "picture" else "shift"
            said.append(
                f"all {images} images are the same: {pattern.file} does not change with its "
                f"`{moved}`, or comes round to the same within each step."
            )
    levels = aspect[lit]
    if float(levels.max()) - float(levels.min()) < _EVEN * full:
        said.append(
            f"the aspect image is even, {levels.mean():.1f} DN everywhere: under {pattern.file} "
            f"nothing stands out."
        )
    return said


def of_light(station: Station, lost: NDArray[np.uint8], truth: Truth | None = None) -> list[str]:
    """Say how much of the part sees no light, and why.

    Parameters
    ----------
    station : Station
    lost : ndarray of uint8, shape (M, N)
        Index into ``backends.LOST``.
    truth : Truth, optional
        To say how many defects are wholly dark.
    """
    part = lost.size - np.count_nonzero(lost == BESIDE)
    if not part:
        return []
    counts = {reason: np.count_nonzero(lost == reason) for reason in (_PAST, _DOWN, _OPENING)}
    dark = sum(counts.values())
    said = []
    for reason, count in counts.items():
        if count < LOST_SHARE * part:
            continue
        seen = "no pixel of the part sees any light" if count == part else (
            f"{_percent(count / part)} of the part sees no light"
        )  # fmt: skip
        said.append(f"{seen}: {_why_lost(station, reason)}")
    if said and truth is not None and dark < part:
        hidden = _hidden(truth, lost)
        if hidden:
            said[-1] += f" {hidden} of {len(truth.defects)} defects lie in the dark."
    if dark == part and not said:
        said.append("no pixel of the part sees any light; lost.png shows why.")
    return said


def _why_lost(station: Station, reason: int) -> str:
    part, tunnel = station.part, station.tunnel
    if reason == _OPENING:
        size = tunnel.opening_length_mm, tunnel.opening_width_mm
        view = _view_mm(station)
        way = (
            f"make it smaller, the camera's own view needs {view[0]:.3g} x {view[1]:.3g} mm"
            if size[0] > view[0] and size[1] > view[1]
            else "a tunnel whose top is nearer to the camera needs a smaller one"
        )
        return f"it reflects the camera opening of {size[0]:g} x {size[1]:g} mm; {way}."
    crown = [f"part.crown_radius_{axis}_mm" for axis in "xy"
             if getattr(part, f"crown_radius_{axis}_mm")]  # fmt: skip
    relief = "part.relief" if part.relief else "the defects' depth_um"
    if reason == _DOWN:
        return (
            f"it is tilted by more than 45 degrees there and reflects the camera's rays down; "
            f"check {_listed([*crown, relief])}."
        )
    needed = _length_needed_mm(station)
    said = f"its rays pass the tunnel's end, tunnel.length_mm = {tunnel.length_mm:g}; "
    if needed is None:
        return said + f"no length catches them all, so tilt them less with {_listed(crown)}."
    if needed <= tunnel.length_mm:
        return said + f"what tilts them so far is the relief: check {relief}."
    return said + f"{needed:g} or more catches those of the flawless part."


def _length_needed_mm(station: Station) -> float | None:
    """Return the tunnel's length that every ray of the flawless part meets; None: none does."""
    part, p, (rows, columns) = station.part, station.camera.sampling_mm, station.shape
    bare = station.model_copy(
        update={
            "part": part.model_copy(update={"relief": None}),
            "tunnel": station.tunnel.model_copy(
                update={"length_mm": 1e9, "opening_length_mm": 0.0}
            ),
        }
    )
    half = min(part.length_mm, columns * p) / 2, min(part.width_mm, rows * p) / 2
    x, y = (np.linspace(-h, h, _GRID) * (1 - 1e-9) for h in half)
    paths = ray_paths(bare, Relief((), Grooves.of(()), ()), x[None, :], y[:, None])
    if (paths.lost == _DOWN).any():
        return None
    seen = np.abs(paths.light[..., 0][paths.lost == 0])
    needed = _three_digits_up(2 * float(seen.max(initial=0.0)) * (1 + 1e-6))
    return needed if needed <= 1e5 else None  # the most that tunnel.length_mm takes


def _three_digits_up(value: float) -> float:
    if value <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.ceil(value / step) * step:.6g}")


def _hidden(truth: Truth, lost: NDArray[np.uint8]) -> int:
    """Return how many defects have pixels on the part and all of them dark."""
    size = len(truth.defects) + 1
    there = np.bincount(truth.labels[lost != BESIDE], minlength=size)[1:]
    lit = np.bincount(truth.labels[lost == 0], minlength=size)[1:]
    return int(np.count_nonzero((there > 0) & (lit == 0)))


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %" if share < 0.999 else "nearly all"


def _view_mm(station: Station) -> tuple[float, float]:
    """Return the camera's view of the part where it passes the tunnel's top."""
    share = 1 - station.tunnel.top_mm / station.camera.height_mm
    return share * station.part.length_mm, share * station.part.width_mm


def _of_view(station: Station) -> list[str]:
    tunnel = station.tunnel
    if not tunnel.opening_length_mm:
        return []
    view = _view_mm(station)
    if tunnel.opening_length_mm >= view[0] and tunnel.opening_width_mm >= view[1]:
        return []
    return [
        f"the camera opening of {tunnel.opening_length_mm:g} x {tunnel.opening_width_mm:g} mm is "
        f"smaller than the camera's view through the tunnel's top, {view[0]:.3g} x {view[1]:.3g} "
        f"mm; the tunnel is taken as transparent to the camera itself."
    ]


# -------------------------------------------------------------------------------- the defects


def _of_defects(
    station: Station, relief: Relief, truth: Truth, scored: Score, lost: NDArray[np.uint8]
) -> list[str]:
    said = []
    least = station.segmentation.min_area_mm2
    sizes = [_zone_area(defect) for defect in truth.defects] if least else []
    if sizes and least > min(sizes):
        small = sum(size < least for size in sizes)
        said.append(
            f"segmentation.min_area_mm2 = {least:g} may swallow {small} of {len(sizes)} defects: "
            f"the smallest zone has {min(sizes):.2g} mm2."
        )
    if scored.unseen:
        said.append(_unseen(scored.unseen, scored.defects))
    grooves = relief.grooves
    slope = np.abs(grooves.depth) / grooves.sigma / math.sqrt(math.e)
    steep = len(np.unique(grooves.owner[slope > TWICE]))
    if steep:
        said.append(
            f"{steep} of {len(relief.defects)} defects have slopes steeper than 30 degrees, up to "
            f"{slope.max():.2g}: light is reflected again in them, and the model follows it once. "
            f"Check depth_um against diameter_mm or width_mm."
        )
    part = lost.size - np.count_nonzero(lost == BESIDE)
    if scored.zone_px > part / 2:
        said.append(
            f"the zones of the defects cover {_percent(scored.zone_px / part)} of the part: the "
            f"flawless level, a median, is then that of defects. Take fewer or smaller ones."
        )
    return said


def _unseen(unseen: int, defects: int) -> str:
    return (
        f"{unseen} of {defects} defects have no pixel of their own in the image: "
        f"outside the field, smaller than camera.sampling_mm, or under another."
    )


def out_of_view(station: Station, parts: int, seen: int) -> list[str]:
    """Say how many of the known defects no image has, where the station alone tells their number.

    Parameters
    ----------
    station : Station
    parts : int
        Number of parts.
    seen : int
        Defects with a pixel in view, of all parts.
    """
    counts = [population.count for population in station.populations]
    measured = station.part.relief or any(d.kind == "measured" for d in station.defects)
    if measured or None in counts:
        return []
    known = parts * (len(station.defects) + sum(count or 0 for count in counts))
    return [_unseen(known - seen, known)] if seen < known else []


def _zone_area(defect: KnownDefect) -> float:
    return math.pi * (defect.size_mm / 2) ** 2 + defect.size_mm * defect.length_mm


# ------------------------------------------------------------------------------- the detection


def _of_detection(
    light_map: LightMap,
    aspect: Image,
    lit: Mask,
    valid: Mask,
    threshold: float,
    scored: Score,
    *,
    basic: bool,
) -> list[str]:
    """Say why nothing, or everything, is detected; `basic`: a more basic cause was said."""
    station = light_map.station
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
            f"{_percent(scored.false_px / flawless)} of the flawless surface is detected at the "
            f"threshold of {threshold:.4g} DN, so that defects are hit by chance: its median level "
            f"is {np.median(aspect[lit]):.4g} DN.{'' if basic else way}"
        ]
    if basic:
        return []
    brightest = float(np.max(aspect, where=lit, initial=0.0))
    if brightest < full / 255:
        return [
            f"the image is dark: its brightest pixel has {brightest:.2g} DN of {full}. "
            f"{_why_dark(light_map, lit)}"
        ]
    if automatic and threshold >= full:
        return [_why_beyond(station, aspect, lit, threshold)]
    if found or not scored.defects:
        return []
    nothing = "nothing is detected, so that P1 is 1 by definition and says nothing"
    above = int(np.count_nonzero((aspect > threshold) & valid))
    if above:
        return [
            f"{nothing}: all {above:,} pixels above the threshold are in blobs smaller than "
            f"segmentation.min_area_mm2 = {station.segmentation.min_area_mm2:g}."
        ]
    level = float(np.median(aspect[lit]))
    if brightest - level < _EVEN * full:
        way = "The image is even: no defect stands out in it."
    elif not automatic:
        way = f'Set segmentation.threshold between {level:.4g} and {brightest:.4g}, or to "auto".'
    else:
        way = _why_high(station, aspect, lit)
    return [
        f"{nothing}: the threshold is {threshold:.4g} DN, the flawless level {level:.4g} DN and "
        f"the brightest pixel {brightest:.4g} DN. {way}"
    ]


def _why_dark(light_map: LightMap, lit: Mask) -> str:
    station = light_map.station
    fusion = station.sequence.fusion
    if fusion in (*_DIFFERENCES, "min"):
        brightest = float(light_map.image(0)[lit].max())
        if brightest >= station.sensor.full_scale_dn / 255:
            if fusion == "min":
                return 'With sequence.fusion = "min" every pixel has its darkest: take "mean".'
            lag = " Check sequence.lag." if fusion == "differential" else ""
            return f'Its images are not, but "{fusion}" finds next to no difference.{lag}'
    way = "widen tunnel.luminous_mm" if light_map.pattern is None else "make the pattern brighter"
    return f"Raise sensor.exposure, or {way}."


def _why_high(station: Station, aspect: Image, lit: Mask) -> str:
    """Say what keeps an automatic threshold above every defect, and what to change."""
    images, full = station.sequence.images, station.sensor.full_scale_dn
    margins = threshold_margins(aspect, lit, full_scale_dn=full, images=images)
    always = max(margins.uneven_dn, margins.floor_dn)  # however many images there are
    if margins.one_image_dn >= always:
        if float(aspect[lit].max()) > margins.flawless_dn + always:
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


def _why_beyond(station: Station, aspect: Image, lit: Mask, threshold: float) -> str:
    """Say why the automatic threshold is beyond full scale: which of its terms put it there."""
    full, images = station.sensor.full_scale_dn, station.sequence.images
    margins = threshold_margins(aspect, lit, full_scale_dn=full, images=images)
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


def common(lists: Iterable[Sequence[str]]) -> list[str]:
    """Return the notes that are in every list, in the order of the first."""
    found: list[Any] = list(lists)
    return [note for note in found[0] if all(note in other for other in found)] if found else []
