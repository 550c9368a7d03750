"""Choose what an AR.Drone is sent in each period: the service's newest command, or hover once that has expired. No I/O.

The same class decides in the sender's own process and in virtual time. A command carries the instant at which it expires;
nothing that the service requested is flown after it, however the service ended: killed, stopped, swapped out or stuck.

Without a service a drone that is low climbs before it hovers, because a deck in waves comes up to a drone that stays where it is
and drags it along. It climbs by its own ultrasound; a drone that was being steered and does not report its height climbs by
time. Both end: an ultrasound that reads one value for ever is not believed beyond twice the height.

The firmware lands a drone that has received no command for a while. A service that comes back calls such a landing off
(`LandingWatch`).
"""

from dataclasses import dataclass, replace

from drivers.ardrone.at import REF_BASE, REF_TAKE_OFF, AtCommand, ComWdg, Pcmd, Ref
from drivers.ardrone.landing_watch import FRESH_S, LandingWatch
from drivers.ardrone.navdata import ControlState, Navdata, NavdataState
from estimator.contracts.time import MonoNs, seconds_between

HOVER = Pcmd(0, 0.0, 0.0, 0.0, 0.0)
STAY_UP = REF_BASE | REF_TAKE_OFF
_ON_GROUND = (ControlState.DEFAULT, ControlState.INIT, ControlState.LANDED)
GONE_S = 1.0
"""A service that is connected but silent for this long counts as gone."""
CLEAR_M = 2.0
"""Height up to which a drone without a service climbs, m: that of guidance, unless the settings say otherwise."""
_CLIMBED_MOST = 2.0
"""Height beyond which no ultrasound is believed against the climb so far, as a multiple of `CLEAR_M`."""
_STARVED_S = 0.1
"""Time for which one datagram counts as flown at most, s."""
_OBEYS = (ControlState.HOVERING, ControlState.FLYING, ControlState.GOTO_FIX, None)
_REPORT_S = 1.0
"""A report that the drone is on the ground is valid for this long, a report that it flies for `FRESH_S`: a REF with the
take-off bit would start the motors of a drone that has landed in the meantime."""


@dataclass(frozen=True, slots=True)
class TimedCommand:
    """One command of the service, which expires at an instant of this host's monotonic clock."""

    until: MonoNs
    sticks: Pcmd
    ref: int | None = None
    """Bits of the REF command; None to send none."""
    landing: bool = False
    """`ref` requests a landing that guidance renews in each cycle; a landing that a person ordered does not set this."""
    watchdog: bool = False
    """The drone's communication watchdog has to be reset."""
    climb: Pcmd | None = None
    """The sticks with which it climbs out of the deck's reach once the service is gone; None to hover where it is."""

    def commands(self) -> list[AtCommand]:
        """Return the AT commands, which fit into one datagram."""
        out: list[AtCommand] = [ComWdg()] if self.watchdog else []
        if self.ref is not None:
            out.append(Ref(self.ref))
        return [*out, self.sticks]


class CommandArbiter:
    """Decides between the newest command and hover, and how long a flying drone is held in hover without any service.

    Args:
        hold_s: how long hover is sent after the last command expired, seconds; after that nothing is sent.
        climb_m_s: climb rate of full stick, m/s.
    """

    def __init__(self, hold_s: float, climb_m_s: float) -> None:
        self._hold_s = hold_s
        self._climb_m_s = climb_m_s
        self._lost = False
        """The service is gone, by its socket."""
        self._climbed_m = 0.0
        self._climbed_at: MonoNs | None = None
        """The newest datagram that ordered a climb; None if the newest did not."""
        self.latest: TimedCommand | None = None
        """The newest command, expired or not; None before the first."""
        self._watch = LandingWatch()
        self._report: tuple[Navdata, MonoNs] | None = None
        """The newest report, and when it was received."""

    def take(self, command: TimedCommand) -> None:
        """Take the newest command of the service, expired or not."""
        self.latest = command
        self._lost, self._climbed_m, self._climbed_at = False, 0.0, None

    def on_report(self, report: Navdata, now: MonoNs) -> None:
        """Take a report that the sender itself received from the drone while the service is silent."""
        self._report = report, now
        self._watch.on_report(report, now, ordered=self.latest is not None and self.latest.landing)

    def fresh(self, now: MonoNs) -> bool:
        """Return whether the newest command has not expired."""
        return self.latest is not None and now <= self.latest.until

    def silent_s(self, now: MonoNs) -> float:
        """Return the seconds since the newest command expired; 0 while it has not, or before the first."""
        return 0.0 if self.latest is None else max(0.0, seconds_between(self.latest.until, now))

    def on_ground(self, now: MonoNs) -> bool:
        """Return whether the drone reported lately that it is on the ground."""
        report = self._reported(now, _REPORT_S)
        if report is None:
            return False
        return not report.flying and (report.control_state is None or report.control_state in _ON_GROUND)

    def commands(self, now: MonoNs) -> list[AtCommand]:
        """Return the commands of one datagram; none before the first command and after `hold_s` of silence."""
        latest = self.latest
        if latest is None or self.silent_s(now) > self._hold_s:
            return []
        if self.fresh(now):
            return latest.commands()
        report = self._reported(now, FRESH_S)
        # Behind a person's landing or EMERGENCY no take-off bit is sent and nothing climbs: each goes on, whatever dies.
        ends = latest.ref is not None and not latest.ref & REF_TAKE_OFF and not latest.landing
        sticks = HOVER if ends or latest.climb is None or not self._climbs(report, latest, now) else latest.climb
        if report is None:
            return [*([ComWdg()] if latest.watchdog else []), sticks]
        out: list[AtCommand] = [ComWdg()] if report.state & NavdataState.COM_WATCHDOG else []
        stays_up = not ends and report.flying and (report.control_state is not ControlState.LANDING or self._watch.calls_off(now))
        return [*out, *([Ref(STAY_UP)] if stays_up else []), sticks]

    def gone(self, now: MonoNs) -> bool:
        """Return whether the service is gone, by its socket or by its silence."""
        return self._lost or self.silent_s(now) > GONE_S

    def _climbs(self, report: Navdata | None, latest: TimedCommand, now: MonoNs) -> bool:
        """Return whether this period's datagram orders a climb, and count it."""
        if self._climbed_at is not None:
            self._climbed_m += self._climb_m_s * min(_STARVED_S, seconds_between(self._climbed_at, now))
        height_m = None if report is None else report.altitude_m
        if not self.gone(now) or (report is not None and not (report.flying and report.control_state in _OBEYS)):
            climbs = False
        elif height_m is not None and height_m > 0.0:
            climbs = height_m < CLEAR_M and self._climbed_m < _CLIMBED_MOST * CLEAR_M
        else:
            climbs = latest.sticks != HOVER and self._climbed_m < CLEAR_M
        self._climbed_at = now if climbs else None
        return climbs

    def _reported(self, now: MonoNs, within_s: float) -> Navdata | None:
        """Return the newest report, or None if it is older than `within_s` seconds."""
        if self._report is None:
            return None
        report, received_at = self._report
        return report if seconds_between(received_at, now) <= within_s else None

    def lost(self, now: MonoNs) -> None:
        """Let the newest command expire now, because the service is gone."""
        self._lost = True
        if self.latest is not None:
            self.latest = replace(self.latest, until=min(self.latest.until, MonoNs(now - 1)))
