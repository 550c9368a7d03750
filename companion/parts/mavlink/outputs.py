"""The messages about the pad that each kind of autopilot obeys, and when each is sent. No I/O."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Mapping

import numpy as np
from msgspec import Struct

from companion.settings.links import OutputOptions
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import Message, TargetRelative, mav
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.vehicle import Condition, Stack
from estimator.attitude_history import AttitudeHistory
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import DeckMotion
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

# Return the pad's position relative to the body at any instant of the last second, from timed beliefs and attitudes.
#
# ArduPilot combines a target with its own attitude of exactly PLND_LAG before the message arrived, whatever the message contains.
# Therefore the vector is re-expressed for that instant instead of the exposure: the target is locked to the lag.

LOOP_RATE_HZ = 400.0
"""The rate of ArduCopter's main loop, which is the rate of its inertial ring, Hz."""
_SPAN_S = 1.0
"""The length of the history; it must exceed PLND_LAG."""
_AHEAD_S = 0.15  # the longest time that the newest belief is extrapolated by its velocity
_GAP_S = 0.25  # the longest gap that is interpolated
TARGET_OBS_BODY_FRD = 1
"""TARGET_OBS_FRAME_BODY_FRD of the development dialect."""
_LEAST_DEPTH_M = 0.02  # depth from which on a direction has angles
MIN_RANGE_CM = 5
"""Shortest range of the rangefinder that is reported."""
MAX_RANGE_CM = 5000
"""Longest range of it."""
PX4_LATE_S = 0.06
"""Lag of PX4 behind a steady ship beyond that of its law, s."""
_WAY_S = 20.0
"""Time over which the ship's way is averaged, s."""
_CHANGE_S = 0.5
"""Time over which the velocity's change is taken for the acceleration, s."""
_BLIND_BELOW_M = 1.0
"""Height below which the camera may lose the pad, so that the target is carried on for longer, m."""
DEFAULT_PLND_LAG_S = 0.02
"""Default PLND_LAG of ArduPilot."""
PLND_LAG_MAX_S = 0.25
"""Largest PLND_LAG."""
_MAVLINK_RANGEFINDER = 10.0
"""The RNGFNDx_TYPE of a rangefinder that reads DISTANCE_SENSOR."""


def effective_lag_s(plnd_lag_s: float) -> float:
    """Return the age of the attitude that ArduPilot uses, s: its ring has round(PLND_LAG * rate) entries, the newest is current.

    Source: AC_PrecLand::init and construct_pos_meas_using_rangefinder.
    """
    return (max(round(plnd_lag_s * LOOP_RATE_HZ), 1) - 1) / LOOP_RATE_HZ


class TargetSample(Struct, frozen=True, eq=False):
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


class _Knot(Struct, frozen=True, eq=False):
    at: MonoNs
    d_ned: F64
    v_ned: F64
    cov_ned: F64
    arrow_rad: float | None
    sigma_yaw_rad: float


class TargetTrack:
    """Keeps attitudes and beliefs as they arrive, and interpolates the pad's state between them."""

    def __init__(self) -> None:
        self._attitudes = AttitudeHistory(_SPAN_S)
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
        # The filter's figures, which are made when they are read, have no such word.
        ambiguous = state.path != "ekf" and dict(state.details).get("yaw_ambiguous")
        arrow_rad = None if state.yaw_rad is None or ambiguous else yaw_rad - state.yaw_rad
        self._knots.append(
            _Knot(
                state.at,
                R_ned_level @ state.d_body_pad_level,
                R_ned_level @ state.v_pad_level,
                R_ned_level.rotate_cov(state.cov[:3, :3]),
                arrow_rad,
                math.sqrt(state.cov[6, 6]),
            )
        )
        while seconds_between(self._knots[0].at, state.at) > _SPAN_S:
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
            return (newest, newest.d_ned + newest.v_ned * ahead_s) if ahead_s <= _AHEAD_S else None
        if i == 0:
            return None
        a, b = self._knots[i - 1], self._knots[i]
        span_s = seconds_between(a.at, b.at)
        if span_s > _GAP_S:
            return None
        weight = seconds_between(a.at, instant) / span_s
        return b, a.d_ned + (b.d_ned - a.d_ned) * weight


def position_at(positions: tuple[LocalPosition, ...], instant: MonoNs) -> F64 | None:
    """Return the autopilot's local position at an instant, (3,) m: interpolate between its reports or extrapolate by velocity.

    The result is None if no report is within `_GAP_S`.
    """
    if not positions:
        return None
    i = bisect_right(positions, instant, key=lambda p: p.stamp.measured_at)
    a = positions[max(i - 1, 0)]
    if abs(seconds_between(a.stamp.measured_at, instant)) > _GAP_S:
        return None
    if 0 < i < len(positions):
        b = positions[i]
        span_s = seconds_between(a.stamp.measured_at, b.stamp.measured_at)
        if 0 < span_s <= _GAP_S:
            weight = seconds_between(a.stamp.measured_at, instant) / span_s
            return np.asarray(a.p_body_ned + (b.p_body_ned - a.p_body_ned) * weight)
    return np.asarray(a.p_body_ned + a.v_body_ned * seconds_between(a.stamp.measured_at, instant))


def lag_locked(track: TargetTrack, now: MonoNs, plnd_lag_s: float, transit_s: float) -> TargetSample | None:
    """Return the target to send to an ArduPilot now: the pad at PLND_LAG before ArduPilot processes this message.

    Args:
        transit_s: the time from here to its precision landing: half of TIMESYNC's round trip and half a main loop.
    """
    return track.at(after(now, transit_s - effective_lag_s(plnd_lag_s)))


# Convert the pad's position to the messages that each autopilot obeys. No I/O, no clocks.
#
# All functions take the vector from the body's origin to the pad's centre in `ned` and the attitude of the same instant. How
# receivers use the fields: docs/mavlink.md. Source: AC_PrecLand_MAVLink.cpp and AC_PrecLand.cpp (ArduPilot),
# mavlink_receiver.cpp and LandingTargetEstimator.cpp (PX4); MAVLink messages LANDING_TARGET, TARGET_RELATIVE, DISTANCE_SENSOR.

BODY_FRD, LOCAL_NED = int(mav.MAV_FRAME_BODY_FRD), int(mav.MAV_FRAME_LOCAL_NED)
VISION_OTHER = int(mav.LANDING_TARGET_TYPE_VISION_OTHER)
_NO_ROTATION_KNOWN = (0.0, 0.0, 0.0, 0.0)
"""A quaternion that is no rotation: receivers that read it treat it as absent."""


def angles_of(d_body: F64) -> tuple[float, float] | None:
    """Return (angle_x, angle_y) in rad as ArduPilot inverts them: (-tan(angle_y), tan(angle_x), 1) points to the pad.

    The result is None if the pad is not below the body.
    """
    x, y, z = (float(v) for v in d_body)
    return (math.atan2(y, z), math.atan2(-x, z)) if z >= _LEAST_DEPTH_M else None


def _quaternion(rotation: Rotation | None) -> tuple[float, ...]:
    return _NO_ROTATION_KNOWN if rotation is None else tuple(float(v) for v in rotation.quat_wxyz)


def landing_target(
    time_us: int,
    d_body_pad_ned: F64,
    R_ned_body: Rotation,
    p_body_ned: F64 | None = None,
    *,
    pad_radius_m: float,
    R_ned_pad: Rotation | None = None,
) -> Message | None:
    """Return LANDING_TARGET with position, distance and angles that agree; None where the pad is not below the body.

    ArduPilot ignores a target that is not below it. Its firmware before 4.1 reads the angles only; later firmware reads the
    position and needs distance > 0.

    Args:
        time_us: for PX4 when it was true, in the clock of our TIMESYNC answers; another clock makes PX4 ignore the target. For
            ArduPilot any clock of constant offset: it uses it for a staleness test only, and takes the attitude from its own
            ring, PLND_LAG back, so the vector must be of that instant (see `TargetTrack`).
        p_body_ned: LOCAL_POSITION_NED of the same instant for PX4, which gets the pad in its own local frame; None for
            ArduPilot, which gets it in MAV_FRAME_BODY_FRD.
        R_ned_pad: the pad's attitude where it is known; it goes into `q`, for ArduPilot relative to the body.
    """
    R_body_ned = R_ned_body.inv
    d_body = R_body_ned @ d_body_pad_ned
    angles = angles_of(d_body)
    if angles is None:
        return None
    if p_body_ned is None:
        frame, xyz, q = BODY_FRD, d_body, _quaternion(None if R_ned_pad is None else R_body_ned @ R_ned_pad)
    else:
        frame, xyz, q = LOCAL_NED, p_body_ned + d_body_pad_ned, _quaternion(R_ned_pad)
    distance_m = math.hypot(*d_body)
    size_rad = 2.0 * math.atan(pad_radius_m / distance_m)
    return mav.MAVLink_landing_target_message(
        time_us, 0, frame, *angles, distance_m, size_rad, size_rad, *(float(v) for v in xyz), q, VISION_OTHER, 1
    )


def target_relative(
    time_us: int, d_body_pad_ned: F64, cov_ned: F64, R_ned_body: Rotation, R_ned_pad: Rotation | None, sigma_yaw_rad: float
) -> Message:
    """Return TARGET_RELATIVE for PX4's vision target estimator: the pad in body axes, standard deviations, capture time.

    Args:
        cov_ned: the (3, 3) covariance of `d_body_pad_ned`.
        sigma_yaw_rad: the standard deviation of the pad's heading; it is large if the heading is not known.
    """
    d_body = R_ned_body.inv @ d_body_pad_ned
    sigma = np.sqrt(np.maximum(np.diag(R_ned_body.inv.rotate_cov(cov_ned)), 0.0))
    return TargetRelative(
        timestamp=time_us,
        id=0,
        frame=TARGET_OBS_BODY_FRD,
        x=float(d_body[0]),
        y=float(d_body[1]),
        z=float(d_body[2]),
        pos_std=[float(s) for s in sigma],
        yaw_std=min(sigma_yaw_rad, math.pi),
        q_target=_quaternion(None if R_ned_pad is None else R_ned_body.inv @ R_ned_pad),
        q_sensor=_quaternion(R_ned_body),
        type=VISION_OTHER,
    )


def distance_sensor(time_boot_ms: int, range_m: float | None, sigma_m: float, sensor_id: int) -> Message:
    """Return a downward DISTANCE_SENSOR with the reading that a lidar would have, for an autopilot without one.

    Args:
        range_m: the distance along the body's down axis; None while nothing is seen, which is sent as an invalid reading.
    """
    if range_m is None:
        reading, quality, covariance = MAX_RANGE_CM + 1, 1, 255
    else:
        reading, quality = min(max(round(100.0 * range_m), 0), MAX_RANGE_CM + 1), 0
        covariance = min(max(round((100.0 * sigma_m) ** 2), 1), 254)
    return mav.MAVLink_distance_sensor_message(
        time_boot_ms & 0xFFFFFFFF, MIN_RANGE_CM, MAX_RANGE_CM, reading, mav.MAV_DISTANCE_SENSOR_UNKNOWN, sensor_id,
        mav.MAV_SENSOR_ROTATION_PITCH_270, covariance, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0), quality,
    )  # fmt: skip


def range_along_down(d_body_pad_ned: F64, R_ned_body: Rotation) -> float | None:
    """Return the distance in m along the body's down axis to the pad's level plane, or None if the axis does not meet it."""
    down = float(R_ned_body.matrix[2, 2])
    depth_m = float(d_body_pad_ned[2])
    return depth_m / down if down > 0.2 and depth_m >= 0.0 else None


# Lead the place of a deck that moves, for an autopilot that follows its targets by itself and so comes late.

LAGS: Mapping[Stack, tuple[float, float]] = {Stack.ARDUPILOT: (0.15, 0.5), Stack.PX4: (0.5, 0.55)}
"""Distance that each autopilot's own landing leaves to a deck in waves: s for its velocity less the way, s^2 for the change of
that, which comes `_CHANGE_S` late. They were fitted to flights of ArduCopter 4.5.7 and PX4 1.16.2 (docs/evidence.md)."""


class Lead:
    """The way by which a target is sent ahead of the pad.

    ArduPilot's filter of the target follows a steady velocity without a lag (PLND_OPTIONS 1). PX4 takes each target for one at
    rest and flies to it as fast as it could stop there, v = f(d), so it stays behind a steady one by d = 2 v a / j + v^2 / (2 a).
    Source: AC_PrecLand.cpp, mode.cpp (ArduPilot); TrajMath.hpp, computeMaxSpeedFromDistance (PX4).

    Args:
        motion: returns the deck's motion at an instant; None while it is not known.
        blind_s: the age of the newest sighting up to which a target leaves where the pad leaves the view.
    """

    def __init__(self, motion: Callable[[MonoNs], DeckMotion | None], blind_s: float) -> None:
        self._motion, self.blind_s = motion, blind_s
        self.wanted = False
        """True while the mission wants targets to be sent."""
        self._way, self._before = np.zeros(3), np.zeros(3)
        """The means of the deck's velocity over `_WAY_S` and `_CHANGE_S`, (3,) m/s in ned."""
        self._at: MonoNs | None = None

    def ahead(self, now: MonoNs, R_ned_body: Rotation, vehicle: AutopilotView) -> F64:
        """Return the horizontal way, (3,) m in ned, from the pad to where the autopilot is to find it."""
        deck = self._motion(now)
        if deck is None or vehicle.stack not in LAGS:
            return np.zeros(3)
        R_ned_level = Rotation.from_rpy(0.0, 0.0, R_ned_body.rpy_rad[2])
        v = R_ned_level @ (deck.v_level * (1.0, 1.0, 0.0))
        since_s = math.inf if self._at is None else seconds_between(self._at, now)
        self._at = now
        for_way, for_change = (1.0, 1.0) if since_s > _SPAN_S else (since_s / _WAY_S, min(1.0, since_s / _CHANGE_S))
        self._way = self._way + for_way * (v - self._way)
        self._before = self._before + for_change * (v - self._before)
        # The estimated acceleration of the deck hardly follows the waves to the side.
        a = (v - self._before) / _CHANGE_S
        by_velocity_s, by_acceleration_s2 = LAGS[vehicle.stack]
        ahead = by_velocity_s * (v - self._way) + by_acceleration_s2 * a
        if vehicle.stack is Stack.PX4:
            brakes, jerk = (vehicle.parameter_values.get(*known) for known in (("MPC_ACC_HOR", 3.0), ("MPC_JERK_AUTO", 4.0)))
            ahead = ahead + v * (2.0 * brakes / jerk + math.hypot(*v) / (2.0 * brakes) + PX4_LATE_S)
        return np.asarray(ahead)


class AutopilotView(Struct, frozen=True):
    """The part of the autopilot's state that `Outputs` reads."""

    stack: Stack
    condition: Condition
    positions: tuple[LocalPosition, ...]
    round_trip_s: float | None
    parameter_values: Mapping[str, float]

    @staticmethod
    def of(autopilot: Autopilot) -> AutopilotView:
        """Return the present view of an autopilot."""
        identity, sync, parameters = autopilot.identity, autopilot.sync, autopilot.parameters
        return AutopilotView(
            Stack.OTHER if identity is None else identity.stack,
            autopilot.condition,
            autopilot.positions,
            None if sync is None else sync.round_trip_s,
            {} if parameters is None else parameters.values,
        )


class Outputs:
    """Makes LANDING_TARGET, TARGET_RELATIVE and DISTANCE_SENSOR, each when it is due.

    No target is sent while the vehicle takes off, nor on the ground: a target that moves after touchdown can keep ArduPilot from
    disarming.

    Args:
        pad_radius_m: the radius of the pad's disc.
        stale_s: the time without a sighting after which the pad is no longer sent.
        lead: of an autopilot that lands by itself; None where guidance steers it.
    """

    def __init__(self, options: OutputOptions, pad_radius_m: float, stale_s: float, lead: Lead | None = None) -> None:
        self._o, self.lead = options, lead
        self._pad_radius_m = pad_radius_m
        self.stale_s = stale_s
        self.rate_hz = options.rate_hz
        self.track = TargetTrack()
        self._target_at: MonoNs | None = None
        self._range_at: MonoNs | None = None
        self._newest: MonoNs | None = None
        self.sent = 0
        """The number of targets sent."""
        self.withheld: Counter[str] = Counter()
        """The reasons why targets that were due were not sent, counted."""

    def sends_ranges(self, vehicle: AutopilotView) -> bool:
        """Return whether we serve as this autopilot's rangefinder."""
        if self._o.ranges != "auto":
            return self._o.ranges == "on"
        kinds = (vehicle.parameter_values.get(f"RNGFND{n}_TYPE") for n in range(1, 5))
        return vehicle.stack.is_ardupilot and _MAVLINK_RANGEFINDER in kinds

    def is_due(self, now: MonoNs, ranges: bool) -> bool:
        """Return whether `due` has something to do at this instant; `ranges` as `sends_ranges` returns it."""
        return self._time_has_come(self._target_at, now, self._o.rate_hz) or (
            ranges and self._time_has_come(self._range_at, now, self._o.range_rate_hz)
        )

    def due(self, now: MonoNs, vehicle: AutopilotView, sighted: MonoNs | None) -> list[Message]:
        """Return the messages that are due at this instant.

        Args:
            sighted: when the pad was last seen, None for never.
        """
        out: list[Message] = []
        if self._time_has_come(self._target_at, now, self._o.rate_hz):
            out += self.target(now, vehicle, sighted)
        if self._time_has_come(self._range_at, now, self._o.range_rate_hz):
            self._range_at = now
            if self.sends_ranges(vehicle):
                out.append(self._range(now, vehicle, sighted))
        return out

    def target(self, now: MonoNs, vehicle: AutopilotView, sighted: MonoNs | None) -> list[Message]:
        """Return the target to send now, whether or not it is due; the next one is due one period later."""
        self._target_at = now
        seen, why = self._target(now, vehicle, sighted)
        if seen is None:
            self.withheld[why] += 1
            return []
        time_us, p_body_ned = now // 1000, None
        if not vehicle.stack.is_ardupilot:
            time_us, p_body_ned = seen.at // 1000, position_at(vehicle.positions, seen.at)
            if p_body_ned is None:
                self.withheld["no local position"] += 1
                return []
        d_ned = seen.d_body_pad_ned if self.lead is None else seen.d_body_pad_ned + self.lead.ahead(now, seen.R_ned_body, vehicle)
        message = landing_target(
            time_us, d_ned, seen.R_ned_body, p_body_ned, pad_radius_m=self._pad_radius_m, R_ned_pad=seen.R_ned_pad
        )
        if message is None:
            self.withheld["not below"] += 1
            return []
        self._newest = seen.at
        self.sent += 1
        if vehicle.stack is Stack.PX4 and self._o.vision_target_estimator:
            relative = target_relative(
                time_us, seen.d_body_pad_ned, seen.cov_ned, seen.R_ned_body, seen.R_ned_pad, seen.sigma_yaw_rad
            )
            return [message, relative]
        return [message]

    def _target(self, now: MonoNs, vehicle: AutopilotView, sighted: MonoNs | None) -> tuple[TargetSample | None, str]:
        if vehicle.stack is Stack.OTHER:
            return None, "unknown autopilot"
        if vehicle.condition.flying is False:
            return None, "on ground"
        if vehicle.condition.taking_off:
            # ArduPilot begins its estimate with the first target, and complains of a pad that leaves the picture in the climb.
            return None, "taking off"
        if self.lead is not None and not self.lead.wanted:
            return None, "not ordered"
        if sighted is None or seconds_between(sighted, now) > self._stale_s(now):
            return None, "not seen"
        if vehicle.stack.is_ardupilot:
            lag_s = min(max(vehicle.parameter_values.get("PLND_LAG", DEFAULT_PLND_LAG_S), 0.0), PLND_LAG_MAX_S)
            transit_s = 0.5 * (vehicle.round_trip_s or 0.0) + self._o.receiver_s
            return lag_locked(self.track, now, lag_s, transit_s), "no attitude"
        newest = vehicle.positions[-1].stamp.measured_at if vehicle.positions else now
        at = min(now, newest)
        if self._newest is not None and at <= self._newest:
            return None, "no newer position"
        return self.track.at(at), "no attitude"

    def _stale_s(self, now: MonoNs) -> float:
        """Return the age of a sighting up to which a target leaves: where no other setpoints leave, longer in the last metre."""
        seen = None if self.lead is None else self.track.at(now)
        low = seen is not None and float(seen.d_body_pad_ned[2]) < _BLIND_BELOW_M
        return max(self.stale_s, self.lead.blind_s) if self.lead is not None and low else self.stale_s

    def _range(self, now: MonoNs, vehicle: AutopilotView, sighted: MonoNs | None) -> Message:
        sigma_m, range_m = 0.05, None
        if vehicle.condition.flying is False:
            range_m = self._o.ground_clearance_m
        elif sighted is not None and seconds_between(sighted, now) <= self.stale_s:
            seen = self.track.at(now)
            if seen is not None:
                range_m = range_along_down(seen.d_body_pad_ned, seen.R_ned_body)
                sigma_m = math.sqrt(max(float(seen.cov_ned[2, 2]), 1e-4))
        return distance_sensor(now // 1_000_000, range_m, sigma_m, self._o.range_id)

    @staticmethod
    def _time_has_come(last: MonoNs | None, now: MonoNs, rate_hz: float) -> bool:
        # A tick that comes a little early counts; otherwise a rate near that of the ticks would be halved.
        return last is None or seconds_between(last, now) >= 0.9 / rate_hz
