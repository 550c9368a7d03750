"""Meter the light of a picture: inside an outline, or of the whole."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera.exposure_law import TARGET, Metered

_PIXELS = 10_000
"""About how many pixels are looked at."""
_FEWEST = 30
"""An outline with fewer pixels tells nothing."""
_CLIPPED = 250
"""Grey value from which on a channel counts as clipped."""
_BRIGHT = 0.97
"""Share of a pad's pixels that are no brighter than its level: every pad has more than 3 % of bright paint."""
_BRIGHTEST = 0.995
"""The same of a whole picture, in which a pad may be small."""
_DARKEST, _SHADOWS = 0.02, 0.03
"""Share of a whole picture's pixels that are its darkest parts, and the light from which on these show what is in them: a grey
value of 48. By day the sea is about as bright when white paint is rightly exposed."""
_CUT = 0.5
"""Share of the outline's area in the frame below which the pad is cut."""


def meter_whole(px: NDArray[np.uint8]) -> tuple[Metered, Metered]:
    """Return the light of a whole picture, (H, W, 3) BGR: of its brightest parts, and of its darkest."""
    h, w = px.shape[:2]
    every = max(1, round((h * w / _PIXELS) ** 0.5))
    pixels = px[::every, ::every].reshape(-1, 3)
    return _metered(pixels, _BRIGHTEST, TARGET), _metered(pixels, _DARKEST, _SHADOWS)


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
    return _metered(chosen, _BRIGHT, TARGET, cut=len(chosen) * every**2 < _CUT * whole)


def _metered(pixels: NDArray[np.uint8], share: float, target: float, *, cut: bool = False) -> Metered:
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
