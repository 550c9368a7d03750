"""Effects of the vehicle's report and of one guidance cycle on the machine, one at a time."""

import pytest
from msgspec.structs import replace

from companion.base.mission import ENDED, FLOWN, Event, State
from companion.base.reason import Reason, ReasonCause
from companion.guidance.controller import Knowledge
from companion.guidance.mission import machine
from companion.guidance.mission.cycle import GuidanceCycle
from companion.guidance.mission.machine import Transitions, mission_step, take_order, take_status
from companion.guidance.mission.progress import Progress
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Hover
from tests.companion.mission_flights import holding
from tests.make import estimate, ns, status

OPTIONS = GuidanceOptions()
STAYS_UP = (State.REFUSED, State.GAVE_UP, State.ABORTED, State.EMERGENCY)


def in_state(state: State, *, automatic: bool = False, stood: bool = False, we_land: bool = False) -> Progress:
    return Progress(state, automatic=automatic, stood=stood, ordered=we_land)


def events_of(changes: Transitions) -> list[tuple[int, State, Event, State, ReasonCause]]:
    return [(c.at, c.source, c.event, c.target, c.reason.cause) for c in changes]


def test_cut_motors_end_the_flight_even_if_the_vehicle_says_that_it_flies() -> None:
    p, changes = take_status(in_state(State.DESCEND), status(3.0, flying=True, emergency=True), OPTIONS)
    assert p.state is State.EMERGENCY
    assert events_of(changes) == [(ns(3), State.DESCEND, Event.CUT, State.EMERGENCY, ReasonCause.MOTORS_CUT)]


@pytest.mark.parametrize(
    ("we_land", "event", "target"),
    [(True, Event.GROUNDED, State.LANDED), (False, Event.GROUNDED_BY_OTHERS, State.LANDED_BY_OTHERS)],
)
def test_a_vehicle_that_stands_landed_by_our_order_or_by_others(we_land: bool, event: Event, target: State) -> None:
    p, changes = take_status(in_state(State.DOWN, we_land=we_land), status(3.0, flying=False), OPTIONS)
    assert p.state is target
    assert events_of(changes) == [(ns(3), State.DOWN, event, target, ReasonCause.VEHICLE_STANDS)]


@pytest.mark.parametrize("state", STAYS_UP)
def test_a_flight_that_ended_in_the_air_is_followed_by_one_after_the_vehicle_stood(state: State) -> None:
    flying, standing = status(3.0, flying=True), status(4.0, flying=False)
    ended = in_state(state, automatic=True)
    assert take_status(ended, flying, OPTIONS) == (ended, ())
    stood, changes = take_status(ended, standing, OPTIONS)
    assert (stood.state, stood.stood, changes) == (state, True, ())
    again, changes = take_status(stood, status(5.0, flying=True), OPTIONS)
    assert again.state is State.SEARCH
    assert events_of(changes) == [
        (ns(5), state, Event.TAKEN_OFF, State.READY, ReasonCause.VEHICLE_FLIES),
        (ns(5), State.READY, Event.BEGIN, State.SEARCH, ReasonCause.AUTOMATIC),
    ]


@pytest.mark.parametrize("state", sorted(ENDED, key=str))
def test_without_the_setting_the_next_flight_waits_for_an_order(state: State) -> None:
    p, changes = take_status(in_state(state, stood=True), status(5.0, flying=True), OPTIONS)
    assert (p.state, len(changes)) == (State.READY, 1)


@pytest.mark.parametrize("state", [State.READY, State.SEARCH, State.STANDBY, State.PAUSED])
def test_a_report_within_a_flight_begins_nothing_by_itself(state: State) -> None:
    p, _ = take_status(in_state(state, automatic=True), status(5.0, flying=True), OPTIONS)
    assert p.state is (State.READY if state is State.STANDBY else state)


@pytest.mark.parametrize("state", [State.WAIT, State.STANDBY, State.LANDED, State.DESCEND])
def test_a_vehicle_that_does_not_say_whether_it_flies_changes_nothing(state: State) -> None:
    p = in_state(state, automatic=True, stood=True)
    unknown = replace(status(3.0, flying=True), flying=None)
    assert take_status(p, unknown, OPTIONS) == (p, ())


def test_an_order_that_the_state_does_not_know_leaves_no_trace() -> None:
    p = in_state(State.SEARCH)
    assert take_order(p, Event.BEGIN, ns(1), OPTIONS) == (p, ())
    moved, changes = take_order(p, Event.PAUSE, ns(1), OPTIONS)
    assert moved.state is State.PAUSED
    assert events_of(changes) == [(ns(1), State.SEARCH, Event.PAUSE, State.PAUSED, ReasonCause.OPERATOR)]


def test_events_that_undo_each_other_do_not_hold_the_cycle_up(monkeypatch: pytest.MonkeyPatch) -> None:
    why = Reason(ReasonCause.OPERATOR)
    both = machine.PHASES[State.DESCEND]._replace(events=lambda *_: [(Event.OUT_OF_CONE, why), (Event.IN_CONE, why)])
    phases = {state: both._replace(ways=machine.PHASES[state].ways) for state in (State.DESCEND, State.INTERCEPT)}
    monkeypatch.setattr(machine, "PHASES", machine.PHASES | phases)
    cycle = GuidanceCycle(ns(1), Knowledge(ns(1), estimate(1.0, (0.0, 0.0, 3.0))))
    p, _, changes = mission_step(in_state(State.DESCEND), cycle, OPTIONS)
    assert [change.target for change in changes] == [State.INTERCEPT, State.DESCEND] * 2
    assert p.state is State.DESCEND


@pytest.mark.hazard("H9")
def test_whoever_takes_the_vehicle_is_the_outcome_until_it_is_given_back() -> None:
    """A failsafe ended a landing while the report said that the pad was not found."""
    words = "PX4 took the vehicle: Maximum flight time reached (mode auto.loiter)"
    taken = replace(status(3.0, flying=True), taken=words)
    for state in sorted(FLOWN, key=str):
        p, changes = take_status(replace(in_state(state), begun=True, asked_at=ns(1.0)), taken, OPTIONS)
        assert (p.state, p.begun, changes[0].reason.text) == (State.TAKEN, True, words)
    cycle = GuidanceCycle(ns(3.1), Knowledge(ns(3.1), estimate(3.1, (0.0, 0.0, 2.0))))
    still, aim, _ = mission_step(p, holding(cycle, True), OPTIONS)
    assert (still.state, aim) == (State.TAKEN, Hover())
    assert take_status(p, taken, OPTIONS) == (p, ())
    assert take_status(p, status(4.0, flying=True), OPTIONS) == (p, ()), "a ground station may choose that mode for its own ends"
    back, changes = take_status(p, status(4.0, flying=True), OPTIONS, resumes=True)
    assert (back.state, changes[0].reason.cause) == (State.SEARCH, ReasonCause.GIVEN_BACK)
    assert take_status(replace(back, asked_at=ns(3.0)), taken, OPTIONS)[1] == (), "a report from before the order"
    for state in (State.READY, State.PAUSED):
        assert take_status(in_state(state), taken, OPTIONS)[1] == ()
