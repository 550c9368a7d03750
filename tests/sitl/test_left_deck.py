"""A contact on a deck that then falls faster than the vehicle's own landing is noticed."""

from typing import Any

import pytest
from msgspec.structs import replace

from companion.base.mission import State, StateChange
from companion.base.observer import Decision, NullObserver
from companion.base.reason import ReasonCause
from sitl.flight.ending import Ending
from sitl.flight.one_flight import fly, perception_level, settings_for
from sitl.scenario.scenario import load

SCENARIO = "sea_state_5"
AS_IT_IS_MET = 30561
"""Seed of a deck that falls away as it is met."""


class _Changes(NullObserver):
    def __init__(self) -> None:
        self.all: list[StateChange] = []

    def on_decision(self, decision: Decision) -> None:
        self.all.extend(decision.transitions)


def flown(seed: int, **limits: Any) -> tuple[Ending, list[StateChange]]:
    scenario = load(SCENARIO)
    settings = settings_for(scenario, None)
    guidance = replace(settings.guidance, limits=replace(settings.guidance.limits, **limits))
    changes = _Changes()
    ending = fly(SCENARIO, scenario, seed, replace(settings, guidance=guidance), perception_level("model"), observers=[changes])
    return ending, changes.all


def assert_landed_softly(ending: Ending) -> None:
    assert ending.on_pad
    assert ending.contact is not None
    assert ending.contact.lateral_m < 0.06
    assert ending.contact.vertical_speed_m_s < 0.5


@pytest.mark.hazard("H3")
def test_a_drone_that_is_in_the_air_again_after_the_contact_goes_around() -> None:
    ending, changes = flown(AS_IT_IS_MET, deck_fall_m_s=10.0)
    arounds = [change for change in changes if change.target is State.GO_AROUND]
    expected = {(State.DOWN, ReasonCause.OFF_DECK), (State.COMMIT, ReasonCause.ERROR)}
    assert {(around.source, around.reason.cause) for around in arounds} <= expected
    assert_landed_softly(ending)
    assert len(ending.contacts) == 1 + len(arounds), "a contact that does not stay is followed by a go-around"
