"""Decide on a driven camera's exposure, frame by frame: meter, wait until a change shows, and request the next one.

While no pad is tracked nobody knows which part of the picture to meter, so two exposures take turns. The first keeps the
brightest parts of the picture from clipping, as a lit pad on a dark sea needs it. The second shows what is in its darkest
parts, as a pad in the shade beside the mirrored sun needs it; where the first shows that too, there is no second.
"""

from functools import lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera.exposure import TARGET, ExposureDrive, ExposureRange, ExposureSetting, LawMemory, Metered, limit_of, step
from drivers.camera.options import ExposureOptions
from estimator.contracts.samples import Frame

_PIXELS = 10_000
"""About how many pixels are looked at."""
_FEWEST = 30
"""An outline with fewer pixels is not used."""
_CLIPPED = 250
"""Grey value from which a channel counts as clipped."""
_BRIGHT = 0.97
"""Share of a pad's pixels that are no brighter than its level: every pad has more than 3 % of bright paint."""
_BRIGHTEST = 0.995
"""Share of a whole picture's pixels that are no brighter than its level: a pad in it may be small."""
_DARKEST, _SHADOWS = 0.02, 0.03
"""Share of a whole picture's pixels that are its darkest parts, and the light from which these show what is in them: a grey
value of 48. By day the sea is about as bright when white paint is rightly exposed."""
_CUT = 0.5
"""Share of the outline's area in the frame below which the pad is cut."""


def meter_whole(px: NDArray[np.uint8]) -> tuple[Metered, Metered]:
    """Return the light of a whole picture, (H, W, 3) BGR: of its brightest parts, and of its darkest."""
    h, w = px.shape[:2]
    every = max(1, round((h * w / _PIXELS) ** 0.5))
    pixels = px[::every, ::every].reshape(-1, 3)
    return _meter(pixels, _BRIGHTEST, TARGET), _meter(pixels, _DARKEST, _SHADOWS)


def meter_inside(px: NDArray[np.uint8], outline_px: NDArray[np.float64]) -> Metered | None:
    """Return the light of the bright paint inside an outline; None if it holds too few pixels.

    Args:
        px: (H, W, 3) BGR.
        outline_px: (N, 2) corners of a convex outline, which may lie outside the frame.
    """
    h, w = px.shape[:2]
    low = np.clip(np.floor(outline_px.min(axis=0)), 0, (w, h)).astype(int)
    high = np.clip(np.ceil(outline_px.max(axis=0)) + 1, 0, (w, h)).astype(int)
    (x0, y0), (x1, y1) = low.tolist(), high.tolist()
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    every = max(1, round(((x1 - x0) * (y1 - y0) / _PIXELS) ** 0.5))
    part = px[y0:y1:every, x0:x1:every]
    mask = np.zeros(part.shape[:2], np.uint8)
    inside = ((outline_px - (x0, y0)) / every).clip(-1e4, 1e4)
    cv2.fillConvexPoly(mask, np.round(inside).astype(np.int32), 1)
    chosen = part[mask.astype(bool)]
    if len(chosen) < _FEWEST:
        return None
    whole = cv2.contourArea(outline_px.astype(np.float32))
    return _meter(chosen, _BRIGHT, TARGET, cut=len(chosen) * every**2 < _CUT * whole)


def _meter(pixels: NDArray[np.uint8], share: float, target: float, *, cut: bool = False) -> Metered:
    # The brightest channel: once it is clipped the colour is wrong, whatever the sum of the three is.
    counts = np.bincount(pixels.max(axis=1), minlength=256)
    below = np.cumsum(counts) / len(pixels)
    code = int(np.searchsorted(below, share))
    saturated = float(counts[_CLIPPED:].sum() / len(pixels))
    return Metered(float(_linear()[code]), saturated, code >= _CLIPPED, target, cut)


@lru_cache(maxsize=1)
def _linear() -> NDArray[np.float64]:
    """Return the light of each grey value, (256,). Source: IEC 61966-2-1."""
    v = np.arange(256) / 255.0
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


_DWELL = 8
"""Pictures with one exposure before the other's turn: a quarter of a second at 30 Hz, enough for several looks of the search."""
_APART_EV = 1.0
"""Stops between the two from which they take turns."""
_FARTHEST_EV = 3.0


class BracketMemory(Struct, frozen=True):
    """Memory of the exposure search from frame to frame."""

    law: LawMemory = LawMemory()
    pictures: int = 0
    """Number of pictures with this exposure."""
    back_to_s: float | None = None
    """Product of time and gain of the first exposure while it is the second's turn, s."""


def search_step(
    memory: BracketMemory, held: ExposureSetting, can: ExposureRange, limit_s: float, brightest: Metered, darkest: Metered
) -> tuple[BracketMemory, ExposureSetting | None]:
    """Return the exposure that the camera is to take; None to leave it. The arguments are those of `step`."""
    pictures = memory.pictures + 1
    if memory.back_to_s is not None:
        if pictures < _DWELL:
            return BracketMemory(memory.law, pictures, memory.back_to_s), step(memory.law, held, can, limit_s, None)[1]
        return BracketMemory(), can.split(memory.back_to_s, limit_s)
    law, wanted = step(memory.law, held, can, limit_s, brightest)
    if wanted is not None or pictures < _DWELL:
        return BracketMemory(law, 0 if wanted is not None else pictures), wanted
    apart_ev = darkest.error_ev
    second = can.split(held.product_s * 2.0 ** min(apart_ev, _FARTHEST_EV), limit_s)
    if apart_ev < _APART_EV or second.product_s < 1.4 * held.product_s:
        return BracketMemory(law), None
    return BracketMemory(law, 0, held.product_s), second


class ExposureGovernor:
    """Drives one camera."""

    def __init__(self, options: ExposureOptions, drive: ExposureDrive) -> None:
        self._o, self._drive = options, drive
        self._law, self._search = LawMemory(), BracketMemory()

    @property
    def short_of_ev(self) -> float:
        """Stops that are missing on the pad where the limits do not allow more, below 0 that are too many; 0 where they do."""
        return self._law.short_of_ev

    def on_frame(self, frame: Frame, outline_px: NDArray[np.float64] | None, speed_px_s: float) -> None:
        """Take the next frame.

        Args:
            outline_px: (N, 2) convex outline of the pad, where it is tracked; None while it is looked for.
            speed_px_s: how fast the picture moves over the sensor.
        """
        can, held = self._drive.can, self._drive.held
        if can is None or held is None:
            return
        limit_s = limit_of(self._o.blur_px, speed_px_s, self._o.longest_s)
        if not self._drive.settled(frame.seq):
            if held.exposure_s > limit_s and held.exposure_s > can.shortest_s:
                self._drive.ask(can.split(held.product_s, limit_s))
            return
        metered = None if outline_px is None else meter_inside(frame.px, outline_px)
        if outline_px is None:
            self._law = LawMemory()
            self._search, wanted = search_step(self._search, held, can, limit_s, *meter_whole(frame.px))
        else:
            self._search = BracketMemory()
            self._law, wanted = step(self._law, held, can, limit_s, metered)
        if wanted is not None and wanted != held:
            self._drive.ask(wanted)
