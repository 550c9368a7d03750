"""Encode frames as UVLC pictures, as an AR.Drone 1.0 does: every picture by itself, one to a datagram."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.core.library import SIM

FINEST = 31
"""The quantizer that captures of the real drone show: it stands for the steps of quantizer 2, the finest that the drone uses."""
_COARSER = (*range(3, 31, 3), 30)
DATAGRAM_MAX = 65504
"""Bytes of the largest UDP datagram, in whole words."""


def encode(px: NDArray[np.uint8], number: int, quantizer: int = FINEST) -> bytes:
    """Encode one (height, width, 3) BGR frame: 176x144, 352x288, 320x240 or 640x480 px.

    A picture that does not fit a datagram is coded again with coarser steps, as the drone keeps its bit rate.

    Args:
        number: the drone's count of pictures.
        quantizer: 1 (fine) to 30; 31 stands for 2.

    Raises:
        ValueError: the frame is of another size, or fits no datagram.
    """
    height, width = px.shape[:2]
    px = np.ascontiguousarray(px)
    out = np.empty(DATAGRAM_MAX, np.uint8)
    for steps in (quantizer, *_COARSER):
        picture = SIM.ffi.new("sim_uvlc_picture *", (width, height, steps, number % 2**32))
        coded = SIM.array("uint8_t", out)
        size = SIM.lib.sim_uvlc_encode(SIM.array("uint8_t", px, 3 * width * height), px.size, picture, coded, len(out))
        if size < 0:
            raise ValueError(f"UVLC has no picture of {width}x{height} px with quantizer {steps}")
        if size > 0:
            return out[:size].tobytes()
    raise ValueError(f"a frame of {width}x{height} px fits no datagram")
