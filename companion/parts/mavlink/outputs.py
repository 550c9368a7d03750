"""The messages about the pad that each kind of autopilot is sent. No I/O; each call brings the time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Protocol

from companion.parts.mavlink.landing_target import (
    ardupilot_landing_target,
    distance_sensor,
    px4_landing_target,
    range_along_down,
    target_relative,
)
from companion.parts.mavlink.target_track import TargetSample, TargetTrack, lag_locked, position_at
from companion.settings.mavlink import OutputOptions
from drivers.mavlink.dialect import Message
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.vehicle import Condition, Stack
from estimator.contracts.time import MonoNs, seconds_between

DEFAULT_PLND_LAG_S, PLND_LAG_MAX_S = 0.02, 0.25
"""Default and largest PLND_LAG of ArduPilot, s."""
_MAVLINK_RANGEFINDER = 10.0
"""The RNGFNDx_TYPE of a rangefinder that reads DISTANCE_SENSOR."""


class AutopilotView(Protocol):
    """The part of the autopilot's state that `Outputs` reads."""

    @property
    def stack(self) -> Stack: ...

    @property
    def condition(self) -> Condition: ...

    @property
    def positions(self) -> tuple[LocalPosition, ...]: ...

    @property
    def round_trip_s(self) -> float | None: ...

    @property
    def parameter_values(self) -> Mapping[str, float]: ...


class Outputs:
    """Makes LANDING_TARGET, TARGET_RELATIVE and DISTANCE_SENSOR, each when it is due.

    No target is sent while the vehicle is on the ground: a target that moves after touchdown can keep ArduPilot from disarming.

    Args:
        pad_radius_m: the radius of the pad's disc.
        stale_s: the time without a sighting after which the pad is no longer sent.
    """

    def __init__(self, options: OutputOptions, track: TargetTrack, pad_radius_m: float, stale_s: float) -> None:
        self._o = options
        self._pad_radius_m = pad_radius_m
        self._stale_s = stale_s
        self._track = track
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
        return vehicle.stack is Stack.ARDUPILOT and _MAVLINK_RANGEFINDER in kinds

    def due(self, now: MonoNs, vehicle: AutopilotView, sighted: MonoNs | None) -> list[Message]:
        """Return the messages that are due at this instant.

        Args:
            sighted: when the pad was last seen, None for never.
        """
        out: list[Message] = []
        if self._time_has_come(self._target_at, now, self._o.rate_hz):
            out += self.target(now, vehicle, sighted)
        if self._time_has_come(self._range_at, now, self._o.range_rate_hz) and self.sends_ranges(vehicle):
            self._range_at = now
            out.append(self._range(now, vehicle, sighted))
        return out

    def target(self, now: MonoNs, vehicle: AutopilotView, sighted: MonoNs | None) -> list[Message]:
        """Return the target to send now, whether or not it is due; the next one is due one period later."""
        self._target_at = now
        seen, why = self._target(now, vehicle, sighted)
        if seen is None:
            self.withheld[why] += 1
            return []
        time_us = seen.at // 1000
        radius_m = self._pad_radius_m
        if vehicle.stack is Stack.ARDUPILOT:
            message = ardupilot_landing_target(
                now // 1000, seen.d_body_pad_ned, seen.R_ned_body, pad_radius_m=radius_m, R_ned_pad=seen.R_ned_pad
            )
        else:
            p_body_ned = position_at(vehicle.positions, seen.at)
            if p_body_ned is None:
                self.withheld["no local position"] += 1
                return []
            message = px4_landing_target(
                time_us, seen.d_body_pad_ned, seen.R_ned_body, p_body_ned, pad_radius_m=radius_m, R_ned_pad=seen.R_ned_pad
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
        if sighted is None or seconds_between(sighted, now) > self._stale_s:
            return None, "not seen"
        if vehicle.stack is Stack.ARDUPILOT:
            lag_s = min(max(vehicle.parameter_values.get("PLND_LAG", DEFAULT_PLND_LAG_S), 0.0), PLND_LAG_MAX_S)
            transit_s = 0.5 * (vehicle.round_trip_s or 0.0) + self._o.receiver_s
            return lag_locked(self._track, now, lag_s, transit_s), "no attitude"
        newest = vehicle.positions[-1].stamp.measured_at if vehicle.positions else now
        at = min(now, newest)
        if self._newest is not None and at <= self._newest:
            return None, "no newer position"
        return self._track.at(at), "no attitude"

    def _range(self, now: MonoNs, vehicle: AutopilotView, sighted: MonoNs | None) -> Message:
        sigma_m, range_m = 0.05, None
        if vehicle.condition.flying is False:
            range_m = self._o.ground_clearance_m
        elif sighted is not None and seconds_between(sighted, now) <= self._stale_s:
            seen = self._track.at(now)
            if seen is not None:
                range_m = range_along_down(seen.d_body_pad_ned, seen.R_ned_body)
                sigma_m = math.sqrt(max(float(seen.cov_ned[2, 2]), 1e-4))
        return distance_sensor(now // 1_000_000, range_m, sigma_m, self._o.range_id)

    @staticmethod
    def _time_has_come(last: MonoNs | None, now: MonoNs, rate_hz: float) -> bool:
        # A tick that comes a little early counts; otherwise a rate near that of the ticks would be halved.
        return last is None or seconds_between(last, now) >= 0.9 / rate_hz
