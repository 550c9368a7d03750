"""Every pair of state and event: where it leads, and where none may lead."""

from itertools import product
from pathlib import Path

import pytest

from companion.base.mission import CONTACT_INTENDED, DESCENDS, ENDED, FAULTS, FLOWN, GROUND, Event, State
from companion.cli.config import mission_page
from companion.guidance.mission.machine import TABLES
from estimator.contracts.total_table import total

MISSIONS = sorted(TABLES)
REPORTS = {Event.CUT: State.EMERGENCY, Event.GROUNDED: State.LANDED, Event.GROUNDED_BY_OTHERS: State.LANDED_BY_OTHERS}
AIRBORNE = set(State) - GROUND - ENDED
AGAIN = {State.GAVE_UP, State.REFUSED, State.TAKEN}
"""Ends after which the operator may begin again in the air."""


def breach(name: str, state: State, event: Event) -> str:
    """Return the law of the air that an entry of a mission's table breaks, empty for none."""
    target = TABLES[name][state][event]
    if target is state:
        return ""
    pressed = (state, event) == ((State.PRESS, Event.PRESSED) if name == "cone" else (State.GATE, Event.GATE_OPEN))
    laws = {
        "no fault leads nearer to the deck": event not in FAULTS or target not in DESCENDS,
        "a report of the vehicle is believed": event not in REPORTS or (target is REPORTS[event] and state in AIRBORNE),
        "the last way begins at the gate": target is not State.COMMIT or (state, event) == (State.GATE, Event.GATE_OPEN),
        "pressed is what touched": target is not State.PRESS
        or (event is Event.CONTACT and state in (State.COMMIT, State.GO_AROUND, State.GATE, State.HOLD_BLIND)),
        "down is what was pressed": target is not State.DOWN or pressed or (name == "thesis" and state is State.PRESS),
        "every way down begins over the pad at height": target not in DESCENDS
        or state in DESCENDS
        or event is Event.CONTACT
        or (target is State.INTERCEPT and event in (Event.SIGHT, Event.CLEAR)),
        "an end is left by a take-off, the operator or a battery that ends": state not in ENDED
        or event is Event.TAKEN_OFF
        or (event is Event.BEGIN and state in AGAIN)
        or (event is Event.BATTERY_ENDS and state in (State.REFUSED, State.GAVE_UP)),
        "the ground is left by a take-off": state not in GROUND or target in GROUND | ENDED or event is Event.TAKEN_OFF,
    }
    return ", ".join(law for law, kept in laws.items() if not kept)


def test_every_pair_is_defined_and_keeps_the_laws_of_the_air() -> None:
    broken = {pair: law for pair in product(MISSIONS, State, Event) if (law := breach(*pair))}
    assert broken == {}


@pytest.mark.parametrize("name", MISSIONS)
def test_the_operators_hand_wins_in_every_state_of_the_flight(name: str) -> None:
    table = TABLES[name]
    for state in AIRBORNE:
        assert table[state][Event.ABORT] is State.ABORTED
        assert table[state][Event.PAUSE] is State.PAUSED
    for state in (State.READY, State.PAUSED, State.ANOTHER_PAD, *AGAIN):
        assert table[state][Event.BEGIN] is State.SEARCH
    for state in ENDED:
        assert table[state][Event.ABORT] is state


@pytest.mark.parametrize("name", MISSIONS)
def test_every_state_that_waits_for_no_person_has_a_time_and_goes_up_when_it_is_over(name: str) -> None:
    for state in FLOWN:
        target = TABLES[name][state][Event.TIMEOUT]
        assert target is not state
        assert target not in DESCENDS


@pytest.mark.parametrize("name", MISSIONS)
def test_every_state_can_be_reached_and_every_flight_can_end(name: str) -> None:
    table, found = TABLES[name], {State.STANDBY, State.WAIT}
    while more := {target for state in found for target in table[state].values()} - found:
        found |= more
    unused = {State.COMMIT, State.PRESS} if name == "thesis" else set()
    assert set(State) - found == unused
    for state in FLOWN:
        ends = {state}
        while more := {target for each in ends for target in table[each].values()} - ends:
            ends |= more
        assert {State.LANDED, State.GAVE_UP, State.ABORTED} <= ends


def test_contact_is_intended_only_behind_the_gate() -> None:
    assert {State.COMMIT, State.PRESS, State.DOWN} == CONTACT_INTENDED


def test_a_table_with_a_gap_or_an_idle_line_is_refused() -> None:
    rows = {state: dict(row) for state, row in TABLES["cone"].items()}
    with pytest.raises(ValueError, match="leads nowhere else"):
        total(rows, Event)
    with pytest.raises(ValueError, match="no row"):
        total({State.WAIT: {}}, Event)


def test_an_event_that_a_row_does_not_name_leaves_the_state_as_it_is() -> None:
    table = total({state: {Event.TAKEN_OFF: State.SEARCH} if state is State.WAIT else {} for state in State}, Event)
    for state, event in product(State, Event):
        named = (state, event) == (State.WAIT, Event.TAKEN_OFF)
        assert table[state][event] is (State.SEARCH if named else state)


def test_the_page_is_what_the_table_says() -> None:
    printed = (Path(__file__).parents[2] / "docs" / "mission.md").read_text(encoding="utf-8")
    assert printed == mission_page(), "run: decklander config mission > docs/mission.md"
    for state in State:
        assert f"| {state.value} |" in printed
