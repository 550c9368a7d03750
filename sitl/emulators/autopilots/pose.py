"""The pose of a vehicle in another simulator, from the MAVLink messages of that simulator or of its autopilot. No I/O here."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.requests import message_id
from drivers.mavlink.samples import LocalPosition
from drivers.mavlink.vehicle import Stack
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, seconds_between

TRUTH = {Stack.ARDUPILOT: "SIM_STATE", Stack.PX4: "HIL_STATE_QUATERNION"}
"""The message in which the simulator of each stack reports the true state."""
_EARTH_M = 6_371_000.0
_ASK_S, _ASKS = 5.0, 3
_TRUTH_LAST_S = 1.0
_GAP_S = 0.2
_MEAN_S = 3.0
"""Time over which the distance between truth and estimate is averaged."""


@dataclass(frozen=True, slots=True, eq=False)
class AutopilotPose:
    """The body at one instant."""

    at: MonoNs
    p_ned: F64
    """(3,) position from the source's origin, m."""
    v_ned: F64
    """(3,) velocity, m/s."""
    R_ned_body: Rotation
    w_body: F64
    """(3,) angular velocity, rad/s; zeros if no source reports it."""
    is_truth: bool
    """Whether the position is the simulator's true one; otherwise it is the autopilot's estimate."""


class PoseSource:
    """Estimate the vehicle's pose from all its messages.

    The pose is the autopilot's own, which is smooth and stamped. If the simulator reports the true position, the pose is shifted
    by the mean difference of the two, because the true position comes in steps of a centimetre and without a stamp of the
    autopilot's clock.
    """

    def __init__(self) -> None:
        self._origin: tuple[float, float, float] | None = None
        self._truth_at: MonoNs | None = None
        self._w_body = np.zeros(3)
        self._apart = np.zeros(3)
        """(3,) mean of the true position minus the autopilot's, m."""
        self._known_s = 0.0
        self._asked: MonoNs | None = None
        self._asks = 0

    def ask(self, stack: Stack, target: tuple[int, int], now: MonoNs, rate_hz: float = 50.0) -> list[Message]:
        """Return the request for the true state when it is due, or None; a simulator without one ignores it."""
        name = TRUTH.get(stack)
        waits = self._asked is not None and seconds_between(self._asked, now) < _ASK_S
        if name is None or self.truthful(now) or waits or self._asks >= _ASKS:
            return []
        self._asked, self._asks = now, self._asks + 1
        interval_us = round(1e6 / rate_hz)
        number = message_id(name)
        return [
            mav.MAVLink_command_long_message(*target, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, interval_us, 0, 0, 0, 0, 0)
        ]

    def truthful(self, now: MonoNs) -> bool:
        """Whether the simulator reported the true position recently."""
        return self._truth_at is not None and seconds_between(self._truth_at, now) < _TRUTH_LAST_S

    def on_message(self, message: Message, now: MonoNs, positions: tuple[LocalPosition, ...]) -> None:
        """Process any message of the vehicle.

        Args:
            positions: the autopilot's own positions at that time, the newest last.
        """
        kind = message.get_type()
        if kind == "SIM_STATE":
            lat, lon = (getattr(message, f"{n}_int", 0) for n in ("lat", "lon"))
            place = (1e-7 * lat, 1e-7 * lon) if lat or lon else (float(message.lat), float(message.lon))
            self._tell(now, (*place, float(message.alt)), (message.xgyro, message.ygyro, message.zgyro), positions)
        elif kind == "HIL_STATE_QUATERNION":
            place = (1e-7 * message.lat, 1e-7 * message.lon)
            rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
            self._tell(now, (*place, 1e-3 * message.alt), rates, positions)

    def newest(
        self, now: MonoNs, positions: tuple[LocalPosition, ...], attitude: Attitude | None, *, by_truth: bool = True
    ) -> AutopilotPose | None:
        """Return the pose at the newest attitude, or None before the autopilot has reported its position.

        Args:
            positions: the autopilot's own positions, the newest last.
            attitude: the autopilot's newest attitude.
            by_truth: shift the pose to the true position if it is reported.
        """
        if not positions or attitude is None:
            return None
        last, at = positions[-1], attitude.stamp.measured_at
        since_s = seconds_between(last.stamp.measured_at, at)
        if abs(since_s) > _GAP_S:
            return None
        truthful = by_truth and self.truthful(now)
        p = last.p_body_ned + since_s * last.v_body_ned
        if truthful:
            p = p + self._apart
        return AutopilotPose(at, p, last.v_body_ned, attitude.R_ned_body, self._w_body if truthful else np.zeros(3), truthful)

    def _tell(
        self, now: MonoNs, place: tuple[float, float, float], rates: tuple[float, ...], positions: tuple[LocalPosition, ...]
    ) -> None:
        if not all(map(math.isfinite, (*place, *rates))) or not positions:
            return
        lat, lon, alt_m = place
        if self._origin is None:
            self._origin = place
        lat0, lon0, alt0_m = self._origin
        north = math.radians(lat - lat0) * _EARTH_M
        east = math.radians(lon - lon0) * _EARTH_M * math.cos(math.radians(lat0))
        last = positions[-1]
        there = last.p_body_ned + seconds_between(last.stamp.measured_at, now) * last.v_body_ned
        apart = np.array([north, east, alt0_m - alt_m]) - there
        since_s = 0.0 if self._truth_at is None else min(max(seconds_between(self._truth_at, now), 1e-3), _TRUTH_LAST_S)
        self._known_s += since_s
        share = 1.0 if self._truth_at is None else since_s / min(max(self._known_s, since_s), _MEAN_S)
        self._apart = self._apart + share * (apart - self._apart)
        self._truth_at, self._w_body = now, np.array(rates, dtype=float)
