"""States in which no landing is flown: before the order, where a person holds the vehicle, and after the end.

On the ground guidance leaves the vehicle alone and keeps no order. In the air it hovers before the first order, and stays against
the deck after a pause, an abort, a refusal, or when it gave up, or flies home as settings say, until a person begins again or
takes it. With the pad in sight an ending battery is one more try after a refusal; with the last charge it comes down.
"""

from collections.abc import Iterator

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.mission import out_of_reach
from companion.guidance.mission.phase import FLIGHT, HELD, Aimed, Phase, still_as_ordered
from companion.guidance.mission.progress import GuidanceCycle, Progress, VehicleHold
from companion.guidance.mission.rules import EventWithReason, Row, unfit_here
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Hover, Land

_ENDS_AFTER_S = 2.0
"""Time after a refusal before a battery that ends is a reason to try again, s."""


def ends_here(p: Progress, o: GuidanceOptions, hold: VehicleHold) -> bool:
    """Return whether a drone that refused comes down where it is before it falls; an AR.Drone has no other place to fly to."""
    refused = p.state in (State.REFUSED, State.GAVE_UP) and not p.stood
    return refused and o.last_charge > 0.0 and (o.refused == "hold" or not hold.over_ground)


def _battery_ends(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield that the battery of a drone that refused will not last while the pad is in sight; what stands does not take off."""
    if p.stood or p.in_state_s(s.at) < _ENDS_AFTER_S or s.battery is None or unfit_here(p, s, o) is not None:
        return
    if o.last_charge < s.battery < o.limits.battery:
        yield Event.BATTERY_ENDS, Reason(ReasonCause.BATTERY_ENDS, 100.0 * s.battery, 100.0 * o.last_charge)


def _refused(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    if s.battery is not None and s.battery <= o.last_charge and ends_here(p, o, s.hold):
        return p, Land()
    if s.off_orders is None and o.refused != "hold" and out_of_reach.out_of_reach(p, s, o):
        return p, Hover(returns=True) if o.refused == "return" else Hover(elsewhere=o.elsewhere.landing_place)
    return still_as_ordered(p, s, o)


_NEXT: Row = {Event.TAKEN_OFF: State.READY}
_SEARCHES: Row = {Event.BEGIN: State.SEARCH, Event.STAY: State.SEARCH}
_AGAIN: Row = {**_NEXT, **_SEARCHES}
_HOVERS: Row = {**_AGAIN, Event.TAKEN: State.TAKEN}
_TRIES_AGAIN: Row = {**_HOVERS, Event.BATTERY_ENDS: State.SEARCH}

PHASES = {
    State.STANDBY: Phase("The vehicle is on the ground, or its state is unknown.", {**_NEXT, Event.ABORT: State.ABORTED}),
    State.WAIT: Phase(
        "The vehicle does not fly yet; by the settings a landing begins as soon as it does.",
        {Event.PAUSE: State.STANDBY, Event.TAKEN: State.STANDBY, Event.TAKEN_OFF: State.SEARCH, Event.ABORT: State.ABORTED},
    ),
    State.READY: Phase(
        "Flying, in its own hover until somebody requests a landing; an autopilot stays with whoever flies it.",
        {**FLIGHT, **_SEARCHES},
    ),
    State.PAUSED: Phase("Held still by the operator.", {**HELD, **_SEARCHES, Event.TAKEN: State.TAKEN}, aim=still_as_ordered),
    State.LANDED: Phase("The vehicle is on the ground after our order, or the operator's to land where it is.", _NEXT),
    State.LANDED_BY_OTHERS: Phase("The vehicle is on the ground without our order.", _NEXT),
    State.REFUSED: Phase("Held still: the conditions are beyond the limits.", _TRIES_AGAIN, _battery_ends, _refused),
    State.GAVE_UP: Phase(
        "Held still: the pad was not found, or the attempts are used up.", _TRIES_AGAIN, _battery_ends, _refused
    ),
    State.ABORTED: Phase("Held still: the operator ended the attempt.", _HOVERS, aim=still_as_ordered),
    State.TAKEN: Phase("Left alone: a failsafe of the autopilot or a person flies the vehicle.", _AGAIN),
    State.EMERGENCY: Phase("The vehicle cut its motors.", _NEXT),
}
