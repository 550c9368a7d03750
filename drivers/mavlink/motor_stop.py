"""Stop an autopilot's motors on deck: ask it to disarm until it reports that it is disarmed. No I/O.

Both stacks refuse to disarm while they take themselves to fly. PX4's land detector compares the vertical speed over the ground
with LNDMC_Z_VEL_MAX, which a heaving deck exceeds; so once guidance has felt the deck, and says so in every cycle, the forced
form is sent. The setpoint stream goes on until the motors have stood for a while: an autopilot that is still armed when the
stream ends takes that for a failure (COM_OF_LOSS_T, GUID_TIMEOUT).
"""

from __future__ import annotations

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import MonoNs, seconds_between

FORCE = 21196.0
"""Parameter 2 of COMPONENT_ARM_DISARM that disarms whatever the autopilot takes itself to do (mavlink.io)."""
OUTLIVE_S = 0.5
"""Time for which setpoints go on after the report that the motors stand, s."""
_EACH_S, _SLOW_S = 0.2, 1.0
_QUICK_S = 5.0
"""Time after which it is asked less often, s."""


def disarm(target: tuple[int, int], *, forced: bool) -> Message:
    """Return the command that stops the motors."""
    number = mav.MAV_CMD_COMPONENT_ARM_DISARM
    return mav.MAVLink_command_long_message(*target, number, 0, 0.0, FORCE if forced else 0.0, 0, 0, 0, 0, 0)


class MotorStop:
    """One stop of the motors, from the first request until it has come about."""

    def __init__(self, now: MonoNs) -> None:
        self._began = now
        self._asked: MonoNs | None = None
        self._stood: MonoNs | None = None

    def period(self, now: MonoNs, target: tuple[int, int], *, armed: bool | None, forced: bool) -> list[Message]:
        """Return the request of this period, if one is due."""
        if armed is False:
            self._stood = self._stood or now
            return []
        self._stood = None
        each_s = _EACH_S if seconds_between(self._began, now) < _QUICK_S else _SLOW_S
        if self._asked is not None and seconds_between(self._asked, now) < each_s:
            return []
        self._asked = now
        return [disarm(target, forced=forced)]

    def over(self, now: MonoNs) -> bool:
        """Return whether the motors have stood for long enough that the setpoints may end."""
        return self._stood is not None and seconds_between(self._stood, now) >= OUTLIVE_S
