"""Stations as text: complete TOML with every default and what each key means, and the examples."""

from __future__ import annotations

import shutil
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, Self, Union, get_args, get_origin

import tomlkit
from pydantic import BaseModel
from tomlkit.items import Table

from gpuspec.station.defects import Distribution
from gpuspec.station.optics import FOLLOWS
from gpuspec.station.sections import Camera


class Written(Protocol):
    """What is written as a station file; see :class:`gpuspec.station.station.Station`."""

    @property
    def file(self) -> str:
        """Its name."""

    @property
    def files(self) -> tuple[str, ...]:
        """Files named in it."""

    @property
    def sides_of_map(self) -> tuple[str, ...]:
        """Keys of the part's size that its map decides."""

    @property
    def camera(self) -> Camera:
        """Keys of which may follow from others."""

    def locate(self, file: str) -> Path:
        """Return the path of a file named in it."""

    def as_dict(self) -> dict[str, Any]:
        """Return nested plain values."""

    @classmethod
    def from_dict(cls, data: dict[str, Any], file: str = ...) -> Self:
        """Build one of plain values."""


def to_toml(
    station: Written, *, comments: bool = True, absolute: bool = False, sized: bool = True
) -> str:
    """Return the station as TOML: every key with its value, keys that are none as comments.

    Parameters
    ----------
    station : Station
    comments : bool
        Whether each key is followed by what it means.
    absolute : bool
        Whether files named in the station get absolute paths, to be found from anywhere.
    sized : bool
        Whether a size that the part has from the map of its relief is written; else the file leaves
        it to the map, and another map gives another.

    Returns
    -------
    str
        ``Station.parse`` of it gives the station back.

    Examples
    --------
    >>> station = gpuspec.Station(tunnel={"height_mm": 120.0})
    >>> text = gpuspec.to_toml(station)
    >>> text.splitlines()[1]
    "length_mm = 200.0 # along x, the direction in which the light moves; not given beside a
        relief: its map's"
    >>> gpuspec.Station.parse(text).as_dict() == station.as_dict()
    True
    """
    if absolute:
        anchored = {name: station.locate(name).resolve().as_posix() for name in station.files}
        station = _relocated(station, anchored)
    document = tomlkit.document()
    for name in type(station).model_fields:  # type: ignore[attr-defined]
        value = getattr(station, name)
        if isinstance(value, BaseModel):
            left = () if sized or name != "part" else station.sides_of_map
            left = station.camera.following if name == "camera" else left
            document.add(name, _table(value, comments, left))
        elif value:
            array = tomlkit.aot()
            told: set[str] = set()
            for entry in value:
                kind = getattr(entry, "kind", name)
                array.append(_table(entry, comments and kind not in told))
                told.add(kind)
            document.add(name, array)
    return tomlkit.dumps(document).replace("\n\n\n", "\n\n")


def _table(section: BaseModel, comments: bool, left: tuple[str, ...] = ()) -> Table:
    table = tomlkit.table()
    nested: list[tuple[str, BaseModel]] = []
    fields = type(section).model_fields
    for name in sorted(fields, key=lambda name: name != "kind"):
        value, field = getattr(section, name), fields[name]
        meaning = field.description or ""
        if isinstance(value, BaseModel) and not isinstance(value, Distribution):
            nested.append((name, value))
        elif name in left:
            table.add(tomlkit.comment(f"{name} = {value:.6g}  # {meaning}{_source(section, name)}"))
        elif value is None:
            if comments and not _is_table(field.annotation):
                table.add(tomlkit.comment(f"{name} = (none)  # {meaning}"))
        else:
            if isinstance(value, Distribution):
                value = value.model_dump()
            item = tomlkit.item(_plain(value))
            if comments and meaning:
                item.comment(meaning)
            table.add(name, item)
    for name, inner in nested:
        table.add(name, _table(inner, comments))
    return table


def _source(section: BaseModel, name: str) -> str:
    """Say what a key follows from."""
    if not isinstance(section, Camera):
        return ""
    return f"; follows from {', '.join(FOLLOWS[name])}"


def copies(station: Written, stem: str) -> dict[str, str]:
    """Return where :func:`keep` puts the files that a station names, relative to its folder.

    Parameters
    ----------
    station : Station
    stem : str
        Name of the kept station file without its ending.
    """
    places: dict[str, str] = {}
    for number, name in enumerate(station.files, 1):
        place = f"{stem}_files/{Path(name).name}"
        if place.casefold() in map(str.casefold, places.values()):
            place = f"{stem}_files/{number}_{Path(name).name}"
        places[name] = place
    return places


def keep(station: Written, path: Path) -> None:
    """Write a station with a copy of every file it names, so that it runs wherever it is moved.

    Parameters
    ----------
    station : Station
        Its files are read.
    path : Path
        The station file, in an existing folder; the copies stand in a folder beside it. A file
        that is no longer there is named by its absolute path.

    Raises
    ------
    OSError
        If the disk is full.
    """
    places = copies(station, path.stem)
    for name, place in places.items():
        source = station.locate(name)
        if source.is_file():
            (path.parent / place).parent.mkdir(exist_ok=True)
            shutil.copyfile(source, path.parent / place)
        else:
            places[name] = source.resolve().as_posix()
    path.write_text(to_toml(_relocated(station, places)), "utf-8")


def _relocated(station: Written, places: Mapping[str, str]) -> Written:
    """Return the station with other paths of the files that it names."""
    if not places:
        return station
    data = station.as_dict()
    for table in (data["part"].get("relief"), data["part"].get("mesh"), *data["defects"]):
        for key in ("file", "zone_file"):
            if table and key in table:
                table[key] = places.get(table[key], table[key])
    return station.from_dict(data, station.file)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, (tuple, list)) else value


def _is_table(annotation: Any) -> bool:
    """Whether a key takes a table, such as part.relief."""
    if get_origin(annotation) in (Union, types.UnionType):
        return any(_is_table(a) for a in get_args(annotation))
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
