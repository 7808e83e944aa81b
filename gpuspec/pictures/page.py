"""The page every picture is laid out on, and how an image is brought onto it."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from PIL import Image

from gpuspec.light.patterns import Pattern
from gpuspec.station.sections import Pose
from gpuspec.station.station import Station

NOTES = 60  # px at the foot of a page, where something is to be known of what it shows
DPI = 110
WIDTH = 1500  # px, of a page
MARGIN = 96  # px, left and right of what is drawn
BAR_PX_MIN = 50
SMALLEST = 9.0  # points, letters
_EDGE = 12  # px, free at the right of a line
# M. Okabe, K. Ito, Color universal design (2008): told apart by colour-blind readers too.
SKY, VERMILION, YELLOW = "#56B4E9", "#D55E00", "#F0E442"


class Sheet:
    """A white page laid out in pixels from its top left corner."""

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self.figure = Figure((width / DPI, height / DPI), dpi=DPI, facecolor="white")

    def axes(self, left: float, top: float, width: float, height: float) -> Axes:
        """Add axes whose frame is this box.

        Parameters
        ----------
        left, top, width, height : float
            Of the box, px from the sheet's top left corner.
        """
        return self.figure.add_axes(
            (
                left / self.width,
                1 - (top + height) / self.height,
                width / self.width,
                height / self.height,
            )
        )

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        """Write text whose top left corner is here.

        Parameters
        ----------
        x, y : float
            Px from the sheet's top left corner.
        text : str
        **style
            As matplotlib's ``Figure.text`` takes it.
        """
        style = {"ha": "left", "va": "top", "fontsize": 10, **style}
        self.figure.text(x / self.width, 1 - y / self.height, text, **style)

    def heading(self, title: str, *lines: str) -> None:
        """Write a bold title and lines under it, 24 px each; what is too long, in small letters.

        Parameters
        ----------
        title : str
        *lines : str
        """
        self._line(14, title, fontsize=13, fontweight="bold")
        for number, line in enumerate(lines):
            self._line(44 + 24 * number, line, color="#404040")

    def notes(self, said: Sequence[str]) -> None:
        """Write the first note at the foot of the page, in two lines, and where the others are."""
        if not said:
            return
        more = f" (1 of {len(said)} notes in score.json)" if len(said) > 1 else ""
        text = textwrap.shorten(f"note: {said[0]}", 290 - len(more), placeholder=" …") + more
        self.text(
            MARGIN, self.height - NOTES + 8, "\n".join(textwrap.wrap(text, 150)), color=VERMILION
        )

    def legend(self, handles: Sequence[Any], top: float) -> None:
        """Put a legend of one line under the heading; a long one is drawn closer and smaller.

        Parameters
        ----------
        handles : sequence of Artist
            With their labels.
        top : float
            Px from the sheet's top.
        """
        labels = [str(handle.get_label()) for handle in handles]
        room = self.width - MARGIN - _EDGE
        symbols = 1.6 + 0.8  # of the letters' size, with what stands between symbol and label
        for size, spacing in ((10.0, 1.8), (10.0, 1.2), (SMALLEST, 1.2)):
            letters = sum(text_width(label, size) for label in labels)
            between = spacing * (len(labels) - 1) + symbols * len(labels)
            if letters + between * size / 72 * DPI <= room:
                break
        self.figure.legend(
            handles=list(handles),
            loc="upper left",
            bbox_to_anchor=(MARGIN / self.width, 1 - top / self.height),
            ncols=len(handles),
            frameon=False,
            borderaxespad=0,
            borderpad=0,
            handlelength=1.6,
            columnspacing=spacing,
            fontsize=size,
        )

    def _line(self, y: float, text: str, **style: Any) -> None:
        """Write a line that ends on the page: with smaller letters, else with an ellipsis."""
        size, weight = style.pop("fontsize", 10.0), style.get("fontweight", "normal")
        room = self.width - MARGIN - _EDGE
        while size > SMALLEST and text_width(text, size, weight) > room:
            size -= 0.5
        while (wide := text_width(text, size, weight)) > room:
            text = text[: min(int(len(text) * room / wide), len(text) - 2) - 1] + "…"
        self.text(MARGIN, y, text, fontsize=size, **style)


def text_width(text: str, size: float, weight: str = "normal") -> float:
    """Return how wide a line of text is, px.

    Parameters
    ----------
    text : str
    size : float
        Of its letters, points.
    weight : str
        As matplotlib names it.
    """
    font = FontProperties(size=size, weight=weight)
    renderer: Any = RendererAgg
    width, _, _ = renderer(1, 1, DPI).get_text_width_height_descent(text, font, ismath=False)
    return float(width)


def essentials(station: Station, pattern: Pattern | None = None) -> str:
    """Return what matters most of a station, in one line.

    Parameters
    ----------
    station : Station
    pattern : Pattern, optional
        Its light, if not stripes.
    """
    part, tunnel, camera = station.part, station.tunnel, station.camera
    kind = "crowned part" if part.crown_radius_x_mm or part.crown_radius_y_mm else "flat part"
    if part.relief:
        kind = "measured relief"
    moved = [name for name in ("part", "camera") if (getattr(station, name).pose or Pose()).moves]
    posed = f", {' and '.join(moved)} moved" if moved else ""
    light = f"light {pattern.file}" if pattern else tunnel.light
    return (
        f"{kind} {part.length_mm:g} × {part.width_mm:g} mm  ·  "
        f"{tunnel.section} at {tunnel.top_mm:g} mm, {light}  ·  "
        f"camera at {camera.height_mm:g} mm, {camera.sampling_mm:g} mm/px, "
        f"pupil {camera.pupil_mm:g} mm{posed}  ·  exposure {station.sensor.exposure:g}, "
        f"{station.sequence.images} images"
    )


def fitted(shape: tuple[int, int], width: float, height: float) -> tuple[int, int]:
    """Return the largest box (width, height) in px of an image's proportions, 2 px at least.

    Parameters
    ----------
    shape : tuple of int
        Of the image, (M, N).
    width, height : float
        What there is room for, px.
    """
    scale = min(width / shape[1], height / shape[0])
    return max(round(scale * shape[1]), 2), max(round(scale * shape[0]), 2)


def round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not longer."""
    decade = float(10.0 ** math.floor(math.log10(length)))
    return max(m for m in (1, 2, 5) if m * decade <= length * (1 + 1e-9)) * decade


def scale_length(mm: float, px: float, share: float = 0.2) -> float:
    """Return a round length for a scale bar: a share of a side, but one that can be seen, mm.

    Parameters
    ----------
    mm, px : float
        Length of the side.
    share : float
        Of it that the bar takes, about.
    """
    return round_length(mm * max(share, BAR_PX_MIN / px))


def length_text(mm: float) -> str:
    """Return a length with the unit that suits it."""
    return f"{mm:g} mm" if mm >= 0.1 else f"{1000 * mm:g} µm"


def drawn(figure: Figure) -> Image.Image:
    """Return a figure as it is seen, drawn with all that Python has to do for it."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def encoded(picture: Image.Image) -> bytes:
    """Return a drawn figure as a PNG file's bytes; other threads go on meanwhile."""
    file = io.BytesIO()
    # A third of the time of the default level, a tenth more bytes.
    picture.save(file, "PNG", compress_level=3, dpi=(DPI, DPI))
    return file.getvalue()


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG file's bytes."""
    return encoded(drawn(figure))
