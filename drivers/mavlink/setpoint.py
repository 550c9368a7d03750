"""Build setpoints of velocity, with or without acceleration: SET_POSITION_TARGET_LOCAL_NED as both stacks obey it. No I/O.

Measured on ArduCopter 4.5.7 and PX4 1.16.2: the frame MAV_FRAME_LOCAL_NED and the mask 0x05C7 (velocity and yaw rate used) move
both. If yaw and yaw rate are both ignored, ArduCopter turns the nose into the direction of travel, so a yaw rate is always given.
A mask that ignores one velocity axis stops ArduCopter. The acceleration of a lean is fed forward to their velocity controllers
(ArduCopter GUIDED takes velocity and acceleration together, PX4 OFFBOARD as a trajectory setpoint); its trim is not sent, because
both cancel wind by themselves.
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


def velocity_setpoint(time_boot_ms: int, target: tuple[int, int], command: Velocity | Lean, yaw_rad: float) -> Message:
    """Return the setpoint that flies `command`.

    Args:
        time_boot_ms: time of this program's own clock, ms; it wraps at 32 bits.
        target: system and component of the autopilot.
        command: velocity in the level frame and yaw rate, for a lean with its acceleration.
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
