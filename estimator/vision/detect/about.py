"""Guess the pose of a small pad about a place where it is expected, of which a half may be covered or in glare.

From afar the pad is some pixels across, and a belief that is off by two of them starts neither alignment nor the search for what
covers a part. The drawing is compared at each place about the expected one, with the whole disc and with each half of it.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.interface import places_of, size_of
from estimator.vision.camera import Camera
from estimator.vision.detect.edge_circles import EdgeCircle
from estimator.vision.detect.guesses import Guess, Outline, guesses_from
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.template import disc_edge_m
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

_WORDS, _AT = size_of("search_circle"), places_of("search_circle")
_REACH_PX, _STEP_PX = 4.0, 1.5
"""How far from the expected place the drawing is compared, and how far apart: alignment starts from a pixel off."""
_SIDES = 4
"""Directions of the half that is taken for the one in view."""
_OUTLINE = 3
"""Points of a half's outline, which tell the direction."""
_MOST_TURNED_RAD = 0.5
"""Largest heading of a guess relative to the expected one, modulo half a turn."""


def pose_about(pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane, expected: PadPose) -> tuple[PadPose, float] | None:
    """Return the pose about an expected one that the drawing explains best, and the fraction of the variance that it explains.

    Args:
        plane: of a measured attitude.
        expected: its distance and heading are taken for about right.

    Returns:
        None if the lens does not show the expected place, or no heading near the expected one fits best anywhere.
    """
    middle = camera.project(expected.t_cam_pad[None])[0]
    if not np.isfinite(middle).all():
        return None
    circles = _circles(middle, camera, pad, plane, expected)
    guesses = guesses_from(circles, Outline.DISC, pyramid, camera, pad, plane, len(circles))
    for guess in sorted(guesses, key=lambda g: -g.drawing):
        turn = _turned(guess, expected)
        if abs(turn) < _MOST_TURNED_RAD:
            return PadPose(expected.R_cam_pad, np.array(guess.t_cam_pad)).turned(turn), guess.drawing
    return None


def _turned(guess: Guess, expected: PadPose) -> float:
    """Return the angle by which the expected pose is to be turned for a guess's heading, -quarter to quarter of a turn."""
    yaw = float((expected.R_cam_pad.inv @ guess.pose.R_cam_pad).rpy_rad[2])
    return (yaw + 0.5 * math.pi) % math.pi - 0.5 * math.pi


@lru_cache(maxsize=1)
def _offsets_px() -> F64:
    """Return places about the middle, and for each the direction of the half in view, (N, 4): nan where it is the whole disc."""
    most = math.floor(_REACH_PX / _STEP_PX)
    steps = _STEP_PX * np.arange(-most, most + 1)
    angles = 2.0 * math.pi * np.arange(_SIDES) / _SIDES
    sides = [(math.nan, math.nan), *zip(np.cos(angles).tolist(), np.sin(angles).tolist(), strict=True)]
    out = np.array([(u, v, *side) for u in steps for v in steps if math.hypot(u, v) <= _REACH_PX for side in sides])
    out.setflags(write=False)
    return out


def _circles(middle: F64, camera: Camera, pad: Pad, plane: Plane, expected: PadPose) -> list[EdgeCircle]:
    """Return the disc at each place about the middle, px, once as a whole and once with an outline on each side alone."""
    offsets = _offsets_px()
    rays = camera.rays(middle + offsets[:, :2])
    on_plane = np.c_[rays, np.ones(len(rays))] @ plane.R_cam_plane
    radius_px = expected.disc_px(camera, pad)
    depth = float((plane.R_cam_plane.T @ expected.t_cam_pad)[2])
    words = np.zeros((len(offsets), _WORDS))
    half = np.isfinite(offsets[:, 2])
    integers = words.view(np.int64)
    integers[:, _AT["bright_inside"].start] = 1
    integers[:, _AT["points"].start] = np.where(half, _OUTLINE, 0)
    words[:, _AT["centre"]] = on_plane[:, :2] / on_plane[:, 2:]
    words[:, _AT["radius"].start] = disc_edge_m(pad) / depth
    words[:, _AT["support"].start] = np.where(half, 0.5, 1.0)
    turns = np.arctan2(offsets[:, 3], offsets[:, 2])[:, None] + np.array([-1.0, 0.0, 1.0])
    outline = (middle + offsets[:, :2])[:, None] + radius_px * np.stack([np.cos(turns), np.sin(turns)], axis=2)
    words[:, _AT["outline_px"]][:, : 2 * _OUTLINE] = np.nan_to_num(outline.reshape(len(offsets), -1))
    return [EdgeCircle(row) for row in words]
