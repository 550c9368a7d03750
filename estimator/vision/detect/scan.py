"""Scan the frame once, coarsely, for regions with more of the disc's own colour than their surroundings.

The measure is the logarithm of the disc's dominant channel minus that of the stronger of the other two. A change of brightness,
colour temperature or white balance shifts it by the same amount all over the frame. Limits are therefore relative to the frame's
median, and no absolute colour is trusted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT

U8 = NDArray[np.uint8]

_FLOOR = 0.01
"""Light, as a fraction of full scale, below which there is only noise (12 of 8000 electrons read noise, twice averaged, is a
sixth of it).
"""
_MIDDLE = 80
"""Value of `excess` where the channels are equal."""
_NAT = 255.0 / float(np.log1p(1.0 / _FLOOR))
"""Steps of `excess` for a factor e."""
_CAST = 0.5 * _NAT
"""Largest shift of the measure by the light alone: 3000 K, or a white balance 20 % off in two channels."""
_WEAK, _STRONG = 0.28 * _NAT, 0.9 * _NAT
_LEAST_CONTRAST = 0.4
"""Smallest contrast of the measure, in natural logarithms, between a region and its surroundings: 99 of 100 discs have 0.56 or
more in any light; noise has less.
"""
_MIN_AREA = 9
_KEPT = 6
_SIDE_PX, _BESIDE_PX = 9, 18
"""Side of the four patches that a blob is compared with, and the distance of their centres from it. They are clear of a disc of
13 px radius; a larger disc shows well in the coarse frame.
"""
_MOST_BLOBS = 12
_BLOB_EXCESS = 0.18 * _NAT
_BLOB_AREA = 12
_LONGEST = 2.6
"""Largest ratio of a blob's length to its width: half a disc has 2."""
_CLOSE = np.ones((3, 3), np.uint8)


def _log_light() -> U8:
    return np.rint(np.log1p(LINEAR_LIGHT / _FLOOR) * _NAT).astype(np.uint8)


_LOG = _log_light()


@dataclass(frozen=True, slots=True, eq=False)
class Coarse:
    """The frame at reduced size, with the colour measure."""

    px: U8
    """The reduced frame, (h, w, 3) BGR."""
    step: int
    """Pixels of the frame per pixel of the reduced one."""
    excess: U8
    """The disc's dominant channel over the others, (h, w), logarithmic, `_MIDDLE` where they are equal."""
    usual: float
    """Median of `excess`, limited to the range around `_MIDDLE` that light alone can shift it by."""

    def to_full(self, uv: F64) -> F64:
        """Map (N, 2) px of the reduced frame to px of the full one."""
        return np.asarray((uv + 0.5) * self.step - 0.5)

    def fraction(self) -> float:
        """Return the fraction of the frame above the low limit."""
        return cv2.countNonZero(cv2.threshold(self.excess, self.usual + _WEAK, 255, cv2.THRESH_BINARY)[1]) / self.excess.size


@dataclass(frozen=True, slots=True, eq=False)
class DiscRegion:
    """A connected region in the disc's colour."""

    outline_px: F64
    """Points on the region's outer border, (N, 2) px of the full frame, moved outward by half a reduced pixel; points along the
    frame's edge are left out.
    """
    cut: bool
    """True if the region reaches the frame's edge."""
    weight: float


def coarse(small: U8, step: int, pad: Pad) -> Coarse:
    """Compute the measure on a frame that is `step` times smaller than the camera's."""
    main = 2 - int(np.argmax(pad.markings.colours.disc))
    channels = cv2.split(cv2.LUT(small, _LOG))
    others = cv2.max(channels[(main + 1) % 3], channels[(main + 2) % 3])
    excess = np.asarray(cv2.addWeighted(channels[main], 1.0, others, -1.0, float(_MIDDLE)), np.uint8)
    usual = float(np.median(excess[::4, ::4]))
    return Coarse(small, step, excess, float(np.clip(usual, _MIDDLE - _CAST, _MIDDLE + _CAST)))


def limits(image: Coarse, learned: tuple[float, float] | None = None) -> list[float]:
    """Return limits of the measure, likeliest first: between the two classes of the frame (Otsu), low, and high.

    Args:
        learned: the learned measure on the disc and around it, in natural logarithms; the limit between them comes first.
    """
    low, high = image.usual + _WEAK, image.usual + _STRONG
    otsu, _ = cv2.threshold(image.excess, 0, 255, cv2.THRESH_OTSU)
    out: list[float] = []
    known = [] if learned is None else [_MIDDLE + _NAT * (0.5 * learned[0] + 0.5 * learned[1])]
    for limit in (*known, max(otsu, low), low, high):
        if all(abs(limit - other) > 0.25 * _NAT for other in out):
            out.append(limit)
    return out


def disc_regions(image: Coarse, limit: float) -> list[DiscRegion]:
    """Return the regions above a limit, most prominent first."""
    excess = image.excess
    rows, cols = excess.shape
    mask = cv2.threshold(excess, limit, 255, cv2.THRESH_BINARY)[1]
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    x, y, w, h, area = (stats[1:, i] for i in range(5))
    box = w * h
    cut = (x == 0) | (y == 0) | (x + w == cols) | (y + h == rows)
    longest, shortest = np.maximum(w, h), np.maximum(1, np.minimum(w, h))
    fit = (area >= _MIN_AREA) & (area > 0.15 * box) & ((longest <= 3.2 * shortest) | cut) & (shortest >= 3)
    indices = np.nonzero(fit)[0]
    if len(indices) > 2 * _KEPT:
        # Area is weak evidence from afar; contrast decides among the largest.
        indices = indices[np.argsort(-area[indices], kind="stable")[: 2 * _KEPT]]
    out = []
    for i in indices:
        x0, y0, x1, y1 = max(0, x[i] - 2), max(0, y[i] - 2), min(cols, x[i] + w[i] + 2), min(rows, y[i] + h[i] + 2)
        window, own = excess[y0:y1, x0:x1], cv2.inRange(labels[y0:y1, x0:x1], int(i) + 1, int(i) + 1)
        inside = cv2.mean(window, own)[0]
        outside = cv2.mean(window, cv2.bitwise_not(mask[y0:y1, x0:x1]))[0]
        contrast = (inside - outside) / _NAT
        if contrast < _LEAST_CONTRAST:
            continue
        weight = contrast * min(float(area[i]), 2000.0) ** 0.35
        contours, _ = cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        contour = max(contours, key=len)[:, 0].astype(float)
        if len(contour) < 6:
            continue
        outline = _moved_out(contour) + np.array([x0, y0])
        free = (outline > 0.6).all(axis=1) & (outline[:, 0] < cols - 1.6) & (outline[:, 1] < rows - 1.6)
        out.append(DiscRegion(image.to_full(outline[free]), bool(cut[i]), weight))
    out.sort(key=lambda s: -s.weight)
    return out[:_KEPT]


@dataclass(frozen=True, slots=True, eq=False)
class Blob:
    """A small round connected component."""

    centre_px: F64
    radius_px: float
    contrast: float
    """Contrast of the measure with the surroundings, in natural logarithms."""
    outline_px: F64
    """Points along its outer border, (N, 2) px of the full frame."""


def blobs(image: Coarse) -> list[Blob]:
    """Return small components that stand out from their surroundings, most prominent first, for the frame at full size."""
    excess = image.excess
    # The highest of the four sides counts: the edge of a deck at sea stands out on one side only, a stripe on two.
    side = cv2.copyMakeBorder(
        cv2.blur(excess, (_SIDE_PX, _SIDE_PX)), _BESIDE_PX, _BESIDE_PX, _BESIDE_PX, _BESIDE_PX, cv2.BORDER_REPLICATE
    )
    h, w = excess.shape
    b, e = _BESIDE_PX, 2 * _BESIDE_PX
    around = cv2.max(
        cv2.max(side[b : b + h, :w], side[b : b + h, e : e + w]), cv2.max(side[:h, b : b + w], side[e : e + h, b : b + w])
    )
    # Light smoothing, because from afar the disc is a few pixels and noise is one.
    over = cv2.subtract(cv2.blur(excess, (3, 3)), around)
    # Ring and H, mixed with the disc, split it into slivers; closing joins them again.
    mask = cv2.morphologyEx(cv2.threshold(over, _BLOB_EXCESS, 255, cv2.THRESH_BINARY)[1], cv2.MORPH_CLOSE, _CLOSE)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    w, h, area = stats[1:, 2], stats[1:, 3], stats[1:, 4]
    shortest, longest = np.minimum(w, h), np.maximum(w, h)
    fit = np.nonzero(
        (area >= _BLOB_AREA) & (longest <= _LONGEST * shortest) & (longest < 2 * _BESIDE_PX) & (area > 0.25 * w * h)
    )[0]
    if len(fit) > 40:
        fit = fit[np.argsort(-area[fit], kind="stable")[:40]]
    found = []
    for i in fit:
        x, y = stats[i + 1, 0], stats[i + 1, 1]
        window = np.s_[y : y + h[i], x : x + w[i]]
        own = cv2.inRange(labels[window], int(i) + 1, int(i) + 1)
        contrast = cv2.minMaxLoc(over[window], own)[1] / _NAT
        radius_px = image.step * math.sqrt(float(w[i] * h[i])) / 2
        found.append((-contrast * min(radius_px, 6.0), contrast, radius_px, x, y, own))
    found.sort(key=lambda f: f[0])
    out = []
    for _, contrast, radius_px, x, y, own in found[:_MOST_BLOBS]:
        rows, columns = own.shape
        centre = np.array([[x + (columns - 1) / 2, y + (rows - 1) / 2]])
        contours, _ = cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        contour = max(contours, key=len)[:, 0].astype(float)
        outline = image.to_full((_moved_out(contour) if len(contour) >= 6 else contour) + np.array([x, y]))
        out.append(Blob(image.to_full(centre)[0], radius_px, contrast, outline))
    return out


def _moved_out(contour: F64) -> F64:
    """Move a border from the centres of the outermost pixels to their outer sides: half a pixel along the outward normal."""
    ahead = np.roll(contour, -2, axis=0) - np.roll(contour, 2, axis=0)
    area2 = float(np.sum(contour[:, 0] * np.roll(contour[:, 1], -1) - contour[:, 1] * np.roll(contour[:, 0], -1)))
    normal = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1) * (1.0 if area2 > 0 else -1.0)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(contour + 0.5 * normal / np.maximum(length, 1e-9))
