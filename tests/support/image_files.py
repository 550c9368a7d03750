"""Images that claim to be larger than they are: a whole small one with another size in its header."""

import struct
import zlib
from functools import lru_cache

import cv2
import numpy as np


@lru_cache
def encoded(suffix: str, width: int = 64, height: int = 48) -> bytes:
    """Return a grey image as OpenCV writes it."""
    ok, data = cv2.imencode(suffix, np.full((height, width, 3), 90, np.uint8))
    assert ok
    return data.tobytes()


def claiming(suffix: str, width: int, height: int) -> bytes:
    """Return a few hundred bytes of JPEG or PNG that claim this many pixels."""
    data = bytearray(encoded(suffix))
    if suffix == ".jpg":
        struct.pack_into(">HH", data, data.index(b"\xff\xc0") + 5, height, width)
    else:
        struct.pack_into(">II", data, 16, width, height)
        struct.pack_into(">I", data, 29, zlib.crc32(data[12:29]))
    return bytes(data)
