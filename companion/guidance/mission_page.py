"""The mission's table as a page: a graph of the way down, what each state is, and what follows each event. Made from the code."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from enum import Enum
from itertools import pairwise

from companion.base.mission import DESCENDS, ENDED, FAULTS, Event, State
from companion.guidance.advice import advised_alerts, advised_causes
from companion.guidance.mission import TABLES

_HEAD = """# The mission

<!-- Made by `decklander config mission`; a test compares. -->

One machine flies the landing: `companion/guidance/mission.py` holds its states, its events and the table below. In each guidance
cycle the events are looked for in the order of their list, and the first one that leads to another state is taken. Each change
carries its reason as data: a cause, the number that was measured and the limit that it is compared with. The reason is in the
journal, in MQTT's events, in MAVLink's STATUSTEXT, in the metrics, in the recording and in the report.

Every state that waits for something has a time, and when it is over the drone goes up or stays, never down. No descent is asked
for without a fresh, consistent estimate of the pad. Where the drone holds still it does so against the deck; until a landing
was asked for in this flight, nothing but its own hover is asked of it.
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
    yield from ("## Events", "", "| event | told as a warning |", "|---|---|")
    for event in Event:
        yield f"| {event.value} | {'yes' if event in FAULTS else 'no'} |"
    yield ""


def _causes() -> Iterator[str]:
    yield from ("## What to do", "", "The operator page says it beside the event.", "", "| cause | what to do |", "|---|---|")
    for cause, words in advised_causes().items():
        yield f"| {_PLACES.sub('...', cause.value)} | {words} |"
    for alert, words in advised_alerts().items():
        yield f"| {alert.value} | {words} |"
    yield ""


def _table(name: str) -> Iterator[str]:
    yield from (f'## Table of the mission "{name}"', "", "An event that is not named leaves the state as it is.", "")
    yield from ("| state | event | next state |", "|---|---|---|")
    for state in State:
        for event, target in TABLES[name][state].items():
            if target is not state:
                yield f"| {state.value} | {event.value} | {target.value} |"
    yield ""


def _thesis() -> Iterator[str]:
    yield from ('## What differs with `guidance.mission = "thesis"`', "", "| state | event | next state |", "|---|---|---|")
    for state in State:
        for event, target in TABLES["thesis"][state].items():
            if target is not TABLES["cone"][state][event]:
                yield f"| {state.value} | {event.value} | {target.value} |"
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
