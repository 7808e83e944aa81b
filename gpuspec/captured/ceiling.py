"""Which ceiling a camera's frames are held against: their own, and the station's where they agree.

A station file may say another light, exposure or part than that of the frames, so that these are
the judge. Where they agree the station's is taken: it is exact, and the same for every part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from gpuspec.arrays import Image, Mask
from gpuspec.detection.segmentation import (
    CEILING_FLOOR,
    NOISE_SIGMAS,
    Ceiling,
    threshold_margins,
)
from gpuspec.errors import FrameError
from gpuspec.frames.ceiling import told_ceiling
from gpuspec.frames.period import sampled, whole_periods
from gpuspec.light.ceiling import ceiling_of, untold
from gpuspec.station.station import Station

_QUIET_DN = 0.5
"""Grey levels of 255 by which frames may spread more than the station's noise: as rounding."""


def ceiling_for(
    samples: Sequence[NDArray[Any]],
    aspect: Image,
    inside: Mask,
    station: Station,
    *,
    lit_as_said: bool,
    rate: float | None,
) -> tuple[Ceiling | None, str, tuple[str, ...]]:
    """Return the ceiling of an inspection of frames, why there is none, and what to know of it.

    Parameters
    ----------
    samples : sequence of ndarray, shape (n,)
        Of each frame that is used, see :func:`gpuspec.frames.period.sampled`.
    aspect : ndarray of float32, shape (M, N)
        Their mean, DN.
    inside : ndarray of bool, shape (M, N)
        What is inspected.
    station : Station
        With the frames' size and number.
    lit_as_said : bool
        Whether its file says the light of the frames, see :func:`says_light`.
    rate : float or None
        Periods by which it says that the light moves from frame to frame, see
        :func:`gpuspec.captured.sequence.stated_rate`.

    Returns
    -------
    Ceiling or None
        None where the threshold needs none, too.
    untold : str
        Why frames tell none, as the end of a sentence.
    notes : tuple of str
    """
    rule = station.segmentation
    if rule.threshold != "auto" or rule.background_mm or rule.polarity != "bright":
        return None, "", ()
    why = _not_whole(samples, station, rate)
    found = None
    if not why:
        found, why = told_ceiling(samples, sampled(aspect), sampled(inside))
    full = station.sensor.full_scale_dn
    stated = ceiling_of(station) if lit_as_said and found is not None else None
    if found is not None and stated is not None and _agree(found, stated, full):
        noise = stated.noise_dn if station.sensor.noise else found.noise_dn
        return Ceiling(stated.level_dn, noise), "", ()
    if found is not None:
        spread = threshold_margins(
            aspect, inside, full_scale_dn=full, images=station.sequence.images
        )
        if found.threshold_dn(full) > spread.rounded_dn(full):
            found, why = None, "the phase of a pixel tells its level no better"
    if found is None:
        return None, why, (f"the threshold is that of the median and spread of levels, for {why}.",)
    if stated is None:
        return found, "", ()
    return found, "", (
        f"flawless pixels of the frames have up to {found.level_dn:.1f} DN with a spread of "
        f"{found.noise_dn:.2g} DN, and by {station.file} up to {stated.level_dn:.1f} DN with "
        f"{stated.noise_dn:.2g} DN: its light, exposure or part is not that of the frames, which "
        f"are believed.",
    )  # fmt: skip


def says_light(station: Station) -> bool:
    """Whether a station's file says the stripes and the exposure, and leaves none to a default.

    Parameters
    ----------
    station : Station
        As it was read.
    """
    stripes = {"luminous_mm", "dark_mm"} <= station.tunnel.model_fields_set
    return stripes and "exposure" in station.sensor.model_fields_set


def _not_whole(samples: Sequence[NDArray[Any]], station: Station, rate: float | None) -> str:
    """Return why frames are no whole periods of which the mean is taken; "" if they are."""
    why = "" if station.sequence.fusion == "mean" else untold(station)
    if not why:
        try:
            numbers = [str(number) for number in range(len(samples))]
            periods = whole_periods(samples, numbers, rate=rate)
        except FrameError:
            return "a frame does not belong to the others"
        if periods.whole is None:
            return "so few frames tell no period of the light"
        if not periods.whole or periods.why:
            return "the frames are no whole periods of the light"
    return why


def _agree(found: Ceiling, stated: Ceiling, full: int) -> bool:
    """Whether frames and station tell the same, as far as frames tell it."""
    apart = max(NOISE_SIGMAS * found.noise_dn, CEILING_FLOOR * full)
    noisy = found.noise_dn > 2 * stated.noise_dn + _QUIET_DN * full / 255
    return abs(found.level_dn - stated.level_dn) <= apart and not noisy
