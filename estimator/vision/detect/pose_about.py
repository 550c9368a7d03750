"""Find the pose of a small pad at each place about the expected one, with the whole disc and with each half of it.

From afar the pad is some pixels across, and a belief that is off by two of them starts neither alignment nor the search for what
covers a part. A pad in glare or half covered is found so.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_NONE
from estimator.core.library import CORE
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.guesses import Outline, Plane, compared, guesses_of
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.template import disc_edge_m
from estimator.vision.pad.pad import Pad

_REACH_PX = 4.0  # Largest shift at which the drawing is compared with the expected place
_STEP_PX = 1.5  # Step of the shifts: alignment starts within a pixel
_SIDES = 4  # Directions of the half that is taken for the one in view
_OUTLINE = 3  # Points of a half's outline, which give the direction
_MOST_TURNED_RAD = 0.5  # Largest heading of a guess relative to the expected one, modulo half a turn


def pose_about(view: FrameView, plane: Plane, expected: PadPose) -> tuple[PadPose, float] | None:
    """Return the pose about an expected one that the drawing explains best, and the fraction of the variance that it explains.

    Args:
        plane: of a measured attitude.
        expected: its distance and heading are taken for about right.

    Returns:
        None if the lens does not show the expected place, or no heading near the expected one fits best anywhere.
    """
    _, camera, pad = view
    middle = camera.project(expected.t_cam_pad[None])[0]
    if not np.isfinite(middle).all():
        return None
    circles = _circles_about(middle, camera, pad, plane, expected)
    counts = np.full(len(circles), DL_NONE, np.int64)
    native = compared(circles.view(np.uint8), counts, None, Outline.DISC, view, plane, len(circles))
    drawing = np.ndarray((len(native),), CORE.dtype("dl_guess"), native)["drawing"]
    for k in np.argsort(-drawing, kind="stable").tolist():
        guess = guesses_of(native[k : k + 1])[0]
        yaw = float((expected.R_cam_pad.inv @ guess.pose.R_cam_pad).rpy_rad[2])
        turn = math.remainder(yaw, math.pi)
        if abs(turn) < _MOST_TURNED_RAD:
            return PadPose(expected.R_cam_pad, np.array(guess.t_cam_pad)).turned(turn), guess.drawing
    return None


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


def _circles_about(middle: F64, camera: Camera, pad: Pad, plane: Plane, expected: PadPose) -> NDArray[Any]:
    """Return the core's circles of the disc at each place about the middle, px: the whole, and with an outline on one side."""
    offsets = _offsets_px()
    rays = camera.rays(middle + offsets[:, :2])
    on_plane = np.c_[rays, np.ones(len(rays))] @ plane.R_cam_plane
    radius_px = expected.px_of(pad.disc_radius_m, camera)
    depth = float((plane.R_cam_plane.T @ expected.t_cam_pad)[2])
    out, half = np.zeros(len(offsets), CORE.dtype("dl_circle")), np.isfinite(offsets[:, 2])
    out["bright_inside"] = 1
    out["points"] = np.where(half, _OUTLINE, 0)
    out["centre"] = on_plane[:, :2] / on_plane[:, 2:]
    out["radius"] = disc_edge_m(pad) / depth
    out["support"] = np.where(half, 0.5, 1.0)
    turns = np.arctan2(offsets[:, 3], offsets[:, 2])[:, None] + np.array([-1.0, 0.0, 1.0])
    outline = (middle + offsets[:, :2])[:, None] + radius_px * np.stack([np.cos(turns), np.sin(turns)], axis=2)
    out["outline_px"][:, : 2 * _OUTLINE] = np.nan_to_num(outline.reshape(len(offsets), -1))
    return out
