"""The heading is held by the gyro while the vehicle reports one that turns otherwise."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimator import pipeline
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Imu
from estimator.contracts.time import MonoNs, Stamp, after
from estimator.integrity.crosschecks import HeadingWatch, add_gyro, hold_heading
from estimator.integrity.options import IntegrityOptions
from estimator.options import EstimatorOptions

DT = 0.005
OPTIONS = IntegrityOptions()
TILT = (math.radians(6.0), math.radians(-4.0))
Error = Callable[[float, np.random.Generator], float]


def stamp(t_s: float) -> Stamp:
    at = MonoNs(round(t_s * 1e9))
    return Stamp(at, after(at, 0.004), 0.002, "sim")


def attitude(t_s: float, yaw_rad: float) -> Attitude:
    return Attitude(stamp(t_s), Rotation.from_rpy(*TILT, wrap_pi(yaw_rad)), np.diag([1e-4, 1e-4, 3e-3]))


def imu(t_s: float, yaw_rate_rad_s: float) -> Imu:
    w = Rotation.from_rpy(*TILT, 0.0).matrix.T @ np.array([0.0, 0.0, yaw_rate_rad_s])
    # A gyro that repeats its bits is refused as frozen.
    return Imu(stamp(t_s), w + 1e-9 * math.sin(1e3 * t_s), np.array([0.0, 0.0, -9.8]))


def flown(error_deg: Error, seconds: float = 10.0, bias_deg_s: float = 0.0, *, gyro: bool = True) -> F64:
    """(n, 3) deg: true heading, reported one and the one that is used, for a body that turns to and fro."""
    watch, rows, rng = HeadingWatch(), [], np.random.default_rng(3)
    for i in range(round(seconds / DT)):
        t = i * DT
        true, rate = math.radians(20.0) * math.sin(t), math.radians(20.0) * math.cos(t)
        if gyro:
            watch = add_gyro(watch, imu(t, rate + math.radians(bias_deg_s)))
        event = attitude(t, true + math.radians(error_deg(t, rng)))
        watch, used = hold_heading(watch, event, OPTIONS)
        assert used.R_ned_body.rpy_rad[:2] == pytest.approx(TILT, abs=1e-9)
        assert (used is event) is (watch.off_rad == 0.0)
        rows.append([true, event.R_ned_body.rpy_rad[2], used.R_ned_body.rpy_rad[2]])
    return np.degrees(rows)


def off_deg(rows: F64, column: int) -> F64:
    return np.asarray((rows[:, column] - rows[:, 0] + 180.0) % 360.0 - 180.0)


def test_a_heading_that_turns_as_the_body_does_passes_unchanged() -> None:
    rows = flown(lambda t, rng: 3.0 * math.sin(0.3 * t) + rng.normal(0.0, 0.5), bias_deg_s=0.8)
    np.testing.assert_array_equal(rows[:, 1], rows[:, 2])


@pytest.mark.parametrize(
    "error_deg",
    [
        lambda t, rng: 15.0 * max(0.0, t - 2.0),
        lambda t, rng: (50.0 + rng.normal(0.0, 5.0)) * (t > 2.0),
        lambda t, rng: 90.0 * (t > 2.0),
    ],
    ids=["drifts by 15 degrees a second", "bent by steel, noisy", "jumps by 90 degrees"],
)
def test_one_that_turns_by_itself_is_replaced_by_the_gyros(error_deg: Error) -> None:
    """WHY: such a compass turned the whole estimate; the pad seemed to be elsewhere, and the flight was given up."""
    rows = flown(error_deg)
    assert np.abs(off_deg(rows, 1)).max() > 45.0
    assert np.abs(off_deg(rows, 2)).max() < 12.0


def test_another_north_is_taken_over_in_time_and_without_a_large_jump() -> None:
    off = off_deg(flown(lambda t, rng: 30.0 * (t > 2.0), seconds=70.0), 2)
    assert off[-1] == pytest.approx(30.0)
    assert np.abs(np.diff(off)).max() < OPTIONS.heading_tolerance_deg + 0.1


def test_without_a_gyro_the_report_is_all_there_is() -> None:
    rows = flown(lambda t, rng: 15.0 * t, gyro=False)
    np.testing.assert_array_equal(rows[:, 1], rows[:, 2])


def test_frames_and_paths_get_the_held_heading() -> None:
    memory = pipeline.start(EstimatorOptions())
    for i in range(600):
        t = i * DT
        memory, _ = pipeline.step(memory, imu(t, 0.0))
        memory, _ = pipeline.step(memory, attitude(t, math.radians(60.0) * (t > 1.5) + 1e-9 * i))
    held = pipeline.attitude_at(memory, stamp(2.9))
    assert held is not None
    assert abs(math.degrees(held.R_ned_body.rpy_rad[2])) < 3.0
    assert abs(math.degrees(memory.guard.heading.off_rad)) > 50.0


MS = 1_000_000


def at(t: int) -> Stamp:
    return Stamp(MonoNs(t), MonoNs(t), 0.001, "sim")


def gyro(t_ms: int, rate_rad_s: float, t_ns: int = 0) -> Imu:
    return Imu(at(t_ms * MS + t_ns), np.array([0.0, 0.0, rate_rad_s]), np.array([0.0, 0.0, -9.8]))


def reported(t_ms: int, yaw_rad: float, t_ns: int = 0) -> Attitude:
    return Attitude(at(t_ms * MS + t_ns), Rotation.from_rpy(0.1, -0.2, yaw_rad), np.eye(3))


def held(rad: float = 0.0, *, at_ms: int = 0, turned_ms: int = 0, rate: float = 0.0, turned_rad: float = 0.0) -> HeadingWatch:
    return HeadingWatch(turned_rad, turned_ms * MS, rate, held_rad=rad, held_at=at_ms * MS)


def test_a_report_from_before_the_last_one_is_not_followed() -> None:
    watch, _ = hold_heading(held(at_ms=80, turned_ms=40), reported(40, 0.1), OPTIONS)
    assert watch.held_rad == 0.0
