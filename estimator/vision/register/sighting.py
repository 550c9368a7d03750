"""Convert a registration to a sighting: transform it from the camera to `level`, including the attitude's uncertainty."""

from __future__ import annotations

import struct

import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Frame
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.vision.camera import Camera
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import Registration

_WORTH = {EdgeKind.DISC: 0.4, EdgeKind.RING: 0.6, EdgeKind.ARROW: 0.4, EdgeKind.H: 0.6}
"""Weight of each kind of edge as evidence that this is the pad and no other round or white thing."""

_IN_LEVEL = CORE.function("sighting_in_level")
_PLACES, _SIZE = places_of("level_sighting"), size_of("level_sighting")
_YAW_AT = _PLACES["yaw_rad"].start
_TILT = struct.Struct("7d")
_YAW_VAR_MAX = 0.5
"""Variance of the heading from which on it counts as unknown, rad^2."""


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
    words = np.empty(_SIZE)
    _IN_LEVEL(_packed(pose, cov_pose, camera, orientation), start_of(words))
    words.setflags(write=False)
    d, R_level_pad, cov_pose6, cov = (words[_PLACES[name]] for name in ("d", "R_level_pad", "cov_pose", "cov"))
    cov = cov.reshape(4, 4)
    yaw: float | None = wrap_pi(words.item(_YAW_AT))
    if cov.item(3, 3) > _YAW_VAR_MAX:
        yaw, ambiguous, cov = None, False, cov.copy()
        cov[3, :] = cov[:, 3] = 0.0
        cov[3, 3] = UNKNOWN_YAW_VAR
    pose6 = Pose6(d, Rotation(R_level_pad.reshape(3, 3)), cov_pose6.reshape(6, 6))
    return Sighting(frame.stamp, frame.seq, "registration", pose6.d_body_pad_level, yaw, ambiguous, cov, sure, pose6, features)


def _packed(pose: PadPose, cov_pose: F64, camera: Camera, orientation: Orientation) -> bytes:
    """Return the core's `camera_sighting`."""
    o, mount = orientation, camera.T_body_cam
    (rr, rp), (pr, pp) = o.cov_tilt.tolist()
    tilt = _TILT.pack(o.roll_rad, o.pitch_rad, rr, rp, pr, pp, o.sigma_deck_rad)
    arrays = (mount.R.matrix, mount.t, pose.R_cam_pad.matrix, pose.t_cam_pad, cov_pose)
    return tilt + b"".join([np.asarray(array, float).tobytes() for array in arrays])


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
