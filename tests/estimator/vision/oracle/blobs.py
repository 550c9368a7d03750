"""The outlines of areas that stand out from their surroundings, in numpy and OpenCV: the oracle of the core's `search_blobs`."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64

U8 = NDArray[np.uint8]
HALVES = (4, 6, 10)


def scores(half_size: U8, noise: float, channels: int) -> tuple[F64, NDArray[np.int64]]:
    """Return, for the corner before each second pixel, the best score of a box about it and the number of its size.

    The score is the mean square of a box's difference from the mean of what is around it, over the variance there.
    """
    px = half_size[:, :, :channels].astype(float)
    h, w = px.shape[0] // 2, px.shape[1] // 2
    best, size = np.zeros((h, w)), np.zeros((h, w), np.int64)
    for k, half in enumerate(HALVES):
        wide = 2 * half + 2
        for i in range(h):
            for j in range(w):
                y, x = 2 * i, 2 * j
                about = np.zeros(px.shape[:2], bool)
                about[max(0, y - wide) : y + wide, max(0, x - wide) : x + wide] = True
                about[max(0, y - half) : y + half, max(0, x - half) : x + half] = False
                around = px[about]
                within = px[max(0, y - half) : y + half, max(0, x - half) : x + half].reshape(-1, channels)
                differs = ((within - around.mean(axis=0)) ** 2).sum(axis=1).mean()
                score = differs / (around.var(axis=0).sum() + channels * (16.0 + noise**2))
                if score > best[i, j]:
                    best[i, j], size[i, j] = score, k
    return best, size


def ellipse(px: U8, at: tuple[int, int], half: int, times: int, channels: int) -> tuple[F64, F64] | None:
    """Return centre (2,) and M (2, 2), px, of the area about a place that differs from what is around it; None if it is open.

    Args:
        px: the frame, or the image at half size.
        at: the corner of pixels in the middle of the box, and half of the box's side.
        times: how often pixels are smoothed.
    """
    reach, kernel = 2 * half + 2, np.array([0.25, 0.5, 0.25])
    soft = px[:, :, :channels].astype(float).reshape(*px.shape[:2], channels)
    left, top = max(0, at[0] - reach), max(0, at[1] - reach)
    for _ in range(times):
        soft = cv2.sepFilter2D(soft, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE).reshape(soft.shape)
    part = soft[top : at[1] + reach, left : at[0] + reach]
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    dx, dy = x + left - at[0], y + top - at[1]
    box = (dx < half) & (dx >= -half) & (dy < half) & (dy >= -half)
    middle = np.median(part[~box], axis=0)
    spread = 1.4826 * np.median(np.abs(part[~box] - middle), axis=0) + 2.0
    off = np.sqrt((((part - middle) / spread) ** 2).mean(axis=2))
    for share in (0.35, 0.6):
        least = max(2.0, share * float(np.quantile(off[box], 0.9)))
        chosen = _component(off, box, least)
        if chosen is not None:
            chosen = _component(off, box, max(least, 0.5 * float(off[chosen].mean())))
        if chosen is None:
            continue
        contours, _ = cv2.findContours(chosen.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        area = cv2.drawContours(np.zeros(off.shape, np.uint8), contours, -1, 1, cv2.FILLED) > 0
        xy = np.stack([x[area], y[area]], axis=1).astype(float)
        M = 4.0 * np.cov(xy.T, bias=True)
        if area.sum() >= 12 and area.sum() / (np.pi * np.sqrt(max(np.linalg.det(M), 1e-9))) >= 0.8:
            return xy.mean(axis=0) + np.array([left, top]), M
    return None


def _component(off: F64, box: NDArray[np.bool_], least: float) -> NDArray[np.bool_] | None:
    """Return the component with most pixels in the box; None if it reaches the border."""
    n, label = cv2.connectedComponents((off > least).astype(np.uint8), connectivity=8)
    counts = np.bincount(label[box], minlength=n)
    counts[0] = 0
    if counts.max() == 0:
        return None
    chosen = np.asarray(label == int(counts.argmax()))
    edge = np.ones(off.shape, bool)
    edge[1:-1, 1:-1] = False
    return None if (chosen & edge).any() else chosen
