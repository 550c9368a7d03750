"""Readings at each edge: a limit may be reached and not passed, a step in its time, a repeat for so long."""

import math

import numpy as np
import pytest
from msgspec import structs

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, VesselReport
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.sensors import Reading, SensorWatch, watch

LIMITS = IntegrityOptions()
S, MS = 1_000_000_000, 1_000_000
T = 10 * S


def at(t: int) -> Stamp:
    return Stamp(MonoNs(t), MonoNs(t), 0.001, "sim")


def imu(t: int, f: float = 9.8, w: float = 0.1) -> Imu:
    return Imu(at(t), np.array([w, 0.0, 0.0]), np.array([0.0, 0.0, -f]))


def velocity(t: int, v: tuple[float, float, float], var: float = 0.01) -> BodyVelocity:
    return BodyVelocity(at(t), np.array(v), np.diag([var, 0.01, 1e3]))


def vessel(t: int, v: float) -> VesselReport:
    return VesselReport(at(t), np.array([0.0, v, 0.0]), np.eye(3), None, None)


def roll(t: int, rad: float) -> Attitude:
    return Attitude(at(t), Rotation.from_rpy(rad, 0.0, 1.0), np.eye(3))


def baro(t: int, height_m: float) -> Baro:
    return Baro(at(t), height_m, 0.5)


def said(*events: Reading) -> list[Verdict | None]:
    state, out = SensorWatch(), []
    for event in events:
        state, verdict = watch(state, event, LIMITS, True)
        out.append(verdict)
    return out


@pytest.mark.parametrize(
    ("reached", "passed"),
    [
        (imu(T, f=80.0), imu(T, f=80.01)),
        (imu(T, w=math.radians(2000.0)), imu(T, w=math.radians(2000.1))),
        (velocity(T, (20.0, 0.0, 500.0)), velocity(T, (20.01, 0.0, 0.0))),
        (velocity(T, (30.0, 0.0, 0.0), var=1000.0), velocity(T, (30.0, 0.0, 0.0), var=999.0)),
        (vessel(T, 20.0), vessel(T, 20.01)),
    ],
    ids=["specific force", "turn rate", "speed", "speed that is measured", "vessel"],
)
def test_a_limit_may_be_reached(reached: Reading, passed: Reading) -> None:
    assert said(reached) == [None]
    assert said(passed) == [Verdict.IMPOSSIBLE]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_speed_is_that_of_the_components_that_were_measured(axis: int) -> None:
    var = np.full(3, 1e3)
    var[axis] = 0.01
    for speed, verdict in ((20.0, None), (-20.0, None), (20.01, Verdict.IMPOSSIBLE)):
        v = np.full(3, 500.0)
        v[axis] = speed
        assert said(BodyVelocity(at(T), v, np.diag(var))) == [verdict]


def test_a_step_on_its_limit_is_possible() -> None:
    assert said(velocity(T, (0.0, 0.0, 0.0)), velocity(T + S, (4.5, 0.0, 0.0))) == [None, None]
    assert said(baro(T, 0.0), baro(T + S, 7.0)) == [None, None]
    half_turn = structs.replace(LIMITS, tilt_step_rad=math.pi - 0.1 * LIMITS.tilt_rate_max_rad_s)
    state, _ = watch(SensorWatch(), roll(T, 0.0), half_turn, True)
    assert watch(state, roll(T + S, math.pi), half_turn, True)[1] is None


def test_upside_down_at_once_is_a_step() -> None:
    assert said(roll(T, 0.0), roll(T + 20 * MS, math.pi))[1] is Verdict.IMPOSSIBLE


@pytest.mark.parametrize(
    ("roll_rad", "pitch_rad"), [(2.315840312948539, -0.08309898974996566), (0.6869503213152144, -0.3514859733064353)]
)
def test_upside_down_is_a_step_though_rounding_puts_the_poles_farther_apart_than_two(roll_rad: float, pitch_rad: float) -> None:
    poles = [Rotation.from_rpy(roll_rad, pitch_rad, 1.0), Rotation.from_rpy(roll_rad + math.pi, -pitch_rad, 1.0)]
    assert math.dist(*(pole.matrix[2].tolist() for pole in poles)) > 2.0
    upright, over = (Attitude(at(T + i * 20 * MS), pole, np.eye(3)) for i, pole in enumerate(poles))
    assert said(upright, over) == [None, Verdict.IMPOSSIBLE]


def test_readings_that_nobody_compares_may_step() -> None:
    assert said(imu(T, f=0.0), imu(T + MS, f=79.0)) == [None, None]
    assert said(vessel(T, 0.0), vessel(T + MS, 19.0)) == [None, None]


def test_a_reading_of_the_same_instant_or_from_before_is_compared_with_none() -> None:
    for t in (T, T - MS):
        assert said(baro(T, 0.0), baro(t, 30.0)) == [None, None]


def test_a_step_is_let_through_when_it_has_lasted_for_its_time_unbroken() -> None:
    begin = T + 100 * MS
    refused = [baro(begin, 30.0), baro(begin + 499 * MS, 31.0)]
    assert said(baro(T, 0.0), *refused, baro(begin + 500 * MS, 30.0))[1:] == [Verdict.IMPOSSIBLE] * 2 + [None]
    broken = said(baro(T, 0.0), *refused, baro(begin + 499 * MS + 1, 0.1), baro(begin + 600 * MS, 30.0))
    assert broken[3:] == [None, Verdict.IMPOSSIBLE]


def test_a_repeat_is_frozen_after_its_time_and_reports_it_until_a_bit_changes() -> None:
    state, _ = watch(SensorWatch(), baro(T, 1.0), LIMITS, True)
    state, verdict = watch(state, baro(T + 2 * S, 1.0), LIMITS, True)
    assert (verdict, state.frozen) == (None, False)
    frozen, verdict = watch(state, baro(T + 2 * S + MS, 1.0), LIMITS, True)
    assert (verdict, frozen.frozen) == (Verdict.FROZEN, True)
    assert not watch(frozen, baro(T + 2 * S + 2 * MS, 1.1), LIMITS, True)[0].frozen
    assert said(baro(T, 1.0), baro(T + S, 1.5), baro(T + 3 * S, 1.5))[2] is None, "counted from its own first"


def test_a_repeat_beyond_the_limits_is_impossible_first() -> None:
    assert said(imu(T, f=90.0), imu(T + S, f=90.0)) == [Verdict.IMPOSSIBLE] * 2
    assert said(imu(T), imu(T + 140 * MS), imu(T + 160 * MS)) == [None, None, Verdict.FROZEN]


def test_a_vessels_report_may_repeat_for_ever() -> None:
    assert said(vessel(T, 1.0), vessel(T + 3600 * S, 1.0)) == [None, None]
