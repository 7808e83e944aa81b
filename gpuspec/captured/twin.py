"""From what was fitted to a station file, in mm as far as a scale is given, and to words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpuspec.arrays import Mask
from gpuspec.captured.light_fit import LightFit, seen_through, table_of
from gpuspec.errors import StationError
from gpuspec.frames.fringes import Fringes, Measured
from gpuspec.frames.photon_transfer import Transfer
from gpuspec.frames.replay import FINE_PX
from gpuspec.frames.texture import Texture
from gpuspec.light.float64 import two_boxes
from gpuspec.report.twin import Number
from gpuspec.station.station import Station

WINDOW_PX = 41.0
"""Side of the window of the local background, where the station gives none."""
_ALIKE = 0.25
"""What share of the fall-off's misfit cos^4 may leave for it to be taken."""
_APART = 0.2  # relative uncertainty of a gain, from which it counts as not told
_SEEN_PX = 0.7  # of an edge of the light, not saturated, below which exposure counts as ill told
_NEIGHBOURS = 0.2  # correlation of neighbours' noise from which it is told


@dataclass(frozen=True)
class Dark:
    """What dark frames tell.

    Attributes
    ----------
    black : Measured
        DN.
    noise_dn : float or None
        Of a grey level from frame to frame; None: there was one frame.
    """

    black: Measured
    noise_dn: float | None


@dataclass(frozen=True)
class Scale:
    """Pixels, periods and millimetres.

    Attributes
    ----------
    sampling_mm, period_mm : float
        Distance of two pixels on the part, and period on the light.
    period_px : float
        In the image.
    magnification : float
        mm on the light to a mm on the part, of a flat one: 1 + H / h.
    reach : float
        H / h.
    pupil_periods : float or None
        Radius of the pupil's image on the light; None: the station does not tell.
    shape : tuple of int
        Of the frames.
    turned : int
        Quarter turns anticlockwise from the direction to the right to that of the light.
    from_period : bool
        Whether the stripes' widths gave the scale.
    told : bool
        Whether anything did.
    """

    sampling_mm: float
    period_mm: float
    period_px: float
    magnification: float
    reach: float
    pupil_periods: float | None
    shape: tuple[int, int]
    turned: int
    from_period: bool
    told: bool

    @classmethod
    def of(cls, given: Station, waves: Fringes, shape: tuple[int, int]) -> Scale:
        """Take what the station says: the sampling, or the widths of the stripes.

        Parameters
        ----------
        given : Station
        waves : Fringes
        shape : tuple of int
            Of the frames.

        Raises
        ------
        StationError
            If its part is not flat, or sampling and period contradict each other.
        """
        part, tunnel, camera = given.part, given.tunnel, given.camera
        curved = part.crown_radius_x_mm, part.crown_radius_y_mm, part.sphere_radius_mm
        if any(curved) or part.relief or part.mesh:
            raise StationError(
                f"{given.file} has a part that is not flat; a twin is fitted to frames of a flat "
                f"one. Leave its shape out, fit, and set it in the twin."
            )
        reach = tunnel.top_mm / camera.height_mm
        period_px = waves.period_px.value
        said = {"luminous_mm", "dark_mm"} <= tunnel.model_fields_set
        sampled = "sampling_mm" in camera.model_fields_set or "sampling_mm" in camera.following
        period = period_px * camera.sampling_mm * (1 + reach)
        sampling = camera.sampling_mm
        if said and not sampled:
            period = tunnel.period_mm
            sampling = period / (1 + reach) / period_px
        radius = camera.pupil_mm * reach / 2 / period
        pupil = "pupil_mm" in camera.model_fields_set or "pupil_mm" in camera.following
        quarter = round(waves.direction_deg / 90) % 4
        return cls(
            sampling, period, period_px, 1 + reach, reach, radius if pupil else None, shape,
            quarter, said and not sampled, said or sampled,
        )  # fmt: skip


def twin_of(
    given: Station, scale: Scale, light: LightFit, transfer: Transfer, sensor: object,
    images: int, periods: int, region: Mask, dark: Dark | None,
) -> Station:  # fmt: skip
    """Return the station that takes such frames.

    Parameters
    ----------
    given : Station
        Whose other keys are kept.
    scale : Scale
    light : LightFit
    transfer : Transfer
    sensor : Sensor
        With the fitted noise.
    images, periods : int
        In the sequence.
    region : ndarray of bool, shape (M, N)
        Whose outer box is the part.
    dark : Dark or None
    """
    rows, columns = (int(np.ptp(np.flatnonzero(region.any(axis)))) + 1 for axis in (1, 0))
    if scale.turned % 2:
        rows, columns = columns, rows
    length, width = (round(n * scale.sampling_mm, 6) for n in (columns, rows))
    gain, cos4 = _gain(light, scale, region, given.camera.height_mm)
    tunnel, exposure, pupil = _light(light, scale)
    needed = length * scale.magnification + 4 * scale.period_mm
    if given.tunnel.section != "ceiling":
        needed *= 1.1
    sensor_keys = _sensor_keys(sensor, transfer, dark)
    smoothing, window = given.segmentation.smoothing_mm, given.segmentation.background_mm
    part = {"length_mm": length, "width_mm": width}
    camera: dict[str, object] = {
        "sampling_mm": float(f"{scale.sampling_mm:.8g}"), "columns": None, "rows": None,
        "pupil_mm": pupil, "vignetting": "cos4" if cos4 else "none",
        "focal_mm": None, "f_number": None, "pixel_um": None, "mtf50_lp_per_mm": None,
    }  # fmt: skip
    return Station.from_dict(
        {
            **_plain(given),
            "part": part | {"surface": given.part.surface, "material": given.part.material},
            "tunnel": _kept(given.tunnel.model_dump(), tunnel)
            | {"length_mm": max(given.tunnel.length_mm, round(needed, 3))},
            "camera": _kept(given.camera.model_dump(), camera),
            "sensor": given.sensor.model_dump() | sensor_keys
            | {"exposure": float(f"{exposure * gain:.6g}"), "noise": True},
            "sequence": {
                "images": images,
                **({"step_mm": scale.period_mm * periods / images} if periods > 1 else {}),
            },
            "segmentation": given.segmentation.model_dump(exclude_none=True)
            | {
                "background_mm": window or round(WINDOW_PX * scale.sampling_mm, 6),
                "smoothing_mm": smoothing or (
                    0.0 if window else round(FINE_PX * scale.sampling_mm, 6)
                ),
            },
        },
        "twin",
    )  # fmt: skip


def _plain(given: Station) -> dict[str, object]:
    """Return what is kept of a station as it is: its classes and rules."""
    kept = given.as_dict()
    return {name: kept[name] for name in ("classes", "decision") if kept.get(name)}


def _kept(old: dict[str, object], new: dict[str, object]) -> dict[str, object]:
    return {key: value for key, value in (old | new).items() if value is not None}


def _sensor_keys(sensor: object, transfer: Transfer, dark: Dark | None) -> dict[str, object]:
    from gpuspec.station.sections import Sensor

    assert isinstance(sensor, Sensor)
    read = sensor.read_noise_e
    if dark and dark.noise_dn is not None:
        square = max(dark.noise_dn**2 - 1 / 12, 0.0)
        read = float(np.sqrt(square)) / sensor.gain_dn_per_e
    return {
        "bit_depth": sensor.bit_depth,
        "saturation_e": float(f"{sensor.saturation_e:.6g}"),
        "read_noise_e": float(f"{read:.6g}"),
        "black_level_dn": float(f"{sensor.black_level_dn:.6g}"),
        "prnu": 0.0, "dark_e": 0.0, "dsnu_e": 0.0,
    }  # fmt: skip


def _light(light: LightFit, scale: Scale) -> tuple[dict[str, object], float, float]:
    """Return the tunnel's keys, the exposure and the pupil's diameter in mm."""
    period = scale.period_mm
    numbers = light.numbers
    if light.kind == "stripes":
        duty = numbers["duty"].value
        keys: dict[str, object] = {
            "profile": "stripes",
            "luminous_mm": float(f"{duty * period:.8g}"),
            "dark_mm": float(f"{(1 - duty) * period:.8g}"),
            "dark_leak": float(f"{numbers['leak'].value:.6g}"),
        }
        pupil = 2 * numbers["pupil"].value * period / max(scale.reach, 1e-9)
        return keys, numbers["exposure"].value, float(f"{pupil:.6g}")
    half = float(f"{period / 2:.8g}")
    keys = {"luminous_mm": half, "dark_mm": half}
    pupil = 2 * (scale.pupil_periods or 0.0) * period / max(scale.reach, 1e-9)
    if light.kind == "sinusoid":
        keys |= {
            "profile": "sinusoid",
            "profile_gamma": float(f"{numbers['gamma'].value:.6g}"),
            "dark_leak": float(f"{numbers['leak'].value:.6g}"),
        }
        return keys, numbers["exposure"].value, pupil
    one = np.ones(1)
    radius = (scale.pupil_periods or 0.0) * one
    wide, narrow = two_boxes(one / scale.period_px, 0 * one, radius, 0 * one)
    weaker = seen_through(light.harmonics, float(wide[0]), float(narrow[0]))
    exposure, profile = table_of(light.harmonics / np.where(np.abs(weaker) > 0.2, weaker, 1))
    return keys | {"profile": list(profile), "dark_leak": 0.0}, exposure, pupil


def _gain(light: LightFit, scale: Scale, region: Mask, height_mm: float) -> tuple[float, bool]:
    """Return the gain by which the exposure counts, and whether the fall-off is cos^4."""
    row, column = np.nonzero(region[::8, ::8])
    half = max(region.shape) / 2
    place = np.column_stack(
        [(8 * column + 0.5 - region.shape[1] / 2) / half,
         (region.shape[0] / 2 - 8 * row - 0.5) / half]
    )  # fmt: skip
    gains = light.gain(place)
    radius = np.hypot(*place.T) * half * scale.sampling_mm / height_mm
    cos4 = (1 + radius**2) ** -2.0
    level = float(np.median(gains))
    misfit = float(np.sum((gains / np.median(gains / cos4) - cos4) ** 2))
    if misfit < _ALIKE * float(np.sum((gains / level - 1) ** 2)) and np.ptp(cos4) > 1e-3:
        return float(np.median(gains / cos4)), True
    return level, False


def known(
    scale: Scale, waves: Fringes, step: Measured, uneven: float, light: LightFit,
    transfer: Transfer, prnu: Measured, dark: Dark | None, station: Station,
) -> tuple[Number, ...]:  # fmt: skip
    """Return what was found, with names, units and where it stands in the twin.

    Parameters
    ----------
    scale : Scale
    waves : Fringes
    step : Measured
        Of the sequence, in periods.
    uneven : float
        Rms of the images' places about equal steps, in periods.
    light : LightFit
    transfer : Transfer
    prnu : Measured
        Rms of the pixels' gain.
    dark : Dark or None
    station : Station
        The twin.
    """
    times = scale.period_mm / scale.period_px
    found = [
        Number("period", "px", waves.period_px, "of the light in the image"),
        Number(
            "period on the light", "mm", _times(waves.period_px, times),
            "tunnel.luminous_mm + tunnel.dark_mm" if not scale.from_period else "given",
        ),
        Number("step", "periods", step, "sequence.step_mm"),
        Number("images per period", "", _over(step), "sequence.images"),
        Number("step unevenness", "periods", Measured(uneven, step.uncertainty), "rms"),
        Number("direction", "°", Measured(waves.direction_deg, _direction(waves)),
               "in which the light moves in the image, 0 to the right, 90 up"),
        Number("bend", "periods", Measured(waves.bend, 0.0), "rms of the phase about a plane"),
    ]  # fmt: skip
    numbers = light.numbers
    gain = station.sensor.exposure
    if light.kind == "table":
        share = numbers["mean"].uncertainty / numbers["mean"].value
        found.append(Number("exposure", "", Measured(gain, gain * share), "sensor.exposure"))
        full = station.sensor.full_scale_dn - station.sensor.black_level_dn
        first = numbers["mean"]
        found.append(Number("mean", "DN", _times(first, full), "of the profile, tunnel.profile"))
        for order, wave in enumerate(light.harmonics[1:], 1):
            size = Measured(abs(wave) * full, numbers[f"cos{order}"].uncertainty * full)
            found.append(Number(f"harmonic {order}", "DN", size, "tunnel.profile"))
    else:
        exposure = numbers["exposure"]
        share = exposure.uncertainty / exposure.value
        found.append(Number("exposure", "", Measured(gain, gain * share), "sensor.exposure"))
        leak = "tunnel.dark_leak"
        found.append(Number("leak", "", numbers["leak"], leak))
        if light.kind == "sinusoid":
            found.append(Number("gamma", "", numbers["gamma"], "tunnel.profile_gamma"))
        else:
            duty, pupil = numbers["duty"], numbers["pupil"]
            found.append(Number("duty", "", duty, "tunnel.luminous_mm over the period"))
            found.append(Number("footprint", "periods", _footprint(pupil, scale),
                                "of a flawless pixel on the light"))  # fmt: skip
            mm = 2 * scale.period_mm / max(scale.reach, 1e-9)
            found.append(Number("pupil", "mm", _times(pupil, mm), "camera.pupil_mm"))
    if light.kind != "stripes":
        wide = Measured(1 / scale.period_px, waves.period_px.uncertainty / scale.period_px**2)
        found.append(Number("footprint", "periods", wide, "of the pixel alone; the pupil's share "
                            "is in the profile"))  # fmt: skip
    edge, spread = _falloff(light, scale)
    found.append(Number("fall-off", "", Measured(edge, spread),
                        "gain at the corners over that in the middle"))  # fmt: skip
    full = station.sensor.full_scale_dn - station.sensor.black_level_dn
    k = transfer.gain_dn_per_e
    electrons = station.sensor.saturation_e
    share = k.uncertainty / max(k.value, 1e-12)
    found.append(Number("gain", "DN/e⁻", k, "of the photon transfer"))
    found.append(
        Number("saturation", "e⁻", Measured(electrons, electrons * share), "sensor.saturation_e")
    )
    read = station.sensor.read_noise_e
    noise = max(read * k.value, 1e-9)
    spread_dn = min(transfer.dark_dn2.uncertainty / (2 * noise),
                    float(np.sqrt(transfer.dark_dn2.uncertainty)))  # fmt: skip
    found.append(
        Number("read noise", "e⁻",
               Measured(read, float(np.hypot(spread_dn / k.value, read * share))),
               "sensor.read_noise_e")
    )  # fmt: skip
    if dark:
        found.append(Number("black level", "DN", dark.black, "sensor.black_level_dn"))
    found.append(Number("uneven gain", "", prnu, "sensor.prnu"))
    if transfer.jitter.uncertainty > 0:  # else its variance came out below 0
        meant = "of the light between images, rms"
        found.append(Number("trembling", "periods", transfer.jitter, meant))
    return tuple(found)


def _times(one: Measured, factor: float) -> Measured:
    return Measured(one.value * factor, one.uncertainty * abs(factor))


def _over(step: Measured) -> Measured:
    return Measured(1 / abs(step.value), step.uncertainty / step.value**2)


def _direction(waves: Fringes) -> float:
    return float(np.degrees(waves.period_px.uncertainty / waves.period_px.value))


def _footprint(pupil: Measured, scale: Scale) -> Measured:
    """Return the root of twelve times the variance of what a pixel averages, in periods."""
    width = float(np.sqrt(scale.period_px**-2 + 3 * pupil.value**2))
    return Measured(width, 3 * pupil.value * pupil.uncertainty / width)


def _falloff(light: LightFit, scale: Scale) -> tuple[float, float]:
    rows, columns = scale.shape
    corners = np.array([[x * columns, y * rows] for x in (-1, 1) for y in (-1, 1)]) / max(
        rows, columns
    )
    value = float(light.gain(corners).mean())
    x, y = abs(corners[0])
    squares = np.array([0, 0, x * x, 0, y * y])
    return value, float(np.sqrt(np.sum((squares * light.falloff_spread) ** 2)))


def unknown(
    given: Station, scale: Scale, waves: Fringes, light: LightFit, transfer: Transfer,
    real: Texture, twin: Texture, *, dark: bool,
) -> tuple[str, ...]:  # fmt: skip
    """Return what such frames cannot tell, a sentence each.

    Parameters
    ----------
    given : Station
        What was known before.
    scale : Scale
    waves : Fringes
    light : LightFit
    transfer : Transfer
    real, twin : Texture
        Of the aspect images of the frames and of the twin.
    dark : bool
        Whether there were dark frames.
    """
    said = []
    if not scale.told:
        said.append(
            f"The scale: nothing in mm. camera.sampling_mm = {scale.sampling_mm:g} is assumed; "
            f"give it, or the stripes' widths, with --set or --station."
        )
    heights = {"height_mm"} & given.tunnel.model_fields_set & given.camera.model_fields_set
    if not heights:
        said.append(
            f"How far camera and light are: only their ratio counts in the frames. "
            f"tunnel.height_mm = {given.tunnel.top_mm:g} and camera.height_mm = "
            f"{given.camera.height_mm:g} are taken; a defect's depth goes with the light's height."
        )
    if not dark and "black_level_dn" not in given.sensor.model_fields_set:
        said.append(
            "The black level: what is dark in every image may be black level or leak; it is taken "
            "as light, and read noise is told for a black level of 0. Give --dark frames."
        )
    gain = transfer.gain_dn_per_e
    if gain.uncertainty > _APART * gain.value:
        said.append(
            "Gain and read noise apart: nearly all grey levels that are not saturated are alike. "
            "Their noise is the twin's; how much of it grows with the level is not told. Give "
            "frames at a shorter exposure."
        )
    if light.kind != "stripes" and scale.pupil_periods is None:
        said.append(
            "The pupil: a smooth profile looks the same through a wider one. It is taken as a "
            "pinhole's, and what it does to the light is in the profile; give camera.pupil_mm."
        )
    exposed = light.numbers["exposure"].value if light.kind != "table" else 0.0
    if light.kind == "stripes" and exposed > 1 and scale.pupil_periods is None:
        said.append(
            "Exposure, stripes' width and pupil apart: the images saturate, and of an edge of the "
            "light only its foot is seen. Give camera.pupil_mm, or frames at a shorter exposure."
        )
    if light.kind == "stripes" and exposed > 1:
        seen = _footprint(light.numbers["pupil"], scale).value * scale.period_px / exposed
        if seen < _SEEN_PX:
            said.append(
                f"The exposure as well as its uncertainty says: of an edge of the light {seen:.2f} "
                f"px do not saturate, and to a part of a pixel the light's place is not told so "
                f"well. Take frames at a shorter exposure."
            )
    if light.kind == "sinusoid" and exposed > 1:
        said.append(
            "The light's profile where it saturates: it is that of a sinusoid through a gamma that "
            "fits below."
        )
    said.append(
        f"The part's tilt and curvature from the lens and the light's tilt: the phase is off a "
        f"plane by {waves.bend:.3f} periods rms, and the twin's part is flat."
    )
    off = (waves.direction_deg + 45) % 90 - 45
    if abs(off) > 1:
        said.append(f"The light moves {off:+.1f}° off the image's axes; the twin's along x.")
    fall, _ = _falloff(light, scale)
    if abs(fall - 1) > 0.02:
        said.append(
            f"Whether the lens or the light is weaker aside: at the corners the gain is {fall:.2f} "
            f"of that in the middle; a station has cos⁴ or none, so the level is the median's."
        )
    if real.correlation > _NEIGHBOURS:
        said.append(
            f"Noise of neighbours is alike (correlation {real.correlation:.2f}): the camera's "
            f"pixels are made of several, or the part has a texture. The twin's is each pixel's "
            f"own; its sensor.prnu gives it the noise that scratches have to pass, between 1.5 and "
            f"25 px, and too much of a single pixel: {twin.pixel_noise_dn:.2f} DN, where the "
            f"frames' has {real.pixel_noise_dn:.2f}."
        )
    return tuple(said)
