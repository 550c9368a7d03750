"""A vehicle with tall feet: gate and commit count from its feet, so that it touches nothing while it waits."""

from msgspec.structs import replace

from companion.base.mission import State
from companion.base.observer import Decision, NullObserver
from sitl.flight.ending import Ending
from sitl.flight.one_flight import fly, settings_for
from sitl.scenario.scenario import load

FEET_M = 0.25


class _Gate(NullObserver):
    def __init__(self) -> None:
        self.heights_m: list[float] = []

    def on_decision(self, decision: Decision) -> None:
        if decision.phase == State.GATE.value and decision.belief is not None:
            self.heights_m.append(decision.belief.height_m)


def flown(feet_m: float | None = None, **changes: float) -> tuple[Ending, list[float]]:
    """Return the ending of a flight with its own feet or others, and its heights at the gate, m."""
    scenario, gate = replace(load("hexa_7kg"), **changes), _Gate()
    settings = settings_for(scenario, None)
    assert settings.guidance.cone.feet_below_m == FEET_M
    cone = replace(settings.guidance.cone, feet_below_m=FEET_M if feet_m is None else feet_m)
    settings = replace(settings, guidance=replace(settings.guidance, cone=cone))
    return fly("hexa_7kg", scenario, 17, settings, "model", observers=[gate]), gate.heights_m


def test_it_waits_with_its_feet_over_the_deck_and_touches_in_the_commit_alone() -> None:
    ending, heights_m = flown()
    assert ending.good
    assert len(ending.contacts) == 1
    assert min(heights_m) > FEET_M + 0.1


def test_with_the_feet_of_a_smaller_vehicle_it_waits_too_low() -> None:
    _, heights_m = flown(0.045, duration_limit_s=10.5)
    assert min(heights_m) < FEET_M + 0.1
