"""One guidance cycle of the mission: account for it, take the events that the table knows, and say where to be."""

from msgspec.structs import replace

from companion.base.mission import ENDED, Event, State, StateChange
from companion.base.reason import Reason, ReasonCause
from companion.guidance.controller import Target
from companion.guidance.mission import TABLES
from companion.guidance.progress import Progress, entered
from companion.guidance.situation import GuidanceCycle
from companion.guidance.steer import Aim, aim
from companion.guidance.watch import account, events
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs

_MOST = 4
"""Most transitions in one cycle; what is left is taken in the next."""

_ORDERS = (State.INTERCEPT, State.DESCEND, State.GATE, State.COMMIT, State.GO_AROUND)
"""States whose orders the height is compared with."""

Transitions = tuple[StateChange, ...]


def mission_step(p: Progress, s: GuidanceCycle, o: GuidanceOptions, *, over_ground: bool) -> tuple[Progress, Aim, Transitions]:
    """Run one guidance cycle; return the memory, the aim and what changed.

    Args:
        over_ground: whether the vehicle's own hover holds over the ground, and its driver adds the deck's velocity to a velocity.
    """
    p = account(p, s, o)
    changes: list[StateChange] = []
    while len(changes) < _MOST:
        moved, change = _first(p, s, o)
        if change is None:
            break
        changes.append(change)
        p = moved
    p, wanted = aim(p, s, o, over_ground=over_ground)
    if p.in_sight and p.state in _ORDERS:
        rate = wanted.descent_rate_m_s if isinstance(wanted, Target) else None
        p = replace(p, course=p.course.ordered(rate))
    return p, wanted, tuple(changes)


def ordered(p: Progress, event: Event, at: MonoNs, o: GuidanceOptions) -> tuple[Progress, Transitions]:
    """Take an order of the operator: BEGIN, PAUSE or ABORT."""
    return _taken(p, event, Reason(ReasonCause.OPERATOR), at, o)


def reported(p: Progress, status: VehicleStatus, o: GuidanceOptions) -> tuple[Progress, Transitions]:
    """Take the vehicle's report about itself."""
    at = status.stamp.received_at
    if status.emergency:
        return _taken(p, Event.CUT, Reason(ReasonCause.MOTORS_CUT), at, o)
    if status.flying is False:
        if p.state in ENDED:
            return replace(p, stood=True), ()
        by_us = Event.GROUNDED if p.ordered else Event.GROUNDED_BY_OTHERS
        return _taken(p, by_us, Reason(ReasonCause.VEHICLE_STANDS), at, o)
    # A report from before the order to begin tells of the flight before.
    if status.taken is not None and (p.asked_at is None or at > p.asked_at):
        return _taken(p, Event.TAKEN, Reason(ReasonCause.TAKEN_OVER, detail=status.taken), at, o)
    if status.taken is None and p.state is State.TAKEN and not p.stood:
        return _taken(p, Event.BEGIN, Reason(ReasonCause.GIVEN_BACK), at, o)
    if status.flying is None or (p.state in ENDED and not p.stood):
        return p, ()
    next_one = p.state in ENDED
    p, changes = _taken(p, Event.TAKEN_OFF, Reason(ReasonCause.VEHICLE_FLIES), at, o)
    if next_one and p.automatic and changes:
        p, more = _taken(p, Event.BEGIN, Reason(ReasonCause.AUTOMATIC), at, o)
        changes = (*changes, *more)
    return p, changes


def _taken(p: Progress, event: Event, reason: Reason, at: MonoNs, o: GuidanceOptions) -> tuple[Progress, Transitions]:
    target = TABLES[o.mission][p.state][event]
    if target is p.state:
        return p, ()
    change = StateChange(at, p.state, event, target, reason)
    return entered(p, change), (change,)


def _first(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> tuple[Progress, StateChange | None]:
    """Take the first event of the cycle that leads to another state."""
    for event, reason in events(p, s, o):
        moved, changes = _taken(p, event, reason, s.at, o)
        if changes:
            return moved, changes[0]
    return p, None
