"""What a data set holds: which station each part is, to which split it belongs, what is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gpuspec.datasets.draws import Draw, Value, draws
from gpuspec.errors import StationError
from gpuspec.station.sections import DataSet
from gpuspec.station.seeds import seeds_of
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml
from gpuspec.sweeps.plan import digests
from gpuspec.version import __version__

SPLITS = ("train", "validation", "test")
PARTS_MAX = 1_000_000
BITS = (8, 16, 32)
Format = Literal["png", "tif"]
_TRIES = 50  # of values drawn for a part until they make a station
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Kept:
    """What is written of each part.

    Attributes
    ----------
    format : {"png", "tif"}
        Of the images.
    bits : int
        8 or 16: levels from 0 to full scale; 32: grey levels as they are, DN, a TIFF of floats.
    fusions, frames : bool
        Whether the other fusions and every image of the sequence are written, too.
    licence : str
        Of the data set; "": none was chosen.
    """

    format: Format = "png"
    bits: int = 8
    fusions: bool = False
    frames: bool = False
    licence: str = ""

    def check(self) -> None:
        """See that there is such a file.

        Raises
        ------
        StationError
            If there is none.
        """
        if self.format not in ("png", "tif"):
            raise StationError(f"images are written as png or tif, not {self.format!r}.")
        if self.bits not in BITS:
            raise StationError(f"images have 8, 16 or 32 bits a pixel, not {self.bits!r}.")
        if self.bits == 32 and self.format == "png":
            raise StationError("a PNG holds no numbers of 32 bits; take the format tif.")
        if not isinstance(self.licence, str) or "\n" in self.licence:
            raise StationError("a licence is named in one line, e.g. CC-BY-4.0.")

    def full_scale(self, station: Station) -> float:
        """Return the level in the files that is the station's full scale."""
        return station.sensor.full_scale_dn if self.bits == 32 else 2.0**self.bits - 1


@dataclass(frozen=True)
class DataSetPlan:
    """The parts of a data set by number, from 1.

    What a part is depends on its number and the seed alone: more parts may be added to a data set.

    Attributes
    ----------
    station : Station
        What is not drawn; its ``[dataset]`` table is that of the plan.
    table : DataSet
    draws : tuple of Draw
    kept : Kept

    Examples
    --------
    >>> from gpuspec.datasets.plan import DataSetPlan
    >>> plan = DataSetPlan.of(gpuspec.example("trim"), {"sensor.exposure": [2, 6]})
    >>> plan
    DataSetPlan(trim.toml: sensor.exposure 2 to 6; png of 8 bits)
    >>> plan.values(1), plan.split(1)
    ({'sensor.exposure': 2.23446}, 'train')
    """

    station: Station
    table: DataSet
    draws: tuple[Draw, ...]
    kept: Kept

    def __repr__(self) -> str:
        drawn = ", ".join(f"{draw.key} {draw}" for draw in self.draws) or "parts alone"
        files = f"{self.kept.format} of {self.kept.bits} bits"
        return f"DataSetPlan({self.station.file}: {drawn}; {files})"

    @classmethod
    def of(
        cls,
        station: Station | str | Path,
        vary: Mapping[str, Any] | None = None,
        seed: int | None = None,
        kept: Kept | None = None,
    ) -> DataSetPlan:
        """Plan a data set.

        Parameters
        ----------
        station : Station, str or Path
            Or the path of a station file; its ``[dataset]`` table is taken where others are None.
        vary : mapping of str to str or list, optional
            Keys and what they take, see :func:`gpuspec.datasets.draws.draws`.
        seed : int, optional
        kept : Kept, optional

        Raises
        ------
        StationError
            If no defect is random, a key or range is wrong, or there is no such file.
        """
        station = Station.of(station)
        kept = kept or Kept()
        kept.check()
        table = station.dataset or DataSet()
        given = table.vary if vary is None else dict(vary)
        drawn = draws(station, given)
        changes = {"vary": {d.key: list(d.values) if len(d.values) > 2 or d.between else
                            ",".join(map(_text, d.values)) for d in drawn}}  # fmt: skip
        if seed is not None:
            changes["seed"] = seed  # type: ignore[assignment]
        base = station.replace(sweep=None, dataset={**table.model_dump(), **changes})
        if not (station.defects or station.populations or station.part.relief):
            raise StationError(
                f"{station.file}: the part has no defects, so there is nothing to learn; add "
                f"[[populations]]."
            )
        if not station.populations and not any(d.key.startswith("defects[") for d in drawn):
            raise StationError(
                f"{station.file}: no defect is random, so every part would be the same; add "
                f"[[populations]], or vary the [[defects]] in [dataset.vary]."
            )
        assert base.dataset is not None
        return cls(base, base.dataset, drawn, kept)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What to know of the data set before it is made."""
        fixed = sum(not any(d.key.startswith(f"defects[{n}]") for d in self.draws)
                    for n in range(1, len(self.station.defects) + 1))  # fmt: skip
        if not fixed:
            return ()
        return (
            f"{fixed} of the station's own [[defects]] are at the same place on every part, those "
            f"to test on, too: a detector may learn the place; leave them out for a fair test.",
        )

    def split(self, number: int) -> str:
        """Return the split of a part: it does not depend on how many there are.

        Parameters
        ----------
        number : int
            Of the part, from 1.
        """
        start = float(self._random().random())
        place = (start + number * _GOLDEN) % 1  # evenly, however many
        ends = np.cumsum(self.table.split)
        return SPLITS[min(int(np.searchsorted(ends, place, "right")), len(SPLITS) - 1)]

    def values(self, number: int) -> dict[str, Value]:
        """Return what is drawn for a part, its keys and their values."""
        return self.drawn(number)[0]

    def station_of(self, number: int) -> Station:
        """Return a part's station; parameters and errors as :meth:`drawn`."""
        return self.drawn(number)[1]

    def drawn(self, number: int) -> tuple[dict[str, Value], Station]:
        """Return what is drawn for a part, and its station with seeds of its own.

        Values that make no valid station are drawn again.

        Parameters
        ----------
        number : int
            From 1.

        Raises
        ------
        StationError
            If no values are found that make one: why not.
        """
        for attempt in range(_TRIES):
            # Raw uniform numbers alone: their stream is the one numpy promises to keep.
            uniform = self._random(number, attempt).random(len(self._seeds) + len(self.draws))
            seeds, rest = np.split(uniform, [len(self._seeds)])
            own = {key: int(u * 2**32) for key, u in zip(self._seeds, seeds, strict=True)}
            values = {d.key: d.value(float(u)) for d, u in zip(self.draws, rest, strict=True)}
            try:
                return values, self._bare.replace(**{**values, **own})
            except StationError as error:
                reason = error
        raise StationError(
            f"of {_TRIES} draws of [dataset.vary] for part {number} none is a valid station, e.g.: "
            f"{reason}"
        )

    @cached_property
    def _bare(self) -> Station:
        """The station without the table, which is no part's own."""
        return self.station.replace(dataset=None)

    @cached_property
    def _seeds(self) -> tuple[str, ...]:
        return tuple(seeds_of(self.station))

    def _random(self, *numbers: int) -> np.random.Generator:
        return np.random.Generator(np.random.PCG64([self.table.seed, *numbers]))

    @property
    def categories(self) -> tuple[str, ...]:
        """Kinds of defects that there may be, in the order of their numbers from 1."""
        kinds: list[str] = [d.kind for d in (*self.station.defects, *self.station.populations)]
        kinds += ["pit"] if self.station.part.relief else []
        return tuple(dict.fromkeys(kinds))

    def identity(self) -> dict[str, Any]:
        """Return what makes this data set this one, as JSON holds it."""
        return {
            "gpuspec": __version__,
            "station": to_toml(self.station, comments=False, absolute=True),
            "files": digests(self.station),
            "format": self.kept.format,
            "bits": self.kept.bits,
            "fusions": self.kept.fusions,
            "frames": self.kept.frames,
            "licence": self.kept.licence,
        }


def _text(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
