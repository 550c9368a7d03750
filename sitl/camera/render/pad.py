"""Place the pad in a frame: which paint each pixel shows, and the coverage of each pixel that an edge touches.

The coverages are exact over pixel and exposure (sitl/core/render/pad.c).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.pad import Pad
from estimator.vision.regions import (
    PaintedArrowhead,
    PaintedDisc,
    PaintedPanel,
    PaintedRing,
    PaintedTriangle,
    Rectangle,
    Region,
    convex_pieces_of,
    is_slanted,
    part_of,
    rectangles_of,
)
from sitl.camera.light import PadInImage
from sitl.camera.projection import F32, Lens, planes_from_rays
from sitl.core.abi import PAD_ANNULUS, PAD_ARROW, PAD_PAINTS, PAD_POLYGON, PAD_RECTANGLE, PAD_REGION, STROKE_NUMBERS
from sitl.native import address, render_pad_kinds, render_pad_shares

_BUDGET = 16_000
"""Aim for the number of subsamples of a frame: 3 x 3 a pixel at 5 m, 5 x 5 at 20 m, 8 x 8 at 30 m, one from near by."""

_PAINT_OF = {"rim": 1, "disc": 2, "panel": 2, "ring": 3, "arrow": 3, "triangle": 4, "letter": 4, "fiducial": 4}
"""Index in `pad_paint_kind` of the paint of each part."""
_UPPER = 5
"""That of lettering of a second paint."""

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
    def in_front(self) -> bool:
        """Whether the camera sees the pad's upper side all the time."""
        poses = (self.middle,) if self.first is self.middle is self.last else (self.first, self.middle, self.last)
        return all(float(R[:, 2].dot(t)) > 1e-3 for R, t in poses)


class PadPainter:
    """The pad's drawing prepared for one lens."""

    def __init__(self, lens: Lens, pad: Pad) -> None:
        self._lens, self._pad = lens, pad
        self._change = lens.jacobian if lens.camera.distorted else np.ascontiguousarray(lens.jacobian[0, 0])
        self._regions = regions_of(pad)
        self._reference = np.concatenate([np.zeros((1, 3)), pad.circle(pad.disc_radius_m, 8)])
        # Room for a frame's pad: asking for its memory each time costs as much as filling it.
        self._edges = np.empty(lens.camera.height * lens.camera.width, np.int32)
        self._kinds = np.empty((lens.camera.height, lens.camera.width), np.uint8)
        self._drawn = len(self._regions), address(self._regions, np.float32)
        rays, change = address(lens.rays, np.float32), address(self._change, np.float32)
        self._seen = lens.camera.height, lens.camera.width, rays, change, int(lens.camera.distorted)

    def place(self, strokes: Sequence[Stroke]) -> PadInImage | None:
        """Return the pad during the exposure.

        Args:
            strokes: equal parts of the exposure, in order; an odd number of them, or one.

        Returns:
            The pad, until the next one is placed, or None if the camera is below it.
        """
        strokes = [stroke for stroke in strokes if stroke.in_front]
        if not strokes:
            return None
        rolling, drawn, seen = strokes[0].rows is not None, self._drawn, self._seen
        middle = strokes[len(strokes) // 2]
        whole = _numbers([Stroke(strokes[0].first, middle.middle, strokes[-1].last, middle.rows)])
        kinds, edges = self._kinds, self._edges
        where = address(edges, np.int32)
        division = address(self._lens.coarse, np.float32), address(whole, np.float32), int(rolling)
        count = render_pad_kinds(*seen, *division, *drawn, address(kinds, np.uint8), where)
        shares, fine, parts = np.empty((count, PAD_PAINTS), np.float32), 1, None
        if count:
            samples = _BUDGET / (count * len(strokes))
            fine = 8 if samples >= 64 else 5 if samples >= 20 else 3 if samples >= 7 else 2 if samples >= 5 else 1
            numbers = _numbers(strokes) if len(strokes) > 1 else whole
            if fine > 1:
                parts = np.empty((count, PAD_PAINTS, fine * fine), np.float32)
            exposed = len(strokes), address(numbers, np.float32), int(rolling)
            room = address(shares, np.float32), address(parts, np.float32)
            render_pad_shares(*seen, *exposed, *drawn, fine, count, where, *room)
        return PadInImage(kinds, edges[:count], shares, fine, parts)

    def travel_px(self, first: Pose, last: Pose) -> F64:
        """Return the longest ways (2,) px to the right and down that a point of the pad moves in the frame between two poses."""
        camera = self._lens.camera
        uv = camera.project(np.concatenate([self._reference.dot(R.T) + t for R, t in (first, last)]))
        # Behind the camera there is no place; far outside the frame any is as good as one near it.
        uv = np.minimum(np.maximum(uv, -100.0), (camera.width + 100.0, camera.height + 100.0))
        ways = np.abs(uv[: len(uv) // 2] - uv[len(uv) // 2 :])
        return np.asarray(np.fmax.reduce(ways, axis=0, initial=0.0))


def regions_of(pad: Pad) -> F32:
    """Return the regions of a pad, the lowest first, (N, `PAD_REGION`)."""
    rows: list[tuple[float, ...]] = []
    below = _PAINT_OF["disc"] if pad.markings.has_ground else 0
    for region in pad.regions:
        paint = _PAINT_OF[part_of(region)]
        match region:
            case PaintedDisc():
                rows.append((PAD_ANNULUS, paint, 0, 0.0, region.radius_m, -1.0, region.radius_m))
            case PaintedPanel():
                x, y = 0.5 * region.length_m, 0.5 * region.width_m
                rows.append((PAD_RECTANGLE, paint, 0, *_rectangle((-x, x, -y, y))))
            case PaintedRing():
                around = 0 if region.part == "rim" else below
                rows.append((PAD_ANNULUS, paint, around, region.inner_m, region.outer_m, region.inner_m, region.outer_m))
            case PaintedArrowhead():
                slant = math.hypot(region.half_base_m, region.depth_m)
                sides = region.half_base_m / slant, region.depth_m / slant
                base = region.tip_m - region.depth_m
                far = max(region.tip_m, math.hypot(base, region.half_base_m))
                rows.append((PAD_ARROW, paint, below, base, far, region.tip_m, base, *sides))
            case _:
                pass
    marks, letter = pad.markings, _PAINT_OF["letter"]
    rows += _lettering([*marks.letters, *([] if marks.triangle is None else [marks.triangle])], letter, below)
    rows += _lettering(marks.upper, _UPPER, letter if marks.upper_on_letters else below)
    return np.array([(*row, *[0.0] * (PAD_REGION - len(row))) for row in rows], np.float32)


def _lettering(shapes: Sequence[Region], paint: int, below: int) -> list[tuple[float, ...]]:
    """Return the rectangles and the convex pieces of lettering of one paint as regions."""
    upright = [s for s in shapes if not isinstance(s, PaintedTriangle) and not is_slanted(s)]
    pieces = [piece for s in shapes if is_slanted(s) for piece in convex_pieces_of(s)]
    return [
        *((PAD_RECTANGLE, paint, below, *_rectangle(limits)) for limits in rectangles_of(upright)),  # type: ignore[arg-type]
        *((PAD_POLYGON, paint, below, *_polygon(piece)) for piece in pieces),
    ]


def _polygon(corners: F64) -> tuple[float, ...]:
    """Return a convex polygon's bounds of the distance from the centre, m, its number of sides, their normals and distances."""
    way = np.roll(corners, -1, axis=0) - corners
    normal = np.stack([way[:, 1], -way[:, 0]], axis=1) / np.linalg.norm(way, axis=1)[:, None]
    offset = np.sum(normal * corners, axis=1)
    nearest = max(0.0, -float(offset.min()))
    return nearest, float(np.hypot(*corners.T).max()), len(corners), *np.c_[normal, offset].ravel().tolist()


def _rectangle(limits: Rectangle) -> tuple[float, ...]:
    """Return a rectangle's least and largest distance from the centre, m, and its limits."""
    x0, x1, y0, y1 = limits
    return math.hypot(max(x0, -x1, 0.0), max(y0, -y1, 0.0)), math.hypot(max(-x0, x1), max(-y0, y1)), *limits


def _numbers(strokes: Sequence[Stroke]) -> F32:
    """Return the homographies of parts of the exposure, (N, 36): in the middle, change, in the first row, in the last."""
    out = np.zeros((len(strokes), STROKE_NUMBERS), np.float32)
    for numbers, s in zip(out.reshape(-1, 4, 9), strokes, strict=True):
        numbers[0] = pad_from_ray(s.middle).ravel()
        if s.first is not s.last:
            first, last = pad_from_ray(s.first, s.last).reshape(2, 9)
            numbers[1] = last - first
        if s.rows is not None:
            numbers[2:] = pad_from_ray(*s.rows).reshape(2, 9)
    return out


def pad_from_ray(*poses: Pose) -> F32:
    """Return the homographies (N, 3, 3) from rays to the pad's plane."""
    return planes_from_rays(poses).astype(np.float32)


def in_row(planes: F32, s: F32) -> F32:
    """Return a homography in rows at s, from -1 in the first to 1 in the last, by a parabola through three: (3, 3, *s.shape).

    Args:
        planes: homographies (3, 3, 3) in the first row, in the middle and in the last row.
    """
    a, b, c = (m.reshape(3, 3, *(1,) * s.ndim) for m in planes)
    return np.asarray(b + s * (np.float32(0.5) * (c - a)) + s * s * (np.float32(0.5) * (c + a) - b), dtype=np.float32)
