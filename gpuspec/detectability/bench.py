"""From a random part to a row of trials: its defects, their signals, hits, and false calls."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from threading import Event
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE
from gpuspec.detectability.laid import Laid
from gpuspec.detectability.plan import TrialPlan
from gpuspec.detectability.seen import Ints, Levels, Seen
from gpuspec.detection.background import robust_sigma
from gpuspec.detection.connected import connected_pixels
from gpuspec.detection.false_blobs import least_pixels
from gpuspec.detection.inspection import Inspection, inspect
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.ceiling import ceiling_of, untold
from gpuspec.light.constants import NO_PIXEL
from gpuspec.light.levels import Zones, thresholds
from gpuspec.light.light_map import in_closed_form
from gpuspec.part.guard import widened
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.part.view import pixel_position
from gpuspec.simulation.cautions.detection import why_beyond
from gpuspec.station.station import Station
from gpuspec.sweeps.trying.columns import column
from gpuspec.sweeps.trying.flawless import Flawless
from gpuspec.sweeps.trying.listing import Listing
from gpuspec.sweeps.trying.parts import StoppedError
from gpuspec.version import __version__

NOISE_SIGMAS = 3.0
"""Robust deviations of the flawless surface up to which a signal is noise."""

WINDOW_PX = 8
"""Around a detected pixel of the sample, so far each way, its blob is looked for."""

_WINDOWS = 64  # of a part; more tell no more
_GROWN = 8  # windows, one around the other, in which the rest of a blob is looked for
_EDGE_MOST = 2048  # pixels beside blobs that reach beyond; of more the surface is flooded
_WORDS = pa.dictionary(pa.int32(), pa.string())
_TRIALS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("kind", pa.string(), "of the defect"),
    ("x_mm", pa.float64(), "its centre"),
    ("y_mm", pa.float64(), "its centre"),
    ("size_mm", pa.float64(), "its diameter or width"),
    ("length_mm", pa.float64(), "of a scratch, else 0"),
    ("depth_um", pa.float64(), "its depth, or height of a bump"),
    ("zone_px", pa.int64(), "pixels of its zone"),
    ("signal_dn", pa.float64(), "brightest of them above the flawless level; NaN: none"),
    ("hit", pa.bool_(), "whether a blob of the least area or more has one of them"),
)
"""Lists of a row, a value for each defect of a population in view."""

TRIALS = tuple(name for name, _, _ in _TRIALS)
"""Names of these."""

_COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("design", pa.int64(), "number of the row: station times parts, plus part"),
    ("reason", pa.string(), "why the station is none; null: it is one"),
    ("caution", pa.string(), "why its automatic threshold detects nothing; null: it may"),
    ("threshold_dn", pa.float64(), "of the station; auto: that of its first part, held"),
    ("flawless_dn", pa.float64(), "median of its first part"),
    ("noise_dn", pa.float64(), "signal up to which it may be noise"),
    ("full_dn", pa.float64(), "highest grey level"),
    ("near_false", pa.int64(), "false blobs near defects"),
    ("drawn", pa.int64(), "pixels drawn of the rest, near no defect"),
    ("drawn_false", pa.float64(), "false blobs of these, a blob shared among its pixels"),
    ("rest_px", pa.int64(), "pixels of the rest"),
    ("clear", pa.bool_(), "whether no pixel of the rest can be above the threshold"),
    *((name, pa.list_(kind), said) for name, kind, said in _TRIALS),
    *((name, _WORDS, "") for name in ("backend", "device", "driver", "version", "gpuspec")),
)
SCHEMA = pa.schema([pa.field(name, kind, metadata={"is": said}) for name, kind, said in _COLUMNS])
"""Of the table: a row for each part."""


@dataclass(frozen=True)
class Held:
    """What is taken once of a station, from the whole image of its first part.

    Attributes
    ----------
    inspection : Inspection
        Its threshold is held for all parts.
    noise_dn : float
        Signal up to which it may be noise.
    on_part : int
        Pixels on the part.
    caution : str or None
        Why an automatic threshold is beyond full scale and detects nothing; None: it is not.
    """

    inspection: Inspection
    noise_dn: float
    on_part: int
    caution: str | None

    @classmethod
    def of(cls, station: Station, backend: Backend) -> Held:
        """Inspect the first part, whole.

        Parameters
        ----------
        station : Station
        backend : Backend
        """
        with backend.trace(station) as light_map:
            aspect, lost = light_map.counted(), light_map.lost()
        on_part, lit = lost != BESIDE, lost == 0
        found = inspect(aspect, on_part, station, lit, ceiling_of(station), untold(station))
        noise = NOISE_SIGMAS * robust_sigma(aspect[lit if lit.any() else on_part])
        beyond = station.segmentation.threshold == "auto" and (
            found.threshold >= station.sensor.full_scale_dn
        )
        caution = why_beyond(station, aspect, lit, found) if beyond else None
        return cls(found, float(noise), int(on_part.sum()), caution)


class TrialBench:
    """A device on which parts of one plan are tried.

    Parameters
    ----------
    plan : TrialPlan
    backend : Backend

    Attributes
    ----------
    stopped : threading.Event
        Set from another thread, it ends the work after a part by StoppedError.
    """

    def __init__(self, plan: TrialPlan, backend: Backend) -> None:
        self.plan = plan
        self.backend = backend
        self.stopped = Event()
        self._station = lru_cache(maxsize=4)(self.plan.plan.station_of)
        self._held = lru_cache(maxsize=4)(lambda n: Held.of(self._station(n), backend))
        self._flawless = lru_cache(maxsize=1)(lambda n: Flawless(self._station(n), backend))
        self._clear = lru_cache(maxsize=64)(self._is_clear)

    def rows(self, designs: Sequence[int], *, sampled: bool) -> pa.Table:
        """Try some parts.

        Parameters
        ----------
        designs : sequence of int
            Numbers of rows.
        sampled : bool
            Not asked: nothing but a sample is ever traced, of all parts but the first.

        Raises
        ------
        BackendError
            If the device fails.
        """
        found = []
        with ThreadPoolExecutor(1, "gpuspec-pod") as ahead:
            begun = ahead.submit(self._laid, designs[0])
            for number, following in zip(designs, (*designs[1:], None), strict=True):
                if self.stopped.is_set():
                    raise StoppedError
                laid = begun
                if following is not None:
                    begun = ahead.submit(self._laid, following)
                try:
                    row = self._tried(laid.result())
                except StationError as error:
                    row = {"reason": str(error)}
                found.append({"design": number, **row})
        return _table(found)

    def _laid(self, design: int) -> Laid:
        """Lay out a part, which needs no device: meanwhile that traces the one before."""
        number, part = divmod(design, self.plan.parts)
        return Laid.of(number, self._station(number), part, self.plan.plan.samples)

    def _tried(self, laid: Laid) -> dict[str, Any]:
        number, part, station, relief = laid.number, laid.part, laid.station, laid.relief
        truth, listing, held = laid.truth, laid.listing, self._held(laid.number)
        threshold = held.inspection.threshold
        seen = Seen.listed(station, relief, listing, self.backend)
        rule, sampling_mm = station.segmentation, station.camera.sampling_mm
        least = max(least_pixels(rule.min_area_mm2, sampling_mm), 1)
        owner = truth.labels.ravel()
        itself = np.sort(listing.itself).astype(np.int64)
        levels = seen.at(itself)
        inside = owner[itself]
        pixels, around = self._grown(laid, itself, levels, threshold)
        blob = _blobs(around, pixels, threshold, station.shape[1], least)[
            np.searchsorted(pixels, itself)
        ]
        true = np.unique(blob[inside != 0])
        hit = np.zeros(len(truth.defects) + 1, bool)
        hit[inside[blob > 0]] = True
        rest = held.on_part - len(itself)
        if part:
            drawn = len(listing.chosen)
            false = self._sampled(laid, itself, seen, threshold, least)
        else:
            labels = held.inspection.labels.ravel()
            there = np.zeros(labels.max(initial=0) + 1, bool)
            there[labels[itself]] = there[0] = True
            drawn, false = rest, float(np.count_nonzero(~there))
        return {
            "caution": held.caution,
            "threshold_dn": threshold,
            "flawless_dn": held.inspection.flawless_dn,
            "noise_dn": held.noise_dn,
            "full_dn": station.sensor.full_scale_dn,
            "near_false": len(np.setdiff1d(blob[blob > 0], true)),
            "drawn": drawn,
            "drawn_false": false,
            "rest_px": rest,
            "clear": self._clear(number, laid.crowded),
            **_trials(station, truth, levels, inside, hit, held.inspection.flawless_dn),
            **self.backend.info.as_dict(),
            "gpuspec": __version__,
        }

    def _grown(
        self, laid: Laid, pixels: Ints, levels: Levels, threshold: float
    ) -> tuple[Ints, Levels]:
        """Return pixels and their levels with those around false blobs that reach beyond them.

        Of a blob that goes on beyond `_GROWN` windows the pieces are counted each: the number may
        be too high then, but not too low.
        """
        shape, owner = laid.station.shape, laid.truth.labels.ravel()
        for _ in range(_GROWN):
            blob = _blobs(levels, pixels, threshold, shape[1], 1)
            true = np.unique(blob[owner[pixels] != 0])
            false = pixels[(blob > 0) & ~np.isin(blob, true)]
            more = _beside(false, pixels, shape)
            if not 0 < len(more) <= _EDGE_MOST:
                break
            more = np.setdiff1d(widened(more, shape, WINDOW_PX - 1), pixels, assume_unique=True)
            seen = Seen.of(laid.station, laid.relief, more.astype(np.uint32), self.backend)
            pixels, levels = np.append(pixels, more), np.append(levels, seen.at(more))
            order = np.argsort(pixels)
            pixels, levels = pixels[order], levels[order]
        return pixels, levels

    def _sampled(self, laid: Laid, itself: Ints, seen: Seen, threshold: float, least: int) -> float:
        """Return how many false blobs the drawn pixels are of, each a share of its blob's pixels.

        Over all pixels these shares add up to the number of blobs; a blob that reaches what stands
        for itself is counted there. Of a blob that reaches beyond the window the share is too
        large: the number may be too high then, but not too low.
        """
        station, owner, listing = laid.station, laid.truth.labels.ravel(), laid.listing
        chosen = np.sort(listing.pixels[listing.chosen]).astype(np.int64)
        above = chosen[seen.at(chosen) > threshold]
        if not len(above):
            return 0.0
        some = above[np.unique(np.linspace(0, len(above) - 1, _WINDOWS).astype(np.intp))]
        around = widened(some, station.shape, WINDOW_PX)
        near = Seen.of(station, laid.relief, around.astype(np.uint32), self.backend)
        blob = _blobs(near.levels, around, threshold, station.shape[1], least)
        size = np.bincount(blob)
        size[np.unique(blob[(owner[around] != 0) | np.isin(around, itself)])] = 0
        size[0] = 0
        size = size[blob[np.searchsorted(around, some)]]
        share = np.divide(1.0, size, out=np.zeros(len(some)), where=size > 0)
        return float(share.mean() * len(above))

    def _is_clear(self, number: int, crowded: int) -> bool:
        """Whether nothing is above the threshold where no defect is near, for certain.

        Parameters
        ----------
        number : int
            Of the station.
        crowded : int
            How many defects may be near.
        """
        station, threshold = self._station(number), self._held(number).inspection.threshold
        # No shape tells of a part's own relief, nor of a posed part; lists alone have a ceiling.
        if not (self.backend.screens and in_closed_form(station)):
            return False
        if station.part.uneven or station.posed:
            return False
        bounds = self._flawless(number).bounds(station, crowded)
        pixels = np.full(16, NO_PIXEL, np.uint32)
        pixels[0] = 0
        some, none = np.arange(16, dtype=np.uint32), np.zeros(0, np.uint32)
        zones = Zones(none, np.zeros(1, np.int64), np.ones((1, 16), np.bool_))
        listing = Listing(pixels, zones, none, some, 1)
        one = station.model_copy(
            update={"camera": station.camera.model_copy(update={"subsampling": 1})}
        )
        with self.backend.traced(one, Relief.of(one, placed=()), pixels) as light_map:
            levels = light_map.counter(zones, listing.sample(bounds)).count([one])
        full = station.sensor.full_scale_dn
        return bool(thresholds(full)[levels.ceiling[0]] <= threshold)


def bench_of(plan: str, backend: Backend) -> TrialBench:
    """Return the bench of a plan.

    Parameters
    ----------
    plan : str
        See :meth:`TrialPlan.message`.
    backend : Backend
    """
    return TrialBench(TrialPlan.from_message(plan), backend)


def _beside(some: Ints, pixels: Ints, shape: tuple[int, int]) -> Ints:
    """Return the neighbours of some pixels that are not among all of them, ascending."""
    around = widened(some, shape)
    at = np.minimum(np.searchsorted(pixels, around), len(pixels) - 1)
    return around[pixels[at] != around] if len(around) else around


def _blobs(levels: Levels, pixels: Ints, threshold: float, columns: int, least: int) -> Ints:
    """Return the number of the blob of each of some pixels, ascending; 0: of none."""
    above = np.flatnonzero(levels > threshold)
    found = np.zeros(len(pixels), np.int64)
    found[above] = connected_pixels(pixels[above], columns, least)
    return found


def _trials(
    station: Station, truth: Truth, levels: Levels, inside: NDArray[np.int32],
    hit: NDArray[np.bool_], flawless: float,
) -> dict[str, Any]:  # fmt: skip
    """Return the trials: the defects of the populations whose centre is in the image."""
    peak = np.full(len(truth.defects) + 1, -np.inf, np.float32)
    np.maximum.at(peak, inside, levels)
    zone = np.bincount(inside, minlength=len(peak))
    # The station's own defects come first; zones of measured relief after all that are placed.
    placed = range(len(station.defects), len(truth.defects))
    of = [i for i in placed if truth.defects[i].kind in ("dent", "bump", "scratch")]
    centres = np.array([[truth.defects[i].x_mm, truth.defects[i].y_mm] for i in of]).reshape(-1, 2)
    place = pixel_position(centres, station)
    in_image = np.all((place >= 0) & (place < station.shape[::-1]), axis=1)
    some = [of[nth] for nth in np.flatnonzero(in_image)]
    signal = np.where(np.isfinite(peak), peak.astype(np.float64) - flawless, np.nan)
    own = {
        name: [getattr(truth.defects[i], name) for i in some]
        for name in ("kind", "x_mm", "y_mm", "size_mm", "length_mm", "depth_um")
    }
    at = [i + 1 for i in some]
    return {**own, "zone_px": zone[at], "signal_dn": signal[at], "hit": hit[at]}


def _table(rows: Sequence[dict[str, Any]]) -> pa.Table:
    columns = []
    for field in SCHEMA:
        values = [row.get(field.name) for row in rows]
        if pa.types.is_list(field.type):
            lists = [[] if v is None else v for v in values]
            ends = column(np.cumsum([0, *map(len, lists)]), pa.int32())
            every = [one for v in lists for one in v]
            columns.append(pa.ListArray.from_arrays(ends, column(every, field.type.value_type)))
        elif any(v is None for v in values) and not pa.types.is_string(field.type):
            columns.append(pa.array(values, field.type))
        else:
            columns.append(column(values, field.type))
    return pa.Table.from_arrays(columns, schema=SCHEMA)
