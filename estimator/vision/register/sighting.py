"""The sighting that a registered pose makes: brought to level, with the attitude's error in its covariance."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, Method, Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Frame
from estimator.core.library import CORE
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.native import edge_points, native_lens, native_pose, native_prior
from estimator.vision.pad.drawing import EdgeKind
from estimator.vision.register.registration import Registration

_NAMES = [kind.name.lower() for kind in EdgeKind]
_YAW_VAR_MAX = 0.5  # Variance of the heading from which it counts as unknown, rad^2


def sighting_of_look(frame: Frame, found: Registration, confidence: float) -> Sighting:
    """Return the sighting of method "registration".

    Args:
        confidence: how sure it is that this is the pad, 0..1.
    """
    uv, shown = found.outline, edge_points(found.pad).shown
    is_whole = math.isfinite(float(uv.sum()))  # else the lens does not project some points
    features = tuple(
        Feature("point" if name == "h" else "outline", name, part if is_whole else part[np.isfinite(part).all(axis=1)])
        for name, part in zip(_NAMES, (uv[each] for each in shown), strict=True)
        if name != "upper" or found.pad.markings.upper
    )
    return sighting_in_level(frame, found.in_level, found.yaw_ambiguous, confidence, features)


def sighting_of(
    frame: Frame, pose: PadPose, cov_pose: F64, camera: Camera, orientation: Orientation, ambiguous: bool, confidence: float
) -> Sighting:
    """Return the sighting of a pose in the camera's axes.

    The difference between the deck's tilt in the frame and the attitude's prediction is split between the errors of both, by
    their variances. The covariance holds the attitude's remaining error in position, heading and tilt, correlations included.

    Args:
        cov_pose: (6, 6) covariance of the pad's centre and of a small rotation of the pad, both in `cam`.
        ambiguous: whether the heading may be half a turn off.
        confidence: the sighting's, 0..1.
    """
    out, prior = np.empty((), CORE.dtype("dl_level_sighting")), CORE.ffi.new("dl_tilt_prior *", native_prior(orientation))
    CORE.lib.dl_sighting_in_level(
        CORE.array("dl_lens", native_lens(camera)), CORE.array("double", camera.T_body_cam.t, 3), prior, native_pose(pose),
        CORE.array("double", np.ascontiguousarray(cov_pose, float), 36), CORE.array("dl_level_sighting", out),
    )  # fmt: skip
    return sighting_in_level(frame, out, ambiguous, confidence)


def sighting_in_level(
    frame: Frame, level: NDArray[Any], ambiguous: bool, confidence: float, features: tuple[Feature, ...] = (),
    method: Method = "registration",
) -> Sighting:  # fmt: skip
    """Return the sighting of a pose that the core has brought to level; arguments as for `sighting_of`.

    Args:
        level: the core's `dl_level_sighting`; it becomes read-only.
    """
    level.setflags(write=False)
    d, R_level_pad, cov_pose6, cov = (level[name] for name in ("d", "R_level_pad", "cov_pose", "cov"))
    cov = cov.reshape(4, 4)
    yaw: float | None = wrap_pi(float(level["yaw_rad"]))
    if cov.item(3, 3) > _YAW_VAR_MAX:
        yaw, ambiguous, cov = None, False, cov.copy()
        cov[3, :] = cov[:, 3] = 0.0
        cov[3, 3] = UNKNOWN_YAW_VAR
    pose6 = Pose6(d, Rotation(R_level_pad.reshape(3, 3)), cov_pose6.reshape(6, 6))
    return Sighting(frame.stamp, frame.seq, method, pose6.d_body_pad_level, yaw, ambiguous, cov, confidence, pose6, features)
