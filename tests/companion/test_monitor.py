"""The run-time monitor: whatever the velocity's error, the way that is flown unseen is bounded, and a right velocity flies on.

The vehicle here closes its loop on the measured velocity within half a second, and its own hold is right, as a simulated
AR.Drone's is. What holds for a hold that follows the same sensor is a test of its own.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.mission import ReasonCause, State
from companion.guidance.monitor import CHECK_M, RULES, STICK_M_S, WAY_M, FlownBy, Monitor, Witnesses, commanded, watched
from companion.guidance.operator.command_limits import Fixed
from companion.guidance.pilot import make_pilot
from companion.settings.load import load
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.geometry import F64, GeoPoint, Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, VehicleStatus
from estimator.contracts.time import after
from tests.make import ns, stamp_at

DT_S, ANSWERS_S = 0.05, 0.5
NOUGHT, ORIGIN = np.zeros(2), GeoPoint(0.7, 0.1)
LEG = Velocity(np.array([0.4, 0.0, 0.0]), 0.0)
BLIND = Lean(np.zeros(2), np.zeros(2), np.zeros(3), 0.0)


class Flown:
    """A flight out of sight: guidance wants one command, and flies what the monitor leaves of it."""

    def __init__(self, *, over_ground: bool = False) -> None:
        self.m, self.at_s, self.over_ground = Monitor(), 0.0, over_ground
        self.v, self.p, self.error = NOUGHT, NOUGHT, NOUGHT
        self.reasons: list[ReasonCause] = []
        self.fixed = self.holds_by_sensor = False
        self.way = NOUGHT

    def step(self, wanted: Command, error: F64, *, sight: F64 | None = None, by_hand: bool = False) -> None:
        """Fly for a cycle; `error` is measured less true velocity, `sight` the pad's true velocity over the ground."""
        measured = self.v + error
        leap, self.error = error - self.error, error
        self.way = self.way + DT_S * measured
        fixed = Fixed(ORIGIN, (0.0, 0.0), ns(self.at_s), tuple(self.p), tuple(self.way)) if self.fixed else None
        leapt = tuple(leap) if math.hypot(*leap) > 0.8 else (0.0, 0.0)
        seen = None if sight is None else sight - self.v
        self.m = watched(self.m, Witnesses(ns(self.at_s), measured, seen, leapt, fixed, self.over_ground))
        refusal = self.m.refusal(by_hand=by_hand)
        command = wanted if refusal is None else BLIND if by_hand else Hover()
        if refusal is not None and (not self.reasons or self.reasons[-1] is not refusal.cause):
            self.reasons.append(refusal.cause)
        self.m = commanded(self.m, command, by_hand=by_hand, trusted=refusal is None)
        held = isinstance(command, Hover)
        target = -error if held and self.holds_by_sensor else NOUGHT if held else np.asarray(command.v_level[:2]) - error
        target = np.asarray(wanted.v_level[:2]) if by_hand and refusal is not None else target
        self.v = self.v + DT_S / ANSWERS_S * (target - self.v)
        self.p, self.at_s = self.p + DT_S * self.v, self.at_s + DT_S

    def fly(self, seconds: float, wanted: Command, error: F64 = NOUGHT, **how: object) -> "Flown":
        for _ in range(round(seconds / DT_S)):
            self.step(wanted, error, **how)  # type: ignore[arg-type]
        return self

    @property
    def away_m(self) -> float:
        return math.hypot(*self.p)


directions = st.floats(0.0, math.tau).map(lambda a: np.array([math.cos(a), math.sin(a)]))


@pytest.mark.hazard("H7", "A11")
@settings(max_examples=15)
@given(st.floats(0.5, 5.0), directions, st.floats(0.0, 20.0), st.booleans(), st.booleans())
def test_a_constant_error_of_any_size_and_begin_flies_no_farther_than_a_small_ship_is_long(size, along, at_s, seen, estimate):
    """The legs of the search themselves are part of the way; an error within a deck's edge is known from the leap."""
    f = Flown()
    if seen:
        f.fly(2.0, Hover(), sight=NOUGHT)
    f.fly(1.0, Hover(), size * along if at_s == 0.0 else NOUGHT).fly(at_s, LEG)
    before = f.p
    f.fly(90.0, BLIND if estimate else LEG, size * along)
    legs_m = 0.4 * WAY_M / 0.2
    unseen_m = math.hypot(*(f.p - before)) - (0.0 if estimate else legs_m)
    assert unseen_m < WAY_M + 5.0
    assert f.m.flown is FlownBy.OWN_HOLD


@pytest.mark.hazard("H7")
@settings(max_examples=10)
@given(st.floats(0.02, 0.3), directions)
def test_an_error_that_grows_is_bounded_too(rate, along):
    f = Flown().fly(1.0, Hover())
    for _ in range(round(80.0 / DT_S)):
        f.step(LEG, rate * f.at_s * along)
    assert f.away_m < WAY_M + 20.0
    assert f.m.refuses is not None


def test_a_right_velocity_flies_the_legs_of_a_search_with_short_holds_between_them() -> None:
    f = Flown().fly(1.0, Hover())
    held = 0
    for n in range(round(14.0 / DT_S)):
        f.step(LEG, 0.1 * np.array([math.sin(n / 7.0), math.cos(n / 11.0)]))
        held += f.m.flown is FlownBy.OWN_HOLD
    assert f.reasons == [ReasonCause.UNCHECKED]
    assert held * DT_S < 5.0
    assert f.m.fault is None
    assert f.m.refuses is None


@pytest.mark.hazard("A11")
def test_distrust_lasts_until_the_pad_is_seen_and_no_time_ends_it() -> None:
    error = np.array([2.0, 0.0])
    f = Flown().fly(1.0, Hover()).fly(20.0, LEG, error)
    assert f.m.fault.cause is ReasonCause.MOVES_IN_HOLD
    # A wrong velocity that becomes right by itself is not believed for that.
    before = f.away_m
    f.fly(300.0, LEG)
    assert f.m.fault is not None
    assert f.away_m == pytest.approx(before, abs=0.1)
    f.fly(0.1, LEG, sight=NOUGHT)
    assert f.m.fault is None
    assert f.m.refusal(by_hand=False) is None
    assert f.m.refuses is None


def test_guidance_refuses_with_the_number_once_it_has_waited_for_the_sight() -> None:
    f = Flown().fly(1.0, Hover()).fly(8.0, LEG, np.array([0.0, 3.0]))
    assert f.m.refuses is None
    f.fly(10.0, LEG, np.array([0.0, 3.0]))
    assert f.m.refuses is not None
    assert "3.0 m/s" in f.m.refuses.text


def test_what_its_own_hold_follows_as_well_nobody_knows_and_the_way_bounds_what_guidance_flies() -> None:
    f = Flown()
    f.holds_by_sensor = True
    flown_m = 0.0
    for _ in range(round(120.0 / DT_S)):
        f.step(LEG, np.array([0.0, 1.0]))
        flown_m += DT_S * math.hypot(*f.v) if f.m.flown is FlownBy.VELOCITY else 0.0
    assert f.m.refuses is not None
    assert f.m.refuses.cause is ReasonCause.UNCONFIRMED
    assert flown_m < 70.0


@pytest.mark.hazard("H7", "A4")
def test_a_stick_is_flown_by_no_velocity_that_leapt_farther_than_a_ship_sails() -> None:
    stick = Velocity(np.array([0.2, 0.0, 0.0]), 0.0)
    f = Flown().fly(2.0, stick, sight=NOUGHT, by_hand=True)
    assert f.m.refusal(by_hand=True) is None
    f.fly(2.0, stick, np.array([5.0, 0.0]), by_hand=True)
    why = f.m.refusal(by_hand=True)
    assert why.cause is ReasonCause.DOUBTFUL
    assert why.measured == pytest.approx(6.0, abs=0.1)
    assert f.away_m < 1.0
    # In sight the sightings say how far it is off, and a hold that shows nothing wrong ends it out of sight.
    f.fly(3.0, stick, np.array([STICK_M_S + 1.0, 0.0]), sight=NOUGHT, by_hand=True)
    assert f.m.refusal(by_hand=True) is not None
    f.fly(3.0, stick, sight=NOUGHT, by_hand=True)
    assert f.m.refusal(by_hand=True) is None


def test_a_person_flies_on_without_sight_where_nothing_contradicts_his_velocity() -> None:
    stick = Velocity(np.array([1.0, 0.0, 0.0]), 0.0)
    f = Flown().fly(1.0, Hover()).fly(120.0, stick, by_hand=True)
    assert not f.reasons
    assert f.away_m > 100.0
    assert f.m.place_m_s == pytest.approx(0.1)


@pytest.mark.hazard("H7")
def test_a_velocity_over_the_ground_is_held_to_the_positions() -> None:
    right = Flown(over_ground=True)
    right.fixed = True
    right.fly(60.0, LEG)
    assert not right.reasons
    assert right.away_m > 20.0
    wrong = Flown(over_ground=True)
    wrong.fixed = True
    wrong.fly(30.0, LEG, np.array([0.0, 3.0]))
    assert wrong.reasons == [ReasonCause.OFF_POSITION]
    assert wrong.away_m < 15.0
    # They agree again.
    wrong.fly(4.0, LEG)
    assert wrong.m.refusal(by_hand=False) is None


def test_a_velocity_over_the_ground_differs_from_the_sightings_by_the_way_of_a_fast_ship() -> None:
    f = Flown(over_ground=True).fly(20.0, LEG, sight=np.array([7.0, 0.0]), by_hand=True)
    assert not f.reasons
    assert f.m.error_m_s == 1.0


def test_positions_carry_a_search_over_any_way_and_a_flow_over_a_ship_is_no_lie() -> None:
    f = Flown()
    f.fixed = True
    f.fly(100.0, LEG, np.array([5.0, 0.0]))
    assert not f.reasons


@pytest.mark.hazard("A11")
@pytest.mark.parametrize("command", [None, Hover(), LEG, BLIND])
@pytest.mark.parametrize("by_hand", [False, True])
def test_with_the_pad_in_sight_guidance_is_never_held_back(command: Command | None, by_hand: bool) -> None:
    f = Flown()
    f.m = commanded(f.m, command, by_hand=by_hand, trusted=True)
    f.fly(30.0, LEG, np.array([8.0, 0.0]), sight=np.array([5.0, 0.0]))
    assert not f.reasons


def test_the_page_has_the_rules_as_the_code_has_them() -> None:
    page = Path("docs/monitor.md").read_text()
    for name, rule in RULES.items():
        assert f"| {name} | {rule.watches} | {rule.witness} | {rule.limit} | {rule.recovery} |" in page
    assert f"{CHECK_M:g} m" in page


@pytest.mark.hazard("H7")
def test_the_pilot_holds_refuses_with_the_number_and_forgets_on_the_ground() -> None:
    pilot, now = make_pilot(load("sim")), ns(1.0)
    for n in range(500):
        now = after(now, 0.05)
        v = np.array([2.0 + 1e-3 * (-1) ** n, 0.0, 0.0])
        pilot.on_sample(Attitude(stamp_at(now), Rotation.from_rpy(0.0, 0.0, 0.0), 1e-5 * np.eye(3)))
        pilot.on_sample(BodyVelocity(stamp_at(now), v, 0.01 * np.eye(3)))
        pilot.on_sample(VehicleStatus(stamp_at(now), True, "flying", 0.9, False, True))
        decision = pilot.decide(now)
        assert isinstance(decision.command, Hover)
    assert pilot.state is State.REFUSED
    assert "2.0 m/s (limit 1 m/s)" in decision.reason
    pilot.on_sample(VehicleStatus(stamp_at(now), False, "landed", 0.9, False, True))
    pilot.decide(now)
    assert pilot.monitor.fault is None
    assert pilot.monitor.way_m == 0.0
