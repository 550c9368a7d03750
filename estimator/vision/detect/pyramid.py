"""A frame at full, half, quarter ... size."""

from typing import Any, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.core.abi import DL_FRAME_LEVELS
from estimator.core.library import CORE
from estimator.vision.camera.camera import Camera
from estimator.vision.detect.colour import in_grey
from estimator.vision.native import checked, count_work, put_image, work_done
from estimator.vision.pad.pad import Pad

U8 = NDArray[np.uint8]
_HALVING_WORK = 3  # Work of a byte of a reduced image, millionths of a floor
_MONOCHROME = 3.0  # Largest difference between the channels of a pixel in a frame of a grey camera


class Pyramid:
    """One frame at full, half, quarter ... size; each level is computed on demand."""

    def __init__(self, px: U8) -> None:
        self._began = work_done()
        self._levels = [np.ascontiguousarray(px, np.uint8)]
        self._native: Any = None

    @property
    def native(self) -> Any:
        """The core's `dl_frame` of the levels that were made, for as long as this pyramid lives."""
        if self._native is None:
            self._native = CORE.ffi.new("dl_frame *")
            for level, px in enumerate(self._levels[: DL_FRAME_LEVELS + 1]):
                put_image(px, self._native.level[level])
            checked(CORE.lib.dl_frame_quality(self._native.level, CORE.ffi.addressof(self._native, "quality")))
        return self._native

    @property
    def work(self) -> float:
        """Work that was done since it was made, in floors, as the core counts it; see `native.work_done`."""
        return 1e-6 * (work_done() - self._began)

    @property
    def monochrome(self) -> bool:
        """True if the frame comes from a grey camera: its channels are equal, apart from what a codec adds.

        A painted pad in view of a colour camera, or anything else of some colour, makes it False.
        """
        return bool(self.native.quality.chroma <= _MONOCHROME)

    def __getitem__(self, level: int) -> U8:
        while len(self._levels) <= level:
            px = self._levels[-1]
            w, h = max(1, px.shape[1] // 2), max(1, px.shape[0] // 2)
            # An odd row or column left over would stretch the result.
            half = cv2.resize(px[: 2 * h, : 2 * w], (w, h), interpolation=cv2.INTER_AREA)
            self._levels.append(np.asarray(half, np.uint8))
            count_work(half.size * _HALVING_WORK)
            if self._native is not None and len(self._levels) <= DL_FRAME_LEVELS + 1:
                put_image(self._levels[-1], self._native.level[len(self._levels) - 1])
        return self._levels[level]


class FrameView(NamedTuple):
    """A frame, the camera that took it, and the pad that is looked for in it."""

    pyramid: Pyramid
    camera: Camera
    pad: Pad

    def as_seen(self) -> Self:
        """Return the same with the pad in the paints that the camera sees."""
        return self._replace(pad=in_grey(self.pad)) if self.pyramid.monochrome else self
