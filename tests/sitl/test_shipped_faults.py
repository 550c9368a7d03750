"""Every shipped fault truly acts: what the world shows with it and without is the same before it begins and another after."""

from functools import lru_cache
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.guidance.operator.precedence import ControlSituation
from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.camera.camera import Exposure
from sitl.faults.fault import Fault, RtkSolution
from sitl.faults.kinds import STREAMS, OperatorActs, PictureFault, ServiceKilled, VesselReports
from sitl.scenario.scenario import FAULTS, Scenario, load, shipped_scenarios
from sitl.world.world import Stick, World
from tests.fly import fly_for
from tests.sitl.test_faults import CALM

BEGINS_S, BEFORE, LATER = 0.5, 20, 100
"""Beginning of a fault, and numbers of looks before it and in all."""
ELSEWHERE = (ServiceKilled, OperatorActs, PictureFault, VesselReports, RtkSolution)
"""Faults that a camera without images does not show: test_faults.py, test_ship_faults.py and test_rtk.py test them."""
SHIPPED = [name for name in shipped_scenarios() if name.startswith(f"{FAULTS}/")]


def soon(fault: Fault) -> Fault:
    """Return the same fault, but it begins at a time."""
    beginnings = dict.fromkeys(("below_height_m", "above_height_m", "in_phase", "per_minute"))
    return msgspec.structs.replace(fault, **beginnings, at_s=BEGINS_S)


@lru_cache(2)
def shown(scenario: Scenario) -> list[Any]:
    """Everything that a flight could see of its world, at each 20 ms of two seconds, under one stick."""
    world, out = World(scenario, 3), []

    def camera(shot: Exposure | None, tick: int) -> Any:
        place = None if shot is None else [*shot.p_pad_ned, *shot.p_body_ned]
        return np.array([tick]), place

    for n in range(1, LATER + 1):
        world.stick(Stick(roll=0.6, pitch=0.2, gaz=-0.1, progressive=True))
        world.advance(after(world.started, 0.02 * n))
        r, truth = world.readings(), world.truth()
        frame = world.expose(camera=camera)()
        image, place = frame.px  # type: ignore[misc]
        out.append([
            [*r.f_body, *r.w_body, *r.rpy_rad, *r.v_level_m_s, r.ultrasound_m, r.pressure_pa, r.battery_fraction],
            None if r.magnetometer is None else [*r.magnetometer],
            seconds_between(MonoNs(0), r.at),
            [*truth.p_body_ned, *truth.p_pad_ned, *truth.R_ned_pad.matrix.ravel()],
            [int(image[0]), place, frame.stamp_error_s],
            [(stream.fate(), stream.delay_s) for stream in (getattr(world.streams, name) for name in STREAMS)],
        ])  # fmt: skip
    return out


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_fault_acts_and_not_before_it_begins(name: str) -> None:
    scenario = load(name)
    assert scenario.because
    own = tuple(soon(fault) for fault in scenario.faults if not isinstance(fault, ELSEWHERE))
    without = msgspec.structs.replace(scenario, faults=(), expect="land", refusal="", title="", because="")
    for fault in own:
        with_it = shown(msgspec.structs.replace(without, faults=(fault,)))
        assert with_it[:BEFORE] == shown(without)[:BEFORE]
        assert with_it != shown(without), fault.kind
    assert own or any(isinstance(fault, ELSEWHERE) for fault in scenario.faults)


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
