"""Every shipped fault says why it is there; what a person does in one is done."""

import pytest

from companion.guidance.operator.precedence import ControlSituation
from sitl.faults.kinds import OperatorActs
from sitl.scenario.scenario import FAULTS, load, shipped_scenarios
from tests.fly import fly_for
from tests.sitl.test_faults import CALM


@pytest.mark.parametrize("name", [name for name in shipped_scenarios() if name.startswith(f"{FAULTS}/")])
def test_a_shipped_fault_has_a_reason_and_acts_on_the_ardrone(name: str) -> None:
    scenario = load(name)
    assert scenario.because
    assert all(fault.carried_by("ardrone") for fault in scenario.faults)


@pytest.mark.parametrize(
    ("fault", "situation"),
    [
        (OperatorActs(at_s=0.5, order="hold"), ControlSituation.HELD),
        (OperatorActs(at_s=0.5, order="manual", climb=1.0), ControlSituation.MANUAL),
        (OperatorActs(at_s=0.5, order="abort"), ControlSituation.OVER),
        (OperatorActs(at_s=0.5, order="land"), ControlSituation.LANDING),
        (OperatorActs(at_s=0.5, for_s=0.5, order="hold"), ControlSituation.GUIDED),
        (OperatorActs(at_s=0.5, for_s=0.5, order="manual"), ControlSituation.GUIDED),
    ],
)
def test_a_person_takes_over_and_gives_back(fault: OperatorActs, situation: ControlSituation) -> None:
    flight = fly_for(1.2, CALM, level="truth", faults=(fault,))
    assert flight.pilot.operator.situation(flight._clock.t) is situation
    early = fly_for(0.45, CALM, level="truth", faults=(fault,))
    assert early.pilot.operator.situation(early._clock.t) is ControlSituation.GUIDED


def test_sticks_of_a_person_fly_the_drone() -> None:
    up, held = (
        fly_for(2.0, CALM, level="truth", faults=(OperatorActs(at_s=0.2, order="manual", climb=c),)).world.truth()
        for c in (1.0, 0.0)
    )
    assert held.p_body_ned[2] - up.p_body_ned[2] > 0.4
