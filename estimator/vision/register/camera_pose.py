"""The pose of the pad in the camera's axes, recovered from a sighting of a registered frame."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, skew
from estimator.vision.camera import Camera
from estimator.vision.pose import Orientation
from estimator.vision.register.tilt import roll_pitch, tilt_axes

_STEPS = 30
_SAME = 1e-13
_QUARTER_TURN = -np.array([[0.0, 1.0], [-1.0, 0.0]])


class CameraPose(NamedTuple):
    """The pad as the camera alone saw it; neither the attitude nor the mount is in it."""

    R_cam_pad: F64
    """(3, 3)."""
    t_cam_pad: F64
    """(3,) m."""
    cov: F64
    """(6, 6): [t_cam_pad (m), small rotation of the pad written in `cam` (rad)]."""


def camera_pose(sighting: Sighting, camera: Camera, orientation: Orientation) -> CameraPose | None:
    """Return the pose that `sighting_of` made this sighting of; None without a full pose.

    A sighting is levelled by the attitude and by a share of what the pad's normal says against it. Both are undone.

    Args:
        camera, orientation: the same that the sighting was made with.
    """
    if sighting.pose6 is None:
        return None
    axes, C = tilt_axes(orientation), orientation.cov_tilt
    A = _QUARTER_TURN @ axes[:2]
    gain = C @ A.T @ np.linalg.inv(A @ C @ A.T + (orientation.sigma_deck_rad**2 + 1e-12) * np.eye(2))
    R_level_pad = sighting.pose6.R_level_pad.matrix
    turn, normal = _undone(R_level_pad[:, 2], axes @ gain)
    R_level_body = roll_pitch(orientation)
    before = R_level_body @ camera.T_body_cam.R.matrix
    R_level_cam = turn @ before
    d = sighting.d_body_pad_level
    t = R_level_cam.T @ (d - turn @ (R_level_body @ camera.T_body_cam.t))

    # The sighting's errors are J (pose, attitude left) with the attitude's share through `back`: see `sighting_of`.
    to_attitude = np.zeros((6, 2))
    to_attitude[:3], to_attitude[3:] = -skew(d) @ axes, axes
    M = np.zeros((6, 6))
    M[:3, :3] = M[3:, 3:] = R_level_cam
    M[:, 3:] += to_attitude @ (gain @ (-skew(normal) @ R_level_cam)[:2])
    own = sighting.pose6.cov - to_attitude @ (C - gain @ A @ C) @ to_attitude.T
    back = np.linalg.inv(M)
    cov = back @ own @ back.T
    return CameraPose(R_level_cam.T @ R_level_pad, t, 0.5 * (cov + cov.T))


def _undone(turned: F64, axes_gain: F64) -> tuple[F64, F64]:
    """Return the turn that the attitude's share of the normal made, and the normal before it, by a fixed point."""
    normal = turned
    turn = np.eye(3)
    for _ in range(_STEPS):
        turn = np.asarray(cv2.Rodrigues(axes_gain @ normal[:2])[0])
        again = turn.T @ turned
        if float(np.abs(again - normal).max()) < _SAME:
            break
        normal = again
    return turn, normal
