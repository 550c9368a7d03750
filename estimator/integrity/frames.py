"""Detect repeated frames: the same pixels under a new stamp carry no new information.

A sensor's noise makes every genuine frame different from every other, so the test is bit equality over a subsample of the raw
pixels. It covers a driver that returns one buffer again, a ring of buffers, and a codec that repeats a frame without residual.
"""

import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_EVERY = 16
"""Distance of the rows that are compared: 23 of 360, 44 kB, 0.04 ms."""
_KEPT = 16
"""Number of frames whose digest is kept: more than the buffer ring of a capture driver holds."""
_FROZEN_RUN = 3


class FrameWatch(NamedTuple):
    """Digests of the newest distinct frames, and the number of repeats since."""

    digests: tuple[int, ...] = ()
    run: int = 0
    """Number of repeats in a row."""

    @property
    def frozen(self) -> bool:
        return self.run >= _FROZEN_RUN


def digest(px: NDArray[np.uint8]) -> int:
    """Return a checksum over rows of an image (H, W, 3), spread over its height."""
    rows = px[_EVERY // 2 :: _EVERY]
    # An image that repeats one row in memory shows nothing more than that row.
    return zlib.crc32(np.ascontiguousarray(rows[:1] if rows.strides[0] == 0 else rows).data)


def watch(state: FrameWatch, px: NDArray[np.uint8]) -> tuple[FrameWatch, bool]:
    """Process one frame; return whether it repeats one of the last few."""
    this = digest(px)
    if this in state.digests:
        return FrameWatch(state.digests, state.run + 1), True
    return FrameWatch((*state.digests, this)[-_KEPT:]), False
