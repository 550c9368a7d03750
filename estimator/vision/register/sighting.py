"""Convert a registration to a sighting: transform it from the camera to `level`, including the attitude's uncertainty."""

from __future__ import annotations

import struct

import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, Method, Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Frame
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.vision.camera import Camera
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.look import Looked

_IN_LEVEL = CORE.function("sighting_in_level")
_PLACES, _SIZE = places_of("level_sighting"), size_of("level_sighting")
_YAW_AT = _PLACES["yaw_rad"].start
_TILT = struct.Struct("7d")
_NAMES = {kind: kind.name.lower() for kind in EdgeKind}
_YAW_VAR_MAX = 0.5
"""Variance of the heading from which on it counts as unknown, rad^2."""


def sighting_of_look(frame: Frame, found: Looked, confidence: float) -> Sighting:
    """Return the sighting of method "registration".

    Args:
        confidence: how sure it is that this is the pad, 0..1.
    """
    features = tuple(
        Feature("outline" if kind is not EdgeKind.H else "point", _NAMES[kind], uv)
        for kind, uv in zip(EdgeKind, found.outlines, strict=True)
        if kind is not EdgeKind.UPPER or found.pad.markings.upper
    )
    return sighting_in_level(frame, found.in_level, found.yaw_ambiguous, confidence, features)


def sighting_of(
    frame: Frame,
    pose: PadPose,
    cov_pose: F64,
    camera: Camera,
    orientation: Orientation,
    ambiguous: bool,
    confidence: float,
) -> Sighting:
    """Return the sighting of a pose in the camera's axes.

    The difference between the deck's tilt in the frame and the attitude's prediction is split between the errors of both, by
    their variances. The covariance holds the attitude's remaining error in position, heading and tilt, correlations included.

    Args:
        cov_pose: (6, 6) covariance of the pad's centre and of a small rotation of the pad, both in `cam`.
        ambiguous: whether the heading may be half a turn off.
        confidence: the sighting's, 0..1.
    """
    words = np.empty(_SIZE)
    _IN_LEVEL(_packed(pose, cov_pose, camera, orientation), start_of(words))
    return sighting_in_level(frame, words, ambiguous, confidence)


def sighting_in_level(
    frame: Frame, words: F64, ambiguous: bool, confidence: float, features: tuple[Feature, ...] = (),
    method: Method = "registration",
) -> Sighting:  # fmt: skip
    """Return the sighting of a pose that the core has brought to level; arguments as for `sighting_of`.

    Args:
        words: the core's `level_sighting`; they become read-only.
    """
    words.setflags(write=False)
    d, R_level_pad, cov_pose6, cov = (words[_PLACES[name]] for name in ("d", "R_level_pad", "cov_pose", "cov"))
    cov = cov.reshape(4, 4)
    yaw: float | None = wrap_pi(words.item(_YAW_AT))
    if cov.item(3, 3) > _YAW_VAR_MAX:
        yaw, ambiguous, cov = None, False, cov.copy()
        cov[3, :] = cov[:, 3] = 0.0
        cov[3, 3] = UNKNOWN_YAW_VAR
    pose6 = Pose6(d, Rotation(R_level_pad.reshape(3, 3)), cov_pose6.reshape(6, 6))
    return Sighting(frame.stamp, frame.seq, method, pose6.d_body_pad_level, yaw, ambiguous, cov, confidence, pose6, features)


def _packed(pose: PadPose, cov_pose: F64, camera: Camera, orientation: Orientation) -> bytes:
    """Return the core's `camera_sighting`."""
    o, mount = orientation, camera.T_body_cam
    (rr, rp), (pr, pp) = o.cov_tilt.tolist()
    tilt = _TILT.pack(o.roll_rad, o.pitch_rad, rr, rp, pr, pp, o.sigma_deck_rad)
    arrays = (mount.R.matrix, mount.t, pose.R_cam_pad.matrix, pose.t_cam_pad, cov_pose)
    return tilt + b"".join([np.asarray(array, float).tobytes() for array in arrays])
