"""Decode UVLC pictures, the video of an AR.Drone 1.0: one intra-coded picture a datagram.

Source: Parrot, AR.Drone Developer Guide SDK 1.7, 7.2 (video stream). The core decodes them (estimator/core/video/uvlc_decode.c).
"""

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.pictures import CodedPicture, PictureRefusal
from estimator.core import abi
from estimator.core.library import CORE

_REFUSALS = {
    abi.DL_UVLC_SHORT: PictureRefusal.TOO_SHORT,
    abi.DL_UVLC_NO_PICTURE: PictureRefusal.BAD_MAGIC,
    abi.DL_UVLC_SIZE: PictureRefusal.BAD_SIZE,
    abi.DL_UVLC_INTER: PictureRefusal.INTER_PICTURE,
    abi.DL_UVLC_TORN: PictureRefusal.TORN,
    abi.DL_UVLC_BAD_CODE: PictureRefusal.BAD_CODE,
}


class UvlcDecoder:
    """A `PictureDecoder` of UVLC."""

    def header(self, data: bytes) -> CodedPicture | PictureRefusal:
        """Read what picture the data hold. Never raises."""
        read = CORE.ffi.new("dl_uvlc_picture *")
        refusal = _REFUSALS.get(CORE.lib.dl_uvlc_header(data, len(data), read))
        return refusal or CodedPicture(read.width, read.height, read.quantizer, read.number)

    def decode(self, data: bytes, picture: CodedPicture) -> NDArray[np.uint8] | PictureRefusal:
        """Return a whole picture's pixels, (height, width, 3) BGR; `picture` is its header. Never raises."""
        header = CORE.ffi.new("dl_uvlc_picture *", {"width": picture.width, "height": picture.height})
        px = np.empty((picture.height, picture.width, 3), np.uint8)
        refusal = _REFUSALS.get(CORE.lib.dl_uvlc_decode(data, len(data), header, CORE.array("uint8_t", px), px.size))
        return px if refusal is None else refusal
