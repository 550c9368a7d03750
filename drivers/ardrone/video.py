"""H.264 access units of PaVE frames to frames.

A decoder that lost a unit goes on with wrong frames and does not always say so, so after any gap, damage or error everything is
dropped up to the next IDR. `VideoDecoder.newest` blocks for 1-2 ms a frame of 640x360: call it from one worker thread, in order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import av
import numpy as np
from av.error import FFmpegError
from av.video.codeccontext import VideoCodecContext
from numpy.typing import NDArray

from drivers.ardrone.pave import CODEC_H264, FrameType, PaveFrame

MAX_PIXELS = 1920 * 1088


@dataclass(frozen=True, slots=True, eq=False)
class DecodedImage:
    """A decoded frame and where in the batch its unit stood."""

    index: int
    px: NDArray[np.uint8]
    """(H, W, 3) BGR."""


class VideoDecoder:
    """Access units in, the newest frame out. Every unit given to it ends in exactly one of the counters."""

    def __init__(self) -> None:
        self._codec: VideoCodecContext | None = None
        self.images = 0
        """Given out."""
        self.overtaken = 0
        """A newer frame of the same batch was given out instead."""
        self.waiting = 0
        """Dropped: no IDR since the start, a gap or damage."""
        self.damaged = 0
        """Dropped: the decoder refused it, marked it corrupt, or its size is not that of its header."""
        self.unsupported = 0
        """Dropped: not H.264, or a part of a frame."""
        self.empty = 0
        """Announcements and parameter sets alone: nothing to see by design."""

    @property
    def units(self) -> int:
        """How many were given to it."""
        return self.images + self.overtaken + self.waiting + self.damaged + self.unsupported + self.empty

    def newest(self, batch: Sequence[PaveFrame]) -> DecodedImage | None:
        """Decode a batch in order and convert only its newest frame; units before the batch's last IDR are not even decoded."""
        start = max((i for i, f in enumerate(batch) if _entry(f)), default=0)
        self.overtaken += start
        seen: tuple[int, av.VideoFrame] | None = None
        for index in range(start, len(batch)):
            image = self._decode(batch[index])
            if image is not None:
                self.overtaken += seen is not None
                seen = index, image
        if seen is None:
            return None
        self.images += 1
        return DecodedImage(seen[0], np.asarray(seen[1].to_ndarray(format="bgr24"), dtype=np.uint8))

    def _decode(self, unit: PaveFrame) -> av.VideoFrame | None:
        header = unit.header
        if header.advertisement or not unit.payload:
            self.empty += 1
            return None
        if header.codec != CODEC_H264 or header.total_chunks > 1 or header.total_slices > 1:
            self.unsupported += 1
            self._codec = None
            return None
        if unit.discontinuity:
            self._codec = None
        if self._codec is None:
            if not _entry(unit):
                self.waiting += 1
                return None
            self._codec = _new_codec()
        try:
            images = self._codec.decode(av.Packet(unit.payload))
        except FFmpegError:
            images = []
        if not images and header.frame_type == FrameType.HEADERS:
            self.empty += 1
            return None
        size = header.display_width, header.display_height
        if len(images) != 1 or images[0].is_corrupt or (images[0].width, images[0].height) != size:
            self.damaged += 1
            self._codec = None
            return None
        return images[0]


def _entry(unit: PaveFrame) -> bool:
    header = unit.header
    whole = header.codec == CODEC_H264 and header.total_chunks <= 1 and header.total_slices <= 1
    return header.frame_type == FrameType.IDR and whole and not header.advertisement and bool(unit.payload)


def _new_codec() -> VideoCodecContext:
    codec = VideoCodecContext.create("h264", "r")
    codec.thread_type = "NONE"
    codec.options = {"err_detect": "explode", "max_pixels": str(MAX_PIXELS)}
    return codec
