"""A sweep's table: one row per design, as Arrow holds it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa

from gpuspec import words
from gpuspec.detection.score import precision, recall
from gpuspec.light.backend import DeviceInfo
from gpuspec.light.constants import LEVELS
from gpuspec.light.levels import thresholds
from gpuspec.station.costs import COSTS, costs
from gpuspec.station.station import Station
from gpuspec.sweeps.plan import SEED_STEP, Plan
from gpuspec.sweeps.rule import Rule, f1_of
from gpuspec.sweeps.trying.columns import column, known
from gpuspec.sweeps.trying.curves import KINDS, Curves
from gpuspec.sweeps.trying.found import smallest_found
from gpuspec.version import __version__

_CURVE = pa.list_(pa.float64(), LEVELS)
_WHOLE = pa.list_(pa.int32(), LEVELS)
KINDS_TOLD = ", ".join(f"{code} {kind}" for code, kind in enumerate(KINDS))
_COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("reason", pa.string(), "why the design is no valid station; null: it is"),
    ("notes", pa.string(), "what to know before trusting the scores, a line each; null: nothing"),
    ("exact", pa.bool_(), "whether every pixel was counted; else P1 is estimated from a sample"),
    ("seeds", pa.list_(pa.uint32()), "what is added to every seed of the station, for each part"),
    ("draws", pa.int32(), "draws of the noise on each part"),
    ("defects", pa.int32(), "known defects with a pixel in view, of all parts and draws"),
    ("zone_px", pa.int64(), "pixels of their zones"),
    ("threshold_dn", pa.float64(), "best threshold"),
    ("best_p1", pa.float64(), f"{words.P1} there; {words.BEST}"),
    ("best_p2", pa.float64(), f"{words.P2} there; {words.BEST}"),
    ("best_f1", pa.float64(), "F1 there"),
    ("best_hits", pa.int32(), "defects hit there"),
    ("part_p1", pa.list_(pa.float64()), f"{words.P1} there of each part, draw by draw"),
    ("part_p2", pa.list_(pa.float64()), f"{words.P2} there of each part, draw by draw"),
    ("part_hits", pa.list_(pa.int32()), "defects hit there of each part, draw by draw"),
    ("p1", _CURVE, f"{words.P1} at each threshold"),
    ("p2", _CURVE, f"{words.P2} at each threshold"),
    ("hits", _WHOLE, "defects hit at each threshold"),
    ("worst_hits", _WHOLE, "defects hit at each threshold on the worst part or draw; null: one"),
    ("worst_p2", _CURVE, f"{words.P2} likewise"),
    ("p1_low", _CURVE, "least P1 there may be, where P1 is estimated"),
    ("p1_high", _CURVE, "greatest P1 there may be, where P1 is estimated"),
    ("margin_dn", pa.float64(), "level of the faintest defect less the highest flawless one"),
    ("margin_high_dn", pa.float64(), "the most it may be, where it is the least it may be"),
    ("flawless_dn", pa.float64(), "highest level of what is flawless"),
    ("noise_dn", pa.float64(), "standard deviation of the flawless surface's noise"),
    ("margin_sigma", pa.float64(), "margin in such deviations"),
    ("smallest_mm", pa.float64(), "size from which on every defect stands above what is flawless"),
    ("smallest_margin_dn", pa.float64(), "by how much the faintest of these does"),
    ("images", pa.int32(), "images of a part"),
    ("tunnel_mm", pa.float64(), "length of the tunnel"),
    ("light_e", pa.float64(), "electrons per image of a fully luminous footprint"),
    ("exposure_s", pa.float64(), "exposure time; null: the light's strength is not told"),
    ("cycle_s", pa.float64(), "time per part; null: neither that nor the frame rate is told"),
    ("false_px", _WHOLE, "detected pixels beyond zones and guard band, the most there may be"),
    ("peaks", pa.list_(pa.uint8()), "level of each defect in view: hit by thresholds below it"),
    ("kinds", pa.list_(pa.uint8()), f"of these defects: {KINDS_TOLD}"),
    ("sizes_mm", pa.list_(pa.float32()), "of these defects: diameter, or width"),
    ("backend", pa.dictionary(pa.int32(), pa.string()), ""),
    ("device", pa.dictionary(pa.int32(), pa.string()), ""),
    ("driver", pa.dictionary(pa.int32(), pa.string()), ""),
    ("version", pa.dictionary(pa.int32(), pa.string()), "of the driver"),
    ("gpuspec", pa.dictionary(pa.int32(), pa.string()), "version"),
)

_MOST = 2**31 - 1

RULE = Rule()
"""By which a row's threshold is the best."""


def schema(plan: Plan) -> pa.Schema:
    """Return the table's columns, each with what it means."""
    return _schema(tuple((a.key, isinstance(a.values[0], int)) for a in plan.axes))


@lru_cache(maxsize=8)
def _schema(axes: tuple[tuple[str, bool], ...]) -> pa.Schema:
    """Return the columns of a table that varies such keys, whole numbers or not."""
    varied = [pa.field(key, pa.int64() if whole else pa.float64()) for key, whole in axes]
    fields = [pa.field(name, kind, metadata={"is": text}) for name, kind, text in _COLUMNS]
    return pa.schema([pa.field("design", pa.int64()), *varied, *fields])


def rows(
    plan: Plan,
    designs: Sequence[int],
    stations: Sequence[Station],
    curves: Curves,
    info: DeviceInfo,
    notes: Sequence[str | None],
    noise_dn: Sequence[float],
) -> pa.Table:
    """Return the rows of valid designs.

    Parameters
    ----------
    plan : Plan
    designs : sequence of int
        Their numbers.
    stations : sequence of Station
        The same, as stations.
    curves : Curves
        How they do.
    info : DeviceInfo
    notes : sequence of str or None
        What to know of each.
    noise_dn : sequence of float
        Of the flawless surface of each; NaN: not known.
    """
    p1, p2, hits = curves.p1, curves.p2, curves.hits.sum(axis=0)
    seen, count = int(curves.seen.sum()), len(designs)
    at = RULE.thresholds(p1, p2, hits, seen)
    pick = np.arange(count), at
    part_hit, part_false, part_hits = (
        part[:, pick[0], pick[1]].T for part in (curves.hit_px, curves.false_px, curves.hits)
    )
    scale = {full: thresholds(full) for full in {s.sensor.full_scale_dn for s in stations}}
    sampled, several = ~curves.exact, np.full(count, plan.inspections > 1)
    columns: dict[str, Any] = {
        "reason": pa.nulls(count, pa.string()),
        "notes": notes,
        "exact": curves.exact,
        "seeds": _lists(np.tile(_seeds(plan), (count, 1)), pa.uint32()),
        "draws": np.full(count, plan.seeds),
        "defects": np.full(count, seen),
        "zone_px": np.full(count, curves.zone_px.sum()),
        "threshold_dn": [float(scale[s.sensor.full_scale_dn][t])
                         for s, t in zip(stations, at, strict=True)],
        "best_p1": p1[pick],
        "best_p2": p2[pick],
        "best_f1": f1_of(p1[pick], p2[pick]),
        "best_hits": hits[pick],
        "part_p1": _lists(precision(part_hit, part_false), pa.float64()),
        "part_p2": _lists(recall(part_hit, curves.zone_px), pa.float64()),
        "part_hits": _lists(part_hits, pa.int32()),
        "p1": _curves(p1),
        "p2": _curves(p2),
        "hits": _curves(hits, pa.int32()),
        "worst_hits": _curves(curves.worst_hits, pa.int32(), where=several),
        "worst_p2": _curves(curves.worst_p2, where=several),
        "p1_low": _curves(curves.p1_low, where=sampled),
        "p1_high": _curves(curves.p1_high, where=sampled),
        **_margins(curves, stations, noise_dn),
        **_costs(stations),
        "false_px": _curves(np.minimum(curves.stray_high, _MOST), pa.int32()),
        "peaks": _lists(curves.peaks, pa.uint8()),
        "kinds": _lists(np.tile(curves.kinds, (count, 1)), pa.uint8()),
        "sizes_mm": _lists(np.tile(curves.sizes_mm, (count, 1)), pa.float32()),
        **{name: [value] * count for name, value in info.as_dict().items()},
        "gpuspec": [__version__] * count,
    }  # fmt: skip
    return _table(plan, designs, columns)


def _margins(
    curves: Curves, stations: Sequence[Station], noise_dn: Sequence[float]
) -> dict[str, Any]:
    """Return margin, noise and the smallest defect found of each design, in DN."""
    step = np.array([s.sensor.full_scale_dn / (LEVELS - 1) for s in stations])
    margin = (curves.weakest - curves.flawless_high) * step
    noise = np.asarray(noise_dn, np.float64)
    smallest, above = smallest_found(curves.peaks, curves.sizes_mm, curves.flawless_high)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = margin / noise
    found = {
        "margin_dn": margin,
        "margin_high_dn": (curves.weakest - curves.flawless_low) * step,
        "flawless_dn": curves.flawless_high * step,
        "noise_dn": noise,
        "margin_sigma": sigmas,
        "smallest_mm": smallest,
        "smallest_margin_dn": above * step,
    }
    return {name: known(values) for name, values in found.items()}


def _costs(stations: Sequence[Station]) -> dict[str, Any]:
    found = [costs(station) for station in stations]
    told = {name: [one[name] for one in found] for name in COSTS}
    return {name: v if name == "images" else known(v) for name, v in told.items()}


def invalid_rows(plan: Plan, reasons: dict[int, str]) -> pa.Table:
    """Return the rows of designs that are no valid station: their values and the reason.

    Parameters
    ----------
    plan : Plan
    reasons : dict of int to str
        Number of the design, and why.
    """
    columns: dict[str, Any] = {
        name: pa.nulls(len(reasons), kind) for name, kind, _ in _COLUMNS if name != "reason"
    }
    return _table(plan, list(reasons), {**columns, "reason": list(reasons.values())})


def _table(plan: Plan, designs: Sequence[int], columns: dict[str, Any]) -> pa.Table:
    values = [plan.values(design) for design in designs]
    varied = {a.key: [v[a.key] for v in values] for a in plan.axes}
    every = {"design": designs, **varied, **columns}
    fields = schema(plan)
    return pa.Table.from_arrays([column(every[f.name], f.type) for f in fields], schema=fields)


def _seeds(plan: Plan) -> np.ndarray[Any, np.dtype[np.uint32]]:
    return np.array([part * SEED_STEP % 2**32 for part in range(plan.parts)], np.uint32)


def _lists(values: np.ndarray[Any, Any], kind: pa.DataType) -> pa.Array:
    """Return an array (D, n) as lists."""
    count, length = values.shape
    ends = column(np.arange(count + 1) * length, pa.int32())
    return pa.ListArray.from_arrays(ends, column(values.ravel(), kind))


def _curves(
    values: np.ndarray[Any, Any], kind: pa.DataType | None = None, where: Any = None
) -> pa.Array:
    """Return an array (D, 256) as lists of that size, null but `where`."""
    flat = column(values.ravel(), kind or pa.float64())
    mask = None if where is None else column(~where, pa.bool_())
    return pa.FixedSizeListArray.from_arrays(flat, LEVELS, mask=mask)
