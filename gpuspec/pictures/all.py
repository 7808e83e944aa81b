"""Pictures of a simulated inspection, for a person to look at.

Each is a `matplotlib.figure.Figure`, or a GIF, in the part frame: mm, x along the columns, y up.
Images larger than their box on the page are reduced before they are drawn, grey levels by their
mean, zones and blobs by their maximum, so that no defect disappears and memory stays small.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from gpuspec.pictures.aspect import aspect_picture
from gpuspec.pictures.detection import detection_picture
from gpuspec.pictures.histogram import histogram_picture
from gpuspec.pictures.lost import lost_picture
from gpuspec.pictures.page import png
from gpuspec.pictures.seen import Inspected
from gpuspec.pictures.sequence import sequence_animation, sequence_strip
from gpuspec.pictures.station import station_picture

__all__ = [
    "PICTURES",
    "aspect_picture",
    "detection_picture",
    "histogram_picture",
    "lost_picture",
    "png",
    "sequence_animation",
    "sequence_strip",
    "station_picture",
]


def _written(draw: Callable[[Inspected], Figure]) -> Callable[[Inspected, Path], None]:
    def write(result: Inspected, path: Path) -> None:
        path.write_bytes(png(draw(result)))

    return write


PICTURES: dict[str, Callable[[Inspected, Path], None]] = {
    "station.png": _written(station_picture),
    "sequence.png": _written(sequence_strip),
    "sequence.gif": sequence_animation,
    "aspect.png": _written(aspect_picture),
    "detection.png": _written(detection_picture),
    "histogram.png": _written(histogram_picture),
    "lost.png": _written(lost_picture),
}
"""What a run draws: file name to what writes it."""
