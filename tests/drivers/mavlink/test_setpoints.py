"""Holder of the vehicle, and the message that is sent in each period."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from pymavlink import mavutil

from drivers.mavlink.custody import Authority, Hand
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.setpoint import level_setpoint, velocity_setpoint
from drivers.mavlink.setpoint_streamer import SetpointStreamer
from drivers.mavlink.take_off import RestVelocity
from drivers.mavlink.vehicle import (
    COPTER_MODES,
    PLANE_MODES,
    PX4_MODES,
    Condition,
    Identity,
    Stack,
    custom_mode,
    is_autopilot,
    mode_name,
    set_mode,
    stack_of,
)
from estimator.contracts.commands import Command, CutMotors, Hover, Land, LandingPlace, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.geometry import F64, GeoPoint, Rotation, moved
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from tests.make import tuned

GO = Velocity(np.array([0.5, -0.25, 0.125]), 0.3)


def ms(t: float) -> MonoNs:
    return MonoNs(50_000_000_000 + round(t * 1_000_000))


class Flight:
    """A streamer in virtual time: `periods` with a nose to the east, `sends` with one to the north."""

    def __init__(
        self, stack: Stack = Stack.ARDUPILOT, mode: str = "loiter", authority: Authority = Authority.SETPOINTS, **options: object
    ) -> None:
        all_options = tuned(AutopilotOptions, links="udpin://127.0.0.1:0", **options)
        self.streamer = SetpointStreamer(Identity(7, 1, stack, 2), all_options, authority)
        self.now = ms(0)
        self.mode = mode
        self.requests: list[int] = []
        """Numbers of the commands that ask for a mode and have no answer."""
        self.told()

    def told(self, mode: str | None = None, *, flying: bool | None = True, armed: bool | None = True) -> None:
        self.mode = mode or self.mode
        self.streamer.on_condition(Condition(self.mode, armed, flying))

    def obeys(self, mode: str) -> None:
        """Report a mode as one that was requested, and then accept the requests as ArduPilot does."""
        self.told(mode)
        for number in self.requests:
            self.streamer.on_answer(number, accepted=True)
        self.requests = []

    def sent(self, at: MonoNs) -> list[Message]:
        """Return the messages of the period at that time."""
        out = self.streamer.period(at)
        asks = (mav.MAV_CMD_DO_SET_MODE, mav.MAV_CMD_DO_REPOSITION)
        self.requests += [m.command for m in out if m.get_type().startswith("COMMAND") and m.command in asks]
        return out

    def sees(self, yaw_rad: float, at: MonoNs) -> None:
        stamp = Stamp(at, at, 0.001, "synced")
        self.streamer.on_attitude(Attitude(stamp, Rotation.from_rpy(0.0, 0.0, yaw_rad), 1e-4 * np.eye(3)))

    def take(self, command: Command, t: float, way: F64 | None = None) -> None:
        self.streamer.take(command, ms(t), way)

    def sends(self, t: float) -> tuple[list[tuple[float, float, float, float]], list[tuple[float, float]]]:
        """Return the velocities and modes of one period."""
        self.sees(0.0, ms(t))
        return said(self.sent(ms(t)))

    def periods(self, seconds: float, command: Command | None = None, *, seen: bool = True) -> list[Message]:
        """Return every message of that long at 25 Hz, the command repeated in each period."""
        out: list[Message] = []
        for _ in range(round(seconds * 25)):
            self.now = MonoNs(self.now + 40_000_000)
            if seen:
                self.sees(math.radians(90.0), self.now)
            if command is not None:
                self.streamer.take(command, self.now)
            out += self.sent(self.now)
        return out


def modes(messages: list[Message]) -> list[tuple[float, float]]:
    return [(m.param2, m.param3) for m in messages if m.get_type() == "COMMAND_LONG" and m.command == mav.MAV_CMD_DO_SET_MODE]


def velocities(messages: list[Message]) -> list[tuple[float, float, float, float]]:
    return [(m.vx, m.vy, m.vz, m.yaw_rate) for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]


@pytest.mark.parametrize("yaw_deg", range(-135, 181, 45))
def test_a_setpoint_says_in_north_and_east_what_was_meant_in_forward_and_right(yaw_deg: int) -> None:
    """A tilt is a velocity with its acceleration: the autopilot cancels the wind, and sent the trim it would cancel it twice."""
    yaw = math.radians(yaw_deg)

    def seen_from_its_nose(north: float, east: float) -> tuple[float, float]:
        return math.cos(yaw) * north + math.sin(yaw) * east, -math.sin(yaw) * north + math.cos(yaw) * east

    plain = velocity_setpoint(2**32 + 5, (7, 1), GO, yaw)
    lean = Lean(np.array([0.6, -0.4]), np.array([9.0, 7.0]), GO.v_level, 0.3)
    fed = velocity_setpoint(0, (7, 1), lean, yaw)
    assert (plain.coordinate_frame, plain.type_mask, plain.time_boot_ms) == (1, 0x05C7, 5)
    assert {n for n in range(12) if fed.type_mask >> n & 1} == {0, 1, 2, 10}
    for m in (plain, fed):
        assert (m.target_system, m.target_component, m.yaw_rate) == (7, 1, 0.3)
        assert (*seen_from_its_nose(m.vx, m.vy), m.vz) == pytest.approx((0.5, -0.25, 0.125))
    assert (*seen_from_its_nose(fed.afx, fed.afy), fed.afz) == pytest.approx((0.6, -0.4, 0.0))
    with pytest.raises(ValueError, match="finite"):
        velocity_setpoint(0, (7, 1), GO, math.nan)


def test_every_mode_has_one_name_and_one_number() -> None:
    for number, name in COPTER_MODES.items():
        assert mode_name(Stack.ARDUPILOT, number) == name
        assert custom_mode(Stack.ARDUPILOT, name) == number
    for (main, sub), name in PX4_MODES.items():
        assert mode_name(Stack.PX4, main << 16 | sub << 24) == name
        assert custom_mode(Stack.PX4, name) == main << 16 | sub << 24
    m = set_mode(Stack.PX4, (7, 1), "auto.precland")
    assert (m.param1, m.param2, m.param3) == (1, 4, 9)
    m = set_mode(Stack.ARDUPILOT, (7, 1), "land")
    assert (m.param1, m.param2, m.param3) == (1, 9, 0)
    autopilot = AutopilotOptions("udpin://127.0.0.1:14550")
    assert (autopilot.modes_left("guided"), autopilot.modes_left("offboard")) == (("guided",), ("offboard", "auto.loiter"))


def test_a_quadplane_is_no_copter_whatever_its_heartbeat_calls_it() -> None:
    """Copter's numbers would put it into ACRO (4) and QSTABILIZE (17)."""
    theirs = mavutil.mode_mapping_bynumber(1)
    assert all(name.replace("_", "") == theirs[n].lower().replace("_", "") for n, name in PLANE_MODES.items())
    for kind in (1, *range(19, 26)):
        beat = mav.MAVLink_heartbeat_message(kind, 3, 0, 15, 4, 3)
        assert (stack_of(beat), is_autopilot(beat, 1)) == (Stack.PLANE, True)
        px4 = mav.MAVLink_heartbeat_message(kind, 12, 0, 0, 4, 3)
        assert (stack_of(px4), is_autopilot(px4, 1)) == (Stack.PX4, kind != 1), "PX4's fixed wing does not hover"
    assert stack_of(mav.MAVLink_heartbeat_message(2, 3, 0, 4, 4, 3)) is Stack.ARDUPILOT
    flight = Flight(Stack.PLANE, "qloiter")
    assert modes(flight.periods(0.5, GO)) == [(15, 0)]
    flight.told("guided")
    assert said(flight.streamer.leave(ms(2000)))[1] == [], "GUIDED holds by itself; QLOITER descends where no stick holds it"
    landing = Flight(Stack.PLANE, "guided")
    landing.periods(0.5, GO)
    assert modes(landing.periods(1.0, Land())) == [], "it lands by velocity: QLAND would come down where it is"
    deck = Flight(Stack.PLANE, "qloiter")
    deck.told(flying=False, armed=False)
    assert deck.periods(2.0, TakeOff()) == [], "its pilot takes off"


def test_ardupilot_is_taken_into_guided_by_the_first_velocity() -> None:
    flight = Flight(Stack.ARDUPILOT)
    sent = flight.periods(0.5, GO)
    assert modes(sent) == [(4, 0)], "asked once, not in every period"
    assert flight.streamer.hand is Hand.TAKING
    flight.told("guided")
    sent = flight.periods(1.0, GO)
    assert modes(sent) == []
    # The nose points east: forward is east, left is north
    assert velocities(sent)[0] == pytest.approx((0.25, 0.5, 0.125, 0.3))
    assert len(velocities(sent)) == 25
    assert flight.streamer.hand is Hand.OURS


def test_a_mode_that_does_not_come_is_requested_a_few_times_and_then_left() -> None:
    flight = Flight(Stack.ARDUPILOT, request_tries=3)
    assert len(modes(flight.periods(8.0, GO))) == 3
    assert flight.streamer.hand is Hand.PERSON
    assert flight.periods(1.0, GO) == []


def test_an_order_to_begin_takes_the_vehicle_in_flight_alone_and_a_mode_chosen_after_it_stands() -> None:
    flight = Flight(Stack.ARDUPILOT)
    for flying in (False, None, True):
        flight.told("poshold", flying=flying)
        flight.streamer.engage()
        assert modes(flight.periods(1.0, Hover())) == ([(4, 0)] if flying else []), "a hover of guidance's own takes no mode"
    flight.told("rtl")
    assert flight.periods(2.0, GO) == []
    flight.streamer.engage()
    assert modes(flight.periods(0.2, GO)) == [(4, 0)]


def test_a_station_s_velocity_mode_is_an_order_by_setting_alone() -> None:
    for option in (False, True):
        flight = Flight(Stack.ARDUPILOT, "guided", mode_is_order=option)
        flight.periods(0.2, GO)
        for mode in ("guided", "poshold", "guided"):
            flight.told(mode)
        assert flight.streamer.hand is (Hand.OURS if option else Hand.PERSON), "a station chooses it for its own fly here"


@pytest.mark.parametrize(("stack", "ours", "back", "number"), [
    (Stack.ARDUPILOT, "guided", "rtl", (6, 0)), (Stack.PX4, "offboard", "auto.rtl", (4, 5)),
])  # fmt: skip
def test_a_return_is_the_autopilots_own_and_a_velocity_takes_it_back(stack, ours, back, number):
    flight = Flight(stack, ours)
    assert flight.periods(1.0, Hover(returns=True)) == [], "not ours yet"
    flight.periods(3.0, GO)
    flight.told(ours)
    assert modes(flight.periods(0.5, Hover(returns=True))) == [number]
    flight.obeys(back)
    assert flight.periods(3.0, Hover(returns=True)) == []
    flight.periods(0.04, GO)
    assert flight.streamer.hand is Hand.TAKING


@pytest.mark.parametrize(("stack", "ours", "way", "land"), [
    (Stack.ARDUPILOT, "guided", "guided", (9, 0)), (Stack.PX4, "offboard", "auto.loiter", (4, 6)),
])  # fmt: skip
def test_another_place_is_flown_to_by_the_autopilot_and_landed_at_only_there(stack, ours, way, land):
    there = GeoPoint.of_degrees(63.44, 10.4, 30.0)
    leaves = Hover(elsewhere=LandingPlace(there, 1000.0))

    def asked(seconds: float, north_m: float | None, command: Hover = leaves) -> list[Message]:
        out = []
        for _ in range(round(5 * seconds)):
            if north_m is not None:
                flight.streamer.on_place(moved(replace(there, height_m=12.0), np.array([north_m, 0.0, 0.0])), flight.now)
            out += flight.periods(0.2, command)
        return out

    flight = Flight(stack, ours)
    flight.periods(3.0, GO)
    flight.told(ours)
    for north_m in (None, 1100.0):
        assert {m.get_type() for m in asked(1.0, north_m)} == {"SET_POSITION_TARGET_LOCAL_NED"}, "no place, or too far: it holds"
    first = asked(0.2, 400.0)
    (sent,) = [m for m in first if m.get_type() == "COMMAND_INT"]
    assert (sent.command, sent.x, sent.y, sent.z, sent.frame) == (mav.MAV_CMD_DO_REPOSITION, 634400000, 104000000, 30.0, 0)
    assert flight.streamer.hand is Hand.LEAVING
    flight.obeys(way)
    assert velocities(asked(3.0, 200.0)) == [] == modes(asked(3.0, 5.0)), "a setpoint would end the way, and nobody lands on it"
    flight.told("land" if stack is Stack.ARDUPILOT else "auto.land")
    assert flight.streamer.hand is Hand.PERSON, "a person landed it on the way"
    flight.streamer.engage()
    for mode, velocity in ((ours, GO), (way, leaves)):
        flight.periods(3.0, velocity)
        flight.obeys(ours)
        asked(0.4, 200.0)
        flight.obeys(mode)
        flight.told()
    assert modes(asked(0.4, 2.0)) == [land]
    flight.obeys("land" if stack is Stack.ARDUPILOT else "auto.land")
    assert asked(2.0, 0.0) == []
    assert modes(flight.periods(2.2, Hover())) != [], "an order to hold takes it back"


@pytest.mark.parametrize(("down", "flown"), [(0.125, 0.0), (-0.5, -0.5)])
def test_without_a_heading_it_holds_over_the_deck_or_climbs_and_never_descends(down: float, flown: float) -> None:
    """WHY: an autopilot that receives nothing flies on with its last setpoint, ArduCopter for 3 s: most of a metre down."""
    flight = Flight(Stack.ARDUPILOT, "guided")
    flight.periods(0.2, GO)
    flight.told("guided")
    flight.periods(0.6, GO, seen=False)
    command, v_deck = Velocity(np.array([0.5, -0.25, down]), 0.3), np.array([0.8, 0.1, 0.2])
    for _ in range(25):
        flight.now = MonoNs(flight.now + 40_000_000)
        flight.streamer.take(command, flight.now, v_deck)
        ((north, east, below, yaw_rate),) = velocities(flight.streamer.period(flight.now))
        # The nose was to the east: forward is east, right is south.
        assert (north, east, below, yaw_rate) == pytest.approx((-0.1, 0.8, flown, 0.0))


def test_without_a_heading_a_vehicle_is_not_taken() -> None:
    flight = Flight(Stack.ARDUPILOT)
    assert flight.periods(1.0, GO, seen=False) == []
    flight.periods(0.04, GO)
    flight.periods(0.6, GO, seen=False)
    assert velocities(flight.periods(1.0, GO, seen=False)) == []


def over_a_deck(stack: Stack = Stack.PX4, **options: object) -> Flight:
    """Steered onto a deck that makes 1.5 m/s to the nose's right, with 0.2 m/s of correction on top."""
    flight = Flight(stack, "loiter" if stack is Stack.ARDUPILOT else "auto.loiter", **options)
    way = np.array([0.0, 1.5, 0.3])
    for _ in range(63):
        flight.streamer.take(Velocity(np.array([0.2, 1.5, 0.3]), 0.0), flight.now, way)
        flight.periods(0.04)
    flight.told("guided" if stack is Stack.ARDUPILOT else "offboard")
    flight.streamer.take(Velocity(np.array([0.2, 1.5, 0.3]), 0.0), flight.now, way)
    return flight


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_silent_guidance_is_flown_as_a_hold_with_the_deck_then_over_the_ground_then_not_at_all(stack: Stack) -> None:
    """Forward is east and right is south in these flights."""
    flight = over_a_deck(stack)
    sent = flight.periods(12.0)
    v = velocities(sent)
    assert v[0] == pytest.approx((-1.5, 0.2, 0.3, 0.0))
    assert v[10] == pytest.approx((-1.5, 0.0, 0.0, 0.0)), "the ship's way, without heave and corrections"
    assert v[80] == (0.0, 0.0, 0.0, 0.0)
    assert all(vz <= 0.0 for _, _, vz, _ in v[7:])
    assert set(modes(sent)) == {(4, 3) if stack is Stack.PX4 else (17, 0)}
    assert len(v) < 12 * 25, "the stream ends, so that the autopilot's own failsafe can act"
    assert flight.periods(1.0) == []
    flight.obeys("auto.loiter" if stack is Stack.PX4 else "brake")
    assert flight.periods(1.0, GO) == [], "a person's hold would read the same"
    flight.streamer.engage()
    assert velocities(flight.periods(0.2, GO)), "an order takes it back"


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_guidance_that_is_back_is_heard_until_the_autopilot_holds_by_itself(stack: Stack) -> None:
    flight = over_a_deck(stack)
    assert modes(flight.periods(6.2)) == [LOITER if stack is Stack.PX4 else BRAKE]
    assert flight.streamer.hand is Hand.HOLDING
    assert velocities(flight.periods(0.2, GO))
    assert flight.streamer.hand is Hand.TAKING
    silent = over_a_deck(stack)
    silent.periods(6.2)
    silent.obeys("auto.loiter" if stack is Stack.PX4 else "brake")
    assert silent.periods(1.0) == silent.periods(1.0, GO) == []
    assert silent.streamer.hand is Hand.PERSON


@pytest.mark.parametrize("known_late", [False, True])
def test_taking_off_step_by_step(known_late: bool) -> None:
    flight = Flight(Stack.ARDUPILOT, "stabilize")
    flight.streamer.on_condition(Condition("stabilize", False, False))
    if not known_late:
        flight.streamer.on_position(0.0)
    flight.streamer.take(TakeOff(), flight.now)
    flight.streamer.on_position(0.0)
    assert modes(flight.periods(0.2)) == [(4, 0)]
    flight.streamer.on_condition(Condition("guided", False, False))
    (arm,) = flight.periods(1.0)
    assert (arm.command, arm.param1) == (400, 1.0)
    flight.streamer.on_condition(Condition("guided", True, False))
    (up,) = flight.periods(1.0)
    assert (up.command, up.param7) == (22, 3.0)
    flight.streamer.on_condition(Condition("guided", True, True))
    assert flight.periods(2.0) == [], "its own take-off lifts it off the deck"
    flight.streamer.on_position(-0.5)
    assert velocities(flight.periods(0.04)) == [(0.0, 0.0, -1.0, 0.0)]
    flight.streamer.on_position(-3.1)
    flight.periods(0.04)
    assert flight.streamer.hand is Hand.OURS
    assert velocities(flight.periods(0.04)) == [(0.0, 0.0, 0.0, 0.0)]


def test_a_take_off_without_a_height_lasts_as_long_as_the_climb() -> None:
    """WHY: it was done as soon as it flew, and a drone hung .13 m over the deck."""
    flight = Flight(Stack.ARDUPILOT, "guided")
    flight.streamer.on_condition(Condition("guided", False, False))
    flight.streamer.take(TakeOff(), flight.now)
    flight.periods(0.4)
    for flying in (False, True):
        flight.streamer.on_condition(Condition("guided", True, flying))
        flight.periods(0.2)
    flight.periods(2.5)
    assert flight.streamer.hand is Hand.TAKING_OFF
    flight.periods(0.6)
    assert flight.streamer.hand is Hand.OURS


def test_the_way_of_a_deck_is_the_mean_over_its_waves_and_since_the_filter_knew_it() -> None:
    """WHY: PX4's filter said 0 for a second before GNSS; half of the ship's way was kept, and she left a drone that searched."""
    rest, gone = RestVelocity(), MonoNs(0)
    for k in range(1000):
        now = MonoNs(20_000_000 * k)
        surge = 0.4 * math.sin(math.tau * k / 300)
        rest.on_velocity(np.array([0.0 if k < 500 else 1.5 + surge, 0.0, surge]), np.array([k, 0.0, 0.0]), now, stands=k < 900)
        gone = now if k < 900 else gone
    assert rest.newest.at == gone
    assert rest.newest.p_ned[0] == 899
    assert rest.newest.v_ned == pytest.approx([1.5, 0.0, 0.0], abs=0.15)


def test_px4_is_taken_off_a_ship_under_way_by_setpoints_that_go_with_her() -> None:
    """Its own take-off mode holds over the ground while the rotors spool up, and turns over on a deck that sails on."""
    flight = Flight(Stack.PX4, "auto.loiter")
    flight.streamer.on_condition(Condition("auto.loiter", False, False))
    for k in range(400):
        flight.streamer.on_velocity(
            np.array([1.5, 0.2 * math.sin(0.1 * k), 0.4]), np.zeros(3), MonoNs(flight.now + 20_000_000 * k)
        )
    flight.streamer.on_position(-4.0)
    flight.streamer.take(TakeOff(), flight.now)
    early = flight.periods(1.9)
    assert modes(early) == []
    along = [(m.vx, m.vz) for m in early]
    assert along == [(pytest.approx(1.5, abs=0.01), 0.0)] * len(along)
    assert modes(flight.periods(0.3)) == [(6, 0)]
    flight.streamer.on_condition(Condition("offboard", False, False))
    armed = [m for m in flight.periods(1.0) if m.get_type() == "COMMAND_LONG"]
    assert [(m.command, m.param1, m.param2) for m in armed] == [(400, 1.0, 0.0)]
    flight.streamer.on_condition(Condition("offboard", True, False))
    assert {v[2] for v in velocities(flight.periods(0.5))} == {-1.0}
    assert all(m.get_type() == "SET_POSITION_TARGET_LOCAL_NED" for m in flight.periods(4.0)), "and no MAV_CMD_NAV_TAKEOFF"
    flight.streamer.on_condition(Condition("offboard", True, True))
    flight.streamer.on_position(-7.0)
    flight.periods(0.04)
    ((north, _, down, _),) = velocities(flight.periods(0.04))
    assert (north, down) == (pytest.approx(1.5, abs=0.01), 0.0), "and it stays over the deck"


ON_DECK = Land(on_deck=True)


def stops(messages: list[Message]) -> list[tuple[float, float]]:
    return [(m.param1, m.param2) for m in messages if m.get_type() == "COMMAND_LONG" and m.command == 400]


@pytest.mark.parametrize(("stack", "mode"), [(Stack.ARDUPILOT, "guided"), (Stack.PX4, "offboard")])
def test_motors_stop_by_force_once_the_deck_was_felt_and_the_stream_outlives_them(stack: Stack, mode: str) -> None:
    flight = Flight(stack, mode)
    flight.periods(0.2, GO)
    flight.told(mode)
    sent = flight.periods(0.04, ON_DECK)
    assert stops(sent) == [(0.0, 21196.0)], "at once"
    assert velocities(sent)[0][2] > 0.0, "it presses on the deck meanwhile"
    assert len(stops(flight.periods(1.0, ON_DECK))) == 5, "an answer that is lost costs a fifth of a second"
    flight.streamer.on_condition(Condition(mode, False, True))
    outlived = flight.periods(0.4)
    assert len(velocities(outlived)) == 10
    assert stops(outlived) == []
    flight.streamer.on_condition(Condition(mode, False, False))
    assert velocities(flight.periods(0.4))[1:] == [] or flight.streamer.hand is Hand.NOBODY
    assert flight.streamer.hand is Hand.NOBODY
    assert flight.periods(1.0) == []


def test_motors_stop_by_force_only_by_setting_and_only_while_guidance_reports_it() -> None:
    gentle = Flight(Stack.PX4, "offboard", disarm_on_contact=False)
    gentle.periods(0.2, GO)
    assert set(stops(gentle.periods(1.0, ON_DECK))) == {(0.0, 0.0)}
    silent = Flight(Stack.PX4, "offboard")
    silent.periods(0.2, GO)
    silent.periods(0.2, ON_DECK)
    assert set(stops(silent.periods(3.0))[2:]) == {(0.0, 0.0)}, "a service that stalls forces nothing"
    assert velocities(silent.periods(0.2)), "and an armed vehicle on deck keeps its setpoints"


def test_a_go_around_takes_back_a_vehicle_whose_motors_did_not_stop() -> None:
    flight = Flight(Stack.PX4, "offboard")
    flight.periods(0.2, GO)
    flight.periods(1.0, ON_DECK)
    flight.periods(0.04, GO)
    flight.told("offboard")
    sent = flight.periods(0.2, GO)
    assert flight.streamer.hand is Hand.OURS
    assert stops(sent) == []


def test_a_vehicle_that_stands_after_a_landing_is_commanded_to_disarm_and_never_left_armed_in_a_hold() -> None:
    flight = Flight(Stack.PX4, "offboard")
    flight.periods(0.2, GO)
    flight.told("offboard")
    flight.periods(0.2, Land())
    flight.told(flying=False)
    sent = flight.periods(8.0)
    assert modes(sent) == [], "no AUTO.LOITER on a deck"
    assert set(stops(sent)) == {(0.0, 0.0)}
    assert len(velocities(sent)) == 200
    flight.streamer.on_condition(Condition("offboard", False, False))
    flight.periods(0.6)
    assert flight.periods(1.0) == []


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_a_vehicle_that_guidance_leaves_standing_is_disarmed_and_one_that_it_steers_or_that_flies_is_not(stack: Stack) -> None:
    """WHY: a service was killed as it stood, and the next one left its motors turning for seven seconds (weather_3, 903071)."""
    for flying, command, stopped in ((False, None, True), (True, None, False), (False, GO, False)):
        flight, sent = over_a_deck(stack), []
        for _ in range(20):
            flight.told(flying=flying)
            sent += flight.periods(0.1, command)
        assert (set(stops(sent)) == {(0.0, 0.0)}) is stopped


GUIDED, LAND, BRAKE = (4, 0), (9, 0), (17, 0)
LOITER, AUTO_LAND = (4, 3), (4, 6)


def said(messages: list[Message]) -> tuple[list[tuple[float, float, float, float]], list[tuple[float, float]]]:
    return velocities(messages), modes(messages)


STILL = (0.0, 0.0, 0.0, 0.0)


def ours(stack: Stack = Stack.ARDUPILOT, way: F64 | None = None, **options: object) -> Flight:
    """Steered since 0 ms and in the velocity mode."""
    flight = Flight(stack, "loiter" if stack is Stack.ARDUPILOT else "offboard", **options)
    flight.take(GO, 0, way)
    flight.sends(0)
    flight.told("guided" if stack is Stack.ARDUPILOT else "offboard")
    assert flight.streamer.hand is Hand.OURS
    return flight


@pytest.mark.parametrize(("flying", "hand"), [(True, Hand.TAKING), (None, Hand.TAKING), (False, Hand.NOBODY)])
def test_it_takes_no_vehicle_that_stands(flying: bool | None, hand: Hand) -> None:
    flight = Flight()
    flight.told("loiter", flying=flying)
    flight.take(GO, 0)
    assert flight.streamer.hand is hand
    other = Flight(Stack.OTHER)
    other.take(GO, 0)
    assert other.streamer.hand is Hand.NOBODY, "nor one whose velocity mode is not known"


def sinking(t: float = 0, **options: object) -> Flight:
    """Return a landing by velocity since `t`, over a deck that makes 1 m/s ahead, two metres below its origin's height."""
    flight = Flight(Stack.PX4, "offboard", **options)
    flight.take(Velocity(np.array([1.0, 0.5, 0.25]), 0.1), t)
    flight.told("offboard")
    flight.streamer.on_position(-2.0)
    flight.take(Land(), t)
    return flight


DOWN, LEVEL = (1.0, 0.5, 0.4, 0.0), (1.0, 0.5, 0.0, 0.0)


def test_a_landing_by_velocity_sinks_while_it_is_requested_then_holds_then_ends() -> None:
    flight = sinking()
    said_at = [flight.sends(t) for t in (0, 500, 500.001, 600, 3000, 3000.001, 6000, 6000.001)]
    assert said_at == [([v], []) for v in (DOWN, DOWN, LEVEL, LEVEL, LEVEL, STILL, STILL)] + [([STILL], [LOITER])]
    assert flight.streamer.hand is Hand.HOLDING


def test_a_landing_by_velocity_ends_by_its_time() -> None:
    flight = sinking()
    for t in range(400, 15_001, 400):
        flight.take(Land(), t)
        assert flight.sends(t)[0] == [DOWN]
    flight.take(Land(), 15_000)
    assert flight.sends(15_000)[0] == [DOWN]
    assert flight.sends(15_000.001)[0] == [LEVEL]
    flight.take(Land(), 15_100)
    assert flight.sends(15_100)[0] == [LEVEL], "though it is asked for"
    flight.take(Hover(), 15_200)
    assert flight.streamer.hand is Hand.TAKING
    flight.told("offboard")
    flight.take(Land(), 15_300)
    assert flight.sends(15_300)[0] == [DOWN], "another one is another one"


def test_a_landing_by_mode_is_called_off_when_it_is_not_renewed() -> None:
    flight = ours()
    flight.obeys("guided")
    flight.take(Land(), 100)
    assert flight.sends(100) == ([], [LAND])
    flight.obeys("land")
    assert flight.sends(600) == ([], [])
    assert flight.sends(600.001) == ([STILL], [GUIDED])
    assert flight.streamer.hand is Hand.TAKING


def test_a_landing_by_mode_that_had_to_be_requested_again_is_a_persons() -> None:
    flight = ours()
    for t in (100, 600, 1099, 1100):
        flight.take(Land(), t)
        assert flight.sends(t) == ([], [LAND] if t in (100, 1100) else [])
    flight.obeys("land")
    assert flight.streamer.hand is Hand.PERSON
    assert flight.sends(1600.001) == ([], [])


@pytest.mark.parametrize(
    ("stack", "landing", "lands_by_velocity"),
    [
        (Stack.PX4, "by stack", True), (Stack.ARDUPILOT, "by stack", False), (Stack.PX4, "mode", False),
        (Stack.ARDUPILOT, "velocity", True), (Stack.PX4, "velocity", True),
    ],
)  # fmt: skip
def test_how_it_lands_is_chosen_by_option_or_stack(stack: Stack, landing: str, lands_by_velocity: bool) -> None:
    flight = ours(stack, landing=landing)
    flight.take(Land(), 100)
    v, modes = flight.sends(100)
    assert (bool(v), bool(modes)) == (lands_by_velocity, not lands_by_velocity)
    other = Flight(stack, "stabilize", landing=landing)
    other.take(Land(), 100)
    assert other.sends(100)[1] == [LAND if stack is Stack.ARDUPILOT else AUTO_LAND], "out of another mode always by its own"


@pytest.mark.parametrize(("landing", "expected"), [("mode", ([STILL], [BRAKE])), ("velocity", ([STILL], []))])
def test_the_last_word_of_a_landing_nobody_renews_is_to_hold(landing: str, expected: object) -> None:
    flight = ours(landing=landing)
    flight.take(Land(), 100)
    flight.sends(100)
    assert said(flight.streamer.leave(ms(110))) == expected
    person = ours(landing=landing)
    person.take(Land(here=True), 100)
    person.sends(100)
    goes_on = landing == "mode"
    assert said(person.streamer.leave(ms(110))) == (([], []) if goes_on else expected)
    assert (person.streamer.suspend(ms(111)) == []) is goes_on


def test_the_last_word_is_to_stand_still_where_the_vehicle_is_ours() -> None:
    assert said(ours().streamer.leave(ms(10))) == ([STILL], [])
    assert said(ours(Stack.PX4).streamer.leave(ms(10))) == ([STILL], [LOITER])
    released = ours()
    released.told("loiter")
    assert released.streamer.leave(ms(10)) == []
    taking = Flight()
    taking.take(GO, 0)
    taking.sends(0)
    assert said(taking.streamer.leave(ms(10))) == ([STILL], [])


# A landing by mode, on deck, the motors, and a person during a take-off


def standing(armed: bool | None = True) -> Flight:
    """Return a streamer on the deck after a landing with a felt contact, at 1000 ms."""
    flight = sinking(900)
    flight.take(Land(on_deck=True), 1000)
    flight.told("offboard", armed=armed)
    assert flight.streamer.hand is Hand.STANDING
    return flight


FORCED, ASKED = (0.0, 21196.0), (0.0, 0.0)


@pytest.mark.parametrize(("stack", "by_attitude"), [(Stack.ARDUPILOT, True), (Stack.PX4, False)])
def test_arducopter_comes_to_stand_on_a_deck_by_an_attitude_and_flies_on_by_velocities(stack: Stack, by_attitude: bool) -> None:
    flight = ours(stack)
    press = Lean(np.zeros(2), np.zeros(2), np.array([1.0, 0.0, 1.0]), 0.6)
    kinds = []
    for k, command in enumerate((press, replace(press, on_deck_turn_rad=0.1), GO)):
        flight.take(command, 1000 + 40 * k)
        flight.sees(2.0, ms(1000 + 40 * k))
        kinds += [m.get_type() for m in flight.streamer.period(ms(1000 + 40 * k)) if m.get_type().startswith("SET_")]
    velocity = "SET_POSITION_TARGET_LOCAL_NED"
    assert kinds == [velocity, "SET_ATTITUDE_TARGET" if by_attitude else velocity, velocity]


@given(roll=st.floats(-0.6, 0.6), pitch=st.floats(-0.6, 0.6), yaw=st.floats(-3.0, 3.0), turn=st.floats(-0.25, 0.25))
def test_an_attitude_on_deck_leans_a_little_to_the_other_side_turns_to_the_heading_and_descends(roll, pitch, yaw, turn):
    """A thrust below one half descends, whether it is read as a climb or as a thrust."""
    m = level_setpoint(2**32 + 5, (7, 1), (roll, pitch, yaw), turn, 6.0 * turn)
    other_roll, other_pitch, heading = Rotation.from_quat(np.array(m.q)).rpy_rad
    assert (m.time_boot_ms, m.target_system, m.target_component, m.type_mask) == (5, 7, 1, 0)
    assert (m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate) == pytest.approx((0.0, 0.0, 6.0 * turn))
    assert math.remainder(heading - yaw - turn, math.tau) == pytest.approx(0.0, abs=1e-6)
    assert other_roll * roll <= 1e-9
    assert other_pitch * pitch <= 1e-9
    assert other_roll * pitch == pytest.approx(other_pitch * roll, abs=1e-6), "in the plane of its lean"
    assert math.hypot(other_roll, other_pitch) < 0.15
    assert 0.0 < m.thrust < 0.5


@pytest.mark.parametrize(
    ("armed", "t", "last"), [(True, 1100, [FORCED]), (None, 1100, [FORCED]), (True, 1300, [ASKED]), (False, 1100, [])]
)
def test_the_last_word_on_deck_is_to_stop_the_motors_that_still_turn(armed: bool | None, t: float, last: list[object]) -> None:
    assert stops(standing(armed).streamer.leave(ms(t))) == last


def test_a_cut_waits_for_no_other_request_and_is_repeated_until_it_is_reported() -> None:
    for before, t in ((Land(), 100), (Land(on_deck=True), 101)):
        flight = ours()
        flight.take(before, t)
        flight.sends(t)
        flight.take(CutMotors(), t + 1)
        assert stops(flight.streamer.period(ms(t + 1))) == [FORCED]
    sent = 0
    for t in range(200, 20_000, 100):
        flight.take(Land(here=True), t)
        flight.take(TakeOff(), t)
        sent += len(stops(flight.streamer.period(ms(t))))
    assert sent > 30
    flight.told("guided", flying=False, armed=False)
    assert flight.streamer.motors_cut
    flight.take(TakeOff(), 20_000)
    assert flight.streamer.period(ms(20_000)) == [] == flight.streamer.leave(ms(20_000))
    flight.take(LeaveEmergency(), 20_100)
    flight.take(TakeOff(), 20_200)
    assert stops(flight.streamer.period(ms(20_200))) == [(1.0, 0.0)]


def test_a_report_from_before_the_cut_ends_no_cut() -> None:
    """The motors were commanded to arm, and the newest HEARTBEAT knows nothing of it."""
    flight = Flight(mode="guided")
    flight.told("guided", flying=False, armed=False)
    flight.take(TakeOff(), 0)
    assert stops(flight.streamer.period(ms(0))) == [(1.0, 0.0)]
    flight.take(CutMotors(), 40)
    for t in (40, 240, 440):
        assert stops(flight.streamer.period(ms(t))) == [FORCED]
        flight.told("guided", flying=False, armed=False)
    flight.streamer.period(ms(640))
    flight.told("guided", flying=False, armed=False)
    assert stops(flight.streamer.period(ms(840))) == []


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_what_was_flown_is_held_once_when_it_is_unclear_who_is_the_autopilot(stack: Stack) -> None:
    flight = ours(stack)
    held = said(flight.streamer.suspend(ms(40)))
    assert held == ([STILL], [LOITER] if stack is Stack.PX4 else [])
    assert flight.streamer.hand is Hand.HOLDING
    flight.take(GO, 80)
    assert flight.streamer.hand is Hand.TAKING, "guidance has it again when it is clear"
    taken = ours(stack)
    taken.told("poshold" if stack is Stack.ARDUPILOT else "posctl")
    assert taken.streamer.suspend(ms(40)) == []


LEDS = [(Stack.ARDUPILOT, "land", "brake"), (Stack.PX4, "auto.precland", "auto.loiter")]


@pytest.mark.parametrize(("stack", "lands", "holds"), LEDS)
def test_where_modes_alone_may_leave_no_setpoint_does_and_the_landing_ends_in_the_autopilots_hold(stack, lands, holds):
    flight = Flight(stack, authority=Authority.MODES, landing="velocity", mode_is_order=True)
    assert flight.periods(1.0, GO) + flight.periods(1.0, TakeOff()) + flight.periods(1.0, Hover()) == []
    assert asked(flight.periods(0.1, Land()), stack) == {lands}
    flight.obeys(lands)
    assert flight.periods(3.0, Land()) + flight.periods(0.4, GO) == [], "the other orders change nothing"
    turns = flight.periods(1.5, Land(turn_rad=math.radians(20.0)))
    assert [(m.command, round(m.param1), m.param4) for m in turns] == [(115, 110, 0)] * (2 if stack is Stack.ARDUPILOT else 0)
    assert asked(flight.periods(0.1, Hover()), stack) == {holds}
    flight.obeys(holds)
    assert flight.periods(20.0, Hover()) == []
    assert asked(flight.periods(0.1, Land()), stack) == {lands}
    flight.obeys(lands)
    assert asked(flight.periods(1.0), stack) == {holds}, "a landing that guidance does not renew is called off"


@pytest.mark.parametrize(("stack", "lands", "holds"), LEDS)
def test_a_pilots_own_mode_is_never_touched(stack: Stack, lands: str, holds: str) -> None:
    flight = Flight(stack, authority=Authority.MODES, mode_is_order=True)
    flight.told(lands)
    assert flight.periods(3.0, Hover()) == [], "the pilot lands: that is not called off"
    flight.told("loiter" if stack is Stack.ARDUPILOT else "posctl")
    flight.periods(0.1, Land())
    flight.told(lands)
    for other in ("stabilize" if stack is Stack.ARDUPILOT else "manual", lands, holds):
        flight.told(other)
        assert flight.streamer.hand is Hand.PERSON
        assert flight.periods(2.0, Hover()) + flight.periods(2.0, Land()) == []


@pytest.mark.parametrize("authority", list(Authority))
@pytest.mark.parametrize(("stack", "lands", "holds"), LEDS)
def test_the_landing_mode_after_the_order_to_begin_takes_nothing_over_where_it_is_waited_for(authority, stack, lands, holds):
    for mode, waited in ((lands, authority is not Authority.SETPOINTS), (holds, authority is Authority.NOTHING)):
        flight = Flight(stack, authority=authority)
        flight.streamer.engage()
        flight.told(mode)
        assert flight.streamer.hand is (Hand.NOBODY if waited else Hand.PERSON)


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_where_nothing_may_leave_only_a_persons_cut_does(stack: Stack) -> None:
    flight = Flight(stack, authority=Authority.NOTHING)
    for command in (GO, Land(), Land(here=True), Land(on_deck=True), Hover(calls_off=True), TakeOff()):
        assert flight.periods(1.0, command) == []
    assert [m.command for m in flight.periods(0.05, CutMotors())] == [mav.MAV_CMD_COMPONENT_ARM_DISARM]


def asked(messages: list[Message], stack: Stack) -> set[str]:
    """Return the modes that are requested, by name; nothing else may be in the messages."""
    assert len(modes(messages)) == len(messages)
    names = PX4_MODES if stack is Stack.PX4 else {(number, 0): name for number, name in COPTER_MODES.items()}
    return {names[(int(main), int(sub))] for main, sub in modes(messages)}
