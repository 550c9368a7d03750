"""Landings on the stand-ins of both stacks, on a ship under way: closed loop down to the contact, motors off, no failsafe."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import msgspec
import pytest

from companion.base.mission import FlightOutcome
from companion.base.observer import Decision, NullObserver, Observer
from companion.base.orders import CENTRED, StickPositions
from companion.cli.main import main
from companion.guidance.mission import contact
from companion.settings.load import response_model, shipped_response
from drivers.mavlink.dialect import mav
from drivers.mavlink.options import GimbalOptions
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs
from sitl.emulators.autopilots.conduct import FlightEnd
from sitl.emulators.autopilots.stand_in.flight import StandInFlight
from sitl.faults.corrupted import Corrupted
from sitl.faults.kinds import Failsafe, LowBattery, OperatorActs, ServiceKilled
from sitl.flight import afterwards
from sitl.flight.afterwards import STANDS_AFTER_S
from sitl.flight.hands import HandsWatch
from sitl.perception.levels import perceive
from sitl.scenario.overrides import Overridable
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for


def test_what_is_reported_of_a_key_wins_over_what_an_autopilot_has() -> None:
    """WHY: `--set guidance.tries.heading=keep` was taken for silence in a flight with an autopilot, and the nose turned."""
    scenario = load("calm")
    given = Overridable(scenario, settings_for(scenario, None, by_autopilot=True))
    for output, heading in ((list[str](), "align"), (["guidance.tries.heading=keep"], "keep")):
        _, settings = given.with_values([given.parse(text, "--set") for text in output], "--set")
        flight = StandInFlight(scenario, 1, settings, "px4")
        assert flight.service_settings().guidance.tries.heading == heading


@pytest.mark.parametrize(("stack", "response"), [("arducopter", "autopilot"), ("px4", "px4")])
def test_an_autopilot_is_flown_by_its_own_response_and_not_by_that_of_the_simulated_loops(stack, response):
    """WHY: ArduCopter was flown by a climb that answers after 58 ms, and swung up and down over the deck by 0.5 m/s."""
    scenario = load("weather_4")
    given = Overridable(scenario, settings_for(scenario, None, by_autopilot=True))
    for changes in ([], ["weather.wind_m_s=4"]):
        _, settings = given.with_values([given.parse(text, "--set") for text in changes], "--set")
        flown_by = StandInFlight(scenario, 1, settings, stack).service_settings()
        assert response_model(flown_by) == shipped_response(response)


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """End each flight soon after its contact: only one of them is to stand."""
    monkeypatch.setattr(afterwards, "STANDS_AFTER_S", 0.0)


def flight_of(
    stack: Literal["px4", "arducopter"],
    name: str = "moderate",
    seed: int = 12,
    level: str = "truth",
    *,
    start: dict[str, float] | None = None,
    observers: Sequence[Observer] = (),
    unaided: bool = False,
    **changes: Any,
) -> StandInFlight:
    """Return a flight of a stand-in in a scenario that begins lower or elsewhere and has other keys."""
    given = load(name)
    begun = msgspec.structs.replace(given.start, **{"height_m": 3.0} if start is None else start)
    scenario = msgspec.structs.replace(given, start=begun, **changes)
    parameters = {"EKF2_REQ_GPS_H": 2.0} if stack == "px4" else {}
    settings = settings_for(scenario, None, by_autopilot=True)
    return StandInFlight(
        scenario, seed, settings, stack, parameters, observers=observers, perception=perceive(level), unaided=unaided
    )


@pytest.mark.hazard("H7")
@pytest.mark.parametrize("stack", ["arducopter", "px4"])
def test_an_accelerometer_that_begins_to_err_makes_no_deck_run_away(stack: Literal["px4", "arducopter"]) -> None:
    """WHY: the filter refused the right velocity for good, and the law followed a deck at 12 m/s (kept from a campaign)."""
    fault = Corrupted(signal="accelerometer", error="biased", size=0.786, at_s=0.0925)
    end = flight_of(stack, "weather_3", 903026, "model", start={}, faults=(fault,)).fly()
    assert end.ending.outcome is FlightOutcome.LANDED
    assert end.ending.contact.on_pad


def assert_landed_and_stopped_at_once(flight: StandInFlight, end: FlightEnd) -> None:
    assert end.failure == ""
    assert end.ending.outcome is FlightOutcome.LANDED
    assert end.ending.contact.on_pad
    assert end.ending.contact.lateral_m < 0.12
    # On a starved machine the stand-in of ArduCopter receives late: it slid 0.43 and 0.62 m/s there, and 0.06 to 0.2 otherwise.
    assert end.ending.contact.lateral_speed_m_s < (0.8 if flight.autopilot == "arducopter" else 0.3)
    assert abs(math.degrees(end.ending.contact.yaw_rad)) < 8.0, "from 20 degrees off the arrow"
    assert end.armed_after_contact_s < 1.0
    assert not flight.stand_in.armed
    assert flight.stand_in.mode in ("guided", "offboard"), "its own landing holds over the ground"


class Seen(NullObserver):
    """The phases of guidance in their order, and the camera's delay as the filter has learned it last."""

    def __init__(self) -> None:
        self.phases: list[str] = []
        self.delay_s = math.nan

    def on_decision(self, decision: Decision) -> None:
        if self.phases[-1:] != [decision.phase]:
            self.phases.append(decision.phase)
        if decision.belief is not None and decision.belief.sighted is not None:
            self.delay_s = dict(decision.belief.details).get("camera_delay_s", math.nan)


@pytest.mark.hazard("H3", "H4")
@pytest.mark.timeout(400)
def test_it_lands_by_sight_and_an_autopilots_filtered_gyro_is_not_taken_for_a_slow_camera() -> None:
    seen = Seen()
    flight = flight_of("arducopter", seed=24, level="model", start={"height_m": 4.0}, observers=[seen])
    end = flight.fly()
    assert_landed_and_stopped_at_once(flight, end)
    assert end.failsafes == ()
    assert abs(seen.delay_s) < 0.012, "as stamped they are 18 ms apart"


@pytest.mark.parametrize(("vehicle", "stack"), [("hexa_7kg", "px4"), ("quad_1_5kg", "arducopter")])
def test_every_vehicle_lands_by_an_autopilot_that_is_set_up_for_it_and_a_seed_gives_the_same_flight(vehicle, stack):
    of_vehicle = msgspec.structs.replace(load("calm").vehicle, file=vehicle)
    flights = [flight_of(stack, "calm", 5, "model", vehicle=of_vehicle).fly() for _ in range(2)]
    first, again = ({**end.as_json(), "cpu_s": 0.0} for end in flights)
    assert first == again
    assert flights[0].ending.standing.lateral_m < 0.15


@pytest.mark.timeout(400)
def test_a_contact_without_a_step_of_the_accelerometer_is_felt_on_a_falling_deck(monkeypatch):
    """The speeds over the ground alone do not show this contact: the vehicle goes around after it."""
    monkeypatch.setattr(contact, "LEAST_M_S2", math.inf)
    monkeypatch.setattr(afterwards, "STANDS_AFTER_S", STANDS_AFTER_S)
    one_system = msgspec.structs.replace(load("sea_state_5").sea, swell=None, peak_enhancement=3.3)
    end = flight_of("px4", "sea_state_5", 4, "model", start={}, sea=one_system).fly()
    assert end.ending.outcome is FlightOutcome.LANDED
    assert end.failsafes == ()
    assert [c.surface for c in end.ending.contacts] == ["pad"]
    assert end.ending.standing.lateral_m < 0.1
    assert end.armed_after_contact_s < 1.0


@pytest.mark.hazard("H3", "H4", "H5")
@pytest.mark.timeout(400)
@pytest.mark.parametrize(("stack", "modes"), [("px4", ["offboard", "auto.loiter"]), ("arducopter", ["guided"])])
def test_it_holds_when_the_service_is_killed_and_a_new_one_lands_it(stack, modes):
    """The new service goes on with the landing: it finds the ship by her reports, its own place by GLOBAL_POSITION_INT."""
    seen, killed = Seen(), (ServiceKilled(below_height_m=2.2, for_s=4.0),)
    start = {"height_m": 3.0, "pad_forward_m": 14.0, "pad_right_m": -6.0, "heading_deg": -20.0}
    flight = flight_of(stack, observers=[seen], faults=killed, name="rendezvous", start=start)
    end = flight.fly()
    assert seen.phases.index("rendezvous") < seen.phases.index("descend")
    assert end.failsafes == (("Failsafe activated: Offboard signal lost, entering Hold",) if stack == "px4" else ())
    (silence,) = end.silences
    assert silence.modes == modes, "nothing of the dying service came through"
    assert silence.phase == "descend"
    assert silence.lasted_s == pytest.approx(4.0, abs=0.01)
    assert silence.height_m == pytest.approx(2.2, abs=0.02)
    assert silence.sank_m < 1.3, "the time limit on setpoints at the rate of descent, the deck's fall, and the braking"
    assert silence.stopped_s is not None
    assert 1.0 < silence.moved_m < 5.0, "the deck's way until it stopped over the ground"
    assert not silence.touched
    assert_landed_and_stopped_at_once(flight, end)
    assert end.ending.good, end.ending.judged


@pytest.mark.hazard("H4", "H6")
@pytest.mark.timeout(400)
@pytest.mark.parametrize("stack", ["px4", "arducopter"])
def test_a_pilot_who_switches_the_mode_is_obeyed_and_gives_it_back(stack):
    """The referee reads the wires: his mode, what the service sent after it, and that it asked for none until he gave it back."""
    modes: list[tuple[float, str]] = []
    switched = OperatorActs(order="mode", below_height_m=2.5, for_s=2.0)
    flight = flight_of(stack, "calm", faults=(switched,))
    acts = HandsWatch.acts

    def noted(watch: HandsWatch, act: str, at: MonoNs, sticks: StickPositions = CENTRED, late_s: float = 0.0) -> None:
        modes.append((at * 1e-9, act))
        acts(watch, act, at, sticks, late_s)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(HandsWatch, "acts", noted)
        end = flight.fly()
    assert [act for _, act in modes] == ["mode", "begin"]
    assert modes[1][0] - modes[0][0] == pytest.approx(2.0, abs=0.2)
    assert end.ending.good


@pytest.mark.hazard("H6")
@pytest.mark.timeout(400)
@pytest.mark.parametrize("stack", ["px4", "arducopter"])
def test_a_failsafe_is_left_alone_and_an_empty_battery_ends_the_flight(stack):
    faults = (Failsafe(below_height_m=2.5, takes="hold"), LowBattery(fraction=0.0, below_height_m=2.4, drawn_within_s=3.0))
    flight = flight_of(stack, "calm", faults=faults, expect="either", because="its failsafe has it")
    end = flight.fly()
    assert flight.stand_in.failsafes != []
    assert end.ending.outcome is FlightOutcome.TAKEN
    assert end.ending.judged.counts.keys() & {"disobeyed_s", "unordered"} == set(), end.ending.judged.unsafe
    assert end.ending.judged.counts["motors_off_m"][0] > 0.5, "the motors stopped in the air"


@pytest.mark.timeout(400)
def test_unaided_it_lands_over_the_ground_while_the_ship_goes_on() -> None:
    """The control flight: the daemon sees the pad and none of its words reaches the vehicle."""
    flight = flight_of("arducopter", unaided=True)
    end = flight.fly()
    assert flight.link.carried["samples out"] > 1000
    assert flight.link.muted
    assert end.ending.outcome is FlightOutcome.LANDED
    assert not end.ending.contact.on_pad
    assert end.ending.contact.lateral_m > 5.0, "the ship's way in the time of the descent"
    assert end.ending.contact.lateral_speed_m_s > 1.0, "the ship's speed"


def test_killed_for_good_it_is_left_alone() -> None:
    killed = ServiceKilled(below_height_m=2.5)
    end = flight_of("arducopter", faults=(killed,), duration_limit_s=10.0, expect="refuse").fly()
    assert end.ending.outcome is None
    assert end.ending.contacts == ()
    assert end.ending.as_json()["because"].startswith("hovered without a service")


def test_killed_before_its_first_step_it_is_watched_all_the_same() -> None:
    end = flight_of("px4", faults=(ServiceKilled(at_s=0.0, for_s=1.0),), duration_limit_s=2.0, expect="refuse").fly()
    (silence,) = end.silences
    assert silence.phase is None


@pytest.mark.hazard("H4", "H5")
@pytest.mark.timeout(400)
def test_a_new_service_lands_a_vehicle_that_was_left_on_the_deck_with_its_motors_turning() -> None:
    killed = ServiceKilled(in_phase="press", for_s=2.0)
    flight = flight_of("arducopter", faults=(killed,), unreached_contacts=True)
    end = flight.fly()
    (silence,) = end.silences
    assert silence.phase == "press"
    assert silence.lowest_m < 0.06
    assert end.failure == ""
    assert end.ending.outcome is FlightOutcome.LANDED
    assert len(end.ending.contacts) == 2
    assert all(contact.on_pad for contact in end.ending.contacts)
    assert not flight.stand_in.armed


def gimbal_flight(*, point_down: bool = True, limit_s: float = 90.0, perception: Any = "pixels", **gimbal: Any) -> StandInFlight:
    scenario = load("gimbal")
    start = msgspec.structs.replace(scenario.start, height_m=2.5, pad_right_m=0.5, pad_forward_m=0.4)
    scenario = msgspec.structs.replace(
        scenario, gimbal=msgspec.structs.replace(scenario.gimbal, **gimbal), start=start, duration_limit_s=limit_s
    )
    settings = settings_for(scenario, None, by_autopilot=True)
    options = GimbalOptions(scenario.gimbal.device_id, point_down=point_down)
    settings = msgspec.structs.replace(settings, camera=msgspec.structs.replace(settings.camera, gimbal=options))
    return StandInFlight(scenario, 3, settings, "arducopter", perception=perceive(perception))


@pytest.mark.timeout(600)
def test_it_lands_by_a_swinging_camera_whose_yaw_is_from_north_and_which_somebody_pointed_ahead_on_the_way():
    landing = gimbal_flight(device_id=1, yaw="earth", leaves_at_s=5.0)
    end = landing.fly()
    assert end.failure == ""
    assert end.ending.outcome is FlightOutcome.LANDED
    assert end.ending.contact.on_pad
    assert end.ending.contact.lateral_m < 0.15
    link = landing.stand_in.gimbal if landing.stand_in is not None else None
    assert link.commands[mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW] == 2, "at the start, and when it had left"
    assert link.control == (1, 191)


@pytest.mark.timeout(600)
def test_it_does_not_descend_while_the_gimbal_reports_nothing() -> None:
    landing = gimbal_flight(limit_s=3.5, silent_at_s=0.01)
    end = landing.fly()
    assert end.ending.contact is None
    assert end.ending.outcome is not FlightOutcome.LANDED
    assert end.health.frames[Verdict.NO_GIMBAL] > 50
    assert end.health.frames[Verdict.FUSED] == 0
    assert landing.body.pad_motion().p_ned[2] - landing.body.state().p_ned[2] > 1.8, "of 2.5 m"


MINIATURE_OF_TRUTH = ["--autopilot", "px4", "--perception", "truth"]


@pytest.mark.parametrize("argv", [[], ["--follow", "udpin://127.0.0.1:1"], MINIATURE_OF_TRUTH])
def test_only_a_miniature_with_rendered_frames_has_a_gimbal(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "gimbal", *argv]) == 2
    assert "gimbal: " in capsys.readouterr().err
