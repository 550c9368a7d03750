"""Receivers of LANDING_TARGET as each autopilot has them, written independently from its published source.

ArduPilot: AC_PrecLand_MAVLink::handle_msg (4.0 and current), AC_PrecLand::construct_pos_meas_using_rangefinder and the inertial
ring. PX4: MavlinkReceiver::handle_message_landing_target and LandingTargetEstimator. Nothing of the project's geometry is used.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

Vector = tuple[float, float, float]
Euler = tuple[float, float, float]
"""Roll, pitch, yaw in rad."""


def body_to_ned(rpy: Euler, v: Vector) -> Vector:
    """One axis after the other: roll about x, pitch about y, yaw about z."""
    x, y, z = v
    roll, pitch, yaw = rpy
    y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
    x, z = x * math.cos(pitch) + z * math.sin(pitch), -x * math.sin(pitch) + z * math.cos(pitch)
    x, y = x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw)
    return x, y, z


def ned_to_body(rpy: Euler, v: Vector) -> Vector:
    """Return the inverse of the same rotations."""
    x, y, z = v
    roll, pitch, yaw = rpy
    x, y = x * math.cos(yaw) + y * math.sin(yaw), -x * math.sin(yaw) + y * math.cos(yaw)
    x, z = x * math.cos(pitch) - z * math.sin(pitch), x * math.sin(pitch) + z * math.cos(pitch)
    y, z = y * math.cos(roll) + z * math.sin(roll), -y * math.sin(roll) + z * math.cos(roll)
    return x, y, z


@dataclass
class ArduPilotReceiver:
    """AC_PrecLand with a companion: `loop` 400 times a second, `hear` whenever a message comes."""

    lag_s: float = 0.02
    loop_rate_hz: float = 400.0
    angles_only: bool = False
    """Firmware before 4.1."""
    rangefinder_m: float | None = None
    """Along the body's down axis."""
    texts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._ring: deque[Euler] = deque(maxlen=max(round(self.lag_s * self.loop_rate_hz), 1))

    def loop(self, rpy: Euler) -> None:
        self._ring.append(rpy)

    def on_message(self, m: Any) -> Vector | None:
        """Return the target from the vehicle in north, east, down for the filter; None when the message is dropped."""
        distance = max(0.0, m.distance)
        if self.angles_only or m.position_valid != 1:
            ray = (-math.tan(m.angle_y), math.tan(m.angle_x), 1.0)
            length = math.sqrt(sum(v * v for v in ray))
        else:
            if m.frame != 12:
                if not self.texts:
                    self.texts.append("Plnd: Frame not supported")
                return None
            if distance <= 0.0:
                return None
            ray, length = (m.x, m.y, m.z), distance
        ray = (ray[0] / length, ray[1] / length, ray[2] / length)
        if ray[2] <= 0.0:
            return None
        tilt = self._ring[0]
        ray_ned = body_to_ned(tilt, ray)
        if distance <= 0.0:
            if self.rangefinder_m is None:
                return None
            approach = body_to_ned(tilt, (0.0, 0.0, 1.0))
            distance = self.rangefinder_m / sum(a * b for a, b in zip(ray_ned, approach, strict=True))
        return (ray_ned[0] * distance, ray_ned[1] * distance, ray_ned[2] * distance)


@dataclass
class Px4Receiver:
    """mavlink_receiver and landing_target_estimator."""

    rpy: Euler = (0.0, 0.0, 0.0)
    dist_bottom_m: float = 0.0
    events: list[str] = field(default_factory=list)

    def on_message(self, m: Any) -> tuple[str, Vector] | None:
        """("absolute", place in the local frame), or ("relative", from the vehicle) by way of an IR-LOCK report."""
        if m.position_valid:
            if m.frame != 1:
                self.events.append(f"landing target: unsupported coordinate frame {m.frame}")
                return None
            return "absolute", (m.x, m.y, m.z)
        ray = body_to_ned(self.rpy, (m.angle_x, m.angle_y, 1.0))
        if abs(ray[2]) < 1e-6:
            return None
        return "relative", (ray[0] / ray[2] * self.dist_bottom_m, ray[1] / ray[2] * self.dist_bottom_m, self.dist_bottom_m)
