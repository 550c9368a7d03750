"""Frames as H.264, one access unit a frame: about a twentieth of the bytes of JPEG."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.recording.timed_frames import prepare, yuv_frame
from drivers.pyav import require_pyav

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext

_START = b"\x00\x00\x01"
_IDR, _SEQUENCE = 5, 7


class VideoQuality(Struct, frozen=True):
    """Quality settings of an encoder."""

    crf: int
    """x264's quality, 0 to 51: a higher number is fewer bytes."""
    key_each: int
    """Frames from one key frame to the next."""
    preset: str = "superfast"
    """x264's: how long it may search for savings."""
    kbit_s: int | None = None
    """The most that frames of 30 Hz may take."""


class FrameEncoder:
    """Encodes frames of one size in order. It begins with a key frame, and again where the size changes."""

    def __init__(self, quality: VideoQuality) -> None:
        self._quality = quality
        self._codec: VideoCodecContext | None = None
        self._size = (0, 0)
        self._count = 0

    def encoded(self, image: NDArray[np.uint8]) -> bytes:
        """Return a (H, W, 3) BGR frame as one access unit (Annex B), with all that decoding it needs if it is a key frame.

        Raises:
            ValueError: a width or height that is odd, or the encoder refuses the frame.
            BadInput: PyAV is not installed.
        """
        height, width = image.shape[:2]
        if width % 2 or height % 2:
            raise ValueError(f"H.264 needs an even width and height, got {width}x{height} px")
        if self._codec is None or self._size != (width, height):
            self._codec, self._size = _encoder(width, height, self._quality), (width, height)
        frame = yuv_frame(image)
        frame.pts = self._count
        self._count += 1
        from av.error import FFmpegError

        try:
            return b"".join(bytes(packet) for packet in self._codec.encode(frame))
        except FFmpegError as why:
            raise ValueError(f"cannot encode a frame as H.264: {why}") from why


def _encoder(width: int, height: int, quality: VideoQuality) -> VideoCodecContext:
    require_pyav("H.264")
    from av.video.codeccontext import VideoCodecContext

    codec = VideoCodecContext.create("libx264", "w")
    prepare(codec, (width, height))
    codec.framerate = Fraction(30)
    # Without lookahead each frame comes out at once, and none refers to a later one.
    options = {"preset": quality.preset, "tune": "zerolatency", "crf": str(quality.crf)}
    options |= {"g": str(quality.key_each), "sc_threshold": "0"}
    if quality.kbit_s is not None:
        options |= {"maxrate": f"{quality.kbit_s}k", "bufsize": f"{quality.kbit_s // 2}k"}
    codec.options = options
    codec.thread_count = 1
    return codec


def is_key_frame(data: bytes) -> bool:
    """Return whether an access unit (Annex B) begins a group of frames."""
    return any(data[at] & 31 == _IDR for at in _units(data))


def codec_name(data: bytes) -> str | None:
    """Return the name of a key frame's codec (RFC 6381, section 3.3: profile, constraints and level); None for other frames."""
    for at in _units(data):
        if data[at] & 31 == _SEQUENCE and at + 4 <= len(data):
            return f"avc1.{data[at + 1 : at + 4].hex()}"
    return None


def _units(data: bytes) -> Iterator[int]:
    """Yield where each unit of the network abstraction layer begins (ITU-T H.264, annex B)."""
    at = data.find(_START)
    while 0 <= at < len(data) - 3:
        yield at + 3
        at = data.find(_START, at + 3)
