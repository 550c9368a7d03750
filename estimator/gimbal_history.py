"""Recent attitudes of the camera's gimbal, and how it holds the camera at the instant of an exposure."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from estimator.attitude_history import AttitudeHistory
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, GimbalAttitude, GimbalFrame
from estimator.contracts.time import Stamp, seconds_between

DOWN = Rotation.from_rpy(0.0, -0.5 * math.pi, 0.0)
"""A gimbal that points straight down, in `body`."""
_GAP_S = 0.25
"""Longest time between two reports that are interpolated: MAVLink requests 5 Hz at least."""
_SPAN_S = 1.0
_CURVE = 0.1
"""Standard deviation of an interpolated attitude, as a fraction of the angle turned between the two reports."""


class HeldCamera(Struct, frozen=True, eq=False):
    """Orientation of a gimballed camera at one instant."""

    R_body_gimbal: Rotation
    cov_body: F64
    """Covariance of the small rotation error written in `body`, (3, 3) rad^2."""


class GimbalHistory(Struct, frozen=True):
    """Recent attitudes of a gimbal, all in the same frame."""

    frame: GimbalFrame = "level"
    attitudes: AttitudeHistory = AttitudeHistory(_SPAN_S)
    """The gimbal's rotations in place of the body's: `R_ned_body` is `R_frame_gimbal`."""

    def add(self, *samples: GimbalAttitude) -> GimbalHistory:
        """Return the history with `samples` added in turn; one in another frame begins it again."""
        frame, attitudes = self.frame, self.attitudes
        for sample in samples:
            if sample.frame != frame:
                frame, attitudes = sample.frame, AttitudeHistory(_SPAN_S)
            attitudes = attitudes.add(Attitude(sample.stamp, sample.R_frame_gimbal, sample.cov_gimbal))
        return GimbalHistory(frame, attitudes) if samples else self

    def reports(self, stamp: Stamp) -> bool:
        """Return whether the gimbal reported so lately that the report that covers an exposure may be on its way."""
        samples = self.attitudes.samples
        return bool(samples) and seconds_between(samples[-1].stamp.measured_at, stamp.measured_at) < _GAP_S

    def at(self, stamp: Stamp, attitude: Attitude) -> HeldCamera | None:
        """Return how the gimbal held the camera at an exposure; None if its reports do not cover that instant.

        The covariance is that of the report, and what the gimbal turned within the uncertainty of both times.

        Args:
            stamp: the exposure's.
            attitude: the vehicle's at the exposure.
        """
        found = self.attitudes.at(stamp.measured_at, stamp, gap_s=_GAP_S)
        if found is None:
            return None
        rate, turned = self.attitudes.turn_at(stamp.measured_at)
        late_s = math.hypot(stamp.sigma_s, self.attitudes.samples[-1].stamp.sigma_s)
        cov = found.cov_body + np.diag((rate * late_s) ** 2 + (_CURVE * turned) ** 2)
        match self.frame:
            case "ned":
                R_body_gimbal = attitude.R_ned_body.inv @ found.R_ned_body
            case "level":
                R_body_gimbal = attitude.R_ned_body.without_heading().inv @ found.R_ned_body
            case _:
                R_body_gimbal = found.R_ned_body
        return HeldCamera(R_body_gimbal, R_body_gimbal.rotate_cov(cov))
