"""Images that claim to be larger than they are, a whole small one with another size in its header, and videos of pictures."""

import struct
import zlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np


@lru_cache
def encoded(suffix: str, width: int = 64, height: int = 48) -> bytes:
    """Return a grey image as OpenCV writes it."""
    ok, data = cv2.imencode(suffix, np.full((height, width, 3), 90, np.uint8))
    assert ok
    return data.tobytes()


def film(path: Path, pictures: Sequence[Any], codec: str = "libx264", rate: int = 25, form: str = "yuv420p", **more: str) -> Path:
    """Write pictures, (h, w, 3) in BGR or (h, w) in grey, as a video; `more` are options of the codec."""
    with av.open(str(path), "w") as out:
        stream = out.add_stream(codec, rate=rate, options=more)
        (stream.height, stream.width), stream.pix_fmt = pictures[0].shape[:2], form
        for px in pictures:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(px, format="bgr24" if px.ndim == 3 else "gray")))
        out.mux(stream.encode())
    return path


def claiming(suffix: str, width: int, height: int) -> bytes:
    """Return a few hundred bytes of JPEG or PNG that claim this many pixels."""
    data = bytearray(encoded(suffix))
    if suffix == ".jpg":
        struct.pack_into(">HH", data, data.index(b"\xff\xc0") + 5, height, width)
    else:
        struct.pack_into(">II", data, 16, width, height)
        struct.pack_into(">I", data, 29, zlib.crc32(data[12:29]))
    return bytes(data)
