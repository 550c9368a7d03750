"""Advice to a person: one for every cause that interrupts a landing, none for what is as it should be."""

import pytest

from companion.base.mission import Event, Reason, ReasonCause, State, StateChange
from companion.base.observer import Decision
from companion.facts import encode
from companion.guidance.advice import advice
from companion.parts.mqtt.encode import Changes
from companion.recording import decode
from estimator.contracts.estimates import IntegrityAlert, Verdict
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import Stamp
from tests.make import ns

NO_FAULT = {
    ReasonCause.VEHICLE_FLIES, ReasonCause.OPERATOR, ReasonCause.AUTOMATIC, ReasonCause.PAD_SEEN, ReasonCause.ARRIVED,
    ReasonCause.OUT_OF_CONE, ReasonCause.LOW_ENOUGH, ReasonCause.ALL_LIMITS_HOLD, ReasonCause.FELT,
    ReasonCause.HELD_UP, ReasonCause.PRESSED, ReasonCause.HIGH_ENOUGH, ReasonCause.VESSEL_FAR, ReasonCause.VESSEL_AWAY,
    ReasonCause.VESSEL_NEAR, ReasonCause.REACHED, ReasonCause.GIVEN_BACK, ReasonCause.RESTARTED,
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
