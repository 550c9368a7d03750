"""Render the pad: compute the coverage of each pixel by each paint.

Pixels inside one paint are filled as polygons. A pixel that an edge may touch is integrated: for each of s x s subpixels and each
part of the exposure, the signed distance to every edge of the drawing that can be near is converted to a coverage. Seen along the
normal of a straight edge, a square subpixel that moves is three boxes convolved: its two sides and its way. The widest is
integrated exactly, the others together by two-point Gauss quadrature, so that mean, variance and skewness are right: edges lie
where the drawing has them in any direction, and areas add up even if a shape is thinner than a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad
from sitl.projection import F32, I32, SHIFT, Lens, fixed_point

BACKGROUND, RIM, DISC, ORANGE, WHITE = range(5)

_BUDGET = 16_000
"""Aim for the number of subsamples of a frame: 3 x 3 a pixel at 5 m, 5 x 5 at 20 m, 8 x 8 at 30 m, one from near by."""

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)

Pose = tuple[F64, F64]
"""Rotation (3, 3) of the pad and its centre (3,) m in `cam`."""


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """The pad's way during a part of the exposure."""

    first: Pose
    middle: Pose
    last: Pose
    rows: tuple[Pose, Pose] | None = None
    """Poses in the middle of this part of the exposure of the first row and of the last one; None for a global shutter."""

    @staticmethod
    def still(pose: Pose, rows: tuple[Pose, Pose] | None = None) -> Stroke:
        """Return the stroke of a pad that does not move while a row is exposed."""
        return Stroke(pose, pose, pose, rows)

    @property
    def is_still(self) -> bool:
        """Whether the pad does not move."""
        return self.first is self.last

    @property
    def in_front(self) -> bool:
        """Whether the camera sees the pad's upper side all the time."""
        return all(float(R[:, 2] @ t) > 1e-3 for R, t in (self.first, self.middle, self.last))


@dataclass(frozen=True, slots=True, eq=False)
class PadInImage:
    """The pad in one frame: polygons for the pixels of one paint, in paint order, and coverages for the others."""

    fills: tuple[tuple[int, I32], ...]
    """Polygons as (paint, fixed-point vertices)."""
    pixels: NDArray[np.intp]
    """(N,) indices into the rows of the frame of the pixels that edges touch, one after the other."""
    shares: F32
    """(5, N) coverage by background, rim, disc, orange and white; each column sums to 1."""


class PadPainter:
    """The pad's drawing prepared for one lens."""

    def __init__(self, lens: Lens, pad: Pad) -> None:
        self._lens, self._pad = lens, pad
        camera = lens.camera
        self._x, self._y = (np.ascontiguousarray(lens.rays[..., i].ravel()) for i in (0, 1))
        changes = lens.jacobian.reshape(-1, 4).T
        self._change = [np.ascontiguousarray(row) for row in changes] if camera.distorted else [row[:1] for row in changes]
        self._shape = (camera.height, camera.width)
        self._circle = pad.circle(1.0, 192)
        self._h_reach_m = math.hypot(pad.h_length_m, pad.h_width_m) / 2
        base = pad.arrow_tip_m - pad.arrow_depth_m
        self._ring_from_m = min(pad.ring_inner_m, base)
        self._ring_to_m = max(pad.arrow_tip_m, math.hypot(base, pad.arrow_half_base_m))

    def place(self, strokes: Sequence[Stroke], travel_px: F64) -> PadInImage | None:
        """Return the pad during the exposure; the pose in the middle of it gives the filled polygons.

        Args:
            strokes: equal parts of the exposure, in order; an odd number of them, or one.
            travel_px: the result of `travel_px` from the first pose to the last.

        Returns:
            The pad, or None if no part of it is in the frame or the camera is below it.
        """
        strokes = [stroke for stroke in strokes if stroke.in_front]
        if not strokes:
            return None
        R, t = strokes[len(strokes) // 2].middle
        px_m = max(1e-3, float(R[:, 2] @ t)) / self._lens.camera.fx
        # OpenCV fills every pixel that an outline touches, some 0.4 px too much.
        shrunk_m = 0.4 * px_m if px_m < 0.1 * min(self._pad.leg_width_m, self._pad.bar_width_m) else 0.0
        fills = [(paint, uv) for paint, uv in self._outlines(strokes[len(strokes) // 2], px_m, shrunk_m) if len(uv)]
        if not fills:
            return None
        rows = self._rows([uv for _, uv in fills], 3 + float(travel_px[1]) / 2)
        if rows is None:
            return None
        y0, y1 = rows
        mask = np.zeros((y1 - y0, self._shape[1]), np.uint8)
        if shrunk_m:
            for paint, uv in fills:
                cv2.fillPoly(mask, [fixed_point(uv - (0, y0))], paint, cv2.LINE_8, SHIFT)
            reach_x, reach_y = (math.ceil(1.1 + min(60.0, float(way)) / 2) for way in travel_px)
            near = np.ones((2 * reach_y + 1, 2 * reach_x + 1), np.uint8)
            mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, near, borderType=cv2.BORDER_REPLICATE), dtype=np.uint8)
        else:  # shapes so thin that the fill of the one inside may hide them
            polygons = [fixed_point(uv - (0, y0)) for _, uv in fills]
            cv2.polylines(mask, polygons, True, 255, 3 + math.ceil(min(float(np.hypot(*travel_px)), 60.0)), cv2.LINE_8, SHIFT)
        pixels = np.flatnonzero(mask.ravel() != 0) + y0 * self._shape[1]
        painted = tuple((paint, fixed_point(uv)) for paint, uv in fills)
        if not len(pixels):
            return PadInImage(painted, pixels, np.empty((5, 0), np.float32))
        samples = _BUDGET / (len(pixels) * len(strokes))
        fine = 8 if samples >= 64 else 5 if samples >= 20 else 3 if samples >= 7 else 2 if samples >= 5 else 1
        if len(strokes) == 1:
            order, total = self._shares(strokes[0], pixels, fine)
            return PadInImage(painted, pixels if order is None else pixels.take(order), total)
        total = self._all_shares(strokes[0], pixels, fine)
        for stroke in strokes[1:]:
            total += self._all_shares(stroke, pixels, fine)
        return PadInImage(painted, pixels, total * np.float32(1.0 / len(strokes)))

    def _reference(self, R: F64, t: F64) -> F64:
        """Return (9, 2) px of points whose motion measures the motion blur; nan behind the camera, clipped to near the frame."""
        points = np.concatenate([np.zeros((1, 3)), self._pad.circle(self._pad.disc_radius_m, 8)])
        camera = self._lens.camera
        uv = camera.project(points @ R.T + t)
        return np.clip(uv, -100.0, (camera.width + 100.0, camera.height + 100.0))

    def travel_px(self, first: Pose, last: Pose) -> F64:
        """Return the longest ways (2,) px to the right and down that a point of the pad moves in the frame between two poses."""
        ways = np.abs(self._reference(*first) - self._reference(*last))
        return np.asarray(np.nanmax(ways, axis=0, initial=0.0))

    def _outlines(self, stroke: Stroke, px_m: float, shrunk_m: float) -> list[tuple[int, F64]]:
        """Return (paint, (N, 2) px) for every outline, moved inward, in paint order; the array is empty if nothing is in view."""
        pad = self._pad
        radius_px = pad.disc_radius_m / px_m
        circle = self._circle[:: 8 if radius_px < 15 else 4 if radius_px < 60 else 2 if radius_px < 250 else 1]
        steps = max(1, min(16, int(radius_px / 25)))
        radii = [(DISC, pad.disc_radius_m), (ORANGE, pad.ring_outer_m), (DISC, pad.ring_inner_m)]
        if pad.rim_width_m:
            radii[:1] = [(RIM, pad.disc_radius_m), (DISC, pad.disc_radius_m - pad.rim_width_m)]
        shapes = [(paint, circle * (radius - shrunk_m)) for paint, radius in radii]
        shapes += [(ORANGE, _inward(pad.arrowhead(), shrunk_m)), (WHITE, _inward(pad.h_corners(), shrunk_m))]
        found = self._lens.outlines([self._in_cam(stroke, points) for _, points in shapes], steps)
        return [(paint, uv) for (paint, _), uv in zip(shapes, found, strict=True)]

    def _in_cam(self, stroke: Stroke, points_pad: F64) -> F64:
        """Return points (N, 3) of the pad in `cam`, each at the time of the row in which it shows."""
        R, t = stroke.middle
        points = points_pad @ R.T + t
        if stroke.rows is None:
            return points
        (Ra, ta), (Rb, tb) = stroke.rows
        first, last = points_pad @ Ra.T + ta, points_pad @ Rb.T + tb
        turn, bend = 0.5 * (last - first), 0.5 * (last + first) - points
        c, at = self._lens.camera, points
        for _ in range(3):
            row = c.fy * at[:, 1] / np.maximum(at[:, 2], 1e-3) + c.cy
            s = np.clip(2.0 * row / (c.height - 1) - 1.0, -1.2, 1.2)[:, None]
            at = points + s * turn + s * s * bend
        return np.asarray(at)

    def _rows(self, outlines: list[F64], margin_px: float) -> tuple[int, int] | None:
        """Return the first row of the frame that outlines touch, and the one after the last, or None if they are all outside."""
        low = np.min([uv.min(axis=0) for uv in outlines], axis=0) - margin_px
        high = np.max([uv.max(axis=0) for uv in outlines], axis=0) + margin_px
        y0, y1 = max(0, math.floor(low[1])), min(self._shape[0], math.ceil(high[1]) + 1)
        return (y0, y1) if y1 > y0 and high[0] > 0 and low[0] < self._shape[1] else None

    def _shares(self, stroke: Stroke, pixels: NDArray[np.intp], fine: int) -> tuple[NDArray[np.intp] | None, F32]:
        """Return the coverages of the pixels for one part of the exposure, from `fine` x `fine` subpixels each.

        Returns:
            The indices (M,) into `pixels` of those that an edge touches, None if all are here; and their coverages (5, M).
        """
        at = self._subpixels(stroke, pixels, fine)
        some = slice(None, None, max(1, len(at.u) // 200))
        reach = 0.55 * sum(float(np.hypot(a[some], b[some]).max()) for a, b in at.across)
        bands = self._bands(at, reach) if fine == 1 else []
        if not bands:
            return None, np.asarray(self._everything(at).reshape(5, fine * fine, -1).mean(axis=1), dtype=np.float32)
        chosen = [np.flatnonzero(near) for near, _ in bands]
        parts = [paint(at.take(which)) for which, (_, paint) in zip(chosen, bands, strict=True)]
        return np.concatenate(chosen), np.concatenate(parts, axis=1)

    def _all_shares(self, stroke: Stroke, pixels: NDArray[np.intp], fine: int) -> F32:
        """Return the coverages (5, N) of all the pixels for one part of the exposure."""
        at = self._subpixels(stroke, pixels, fine)
        return np.asarray(self._everything(at).reshape(5, fine * fine, -1).mean(axis=1), dtype=np.float32)

    def _subpixels(self, stroke: Stroke, pixels: NDArray[np.intp], fine: int) -> _Patch:
        """Return the `fine` x `fine` subpixels of the pixels, those of one place in all the pixels one after the other."""
        M = pad_from_ray(stroke.middle)
        if stroke.rows is not None:
            first, last = (pad_from_ray(pose) for pose in stroke.rows)
            s = (pixels // self._shape[1]) * np.float32(2.0 / (self._shape[0] - 1)) - _ONE
            M = in_row(first, M, last, s.astype(np.float32))
        x, y = self._x.take(pixels), self._y.take(pixels)
        one = np.float32(1.0 / fine)
        x_right, x_down, y_right, y_down = (c.take(pixels) * one if len(c) > 1 else c * one for c in self._change)
        if fine > 1:
            offsets = (np.arange(fine, dtype=np.float32) - np.float32((fine - 1) / 2)).repeat(fine).reshape(fine, fine)
            du, dv = offsets.T.reshape(-1, 1), offsets.reshape(-1, 1)
            x, y = x + du * x_right + dv * x_down, y + du * y_right + dv * y_down
        w = np.reciprocal(M[2, 0] * x + M[2, 1] * y + M[2, 2])
        if w.min() <= 0:
            w[w <= 0] = np.float32(1e3)
        u, v = (M[0, 0] * x + M[0, 1] * y + M[0, 2]) * w, (M[1, 0] * x + M[1, 1] * y + M[1, 2]) * w
        ux, uy = (M[0, 0] - u * M[2, 0]) * w, (M[0, 1] - u * M[2, 1]) * w
        vx, vy = (M[1, 0] - v * M[2, 0]) * w, (M[1, 1] - v * M[2, 1]) * w
        # The sides of the subpixel on the pad, and its way: columns of (u, v).
        if len(self._change[0]) == 1:
            across = [(ux * x_right, vx * x_right), (uy * y_down, vy * y_down)]
        else:
            across = [(ux * x_right + uy * y_right, vx * x_right + vy * y_right),
                      (ux * x_down + uy * y_down, vx * x_down + vy * y_down)]  # fmt: skip
        if not stroke.is_still:
            D = pad_from_ray(stroke.last) - pad_from_ray(stroke.first)
            turn = D[2, 0] * x + D[2, 1] * y + D[2, 2]
            across.append(
                ((D[0, 0] * x + D[0, 1] * y + D[0, 2] - u * turn) * w, (D[1, 0] * x + D[1, 1] * y + D[1, 2] - v * turn) * w)
            )
        r = np.asarray(cv2.magnitude(u, v), dtype=np.float32).reshape(u.shape)
        np.maximum(r, np.float32(1e-6), out=r)

        return _Patch(u.ravel(), v.ravel(), r.ravel(), [(a.reshape(-1), b.reshape(-1)) for a, b in across])

    def _bands(self, at: _Patch, reach_m: float) -> list[tuple[NDArray[np.bool_], Callable[[_Patch], F32]]]:
        """Return the subpixels by the edges that are near, with what paints them.

        Args:
            reach_m: largest distance of a subpixel's middle from an edge that touches it. Subpixels further from all edges are
                left out.

        Returns:
            Nothing at all if a subpixel may reach from the H to the ring or from there to the rim.
        """
        pad, u, v, r = self._pad, at.u, at.v, at.r
        inner, outer = 0.5 * (self._h_reach_m + self._ring_from_m), 0.5 * (self._ring_to_m + pad.disc_radius_m - pad.rim_width_m)
        if not (inner - self._h_reach_m > reach_m and outer - self._ring_to_m > reach_m):
            return []
        half = np.float32(0.5 * (pad.ring_outer_m - pad.ring_inner_m) + reach_m)
        about_ring = np.abs(r - np.float32(0.5 * (pad.ring_outer_m + pad.ring_inner_m))) < half
        about_arrow = u > np.float32(pad.arrow_tip_m - pad.arrow_depth_m - reach_m)
        about_arrow &= np.abs(v) < np.float32(pad.arrow_half_base_m + reach_m)
        about_arrow &= r < np.float32(outer)
        rim_half = np.float32(0.5 * pad.rim_width_m + reach_m)
        about_rim = np.abs(r - np.float32(pad.disc_radius_m - 0.5 * pad.rim_width_m)) < rim_half
        about_h = r < np.float32(inner)
        return [(about_h, self._inside_ring), (about_ring | about_arrow, self._about_ring), (about_rim, self._about_rim)]

    def _everything(self, at: _Patch) -> F32:
        out = self._about_rim(at)
        out[ORANGE], out[WHITE] = self._orange(at), self._white(at)
        out[DISC] -= out[ORANGE] + out[WHITE]
        return out

    def _inside_ring(self, at: _Patch) -> F32:
        out = np.zeros((5, len(at.u)), np.float32)
        out[WHITE] = self._white(at)
        np.subtract(_ONE, out[WHITE], out=out[DISC])
        return out

    def _about_ring(self, at: _Patch) -> F32:
        out = np.zeros((5, len(at.u)), np.float32)
        out[ORANGE] = self._orange(at)
        np.subtract(_ONE, out[ORANGE], out=out[DISC])
        return out

    def _about_rim(self, at: _Patch) -> F32:
        pad = self._pad
        out = np.zeros((5, len(at.u)), np.float32)
        sharp = at.shape_r()
        inside = _covered(np.float32(pad.disc_radius_m) - at.r, sharp)
        out[BACKGROUND] = _ONE - inside
        if pad.rim_width_m:
            out[DISC] = _covered(np.float32(pad.disc_radius_m - pad.rim_width_m) - at.r, sharp)
            out[RIM] = inside - out[DISC]
        else:
            out[DISC] = inside
        return out

    def _orange(self, at: _Patch) -> F32:
        pad = self._pad
        sharp = at.shape_r()
        ring = _covered(np.float32(pad.ring_outer_m) - at.r, sharp) - _covered(np.float32(pad.ring_inner_m) - at.r, sharp)
        slant = math.hypot(pad.arrow_half_base_m, pad.arrow_depth_m)
        cu, cv = np.float32(pad.arrow_half_base_m / slant), np.float32(pad.arrow_depth_m / slant)
        ahead, aside = cu * (np.float32(pad.arrow_tip_m) - at.u), cv * at.v
        arrow = _covered(at.u - np.float32(pad.arrow_tip_m - pad.arrow_depth_m), at.shape(_ONE, _ZERO))
        arrow *= _covered(ahead - aside, at.shape(cu, cv))
        arrow *= _covered(ahead + aside, at.shape(cu, -cv))
        return np.asarray(ring + arrow - ring * arrow, dtype=np.float32)

    def _white(self, at: _Patch) -> F32:
        pad = self._pad
        sharp_u, sharp_v = at.shape(_ONE, _ZERO), at.shape(_ZERO, _ONE)
        half = pad.h_width_m / 2
        between = _strip(at.v, half - pad.leg_width_m, sharp_v)
        legs = (_strip(at.v, half, sharp_v) - between) * _strip(at.u, pad.h_length_m / 2, sharp_u)
        return np.asarray(legs + between * _strip(at.u, pad.bar_width_m / 2, sharp_u), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Patch:
    """Subpixels on the pad's plane: centres u, v and radii r, (N,) m, and the vectors of their sides and of their way."""

    u: F32
    v: F32
    r: F32
    across: list[tuple[F32, F32]]

    def take(self, which: NDArray[np.intp]) -> _Patch:
        """Return some of the subpixels."""
        across = [(a.take(which), b.take(which)) for a, b in self.across]
        return _Patch(self.u.take(which), self.v.take(which), self.r.take(which), across)

    def shape(self, gu: np.float32 | F32, gv: np.float32 | F32) -> tuple[F32, F32]:
        """Return what a subpixel is along the direction (gu, gv): a box blurred by two points.

        Returns:
            One over the box's width, 1/m, and the distance of the points from the middle in widths.
        """
        widest: F32 = np.full(1, 1e-14, np.float32)
        total: F32 = widest
        for a, b in self.across:
            along = a if gv is _ZERO else b if gu is _ZERO else gu * a + gv * b
            width2 = along * along
            total = width2 + total
            widest = np.maximum(width2, widest)
        per_width2 = np.reciprocal(widest)
        rest = total * per_width2
        rest -= _ONE
        rest *= np.float32(1.0 / 12.0)
        return np.sqrt(per_width2), np.sqrt(np.maximum(rest, _ZERO, out=rest), out=rest)

    def shape_r(self) -> tuple[F32, F32]:
        """Return `shape` along the radius."""
        per_r = np.reciprocal(self.r)
        return self.shape(self.u * per_r, self.v * per_r)


def pad_from_ray(pose: Pose) -> F32:
    """Return the homography from rays to the pad's plane."""
    R, t = pose
    return np.linalg.inv(np.stack([R[:, 0], R[:, 1], t], axis=1)).astype(np.float32)


def _inward(polygon: F64, by_m: float) -> F64:
    """Return a polygon (N, 3) of the pad's plane with its sides moved inward; corners run clockwise about +z."""
    if by_m == 0:
        return polygon
    side = np.roll(polygon, -1, axis=0) - polygon
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    before = np.roll(side, 1, axis=0)
    turn = before[:, 0] * side[:, 1] - before[:, 1] * side[:, 0]
    return np.asarray(polygon + (side - before) * (by_m / turn)[:, None])


def in_row(first: F32, middle: F32, last: F32, s: F32) -> F32:
    """Return a homography in rows at s, from -1 in the first to 1 in the last, by a parabola through three: (3, 3, *s.shape)."""
    a, b, c = (m.reshape(3, 3, *(1,) * s.ndim) for m in (first, middle, last))
    return np.asarray(b + s * (np.float32(0.5) * (c - a)) + s * s * (np.float32(0.5) * (c + a) - b), dtype=np.float32)


def _covered(distance_m: F32, shape: tuple[F32, F32]) -> F32:
    """Return the fraction of a subpixel on the positive side of an edge."""
    per_width, offset = shape
    share = distance_m * per_width
    share += _HALF
    other = share - offset
    share += offset
    for part in (share, other):
        np.maximum(part, _ZERO, out=part)
        np.minimum(part, _ONE, out=part)
    share += other
    share *= _HALF
    return share


def _strip(x_m: F32, half_width_m: float, shape: tuple[F32, F32]) -> F32:
    """Return the fraction of a subpixel between -half_width and +half_width; it is also right for a strip thinner than that."""
    half = np.float32(half_width_m)
    return _covered(x_m + half, shape) - _covered(x_m - half, shape)
