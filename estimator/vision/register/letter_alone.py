"""Doubt the registration of a pad that is one letter on the bare deck: only clear edges tell it from plates and lines."""

import math

import numpy as np

from estimator.contracts.geometry import wrap_pi
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad_pose import PadPose
from estimator.vision.register.registration import Registration

_INLIERS = (0.9, 0.7)
"""Share of the edges that agree from which on they do not count against a pose, and at which they refute it: 0.98 or more at
right poses.
"""
_INLIERS_TRACKED = (0.5, 0.3)
"""The same where a belief led to the place: the drone's own shadow crosses most edges of a near letter."""
_INLIERS_FAR, _SNR_FAR = (0.95, 0.85), (100.0, 50.0)
"""The same of the pixels of a distant letter, and of its contrast: 0.97 and 420 or more at right poses from 3 to 14 m in plain
light. A fit that has taken the bare deck for a letter of another size has fewer that agree, or no contrast (68 and less).
"""
_OFF_PX = (0.15, 0.3)
"""The same for the displacement of edges that nothing explains: 0.01 at right poses, 0.27 and more at other markings."""
_SNR = (20.0, 8.0)
"""The same for the contrast over its deviation: 65 or more at right poses in plain light."""
_VISIBLE = (0.8, 0.7)
"""The same for the share of the edges in view, where no belief led to the place: an end of a stroke may be of anything."""
_REFUTED = -25.0
"""Log-odds of a refuted pose: more than all other evidence together."""


def letter_log_odds(found: Registration, tracked: bool) -> float:
    """Return the log-odds, at most 0, that the edges add to the confidence of a registration.

    From afar edges merge, and a letter resembles what else is small and bright: there it is followed and not found.

    Args:
        tracked: whether a belief led to this place.
    """
    clear = found.edges[EdgeKind.H].snr
    if tracked:
        inliers, least_snr = (_INLIERS_FAR, _SNR_FAR) if found.dense else (_INLIERS_TRACKED, _SNR)
        return _REFUTED * max(_between(-found.inliers, inliers, -1.0), _between(-clear, least_snr, -1.0))
    if found.dense:
        return _REFUTED
    doubts = (
        (found.inliers, _INLIERS, -1.0),
        (found.edge_rms_px, _OFF_PX, 1.0),
        (clear, _SNR, -1.0),
        (found.visible, _VISIBLE, -1.0),
    )
    return _REFUTED * max(_between(sign * value, limits, sign) for value, limits, sign in doubts)


def _between(value: float, limits: tuple[float, float], sign: float = 1.0) -> float:
    good, bad = (sign * limit for limit in limits)
    return min(1.0, max(0.0, (value - good) / (bad - good)))


def nearest_of_four(pose: PadPose, R_level_cam: np.ndarray, yaw_rad: float) -> PadPose:
    """Return the pose of a drawing that looks the same after a quarter turn whose heading is nearest to a given one, rad."""
    x, y, _ = (R_level_cam @ pose.R_cam_pad.matrix)[:, 0].tolist()
    return pose.turned(0.5 * math.pi * round(wrap_pi(-math.atan2(y, x) - yaw_rad) / (0.5 * math.pi)))
