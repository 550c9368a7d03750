"""The place at which the filter expects the pad in a frame, and the places that it excludes."""

from __future__ import annotations

import math

from msgspec import Struct

from estimator.contracts.estimates import IntegrityAlert, RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.integrity.guard import excludes
from estimator.integrity.options import IntegrityOptions
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig

_FRESH_S = 1.0  # Age of the newest fused sighting up to which a belief excludes places
EXPECTED_SIGMAS = 3.0
"""Standard deviations of the expected position within which what is found counts as expected."""
_REACH_OF_DISC = 0.6
"""Reach of tracking, as a fraction of the disc's radius. Tracking is tried if two standard deviations of the expected position
lie within this and the next.

Much of the belief's uncertainty comes from the attitude and does not show in the frame. A start that is too far off only costs a
search.
"""
_REACH_OF_HEIGHT = 0.04  # What is added to that, as a fraction of the height
_SIGMA_YAW_RAD = 0.3  # Largest standard deviation of a heading that tracking starts from


class ExpectedPlace(Struct, frozen=True, eq=False):
    """Expected and excluded places of the pad in the frame, by the filter's estimate."""

    state: RelativeState | None
    """None if it is not fresh, not consistent or not sharp: then it excludes no place."""
    integrity: IntegrityOptions

    @staticmethod
    def of(belief: RelativeState | None, frame: Frame, tracker: TrackerConfig, alike_yaw_rad: float | None) -> ExpectedPlace:
        """Return what a belief says. That a pad is seen elsewhere makes it no less consistent here.

        Args:
            alike_yaw_rad: the heading if the belief has none.
        """
        if belief is not None:
            consistent = belief.consistent or belief.alerts == (IntegrityAlert.ELSEWHERE,)
            fresh = belief.age_s(frame.stamp.measured_at) <= _FRESH_S
            if consistent and fresh and near_enough(belief, sigma_of(belief), tracker.pad, alike_yaw_rad):
                return ExpectedPlace(belief, tracker.integrity)
        return ExpectedPlace(None, tracker.integrity)

    def excludes(self, seen: Sighting) -> bool:
        """Return whether a pad in that place is not the tracked one."""
        return self.state is not None and excludes(self.state, seen, self.integrity)


def expected(belief: RelativeState, attitude: Attitude, camera: Camera, alike_yaw_rad: float | None = None) -> PadPose | None:
    """Return the pose in camera coordinates that the belief predicts for a level deck; None without a heading.

    Args:
        alike_yaw_rad: the heading if the belief has none.
    """
    yaw_rad = alike_yaw_rad if belief.yaw_rad is None else belief.yaw_rad
    if yaw_rad is None:
        return None
    return in_camera(belief.d_body_pad_level, yaw_rad, attitude.R_ned_body.without_heading(), camera)


def in_camera(d_body_pad_level: F64, yaw_rad: float, R_level_body: Rotation, camera: Camera) -> PadPose:
    """Return the pose in camera coordinates of a pad on a level deck."""
    R_cam_body = camera.T_body_cam.R.inv
    R_cam_level = R_cam_body @ R_level_body.inv
    t = R_cam_level @ d_body_pad_level - R_cam_body @ camera.T_body_cam.t
    return PadPose(R_cam_level @ Rotation.from_rpy(0.0, 0.0, -yaw_rad), t)


def near_enough(belief: RelativeState, sigma_m: float, pad: Pad, alike_yaw_rad: float | None) -> bool:
    """Return whether the belief is certain enough to start tracking from."""
    remembered = belief.yaw_rad is None and alike_yaw_rad is not None
    sigma_yaw = 0.0 if remembered else math.sqrt(float(belief.cov[6, 6]))
    reach_m = _REACH_OF_DISC * pad.disc_radius_m + _REACH_OF_HEIGHT * belief.height_m
    return 2.0 * sigma_m < reach_m and sigma_yaw < _SIGMA_YAW_RAD


def sigma_of(belief: RelativeState) -> float:
    """Return the standard deviation of the pad's position along its worst direction, metres."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = belief.cov[:3, :3].tolist()
    mean, off2 = (xx + yy + zz) / 3.0, xy * xy + xz * xz + yz * yz
    x, y, z = xx - mean, yy - mean, zz - mean
    # The largest eigenvalue in closed form (Smith, Comm. ACM 4(4), 1961): LAPACK's takes ten times as long between two frames.
    spread = math.sqrt((x * x + y * y + z * z + 2.0 * off2) / 6.0)
    half = (x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz)) / max(2.0 * spread**3, 1e-300)
    return math.sqrt(mean + 2.0 * spread * math.cos(math.acos(max(-1.0, min(1.0, half))) / 3.0))
