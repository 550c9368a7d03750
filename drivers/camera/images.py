"""Decode images to pixels; the size is read from the header before any memory is allocated for them.

A JPEG or PNG of 700 bytes can claim 30000 by 30000 pixels, and a decoder believes it: 2.7 GB. Here the claim is compared with
the camera's size, or with an upper bound, before the decoder sees the first byte.
"""

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

U8 = NDArray[np.uint8]

MOST_PIXELS = 8192 * 8192
"""Largest number of pixels of an image: that of the largest camera that a camera file can describe."""
MOST_BYTES = 256 << 20
"""Largest size of an encoded image."""
_HEAD = 1 << 16
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})


class ImageRefused(ValueError):
    """The bytes are not an image that may be decoded; the text gives the reason without the source."""


def decode(data: bytes | memoryview, size: tuple[int, int] | None = None, *, turned: bool = False) -> U8:
    """Decode one image of any format that `claimed_size` reads.

    Args:
        size: width and height that it must have; None allows any size up to `MOST_PIXELS`.
        turned: apply the orientation tag of a phone's JPEG, so that width and height of `size` may be swapped in the file.

    Returns:
        (H, W, 3) uint8, BGR.

    Raises:
        ImageRefused: the data are not an image, or one of another size, too large, or damaged.
    """
    claimed = claimed_size(data)
    if claimed is None:
        raise ImageRefused("no size of an image in it")
    width, height = claimed
    fits = size is None or claimed == size or (turned and claimed == size[::-1])
    if not fits or width * height > MOST_PIXELS or not width or not height:
        expected = f"at most {MOST_PIXELS / 1e6:.0f} million pixels" if size is None else f"{size[0]}x{size[1]} px"
        raise ImageRefused(f"{width}x{height} px, expected {expected}")
    flags = cv2.IMREAD_COLOR if turned else cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        px = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except (cv2.error, MemoryError) as why:
        raise ImageRefused("damaged") from why
    if px is None:
        raise ImageRefused("damaged")
    if size is not None and px.shape[1::-1] != size:
        raise ImageRefused(f"{px.shape[1]}x{px.shape[0]} px, expected {size[0]}x{size[1]} px")
    return np.asarray(px, np.uint8)


def load(path: Path) -> bytes:
    """Return the bytes of an image file.

    Raises:
        OSError: the file cannot be read.
        ImageRefused: it is larger than any image that is decoded.
    """
    with path.open("rb") as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ImageRefused(f"more than {MOST_BYTES >> 20} MiB")
    return data


def claimed_size(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return the width and height that the header claims; None if it is torn, or not of a JPEG, PNG, BMP, TIFF, WebP or PNM."""
    head = bytes(data[:16])
    for magic, read in _READERS:
        if head.startswith(magic):
            try:
                return read(data)
            except (struct.error, ValueError, IndexError):
                return None
    return None


def _jpeg(data: bytes | memoryview) -> tuple[int, int] | None:
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == 0xFF:  # fill bytes before a marker
            at += 1
        elif marker in _JPEG_ALONE:
            at += 2
        elif marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        elif marker in (0xD9, 0xDA, 0x00):  # the end or the pixels, and no size before
            return None
        else:
            (length,) = struct.unpack_from(">H", data, at + 2)
            if length < 2:
                return None
            at += 2 + length
    return None


def _png(data: bytes | memoryview) -> tuple[int, int] | None:
    if bytes(data[12:16]) != b"IHDR":
        return None
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _bmp(data: bytes | memoryview) -> tuple[int, int] | None:
    (header,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if header == 12 else "<ii", data, 18)
    return abs(width), abs(height)  # a height below zero counts lines from the top


def _webp(data: bytes | memoryview) -> tuple[int, int] | None:
    if bytes(data[8:12]) != b"WEBP":
        return None
    kind = bytes(data[12:16])
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None


def _tiff(data: bytes | memoryview) -> tuple[int, int] | None:
    order = "<" if bytes(data[:2]) == b"II" else ">"
    magic, offset = struct.unpack_from(f"{order}HI", data, 2)
    if magic != 42:
        return None
    (entries,) = struct.unpack_from(f"{order}H", data, offset)
    found: dict[int, int] = {}
    for k in range(entries):
        at = offset + 2 + 12 * k
        tag, kind = struct.unpack_from(f"{order}HH", data, at)
        if tag in (256, 257):
            (found[tag],) = struct.unpack_from(order + {3: "H", 4: "I"}.get(kind, "H"), data, at + 8)
    return (found[256], found[257]) if len(found) == 2 else None


def _pnm(data: bytes | memoryview) -> tuple[int, int] | None:
    lines = bytes(data[2:_HEAD]).splitlines()
    words = b" ".join(line.partition(b"#")[0] for line in lines[:64]).split()
    if not all(word.isdigit() and len(word) < 10 for word in words[:2]):
        return None
    return int(words[0]), int(words[1])


_READERS: tuple[tuple[bytes, Callable[[bytes | memoryview], tuple[int, int] | None]], ...] = (
    (b"\xff\xd8", _jpeg),
    (b"\x89PNG\r\n\x1a\n", _png),
    (b"BM", _bmp),
    (b"RIFF", _webp),
    (b"II*\0", _tiff),
    (b"MM\0*", _tiff),
    *((b"P%d" % kind, _pnm) for kind in range(1, 7)),
)
