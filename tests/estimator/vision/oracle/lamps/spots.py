"""Small bright spots of a frame: lamps, their reflections, and whatever else shines."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.srgb import LINEAR_LIGHT

_BACKGROUND_PX = 31
"""Side of the window whose mean is a pixel's background: lamps are smaller."""
_BLUR_PX = 0.7
_FULL = 65535.0
_LEAST, _NOISES = 0.004, 7.0
"""Least brightness of a spot over its background: linear light, full scale 1, and in standard deviations of the noise."""
_BRIGHTEST = 0.03
"""A spot's least brightness, as a part of the brightest one's: the halo of a lamp near by has faint peaks."""
_PEAK_PX = 7
_OF_PEAK = 0.6
"""A spot's pixels have more than this part of the brightest within `_PEAK_PX`: two lamps are two spots down to some 3 px."""
_EDGE_PX = 3
"""Distance from the frame's edge within which a spot counts as cut."""
_LARGEST = 0.02
"""Largest part of the frame that a spot covers."""
_LONGEST = 4.0
"""Largest ratio of a spot's sides: motion draws a lamp out, a lit edge is longer."""
_MUCH_SMALLER, _HALO = 0.4, 2.7
"""Radius of a spot over that of another one, and its distance in radii of that, below which it is a part of the other's halo."""
_MOST = 40
"""The brightest so many are kept."""
_CENTRE_PX, _OF_RADIUS = 0.06, 0.015
"""Standard deviation of a spot's centre that saturation and the lens leave besides noise: px, and as a part of its radius."""
_CROWDED_PX, _CROWDED_WITHIN_PX = 0.3, 7.0
"""Standard deviation that the light of another spot in the same place would leave; from this distance on it leaves none."""
_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""
_NEIGHBOURS = np.ones((_PEAK_PX, _PEAK_PX), np.uint8)
_LINEAR = np.rint(_FULL * LINEAR_LIGHT).astype(np.uint16)


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """N spots, the brightest first."""

    uv_px: F64
    """Centres of brightness, (N, 2) px."""
    sigma_px: F64
    """Standard deviations of the centres, (N,) px, alike in both directions."""
    radius_px: F64
    """Radii of discs of the same areas, (N,) px."""

    @staticmethod
    def none() -> Spots:
        return Spots(np.empty((0, 2)), np.empty(0), np.empty(0))

    def __len__(self) -> int:
        return len(self.sigma_px)


def find_spots(px: NDArray[np.uint8], window: tuple[int, int, int, int] | None = None) -> Spots:
    """Return the bright spots of a frame, (H, W, 3) BGR, that lie wholly in it: the centre of one that is cut is not known.

    Args:
        window: the part that is looked at, first and last column and row (left, top, right, below); the whole frame by default.
    """
    left, top, right, below = window or (0, 0, px.shape[1], px.shape[0])
    spots = _spots(px[top:below, left:right])
    return Spots(spots.uv_px + np.array([left, top]), spots.sigma_px, spots.radius_px)


def _spots(px: NDArray[np.uint8]) -> Spots:
    blue, green, red = cv2.split(px)
    light = cv2.LUT(cv2.max(cv2.max(blue, green), red), _LINEAR)
    smooth = cv2.GaussianBlur(light, (0, 0), _BLUR_PX)
    over = cv2.subtract(smooth, cv2.blur(light, (_BACKGROUND_PX, _BACKGROUND_PX)))
    rows = smooth[::4, ::4].astype(np.int32)
    noise = float(np.median(np.abs(rows[:, 1:] - rows[:, :-1]))) / (_NORMAL * 2.0**0.5)
    least = max(_LEAST * _FULL, _NOISES * noise, _BRIGHTEST * float(over.max()))
    peak = cv2.dilate(over, _NEIGHBOURS)
    cv2.max(cv2.addWeighted(peak, _OF_PEAK, peak, 0.0, 0.0), least, peak)
    n, labels, stats, _ = cv2.connectedComponentsWithStats(cv2.compare(over, peak, cv2.CMP_GT), connectivity=8)
    if n <= 1:
        return Spots.none()
    width, height, area = (stats[:, at].astype(float) for at in (cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT, cv2.CC_STAT_AREA))
    long, short = np.maximum(width, height), np.minimum(width, height)
    kept = (area <= _LARGEST * light.size) & (long <= _LONGEST * short + 3.0)
    left, top = stats[:, cv2.CC_STAT_LEFT], stats[:, cv2.CC_STAT_TOP]
    right, below = left + width + _EDGE_PX, top + height + _EDGE_PX
    kept &= (left >= _EDGE_PX) & (top >= _EDGE_PX) & (right <= light.shape[1]) & (below <= light.shape[0])
    kept[0] = False
    v, u = np.nonzero(labels)
    of = labels[v, u]
    weight = smooth[v, u].astype(float)
    flux = np.maximum(np.bincount(of, weight, n), 1.0)
    centre = np.stack([np.bincount(of, weight * u, n) / flux, np.bincount(of, weight * v, n) / flux], axis=1)
    spread2 = np.bincount(of, (u - centre[of, 0]) ** 2 + (v - centre[of, 1]) ** 2, n) / 2.0
    radius = np.sqrt(area / np.pi)
    sigma = np.hypot(np.hypot(_CENTRE_PX, _OF_RADIUS * radius), max(noise, 1.0) * np.sqrt(spread2) / flux)
    order = np.flatnonzero(kept)
    order = order[np.argsort(-flux[order], kind="stable")]
    order = order[~_in_halo(centre[order], radius[order])][:_MOST]
    return Spots(centre[order], np.hypot(sigma[order], _crowded(centre[order])), radius[order])


def _crowded(centre: F64) -> F64:
    """Return the standard deviation that the light of its nearest neighbour leaves to each spot's centre, px."""
    away = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    np.fill_diagonal(away, _CROWDED_WITHIN_PX)
    return np.asarray(_CROWDED_PX * np.maximum(0.0, 1.0 - away.min(axis=1, initial=_CROWDED_WITHIN_PX) / _CROWDED_WITHIN_PX))


def _in_halo(centre: F64, radius: F64) -> NDArray[np.bool_]:
    """Return which spots lie in the halo of a much larger one, where its light breaks up."""
    away = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    return np.asarray(np.any((radius[:, None] < _MUCH_SMALLER * radius[None]) & (away < _HALO * radius[None] + 4.0), axis=1))
