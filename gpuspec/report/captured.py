"""What an inspection of a camera's frames leaves behind, as far as a run's files mean something."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gpuspec import words
from gpuspec.detection.classes import Confusion
from gpuspec.detection.decision import Decision
from gpuspec.errors import OutputError
from gpuspec.files import Outputs, Space, folder_of
from gpuspec.frames.replay import Replay
from gpuspec.frames.silhouette import Silhouette
from gpuspec.pictures.seen import Inspected
from gpuspec.report.folder import (
    beside,
    classes_of,
    confusion_of,
    provenance,
    threshold_of,
    write_tif,
)
from gpuspec.report.silhouette import FILES as SILHOUETTE
from gpuspec.report.silhouette import write_silhouette
from gpuspec.station.station import Station
from gpuspec.station.toml import copies, keep

FILES = (
    "aspect.tif", "labels.tif", "truth.tif", "blobs.csv", "frames.csv", "score.json",
    "station.toml", "aspect.png", "detection.png", "histogram.png", "exposure.png", "exposure.csv",
)  # fmt: skip
"""What `inspect` writes."""
KIND = "inspection"


@dataclass(frozen=True)
class FrameRow:
    """What is known of a frame.

    Attributes
    ----------
    name : str
    path : Path or None
        Of its file; None: it came as an array.
    mean_dn : float
        Mean grey level.
    saturated : float
        Share of its pixels at full scale.
    used : bool
        Whether the aspect image is made of it.
    why : str
        Why it is not.
    """

    name: str
    path: Path | None
    mean_dn: float
    saturated: float
    used: bool = True
    why: str = ""


class Reported(Inspected, Protocol):
    """An inspection with all that is written of it; as :class:`gpuspec.Captured` explains."""

    @property
    def frames(self) -> tuple[FrameRow, ...]:
        """What each frame was."""

    @property
    def confusion(self) -> Confusion | None:
        """Known defects against classes found."""

    @property
    def decision(self) -> Decision:
        """Whether the part is accepted."""

    @property
    def silhouette(self) -> Silhouette | None:
        """The outline against the nominal one."""

    @property
    def made_with(self) -> Mapping[str, str]:
        """What else the image was made with."""


def outputs(
    station: Station, folder: str | Path, read: tuple[Path, ...] = (), *, force: bool = False
) -> Outputs:
    """Return what an inspection will write, to be checked before it and written after it.

    Parameters
    ----------
    station : Station
    folder : str or Path
    read : tuple of Path
        Files that are never replaced, beside the station's own.
    force : bool
        Whether files are replaced that are not known to be an earlier inspection's.

    Raises
    ------
    OutputError
        If it is the folder of a run, a sweep or a search.
    """
    folder = folder_of(folder)
    for name, what in (("sweep.json", "sweep"), ("optimise.json", "search")):
        if folder.joinpath(name).is_file():
            raise OutputError(f"{folder} is the folder of a {what}; choose another folder with -o.")
    rows, columns = station.shape
    space = Space(rows * columns * 6, f"images of {columns:,} x {rows:,} pixels", "cut the frames")
    names = (*FILES, *SILHOUETTE, *copies(station, "station").values())
    return Outputs(folder, KIND, names, (*station.inputs, *read), force=force, space=space)


def write_files(
    result: Reported,
    folder: Path,
    *,
    pictures: bool,
    progress: Callable[[str], None] | None = None,
) -> None:
    """Write an inspection's files straight into an existing folder.

    Parameters
    ----------
    result : Reported
    folder : Path
    pictures : bool
        Whether the pictures are drawn.
    progress : callable, optional
        Told what is being written.
    """
    tell = progress or (lambda _: None)
    tell("writing images and tables")
    with beside() as also:
        for name in ("aspect", "labels", *(("truth",) if result.score else ())):
            also(write_tif, folder / f"{name}.tif", getattr(result, name), result)
        with (folder / "blobs.csv").open("w", encoding="utf-8", newline="") as file:
            result.blobs.write_csv(file, result.classes.tolist())
        _write_frames(folder / "frames.csv", result)
        text = json.dumps(summary(result), indent=2) + "\n"
        (folder / "score.json").write_text(text, "utf-8")
        keep(result.station, folder / "station.toml")
        if result.silhouette is not None:
            about = f"{result.made}  ·  {result.about}"
            write_silhouette(result.silhouette, result.station, about, folder, pictures=pictures)
        if pictures:
            from gpuspec.pictures import all as figures

            for name in figures.IMAGE_FIGURES:
                tell(f"drawing {name}.png")
                also(figures.PICTURES[f"{name}.png"](result), folder / f"{name}.png")


def write_replay(found: Replay, about: str, folder: Path) -> None:
    """Write what each exposure would have shown, as a table and a picture.

    Parameters
    ----------
    found : Replay
    about : str
        Which frames.
    folder : Path
        An existing one.
    """
    from gpuspec.pictures.page import png
    from gpuspec.pictures.replay import replay_picture

    with (folder / "exposure.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(("exposure", "saturated", "contrast_dn", "noise_dn", "contrast_over_noise"))
        columns = found.exposure, found.saturated, found.contrast_dn, found.noise_dn, found.ratio
        table.writerows([f"{value:.5g}" for value in row] for row in zip(*columns, strict=True))
    (folder / "exposure.png").write_bytes(png(replay_picture(found, about)))


def summary(result: Reported) -> dict[str, Any]:
    """Return the content of `score.json`: what was found, by what, and the score if there is one.

    Parameters
    ----------
    result : Reported
    """
    used = [frame for frame in result.frames if frame.used]
    return {
        **provenance(result),
        "station": result.station.file,
        "frames": len(used),
        "fusion": result.station.sequence.fusion,
        "left_out": {frame.name: frame.why for frame in result.frames if not frame.used},
        "saturated": float(np.mean([frame.saturated for frame in used])),
        **result.made_with,
        "silhouette": result.silhouette and result.silhouette.as_dict(),
        **threshold_of(result),
        "blobs": len(result.blobs),
        "decision": {"accepted": result.decision.accepted, "reasons": result.decision.reasons},
        "score": result.score.as_dict() if result.score else None,
        **({"score_legend": words.LEGEND} if result.score else {}),
        "classes": classes_of(result),
        "confusion": confusion_of(result.confusion) if result.confusion else None,
        "warnings": list(result.warnings),
    }


def _write_frames(path: Path, result: Reported) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(("frame", "file", "mean_dn", "saturated", "used", "why"))
        for frame in result.frames:
            table.writerow(
                (frame.name, frame.path or "", f"{frame.mean_dn:.4f}", f"{frame.saturated:.5f}",
                 "yes" if frame.used else "no", frame.why)
            )  # fmt: skip
