"""Pictures of a simulated inspection, for a person to look at.

Each is a `matplotlib.figure.Figure`, or a GIF, in the part frame: mm, x along the columns, y up.
Images larger than their box on the page are reduced before they are drawn, grey levels by their
mean, zones and blobs by their maximum, so that no defect disappears and memory stays small.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from gpuspec.errors import StationError
from gpuspec.pictures.aspect import aspect_picture
from gpuspec.pictures.detection import detection_picture
from gpuspec.pictures.histogram import histogram_picture
from gpuspec.pictures.lost import lost_picture
from gpuspec.pictures.page import png
from gpuspec.pictures.seen import Inspected
from gpuspec.pictures.sequence import sequence_animation, sequence_strip
from gpuspec.pictures.station import station_picture

__all__ = [
    "FIGURES",
    "PICTURES",
    "aspect_picture",
    "detection_picture",
    "histogram_picture",
    "lost_picture",
    "picture",
    "pictures_of",
    "png",
    "sequence_animation",
    "sequence_strip",
    "station_picture",
]


FIGURES: dict[str, Callable[[Inspected], Figure]] = {
    "station": station_picture,
    "sequence": sequence_strip,
    "aspect": aspect_picture,
    "detection": detection_picture,
    "histogram": histogram_picture,
    "lost": lost_picture,
}
"""What a run draws on a page: name to what draws it."""


def _written(draw: Callable[[Inspected], Figure]) -> Callable[[Inspected, Path], None]:
    def write(result: Inspected, path: Path) -> None:
        path.write_bytes(png(draw(result)))

    return write


PICTURES: dict[str, Callable[[Inspected, Path], None]] = {
    **{f"{name}.png": _written(draw) for name, draw in FIGURES.items()},
    "sequence.gif": sequence_animation,
}
"""What a run draws: file name to what writes it."""


def pictures_of(result: Inspected) -> tuple[str, ...]:
    """Return which of ``PICTURES`` tell the truth: a station's has stripes, and a pattern none."""
    return tuple(
        name for name in PICTURES if name != "station.png" or result.light_map.pattern is None
    )


def picture(result: Inspected, name: str) -> Figure:
    """Draw one of ``FIGURES`` by its name.

    Parameters
    ----------
    result : Inspected
    name : str
        E.g. ``"histogram"``.

    Raises
    ------
    StationError
        If there is no picture of that name; with those there are.
    """
    names = [one for one in FIGURES if f"{one}.png" in pictures_of(result)]
    if name not in names:
        raise StationError(f"there is no picture {name!r}; choose one of {', '.join(names)}.")
    return FIGURES[name](result)
