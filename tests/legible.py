"""What makes a picture legible: its letters are large enough, on the page, and apart."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from gpuspec.pictures.page import WIDTH

TOUCHING_PX = 1.0


def pixels(figure: Figure) -> np.ndarray:
    """The picture as it is saved, (rows, columns, 3)."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def check_legible(figure: Figure) -> None:
    """Every text that is drawn is at least 9 points high, on the page, and touches no other."""
    figure.draw_without_rendering()  # lays it out
    height = figure.bbox.height
    boxes = []
    for text in drawn_texts(figure):
        assert text.get_fontsize() >= 9, text
        box = text.get_window_extent()
        assert box.x0 >= 0, text
        assert box.x1 <= WIDTH, text
        assert box.y0 >= 0, text
        assert box.y1 <= height, text
        if text.get_rotation() % 90 == 0:  # the boxes of oblique texts overlap, their letters not
            boxes.append((text, box))
    for (one, a), (other, b) in combinations(boxes, 2):
        assert not overlap(a, b), (one, other)


def overlap(a: Bbox, b: Bbox) -> bool:
    return bool(
        min(a.x1, b.x1) - max(a.x0, b.x0) > TOUCHING_PX
        and min(a.y1, b.y1) - max(a.y0, b.y0) > TOUCHING_PX
    )


def drawn_texts(figure: Figure) -> list[Text]:
    """Every text but labels of ticks beyond their axes, which exist and are not drawn."""
    axes = [
        axis
        for ax in figure.findobj(lambda a: hasattr(a, "xaxis"))
        for axis in (ax.xaxis, ax.yaxis)
    ]
    of_ticks, drawn = set(), set()
    for axis in axes:
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            labels = {tick.label1, tick.label2}
            of_ticks |= labels
            if low <= tick.get_loc() <= high:
                drawn |= labels
    return [
        text
        for text in figure.findobj(Text)
        if text.get_text().strip()
        and text.get_visible()
        and (text not in of_ticks or text in drawn)
    ]
