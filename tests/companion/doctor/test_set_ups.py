"""Broken set-ups of both stacks as data: each is named by its rules and by nothing else, on top of each of three good ones."""

import math
import struct
import tomllib
from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.tools.doctor.diagnose import LOG_RULES, PARAMETERS, counted, diagnose
from companion.tools.doctor.diagnose import RULES as ALL_RULES
from companion.tools.doctor.firmware_parameters import RENAMED, defaults_of, differing, earlier_names, names_in
from companion.tools.doctor.gather_outside import examine_log
from companion.tools.doctor.rules_values import RULES, ValueRule
from companion.tools.doctor.snapshot import LinkSnapshot, ServiceSnapshot, Snapshot
from estimator.contracts.time import Clock
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.emulators.autopilots.programs import arducopter
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from tests.companion.doctor.test_rules import ARDUPILOT, BROKEN, GOOD, PLANE, PX4
from tests.support.flight_logs import copter_log, px4_log

DATA = {
    stack: tomllib.loads((Path(__file__).parent / name).read_text())
    for stack, name in (("ArduPilot", "arducopter.toml"), ("PX4", "px4.toml"))
}
GOOD_ONES = [(stack, name) for stack, data in DATA.items() for name in data["good"]]


def set_up(stack: str, good: str, **changes: float) -> Snapshot:
    """Return a good set-up, which begins with the defaults, and changes to it."""
    values = DATA[stack]["good"]["defaults"] | DATA[stack]["good"][good] | changes
    asked = {name: float(value) for name, value in values.items() if name in PARAMETERS[stack]}
    return replace(GOOD, autopilot=replace(ARDUPILOT if stack == "ArduPilot" else PX4, parameters=asked))


@pytest.mark.parametrize(("stack", "name"), GOOD_ONES)
def test_a_good_one_is_left_in_peace(stack: str, name: str) -> None:
    assert diagnose(set_up(stack, name)) == ()
    assert diagnose(replace(set_up(stack, name), moving_pad=False)) == ()


@pytest.mark.parametrize(("stack", "good"), GOOD_ONES)
def test_a_broken_one_is_named_and_its_changes_heal_it(stack: str, good: str) -> None:
    for name, one in DATA[stack]["broken"].items():
        snapshot = replace(set_up(stack, good, **one["set"]), ship_speed_m_s=one.get("ship_speed_m_s"))
        found = diagnose(snapshot)
        assert {f.rule for f in found} >= set(one["rules"]), name
        if good == "defaults":
            assert sorted(f.rule for f in found) == sorted(one["rules"]), name
        assert snapshot.autopilot is not None
        changed = {c.parameter: c.value for f in found for c in f.changes}
        healed = replace(snapshot, autopilot=replace(snapshot.autopilot, parameters=snapshot.autopilot.parameters | changed))
        worse = {f.rule for f in diagnose(healed)} - {f.rule for f in found if not f.changes}
        assert worse == set(), f"{name}: what is offered makes nothing worse"


@pytest.mark.parametrize("stack", DATA)
def test_a_log_of_a_broken_one_names_the_same(stack: str, tmp_path: Path) -> None:
    for name, one in DATA[stack]["broken"].items():
        values = DATA[stack]["good"]["defaults"] | one["set"]
        log = copter_log(tmp_path / "x.bin", values) if stack == "ArduPilot" else px4_log(tmp_path / "x.ulg", values, {})
        found = diagnose(replace(examine_log(log), ship_speed_m_s=one.get("ship_speed_m_s")))
        assert sorted(f.rule for f in found) == sorted(one["rules"]), name


def test_every_rule_has_a_broken_set_up() -> None:
    snapshots = [broken for _, broken, _ in BROKEN.values()]
    snapshots += [set_up(stack, "defaults", **one["set"]) for stack, data in DATA.items() for one in data["broken"].values()]
    fired = {rule for rule in ALL_RULES for snapshot in snapshots if rule(snapshot) is not None}
    assert fired >= set(ALL_RULES) - {*RULES, *LOG_RULES}, "those have tests of their own"


def in_32_bits(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def test_under_the_names_and_units_of_arducopter_4_7_the_same_rules_are_broken_and_the_same_heals() -> None:
    for one in DATA["ArduPilot"]["broken"].values():
        old = replace(set_up("ArduPilot", "defaults", **one["set"]), ship_speed_m_s=one.get("ship_speed_m_s"))
        assert old.autopilot is not None
        new_names = {}
        for parameter, value in old.autopilot.parameters.items():
            later = RENAMED.get(parameter)
            new_names[parameter if later is None else later.name] = value if later is None else in_32_bits(value * later.factor)
        autopilot = replace(old.autopilot, firmware=(4, 7, 0), parameters=new_names)
        found = diagnose(replace(old, autopilot=autopilot))
        assert [f.rule for f in found] == [f.rule for f in diagnose(old)]
        changes = {c.parameter: c.value for f in found for c in f.changes}
        assert set(changes) <= set(new_names)
        healed = replace(old, autopilot=replace(autopilot, parameters=new_names | changes))
        assert {f.rule for f in diagnose(healed)} <= {f.rule for f in found if not f.changes}


def test_a_later_name_is_reported_in_its_own_unit() -> None:
    autopilot = replace(ARDUPILOT, firmware=(4, 7, 0), parameters={"LAND_SPD_MS": in_32_bits(2.5), "ARMING_SKIPCHK": -1.0})
    speed, skipped = diagnose(replace(GOOD, autopilot=autopilot))
    assert speed.what.startswith("LAND_SPD_MS is 2.5: it strikes the deck")
    assert speed.fix == "set LAND_SPD_MS 0.4"
    assert skipped.rule == "arming-skipped"


def test_each_firmware_is_queried_by_its_own_names() -> None:
    names = ("LAND_SPEED", "GPS_RATE_MS", "GUID_TIMEOUT")
    assert names_in(names, None) == names_in(names, (4, 5, 7)) == names
    assert names_in(names, (4, 6, 2)) == ("LAND_SPEED", "GPS1_RATE_MS", "GUID_TIMEOUT")
    assert names_in(names, (4, 7, 0)) == ("LAND_SPD_MS", "GPS1_RATE_MS", "GUID_TIMEOUT")
    assert names_in(("ARMING_SKIPCHK",), (4, 5, 7)) == ()


def test_limits_of_speed_are_judged_against_the_ship_s() -> None:
    slow = replace(set_up("PX4", "defaults", MPC_XY_VEL_MAX=7.0), ship_speed_m_s=2.0)
    assert [f.rule for f in diagnose(slow)] == ["px4-land-way"]
    (speed, way) = diagnose(replace(slow, ship_speed_m_s=6.0))
    assert (speed.rule, way.rule) == ("px4-speed-limit", "px4-land-way")
    assert speed.what == "MPC_XY_VEL_MAX is 7: it cannot overtake the ship (she makes 6 m/s)"
    assert speed.fix == "set MPC_XY_VEL_MAX 12"
    assert way.fix == "set LNDMC_XY_VEL_MAX 6.5"


def stand_in(stack: str, **changes: float) -> Snapshot:
    """Return a set-up with the parameters of a stand-in: the program's defaults, and those with which `simulate` starts it."""
    if stack == "ArduPlane":  # it has none: those of the program alone
        started = {n: v for n, v in arducopter.PLANE.items() if n in PARAMETERS[stack]}
        return replace(GOOD, autopilot=replace(PLANE, parameters=PLANE.parameters | started | changes))
    clock: Clock = LockStepClock()
    flown = CopterStandIn(clock, changes) if stack == "ArduPilot" else Px4StandIn(clock, changes)
    of = ARDUPILOT if stack == "ArduPilot" else PX4
    asked = {name: value for name, value in flown.parameters.items() if name in PARAMETERS[stack]}
    return replace(GOOD, autopilot=replace(of, parameters=asked))


def wrong_values(rule: ValueRule) -> list[float]:
    out = list(rule.wrong)
    if math.isfinite(rule.low):
        out.append(rule.low - max(0.1, 0.2 * abs(rule.low)))
    if math.isfinite(rule.high):
        out.append(rule.high + max(0.1, 0.2 * abs(rule.high)))
    out += [float(int(rule.good) | 1 << k) for k in range(12) if rule.bits >> k & 1]
    out += [float(int(rule.good) & ~(1 << k)) for k in range(12) if rule.needed >> k & 1]
    return out


CASES = [(rule, value) for rule in RULES for value in wrong_values(rule)]


@pytest.mark.parametrize(("rule", "value"), CASES, ids=[f"{rule.parameter}={value:g}" for rule, value in CASES])
def test_a_value_that_spoils_a_landing_is_named_with_its_fix_and_nothing_else(rule: ValueRule, value: float) -> None:
    snapshot = stand_in(rule.stack, **{rule.parameter: value})
    found = diagnose(snapshot)
    assert [f.rule for f in found] == [rule.rule]
    assert rule.parameter in found[0].what
    lacks = rule.lacking is not None and not int(value) & rule.bits
    severity, why = rule.lacking if rule.lacking is not None and lacks else (rule.severity, rule.why)
    assert (found[0].severity, why in found[0].what) == (severity, True)
    if rule.by_hand:
        assert (found[0].changes, rule.by_hand in found[0].fix) == ((), True)
        return
    (change,) = found[0].changes
    assert found[0].fix == f"set {rule.parameter} {change.value:g}"
    assert change.value == snapshot.autopilot.parameters.get(rule.like, rule.good)
    assert diagnose(stand_in(rule.stack, **{rule.parameter: change.value})) == ()
    assert rule.parameter in PARAMETERS[rule.stack], "and it is asked for"


def test_no_change_that_is_offered_switches_a_protection_off() -> None:
    broken = [stand_in(rule.stack, **{rule.parameter: value}) for rule, value in CASES]
    broken += [set_up(stack, good, **one["set"]) for stack, good in GOOD_ONES for one in DATA[stack]["broken"].values()]
    changes = [change for snapshot in broken for finding in diagnose(snapshot) for change in finding.changes]
    assert len(changes) > 400
    off = DATA["ArduPilot"]["off"] | DATA["PX4"]["off"]
    assert [change for change in changes if change.value in off.get(change.parameter, ())] == []


def test_what_matters_on_a_ship_only_is_not_named_ashore() -> None:
    for rule, value in CASES:
        snapshot = replace(stand_in(rule.stack, **{rule.parameter: value}), moving_pad=False)
        assert (rule(snapshot) is None) is rule.on_ship


def test_the_last_line_says_what_was_judged_and_what_was_not() -> None:
    down = Snapshot(4.0, (LinkSnapshot("serial:///dev/ttyNOPE:921600", down="no such file"),))
    left = "not judged: an autopilot (no link is open)\n1 of the known faults found"
    assert counted(down, 1) == f"judged: the links\n{left}"
    service = ServiceSnapshot(camera_size=(640, 360), device_fault="not there", broker="ship:1883")
    assert counted(replace(down, service=service), 1) == (
        f"judged: the links; the settings and their files; the camera; the broker\n{left}"
    )
    some = dict(list(ARDUPILOT.parameters.items())[:3])
    few = counted(Snapshot(0.0, autopilot=replace(ARDUPILOT, parameters=some, absent=("PLND_LAG",))), 0)
    assert few.startswith("judged: 4 of 90 parameters\nnot judged: parameters that were not read: PLND_OPTIONS, ")
    assert few.endswith("none of the known faults found")


def test_every_rule_has_a_name_of_its_own() -> None:
    assert len({rule.rule for rule in RULES}) == len(RULES)
    assert len({(rule.stack, rule.parameter) for rule in RULES}) == len(RULES)


@pytest.mark.parametrize(
    ("stack", "firmware"), [("ArduPilot", (4, 5, 7)), ("ArduPilot", (4, 7, 1)), ("PX4", (1, 16, 2)), ("PX4", (1, 17, 0))]
)
def test_a_firmware_s_own_defaults_differ_in_nothing_and_each_of_them_is_looked_at(stack, firmware):
    defaults = defaults_of(stack, firmware)
    assert differing(defaults, defaults) == {}
    other = {name: value + 1.0 for name, value in defaults.items()}
    assert differing(other, defaults) == {name: (value + 1.0, value) for name, value in sorted(defaults.items())}


def test_later_releases_are_queried_by_their_names_and_judged_in_their_units() -> None:
    old, new = defaults_of("ArduPilot", (4, 5, 7)), defaults_of("ArduPilot", (4, 7, 0))
    assert (old["PSC_ACCZ_P"], new["PSC_D_ACC_P"], new["WP_SPD"]) == (0.5, 0.05, 10.0)
    assert not set(new) & {name for name, later in RENAMED.items() if later.name != name}
    assert differing({"PSC_D_ACC_P": 0.05000000074505806, "WP_SPD": 3.0}, new) == {"WP_SPD": (3.0, 10.0)}
    assert defaults_of("other", None) == {}


def test_a_development_build_that_has_the_earlier_names_is_judged_by_them() -> None:
    read = {"WPNAV_SPEED": 300.0, "LAND_SPD_MS": 0.5}
    assert earlier_names({"WP_SPD", "PLND_ENABLED"}) == ("WPNAV_SPEED",)
    assert differing(read, defaults_of("ArduPilot", (4, 7, 0), read)) == {"WPNAV_SPEED": (300.0, 1000.0)}


def test_a_default_that_a_release_changed_is_judged_by_the_release() -> None:
    assert [defaults_of("PX4", (1, minor, 0))["MC_ROLL_P"] for minor in (15, 16, 17)] == [6.5, 6.5, 4]


def test_what_no_landing_feels_is_left_out() -> None:
    changed = {"SERIAL1_BAUD": 57.0, "COM_FLIGHT_UUID": 9.0, "EKF2_IMU_CTRL": 3.0}
    assert list(differing(changed, dict.fromkeys(changed, 1.0))) == ["EKF2_IMU_CTRL"]
