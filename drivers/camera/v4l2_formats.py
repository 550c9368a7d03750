"""Decode the bytes of a V4L2 buffer to a BGR image. Wire input never raises: the result for unreadable bytes is None."""

from dataclasses import dataclass

import av
import cv2
import numpy as np
from av.error import FFmpegError
from av.video.codeccontext import VideoCodecContext
from numpy.typing import NDArray

from drivers.camera.images import ImageRefused, decode
from drivers.camera.videos import most_pixels

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """The format of the frames that the device agreed to send."""

    format: str
    width: int
    height: int
    bytes_per_line: int
    """The length of an image line, bytes; 0 for compressed formats."""


def to_bgr(data: bytes, layout: FrameLayout) -> U8 | None:
    """Decode one buffer of a format whose frames are independent to (H, W, 3) BGR; None if torn, damaged or of another size.

    YUYV and NV12 are read as BT.601 with studio swing, which webcams send and V4L2 assumes for standard definition.
    """
    if layout.format == "MJPG":
        return _jpeg(data, layout)
    w, h, stride = layout.width, layout.height, layout.bytes_per_line
    rows = h * 3 // 2 if layout.format == "NV12" else h
    if len(data) < rows * stride:
        return None
    lines = np.frombuffer(data, np.uint8, rows * stride).reshape(rows, stride)
    if layout.format == "YUYV":
        return _u8(cv2.cvtColor(lines[:, : 2 * w].reshape(h, w, 2), cv2.COLOR_YUV2BGR_YUYV))
    if layout.format == "NV12":
        return _u8(cv2.cvtColor(np.ascontiguousarray(lines[:, :w]), cv2.COLOR_YUV2BGR_NV12))
    return _u8(cv2.cvtColor(np.ascontiguousarray(lines[:, :w]), cv2.COLOR_GRAY2BGR))


def _jpeg(data: bytes, layout: FrameLayout) -> U8 | None:
    # The decoder silently fills the missing part of a torn frame with grey, hence the end mark; drivers pad with zeros.
    whole = data.rstrip(b"\0")
    if not (whole.startswith(b"\xff\xd8") and whole.endswith(b"\xff\xd9")):
        return None
    try:
        return decode(whole, (layout.width, layout.height))
    except ImageRefused:
        return None


def _u8(px: NDArray[np.generic]) -> U8:
    return np.asarray(px, dtype=np.uint8)


class H264Decoder:
    """Decodes access units in Annex B, in order. After damage everything is dropped up to the next IDR."""

    def __init__(self) -> None:
        self._codec: VideoCodecContext | None = None

    def broken(self) -> None:
        """Drop all units up to the next IDR, because units were lost."""
        self._codec = None

    @property
    def waiting(self) -> bool:
        """Whether the decoder waits for an IDR."""
        return self._codec is None

    def decode(self, unit: bytes, layout: FrameLayout) -> U8 | None:
        """Decode one access unit to (H, W, 3) BGR; None while waiting for an IDR, or if the unit is damaged (then it waits)."""
        if self._codec is None:
            if not stands_alone(unit):
                return None
            self._codec = VideoCodecContext.create("h264", "r")
            self._codec.thread_type = "NONE"
            self._codec.options = {
                "err_detect": "explode",
                "max_pixels": str(most_pixels((layout.width, layout.height))),
                "flags": "low_delay",
            }
        try:
            frame_images = self._codec.decode(av.Packet(unit))
        except FFmpegError:
            frame_images = []
        if (
            len(frame_images) != 1
            or frame_images[0].is_corrupt
            or (frame_images[0].width, frame_images[0].height) != (layout.width, layout.height)
        ):
            self._codec = None
            return None
        return _u8(frame_images[0].to_ndarray(format="bgr24"))


def stands_alone(unit: bytes) -> bool:
    """Return whether an access unit holds an IDR slice (NAL type 5) and can be decoded without those before it."""
    at = unit.find(b"\0\0\1")
    while at != -1 and at + 3 < len(unit):
        if unit[at + 3] & 0x1F == 5:
            return True
        at = unit.find(b"\0\0\1", at + 3)
    return False
