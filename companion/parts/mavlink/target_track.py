"""Return the pad's position relative to the body at any instant of the last second, from timed beliefs and attitudes.

ArduPilot combines a target with its own attitude of exactly PLND_LAG before the message arrived, whatever the message contains.
Therefore the vector is re-expressed for that instant instead of the exposure: the target is locked to the lag.
"""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np

from drivers.mavlink.samples import LocalPosition
from estimator.attitude_history import AttitudeHistory
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

LOOP_RATE_HZ = 400.0
"""The rate of ArduCopter's main loop, which is the rate of its inertial ring, Hz."""


def effective_lag_s(plnd_lag_s: float, loop_rate_hz: float = LOOP_RATE_HZ) -> float:
    """Return the age of the attitude that ArduPilot uses, s: its ring has round(PLND_LAG * rate) entries, the newest is current.

    Source: AC_PrecLand::init and construct_pos_meas_using_rangefinder.
    """
    entries = max(round(plnd_lag_s * loop_rate_hz), 1)
    return (entries - 1) / loop_rate_hz


@dataclass(frozen=True, slots=True, eq=False)
class TargetSample:
    """The pad's state relative to the body at one instant."""

    at: MonoNs
    d_body_pad_ned: F64
    """The (3,) vector from the body to the pad in ned, m."""
    v_pad_ned: F64
    """The (3,) velocity of the pad minus that of the body, m/s."""
    R_ned_body: Rotation
    R_ned_pad: Rotation | None
    """The attitude of the pad, which is taken as level; None if its heading is not known."""
    cov_ned: F64
    """The (3, 3) covariance of `d_body_pad_ned`, m^2."""
    sigma_yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class _Knot:
    at: MonoNs
    d_ned: F64
    v_ned: F64
    cov_ned: F64
    arrow_rad: float | None
    sigma_yaw_rad: float


class TargetTrack:
    """Keeps attitudes and beliefs as they arrive, and interpolates the pad's state between them.

    Args:
        span_s: the length of the history; it must exceed PLND_LAG.
        ahead_s: the longest time that the newest belief is extrapolated by its velocity.
        gap_s: the longest gap between two beliefs that is interpolated.
    """

    def __init__(self, span_s: float = 1.0, ahead_s: float = 0.15, gap_s: float = 0.25) -> None:
        self._span_s, self._ahead_s, self._gap_s = span_s, ahead_s, gap_s
        self._attitudes = AttitudeHistory(span_s)
        self._knots: deque[_Knot] = deque()

    def on_attitude(self, attitude: Attitude) -> None:
        """Add an attitude of the autopilot."""
        self._attitudes = self._attitudes.add(attitude)

    def believe(self, state: RelativeState | None) -> None:
        """Add a belief of the estimator; None forgets the pad."""
        if state is None:
            self._knots.clear()
            return
        R_ned_body = self.attitude_at(state.at)
        if R_ned_body is None or (self._knots and state.at <= self._knots[-1].at):
            return
        yaw_rad = R_ned_body.rpy_rad[2]
        R_ned_level = Rotation.from_rpy(0.0, 0.0, yaw_rad)
        arrow_rad = None if state.yaw_rad is None or dict(state.details).get("yaw_ambiguous") else yaw_rad - state.yaw_rad
        self._knots.append(
            _Knot(
                state.at,
                R_ned_level @ state.d_body_pad_level,
                R_ned_level @ state.v_pad_level,
                R_ned_level.rotate_cov(state.cov[:3, :3]),
                arrow_rad,
                float(np.sqrt(state.cov[6, 6])),
            )
        )
        while seconds_between(self._knots[0].at, state.at) > self._span_s:
            self._knots.popleft()

    def attitude_at(self, instant: MonoNs) -> Rotation | None:
        found = self._attitudes.at(instant, Stamp(instant, instant, 0.0, "synced"))
        return None if found is None else found.R_ned_body

    def at(self, instant: MonoNs) -> TargetSample | None:
        """Return the pad at that instant, or None if beliefs or attitudes do not reach it."""
        R_ned_body = self.attitude_at(instant)
        place = self._place(instant)
        if R_ned_body is None or place is None:
            return None
        knot, d_ned = place
        R_ned_pad = None if knot.arrow_rad is None else Rotation.from_rpy(0.0, 0.0, knot.arrow_rad)
        return TargetSample(instant, d_ned, knot.v_ned, R_ned_body, R_ned_pad, knot.cov_ned, knot.sigma_yaw_rad)

    def _place(self, instant: MonoNs) -> tuple[_Knot, F64] | None:
        if not self._knots:
            return None
        i = bisect_right(self._knots, instant, key=lambda k: k.at)
        if i == len(self._knots):
            newest = self._knots[-1]
            ahead_s = seconds_between(newest.at, instant)
            return (newest, newest.d_ned + newest.v_ned * ahead_s) if ahead_s <= self._ahead_s else None
        if i == 0:
            return None
        a, b = self._knots[i - 1], self._knots[i]
        span_s = seconds_between(a.at, b.at)
        if span_s > self._gap_s:
            return None
        weight = seconds_between(a.at, instant) / span_s
        return b, a.d_ned + (b.d_ned - a.d_ned) * weight


def position_at(positions: tuple[LocalPosition, ...], instant: MonoNs, reach_s: float = 0.25) -> F64 | None:
    """Return the autopilot's local position at an instant, (3,) m: interpolate between its reports or extrapolate by velocity.

    The result is None if no report is within `reach_s`.
    """
    if not positions:
        return None
    i = bisect_right(positions, instant, key=lambda p: p.stamp.measured_at)
    a = positions[max(i - 1, 0)]
    if abs(seconds_between(a.stamp.measured_at, instant)) > reach_s:
        return None
    if 0 < i < len(positions):
        b = positions[i]
        span_s = seconds_between(a.stamp.measured_at, b.stamp.measured_at)
        if 0 < span_s <= reach_s:
            weight = seconds_between(a.stamp.measured_at, instant) / span_s
            return np.asarray(a.p_body_ned + (b.p_body_ned - a.p_body_ned) * weight)
    return np.asarray(a.p_body_ned + a.v_body_ned * seconds_between(a.stamp.measured_at, instant))


def lag_locked(track: TargetTrack, now: MonoNs, plnd_lag_s: float, transit_s: float) -> TargetSample | None:
    """Return the target to send to an ArduPilot now: the pad at PLND_LAG before ArduPilot processes this message.

    Args:
        transit_s: the time from here to its precision landing: half of TIMESYNC's round trip and half a main loop.
    """
    return track.at(after(now, transit_s - effective_lag_s(plnd_lag_s)))
