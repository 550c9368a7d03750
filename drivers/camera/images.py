"""Decode images to pixels; the size is read from the header before any memory is allocated for them.

A JPEG or PNG of 700 bytes can claim 30000 by 30000 pixels, and a decoder allocates it: 2.7 GB. Here the claim is compared with
the camera's size, or with an upper bound, before the decoder sees the first byte.
"""

import struct
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

U8 = NDArray[np.uint8]

MOST_PIXELS = 8192 * 8192
"""Largest number of pixels of an image: that of the largest camera that a camera file can describe."""
PICTURES = frozenset({
    ".jpg", ".jpeg", ".jpe", ".png", ".bmp", ".dib",
    ".tif", ".tiff", ".webp", ".ppm", ".pgm", ".pbm", ".pnm", ".jp2", ".ras", ".sr",
})  # fmt: skip
"""The endings of image files in a folder."""
_HEAD = 1 << 16  # bytes of a file that hold its format, size and tables
_BEFORE_MOST = 64
"""The bytes that a bridge may put before a JPEG."""
_WHITE = 255.0  # grey value of white in eight bits
_FLOAT_MOST = 2.0
"""Floats go from 0 to 1 and a highlight above it, or they are a camera's whole numbers."""
_GAP = bytes(24)
"""Zeros that are no coded data of the usual tables: eight coefficients each of -1 in three bytes, and a block has 63."""
_USUAL_AC = bytes.fromhex("7d01020300041105122131410613516107")
"""The begin of the usual table for the brightness (ITU-T T.81, table K.5)."""
_UNITS = {"444": (8, 8), "422": (16, 8), "420": (16, 16), "440": (8, 16), "411": (32, 8), "Gray": (8, 8)}
"""Width and height of what a JPEG codes at once, px, by its subsampling."""
_STEP_LEAST = 6.0
"""A step of brightness or colour by this many levels between two rows of units counts whole."""
_STEP_ALL = 0.75  # mean of the steps along a whole row of units at least
_STEP_PART = 0.6  # mean of the steps along either part of it at least
_STEP_NONE = 0.4  # mean of the steps along the parts that must have none at most
_STEP_MAYBE = 0.6
"""The mean along a whole row at which a closer look follows."""
_ROWS_LEAST = 2  # rows of units from which a picture is searched for a step
_COLUMNS_LEAST = 6  # columns of units from which it is
_TABLE = 65
"""The bytes of a table of quantization with its number."""
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})


class ImageRefused(ValueError):
    """The bytes are not an image that may be decoded; the text gives the reason without the source."""


def decode(data: bytes | memoryview, size: tuple[int, int] | None = None) -> U8:
    """Decode one image of any format that `claimed_size` reads, as the sensor gave it: an orientation tag turns nothing.

    A JPEG is refused at any doubt of its decoder: what follows a gap in its data looks like a picture, and is none. Values of
    more than 8 bits are scaled to 8 by what the file states.

    Args:
        size: width and height that it must have; None allows any size up to `MOST_PIXELS`.

    Returns:
        (H, W, 3) uint8, BGR.

    Raises:
        ImageRefused: the data are not an image, or one of another size, too large, or damaged.
    """
    check_size(data, size)
    begin = _jpeg_begin(data)
    px = _decoded_jpeg(data[begin:]) if begin is not None else _decoded(data)
    if size is not None and px.shape[1::-1] != size:
        raise ImageRefused(f"{px.shape[1]}x{px.shape[0]} px, expected {size[0]}x{size[1]} px")
    return px


def as_shown(data: bytes) -> tuple[U8, bool]:
    """Decode one image as a browser shows it: on white, turned as its tag says; return whether a part of it is transparent.

    Returns:
        (H, W, 3) uint8, BGR.

    Raises:
        ImageRefused: the data are not an image, too large, damaged, or of a transparency that is not read.
        cv2.error: the decoder failed.
    """
    check_size(data)
    encoded = np.frombuffer(data, np.uint8)
    px, raw = cv2.imdecode(encoded, cv2.IMREAD_COLOR), cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)
    if px is None or raw is None:
        raise ImageRefused("damaged")
    if raw.ndim == 2 and data.startswith(b"\x89PNG") and 0 < data.find(b"tRNS") < data.find(b"IDAT"):
        raise ImageRefused("one of its greys is transparent: save it with an alpha channel")
    white = {1: 255.0, 2: 65535.0}.get(raw.dtype.itemsize, 1.0)
    # A file with an alpha of nothing but zeros does not use it.
    if raw.ndim < 3 or raw.shape[2] < 4 or not raw[..., 3].any() or raw[..., 3].min() >= white:
        return np.asarray(px, np.uint8), False
    upright = cv2.imdecode(encoded, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if upright is None or not np.array_equal(upright, px):
        raise ImageRefused("a part of it is transparent, and a tag turns it: save it upright")
    share = raw[..., 3:] / white
    return np.rint(_WHITE * (1.0 - share + share * (raw[..., :3] / white))).astype(np.uint8), True


def check_size(data: bytes | memoryview, size: tuple[int, int] | None = None) -> None:
    """Refuse an image by the size that its header claims, before a decoder sees it. Raises ImageRefused."""
    claimed = claimed_size(data)
    if claimed is None:
        raise ImageRefused("no size of an image in it")
    width, height = claimed
    if size not in (None, claimed) or width * height > MOST_PIXELS or not width or not height:
        expected = f"at most {MOST_PIXELS / 1e6:.0f} million pixels" if size is None else f"{size[0]}x{size[1]} px"
        raise ImageRefused(f"{width}x{height} px, expected {expected}")


def _decoded_jpeg(data: bytes | memoryview) -> U8:
    if _has_gap(data):
        raise ImageRefused("damaged: zeros in place of coded data")
    try:
        px = np.asarray(simplejpeg.decode_jpeg(data, "BGR", strict=True), np.uint8)
        subsampling = simplejpeg.decode_jpeg_header(data, strict=True)[3]
        if _lacks_scans(bytes(data)):
            raise ValueError("it ends before its last scan")
    except (LookupError, ValueError, MemoryError) as why:
        raise ImageRefused(f"damaged: {why}") from why
    if subsampling in _UNITS and _is_shifted(px, _UNITS[subsampling], max(_STEP_LEAST, _coarsest(bytes(data[:_HEAD])) / 2)):
        raise ImageRefused("damaged: its brightness steps in the middle of a row of blocks")
    return px


def _lacks_scans(data: bytes) -> bool:
    """Return whether some bit of a coefficient is in no scan: a JPEG that was cut between two scans shows what it has."""
    frame = _frame(data) or 0
    lacks = dict.fromkeys(data[frame + 10 : frame + 10 + 3 * data[frame + 9] : 3], (1 << 64) - 1)
    scan = data.find(b"\xff\xda", frame)
    while scan >= 0:
        spectrum = scan + 5 + 2 * data[scan + 4]
        first, last, bits = data[spectrum : spectrum + 3]
        for component in data[scan + 5 : spectrum : 2] if not bits & 15 else b"":
            lacks[component] &= (1 << first) - 1 | -1 << last + 1
        scan = data.find(b"\xff\xda", spectrum)
    return any(lacks.values())


def _coarsest(head: bytes) -> int:
    """Return the largest step of a unit's mean in the tables of quantization, eighths of a level of brightness."""
    head = head[: head.find(b"\xff\xda")]
    coarsest, at = 0, head.find(b"\xff\xdb")
    while 0 <= at < len(head) - 5:
        length = int.from_bytes(head[at + 2 : at + 4], "big")
        coarsest = max(coarsest, 0, *head[at + 5 : at + 2 + length : _TABLE])
        at = head.find(b"\xff\xdb", at + 2 + length)
    return coarsest


def _is_shifted(px: U8, unit: tuple[int, int], step: float) -> bool:
    """Return whether all that follows one unit of a JPEG, in the order of its coding, is brighter, darker or of another colour.

    The mean of a unit is coded as its difference from that of the unit before. A wrong bit shifts all that follow: the right part
    of one row of units steps against the row above, and the left part of the next row does so by as much. The other two parts do
    not. No edge of a scene steps so, and between two rows of pixels alone.

    Args:
        px: (H, W, 3) uint8.
        unit: width and height of a unit, px.
        step: the levels by which what follows is shifted at least.
    """
    width, height = unit
    columns, rows = px.shape[1] // width, (px.shape[0] - 2) // height
    if rows < _ROWS_LEAST or columns < _COLUMNS_LEAST:
        return False
    # Two pixels of each unit say at little cost that a frame has no such step.
    last, first = _row_means(px, unit, (-1, 0), cv2.INTER_LINEAR)
    left, right = _parts(np.clip((first - last) / step, -1.0, 1.0))
    if np.abs(right[:-1] + left[1:]).max() <= 2.0 * _STEP_MAYBE:
        return False
    above, last, first, below = _row_means(px, unit, (-2, -1, 0, 1), cv2.INTER_AREA)
    apart = (first - last) / step
    blank_left, blank_right = _parts(np.clip(apart, -1.0, 1.0))
    sharp = np.abs(apart) - 2.0 / step * np.maximum(np.abs(last - above), np.abs(below - first))
    left, right = _parts(np.sign(apart) * np.clip(sharp, 0.0, 1.0))
    found = np.abs(right[:-1] + left[1:]) > 2.0 * _STEP_ALL
    found &= np.minimum(np.abs(right[:-1]), np.abs(left[1:])) > _STEP_PART
    found &= np.maximum(np.abs(blank_left[:-1]), np.abs(blank_right[1:])) < _STEP_NONE
    return bool(found.any())


def _row_means(px: U8, unit: tuple[int, int], beside: tuple[int, ...], how: int) -> NDArray[np.float32]:
    """Return the mean over each unit's width of the lines of pixels beside the border of two rows of units.

    Args:
        beside: the lines, counted from the first one below the border.
        how: OpenCV's interpolation: of all of a unit's pixels, or of those in its middle.

    Returns:
        (lines, rows, 3, columns), BGR.
    """
    width, height = unit
    columns, rows = px.shape[1] // width, (px.shape[0] - 2) // height
    lines = (height * np.arange(1, rows + 1) + np.array(beside)[:, None]).ravel()
    means = cv2.resize(px[lines, : columns * width], (columns, len(lines)), interpolation=how)
    return means.reshape(len(beside), rows, columns, 3).transpose(0, 1, 3, 2).astype(np.float32, order="C")


def _parts(steps: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the means of the columns left of each column from the third to the last but one, and of the others."""
    columns = steps.shape[2]
    means = (steps.reshape(-1, columns) @ _means_of_parts(columns)).reshape(*steps.shape[:2], -1)
    return means[..., : columns - 3], means[..., columns - 3 :]


@cache
def _means_of_parts(columns: int) -> NDArray[np.float32]:
    """Return the matrix (columns, 2 * (columns - 3)) that takes steps to the means of their two parts."""
    count = np.arange(2, columns - 1)
    is_left = np.arange(columns)[:, None] < count
    return np.concatenate([is_left / count, ~is_left / (columns - count)], axis=1).astype(np.float32)


def _has_gap(data: bytes | memoryview) -> bool:
    """Return whether a block of zeros lies in the coded data, as a lost USB packet leaves it, and not after the end.

    Zeros are codes of the usual tables, and the decoder reads them without a word. No encoder writes this many of them by these
    tables; by tables of its own, a black image may be nothing else.
    """
    gap = bytes(data).find(_GAP)
    if gap < 0:
        return False
    head = bytes(data[: min(gap, _HEAD)])
    scan = head.find(b"\xff\xda")
    usual = b"\xff\xc4" not in head or _USUAL_AC in head
    return scan >= 0 and usual and bytes(data).find(b"\xff\xd9", scan, gap) < 0


def _decoded(data: bytes | memoryview) -> U8:
    try:
        px = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, MemoryError) as why:
        raise ImageRefused("damaged") from why
    if px is None:
        raise ImageRefused("damaged")
    most = _largest_value(data, px)
    return np.asarray(px, np.uint8) if most == _WHITE else np.clip(np.rint(px * (_WHITE / most)), 0, _WHITE).astype(np.uint8)


def _largest_value(data: bytes | memoryview, px: NDArray[np.generic]) -> float:
    """Return the value of white.

    A PNM states it, a PNG may state how many bits count. Else it is the least number of bits, by twos, that holds all values:
    cameras of 10, 12 and 14 bits write their values into 16 as they are.
    """
    head = bytes(data[:_HEAD])
    if head[:1] == b"P" and (words := _pnm_words(head)) is not None and len(words) > 2 and head[1:2] not in b"14":
        return float(max(1, int(words[2])))
    if px.dtype == np.uint8:
        return _WHITE
    if head.startswith(b"\x89PNG") and 0 < (at := head.find(b"sBIT")) < len(head) - 4 and 8 <= head[at + 4] <= 16:
        return float((1 << head[at + 4]) - 1)
    most = float(px.max())
    if not np.issubdtype(px.dtype, np.unsignedinteger) and not most > _FLOAT_MOST:
        return 1.0
    return float(next((1 << bits) - 1 for bits in (8, 10, 12, 14, 16) if most < 1 << bits or bits == 16))


def claimed_size(data: bytes | memoryview) -> tuple[int, int] | None:
    """Return the width and height that the header claims; None if it is torn, or of no format that is read."""
    head = bytes(data[:16])
    if (begin := _jpeg_begin(data)) is not None:
        return _guarded(_jpeg, data[begin:])
    for magic, read in _READERS:
        if head.startswith(magic):
            return _guarded(read, data)
    return None


def _guarded(read: Callable[[bytes | memoryview], tuple[int, int] | None], data: bytes | memoryview) -> tuple[int, int] | None:
    try:
        return read(data)
    except (struct.error, ValueError, IndexError):
        return None


def _jpeg_begin(data: bytes | memoryview) -> int | None:
    """Return where a JPEG begins, which some bytes of no format may precede; None if there is none."""
    head = bytes(data[: _BEFORE_MOST + 3])
    begin = head.find(b"\xff\xd8\xff")
    return None if begin < 0 or any(head.startswith(magic) for magic, _ in _READERS) else begin


def _jpeg(data: bytes | memoryview) -> tuple[int, int] | None:
    frame = _frame(data)
    return None if frame is None else struct.unpack_from(">HH", data, frame + 5)[::-1]


def _frame(data: bytes | memoryview) -> int | None:
    """Return where a JPEG says its size and components; None where its pixels come first."""
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
            return at
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
    words = _pnm_words(bytes(data[:_HEAD]))
    return None if words is None else (int(words[0]), int(words[1]))


def _pnm_words(head: bytes) -> list[bytes] | None:
    """Return width, height and, where it is a number, the value of white; None if there is no size."""
    words = b" ".join(line.partition(b"#")[0] for line in head[2:].splitlines()[:64]).split()[:3]
    numbers = [word for word in words if word.isdigit() and len(word) < 10]
    return None if len(numbers) < 2 or numbers != words[: len(numbers)] else numbers


def _jp2(data: bytes | memoryview) -> tuple[int, int] | None:
    at = bytes(data[:_HEAD]).find(b"ihdr")
    if at < 0:
        return None
    height, width = struct.unpack_from(">II", data, at + 4)
    return width, height


def _sun(data: bytes | memoryview) -> tuple[int, int] | None:
    width, height = struct.unpack_from(">II", data, 4)
    return width, height


_READERS: tuple[tuple[bytes, Callable[[bytes | memoryview], tuple[int, int] | None]], ...] = (
    (b"\x89PNG\r\n\x1a\n", _png),
    (b"BM", _bmp),
    (b"RIFF", _webp),
    (b"II*\0", _tiff),
    (b"MM\0*", _tiff),
    (b"\0\0\0\x0cjP  ", _jp2),
    (b"\x59\xa6\x6a\x95", _sun),
    *((b"P%d" % kind, _pnm) for kind in range(1, 7)),
)
