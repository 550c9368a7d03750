"""The arrow method: the centre of the white H and the tip of the orange arrowhead give position and heading."""

import math

import cv2
import numpy as np

from estimator.contracts.estimates import Feature
from estimator.contracts.geometry import F64
from estimator.vision.camera.pose import Marks, OrientedCamera, point_modes
from estimator.vision.pad.pad import Pad
from estimator.vision.thesis.cue import Cue
from estimator.vision.thesis.right_angles import RightAngle, refine
from estimator.vision.thesis.segmentation import F32, U8, Segmentation

_SIGMA_CENTROID_PX = 0.03  # Error of the centroid that more pixels do not lessen
_SIGMA_CENTROID = 0.0015
"""Error of the centroid from worn paint and edges of shadows, as a fraction of the H's length; it does not fall with more
pixels.
"""
_SIGMA_TIP_PX = 0.06
"""Remaining error of the tip. Blur moves a corner along its bisector; the fit of the arms avoids the blurred part except for
this.
"""
_TIP_CANDIDATES = 6  # Orange pixels that are tried for the tip
_MIN_REACH_PX = 3.2  # Arms shorter than this are only blur: the tip comes out up to 2 % of the arrow's length too far
_SECTORS = 24  # Directions about the centre of which each gives one
_MIN_PAINT = 0.25  # Smallest coverage that counts as orange, as a fraction of the brightest orange: in deep shadow
_MAX_REACH_PX = 24.0  # Longest arms that a tip is fitted to


def find_arrow(seg: Segmentation, view: OrientedCamera, pad: Pad) -> Cue | None:
    """Return the arrow; None if the H leaves the frame, there is no tip, or the two do not fit one another."""
    orangeness = seg.orangeness()
    if seg.h_touches_border or seg.whiteness is None or orangeness is None:
        return None
    centre = _centroid(seg, seg.whiteness, view)
    if centre is None:
        return None
    origin = np.array(seg.origin_px, dtype=float)
    centre_px, area_plane, perimeter_px = centre
    marks = pad.markings
    scale = math.sqrt(area_plane / (2.0 * marks.h_length_m * marks.leg_width_m + marks.bar_length_m * marks.bar_width_m))
    centre_plane = view.plane(centre_px[None, :])[0]
    px_per_m = _local_px(view, centre_plane) * scale
    # Between the arms of the arrowhead there is nothing else within three quarters of their length.
    reach_px = 0.75 * math.hypot(marks.arrow_depth_m, marks.arrow_half_base_m) * px_per_m
    if reach_px < _MIN_REACH_PX:
        return None
    starts = _farthest(seg.orange, centre_px - origin, pad, px_per_m)
    if len(starts) == 0:
        return None
    paint = _paint_behind(starts, centre_px - origin - starts, orangeness, pad, px_per_m)
    starts, paint = starts[paint > _MIN_PAINT], paint[paint > _MIN_PAINT]
    reach_px = min(reach_px, _MAX_REACH_PX)
    tips = [t for t in refine(orangeness, starts, reach_px, paint) if not t.inner]
    misfits = [_misfit(tip, origin, centre_plane, view, pad, scale) for tip in tips]
    misfit = min(misfits, default=math.inf)
    if misfit == math.inf:
        return None
    rough = tips[misfits.index(misfit)]
    # Refine once more with the tip's own paint: the ring, thin from afar, is paler, and a shadow may lie on the tip.
    inwards = rough.arms.sum(axis=0)[None, :]
    paint = _paint_behind(rough.uv_px[None, :], inwards, orangeness, pad, px_per_m)
    again = refine(orangeness, rough.uv_px[None, :], reach_px, paint, settled=True) if paint[0] > _MIN_PAINT else []
    if len(again) != 1 or again[0].inner:
        return None
    exact = again[0]
    tip_uv = exact.uv_px + origin
    uv = np.stack([centre_px, tip_uv])
    n_edge = max(4.0, perimeter_px / 4.0)
    sigma = [
        math.hypot(0.25 / math.sqrt(n_edge), _SIGMA_CENTROID_PX, _SIGMA_CENTROID * marks.h_length_m * px_per_m),
        math.hypot(exact.sigma_px, _SIGMA_TIP_PX),
    ]
    confidence = math.exp(-0.5 * misfit) * (0.5 + 0.5 * seg.plausibility)
    features = (
        Feature("line", "arrow", uv),
        Feature("point", "tip", tip_uv[None, :]),
        Feature("point", "centre", centre_px[None, :]),
    )
    places = np.array([[0.0, 0.0], [marks.arrow_tip_m, 0.0]])
    return Cue(Marks(uv, places, point_modes(np.array(sigma))), confidence, features)


def _centroid(seg: Segmentation, whiteness: F32, view: OrientedCamera) -> tuple[F64, float, float] | None:
    """Return the image of the H's centre, (2,) px, its area in the level plane, and its perimeter, px.

    The centroid is that of the paint in the level plane; in the frame itself the nearer half would count more.
    """
    near = cv2.dilate(seg.h, np.ones((3, 3), np.uint8), iterations=2)
    u0, v0, w, h = cv2.boundingRect(near)
    box = np.s_[v0 : v0 + h, u0 : u0 + w]
    # The weight is steeper than the coverage, so that uneven paint inside counts alike and only the edge keeps its fractions.
    weight = np.where(near[box] > 0, np.clip(2.0 * whiteness[box] - 0.5, 0.0, 1.0), np.float32(0.0))
    m = cv2.moments(weight)
    if m["m00"] < 6.0:
        return None
    uv = np.array([m["m10"] / m["m00"] + u0 + seg.origin_px[0], m["m01"] / m["m00"] + v0 + seg.origin_px[1]])
    C = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
    # Map the moments to the level plane by a second-order expansion of the map about the centroid.
    step = 0.5 * math.sqrt(max(float(np.trace(C)), 4.0))
    grid = np.array([(i, j) for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
    q = view.plane(uv + step * grid).reshape(3, 3, 2)
    if not np.all(np.isfinite(q)):
        return None
    du, dv = (q[2, 1] - q[0, 1]) / (2 * step), (q[1, 2] - q[1, 0]) / (2 * step)
    duu, dvv = (q[2, 1] - 2 * q[1, 1] + q[0, 1]) / step**2, (q[1, 2] - 2 * q[1, 1] + q[1, 0]) / step**2
    duv = (q[2, 2] - q[2, 0] - q[0, 2] + q[0, 0]) / (4 * step**2)
    J = np.stack([du, dv], axis=1)
    det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    grow_u = (duu[0] * dv[1] + du[0] * duv[1] - duv[0] * du[1] - dv[0] * duu[1]) / det
    grow_v = (duv[0] * dv[1] + du[0] * dvv[1] - dvv[0] * du[1] - dv[0] * duv[1]) / det
    bend = 0.5 * (C[0, 0] * duu + 2.0 * C[0, 1] * duv + C[1, 1] * dvv)
    centre = q[1, 1] + bend + J @ C @ np.array([grow_u, grow_v])
    uv_centre = view.pixels(centre[None, :])[0]
    contours, _ = cv2.findContours(seg.h, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    perimeter = sum(cv2.arcLength(c, True) for c in contours)
    return uv_centre, float(m["m00"] * abs(det)), perimeter


def _farthest(orange: U8, centre: F64, pad: Pad, px_per_m: float) -> F64:
    """Return (N, 2) orange pixels that extend farthest from the ring, one for each direction; the tip is among them."""
    if not orange.any():
        return np.zeros((0, 2))
    d = cv2.findNonZero(orange)[:, 0, :] - centre
    r = np.sqrt(d[:, 0] ** 2 + d[:, 1] ** 2)
    # The area of the H gives the scale to a few percent; the tip extends beyond the ring by 15 %.
    near = (r > 1.03 * pad.markings.ring_outer_m * px_per_m) & (r < 1.25 * pad.markings.arrow_tip_m * px_per_m)
    d, r = d[near], r[near]
    if len(r) == 0:
        return np.zeros((0, 2))
    order = np.argsort(-r)
    sector = np.floor(np.arctan2(d[order, 1], d[order, 0]) * (_SECTORS / math.tau)).astype(int)
    _, first = np.unique(sector, return_index=True)
    return np.asarray(d[order][np.sort(first)[:_TIP_CANDIDATES]] + centre)


def _paint_behind(tips: F64, inwards: F64, orangeness: F32, pad: Pad, px_per_m: float) -> F64:
    """Return (N,) coverage by orange in the middle of the arrowheads with these tips, (N, 2), and directions."""
    incentre_m = math.sqrt(2.0) * (pad.markings.arrow_depth_m + pad.markings.arrow_half_base_m) * 0.5 * (math.sqrt(2.0) - 1.0)
    at = tips + inwards / np.linalg.norm(inwards, axis=1, keepdims=True) * incentre_m * px_per_m
    spread = 0.25 * incentre_m * px_per_m
    grid = at[:, None, :] + spread * np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    u, v = grid[:, :, 0].astype(np.float32), grid[:, :, 1].astype(np.float32)
    return np.asarray(np.median(cv2.remap(orangeness, u, v, cv2.INTER_LINEAR), axis=1), float)


def _misfit(tip: RightAngle, origin: F64, centre_plane: F64, view: OrientedCamera, pad: Pad, scale: float) -> float:
    """Return the misfit of tip and H: length against the H's area, bisector against the centre, arms' angle against 90 degrees.

    It is infinite if any of them is out of range. The H's long axis is of no use: its moments are equal along and across.
    """
    uv = tip.uv_px + origin
    q = view.plane(np.stack([uv, uv + 2.0 * tip.arms[0], uv + 2.0 * tip.arms[1]]))
    if not np.all(np.isfinite(q)):
        return math.inf
    v = q[0] - centre_plane
    length = float(np.linalg.norm(v))
    off_length = math.log(length / (pad.markings.arrow_tip_m * scale)) / 0.12
    arms = (q[1:] - q[0]) / np.linalg.norm(q[1:] - q[0], axis=1, keepdims=True)
    inward = -(arms[0] + arms[1])
    off_bisector = math.acos(float(np.clip(inward @ v / (np.linalg.norm(inward) * length), -1.0, 1.0))) / math.radians(10.0)
    off_right = abs(math.acos(float(np.clip(arms[0] @ arms[1], -1.0, 1.0))) - math.pi / 2) / math.radians(10.0)
    parts = np.array([off_length, off_bisector, off_right])
    return float(np.mean(parts**2)) if np.all(np.abs(parts) <= 3.0) else math.inf


def _local_px(view: OrientedCamera, plane: F64) -> float:
    """Return the number of pixels per unit of the level plane at this position."""
    h = 1e-3
    uv = view.pixels(plane + h * np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]))
    a, b = (uv[0] - uv[1]) / (2 * h), (uv[2] - uv[3]) / (2 * h)
    return math.sqrt(abs(float(a[0] * b[1] - a[1] * b[0])))
