"""The gimbal's messages of a stand-in: reports, and the commands of a gimbal manager (MAVLink's gimbal protocol v2).

Source: mavlink.io, "Gimbal Protocol v2".
"""

import math
from collections import Counter, deque

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.geometry import Rotation
from sitl.camera.gimbal import SimulatedGimbal

_REPORT_S, _STATUS_S = 0.2, 0.2
"""Interval of reports that nobody has requested otherwise, and of the manager's status."""
_BOOT_MS = 77_000
"""Age of the clock of a gimbal that is a component of its own, at the start."""
_ACCEPTED, _DENIED, _UNSUPPORTED = (
    int(result) for result in (mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED, mav.MAV_RESULT_UNSUPPORTED)
)
_LOCKS = int(mav.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mav.GIMBAL_DEVICE_FLAGS_PITCH_LOCK)


class GimbalLink:
    """The messages of a simulated gimbal and of its manager, which is the autopilot."""

    def __init__(self, gimbal: SimulatedGimbal, system: int) -> None:
        self._gimbal, self._system = gimbal, system
        self._own = gimbal.settings.device_id > 6
        self._interval_s = _REPORT_S
        self._report_s = self._status_s = 0.0
        self._began_s: float | None = None
        self._on_the_way: deque[tuple[float, Message]] = deque()
        self.control: tuple[int, int] = (0, 0)
        """The (system, component) that has primary control; zeros for nobody."""
        self.commands: Counter[int] = Counter()

    @property
    def component(self) -> int:
        """The component that reports."""
        return self._gimbal.settings.device_id if self._own else 1

    def on_command(self, m: Message, sender: tuple[int, int]) -> int | None:
        """Take a COMMAND_LONG; return its result, or None of one that is not for gimbal or manager."""
        if m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            asked = m.param1 == mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS
            if m.target_component != self.component or not (asked or self._own):
                return None
            if not asked:
                return _UNSUPPORTED
            self._interval_s = max(1e-6 * m.param2, 0.005)
            return _ACCEPTED
        if m.target_component != 1 or m.param7 not in (0, self._gimbal.settings.device_id):
            return None
        if m.command == mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            self.commands[m.command] += 1
            self.control = int(m.param1), int(m.param2)
            return _ACCEPTED
        if m.command == mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:
            self.commands[m.command] += 1
            if self.control != sender or not math.isfinite(m.param1):
                return _DENIED
            self._gimbal.point(math.radians(m.param1))
            return _ACCEPTED
        return None

    def due(self, now_s: float, boot_ms: int, yaw_rad: float) -> list[tuple[int, Message]]:
        """Return what is sent now, each with its component.

        Args:
            boot_ms: the autopilot's time since boot.
            yaw_rad: the vehicle's heading.
        """
        s = self._gimbal.settings
        self._began_s = now_s if self._began_s is None else self._began_s
        since_s = now_s - self._began_s
        silent = 0.0 < s.silent_at_s <= since_s
        if now_s >= self._report_s and not silent:
            self._report_s = max(now_s, self._report_s + self._interval_s)
            stamp_ms = _BOOT_MS + int(1e3 * since_s) if self._own else boot_ms
            self._on_the_way.append((now_s + s.report_delay_s, self._report(stamp_ms, yaw_rad)))
        out: list[tuple[int, Message]] = []
        while self._on_the_way and self._on_the_way[0][0] <= now_s:
            out.append((self.component, self._on_the_way.popleft()[1]))
        if now_s >= self._status_s:
            self._status_s = now_s + _STATUS_S
            out.append((1, mav.MAVLink_gimbal_manager_status_message(boot_ms, 0, s.device_id, *self.control, 0, 0)))
        return out

    def _report(self, stamp_ms: int, yaw_rad: float) -> Message:
        s, rotation = self._gimbal.settings, self._gimbal.R_ned_gimbal
        flags, delta = _LOCKS | int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME), math.nan
        if s.yaw == "vehicle":
            rotation = Rotation.from_rpy(0.0, 0.0, -yaw_rad) @ rotation
            flags = _LOCKS | int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME)
        q, number = rotation.quat_wxyz.tolist(), 0 if self._own else s.device_id
        return mav.MAVLink_gimbal_device_attitude_status_message(
            self._system, 0, stamp_ms, flags, q, *self._gimbal.w_gimbal.tolist(), 0, delta, math.nan, number
        )
