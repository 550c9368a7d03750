"""Meter the light of a picture, or of the bright paint inside a pad's outline.

Light is linear: the sRGB curve is undone first, and full scale is 1.
"""

import math
from functools import lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

TARGET = 0.55
"""Light of the bright paint at which the law aims, full scale is 1: a grey value of 194 by the sRGB curve, over half a stop below
clipping."""
_NO_LIGHT = 2.0**-13
"""Light below which eight bits carry no information."""
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
_DARKEST = 0.02  # share of a whole picture's pixels that are its darkest parts
_SHADOWS = 0.03
"""Light from which the darkest parts show what is in them: a grey value of 48. By day the sea is about as bright when white paint
is rightly exposed."""
_CUT = 0.5
"""Share of the outline's area in the frame below which the pad is cut."""


class Metered(Struct, frozen=True):
    """The light in a part of a picture."""

    level: float
    """Light by the sRGB curve, full scale is 1."""
    saturated: float = 0.0
    """Share of its pixels with a clipped channel."""
    clipped: bool = False
    """True if the level itself is clipped: it is only known to be too bright."""
    target: float = TARGET
    """The level at which that part is rightly exposed."""
    cut: bool = False
    """True if the frame shows only a smaller part of what is metered."""

    @property
    def error_ev(self) -> float:
        """Stops by which the picture is too dark; negative where it is too bright."""
        if self.clipped:
            return -1.0 - 2.0 * self.saturated
        return math.log2(self.target / max(self.level, _NO_LIGHT))


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
