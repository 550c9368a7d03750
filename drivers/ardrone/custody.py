"""The AR.Drone's custody, which decides the REF that it is sent: one table of states and events. No I/O.

The drone is its own autopilot, and REF has two bits. With `REF_TAKE_OFF` a drone on the ground takes off, one that lands stays up
and one that flies flies on; without it a flying drone lands. A rising `REF_EMERGENCY` toggles: it cuts the motors, or leaves the
state that a cut led to. So for each state there is one thing to send (`_REF`), where nothing is known it is no REF at all, and an
event changes the state by the table or not at all. Three rules follow from the table, whatever is lost or late on the way:

- After EMERGENCY nothing takes off: no state behind `CUT` sends the take-off bit before the drone has left the emergency state.
  EMERGENCY is sent until the drone reports it; a toggle waits for a report that can show what the one before did.
- A landing is called off only by us, or where the firmware began it because it received no commands
  (`LandingWatch`), and not close to the ground: the bit would start the motors of a drone that has touched down meanwhile.
- Silence of the drone ends no order, but a take-off that does not happen ends by its time.

`CommandStreamer` builds each period's command of it: this REF, the sticks of `velocity_loop`, and the watchdog's reset.
"""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

from msgspec import Struct

from drivers.ardrone.arbiter import HOVER, STAY_UP, TimedCommand
from drivers.ardrone.at import REF_BASE, REF_EMERGENCY, Pcmd
from drivers.ardrone.landing_watch import FRESH_S, ORDERED_ABOVE_M, SILENT_ABOVE_M, Cause, LandingWatch
from drivers.ardrone.navdata import ControlState, Navdata, NavdataState
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.velocity_loop import VelocityLoop
from estimator.contracts.commands import Command, CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.tables import total
from estimator.contracts.time import MonoNs, after, seconds_between

_TOGGLE_PERIODS = 3
"""The drone acts on the rising edge; three periods survive a lost datagram."""
_CUT_AGAIN_S = 0.3
"""Time after which the emergency bit is sent again to a drone that reports, later than that, that it still flies."""
_CUT_SILENT_S = 1.0  # silence of the drone after which the emergency bit is sent again
_TOGGLE_S = 2.0
"""Time after which the emergency bit is sent again in all other cases, as a toggle that is only late would be undone by another
one. A second one never starts motors that the first has stopped: no take-off bit goes with it."""
_ORDER_LATE_S = 0.5
"""Time after our order to land in which a landing is our own: order and report are under way."""


class Custody(Enum):
    """The party that has the drone. The value is its name in the documentation."""

    UNHEARD = "not known"
    STANDS = "stands"
    TAKING_OFF = "takes off"
    OURS = "ours"
    LANDING = "lands for us"
    CALLED_OFF = "called off"
    SILENCED = "lands for silence"
    OTHERS = "others land"
    CUT = "to be cut"
    DEAD = "emergency"
    LEAVING = "leaves emergency"


class CustodyEvent(Enum):
    """An event that may change who has the drone. The value is its name in the documentation."""

    STANDS = "stands"
    FLIES = "flies"
    LANDS_AS_ORDERED = "our landing"
    LANDS_FOR_SILENCE = "silence landing"
    LANDS_FOR_OTHERS = "others' landing"
    DEAD = "emergency"
    UNDONE = "emergency undone"
    SILENT = "silence"
    TAKE_OFF = "take-off"
    LAND = "landing order"
    STEER = "other command"
    CALL_OFF = "person's hold"
    CUT = "EMERGENCY"
    RESET = "reset"
    TOO_LONG = "too long"
    UNRENEWED = "unrenewed"


_C, _E = Custody, CustodyEvent
_Row = Mapping[CustodyEvent, Custody]
_CUT: _Row = {_E.CUT: _C.CUT}
_DOWN: _Row = {**_CUT, _E.STANDS: _C.STANDS, _E.DEAD: _C.DEAD}
_LANDS: _Row = {_E.LANDS_AS_ORDERED: _C.CALLED_OFF, _E.LANDS_FOR_SILENCE: _C.SILENCED, _E.LANDS_FOR_OTHERS: _C.OTHERS}
_UP: _Row = {_E.FLIES: _C.OURS, **_LANDS}
_LAND: _Row = {_E.LAND: _C.LANDING}

TABLE: Mapping[Custody, _Row] = total(
    {
        _C.UNHEARD: {**_DOWN, **_UP, **_LAND, _E.TAKE_OFF: _C.TAKING_OFF, _E.RESET: _C.LEAVING},
        _C.STANDS: {**_CUT, **_UP, _E.DEAD: _C.DEAD, _E.SILENT: _C.UNHEARD, _E.TAKE_OFF: _C.TAKING_OFF},
        _C.TAKING_OFF: {
            **_CUT, **_UP, **_LAND, _E.DEAD: _C.DEAD, _E.CALL_OFF: _C.STANDS, _E.TOO_LONG: _C.STANDS,
        },
        _C.OURS: {**_DOWN, **_LANDS, **_LAND, _E.SILENT: _C.UNHEARD},
        _C.LANDING: {
            **_DOWN, _E.CALL_OFF: _C.CALLED_OFF, _E.TAKE_OFF: _C.CALLED_OFF, _E.STEER: _C.CALLED_OFF, _E.UNRENEWED: _C.CALLED_OFF,
        },
        _C.CALLED_OFF: {**_DOWN, **_LAND, _E.FLIES: _C.OURS, _E.LANDS_FOR_OTHERS: _C.OTHERS, _E.LANDS_FOR_SILENCE: _C.SILENCED},
        _C.SILENCED: {**_DOWN, **_LAND, _E.FLIES: _C.OURS, _E.LANDS_FOR_OTHERS: _C.OTHERS},
        _C.OTHERS: {**_DOWN, _E.FLIES: _C.OURS},
        _C.CUT: {_E.DEAD: _C.DEAD, _E.RESET: _C.LEAVING},
        _C.DEAD: {**_UP, _E.STANDS: _C.STANDS, _E.UNDONE: _C.CUT, _E.RESET: _C.LEAVING},
        _C.LEAVING: {**_CUT, **_UP, _E.STANDS: _C.STANDS},
    },
    CustodyEvent,
)  # fmt: skip
"""The state that follows, for each state and event."""

_REF: Mapping[Custody, int | None] = MappingProxyType({
    _C.UNHEARD: None, _C.STANDS: REF_BASE, _C.TAKING_OFF: STAY_UP, _C.OURS: STAY_UP, _C.LANDING: REF_BASE,
    _C.CALLED_OFF: STAY_UP, _C.SILENCED: STAY_UP, _C.OTHERS: None, _C.CUT: REF_BASE, _C.DEAD: REF_BASE, _C.LEAVING: REF_BASE,
})  # fmt: skip
"""The bits of REF that are sent, None for no REF.

Beyond a take-off the take-off bit needs a fresh report that the drone flies; `CALLED_OFF` and `SILENCED` need their height too.
"""

_ON_GROUND = (ControlState.DEFAULT, ControlState.INIT, ControlState.LANDED, None)
_NOT_STEERABLE = (ControlState.TAKING_OFF, ControlState.LANDING, ControlState.LANDED)
DEAD_OR_CUT = (Custody.CUT, Custody.DEAD, Custody.LEAVING)
"""States behind an emergency, in which nothing takes off."""
_OF_OTHERS = (CustodyEvent.LANDS_FOR_OTHERS, CustodyEvent.LANDS_FOR_SILENCE, CustodyEvent.DEAD)
_TOGGLES = (Custody.CUT, Custody.LEAVING)


def event_of(command: Command) -> CustodyEvent:
    """Return the event that a command is."""
    match command:
        case CutMotors():
            return CustodyEvent.CUT
        case LeaveEmergency():
            return CustodyEvent.RESET
        case TakeOff():
            return CustodyEvent.TAKE_OFF
        case Land():
            return CustodyEvent.LAND
        case Hover() if command.calls_off:
            return CustodyEvent.CALL_OFF
        case _:
            return CustodyEvent.STEER


class CustodyKeeper:
    """Follows who has the drone by commands, reports and time, and says what REF it is sent in each period."""

    def __init__(self, options: ArDroneOptions) -> None:
        self._o = options
        self.state = Custody.UNHEARD
        self._since = MonoNs(0)
        """Time at which the state began, or was last ordered again."""
        self._watch = LandingWatch()
        self._report: Navdata | None = None
        self.control: ControlState | None = None
        """The newest control state; a datagram need not carry it."""
        self._heard: MonoNs | None = None
        self._steered: MonoNs | None = None
        """Time of the newest velocity or tilt; None after any other command."""
        self._landed_by_us: MonoNs | None = None
        """Time at which we last requested a landing."""
        self._cut: MonoNs | None = None
        """Time of the newest EMERGENCY, as it was ordered or sent."""
        self._toggled: tuple[MonoNs, Custody] | None = None
        """The newest toggle, and the state for which it was sent."""
        self._toggle_periods = 0
        self.others_at: MonoNs | None = None
        """Newest report in which the drone began to land, or cut its motors, by no order of ours; None before one."""

    @property
    def steerable(self) -> bool:
        """True if the drone follows the sticks, as far as it was last reported to fly."""
        flies = self._report is not None and self._report.flying
        return flies and self.state in (Custody.OURS, Custody.UNHEARD) and self.control not in _NOT_STEERABLE

    def order(self, command: Command, now: MonoNs) -> None:
        """Take the newest command."""
        self._steered = now if isinstance(command, Velocity | Lean) else None
        event = event_of(command)
        if event is CustodyEvent.CUT:
            self._cut = now
        if event is CustodyEvent.LAND and self.state is Custody.LANDING:
            self._since = now
        self._happens(event, now)

    def on_report(self, report: Navdata, now: MonoNs) -> None:
        """Take the drone's report, in order."""
        self._report, self._heard = report, now
        if self.state is Custody.LANDING:
            self._landed_by_us = now
        if report.control_state is not None:
            self.control = report.control_state
        ordered = self._landed_by_us is not None and seconds_between(self._landed_by_us, now) <= _ORDER_LATE_S
        self._watch.on_report(report, now, ordered=ordered)
        if (event := self._reported(report, now)) is not None:
            before = self.state
            self._happens(event, now)
            if event in _OF_OTHERS and before not in (Custody.CUT, self.state):
                self.others_at = now

    def _reported(self, report: Navdata, now: MonoNs) -> CustodyEvent | None:
        """Return the event that a report is; None if it contradicts itself."""
        if report.state & NavdataState.EMERGENCY:
            return CustodyEvent.DEAD
        if self.state is Custody.DEAD and self._cut is not None and seconds_between(self._cut, now) < _TOGGLE_S:
            return CustodyEvent.UNDONE
        if not report.flying:
            return CustodyEvent.STANDS if self.control in _ON_GROUND else None
        match self._watch.cause if self.control is ControlState.LANDING else None:
            case Cause.OURS:
                return CustodyEvent.LANDS_AS_ORDERED
            case Cause.SILENCE:
                return CustodyEvent.LANDS_FOR_SILENCE
            case Cause.OTHERS:
                return CustodyEvent.LANDS_FOR_OTHERS
        return CustodyEvent.FLIES

    def _happens(self, event: CustodyEvent, now: MonoNs) -> None:
        after = TABLE[self.state][event]
        if after is self.state:
            return
        self.state, self._since = after, now

    def _passes(self, now: MonoNs) -> None:
        """Take what time brings."""
        in_state_s = seconds_between(self._since, now)
        if self.state is Custody.TAKING_OFF and in_state_s > self._o.take_off_timeout_s:
            self._happens(CustodyEvent.TOO_LONG, now)
        if self.state is Custody.LANDING and in_state_s > self._o.landing_timeout_s and self._watch.calls_off(now):
            self._happens(CustodyEvent.UNRENEWED, now)
        if self._heard is None or seconds_between(self._heard, now) > self._o.navdata_silence_s:
            self._happens(CustodyEvent.SILENT, now)

    def ref(self, now: MonoNs) -> int | None:
        """Return the bits of this period's REF; None to send none. Call it once in each period."""
        self._passes(now)
        if self.state is Custody.LANDING:
            self._landed_by_us = now
        if self.state in _TOGGLES:
            return REF_BASE | REF_EMERGENCY if self._toggles(now) else REF_BASE
        self._toggle_periods = 0
        bits = _REF[self.state]
        if bits == STAY_UP and self.state is not Custody.TAKING_OFF and not self._fresh(now):
            return None
        if self.state not in (Custody.CALLED_OFF, Custody.SILENCED) or self.control is not ControlState.LANDING:
            return bits
        # Guidance that flies has an estimate and takes the drone further; without it the drone would only hover there.
        flies = self._steered is not None and seconds_between(self._steered, now) <= self._o.command_timeout_s
        low = self.state is Custody.CALLED_OFF or flies
        return bits if self._watch.calls_off(now, ORDERED_ABOVE_M if low else SILENT_ABOVE_M) else None

    def _fresh(self, now: MonoNs) -> bool:
        """Return whether the newest report is evidence that the drone is still in the air."""
        return self._heard is not None and seconds_between(self._heard, now) <= FRESH_S

    def _toggles(self, now: MonoNs) -> bool:
        """Return whether this period's REF has the emergency bit."""
        if self._toggle_periods == 0 and self._due(now):
            self._toggled, self._toggle_periods = (now, self.state), _TOGGLE_PERIODS
            self._cut = now if self.state is Custody.CUT else self._cut
        if self._toggle_periods > 0:
            self._toggle_periods -= 1
            return True
        return False

    def _due(self, now: MonoNs) -> bool:
        """Return whether a toggle is due: the first at once, another when the one before is known to have had no effect."""
        if self._toggled is None or self._toggled[1] is not self.state or self._toggled[0] < self._since:
            return True
        toggled_at, cuts = self._toggled[0], self.state is Custody.CUT
        heard_at = toggled_at if self._heard is None else max(self._heard, toggled_at)
        if cuts and seconds_between(heard_at, now) > _CUT_SILENT_S:
            return True
        again_s = _CUT_AGAIN_S if cuts and self._report is not None and self._report.flying else _TOGGLE_S
        return seconds_between(toggled_at, heard_at) >= again_s


class _Motion(Struct, frozen=True):
    """A velocity or a tilt that guidance requests."""

    wanted: Velocity | Lean
    asked_at: MonoNs


class CommandStreamer:
    """Holds the newest command and the drone's latest status, and builds the command of each period from them.

    Velocity, tilt and hover change the sticks alone, and only while the drone is ours; what orders are held, and for how long,
    is the table of `custody`.
    """

    def __init__(self, options: ArDroneOptions) -> None:
        self._o = options
        self._custody = CustodyKeeper(options)
        self._loop = VelocityLoop(options)
        self.on_sample = self._loop.on_sample
        """Takes a sample of the drone."""
        self._motion: _Motion | None = None
        """The velocity or lean to fly; None to hover."""
        self._watchdog = False

    def take(self, command: Command, now: MonoNs) -> None:
        """Take the newest command."""
        self._custody.order(command, now)
        self._motion = _Motion(command, now) if isinstance(command, Velocity | Lean) else None

    @property
    def others_at(self) -> MonoNs | None:
        """Newest report of what was not ordered here: a pilot's landing, one for a low battery or silence, or an emergency."""
        return self._custody.others_at

    def on_navdata(self, navdata: Navdata, now: MonoNs) -> None:
        """Take the next navdata datagram, in order."""
        self._watchdog = bool(navdata.state & NavdataState.COM_WATCHDOG)
        self._custody.on_report(navdata, now)
        if self._custody.state is Custody.STANDS:
            self._loop.reset()

    def command(self, now: MonoNs) -> TimedCommand:
        """Return the command of this period, with the instant at which it expires."""
        ref = self._custody.ref(now)
        sticks = self._sticks(now)
        # A velocity's lifetime counts from the guidance cycle that requested it, not from the period that repeats it.
        since = now if self._motion is None or sticks is HOVER else self._motion.asked_at
        renewed = self._custody.state is Custody.LANDING
        return TimedCommand(after(since, self._o.command_timeout_s), sticks, ref, renewed, self._watchdog, self._loop.climb())

    def leave(self, now: MonoNs) -> TimedCommand:
        """Return the final command: hover in place, or continue a landing that was commanded; a take-off ends."""
        if self._custody.state is Custody.TAKING_OFF:
            self._custody.order(Hover(calls_off=True), now)
        return TimedCommand(after(now, self._o.command_timeout_s), HOVER, self._custody.ref(now))

    def _sticks(self, now: MonoNs) -> Pcmd:
        motion = self._motion
        if not self._custody.steerable:
            return self._loop.hover()
        if motion is None:
            self._loop.feel_held(now)
            return self._loop.hover()
        if seconds_between(motion.asked_at, now) > self._o.command_timeout_s:
            return self._loop.hover()
        return self._loop.fly(motion.wanted, now)
