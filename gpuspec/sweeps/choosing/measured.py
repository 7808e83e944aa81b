"""The measures of a table's designs at every threshold: what each has for certain."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute
from numpy.typing import NDArray

from gpuspec.detection.chances import least_share
from gpuspec.light.constants import LEVELS
from gpuspec.station.costs import COSTS
from gpuspec.station.sections import Sensor
from gpuspec.sweeps.choosing.front import curves, p1_bounds
from gpuspec.sweeps.rule import f1_of
from gpuspec.sweeps.trying.curves import KINDS

Floats = NDArray[np.float64]

COLUMNS = ("design", "exact", "draws", "defects", "p1", "p2", "hits", "worst_hits", "worst_p2",
           "p1_low", "p1_high", "false_px", "peaks", "kinds", "margin_dn", "margin_high_dn",
           "margin_sigma", "noise_dn", "smallest_mm", *COSTS)  # fmt: skip
"""Of a sweep's table."""

BITS = "sensor.bit_depth"
"""A column, too, where it is varied."""

DRAWN_SIGMAS = 6.0
"""By how many deviations a draw of the noise may move a margin: the highest of a million flawless
pixels is five above its mean, the brightest of a defect's own some less."""

_SENSOR = Sensor()


@dataclass(frozen=True)
class Measured:
    """D designs at every threshold.

    Attributes
    ----------
    design : ndarray of int64, shape (D,)
    exact : ndarray of bool, shape (D,)
    values : dict of str to ndarray
        By the name of the measure, and ``room``; shape (D, 256) or (D, 1). Where a design is
        screened what it has at least: the least P1 and margin, the most false pixels. False blobs
        are no more than false pixels, and are none where these are none: they are counted of the
        designs that may be chosen alone.
    spans : dict of str to two ndarray of shape (D, 1)
        Between which both margins are: a level of the table stands for all from the one below it
        on, so that the difference of two is off by less than one, each way; with noise by
        `DRAWN_SIGMAS` more, for the table is of one draw.
    weakest, flawless : ndarray of int64, shape (D,)
        Level of the faintest defect that must be hit, and the highest of what is flawless.
    """

    design: NDArray[np.int64]
    exact: NDArray[np.bool_]
    values: dict[str, Floats]
    spans: dict[str, tuple[Floats, Floats]]
    weakest: NDArray[np.int64]
    flawless: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        table: pa.Table,
        names: Collection[str],
        least_hits: int | None = None,
        sensor: Sensor = _SENSOR,
    ) -> Measured | None:
        """Read the valid designs of a table with `COLUMNS`; None if there are none.

        Parameters
        ----------
        table : pyarrow.Table
        names : collection of str
            Measures that are wanted.
        least_hits : int, optional
            How many defects must be hit, the others, the faintest, may be missed; None: all.
        sensor : Sensor
            Of the sweep's station.
        """
        table = table.filter(pa.compute.is_valid(table["exact"]))
        if not len(table):
            return None
        false = curves(table, "false_px")
        row, peaks, kinds = _defects(table)
        count = np.bincount(row, minlength=len(table))
        rising = peaks[np.lexsort((peaks, row))]
        spared = np.maximum(count - (count if least_hits is None else least_hits), 0)
        at = np.cumsum(count) - count + np.minimum(spared, count - 1)
        weakest = np.where(count > spared, np.append(rising, 0)[at], LEVELS - 1)
        flawless = (false > 0).sum(axis=1)
        level = np.arange(LEVELS)
        room = np.minimum(level - flawless[:, None], weakest[:, None] - 1 - level)
        low, _ = p1_bounds(table)
        values = {
            "p1": low, "p2": curves(table, "p2"), "hits": curves(table, "hits"),
            "false_px": false, "false_blobs": false, "room": room.astype(np.float64),
            **{name: _column(table, name) for name in
               ("margin_dn", "margin_sigma", "noise_dn", "smallest_mm", *COSTS)},
        }  # fmt: skip
        for name in {"worst_hits", "worst_p2"}.intersection(names):
            one = table[name].null_count  # there is one part under one draw
            values[name] = values[name.removeprefix("worst_")] if one else curves(table, name)
        if "sure_hit_share" in names:
            # Draws of the noise on one part are no trials of other defects.
            draws, defects = (table[name].to_numpy()[:, None] for name in ("draws", "defects"))
            values["sure_hit_share"] = least_share(values["hits"] / draws, defects / draws)
        if "f1" in names:
            values["f1"] = f1_of(values["p1"], values["p2"])
        for code, kind in enumerate(KINDS):
            if f"hits.{kind}" in names:
                counts = np.zeros((len(table), LEVELS))
                own = kinds == code
                np.add.at(counts, (row[own], peaks[own]), 1)
                above = np.zeros_like(counts)
                above[:, :-1] = counts[:, :0:-1].cumsum(axis=1)[:, ::-1]
                values[f"hits.{kind}"] = above
        return cls(
            table["design"].to_numpy(), table["exact"].to_numpy(), values,
            _spans(table, sensor), weakest, flawless,
        )  # fmt: skip


def counts_of_kinds(table: pa.Table) -> dict[str, int]:
    """Return how many defects of each kind a design of a table has at most, by ``hits.KIND``.

    Parameters
    ----------
    table : pyarrow.Table
        With `COLUMNS`.
    """
    row, _, kinds = _defects(table.filter(pa.compute.is_valid(table["exact"])))
    return {
        f"hits.{kind}": int(np.bincount(row[kinds == code]).max(initial=0))
        for code, kind in enumerate(KINDS)
    }


def _defects(table: pa.Table) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return row, peak and kind of every defect of every design."""
    peaks, kinds = (table[name].combine_chunks() for name in ("peaks", "kinds"))
    lengths = pa.compute.list_value_length(peaks).to_numpy(zero_copy_only=False)
    row = np.repeat(np.arange(len(table)), lengths.astype(np.intp))
    return row, *(column.flatten().to_numpy().astype(np.intp) for column in (peaks, kinds))


def _spans(table: pa.Table, sensor: Sensor) -> dict[str, tuple[Floats, Floats]]:
    """Return between which both margins of each design are."""
    bits = _column(table, BITS) if BITS in table.column_names else np.array(1.0 * sensor.bit_depth)
    noise = _column(table, "noise_dn")
    off = (2**bits - 1) / (LEVELS - 1) + (
        DRAWN_SIGMAS * np.nan_to_num(noise) if sensor.noise else 0
    )
    low, high = _column(table, "margin_dn") - off, _column(table, "margin_high_dn") + off
    noise = np.where(noise > 0, noise, np.nan)
    return {"margin_dn": (low, high), "margin_sigma": (low / noise, high / noise)}


def _column(table: pa.Table, name: str) -> Floats:
    """Return numbers of shape (D, 1), NaN where null."""
    values: Floats = table[name].to_numpy(zero_copy_only=False).astype(np.float64)
    return values[:, None]
