"""Broken set-ups of both stacks as data: each is named by its rules and by nothing else, on top of each of three good ones."""

import struct
import tomllib
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from companion.tools.doctor import rules_values
from companion.tools.doctor.diagnose import PARAMETERS, diagnose
from companion.tools.doctor.firmware_parameters import RENAMED, names_in
from companion.tools.doctor.gather import examine_log
from companion.tools.doctor.snapshot import Snapshot
from tests.companion.doctor.test_rules import ARDUPILOT, GOOD, PX4
from tests.support.flight_logs import dataflash, ulog

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
        log = dataflash(tmp_path / "x.bin", values) if stack == "ArduPilot" else ulog(tmp_path / "x.ulg", values, {})
        found = diagnose(replace(examine_log(log), ship_speed_m_s=one.get("ship_speed_m_s")))
        assert sorted(f.rule for f in found) == sorted(one["rules"]), name


def judged_alike(one: dict[str, Any]) -> None:
    """Show that a set-up under the names and units of ArduCopter 4.7 breaks the same rules, and that the same heals it."""
    old = replace(set_up("ArduPilot", "defaults", **one["set"]), ship_speed_m_s=one.get("ship_speed_m_s"))
    assert old.autopilot is not None
    new_names = {}
    for parameter, value in old.autopilot.parameters.items():
        later = RENAMED.get(parameter)
        new_names[parameter if later is None else later.name] = value if later is None else in_32_bits(value * later.factor)
    new = replace(old, autopilot=replace(old.autopilot, firmware=(4, 7, 0), parameters=new_names))
    found = diagnose(new)
    assert [f.rule for f in found] == [f.rule for f in diagnose(old)]
    changes = {c.parameter: c.value for f in found for c in f.changes}
    assert new.autopilot is not None
    assert set(changes) <= set(new_names)
    healed = replace(new, autopilot=replace(new.autopilot, parameters=new_names | changes))
    assert {f.rule for f in diagnose(healed)} <= {f.rule for f in found if not f.changes}


def test_the_names_and_units_of_arducopter_4_7_are_judged_alike() -> None:
    for one in DATA["ArduPilot"]["broken"].values():
        judged_alike(one)


def in_32_bits(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


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


def test_there_are_forty_of_each_stack() -> None:
    for data in DATA.values():
        assert len(data["broken"]) >= 40
        assert len(data["good"]) == 3


def test_each_parameter_that_a_single_rule_judges_is_broken_or_good_in_the_data() -> None:
    for stack, data in DATA.items():
        reported = {name for one in data["broken"].values() for name in one["set"]} | set(data["good"]["defaults"])
        left = {rule.parameter for rule in rules_values.RULES if rule.stack == stack} - reported
        assert left <= {"INS_HNTC2_FREQ", "ARMING_SKIPCHK"}
        assert set(rules_values.FAILSAFE_PARAMETERS[stack]) <= reported


def test_limits_of_speed_are_judged_against_the_ship_s() -> None:
    slow = replace(set_up("PX4", "defaults", MPC_XY_VEL_MAX=7.0), ship_speed_m_s=2.0)
    assert [f.rule for f in diagnose(slow)] == ["px4-land-way"]
    (speed, way) = diagnose(replace(slow, ship_speed_m_s=6.0))
    assert (speed.rule, way.rule) == ("px4-speed-limit", "px4-land-way")
    assert speed.what == "MPC_XY_VEL_MAX is 7: it cannot overtake the ship (she makes 6 m/s)"
    assert speed.fix == "set MPC_XY_VEL_MAX 12"
    assert way.fix == "set LNDMC_XY_VEL_MAX 6.5"
