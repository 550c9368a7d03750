"""A pose of the pad in the camera's axes brought to `level`, by numpy."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from estimator.contracts.geometry import F64, skew
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation, roll_pitch, tilt_axes

_EYE, _THRICE = np.eye(2), 3.0 * np.eye(3)
_QUARTER_TURN = -np.array([[0.0, 1.0], [-1.0, 0.0]])


class LevelPose(NamedTuple):
    """The pad in `level`."""

    d: F64
    R_level_pad: F64
    cov_pose: F64
    yaw_rad: float
    cov: F64


def in_level(pose: PadPose, cov_pose: F64, camera: Camera, orientation: Orientation) -> LevelPose:
    """Return the pose in `level`, and the covariances of (place, rotation) and of (place, heading)."""
    R_level_body = roll_pitch(orientation)
    R_level_cam = R_level_body @ camera.T_body_cam.R.matrix
    R_cam_pad, t = pose.R_cam_pad.matrix, pose.t_cam_pad
    axes, C = tilt_axes(orientation), orientation.cov_tilt

    normal = R_level_cam @ R_cam_pad[:, 2]
    # An error e of the attitude turns the normal by (axes @ e) x z; the remainder is the deck's own tilt.
    A = _QUARTER_TURN @ axes[:2]
    gain = C @ A.T @ np.linalg.inv(A @ C @ A.T + (orientation.sigma_deck_rad**2 + 1e-12) * _EYE)
    turn = cv2.Rodrigues(axes @ (gain @ normal[:2]))[0]
    R_level_cam = turn @ R_level_cam
    d = R_level_cam @ t + turn @ (R_level_body @ camera.T_body_cam.t)
    R_level_pad = _nearest(R_level_cam @ R_cam_pad)

    # Errors of (t_cam_pad, rotation, attitude) map to those of (d_body_pad_level, rotation of the pad in level).
    back = np.zeros((2, 6))
    back[:, 3:] = gain @ (-skew(normal) @ R_level_cam)[:2]
    joint = np.zeros((8, 8))
    joint[:6, :6] = cov_pose
    joint[6:, :6] = crossed = back @ cov_pose
    joint[:6, 6:] = crossed.T
    joint[6:, 6:] = crossed @ back.T + C - gain @ A @ C
    J = np.zeros((6, 8))
    J[:3, :3] = J[3:, 3:6] = R_level_cam
    J[:3, 6:] = -skew(d) @ axes
    J[3:, 6:] = axes
    cov6 = _symmetric(J @ joint @ J.T)

    x, y, z = R_level_pad[:, 0].tolist()
    flat2 = max(x * x + y * y, 1e-9)
    to4 = np.zeros((4, 6))
    to4[0, 0] = to4[1, 1] = to4[2, 2] = 1.0
    # This row is the effect of a small rotation in `level` on the arrow's azimuth; the heading has the opposite sign.
    to4[3, 3:] = x * z / flat2, y * z / flat2, -(x * x + y * y) / flat2
    cov = _symmetric(to4 @ cov6 @ to4.T)
    return LevelPose(d, R_level_pad, cov6, -math.atan2(y, x), cov)


def _nearest(m: F64) -> F64:
    return np.asarray(0.5 * m @ (_THRICE - m.T @ m))


def _symmetric(m: F64) -> F64:
    return np.asarray(0.5 * (m + m.T))
