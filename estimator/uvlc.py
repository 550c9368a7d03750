"""Decode UVLC pictures, the video of an AR.Drone 1.0: one intra-coded picture a datagram.

Source: Parrot, AR.Drone Developer Guide SDK 1.7, 7.2 (video stream). The core decodes them (estimator/core/video/uvlc_decode.c).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.pictures import CodedPicture, PictureRefusal
from estimator.core.library import CORE

_HEADER, _DECODE = CORE.function("uvlc_header"), CORE.function("uvlc_decode")
_REFUSALS = (
    None,
    PictureRefusal.TOO_SHORT,
    PictureRefusal.BAD_MAGIC,
    PictureRefusal.BAD_SIZE,
    PictureRefusal.INTER_PICTURE,
    PictureRefusal.TORN,
    PictureRefusal.BAD_CODE,
)
"""What the results of the core mean, in their order (`estimator.core.interface.video.RESULTS`)."""


class UvlcDecoder:
    """A `PictureDecoder` of UVLC."""

    def header(self, data: bytes) -> CodedPicture | PictureRefusal:
        """Read what picture the data hold. Never raises."""
        words = np.zeros(5, np.int64)
        refusal = _REFUSALS[_HEADER(data, len(data), words.ctypes.data)]
        if refusal is not None:
            return refusal
        width, height, _, quantizer, number = words.tolist()
        return CodedPicture(width, height, quantizer, number)

    def decode(self, data: bytes, picture: CodedPicture) -> NDArray[np.uint8] | PictureRefusal:
        """Return a whole picture's pixels, (height, width, 3) BGR; `picture` is its header. Never raises."""
        words = np.array([picture.width, picture.height, 1, picture.quantizer, picture.number], np.int64)
        px = np.empty((picture.height, picture.width, 3), np.uint8)
        refusal = _REFUSALS[_DECODE(data, len(data), words.ctypes.data, px.ctypes.data)]
        return px if refusal is None else refusal
