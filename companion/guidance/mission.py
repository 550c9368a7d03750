"""The mission as one machine: its states, its events, and the table that says for every pair of them what follows.

Everything that decides on a state lives here. What computes is beside it: `watch` finds the events of a guidance cycle, `steer`
says where to be in each state, `mission_step` puts them together. A state that waits for something also has a time, and when
that is over it goes up: to a go-around, a hold or a refusal, never down.

Source: ``_state.py`` of h11 for the form: one table, total, in one file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from companion.guidance.reason import Reason
from estimator.contracts.time import MonoNs


class State(Enum):
    """What the drone is doing; the value is the phase that people read."""

    # By identity: an enumeration's own hash is that of its name, and the tables here are read in every guidance cycle.
    __hash__ = object.__hash__

    STANDBY = "waiting for the vehicle and the start"
    """On the ground, or unknown; nobody has asked for a landing."""
    WAIT = "waiting for the vehicle"
    """A landing was asked for; the vehicle does not fly yet."""
    READY = "waiting for the start"
    """Flying, in its own hover until somebody asks for a landing; an autopilot stays with whoever flies it."""
    PAUSED = "paused"
    """Held still by the operator."""
    RENDEZVOUS = "rendezvous"
    """Flying to the place that the vessel reports."""
    SEARCH = "search"
    """Waiting for the first sight of the pad."""
    INTERCEPT = "intercept"
    """Flying over the pad at height."""
    DESCEND = "descend"
    """Descending in the cone over the pad."""
    GATE = "gate"
    """Following the deck just above it until every limit holds."""
    COMMIT = "commit"
    """Going down to the deck under full control."""
    PRESS = "press"
    """Pressing on level after the contact."""
    DOWN = "down"
    """Ordering the vehicle to stop its motors, in every cycle."""
    HOLD_BLIND = "hold blind"
    """Still against the deck without sight of the pad."""
    GO_AROUND = "go around"
    """Climbing on the clear side, to begin again."""
    ANOTHER_PAD = "another pad"
    """Climbing, then waiting for the operator's decision about a pad in another place."""
    LANDED = "landed"
    """On the ground after our order."""
    LANDED_BY_OTHERS = "landed by others"
    """On the ground without our order."""
    REFUSED = "refused"
    """Held still: the conditions are beyond the limits."""
    GAVE_UP = "gave up"
    """Held still: the pad was not found, or the tries are used up."""
    ABORTED = "aborted"
    """Held still: the operator ended the flight."""
    EMERGENCY = "emergency"
    """The vehicle cut its motors."""


class Event(Enum):
    """What can happen. Of several in one guidance cycle the one that is named first here is taken first."""

    __hash__ = object.__hash__

    CUT = "motors cut"
    GROUNDED = "on the ground after our order"
    GROUNDED_BY_OTHERS = "on the ground without our order"
    TAKEN_OFF = "taken off"
    """The vehicle flies, the first time or after it has stood."""
    ABORT = "abort ordered"
    PAUSE = "pause ordered"
    BEGIN = "landing ordered"
    OTHER_PAD = "another pad seen"
    CONTACT = "contact"
    PRESSED = "pressed"
    NO_CONDITIONS = "conditions beyond the limits"
    """They will not pass within this flight."""
    HOPELESS = "no way on"
    """What this try or this flight allows is used up."""
    LIMIT = "limit exceeded"
    """A limit ends this try."""
    TIMEOUT = "time over"
    SIGHT_LOST = "sight lost"
    SIGHT = "sight"
    """There is a fresh, consistent estimate of the pad."""
    VESSEL_FAR = "vessel far"
    ARRIVED = "arrived"
    CLEAR = "clear"
    """High enough to begin again, or to look again."""
    OUT_OF_CONE = "out of the cone"
    IN_CONE = "in the cone"
    AT_GATE = "at the gate"
    GATE_OPEN = "gate open"


@dataclass(frozen=True, slots=True)
class StateChange:
    """One change of state."""

    at: MonoNs
    source: State
    event: Event
    target: State
    reason: Reason


Row = Mapping[Event, State]
Table = Mapping[State, Row]

_S, _E = State, Event
_STAYS_UP = (State.REFUSED, State.GAVE_UP, State.ABORTED)
GROUND = frozenset({State.STANDBY, State.WAIT, State.LANDED, State.LANDED_BY_OTHERS, State.EMERGENCY})
"""States in which guidance leaves the vehicle alone."""
ENDED = frozenset({State.LANDED, State.LANDED_BY_OTHERS, State.EMERGENCY, *_STAYS_UP})
"""States that end a flight; the next one begins when the vehicle has stood and flies again."""
FLOWN = frozenset(State) - GROUND - ENDED - {State.READY, State.PAUSED}
"""States in which the machine flies a landing."""
DESCENDS = frozenset({State.INTERCEPT, State.DESCEND, State.GATE, State.COMMIT, State.PRESS, State.DOWN})
"""States in which the drone may be asked to come nearer to the deck."""
CONTACT_INTENDED = frozenset({State.COMMIT, State.PRESS, State.DOWN})
"""States in which the drone may touch the deck with its motors turning."""

FAULTS = frozenset(
    {_E.CUT, _E.GROUNDED_BY_OTHERS, _E.OTHER_PAD, _E.NO_CONDITIONS, _E.HOPELESS, _E.LIMIT, _E.TIMEOUT, _E.SIGHT_LOST}
)
"""Events that are told to people as warnings."""

_VEHICLE: Row = {_E.CUT: _S.EMERGENCY, _E.GROUNDED: _S.LANDED, _E.GROUNDED_BY_OTHERS: _S.LANDED_BY_OTHERS}
_HELD: Row = {**_VEHICLE, _E.ABORT: _S.ABORTED}
_FLIGHT: Row = {**_HELD, _E.PAUSE: _S.PAUSED}
_AROUND: Row = {_E.LIMIT: _S.GO_AROUND, _E.TIMEOUT: _S.GO_AROUND}
_TRY: Row = {
    **_FLIGHT, **_AROUND, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.NO_CONDITIONS: _S.GO_AROUND, _E.SIGHT_LOST: _S.HOLD_BLIND,
}  # fmt: skip
_NEXT: Row = {_E.TAKEN_OFF: _S.READY}

_CONE: Table = {
    _S.STANDBY: {_E.BEGIN: _S.WAIT, _E.TAKEN_OFF: _S.READY, _E.ABORT: _S.ABORTED},
    _S.WAIT: {_E.PAUSE: _S.STANDBY, _E.TAKEN_OFF: _S.SEARCH, _E.ABORT: _S.ABORTED},
    _S.READY: {**_FLIGHT, _E.BEGIN: _S.SEARCH},
    _S.PAUSED: {**_HELD, _E.BEGIN: _S.SEARCH},
    _S.RENDEZVOUS: {
        **_FLIGHT, _E.NO_CONDITIONS: _S.REFUSED, _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT, _E.ARRIVED: _S.SEARCH,
    },
    _S.SEARCH: {
        **_FLIGHT, _E.NO_CONDITIONS: _S.REFUSED, _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT, _E.VESSEL_FAR: _S.RENDEZVOUS,
    },
    _S.INTERCEPT: {**_TRY, _E.IN_CONE: _S.DESCEND},
    _S.DESCEND: {**_TRY, _E.OUT_OF_CONE: _S.INTERCEPT, _E.AT_GATE: _S.GATE},
    _S.GATE: {**_TRY, _E.OUT_OF_CONE: _S.DESCEND, _E.GATE_OPEN: _S.COMMIT},
    # Half a second from the deck the drone goes up without sight, it does not wait; and nothing but a limit of its own ends it.
    _S.COMMIT: {**_FLIGHT, **_AROUND, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.SIGHT_LOST: _S.GO_AROUND, _E.CONTACT: _S.PRESS},
    _S.PRESS: {**_FLIGHT, **_AROUND, _E.PRESSED: _S.DOWN},
    _S.DOWN: {**_FLIGHT, **_AROUND},
    _S.HOLD_BLIND: {
        **_FLIGHT, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.NO_CONDITIONS: _S.GO_AROUND, _E.LIMIT: _S.GO_AROUND, _E.TIMEOUT: _S.GAVE_UP,
        _E.SIGHT: _S.INTERCEPT,
    },
    _S.GO_AROUND: {
        **_FLIGHT, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.NO_CONDITIONS: _S.REFUSED, _E.HOPELESS: _S.GAVE_UP, _E.TIMEOUT: _S.GAVE_UP,
        _E.CLEAR: _S.INTERCEPT,
    },
    _S.ANOTHER_PAD: {**_FLIGHT, _E.BEGIN: _S.SEARCH, _E.TIMEOUT: _S.GAVE_UP},
    _S.LANDED: _NEXT,
    _S.LANDED_BY_OTHERS: _NEXT,
    _S.REFUSED: {**_NEXT, _E.BEGIN: _S.SEARCH},
    _S.GAVE_UP: {**_NEXT, _E.BEGIN: _S.SEARCH},
    _S.ABORTED: _NEXT,
    _S.EMERGENCY: _NEXT,
}  # fmt: skip
# The thesis' way ends at a height from which the vehicle lands by itself, still in the air.
_THESIS: Table = {
    **_CONE,
    _S.GATE: {**_CONE[_S.GATE], _E.GATE_OPEN: _S.DOWN},
    _S.DOWN: {**_CONE[_S.DOWN], _E.OTHER_PAD: _S.ANOTHER_PAD},
}


def whole(rows: Table) -> Table:
    """Return the table with every pair: an event that a row does not name leaves the state as it is.

    Raises:
        ValueError: a state has no row, or a row names an event that leads nowhere else.
    """
    table: dict[State, Row] = {}
    for state in State:
        if state not in rows:
            raise ValueError(f"{state}: no row says what follows")
        if idle := [event for event, target in rows[state].items() if target is state]:
            raise ValueError(f"{state}: {idle[0]} leads nowhere else, so the row must not name it")
        table[state] = MappingProxyType({event: rows[state].get(event, state) for event in Event})
    return MappingProxyType(table)


TABLES: Mapping[str, Table] = MappingProxyType({"cone": whole(_CONE), "thesis": whole(_THESIS)})
"""The tables by `guidance.mission`."""
