"""Point a gimbal down by commands to its manager. No I/O.

Control is taken (MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE), then the angle is given (MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW); each is
repeated until it is answered. The gimbal is then left alone while its own reports say that it points down.
"""

import logging
import math
from collections import Counter
from enum import Enum

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import MonoNs, after

_log = logging.getLogger(__name__)

OFF_RAD = math.radians(10.0)
"""Angle from the vertical beyond which the gimbal has left: less than what a stabilizing gimbal lags behind in a gust."""
_REPEAT_S = 1.0  # time to the next command after one that was not answered
_REFUSED_S = 5.0  # time to the next command after one that was refused
_SETTLE_S = 4.0  # time to the next command after one that was accepted: the gimbal moves
_KEEP = -1.0  # parameter that leaves secondary control unchanged
_CONTROL = int(mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE)
_POINT = int(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW)
_DONE = frozenset({int(mav.MAV_RESULT_ACCEPTED), int(mav.MAV_RESULT_IN_PROGRESS)})
_UNSUPPORTED = int(mav.MAV_RESULT_UNSUPPORTED)
_FLAGS = int(
    mav.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | mav.GIMBAL_MANAGER_FLAGS_PITCH_LOCK | mav.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME
)
"""Roll and pitch against the horizon, yaw with the vehicle."""


class Step(Enum):
    """Next request to the gimbal manager."""

    CONTROL = "taking control"
    POINT = "pointing"
    POINTED = "pointed"


class GimbalPointer:
    """Commands to one gimbal's manager.

    Args:
        device_id: the gimbal.
    """

    def __init__(self, device_id: int) -> None:
        self._device_id = device_id
        self._asked: int | None = None
        self._not_before: MonoNs | None = None
        self._logged: set[tuple[int, int]] = set()
        self.step = Step.CONTROL
        self.counts: Counter[str] = Counter()
        """The number of times that it was pointed down (`pointed`), had left (`left`), and that a command was refused."""

    def restart(self) -> None:
        """Begin again, because the autopilot or the gimbal has."""
        self.step, self._asked, self._not_before = Step.CONTROL, None, None

    def due(self, now: MonoNs, us: tuple[int, int], manager: tuple[int, int], off_rad: float | None) -> list[Message]:
        """Return the command to send now as a list of at most one message.

        Args:
            us: our (system, component).
            manager: the (system, component) of the gimbal's manager.
            off_rad: the angle between the gimbal and the vertical as it reports it; None while it reports none.
        """
        if self._not_before is not None and now < self._not_before:
            return []
        if self.step is Step.POINTED:
            if off_rad is None or off_rad <= OFF_RAD:
                return []
            self.counts["left"] += 1
            _log.info("gimbal %d: %.0f degrees off the vertical; pointing it down again", self._device_id, math.degrees(off_rad))
            self.step = Step.CONTROL
        self._not_before = after(now, _REPEAT_S)
        if self.step is Step.CONTROL:
            self._asked = _CONTROL
            return [self._command(manager, _CONTROL, float(us[0]), float(us[1]), _KEEP, _KEEP, 0.0)]
        self._asked = _POINT
        return [self._command(manager, _POINT, -90.0, 0.0, math.nan, math.nan, float(_FLAGS))]

    def on_ack(self, command: int, result: int, now: MonoNs) -> None:
        """Take a COMMAND_ACK of the manager."""
        if command != self._asked:
            return
        self._asked = None
        if command == _CONTROL and (result in _DONE or result == _UNSUPPORTED):
            self.step, self._not_before = Step.POINT, None
        elif command == _POINT and result in _DONE:
            self.step, self._not_before = Step.POINTED, after(now, _SETTLE_S)
            self.counts["pointed"] += 1
        else:
            self.step, self._not_before = Step.CONTROL, after(now, _REFUSED_S)
            self.counts["refused"] += 1
            if (command, result) not in self._logged and len(self._logged) < 16:
                self._logged.add((command, result))
                what = "control" if command == _CONTROL else "to be pointed down"
                _log.warning("gimbal %d: its manager refuses %s (result %d); requesting it again", self._device_id, what, result)

    def _command(self, manager: tuple[int, int], command: int, *values: float) -> Message:
        return mav.MAVLink_command_long_message(*manager, command, 0, *values, 0.0, float(self._device_id))
