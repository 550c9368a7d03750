"""Guess poses of the pad from circles of edges: which of its circles one may be, at which heading, and how well it fits.

The native core computes them (`estimator/core/vision/search/guesses.c`, `tilt.c` there).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import SEARCH_LEVELS
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect.edge_circles import EdgeCircle
from estimator.vision.detect.heading import packed_drawing
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.template import disc_edge_m
from estimator.vision.native import address, packed_camera, pixels
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

_GUESSES = CORE.function("search_guesses")
_WORDS, _AT = size_of("search_guess"), places_of("search_guess")
_TURN, _DRAWING, _SUPPORT = (_AT[name].start for name in ("turn_rad", "drawing", "support"))
_ROTATION, _CENTRE, _SIDE = _AT["R"], _AT["t"], _AT["side"]
_R_CAM_PLANE = places_of("search_frame")["R_cam_plane"]

MOST = 20
"""Largest number of guesses from the circles of one kind."""
_SAME_SHADE = 12.0
"""Difference in luminance between two paints below which either may be the brighter."""
_BY_SUPPORT, _BY_FILLED = 0.3, 0.1
"""Weight of a circle's support beside the drawing's score: from afar the drawing alone is weak evidence. The outline of an area
is one more often, whatever the area is.
"""


class Outline(Enum):
    """What a circle is the outline of."""

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
    """What guesses are ordered by."""
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


def guesses_from(
    circles: Sequence[EdgeCircle],
    of: Outline,
    pyramid: Pyramid,
    camera: Camera,
    pad: Pad,
    plane: Plane,
    most: int = MOST,
    rated: dict[int, F64] | None = None,
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
    counts = np.array([-1 if rows is None else len(rows) for rows in known], np.int64)
    some = [rows for rows in known if rows is not None and len(rows)]
    levels = [pyramid[level] for level in range(SEARCH_LEVELS)]
    at = [pixels(px) for px in levels]
    frame = _frame(pad, of, plane.known, tuple((px.shape[1], px.shape[0], px.strides[0]) for px in levels)).copy()
    frame[_R_CAM_PLANE] = plane.R_cam_plane.ravel()
    found = np.array([circle.words for circle in circles])
    starts, out = np.array([start for start, _ in at], np.int64), np.empty((most, _WORDS))
    before = np.concatenate(some) if some else out
    n = _GUESSES(
        address(packed_camera(camera)), address(packed_drawing(pad)), start_of(frame), start_of(starts), len(found),
        start_of(found), start_of(counts), start_of(before), most, start_of(out),
    )  # fmt: skip
    first = 0
    for circle, count in zip(circles, counts.tolist(), strict=True):
        if count < 0 or first + count > n:
            break
        rated[id(circle)] = out[first : first + count]
        first += count
    return guesses_of(out[:n], _BY_FILLED if of is Outline.AREA else _BY_SUPPORT)


def guesses_of(rows: F64, by_support: float = _BY_SUPPORT) -> list[Guess]:
    """Return the guesses in structures `search_guess` of the core, (n, words).

    Args:
        by_support: weight of the circle's support beside the drawing's score.
    """
    found = []
    for (known, one_sided), words in zip(rows[:, :2].view(np.int64).tolist(), rows.tolist(), strict=True):
        drawing, support = words[_DRAWING], words[_SUPPORT]
        side = np.array(words[_SIDE]) if one_sided else None
        score = drawing + by_support * support
        found.append(Guess(words[_ROTATION], words[_CENTRE], words[_TURN], drawing, score, bool(known), support, side))
    return found


@lru_cache(maxsize=16)
def _frame(pad: Pad, of: Outline, plane_known: bool, sizes: tuple[tuple[int, int, int], ...]) -> F64:
    """Return the core's `search_frame` without the plane.

    Args:
        sizes: width, height and bytes from row to row of each level.
    """
    (radius_m, sign), (width, height, stride) = _circles(pad, of), zip(*sizes, strict=True)
    return record("search_frame", {
        "levels": SEARCH_LEVELS, "plane_known": plane_known, "radii": len(radius_m), "width": width, "height": height,
        "stride": stride, "radius_m": radius_m, "sign": sign,
    })  # fmt: skip


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
