"""Broken set-ups, each of them named, and nothing else named with it; a good one is left in peace."""

from typing import Any

import pytest
from msgspec.structs import replace

from companion.cli import doctor
from companion.cli.main import Parser
from companion.settings.load import from_mapping
from companion.settings.remarks import Contradiction, contradiction
from companion.tools.doctor.diagnose import diagnose
from companion.tools.doctor.finding import Severity
from companion.tools.doctor.firmware_parameters import defaults_of
from companion.tools.doctor.snapshot import (
    AutopilotSnapshot,
    FoundSystem,
    GimbalSnapshot,
    LinkSnapshot,
    ServiceSnapshot,
    ShipSource,
    Snapshot,
    TimeSyncSnapshot,
    decode,
    encode,
)
from drivers.mavlink.failsafe import event_id
from drivers.mavlink.requests import RATES_HZ
from drivers.mavlink.roster import IdConflict
from drivers.mavlink.samples import SAMPLE_PARAMETERS
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import BadInput

LINK = LinkSnapshot("serial:///dev/ttyAMA0:921600", bytes_in=90_000, messages=3000)
SERVICE = ServiceSnapshot(
    frame_rate_hz=30.0,
    frame_size=(640, 360),
    camera_size=(640, 360),
    exposure_to_belief_s=0.06,
    sends_ranges=True,
    targets_sent=200,
    broker="localhost:1883",
    drone="192.168.1.1:5559",
)
ARDUPILOT = AutopilotSnapshot(
    stack="ArduPilot", system=1, firmware=(4, 5, 7), mode="loiter", armed=True, flying=True,
    parameters={
        "PLND_ENABLED": 1.0, "PLND_TYPE": 1.0, "PLND_EST_TYPE": 1.0, "PLND_LAG": 0.05, "PLND_OPTIONS": 1.0, "PLND_STRICT": 2.0,
        "PLND_ORIENT": 25.0, "PLND_YAW_ALIGN": 0.0, "PLND_CAM_POS_X": 0.0, "PLND_CAM_POS_Y": 0.0, "PLND_CAM_POS_Z": 0.0,
        "PLND_ALT_MAX": 8.0, "INS_GYR_CAL": 0.0, "EK3_SRC1_POSXY": 3.0, "EK3_SRC1_VELXY": 3.0, "EK3_SRC1_POSZ": 1.0,
        "EK3_SRC1_VELZ": 3.0, "EK3_SRC1_YAW": 1.0, "EK3_RNG_USE_HGT": -1.0, "RNGFND1_TYPE": 10.0, "RNGFND1_ORIENT": 25.0,
        "RNGFND2_TYPE": 0.0, "RNGFND2_ORIENT": 25.0,
    },
    rates_hz={"ATTITUDE_QUATERNION": 99.0, "LOCAL_POSITION_NED": 49.0, "EXTENDED_SYS_STATE": 5.0},
    wanted_hz=dict(RATES_HZ[Stack.ARDUPILOT]),
    texts=("PrecLand: Target Found",), precland_enabled=True, precland_healthy=True,
)  # fmt: skip
PX4 = AutopilotSnapshot(
    stack="PX4", system=1, firmware=(1, 16, 2), mode="offboard", armed=True, flying=True,
    parameters={"PLD_HACC_RAD": 0.2, "COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0.0, "EKF2_HGT_REF": 1.0, "EKF2_EV_CTRL": 0.0},
    rates_hz={"ATTITUDE_QUATERNION": 99.0, "LOCAL_POSITION_NED": 49.0, "EXTENDED_SYS_STATE": 5.0},
    wanted_hz=dict(RATES_HZ[Stack.PX4]),
)  # fmt: skip
PLANE = replace(
    ARDUPILOT, stack="ArduPlane", mode="guided", texts=(), precland_enabled=None, precland_healthy=None,
    parameters={"Q_ENABLE": 1.0, "Q_GUIDED_MODE": 1.0, "SCR_ENABLE": 1.0, "DKP_ENABLE": 1.0, "STICK_MIXING": 1.0},
)  # fmt: skip
SYNC = TimeSyncSnapshot(True, 0.004)
GOOD = Snapshot(8.0, (LINK,), ARDUPILOT, SYNC, SERVICE)
GOOD_PX4 = replace(GOOD, autopilot=PX4)


def link(**changes: Any) -> Snapshot:
    return replace(GOOD, links=(replace(LINK, **changes),))


def ardupilot(**changes: Any) -> Snapshot:
    return replace(GOOD, autopilot=replace(ARDUPILOT, **changes))


def px4(**changes: Any) -> Snapshot:
    return replace(GOOD_PX4, autopilot=replace(PX4, **changes))


def plane(name: str, value: float, absent: tuple[str, ...] = ()) -> Snapshot:
    return replace(GOOD, autopilot=replace(PLANE, parameters=PLANE.parameters | {name: value}, absent=absent))


def parameter(name: str, value: float) -> Snapshot:
    return ardupilot(parameters=ARDUPILOT.parameters | {name: value})


def service(**changes: Any) -> Snapshot:
    return replace(GOOD, service=replace(SERVICE, **changes))


def out_of_place(**tables: dict[str, Any]) -> Contradiction | None:
    data = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}, **tables}
    return contradiction(from_mapping(data, "mine.toml"))


def defaults(stack: str, firmware: tuple[int, int, int] | None = None) -> dict[str, float]:
    """Return every parameter that an examination requests besides those of its rules: an absent one is waited for."""
    return dict.fromkeys(SAMPLE_PARAMETERS[Stack(stack)], 0.0) | defaults_of(stack, firmware)


def run_doctor(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str]:
    """Return the exit code and what was printed."""
    parser = Parser(prog="decklander")
    doctor.add_arguments(parser)
    code = doctor.run(parser.parse_args(["--seconds", "0.5", *argv]))
    return code, capsys.readouterr().out


FOUND = FoundSystem(1, 1, "ArduPilot", "quadrotor", True)
SILENCE = dict.fromkeys(ARDUPILOT.wanted_hz, -1)
UNANSWERED = replace(ARDUPILOT, parameters={}, absent=("PLND_ENABLED",), rates_hz={"HEARTBEAT": 1.0}, refused=SILENCE)
ONE_WAY = replace(GOOD, autopilot=UNANSWERED, sync=TimeSyncSnapshot(False), systems=(FOUND,))
NO_SOURCE = out_of_place(guidance={"rendezvous": {"enabled": True}})
UNUSED = out_of_place(vessel={"nmea": "127.0.0.1:10110"})

SWITCH = replace(SERVICE, switch_channel=7, switch=("hold", "stay", "begin"))
MOVED = {7: {"middle": 1500, "high": 1990, "low": 1000}}


def switched(of: AutopilotSnapshot = ARDUPILOT, channels: Any = MOVED, rate_hz: float = 10.0, **values: float) -> Snapshot:
    rates = of.rates_hz | ({"RC_CHANNELS": rate_hz} if rate_hz else {})
    with_switch = replace(of, parameters=of.parameters | values, rates_hz=rates, channels=channels)
    return replace(GOOD, service=SWITCH, autopilot=with_switch)


BROKEN: dict[str, tuple[str, Snapshot, str]] = {
    # what is broken: the rule that names it, the frame, a word of the cure
    "serial port without permission": ("link-down", link(down="/dev/ttyAMA0: add the user to the group dialout"), "dialout"),
    "wire not connected": ("link-silent", link(bytes_in=0, messages=0), "SERIALn_PROTOCOL"),
    "wrong speed": ("link-garbage", link(bytes_in=9000, messages=3, damaged=800), "same speed"),
    "a login console": ("link-console", link(bytes_in=400, text=390, messages=0, damaged=30), "no login shell"),
    "TX on our own RX": ("link-echo", link(bytes_in=400, messages=20, echoed=20), "TX"),
    "key on one side only": ("link-signature", link(refused_signature=40), "same key"),
    "an autopilot whose clock is not set yet": ("link-signature",
        link(refused_signature=40, refused_time=40, behind_s=259_200.0, signed=True), "GNSS"),
    "no program listens there": ("link-refused", link(bytes_in=0, messages=0, refused_datagrams=30), "router"),
    "a line that stands still": ("link-late", link(late=300), "RTS/CTS"),
    "two autopilots of one id": ("autopilot-id-twice", replace(GOOD, id_conflicts=(
        IdConflict("autopilot-id-twice", "two autopilots have one id", "choose by vehicle.system_id", True), ), ),
        "vehicle.system_id"),
    "another program with our ids": ("component-id-twice", replace(
        GOOD, id_conflicts=(IdConflict("component-id-twice", "another sends as us", "vehicle.component_id", False),) ),
        "vehicle.component_id"),
    "not signed in a network": ("link-unsigned", link(url="udpin://0.0.0.0:14550", signed=False), "decklander keys"),
    "a station that is not named": ("link-unknown-senders", link(unknown_senders=300), "vehicle.operators"),
    "MAVLink 1 on the port": ("link-mavlink1", link(old_version=2900), "SERIALn_PROTOCOL 2"),
    "overloaded link": ("link-lossy", link(lost=600), "921600"),
    "only a ground station found": ("no-autopilot",
        replace(GOOD, autopilot=None, sync=None, systems=(FoundSystem(255, 190, "", "gcs", False),)), "frame type"),
    "nothing with a heart": ("no-autopilot", replace(GOOD, autopilot=None, sync=None), "frame type"),
    "a rover": ("no-autopilot",
        replace(GOOD, autopilot=None, sync=None, systems=(FoundSystem(1, 1, "ArduPilot", "ground rover", False),)),
        "lands copters"),
    "another id than the wished one": ("wrong-system",
        replace(GOOD, autopilot=None, sync=None, wanted_system=5, systems=(FOUND, FoundSystem(3, 1, "PX4", "hexarotor", True))),
        "--system 1 or 3"),
    "a radio that passes one direction": ("link-one-way", ONE_WAY, "TX"),
    "an autopilot that signs": ("link-signature", replace(ONE_WAY, links=(replace(LINK, with_signature=2900),)), "--signing-key"),
    "a radio that passes MAVLink 1 only": ("link-one-way",
        replace(ONE_WAY, links=(replace(LINK, messages=40, old_version=40),)), "MAVLink 2"),
    "two drones, one network": ("several-autopilots", ardupilot(others=(2, 5)), "SYSID_THISMAV"),
    "firmware without a stream": ("stream-refused", ardupilot(refused={"LOCAL_POSITION_NED": 2}), "update the firmware"),
    "stream silent": ("stream-silent", ardupilot(rates_hz=ARDUPILOT.rates_hz | {"LOCAL_POSITION_NED": 0.0}), "SRn_"),
    "attitude at 4 Hz": ("attitude-slow", ardupilot(rates_hz=ARDUPILOT.rates_hz | {"ATTITUDE_QUATERNION": 4.0}), "921600"),
    "clock not locked": ("clock-not-locked", replace(GOOD, sync=TimeSyncSnapshot(False)), "TIMESYNC"),
    "telemetry radio": ("clock-far", replace(GOOD, sync=TimeSyncSnapshot(True, 0.180)), "wire"),
    "PX4 over Wi-Fi": ("clock-far", replace(GOOD_PX4, sync=TimeSyncSnapshot(True, 0.022)), "wire"),
    "clock set while listening": ("clock-jumps", replace(GOOD, sync=TimeSyncSnapshot(True, 0.004, 2, 31.0)), "power"),
    "a key that is not there": ("settings-files", service(files_fault="http.token_file: t: No such file"), "setting"),
    "settings that do nothing": ("settings-idle", service(without_effect=("http.port: without effect",)), "take these keys out"),
    "limits without a limit": ("limits-wide", service(beyond_sound=("error_m is 2, beyond 0.26: a foot",)), "may land"),
    "feet of an AR.Drone": ("feet-not-said", service(feet_below_m=0.045), "measure"),
    "camera not plugged in": ("camera-device", service(device_fault="usb: no such camera; there is none at all"), "cable"),
    "camera file with a fault": ("camera-file", service(camera_fault="cam.toml: fx: expected a number"), "config check"),
    "a lens nobody measured": ("lens-nominal", service(lens_assumed=("distances may be 5 % off",)), "calibrate camera"),
    "camera at another size": ("camera-size", service(frame_size=(1280, 720)), "calibrate"),
    "camera in the dark": ("camera-slow", service(frame_rate_hz=4.0), "light"),
    "camera unplugged": ("camera-slow", service(frame_rate_hz=0.0), "cable"),
    "broker not running": ("broker", service(broker_fault="Connect call failed"), "start the broker"),
    "not in the drone's Wi-Fi": ("drone", service(drone_fault="no answer within 2 s"), "Wi-Fi"),
    "a camera that refuses an exposure": ("exposure-refused", service(exposure={"refused": 3.0, "frames_pad": 9.0}), "journal"),
    "a pad in the dark": ("exposure-limited", service(exposure={"frames_pad": 90.0, "frames_dark": 30.0}), "more light"),
    "a gimbal that is silent": ("gimbal-silent", service(gimbal=GimbalSnapshot(154, 0.0, {"failure": 9})), "device_id"),
    "a gimbal that reports seldom": ("gimbal-slow", replace(GOOD, gimbal=GimbalSnapshot(1, 5.0)), "rate"),
    "rendezvous without a source": ("ship-place", service(ship_place=NO_SOURCE), "vessel.nmea"),
    "a place that nobody flies to": ("ship-place", service(ship_place=UNUSED), "enabled = true"),
    "the ship is silent": ("ship-silent", service(places_taken=0), "firewall"),
    "her sentences are damaged": ("ship-silent", service(places_taken=0, places_refused={"checksum": 9}), "rendezvous.md"),
    "another program has her port": ("ship-source", service(ship_fault="vessel.nmea: address already in use"), "[http]"),
    "her gyro has not settled": ("ship-sentences", service(ship_sources=(ShipSource("TIROT", 0, 1.0, {"not_valid": 9}),)),
        "settle"),
    "firmware without precision landing": ("plnd-missing", ardupilot(
        parameters={k: v for k, v in ARDUPILOT.parameters.items() if not k.startswith("PLND_")}, absent=("PLND_ENABLED",) ),
        "custom"),
    "set but not rebooted": ("plnd-not-rebooted", ardupilot(precland_healthy=False), "reboot"),
    "lag far from what is measured": ("plnd-lag", service(exposure_to_belief_s=0.16), "PLND_LAG 0.16"),
    "pad taken to stand still": ("plnd-still-target", parameter("PLND_OPTIONS", 4.0), "PLND_OPTIONS 5"),
    "rangefinder that nobody feeds": ("rangefinder-unfed", service(sends_ranges=False), "ranges"),
    "height from the deck": ("ekf-height-by-range", parameter("EK3_SRC1_POSZ", 2.0), "EK3_SRC1_POSZ 1"),
    "a heading of two antennas that nobody takes": ("yaw-by-gnss", ardupilot(
        parameters=ARDUPILOT.parameters | {"GPS1_TYPE": 17.0, "GPS2_TYPE": 18.0, "EK3_SRC1_YAW": 1.0}),
        "EK3_SRC1_YAW 3"),
    "gyros calibrated at sea": ("gyro-calibration", parameter("INS_GYR_CAL", 1.0), "ashore"),
    "another program's frame": ("frame-not-supported", ardupilot(texts=("Plnd: Frame not supported",)), "another program"),
    "targets at 1 Hz": ("target-too-rare", ardupilot(texts=("PrecLand: Init Failed",)), "10 Hz"),
    "a name with a letter too few": ("parameter-name", ardupilot(misspelt={"PLND_ENABLE": "PLND_ENABLED"}), "known name"),
    "nobody disarms it on deck": ("disarm-script", ardupilot(parameters=ARDUPILOT.parameters | {"SCR_ENABLE": 0.0}),
        "SCR_ENABLE 1"),
    "target lost": ("target-lost", ardupilot(texts=("PrecLand: Target Lost",)), "light"),
    "refuses to arm": ("arming-refused", ardupilot(
        armed=False, texts=("PreArm: Need Position Estimate", "PreArm: Battery 1 low", "PreArm: Need Position Estimate") ),
        "open sky"),
    "PX4 refuses to arm": ("arming-refused", px4(
        armed=False, texts=("Preflight Fail: Compass Sensor 0 missing", "Arming denied: Resolve system health failures first")
        ), "steel"),
    "ArduPilot 4.0": ("firmware-old", ardupilot(firmware=(4, 0, 7)), "update"),
    "PX4 without the module": ("px4-precland-missing",
        px4(parameters={k: v for k, v in PX4.parameters.items() if k != "PLD_HACC_RAD"}, absent=("PLD_HACC_RAD",)), "OFFBOARD"),
    "a heading of two antennas that PX4 does not take": ("px4-yaw-by-gnss",
        px4(parameters=PX4.parameters | {"GPS_UBX_MODE": 1.0, "EKF2_GPS_CTRL": 7.0}), "EKF2_GPS_CTRL 15"),
    "PX4 precision landing on a ship": ("px4-precland-moving", px4(mode="auto.precland"), "OFFBOARD"),
    "PX4 led, and slow": ("px4-precland-jerk", replace(
        px4(parameters=PX4.parameters | {"PLD_HACC_RAD": 8.0, "MPC_JERK_AUTO": 4.0}),
        service=replace(GOOD_PX4.service, leads=True), ), "MPC_JERK_AUTO 20"),
    "PX4 and another program's frame": ("px4-frame", px4(events=(event_id("mavlink_rcv_lnd_target_unsup_coord"),)),
        "another program"),
    "no receiver": ("switch-silent", switched(channels={}, rate_hz=0.0), "bind"),
    "a transmitter that is off": ("switch-no-pulse", switched(channels={5: {"low": 1000}}), "transmitter on"),
    "a switch that nobody flipped": ("switch-unmoved", switched(channels={7: {"low": 1000}}), "flip"),
    "a switch that ArduPilot has too": ("switch-used", switched(RC7_OPTION=41.0, FLTMODE_CH=5.0), "free channel"),
    "the mode switch of PX4": ("switch-used", switched(PX4, RC_MAP_FLTMODE=7.0, RC_MAP_KILL_SW=8.0), "free channel"),
    "a mode button of PX4": ("switch-used", switched(PX4, RC_MAP_FLTM_BTN=64.0), "free channel"),
    "a QuadPlane without the script": ("plane-script", plane("Q_ENABLE", 1.0, ("DKP_ENABLE",)), "decklander_plane.lua"),
    **{
        f"{name} of a QuadPlane": (f"plane-{rule}", plane(name, value), word)
        for name, value, rule, word in (
            ("Q_ENABLE", 0.0, "fixed-wing", "VTOL"), ("Q_GUIDED_MODE", 0.0, "guided", "Q_GUIDED_MODE 1"),
            ("SCR_ENABLE", 0.0, "script", "APM/scripts"), ("DKP_ENABLE", 0.0, "script-off", "DKP_ENABLE 1"),
            ("STICK_MIXING", 0.0, "no-turn", "STICK_MIXING 1"), ("Q_P_JERK_XY", 2.0, "jerk", "20"),
            ("Q_ANGLE_MAX", 9.0, "lean-limit", "3000"), ("Q_P_JERK_Z", 5.0, "jerk-z", "20"),
            ("Q_WP_ACCEL", 100.0, "accel", "500"), ("Q_PILOT_ACCEL_Z", 1.0, "accel-z", "3"), ("Q_WP_SPEED", 9.0, "speed", "1000"),
        )
    },
    "pad out of the frame": ("targets-withheld", service(targets_sent=0, withheld={"not seen": 90, "on ground": 3}), "detect"),
}  # fmt: skip


OTHER_MESSAGE = {k: v for k, v in ARDUPILOT.rates_hz.items() if k != "ATTITUDE_QUATERNION"} | {"ATTITUDE": 90.0}
HARMLESS = {
    "ArduPilot": GOOD,
    "PX4": GOOD_PX4,
    "a QuadPlane": plane("Q_ENABLE", 1.0),
    "nothing known": Snapshot(0.0),
    "another message of the same": ardupilot(refused={"ATTITUDE_QUATERNION": 2}, rates_hz=OTHER_MESSAGE),
    "an old refusal to arm": ardupilot(armed=True, texts=("PreArm: Need Position Estimate",)),
    "a simulator on a busy machine": replace(GOOD, sync=TimeSyncSnapshot(True, 0.004, 5, 0.2)),
    "a cable": link(url="serial:///dev/ttyAMA0:921600", signed=False),
    "loopback": link(url="udpin://[::1]:1", signed=False),
    "a name of loopback": link(url="tcp://localhost:5760", signed=False),
    "signed": link(url="udpin://0.0.0.0:14550", signed=True),
    "a free switch": switched(RC7_OPTION=0.0, FLTMODE_CH=5.0, TUNE=3.0),
    "a free switch of PX4": switched(PX4, RC_MAP_FLTMODE=5.0, RC_MAP_FLTM_BTN=16.0),
}


@pytest.mark.parametrize("snapshot", HARMLESS.values(), ids=HARMLESS)
def test_nothing_is_reported_of_a_good_set_up_or_of_what_is_not_known(snapshot: Snapshot) -> None:
    assert diagnose(snapshot) == ()


@pytest.mark.hazard("H12")
@pytest.mark.parametrize("name", BROKEN)
def test_the_trap_is_named_with_its_cure_and_no_other(name: str) -> None:
    rule, snapshot, word = BROKEN[name]
    assert decode(encode(snapshot), "there", Snapshot, "snapshot") == snapshot
    found = diagnose(snapshot)
    assert [f.rule for f in found] == [rule]
    assert word in found[0].fix
    assert "\n" not in found[0].what + found[0].fix
    for change in found[0].changes:
        assert change.parameter.removesuffix("_X") in found[0].fix.replace("*", "")
        assert snapshot.autopilot is not None
        healed = replace(snapshot.autopilot, parameters=snapshot.autopilot.parameters | {change.parameter: change.value})
        assert diagnose(replace(snapshot, autopilot=healed)) == (), "the change heals it"


def test_on_a_pad_that_does_not_move_the_ships_traps_are_none() -> None:
    for name in (
        "pad taken to stand still",
        "gyros calibrated at sea",
        "height from the deck",
        "PX4 precision landing on a ship",
    ):
        assert diagnose(replace(BROKEN[name][1], moving_pad=False)) == ()


def test_a_file_that_is_no_image_is_bad_input() -> None:
    for data in (b"", b"[1]", b'{"seconds": "x"}', b"\xff"):
        with pytest.raises(BadInput, match=r"pic\.json: no snapshot"):
            decode(data, "pic.json", Snapshot, "snapshot of a set-up")


@pytest.mark.parametrize(
    ("parameters", "absent", "says"),
    [
        ({"SCR_ENABLE": 0.0}, ("DKL_ENABLE",), "copy configs/autopilot/decklander_disarm.lua to APM/scripts, set SCR_ENABLE 1"),
        ({"SCR_ENABLE": 1.0, "SCR_HEAP_SIZE": 20000.0}, ("DKL_ENABLE",), "set SCR_HEAP_SIZE 80000"),
        ({"SCR_ENABLE": 1.0, "SCR_HEAP_SIZE": 43008.0}, ("DKL_ENABLE",), "copy configs/autopilot/decklander_disarm.lua"),
        ({"SCR_ENABLE": 1.0, "SCR_HEAP_SIZE": 204800.0, "DKL_ENABLE": 0.0}, (), "set DKL_ENABLE 1"),
        ({"SCR_ENABLE": 1.0, "SCR_HEAP_SIZE": 204800.0, "DKL_ENABLE": 1.0}, (), None),
        ({}, ("SCR_ENABLE", "DKL_ENABLE"), None),
    ],
)
def test_a_copter_that_nobody_disarms_on_deck_is_an_advice_and_no_change_of_its_own(parameters, absent, says):
    autopilot = replace(ARDUPILOT, parameters=ARDUPILOT.parameters | parameters, absent=absent)
    found = diagnose(replace(GOOD, autopilot=autopilot))
    assert [(f.rule, f.severity, f.changes) for f in found] == ([] if says is None else [("disarm-script", Severity.ADVICE, ())])
    assert says is None or says in found[0].fix
    assert diagnose(replace(GOOD, autopilot=autopilot, moving_pad=False)) == ()
