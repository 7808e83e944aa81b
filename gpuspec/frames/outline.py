"""Which pixels are inspected, as it is said: a box, a polygon, or an image that is a mask."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gpuspec.arrays import Mask
from gpuspec.errors import FrameError
from gpuspec.frames.readers import decoded, heads

_NUMBER = r"-?\d+(?:\.\d+)?"
_BOX = re.compile(rf"^\s*{_NUMBER}(?:\s*,\s*{_NUMBER}){{3}}\s*$")
_POLYGON = re.compile(rf"^\s*{_NUMBER}\s*,\s*{_NUMBER}(?:\s+{_NUMBER}\s*,\s*{_NUMBER}){{2,}}\s*$")


def outlined(said: str | Path | Mask, shape: tuple[int, int]) -> Mask:
    """Return the pixels inside an outline.

    Parameters
    ----------
    said : str, Path or ndarray of bool
        ``"left,top,right,bottom"`` in pixels from the top left corner, right and bottom excluded;
        a polygon ``"x,y x,y x,y ..."``; the path of a mask, where what is not 0 is inspected; or a
        mask itself.
    shape : tuple of int
        Of the frames, (M, N).

    Returns
    -------
    ndarray of bool, shape (M, N)

    Raises
    ------
    FrameError
        If it is none of these, has another size, or holds no pixel of the frames.

    Examples
    --------
    >>> from gpuspec.frames.outline import outlined
    >>> outlined("1,0,3,1", (2, 4)).astype(int).tolist()
    [[0, 1, 1, 0], [0, 0, 0, 0]]
    >>> outlined("0,0 4,0 0,2", (2, 4)).astype(int).tolist()
    [[1, 1, 1, 0], [1, 0, 0, 0]]
    """
    name = "the region" if isinstance(said, np.ndarray) else f"the region {said}"
    if isinstance(said, np.ndarray):
        mask: Mask = said != 0
    elif _BOX.match(str(said)):
        mask = _box(str(said), shape)
    elif _POLYGON.match(str(said)):
        mask = _polygon(str(said), shape)
    else:
        mask = _of_file(Path(said))
    if mask.shape != shape:
        rows, columns = shape
        size = " x ".join(map(str, mask.shape[::-1]))
        raise FrameError(f"{name} has {size} pixels and the frames {columns} x {rows}.")
    if not mask.any():
        raise FrameError(f"{name} holds no pixel of the frames; nothing would be inspected.")
    return mask


def _box(said: str, shape: tuple[int, int]) -> Mask:
    left, top, right, bottom = (round(float(one)) for one in said.split(","))
    if not (left < right and top < bottom):
        raise FrameError(
            f"the region {said} is no box; say left,top,right,bottom in pixels from the top left."
        )
    mask = np.zeros(shape, np.bool_)
    mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
    return mask


def _polygon(said: str, shape: tuple[int, int]) -> Mask:
    from skimage.draw import polygon2mask

    pairs = [re.findall(_NUMBER, pair) for pair in re.findall(rf"{_NUMBER}\s*,\s*{_NUMBER}", said)]
    corners = np.array([[float(y) - 0.5, float(x) - 0.5] for x, y in pairs])
    mask: Mask = polygon2mask(shape, corners).astype(np.bool_)  # type: ignore[no-untyped-call]
    return mask


def _of_file(path: Path) -> Mask:
    if not path.is_file():
        raise FrameError(
            f"the region {path} is neither a box left,top,right,bottom, nor a polygon x,y x,y x,y, "
            f"nor the file of a mask."
        )
    (source, *others) = heads(path)
    if others or source.channels > 1:
        raise FrameError(f"{path} is no mask: it has {source.said}, {1 + len(others)} of them.")
    mask: Mask = decoded(source) != 0
    return mask
