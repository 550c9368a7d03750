"""Frames as H.264, one access unit a frame: about a twentieth of the bytes of JPEG.

Their times are on the clock of 90 kHz, their colours by BT.709 in limited range.

Each frame of a recording is encoded from those before it back to the last key frame, so whoever wants one decodes these as well.
Frames are mostly wanted in order, and then each is decoded once.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from drivers.pyav import AccessUnitDecoder, require_pyav
from estimator.contracts.time import MonoNs, seconds_between

if TYPE_CHECKING:
    import av
    from av.video.codeccontext import VideoCodecContext

CLOCK_HZ = 90_000
"""The clock of RTP time stamps for video (RFC 6184, section 8.1); it divides all usual rates."""
_BT709 = 1
_LIMITED_RANGE = 1
_START = b"\x00\x00\x01"
_IDR, _SEQUENCE = 5, 7


def prepare(context: VideoCodecContext, size: tuple[int, int]) -> None:
    """Set an encoder up for frames of `yuv_frame` of this (width, height), px."""
    context.width, context.height, context.pix_fmt = *size, "yuv420p"
    context.colorspace = context.color_primaries = context.color_trc = _BT709
    context.color_range = _LIMITED_RANGE


def yuv_frame(image: NDArray[np.uint8]) -> av.VideoFrame:
    """Return an (H, W, 3) BGR picture as the frame that an encoder takes."""
    import av

    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
    return frame.reformat(format="yuv420p", dst_colorspace=_BT709, dst_color_range=_LIMITED_RANGE)


class TimedFrames:
    """Makes the encoder's frames of pictures of one size, in the order of their times; its time base is 1/`CLOCK_HZ`.

    Args:
        size: (width, height) px.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._first: MonoNs | None = None
        self._pts = -1

    def frame(self, image: NDArray[np.uint8], at: MonoNs) -> av.VideoFrame | None:
        """Return the frame of an (H, W, 3) BGR picture of the instant `at`; None for one that is not later than the last.

        Raises:
            ValueError: a picture of another size.
        """
        width, height = self._size
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise ValueError(f"want {height, width, 3} uint8 BGR, got {image.shape} {image.dtype}")
        if self._first is None:
            self._first = at
        pts = round(seconds_between(self._first, at) * CLOCK_HZ)
        if pts <= self._pts:
            return None
        self._pts = pts
        frame = yuv_frame(image)
        frame.pts, frame.time_base = pts, Fraction(1, CLOCK_HZ)
        return frame


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


U8 = NDArray[np.uint8]

KEY_EACH = 30
"""Frames from one key frame to the next: what a viewer decodes for a seek, and what a damaged frame spoils at most."""
_CRF = 26
"""Quality of the codec.

At 20 most of the bytes are the sensor's noise: five times as many, for a heading that a replay measures 0.1 degrees better at 95
%.
"""
_PIXELS_MAX = 1 << 24
"""A file that claims larger frames than any camera here gets no memory for them."""
RECORDED = VideoQuality(_CRF, KEY_EACH)


class _Group(Struct, eq=False):
    """A key frame and what follows it up to the next."""

    packets: list[bytes] = field(default_factory=list)
    decoder: AccessUnitDecoder | None = None
    decoded: int = 0
    last: U8 | None = None

    def image(self, number: int) -> U8 | None:
        if self.decoder is None or number < self.decoded - 1:
            self.decoder = AccessUnitDecoder("a recording whose frames are H.264", _PIXELS_MAX, flags="low_delay")
            self.decoded, self.last = 0, None
        while self.decoded <= number:
            frames = self.decoder.decode(self.packets[self.decoded])
            self.last = np.asarray(frames[-1].to_ndarray(format="bgr24"), np.uint8) if frames else None
            self.decoded += 1
        return self.last


class VideoImage(Struct, frozen=True, eq=False):
    """One recorded frame of a video, decoded when it is requested."""

    _group: _Group
    _number: int

    def px(self) -> U8 | None:
        """Return (H, W, 3) BGR, or None if the frame is damaged or what it builds upon is missing."""
        return self._group.image(self._number)


class FrameSequence:
    """Puts the access units of a recording together, in order."""

    def __init__(self) -> None:
        self._group: _Group | None = None

    def add(self, data: bytes) -> VideoImage | None:
        """Return the frame of an access unit; None before the first key frame."""
        if is_key_frame(data):
            self._group = _Group()
        if self._group is None:
            return None
        self._group.packets.append(data)
        return VideoImage(self._group, len(self._group.packets) - 1)
