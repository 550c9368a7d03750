"""A landing begun by the autopilot's own flight: at the end of a mission, or by a return that has come over the pad.

The settings say at which of the two. Nothing of it takes the vehicle from a person or a failsafe
(docs/decisions/mavlink.md): an order to begin is given to the arbiter, once in a
journey, while nothing was ordered or taken in this flight, the pad is in sight, and the vehicle hovers or sinks over it.

Source: mavlink.io, common message set: MISSION_CURRENT (42) with MISSION_STATE, MISSION_ITEM_REACHED (46).
PX4 reports no MISSION_STATE and goes from AUTO.MISSION to AUTO.LOITER behind the last item.
"""

import math
from collections.abc import Callable

from msgspec import Struct

from companion.base.mission import State
from companion.guidance.operator.precedence import ControlSituation
from companion.guidance.pilot import Pilot
from companion.settings.operator import HandoverOptions
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.custody import Hand, HandEvent
from drivers.mavlink.dialect import Message
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.vehicle import HOLD_MODE, RETURN_MODE, Stack
from estimator.contracts.time import MonoNs, seconds_between

MISSION, RETURN = "at the mission's end", "from the return over the pad"
_RATE_HZ = 2.0  # rate at which MISSION_CURRENT is requested
_MISSION_MODES, _RETURNS = ("auto", "auto.mission"), tuple(RETURN_MODE.values())
_ACTIVE = 3  # MISSION_STATE_ACTIVE
_COMPLETE = 5
"""MISSION_STATE_COMPLETE."""
_LAST_S = 3.0
"""Time in which PX4 leaves the mission's mode by itself, and the largest gap between HEARTBEATs, s: in a longer one a mode may
have been chosen unseen."""
SETTLED_S = 2.0
"""Time for which it must be over the pad and slow."""
_STILL_M_S = 1.0  # speed over the ground up to which it is slow
_CLIMB_M_S = 0.5  # rate of climb up to which it is slow
_SIGHT_S = 0.5  # age of sight up to which it is over the pad
_LOW_M = 2.0  # height over the pad below which a return is left to land


class Journey(Struct):
    """One spell of one mode of the autopilot."""

    mode: str
    ran: bool = False
    """True once a mission ran in it."""
    ended: bool = False
    """True once that mission was flown to its end."""
    last: MonoNs | None = None
    """Time when its last item was reached."""
    settled: MonoNs | None = None
    """Time since when it has been over the pad and slow."""
    done: bool = False
    """True once it was handed over, or began unseen."""


class Handover:
    """Watches one autopilot's journeys.

    Args:
        begin: gives the order to begin, with the words that name the journey and the time since when it hovers over the pad.
    """

    def __init__(self, options: HandoverOptions, pilot: Pilot, begin: Callable[[str, MonoNs], str | None]) -> None:
        self._o, self._pilot, self._begin = options, pilot, begin
        self._journey = Journey("")
        self._beat: MonoNs | None = None
        self._items: int | None = None
        self._reached: int | None = None

    def on_message(self, autopilot: Autopilot, received: ReceivedMessage) -> None:
        """Take any message of the autopilot's links."""
        m, now = received.message, received.received_at
        if not autopilot.is_own(received) or autopilot.streams is None:
            return
        autopilot.streams.also("MISSION_CURRENT", _RATE_HZ)
        match m.get_type():
            case "HEARTBEAT":
                seen = self._beat is not None and seconds_between(self._beat, now) <= _LAST_S
                if (mode := autopilot.condition.mode) != self._journey.mode:
                    # It is not known what chose a return whose beginning was not reported.
                    self._journey = self._next(mode, now, done=mode in _RETURNS and not seen)
                self._beat = now
            case "MISSION_CURRENT":
                self._on_mission(m)
            case "MISSION_ITEM_REACHED":
                # PX4 repeats it for some seconds.
                if m.seq != self._reached and self._items is not None and m.seq == self._items - 1:
                    self._journey.last = now
                self._reached = m.seq
            case "LOCAL_POSITION_NED":
                self._judge(autopilot, now)

    def _next(self, mode: str, now: MonoNs, *, done: bool) -> Journey:
        before = self._journey
        left = before.ended or (before.last is not None and seconds_between(before.last, now) <= _LAST_S)
        ended = before.mode == "auto.mission" and mode == HOLD_MODE[Stack.PX4] and left
        return Journey(mode, ended=ended, done=done)

    def _on_mission(self, m: Message) -> None:
        journey, state = self._journey, getattr(m, "mission_state", 0)
        self._items = getattr(m, "total", 0) or None
        if journey.mode in _MISSION_MODES:
            # The state of the mission before stands in the first reports.
            journey.ran |= state == _ACTIVE
            journey.ended |= journey.ran and state == _COMPLETE

    def _judge(self, autopilot: Autopilot, now: MonoNs) -> None:
        journey = self._journey
        returns = journey.mode in _RETURNS
        name, wanted = (RETURN, self._o.returns) if returns else (MISSION, self._o.mission)
        if journey.done or not wanted or not (returns or journey.ended):
            return
        if not (self._free(autopilot, now) and self._over_pad(autopilot, now)):
            journey.settled = None
            return
        journey.settled = journey.settled or now
        if seconds_between(journey.settled, now) < SETTLED_S:
            return
        journey.done = True
        self._begin(name, journey.settled)

    def _free(self, autopilot: Autopilot, now: MonoNs) -> bool:
        """Return whether nothing was ordered, held or taken in this flight; by the settings a failsafe may have."""
        condition, streamer = autopilot.condition, autopilot.streamer
        waits = self._pilot.state is State.READY and self._pilot.operator.situation(now) is ControlSituation.GUIDED
        if streamer is None or autopilot.unclear is not None:
            return False
        free = streamer.hand is Hand.NOBODY and (condition.failsafe is None or self._o.failsafe)
        free |= self._o.failsafe and streamer.hand is Hand.PERSON and streamer.cause is HandEvent.FAILSAFE
        return waits and free and bool(condition.armed and condition.flying)

    def _over_pad(self, autopilot: Autopilot, now: MonoNs) -> bool:
        """Return whether the pad is in sight, well below, and the vehicle slow over the ground."""
        belief = self._pilot.belief(now)
        if belief is None or not belief.consistent or belief.age_s(now) > _SIGHT_S or not autopilot.positions:
            return False
        north, east, down = autopilot.positions[-1].v_body_ned
        return belief.height_m >= _LOW_M and math.hypot(north, east) <= _STILL_M_S and down >= -_CLIMB_M_S
