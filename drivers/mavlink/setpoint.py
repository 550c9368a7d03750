"""Build setpoints of velocity, with or without acceleration: SET_POSITION_TARGET_LOCAL_NED as both stacks obey it. No I/O.

Measured on ArduCopter 4.5.7 and PX4 1.16.2: the frame MAV_FRAME_LOCAL_NED and the mask 0x05C7 (velocity and yaw rate used) move
both. If yaw and yaw rate are both ignored, ArduCopter turns the nose into the direction of travel, so a yaw rate is always given.
A mask that ignores one velocity axis stops ArduCopter. The acceleration of a tilt is fed forward to their velocity controllers
(ArduCopter GUIDED takes velocity and acceleration together, PX4 OFFBOARD as a trajectory setpoint); its trim is not sent, because
both cancel wind by themselves.

Take-off modes hold a place over the ground. PX4 does so while its rotors spool up for three or four seconds already, and on a
ship under way it turns over; so it is armed and climbs in OFFBOARD, by setpoints with the deck's velocity. ArduCopter leaves
the ground in GUIDED by MAV_CMD_NAV_TAKEOFF only, which reads no place; once it flies, setpoints take it on.
"""

import math

import numpy as np

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.geometry import Rotation

VELOCITY_AND_YAW_RATE = 0x05C7
"""POSITION_TARGET_TYPEMASK that ignores position (0x7), acceleration (0x1C0) and yaw (0x400)."""


VELOCITY_ACCELERATION_AND_YAW_RATE = 0x0407
"""POSITION_TARGET_TYPEMASK that ignores position (0x7) and yaw (0x400)."""
_LEVEL_THRUST = 0.12
"""Thrust with which ArduCopter comes to stand on a deck, of the largest. It reads this as a descent by three quarters of
WPNAV_SPEED_DN, 1.1 m/s by default, and as a thrust where GUID_OPTIONS has 8."""
_OPPOSITE = 3.0  # lean to the other side for each radian that it still leans: it is level the sooner (docs/decisions/contact.md)
_OPPOSITE_MOST_RAD = math.radians(8.0)  # lean to the other side at most (docs/decisions/contact.md)


def velocity_setpoint(time_boot_ms: int, target: tuple[int, int], command: Velocity | Lean, yaw_rad: float) -> Message:
    """Return the setpoint that flies `command`.

    Args:
        time_boot_ms: time of this program's own clock, ms; it wraps at 32 bits.
        target: system and component of the autopilot.
        command: velocity in the level frame and yaw rate, for a tilt with its acceleration.
        yaw_rad: heading of the body in the autopilot's own frame; it rotates `v_level` into north and east.

    Raises:
        ValueError: the heading is not finite.
    """
    if not math.isfinite(yaw_rad):
        raise ValueError(f"a heading must be finite, got {yaw_rad!r}")
    R_ned_level = Rotation.from_rpy(0.0, 0.0, yaw_rad)
    north, east, down = (float(v) for v in R_ned_level @ command.v_level)
    mask, a_north, a_east = VELOCITY_AND_YAW_RATE, 0.0, 0.0
    if isinstance(command, Lean):
        mask = VELOCITY_ACCELERATION_AND_YAW_RATE
        a_north, a_east, _ = (float(a) for a in R_ned_level @ np.append(command.a_level, 0.0))
    return mav.MAVLink_set_position_target_local_ned_message(
        time_boot_ms & 0xFFFFFFFF, *target, mav.MAV_FRAME_LOCAL_NED, mask,
        0.0, 0.0, 0.0, north, east, down, a_north, a_east, 0.0, 0.0, command.yaw_rate_rad_s,
    )  # fmt: skip


def level_setpoint(
    time_boot_ms: int, target: tuple[int, int], rpy_rad: tuple[float, float, float], turn_rad: float, yaw_rate_rad_s: float
) -> Message:
    """Return the setpoint with which ArduCopter comes to stand level on a deck, its weight on all feet.

    Its way to level by a velocity is limited in jerk, and meanwhile it turns about the foot that touched first.

    Args:
        time_boot_ms: time of this program's own clock, ms; it wraps at 32 bits.
        target: system and component of the autopilot.
        rpy_rad: attitude of the body in the autopilot's own frame.
        turn_rad: turn that is left to the wanted heading.
        yaw_rate_rad_s: rate of that turn, for which the autopilot's gain of a heading alone is too weak.
    """
    roll, pitch, yaw = rpy_rad
    opposite = -min(_OPPOSITE, _OPPOSITE_MOST_RAD / max(math.hypot(roll, pitch), 1e-9))
    q = Rotation.from_rpy(opposite * roll, opposite * pitch, yaw + turn_rad).quat_wxyz.tolist()
    ms = time_boot_ms & 0xFFFFFFFF
    return mav.MAVLink_set_attitude_target_message(ms, *target, 0, q, 0.0, 0.0, yaw_rate_rad_s, _LEVEL_THRUST)
