"""The axes of ROS (REP-103): x forward, y left, z up on a body, and east, north, up on the Earth.

Our `body` and `level` are forward-right-down, `ned` is north-east-down, `pad` has z into the deck. In each of the first two and
in `pad`, half a turn about x leads to the axes of ROS, so one matrix converts them all. Our `cam` has the axes of an optical
frame of ROS as it is.

Frames (REP-105): `base_link` is the body, `base_stabilized` the same without roll and pitch, `deck` the pad with z up, `map`
east-north-up; `camera_optical_frame` is the camera, and `range_down` has x along the range sensor's beam.
"""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR
from estimator.contracts.geometry import F64, Rotation

BODY, LEVEL, DECK, MAP = "base_link", "base_stabilized", "deck", "map"
CAMERA, BEAM = "camera_optical_frame", "range_down"

UP = np.diag([1.0, -1.0, -1.0])
"""Takes forward-right-down to forward-left-up, and back."""
_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
R_BODY_BEAM = Rotation.from_rpy(0.0, 0.5 * math.pi, 0.0)
"""The rotation from `range_down` to `base_link`: the beam's x axis points down."""


def up(v: F64) -> F64:
    """Return a vector (3,) of `body`, `level` or `pad` in the axes of ROS."""
    return UP @ v


def up_cov(cov: F64) -> F64:
    """Return a covariance (3, 3) of `body`, `level` or `pad` in the axes of ROS."""
    return np.asarray(UP @ cov @ UP)


def body_in_level(R_ned_body: Rotation) -> Rotation:
    """Return the rotation from `base_link` to `base_stabilized` of an attitude: its roll and pitch."""
    return Rotation(UP @ R_ned_body.without_heading().matrix @ UP)


def enu(v_ned: F64) -> F64:
    """Return a vector (3,) of `ned` as east, north, up."""
    return np.asarray(_ENU_NED @ v_ned)


def enu_cov(cov_ned: F64) -> F64:
    """Return a covariance (3, 3) of `ned` in east, north, up."""
    return np.asarray(_ENU_NED @ cov_ned @ _ENU_NED.T)


def enu_attitude(R_ned_body: Rotation) -> Rotation:
    """Return the rotation from `base_link` to `map` of an attitude."""
    return Rotation(_ENU_NED @ R_ned_body.matrix @ UP)


def camera_rotation(R_body_cam: Rotation) -> Rotation:
    """Return the rotation from `camera_optical_frame` to `base_link` of a camera's mount."""
    return Rotation(UP @ R_body_cam.matrix)


def deck_heading(yaw_rad: float) -> Rotation:
    """Return the rotation from `base_stabilized` to `deck`, from the heading against the arrow, clockwise seen from above."""
    return Rotation.from_rpy(0.0, 0.0, -yaw_rad)


def pad_in_level(cov: F64) -> F64:
    """Return the covariance (6, 6) of the pad's pose in `base_stabilized`: x, y, z in m, then rotations about them in rad.

    The pad's tilt is not estimated; it has the variance of an angle that could be anything.

    Args:
        cov: the covariance (4, 4) of [forward, right, down, yaw] in m and rad, or (7, 7) with the velocity before the yaw.
    """
    keep = [0, 1, 2, -1]
    # The pad turns to the left in `base_stabilized` by as much as the body's heading turns to the right on the pad.
    signs = np.diag([1.0, -1.0, -1.0, 1.0])
    return _padded(signs @ cov[np.ix_(keep, keep)] @ signs)


def level_in_deck(d_body_pad_level: F64, yaw_rad: float, cov: F64) -> tuple[F64, F64]:
    """Return the place (3,) m of `base_stabilized` in `deck`, and the covariance (6, 6) of its pose.

    Args:
        d_body_pad_level: the vector (3,) m to the pad.
        yaw_rad: the heading against the arrow.
        cov: the covariance (7, 7) of [d, v, yaw].
    """
    R, d = deck_heading(yaw_rad).matrix, up(d_body_pad_level)
    # The place is -R d, and R turns with the heading: d/d(heading) of R d is z x (R d).
    turned = np.cross([0.0, 0.0, 1.0], R @ d)
    J = np.zeros((4, 4))
    J[:3, :3] = -R @ UP
    J[:3, 3] = turned
    J[3, 3] = -1.0
    keep = [0, 1, 2, 6]
    return -(R @ d), _padded(J @ cov[np.ix_(keep, keep)] @ J.T)


def _padded(cov: F64) -> F64:
    """Return a covariance (6, 6) of a pose from that (4, 4) of place and heading."""
    out = np.zeros((6, 6))
    out[:3, :3], out[:3, 5], out[5, :3], out[5, 5] = cov[:3, :3], cov[:3, 3], cov[3, :3], cov[3, 3]
    out[3, 3] = out[4, 4] = UNKNOWN_YAW_VAR
    return out
