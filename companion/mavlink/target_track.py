"""Where the pad was, seen from the body, at any instant of the last second: beliefs and attitudes, each at its own time.

ArduPilot joins a target with its attitude of exactly PLND_LAG before the message came, whatever the message says. So the vector
is not sent as it was at the exposure but re-expressed for that instant: the target is locked to the lag.
"""

from __future__ import annotations

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
"""ArduCopter's main loop: the step of its inertial ring."""


def effective_lag_s(plnd_lag_s: float, loop_rate_hz: float = LOOP_RATE_HZ) -> float:
    """How old the attitude is that ArduPilot takes: its ring has round(PLND_LAG * rate) entries, the newest is of now.

    Source: AC_PrecLand::init and construct_pos_meas_using_rangefinder.
    """
    entries = max(round(plnd_lag_s * loop_rate_hz), 1)
    return (entries - 1) / loop_rate_hz


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The pad from the body at one instant."""

    at: MonoNs
    d_body_pad_ned: F64
    """(3,) m."""
    v_pad_ned: F64
    """(3,) m/s, of the pad less that of the body."""
    R_ned_body: Rotation
    R_ned_pad: Rotation | None
    """Of a level pad, where its heading is known."""
    cov_ned: F64
    """(3, 3) of `d_body_pad_ned`."""
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
    """Feed it attitudes and beliefs as they come; ask where the pad was.

    Args:
        span_s: how far back it reaches; more than PLND_LAG.
        ahead_s: how far the newest belief is carried on by its velocity.
        gap_s: beliefs further apart than this are not joined.
    """

    def __init__(self, span_s: float = 1.0, ahead_s: float = 0.15, gap_s: float = 0.25) -> None:
        self._span_s, self._ahead_s, self._gap_s = span_s, ahead_s, gap_s
        self._attitudes = AttitudeHistory(span_s)
        self._knots: deque[_Knot] = deque()

    def on_attitude(self, attitude: Attitude) -> None:
        """The autopilot's own attitude."""
        self._attitudes = self._attitudes.add(attitude)

    def believe(self, state: RelativeState | None) -> None:
        """One round of the estimator; None forgets the pad."""
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

    def at(self, instant: MonoNs) -> Seen | None:
        """The pad at that instant, None where beliefs or attitudes do not reach it."""
        R_ned_body = self.attitude_at(instant)
        place = self._place(instant)
        if R_ned_body is None or place is None:
            return None
        knot, d_ned = place
        R_ned_pad = None if knot.arrow_rad is None else Rotation.from_rpy(0.0, 0.0, knot.arrow_rad)
        return Seen(instant, d_ned, knot.v_ned, R_ned_body, R_ned_pad, knot.cov_ned, knot.sigma_yaw_rad)

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
        share = seconds_between(a.at, instant) / span_s
        return b, a.d_ned + (b.d_ned - a.d_ned) * share


def position_at(positions: tuple[LocalPosition, ...], instant: MonoNs, reach_s: float = 0.25) -> F64 | None:
    """(3,) m, the autopilot's own local position at an instant: between its reports, or carried on by their velocity.

    None where no report is within `reach_s`.
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
            share = seconds_between(a.stamp.measured_at, instant) / span_s
            return np.asarray(a.p_body_ned + (b.p_body_ned - a.p_body_ned) * share)
    return np.asarray(a.p_body_ned + a.v_body_ned * seconds_between(a.stamp.measured_at, instant))


def lag_locked(track: TargetTrack, now: MonoNs, plnd_lag_s: float, transit_s: float) -> Seen | None:
    """What to send now to an ArduPilot: the pad as it was PLND_LAG before this message will be taken up.

    Args:
        transit_s: from here to its precision landing: half of TIMESYNC's round trip and half a main loop.
    """
    return track.at(after(now, transit_s - effective_lag_s(plnd_lag_s)))
