"""A contact on a deck that then falls faster than the vehicle's own landing: it is not made, and if it was it is noticed."""

from typing import Any

import pytest
from msgspec.structs import replace

from companion.base.mission import State, StateChange
from companion.base.observer import Decision, NullObserver
from estimator.contracts.time import NS_PER_S
from sitl.flight.ending import Ending
from sitl.flight.one_flight import fly, perception_level, settings_for
from sitl.scenario.scenario import load

SCENARIO = "sea_state_5"
SEED = 40001
"""A deck that is about to fall away while the drone is at the gate."""


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
    assert ending.contact.lateral_m < 0.05
    assert ending.contact.vertical_speed_m_s < 0.5


@pytest.mark.hazard("H3")
def test_it_waits_at_the_gate_while_the_deck_will_fall_away_from_a_drone_that_stands_on_it() -> None:
    hasty, _ = flown(SEED, deck_fall_m_s=10.0)
    ending, changes = flown(SEED)
    assert_landed_softly(ending)
    assert_landed_softly(hasty)
    assert len(ending.contacts) == 1
    assert hasty.contacts[0].at < ending.contacts[0].at - NS_PER_S, "without the limit it meets the deck before that falls"
    assert State.GO_AROUND not in {change.target for change in changes}
