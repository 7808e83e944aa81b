"""Stations as text: complete TOML with every default and what each key means, and the examples."""

from __future__ import annotations

import tempfile
import types
from importlib import resources
from pathlib import Path
from typing import Any, Union, get_args, get_origin

import tomlkit
from pydantic import BaseModel
from tomlkit.items import Table

from gpuspec.defects import Distribution
from gpuspec.errors import OutputError, StationError
from gpuspec.station import Station


def to_toml(station: Station, *, comments: bool = True, absolute: bool = False) -> str:
    """Return the station as TOML: every key with its value, keys that are none as comments.

    Parameters
    ----------
    station : Station
    comments : bool
        Whether each key is followed by what it means.
    absolute : bool
        Whether files named in the station get absolute paths, to be found from anywhere.

    Returns
    -------
    str
        ``Station.parse`` of it gives the station back.
    """
    if absolute:
        station = _anchored(station)
    document = tomlkit.document()
    for name in type(station).model_fields:
        value = getattr(station, name)
        if isinstance(value, BaseModel):
            document.add(name, _table(value, comments))
        elif value:
            array = tomlkit.aot()
            told: set[str] = set()
            for entry in value:
                kind = getattr(entry, "kind", name)
                array.append(_table(entry, comments and kind not in told))
                told.add(kind)
            document.add(name, array)
    return tomlkit.dumps(document).replace("\n\n\n", "\n\n")


def _table(section: BaseModel, comments: bool) -> Table:
    table = tomlkit.table()
    nested: list[tuple[str, BaseModel]] = []
    fields = type(section).model_fields
    for name in sorted(fields, key=lambda name: name != "kind"):
        value, field = getattr(section, name), fields[name]
        meaning = field.description or ""
        if isinstance(value, BaseModel) and not isinstance(value, Distribution):
            nested.append((name, value))
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


def _anchored(station: Station) -> Station:
    """Return the station with absolute paths."""
    data = station.as_dict()
    for table in (data["part"].get("relief"), *data["defects"]):
        for key in ("file", "zone_file"):
            if table and key in table:
                table[key] = station.locate(table[key]).resolve().as_posix()
    return Station.from_dict(data, station.file)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, (tuple, list)) else value


def _is_table(annotation: Any) -> bool:
    """Whether a key takes a table, such as part.relief."""
    if get_origin(annotation) in (Union, types.UnionType):
        return any(_is_table(a) for a in get_args(annotation))
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def examples() -> tuple[str, ...]:
    """Return the names of the stations that come with the package."""
    folder = resources.files("gpuspec") / "examples"
    return tuple(
        sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))
    )


def example(name: str) -> Station:
    """Return an example station by name.

    Raises
    ------
    StationError
        If there is none of that name.
    """
    return Station.parse(example_text(name), f"{name}.toml", Path.cwd())


def example_text(name: str) -> str:
    """Return the TOML text of an example station.

    Raises
    ------
    StationError
        If there is none of that name.
    """
    if name not in examples():
        raise StationError(f"there is no example {name!r}; choose one of {', '.join(examples())}.")
    return (resources.files("gpuspec") / "examples" / f"{name}.toml").read_text(encoding="utf-8")


def write_new(path: Path, text: str, *, force: bool = False) -> None:
    """Write a new text file whole; keep an existing one unless forced.

    Raises
    ------
    OutputError
        If it exists, or cannot be written.
    """
    partial: Path | None = None
    try:
        if path.exists() and not force:
            raise OutputError(
                f"{path} exists already; choose another name, or --force to replace it."
            )
        with tempfile.NamedTemporaryFile(
            "w", prefix=".gpuspec-", dir=path.parent, delete=False, encoding="utf-8"
        ) as file:
            partial = Path(file.name)
            file.write(text)
        partial.chmod(0o644)
        partial.replace(path)
    except OSError as error:
        raise OutputError(
            f"{path} cannot be written: {error.strerror or error}; choose another place."
        ) from None
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)
