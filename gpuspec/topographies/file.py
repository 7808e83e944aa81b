"""Files of measured topographies: heights in mm on a grid, whoever wrote them.

Plain matrices (.npy, .tif, text) are read here. They carry no unit, so the station file gives it:
``height_unit`` and ``pitch_um``. Everything else is read by the package SurfaceTopography.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import TopographyError
from gpuspec.topographies.made import is_made, surface
from gpuspec.units import MICRO

INSTALL = 'pip install "gpuspec[topography]"'
POINTS_MAX = 100_000_000  # of all maps: 0.4 GB on the device, some 5 GB here while they are read
SIDE_MIN = 4
_MISSING_MAX = 0.5
_MM = {"m": 1e3, "mm": 1.0, "um": 1e-3, "nm": 1e-6}
_SAME = 1e-3  # relative; two pitches that differ by less are one, rounded
_TEXT = (".txt", ".csv", ".tsv", ".asc", ".dat")
_NO_NUMBER = {"", "-", "--", "---", "*", "***", "bad", "nan", "na", "n/a", "null", "none"}

Heights = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Described(Hashable, Protocol):
    """What is said of a file beside it; the sections of a station that name one have it."""

    @property
    def file(self) -> str:
        """Its name."""

    @property
    def height_unit(self) -> str | None:
        """Unit of its heights, where it states none."""

    @property
    def height_scale(self) -> float:
        """Its heights times this."""

    @property
    def pitch_um(self) -> float | tuple[float, float] | None:
        """Distance of two points, or along x and y, where it states none."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Heights as a file holds them, in mm.

    Attributes
    ----------
    heights_mm : ndarray of float64, shape (ny, nx)
        0 where missing. Row 0 has the least y: the last line of the file or picture.
    defined : ndarray of bool, shape (ny, nx)
        Where a height was measured.
    pitch_mm : tuple of float
        Distance of two points along x and y.
    """

    heights_mm: Heights
    defined: Mask
    pitch_mm: tuple[float, float]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Extent along x and y: every point stands for one pitch."""
        ny, nx = self.heights_mm.shape
        return nx * self.pitch_mm[0], ny * self.pitch_mm[1]


@dataclass(frozen=True)
class _Grid:
    """What a file holds, first line the top: a plain matrix, or a map in mm with its pitch.

    `unit` is the file's own, of which the heights in mm were made; None: plain numbers.
    """

    heights: NDArray[Any]  # NaN: missing
    unit: str | None = None
    pitch_mm: tuple[float, float] | None = None


def read_topography(
    topography: Described, path: Path, file: str, key: str, points: int = 0
) -> Measured:
    """Read a topography with the units of its file, or those of its section in the station.

    Parameters
    ----------
    topography : Described
        The section that names the file.
    path : Path
        Where the file is.
    file, key : str
        Station file and section, for messages: ``part.relief``, ``defects[3]``.
    points : int
        Points of other maps that are read already.

    Returns
    -------
    Measured

    Raises
    ------
    TopographyError
        If the file is absent, damaged, too large, no areal topography, or without a unit or pitch
        that the section does not give either; or if file and section contradict each other.
    """
    says = f'{file}: {key}.file = "{topography.file}"'
    grid = _grid(topography, path, says, points)
    scale = topography.height_scale * _height_mm(topography, grid.unit, says, key)
    pitch = _pitch(topography, grid, says, key)
    heights = np.asarray(grid.heights, np.float64)[::-1]
    if np.isinf(heights).any():
        raise TopographyError(f"{says} holds infinite heights; mark these points as missing.")
    defined = ~np.isnan(heights)
    missing = 1 - np.count_nonzero(defined) / defined.size
    if missing > _MISSING_MAX:
        share = "all" if missing == 1 else f"{missing:.0%}"
        raise TopographyError(
            f"{says} misses {share} of its points, more than {_MISSING_MAX:.0%}; measure it again "
            f"or crop it."
        )
    return Measured(np.where(defined, heights * scale, 0.0), defined, pitch)


def size_mm(
    topography: Described, path: Path, file: str = "station", key: str = "part.relief"
) -> tuple[float, float]:
    """Return the extent of a map along x and y; it is remembered until the file changes.

    Parameters
    ----------
    topography, path, file, key
        As :func:`read_topography` takes them.

    Raises
    ------
    TopographyError
        As :func:`read_topography`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from gpuspec.station.defects import Topography
    >>> from gpuspec.topographies.file import size_mm
    >>> np.save("heights.npy", np.zeros((480, 640)))
    >>> size_mm(Topography(file="heights.npy", height_unit="um", pitch_um=3.5), Path("heights.npy"))
    (2.24, 1.68)
    """
    state = path.stat() if path.is_file() else None
    changed = (state.st_mtime_ns, state.st_size) if state else None
    return _size(topography, path, changed, file, key)


@lru_cache(maxsize=32)
def _size(
    topography: Described, path: Path, changed: object, file: str, key: str
) -> tuple[float, float]:
    says = f'{file}: {key}.file = "{topography.file}"'
    grid = _grid(topography, path, says, 0)
    _height_mm(topography, grid.unit, says, key)
    pitch = _pitch(topography, grid, says, key)
    ny, nx = grid.heights.shape
    return nx * pitch[0], ny * pitch[1]


def _height_mm(topography: Described, unit: str | None, says: str, key: str) -> float:
    """Return the mm of a unit of the heights."""
    given = topography.height_unit
    if unit is None:
        if given is None:
            raise TopographyError(
                f"{says} carries no length unit, so its heights mean nothing; give "
                f'{key}.height_unit ("m", "mm", "um" or "nm") and {key}.pitch_um, the distance of '
                f"two points, or use a format with units, such as .sur, .x3p or .al3d."
            )
        return _MM[given]
    if given is not None and given != unit:
        raise TopographyError(
            f'{says} states its own units, and {key}.height_unit = "{given}" another than its '
            f'"{unit}"; leave height_unit out, or export the file with the right units.'
        )
    return _MM["mm"]


def _pitch(topography: Described, grid: _Grid, says: str, key: str) -> tuple[float, float]:
    given = topography.pitch_um
    pair = (given, given) if isinstance(given, float) else given
    wanted = None if pair is None else (pair[0] * MICRO, pair[1] * MICRO)
    if grid.pitch_mm is None:
        if wanted is None:
            raise TopographyError(
                f"{says} does not say how far apart its points are; give {key}.pitch_um, a number "
                f"or [along x, along y]."
            )
        return wanted
    if not all(np.isfinite(p) and p > 0 for p in grid.pitch_mm):
        raise TopographyError(f"{says} has a pitch of {grid.pitch_mm} mm; export it again.")
    if wanted is not None and any(
        abs(a - b) > _SAME * b for a, b in zip(wanted, grid.pitch_mm, strict=True)
    ):
        own = " x ".join(f"{p / MICRO:.6g}" for p in grid.pitch_mm)
        raise TopographyError(
            f"{says} states a pitch of {own} um itself, and {key}.pitch_um another; leave pitch_um "
            f"out, or export the file with the right units."
        )
    return grid.pitch_mm


def _grid(topography: Described, path: Path, says: str, points: int) -> _Grid:
    """Read a file by the first reader that knows it."""
    if is_made(topography.file, path):
        made = surface(topography.file)
        return _Grid(made.heights_mm, "mm", (made.pitch_mm, made.pitch_mm))
    if path.is_dir():
        raise TopographyError(f"{says} is a folder; name a file in it.")
    if not path.is_file():
        raise TopographyError(f"{says} is not there; looked for {path}.")
    kind = path.suffix.lower()
    with silence():
        # A reader given damaged bytes may raise anything.
        try:
            values = None
            if kind == ".npy":
                values = np.load(path, mmap_mode="r", allow_pickle=False)
            elif kind in (".tif", ".tiff"):
                values = _picture(path)
            elif kind in _TEXT:
                values = _matrix(path)
            if values is None:
                return _instrument(path, says, points)
            _check_numbers(values, says)
            _check_grid(values.shape[::-1], True, says, points)
            return _Grid(values)
        except TopographyError:
            raise
        except Exception as error:
            raise TopographyError(
                f"{says} cannot be read ({brief(error)}); it may be damaged: export it again."
            ) from None


def _instrument(path: Path, says: str, points: int) -> _Grid:
    """Read what SurfaceTopography knows."""
    try:
        from SurfaceTopography import open_topography
        from SurfaceTopography.Exceptions import CannotDetectFileFormat
    except ImportError as error:
        raise TopographyError(
            f"{says} cannot be read without SurfaceTopography ({error}); {INSTALL}."
        ) from None
    try:
        reader = open_topography(str(path))
    except CannotDetectFileFormat:
        raise TopographyError(
            f"{says} is in no format that SurfaceTopography knows, or is damaged; export it "
            f"from the instrument as .sur, .x3p or .al3d."
        ) from None
    with reader:
        channel = reader.default_channel
        size = tuple(int(n) for n in channel.nb_grid_pts or ())
        _check_grid(size, channel.is_uniform is not False, says, points)
        pitch = None
        if channel.unit:
            measured = reader.topography().to_unit("mm")
            pitch = tuple(float(p) for p in measured.pixel_size)
        elif channel.physical_sizes is None:
            measured = reader.topography(physical_sizes=(1.0, 1.0))
        else:
            measured = reader.topography()
        heights: Any = np.ma.asarray(measured.heights()).astype(np.float64)
        unit = channel.unit.replace("µ", "u").replace("μ", "u") if channel.unit else None
        return _Grid(heights.filled(np.nan).T, unit, (pitch[0], pitch[1]) if pitch else None)


def _picture(path: Path) -> NDArray[Any]:
    import tifffile

    with tifffile.TiffFile(path) as file:
        values: NDArray[Any] = file.asarray()
    return values


def _matrix(path: Path) -> Heights | None:
    """Read lines of numbers; None: anything else, such as a header that states units.

    Cells are apart by tabs, semicolons, commas or blanks; a comma is the decimal one where tabs or
    semicolons are there.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        return None
    lines = [line for line in text.splitlines() if line.strip()]
    remarks = [line for line in lines if line.startswith(("#", "%"))]
    lines = [line for line in lines if not line.startswith(("#", "%"))]
    if not lines or any(re.search("[:=]", remark) for remark in remarks):
        return None
    apart = next((sign for sign in ("\t", ";", ",") if sign in lines[0]), None)
    comma = apart in ("\t", ";") and "," in lines[0]
    if apart and all(line.rstrip(" ").endswith(apart) for line in lines):
        lines = [line.rstrip(" ")[:-1] for line in lines]
    rows = []
    for line in lines:
        cells = (line.replace(",", ".") if comma else line).split(apart)
        try:
            rows.append(np.array(cells, np.float64))
        except ValueError:
            try:
                rows.append(np.array([_number(cell) for cell in cells]))
            except ValueError:
                return None
        if len(rows[-1]) != len(rows[0]):
            return None
    # Two or three columns are a profile or a list of points to SurfaceTopography.
    return np.stack(rows) if len(rows[0]) >= SIDE_MIN else None


def _number(cell: str) -> float:
    return np.nan if cell.strip().strip('"').lower() in _NO_NUMBER else float(cell)


def _check_numbers(values: NDArray[Any], says: str) -> None:
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        shape = " x ".join(map(str, values.shape)) or "no"
        raise TopographyError(
            f"{says} holds {shape} values of type {values.dtype}, not one matrix of heights (rows "
            f"x columns of numbers); export the height map alone, without colours or pages."
        )


def _check_grid(grid: tuple[int, ...], uniform: bool, says: str, points: int) -> None:
    if len(grid) != 2 or not uniform:
        raise TopographyError(
            f"{says} is {'a line scan' if len(grid) < 2 else 'scattered points'}, not an area "
            f"on a regular grid; give an areal topography."
        )
    if min(grid) < SIDE_MIN:
        raise TopographyError(
            f"{says} has {grid[0]} x {grid[1]} points; at least {SIDE_MIN} x {SIDE_MIN} are needed."
        )
    if grid[0] * grid[1] + points > POINTS_MAX:
        already = f" beside {points:,} of other maps" if points else ""
        raise TopographyError(
            f"{says} has {grid[0] * grid[1]:,} points{already}, more than {POINTS_MAX:,}; crop "
            f"or resample it."
        )


@contextmanager
def silence() -> Iterator[None]:
    """Keep what readers print of damaged files from the user, who gets one sentence."""
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)


def brief(error: Exception) -> str:
    """Return the first line of what a library says, to be put into a sentence."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0].rstrip(".")[:200]
