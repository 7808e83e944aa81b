"""What a comparison of outlines leaves behind: a table and a picture."""

from __future__ import annotations

import csv
from pathlib import Path

from gpuspec.frames.silhouette import Silhouette
from gpuspec.station.station import Station

FILES = ("silhouette.csv", "silhouette.png")
"""What is written of it."""


def write_silhouette(
    found: Silhouette, station: Station, about: str, folder: Path, *, pictures: bool
) -> None:
    """Write what is missing and what is extra, as a table and a picture.

    Parameters
    ----------
    found : Silhouette
    station : Station
        Of its image.
    about : str
        Which frames.
    folder : Path
        An existing one.
    pictures : bool
        Whether the picture is drawn.
    """
    with (folder / FILES[0]).open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ("find", "kind", "x_mm", "y_mm", "area_px", "area_mm2", "width_mm", "depth_mm")
        )
        for number, one in enumerate(found.finds, 1):
            table.writerow(
                (number, one.kind, f"{one.x_mm:.4f}", f"{one.y_mm:.4f}", one.area_px,
                 f"{one.area_mm2:.5g}", f"{one.width_mm:.4g}", f"{one.depth_mm:.4g}")
            )  # fmt: skip
    if pictures:
        from gpuspec.pictures.page import png
        from gpuspec.pictures.silhouette import silhouette_picture

        (folder / FILES[1]).write_bytes(png(silhouette_picture(found, station, about)))
