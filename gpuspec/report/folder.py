"""What a run leaves behind: images, tables, score, pictures, and all that it was made from."""

from __future__ import annotations

import csv
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec import words
from gpuspec.detection.classes import Confusion
from gpuspec.errors import OutputError
from gpuspec.files import Outputs, Space, folder_of
from gpuspec.pictures.seen import Inspected
from gpuspec.station.station import Station
from gpuspec.station.toml import copies, keep
from gpuspec.version import __version__

FILES = (
    "aspect.tif", "frames.tif", "labels.tif", "truth.tif", "lost.tif", "blobs.csv", "defects.csv",
    "score.json", "station.toml", "station.png", "sequence.png", "sequence.gif", "aspect.png",
    "detection.png", "histogram.png", "lost.png",
)  # fmt: skip
"""What `simulate` writes."""
ARRAYS = ("aspect", "labels", "truth", "lost")
"""Images of a run that are kept to the bit, each as a TIFF."""
PATTERN = "pattern.glsl"  # beside them, of a prototype
_LABELS_BYTES = 1  # a pixel, of both label images, compressed: at the most, about
_PAGE_BYTES = 700  # of a TIFF's page beside its pixels

KIND = "run"
GLANCE = ("score.json", "detection.png")
"""What `prototype --watch` writes."""


class Reported(Inspected, Protocol):
    """An inspection with all that is written of it; attributes as in a simulation's result."""

    @property
    def confusion(self) -> Confusion:
        """Known defects against classes found."""

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken as ideal."""


def outputs(
    station: Station,
    folder: str | Path,
    *,
    frames: bool = False,
    force: bool = False,
    also_read: tuple[Path, ...] = (),
) -> Outputs:
    """Return what a run will write, to be checked before it and written after it.

    Parameters
    ----------
    station : Station
    folder : str or Path
    frames : bool
        Whether every image of the sequence is written, too.
    force : bool
        Whether files are replaced that are not known to be an earlier run's.
    also_read : tuple of Path
        Files that are never replaced, beside the station's own.

    Raises
    ------
    OutputError
        If it is the folder of a sweep or a search.
    """
    folder = folder_of(folder)
    for name in ("sweep.json", "optimise.json"):
        if os.path.isfile(folder / name):  # noqa: PTH113 (False for impossible names)
            raise OutputError(
                f"{folder} is the folder of {'a sweep' if name == 'sweep.json' else 'a search'}, "
                f"not of a run; choose another folder with -o."
            )
    names = (*FILES, PATTERN, *copies(station, "station").values())
    read = (*station.inputs, *also_read)
    space = _space(station, frames=frames)
    return Outputs(folder, KIND, names, read, force=force, over=("glance",), space=space)


def _space(station: Station, *, frames: bool) -> Space:
    rows, columns = station.shape
    pixels = rows * columns
    size = pixels * (4 + _LABELS_BYTES) + sum(
        path.stat().st_size for path in map(station.locate, station.files) if path.is_file()
    )
    images = station.sequence.images
    if not frames:
        what = f"images of {columns:,} x {rows:,} pixels"
        return Space(size, what, "set smaller camera.columns and camera.rows")
    size += images * (pixels * np.dtype(_grey(station)).itemsize + _PAGE_BYTES)
    what = f"{images:,} images of {columns:,} x {rows:,} pixels"
    return Space(size, what, "leave --frames out, or set fewer sequence.images")


def _grey(station: Station) -> type[np.uint8 | np.uint16]:
    """Return the kind of number that holds a station's grey levels."""
    return np.uint8 if station.sensor.bit_depth == 8 else np.uint16


def write(
    result: Reported,
    folder: str | Path,
    *,
    frames: bool = False,
    pictures: bool = True,
    force: bool = False,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Write a run's files into a folder.

    Parameters
    ----------
    result : Reported
    folder : str or Path
        Made if missing. Files of an earlier run in it are replaced, and no others.
    frames : bool
        Whether to write every image of the sequence, too.
    pictures : bool
        Whether to draw the pictures.
    force : bool
        Whether files of the same names are replaced that are not known to be an earlier run's;
        what the run was made from never is.
    progress : callable, optional
        Told what is being written.

    Raises
    ------
    OutputError
        If a file is in the way, the folder cannot be written or the disk is full; nothing is left
        half-written.

    Examples
    --------
    >>> from pathlib import Path
    >>> result = gpuspec.simulate(gpuspec.example("trim").replace(camera__sampling_mm=0.5))
    >>> gpuspec.write(result, "run", pictures=False)
    >>> sorted(file.name for file in Path("run").glob("*.csv"))
    ['blobs.csv', 'defects.csv']
    """
    with outputs(result.station, folder, frames=frames, force=force).writing() as partial:
        write_files(result, partial, frames=frames, pictures=pictures, progress=progress)


def write_glance(result: Reported, folder: Path) -> None:
    """Write what one looks at while trying things: the score, and the detection over the aspect.

    Parameters
    ----------
    result : Reported
    folder : Path
        An existing one.
    """
    from gpuspec.pictures import all as figures

    (folder / "score.json").write_text(json.dumps(summary(result), indent=2) + "\n", "utf-8")
    figures.PICTURES["detection.png"](result, folder / "detection.png")


def write_files(
    result: Reported,
    folder: Path,
    *,
    frames: bool,
    pictures: bool,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Write a run's files straight into an existing folder; see :func:`write`.

    Parameters
    ----------
    result : Reported
    folder : Path
        An existing one.
    frames : bool
        Whether every image of the sequence is written, too.
    pictures : bool
        Whether pictures are drawn.
    progress : callable, optional
        Told in a few words what is being done.
    """
    tell = progress or (lambda _: None)
    tell("writing images and tables")
    for name in ARRAYS:
        _write_tif(folder / f"{name}.tif", getattr(result, name), result)
    with (folder / "blobs.csv").open("w", encoding="utf-8", newline="") as file:
        result.blobs.write_csv(file, result.classes.tolist())
    _write_defects(folder / "defects.csv", result)
    (folder / "score.json").write_text(json.dumps(summary(result), indent=2) + "\n", "utf-8")
    keep(result.station, folder / "station.toml")
    pattern = result.light_map.pattern
    if pattern:
        (folder / PATTERN).write_text(pattern.text, "utf-8")
    if frames:
        _write_frames(folder / "frames.tif", result, tell)
    if pictures:
        from gpuspec.pictures import all as figures

        for name in figures.pictures_of(result):
            tell(f"drawing {name}")
            figures.PICTURES[name](result, folder / name)


def provenance(result: Reported) -> dict[str, Any]:
    """Return what every output records: program, backend, device, driver and version."""
    return {"gpuspec": __version__, **result.info.as_dict()}


def summary(result: Reported) -> dict[str, Any]:
    """Return the content of `score.json`: score, threshold, classes, confusion, provenance."""
    names, counts = np.unique(result.classes, return_counts=True)
    return {
        **provenance(result),
        "station": result.station.file,
        "pattern": result.light_map.pattern.file if result.light_map.pattern else None,
        "threshold_dn": result.threshold,
        "flawless_dn": result.flawless_dn,
        "score": result.score.as_dict(),
        "score_legend": words.LEGEND,
        "classes": {str(n): int(c) for n, c in zip(names, counts, strict=True)},
        "confusion": {
            row: dict(zip(result.confusion.columns, map(int, line), strict=True))
            for row, line in zip(result.confusion.rows, result.confusion.counts, strict=True)
        },
        "warnings": list(result.warnings),
        "assumptions": list(result.assumptions),
    }


def _tags(result: Reported) -> dict[str, Any]:
    per_cm = 10 / result.station.camera.sampling_mm
    return {
        "resolution": (per_cm, per_cm),
        "resolutionunit": "CENTIMETER",
        "software": f"gpuspec {__version__}",
        "description": json.dumps(
            {**provenance(result), "sampling_mm": result.station.camera.sampling_mm}
        ),
        "metadata": None,
    }


def _write_tif(path: Path, image: NDArray[Any], result: Reported) -> None:
    import tifffile

    tifffile.imwrite(path, image, compression=None if image.dtype.kind == "f" else "zlib",
                     **_tags(result))  # fmt: skip


def _write_frames(path: Path, result: Reported, tell: Callable[[str], None]) -> None:
    """Write the images one after another: the sequence is never held."""
    import tifffile

    station = result.station
    dtype = _grey(station)
    rows, columns = station.shape
    images = station.sequence.images
    size = rows * columns * np.dtype(dtype).itemsize * images
    began = time.monotonic()
    with tifffile.TiffWriter(path, bigtiff=size > 2**31) as file:
        for k in range(images):
            left = (images - k) * (time.monotonic() - began) / k if k else 0.0
            tell(f"writing image {k + 1:,} of {images:,}, about {left / 60:.0f} min left"
                 if left > 60 else f"writing image {k + 1:,} of {images:,}")  # fmt: skip
            grey = np.rint(result.light_map.image(k)).astype(dtype)
            file.write(grey, contiguous=False, **_tags(result))


def _write_defects(path: Path, result: Reported) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ("defect", "kind", "x_mm", "y_mm", "size_mm", "length_mm", "depth_um", "zone_px",
             "hit_px", "hit")
        )  # fmt: skip
        hits = zip(result.score.defect_zone_px, result.score.defect_hit_px, strict=True)
        for number, (defect, (zone, hit)) in enumerate(zip(result.defects, hits, strict=True), 1):
            table.writerow(
                (number, defect.kind, f"{defect.x_mm:.4f}", f"{defect.y_mm:.4f}",
                 f"{defect.size_mm:.4g}", f"{defect.length_mm:.4g}", f"{defect.depth_um:.4g}",
                 int(zone), int(hit), "yes" if hit else "no")
            )  # fmt: skip
