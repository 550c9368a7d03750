"""Landings on the stand-ins of both stacks, on a ship under way: closed loop down to the contact, motors off, no failsafe."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import pytest

from companion.runtime.pilot import FlightOutcome
from sitl.autopilots.flight import AutopilotFlight, AutopilotProgram
from sitl.one_flight import settings_for
from sitl.perception.levels import perceive
from sitl.scenario import load


@pytest.mark.timeout(400)
@pytest.mark.parametrize("stack", ["px4", "arducopter"])
async def test_it_lands_on_a_ship_under_way_and_stops_its_motors_at_once(
    stack: Literal["px4", "arducopter"], tmp_path: Path
) -> None:
    scenario = load("moderate")
    program = AutopilotProgram(stack, None, parameters=(("EKF2_REQ_GPS_H", 2.0),))
    flight = AutopilotFlight(scenario, 12, settings_for(scenario, None), program, tmp_path, perception=perceive("truth"))
    end = await flight.fly()
    assert end.failure == ""
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad
    assert end.landing.lateral_m < 0.12
    assert end.landing.slide_m_s < 0.3
    assert abs(math.degrees(end.landing.yaw_rad)) < 8.0, "from 20 degrees off the arrow"
    assert end.armed_after_contact_s is not None
    assert end.armed_after_contact_s < 1.0
    assert end.failsafes == ()
    assert flight.stand_in is not None
    assert not flight.stand_in.armed
