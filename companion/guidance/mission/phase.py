"""A state of the mission as its file declares it, and the rows that many states share."""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from companion.base.mission import Event, State
from companion.guidance.mission.cycle import GuidanceCycle
from companion.guidance.mission.holding import Aimed, not_lower, still
from companion.guidance.mission.progress import Progress
from companion.guidance.mission.rules import Events, EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command

Row = Mapping[Event, State]
"""The states that events lead to; an event that is not named leaves the state as it is."""

GROUNDED: Row = {
    Event.CUT: State.EMERGENCY,
    Event.GROUNDED: State.LANDED,
    Event.GROUNDED_BY_OTHERS: State.LANDED_BY_OTHERS,
}
HELD: Row = {**GROUNDED, Event.ABORT: State.ABORTED}
FLIGHT: Row = {**HELD, Event.PAUSE: State.PAUSED}
LANDING: Row = {**FLIGHT, Event.TAKEN: State.TAKEN}
AROUND: Row = {Event.LIMIT: State.GO_AROUND, Event.TIMEOUT: State.GO_AROUND}
TRY: Row = {
    **LANDING,
    **AROUND,
    Event.OTHER_PAD: State.ANOTHER_PAD,
    Event.NO_CONDITIONS: State.GO_AROUND,
    Event.SIGHT_LOST: State.HOLD_BLIND,
}


def _nothing(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from ()


def _as_it_is(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    return p


class Phase(NamedTuple):
    """One state: where it leads, what it watches, what it aims at, and what it remembers."""

    does: str
    """The words for people: what the drone does."""
    ways: Row
    events: Events = _nothing
    """Events of a cycle that lead to another state."""
    aim: Callable[[Progress, GuidanceCycle, GuidanceOptions], Aimed] = still
    """The place to be: a target for the controller, or a command where no estimate will do."""
    note: Callable[[Progress, GuidanceCycle, GuidanceOptions], Progress] = _as_it_is
    """The state's own memory of a cycle, noted before its events."""
    allows: Callable[[Command, Progress, GuidanceCycle, GuidanceOptions], Command] = not_lower
    """The controller's command for the target, as far as the state allows it."""
