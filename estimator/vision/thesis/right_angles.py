"""Find right-angled corners at sub-pixel precision, with the directions of their arms.

Around a corner a small circle crosses between paint and ground twice, with the crossings a right angle apart. With a quarter of
the circle on paint the corner is a tip; with three quarters it is an inner corner. The crossings on circles of several radii lie
on the two arms; lines fitted to them meet in the corner. This needs no neighbourhood averages, which depend on the range, and no
rounding or drawing into the frame that is measured.

The arrow method: the centre of the white H and the tip of the orange arrowhead give position and heading.

The corners method: the right angles of the H, for the range where neither disc nor arrow fits into the frame.

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
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.estimates import Feature
from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad
from estimator.vision.pose import Marks, OrientedCamera, point_modes
from estimator.vision.thesis.segmentation import F32, U8, Segmentation

_RADII = 7
_MIN_RADIUS_PX = 1.6
"""Smallest radius of a circle, px; closer in, blur rounds the corner."""


class RightAngle(Struct, frozen=True, eq=False):
    """A corner, in the coordinates of the channel it was found in."""

    uv_px: F64
    """Position, (2,) px."""
    arms: F64
    """Unit vectors from the corner along its edges, (2, 2). The second follows the first by about 90 degrees; between them lies
    the smaller side: paint for a tip, ground for an inner corner.
    """
    inner: bool
    """True if three quarters of its surroundings are paint."""
    sigma_px: float
    """One standard deviation of `uv_px` in each axis."""


def candidates(coverage: F32, where: U8, stroke_px: float) -> F64:
    """Return (N, 2) px of the peaks of the Harris response, good to a few pixels, strongest first; N <= 40.

    Args:
        coverage: (h, w) coverage by paint.
        where: (h, w) mask of the search area.
        stroke_px: width of the strokes that form the corners; the search runs at a scale where it is about 8 px.
    """
    k = max(1, int(stroke_px / 8.0))
    h, w = coverage.shape
    grey = np.clip(coverage * 255.0, 0.0, 255.0).astype(np.uint8)
    if k > 1:
        grey = np.asarray(cv2.resize(grey, (max(8, w // k), max(8, h // k)), interpolation=cv2.INTER_AREA), np.uint8)
    fu, fv = w / grey.shape[1], h / grey.shape[0]
    smooth = cv2.GaussianBlur(grey, (5, 5), 1.0)
    response = cv2.cornerHarris(smooth, 3, 3, 0.04, borderType=cv2.BORDER_REPLICATE)
    reach = 2 * max(1, round(0.3 * stroke_px / k)) + 1
    peak = (response == cv2.dilate(response, np.ones((reach, reach), np.uint8))) & (response > 0.02 * response.max(initial=0.0))
    small = cv2.resize(where, (grey.shape[1], grey.shape[0]), interpolation=cv2.INTER_NEAREST)
    peak &= small > 0
    v, u = np.nonzero(peak)
    order = np.argsort(-response[v, u])[:40]
    return np.stack([(u[order] + 0.5) * fu - 0.5, (v[order] + 0.5) * fv - 0.5], axis=1)


def refine(coverage: F32, uv_px: F64, reach_px: float, paint: F64 | None = None, settled: bool = False) -> list[RightAngle]:
    """Return the right-angled corners among the candidates, each once.

    Args:
        coverage: (h, w) coverage by paint: 0 is ground, 1 is paint.
        uv_px: (N, 2) candidates, off by up to half of `reach_px`.
        reach_px: radius within which only a corner's two arms show.
        settled: the candidates are corners already, off by a fraction of a pixel.
        paint: (N,) coverage that counts as full at each candidate, 1 by default; the edge is at half of it.
    """
    if len(uv_px) == 0 or reach_px < _MIN_RADIUS_PX + 0.8:
        return []
    at = np.asarray(uv_px, dtype=float)
    level = 0.5 * (np.ones(len(at)) if paint is None else paint)
    radii = np.linspace(max(_MIN_RADIUS_PX, 0.3 * reach_px), reach_px, _RADII)
    if not settled:
        # From an inexact start, only the outer circles certainly enclose the corner.
        uv, _, _, _, ok = _fit(coverage, at, np.linspace(0.5 * reach_px, reach_px, 4), level)
        at, level = uv[ok], level[ok]
        if len(at) == 0:
            return []
    uv, arms, inner, sigma, ok = _fit(coverage, at, radii, level)
    out: list[RightAngle] = []
    fitted = np.flatnonzero(ok)
    for i in fitted[np.argsort(sigma[fitted])]:
        if all(math.dist(uv[i], corner.uv_px) > 0.5 * reach_px for corner in out):
            out.append(RightAngle(uv[i], arms[i], bool(inner[i]), float(sigma[i])))
    return out


def _fit(coverage: F32, at: F64, radii: F64, level: F64) -> tuple[F64, F64, NDArray[np.bool_], F64, NDArray[np.bool_]]:
    """Fit a line to each arm from the two crossings of circles about (N, 2) points, and return the lines' intersections.

    They are the four fields of `RightAngle`, with N rows each, and a mask of those that are right angles.
    """
    n, m = len(at), len(radii)
    # Steps are 0.7 px at most; otherwise an edge fits between two samples and its crossing is off.
    count_a = int(np.clip(math.ceil(math.tau * radii[-1] / 0.7), 48, 256))
    angle = np.arange(count_a) * (math.tau / count_a)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pts = at[:, None, None, :] + radii[None, :, None, None] * ring[None, None, :, :]
    flat = pts.reshape(n * m, count_a, 2).astype(np.float32)
    value = cv2.remap(
        coverage, flat[:, :, 0], flat[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-100.0
    )
    v = np.asarray(value, float).reshape(n, m, count_a)
    inside = v.min(axis=2) > -10.0
    half = level[:, None]
    bright = v >= half[:, :, None]
    after = np.roll(v, -1, axis=2)
    rising = ~bright & np.roll(bright, -1, axis=2)
    falling = bright & ~np.roll(bright, -1, axis=2)
    clean = inside & (rising.sum(axis=2) == 1) & (falling.sum(axis=2) == 1)

    def crossing(edge: NDArray[np.bool_]) -> F64:
        k = np.argmax(edge, axis=2)
        a, b = np.take_along_axis(v, k[:, :, None], 2)[:, :, 0], np.take_along_axis(after, k[:, :, None], 2)[:, :, 0]
        part = (half - a) / np.where(np.abs(b - a) > 1e-6, b - a, 1.0)
        return np.asarray((k + np.clip(part, 0.0, 1.0)) * (math.tau / count_a))

    def arm(angle: F64) -> tuple[F64, F64, F64]:
        return _lines(at[:, None, :] + radii[None, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2), good, at)

    rise, fall = crossing(rising), crossing(falling)
    paint = np.mod(fall - rise, math.tau) / math.tau
    good = clean & (np.abs(np.abs(paint - 0.5) - 0.25) < 0.16)
    count = good.sum(axis=1)
    paint_fraction = np.sum(np.where(good, paint, 0.0), axis=1) / np.maximum(count, 1)
    inner = paint_fraction > 0.5
    (c1, d1, e1), (c2, d2, e2) = arm(rise), arm(fall)
    cross = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    gap = c2 - c1
    safe = np.where(np.abs(cross) > 0.3, cross, 1.0)
    t = (gap[:, 0] * d2[:, 1] - gap[:, 1] * d2[:, 0]) / safe
    uv = c1 + t[:, None] * d1
    # In frame axes (v down) angles grow clockwise; the smaller side lies clockwise of a tip's rise, of an inner corner's fall.
    arms = np.where(inner[:, None, None], np.stack([d2, d1], axis=1), np.stack([d1, d2], axis=1))
    rms = np.sqrt(0.5 * (e1**2 + e2**2))
    # Extrapolating a line of m points at radii r to radius 0 multiplies their error by sqrt(1/m + mean^2/sum of squares).
    lever = math.sqrt(1.0 / m + float(np.mean(radii) ** 2 / np.sum((radii - np.mean(radii)) ** 2)))
    sigma = np.maximum(rms, 0.03) * lever
    shifted = np.linalg.norm(uv - at, axis=1)
    ok = (count >= m - m // 3) & (np.abs(cross) > 0.75) & (rms < 0.06 * radii[-1] + 0.2) & (shifted < 0.8 * radii[-1])
    return uv, arms, inner, sigma, ok


def _lines(pts: F64, good: NDArray[np.bool_], origin: F64) -> tuple[F64, F64, F64]:
    """Fit total-least-squares lines to those of (N, M, 2) points that are good.

    Return a point (N, 2), a direction away from `origin` (N, 2), and the rms (N,).
    """
    weight = good.astype(float)
    total = np.maximum(weight.sum(axis=1), 1e-9)
    centre = np.einsum("nm,nmi->ni", weight, pts) / total[:, None]
    d = pts - centre[:, None, :]
    sxx = np.einsum("nm,nm->n", weight, d[:, :, 0] ** 2) / total
    syy = np.einsum("nm,nm->n", weight, d[:, :, 1] ** 2) / total
    sxy = np.einsum("nm,nm->n", weight, d[:, :, 0] * d[:, :, 1]) / total
    angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    away = np.sum(direction * (centre - origin), axis=1)
    direction *= np.where(away < 0.0, -1.0, 1.0)[:, None]
    across = 0.5 * (sxx + syy) - np.hypot(0.5 * (sxx - syy), sxy)
    return centre, direction, np.sqrt(np.maximum(across, 0.0))


_SIGMA_CENTROID_PX = 0.03
_SIGMA_CENTROID = 0.0015
"""Error of the centroid from worn paint and edges of shadows, as a fraction of the H's length; it does not fall with more
pixels.
"""
_SIGMA_TIP_PX = 0.06
"""Remaining error of the tip. Blur moves a corner along its bisector; the fit of the arms avoids the blurred part except for
this.
"""
_TIP_CANDIDATES = 6
_MIN_REACH_PX = 3.2
"""Arms shorter than this are only blur: the tip comes out up to 2 % of the arrow's length too far."""
_SECTORS = 24
_MIN_PAINT = 0.25
"""Smallest coverage that counts as orange, as a fraction of the brightest orange: in deep shadow."""
_MAX_REACH_PX = 24.0


Side = Literal["long", "short"]


class Cue(Struct, frozen=True, eq=False):
    """The result of one method."""

    marks: Marks
    confidence: float
    features: tuple[Feature, ...]


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


_MIN_STROKE_PX = 4.5
_SIGMA_CORNER_PX = 0.06
_SIGMA_CORNER = 0.004
"""Error of a corner as a fraction of a stroke's width: a shadow's edge across it."""
_ALONG = math.cos(math.radians(10.0))
"""Smallest cosine between an arm and the line between its two corners, for any perspective; the diagonal is 18 degrees off the
bar.
"""
_INNER = (2, 3, 8, 9)
_IS_INNER = np.isin(np.arange(12), _INNER)
"""Mask of the inner corners of `Pad.h_corners`: fore port, fore starboard, aft starboard, aft port."""


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
    best: tuple[int, float, _Pairs] | None = None
    for a, b in itertools.combinations([i for i, c in enumerate(found) if c.inner], 2):
        side = _side_of(found[a], found[b])
        if side is None:
            continue
        aligned = _align(a, b, side, found, plane, drawing)
        matched = None if aligned is None else _match(found, plane, drawing, aligned, pad)
        if matched is None:
            continue
        pairs, misfit = matched
        if best is None or (len(pairs), -misfit) > (best[0], -best[1]):
            best = (len(pairs), misfit, pairs)
            if len(pairs) == len(found) or len(pairs) == len(drawing):
                break
    if best is None:
        return None
    count, misfit, pairs = best
    at, places = list(pairs.values()), drawing[list(pairs)]
    fit = _similarity(places, plane[at])
    if fit is None or not _painted(fit, seg, view, pad, whiteness):
        return None
    sigma = np.hypot([found[i].sigma_px for i in at], math.hypot(_SIGMA_CORNER_PX, _SIGMA_CORNER * stroke_px))
    marks = Marks(uv[at], places, point_modes(sigma), yaw_ambiguous=True)
    confidence = (1.0 - math.exp(-0.5 * count)) * math.exp(-((misfit / 0.15) ** 2)) * (0.5 + 0.5 * seg.plausibility)
    centre = view.pixels(_apply(fit, np.zeros((1, 2))))
    features = (
        Feature("point", "corners", uv[at]),
        Feature("outline", "H", view.pixels(_apply(fit, drawing))),
        Feature("point", "centre", centre),
    )
    return Cue(marks, confidence, features)


def _side_of(a: RightAngle, b: RightAngle) -> Side | None:
    """Return the side of the cross-bar that two inner corners are on; None if they are no such pair (the diagonal, another H)."""
    between = b.uv_px - a.uv_px
    between = between / max(float(np.linalg.norm(between)), 1e-9)
    along_a, along_b = a.arms @ between, b.arms @ between
    if min(along_a.max(), -along_b.min()) > _ALONG:
        return "long"
    return "short" if min(-along_a.min(), along_b.max()) > _ALONG else None


Similarity = tuple[float, float, float, float]
"""The parameters a, b, x, y of q = [[a, -b], [b, a]] p + [x, y]."""
_Pairs = dict[int, int]
"""The index of the corner that was found for each corner of the drawing."""


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
