"""Every pair of state and event: where it leads, and where none may lead."""

from itertools import product
from pathlib import Path

import pytest

from companion.base.mission import CONTACT_INTENDED, DESCENDS, ENDED, FAULTS, FLOWN, GROUND, Event, State
from companion.guidance import mission
from companion.guidance.mission import TABLES, whole

MISSIONS = sorted(TABLES)
PAIRS = [(name, state, event) for name in MISSIONS for state, event in product(State, Event)]
REPORTS = {Event.CUT: State.EMERGENCY, Event.GROUNDED: State.LANDED, Event.GROUNDED_BY_OTHERS: State.LANDED_BY_OTHERS}
AIRBORNE = set(State) - GROUND - ENDED
AGAIN = {State.GAVE_UP, State.REFUSED, State.TAKEN}
"""Ends after which the operator may begin again in the air."""


@pytest.mark.parametrize(("name", "state", "event"), PAIRS, ids=lambda x: getattr(x, "name", x))
def test_every_pair_is_defined_and_keeps_the_laws_of_the_air(name: str, state: State, event: Event) -> None:
    target = TABLES[name][state][event]
    if target is state:
        return
    if event in FAULTS:
        assert target not in DESCENDS, "no fault leads nearer to the deck"
    if event in REPORTS:
        assert target is REPORTS[event]
        assert state in AIRBORNE
    if target is State.COMMIT:
        assert (state, event) == (State.GATE, Event.GATE_OPEN)
    if target is State.PRESS:
        assert event is Event.CONTACT
        assert state in (State.COMMIT, State.GO_AROUND, State.GATE, State.HOLD_BLIND)
    if target is State.DOWN:
        assert (state, event) == ((State.PRESS, Event.PRESSED) if name == "cone" else (State.GATE, Event.GATE_OPEN)) or (
            name == "thesis" and state is State.PRESS
        )
    if target in DESCENDS and state not in DESCENDS and event is not Event.CONTACT:
        assert target is State.INTERCEPT, "every way down begins over the pad at height"
        assert event in (Event.SIGHT, Event.CLEAR)
    if state in ENDED:
        assert event in (Event.TAKEN_OFF, Event.BEGIN)
        assert event is not Event.BEGIN or state in AGAIN
    if state in GROUND and target not in GROUND | ENDED:
        assert event is Event.TAKEN_OFF


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
        whole(rows)
    with pytest.raises(ValueError, match="no row"):
        whole({State.WAIT: {}})


def test_an_event_that_a_row_does_not_name_leaves_the_state_as_it_is() -> None:
    table = whole({state: {Event.TAKEN_OFF: State.SEARCH} if state is State.WAIT else {} for state in State})
    for state, event in product(State, Event):
        named = (state, event) == (State.WAIT, Event.TAKEN_OFF)
        assert table[state][event] is (State.SEARCH if named else state)


def test_the_page_is_what_the_table_says() -> None:
    page = (Path(__file__).parents[2] / "docs" / "mission.md").read_text(encoding="utf-8")
    assert page == mission.page(), "run: decklander config mission > docs/mission.md"
    for state in State:
        assert f"| {state.value} |" in page
