"""Guess poses of the pad from circles of edges: which of its circles one may be, at which heading, and how well it fits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.detect.edge_circles import EdgeCircle
from estimator.vision.detect.heading import heading
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.template import disc_edge_m
from estimator.vision.detect.tilted import tilted_circles
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

_SHARP_PX = 20.0
"""Least radius of a disc at the size of the frame that its drawing is compared at."""
_SAME_SHADE = 12.0
"""Difference in luminance between two paints below which either may be the brighter."""
_COVERED = 0.8
"""Support of a circle below which half of the disc is taken to be covered."""
_ONE_SIDED = 0.2
"""Least distance from a circle's centre to the mean of its edges, in radii, if they lie on one side."""
_BY_SUPPORT = 0.3
"""Weight of a circle's support beside the drawing's score: from afar the drawing alone is weak evidence."""


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """A rough pose of the pad."""

    flat: PadPose
    turn_rad: float
    """Angle by which the pad is to be turned about its own z axis relative to `flat`."""
    drawing: float
    """Fraction of the variance that the drawing explains, 0..1."""
    score: float
    """What guesses are ordered by."""
    tilt_known: bool
    side: F64 | None = None
    """Unit direction, (2,), in x and y of the turned pad: only the half of the disc on this side is used, as the other is
    covered.
    """

    @property
    def pose(self) -> PadPose:
        return self.flat.turned(self.turn_rad)


def guesses_from(
    circle: EdgeCircle, by_colour: bool, pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane
) -> Iterator[Guess]:
    """Yield guesses from a circle: one for each circle of the drawing that it may be, in each plane that it may lie in.

    Args:
        by_colour: the circle was found in the measure of the disc's colour, not in luminance.
    """
    seen = [(plane, circle.centre, circle.radius)]
    if not plane.known:
        seen += tilted_circles(circle.outline_px, camera)
    for stand, centre, radius in seen:
        side = _side(circle, stand, centre, radius, camera)
        for radius_m, sign in _circles(pad, by_colour):
            if sign != (-1 if circle.bright_inside else 1):
                pose = stand.pose(centre, radius, radius_m)
                guess = _guess(pose, stand.known, circle.support, pyramid, camera, pad, side)
                if guess is not None:
                    yield guess


def _circles(pad: Pad, by_colour: bool) -> list[tuple[float, int]]:
    """Return the circles of the drawing: radius, and 1 if it is brighter inside, -1 if darker, 0 if that depends on the deck."""
    marks = pad.markings
    if by_colour:
        return [(disc_edge_m(pad), 1)]
    paints = np.array([[marks.colours.ring[::-1], marks.colours.disc[::-1]]], np.uint8)
    ring, disc = cv2.cvtColor(paints, cv2.COLOR_BGR2GRAY)[0].tolist()
    over = ring - disc
    sign = 0 if abs(over) < _SAME_SHADE else int(math.copysign(1, over))
    rings = [(marks.ring_outer_m, sign), (marks.ring_inner_m, -sign)] if marks.ring_outer_m else []
    return [(disc_edge_m(pad), 0), *rings] if marks.field_radius_m or not rings else rings


def _side(circle: EdgeCircle, plane: Plane, centre: F64, radius: float, camera: Camera) -> F64 | None:
    """Return the unit direction, (2,), from a circle's centre to its edges if these lie on one side only."""
    if circle.support > _COVERED:
        return None
    places = plane.places(camera, circle.outline_px) - centre
    toward = places[np.isfinite(places).all(axis=1)].mean(axis=0)
    length = float(np.hypot(*toward))
    return toward / length if length > _ONE_SIDED * radius else None


def _guess(
    pose: PadPose, tilt_known: bool, support: float, pyramid: Pyramid, camera: Camera, pad: Pad, side: F64 | None
) -> Guess | None:
    radius_px = camera.fx * pad.disc_radius_m / float(pose.t_cam_pad[2])
    level = max(0, math.floor(math.log2(radius_px / _SHARP_PX))) if math.isfinite(radius_px) and radius_px > 1.0 else 0
    best = heading(pyramid[level], 1 << level, camera, pad, pose, side)
    if best is None:
        return None
    if side is not None:
        c, s = math.cos(best.turn_rad), math.sin(best.turn_rad)
        side = np.array([c * side[0] + s * side[1], c * side[1] - s * side[0]])
    return Guess(pose, best.turn_rad, best.score, best.score + _BY_SUPPORT * support, tilt_known, side)
