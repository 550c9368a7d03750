"""The drone without sockets: its protocol, who may write its configuration, and the sets that it keeps."""

import math

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.ardrone import at, control
from drivers.ardrone.navdata import ControlState, NavdataState
from estimator.contracts.geometry import Rotation
from sitl.ardrone.config import KEYS, Answer, Configuration, Ids, tilting
from sitl.ardrone.state import HOVER, LOST_COM, DroneState, RefAction
from sitl.emulators.ardrone.wire_pictures import IDR_EVERY, Encoder, front_view, split_annex_b
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import Stick
from tests.drivers.captures import CAPTURES, needs_captures
from tests.make import ns
from tests.sitl.test_vehicle import shipped_vehicle

MINE = Ids("ca0000d1", "ca0000d3", "ca0000d2")


def chosen() -> Configuration:
    config = Configuration()
    assert config.set("custom:session_id", MINE.session) is Answer.SET
    assert config.set("custom:profile_id", MINE.user) is Answer.SET
    assert config.set("custom:application_id", MINE.application) is Answer.SET
    assert config.ids == MINE
    return config


@pytest.mark.parametrize(
    ("name", "value", "answer", "kept"),
    [
        ("general:navdata_demo", "TRUE", Answer.SET, "TRUE"),
        ("GENERAL:navdata_demo", " true ", Answer.SET, "TRUE"),
        ("general:navdata_demo", "maybe", Answer.BAD_VALUE, "FALSE"),
        ("general:num_version_soft", "9", Answer.READ_ONLY, "2.4.8"),
        ("control:euler_angle_max", "0.3", Answer.SET, "0.3"),
        ("control:euler_angle_max", "2.0", Answer.BAD_VALUE, "0.20943952"),
        ("control:euler_angle_max", "nan", Answer.BAD_VALUE, "0.20943952"),
        ("video:video_channel", "1", Answer.SET, "1"),
        ("video:video_channel", "7", Answer.BAD_VALUE, "0"),
        ("general:ardrone_name", "a\nb", Answer.BAD_VALUE, "Decklander"),
    ],
)
def test_set_answers_and_keeps(name: str, value: str, answer: Answer, kept: str) -> None:
    config = Configuration()
    assert config.set(name, value) is answer
    assert config[name.lower()] == kept


@pytest.mark.parametrize(("vehicle", "takes"), [("ardrone2", False), ("hexa_7kg", False), ("quad_1_5kg", True)])
def test_a_larger_vehicle_takes_the_tilt_of_its_own_loops_and_an_ardrone_its_firmwares(vehicle: str, takes: bool) -> None:
    limits = shipped_vehicle(vehicle).stick_limits()
    config = Configuration(keys=tilting(KEYS, limits.euler_angle_most_rad))
    assert config.set("control:euler_angle_max", "0.52") is Answer.SET
    assert (config.set("control:euler_angle_max", "0.61") is Answer.SET) is takes
    assert config.set("control:euler_angle_max", "0.62") is Answer.BAD_VALUE
    loops_rad = math.radians(shipped_vehicle(vehicle).loops.tilt_max_deg)
    assert config.set("control:euler_angle_max", f"{loops_rad:.6f}") is Answer.SET


def test_outdoor_brings_its_own_limits_and_keeps_the_indoor_ones() -> None:
    config = Configuration()
    config.set("control:control_vz_max", "900")
    assert config["control:indoor_control_vz_max"] == "900.0"
    config.set("control:outdoor", "TRUE")
    assert config["control:control_vz_max"] == "1000"
    config.set("control:outdoor_control_vz_max", "1500")
    assert config["control:control_vz_max"] == "1500.0"
    config.set("control:outdoor", "FALSE")
    assert config["control:control_vz_max"] == "900.0"


def test_a_session_keeps_its_keys_from_others() -> None:
    config = chosen()
    assert config.set("video:video_channel", "1") is Answer.WRONG_IDS
    assert config.set("video:video_channel", "1", Ids("ca0000d1", "ffffffff", "ffffffff")) is Answer.SET
    assert config.set("control:euler_angle_max", "0.3", Ids("ca0000d1", "ffffffff", "ca0000d2")) is Answer.WRONG_IDS
    assert config.set("control:altitude_max", "5000") is Answer.SET, "a common key needs no ids"
    config.set("custom:session_id", "00000000")
    assert config["video:video_channel"] == "0"
    assert config.ids == Ids()
    config.set("custom:session_id", MINE.session)
    assert config["video:video_channel"] == "1"
    assert config.ids == MINE, "a session brings its user and application back"


def test_custom_ids_list_is_in_the_form_the_sdk_reads() -> None:
    config = chosen()
    assert config.set("custom:profile_desc", "deck pilot", MINE) is Answer.SET
    text = config.custom_ids()
    assert text.endswith(b"\r\0")
    lines = text[:-1].decode().split("\r")
    assert [line for line in lines if line.startswith("[")] == ["[applis]", "[profiles]", "[sessions]"]
    assert "ca0000d3,deck pilot" in lines[lines.index("[profiles]") : lines.index("[sessions]")]


@settings(max_examples=200)
@given(st.lists(st.tuples(st.sampled_from([*KEYS, "custom:session_id", "nope"]), st.text(max_size=12)), max_size=8))
def test_no_value_breaks_the_table(writes: list[tuple[str, str]]) -> None:
    config = Configuration()
    for name, value in writes:
        config.set(name, value, MINE)
    read = config.dump()
    assert list(read) == list(KEYS)
    assert control.parse(control.render(read) + b"general:late = 1\n") == read, "what follows the NUL is not of this text"
    assert 0.0 <= config.number("control:euler_angle_max") <= 0.52
    assert config.number("general:com_watchdog") >= 1


@needs_captures
def test_a_real_configuration() -> None:
    text = (CAPTURES / "config_port5559_ardrone1.txt").read_bytes()
    reported = control.parse(text)
    assert len(reported) == len([line for line in text.splitlines() if b"=" in line])
    assert reported["general:navdata_options"] == "65537"
    assert reported["general:soft_build_date"] == "2011-07-13 09:52"
    assert reported["network:passkey"] == ""
    assert reported["network:owner_mac"] == "00:00:00:00:00:00"
    assert control.number(reported["control:euler_angle_max"]) == pytest.approx(0.15)
    assert control.render(reported).rstrip(b"\0").split() == text.split()


@given(st.binary(max_size=300))
def test_garbage_never_raises_and_costs_no_line(garbage: bytes) -> None:
    control.parse(garbage)
    reported = control.parse(garbage.replace(b"\0", b"") + b"\ngeneral:a = 1\n")
    assert reported["general:a"] == "1"


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


SPS, PPS, IDR, SLICE = 7, 8, 5, 1


def moving_image(n: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(7)
    coarse = (rng.random((45, 90, 3)) * 200).astype(np.uint8)
    return np.ascontiguousarray(cv2.resize(coarse, (720, 400), interpolation=cv2.INTER_CUBIC)[10:370, n : n + 640])


def test_every_access_unit_decodes_at_once_to_its_own_image() -> None:
    encoder = Encoder(640, 360, 30.0, 8000.0)
    decoder = av.CodecContext.create("h264", "r")
    assert encoder.coded_size == (640, 368)
    for n in range(2 * IDR_EVERY + 2):
        px = moving_image(2 * n)
        unit = encoder.encode(px)
        kinds = [kind for kind, _ in split_annex_b(unit.data)]
        if n % IDR_EVERY == 0:
            assert unit.idr
            assert kinds == [SPS, PPS, IDR]
            sps, pps = (part for _, part in split_annex_b(unit.data)[:2])
            assert (unit.sps_size, unit.pps_size) == (len(sps), len(pps))
            assert sps[4:6] == bytes([0x67, 66]), "baseline profile"
        else:
            assert not unit.idr
            assert kinds == [SLICE]
            assert unit.sps_size == unit.pps_size == 0
        (frame,) = decoder.decode(av.Packet(unit.data))
        decoded = frame.to_ndarray(format="bgr24")
        assert decoded.shape == (360, 640, 3)
        assert np.abs(decoded.astype(int) - px).mean() < 6.0
        assert unit.data.startswith(b"\0\0\0\1")


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, 0.0), (0.0, 0.15), (-0.1, -0.1)])
def test_front_view_puts_the_horizon_where_a_pinhole_would(roll: float, pitch: float) -> None:
    px = front_view(Rotation.from_rpy(roll, pitch, 1.0)).astype(int)
    sky = px.sum(axis=2) > 450
    f = 640 / 2 / 0.81
    for u in (40, 320, 600):
        x = (u - 319.5) / f
        # down component of the ray through (u, v): -sin(p) + cos(p) sin(r) x + cos(p) cos(r) y = 0
        y = (np.tan(pitch) - np.sin(roll) * x) / np.cos(roll)
        v = 179.5 + f * y
        assert abs(int(sky[:, u].sum()) - v) < 2.0
