"""The files of a part: its image, its masks as a label image, other fusions, frames."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.datasets.plan import Kept
from gpuspec.datasets.sample import Taken
from gpuspec.station.station import Station

_LEVEL = 1  # of zlib: noise packs no better at a higher one
Files = Iterator[tuple[str, bytes]]


def files(of: Taken, kept: Kept) -> Files:
    """Yield the files of a part, their names in the data set's folder and what they hold.

    Parameters
    ----------
    of : Taken
    kept : Kept
    """
    name = f"{of.number:06}"
    yield f"images/{name}.{kept.format}", _image(of.aspect, of.station, kept)
    yield f"masks/{name}.png", _png(of.zones.astype(np.uint16))
    for fusion, image in of.fusions.items():
        yield f"fusions/{name}_{fusion}.{kept.format}", _image(image, of.station, kept)
    if of.frames is not None:
        deep = of.station.sensor.bit_depth > 8
        yield f"frames/{name}.tif", _tif(np.rint(of.frames).astype(np.uint16 if deep else np.uint8))


def levels(image: NDArray[np.float32], station: Station, kept: Kept) -> NDArray[Any]:
    """Return an image as its file holds it.

    Parameters
    ----------
    image : ndarray of float32, shape (M, N)
        DN.
    station : Station
        Whose full scale is the files'.
    kept : Kept

    Examples
    --------
    >>> from gpuspec.datasets.files import levels
    >>> from gpuspec.datasets.plan import Kept
    >>> levels(np.float32([[0, 127.6, 255]]), gpuspec.example("trim"), Kept(bits=16))
    array([[    0, 32793, 65535]], dtype=uint16)
    """
    if kept.bits == 32:
        return image.astype(np.float32, copy=False)
    scale = np.float32(kept.full_scale(station) / station.sensor.full_scale_dn)
    # A difference of images may be below 0.
    grey: NDArray[Any] = np.clip(np.rint(image * scale), 0, kept.full_scale(station))
    return grey.astype(np.uint8 if kept.bits == 8 else np.uint16)


def _image(image: NDArray[np.float32], station: Station, kept: Kept) -> bytes:
    grey = levels(image, station, kept)
    return _png(grey) if kept.format == "png" else _tif(grey)


def _png(grey: NDArray[Any]) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    # Of filtered rows runs alone repeat: looking for more takes longer, and packs no better.
    packing = {"compress_level": _LEVEL, "compress_type": zlib.Z_RLE}
    Image.fromarray(grey).save(file, "PNG", **packing)
    return file.getvalue()


def _tif(grey: NDArray[Any]) -> bytes:
    import tifffile

    file = io.BytesIO()
    whole = grey.dtype.kind == "u"
    tifffile.imwrite(
        file, grey, compression="zlib" if whole else None, metadata=None, photometric="minisblack",
        compressionargs={"level": _LEVEL} if whole else None,
    )  # fmt: skip
    return file.getvalue()
