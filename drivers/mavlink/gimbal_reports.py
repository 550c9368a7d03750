"""Take the attitudes that a gimbal reports.

The quaternion of GIMBAL_DEVICE_ATTITUDE_STATUS has roll and pitch against the horizon, and a yaw from the vehicle's
heading or from north, as its flags say. MOUNT_ORIENTATION is the same in degrees. MOUNT_STATUS has hundredths of a degree against
the vehicle itself, as ArduPilot sends it of servo gimbals.

Source: mavlink.io, "Gimbal Protocol v2" and the definitions of messages 158, 265 and 285.
"""

import math
from collections import Counter

import numpy as np
from msgspec.structs import replace

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.mavlink.boot_clock import MS_WRAP_NS, BootClock, boot_ms
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.options import GimbalOptions
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import GimbalAttitude, GimbalFrame
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, seconds_between

DEVICE_STATUS, MOUNT_ORIENTATION, MOUNT_STATUS = "GIMBAL_DEVICE_ATTITUDE_STATUS", "MOUNT_ORIENTATION", "MOUNT_STATUS"
_VEHICLE_YAW, _EARTH_YAW = int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME), int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME)
_YAW_LOCK = int(mav.GIMBAL_DEVICE_FLAGS_YAW_LOCK)
_FAILURES = int(
    mav.GIMBAL_DEVICE_ERROR_FLAGS_ENCODER_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_POWER_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_MOTOR_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_SOFTWARE_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_COMMS_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_CALIBRATION_RUNNING
)
"""Failures with which the reported attitude need not be the camera's. At a limit of its travel a gimbal still knows its own."""
_LENGTH_OFF = 0.05
"""Largest difference of a quaternion's length from one."""
_ANGLE_MAX_DEG = 720.0  # angles beyond this are damaged
_ARRIVAL_SIGMA_S = 0.02
"""Standard deviation of the instant of a report without a stamp, which has the time of its arrival."""
_OLDER_AFTER_S = 1.0
"""Time without a report of the gimbal protocol after which MOUNT_ORIENTATION is taken."""
_OWN_CLOCK = ClockMapOptions(wrap_ns=MS_WRAP_NS, resolution_s=0.001, floor_s=0.001, floor_sigma_s=0.005, name="the gimbal")


class Refused(Exception):
    """A report that cannot be used; its text is the reason, one word for counting."""


class GimbalSampler:
    """Reports of one gimbal, in the order in which they were received, to samples."""

    def __init__(self, options: GimbalOptions) -> None:
        self._o = options
        self._cov = np.eye(3) * options.sigma_rad**2
        self._cov.setflags(write=False)
        self._clock = ClockMap(_OWN_CLOCK)
        self._device_at: MonoNs | None = None
        self.newest: GimbalAttitude | None = None
        self.refused: Counter[str] = Counter()
        """Reports that were refused, by reason: rotation, frame, failure, angle, old."""

    def restart(self) -> None:
        """Forget the sender's clock, because it has booted or another one reports."""
        self._clock, self._device_at, self.newest = ClockMap(_OWN_CLOCK), None, None

    def sample(self, message: Message, received_at: MonoNs, boot: BootClock | None) -> GimbalAttitude | None:
        """Return the sample of a message; None of one that is no report of the chosen kind, or is refused.

        Args:
            boot: the clock of the autopilot, if that stamped the message; None if the gimbal itself did.
        """
        kind = message.get_type()
        if not self._chosen(kind, received_at):
            return None
        try:
            frame, rotation = self._rotation(kind, message)
        except Refused as why:
            self.refused[str(why)] += 1
            return None
        stamp = self._stamp(getattr(message, "time_boot_ms", 0), received_at, boot)
        if self.newest is not None and stamp.measured_at <= self.newest.stamp.measured_at:
            self.refused["old"] += 1
            return None
        if kind == DEVICE_STATUS:
            self._device_at = received_at
        self.newest = GimbalAttitude(stamp, frame, rotation, self._cov)
        return self.newest

    def _chosen(self, kind: str, received_at: MonoNs) -> bool:
        if self._o.report == "mount_status":
            return kind == MOUNT_STATUS
        if kind == MOUNT_ORIENTATION:
            return self._device_at is None or seconds_between(self._device_at, received_at) > _OLDER_AFTER_S
        return kind == DEVICE_STATUS

    def _rotation(self, kind: str, m: Message) -> tuple[GimbalFrame, Rotation]:
        if kind == DEVICE_STATUS:
            return _of_device(m)
        if kind == MOUNT_ORIENTATION:
            if math.isfinite(m.yaw):
                return "level", _of_degrees(m.roll, m.pitch, m.yaw)
            return "ned", _of_degrees(m.roll, m.pitch, m.yaw_absolute)
        return "body", _of_degrees(0.01 * m.pointing_b, 0.01 * m.pointing_a, 0.01 * m.pointing_c)

    def _stamp(self, time_boot_ms: int, received_at: MonoNs, boot: BootClock | None) -> Stamp:
        if time_boot_ms == 0:
            stamp = Stamp(received_at, received_at, _ARRIVAL_SIGMA_S, "arrival")
        elif boot is not None:
            stamp = boot.stamp(boot_ms(time_boot_ms), received_at)
        else:
            stamp = self._clock.stamp(boot_ms(time_boot_ms), received_at)
        measured_at = MonoNs(stamp.measured_at - round(self._o.latency_s * NS_PER_S))
        sigma_s = min(math.hypot(stamp.sigma_s, self._o.latency_sigma_s), 0.9)
        return replace(stamp, measured_at=measured_at, sigma_s=sigma_s)


def _of_device(m: Message) -> tuple[GimbalFrame, Rotation]:
    """Return the frame and the rotation of a GIMBAL_DEVICE_ATTITUDE_STATUS.

    Where an attitude from north comes with the vehicle's heading by the same clockwork, `delta_yaw`, that is taken out: two
    compasses differ. A field that a sender leaves out reads zero.

    Raises:
        Refused: a failure, flags that contradict one another, or no rotation.
    """
    if m.failure_flags & _FAILURES:
        raise Refused("failure")
    stated = m.flags & (_VEHICLE_YAW | _EARTH_YAW)
    if stated == _VEHICLE_YAW | _EARTH_YAW:
        raise Refused("frame")
    size = math.sqrt(sum(q * q for q in m.q))
    if not abs(size - 1.0) <= _LENGTH_OFF:
        raise Refused("rotation")
    rotation = Rotation.from_quat(list(m.q))
    if stated == _VEHICLE_YAW or not (stated or m.flags & _YAW_LOCK):
        return "level", rotation
    if stated and math.isfinite(m.delta_yaw) and 0.0 < abs(m.delta_yaw) <= math.tau:
        return "level", Rotation.from_rpy(0.0, 0.0, -m.delta_yaw) @ rotation
    return "ned", rotation


def _of_degrees(roll: float, pitch: float, yaw: float) -> Rotation:
    """Return a rotation of angles in degrees.

    Raises:
        Refused: one is no angle.
    """
    if not all(abs(angle) <= _ANGLE_MAX_DEG for angle in (roll, pitch, yaw)):
        raise Refused("angle")
    return Rotation.from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw))
