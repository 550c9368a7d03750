"""Landings on the stand-ins of both stacks, on a ship under way: closed loop down to the contact, motors off, no failsafe."""

import math
from pathlib import Path
from typing import Literal

import msgspec
import pytest

from companion.base.mission import FlightOutcome
from companion.base.observer import Decision, NullObserver
from companion.guidance import contact
from sitl.campaign.overrides import Overridable
from sitl.emulators.autopilots.flight import AutopilotFlight, AutopilotProgram
from sitl.faults.kinds import ServiceKilled
from sitl.flight.one_flight import settings_for
from sitl.flight.safety import Grade
from sitl.perception.levels import perceive
from sitl.scenario.scenario import load


def test_what_is_reported_of_a_key_wins_over_what_an_autopilot_has(tmp_path: Path) -> None:
    """WHY: `--set guidance.tries.heading=keep` was taken for silence in a flight with an autopilot, and the nose turned."""
    scenario = load("calm")
    given = Overridable(scenario, settings_for(scenario, None, by_autopilot=True))
    for output, heading in ((list[str](), "align"), (["guidance.tries.heading=keep"], "keep")):
        _, settings = given.with_values([given.parse(text, "--set") for text in output], "--set")
        flight = AutopilotFlight(scenario, 1, settings, AutopilotProgram("px4", None), tmp_path)
        assert flight.service_settings(14540).guidance.tries.heading == heading


@pytest.mark.hazard("H3", "H4")
@pytest.mark.timeout(400)
@pytest.mark.parametrize("stack", ["px4", "arducopter"])
async def test_it_lands_on_a_ship_under_way_and_stops_its_motors_at_once(
    stack: Literal["px4", "arducopter"], tmp_path: Path
) -> None:
    scenario = load("moderate")
    program = AutopilotProgram(stack, None, parameters=(("EKF2_REQ_GPS_H", 2.0),))
    flight = AutopilotFlight(
        scenario, 12, settings_for(scenario, None, by_autopilot=True), program, tmp_path, perception=perceive("truth")
    )
    end = await flight.fly()
    assert end.failure == ""
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad
    assert end.landing.lateral_m < 0.12
    # On a starved machine the stand-in of ArduCopter receives late: it slid 0.43 and 0.62 m/s there, and 0.06 to 0.2 otherwise.
    assert end.landing.slide_m_s < (0.8 if stack == "arducopter" else 0.3)
    assert abs(math.degrees(end.landing.yaw_rad)) < 8.0, "from 20 degrees off the arrow"
    assert end.armed_after_contact_s is not None
    assert end.armed_after_contact_s < 1.0
    assert end.failsafes == ()
    assert flight.stand_in is not None
    assert not flight.stand_in.armed


class Phases(NullObserver):
    """The phases of guidance in their order."""

    def __init__(self) -> None:
        self.seen: list[str] = []

    def on_decision(self, decision: Decision) -> None:
        if self.seen[-1:] != [decision.phase]:
            self.seen.append(decision.phase)


@pytest.mark.timeout(400)
async def test_it_finds_the_ship_by_her_reports_and_lands(tmp_path: Path) -> None:
    """The place of the ship comes from her reports, the vehicle's own from its GLOBAL_POSITION_INT."""
    far = load("rendezvous")
    start = msgspec.structs.replace(far.start, height_m=6.0, pad_forward_m=22.0, pad_right_m=-8.0)
    scenario, phases = msgspec.structs.replace(far, start=start), Phases()
    program, settings = AutopilotProgram("px4", None), settings_for(scenario, None, by_autopilot=True)
    flight = AutopilotFlight(scenario, 12, settings, program, tmp_path, observers=(phases,), perception=perceive("truth"))
    end = await flight.fly()
    assert phases.seen.index("rendezvous") < phases.seen.index("descend")
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad


@pytest.mark.timeout(400)
async def test_a_contact_without_a_step_of_the_accelerometer_is_felt_on_a_falling_deck(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The speeds over the ground alone do not show this contact: the vehicle goes around after it."""
    monkeypatch.setattr(contact, "LEAST_M_S2", math.inf)
    scenario = load("sea_state_5")
    program = AutopilotProgram("px4", None)
    flight = AutopilotFlight(
        scenario, 3, settings_for(scenario, None, by_autopilot=True), program, tmp_path, perception=perceive("model")
    )
    end = await flight.fly()
    assert end.outcome is FlightOutcome.LANDED
    assert [c.surface for c in end.contacts] == ["pad"]
    assert end.armed_after_contact_s is not None
    assert end.armed_after_contact_s < 1.0


@pytest.mark.hazard("H5")
@pytest.mark.timeout(400)
@pytest.mark.parametrize(("stack", "modes"), [("px4", ["offboard", "auto.loiter"]), ("arducopter", ["guided"])])
async def test_it_holds_when_the_service_is_killed_and_a_new_one_lands_it(
    stack: Literal["px4", "arducopter"], modes: list[str], tmp_path: Path
) -> None:
    killed = ServiceKilled(below_height_m=2.5, for_s=4.0)
    scenario = msgspec.structs.replace(load("moderate"), faults=(killed,))
    program = AutopilotProgram(stack, None, parameters=(("EKF2_REQ_GPS_H", 2.0),))
    flight = AutopilotFlight(
        scenario, 12, settings_for(scenario, None, by_autopilot=True), program, tmp_path, perception=perceive("truth")
    )
    end = await flight.fly()
    (silence,) = end.silences
    assert silence.modes == modes, "nothing of the dying service came through"
    assert silence.phase == "descend"
    assert silence.lasted_s == pytest.approx(4.0, abs=0.01)
    assert silence.height_m == pytest.approx(2.5, abs=0.02)
    assert silence.sank_m < 1.0, "the time limit on setpoints at the rate of descent, and the braking"
    assert silence.stopped_s is not None
    assert 1.0 < silence.moved_m < 5.0, "the deck's way until it stopped over the ground"
    assert not silence.touched
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad
    assert end.result is not None
    assert end.result.grade is Grade.ON_PAD


@pytest.mark.timeout(400)
async def test_unaided_it_lands_over_the_ground_while_the_ship_goes_on(tmp_path: Path) -> None:
    """The control flight: the daemon sees the pad and none of its words reaches the vehicle."""
    scenario = load("moderate")
    program = AutopilotProgram("arducopter", None, unaided=True)
    flight = AutopilotFlight(
        scenario, 12, settings_for(scenario, None, by_autopilot=True), program, tmp_path, perception=perceive("truth")
    )
    end = await flight.fly()
    assert flight.link.carried["samples out"] > 1000
    assert flight.link.muted
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert not end.landing.on_pad
    assert end.landing.lateral_m > 5.0, "the ship's way in the time of the descent"
    assert end.landing.slide_m_s > 1.0, "the ship's speed"


async def test_killed_for_good_it_is_left_alone(tmp_path: Path) -> None:
    killed = ServiceKilled(below_height_m=2.5)
    scenario = msgspec.structs.replace(load("moderate"), faults=(killed,), duration_limit_s=25.0, expect="refuse")
    program = AutopilotProgram("arducopter", None)
    flight = AutopilotFlight(
        scenario, 12, settings_for(scenario, None, by_autopilot=True), program, tmp_path, perception=perceive("truth")
    )
    end = await flight.fly()
    assert end.outcome is None
    assert end.contacts == ()
    assert end.result is not None
    assert end.result.because.startswith("hovered without a service")


@pytest.mark.hazard("H4", "H5")
@pytest.mark.timeout(400)
async def test_a_new_service_lands_a_vehicle_that_was_left_on_the_deck_with_its_motors_turning(tmp_path: Path) -> None:
    killed = ServiceKilled(in_phase="press", for_s=2.0)
    scenario = msgspec.structs.replace(load("moderate"), faults=(killed,), unreached_contacts=True)
    program = AutopilotProgram("arducopter", None)
    flight = AutopilotFlight(
        scenario, 12, settings_for(scenario, None, by_autopilot=True), program, tmp_path, perception=perceive("truth")
    )
    end = await flight.fly()
    (silence,) = end.silences
    assert silence.phase == "press"
    assert silence.lowest_m < 0.06
    assert end.failure == ""
    assert end.outcome is FlightOutcome.LANDED
    assert len(end.contacts) == 2
    assert all(contact.on_pad for contact in end.contacts)
    assert flight.stand_in is not None
    assert not flight.stand_in.armed


class _CameraDelay(NullObserver):
    """Keeps the camera's delay as the filter has learned it."""

    learned_s = math.nan

    def on_decision(self, decision: Decision) -> None:
        if decision.belief is not None and decision.belief.sighted is not None:
            self.learned_s = dict(decision.belief.details).get("camera_delay_s", math.nan)


@pytest.mark.timeout(400)
async def test_an_autopilots_filtered_gyro_is_not_taken_for_a_slow_camera(tmp_path: Path) -> None:
    scenario, seen = load("moderate"), _CameraDelay()
    program = AutopilotProgram("arducopter", None)
    flight = AutopilotFlight(
        scenario, 24, settings_for(scenario, None, by_autopilot=True), program, tmp_path, [seen], perceive("model")
    )
    end = await flight.fly()
    assert end.outcome is FlightOutcome.LANDED
    assert abs(seen.learned_s) < 0.012, "as stamped they are 18 ms apart"
