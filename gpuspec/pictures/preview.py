"""A preview: the detection over the aspect image, pixel by pixel, without a page around it."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_rgba_array
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gpuspec.pictures.detection import KINDS
from gpuspec.pictures.place import grey_range
from gpuspec.pictures.seen import Previewed

_NAMES = ("hit", "false", "missed")
_LEGEND = 28  # px, below the image
_WIDTH = 640  # px, at the least, for what the legend takes, unless so the image is higher than
_HEIGHT = 2000


def preview_picture(preview: Previewed) -> Image.Image:
    """Colour blobs that meet a zone, those that meet none, and the zones that no blob meets.

    Parameters
    ----------
    preview : Previewed
    """
    labels, zones = preview.labels, preview.truth
    low, high = grey_range(preview)
    grey = np.clip((preview.aspect - low) * (255 / (high - low)), 0, 255)
    picture = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)
    both = (labels > 0) & (zones > 0)
    meets, met = (np.isin(of, np.unique(of[both])) for of in (labels, zones))
    colours = np.rint(to_rgba_array([KINDS[name] for name in _NAMES])[:, :3] * 255)
    for where, colour in zip(
        ((labels > 0) & meets, (labels > 0) & ~meets, (zones > 0) & ~met),
        colours.astype(np.uint8), strict=True,
    ):  # fmt: skip
        picture[where] = colour
    enlarged = max(1, min(-(-_WIDTH // picture.shape[1]), _HEIGHT // picture.shape[0]))
    picture = picture.repeat(enlarged, axis=0).repeat(enlarged, axis=1)
    return _with_legend(picture, preview.step, colours.astype(int).tolist())


def _with_legend(picture: NDArray[np.uint8], step: int, colours: list[list[int]]) -> Image.Image:
    rows, columns = picture.shape[:2]
    page = Image.new("RGB", (max(columns, _WIDTH), rows + _LEGEND), "white")
    page.paste(Image.fromarray(picture), (0, 0))
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(15)
    share = f"one pixel of {step**2}, of one footprint" if step > 1 else "one footprint per pixel"
    left, top = 8, rows + 5
    draw.text((left, top), f"preview: {share}", "black", font)
    left += int(draw.textlength(f"preview: {share}", font)) + 24
    for name, colour in zip(_NAMES, colours, strict=True):
        draw.rectangle((left, top + 3, left + 12, top + 15), tuple(colour), "#404040")
        draw.text((left + 18, top), name, "black", font)
        left += 42 + int(draw.textlength(name, font))
    return page
