"""Frozen halves of an IMU, and what takes their place."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.parity import Half, TurnByAttitude, read_half, replace_halves, turn_between

MS = 1_000_000
T = 5_000_000_000


def stamp(t: int) -> Stamp:
    return Stamp(MonoNs(t), MonoNs(t), 0.001, "sim")


def attitude(t: int, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Attitude:
    return Attitude(stamp(t), Rotation.from_rpy(roll, pitch, yaw), 1e-4 * np.eye(3))


def frozen_after(values: list[bytes], step_ms: int, flying: bool = True) -> list[bool]:
    half, found, step = Half(), [], step_ms * MS
    for n, value in enumerate(values):
        same = n > 0 and value == values[n - 1]
        half = read_half(half, T + (n - 1) * step if same else None, T + n * step, 0.15, flying)
        found.append(half.frozen)
    return found


def test_a_half_that_repeats_itself_is_frozen_after_the_limit_and_back_at_once() -> None:
    found = frozen_after([b"a", b"b", *[b"c"] * 40, b"d", b"e"], 5)
    assert found.index(True) in (2 + 30, 2 + 31), "150 ms after its first reading"
    assert found[-2:] == [False, False]
    assert all(found[33:42])


def test_what_stands_on_the_ground_repeats_itself_and_is_not_frozen() -> None:
    assert not any(frozen_after([b"a"] * 400, 5, flying=False))


def test_readings_that_toggle_between_two_values_are_not_frozen() -> None:
    assert not any(frozen_after([b"a", b"a", b"b", b"b"] * 100, 5))


def test_a_sensor_of_coarse_steps_gets_the_time_that_it_has_needed_before() -> None:
    def runs(*of_ms: int) -> list[bytes]:
        return [bytes([n]) for n, ms in enumerate(of_ms) for _ in range(ms // 10)]

    assert not any(frozen_after(runs(20, 60, 100, 140, 250, 400, 20), 10)), "each longer one within three times the one before"
    assert any(frozen_after(runs(20, 20, 250), 10))
    assert any(frozen_after(runs(60, 100, 140, 1300), 10)), "nothing excuses a second"


@settings(max_examples=60)
@given(st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3), st.floats(-3.0, 3.0))
def test_the_turn_between_two_attitudes_is_their_rotation_vector(turn: list[float], yaw: float) -> None:
    first = Rotation.from_rpy(0.2, -0.1, yaw)
    second = first @ Rotation.from_rotvec(np.array(turn))
    a, b = (Attitude(stamp(T), R, 1e-4 * np.eye(3)) for R in (first, second))
    assert turn_between(a, b) == pytest.approx(tuple(turn), abs=1e-9)


def test_a_lost_gyro_is_replaced_by_the_turn_of_the_attitude_while_there_is_one() -> None:
    turn = TurnByAttitude()
    for n in range(20):
        turn = turn.after(attitude(T + 5 * n * MS, roll=0.5 * 0.005 * n))
    imu = Imu(stamp(T + 97 * MS), np.array([9.0, 9.0, 9.0]), np.array([0.1, 0.2, -9.8]))
    left = replace_halves(imu, 0.005, 0.0, turn)
    assert left is not None
    assert left.w_body == pytest.approx((0.5, 0.0, 0.0), abs=1e-9)
    assert (left.gyro_lost_s, left.accel_lost_s) == (0.005, 0.0)
    assert left.f_body is imu.f_body
    late = Imu(stamp(T + 400 * MS), imu.w_body, imu.f_body)
    assert replace_halves(late, 0.005, 0.0, turn) is None, "nothing says how it turns by now"
    accel = replace_halves(late, 0.0, 0.155, turn)
    assert accel is not None
    assert accel.w_body is imu.w_body
    assert math.isclose(accel.accel_lost_s, 0.155)
