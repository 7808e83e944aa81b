"""The way through for frames: from files or arrays to blobs, classes and score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Image, Mask
from gpuspec.captured.captured import Captured, Zone
from gpuspec.captured.ceiling import ceiling_for, says_light
from gpuspec.captured.notes import uneven, unlit
from gpuspec.captured.sequence import (
    Given,
    Seen,
    Sequenced,
    added,
    fitting,
    shading_of,
    stated_rate,
)
from gpuspec.detection.classes import Confusion, confusion
from gpuspec.detection.decision import decision_rules
from gpuspec.detection.inspection import Inspection
from gpuspec.detection.inspection import inspect as inspect_image
from gpuspec.detection.measures import measure_blobs
from gpuspec.detection.score import Score, score
from gpuspec.errors import FrameError
from gpuspec.frames.accumulator import Accumulator
from gpuspec.frames.outline import outlined
from gpuspec.frames.period import Periods, whole_periods
from gpuspec.frames.readers import Colour
from gpuspec.frames.region import lit_region
from gpuspec.frames.replay import Replay, replay
from gpuspec.frames.silhouette import TOLERANCE_PX, silhouette_of
from gpuspec.light.backend import DeviceInfo
from gpuspec.station.station import Station

INFO = DeviceInfo("numpy", "cpu", "NumPy integers", np.__version__)
"""What adds frames up."""
_LONG = 3.0  # times as long as wide: a zone with a length


def inspect(
    frames: Given,
    station: Station | str | Path | None = None,
    *,
    truth: str | Path | NDArray[Any] | None = None,
    region: str | Path | Mask | None = None,
    dark: Given | None = None,
    flat: Given | None = None,
    colour: Colour | None = None,
    gaps: bool = False,
    every_frame: bool = False,
    silhouette: str | Path | Mask | None = None,
    progress: Callable[[str], None] | None = None,
) -> Captured:
    """Inspect the frames that a camera took: add them up, segment, measure and classify.

    Parameters
    ----------
    frames : str, Path, sequence of these, ndarray, or iterable of ndarray
        A folder, a pattern, files (PNG, TIFF; 8 to 16 bit), or arrays of uint8 or uint16.
    station : Station, str or Path, optional
        Gives the scale (``camera.sampling_mm``), bit depth, fusion, threshold and classes; None:
        gpuspec's defaults, said in the warnings.
    truth : str, Path or ndarray of int, shape (M, N), optional
        Zones of known defects, 0 elsewhere: a label image, as ``truth.tif`` of a run.
    region : str, Path or ndarray of bool, shape (M, N), optional
        What is inspected, see :func:`gpuspec.frames.outline.outlined`; ``"found"``, or
        ``"found:25"`` with a margin in pixels: where the light ever comes, see
        :func:`gpuspec.frames.region.lit_region`; None: everything.
    dark, flat : as `frames`, optional
        Frames without light, and of an evenly lit surface.
    colour : {"luminance", "red", "green", "blue"}, optional
        What is taken of coloured frames; None: they are refused.
    gaps : bool
        Whether numbers may be missing in the series.
    every_frame : bool
        Whether all frames are used; else those of whole periods, and none that does not belong to
        the sequence, see :func:`gpuspec.frames.period.whole_periods`.
    silhouette : str, Path or ndarray of bool, shape (M, N), optional
        The nominal part, whose outline is compared with where the light passes: ``"part"``, the
        station's; a box, a polygon or a mask, as of `region`; each with a tolerance in pixels,
        ``"part:2.5"``, see :func:`gpuspec.frames.silhouette.silhouette`. It may lie elsewhere and
        be turned by some degrees. None: no outline is compared.
    progress : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    Captured

    Raises
    ------
    FrameError
        If a frame cannot be read, does not belong to the others, or nothing can be seen in them.
    StationError
        If the station cannot be read, or says another size or depth.

    Examples
    --------
    >>> frames = np.random.default_rng(1).integers(58, 63, (8, 40, 60), np.uint8)
    >>> frames[:, 20:23, 10:40] += 90  # a bright streak
    >>> found = gpuspec.inspect(frames, gpuspec.Station(camera={"sampling_mm": 0.1}))
    >>> found.made, found.classes.tolist(), found.blobs.area_px.tolist()
    ('mean of 8 frames', ['scratch'], [90])
    """
    tell = progress or (lambda _: None)
    given = Station() if station is None else Station.of(station)
    lit_as_said, rate = says_light(given), stated_rate(given)
    decision_rules(given)
    tell("looking at the frames")
    sequence = Sequenced.of(frames, colour=colour, gaps=gaps)
    margin = _found(region)
    against, tolerance = _named(silhouette, "the silhouette", "part", TOLERANCE_PX)
    of_part = isinstance(against, str) and against == "part"
    if of_part and station is None:
        raise FrameError(
            "the silhouette's nominal part is the station's; name its file (--station), or a mask."
        )
    ends = margin is not None or against is not None
    sums, rows = added(sequence, given, tell, ends=ends)
    notes: tuple[str, ...] = ()
    if not every_frame:
        chosen = _chosen(rows, rate)
        notes = _left_out(chosen, rows)
        if chosen.why:
            sums, rows = _again(sequence, chosen, given, rows, tell, ends)
    shape = rows.shape
    given = fitting(given, rows)
    if margin is not None and rows.ends is not None:
        inside = lit_region(rows.ends[0] - rows.ends[1], margin if margin >= 0 else None)
    else:
        inside = np.full(shape, True) if region is None else outlined(region, shape)
    zones = None if truth is None else _zones(truth, shape)
    mask = None if against is None or of_part else outlined(against, shape)
    tell("fusing")
    aspect = sums.fused()
    rows.check()
    shading = shading_of(dark, flat, shape, colour, tell)
    aspect = shading.corrected(aspect, given.sequence.fusion, inside)
    tell("segmenting")
    ceiling, untold, said = ceiling_for(
        rows.samples, aspect, inside, given, lit_as_said=lit_as_said, rate=rate
    )
    found = inspect_image(aspect, inside, given, ceiling=ceiling, untold=untold)
    edge = None
    if against is not None and rows.ends is not None:
        tell("comparing the outline")
        edge = silhouette_of(given, *rows.ends, mask=mask, laid=False, tolerance_px=tolerance)
    named = {"dark": dark, "flat": flat, "region": region}
    made_with = {
        name: "given" if not isinstance(one, (str, Path)) else Path(one).name
        for name, one in named.items() if one is not None
    }  # fmt: skip
    warnings = (
        *_warnings(rows, given, assumed=station is None),
        *(unlit(rows.samples) if region is None else ()),
        *(uneven(aspect, inside, found) if not given.segmentation.background_mm else ()),
        *notes,
        *said,
    )
    if zones is None:
        nothing = np.zeros(shape, np.int32)
        return Captured(
            given, INFO, aspect, inside, found, rows.frames, nothing, made_with=made_with,
            warnings=warnings, silhouette=edge,
        )  # fmt: skip
    defects, scored, table = _scored(zones, aspect, inside, found, given)
    return Captured(
        given, INFO, aspect, inside, found, rows.frames, zones, defects, scored, table,
        made_with, warnings, edge,
    )  # fmt: skip


def _named(
    said: str | Path | Mask | None, what: str, name: str, usual: float
) -> tuple[str | Path | Mask | None, float]:
    """Return what is said without the number of pixels after its last colon, and that."""
    if not isinstance(said, str):
        return said, usual
    start, colon, pixels = said.rpartition(":")
    if not colon:
        return said, usual
    try:
        return start, float(pixels)
    except ValueError:
        if start == name:
            raise FrameError(
                f"{what} {said!r} has no number of pixels after its colon; write e.g. {name}:2.5."
            ) from None
    return said, usual


def _found(region: str | Path | Mask | None) -> float | None:
    """Return the margin of a region that is to be found, -1 for the usual; None: it is named."""
    if not isinstance(region, str) or not region.startswith("found"):
        return None
    _, _, margin = region.partition(":")
    if region == "found":
        return -1.0
    try:
        pixels = float(margin)
    except ValueError:
        pixels = -1.0
    if not 0 <= pixels < np.inf:
        raise FrameError(f"the region {region!r} has no margin in pixels; write e.g. found:25.")
    return pixels


def _chosen(seen: Seen, rate: float | None) -> Periods:
    """Return which frames are used, or say how all are if one does not belong to them."""
    try:
        return whole_periods(seen.samples, [frame.name for frame in seen.frames], rate=rate)
    except FrameError as error:
        raise FrameError(
            f"{error} If all of them are meant, take them with --every-frame."
        ) from None


def _left_out(chosen: Periods, seen: Seen) -> tuple[str, ...]:
    """Say which frames are used, where they are not all, or are no whole period."""
    names = [frame.name for frame in seen.frames]
    ends = f"{names[chosen.first]} to {names[chosen.last - 1]}"
    said = [f"{names[k]} is left out: {why}." for k, why in sorted(chosen.why.items())]
    if chosen.whole and said:
        count = chosen.last - chosen.first
        said.append(f"{ends}, {count} frames, are whole periods of the light; they are used.")
    if chosen.whole is False:
        said.append(
            f"{ends} are no whole period of the light, as far as they tell: stripes are left in "
            f"the mean. Take frames until the first comes again."
        )
    return tuple(said)


def _again(
    sequence: Sequenced, chosen: Periods, station: Station, seen: Seen,
    tell: Callable[[str], None], ends: bool,
) -> tuple[Accumulator, Seen]:  # fmt: skip
    """Add up the frames that are used, and keep what is known of the others."""
    used = range(chosen.first, chosen.last)
    sums, rows = added(sequence.only(used), station, tell, ends=ends)
    frames = tuple(
        rows.frames[k - chosen.first] if k in used
        else replace(frame, used=False, why=chosen.why.get(k, ""))
        for k, frame in enumerate(seen.frames)
    )  # fmt: skip
    return sums, replace(rows, frames=frames)


def _zones(truth: str | Path | NDArray[Any], shape: tuple[int, int]) -> NDArray[np.int32]:
    """Return the zones of known defects, numbered without gaps in their order."""
    if isinstance(truth, np.ndarray):
        zones, name = truth, "the truth"
    else:
        import tifffile

        name = str(truth)
        try:
            zones = tifffile.imread(truth)
        except Exception as error:  # a damaged file fails in as many ways as it has bytes
            raise FrameError(f"{name} cannot be read as a label image: {error}.") from None
    if zones.dtype.kind not in "iu" or zones.shape != shape:
        raise FrameError(
            f"{name} is {zones.dtype} of {zones.shape} and the frames are {shape}; a truth image "
            f"holds whole numbers, 0 where flawless, for each pixel of a frame."
        )
    if zones.size and int(zones.min()) < 0:
        raise FrameError(f"{name} holds {zones.min()}; zones are numbered from 1, 0 is flawless.")
    return zones.astype(np.int32)


def _scored(
    zones: NDArray[np.int32], aspect: Image, inside: Mask, found: Inspection, station: Station
) -> tuple[tuple[Zone, ...], Score, Confusion]:
    """Return the known defects, the score against them, and what they were taken for."""
    measured = measure_blobs(
        zones, aspect, sampling_mm=station.camera.sampling_mm, flawless_dn=found.flawless_dn
    )
    axes = {
        int(row["label"]): (float(row["minor_mm"]), float(row["major_mm"]))
        for row in measured.rows()
    }
    count = int(zones.max(initial=0))
    sizes = [axes.get(number, (0.0, 0.0)) for number in range(1, count + 1)]
    defects = tuple(
        Zone("defect", minor, major if major > _LONG * minor else 0.0) for minor, major in sizes
    )
    kinds = [one.kind for one in defects]
    return (
        defects,
        score(found.labels, zones, inside, count),
        confusion(kinds, zones, found.labels, found.classes),
    )


def _warnings(seen: Seen, station: Station, *, assumed: bool) -> tuple[str, ...]:
    said = []
    if assumed:
        said.append(
            f"no station was given: camera.sampling_mm = {station.camera.sampling_mm:g} is "
            f"assumed, so lengths in mm are not the part's; name a station file with --station."
        )
    saturated = float(np.mean([frame.saturated for frame in seen.frames if frame.used]))
    if saturated == 0 and station.sequence.fusion == "mean":
        said.append(
            "no pixel of any frame is saturated: the mean over a whole period then has no "
            "contrast. Expose 2 to 4 times as long."
        )
    if len(seen.frames) == 1:
        said.append(f"there is one frame, {seen.frames[0].name}: it is inspected as it is.")
    return tuple(said)


def replayed(
    frames: Given, found: Captured, exposures: Sequence[float], *, colour: Colour | None = None,
    gaps: bool = False,
) -> Replay:  # fmt: skip
    """Take the frames of an inspection again at other exposures.

    Parameters
    ----------
    frames : as of :func:`inspect`
    found : Captured
        What :func:`inspect` found in them: its frames and its region are used.
    exposures : sequence of float
        Over that of the frames.
    colour, gaps
        As of :func:`inspect`.

    Raises
    ------
    FrameError
        As of :func:`gpuspec.frames.replay.replay`.
    """
    used = [number for number, row in enumerate(found.frames) if row.used]
    sequence = Sequenced.of(frames, colour=colour, gaps=gaps).only(range(used[0], used[-1] + 1))
    region = found.lost == 0 if found.made_with.get("region") else None
    full = found.station.sensor.full_scale_dn
    return replay((frame for _, frame in sequence), exposures, full, region)
