"""Find why an AR.Drone is landing, and whether that landing is to be called off. No I/O.

The firmware lands a drone that has received no command for a while, over deck or water alike. A service that comes back calls
such a landing off; it never calls off one that a person, a low battery or a fault began. Near the ground no landing is called
off: the bit that calls it off starts the motors of a drone that has touched down in the meantime.
"""

from enum import Enum

from drivers.ardrone.navdata import ControlState, Navdata, NavdataState
from estimator.contracts.time import MonoNs, seconds_between

GAP_S = 1.0
"""Navdata gap, or time without received commands by the drone's report, after which a landing can have begun for our silence.

Somebody else began any other landing, and the drone received the commands for it.
"""
FRESH_S = 0.2
"""A report older than this is no evidence that the drone is still in the air."""
SILENT_ABOVE_M = 0.5
"""An unordered landing, or one that guidance no longer requests, is called off above this height and finished below it."""
ORDERED_ABOVE_M = 0.15
"""A landing that guidance takes back by another command is called off above this height."""
_SILENCE_REPORTED = NavdataState.COM_WATCHDOG | NavdataState.COMMUNICATION_LOST
"""Bits by which the drone reports that it receives no commands."""
_NOT_FOR_SILENCE = (
    NavdataState.BATTERY_LOW
    | NavdataState.USER_EMERGENCY
    | NavdataState.MOTOR_PROBLEM
    | NavdataState.CUTOUT
    | NavdataState.ANGLES_OUT_OF_RANGE
    | NavdataState.EMERGENCY
)
"""Bits of a drone whose landing has another reason than silence."""


class Cause(Enum):
    """The party that began the present landing."""

    OURS = "ours"
    SILENCE = "silence"
    """The firmware began the landing, because it received no commands."""
    OTHERS = "others"
    """A person, a low battery or a fault began the landing."""


class LandingWatch:
    """Follows the reports and remembers who began the present landing."""

    def __init__(self) -> None:
        self._newest: tuple[Navdata, MonoNs] | None = None
        """The newest report, and when it was received."""
        self._unheard_since: MonoNs | None = None
        """The first of the newest reports that all say that the drone receives no commands; None if the newest does not."""
        self.cause: Cause | None = None
        """The cause of the present landing; None while the drone is not landing."""

    def on_report(self, report: Navdata, now: MonoNs, *, ordered: bool) -> None:
        """Take the newest report; `ordered` says whether we are asking the drone to land."""
        gap = self._newest is None or seconds_between(self._newest[1], now) > GAP_S
        self._newest = report, now
        if not report.state & _SILENCE_REPORTED:
            self._unheard_since = None
        elif self._unheard_since is None:
            self._unheard_since = now
        if report.control_state is None:
            return
        if not (report.flying and report.control_state is ControlState.LANDING):
            self.cause = None
        elif self.cause is None:
            silent = self._unheard_since is not None and (gap or seconds_between(self._unheard_since, now) > GAP_S)
            if ordered:
                self.cause = Cause.OURS
            elif silent and not report.state & _NOT_FOR_SILENCE:
                self.cause = Cause.SILENCE
            else:
                self.cause = Cause.OTHERS

    def calls_off(self, now: MonoNs, above_m: float = SILENT_ABOVE_M) -> bool:
        """Return whether the present landing, which guidance does not request, is to be called off at this height."""
        if self._newest is None or self.cause not in (Cause.OURS, Cause.SILENCE):
            return False
        report, received_at = self._newest
        if report.state & _NOT_FOR_SILENCE or seconds_between(received_at, now) > FRESH_S or report.altitude_m is None:
            return False
        return report.altitude_m >= above_m
