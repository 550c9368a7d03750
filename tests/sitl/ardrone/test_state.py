"""The drone's side of the conversation, with a clock that the test moves: sequence rules, handshake, watchdog, emergency."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ardrone import at
from drivers.ardrone.navdata import ControlState, NavdataState
from sitl.ardrone.state import HOVER, LOST_COM, DroneState, RefAction
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import Stick
from tests.make import ns

FLY = at.Ref(at.REF_BASE | at.REF_TAKE_OFF)
LAND = at.Ref(at.REF_BASE)
AHEAD = at.Pcmd(at.PCMD_PROGRESSIVE, 0.0, -0.5, 0.0, 0.0)


class Pilot:
    """Numbers the commands as a client does."""

    def __init__(self) -> None:
        self.drone = DroneState()
        self.sequence = 0

    def say(
        self, *commands: at.AtCommand, phase: VehiclePhase = VehiclePhase.LANDED, now_s: float = 0.0
    ) -> list[RefAction | Stick]:
        datagram = b""
        for command in commands:
            self.sequence += 1
            datagram += at.encode(self.sequence, command)
        return list(self.drone.take(datagram, ns(now_s), phase))

    def word(self, phase: VehiclePhase = VehiclePhase.LANDED) -> set[NavdataState]:
        word = self.drone.word(phase, battery_low=False, ultrasound_deaf=False)
        return {bit for bit in NavdataState if word & bit}


@pytest.fixture
def pilot() -> Pilot:
    return Pilot()


def test_take_off_is_held_and_landing_is_its_absence(pilot: Pilot) -> None:
    assert pilot.say(FLY) == [RefAction.TAKE_OFF]
    assert pilot.say(FLY, phase=VehiclePhase.TAKING_OFF) == []
    assert pilot.say(FLY, AHEAD, phase=VehiclePhase.HOVERING) == [Stick(0.0, -0.5, 0.0, 0.0, True)]
    assert pilot.say(AHEAD, phase=VehiclePhase.LANDED) == []
    assert pilot.say(LAND, phase=VehiclePhase.FLYING) == [RefAction.LAND]
    assert pilot.say(LAND, phase=VehiclePhase.LANDING) == []
    assert pilot.say(FLY, phase=VehiclePhase.LANDING) == [RefAction.STAY_UP]
    assert pilot.say(at.Ref(1 << 9)) == [RefAction.TAKE_OFF], "some clients leave the base bits out"


def test_smaller_sequence_numbers_are_ignored_and_one_starts_again(pilot: Pilot) -> None:
    drone = pilot.drone
    pilot.sequence = 99
    assert pilot.say(FLY) == [RefAction.TAKE_OFF]
    for late in (50, 100):
        assert list(drone.take(at.encode(late, FLY), ns(0.1), VehiclePhase.LANDED)) == []
    assert drone.counters["at_out_of_order"] == 2
    assert list(drone.take(at.encode(1, FLY), ns(0.2), VehiclePhase.LANDED)) == [RefAction.TAKE_OFF]
    assert list(drone.take(at.encode(2, FLY), ns(0.3), VehiclePhase.LANDED)) == [RefAction.TAKE_OFF]


def test_silence_makes_a_flying_drone_hover_then_land(pilot: Pilot) -> None:
    drone = pilot.drone
    pilot.say(at.ComWdg(), FLY)
    assert NavdataState.COM_WATCHDOG not in pilot.word()
    pilot.say(AHEAD, phase=VehiclePhase.FLYING, now_s=1.0)
    assert list(drone.tick(ns(2.9), VehiclePhase.FLYING)) == []
    assert list(drone.tick(ns(3.0), VehiclePhase.FLYING)) == [HOVER]
    word = pilot.word(VehiclePhase.HOVERING)
    assert NavdataState.COM_WATCHDOG in word
    assert NavdataState.COMMUNICATION_LOST in word
    assert drone.control_state(VehiclePhase.HOVERING) == ControlState.HOVERING.word | LOST_COM
    assert list(drone.tick(ns(4.9), VehiclePhase.HOVERING)) == []
    assert list(drone.tick(ns(5.0), VehiclePhase.HOVERING)) == [RefAction.LAND]
    assert list(drone.tick(ns(5.1), VehiclePhase.LANDING)) == []
    assert (drone.counters["com_watchdog"], drone.counters["landed_for_silence"]) == (1, 1)


def test_a_client_that_comes_back_in_time_keeps_flying_and_clears_the_bit_itself(pilot: Pilot) -> None:
    drone = pilot.drone
    pilot.sequence = 500
    pilot.say(at.ComWdg(), AHEAD, phase=VehiclePhase.FLYING)
    assert list(drone.tick(ns(2.5), VehiclePhase.FLYING)) == [HOVER]
    pilot.sequence = 6
    assert pilot.say(FLY, AHEAD, phase=VehiclePhase.HOVERING, now_s=2.6) == [Stick(0.0, -0.5, 0.0, 0.0, True)], (
        "the watchdog resets numbers"
    )
    assert NavdataState.COMMUNICATION_LOST not in pilot.word()
    assert NavdataState.COM_WATCHDOG in pilot.word()
    pilot.say(at.ComWdg(), phase=VehiclePhase.FLYING, now_s=2.7)
    assert NavdataState.COM_WATCHDOG not in pilot.word()
    assert list(drone.tick(ns(4.6), VehiclePhase.FLYING)) == []


def test_emergency_is_an_edge_that_toggles(pilot: Pilot) -> None:
    cut = at.Ref(at.REF_BASE | at.REF_EMERGENCY)
    assert pilot.say(cut, phase=VehiclePhase.FLYING) == [RefAction.CUT_MOTORS]
    assert pilot.say(cut, phase=VehiclePhase.EMERGENCY) == []
    word = pilot.word(VehiclePhase.EMERGENCY)
    assert NavdataState.EMERGENCY in word
    assert NavdataState.USER_EMERGENCY in word
    assert pilot.say(FLY, phase=VehiclePhase.EMERGENCY) == []
    assert pilot.say(cut, phase=VehiclePhase.EMERGENCY) == [RefAction.LEAVE_EMERGENCY]
    assert NavdataState.USER_EMERGENCY not in pilot.word()


def test_the_rest_is_accepted(pilot: Pilot) -> None:
    assert pilot.say(at.Ftrim()) == [RefAction.FLAT_TRIM]
    assert pilot.say(at.Config("control:euler_angle_max", "0.3")) == [RefAction.APPLY_LIMITS]
    assert pilot.say(at.Config("control:euler_angle_max", "30")) == []
    (stick,) = pilot.say(at.Pcmd(1, 3.0, -2.0, 1.5, 0.25), phase=VehiclePhase.FLYING)
    assert stick == Stick(1.0, -1.0, 1.0, 0.25, True), "held to its range"
    assert pilot.say(at.Ftrim(), at.Calib(0), at.Anim(16, 15), at.Pmode(2), at.Misc(), phase=VehiclePhase.FLYING) == []
    pilot.say(at.Led(5, 2.5, 7))
    assert (pilot.drone.leds.animation, pilot.drone.leds.frequency_hz, pilot.drone.leds.duration_s) == (5, 2.5, 7.0)
    pilot.say(at.Config("leds:leds_anim", "9,1073741824,3"))
    assert (pilot.drone.leds.animation, pilot.drone.leds.frequency_hz, pilot.drone.leds.duration_s) == (9, 2.0, 3.0)
    pilot.say(at.Config("leds:leds_anim", "nonsense"))
    assert pilot.drone.leds.animation == 9
    counters = pilot.drone.counters
    assert counters["at_taken"] == pilot.sequence
    assert (counters["ftrim_refused_in_flight"], counters["not_flown_calib"], counters["not_flown_anim"]) == (1, 1, 1)


_FRAGMENT = st.one_of(
    st.binary(max_size=40),
    st.sampled_from([b"AT*", b"REF=", b"CONFIG=1,", b'"', b"\r", b",", b"-1", b"4294967296", b"\x00", b'"custom:session_id"']),
    st.builds(lambda n, c: at.encode(n, c), st.integers(0, 99), st.sampled_from([FLY, AHEAD, at.Ctrl(4), at.ComWdg()])),
)


@settings(max_examples=150)
@given(st.lists(_FRAGMENT, max_size=8), st.sampled_from(list(VehiclePhase)))
def test_garbage_never_raises_and_the_next_good_command_counts(fragments: list[bytes], phase: VehiclePhase) -> None:
    drone = DroneState()
    list(drone.take(b"".join(fragments), ns(0.0), phase))
    list(drone.tick(ns(9.0), phase))
    assert list(drone.take(at.encode(1, FLY), ns(9.1), VehiclePhase.LANDED)) == [RefAction.TAKE_OFF]
    assert 0 <= drone.word(phase, True, True) < 2**32
