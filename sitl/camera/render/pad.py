"""Place the pad in a frame: which paint each pixel shows, and the coverage of each pixel that an edge touches.

The coverages are exact over pixel and exposure (sitl/core/render/pad.c).

The camera adds motion blur of the scenery, vignetting, and the rows of a rolling shutter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.geometry import Rectangle, convex_pieces_of, is_slanted, rectangles_of
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import PaintedArrowhead, PaintedDisc, PaintedPanel, PaintedRing, PaintedTriangle, Region, part_of
from sitl.camera.light import I16, U16, PadInImage
from sitl.camera.projection import F32, Lens, planes_from_rays
from sitl.core.abi import (
    DL_CELL_PX,
    DL_GAIN_ONE,
    DL_PAD_ANNULUS,
    DL_PAD_ARROW,
    DL_PAD_PAINTS,
    DL_PAD_POLYGON,
    DL_PAD_RECTANGLE,
    DL_PAD_REGION,
    DL_STROKE_NUMBERS,
)
from sitl.core.library import SIM

_BUDGET = 16_000
"""Aim for the number of subsamples of a frame: 3 x 3 a pixel at 5 m, 5 x 5 at 20 m, 8 x 8 at 30 m, one from near by."""

_PAINT_OF = {"rim": 1, "disc": 2, "panel": 2, "ring": 3, "arrow": 3, "triangle": 4, "letter": 4, "fiducial": 4}
"""Index in `dl_sim_paint` of the paint of each part."""
_UPPER = 5
"""Index of the upper side of lettering of a second paint."""

Pose = tuple[F64, F64]
"""Rotation (3, 3) of the pad and its centre (3,) m in `cam`."""


class Stroke(Struct, frozen=True, eq=False):
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
        """True if the camera sees the pad's upper side all the time."""
        poses = (self.middle,) if self.first is self.middle is self.last else (self.first, self.middle, self.last)
        return all(float(R[:, 2].dot(t)) > 1e-3 for R, t in poses)


class PadPainter:
    """The pad's drawing prepared for one lens."""

    def __init__(self, lens: Lens, pad: Pad) -> None:
        self._lens, self._pad = lens, pad
        self._change = lens.jacobian if lens.camera.distorted else np.ascontiguousarray(lens.jacobian[0, 0])
        self._regions = regions_of(pad)
        self._reference = np.concatenate([np.zeros((1, 3)), pad.circle(pad.disc_radius_m, 8)])
        # Room for a frame's pad: requesting its memory each time costs as much as filling it.
        self._edges = np.empty(lens.camera.height * lens.camera.width, np.int32)
        self._kinds = np.empty((lens.camera.height, lens.camera.width), np.uint8)
        self._view = SIM.new(
            "dl_sim_pad_view", h=lens.camera.height, w=lens.camera.width, bent=lens.camera.distorted, regions=len(self._regions),
            rays=lens.rays, change=self._change, middles=lens.coarse, pad=self._regions,
        )  # fmt: skip

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
        view = self._view
        view.rolling = strokes[0].rows is not None
        middle = strokes[len(strokes) // 2]
        whole = _numbers([Stroke(strokes[0].first, middle.middle, strokes[-1].last, middle.rows)])
        kinds, edges = self._kinds, self._edges
        where = SIM.array("int32_t", edges)
        count = SIM.lib.dl_sim_render_pad_kinds(
            view, SIM.array("float", whole, DL_STROKE_NUMBERS), SIM.array("uint8_t", kinds), where
        )
        shares, fine, parts = np.empty((count, DL_PAD_PAINTS), np.float32), 1, None
        if count:
            samples = _BUDGET / (count * len(strokes))
            fine = 8 if samples >= 64 else 5 if samples >= 20 else 3 if samples >= 7 else 2 if samples >= 5 else 1
            numbers = _numbers(strokes) if len(strokes) > 1 else whole
            if fine > 1:
                parts = np.empty((count, DL_PAD_PAINTS, fine * fine), np.float32)
            each = SIM.array("float", shares), SIM.ffi.NULL if parts is None else SIM.array("float", parts)
            exposed = SIM.array("float", numbers, len(strokes) * DL_STROKE_NUMBERS)
            SIM.lib.dl_sim_render_pad_shares(view, len(strokes), exposed, fine, count, where, *each)
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
    """Return the regions of a pad, the lowest first, (N, `DL_PAD_REGION`)."""
    rows: list[tuple[float, ...]] = []
    below = _PAINT_OF["disc"] if pad.markings.has_ground else 0
    for region in pad.regions:
        paint = _PAINT_OF[part_of(region)]
        match region:
            case PaintedDisc():
                rows.append((DL_PAD_ANNULUS, paint, 0, 0.0, region.radius_m, -1.0, region.radius_m))
            case PaintedPanel():
                x, y = 0.5 * region.length_m, 0.5 * region.width_m
                rows.append((DL_PAD_RECTANGLE, paint, 0, *_rectangle((-x, x, -y, y))))
            case PaintedRing():
                around = 0 if region.part == "rim" else below
                rows.append((DL_PAD_ANNULUS, paint, around, region.inner_m, region.outer_m, region.inner_m, region.outer_m))
            case PaintedArrowhead():
                slant = math.hypot(region.half_base_m, region.depth_m)
                sides = region.half_base_m / slant, region.depth_m / slant
                base = region.tip_m - region.depth_m
                far = max(region.tip_m, math.hypot(base, region.half_base_m))
                rows.append((DL_PAD_ARROW, paint, below, base, far, region.tip_m, base, *sides))
            case _:
                pass
    marks, letter = pad.markings, _PAINT_OF["letter"]
    rows += _lettering([*marks.letters, *([] if marks.triangle is None else [marks.triangle])], letter, below)
    rows += _lettering(marks.upper, _UPPER, letter if marks.upper_on_letters else below)
    return np.array([(*row, *[0.0] * (DL_PAD_REGION - len(row))) for row in rows], np.float32)


def _lettering(shapes: Sequence[Region], paint: int, below: int) -> list[tuple[float, ...]]:
    """Return the rectangles and the convex pieces of lettering of one paint as regions."""
    upright = [s for s in shapes if not isinstance(s, PaintedTriangle) and not is_slanted(s)]
    pieces = [piece for s in shapes if is_slanted(s) for piece in convex_pieces_of(s)]
    return [
        *((DL_PAD_RECTANGLE, paint, below, *_rectangle(limits)) for limits in rectangles_of(upright)),  # type: ignore[arg-type]
        *((DL_PAD_POLYGON, paint, below, *_polygon(piece)) for piece in pieces),
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
    out = np.zeros((len(strokes), DL_STROKE_NUMBERS), np.float32)
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


def smear(scene: U16, lens: Lens, middle: Pose, ends: list[Pose]) -> U16:
    """Return the scenery (H, W, 4) blurred along its motion in the middle of the frame, if that is a pixel or more."""
    camera = lens.camera
    R, t = middle
    on_pad = -t.dot(R)
    depth = -float(on_pad[2]) / max(0.05, float(R[2, 2]))
    if not 0 < depth < 1e4:
        return scene
    on_pad += depth * R[2]
    right, down = _way_px(camera, *(r.dot(on_pad) + p for r, p in ends))
    length = math.hypot(right, down)
    if not length >= 1.0:
        return scene
    way = np.array([right, down]) * min(1.0, 31.0 / length)
    # A long way is a short one, up to some four pixels, seen twice, four times and so on, whole pixels apart.
    doublings = max(0, math.ceil(math.log2(min(length, 31.0) / 4.0)))
    steps = [np.round(way / 2 ** (doublings - n)) for n in range(doublings)]
    shifts, taps = _smear_taps(way - np.sum(steps, axis=0, initial=0.0))
    h, w = scene.shape[:2]
    smeared = np.empty_like(scene)
    weights = SIM.array("int32_t", shifts, 2 * len(taps)), SIM.array("uint16_t", taps)
    SIM.lib.dl_sim_render_smear(h, w, SIM.array("uint16_t", scene), len(taps), *weights, SIM.array("uint16_t", smeared))
    spare = np.empty_like(scene) if doublings else smeared
    off = np.zeros(2)
    for apart in steps:
        first = np.round(-apart / 2 - off)
        off += first + apart / 2
        pair = np.concatenate([first, first + apart]).astype(np.int32)
        both = SIM.array("uint16_t", smeared), SIM.array("int32_t", pair, 4)
        SIM.lib.dl_sim_render_average(h, w, *both, SIM.array("uint16_t", spare))
        smeared, spare = spare, smeared
    return smeared


def _way_px(camera: Camera, first: F64, last: F64) -> tuple[float, float]:
    """Return the way in the frame from one point in `cam` to another, px."""
    if camera.distorted:
        right, down = np.diff(camera.project(np.array([first, last])), axis=0)[0].tolist()
        return right, down
    (x0, y0, z0), (x1, y1, z1) = first.tolist(), last.tolist()
    if min(z0, z1) <= 1e-3:
        return math.nan, math.nan
    return camera.fx * (x1 / z1 - x0 / z0), camera.fy * (y1 / z1 - y0 / z0)


def _smear_taps(way: F64) -> tuple[NDArray[np.int32], U16]:
    """Return the shifts (N, 2) px and the weights (N,), parts of 65536, that blur a scene along a straight way (2,) px."""
    half = math.floor(np.hypot(*way) / 2) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for s in (np.arange(64) + 0.5) / 64 - 0.5:
        x, y = half + way[0] * s, half + way[1] * s
        i, j = math.floor(x), math.floor(y)
        fx, fy = x - i, y - j
        for dj, di, share in ((0, 0, (1 - fx) * (1 - fy)), (0, 1, fx * (1 - fy)), (1, 0, (1 - fx) * fy), (1, 1, fx * fy)):
            kernel[j + dj, i + di] += share / 64
    weights = np.floor(65536.0 * kernel)
    rows, columns = np.nonzero(weights)
    return np.stack([columns - half, rows - half], axis=1).astype(np.int32), weights[rows, columns].astype(np.uint16)


def vignette(lens: Lens, loss: float) -> I16:
    """Return the (H, W) vignetting: the fourth power of the cosine of the angle off the axis, scaled to the corners' loss."""
    r2 = (lens.rays**2).sum(axis=-1)
    fall = 1.0 - (1.0 + r2) ** -2
    return np.asarray(np.round(DL_GAIN_ONE * (1.0 - loss * fall / fall.max())), dtype=np.int16)


def row_map(lens: Lens, first: Pose, middle: Pose, last: Pose) -> F32 | None:
    """Return where in the frame of one instant a rolling shutter looks, px; the deck's plane is seen.

    Args:
        first: pose of the pad while the first row is exposed.
        middle: pose in the middle of the readout.
        last: pose while the last row is exposed.

    Returns:
        Positions for the cells of `Lens.coarse`, (R, C, 2), or None if the deck's plane is not in front of the camera.
    """
    R, t = middle
    if not float(R[:, 2] @ t) > 0.02:
        return None
    coarse, c = lens.coarse, lens.camera
    s = (DL_CELL_PX * np.arange(-1, len(coarse) - 1) + (DL_CELL_PX - 1) / 2) * 2.0 / (c.height - 1) - 1.0
    M = in_row(pad_from_ray(first, middle, last), s.astype(np.float32)[:, None])
    x, y = coarse[..., 0], coarse[..., 1]
    q = [M[i, 0] * x + M[i, 1] * y + M[i, 2] for i in range(3)]
    there = np.stack([R[:, 0], R[:, 1], t], axis=1).astype(np.float32) @ np.stack(q).reshape(3, -1)
    uv = c.project(there.T.astype(float) / np.maximum(there[2:].T, 1e-6)).reshape(*coarse.shape)
    # Beyond the horizon no pixel meets the plane: those keep their own place.
    at = np.stack(np.meshgrid(*(DL_CELL_PX * np.arange(-1, n - 1) + (DL_CELL_PX - 1) / 2 for n in coarse.shape[1::-1])), axis=-1)
    sane = np.isfinite(uv).all(axis=-1) & (np.abs(uv - at).max(axis=-1) < 60.0) & (q[2] > 0) & (there[2] > 0).reshape(q[2].shape)
    return np.where(sane[..., None], uv, at).astype(np.float32)


def moved_scene(scene: U16, cells: F32) -> U16:
    """Return a scene (H, W, 4) as the rows of a rolling shutter see it; `cells` are the result of `row_map`."""
    h, w = scene.shape[:2]
    seen = np.empty_like(scene)
    whole, drawn = SIM.new("dl_sim_frame_part", w=w, x1=w, y1=h), SIM.new("dl_sim_drawing", texels=scene, h=h, w=w)
    where = SIM.new("dl_sim_plane_cells", at=cells, columns=cells.shape[1])
    SIM.lib.dl_sim_render_deck(whole, where, drawn, SIM.ffi.NULL, SIM.array("uint16_t", seen))
    return seen


def moved(image: NDArray[Any], rows: F32) -> NDArray[Any]:
    """Return an image as the rows of a rolling shutter see it; `rows` are the positions for all pixels, (H, W, 2)."""
    return np.asarray(cv2.remap(image, rows, np.empty(0, np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
