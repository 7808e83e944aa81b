"""What a station tells without an image: keys without effect, stripes, shifts, view."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from gpuspec.light.float64 import fresnel_reflectance
from gpuspec.station.materials import MATERIALS
from gpuspec.station.station import Station

SAME_SHIFT = 0.01
"""Share of a period within which all shifts lie when the images are as good as equal."""
FEW_SHIFTS = 8
"""Distinct shifts of the stripes below which it is said, if they are less than half the images."""
_EQUAL = 1e-6  # of a period, between equal shifts
_SHOWN = 5
DIFFERENCES = "std", "differential"  # fusions that are zero where the images do not differ


def of_station(station: Station) -> list[str]:
    """Return what the station tells without an image: keys, stripes, shifts, opening."""
    return [*unstated(station), *without_effect(station), *of_design(station)]


def of_design(station: Station) -> list[str]:
    """Return what is wrong with a design whatever its part: stripes, shifts, opening."""
    return [*of_stripes(station), *of_view(station)]


def assumptions(station: Station) -> tuple[str, ...]:
    """Return what the station leaves to an ideal that no real one has."""
    if station.tunnel.opening_length_mm:
        return ()
    return (
        "the camera looks through the tunnel's top as if it were not there; "
        "tunnel.opening_length_mm and tunnel.opening_width_mm cut an opening into it, which the "
        "part then reflects as a blind zone.",
    )


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
        f"{listed(keys)} {'has' if len(keys) == 1 else 'have'} no effect {why}."
        for why, keys in together.items()
    ]


def listed(words: Sequence[str]) -> str:
    """Return words as a sentence lists them; of many, the first and how many more."""
    shown = [*words[:_SHOWN], *([f"{len(words) - _SHOWN} more"] if len(words) > _SHOWN else [])]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


def of_stripes(station: Station) -> list[str]:
    """Say where stripes, shifts and exposure cannot give an aspect image."""
    period, images, step = station.tunnel.period_mm, station.sequence.images, station.step_mm
    said = of_shifts(station)
    if not said and station.distinct_shifts is None:
        said.append(
            f"the {images} images cover {images * step / period:.6g} periods of the stripes: the "
            f"flawless level is even only over whole periods. Leave sequence.step_mm out, or "
            f"choose images and step so that they fill whole ones."
        )
    said += _unsaturated(station)
    return said


def of_shifts(station: Station) -> list[str]:
    """Say where there is no sequence: one image, or images that are the same."""
    period, images, step = station.tunnel.period_mm, station.sequence.images, station.step_mm
    if images == 1:
        shows = (
            f'the "{station.sequence.fusion}" of one image is black'
            if station.sequence.fusion in DIFFERENCES
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


def percent(share: float) -> str:
    """Return a share in percent, three digits; of nearly all, that."""
    return f"{100 * share:.3g} %" if share < 0.999 else "nearly all"


def view_mm(station: Station) -> tuple[float, float]:
    """Return the camera's view of the part where it passes the tunnel's top."""
    share = 1 - station.tunnel.top_mm / station.camera.height_mm
    return share * station.part.length_mm, share * station.part.width_mm


def of_view(station: Station) -> list[str]:
    """Say where the opening is smaller than what the camera looks through."""
    tunnel = station.tunnel
    if not tunnel.opening_length_mm:
        return []
    view = view_mm(station)
    if tunnel.opening_length_mm >= view[0] and tunnel.opening_width_mm >= view[1]:
        return []
    return [
        f"the camera opening of {tunnel.opening_length_mm:g} x {tunnel.opening_width_mm:g} mm is "
        f"smaller than the camera's view through the tunnel's top, {view[0]:.3g} x {view[1]:.3g} "
        f"mm; the tunnel is taken as transparent to the camera itself."
    ]
