"""States in which no landing is flown: before the order, where a person holds the vehicle, and after the end.

On the ground guidance leaves the vehicle alone, once its motors stand, and keeps no order. In the air it hovers before the first
order, and stays against the deck after a pause, an abort, a refusal, or when it gave up, or flies home as settings say, until a
person begins again, takes it, or orders it to hold. With the pad in sight an ending battery is one more try after a refusal; with
the last charge it comes down where it is (`land_here`). A drone that a person left in the air ends as he chose beforehand
(`held_ends`), and he reads it in time.
"""

from collections.abc import Iterator

from msgspec import Struct
from msgspec.structs import replace

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.mission import out_of_reach
from companion.guidance.mission.phase import FLIGHT, HELD, OVER, Aimed, Phase, still_as_ordered
from companion.guidance.mission.progress import GuidanceCycle, Progress, VehicleHold
from companion.guidance.mission.rules import EventWithReason, Row, unfit_here
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Hover, Land

_STOPS_S = 2.0
"""Time for which the motors of an autopilot that stands are ordered to stop, s."""
_ENDS_AFTER_S = 2.0
"""Time after a refusal before a battery that ends is a reason to try again, s."""
_SHOWN_S = 10.0
"""Least time after a person's order for which the coming end of the charge is shown before it begins, s."""


class Returning(Struct, frozen=True):
    """The vehicle flies back with its last charge, as settings say, until an order calls that off."""


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


def _ends(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    if s.battery is not None and s.battery <= o.last_charge and ends_here(p, o, s.hold):
        yield Event.LAND, Reason(ReasonCause.LANDS_HERE, 100.0 * s.battery, 100.0 * o.last_charge)
    yield from _battery_ends(p, s, o)


def end_of(p: Progress, o: GuidanceOptions, *, over_ground: bool, by_hand: bool) -> str:
    """Return the end of a drone that a person left in the air: "hold", "land" or "return"; "" where he or a pilot flies it."""
    # What an autopilot flies before our first order is whose it is.
    if by_hand or p.state is State.TAKEN or (p.state is State.READY and over_ground):
        return ""
    return "hold" if p.end_begun or o.last_charge <= 0.0 else o.held_ends


def _held_ends(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    """Yield the end that the settings have for a drone that a person left in the air."""
    if s.battery is None or p.stood or p.in_state_s(s.at) < _SHOWN_S:
        return
    if end_of(p, o, over_ground=s.hold.over_ground, by_hand=s.by_hand) != "land":
        return
    if s.battery <= o.last_charge:
        yield Event.LAND, Reason(ReasonCause.LANDS_HERE, 100.0 * s.battery, 100.0 * o.last_charge)
    yield from _battery_ends(p, s, o)


def _held(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    """Stay, or fly back with the last charge where the settings say so."""
    ends = s.battery is not None and s.battery <= o.last_charge and p.in_state_s(s.at) >= _SHOWN_S and s.off_orders is None
    returns = end_of(p, o, over_ground=s.hold.over_ground, by_hand=s.by_hand) == "return"
    if ends and returns and out_of_reach.out_of_reach(p, s, o):
        return replace(p, kept=Returning()), Hover(returns=True)
    return still_as_ordered(p, s, o)


def _refused(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    if s.off_orders is None and o.refused != "hold" and out_of_reach.out_of_reach(p, s, o):
        return p, Hover(returns=True) if o.refused == "return" else Hover(elsewhere=o.elsewhere.landing_place)
    return still_as_ordered(p, s, o)


def on_ground(p: Progress, s: GuidanceCycle) -> Land | None:
    """Return the order to stop the motors where an autopilot came to stand by a person's order, as long as it may be armed.

    It may find the ground before us, by thrust and speed, and idles on the deck for ten seconds then.
    """
    stops = p.state is State.LANDED and p.here is not None and s.hold.over_ground and p.in_state_s(s.at) <= _STOPS_S
    return Land(on_deck=True) if stops else None


_NEXT: Row = {Event.TAKEN_OFF: State.READY}
_SEARCHES: Row = {Event.BEGIN: State.SEARCH, Event.STAY: State.SEARCH}
_AGAIN: Row = {**_NEXT, **_SEARCHES, Event.LAND: State.LAND_HERE}
_HOVERS: Row = {**_AGAIN, **OVER, Event.TAKEN: State.TAKEN}
_TRIES_AGAIN: Row = {**_HOVERS, Event.BATTERY_ENDS: State.SEARCH, Event.HOLD: State.PAUSED, Event.ABORT: State.ABORTED}

PHASES = {
    State.STANDBY: Phase("The vehicle is on the ground, or its state is unknown.", {**_NEXT, Event.ABORT: State.ABORTED}),
    State.WAIT: Phase(
        "The vehicle does not fly yet; by the settings a landing begins as soon as it does.",
        {Event.HOLD: State.STANDBY, Event.TAKEN: State.STANDBY, Event.TAKEN_OFF: State.SEARCH, Event.ABORT: State.ABORTED},
    ),
    State.READY: Phase(
        "Flying, in its own hover until somebody requests a landing; an autopilot stays with whoever flies it.",
        {**FLIGHT, **_SEARCHES, Event.BATTERY_ENDS: State.SEARCH},
        _held_ends,
    ),
    State.PAUSED: Phase(
        "Held still by the operator.",
        {**HELD, **_SEARCHES, **OVER, Event.BATTERY_ENDS: State.SEARCH, Event.TAKEN: State.TAKEN},
        _held_ends,
        _held,
    ),
    State.LANDED: Phase("The vehicle is on the ground after our order, or the operator's to land where it is.", _NEXT),
    State.LANDED_BY_OTHERS: Phase("The vehicle is on the ground without our order.", _NEXT),
    State.REFUSED: Phase("Held still: the conditions are beyond the limits.", _TRIES_AGAIN, _ends, _refused),
    State.GAVE_UP: Phase("Held still: the pad was not found, or the attempts are used up.", _TRIES_AGAIN, _ends, _refused),
    State.ABORTED: Phase("Held still: the operator ended it.", {**_HOVERS, Event.BATTERY_ENDS: State.SEARCH}, _held_ends, _held),
    State.TAKEN: Phase("Left alone: a failsafe of the autopilot or a person flies the vehicle.", _AGAIN),
    State.EMERGENCY: Phase("The vehicle cut its motors.", _NEXT),
}
