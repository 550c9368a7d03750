"""Decode the H.264 access units of PaVE frames.

A decoder that lost a unit continues with wrong frames and does not always report it, so after any gap, damage or error everything
is dropped up to the next IDR. `VideoDecoder.newest` blocks for 1-2 ms a frame of 640x360: call it in order from one thread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.ardrone.pave import CODEC_H264, FrameType, PaveFrame, PaveHeader
from drivers.pyav import AccessUnitDecoder, whole

if TYPE_CHECKING:
    from av import VideoFrame

MAX_PIXELS = 1920 * 1088


def unit_decoder() -> AccessUnitDecoder:
    """Return a new decoder. Nothing needs one before the first frame, so `VideoDecoder` makes it when a video begins."""
    return AccessUnitDecoder("the video of an AR.Drone", MAX_PIXELS, err_detect="explode")


@dataclass(frozen=True, slots=True, eq=False)
class DecodedImage:
    """A decoded frame and the index of its unit in the batch."""

    index: int
    px: NDArray[np.uint8]
    """The pixels, (H, W, 3) BGR."""


class VideoDecoder:
    """Takes access units and returns the newest frame."""

    def __init__(self) -> None:
        self._codec: AccessUnitDecoder | None = None

    def newest(self, batch: Sequence[PaveFrame]) -> DecodedImage | None:
        """Decode a batch in order and convert only its newest frame; units before the batch's last IDR are not even decoded."""
        start = max((i for i, f in enumerate(batch) if _entry(f)), default=0)
        seen: tuple[int, VideoFrame] | None = None
        for index in range(start, len(batch)):
            image = self._decode(batch[index])
            if image is not None:
                seen = index, image
        if seen is None:
            return None
        return DecodedImage(seen[0], np.asarray(seen[1].to_ndarray(format="bgr24"), dtype=np.uint8))

    def _decode(self, unit: PaveFrame) -> VideoFrame | None:
        header = unit.header
        if header.advertisement or not unit.payload:
            return None
        if unit.discontinuity or not _is_whole(header):
            self._codec = None
        if self._codec is None:
            if not _entry(unit):
                return None
            self._codec = unit_decoder()
        images = self._codec.decode(unit.payload)
        image = whole(images, (header.display_width, header.display_height))
        if image is None and (images or header.frame_type != FrameType.HEADERS):
            self._codec = None
        return image


def _is_whole(header: PaveHeader) -> bool:
    """Return whether a unit is H.264 and not a part of a frame."""
    return header.codec == CODEC_H264 and header.total_chunks <= 1 and header.total_slices <= 1


def _entry(unit: PaveFrame) -> bool:
    header = unit.header
    return header.frame_type == FrameType.IDR and _is_whole(header) and not header.advertisement and bool(unit.payload)
