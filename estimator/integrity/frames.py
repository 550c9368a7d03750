"""Frames that repeat: the same pixels under a new stamp tell nothing new of the world.

A sensor's noise makes every true frame differ from every other one, so the test is equality to the bit over a subsample of the
raw pixels. It covers a driver that hands out one buffer again, a ring of buffers, and a codec that repeats a frame without
residual.
"""

from __future__ import annotations

import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_EVERY = 16
"""One row in so many is looked at: 23 of 360, 44 kB, 0.04 ms."""
_KEPT = 16
"""Frames whose digest is kept: longer than the buffer ring of a capture driver."""
_FROZEN_RUN = 3


class FrameWatch(NamedTuple):
    """Digests of the newest frames that differed, and how many have repeated one of them since."""

    digests: tuple[int, ...] = ()
    run: int = 0
    """Repeats in a row."""

    @property
    def frozen(self) -> bool:
        return self.run >= _FROZEN_RUN


def digest(px: NDArray[np.uint8]) -> int:
    """A check sum over rows of an image (H, W, 3), spread over its height."""
    return zlib.crc32(np.ascontiguousarray(px[_EVERY // 2 :: _EVERY]).data)


def watch(state: FrameWatch, px: NDArray[np.uint8]) -> tuple[FrameWatch, bool]:
    """Take one frame; whether it repeats one of the last few."""
    this = digest(px)
    if this in state.digests:
        return FrameWatch(state.digests, state.run + 1), True
    return FrameWatch((*state.digests, this)[-_KEPT:]), False
