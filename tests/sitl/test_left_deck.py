"""A contact on a deck that then falls faster than the vehicle's own landing: it is not made, and if it was it is noticed."""

from typing import Any

import pytest

from companion.base.mission import State
from estimator.contracts.time import NS_PER_S
from sitl.flight.ending import Ending
from sitl.flight.one_flight import settings_for
from sitl.scenario.scenario import load
from tests.fly import ObservedCalls, land
from tests.make import change

SCENARIO = "sea_state_5"
SEED = 40001
"""A deck that is about to fall away while the drone is at the gate."""


def fly_with_limits(seed: int, **limits: Any) -> tuple[Ending, set[State]]:
    """Return the ending of a flight with other limits, and the states that it came into."""
    settings, calls = change(settings_for(load(SCENARIO), None), guidance={"limits": limits}), ObservedCalls()
    ending = land(SCENARIO, seed, level="model", settings=settings, observers=[calls])
    return ending, {change.target for decision in calls.decisions for change in decision.transitions}


def assert_landed_softly(ending: Ending) -> None:
    assert ending.on_pad
    assert ending.contact is not None
    assert ending.contact.lateral_m < 0.05
    assert ending.contact.vertical_speed_m_s < 0.5


@pytest.mark.hazard("H3")
def test_it_waits_at_the_gate_while_the_deck_will_fall_away_from_a_drone_that_stands_on_it() -> None:
    hasty, _ = fly_with_limits(SEED, deck_fall_m_s=10.0)
    ending, states = fly_with_limits(SEED)
    assert_landed_softly(ending)
    assert_landed_softly(hasty)
    assert len(ending.contacts) == 1
    assert hasty.contacts[0].at < ending.contacts[0].at - NS_PER_S, "without the limit it meets the deck before that falls"
    assert State.GO_AROUND not in states
