"""Convert a registration to a sighting: transform it from the camera to `level`, including the attitude's uncertainty."""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, skew, wrap_pi
from estimator.contracts.samples import Frame
from estimator.vision.camera import Camera
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import Registration
from estimator.vision.register.tilt import roll_pitch, tilt_axes

_WORTH = {EdgeKind.DISC: 0.4, EdgeKind.RING: 0.6, EdgeKind.ARROW: 0.4, EdgeKind.H: 0.6}
"""Weight of each kind of edge as evidence that this is the pad and no other round or white thing."""

_EYE, _THRICE = np.eye(2), 3.0 * np.eye(3)
_QUARTER_TURN = -np.array([[0.0, 1.0], [-1.0, 0.0]])


def registered_sighting(frame: Frame, found: Registration, camera: Camera, orientation: Orientation) -> Sighting:
    """Return the sighting of method "registration".

    Args:
        orientation: attitude at the exposure and the deck's expected tilt; the same that `register` had as prior.
    """
    features = tuple(
        Feature("outline" if kind is not EdgeKind.H else "point", kind.name.lower(), _finite(uv))
        for kind, uv in zip(EdgeKind, found.outline_px, strict=True)
    )
    return sighting_of(
        frame, found.pose, found.cov, camera, orientation, found.yaw_ambiguous, confidence(found), features=features
    )


def sighting_of(
    frame: Frame,
    pose: PadPose,
    cov_pose: F64,
    camera: Camera,
    orientation: Orientation,
    ambiguous: bool,
    sure: float,
    features: tuple[Feature, ...] = (),
) -> Sighting:
    """Return the sighting of a pose in the camera's axes.

    The difference between the deck's tilt in the frame and the attitude's prediction is split between the errors of both, by
    their variances. The covariance holds the attitude's remaining error in position, heading and tilt, correlations included.

    Args:
        cov_pose: (6, 6) covariance of the pad's centre and of a small rotation of the pad, both in `cam`.
        ambiguous: whether the heading may be half a turn off.
        sure: the sighting's confidence, 0..1.
    """
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
    R_level_pad = Rotation(_nearest(R_level_cam @ R_cam_pad))

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

    x, y, z = R_level_pad.matrix[:, 0].tolist()
    flat2 = max(x * x + y * y, 1e-9)
    to4 = np.zeros((4, 6))
    to4[0, 0] = to4[1, 1] = to4[2, 2] = 1.0
    # This row is the effect of a small rotation in `level` on the arrow's azimuth; the heading has the opposite sign.
    to4[3, 3:] = x * z / flat2, y * z / flat2, -(x * x + y * y) / flat2
    cov = _symmetric(to4 @ cov6 @ to4.T)
    yaw: float | None = wrap_pi(-math.atan2(y, x))
    if cov[3, 3] > 0.5:
        yaw, ambiguous = None, False
        cov[3, :] = cov[:, 3] = 0.0
        cov[3, 3] = UNKNOWN_YAW_VAR
    pose6 = Pose6(d, R_level_pad, cov6)
    return Sighting(frame.stamp, frame.seq, "registration", pose6.d_body_pad_level, yaw, ambiguous, cov, sure, pose6, features)


def confidence(found: Registration) -> float:
    """Return 0..1 from the visible edges: it grows with the number of kinds and falls with the fraction that disagrees."""
    doubt = 1.0
    for kind, evidence in found.edges.items():
        if evidence.seen:
            doubt *= 1.0 - _WORTH[kind] * evidence.inliers
    return max(0.0, min(1.0, (1.0 - doubt) * min(1.0, found.inliers / 0.6)))


def _finite(uv: F64) -> F64:
    if uv.size == 0:
        return uv
    ok = np.isfinite(uv)
    return uv if ok.all() else uv[ok.all(axis=1)]


def _nearest(m: F64) -> F64:
    """Return the nearest rotation by one Newton step; the matrix is a product of a few rotations (Higham 1986)."""
    return np.asarray(0.5 * m @ (_THRICE - m.T @ m))


def _symmetric(m: F64) -> F64:
    return np.asarray(0.5 * (m + m.T))
