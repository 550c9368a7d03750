"""The green blob of a frame that is most like the disc, by its shape and by the paints on it."""

from __future__ import annotations

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.vision.detect.pyramid import U8

_MIN_BLOB_PX = 25.0  # Smallest disc that is considered: a radius of about 3 px, as the sim camera sees the pad from 48 m
_CLOSE = np.ones((5, 5), np.uint8)
_SEEDS = 0.02  # Fraction of a blob that must lie within the strict green limits; around such seeds the paler range counts too
_BLOBS = 6  # Blobs that are looked at


class Masks(Struct, frozen=True, eq=False):
    """Masks (H, W) of 0 and 255 for each paint."""

    green: U8
    orange: U8
    white: U8


class DiscBlob(Struct, frozen=True, eq=False):
    """A possible disc, or the visible part of it."""

    hull: NDArray[np.int32]
    """Convex hull, (N, 1, 2) px."""
    touches_border: bool
    plausibility: float
    """Plausibility, 0..1: painted fraction of the hull, its similarity to an ellipse, and the fractions of white and orange on
    it.
    """
    score: float
    """Score for comparing the blobs of one frame: plausibility squared times the root of the area."""


def choose_blob(masks: Masks, sure: U8, widest_px: int | None = None) -> DiscBlob | None:
    """Return the blob most like the disc, or None.

    Args:
        masks: masks of the whole frame.
        sure: mask of certain green; a blob needs some.
        widest_px: leave out blobs wider than this and those at the frame's edge.
    """
    height, width = sure.shape
    # Where ring and disc meet, pixels mix to a hue in neither range. Closing bridges that line, so that the blob is one.
    painted = cv2.morphologyEx(cv2.bitwise_or(masks.green, masks.orange), cv2.MORPH_CLOSE, _CLOSE)
    contours, _ = cv2.findContours(painted, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    big = sorted(((cv2.contourArea(c), i) for i, c in enumerate(contours) if len(c) >= 12), reverse=True)[:_BLOBS]
    best: DiscBlob | None = None
    edge_pieces: list[NDArray[np.int32]] = []
    for area, i in big:
        if area < _MIN_BLOB_PX:
            break
        contour = np.asarray(contours[i], np.int32)
        touches = _touches(contour, width, height)
        if touches and area > 0.01 * width * height:
            edge_pieces.append(contour)
        hull = np.asarray(cv2.convexHull(contour), np.int32)
        u0, v0, w, h = cv2.boundingRect(hull)
        if cv2.countNonZero(sure[v0 : v0 + h, u0 : u0 + w]) < max(3.0, _SEEDS * area):
            continue
        if widest_px is not None and (touches or max(w, h) > widest_px):
            continue
        plausibility = _plausibility(hull, touches, masks)
        # Square and root prevent a large meadow from beating a small disc that carries ring and H.
        score = plausibility**2 * float(np.sqrt(area))
        if best is None or score > best.score:
            best = DiscBlob(hull, touches, plausibility, score)
    if best is None or len(edge_pieces) < 2:
        return best
    return _joined(best, edge_pieces, masks)


def _joined(best: DiscBlob, pieces: list[NDArray[np.int32]], masks: Masks) -> DiscBlob:
    """Return a disc that ring and H cut into pieces which each reach the frame's edge; the best piece if they are none."""
    hull = np.asarray(cv2.convexHull(np.concatenate(pieces)), np.int32)
    plausibility = _plausibility(hull, True, masks)
    if not best.touches_border or plausibility < 0.8 * best.plausibility:
        return best
    return DiscBlob(hull, True, max(best.plausibility, plausibility), best.score)


def _plausibility(hull: NDArray[np.int32], touches: bool, masks: Masks) -> float:
    """Return 0..1: painted fraction of the hull, its similarity to an ellipse, and the fractions of white and orange on it."""
    u0, v0, w, h = cv2.boundingRect(hull)
    inside = np.zeros((h, w), np.uint8)
    cv2.fillConvexPoly(inside, hull - (u0, v0), 255)
    crop = np.s_[v0 : v0 + h, u0 : u0 + w]
    n = max(1, cv2.countNonZero(inside))
    green, orange, white = (
        cv2.countNonZero(cv2.bitwise_and(m[crop], inside)) / n for m in (masks.green, masks.orange, masks.white)
    )
    shape = 1.0
    if not touches:
        m = cv2.moments(hull)
        det = (m["mu20"] * m["mu02"] - m["mu11"] ** 2) / max(m["m00"], 1e-9) ** 2
        # An ellipse has area 4 pi sqrt(det of its second moments); every other shape has less.
        likeness = m["m00"] / (4.0 * np.pi * np.sqrt(max(det, 1e-9)))
        shape = float(np.clip((likeness - 0.80) / 0.18, 0.0, 1.0))
    markings = 0.5 * (0.005 < white < (0.7 if touches else 0.25)) + 0.5 * (0.005 < orange < 0.25)
    return min(1.0, green + orange + white) * shape * (0.3 + 0.7 * markings) * (1.0 if green > 0.2 else 0.2)


def _touches(contour: NDArray[np.int32], width: int, height: int) -> bool:
    low, high = contour.min(axis=(0, 1)), contour.max(axis=(0, 1))
    return bool(low[0] <= 0 or low[1] <= 0 or high[0] >= width - 1 or high[1] >= height - 1)
