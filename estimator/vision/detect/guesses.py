"""Find circles, and guess poses of the pad from them: which of its circles one may be, at which heading, and how well it fits.

Circles are found by the votes of edges for their centres, in any light and without colour, and pads of some pixels by their area.
A pad of 12 to 40 px across that is seen obliquely has too few pixels for its edges to give the centre. It differs from its
surroundings as a whole: its area gives the centre, and the ellipse of the area's second moments gives the tilt.

A heading is found by comparing the drawing at all headings at once. The frame is sampled in polar cells around the candidate's
centre. For a given heading every cell belongs to one paint, and the score is the fraction of the variance between the paints
(one-way analysis of variance). The native core computes all of this (`estimator/core/vision/search`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import DL_NONE, DL_SEARCH_BLOCK, DL_SEARCH_LEVELS
from estimator.core.library import CORE
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.pyramid import U8, FrameView, Pyramid
from estimator.vision.detect.template import F32, disc_edge_m
from estimator.vision.native import checked, image_of, native_pose, tracker_of
from estimator.vision.pad.pad import Pad

_MOST_AREAS = 16
"""Largest number of outlines of areas. Of 280 pads at 10 and 15 m in any light nine in ten are among the first eight."""

MOST = 20
"""Largest number of guesses from the circles of one kind."""
_SAME_SHADE = 12.0  # Difference in luminance between two paints below which either may be the brighter
_BY_SUPPORT = 0.3  # Weight of a circle's support beside the drawing's score: from afar the drawing alone is weak evidence
_BY_FILLED = 0.1  # The same of an area's outline, which is a circle more often, whatever the area is

_HEADING_PX = 28.0  # Smallest radius of the disc in the frame that a heading is searched in


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane at unit distance from the lens, assumed parallel to the pad."""

    R_cam_plane: F64
    """Rotation (3, 3) whose z axis is the plane's normal, away from the lens."""
    known: bool
    """False if the plane merely faces the camera."""

    @staticmethod
    def of(camera: Camera, R_level_body: Rotation | None) -> Plane:
        """Return the plane of a level deck under a vehicle of known roll and pitch, or one facing the lens."""
        if R_level_body is None:
            return Plane(np.eye(3), False)
        return Plane(camera.T_body_cam.R.matrix.T @ R_level_body.matrix.T, True)

    @staticmethod
    def facing(normal_cam: F64) -> Plane:
        """Return the plane with this unit normal, turned as little as possible from the camera's axes."""
        axis = np.cross([0.0, 0.0, 1.0], normal_cam)
        s, c = float(np.linalg.norm(axis)), float(normal_cam[2])
        turn = axis * (math.atan2(s, c) / s) if s > 1e-9 else np.zeros(3)
        return Plane(Rotation.from_rotvec(turn).matrix, True)

    def met_by(self, xy: F64) -> F64:
        """Map (N, 2) rays to (N, 2) positions on the plane; nan where the ray misses it."""
        p = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ self.R_cam_plane
        return np.asarray(p[:, :2] / np.where(p[:, 2] > 0.15, p[:, 2], np.nan)[:, None])

    def pose(self, centre: F64, radius: float, radius_m: float) -> PadPose:
        """Return the pose of a pad whose circle of `radius_m` appears as this circle."""
        depth = radius_m / radius
        return PadPose(Rotation(self.R_cam_plane), self.R_cam_plane @ np.array([centre[0] * depth, centre[1] * depth, depth]))


class Circle(NamedTuple):
    """A circle of edges in a plane at unit distance, with the edges on its outline."""

    native: U8
    """The core's `dl_circle`, in bytes."""
    support: float
    radius: float


class Outline(Enum):
    """Outline that a circle belongs to."""

    EDGES = "edges in luminance"
    AREA = "an area that differs from what is around it"
    DISC = "the disc, by its colour"
    RING = "the ring, by the disc's colour"


class Guess(NamedTuple):
    """A rough pose of the pad, in plain numbers: a frame has many of them, and few are tried."""

    R_cam_pad: Sequence[float]
    """The rotation's rows, nine numbers, before the pad is turned."""
    t_cam_pad: Sequence[float]
    """The pad's centre in `cam`, three numbers, m."""
    turn_rad: float
    """Angle by which the pad is to be turned about its own z axis."""
    drawing: float
    """Fraction of the variance that the drawing explains, 0..1."""
    score: float
    """Score by which guesses are sorted."""
    tilt_known: bool
    support: float = 0.0
    """Support of the circle that it comes from, 0..1."""
    side: F64 | None = None
    """Unit direction, (2,), in x and y of the turned pad: only the half of the disc on this side is used, as the other is
    covered.
    """

    @property
    def flat(self) -> PadPose:
        """The pose before the pad is turned."""
        return PadPose(Rotation(np.array(self.R_cam_pad).reshape(3, 3)), np.array(self.t_cam_pad))

    @property
    def pose(self) -> PadPose:
        return self.flat.turned(self.turn_rad)


class Radii(Struct, frozen=True):
    """Radii that are searched for at one size of the frame, px of that size for a pad that faces the camera."""

    least_px: float
    ratio: float
    count: int


def edge_circles(
    grey: U8, step: int, camera: Camera, plane: Plane, radii: Radii, most: int, margin_px: int = 0, *, only_bright: bool = False
) -> list[Circle]:
    """Return the circles with the most edges, most prominent first.

    Args:
        grey: the frame, `step` times smaller than the camera's, (h, w).
        most: the largest number of circles.
        margin_px: how far beyond the frame's edge centres may lie, px of `grey`.
        only_bright: look only for circles that are brighter inside.
    """
    h, w = grey.shape
    how = CORE.ffi.new("dl_circle_search *", {
        "step": step, "margin": margin_px, "radii": radii.count, "most": most, "only_bright": only_bright,
        "least": radii.least_px * step / camera.fx, "ratio": radii.ratio, "R_cam_plane": plane.R_cam_plane.ravel().tolist(),
    })  # fmt: skip
    (out, circles), rays = CORE.room("dl_circle", most), _corner_rays(camera.optics, step, w, h)
    found = CORE.lib.dl_search_circles(tracker_of(camera), CORE.ffi.NULL, image_of(grey), CORE.array("float", rays), how, circles)
    return _circles_of(out[: checked(found)])


def _circles_of(rows: NDArray[Any]) -> list[Circle]:
    """Return the circles in structures `dl_circle` of the core, (n,)."""
    native = rows.view(np.uint8).reshape(len(rows), rows.itemsize)
    return list(map(Circle, native, rows["support"].tolist(), rows["radius"].tolist()))


@lru_cache(maxsize=16)
def _corner_rays(camera: Camera, step: int, width: int, height: int) -> F32:
    """Return the rays of the corners of the blocks, (rows + 1, columns + 1, 2)."""
    u, v = (np.arange(-(-side // DL_SEARCH_BLOCK) + 1) * DL_SEARCH_BLOCK for side in (width, height))
    uv: F64 = np.stack(np.meshgrid(u, v), axis=2).reshape(-1, 2).astype(float)
    rays = camera.rays(np.asarray((uv + 0.5) * step - 0.5)).reshape(len(v), len(u), 2).astype(np.float32)
    rays.setflags(write=False)
    return rays


def blob_circles(pyramid: Pyramid, camera: Camera, plane: Plane) -> list[Circle]:
    """Return the outlines of what stands out, most prominent first, as circles of edges.

    Their `support` is the fraction of the area of an ellipse with the same moments that is filled.
    """
    pyramid[1]
    how = CORE.ffi.new("dl_circle_search *", {
        "most": _MOST_AREAS, "grey": pyramid.monochrome, "R_cam_plane": plane.R_cam_plane.ravel().tolist()
    })  # fmt: skip
    (out, circles), none = CORE.room("dl_circle", _MOST_AREAS), CORE.ffi.NULL
    found = CORE.lib.dl_search_circles(tracker_of(camera), pyramid.native, none, none, how, circles)
    return _circles_of(out[: checked(found)])


def guesses_from(
    circles: Sequence[Circle], of: Outline, view: FrameView, plane: Plane, most: int = MOST, rated: dict[int, U8] | None = None
) -> list[Guess]:
    """Return guesses from circles: one for each circle of the drawing that one may be, in each plane that it may lie in.

    Circles behind one that fits well are left out.

    Args:
        circles: likeliest first.
        of: what they are outlines of.
        most: the largest number of guesses.
        rated: the core's guesses from circles of this frame and kind of outline, by `id` of the circle. They are not computed
            again, and those that are new are added. The circles have to live as long as it does.
    """
    if not circles:
        return []
    rated = {} if rated is None else rated
    known = [rated.get(id(circle)) for circle in circles]
    counts = np.array([DL_NONE if rows is None else len(rows) for rows in known], np.int64)
    some = [rows for rows in known if rows is not None and len(rows)]
    native, before = np.concatenate([circle.native for circle in circles]), np.concatenate(some) if some else None
    out = compared(native, counts, before, of, view, plane, most)
    n, first = len(out), 0
    for circle, count in zip(circles, counts.tolist(), strict=True):
        if count < 0 or first + count > n:
            break
        rated[id(circle)] = out[first : first + count]
        first += count
    return guesses_of(out, _BY_FILLED if of is Outline.AREA else _BY_SUPPORT)


def compared(
    circles: U8, counts: NDArray[np.int64], before: U8 | None, of: Outline, view: FrameView, plane: Plane, most: int
) -> U8:
    """Return the core's guesses from circles in bytes, (n, bytes); `counts` says how many each has, and then how many it got."""
    pyramid, camera, pad = view
    pyramid[DL_SEARCH_LEVELS - 1]
    radius_m, sign = _circles(pad, of)
    how = CORE.ffi.new("dl_guess_search *", {
        "plane_known": plane.known, "radii": len(radius_m), "most": most, "before": 0 if before is None else len(before),
        "R_cam_plane": plane.R_cam_plane.ravel().tolist(), "radius_m": radius_m, "sign": sign,
    })  # fmt: skip
    out, guesses = CORE.block("dl_guess", most)
    n = checked(CORE.lib.dl_search_guesses(
        tracker_of(camera, pad), pyramid.native, how, len(counts), CORE.ffi.from_buffer("dl_circle[]", circles),
        CORE.array("int64_t", counts), CORE.ffi.NULL if before is None else CORE.ffi.from_buffer("dl_guess[]", before), guesses,
    ))  # fmt: skip
    return out.reshape(most, -1)[:n]


def guesses_of(native: U8, by_support: float = _BY_SUPPORT) -> list[Guess]:
    """Return the guesses in structures `dl_guess` of the core, (n, bytes).

    Args:
        by_support: weight of the circle's support beside the drawing's score.
    """
    rows = np.ndarray((len(native),), CORE.dtype("dl_guess"), native)
    columns = (rows[name].tolist() for name in ("known", "one_sided", "R", "t", "turn_rad", "drawing", "support", "side"))
    found = []
    for known, one_sided, R, t, turn, drawing, support, side in zip(*columns, strict=True):
        half = np.array(side) if one_sided else None
        found.append(Guess(R, t, turn, drawing, drawing + by_support * support, known, support, half))
    return found


@lru_cache(maxsize=16)
def _circles(pad: Pad, of: Outline) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the drawing's circles: radii, and 1 if brighter inside, -1 if darker, 0 if that depends on the deck."""
    marks = pad.markings
    if of is Outline.RING:
        return (marks.ring_outer_m, marks.ring_inner_m), (-1.0, 1.0)
    if of is Outline.DISC:
        return (disc_edge_m(pad),), (1.0,)
    paints = np.array([[marks.colours.ring[::-1], marks.colours.disc[::-1]]], np.uint8)
    ring, disc = cv2.cvtColor(paints, cv2.COLOR_BGR2GRAY)[0].tolist()
    over = ring - disc
    sign = 0.0 if abs(over) < _SAME_SHADE else math.copysign(1.0, over)
    if of is Outline.AREA and marks.is_searched_by_parts and marks.is_h:
        # On a deck as bright as the disc the area is ring and H, blurred into one: of some size from the H's to the ring's.
        h_m, ring_m = 0.5 * math.hypot(marks.h_length_m, marks.h_width_m), marks.ring_inner_m
        return (disc_edge_m(pad), ring_m, math.sqrt(ring_m * h_m), h_m), (0.0, sign, sign, sign)
    edge = [(disc_edge_m(pad), 0.0)] if marks.field_radius_m or not marks.ring_outer_m else []
    rings = [(marks.ring_outer_m, sign), (marks.ring_inner_m, -sign)] if marks.ring_outer_m else []
    radii, signs = zip(*edge, *rings, strict=True)
    return radii, signs


def heading(view: FrameView, pose: PadPose) -> Any:
    """Return the core's `dl_polar_fit` of the best heading of the drawing at a pose; None if hardly any of it is in view."""
    pyramid, camera, pad = view
    level, out = (
        max(0, math.floor(math.log2(max(pose.px_of(pad.disc_radius_m, camera), 1.0) / _HEADING_PX))),
        CORE.ffi.new("dl_polar_fit *"),
    )
    image, pose_at = image_of(pyramid[level]), native_pose(pose)
    found = CORE.lib.dl_search_heading(tracker_of(camera, pad), image, 1 << level, pose_at, CORE.ffi.NULL, out)
    return out if checked(found) else None
