"""Render the pad: compute the coverage of each pixel by each paint.

Pixels inside one paint are filled as polygons. A pixel that an edge may touch is integrated: for each of s x s subpixels and each
sub-exposure, the signed distance to every edge of the drawing is converted to a coverage. Seen along the normal of a straight
edge, a square subpixel is a box of its wider side blurred by a box of its narrower one. The wider is integrated exactly, the
narrower by two-point Gauss quadrature, so that mean, variance and skewness are those of the square: edges lie where the drawing
has them in any direction, and areas add up even if a shape is thinner than a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad
from sitl.projection import F32, I32, SHIFT, Lens, fixed_point

BACKGROUND, RIM, DISC, ORANGE, WHITE = range(5)

_BUDGET = 24_000
"""Largest number of subsamples of a frame: 5 x 5 a pixel at 10 m, 8 x 8 from 20 m on, one if the pad fills the frame."""

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)


@dataclass(frozen=True, slots=True, eq=False)
class PadInImage:
    """The pad in one frame: polygons for the pixels of one paint, in paint order, and coverages for the others."""

    fills: tuple[tuple[int, I32], ...]
    """Polygons as (paint, fixed-point vertices)."""
    rows: NDArray[np.intp]
    """(N,) row numbers of the pixels that edges touch."""
    cols: NDArray[np.intp]
    shares: F32
    """(N, 5) coverage by background, rim, disc, orange and white; each row sums to 1."""


class PadPainter:
    """The pad's drawing prepared for one lens."""

    def __init__(self, lens: Lens, pad: Pad) -> None:
        self._lens, self._pad = lens, pad
        self._mask = np.zeros((lens.camera.height, lens.camera.width), np.uint8)
        self._circle = pad.circle(1.0, 192)
        self._arrow, self._h = pad.arrowhead(), pad.h_corners()

    def place(self, cam_from_pad: Sequence[tuple[F64, F64]]) -> PadInImage | None:
        """Return the pad at the poses of the sub-exposures; the middle pose gives the filled polygons.

        Args:
            cam_from_pad: rotation (3, 3) and pad's centre (3,) m in `cam` for each sub-exposure.

        Returns:
            The pad, or None if no part of it is in the frame or the camera is below it.
        """
        cam_from_pad = [(R, t) for R, t in cam_from_pad if float(R[:, 2] @ t) > 1e-3]
        if not cam_from_pad:
            return None
        middle = len(cam_from_pad) // 2
        R, t = cam_from_pad[middle]
        fills = self._outlines(R, t)
        travel = 0.0
        outlines = [uv for _, uv in fills]
        if len(cam_from_pad) > 1:
            others = [[uv for _, uv in self._outlines(*pose)] for n, pose in enumerate(cam_from_pad) if n != middle]
            first, last = (self._reference(*pose) for pose in (cam_from_pad[0], cam_from_pad[-1]))
            travel = float(np.nanmax(np.abs(first - last), initial=0.0)) / (len(cam_from_pad) - 1)
            outlines += [uv for other in others for uv in other]
        outlines = [uv for uv in outlines if len(uv)]
        if not outlines:
            return None
        box = self._box(outlines, 3 + travel)
        if box is None:
            return None
        x0, y0, x1, y1 = box
        mask = self._mask[y0:y1, x0:x1]
        mask[:] = 0
        polygons = [fixed_point(uv - (x0, y0)) for uv in outlines]
        cv2.polylines(mask, polygons, True, 255, 3 + math.ceil(min(travel, 40.0)), cv2.LINE_8, SHIFT)
        where: NDArray[np.int32] | None = cv2.findNonZero(mask)  # type: ignore[assignment]
        painted = tuple((paint, fixed_point(uv)) for paint, uv in fills if len(uv))
        if where is None:
            nothing = np.empty(0, np.intp)
            return PadInImage(painted, nothing, nothing, np.empty((0, 5), np.float32))
        cols = where[:, 0, 0].astype(np.intp) + x0
        rows = where[:, 0, 1].astype(np.intp) + y0
        fine = max(1, min(8, int(math.sqrt(_BUDGET / (len(rows) * len(cam_from_pad))))))
        total = np.zeros((5, len(rows)), np.float32)
        for R, t in cam_from_pad:
            total += self._shares(R, t, rows, cols, fine)
        return PadInImage(painted, rows, cols, np.ascontiguousarray(total.T) * np.float32(1.0 / len(cam_from_pad)))

    def _reference(self, R: F64, t: F64) -> F64:
        """Return (9, 2) px of points whose motion measures the motion blur; nan behind the camera, clipped to near the frame."""
        points = np.concatenate([np.zeros((1, 3)), self._pad.circle(self._pad.disc_radius_m, 8)])
        camera = self._lens.camera
        uv = camera.project(points @ R.T + t)
        return np.clip(uv, -100.0, (camera.width + 100.0, camera.height + 100.0))

    def travel_px(self, first: tuple[F64, F64], last: tuple[F64, F64]) -> float:
        """Return the longest distance that a point of the pad moves in the frame from one pose to the other, px."""
        return float(np.nanmax(np.abs(self._reference(*first) - self._reference(*last)), initial=0.0))

    def _outlines(self, R: F64, t: F64) -> list[tuple[int, F64]]:
        """Return (paint, (N, 2) px) for every outline in paint order; the array is empty if nothing is in view."""
        pad = self._pad
        radius_px = pad.disc_radius_m * self._lens.camera.fx / max(1e-3, float(R[:, 2] @ t))
        circle = self._circle[:: 8 if radius_px < 15 else 4 if radius_px < 60 else 2 if radius_px < 250 else 1]
        steps = max(1, min(16, int(radius_px / 25)))
        shapes: list[tuple[int, F64]] = [(DISC, circle * pad.disc_radius_m)]
        if pad.rim_width_m:
            shapes = [(RIM, circle * pad.disc_radius_m), (DISC, circle * (pad.disc_radius_m - pad.rim_width_m))]
        shapes += [
            (ORANGE, circle * pad.ring_outer_m),
            (DISC, circle * pad.ring_inner_m),
            (ORANGE, self._arrow),
            (WHITE, self._h),
        ]
        found = self._lens.outlines([points @ R.T + t for _, points in shapes], steps)
        return [(paint, uv) for (paint, _), uv in zip(shapes, found, strict=True)]

    def _box(self, outlines: list[F64], margin_px: float) -> tuple[int, int, int, int] | None:
        camera = self._lens.camera
        low = np.min([uv.min(axis=0) for uv in outlines], axis=0) - margin_px
        high = np.max([uv.max(axis=0) for uv in outlines], axis=0) + margin_px
        x0, y0 = max(0, math.floor(low[0])), max(0, math.floor(low[1]))
        x1, y1 = min(camera.width, math.ceil(high[0]) + 1), min(camera.height, math.ceil(high[1]) + 1)
        return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None

    def _shares(self, R: F64, t: F64, rows: NDArray[np.intp], cols: NDArray[np.intp], fine: int) -> F32:
        """Return the coverages (5, N) of the pixels for one pose, from `fine` x `fine` subpixels each."""
        pad, lens = self._pad, self._lens
        M = np.linalg.inv(np.stack([R[:, 0], R[:, 1], t], axis=1)).astype(np.float32)
        jac = lens.jacobian[rows, cols] / np.float32(fine)
        offsets = (np.arange(fine, dtype=np.float32) - np.float32((fine - 1) / 2)).repeat(fine).reshape(fine, fine)
        du, dv = offsets.T.reshape(-1, 1), offsets.reshape(-1, 1)
        centre = lens.rays[rows, cols]
        x = centre[:, 0] + du * jac[:, 0, 0] + dv * jac[:, 0, 1]
        y = centre[:, 1] + du * jac[:, 1, 0] + dv * jac[:, 1, 1]

        w = 1.0 / (M[2, 0] * x + M[2, 1] * y + M[2, 2])
        w[w <= 0] = np.float32(1e3)
        u = (M[0, 0] * x + M[0, 1] * y + M[0, 2]) * w
        v = (M[1, 0] * x + M[1, 1] * y + M[1, 2]) * w
        ux, uy = (M[0, 0] - u * M[2, 0]) * w, (M[0, 1] - u * M[2, 1]) * w
        vx, vy = (M[1, 0] - v * M[2, 0]) * w, (M[1, 1] - v * M[2, 1]) * w
        u_right, u_down = ux * jac[:, 0, 0] + uy * jac[:, 1, 0], ux * jac[:, 0, 1] + uy * jac[:, 1, 1]
        v_right, v_down = vx * jac[:, 0, 0] + vy * jac[:, 1, 0], vx * jac[:, 0, 1] + vy * jac[:, 1, 1]

        r = np.maximum(cv2.magnitude(u, v), np.float32(1e-6))
        per_r = 1.0 / r
        across_r = _across((u * u_right + v * v_right) * per_r, (u * u_down + v * v_down) * per_r)
        across_u, across_v = _across(u_right, u_down), _across(v_right, v_down)

        inside = _covered(pad.disc_radius_m - r, across_r)
        field = _covered(pad.disc_radius_m - pad.rim_width_m - r, across_r) if pad.rim_width_m else inside
        ring = _covered(pad.ring_outer_m - r, across_r) - _covered(pad.ring_inner_m - r, across_r)

        slant = math.hypot(pad.arrow_half_base_m, pad.arrow_depth_m)
        cu, cv = np.float32(pad.arrow_half_base_m / slant), np.float32(pad.arrow_depth_m / slant)
        ahead, aside = cu * (np.float32(pad.arrow_tip_m) - u), cv * v
        across_s = _across(cu * u_right + cv * v_right, cu * u_down + cv * v_down)
        across_p = _across(cu * u_right - cv * v_right, cu * u_down - cv * v_down)
        arrow = _covered(u - (pad.arrow_tip_m - pad.arrow_depth_m), across_u)
        arrow *= _covered(ahead - aside, across_s) * _covered(ahead + aside, across_p)
        orange = ring + arrow - ring * arrow

        half_w, half_l = pad.h_width_m / 2, pad.h_length_m / 2
        inner = half_w - pad.leg_width_m
        legs = _strip(v, half_w, across_v) - _strip(v, inner, across_v)
        white = legs * _strip(u, half_l, across_u) + _strip(v, inner, across_v) * _strip(u, pad.bar_width_m / 2, across_u)

        out = np.empty((5, len(rows)), np.float32)
        out[RIM] = (inside - field).mean(axis=0)
        out[ORANGE] = orange.mean(axis=0)
        out[WHITE] = white.mean(axis=0)
        whole = inside.mean(axis=0)
        out[DISC] = whole - out[RIM] - out[ORANGE] - out[WHITE]
        out[BACKGROUND] = 1.0 - whole
        return out


def _across(right: F32, down: F32) -> tuple[F32, F32]:
    """Return the shape of a subpixel across an edge from the distance's change over a subpixel to the right and down.

    Returns:
        1 / wider side, and the offset of the quadrature point along the narrower side in units of the wider one.
    """
    right, down = np.abs(right), np.abs(down)
    # OpenCV's min and max take a fifth of numpy's time on float32.
    per_wider: F32 = np.reciprocal(np.asarray(cv2.max(right, down), dtype=np.float32))
    offset: F32 = np.asarray(cv2.min(right, down), dtype=np.float32) * per_wider
    offset *= np.float32(math.sqrt(1.0 / 12.0))
    return per_wider, offset


def _covered(distance_m: F32, across: tuple[F32, F32]) -> F32:
    """Return the fraction of a subpixel on the positive side of an edge."""
    per_wider, offset = across
    t = distance_m * per_wider
    t += _HALF
    share: F32 = t + offset
    t -= offset
    for part in (share, t):
        part.clip(_ZERO, _ONE, out=part)
    share += t
    share *= _HALF
    return share


def _strip(x_m: F32, half_width_m: float, across: tuple[F32, F32]) -> F32:
    """Return the fraction of a subpixel between -half_width and +half_width; it is also right for a strip thinner than that."""
    half = np.float32(half_width_m)
    return _covered(x_m + half, across) - _covered(x_m - half, across)
