"""What a station tells without an image: keys without effect, stripes, shifts, view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpuspec.light.constants import HARMONICS
from gpuspec.light.diffuse import diffuse_share, form_factor, ripple
from gpuspec.light.profiles import left_out
from gpuspec.simulation.cautions.camera import of_camera
from gpuspec.station.materials import TABLES, reflectance
from gpuspec.station.optics import FOLLOWS
from gpuspec.station.sections import Tunnel
from gpuspec.station.station import Station

SAME_SHIFT = 0.01
"""Share of a period within which all shifts lie when the images are as good as equal."""
FEW_SHIFTS = 8
"""Distinct shifts of the stripes below which it is said, if they are less than half the images."""
LEFT_OUT = 0.02
"""Of full luminance, by which a profile's harmonics may miss it before it is said."""
UNEVEN = 0.05
"""Share by which the light that falls on the part may be uneven before it is said."""
_EQUAL = 1e-6  # of a period, between equal shifts
_SHOWN = 5
DIFFERENCES = "std", "differential"  # fusions that are zero where the images do not differ


def of_station(station: Station) -> list[str]:
    """Return what the station tells without an image: keys, stripes, shifts, opening."""
    return [*unstated(station), *without_effect(station), *of_design(station)]


def of_design(station: Station) -> list[str]:
    """Return what is wrong with a design whatever its part: stripes, shifts, opening."""
    return [*of_stripes(station), *of_camera(station)]


def assumptions(station: Station) -> tuple[str, ...]:
    """Return what the station leaves to an ideal that no real one has."""
    said = []
    if not station.tunnel.opening_length_mm:
        said.append(
            "the camera looks through the tunnel's top as if it were not there; "
            "tunnel.opening_length_mm and tunnel.opening_width_mm cut an opening into it, which "
            "the part then reflects as a blind zone."
        )
    if station.camera.pixel_um and not station.camera.blur_mm:
        said.append(
            "the lens is perfect but for its pupil; camera.mtf50_lp_per_mm, from its data sheet, "
            "or camera.blur_mm blurs what it sees."
        )
    return tuple(said)


def unstated(station: Station) -> list[str]:
    """Say so where a station is all defaults: an empty file."""
    tables = {"sweep", "dataset"}  # of other commands
    fields = {n: field for n, field in type(station).model_fields.items() if n not in tables}
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
    for key, words in _idle(station).items():
        found[f"camera.{key}"] = words
    lens = station.camera.focal_mm and station.camera.f_number
    if station.part.material not in TABLES and not lens:
        found["tunnel.wavelength_nm"] = (
            f'with part.material = "{station.part.material}", which reflects all wavelengths '
            f"alike, and without camera.focal_mm and camera.f_number, whose diffraction it tells"
        )
    if not station.segmentation.background_mm:
        found["segmentation.smoothing_mm"] = "without segmentation.background_mm"
    if tunnel.profile != "sinusoid":
        found["tunnel.profile_gamma"] = 'without a screen: tunnel.profile = "sinusoid" is one'
    if not sensor.noise:
        for name in ("saturation_e", "read_noise_e", "dark_e", "prnu", "dsnu_e",
                     "black_level_dn", "seed"):  # fmt: skip
            found[f"sensor.{name}"] = "without noise: sensor.noise = true turns it on"
    return found


def _idle(station: Station) -> dict[str, str]:
    """Return the keys of the camera's data sheet from which nothing follows."""
    camera = station.camera
    used = {name for key in camera.following for name in FOLLOWS[key]}
    found = {}
    for key in ("focal_mm", "f_number", "pixel_um", "mtf50_lp_per_mm"):
        if getattr(camera, key) is not None and key not in used:
            beside = sorted(
                {n for names in FOLLOWS.values() if key in names for n in names} - {key}
            )
            found[key] = f"without {' or '.join(f'camera.{n}' for n in beside if n != 'height_mm')}"
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
    """Say where the light, shifts and exposure cannot give an aspect image."""
    period, images, step = station.tunnel.period_mm, station.sequence.images, station.step_mm
    said = of_shifts(station)
    if not said and station.distinct_shifts is None:
        closed = ", and only there has the mean a closed form: this one goes frame by frame"
        mean_of_stripes = station.sequence.fusion == "mean" and station.tunnel.is_striped
        said.append(
            f"the {images} images cover {images * step / period:.6g} periods of the light: the "
            f"flawless level is even only over whole periods{closed * mean_of_stripes}. Leave "
            f"sequence.step_mm out, or choose images and step so that they fill whole ones."
        )
    said += _unsaturated(station)
    return said + _unlike(station.tunnel) + of_diffuse(station)


def of_diffuse(station: Station) -> list[str]:
    """Say where the light that the part scatters is not as even as it is taken.

    Parameters
    ----------
    station : Station
    """
    if not station.part.diffuse:
        return []
    tunnel, said = station.tunnel, []
    changes = ripple(tunnel)
    if changes > UNEVEN:
        said.append(
            f"part.diffuse is lit as by the mean of the light, of which a period of "
            f"{tunnel.period_mm:g} mm is coarse at {tunnel.top_mm:g} mm: with the shift it changes "
            f"by up to {percent(changes)}, which is left out."
        )
    middle, end = form_factor(tunnel), form_factor(tunnel, station.part.length_mm / 2)
    if abs(end - middle) > UNEVEN * middle:
        said.append(
            f"part.diffuse is lit everywhere as in the part's middle; at its ends it gets "
            f"{100 * end / max(middle, 1e-9):.3g} % of that light. A longer tunnel, "
            f"tunnel.length_mm, lights it more evenly."
        )
    return said


def _unlike(tunnel: Tunnel) -> list[str]:
    """Say where a profile has sharper edges than its harmonics tell."""
    missed = left_out(tunnel)
    if missed <= LEFT_OUT:
        return []
    return [
        f"tunnel.profile has edges sharper than {HARMONICS} harmonics tell: they miss its values "
        f'by up to {percent(missed)} of full. tunnel.profile = "stripes" is exact for sharp edges.'
    ]


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
    differ = station.distinct_shifts or _different(images * step / period, images)
    if differ < min(FEW_SHIFTS, images / 2):
        return [
            f"only {differ} of {images} images differ: sequence.step_mm = {step:g} brings the "
            f"stripes, of a period of {period:g} mm, back to where they were after {differ}. {way}"
        ]
    return []


def _different(periods: float, images: int) -> int:
    """Return how many of some images, over so many periods, have another shift than all others."""
    shifts = np.round(np.arange(images) * periods / images / _EQUAL) % round(1 / _EQUAL)
    return len(np.unique(shifts))


def _unsaturated(station: Station) -> list[str]:
    material, exposure = station.part.material, station.sensor.exposure
    reflected = reflectance(material, station.tunnel.wavelength_nm)
    brightest = station.tunnel.brightest + diffuse_share(station)
    if exposure * reflected * brightest > 1 or station.sequence.fusion != "mean":
        return []
    dull = f", of which {material} reflects {reflected:.0%}," if reflected < 1 else ""
    reflected *= brightest
    return [
        f"sensor.exposure = {exposure:g}{dull} does not saturate the sensor: the mean over a whole "
        f"period then has no contrast. Take {2 / reflected:.2g} to {4 / reflected:.2g}."
    ]


def percent(share: float) -> str:
    """Return a share in percent, three digits; of nearly all, that."""
    return f"{100 * share:.3g} %" if share < 0.999 else "nearly all"
