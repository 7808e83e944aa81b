"""The inspection station: part, defects, tunnel, camera, sensor, sequence, as one file says it.

Every key carries its unit. Every default is gpuspec's own choice: the paper (Seulin, Merienne,
Gorria) prints no camera distance, stripe width or image count.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections import Counter
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from gpuspec.errors import OutputError, StationError, TopographyError
from gpuspec.files import write_new
from gpuspec.shown import cell, html_page, html_table
from gpuspec.station.defects import (
    Defect,
    EdgeDefect,
    Patch,
    Population,
    Scratch,
    ScratchPopulation,
    Section,
    Topography,
)
from gpuspec.station.materials import reflectance
from gpuspec.station.mistakes import explain
from gpuspec.station.optics import FOLLOWS
from gpuspec.station.paths import at, merged, places, plain
from gpuspec.station.sections import (
    Camera,
    ClassRule,
    DataSet,
    OwnRelief,
    Part,
    Pose,
    RejectRule,
    Segmentation,
    Sensor,
    Sequence,
    Sweep,
    Tolerance,
    Tunnel,
)
from gpuspec.units import MICRO

_SIDES = ("length_mm", "width_mm")  # of the part
_PATH_MAX = 200  # letters; no key of a station needs as many
_FACING_MIN = math.cos(math.radians(75))  # of the part's normal and the camera's axis
_BARE_ENTRY = re.compile(r"^\s*[a-z]+\[\d+\][.\w]*\s*=", re.MULTILINE)


def _part_of(data: dict[str, Any]) -> dict[str, Any]:
    """Return what the data say of the part; empty if that is no table."""
    part = data.get("part")
    if isinstance(part, Part):
        return {key: getattr(part, key) for key in part.model_fields_set}
    return part if isinstance(part, dict) else {}


def _sides_of_map(data: dict[str, Any], folder: Path) -> dict[str, float | None]:
    """Return the sides of the part that its map decides, None where the map cannot be read yet."""
    part = _part_of(data)
    relief = part.get("relief")
    if not isinstance(relief, (dict, Topography)):
        return {}
    sides: dict[str, float | None] = {side: None for side in _SIDES if side not in part}
    if sides:
        from gpuspec.topographies.file import size_mm

        try:
            topography = OwnRelief.model_validate(relief)
            size = size_mm(topography, folder / topography.file)
        except (ValidationError, TopographyError):
            return sides
        for side, value in zip(_SIDES, size, strict=True):
            if side in sides:
                sides[side] = float(f"{value:.9g}")
    return sides


def _sized(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the data with the sides of the part that its map decides and can be read of it."""
    sides = {side: value for side, value in _sides_of_map(data, folder).items() if value}
    return {**data, "part": {**_part_of(data), **sides}} if sides else data


class Station(Section):
    """One inspection station, whole and valid.

    Raises
    ------
    StationError
        One line per wrong value.

    Examples
    --------
    >>> dent = {"kind": "dent", "x_mm": 2.0, "y_mm": 1.0, "diameter_mm": 1.0, "depth_um": 8.0}
    >>> station = gpuspec.Station(part={"length_mm": 20.0, "width_mm": 10.0}, defects=[dent])
    >>> station
    Station(station: part 20 x 10 mm, 1 defect; ceiling at 150 mm, stripes 4 + 12 mm; 400 x
        200 pixels, 40 images)
    >>> station.tunnel.height_mm, station.camera.pupil_mm
    (150.0, 3.0)
    """

    part: Part = Part()
    tunnel: Tunnel = Tunnel()
    camera: Camera = Camera()
    sensor: Sensor = Sensor()
    sequence: Sequence = Sequence()
    defects: tuple[Defect, ...] = Field((), strict=False, description="known defects, one by one")
    populations: tuple[Population, ...] = Field(
        (), strict=False, description="defects at random places, of random sizes"
    )
    edges: tuple[EdgeDefect, ...] = Field(
        (), strict=False, description="chips and burrs on the part's edges"
    )
    segmentation: Segmentation = Segmentation()
    classes: tuple[ClassRule, ...] = Field(
        (), strict=False, description="classes of blobs; none: scratch, and dent or bump"
    )
    decision: tuple[RejectRule, ...] = Field(
        (), strict=False, description="reasons to reject a part; none: every blob is one"
    )

    sweep: Sweep | None = Field(None, description="what `gpuspec sweep` varies")
    dataset: DataSet | None = Field(None, description="what `gpuspec dataset` draws")
    tolerance: Tolerance | None = Field(
        None, description="by how much keys may be off; none: a step of a sweep's grid"
    )

    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _file: str = PrivateAttr(default="station")
    _source: Path | None = PrivateAttr(default=None)

    def __init__(self, /, **sections: Any) -> None:
        data = plain(sections)
        try:
            super().__init__(**_sized(data, Path.cwd()))
        except ValidationError as error:
            raise StationError("\n".join(explain(error, type(self), "station"))) from None
        self.part.model_fields_set.difference_update(_sides_of_map(data, Path.cwd()))

    # Read by pydantic: what is validated from a file goes another way, and names the file.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def of(cls, given: Station | str | Path) -> Station:
        """Return a station as it is, or read it if a path is given.

        Raises
        ------
        StationError
            As :meth:`read`.
        """
        return given if isinstance(given, cls) else cls.read(given)  # type: ignore[arg-type]

    @classmethod
    def read(cls, path: str | Path) -> Station:
        """Read a station from a TOML file.

        Parameters
        ----------
        path : str or Path
            The station file; files named in it are found relative to its folder.

        Returns
        -------
        Station

        Raises
        ------
        StationError
            File missing, not TOML, unknown key or impossible value; one sentence for each.

        Examples
        --------
        >>> from pathlib import Path
        >>> file = Path("trim.toml")
        >>> _ = file.write_text("tunnel.height_mm = 120.0")
        >>> gpuspec.Station.read(file)
        Station(trim.toml: part 200 x 50 mm, 0 defects; ceiling at 120 mm, stripes 4 + 12 mm;
            4000 x 1000 pixels, 40 images)
        >>> _ = file.write_text("tunnel.heigth_mm = 120.0")
        >>> gpuspec.Station.read(file)
        Traceback (most recent call last):
            ...
        gpuspec.errors.StationError: trim.toml: tunnel.heigth_mm is not a known key (did you
            mean height_mm?).
        """
        if not isinstance(path, (str, Path)):
            raise StationError(
                f"a station is a Station or the path of its file, not {type(path).__name__}; "
                f"Station.from_dict makes one of a dictionary."
            )
        path = Path(path)
        try:
            text = path.read_bytes().decode("utf-8-sig")
        except FileNotFoundError:
            raise StationError(
                f"{path}: no such station file; `gpuspec init` writes one to start from."
            ) from None
        except IsADirectoryError:
            raise StationError(f"{path}: this is a folder; name a station file in it.") from None
        except (OSError, UnicodeDecodeError) as error:
            raise StationError(f"{path}: cannot be read as UTF-8 text ({error}).") from None
        station = cls.parse(text, path.name, path.resolve().parent)
        station._source = path.absolute()
        return station

    @classmethod
    def parse(cls, text: str, file: str = "station", folder: str | Path = ".") -> Station:
        """Build a station from TOML text.

        Parameters
        ----------
        text : str
        file : str
            Its name in errors.
        folder : str or Path
            Where files named in it are found.

        Raises
        ------
        StationError
            If it is no TOML, a key is unknown, or a value is not allowed; one sentence says where.

        Examples
        --------
        >>> gpuspec.Station.parse("sensor.exposure = 6.0").sensor.exposure
        6.0
        >>> gpuspec.Station.parse("sensor.exposure = -1", "trim.toml")
        Traceback (most recent call last):
            ...
        gpuspec.errors.StationError: trim.toml: sensor.exposure = -1 must be greater than 0.
        """
        try:
            data = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # ValueError: a number too long, too
            way = '; a key with [1] in it needs quotes: "defects[1].depth_um"'
            hint = way if _BARE_ENTRY.search(text) else ""
            raise StationError(f"{file}: not a valid TOML file: {error}{hint}.") from None
        return cls.from_dict(data, file, folder)

    @classmethod
    def from_dict(
        cls, data: dict[str, Any], file: str = "station", folder: str | Path = "."
    ) -> Station:
        """Build a station from nested dictionaries as TOML gives them.

        A part with a measured relief and without ``length_mm`` or ``width_mm`` gets them from the
        map, if it can be read; whoever uses the map says why it cannot.

        Parameters
        ----------
        data : dict
            Sections, and lists of defects, populations and classes.
        file, folder
            As of :meth:`parse`.

        Raises
        ------
        StationError
            If a key is unknown, or a value is not allowed; one sentence names it.

        Examples
        --------
        >>> station = gpuspec.Station.from_dict({"part": {"length_mm": 20.0, "width_mm": 10.0}})
        >>> station.part.length_mm, station.part.crown_radius_x_mm
        (20.0, None)
        """
        if not isinstance(data, dict):
            raise StationError(
                f"{file}: a station is made of a dictionary of its sections, not "
                f"{type(data).__name__}."
            )
        with suppress(RecursionError):  # tables too deep, which pydantic refuses in a sentence
            data = plain(data)
        sides = _sides_of_map(data, Path(folder))
        try:
            station = cls.model_validate(_sized(data, Path(folder)))
        except ValidationError as error:
            said = explain(error, cls, file)
            if any(sides.values()):
                taken = " and ".join(f"{k} = {v:g}" for k, v in sides.items() if v)
                said.append(f"{file}: part.relief gives the part {taken}; check its map's pitch.")
            raise StationError("\n".join(said)) from None
        station._folder = Path(folder)
        station._file = file
        station.part.model_fields_set.difference_update(sides)
        return station

    def replace(self, /, **changes: Any) -> Station:
        """Return a station with values changed by dotted path, e.g. ``{"tunnel.dark_mm": 8.0}``.

        Entries of lists count from 1: ``{"defects[2].depth_um": 3.0}``. A dictionary changes the
        keys it names and leaves the others of its section: ``{"tunnel": {"dark_mm": 8.0}}``; only a
        defect with other keys takes the place of the old one whole. None unsets a key.

        Keyword names use ``__`` for the dot: ``replace(tunnel__dark_mm=8.0)``.

        Raises
        ------
        StationError
            If the changed station is invalid.

        Examples
        --------
        >>> station = gpuspec.example("trim")
        >>> station.replace(sensor__exposure=6).sensor.exposure
        6.0
        >>> station.replace(**{"defects[1].depth_um": 3.0}).defects[0].depth_um
        3.0
        >>> changed = station.replace(tunnel={"luminous_mm": 1.0, "dark_mm": 3.0})
        >>> changed.tunnel.period_mm, changed.tunnel.height_mm
        (4.0, 300.0)
        >>> station.replace(tunnel__dark=8)
        Traceback (most recent call last):
            ...
        gpuspec.errors.StationError: trim.toml: tunnel.dark is not a known key (did you mean
            dark_mm?).
        """
        data = self.as_dict()
        sides = {side: data["part"].pop(side) for side in self.sides_of_map}
        said = self.camera.model_fields_set
        optics = {key: data["camera"].pop(key) for key in FOLLOWS if key not in said}
        for name, value in plain(changes).items():
            path = name.replace("__", ".")
            *sections, key = places(path)
            if len(path) > _PATH_MAX:
                raise StationError(f"{self._file}: {path[:50]}... is not a known key.")
            target: Any = data
            for place in sections:
                target = self._inside(target, place, path)
            if isinstance(key, int):
                self._inside(target, key, path)  # there must be such an entry
                if value is None:
                    raise StationError(
                        f"{self._file}: {path} cannot be unset alone; give the whole list, e.g. "
                        f"{sections[-1]} = []."
                    )
                target[key] = merged(at(self, path), target[key], value)
            elif not isinstance(target, dict):
                raise StationError(
                    f"{self._file}: {path} cannot be changed: {sections[-1]} is not a table of "
                    f"keys."
                )
            elif value is None:
                target.pop(key, None)
            else:
                target[key] = merged(at(self, path), target.get(key), value)
        part = data.get("part")
        if isinstance(part, dict) and "relief" not in part:
            data["part"] = sides | part  # another map gives another size; without one it stays
        camera = data.get("camera")
        if isinstance(camera, dict):  # what no longer follows from the data sheet stays as it was
            left = {key for key in self.camera.following if not camera.keys() >= set(FOLLOWS[key])}
            data["camera"] = {key: optics[key] for key in left} | camera
        changed = type(self).from_dict(data, self._file, self._folder)
        changed._source = self._source
        return changed

    def write(self, path: str | Path, *, force: bool = False, sized: bool = True) -> Path:
        """Write the station to a new file: every key, with what it means.

        Files named in it are found from there, too: beside the station's own file by their names,
        from anywhere else by their absolute paths.

        Parameters
        ----------
        path : str or Path
        force : bool
            Whether an existing file is replaced; what the station was made from never is.
        sized : bool
            Whether a size that the part has from the map of its relief is written; else the file
            leaves it to the map.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OutputError
            If it exists, or cannot be written.

        Examples
        --------
        >>> import gpuspec as gs, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = gs.example("trim").write(f"{folder}/mine.toml")
        ...     gs.Station.read(path).tunnel.dark_mm
        6.0
        """
        from gpuspec.station.toml import to_toml

        if not isinstance(path, (str, Path)):
            raise OutputError(f"a station is written to the path of a file, not {path!r}.")
        path = Path(path)
        absolute = path.absolute().parent.resolve() != self._folder.resolve()
        text = to_toml(self, absolute=absolute, sized=sized)
        write_new(path, text, force=force, inputs=self.inputs)
        return path

    def _inside(self, target: Any, place: str | int, path: str) -> Any:
        """Return what stands at a place of nested tables and lists; a missing table is made."""
        if isinstance(place, int):
            if not isinstance(target, list) or not 0 <= place < len(target):
                count = len(target) if isinstance(target, list) else 0
                there = f"there {'is' if count == 1 else 'are'} {count}, numbered from 1"
                there = there if count else "there is none"
                raise StationError(
                    f"{self._file}: {path} cannot be changed: no such entry; {there}."
                )
            return target[place]
        if isinstance(target, list):
            raise StationError(
                f"{self._file}: {path} cannot be changed: a list has entries [1], [2] ..."
            )
        found = target.setdefault(place, {}) if isinstance(target, dict) else None
        if isinstance(found, tuple):
            found = target[place] = list(found)
        if not isinstance(found, (dict, list)):
            raise StationError(
                f"{self._file}: {path} cannot be changed: {place} is not a table of keys."
            )
        return found

    def __eq__(self, other: object) -> bool:
        """Whether all sections and the files they name are the same, wherever they were read."""
        if not isinstance(other, Station):
            return NotImplemented
        same = all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)
        return same and all(
            self.locate(name).resolve() == other.locate(name).resolve() for name in self.files
        )

    def __repr__(self) -> str:
        part, tunnel = self.part, self.tunnel
        rows, columns = self.shape
        count = len(self.defects)
        known = f"{count} defect{'s' * (count != 1)}"
        random = len(self.populations)
        placed = f", {random} population{'s' * (random != 1)}" if random else ""
        relief = f", relief {part.relief.file}" if part.relief else ""
        return (
            f"Station({self._file}: part {part.length_mm:g} x {part.width_mm:g} mm{relief}, {known}"
            f"{placed}; {tunnel.section} at {tunnel.top_mm:g} mm, {tunnel.light}; {columns} x "
            f"{rows} pixels, {self.sequence.images} images)"
        )

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Show itself in a notebook: a line for each section."""
        rows = []
        for name, held in self.as_dict().items():
            if isinstance(held, dict):
                told = [f"{key} = {cell(value)}" for key, value in held.items()]
            else:
                kinds = Counter(entry.get("kind", entry.get("name")) for entry in held)
                told = [f"{count} {kind}" for kind, count in kinds.items()]
            if told:
                rows.append({"section": name, "holds": ", ".join(told)})
        return html_page(self) + html_table(rows, len(rows))

    def as_dict(self) -> dict[str, Any]:
        """Return nested plain values, keys with value none left out, as TOML holds them.

        Examples
        --------
        >>> gpuspec.example("trim").as_dict()["sequence"]
        {'images': 40, 'fusion': 'mean', 'lag': 1}
        """
        return self.model_dump(exclude_none=True, mode="python")

    def locate(self, file: str) -> Path:
        """Return the path of a file named in the station, relative to the station's folder."""
        return self._folder / file

    @property
    def sides_of_map(self) -> tuple[str, ...]:
        """Keys of the part's size that the map of its relief decides, for none was given."""
        given = self.part.model_fields_set if self.part.relief else _SIDES
        return tuple(side for side in _SIDES if side not in given)

    @property
    def file(self) -> str:
        """Name of the file it was read from, for messages."""
        return self._file

    @property
    def files(self) -> tuple[str, ...]:
        """Files named in it, as they are named, each once: topographies, their zones, a mesh.

        A surface that is made is none.
        """
        from gpuspec.topographies.made import is_made

        named = (self.part.relief, self.part.mesh, *self.defects)
        names = (getattr(one, key, None) for one in named for key in ("file", "zone_file"))
        given = {name for name in names if name}
        return tuple(sorted(name for name in given if not is_made(name, self.locate(name))))

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Every file that it was made from: its own, if it was read from one, and those named."""
        own = (self._source,) if self._source else ()
        return (*own, *map(self.locate, self.files))

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Image shape (M, N) in pixels."""
        step = self.camera.sampling_mm
        return (
            self.camera.rows or max(math.ceil(self.part.width_mm / step - 1e-6), 1),
            self.camera.columns or max(math.ceil(self.part.length_mm / step - 1e-6), 1),
        )

    @property
    def posed(self) -> bool:
        """Whether part or camera are moved from where the model has them."""
        return any(one.pose is not None and one.pose.moves for one in (self.part, self.camera))

    @property
    def poses(self) -> list[str]:
        """The keys of the poses that it states."""
        return [f"{name}.pose" for name in ("part", "camera") if getattr(self, name).pose]

    @property
    def seen_by(self) -> str:
        """The keys by which the image sees the part, in words."""
        return ", ".join([*self.poses, "part.length_mm, part.width_mm and camera.sampling_mm"])

    @property
    def step_mm(self) -> float:
        """Translation of the tunnel between two images."""
        return self.sequence.step_mm or self.tunnel.period_mm / self.sequence.images

    @property
    def distinct_shifts(self) -> int | None:
        """Number of distinct, equally spaced shifts that fill the period; None if they do not.

        When K images of step s cover j whole periods, the shifts modulo the period are
        K / gcd(j, K) equal steps: the closed form of the mean holds.

        Examples
        --------
        >>> station = gpuspec.example("trim")  # 40 images over one period
        >>> station.distinct_shifts
        40
        >>> station.replace(sequence__step_mm=0.4).distinct_shifts  # over two
        20
        >>> print(station.replace(sequence__step_mm=0.3).distinct_shifts)
        None
        """
        images = self.sequence.images
        periods = images * self.step_mm / self.tunnel.period_mm
        whole = round(periods)
        if whole < 1 or abs(periods - whole) > 1e-9 * whole:
            return None
        return images // math.gcd(whole, images)

    @model_validator(mode="after")
    def _possible(self) -> Station:
        return self.possible()

    def possible(self, *, part_is: bool = False) -> Station:
        """Return self if its sections fit together.

        Parameters
        ----------
        part_is : bool
            Whether it is known that what is on the part fits on it.

        Raises
        ------
        ValueError
            If they do not: what is wrong.
        """
        part, tunnel, camera = self.part, self.tunnel, self.camera
        for axis, size in (("x", part.length_mm), ("y", part.width_mm)):
            radius = getattr(part, f"crown_radius_{axis}_mm")
            side = "length_mm" if axis == "x" else "width_mm"
            if radius is not None and abs(radius) <= size / 2:
                raise ValueError(
                    f"part.crown_radius_{axis}_mm = {radius:g} must be larger than half the "
                    f"part's {side} ({size / 2:g}), or left out for a flat part"
                )
        self._check_shape()
        self._check_reflectance()
        high = part.height_range_mm[1]
        if tunnel.section == "arch":
            if tunnel.radius_mm is None:
                raise ValueError('tunnel.radius_mm is missing: section = "arch" needs it')
            if math.hypot(part.width_mm / 2, max(high, 0)) >= tunnel.radius_mm:
                raise ValueError(
                    f"tunnel.radius_mm = {tunnel.radius_mm:g} must be larger than the part's "
                    f"half width and height, {math.hypot(part.width_mm / 2, high):g}"
                )
        elif tunnel.height_mm <= high:
            raise ValueError(
                f"tunnel.height_mm = {tunnel.height_mm:g} must be above the part's highest "
                f"point, {high:g}"
            )
        if tunnel.section == "box" and tunnel.width_mm is None:
            raise ValueError('tunnel.width_mm is missing: section = "box" needs it')
        if tunnel.section == "box" and (tunnel.width_mm or 0) <= part.width_mm:
            raise ValueError(
                f"tunnel.width_mm = {tunnel.width_mm:g} must be "
                f'larger than part.width_mm = {part.width_mm:g} when section = "box"'
            )
        if camera.height_mm <= tunnel.top_mm:
            key = "radius_mm" if tunnel.section == "arch" else "height_mm"
            raise ValueError(
                f"camera.height_mm = {camera.height_mm:g} must be above the tunnel, whose "
                f"tunnel.{key} is {tunnel.top_mm:g}"
            )
        if self.posed:
            self._check_pose()
        if (tunnel.opening_length_mm > 0) != (tunnel.opening_width_mm > 0):
            raise ValueError(
                "tunnel.opening_length_mm and tunnel.opening_width_mm must both be zero (no "
                "opening) or both be larger than zero"
            )
        rows, columns = self.shape
        if max(rows, columns) > 2**24:
            raise ValueError(
                f"camera.sampling_mm = {camera.sampling_mm:g} makes an image of {columns} x {rows} "
                f"pixels, more than 16,777,216 on a side; sample more coarsely or set "
                f"camera.columns and camera.rows"
            )
        if rows * columns > 2**31 - 1:
            raise ValueError(
                f"camera.sampling_mm = {camera.sampling_mm:g} makes an image of {columns} x {rows} "
                f"pixels, more than 2,147,483,647; sample more coarsely or set camera.columns and "
                f"camera.rows"
            )
        if self.sensor.black_level_dn >= self.sensor.full_scale_dn:
            raise ValueError(
                f"sensor.black_level_dn = {self.sensor.black_level_dn:g} must be below full scale, "
                f"{self.sensor.full_scale_dn}"
            )
        threshold = self.segmentation.threshold
        if threshold != "auto" and threshold >= self.sensor.full_scale_dn:
            raise ValueError(
                f"segmentation.threshold = {threshold:g} must be below full scale, "
                f'{self.sensor.full_scale_dn}, or "auto"'
            )
        if self.sequence.fusion == "differential" and self.sequence.lag >= self.sequence.images:
            raise ValueError(
                f"sequence.lag = {self.sequence.lag} must be smaller than sequence.images = "
                f"{self.sequence.images}"
            )
        if not part_is:
            self._check_sizes()
            self._check_edges()
            self._check_places()
        return self

    def _check_places(self) -> None:
        """Refuse defects beside the part."""
        part = self.part
        for number, defect in enumerate(self.defects, 1):
            points = (
                defect.points_mm if isinstance(defect, Scratch) else ((defect.x_mm, defect.y_mm),)
            )
            for x, y in points:
                if abs(x) > part.length_mm / 2 or abs(y) > part.width_mm / 2:
                    raise ValueError(
                        f"defects[{number}] ({defect.kind}) at ({x:g}, {y:g}) mm is outside the "
                        f"part, which reaches ±{part.length_mm / 2:g} mm along x and "
                        f"±{part.width_mm / 2:g} mm along y"
                    )

    def _check_pose(self) -> None:
        """Refuse a part moved out of the tunnel, and a camera in it or behind the part."""
        part, tunnel, camera = self.part, self.tunnel, self.camera
        pose, seen = part.pose or Pose(), camera.pose or Pose()
        low, high = part.height_range_mm
        corners = [
            tuple(
                sum(a * u for a, u in zip(row, (x, y, z), strict=True)) + shift
                for row, shift in zip(pose.axes, pose.shift_mm, strict=True)
            )
            for x in (-part.length_mm / 2, part.length_mm / 2)
            for y in (-part.width_mm / 2, part.width_mm / 2)
            for z in (low, high)
        ]
        top = max(corner[2] for corner in corners)
        beside = max(abs(corner[1]) for corner in corners)
        farthest = max(math.hypot(y, max(z, 0)) for _, y, z in corners)
        if tunnel.section == "arch" and farthest >= (tunnel.radius_mm or 0):
            raise ValueError(
                f"part.pose moves the part out of the tunnel: a corner is {farthest:.4g} mm from "
                f"its axis, and tunnel.radius_mm = {tunnel.radius_mm:g}"
            )
        if tunnel.section != "arch" and top >= tunnel.height_mm:
            raise ValueError(
                f"part.pose moves the part out of the tunnel: a corner is at z = {top:.4g} mm, and "
                f"tunnel.height_mm = {tunnel.height_mm:g}"
            )
        if tunnel.section == "box" and 2 * beside >= (tunnel.width_mm or 0):
            raise ValueError(
                f"part.pose moves the part out of the tunnel: a corner is at y = {beside:.4g} mm, "
                f"and tunnel.width_mm = {tunnel.width_mm:g}"
            )
        pupil = camera.height_mm + seen.shift_z_mm
        if pupil <= tunnel.top_mm:
            raise ValueError(
                f"camera.pose moves the camera into the tunnel: its pupil is at z = {pupil:.4g} "
                f"mm, and the tunnel reaches up to {tunnel.top_mm:g}"
            )
        facing = sum(row[2] * other[2] for row, other in zip(pose.axes, seen.axes, strict=True))
        if facing < _FACING_MIN:
            raise ValueError(
                f"part.pose and camera.pose tilt the part by {math.degrees(math.acos(facing)):.3g} "
                f"degrees against the camera's axis; at most "
                f"{math.degrees(math.acos(_FACING_MIN)):.3g} are taken"
            )

    def _check_shape(self) -> None:
        """Refuse two shapes, a sphere that ends before the part does, and a mesh without height."""
        part, radius = self.part, self.part.sphere_radius_mm
        crowned = part.crown_radius_x_mm is not None or part.crown_radius_y_mm is not None
        if crowned + (radius is not None) + (part.mesh is not None) > 1:
            raise ValueError(
                "part has two shapes; a crown (part.crown_radius_x_mm, part.crown_radius_y_mm), a "
                "sphere (part.sphere_radius_mm) and a mesh (part.mesh) exclude each other"
            )
        corner = math.hypot(part.length_mm, part.width_mm) / 2
        if radius is not None and abs(radius) <= corner:
            raise ValueError(
                f"part.sphere_radius_mm = {radius:g} must be larger than the distance from the "
                f"part's centre to its corner ({corner:g}), or left out for a flat part"
            )
        if part.mesh and part.surface != "height":
            raise ValueError(
                'part.surface = "orientation" knows no height, which a mesh is; set part.surface = '
                '"height"'
            )

    def _check_edges(self) -> None:
        """Refuse chips and burrs beside their edge, or larger than the part."""
        length, width = self.part.length_mm, self.part.width_mm
        for number, edge in enumerate(self.edges, 1):
            side, across = (length, width) if edge.side in ("top", "bottom") else (width, length)
            if abs(edge.at_mm) > side / 2:
                raise ValueError(
                    f"edges[{number}].at_mm = {edge.at_mm:g} is beside the part's {edge.side} "
                    f"edge, which reaches ±{side / 2:g} mm from its middle"
                )
            for key, size, most in (
                ("width_mm", edge.width_mm, side), ("depth_mm", edge.depth_mm, across)
            ):  # fmt: skip
                if size > most:
                    raise ValueError(
                        f"edges[{number}].{key} = {size:g} is larger than the part, {length:g} x "
                        f"{width:g} mm"
                    )

    def _check_reflectance(self) -> None:
        """Refuse a material that would give back more light than falls on it."""
        part = self.part
        mirrored = reflectance(part.material, self.tunnel.wavelength_nm)
        if part.material != "ideal" and part.diffuse + mirrored > 1:
            raise ValueError(
                f"part.diffuse = {part.diffuse:g} is more than {part.material} leaves: it reflects "
                f"{mirrored:.3g} of the light as a mirror; take {1 - mirrored:.2g} or less"
            )

    def _check_sizes(self) -> None:
        """Refuse defects so deep or so wide that the model of a relief on a mirror is void."""
        largest = max(self.part.length_mm, self.part.width_mm)
        for number, defect in enumerate(self.defects, 1):
            if isinstance(defect, Patch):
                continue
            key = "width_mm" if isinstance(defect, Scratch) else "diameter_mm"
            size = getattr(defect, key)
            if size > largest:
                raise ValueError(
                    f"defects[{number}].{key} = {size:g} is larger than the part, "
                    f"{self.part.length_mm:g} x {self.part.width_mm:g} mm; so wide a shape is the "
                    f"part's own: see part.crown_radius_x_mm and part.crown_radius_y_mm"
                )
            _check_depth(f"defects[{number}]", key, size, defect.depth_um)
        for number, population in enumerate(self.populations, 1):
            key = "width_mm" if isinstance(population, ScratchPopulation) else "diameter_mm"
            widest = getattr(population, key).high
            _check_depth(f"populations[{number}]", key, widest, population.depth_um.low)


def _check_depth(name: str, key: str, size_mm: float, depth_um: float) -> None:
    """Refuse what is deeper than wide: a Gaussian's slope, d / (sigma sqrt e), is then 2.4."""
    if depth_um * MICRO > size_mm:
        raise ValueError(
            f"{name}.depth_um = {depth_um:g} is more than its {key} = {size_mm:g}: a hole with "
            f"sides steeper than 67 degrees, in which light is reflected again and again, while "
            f"the model follows it once. Depths are in um, widths in mm"
        )
