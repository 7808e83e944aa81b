"""What a study leaves behind: a figure, a table, what it found, and where it was worked out."""

from __future__ import annotations

import csv
import json
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from gpuspec.files import Outputs, folder_of
from gpuspec.light.backend import DeviceInfo
from gpuspec.shown import html_page, object_of
from gpuspec.station.station import Station
from gpuspec.station.toml import copies, keep
from gpuspec.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENDINGS = (".png", ".csv", ".json", ".toml")
"""A study writes its name with each of these."""


@dataclass(frozen=True, repr=False)
class Outcome(ABC):
    """What a study of a station found.

    Attributes
    ----------
    station : Station
        The station studied.
    info : DeviceInfo
        Backend, device, driver and version that traced it.
    notes : tuple of str
        What is wrong with the station, see :mod:`gpuspec.simulation.cautions`.
    """

    name: ClassVar[str]
    """Of the study, and of its files."""

    station: Station
    info: DeviceInfo
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    def __repr__(self) -> str:
        said = {str(number): finding for number, finding in enumerate(self.findings(), 1)}
        return object_of(type(self).__name__, f"{self.station.file}, {self.info}", said)

    @abstractmethod
    def figure(self) -> Figure:
        """Draw what was found."""

    @abstractmethod
    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """Return the table's heads and rows; heads carry the unit."""

    @abstractmethod
    def findings(self) -> tuple[str, ...]:
        """Say what was found, a sentence each."""

    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """Return the figures behind the findings, keys with their unit."""

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook."""
        from gpuspec.pictures.page import png

        return png(self.figure())

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what was found, and the figure."""
        return html_page(self, self._repr_png_())

    def write(self, folder: str | Path, *, force: bool = False) -> None:
        """Write figure, table, findings and station, each under the study's name.

        Parameters
        ----------
        folder : str or Path
            Made if missing; files of the same study in it are replaced, and no others.
        force : bool
            Whether files of the same names are replaced that are not known to be a study's; what
            it was made from never is.

        Raises
        ------
        OutputError
            If a file is in the way, the folder cannot be written or the disk is full; nothing is
            left half-written.

        Examples
        --------
        >>> from pathlib import Path
        >>> height = gpuspec.study("height", gpuspec.example("trim"), distances=5)
        >>> height.write("studies")
        >>> sorted(file.name for file in Path("studies").glob("height.*"))
        ['height.csv', 'height.json', 'height.png', 'height.toml']
        """
        with outputs(self.name, self.station, folder, force=force).writing() as partial:
            self.write_files(partial)

    def write_files(self, folder: Path) -> None:
        """Write the files straight into an existing folder; see :meth:`write`."""
        from gpuspec.pictures.page import png

        figure, table, summary, station = (folder / name for name in files(self.name))
        figure.write_bytes(png(self.figure()))
        heads, rows = self.table()
        with table.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(heads)
            writer.writerows([_shown(value) for value in row] for row in rows)
        said = {
            "gpuspec": __version__,
            **self.info.as_dict(),
            "study": self.name,
            "station": self.station.file,
            **{key: _finite(value) for key, value in self.numbers().items()},
            "findings": list(self.findings()),
            "notes": list(self.notes),
        }
        summary.write_text(json.dumps(said, indent=2) + "\n", "utf-8")
        keep(self.station, station)


def outputs(
    name: str, station: Station | None, folder: str | Path, *, force: bool = False
) -> Outputs:
    """Return what a study writes, to be checked before it and written after it.

    Parameters
    ----------
    name : str
        Of the study.
    station : Station or None
        None: it was run without one.
    folder : str or Path
    force : bool
        Whether files are replaced that are not known to be an earlier study's.
    """
    places = copies(station, name).values() if station else ()
    read = station.inputs if station else ()
    return Outputs(folder_of(folder), f"{name} study", (*files(name), *places), read, force=force)


def files(name: str) -> tuple[str, ...]:
    """Return what the study of this name writes."""
    return tuple(name + ending for ending in ENDINGS)


def percent(share: float) -> str:
    """Return a share in percent, three digits."""
    return f"{100 * share:.3g} %"


def _shown(value: Any) -> Any:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return value


def _finite(value: Any) -> Any:
    """Return a value that JSON knows: it has no infinity and no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


GREY, PALE, DARK = "#606060", "#D9D9D9", "#404040"
