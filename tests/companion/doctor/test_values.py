"""Parameters of both stacks that spoil a landing: each is named with its fix and nothing else; good set-ups are left in peace."""

import math

import pytest
from msgspec.structs import replace

from companion.tools.doctor.diagnose import PARAMETERS, diagnose
from companion.tools.doctor.rules_values import RULES, ValueRule
from companion.tools.doctor.snapshot import Snapshot
from estimator.contracts.ports import Clock
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from tests.companion.doctor.test_rules import ARDUPILOT, BROKEN, GOOD, PX4


def stand_in(stack: str, **changes: float) -> Snapshot:
    """Return a set-up with the parameters of a stand-in: the program's defaults, and those with which `simulate` starts it."""
    clock: Clock = LockStepClock()
    flown = CopterStandIn(clock, changes) if stack == "ArduPilot" else Px4StandIn(clock, changes)
    of = ARDUPILOT if stack == "ArduPilot" else PX4
    asked = {name: value for name, value in flown.parameters.items() if name in PARAMETERS[stack]}
    return replace(GOOD, autopilot=replace(of, parameters=asked))


def documented(stack: str) -> Snapshot:
    """Return a set-up with the values that each fix names."""
    of = ARDUPILOT if stack == "ArduPilot" else PX4
    fixed = {rule.parameter: rule.good for rule in RULES if rule.stack == stack}
    return replace(GOOD, autopilot=replace(of, parameters=of.parameters | fixed))


def plain(stack: str) -> Snapshot:
    return replace(GOOD, autopilot=ARDUPILOT if stack == "ArduPilot" else PX4)


@pytest.mark.parametrize("stack", ["ArduPilot", "PX4"])
@pytest.mark.parametrize("good", [stand_in, documented, plain])
def test_three_good_set_ups_a_stack_are_left_in_peace(stack: str, good: type) -> None:
    assert diagnose(good(stack)) == ()


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
    assert found[0].severity is (rule.lacking if lacks else rule.severity)
    (change,) = found[0].changes
    assert found[0].fix == f"set {rule.parameter} {change.value:g}"
    assert snapshot.autopilot is not None
    assert change.value == snapshot.autopilot.parameters.get(rule.like, rule.good)
    assert diagnose(stand_in(rule.stack, **{rule.parameter: change.value})) == ()
    assert rule.parameter in PARAMETERS[rule.stack], "and it is asked for"


@pytest.mark.parametrize("stack", ["ArduPilot", "PX4"])
def test_forty_broken_set_ups_a_stack_are_named(stack: str) -> None:
    values = {(rule.parameter, value) for rule, value in CASES if rule.stack == stack}
    others = {name for name, (_, s, _) in BROKEN.items() if s.autopilot is not None and s.autopilot.stack == stack}
    assert len(values) + len(others) >= 40


def test_what_matters_on_a_ship_only_is_not_named_ashore() -> None:
    for rule, value in CASES:
        snapshot = replace(stand_in(rule.stack, **{rule.parameter: value}), moving_pad=False)
        assert (rule(snapshot) is None) is rule.on_ship


def test_every_rule_has_a_name_of_its_own() -> None:
    assert len({rule.rule for rule in RULES}) == len(RULES)
    assert len({(rule.stack, rule.parameter) for rule in RULES}) == len(RULES)
