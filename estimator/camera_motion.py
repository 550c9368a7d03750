"""Motion of the camera against the pad while a frame is read out, by the gyro, the attitude's history and the estimate."""

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import Stamp, after
from estimator.gimbal_history import HeldCamera
from estimator.pipeline import RelativeEstimator
from estimator.vision.camera import Camera
from estimator.vision.rolling import CameraMotion

_LEAST_S = 0.01
"""Time to either side of the exposure over which a rotation is taken, at least, s: a shorter one is noise."""


def camera_motion(
    estimator: RelativeEstimator, stamp: Stamp, camera: Camera, belief: RelativeState, held: HeldCamera | None = None
) -> CameraMotion | None:
    """Return the camera's motion at an exposure; None if attitude or gimbal do not cover it.

    The rate is the gyro's without its bias where the steering path has one; two attitudes within the readout say it to 0.1 rad/s.

    Args:
        camera: as it was held at the exposure.
        belief: about the pad, at the exposure.
        held: how a gimbal held the camera then; None of one that is fixed on the body.
    """
    aside_s = max(0.5 * abs(camera.readout_s), _LEAST_S)
    earlier, later = _at(stamp, -aside_s), _at(stamp, aside_s)
    begins, ends = estimator.attitude_at(earlier), estimator.attitude_at(later)
    if begins is None or ends is None:
        return None
    moves, _ = estimator.motion(stamp.measured_at)
    w_body = (begins.R_ned_body.inv @ ends.R_ned_body).rotvec_rad / (2.0 * aside_s) if moves is None else moves.w_body
    R_body_cam = camera.T_body_cam.R
    w_cam = R_body_cam.inv @ w_body
    if held is not None:
        first, last = estimator.held_at(earlier, begins), estimator.held_at(later, ends)
        if first is None or last is None:
            return None
        turned = (begins.R_ned_body @ first.R_body_gimbal).inv @ (ends.R_ned_body @ last.R_body_gimbal)
        R_gimbal_cam = held.R_body_gimbal.inv @ R_body_cam
        w_cam = R_gimbal_cam.inv @ (turned.rotvec_rad / (2.0 * aside_s))
    R_level_body = begins.R_ned_body.without_heading()
    v_level = belief.v_pad_level - R_level_body @ np.cross(w_body, camera.T_body_cam.t)
    return CameraMotion(w_cam, R_body_cam.inv @ (R_level_body.inv @ v_level))


def _at(stamp: Stamp, seconds: float) -> Stamp:
    measured_at = after(stamp.measured_at, seconds)
    return structs.replace(stamp, measured_at=measured_at, received_at=max(measured_at, stamp.received_at))
