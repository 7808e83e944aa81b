"""Pictures of a simulated inspection, for a person to look at.

Each is a `matplotlib.figure.Figure`, or a GIF, in the part frame: mm, x along the columns, y up.
Images larger than their box on the page are reduced before they are drawn, grey levels by their
mean, zones and blobs by their maximum, so that no defect disappears and memory stays small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from gpuspec.errors import StationError
from gpuspec.pictures.aspect import aspect_picture
from gpuspec.pictures.detection import detection_picture
from gpuspec.pictures.histogram import histogram_picture
from gpuspec.pictures.lost import lost_picture
from gpuspec.pictures.over_threshold import over_threshold_picture
from gpuspec.pictures.page import drawn, encoded, png
from gpuspec.pictures.seen import Inspected, Simulated
from gpuspec.pictures.sequence import (
    animation_pages,
    sequence_animation,
    sequence_strip,
    write_animation,
)
from gpuspec.pictures.station import station_picture

__all__ = [
    "FIGURES",
    "IMAGE_FIGURES",
    "PICTURES",
    "aspect_picture",
    "detection_picture",
    "figure_of",
    "histogram_picture",
    "lost_picture",
    "over_threshold_picture",
    "picture",
    "pictures_of",
    "png",
    "sequence_animation",
    "sequence_strip",
    "station_picture",
]


IMAGE_FIGURES: dict[str, Callable[[Inspected], Figure]] = {
    "aspect": aspect_picture,
    "detection": detection_picture,
    "histogram": histogram_picture,
}
"""What is drawn of any aspect image, simulated or real: name to what draws it."""
FIGURES: dict[str, Callable[[Simulated], Figure]] = {
    "station": station_picture,
    "sequence": sequence_strip,
    **IMAGE_FIGURES,
    "over_threshold": over_threshold_picture,
    "lost": lost_picture,
}
"""What a run draws on a page: name to what draws it."""


Write = Callable[[Path], Any]
"""What is left to do of a drawn picture: little of it is Python's, so that another thread can."""


def _page(draw: Callable[[Any], Figure]) -> Callable[[Any], Write]:
    def picture(result: Any) -> Write:
        page = drawn(draw(result))
        return lambda path: path.write_bytes(encoded(page))

    return picture


def _animation(result: Simulated) -> Write:
    pages = animation_pages(result)
    return lambda path: write_animation(pages, path)


PICTURES: dict[str, Callable[[Any], Write]] = {
    **{f"{name}.png": _page(draw) for name, draw in FIGURES.items()},
    "sequence.gif": _animation,
}
"""What a run draws: file name to what draws it and returns what writes it."""


def pictures_of(result: Simulated) -> tuple[str, ...]:
    """Return which of ``PICTURES`` tell the truth.

    A station's has stripes, and a pattern none; over the threshold something is to be found.
    """
    without = {
        "station.png": result.light_map.pattern is not None,
        "over_threshold.png": not result.score.zone_px,
    }
    return tuple(name for name in PICTURES if not without.get(name))


def picture(result: Simulated, name: str) -> Figure:
    """Draw one of ``FIGURES`` by its name.

    Parameters
    ----------
    result : Simulated
    name : str
        E.g. ``"histogram"``.

    Raises
    ------
    StationError
        If there is no picture of that name; with those there are.
    """
    there = pictures_of(result)
    return figure_of(result, name, {n: d for n, d in FIGURES.items() if f"{n}.png" in there})


def figure_of(result: Any, name: str, figures: Mapping[str, Callable[[Any], Figure]]) -> Figure:
    """Draw one of some figures by its name.

    Parameters
    ----------
    result : Inspected
        As the figures take it.
    name : str
    figures : mapping of str to callable
        Name to what draws it.

    Raises
    ------
    StationError
        If there is no picture of that name; with those there are.
    """
    if name not in figures:
        raise StationError(f"there is no picture {name!r}; choose one of {', '.join(figures)}.")
    return figures[name](result)
