"""Recent attitudes of the body and of the camera's gimbal, interpolated to the instant of an exposure."""

from __future__ import annotations

import math
from bisect import bisect_left

import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, GimbalAttitude, GimbalFrame
from estimator.contracts.time import MonoNs, Stamp, seconds_between

_APART_S = 0.1  # Time between two samples beyond which their difference says nothing about the rate at the newer one
DOWN = Rotation.from_rpy(0.0, -0.5 * math.pi, 0.0)
"""A gimbal that points straight down, in `body`."""
_GAP_S = 0.25  # Longest time between two reports that are interpolated: MAVLink requests 5 Hz at least
_SPAN_S = 1.0  # Time for which attitudes are kept: a frame is rarely later
_CURVE = 0.1  # Standard deviation of an interpolated attitude, as a fraction of the angle turned between the two reports


class AttitudeHistory(Struct, frozen=True):
    """Recent attitudes, oldest first, bounded by `span_s`."""

    span_s: float = 1.0
    samples: tuple[Attitude, ...] = ()

    @property
    def newest_rate_rad_s(self) -> F64:
        """Angular rate (3,) between the newest two samples less than 0.1 s apart, in `body`; zero if there are none.

        It extrapolates the newest attitude a little past its time.
        """
        for earlier, later in zip(self.samples[-2::-1], self.samples[:0:-1], strict=True):
            dt = seconds_between(earlier.stamp.measured_at, later.stamp.measured_at)
            if dt < _APART_S:
                return (earlier.R_ned_body.inv @ later.R_ned_body).rotvec_rad / dt
        return np.zeros(3)

    def turn_at(self, instant: MonoNs) -> tuple[F64, F64]:
        """Return the rate at an instant, (3,) rad/s, and the angle (3,) turned between the two samples around it.

        Both are written in the body's axes at the earlier sample. After the newest sample, and with fewer than two samples, the
        angle is zero and the rate `newest_rate_rad_s`.
        """
        i = bisect_left(self.samples, instant, key=lambda s: s.stamp.measured_at)
        if not 0 < i < len(self.samples):
            return self.newest_rate_rad_s, np.zeros(3)
        earlier, later = self.samples[i - 1], self.samples[i]
        turned = (earlier.R_ned_body.inv @ later.R_ned_body).rotvec_rad
        return turned / seconds_between(earlier.stamp.measured_at, later.stamp.measured_at), turned

    def add(self, *samples: Attitude) -> AttitudeHistory:
        """Return the history with `samples` added in turn; one that is not newer than the newest is ignored."""
        kept = list(self.samples)
        for sample in samples:
            if not kept or sample.stamp.measured_at > kept[-1].stamp.measured_at:
                kept.append(sample)
        if len(kept) == len(self.samples):
            return self
        newest, first = kept[-1].stamp.measured_at, 0
        while seconds_between(kept[first].stamp.measured_at, newest) > self.span_s:
            first += 1
        return AttitudeHistory(self.span_s, tuple(kept[first:]))

    def at(self, instant: MonoNs, stamp: Stamp, reach_s: float = 0.05, gap_s: float = 0.2) -> Attitude | None:
        """Return the attitude at `instant`, stamped `stamp`: interpolated on the great arc, or extrapolated from the newest.

        Return None if `instant` lies before the history, in a gap longer than `gap_s`, or more than `reach_s` past the newest
        sample. Extrapolation adds to the covariance: one standard deviation is a tenth of the angle turned in that time.
        """
        if not self.samples:
            return None
        i = bisect_left(self.samples, instant, key=lambda s: s.stamp.measured_at)
        if i == len(self.samples):
            newest = self.samples[-1]
            ahead_s = seconds_between(newest.stamp.measured_at, instant)
            if ahead_s > reach_s:
                return None
            turned = self.newest_rate_rad_s * ahead_s
            cov = newest.cov_body + np.diag((0.1 * turned) ** 2)
            return Attitude(stamp, newest.R_ned_body @ Rotation.from_rotvec(turned), cov)
        later = self.samples[i]
        if later.stamp.measured_at == instant:
            return Attitude(stamp, later.R_ned_body, later.cov_body)
        if i == 0:
            return None
        earlier = self.samples[i - 1]
        span_s = seconds_between(earlier.stamp.measured_at, later.stamp.measured_at)
        if span_s > gap_s:
            return None
        weight = seconds_between(earlier.stamp.measured_at, instant) / span_s
        turned = (earlier.R_ned_body.inv @ later.R_ned_body).rotvec_rad * weight
        return Attitude(stamp, earlier.R_ned_body @ Rotation.from_rotvec(turned), later.cov_body)


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
