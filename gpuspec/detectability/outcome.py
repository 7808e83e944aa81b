"""What trials told: the curve, the sizes, false calls; as sentences, tables and a picture."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from gpuspec.detectability.curve import POD
from gpuspec.detectability.false_calls import FalseCalls
from gpuspec.detectability.fitted import Fitted
from gpuspec.detectability.mapped import SizeMap
from gpuspec.detection.chances import CONFIDENCE
from gpuspec.errors import TrialsError
from gpuspec.files import Outputs, folder_of
from gpuspec.light.backend import DeviceInfo
from gpuspec.shown import html_page, object_of
from gpuspec.station.paths import at
from gpuspec.station.station import Station
from gpuspec.station.toml import copies, keep
from gpuspec.version import __version__
from gpuspec.words import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE, CURVE, NUMBERS, TRIALS, STATION = (
    "pod.png", "pod.csv", "pod.json", "pod-trials.csv", "pod.toml",
)  # fmt: skip
STATIONS = "pod-stations.csv"
MAP, MAP_TABLE = "pod-map.png", "pod-map.csv"
_POINTS = 201  # of a curve in the table


@dataclass(frozen=True)
class Tried:
    """One of several stations.

    Attributes
    ----------
    values : dict of str to float or int
        What it has of the keys that are varied.
    sizes : dict of str to float or None
        a50, a90 and a90/95.
    applies : bool
        Whether they are to be believed.
    calls, most_calls : float
        False calls per part, and their upper bound; NaN: unknown.
    reason : str
        Why it was not chosen from; empty: it was.
    """

    values: dict[str, float | int]
    sizes: dict[str, float | None]
    applies: bool = False
    calls: float = math.nan
    most_calls: float = math.nan
    reason: str = ""


@dataclass(frozen=True)
class Worst:
    """The worst of a station's designs within its tolerances, the threshold held.

    Attributes
    ----------
    off : dict of str to float or int
        What its keys are there; empty: nothing is off.
    rank : float
        Its a90/95; infinite: it has none.
    tried : int
        How many designs were.
    reason : str
        Why it has none, or what its curve says of itself.
    """

    off: dict[str, float | int]
    rank: float
    tried: int
    reason: str = ""

    def said(self, unit: str) -> str:
        """Return it as a sentence.

        Parameters
        ----------
        unit : str
            Of the size.
        """
        where = ", ".join(f"{key} = {number(value)}" for key, value in self.off.items())
        where = where or "the station as it is"
        told = f"at most {self.rank:.3g} {unit}" if math.isfinite(self.rank) else "not known"
        return (
            f"within the tolerances, the threshold held: a90/95 is {told} in {self.tried} designs, "
            f"the worst at {where}"
        )


@dataclass(frozen=True, repr=False)
class Pod:
    """Probability of detection over a size.

    Attributes
    ----------
    size, unit : str
        What the curves are over; "x" and no unit, where a file alone tells of it.
    simulated : Fitted or None
        Hits and misses of the station.
    signals : Fitted or None
        Its signals.
    measured : tuple of Fitted
        Of files.
    false_calls : FalseCalls or None
    trials : pyarrow.Table or None
        Every trial of the station: part, kind, place, sizes, signal, hit.
    parts : int
    threshold_dn : float or None
    station : Station or None
    info : DeviceInfo or None
    notes : tuple of str
    stations : tuple of Tried
        Of which the station has the smallest a90/95; none: it is the only one.
    worst : Worst or None
        Within the station's tolerances, where that was asked for.
    map : SizeMap or None
        The a90 of the size at each of a second one, where one was asked for.
    """

    size: str
    unit: str
    simulated: Fitted | None
    signals: Fitted | None
    measured: tuple[Fitted, ...]
    false_calls: FalseCalls | None = None
    trials: pa.Table | None = None
    parts: int = 0
    threshold_dn: float | None = None
    station: Station | None = None
    info: DeviceInfo | None = None
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    stations: tuple[Tried, ...] = field(default=(), kw_only=True)
    worst: Worst | None = field(default=None, kw_only=True)
    map: SizeMap | None = field(default=None, kw_only=True)

    def __repr__(self) -> str:
        said = {str(n): finding for n, finding in enumerate(self.findings(), 1)}
        name = self.station.file if self.station else "trials of files"
        return object_of("Pod", f"{name}, over {self.label}", said)

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook."""
        from gpuspec.pictures.page import png

        return png(self.figure())

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what was found, and the picture."""
        return html_page(self, self._repr_png_())

    @property
    def label(self) -> str:
        """The size with its unit."""
        return f"{self.size}, {self.unit}" if self.unit else self.size

    @property
    def curves(self) -> tuple[Fitted, ...]:
        """What was fitted: to hits, to signals, to files."""
        return tuple(one for one in (self.simulated, self.signals, *self.measured) if one)

    def findings(self) -> tuple[str, ...]:
        """Say what was found, a sentence each."""
        said = []
        if self.stations and self.station is not None:
            told = ", ".join(
                f"{key} = {number(at(self.station, key))}" for key in self.stations[0].values
            )
            fit = sum(not one.reason for one in self.stations)
            said.append(f"smallest a90/95 of {fit:,} of {len(self.stations):,} stations: {told}")
        if self.simulated is not None:
            found = self.simulated
            said.append(
                f"{len(found.size):,} trials on {self.parts:,} parts, {self.size} "
                f"{found.size.min():.3g} to {found.size.max():.3g} {self.unit}: "
                f"{found.hit.sum():,} hits above {self.threshold_dn:.5g} DN"
            )
            said.append(f"hits: {found.said}")
        if self.worst is not None:
            said.append(self.worst.said(self.unit))
        if self.map is not None:
            said.append(self.map.said)
        if self.signals is not None and self.signals.line is not None:
            line = self.signals.line
            said.append(
                f"signals: {self.signals.said}; {line.below:,} at or below noise of "
                f"{line.noise:.3g} DN, {line.above:,} at or above saturation"
            )
        said += [f"{one.name}, {len(one.size):,} trials: {one.said}" for one in self.measured]
        if self.false_calls is not None:
            said.append(self.false_calls.said)
        return tuple(said)

    def cautions(self) -> tuple[str, ...]:
        """Say where a model does not apply and what would settle it, a sentence each."""
        return (
            tuple(f"{one.name}: {text}" for one in self.curves for text in one.verdict.said)
            + (
                (f"within the tolerances: {self.worst.reason}",)
                if self.worst and math.isinf(self.worst.rank)
                else ()
            )
            + tuple(f"map: {text}" for text in (self.map.notes if self.map else ()))
            + self.notes
        )

    def numbers(self) -> dict[str, Any]:
        """Return the figures behind the findings, as JSON holds them."""
        calls = self.false_calls
        return {
            "gpuspec": __version__,
            **(self.info.as_dict() if self.info else {}),
            "station": self.station.file if self.station else None,
            "size": self.size,
            "unit": self.unit,
            "parts": self.parts,
            "threshold_dn": self.threshold_dn,
            "pod": POD,
            "confidence": CONFIDENCE,
            "hits": self.simulated and self.simulated.numbers(),
            "signals": self.signals and self.signals.numbers(),
            "measured": [{"file": one.name, **one.numbers()} for one in self.measured],
            "false_calls": calls and {
                "per_part": calls.per_part, "at_most": calls.bound,
                "near_defects": int(calls.near.sum()), "pixels_drawn": calls.drawn,
                "of_these": calls.drawn_false, "certain": calls.clear,
            },
            "within_tolerance": self.worst and {
                "a90_95": self.worst.rank if math.isfinite(self.worst.rank) else None,
                "at": self.worst.off, "designs": self.worst.tried,
            },
            "map": self.map and self.map.numbers(),
            "findings": list(self.findings()),
            "notes": list(self.cautions()),
        }  # fmt: skip

    def figure(self) -> Figure:
        """Draw the curves with their trials, bounds and sizes."""
        from gpuspec.detectability.picture import pod_picture

        return pod_picture(self)

    def map_figure(self) -> Figure:
        """Draw the map: hits and misses over both sizes, with a90 and a90/95 across.

        Raises
        ------
        TrialsError
            If there is none.
        """
        from gpuspec.detectability.map_picture import map_picture
        from gpuspec.pictures.page import essentials

        if self.map is None:
            raise TrialsError("there is no map; name a second size, e.g. over='diameter'.")
        station = (essentials(self.station),) if self.station else ()
        return map_picture(self.map, (*station, self.map.said))

    def write(self, folder: str | Path, *, force: bool = False) -> None:
        """Write picture, curve, numbers, trials and station.

        Parameters
        ----------
        folder : str or Path
            Made if missing; files of earlier trials in it are replaced, and no others.
        force : bool
            Whether files of the same names are replaced that are not known to be of trials.

        Raises
        ------
        OutputError
            If a file is in the way, the folder cannot be written or the disk is full; nothing is
            left half-written.

        Examples
        --------
        >>> import gpuspec as gs
        >>> station = gs.example("trim").replace(camera__sampling_mm=0.5)
        >>> gs.pod(station, parts=2).write("found")
        >>> from pathlib import Path
        >>> sorted(file.name for file in Path("found").glob("pod*.*"))
        ['pod-trials.csv', 'pod.csv', 'pod.json', 'pod.png', 'pod.toml']
        """
        with outputs(self.station, folder, force=force).writing() as partial:
            self.write_files(partial)

    def write_files(self, folder: Path) -> None:
        """Write the files straight into an existing folder; see :meth:`write`."""
        from gpuspec.pictures.page import png

        (folder / PICTURE).write_bytes(png(self.figure()))
        with (folder / CURVE).open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file)
            table.writerow(["of", self.label.replace(", ", "_") or "x", "pod", "bound"])
            table.writerows(self._curve_rows())
        text = json.dumps(self.numbers(), indent=2, allow_nan=False) + "\n"
        (folder / NUMBERS).write_text(text, "utf-8")
        if self.trials is not None:
            with (folder / TRIALS).open("w", encoding="utf-8", newline="") as file:
                table = csv.writer(file)
                table.writerow(self.trials.column_names)
                columns = [column.to_pylist() for column in self.trials.columns]
                table.writerows(
                    [f"{v:.6g}" if isinstance(v, float) else v for v in row]
                    for row in zip(*columns, strict=True)
                )
        if self.stations:
            with (folder / STATIONS).open("w", encoding="utf-8", newline="") as file:
                table = csv.writer(file)
                first = self.stations[0]
                heads = "false_calls", "false_calls_at_most", "applies", "reason"
                table.writerow([*first.values, *first.sizes, *heads])
                table.writerows(
                    [*one.values.values(), *one.sizes.values(), one.calls, one.most_calls,
                     one.applies, one.reason]
                    for one in self.stations
                )  # fmt: skip
        if self.map is not None:
            (folder / MAP).write_bytes(png(self.map_figure()))
            with (folder / MAP_TABLE).open("w", encoding="utf-8", newline="") as file:
                rows = self.map.rows()
                lines = csv.DictWriter(file, list(rows[0]))
                lines.writeheader()
                lines.writerows(
                    {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()}
                    for row in rows
                )
        if self.station is not None:
            keep(self.station, folder / STATION)

    def _curve_rows(self) -> Iterator[tuple[str, ...]]:
        for one in self.curves:
            if one.curve is None:
                continue
            size = np.linspace(one.size.min(), one.size.max(), _POINTS)
            for values in zip(size, one.curve.pod(size), one.curve.bound(size), strict=True):
                yield one.name, *(f"{value:.6g}" for value in values)


def written(found: Pod) -> tuple[str, ...]:
    """Return the names of the files that are written of it."""
    more = ((TRIALS, found.trials), (STATION, found.station), (STATIONS, found.stations or None),
            (MAP, found.map), (MAP_TABLE, found.map))  # fmt: skip
    return PICTURE, CURVE, NUMBERS, *(name for name, of in more if of is not None)


def outputs(
    station: Station | None, folder: str | Path, read: tuple[Path, ...] = (), *, force: bool = False
) -> Outputs:
    """Return what is written of trials, to be checked before them and written after.

    Parameters
    ----------
    station : Station or None
    folder : str or Path
    read : tuple of Path
        Files of trials.
    force : bool
        Whether files are replaced that are not known to be of trials.
    """
    places = copies(station, "pod").values() if station else ()
    names = (PICTURE, CURVE, NUMBERS, TRIALS, STATION, STATIONS, MAP, MAP_TABLE, *places)
    inputs = (*(station.inputs if station else ()), *read)
    return Outputs(folder_of(folder), "pod", names, inputs, force=force)
