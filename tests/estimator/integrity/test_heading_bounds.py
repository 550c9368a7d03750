"""The held heading at each edge: which gyro samples count, how far a report is followed, and from where on it is replaced."""

import math

import numpy as np
import pytest
from msgspec import structs

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.heading import HeadingWatch, steadied, turned
from estimator.integrity.options import IntegrityOptions

MS = 1_000_000
OPTIONS = structs.replace(IntegrityOptions(), heading_tolerance_deg=math.degrees(0.125), heading_slip_deg_s=math.degrees(0.5))


def at(t: int) -> Stamp:
    return Stamp(MonoNs(t), MonoNs(t), 0.001, "sim")


def gyro(t_ms: int, rate_rad_s: float, t_ns: int = 0) -> Imu:
    return Imu(at(t_ms * MS + t_ns), np.array([0.0, 0.0, rate_rad_s]), np.array([0.0, 0.0, -9.8]))


def reported(t_ms: int, yaw_rad: float, t_ns: int = 0) -> Attitude:
    return Attitude(at(t_ms * MS + t_ns), Rotation.from_rpy(0.1, -0.2, yaw_rad), np.eye(3))


def held(rad: float = 0.0, *, at_ms: int = 0, turned_ms: int = 0, rate: float = 0.0, turned_rad: float = 0.0) -> HeadingWatch:
    return HeadingWatch(turned_rad, turned_ms * MS, rate, held_rad=rad, held_at=at_ms * MS)


def test_the_turn_is_the_mean_of_two_rates_over_the_time_between() -> None:
    first = turned(HeadingWatch(), gyro(0, 0.2))
    assert (first.turned_rad, first.turned_at, first.rate_rad_s) == (0.0, 0, 0.2)
    assert turned(first, gyro(50, 0.4)).turned_rad == pytest.approx(0.015)


def test_it_is_about_the_vertical_of_the_newest_attitude() -> None:
    watch = HeadingWatch(0.0, 0, 0.0, down=(0.2, -0.3, 0.9))
    assert turned(watch, structs.replace(gyro(10, 0.0), w_body=np.array([1.0, 2.0, 3.0]))).rate_rad_s == pytest.approx(2.3)


def test_the_first_sample_and_one_after_a_gap_turn_nothing_and_the_heading_is_forgotten() -> None:
    began = turned(structs.replace(held(), turned_at=-1), gyro(20, 9.0))
    assert (began.turned_rad, began.turned_at, began.rate_rad_s, began.held_rad) == (0.0, 20 * MS, 9.0, None)
    assert turned(held(), gyro(100, 1.0)).held_rad == 0.0
    late = turned(held(turned_rad=1.0), gyro(100, 2.0, 1))
    assert (late.turned_rad, late.turned_at, late.rate_rad_s, late.held_rad) == (1.0, 100 * MS + 1, 2.0, None)


def test_a_sample_that_is_not_newer_is_passed_over() -> None:
    watch = held(turned_ms=50, rate=0.1)
    for t_ms in (40, 50):
        assert turned(watch, gyro(t_ms, 5.0)) is watch


def test_without_a_gyro_sample_nothing_is_held() -> None:
    event = reported(20, 1.0)
    watch, used = steadied(structs.replace(held(5.0), turned_at=-1, off_rad=4.0), event, OPTIONS)
    assert (watch.held_rad, watch.off_rad, used) == (None, 0.0, event)


@pytest.mark.parametrize("turned_ms", [0, 400])
def test_the_first_report_is_held_less_the_turn_up_to_its_own_instant(turned_ms: int) -> None:
    watch = structs.replace(held(turned_ms=turned_ms, rate=2.0, turned_rad=0.3), held_rad=None, held_at=-1, off_rad=4.0)
    event = reported(turned_ms + 50, 1.0)
    watch, used = steadied(watch, event, OPTIONS)
    assert watch.held_rad == pytest.approx(1.0 - 0.3 - 0.1)
    assert (watch.held_at, watch.off_rad, used) == ((turned_ms + 50) * MS, 0.0, event)


def test_beyond_the_tolerance_the_held_heading_is_used_with_the_reported_tilt() -> None:
    event = reported(40, 1.0)
    watch, used = steadied(held(turned_ms=40, turned_rad=0.3), event, OPTIONS)
    assert watch.off_rad == pytest.approx(0.7 - 0.005)
    assert used.R_ned_body.rpy_rad == pytest.approx((0.1, -0.2, 0.305))
    assert watch.down == pytest.approx(tuple(event.R_ned_body.matrix[2]))


def test_a_report_from_before_the_last_one_is_not_followed() -> None:
    watch, _ = steadied(held(at_ms=80, turned_ms=40), reported(40, 0.1), OPTIONS)
    assert watch.held_rad == 0.0


def test_half_a_turn_is_taken_the_short_way() -> None:
    watch, used = steadied(held(3.1, turned_ms=40), reported(40, -3.1), OPTIONS)
    assert watch.held_rad == pytest.approx(3.12)
    assert used.R_ned_body.rpy_rad[2] == pytest.approx(-3.1)
