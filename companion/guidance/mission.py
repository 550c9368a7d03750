"""The mission as one machine: the table that says for each of its states and events (`companion.base.mission`) what follows.

Everything that decides on a state lives here. What computes is beside it: `watch` finds the events of a guidance cycle, `steer`
says where to be in each state, `mission_step` puts them together. A state that waits for something also has a time, and when that
is over it goes up: to a go-around, a hold or a refusal, never down.
"""

import ast
import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from enum import Enum
from itertools import pairwise
from types import MappingProxyType

from companion.base.mission import DESCENDS, ENDED, FAULTS, Event, State
from companion.guidance.advice import advised_alerts, advised_causes
from estimator.contracts.total_table import next_states, total

Row = Mapping[Event, State]
Table = Mapping[State, Row]

_S, _E = State, Event

_VEHICLE: Row = {_E.CUT: _S.EMERGENCY, _E.GROUNDED: _S.LANDED, _E.GROUNDED_BY_OTHERS: _S.LANDED_BY_OTHERS}
_HELD: Row = {**_VEHICLE, _E.ABORT: _S.ABORTED}
_FLIGHT: Row = {**_HELD, _E.PAUSE: _S.PAUSED}
_LANDING: Row = {**_FLIGHT, _E.TAKEN: _S.TAKEN}
_AROUND: Row = {_E.LIMIT: _S.GO_AROUND, _E.TIMEOUT: _S.GO_AROUND}
_TRY: Row = {
    **_LANDING, **_AROUND, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.NO_CONDITIONS: _S.GO_AROUND, _E.SIGHT_LOST: _S.HOLD_BLIND,
}  # fmt: skip
_NEXT: Row = {_E.TAKEN_OFF: _S.READY}

_CONE: Table = {
    _S.STANDBY: {_E.BEGIN: _S.WAIT, _E.TAKEN_OFF: _S.READY, _E.ABORT: _S.ABORTED},
    _S.WAIT: {_E.PAUSE: _S.STANDBY, _E.TAKEN_OFF: _S.SEARCH, _E.ABORT: _S.ABORTED},
    _S.READY: {**_FLIGHT, _E.BEGIN: _S.SEARCH},
    _S.PAUSED: {**_HELD, _E.BEGIN: _S.SEARCH},
    _S.RENDEZVOUS: {
        **_LANDING, _E.NO_CONDITIONS: _S.REFUSED, _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT, _E.ARRIVED: _S.SEARCH,
    },
    _S.SEARCH: {
        **_LANDING, _E.NO_CONDITIONS: _S.REFUSED, _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT, _E.VESSEL_FAR: _S.RENDEZVOUS,
    },
    _S.INTERCEPT: {**_TRY, _E.IN_CONE: _S.DESCEND},
    _S.DESCEND: {**_TRY, _E.OUT_OF_CONE: _S.INTERCEPT, _E.AT_GATE: _S.GATE},
    _S.GATE: {**_TRY, _E.CONTACT: _S.PRESS, _E.OUT_OF_CONE: _S.DESCEND, _E.GATE_OPEN: _S.COMMIT},
    # Half a second from the deck the drone goes up without sight, it does not wait; and nothing but a limit of its own ends it.
    _S.COMMIT: {**_LANDING, **_AROUND, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.SIGHT_LOST: _S.GO_AROUND, _E.CONTACT: _S.PRESS},
    _S.PRESS: {**_LANDING, **_AROUND, _E.PRESSED: _S.DOWN},
    _S.DOWN: {**_LANDING, **_AROUND},
    _S.HOLD_BLIND: {
        **_LANDING, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.CONTACT: _S.PRESS, _E.NO_CONDITIONS: _S.GO_AROUND, _E.LIMIT: _S.GO_AROUND,
        _E.TIMEOUT: _S.GAVE_UP, _E.SIGHT: _S.INTERCEPT,
    },
    _S.GO_AROUND: {
        **_LANDING, _E.OTHER_PAD: _S.ANOTHER_PAD, _E.CONTACT: _S.PRESS, _E.NO_CONDITIONS: _S.REFUSED, _E.HOPELESS: _S.GAVE_UP,
        _E.TIMEOUT: _S.GAVE_UP, _E.CLEAR: _S.INTERCEPT,
    },
    _S.ANOTHER_PAD: {**_LANDING, _E.BEGIN: _S.SEARCH, _E.TIMEOUT: _S.GAVE_UP},
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


_HEAD = """# The mission

<!-- Made by `decklander config mission`; a test compares. -->

One machine flies the landing (`companion/guidance/mission.py`). In each guidance cycle it takes the first event of their list
that leads to another state. Each change carries a cause, the measured number and its limit, for log, MQTT, STATUSTEXT, metrics,
recording and report.

Every state that waits has a time limit; when it is over the drone goes up or stays, never down. It never descends without a
fresh, consistent estimate of the pad. It holds still against the deck. Low without sight it only climbs, by range sensor, height
last known, or time. Before the first order to land it stays in its own hover.
"""


def page() -> str:
    """Return docs/mission.md."""
    return "\n".join((_HEAD, *_graph(), *_states(), *_events(), *_causes(), *_table("cone"), *_thesis()))


def _graph() -> Iterator[str]:
    yield from ("## The way down", "", "```mermaid", "stateDiagram-v2")
    for state in State:
        yield f"    {state.name}: {state.value}"
    for state in State:
        ways: dict[State, list[str]] = {}
        for event, target in TABLES["cone"][state].items():
            if target is not state and state not in ENDED and target is not State.EMERGENCY and event not in _ALWAYS:
                ways.setdefault(target, []).append(event.value)
        for target, events in ways.items():
            yield f"    {state.name} --> {target.name}: {', '.join(events)}"
    yield from (
        "```",
        "",
        "Left out are the operator's pause and abort, and the vehicle's reports that it stands or cut its motors.",
        "",
    )


_PLACES = re.compile(r"\{[^}]*\}")
_ALWAYS = (Event.PAUSE, Event.ABORT, Event.GROUNDED, Event.GROUNDED_BY_OTHERS)


def _states() -> Iterator[str]:
    yield from ("## States", "", "| state | what the drone does | may come nearer to the deck |", "|---|---|---|")
    for member, words in _documented(State):
        yield f"| {member.value} | {words} | {'yes' if member in DESCENDS else 'no'} |"
    yield ""


def _events() -> Iterator[str]:
    yield from ("## Events", "", "| event | a warning |", "|---|---|")
    for event in Event:
        yield f"| {event.value} | {'yes' if event in FAULTS else 'no'} |"
    yield ""


def _causes() -> Iterator[str]:
    yield from ("## What to do", "", "The operator page shows it beside the event.", "", "| what to do | causes |", "|---|---|")
    causes = {_PLACES.sub("...", cause.value): words for cause, words in advised_causes().items()}
    by_advice: dict[str, list[str]] = {}
    for cause, words in (causes | {alert.value: words for alert, words in advised_alerts().items()}).items():
        by_advice.setdefault(words, []).append(cause)
    for words, named in by_advice.items():
        yield f"| {words} | {'; '.join(named)} |"
    yield ""


def _table(name: str) -> Iterator[str]:
    yield from (f'## Table of the mission "{name}"', "", "An event that is not named leaves the state as it is.", "")
    yield from _rows(name, {state: dict.fromkeys(Event, state) for state in State})


def _thesis() -> Iterator[str]:
    yield from ('## What differs with `guidance.mission = "thesis"`', "")
    yield from _rows("thesis", TABLES["cone"])


def _rows(name: str, usual: Table) -> Iterator[str]:
    """Yield a row for each state: its next states, each with the events that lead there, where they are not the usual ones."""
    yield from ("| state | next state: events |", "|---|---|")
    if name == "cone":
        yield (
            "| all from rendezvous to another pad | " + "; ".join(f"**{t.value}**: {e.value}" for e, t in _LANDING.items()) + " |"
        )
    for state in State:
        row = TABLES[name][state]
        shared = _LANDING if _LANDING.items() <= row.items() else {}
        named = {event: target for event, target in row.items() if event not in shared}
        if cells := [f"**{to.value}**: {', '.join(e.value for e in by)}" for to, by in next_states(named, usual[state])]:
            yield f"| {state.value} | {'; '.join(cells)} |"
    yield ""


def _documented(kind: type[Enum]) -> Iterator[tuple[State, str]]:
    """Yield each member with the docstring that follows it in the source."""
    tree = ast.parse(inspect.getsource(sys.modules[kind.__module__]))
    body = next(node.body for node in tree.body if isinstance(node, ast.ClassDef) and node.name == kind.__name__)
    for line, after in pairwise(body):
        if isinstance(line, ast.Assign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            name = line.targets[0]
            assert isinstance(name, ast.Name)
            yield State[name.id], str(after.value.value)
