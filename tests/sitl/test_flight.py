"""Whole flights in virtual time: frames as the drone is configured, never lower for a fault, and nothing learned by standing."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import State
from companion.base.observer import Decision, NullObserver
from companion.settings.load import load
from estimator.contracts.commands import Land, Lean, Velocity
from sitl.ardrone.flight import Flight
from sitl.faults.kinds import FrameStream, LensCovered, NavdataStream, StreamFault
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.settings import settings_for
from tests.fly import ObservedCalls, fly_for, land, new_flight
from tests.make import change

SIM = load("sim")
LOW = change(load_scenario("calm"), start={"height_m": 2.2, "pad_forward_m": 0.3, "pad_right_m": 0.2}, duration_limit_s=40.0)
"""A short flight: most of it is the descent."""
_ON_DECK = (State.PRESS.value, State.DOWN.value)
"""Phases that only a felt contact leads to."""
SETTLED_S = 16.0


@pytest.mark.parametrize("frames_per_s", [15, 30])
def test_frames_come_as_often_as_the_drone_is_configured_to_send_them(frames_per_s: int) -> None:
    settings = change(SIM, vehicle={"further_configuration": f"video:codec_fps={frames_per_s}"})
    flight = fly_for(2.0, LOW, 3, level="truth", settings=settings)
    assert flight.exposures == pytest.approx(2 * frames_per_s, abs=1)


def assert_never_lower_without_sight(decisions: list[Decision]) -> None:
    """While sight is stale nothing descends or lands; what the air does to the drone is not a command."""
    stale_s = SIM.guidance.stale_after_s
    blind = [d for d in decisions if d.belief is None or d.belief.age_s(d.at) > stale_s]
    blind = [d for d in blind if d.phase not in _ON_DECK]
    assert len(blind) > 50
    for decision in blind:
        assert not (isinstance(decision.command, Velocity | Lean) and decision.command.v_level[2] > 0), decision
        assert not isinstance(decision.command, Land), decision


@pytest.mark.parametrize("kind", [FrameStream, NavdataStream])
def test_a_fault_in_the_descent_never_makes_it_descend_or_land_without_sight(kind: type[StreamFault]) -> None:
    """Losses of the wires are lost with images and without: the flight sees by the model of them."""
    calls, lost = ObservedCalls(), kind(at_s=2.5, for_s=4.0, dropped_fraction=1.0)
    flown = land(LOW, 3, level="model", settings=SIM, observers=[calls], faults=(lost,), duration_limit_s=12.0)
    assert_never_lower_without_sight(calls.decisions)
    assert flown.contact is None or flown.contact.surface in ("pad", "deck")


def test_it_lands_after_the_lens_was_covered_for_a_while_in_which_it_never_sank_nor_began_to_land() -> None:
    calls = ObservedCalls()
    result = land(LOW, 3, level="pixels", settings=SIM, observers=[calls], faults=(LensCovered(at_s=2.5, for_s=3.0),))
    assert_never_lower_without_sight(calls.decisions)
    assert result.on_pad
    assert result.frames.total() == len(calls.frames), "every frame is counted"
    assert "go around" in {d.phase for d in calls.decisions}


def test_it_stays_over_the_pad_of_a_ship_in_sea_state_4_until_a_person_begins_the_landing() -> None:
    stays, begins = load_scenario("stay").faults
    scenario = change(load_scenario("stay"), faults=(stays, replace(begins, at_s=20.0)))
    flight, aside_m, heights_m = new_flight(scenario, 2, level="model", settings=settings_for(scenario, None)), [0.0], [3.0]
    while flight.step():
        truth = flight.world.truth()
        if 9.0 < (truth.at - flight.world.started) * 1e-9 < 19.9:
            assert flight.world.guidance_phase == State.STAY.value
            aside_m.append(float(np.hypot(*truth.d_body_pad_level[:2])))
            heights_m.append(float(truth.d_body_pad_level[2]))
    print(f"10.9 s within {max(aside_m):.2f} m of the axis, {min(heights_m):.2f} to {max(heights_m):.2f} m over the deck")
    assert max(aside_m) < 0.5
    assert min(heights_m) > 2.7
    assert max(heights_m) < 4.0
    assert flight.result().on_pad


class Errors(NullObserver):
    """The NEES of the pad's position at each decision of a settled hover."""

    def __init__(self) -> None:
        self.nees: list[float] = []
        self.flight: Flight | None = None

    def on_decision(self, decision: Decision) -> None:
        assert self.flight is not None
        if decision.belief is not None and decision.at > SETTLED_S * 1e9:
            error = decision.belief.d_body_pad_level - self.flight.world.truth().d_body_pad_level
            self.nees.append(float(error @ np.linalg.solve(decision.belief.cov[:3, :3], error)))


def test_a_tilted_body_is_not_distinguished_from_a_biased_accelerometer_by_standing_still() -> None:
    """Two seeds whose accelerometers are off by two sigma; a filter that learns from its own corrections is at 10, not at 3."""
    settings = change(SIM, guidance={"start": "signal"})
    means = []
    for seed in (1, 7):
        errors = Errors()
        errors.flight = new_flight("calm", seed, level="model", settings=settings, observers=[errors], duration_limit_s=24.0)
        while errors.flight.step():
            pass
        assert len(errors.nees) > 300
        means.append(np.mean(errors.nees))
    assert max(means) < 8.0
