"""Pictures on the way to an H.264 encoder: their times on the clock of 90 kHz, their colours by BT.709 in limited range."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.time import MonoNs, seconds_between

if TYPE_CHECKING:
    import av
    from av.video.codeccontext import VideoCodecContext

CLOCK_HZ = 90_000
"""The clock of RTP time stamps for video (RFC 6184, section 8.1); it divides all usual rates."""
_BT709 = 1
_LIMITED_RANGE = 1


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
