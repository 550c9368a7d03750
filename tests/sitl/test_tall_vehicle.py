"""A vehicle with tall feet: gate and commit count from its feet, so that it touches nothing while it waits."""

import pytest
from msgspec.structs import replace

from companion.base.mission import State
from companion.base.observer import Decision, NullObserver
from sitl.flight.one_flight import fly, settings_for
from sitl.scenario.scenario import load

FEET_M = 0.25


class _Gate(NullObserver):
    def __init__(self) -> None:
        self.heights_m: list[float] = []

    def on_decision(self, decision: Decision) -> None:
        if decision.phase == State.GATE.value and decision.belief is not None:
            self.heights_m.append(decision.belief.height_m)


@pytest.mark.parametrize("seed", [17, 32])
def test_it_waits_with_its_feet_over_the_deck_and_touches_in_the_commit_alone(seed: int) -> None:
    scenario, gate = load("hexa_7kg"), _Gate()
    settings = settings_for(scenario, None)
    assert settings.guidance.cone.feet_below_m == FEET_M
    ending = fly("hexa_7kg", scenario, seed, settings, "model", observers=[gate])
    assert ending.good
    assert len(ending.contacts) == 1
    assert min(gate.heights_m) > FEET_M + 0.1


def test_with_the_feet_of_a_smaller_vehicle_it_would_touch_while_it_waits() -> None:
    scenario, gate = load("hexa_7kg"), _Gate()
    settings = settings_for(scenario, None)
    low = replace(settings.guidance, cone=replace(settings.guidance.cone, feet_below_m=0.045))
    ending = fly("hexa_7kg", scenario, 17, replace(settings, guidance=low), "model", observers=[gate])
    assert min(gate.heights_m) < FEET_M + 0.1
    assert not ending.good
