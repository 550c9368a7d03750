"""The corners method: the right angles of the H, for the range where neither disc nor arrow fits into the frame.

Two inner corners of the cross-bar start it. Their arms identify them: arms that point at each other lie along the bar, so the
pair is on a long side; arms that point away from each other lie along one leg, so the pair is on a short side. The drawing
aligned with the pair predicts all twelve corners, and the corners found there join the fit. The H is symmetric, so the heading is
known up to 180 degrees.
"""

import itertools
import math
from typing import Literal

import cv2
import numpy as np

from estimator.contracts.estimates import Feature
from estimator.contracts.geometry import F64
from estimator.vision.camera.pose import Marks, OrientedCamera, point_modes
from estimator.vision.pad.pad import Pad
from estimator.vision.thesis.cue import Cue
from estimator.vision.thesis.right_angles import RightAngle, candidates, refine
from estimator.vision.thesis.segmentation import F32, U8, Segmentation

Side = Literal["long", "short"]

_MIN_STROKE_PX = 4.5  # Least width of the strokes: of narrower ones the corners run together
_SIGMA_CORNER_PX = 0.06  # Error of a corner that its fit does not show
_SIGMA_CORNER = 0.004  # Error of a corner as a fraction of a stroke's width: a shadow's edge across it
_ALONG = math.cos(math.radians(10.0))
"""Smallest cosine between an arm and the line between its two corners, for any perspective; the diagonal is 18 degrees off the
bar.
"""
_INNER = (2, 3, 8, 9)
_IS_INNER = np.isin(np.arange(12), _INNER)
"""Mask of the inner corners of `Pad.h_corners`: fore port, fore starboard, aft starboard, aft port."""

Similarity = tuple[float, float, float, float]
"""The parameters a, b, x, y of q = [[a, -b], [b, a]] p + [x, y]."""
_Pairs = dict[int, int]  # The index of the corner that was found for each corner of the drawing


def find_corners(seg: Segmentation, view: OrientedCamera, pad: Pad) -> Cue | None:
    """Return the corners of the H; None if fewer than two inner ones show or they do not fit the drawing."""
    whiteness = seg.whiteness
    if whiteness is None:
        return None
    stroke_px = _stroke(seg.h)
    if stroke_px < _MIN_STROKE_PX:
        return None
    around = 2 * max(1, round(0.3 * stroke_px)) + 1
    where = np.asarray(cv2.dilate(seg.h, np.ones((around, around), np.uint8)), np.uint8)
    found = refine(whiteness, candidates(whiteness, where, stroke_px), min(0.75 * stroke_px, 30.0))
    inner = [c for c in found if c.inner]
    if len(inner) < 2:
        return None
    origin = np.array(seg.origin_px, dtype=float)
    uv = np.array([c.uv_px for c in found]) + origin
    plane = view.plane(uv)
    drawing = pad.markings.h_corners()[:, :2]
    best = _best_match(found, plane, drawing, pad)
    if best is None:
        return None
    pairs, misfit = best
    at, places = list(pairs.values()), drawing[list(pairs)]
    fit = _similarity(places, plane[at])
    if fit is None or not _painted(fit, seg, view, pad, whiteness):
        return None
    sigma = np.hypot([found[i].sigma_px for i in at], math.hypot(_SIGMA_CORNER_PX, _SIGMA_CORNER * stroke_px))
    marks = Marks(uv[at], places, point_modes(sigma), yaw_ambiguous=True)
    confidence = (1.0 - math.exp(-0.5 * len(pairs))) * math.exp(-((misfit / 0.15) ** 2)) * (0.5 + 0.5 * seg.plausibility)
    centre = view.pixels(_apply(fit, np.zeros((1, 2))))
    features = (
        Feature("point", "corners", uv[at]),
        Feature("outline", "H", view.pixels(_apply(fit, drawing))),
        Feature("point", "centre", centre),
    )
    return Cue(marks, confidence, features)


def _best_match(found: list[RightAngle], plane: F64, drawing: F64, pad: Pad) -> tuple[_Pairs, float] | None:
    """Return the pairs of most corners, and of those the least misfit, from any two inner corners of one side."""
    best: tuple[_Pairs, float] | None = None
    for a, b in itertools.combinations([i for i, c in enumerate(found) if c.inner], 2):
        side = _side_of(found[a], found[b])
        aligned = None if side is None else _align(a, b, side, found, plane, drawing)
        matched = None if aligned is None else _match(found, plane, drawing, aligned, pad)
        if matched is not None and (best is None or (len(matched[0]), -matched[1]) > (len(best[0]), -best[1])):
            best = matched
            if len(best[0]) in (len(found), len(drawing)):
                break
    return best


def _side_of(a: RightAngle, b: RightAngle) -> Side | None:
    """Return the side of the cross-bar that two inner corners are on; None if they are no such pair (the diagonal, another H)."""
    between = b.uv_px - a.uv_px
    between = between / max(float(np.linalg.norm(between)), 1e-9)
    along_a, along_b = a.arms @ between, b.arms @ between
    if min(along_a.max(), -along_b.min()) > _ALONG:
        return "long"
    return "short" if min(-along_a.min(), along_b.max()) > _ALONG else None


def _align(a: int, b: int, side: Side, found: list[RightAngle], plane: F64, drawing: F64) -> Similarity | None:
    """Align the drawing with two inner corners; of the two orientations take the one with the paint on the right side.

    Clockwise around the drawing, fore port to fore starboard is the fore long side, and fore starboard to aft starboard is the
    starboard short side. The arm that is not along the pair points forward from the fore side, and inward from the short one.
    """
    between = found[b].uv_px - found[a].uv_px
    across = [arm for arm in found[a].arms if abs(float(arm @ between)) < 0.7 * float(np.linalg.norm(between))]
    if len(across) != 1:
        return None
    # The camera sees the deck from above: the level axes forward, right are rotated against u, v but never mirrored.
    turn = float(between[0] * across[0][1] - between[1] * across[0][0])
    if side == "long":
        # From fore port to fore starboard (+y) the legs' arms point along +x: from +y to +x is anticlockwise.
        first, second = (_INNER[0], _INNER[1]) if turn < 0 else (_INNER[1], _INNER[0])
    else:
        # From fore starboard to aft starboard (-x) the bar's arms point along -y: from -x to -y is clockwise.
        first, second = (_INNER[1], _INNER[2]) if turn > 0 else (_INNER[2], _INNER[1])
    return _similarity(drawing[[first, second]], plane[[a, b]])


def _match(found: list[RightAngle], plane: F64, drawing: F64, similarity: Similarity, pad: Pad) -> tuple[_Pairs, float] | None:
    """Match corners with the drawing's corners of the same kind; return the pairs and the rms distance in widths of a leg.

    Return None if there are fewer than two inner corners among them.
    """
    other_kind = np.array([c.inner for c in found])[:, None] != _IS_INNER[None, :]
    pairs: _Pairs = {}
    for limit in (0.4, 0.2):
        unit = math.hypot(similarity[0], similarity[1]) * pad.markings.leg_width_m
        distance = np.linalg.norm(plane[:, None, :] - _apply(similarity, drawing)[None, :, :], axis=2) / unit
        distance[other_kind] = np.inf
        nearest, d = np.argmin(distance, axis=1), np.min(distance, axis=1)
        pairs = {}
        for i in np.argsort(d):
            if d[i] < limit:
                pairs.setdefault(int(nearest[i]), int(i))
        refit = _similarity(drawing[list(pairs)], plane[list(pairs.values())]) if len(pairs) >= 2 else None
        if refit is None:
            return None
        similarity = refit
    if sum(k in _INNER for k in pairs) < 2:
        return None
    off = plane[list(pairs.values())] - _apply(similarity, drawing[list(pairs)])
    unit = math.hypot(similarity[0], similarity[1]) * pad.markings.leg_width_m
    return pairs, float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) / unit


def _painted(similarity: Similarity, seg: Segmentation, view: OrientedCamera, pad: Pad, whiteness: F32) -> bool:
    """Return whether the frame is white on the aligned drawing and not white beside it, at the points inside the frame."""
    marks = pad.markings
    leg_y = 0.5 * (marks.h_width_m - marks.leg_width_m)
    end, notch = 0.4 * marks.h_length_m, 0.25 * marks.h_length_m
    beside, beyond = 0.5 * marks.h_width_m + 0.7 * marks.leg_width_m, 2 * notch + marks.leg_width_m
    white = [(0.0, 0.0), *((x, y) for x in (0.0, end, -end) for y in (leg_y, -leg_y))]
    ground = [(notch, 0.0), (-notch, 0.0), (0.0, beside), (0.0, -beside), (beyond, leg_y), (-beyond, -leg_y)]
    uv = view.pixels(_apply(similarity, np.array(white + ground))) - np.array(seg.origin_px)
    h, w = whiteness.shape
    expected = np.arange(len(uv)) < len(white)
    ok = np.all(np.isfinite(uv), axis=1)
    cell = np.rint(np.where(ok[:, None], uv, -1.0)).astype(int)
    ok &= (cell[:, 0] >= 0) & (cell[:, 1] >= 0) & (cell[:, 0] < w) & (cell[:, 1] < h)
    if ok.sum() < 3:
        return False
    seen = whiteness[cell[ok, 1], cell[ok, 0]] > 0.5
    return bool(np.mean(seen == expected[ok]) > 0.85)


def _stroke(h: U8) -> float:
    """Return the width of the strokes of a white shape, px: twice its area over its perimeter."""
    contours, _ = cv2.findContours(h, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not contours:
        return 0.0
    largest = max(contours, key=cv2.contourArea)
    length = cv2.arcLength(largest, True)
    # Contours run through pixel centres, half a pixel inside the paint's edge on either side.
    return 2.0 * cv2.contourArea(largest) / length + 1.0 if length > 0 else 0.0


def _similarity(p: F64, q: F64) -> Similarity | None:
    """Fit shift, rotation and scale from p to q, (N, 2) each, by least squares."""
    pc, qc = p.mean(axis=0), q.mean(axis=0)
    dp, dq = p - pc, q - qc
    spread = float(np.sum(dp * dp))
    if spread <= 0.0 or not np.all(np.isfinite(q)):
        return None
    a = float(np.sum(dp * dq)) / spread
    b = float(np.sum(dp[:, 0] * dq[:, 1] - dp[:, 1] * dq[:, 0])) / spread
    return a, b, float(qc[0] - a * pc[0] + b * pc[1]), float(qc[1] - b * pc[0] - a * pc[1])


def _apply(similarity: Similarity, p: F64) -> F64:
    a, b, x, y = similarity
    return np.stack([a * p[:, 0] - b * p[:, 1] + x, b * p[:, 0] + a * p[:, 1] + y], axis=1)
