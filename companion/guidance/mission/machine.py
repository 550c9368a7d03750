"""The mission as one machine: the table that says for each of its states and events (`companion.base.mission`) what follows.

Everything that decides on a state lives here. What computes is beside it: `watch` finds the events of a guidance cycle, `steer`
says where to be in each state, `mission_step` puts them together. A state that waits for something also has a time, and when that
is over it goes up: to a go-around, a hold or a refusal, never down.
"""

from collections.abc import Mapping
from types import MappingProxyType

from companion.base.mission import Event, State
from estimator.contracts.total_table import total

Row = Mapping[Event, State]
Table = Mapping[State, Row]

_S, _E = State, Event

_VEHICLE: Row = {_E.CUT: _S.EMERGENCY, _E.GROUNDED: _S.LANDED, _E.GROUNDED_BY_OTHERS: _S.LANDED_BY_OTHERS}
_HELD: Row = {**_VEHICLE, _E.ABORT: _S.ABORTED}
_FLIGHT: Row = {**_HELD, _E.PAUSE: _S.PAUSED}
LANDING: Row = {**_FLIGHT, _E.TAKEN: _S.TAKEN}
_AROUND: Row = {_E.LIMIT: _S.GO_AROUND, _E.TIMEOUT: _S.GO_AROUND}
_TRY: Row = {
    **LANDING, **_AROUND, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.NO_CONDITIONS: _S.GO_AROUND, _E.SIGHT_LOST: _S.HOLD_BLIND,
}  # fmt: skip
_NEXT: Row = {_E.TAKEN_OFF: _S.READY}

_CONE: Table = {
    _S.STANDBY: {_E.BEGIN: _S.WAIT, _E.TAKEN_OFF: _S.READY, _E.ABORT: _S.ABORTED},
    _S.WAIT: {_E.PAUSE: _S.STANDBY, _E.TAKEN_OFF: _S.SEARCH, _E.ABORT: _S.ABORTED},
    _S.READY: {**_FLIGHT, _E.BEGIN: _S.SEARCH},
    _S.PAUSED: {**_HELD, _E.BEGIN: _S.SEARCH},
    _S.RENDEZVOUS: {
        **LANDING, _E.NO_CONDITIONS: _S.REFUSED, _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT, _E.ARRIVED: _S.SEARCH,
    },
    _S.SEARCH: {
        **LANDING, _E.NO_CONDITIONS: _S.REFUSED, _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT, _E.VESSEL_FAR: _S.RENDEZVOUS,
    },
    _S.INTERCEPT: {**_TRY, _E.IN_CONE: _S.DESCEND},
    _S.DESCEND: {**_TRY, _E.OUT_OF_CONE: _S.INTERCEPT, _E.AT_GATE: _S.GATE},
    _S.GATE: {**_TRY, _E.CONTACT: _S.PRESS, _E.OUT_OF_CONE: _S.DESCEND, _E.GATE_OPEN: _S.COMMIT},
    # Half a second from the deck the drone goes up without sight, it does not wait; and nothing but a limit of its own ends it.
    _S.COMMIT: {**LANDING, **_AROUND, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.SIGHT_LOST: _S.GO_AROUND, _E.CONTACT: _S.PRESS},
    _S.PRESS: {**LANDING, **_AROUND, _E.PRESSED: _S.DOWN},
    _S.DOWN: {**LANDING, **_AROUND},
    _S.HOLD_BLIND: {
        **LANDING, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.CONTACT: _S.PRESS, _E.NO_CONDITIONS: _S.GO_AROUND, _E.LIMIT: _S.GO_AROUND,
        _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT,
    },
    _S.GO_AROUND: {
        **LANDING, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.CONTACT: _S.PRESS, _E.NO_CONDITIONS: _S.REFUSED, _E.HOPELESS: _S.GAVE_UP,
        _E.TIMEOUT: _S.GAVE_UP, _E.CLEAR: _S.INTERCEPT,
    },
    _S.ANOTHER_PAD: {**LANDING, _E.BEGIN: _S.SEARCH, _E.TIMEOUT: _S.GAVE_UP},
    _S.LANDED: _NEXT,
    _S.LANDED_BY_OTHERS: _NEXT,
    _S.REFUSED: {**_NEXT, _E.BEGIN: _S.SEARCH, _E.BATTERY_ENDS: _S.SEARCH},
    _S.GAVE_UP: {**_NEXT, _E.BEGIN: _S.SEARCH, _E.BATTERY_ENDS: _S.SEARCH},
    _S.ABORTED: _NEXT,
    _S.TAKEN: {**_NEXT, _E.BEGIN: _S.SEARCH},
    _S.EMERGENCY: _NEXT,
}  # fmt: skip


def _without_contact(state: State) -> Row:
    return {event: target for event, target in _CONE[state].items() if event is not _E.CONTACT}


# The thesis' way ends at a height from which the vehicle lands by itself, still in the air.
_THESIS: Table = {
    **_CONE,
    _S.GATE: {**_without_contact(_S.GATE), _E.GATE_OPEN: _S.DOWN},
    _S.HOLD_BLIND: _without_contact(_S.HOLD_BLIND),
    _S.DOWN: {**_CONE[_S.DOWN], _E.OTHER_PAD: _S.ANOTHER_PAD},
    _S.GO_AROUND: _without_contact(_S.GO_AROUND),
}


TABLES: Mapping[str, Table] = MappingProxyType({"cone": total(_CONE, Event), "thesis": total(_THESIS, Event)})
"""The tables by `guidance.mission`."""
