"""Every pair of state and event: where it leads, where none may lead, and the advice to a person about each cause."""

from itertools import product

import pytest
from msgspec.structs import replace

from companion.base.mission import DESCENDS, ENDED, FAULTS, FLOWN, GROUND, Event, Reason, ReasonCause, State, StateChange
from companion.base.observer import Decision
from companion.facts import encode
from companion.guidance.advice import advice
from companion.guidance.controller import Knowledge
from companion.guidance.mission import machine
from companion.guidance.mission.machine import TABLES, Transitions, mission_step, take_order, take_status
from companion.guidance.mission.progress import GuidanceCycle, Progress, of_frames
from companion.parts.mqtt.encode import Changes
from companion.recording import decode
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Hover
from estimator.contracts.estimates import IntegrityAlert, Verdict
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.tables import total
from estimator.contracts.time import Stamp
from tests.companion.test_mission_flights import holding
from tests.make import estimate, ns, status

MISSIONS = sorted(TABLES)
REPORTS = {Event.CUT: State.EMERGENCY, Event.GROUNDED: State.LANDED, Event.GROUNDED_BY_OTHERS: State.LANDED_BY_OTHERS}
AIRBORNE = set(State) - GROUND - ENDED
AGAIN = {State.GAVE_UP, State.REFUSED, State.TAKEN, State.ABORTED}
"""Ends after which the operator may begin again in the air."""
BY_ITSELF = {State.GAVE_UP, State.REFUSED}
"""Ends that guidance chose: it may fly back or elsewhere there until a person ends that."""


def breach(name: str, state: State, event: Event) -> str:
    """Return the law of the air that an entry of a mission's table breaks, empty for none."""
    target = TABLES[name][state][event]
    if target is state:
        return ""
    if event is Event.TIPPED:
        ours = state in AIRBORNE - {State.READY} or state in (State.PAUSED, State.REFUSED, State.GAVE_UP, State.ABORTED)
        return "" if target is State.DOWN and ours else "what lies on a deck has its motors stopped, if it is ours"
    pressed = (state, event) == ((State.PRESS, Event.PRESSED) if name == "cone" else (State.GATE, Event.GATE_OPEN))
    laws = {
        "no fault leads nearer to the deck": event not in FAULTS or target not in DESCENDS,
        "a report of the vehicle is believed": event not in REPORTS or (target is REPORTS[event] and state in AIRBORNE),
        "the last way begins at the gate": target is not State.COMMIT or (state, event) == (State.GATE, Event.GATE_OPEN),
        "pressed is what touched": target is not State.PRESS
        or (event is Event.CONTACT and (state in DESCENDS or state in (State.GO_AROUND, State.HOLD_BLIND))),
        "down is what was pressed": target is not State.DOWN or pressed or (name != "cone" and state is State.PRESS),
        "every way down begins over the pad at height": target not in DESCENDS
        or state in DESCENDS
        or event in (Event.CONTACT, Event.LAND)
        or (target is State.INTERCEPT and event in (Event.SIGHT, Event.CLEAR))
        or (name == "targets" and (state, event, target) == (State.SEARCH, Event.SIGHT, State.GATE)),
        "an order to stay leads up, over the pad, or to a search": event is not Event.STAY
        or target in (State.SEARCH, State.INTERCEPT, State.GO_AROUND),
        "what stays goes down by no way of its own": state is not State.STAY
        or target not in DESCENDS
        or event is Event.LAND
        or (event, target) == (Event.OUT_OF_CONE, State.INTERCEPT),
        "only a person's order, the last charge and a bounce of such a landing lead down without a gate": (event is Event.LAND)
        == (target is State.LAND_HERE),
        "an end is left by a take-off, the operator, a pilot or a battery that ends": state not in ENDED
        or event in (Event.TAKEN_OFF, Event.TAKEN)
        or (event in (Event.BEGIN, Event.STAY, Event.LAND) and state in AGAIN)
        or (event in (Event.HOLD, Event.ABORT) and state in BY_ITSELF)
        or (event is Event.BATTERY_ENDS and state in BY_ITSELF | {State.ABORTED}),
        "the ground is left by a take-off": state not in GROUND or target in GROUND | ENDED or event is Event.TAKEN_OFF,
        "no order to fly to the pad is kept on the ground": state not in GROUND
        or event not in (Event.BEGIN, Event.STAY, Event.LAND),
    }
    return ", ".join(law for law, kept in laws.items() if not kept)


def test_every_pair_is_defined_and_keeps_the_laws_of_the_air() -> None:
    broken = {pair: law for pair in product(MISSIONS, State, Event) if (law := breach(*pair))}
    assert broken == {}


@pytest.mark.parametrize("name", MISSIONS)
def test_the_operators_hand_wins_in_every_state_of_the_flight(name: str) -> None:
    table = TABLES[name]
    for state in AIRBORNE | AGAIN:
        assert table[state][Event.LAND] is State.LAND_HERE
    for state in AIRBORNE:
        assert table[state][Event.ABORT] is State.ABORTED
        assert table[state][Event.HOLD] is State.PAUSED
    for state in (State.READY, State.PAUSED, State.ANOTHER_PAD, State.LAND_HERE, *AGAIN):
        assert table[state][Event.BEGIN] is table[state][Event.STAY] is State.SEARCH
    assert table[State.STAY][Event.BEGIN] is State.SEARCH
    for state in ENDED:
        ends = (State.PAUSED, State.ABORTED) if state in BY_ITSELF else (state, state)
        assert (table[state][Event.HOLD], table[state][Event.ABORT]) == ends


@pytest.mark.parametrize("name", MISSIONS)
def test_every_state_that_waits_for_no_person_has_a_time_and_goes_up_when_it_is_over(name: str) -> None:
    for state in FLOWN - {State.LAND_HERE}:
        target = TABLES[name][state][Event.TIMEOUT]
        assert target is not state
        assert target not in DESCENDS


@pytest.mark.parametrize("name", MISSIONS)
def test_every_state_can_be_reached_and_every_flight_can_end(name: str) -> None:
    table, found = TABLES[name], {State.STANDBY, State.WAIT}
    while more := {target for state in found for target in table[state].values()} - found:
        found |= more
    over_pad = {State.RENDEZVOUS, State.INTERCEPT, State.STAY, State.DESCEND, State.HOLD_BLIND}
    unused = {"cone": set[State](), "thesis": {State.COMMIT}, "targets": {State.COMMIT} | over_pad}[name]
    assert set(State) - found == unused
    for state in FLOWN - unused:
        ends = {state}
        while more := {target for each in ends for target in table[each].values()} - ends:
            ends |= more
        assert {State.LANDED, State.GAVE_UP, State.ABORTED} <= ends


def test_a_table_with_a_gap_or_an_idle_line_is_refused() -> None:
    rows = {state: dict(row) for state, row in TABLES["cone"].items()}
    with pytest.raises(ValueError, match="leads nowhere else"):
        total(rows, Event)
    with pytest.raises(ValueError, match="no row"):
        total({State.WAIT: {}}, Event)


# Effects of the vehicle's report and of one guidance cycle


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


@pytest.mark.parametrize(("we_land", "event"), [(True, Event.GROUNDED), (False, Event.GROUNDED_BY_OTHERS)])
def test_a_vehicle_that_stands_landed_by_our_order_or_by_others(we_land: bool, event: Event) -> None:
    p, changes = take_status(in_state(State.DOWN, we_land=we_land), status(3.0, flying=False), OPTIONS)
    assert events_of(changes) == [(ns(3), State.DOWN, event, p.state, ReasonCause.VEHICLE_STANDS)]
    assert p.state is REPORTS[event]


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


@pytest.mark.parametrize("state", [State.WAIT, State.STANDBY, State.LANDED, State.DESCEND])
def test_a_vehicle_that_does_not_say_whether_it_flies_changes_nothing(state: State) -> None:
    p = in_state(state, automatic=True, stood=True)
    unknown = replace(status(3.0, flying=True), flying=None)
    assert take_status(p, unknown, OPTIONS) == (p, ())


def test_an_order_that_the_state_does_not_know_leaves_no_trace() -> None:
    p = in_state(State.SEARCH)
    assert take_order(p, Event.BEGIN, ns(1), OPTIONS) == (p, ())
    moved, changes = take_order(p, Event.HOLD, ns(1), OPTIONS)
    assert moved.state is State.PAUSED
    assert events_of(changes) == [(ns(1), State.SEARCH, Event.HOLD, State.PAUSED, ReasonCause.OPERATOR)]


def test_events_that_undo_each_other_do_not_hold_the_cycle_up(monkeypatch: pytest.MonkeyPatch) -> None:
    why = Reason(ReasonCause.OPERATOR)
    both = machine.PHASES[State.DESCEND]._replace(events=lambda *_: [(Event.OUT_OF_CONE, why), (Event.IN_CONE, why)])
    phases = {state: both._replace(ways=machine.PHASES[state].ways) for state in (State.DESCEND, State.INTERCEPT)}
    monkeypatch.setattr(machine, "MISSIONS", {"cone": machine.PHASES | phases})
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
    why, changes = take_status(p, replace(taken, taken=f"{words}, later"), OPTIONS)
    assert (why.state, why.taken_from, [c.reason.text for c in changes]) == (State.TAKEN, p.taken_from, [f"{words}, later"])
    assert take_status(p, status(4.0, flying=True), OPTIONS) == (p, ()), "a ground station may choose that mode for its own ends"
    back, changes = take_status(p, status(4.0, flying=True), OPTIONS, resumes=True)
    assert (back.state, changes[0].reason.cause) == (State.SEARCH, ReasonCause.GIVEN_BACK)
    assert take_status(replace(back, asked_at=ns(3.0)), taken, OPTIONS)[1] == (), "a report from before the order"
    assert take_status(in_state(State.READY), taken, OPTIONS)[1] == ()
    for state in (State.PAUSED, State.REFUSED, State.GAVE_UP, State.ABORTED):
        p, _ = take_status(replace(in_state(state), begun=True), taken, OPTIONS)
        assert (p.state, mission_step(p, cycle, OPTIONS)[1]) == (State.TAKEN, Hover())
        assert take_status(p, status(4.0, flying=True), OPTIONS, resumes=True) == (p, ()), "no landing was flown"


NO_FAULT = {
    ReasonCause.VEHICLE_FLIES, ReasonCause.OPERATOR, ReasonCause.AUTOMATIC, ReasonCause.PAD_SEEN, ReasonCause.ARRIVED,
    ReasonCause.OUT_OF_CONE, ReasonCause.LOW_ENOUGH, ReasonCause.ALL_LIMITS_HOLD, ReasonCause.FELT, ReasonCause.STAYED,
    ReasonCause.HELD_UP, ReasonCause.PRESSED, ReasonCause.HIGH_ENOUGH, ReasonCause.VESSEL_FAR, ReasonCause.VESSEL_AWAY,
    ReasonCause.VESSEL_NEAR, ReasonCause.REACHED, ReasonCause.GIVEN_BACK, ReasonCause.RESTARTED,
    ReasonCause.PILOT_LANDS, ReasonCause.SERVICE, ReasonCause.TURNED_ABOUT,
}  # fmt: skip
BY_DETAIL = {ReasonCause.ALERT, ReasonCause.FRAMES}


@pytest.mark.parametrize("cause", [cause for cause in ReasonCause if cause not in BY_DETAIL])
def test_a_cause_has_an_advice_unless_it_is_no_fault(cause: ReasonCause) -> None:
    output = advice(State.GO_AROUND, Reason(cause))
    assert (output == "") == (cause in NO_FAULT)
    assert output == "" or output.endswith((".", "?"))


def test_details_have_an_advice_of_their_own() -> None:
    alerts = [advice(State.HOLD_BLIND, Reason(ReasonCause.ALERT, detail=alert)) for alert in IntegrityAlert]
    assert all(alerts)
    frames = {verdict: Reason(ReasonCause.FRAMES, 60.0, detail=verdict) for verdict in Verdict}
    assert all(reason.text.startswith("60 % of frames ") for reason in frames.values())
    assert [verdict for verdict, reason in frames.items() if not advice(State.HOLD_BLIND, reason)] == [Verdict.FUSED]
    slow = {Verdict.REPLACED: 53, Verdict.GATED: 5}
    hidden = of_frames(slow | {Verdict.NO_PAD: 42})
    assert hidden.text.endswith("this machine is too slow; 89 % of those that were searched show no pad")
    assert advice(State.GO_AROUND, hidden).startswith(advice(State.GO_AROUND, of_frames(slow)) + " Look at the picture")


@pytest.mark.parametrize("state", [State.REFUSED, State.GAVE_UP, State.ABORTED])
def test_a_wait_for_a_person_is_reported(state: State) -> None:
    assert advice(state, Reason(ReasonCause.WIND)).endswith("It hovers until you begin again or land it.")
    assert "hovers" not in advice(State.GO_AROUND, Reason(ReasonCause.WIND))


def test_the_vehicle_s_own_words_reach_mqtt_and_a_recording_and_come_back() -> None:
    words = "PX4 took the vehicle: Maximum flight time reached (mode auto.loiter)"
    taken = StateChange(ns(1.0), State.DESCEND, Event.TAKEN, State.TAKEN, Reason(ReasonCause.TAKEN_OVER, detail=words))
    assert decode.transition(encode.transition(taken)) == taken
    (event,) = Changes().decision(Decision(ns(1.0), State.TAKEN.value, None, None, transitions=(taken,)))
    assert (event.text, event.data["detail"]) == (f"taken over: {words}", words)
    status = VehicleStatus(Stamp(ns(1.0), ns(1.0), 0.0, "arrival"), True, "auto.loiter", 0.5, False, True, words)
    assert decode.sample(encode.sample(status)) == status
