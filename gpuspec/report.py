"""What a run leaves behind: images, tables, score and pictures, each whole or not at all."""

from __future__ import annotations

import csv
import glob
import json
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec import __version__
from gpuspec.errors import OutputError
from gpuspec.inspection import Result
from gpuspec.stationfile import to_toml

FILES = (
    "aspect.tif", "frames.tif", "labels.tif", "truth.tif", "blobs.csv", "defects.csv",
    "score.json", "station.toml", "station.png", "sequence.png", "sequence.gif", "aspect.png",
    "detection.png", "histogram.png", "lost.png",
)  # fmt: skip
"""What `simulate` writes."""
PATTERN = "pattern.glsl"  # beside them, of a prototype

# Of hidden folders; a process number tells nothing about another machine on a shared disk.
_PREFIX = f".gpuspec-{platform.node() or 'local'}-"


@contextmanager
def output_folder(folder: Path, replaces: tuple[str, ...] = (*FILES, PATTERN)) -> Iterator[Path]:
    """Give a hidden folder to write in; on success its files move to `folder`, else it vanishes.

    Files of an earlier run (`replaces`) that this one did not write are removed with the move, so
    that a folder never mixes two runs. What a killed run left hidden is removed by the next one
    beside it.

    Raises
    ------
    OutputError
        If the folder cannot be made or written, or the disk is full.
    """
    folder = Path(folder)
    partial: Path | None = None
    try:
        above = next(
            p for p in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(p)
        )
        if not above.is_dir():
            raise OutputError(f"{above} is a file; choose another folder with -o.")
        for name in replaces:
            if (folder / name).is_dir():
                raise OutputError(f"{folder / name} is a folder; choose another folder with -o.")
        _remove_left_behind(above)
        partial = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-", dir=above))
        partial.chmod(0o755)
        yield partial
        folder.mkdir(parents=True, exist_ok=True)
        written = {path.name for path in partial.iterdir()}
        try:
            _move(partial, folder, set(replaces) - written)
        except OSError:
            raise
        except BaseException:  # Ctrl-C: the whole run is there, so finish what takes no time
            _move(partial, folder, set(replaces) - written)
            raise
    except OSError as error:
        # NumPy reports a short write without its reason.
        reason = error.strerror or f"the disk may be full ({error})"
        raise OutputError(
            f"results cannot be written to {folder}: {reason}. Free some space or choose another "
            f"folder with -o; nothing half-written was left."
        ) from None
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)


def _move(partial: Path, folder: Path, stale: set[str]) -> None:
    for path in sorted(partial.iterdir()):
        path.replace(folder / path.name)
    for name in stale:
        (folder / name).unlink(missing_ok=True)


def _remove_left_behind(above: Path) -> None:
    """Remove the hidden folders of this machine's runs that were killed: their process is gone."""
    if os.name != "posix":  # there, signal 0 would end the process it asks about
        return
    for left in above.glob(f"{glob.escape(_PREFIX)}*-*"):
        number = left.name.removeprefix(_PREFIX).partition("-")[0]
        if not number.isdecimal():
            continue
        try:
            os.kill(int(number), 0)
        except ProcessLookupError:
            shutil.rmtree(left, ignore_errors=True)
        except (OSError, OverflowError):
            continue


def write(
    result: Result,
    folder: str | Path,
    *,
    frames: bool = False,
    pictures: bool = True,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Write a run's files into a folder.

    Parameters
    ----------
    result : Result
    folder : str or Path
        Made if missing. Files of an earlier run in it are replaced.
    frames : bool
        Whether to write every image of the sequence, too.
    pictures : bool
        Whether to draw the pictures.
    progress : callable, optional
        Told what is being written.

    Raises
    ------
    OutputError
        If the folder cannot be written or the disk is full; nothing is left half-written.
    """
    with output_folder(Path(folder)) as partial:
        write_files(result, partial, frames=frames, pictures=pictures, progress=progress)


def write_glance(result: Result, folder: Path) -> None:
    """Write what one looks at while trying things: the score, and the detection over the aspect."""
    from gpuspec import figures

    (folder / "score.json").write_text(json.dumps(summary(result), indent=2) + "\n", "utf-8")
    figures.PICTURES["detection.png"](result, folder / "detection.png")


def write_files(
    result: Result,
    folder: Path,
    *,
    frames: bool,
    pictures: bool,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Write a run's files straight into an existing folder; see :func:`write`."""
    tell = progress or (lambda _: None)
    tell("writing images and tables")
    _write_tif(folder / "aspect.tif", result.aspect, result)
    _write_tif(folder / "labels.tif", result.labels, result)
    _write_tif(folder / "truth.tif", result.truth, result)
    with (folder / "blobs.csv").open("w", encoding="utf-8", newline="") as file:
        result.blobs.write_csv(file, result.classes.tolist())
    _write_defects(folder / "defects.csv", result)
    (folder / "score.json").write_text(json.dumps(summary(result), indent=2) + "\n", "utf-8")
    (folder / "station.toml").write_text(to_toml(result.station, absolute=True), "utf-8")
    pattern = result.light_map.pattern
    if pattern:
        (folder / PATTERN).write_text(pattern.text, "utf-8")
    if frames:
        _write_frames(folder / "frames.tif", result, tell)
    if pictures:
        from gpuspec import figures

        for name, draw in figures.PICTURES.items():
            if pattern and name == "station.png":  # it draws the stripes
                continue
            tell(f"drawing {name}")
            draw(result, folder / name)


def provenance(result: Result) -> dict[str, Any]:
    """Return what every output records: program, backend, device, driver and version."""
    return {"gpuspec": __version__, **result.info.as_dict()}


def summary(result: Result) -> dict[str, Any]:
    """Return the content of `score.json`: score, threshold, classes, confusion, provenance."""
    names, counts = np.unique(result.classes, return_counts=True)
    return {
        **provenance(result),
        "station": result.station.file,
        "pattern": result.light_map.pattern.file if result.light_map.pattern else None,
        "threshold_dn": result.threshold,
        "flawless_dn": result.flawless_dn,
        "score": result.score.as_dict(),
        "classes": {str(n): int(c) for n, c in zip(names, counts, strict=True)},
        "confusion": {
            row: dict(zip(result.confusion.columns, map(int, line), strict=True))
            for row, line in zip(result.confusion.rows, result.confusion.counts, strict=True)
        },
        "warnings": list(result.warnings),
    }


def _tags(result: Result) -> dict[str, Any]:
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


def _write_tif(path: Path, image: NDArray[Any], result: Result) -> None:
    import tifffile

    tifffile.imwrite(path, image, compression="zlib" if image.dtype == np.int32 else None,
                     **_tags(result))  # fmt: skip


def _write_frames(path: Path, result: Result, tell: Callable[[str], None]) -> None:
    """Write the images one after another: the sequence is never held."""
    import tifffile

    station = result.station
    dtype = np.uint8 if station.sensor.bit_depth == 8 else np.uint16
    rows, columns = station.shape
    size = rows * columns * np.dtype(dtype).itemsize * station.sequence.images
    with tifffile.TiffWriter(path, bigtiff=size > 2**31) as file:
        for k in range(station.sequence.images):
            tell(f"writing image {k + 1} of {station.sequence.images}")
            grey = np.rint(result.light_map.image(k)).astype(dtype)
            file.write(grey, contiguous=False, **_tags(result))


def _write_defects(path: Path, result: Result) -> None:
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
