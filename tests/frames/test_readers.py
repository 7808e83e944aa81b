"""Frames as files hold them: read to the bit, or refused in a sentence that names the file."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image as Picture

import gpuspec
from gpuspec.errors import FrameError
from gpuspec.frames.readers import decoded, heads, sources

SIZE = (40, 60)
RNG = np.random.default_rng(5)
GREY8 = RNG.integers(0, 256, SIZE, np.uint8)
GREY16 = RNG.integers(0, 4096, SIZE, np.uint16)
RGB = RNG.integers(0, 256, (*SIZE, 3), np.uint8)


def png(path: Path, image: np.ndarray) -> Path:
    Picture.fromarray(image).save(path)
    return path


def tif(path: Path, image: np.ndarray, **how: object) -> Path:
    tifffile.imwrite(path, image, **how)
    return path


def png_claiming(path: Path, columns: int, rows: int) -> Path:
    """A PNG of a few bytes whose head is valid and says another size."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(61))) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


WRITTEN = {
    "8.png": lambda p: (png(p, GREY8), GREY8),
    "16.png": lambda p: (png(p, GREY16), GREY16),
    "8.tif": lambda p: (tif(p, GREY8), GREY8),
    "12 in 16.tif": lambda p: (tif(p, GREY16), GREY16),
    "big endian.tif": lambda p: (tif(p, GREY16, byteorder=">"), GREY16),
    "packed.tif": lambda p: (tif(p, GREY16, compression="zlib"), GREY16),
    "strips.tiff": lambda p: (tif(p, GREY8, rowsperstrip=7), GREY8),
    "big.tif": lambda p: (tif(p, GREY8, bigtiff=True), GREY8),
    "a png.tif": lambda p: (png(p.with_suffix(".png"), GREY8).rename(p), GREY8),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_frame_is_read_to_the_bit(name, tmp_path):
    path, expected = WRITTEN[name](tmp_path / name)
    (source,) = heads(path)
    assert (source.shape, source.bits) == (SIZE, 8 * expected.itemsize)
    frame = decoded(source)
    assert frame.dtype == expected.dtype
    assert np.array_equal(frame, expected)


def test_frames_come_in_natural_order_decoded_ahead(tmp_path):
    frames = [np.full(SIZE, k, np.uint8) for k in range(12)]
    for k, frame in enumerate(frames):
        png(tmp_path / f"f_{k}.png", frame)
    found = sources([tmp_path])
    assert found.names == tuple(f"f_{k}.png" for k in range(12))
    assert [int(frame[0, 0]) for frame in found.stream()] == list(range(12))
    stack = tif(tmp_path / "stack.tif", np.stack(frames), photometric="minisblack")
    assert [int(frame[0, 0]) for frame in sources([stack]).stream()] == list(range(12))
    assert sources([stack]).names[0] == "stack.tif, page 1"


@pytest.mark.parametrize("name", ["c.png", "c.tif"])
def test_of_colour_what_is_asked_for_is_taken(name, tmp_path):
    path = (png if name.endswith("png") else tif)(tmp_path / name, RGB)
    for place, colour in enumerate(("red", "green", "blue")):
        (frame,) = sources([path], colour=colour).stream()
        assert np.array_equal(frame, RGB[..., place])
    (grey,) = sources([path], colour="luminance").stream()
    assert np.abs(grey - RGB @ [0.2126, 0.7152, 0.0722]).max() <= 0.5 + 1e-3
    with pytest.raises(FrameError, match=f"{name} is in colour; say what of it is meant"):
        sources([path])
    with pytest.raises(FrameError, match="'cyan' is not one of luminance, red"):
        sources([path], colour="cyan")


def cut(path: Path, share: float) -> Path:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    return path


BAD = {
    "a truncated PNG": (lambda d: cut(png(d / "a.png", GREY8), 0.6), "a.png is truncated"),
    "a PNG's head alone": (lambda d: cut(png(d / "a.png", GREY8), 0.01), "a.png is truncated"),
    "a truncated TIFF": (lambda d: cut(tif(d / "a.tif", GREY8), 0.6), "a.tif is truncated"),
    "a truncated packed TIFF": (
        lambda d: cut(tif(d / "a.tif", GREY8, compression="zlib"), 0.7), "a.tif is truncated",
    ),
    "a truncated stack": (
        lambda d: cut(tif(d / "a.tif", np.stack([GREY8] * 5), photometric="minisblack"), 0.7),
        "a.tif is truncated",
    ),
    "an empty file": (lambda d: (d / "a.png").write_bytes(b"") and None, "a.png is empty"),
    "a text": (lambda d: (d / "a.png").write_text("hello, I am no picture"), "neither PNG nor"),
    "a huge claim": (
        lambda d: png_claiming(d / "a.png", 2_000_000, 2_000_000), "more than its bytes can hold",
    ),
    "too long a side": (
        lambda d: png_claiming(d / "a.png", 70_000, 1), "at most 65,536 a side",
    ),
    "no pixels": (lambda d: png_claiming(d / "a.png", 0, 5), "has no pixels"),
    "real numbers": (lambda d: tif(d / "a.tif", GREY8.astype("f4")), "a.tif holds real numbers"),
    "signed numbers": (lambda d: tif(d / "a.tif", GREY16.astype("i2")), "holds signed numbers"),
    "numbers of 32 bit": (lambda d: tif(d / "a.tif", GREY16.astype("u4")), "numbers of 32 bit"),
    "a negative": (lambda d: tif(d / "a.tif", GREY8, photometric="miniswhite"), "as a negative"),
    "a bilevel PNG": (
        lambda d: Picture.fromarray(GREY8 > 99).save(d / "a.png"), "1 bit per pixel",
    ),
    "another size": (
        lambda d: (png(d / "a_1.png", GREY8), png(d / "a_2.png", GREY8[:-1])),
        "a_2.png has 60 x 39 pixels of 8 bit and",
    ),
    "another depth": (
        lambda d: (png(d / "a_1.png", GREY8), png(d / "a_2.png", GREY16)),
        "a_2.png has 60 x 40 pixels of 16 bit and",
    ),
    "a missing number": (
        lambda d: [png(d / f"a_{k}.png", GREY8) for k in (1, 2, 3, 5, 6)],
        "a_4.png is missing between a_3.png and a_5.png",
    ),
    "other pictures": (
        lambda d: [png(d / f"a_{k}.png", GREY8) for k in range(4)] + [png(d / "map.png", GREY8)],
        "pictures of several names (a_0.png and 3 more; map.png)",
    ),
    "a picture that is not read": (
        lambda d: (png(d / "a_1.png", GREY8), (d / "a_2.jpg").write_bytes(b"x")),
        "a_1.png); name those that are meant, e.g. '",
    ),
    "nothing": (lambda d: None, "holds no PNG or TIFF"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_what_is_no_frame_is_refused_before_any_is_decoded(what, tmp_path, monkeypatch):
    make, words = BAD[what]
    make(tmp_path)
    monkeypatch.setattr("gpuspec.frames.readers._pixels", lambda source: pytest.fail("decoded"))
    with pytest.raises(FrameError) as said:
        gpuspec.inspect(tmp_path)
    assert words in str(said.value)
    assert str(said.value).endswith(".")
    assert ". " not in str(said.value).replace("e.g. ", "")
    assert ".jpg'" not in str(said.value)


def test_what_only_decoding_tells_is_named(tmp_path):
    path = png(tmp_path / "a_7.png", GREY8)
    damaged = bytearray(path.read_bytes())
    damaged[60:80] = bytes(20)
    path.write_bytes(damaged)
    with pytest.raises(FrameError, match=r"a_7\.png cannot be decoded: .*; take this frame again"):
        list(sources([path]).stream())


def test_a_file_that_was_replaced_meanwhile_is_named(tmp_path):
    path = png(tmp_path / "a.png", GREY8)
    found = sources([path])
    png(path, GREY8[:-3])
    with pytest.raises(FrameError, match="was it replaced meanwhile"):
        list(found.stream())


def test_memory_that_is_not_there_is_refused_by_name(tmp_path, monkeypatch):
    path = png(tmp_path / "a.png", GREY8)
    monkeypatch.setattr("gpuspec.frames.readers.free_bytes", lambda: 1000)
    with pytest.raises(FrameError, match=r"a\.png claims to have 60 x 40 pixels, for which"):
        sources([path])
