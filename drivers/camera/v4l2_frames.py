"""Decode the buffers of a V4L2 device: YUYV, NV12, grey and MJPG, whose frames are independent, and H.264."""

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera.images import ImageRefused, decode
from drivers.camera.videos import most_pixels
from drivers.pyav import AccessUnitDecoder, whole
from estimator.contracts.errors import BadInput

U8 = NDArray[np.uint8]


class FrameLayout(Struct, frozen=True):
    """The format of the frames that the device agreed to send."""

    format: str
    width: int
    height: int
    bytes_per_line: int
    """The length of an image line, bytes; 0 for compressed formats."""


def line_length(layout: FrameLayout) -> int:
    """Return the length of an image line, bytes; where a driver says 0, the lines follow one another without a gap.

    Raises:
        BadInput: the driver reports a line that is too short for the width.
    """
    w, even = layout.width, layout.width + layout.width % 2
    needed = {"YUYV": 2 * even, "NV12": even}.get(layout.format, w)
    stride = layout.bytes_per_line or needed
    if stride < (needed if layout.format == "YUYV" else w):
        raise BadInput(
            f"the camera's driver says that a line of {w} px in {layout.format} takes {stride} bytes, but it takes {needed}: "
            "choose another camera.format or size, or another driver"
        )
    return stride


def to_bgr(data: bytes, layout: FrameLayout) -> U8 | None:
    """Decode one buffer of a format whose frames are independent to (H, W, 3) BGR; None if torn, damaged or of another size.

    YUYV and NV12 are read as BT.601 with studio swing, which webcams send and V4L2 assumes for standard definition. Their sizes
    may be odd.

    Raises:
        BadInput: the layout is none that can be; the device checks it when it is opened.
    """
    if layout.format == "MJPG":
        try:
            return decode(data, (layout.width, layout.height))
        except ImageRefused:
            return None
    w, h, stride = layout.width, layout.height, line_length(layout)
    rows = h + (h + 1) // 2 if layout.format == "NV12" else h
    if len(data) < rows * stride:
        return None
    lines = np.frombuffer(data, np.uint8, rows * stride).reshape(rows, stride)
    if layout.format == "YUYV":
        even = w + w % 2
        return _u8(cv2.cvtColor(lines[:, : 2 * even].reshape(h, even, 2), cv2.COLOR_YUV2BGR_YUYV)[:, :w])
    if layout.format == "NV12":
        return _u8(cv2.cvtColor(_even_planes(lines, w, h), cv2.COLOR_YUV2BGR_NV12)[:h, :w])
    return _u8(cv2.cvtColor(np.ascontiguousarray(lines[:, :w]), cv2.COLOR_GRAY2BGR))


def _even_planes(lines: U8, w: int, h: int) -> U8:
    """Return NV12's two planes with an even width and height, the last column and row of brightness twice."""
    even = min(w + w % 2, lines.shape[1])
    planes = lines[:, :even]
    if even % 2:
        planes = np.pad(planes, ((0, 0), (0, 1)), mode="edge")
        planes[h:, -1] = planes[h:, -3]  # the colours alternate
    if h % 2:
        planes = np.insert(planes, h, planes[h - 1], axis=0)
    return np.ascontiguousarray(planes)


def _u8(px: NDArray[np.generic]) -> U8:
    return np.asarray(px, dtype=np.uint8)


class H264Decoder:
    """Decodes access units in Annex B, in order. After damage everything is dropped up to the next IDR."""

    def __init__(self) -> None:
        self._codec: AccessUnitDecoder | None = None

    def broken(self) -> None:
        """Drop all units up to the next IDR, because units were lost."""
        self._codec = None

    @property
    def waiting(self) -> bool:
        """True if the decoder waits for an IDR."""
        return self._codec is None

    def decode(self, unit: bytes, layout: FrameLayout) -> U8 | None:
        """Decode one access unit to (H, W, 3) BGR; None while waiting for an IDR, or if the unit is damaged (then it waits).

        Raises:
            BadInput: PyAV is not installed.
        """
        size = layout.width, layout.height
        if self._codec is None:
            if not stands_alone(unit):
                return None
            self._codec = AccessUnitDecoder(
                "a camera that sends H.264", most_pixels(size), err_detect="explode", flags="low_delay"
            )
        image = whole(self._codec.decode(unit), size)
        if image is None:
            self._codec = None
            return None
        return _u8(image.to_ndarray(format="bgr24"))


def stands_alone(unit: bytes) -> bool:
    """Return whether an access unit holds an IDR slice (NAL type 5) and can be decoded without those before it."""
    at = unit.find(b"\0\0\1")
    while at != -1 and at + 3 < len(unit):
        if unit[at + 3] & 0x1F == 5:
            return True
        at = unit.find(b"\0\0\1", at + 3)
    return False
