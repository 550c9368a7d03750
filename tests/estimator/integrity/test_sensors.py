"""Readings that cannot be: beyond the vehicle, a step it cannot make, or not one bit of change."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.sensors import Reading, SensorWatch, watch_reading

LIMITS = IntegrityOptions()
RNG = np.random.default_rng(5)
FLIGHT = Path(__file__).parents[3] / "../shared/data/flight_with_mocap"


def at(t_s: float) -> Stamp:
    t = MonoNs(round(t_s * 1e9))
    return Stamp(t, t, 0.001, "sim")


def imu(t_s: float, f: tuple[float, float, float] | None = None, w: tuple[float, float, float] | None = None) -> Imu:
    noise = RNG.normal(0, 0.01, 3)
    return Imu(at(t_s), noise if w is None else np.array(w), np.array([0, 0, -9.8]) + noise if f is None else np.array(f))


def velocity(t_s: float, v: tuple[float, float, float]) -> BodyVelocity:
    return BodyVelocity(at(t_s), np.array(v), np.diag([0.01, 0.01, UNKNOWN_VAR]))


def run(events: list[Reading], flying: bool = True) -> list[Verdict | None]:
    state, out = SensorWatch(), []
    for event in events:
        state, verdict = watch_reading(state, event, LIMITS, flying)
        out.append(verdict)
    return out


@pytest.mark.parametrize(
    "event",
    [
        imu(1.0, f=(1e4, 0, 0)),
        imu(1.0, f=(0, 0, -81.0)),
        imu(1.0, w=(0, 36.0, 0)),
        velocity(1.0, (20.1, 0, 0)),
        VesselReport(at(1.0), np.array([21.0, 0, 0]), np.eye(3), None, None),
    ],
    ids=["accelerometer spike", "9 g", "gyro", "velocity", "vessel"],
)
def test_what_no_vehicle_does_is_impossible(event: Reading) -> None:
    assert run([event]) == [Verdict.IMPOSSIBLE]


@pytest.mark.parametrize(
    "event",
    [
        imu(1.0, f=(0, 0, -79.0)),
        imu(1.0, w=(34.0, 0, 0)),
        velocity(1.0, (19.9, 0, 999.0)),
        VesselReport(at(1.0), None, None, 1.0, 0.1),
    ],
    ids=["8 g", "gyro", "velocity whose unmeasured axis says anything", "vessel without velocity"],
)
def test_what_a_vehicle_may_do_is_let_through(event: Reading) -> None:
    assert run([event]) == [None]


@pytest.mark.parametrize(
    ("make", "frozen_s"),
    [
        (lambda t: imu(t, (0.1, 0.2, -9.8), (0.0, 0.0, 0.1)), LIMITS.imu_frozen_s),
        (lambda t: Attitude(at(t), Rotation.identity(), np.eye(3)), LIMITS.attitude_frozen_s),
        (lambda t: velocity(t, (0.0, 0.0, 0.0)), LIMITS.velocity_frozen_s),
        (lambda t: Range(at(t), 1.234, 0.02), LIMITS.range_frozen_s),
        (lambda t: Baro(at(t), 1.234, 0.02), LIMITS.baro_frozen_s),
    ],
    ids=["imu", "attitude", "velocity", "range", "baro"],
)
def test_a_reading_that_holds_to_the_bit_is_frozen_after_its_time_and_in_flight_alone(make, frozen_s: float) -> None:
    events = [make(0.005 * i) for i in range(round(frozen_s / 0.005) + 20)]
    output = run(events)
    assert output[: round(frozen_s / 0.005)] == [None] * round(frozen_s / 0.005)
    assert output[-1] is Verdict.FROZEN
    assert set(run(events, flying=False)) == {None}


def test_one_changed_bit_thaws_it() -> None:
    still = [imu(0.005 * i, (0.1, 0.2, -9.8), (0.0, 0.0, 0.1)) for i in range(100)]
    assert run([*still, imu(0.6)])[-2:] == [Verdict.FROZEN, None]


def test_a_spike_of_velocity_or_tilt_or_height_is_refused_and_a_lasting_step_is_let_through() -> None:
    def stepping(make, low, high) -> list[Reading]:
        return [make(0.02 * i, high if i >= 50 else low) for i in range(100)]

    for make, low, high in (
        (lambda t, v: velocity(t, (v + 1e-3 * np.sin(t), 0, 0)), 0.0, 6.0),
        (lambda t, roll: Attitude(at(t), Rotation.from_rpy(roll + 1e-3 * np.sin(t), 0, 1.0), np.eye(3)), 0.0, 1.4),
        (lambda t, h: Baro(at(t), h + 1e-3 * np.sin(t), 0.5), 0.0, 30.0),
    ):
        output = run(stepping(make, low, high))
        assert output[:50] == [None] * 50
        assert output[50:74] == [Verdict.IMPOSSIBLE] * 24
        assert output[-1] is None


def test_a_turn_of_heading_is_no_step_of_tilt() -> None:
    assert run([Attitude(at(0.02 * i), Rotation.from_rpy(0.001 * i, 0, 1.5 * i), np.eye(3)) for i in range(20)]) == [None] * 20


@pytest.mark.skipif(not FLIGHT.is_dir(), reason="the recorded flight is not on this machine")
def test_nothing_of_a_real_flight_is_refused() -> None:
    """Real noise, real repeats: 41 s of an AR.Drone's IMU, velocity and ultrasound."""
    with (FLIGHT / "imu.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    output = run([imu(r["t_stamp_s"], (r["ax"], r["ay"], -r["az"]), (r["wx"], r["wy"], r["wz"])) for r in rows])
    assert set(output) == {None}
    with (FLIGHT / "navdata.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    rows = [r for r in rows if r["motor1"] > 0 and r["altd_mm"] > 0]
    assert len(rows) > 7000
    assert set(run([velocity(r["t_stamp_s"], (1e-3 * r["vx_mm_s"], 1e-3 * r["vy_mm_s"], 0)) for r in rows])) == {None}
    assert set(run([Range(at(r["t_stamp_s"]), 1e-3 * r["altd_mm"], 0.02) for r in rows])) == {None}


S, MS = 1_000_000_000, 1_000_000


T = 10 * S


def at_ns(t: int) -> Stamp:
    return Stamp(MonoNs(t), MonoNs(t), 0.001, "sim")


def imu_at(t: int, f: float = 9.8, w: float = 0.1) -> Imu:
    return Imu(at_ns(t), np.array([w, 0.0, 0.0]), np.array([0.0, 0.0, -f]))


def vessel(t: int, v: float) -> VesselReport:
    return VesselReport(at_ns(t), np.array([0.0, v, 0.0]), np.eye(3), None, None)


def baro(t: int, height_m: float) -> Baro:
    return Baro(at_ns(t), height_m, 0.5)


def said(*events: Reading) -> list[Verdict | None]:
    state, out = SensorWatch(), []
    for event in events:
        state, verdict = watch_reading(state, event, LIMITS, True)
        out.append(verdict)
    return out


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_speed_is_that_of_the_components_that_were_measured(axis: int) -> None:
    var = np.full(3, 1e3)
    var[axis] = 0.01
    for speed, verdict in ((20.0, None), (-20.0, None), (20.01, Verdict.IMPOSSIBLE)):
        v = np.full(3, 500.0)
        v[axis] = speed
        assert said(BodyVelocity(at_ns(T), v, np.diag(var))) == [verdict]


@pytest.mark.parametrize(
    ("roll_rad", "pitch_rad"), [(2.315840312948539, -0.08309898974996566), (0.6869503213152144, -0.3514859733064353)]
)
def test_upside_down_is_a_step_though_rounding_puts_the_poles_farther_apart_than_two(roll_rad: float, pitch_rad: float) -> None:
    poles = [Rotation.from_rpy(roll_rad, pitch_rad, 1.0), Rotation.from_rpy(roll_rad + math.pi, -pitch_rad, 1.0)]
    assert math.dist(*(pole.matrix[2].tolist() for pole in poles)) > 2.0
    upright, over = (Attitude(at_ns(T + i * 20 * MS), pole, np.eye(3)) for i, pole in enumerate(poles))
    assert said(upright, over) == [None, Verdict.IMPOSSIBLE]


def test_readings_that_nobody_compares_may_step() -> None:
    assert said(imu_at(T, f=0.0), imu_at(T + MS, f=79.0)) == [None, None]
    assert said(vessel(T, 0.0), vessel(T + MS, 19.0)) == [None, None]


def test_a_reading_of_the_same_instant_or_from_before_is_compared_with_none() -> None:
    for t in (T, T - MS):
        assert said(baro(T, 0.0), baro(t, 30.0)) == [None, None]


def test_a_repeat_beyond_the_limits_is_impossible_first() -> None:
    assert said(imu_at(T, f=90.0), imu_at(T + S, f=90.0)) == [Verdict.IMPOSSIBLE] * 2
    assert said(imu_at(T), imu_at(T + 140 * MS), imu_at(T + 160 * MS)) == [None, None, Verdict.FROZEN]


def test_a_vessels_report_may_repeat_for_ever() -> None:
    assert said(vessel(T, 1.0), vessel(T + 3600 * S, 1.0)) == [None, None]
