"""Memory of the machine after a transition."""

import math
from typing import Any

import numpy as np
import pytest

from companion.base.mission import ENDED, Event, State, StateChange
from companion.base.reason import Reason, ReasonCause
from companion.guidance.mission.progress import Attempt, HeadingMemory, Progress, entered
from tests.companion.mission_flights import ns

WHY = Reason(ReasonCause.OPERATOR)


def after(p: Progress, event: Event, target: State, why: Reason = WHY) -> Progress:
    return entered(p, StateChange(ns(9), p.state, event, target, why))


def well_on(state: State, **more: Any) -> Progress:
    """Return a memory in which everything of an attempt and of a state has been used."""
    fields: dict[str, Any] = {
        "since": ns(1), "fault": WHY, "stood": False, "begun": True, "ordered": True, "go_arounds": 2, "questions": 1,
        "landing_began": ns(2),
        "attempt": Attempt(losses=2, without_sight_s=3.0), "seen": ns(8), "seen_height_m": 1.5, "climbed_m": 0.5,
        "was_silent": True, "in_sight": True, "track": 4, "heading": HeadingMemory(1.0), "turned": WHY,
        "entered_height_m": 3.0, "held": np.ones(3), "held_yaw_rad": 0.3, "good_since": ns(7), "blocked": WHY,
        "waits_for": WHY, "waits_since": ns(7), "no_return_until": ns(10), "search_leg": 3, "newest_track": 5,
    }  # fmt: skip
    return Progress(state, **{"automatic": True, "reason": None, **fields, **more})


def test_a_service_waits_for_a_vehicle_or_for_an_order() -> None:
    p = Progress.start(automatic=True)
    assert (p.state, Progress.start(automatic=False).state) == (State.WAIT, State.STANDBY)
    assert (p.begun, p.ordered, p.was_silent, p.in_sight) == (False,) * 4
    assert (p.since_last_s, p.climbed_m, p.go_arounds, p.questions, p.search_leg) == (0,) * 5


def test_a_state_begins_with_nothing_of_the_state_before() -> None:
    p = after(well_on(State.DESCEND), Event.AT_GATE, State.GATE)
    assert (p.state, p.since, p.reason, p.entered_height_m) == (State.GATE, ns(9), WHY, 1.5)
    nothing = (p.held, p.held_yaw_rad, p.good_since, p.blocked, p.waits_for, p.waits_since, p.no_return_until)
    assert nothing == (None,) * 7
    assert p.climbed_m == 0.5
    assert (p.go_arounds, p.questions, p.attempt.losses, p.track, p.ordered, p.search_leg) == (2, 1, 2, 4, True, 3)


def test_a_take_off_begins_a_flight_in_which_nothing_was_requested_yet() -> None:
    p = after(well_on(State.LANDED, stood=True, refusing=True), Event.TAKEN_OFF, State.READY)
    assert (p.begun, p.stood, p.ordered, p.go_arounds, p.questions, p.landing_began) == (False, False, False, 0, 0, None)
    forgotten = (p.fault, p.refusing, p.attempt, p.seen, p.seen_height_m, p.in_sight, p.track, p.heading)
    assert forgotten == (None, False, Attempt(), None, math.inf, False, None, HeadingMemory())
    assert (p.turned, p.newest_track, p.was_silent) == (None, None, False)


@pytest.mark.parametrize(("cause", "kept"), [(ReasonCause.AUTOMATIC, (2, 1, ns(2))), (ReasonCause.OPERATOR, (0, 0, None))])
def test_an_order_gives_the_tries_back_and_what_begins_by_itself_does_not(cause, kept):
    p = after(well_on(State.ANOTHER_PAD), Event.BEGIN, State.SEARCH, Reason(cause))
    assert (p.go_arounds, p.questions, p.landing_began) == kept
    assert (p.begun, p.attempt, p.track, p.search_leg) == (True, Attempt(), None, 0)


def test_a_question_is_counted_and_forgets_the_sight() -> None:
    p = after(well_on(State.DESCEND), Event.OTHER_PAD, State.ANOTHER_PAD)
    assert (p.questions, p.in_sight, p.newest_track, p.fault, p.ordered) == (2, False, None, WHY, True)


def test_conditions_that_refuse_are_remembered_through_the_go_around() -> None:
    p = after(well_on(State.GATE, fault=None), Event.NO_CONDITIONS, State.GO_AROUND)
    assert (p.refusing, p.go_arounds, p.turned, p.fault) == (True, 3, None, WHY)
    assert not after(well_on(State.GATE), Event.LIMIT, State.GO_AROUND).refusing


@pytest.mark.parametrize(("climbed_m", "height_m"), [(None, 1.5), (2.5, 2.5), (1.0, 1.5)])
def test_a_climb_is_as_high_as_what_was_seen_or_flown(climbed_m: float | None, height_m: float) -> None:
    p = after(well_on(State.GO_AROUND), Event.CLEAR, State.INTERCEPT, Reason(ReasonCause.HIGH_ENOUGH, climbed_m))
    assert (p.seen_height_m, p.was_silent, p.attempt) == (height_m, False, Attempt(without_sight_s=3.0))


def test_what_goes_for_the_deck_is_our_order_and_what_gives_up_gives_the_reason() -> None:
    for state in (State.COMMIT, State.DOWN):
        assert after(well_on(State.GATE, ordered=False), Event.GATE_OPEN, state).ordered
    assert not after(well_on(State.DESCEND, ordered=False), Event.AT_GATE, State.GATE).ordered
    for state in (State.REFUSED, State.GAVE_UP):
        assert after(well_on(State.SEARCH, fault=None), Event.TIMEOUT, state).fault == WHY


@pytest.mark.parametrize("state", sorted(ENDED, key=str))
def test_only_what_landed_stands(state: State) -> None:
    p = after(well_on(State.DOWN), Event.GROUNDED, state)
    assert p.stood is (state in (State.LANDED, State.LANDED_BY_OTHERS))
    assert not after(well_on(State.DOWN, stood=False), Event.LIMIT, State.GO_AROUND).stood
