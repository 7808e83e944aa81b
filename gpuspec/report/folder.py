"""What a run leaves behind: images, tables, score, pictures, and all that it was made from."""

from __future__ import annotations

import csv
import json
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpuspec import words
from gpuspec.detection.classes import Confusion
from gpuspec.detection.expected import Expected
from gpuspec.errors import OutputError
from gpuspec.files import Outputs, Space, folder_of
from gpuspec.frames.silhouette import Silhouette
from gpuspec.light.refinement import counted
from gpuspec.pictures.seen import Inspected, Previewed, Simulated
from gpuspec.report.silhouette import FILES as SILHOUETTE
from gpuspec.report.silhouette import write_silhouette
from gpuspec.station.station import Station
from gpuspec.station.toml import copies, keep
from gpuspec.version import __version__

FILES = (
    "aspect.tif", "frames.tif", "labels.tif", "truth.tif", "lost.tif", "blobs.csv", "defects.csv",
    "score.json", "station.toml", "station.png", "sequence.png", "sequence.gif", "aspect.png",
    "detection.png", "histogram.png", "over_threshold.png", "lost.png",
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
PREVIEW = ("preview.png",)
"""What it writes before."""


class Reported(Simulated, Protocol):
    """An inspection with all that is written of it; attributes as in a simulation's result."""

    @property
    def confusion(self) -> Confusion:
        """Known defects against classes found."""

    @property
    def silhouette(self) -> Silhouette | None:
        """The outline against that of the part without chips and burrs."""

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken as ideal."""

    @property
    def expected(self) -> Expected | None:
        """What noise makes of the score over all its draws."""


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
    names = (*FILES, PATTERN, *SILHOUETTE, *copies(station, "station").values())
    read = (*station.inputs, *also_read)
    space = _space(station, frames=frames)
    return Outputs(folder, KIND, names, read, force=force, over=("glance", "preview"), space=space)


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
    figures.PICTURES["detection.png"](result)(folder / "detection.png")


def write_preview(preview: Previewed, folder: Path) -> None:
    """Write what one sees first.

    Parameters
    ----------
    preview : Previewed
    folder : Path
        An existing one.
    """
    from gpuspec.pictures.page import encoded
    from gpuspec.pictures.preview import preview_picture

    (folder / PREVIEW[0]).write_bytes(encoded(preview_picture(preview)))


def write_files(
    result: Reported,
    folder: Path,
    *,
    frames: bool,
    pictures: bool,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Write a run's files straight into an existing folder; parameters as :func:`write`."""
    tell = progress or (lambda _: None)
    tell("writing images and tables")
    with beside() as also:
        for name in ARRAYS:
            also(write_tif, folder / f"{name}.tif", getattr(result, name), result)
        _write_tables(result, folder)
        if result.silhouette is not None:
            about = f"{result.made}  ·  {result.about}"
            write_silhouette(result.silhouette, result.station, about, folder, pictures=pictures)
        if frames:
            _write_frames(folder / "frames.tif", result, tell)
        if pictures:
            from gpuspec.pictures import all as figures

            for name in figures.pictures_of(result):
                tell(f"drawing {name}")
                also(figures.PICTURES[name](result), folder / name)


@contextmanager
def beside() -> Iterator[Callable[..., None]]:
    """Give what has a function called in another thread: for compression, that needs no Python.

    At the end all are waited for; what one raises is raised. What has not begun when the block
    fails is left out.
    """
    called: list[Future[Any]] = []
    with ThreadPoolExecutor(1, "gpuspec-files") as thread:
        try:
            yield lambda *call: called.append(thread.submit(*call))
            for one in called:
                one.result()
        except BaseException:
            thread.shutdown(cancel_futures=True)
            raise


def _write_tables(result: Reported, folder: Path) -> None:
    """Write tables and score, and what the run was made from."""
    with (folder / "blobs.csv").open("w", encoding="utf-8", newline="") as file:
        result.blobs.write_csv(file, result.classes.tolist())
    _write_defects(folder / "defects.csv", result)
    (folder / "score.json").write_text(json.dumps(summary(result), indent=2) + "\n", "utf-8")
    keep(result.station, folder / "station.toml")
    pattern = result.light_map.pattern
    if pattern:
        (folder / PATTERN).write_text(pattern.text, "utf-8")


def provenance(result: Inspected) -> dict[str, Any]:
    """Return what every output records: program, backend, device, driver and version."""
    return {"gpuspec": __version__, **result.info.as_dict()}


def summary(result: Reported) -> dict[str, Any]:
    """Return the content of `score.json`: score, threshold, classes, confusion, provenance.

    Under `refined` stands how many pixels have sub-rays because one footprint does not tell them,
    see :func:`gpuspec.light.refinement.counted`; under `expected` what noise makes of the score
    over all its draws, null without noise or where no closed form tells it, see
    :attr:`gpuspec.simulation.result.Result.expected`.
    """
    return {
        **provenance(result),
        "station": result.station.file,
        "pattern": result.light_map.pattern.file if result.light_map.pattern else None,
        **threshold_of(result),
        "refined": counted(result.light_map.refined),
        "score": result.score.as_dict(),
        "score_legend": words.LEGEND,
        "expected": result.expected and result.expected.as_dict(),
        "silhouette": result.silhouette and result.silhouette.as_dict(),
        "classes": classes_of(result),
        "confusion": confusion_of(result.confusion),
        "warnings": list(result.warnings),
        "assumptions": list(result.assumptions),
    }


def threshold_of(result: Inspected) -> dict[str, Any]:
    """Return the threshold and how it came about, as `score.json` tells it."""
    found = result.inspection
    return {
        "threshold_dn": found.threshold,
        "threshold_rule": found.rule,
        "threshold_said": found.threshold_said,
        "ceiling_dn": found.ceiling and found.ceiling.level_dn,
        "ceiling_noise_dn": found.ceiling and found.ceiling.noise_dn,
        "flawless_dn": found.flawless_dn,
    }


def classes_of(result: Inspected) -> dict[str, int]:
    """Return how many blobs there are of each class."""
    names, counts = np.unique(result.classes, return_counts=True)
    return {str(n): int(c) for n, c in zip(names, counts, strict=True)}


def confusion_of(table: Confusion) -> dict[str, dict[str, int]]:
    """Return how many defects of each kind were taken for which class."""
    return {
        row: dict(zip(table.columns, map(int, line), strict=True))
        for row, line in zip(table.rows, table.counts, strict=True)
    }


def _tags(result: Inspected) -> dict[str, Any]:
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


def write_tif(path: Path, image: NDArray[Any], result: Inspected) -> None:
    """Write an image as a TIFF that tells its scale and what made it.

    Parameters
    ----------
    path : Path
    image : ndarray, shape (M, N)
    result : Inspected
    """
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
