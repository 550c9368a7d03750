"""The time after a flight's outcome, by crafted truths: the one end of every flight, whatever vehicle flew it."""

import msgspec
import numpy as np
import pytest

from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.guidance.operator.precedence import ControlSituation
from drivers.clock import SystemClock
from estimator.contracts.time import MonoNs, after
from sitl.faults.corrupted import Corruptions
from sitl.faults.fault import FaultTimer
from sitl.flight.afterwards import Afterwards
from sitl.flight.grader import FlightGrader
from sitl.scenario.scenario import vehicle_model
from sitl.scenario.settings import settings_for
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Touchdown, Truth
from sitl.world.world import World
from tests.sitl.test_world import CALM


class CraftedWorld:
    """A world at rest whose vehicle is put where a test says."""

    def __init__(self) -> None:
        self.scenario, self.seed, self.faults, self.guidance_phase = CALM, 1, FaultTimer(()), "gave_up"
        self._truth = World(CALM, seed=1).truth()
        self.started = self._truth.at
        self.corruptions, self.reached = Corruptions(self.faults, 1), True

    @property
    def at(self) -> MonoNs:
        return self._truth.at

    now = at

    def put(
        self, at_s: float, height_m: float, *contacts: Touchdown, aside_m: float = 0.0, phase: VehiclePhase = VehiclePhase.FLYING
    ) -> None:
        still, touch = np.zeros(3), contacts[-1] if contacts else None
        self._truth = msgspec.structs.replace(
            self._truth, at=after(self.started, at_s), p_body_ned=np.array([aside_m, 0.0, -height_m]), p_pad_ned=still,
            v_body_ned=still, v_pad_ned=still, R_ned_body=self._truth.R_ned_pad, contacts=contacts, touchdown=touch, phase=phase,
        )  # fmt: skip

    def truth(self) -> Truth:
        return self._truth


def followed(world: CraftedWorld, outcome: FlightOutcome) -> tuple[FlightGrader, Afterwards]:
    grader = FlightGrader(world, settings_for(CALM, None), 2.0)
    return grader, Afterwards(grader, grader.result(outcome, ControlSituation.GUIDED, Health(SystemClock())))


FEET = vehicle_model(CALM).airframe().feet


@pytest.mark.parametrize(
    ("height_m", "aside_m", "phase", "why"),
    [
        (FEET.below_m, 0.1, VehiclePhase.LANDED, ""),
        (FEET.below_m, 0.43, VehiclePhase.LANDED, "stands 43.0 cm from the pad's centre, 43.0 cm from its contact, off the pad"),
        (3.0, 0.0, VehiclePhase.FLYING, "it does not stand: 5 s later: flying"),
        (-3.0, 0.0, VehiclePhase.LANDED, "it left the deck"),
    ],
)
def test_a_landing_is_worth_where_the_vehicle_stands_afterwards(height_m, aside_m, phase, why) -> None:
    """WHY: a vehicle that an autopilot flew stood 43 cm off and was graded "on pad"."""
    world = CraftedWorld()
    touch = Touchdown(world.started, "pad", np.zeros(3), 0.0, 0.0, 0.2, 0.0, over_rim_m=-0.2)
    world.put(0.0, FEET.below_m, touch, phase=phase)
    grader, later = followed(world, FlightOutcome.LANDED)
    assert later.flies is (phase is VehiclePhase.FLYING)
    for n in range(1, 101):
        world.put(0.05 * n, height_m, touch, aside_m=min(aside_m, 0.02 * n), phase=phase)
        grader.step()
        later.step()
    ending = later.ending(7.0)
    assert (ending.judged.grade, ending.judged.cpu_s) == ("failed" if why else "on pad", 7.0)
    assert ending.judged.because.startswith(why)


def test_a_refused_vehicle_that_falls_climbs_or_stands_with_turning_motors_is_unsafe() -> None:
    world = CraftedWorld()
    world.put(0.0, 14.5)
    grader, later = followed(world, FlightOutcome.GAVE_UP)
    world.put(1.0, 14.6)
    grader.step()
    assert later.ending(1.0).aftermath.unsafe == (), "it was too high before"
    stray = Touchdown(after(world.started, 2.0), "deck", np.array([0.9, 0.0, 0.0]), 0.9, 0.0, 0.2, 0.1, over_rim_m=0.6)
    for n in range(8):
        world.put(2.0 + 0.5 * n, FEET.below_m, stray, aside_m=0.9)
        grader.step()
        later.step()
    ending = later.ending(1.0)
    assert (ending.aftermath.contacts, ending.judged.highest_m) == (1, pytest.approx(14.6))
    assert ending.aftermath.unsafe == (
        "gave up, and then touched the deck 0.90 m from the pad's centre, a foot 0.60 m over the rim, 1 times so",
        "gave up, and then stood on the deck for 3.5 s with turning motors",
    )
    assert ending.judged.unsafe[1:] == ending.aftermath.unsafe
    assert not ending.good


@pytest.mark.parametrize(("phase", "grade"), [("stay over the pad", "refused rightly"), ("search", "failed")])
def test_a_flight_that_stays_over_the_pad_for_its_person_waits_rightly(phase: str, grade: str) -> None:
    world = CraftedWorld()
    world.scenario, world.guidance_phase = msgspec.structs.replace(CALM, expect="either"), phase
    world.put(0.0, 3.0)
    grader = FlightGrader(world, settings_for(CALM, None), 2.0)
    assert grader.result(None, ControlSituation.GUIDED, Health(SystemClock())).judged.grade == grade
