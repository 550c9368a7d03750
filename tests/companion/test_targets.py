"""The mission in which the autopilot lands by itself: who chooses its modes, when it is called off, and what is sent ahead."""

import math
from types import MappingProxyType

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import GROUND, Event, Reason, ReasonCause, State
from companion.guidance.controller import Knowledge, Target
from companion.guidance.landing import LandingGuidance, PilotOptions
from companion.guidance.mission.gate import gate_of
from companion.guidance.mission.machine import aim, mission_step, take_order
from companion.guidance.mission.progress import GuidanceCycle, Progress
from companion.parts.mavlink.make import authority_of
from companion.parts.mavlink.outputs import PX4_LATE_S, AutopilotView, Lead, Outputs
from companion.settings.guidance import GuidanceOptions
from companion.settings.links import OutputOptions
from companion.settings.load import load
from companion.settings.overrides import with_overrides
from drivers.mavlink.custody import Authority
from drivers.mavlink.vehicle import Condition, Stack
from estimator.contracts.commands import Hover, Land, Lean, TakeOff, Velocity
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from tests.make import attitude, deck, estimate, ns, status

PILOTS = GuidanceOptions(mission="targets")
OURS = GuidanceOptions(mission="targets", mode_changes=True)
THING = Reason(ReasonCause.ON_PAD, 30.0, detail="5 cm")


class Flight:
    """The mission over a pad in sight, cycle by cycle."""

    def __init__(self, options: GuidanceOptions) -> None:
        self.o, self.p, self.t = options, Progress(State.READY, automatic=False, stood=False), 1.0
        self.p, _ = take_order(self.p, Event.BEGIN, ns(1.0), options)
        self.aim: object = None

    def fly(self, seconds: float, mode: str, height_m: float = 4.0, *, seen: bool = True, **more: object) -> State:
        for _ in range(round(seconds * 10)):
            self.t += 0.1
            found = estimate(self.t, (0.0, 0.0, height_m)) if seen else None
            cycle = GuidanceCycle(ns(self.t), Knowledge(ns(self.t), found), mode=mode, **more)  # type: ignore[arg-type]
            self.p, self.aim, _ = mission_step(self.p, cycle, self.o)
        return self.p.state


@pytest.mark.parametrize("options", [PILOTS, OURS])
def test_no_state_aims_anywhere(options: GuidanceOptions) -> None:
    cycle = GuidanceCycle(ns(2.0), Knowledge(ns(2.0), estimate(2.0)), mode="land")
    for state in set(State) - GROUND:
        wanted = aim(Progress(state, automatic=False, begun=True, stood=False), cycle, options)[1]
        assert not isinstance(wanted, Target | Velocity | Lean | TakeOff), state


@pytest.mark.parametrize("mode", ["land", "auto.precland"])
def test_the_pilot_chooses_the_landing_and_ends_it(mode: str) -> None:
    flight = Flight(PILOTS)
    assert flight.fly(30.0, "loiter") is State.GATE
    assert (gate_of(flight.p).waits_for, flight.aim) == (Reason(ReasonCause.AWAITS_PILOT), Hover())
    assert flight.fly(0.2, mode) is State.DOWN
    assert flight.aim == Hover(), "what the pilot chose is not chosen again"
    assert flight.fly(0.1, mode, thing=THING) is State.GO_AROUND, "it is only said"
    assert (flight.aim, flight.fly(5.0, mode)) == (Hover(), State.DOWN)
    assert flight.fly(0.1, "loiter") is State.TAKEN


def test_where_settings_allow_it_the_landing_is_requested_and_called_off_high_up_alone() -> None:
    flight = Flight(OURS)
    assert flight.fly(1.5, "guided") is State.GATE
    assert flight.fly(2.0, "guided") is State.DOWN
    assert flight.aim == Land()
    assert flight.fly(1.0, "land", 0.5, thing=THING) is State.DOWN, "a hold over the ground is no better so low"
    assert flight.fly(0.2, "land", 3.0, thing=THING) is State.GO_AROUND
    assert flight.aim == Hover()
    assert flight.fly(10.0, "brake", thing=THING) is State.GATE, "the thing lies there still"
    assert flight.fly(1.0, "brake") is State.DOWN
    assert flight.fly(1.0, "land", seen=False) is State.DOWN
    assert flight.fly(1.5, "land", seen=False) is State.GO_AROUND
    assert flight.fly(6.0, "brake", seen=False) is State.SEARCH
    assert flight.fly(3.0, "brake") is State.DOWN
    assert flight.fly(8.0, "brake") is State.GO_AROUND, "it does not take its landing mode"
    assert flight.fly(100.0, "brake") is State.GAVE_UP


def test_the_heading_is_requested_with_our_own_landing_where_settings_want_one() -> None:
    o, found = replace(OURS, tries=replace(OURS.tries, heading="align")), estimate(2.0, yaw=0.3)
    cycle = GuidanceCycle(ns(2.0), Knowledge(ns(2.0), found), mode="land")
    down = Progress(State.DOWN, automatic=False, begun=True, stood=False)
    assert aim(down, cycle, o)[1] == Land(turn_rad=pytest.approx(-0.3))
    assert aim(down, cycle, OURS)[1] == Land()
    assert aim(replace(down, reason=Reason(ReasonCause.PILOT_LANDS)), cycle, o)[1] == Hover()


def test_an_order_to_stay_leads_nobody_down() -> None:
    flight = Flight(OURS)
    flight.p, _ = take_order(flight.p, Event.STAY, ns(1.0), OURS)
    assert flight.fly(20.0, "land") is State.GATE


@pytest.mark.parametrize(("mission", "state"), [("targets", State.SEARCH), ("cone", State.READY)])
def test_the_pilots_landing_mode_is_the_order_to_lead_it(mission: str, state: State) -> None:
    guidance = LandingGuidance(GuidanceOptions(mission=mission), PilotOptions(automatic=False))  # type: ignore[arg-type]
    guidance.on_samples((status(1.0, mode="loiter"), status(1.5, mode="land")))
    assert guidance.state is state
    guidance.on_samples((status(2.0, mode="land", taken="a failsafe"),))
    assert (guidance.state is State.TAKEN) is (mission == "targets")


def test_settings_say_what_may_leave_and_for_which_vehicle() -> None:
    assert [authority_of(o) for o in (GuidanceOptions(), OURS, PILOTS)] == list(Authority)
    with pytest.raises(BadInput, match="has none"):
        with_overrides(load("ardrone2"), ["guidance.mission=targets"], "--set")
    with pytest.raises(ValueError, match="flies nowhere"):
        GuidanceOptions(mission="targets", rendezvous=replace(PILOTS.rendezvous, enabled=True))


def view(stack: Stack, **parameters: float) -> AutopilotView:
    return AutopilotView(stack, Condition("land", True, True), (), None, MappingProxyType(parameters))


def stops_from_m_s(distance_m: float, brakes: float, jerk: float) -> float:
    """Return the speed with which PX4 flies to a target at rest, as its sources have it."""
    b = 4.0 * brakes**2 / jerk
    return 0.5 * (-b + math.sqrt(b * b + 8.0 * brakes * distance_m))


@pytest.mark.parametrize("parameters", [{}, {"MPC_ACC_HOR": 5.0, "MPC_JERK_AUTO": 20.0}])
@pytest.mark.parametrize("speed_m_s", [0.3, 1.5, 4.0])
def test_a_steady_ship_is_led_by_what_px4_stays_behind_and_not_at_all_for_arducopter(parameters, speed_m_s):
    lead = Lead(lambda now: deck(1.0, (speed_m_s, 0.0, 0.3), (0.0, 0.0, 0.0)), 1.5)
    east = Rotation.from_rpy(0.1, -0.1, math.radians(90.0))
    ahead = lead.ahead(ns(1.0), east, view(Stack.PX4, **parameters))
    by_law_m = float(ahead[1]) - PX4_LATE_S * speed_m_s
    wanted = stops_from_m_s(by_law_m, parameters.get("MPC_ACC_HOR", 3.0), parameters.get("MPC_JERK_AUTO", 4.0))
    assert wanted == pytest.approx(speed_m_s)
    assert ahead[[0, 2]] == pytest.approx(0.0)
    assert lead.ahead(ns(1.0), east, view(Stack.ARDUPILOT)) == pytest.approx(0.0)
    assert Lead(lambda now: None, 1.5).ahead(ns(1.0), east, view(Stack.PX4)) == pytest.approx(0.0)


def test_targets_leave_when_wanted_and_a_little_longer_in_the_last_metre() -> None:
    outputs = Outputs(OutputOptions(), 0.39, 0.5, lead := Lead(lambda now: None, 1.5))
    sent: list[bool] = []
    for height_m, age_s, lead.wanted in (
        (4.0, 0.1, False),
        (4.0, 0.1, True),
        (4.0, 1.0, True),
        (0.6, 1.0, True),
        (0.6, 1.6, True),
    ):
        t = 10.0 + 2.0 * len(sent)
        for k in range(8):
            outputs.track.on_attitude(attitude(t + 0.05 * k))
            outputs.track.believe(estimate(t + 0.05 * k, (0.0, 0.0, height_m)))
        now = ns(t + 0.35)
        sent.append(bool(outputs.target(now, view(Stack.ARDUPILOT), ns(t + 0.35 - age_s))))
    assert sent == [False, True, False, True, False]
    assert outputs.withheld == {"not ordered": 1, "not seen": 2}


def test_waves_are_led_by_velocity_and_acceleration() -> None:
    found, moves = [], [deck(0.0)]
    lead = Lead(lambda now: moves[-1], 1.5)
    for k in range(800):
        phase = 0.08 * k
        moves.append(deck(0.1 * k, (1.5 + 0.3 * math.sin(phase), 0.0, 0.0), (0.24 * math.cos(phase), 0.0, 0.0)))
        ahead = lead.ahead(ns(0.1 * k), Rotation.from_rpy(0.0, 0.0, 0.0), view(Stack.ARDUPILOT))
        found.append((ahead[0], moves[-1].v_level[0] - 1.5, moves[-1].a_level[0]))
    ahead, v, a = np.array(found[400:]).T
    by_v, by_a = np.linalg.lstsq(np.column_stack([v, a]), ahead, rcond=None)[0]
    assert np.abs(ahead - by_v * v - by_a * a).max() < 0.02
    assert (by_v, by_a) == pytest.approx((0.3, 0.45), abs=0.1)
