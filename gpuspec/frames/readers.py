"""Frames of a camera as files hold them: looked at before the work, then decoded ahead of it."""

from __future__ import annotations

import logging
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import FrameError
from gpuspec.frames.series import READ, found
from gpuspec.host import free_bytes, processors

Frame = NDArray[np.uint8] | NDArray[np.uint16]
"""Grey levels as the camera gave them, shape (M, N)."""
Colour = Literal["luminance", "red", "green", "blue"]
COLOURS = ("luminance", "red", "green", "blue")
"""What of a coloured frame may be asked for."""
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of red, green and blue in the luminance, ITU-R BT.709."""

SIDE_MAX = 1 << 16
_PACKED = 1032  # bytes that deflate makes of one, at the most
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"
_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # of the colour types of PNG


@dataclass(frozen=True)
class Source:
    """A frame in a file, as the file's head describes it.

    Attributes
    ----------
    path : Path
    page : int or None
        Of a TIFF of several pages, from 0.
    shape : tuple of int
        (M, N).
    bits : int
        Of a number in the file, 8 or 16.
    channels : int
        1 of a grey frame, 3 or 4 of a coloured one.
    """

    path: Path
    page: int | None
    shape: tuple[int, int]
    bits: int
    channels: int

    @property
    def name(self) -> str:
        """As it is called in messages and tables."""
        return self.path.name if self.page is None else f"{self.path.name}, page {self.page + 1}"

    @property
    def said(self) -> str:
        """Its size and depth in words."""
        colour = "" if self.channels == 1 else ", colour"
        return f"{self.shape[1]} x {self.shape[0]} pixels of {self.bits} bit{colour}"


@dataclass(frozen=True)
class Sources:
    """The frames of a sequence: known, not read.

    Attributes
    ----------
    frames : tuple of Source
        In their order, of one size and depth.
    colour : str or None
        What is taken of coloured frames.
    """

    frames: tuple[Source, ...]
    colour: Colour | None = None

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.frames)

    def __repr__(self) -> str:
        return f"Sources({self.said})"

    @property
    def shape(self) -> tuple[int, int]:
        """Of each frame, (M, N)."""
        return self.frames[0].shape

    @property
    def bits(self) -> int:
        """Of a number in the files, 8 or 16."""
        return self.frames[0].bits

    @property
    def names(self) -> tuple[str, ...]:
        """Of the frames."""
        return tuple(frame.name for frame in self.frames)

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """That hold them, each once."""
        return tuple(dict.fromkeys(frame.path for frame in self.frames))

    @property
    def said(self) -> str:
        """The sequence in a few words."""
        count = len(self)
        ends = self.names[0] if count == 1 else f"{self.names[0]} to {self.names[-1]}"
        return f"{count} frame{'s' * (count != 1)}, {ends}: {self.frames[0].said}"

    def stream(self) -> Iterator[Frame]:
        """Decode one after another, some ahead of the one that is asked for.

        Yields
        ------
        ndarray of uint8 or uint16, shape (M, N)

        Raises
        ------
        FrameError
            If one cannot be decoded: truncated, damaged, or no longer what its head said.
        """
        threads = processors()
        waiting: deque[Future[Frame]] = deque()
        with ThreadPoolExecutor(threads, "gpuspec-frames") as pool:
            try:
                for frame in self.frames:
                    waiting.append(pool.submit(decoded, frame, self.colour))
                    if len(waiting) > 2 * threads:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def sources(
    given: Sequence[str | Path], *, colour: Colour | None = None, gaps: bool = False
) -> Sources:
    """Look at the heads of all frames that are meant, before any is decoded.

    Parameters
    ----------
    given : sequence of str or Path
        Folders, patterns and files, see :func:`gpuspec.frames.series.found`.
    colour : {"luminance", "red", "green", "blue"}, optional
        What is taken of coloured frames; None: they are refused.
    gaps : bool
        Whether numbers may be missing in the series.

    Raises
    ------
    FrameError
        If a file cannot be read, is truncated, claims more than it can hold, or differs from the
        first in size or depth; or for reasons of :func:`gpuspec.frames.series.found`.
    """
    if colour is not None and colour not in COLOURS:
        raise FrameError(f"colour = {colour!r} is not one of {', '.join(COLOURS)}.")
    frames: list[Source] = []
    for path in found(given, gaps=gaps):
        frames += heads(path)
    first = frames[0]
    for frame in frames:
        if frame.channels > 1 and colour is None:
            raise FrameError(
                f"{frame.path} is in colour; say what of it is meant: --colour luminance, red, "
                f"green or blue."
            )
        if (frame.shape, frame.bits) != (first.shape, first.bits):
            raise FrameError(
                f"{_place(frame)} has {frame.said} and {_place(first)} {first.said}; frames of one "
                f"sequence are alike, so leave out what does not belong to it."
            )
    return Sources(tuple(frames), colour)


def heads(path: Path) -> tuple[Source, ...]:
    """Look at the head of a file: what frames it holds.

    Parameters
    ----------
    path : Path
        PNG, or TIFF of one page or several.

    Raises
    ------
    FrameError
        If it is none, is truncated, is of a kind that is not read, or claims more than it holds.
    """
    try:
        with path.open("rb") as file:
            begin = file.read(33)
        if begin[:8] == _PNG:
            return (_png(path, begin),)
        if begin[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            return _tiff(path)
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror or error}.") from None
    if not begin:
        raise FrameError(f"{path} is empty; take this frame again.")
    read = ", ".join(sorted(READ))
    raise FrameError(f"{path} is neither PNG nor TIFF; frames are read of {read}.")


def _png(path: Path, begin: bytes) -> Source:
    if len(begin) < 33 or begin[12:16] != b"IHDR":
        raise _truncated(path)
    columns, rows, bits, kind = struct.unpack(">IIBB", begin[16:26])
    if zlib.crc32(begin[12:29]) != struct.unpack(">I", begin[29:33])[0]:
        raise FrameError(f"{path} is damaged: its head does not fit its checksum.")
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - len(_PNG_END), 0))
        whole = file.read() == _PNG_END
    if not whole and not _png_ends(path, size):
        raise _truncated(path)
    if kind not in _CHANNELS or bits not in (8, 16) or (kind == 3 and bits != 8):
        raise FrameError(
            f"{path} has {bits} bit per pixel and the colour type {kind}; frames are PNG of 8 or "
            f"16 bit."
        )
    channels = 1 if kind in (0, 4) else 3
    if channels > 1 and bits == 16:
        raise FrameError(
            f"{path} is a PNG of 16 bit in colour, which would be read at 8 bit; save it as TIFF, "
            f"or as grey."
        )
    source = Source(path, None, (rows, columns), bits, channels)
    _check_claim(source, size * _PACKED, rows * columns * _CHANNELS[kind] * bits // 8)
    return source


def _png_ends(path: Path, size: int) -> bool:
    """Whether a PNG with something after its end has one."""
    place = 8
    with path.open("rb") as file:
        while place + 12 <= size:
            file.seek(place)
            length, name = struct.unpack(">I4s", file.read(8))
            if name == b"IEND":
                return True
            place += 12 + length
    return False


def _tiff(path: Path) -> tuple[Source, ...]:
    import tifffile

    frames = []
    size = path.stat().st_size
    with _complaints() as said:
        try:
            with tifffile.TiffFile(path) as file:
                pages = list(file.pages)
                for number, page in enumerate(pages):
                    source = _tiff_page(path, page, number if len(pages) > 1 else None)
                    ends = zip(page.dataoffsets, page.databytecounts, strict=True)
                    if any(offset + count > size for offset, count in ends):
                        raise _truncated(path)
                    _check_claim(source, sum(page.databytecounts) * _PACKED, page.nbytes)
                    frames.append(source)
        except FrameError:
            raise
        except Exception as error:  # a damaged file fails in as many ways as it has bytes
            raise FrameError(f"{path} is damaged: {_brief(error)}.") from None
    if any("page" in one or "IFD" in one for one in said) or not frames:
        raise _truncated(path)
    return tuple(frames)


def _tiff_page(path: Path, page: Any, number: int | None) -> Source:
    samples, bits = int(page.samplesperpixel), int(page.bitspersample)
    place = f"{path}{'' if number is None else f', page {number + 1}'}"
    if page.sampleformat not in (1, None) or bits not in (8, 16):
        kind = {2: "signed numbers", 3: "real numbers"}.get(page.sampleformat, "numbers")
        raise FrameError(
            f"{place} holds {kind} of {bits} bit; frames are of 8 or 16 bit without a sign, as "
            f"the camera gives them (10 and 12 bit in 16)."
        )
    if page.photometric == 0:
        raise FrameError(f"{place} is stored as a negative (white is zero); save it as it is.")
    if page.photometric == 3:
        raise FrameError(f"{place} has a palette; save it as grey.")
    if page.imagedepth != 1 or samples not in (1, 3, 4):
        raise FrameError(f"{place} has {samples} values per pixel; frames have one, or colours.")
    if samples > 1 and page.planarconfig != 1:
        raise FrameError(f"{place} holds its colours one plane after another; save it as grey.")
    shape = int(page.imagelength), int(page.imagewidth)
    return Source(path, number, shape, bits, samples)


def _check_claim(source: Source, most: int, needed: int) -> None:
    """Refuse a size that the file cannot hold, or the memory."""
    rows, columns = source.shape
    place = _place(source)
    if min(rows, columns) < 1:
        raise FrameError(f"{place} has no pixels.")
    claim = f"{place} claims to have {columns:,} x {rows:,} pixels"
    if needed > most:
        raise FrameError(f"{claim}, more than its bytes can hold: it is truncated or made up.")
    if max(rows, columns) > SIDE_MAX:
        raise FrameError(f"{claim}; frames have at most {SIDE_MAX:,} a side.")
    # Frames that are decoded ahead, sums, the mean and what segmentation takes.
    memory = needed * (2 * processors() + 2) + rows * columns * 44
    free = free_bytes()
    if memory > free:
        raise FrameError(
            f"{claim}, for which {memory / 2**30:.1f} GiB of memory are needed and "
            f"{free / 2**30:.1f} GiB are free; cut the frames."
        )


def decoded(source: Source, colour: Colour | None = None) -> Frame:
    """Decode a frame.

    Parameters
    ----------
    source : Source
    colour : {"luminance", "red", "green", "blue"}, optional
        What is taken of a coloured one.

    Returns
    -------
    ndarray of uint8 or uint16, shape (M, N)

    Raises
    ------
    FrameError
        If it is truncated or damaged, or no longer what its head said.
    """
    try:
        image = _pixels(source)
    except Exception as error:  # a damaged file fails in as many ways as it has bytes
        raise FrameError(
            f"{_place(source)} cannot be decoded: {_brief(error)}; take this frame again."
        ) from None
    if source.channels > 1 and image.ndim == 3:
        image = _one_colour(image, colour or "luminance")
    kind = np.uint8 if source.bits == 8 else np.uint16
    if image.shape != source.shape or image.dtype != kind:
        raise FrameError(
            f"{_place(source)} holds {image.dtype} of {image.shape} and its head says "
            f"{source.said}; was it replaced meanwhile?"
        )
    frame: Frame = image
    return frame


def _pixels(source: Source) -> NDArray[Any]:
    if source.path.suffix.lower() == ".png" or source.page is None:
        with source.path.open("rb") as file:
            png = file.read(8) == _PNG
        if png:
            return _png_pixels(source)
    import tifffile

    with tifffile.TiffFile(source.path) as file:
        page: Any = file.pages[source.page or 0]
        try:
            image: NDArray[Any] = page.asarray()
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
            image = _by_pillow(source)  # it knows packings that the other leaves to a package
    return image.astype(image.dtype.newbyteorder("="), copy=False)


def _png_pixels(source: Source) -> NDArray[Any]:
    from PIL.PngImagePlugin import PngImageFile

    # By its own class: the library's limit of size is another than that of _check_claim.
    with PngImageFile(source.path) as image:
        if image.mode in ("LA", "I"):
            return np.asarray(image.getchannel(0)).astype(f"uint{source.bits}")
        if image.mode in ("P", "RGBA"):
            return np.asarray(image.convert("RGB"))
        return np.asarray(image)


def _by_pillow(source: Source) -> NDArray[Any]:
    from PIL.TiffImagePlugin import TiffImageFile

    with TiffImageFile(source.path) as image:
        image.seek(source.page or 0)
        return np.asarray(image)


def _one_colour(image: NDArray[Any], colour: Colour) -> NDArray[Any]:
    """Return one channel, or the luminance rounded to whole grey levels."""
    if colour != "luminance":
        return np.ascontiguousarray(image[..., COLOURS.index(colour) - 1])
    grey = image[..., :3] @ np.array(LUMINANCE, np.float32)
    rounded: NDArray[Any] = np.rint(grey).astype(image.dtype)
    return rounded


def _place(source: Source) -> str:
    page = "" if source.page is None else f", page {source.page + 1},"
    return f"{source.path}{page}"


def _truncated(path: Path) -> FrameError:
    return FrameError(f"{path} is truncated: its end is missing; copy or take it again.")


def _brief(error: Exception) -> str:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0].rstrip(".")[:200]


@contextmanager
def _complaints() -> Iterator[list[str]]:
    """Give what tifffile logs of a damaged file, which it would then read in part."""
    said: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    logger, keep = logging.getLogger("tifffile"), Keep(logging.ERROR)
    before, logger.propagate = logger.propagate, False
    logger.addHandler(keep)
    try:
        yield said
    finally:
        logger.removeHandler(keep)
        logger.propagate = before
