"""A frame at full, half, quarter ... size."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.vision.detect.colour import in_grey
from estimator.vision.native import pixels
from estimator.vision.pad import Pad

U8 = NDArray[np.uint8]
_QUALITY, _QUALITY_WORDS = CORE.function("frame_noise"), size_of("frame_quality")
_NOISE, _CHROMA = (places_of("frame_quality")[name].start for name in ("noise", "chroma"))
_MONOCHROME = 3.0
"""Largest difference between the channels of a pixel in a frame of a grey camera."""


class Pyramid:
    """One frame at full, half, quarter ... size; each level is computed on demand."""

    def __init__(self, px: U8) -> None:
        self._levels = [px]
        self._quality: F64 | None = None

    @property
    def monochrome(self) -> bool:
        """Whether the frame comes from a grey camera: its channels are equal, but for what a codec adds.

        A painted pad in view of a colour camera, or anything else of some colour, makes it False.
        """
        return float(self.quality[_CHROMA]) <= _MONOCHROME

    @property
    def quality(self) -> F64:
        """The structure `frame_quality` of the core: noise beyond a camera's usual, contrast and colour."""
        if self._quality is None:
            px, self._quality = self._levels[0], np.empty(_QUALITY_WORDS)
            _QUALITY(*pixels(px), px.shape[1], px.shape[0], start_of(self._quality))
        return self._quality

    @property
    def noise(self) -> float:
        """Standard deviation of the frame's noise beyond what a camera usually has, 3 values of a pixel; 1 is full scale."""
        return float(self.quality[_NOISE])

    def as_seen(self, pad: Pad) -> Pad:
        """Return a pad in the paints that the frame's camera sees."""
        return in_grey(pad) if self.monochrome else pad

    def __getitem__(self, level: int) -> U8:
        while len(self._levels) <= level:
            self._levels.append(_halved(self._levels[-1]))
        return self._levels[level]

    def size(self, level: int) -> tuple[int, int]:
        """Return the columns and rows of a level."""
        h, w = self._levels[0].shape[:2]
        return max(1, w >> level), max(1, h >> level)

    def cut(self, level: int, left: int, top: int, right: int, below: int) -> U8:
        """Return part of a level. If the part is small, only that part of the level is computed."""
        made = len(self._levels) - 1
        w, h = self.size(level)
        if level <= made or 2 * (right - left) * (below - top) > w * h:
            return self[level][top:below, left:right]
        up = level - made
        part = self._levels[made][top << up : below << up, left << up : right << up]
        for _ in range(up):
            part = _halved(part)
        return part


def _halved(px: U8) -> U8:
    w, h = max(1, px.shape[1] // 2), max(1, px.shape[0] // 2)
    # An odd row or column left over would stretch the result.
    return np.asarray(cv2.resize(px[: 2 * h, : 2 * w], (w, h), interpolation=cv2.INTER_AREA), np.uint8)
