"""`doctor LOG`: the parameters in a log are judged like those on the wire, and what spoiled a landing in it is named."""

import struct
from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.tools.doctor.diagnose import diagnose
from companion.tools.doctor.finding import Finding, Severity
from companion.tools.doctor.gather_outside import examine_log
from drivers.imports.history_meter import LandingMeter
from drivers.imports.px4_ulog import read_history
from estimator.contracts.errors import BadInput
from tests.companion.doctor.test_rules import ARDUPILOT, PX4, run_doctor
from tests.support.flight_logs import copter_log, px4_log

DATA = Path(__file__).parents[3] / "../shared/data/mavlink"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the shared recordings are not here")
Row = tuple[float, str, tuple[object, ...]]
ARM, DISARM, LANDED, FLYING = 10, 11, 18, 28
FLIGHT: list[Row] = [(1.0, "EV", (ARM,)), (3.0, "EV", (FLYING,)), (40.0, "EV", (LANDED,)), (41.0, "EV", (DISARM,))]
STATUS = {"arming_state": "uint8_t", "failsafe": "bool"}
TOPICS = {
    "vehicle_status": STATUS,
    "vehicle_land_detected": {"landed": "bool"},
    "failsafe_flags": {"offboard_control_signal_lost": "bool", "gcs_connection_lost": "bool"},
    "estimator_status": {"vel_test_ratio": "float", "mag_test_ratio": "float"},
    "vehicle_imu_status": {"accel_clipping[0]": "uint32_t", "accel_vibration_metric": "float"},
}
PX4_FLIGHT: list[Row] = [
    (0.0, "vehicle_status", (1, False)), (0.0, "vehicle_land_detected", (True,)), (1.0, "vehicle_status", (2, False)),
    (3.0, "vehicle_land_detected", (False,)), (40.0, "vehicle_land_detected", (True,)), (41.0, "vehicle_status", (1, False)),
]  # fmt: skip


def copter(path: Path, rows: list[Row] = FLIGHT, **wrong: float) -> tuple[Finding, ...]:
    return diagnose(examine_log(copter_log(path / "x.bin", ARDUPILOT.parameters | wrong, sorted(rows, key=lambda r: r[0]))))


def px4(
    path: Path, rows: list[Row] = PX4_FLIGHT, texts: tuple[tuple[float, str], ...] = (), **wrong: float
) -> tuple[Finding, ...]:
    log = px4_log(path / "x.ulg", PX4.parameters | wrong, TOPICS, sorted(rows, key=lambda r: r[0]), texts)
    return diagnose(examine_log(log))


def during(begin_s: float, end_s: float, name: str, *values: object) -> list[Row]:
    return [(begin_s + 0.1 * k, name, values) for k in range(round(10 * (end_s - begin_s)))]


def test_a_good_flight_of_each_stack_is_left_in_peace(tmp_path: Path) -> None:
    calm = [*during(1, 40, "XKF4", 0, 30, 20, 40, 50, 0), *during(1, 40, "VIBE", 0, 5.0, 6.0, 9.0, 7), *during(5, 39, "PL", 1, 1)]
    assert copter(tmp_path, [*FLIGHT, *calm]) == ()
    assert px4(tmp_path, [*PX4_FLIGHT, *during(1, 40, "estimator_status", 0.3, 0.2)]) == ()


def test_parameters_in_a_log_are_judged_like_those_on_the_wire(tmp_path: Path) -> None:
    assert [f.rule for f in copter(tmp_path, LAND_SPEED=250, PLND_TYPE=2)] == ["plnd-type", "land-speed"]
    assert [f.rule for f in px4(tmp_path, EKF2_GPS_CHECK=245, COM_OF_LOSS_T=10.0)] == ["px4-gnss-checks", "px4-offboard-loss"]


COPTER_EVENTS: dict[str, tuple[str, list[Row], str]] = {
    "battery failsafe": ("log-failsafe", [(30.0, "ERR", (6, 1))], "failsafe: battery at 30.0 s"),
    "EKF check": ("log-failsafe", [(30.0, "ERR", (16, 2)), (31.0, "ERR", (16, 0))], "EKF check: variances too large at 30.0 s"),
    "crash": ("log-failsafe", [(40.2, "ERR", (12, 1))], "crash detected"),
    "thrust": ("log-failsafe", [(30.0, "ERR", (25, 1))], "loss of thrust"),
    "velocity refused": ("log-ekf", during(30, 34, "XKF4", 0, 240, 20, 40, 50, 0), "velocity for 3.9 s (ratio 2.4 at 30.0 s)"),
    "compass refused": ("log-ekf", during(30, 32, "XKF4", 0, 20, 20, 40, 150, 0), "compass for 1.9 s"),
    "clipping": ("log-clipping", [(5.0, "VIBE", (0, 5.0, 5.0, 5.0, 3)), (39.0, "VIBE", (0, 5.0, 5.0, 5.0, 500))], "497 times"),
    "vibration": ("log-vibration", during(10, 15, "VIBE", 0, 12.0, 45.0, 20.0, 0), "above 30 m/s^2 for 4.9 s"),
    "target lost": (
        "log-target-lost",
        [r for k in range(3) for r in ((20.0 + k, "PL", (1, 1)), (20.5 + k, "PL", (1, 0)))],
        "3 times",
    ),
    "landing taken back": ("log-land-detector", [(35.0, "EV", (LANDED,)), (37.0, "EV", (FLYING,))], "taken back once"),
}


PX4_EVENTS: dict[str, tuple[str, list[Row], str]] = {
    "setpoints lost": (
        "log-failsafe",
        [
            (5.0, "failsafe_flags", (False, True)), (29.5, "failsafe_flags", (True, True)), (30.0, "vehicle_status", (2, True)),
            (32.0, "vehicle_status", (2, False)),
        ],
        "failsafe: setpoints lost at 30.0 s",
    ),
    "velocity refused": ("log-ekf", during(30, 34, "estimator_status", 2.4, 0.1), "velocity for 3.9 s"),
    "clipping": ("log-clipping", [(5.0, "vehicle_imu_status", (9, 1.0)), (39.0, "vehicle_imu_status", (300, 1.0))], "291 times"),
    "vibration": ("log-vibration", during(10, 15, "vehicle_imu_status", 0, 15.0), "above 9.81 m/s^2"),
    "landing taken back": (
        "log-land-detector",
        [(t, "vehicle_land_detected", (k % 2 == 0,)) for k, t in enumerate((34.0, 35.0, 36.0, 37.0))],
        "at 34.0 s was detected and taken back 2 times",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("stack", "name"), [*(("ArduPilot", n) for n in COPTER_EVENTS), *(("PX4", n) for n in PX4_EVENTS)])
def test_what_spoiled_a_landing_is_named(stack: str, name: str, tmp_path: Path) -> None:
    rule, rows, says = (COPTER_EVENTS if stack == "ArduPilot" else PX4_EVENTS)[name]
    (found,) = copter(tmp_path, [*FLIGHT, *rows]) if stack == "ArduPilot" else px4(tmp_path, [*PX4_FLIGHT, *rows])
    assert found.rule == rule
    assert says in found.what


def test_a_failsafe_without_flags_is_named_by_px4_s_own_words(tmp_path: Path) -> None:
    text = (30.0, "Failsafe activated: Offboard signal lost, entering Hold")
    (found,) = px4(tmp_path, [*PX4_FLIGHT, (30.0, "vehicle_status", (2, True))], (text,))
    assert found.what == f"{text[1]} at 30.0 s"


def test_px4_s_own_precision_landing_on_a_ship_is_named(tmp_path: Path) -> None:
    topics = {"vehicle_status": {"arming_state": "uint8_t", "failsafe": "bool", "nav_state": "uint8_t"}}
    rows = [
        (0.0, "vehicle_status", (1, False, 4)),
        (9.0, "vehicle_status", (2, False, 20)),
        (30.0, "vehicle_status", (1, False, 4)),
    ]
    (found,) = diagnose(examine_log(px4_log(tmp_path / "x.ulg", PX4.parameters, topics, rows)))
    assert found.rule == "px4-precland-moving"


def test_a_log_with_holes_is_reported(tmp_path: Path) -> None:
    path = px4_log(tmp_path / "x.ulg", PX4.parameters, TOPICS, PX4_FLIGHT)
    path.write_bytes(path.read_bytes() + struct.pack("<HBH", 2, ord("O"), 2500))
    (found,) = diagnose(examine_log(path))
    assert (found.rule, found.severity) == ("log-dropouts", Severity.ADVICE)
    assert "lost 2.5 s" in found.what


def test_armed_on_deck_matters_on_a_ship(tmp_path: Path) -> None:
    rows = [*FLIGHT[:-1], (60.0, "EV", (DISARM,))]
    (found,) = copter(tmp_path, rows)
    assert found.rule == "log-armed-on-deck"
    assert "armed for 20 s after the landing at 40.0 s" in found.what
    snapshot = examine_log(copter_log(tmp_path / "x.bin", ARDUPILOT.parameters, rows))
    assert diagnose(replace(snapshot, moving_pad=False)) == ()


def test_what_happens_before_arming_is_no_fault(tmp_path: Path) -> None:
    still = [
        (0.5, "EV", (DISARM,)),
        *during(0.6, 0.9, "XKF4", 0, 900, 20, 40, 50, 0),
        *during(0.6, 0.9, "VIBE", 0, 99.0, 1.0, 1.0, 9),
    ]
    assert copter(tmp_path, [*FLIGHT, *still]) == ()


def test_a_go_around_is_no_doubt_about_the_landing() -> None:
    meter = LandingMeter()
    meter.flying(3.0)
    meter.landed(40.0)
    meter.flying(42.0)
    meter.landed(80.0)
    meter.disarmed(81.0)
    first, second = meter.landings(90.0)
    assert (first.at_s, first.lost, second.at_s, second.lost, second.armed_s) == (40.0, 0, 80.0, 0, 1.0)


def test_the_command_on_a_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = copter_log(tmp_path / "x.bin", ARDUPILOT.parameters, [*FLIGHT, (41.5, "ERR", (6, 1))])
    code, out = run_doctor(capsys, str(path))
    assert code == 1
    assert out.startswith("ArduPilot 4.5.7, system 1: log of 42 s")
    assert "landing at 40.0 s, taken back by the detector 0 times, armed for 1.0 s after" in out
    assert "error: failsafe: battery at 41.5 s [log-failsafe]" in out
    assert run_doctor(capsys, str(px4_log(tmp_path / "x.ulg", PX4.parameters, TOPICS, PX4_FLIGHT)))[0] == 0


def test_a_log_of_another_kind_of_vehicle_or_of_nothing_is_refused(tmp_path: Path) -> None:
    path = copter_log(tmp_path / "x.bin", {"A": 1.0})
    path.write_bytes(path.read_bytes().replace(b"ArduCopter V4.5.7", b"ArduPlane V4.5.07"))
    with pytest.raises(BadInput, match="a log of ArduPlane"):
        examine_log(path)
    with pytest.raises(BadInput, match="no parameters"):
        examine_log(copter_log(tmp_path / "y.bin", {}))
    with pytest.raises(BadInput, match="no parameters"):
        examine_log(px4_log(tmp_path / "y.ulg", {}, TOPICS))


def test_a_parameter_that_is_no_number_is_left_out(tmp_path: Path) -> None:
    path = px4_log(tmp_path / "x.ulg", PX4.parameters, TOPICS)
    expected = read_history(path).parameters
    key = b"char[4] MPC_TEXT"
    path.write_bytes(path.read_bytes() + struct.pack("<HB", 1 + len(key) + 4, ord("P")) + bytes([len(key)]) + key + b"1e3x")
    assert read_history(path).parameters == expected


@needs_data
def test_recorded_logs_of_both_stacks() -> None:
    old = examine_log(DATA / "arducopter_flight.bin")
    assert [m.what for m in old.log.failsafes] == ["EKF check: variances too large"]
    assert {"log-failsafe", "log-ekf", "firmware-old"} <= (rules := {f.rule for f in diagnose(old)})
    assert "fence" not in rules, "a ceiling that only reports ends no flight"
    assert {f.rule for f in diagnose(examine_log(DATA / "px4_sample.ulg"))} == {
        "px4-offboard-short", "px4-precland-missing", "px4-disarm-late", "px4-return-lands"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("said", "rules"),
    [
        ([(8.0, "Target Found"), (8.6, "Init Failed"), (20.0, "Target Found"), (20.6, "Init Complete")], []),
        ([(8.0, "Init Complete"), (9.0, "Target Lost"), (20.6, "Init Complete"), (39.5, "Target Lost")], []),
        ([(20.6, "Init Complete"), (40.5, "Target Lost")], []),
        ([(20.0, "Target Found"), (20.6, "Init Failed")], ["target-too-rare"]),
        ([(20.6, "Init Complete"), (25.0, "Target Lost")], ["target-lost"]),
    ],
)
def test_only_what_is_still_true_at_the_landing_is_a_fault_of_it(said, rules, tmp_path):
    """ArduCopter begins its estimate on the climb-out, loses the pad on the way, and near the deck again: all of it ends well."""
    assert [f.rule for f in copter(tmp_path, [*FLIGHT, *((at_s, "MSG", (f"PrecLand: {text}",)) for at_s, text in said)])] == rules


def test_a_log_reports_what_its_own_firmware_begins_with(tmp_path: Path) -> None:
    path = copter_log(tmp_path / "x.bin", ARDUPILOT.parameters | {"PSC_POSXY_P": 0.7, "SERIAL1_BAUD": 57.0}, FLIGHT)
    autopilot = examine_log(path).autopilot
    assert autopilot.differs == {}, "a log without defaults says nothing"
    for value, default in ((1.0, 1.0), (1.25, 1.0)):
        rows = [(0.5, "PARM", ("PSC_POSXY_P", value, default)), (0.5, "PARM", ("SERIAL1_BAUD", 57.0, 115.0))]
        autopilot = examine_log(copter_log(path, ARDUPILOT.parameters, [*rows, *FLIGHT], defaults=True)).autopilot
        assert autopilot.differs == ({"PSC_POSXY_P": (1.25, 1.0)} if value != default else {})
