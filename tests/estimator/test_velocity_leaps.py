"""A velocity that the accelerometer contradicts: it leaps, as with GNSS found on a ship under way, or the accelerometer errs."""

import math

import numpy as np
import pytest

from estimator.ekf import EkfOptions, Filter
from estimator.ekf.params import ACCEL_BIAS, DECK_RATE, VEL, VESSEL_VEL
from tests.estimator.ekf.core_state import newest
from tests.make import attitude, imu, sighting, stamp, velocity

BEGIN_S = 100.0
PAD = (0.0, 0.0, 3.0)


def after_leap(leap_ms: int, by_m_s: float, *, sighted: bool) -> Filter:
    """Return the filter 2 s after the velocity of a body at rest over a deck leapt, which its accelerometer did not feel."""
    ekf = Filter(EkfOptions(velocity_is_over="ground"))
    for ms in range(0, leap_ms + 2000, 20):
        now = stamp(BEGIN_S + 1e-3 * ms)
        ekf.put([imu(now)])
        if ms % 100 == 0:
            v = (by_m_s if ms >= leap_ms else 0.0, 0.0, 0.0)
            ekf.put([attitude(now, var=math.radians(0.5) ** 2)])
            ekf.put([velocity(now, v, var=0.1**2)])
        if sighted and ms % 40 == 0:
            ekf.put([sighting(now, PAD, var=4e-4, yaw_var=1e-4, seq=ms, confidence=1.0)])
    return ekf


@pytest.mark.parametrize(("sighted", "by_m_s"), [(False, 1.5), (False, 3.0), (False, 6.0), (True, 3.0), (True, 6.0)])
@pytest.mark.parametrize("leap_ms", [800, 1500, 4000])
def test_a_leap_is_one_of_body_and_vessel_together(leap_ms: int, by_m_s: float, sighted: bool) -> None:
    b = newest(after_leap(leap_ms, by_m_s, sighted=sighted))
    assert b.x[VEL][0] == pytest.approx(by_m_s, rel=0.05)
    assert not sighted or b.x[VEL][0] - b.x[VESSEL_VEL][0] == pytest.approx(0.0, abs=0.1)
    assert np.abs(b.x[ACCEL_BIAS][:2]).max() < 0.05
    assert math.degrees(math.asin(abs(b.R[2, 0]))) < 0.3


@pytest.mark.parametrize("sighted", [False, True])
@pytest.mark.parametrize("off_m_s2", [(0.8, 0.8, 0.8), (-0.5, 0.0, 1.2), (0.0, 1.0, 0.0), (0.0, 0.0, -1.4)])
def test_an_accelerometer_that_begins_to_err_moves_neither_body_nor_deck(
    off_m_s2: tuple[float, float, float], sighted: bool
) -> None:
    """WHY: refused for good, the right velocity held nothing, and the deck ran away with the body at 10 m/s."""
    ekf = Filter(
        EkfOptions(
            velocity_is_over="ground",
            asd_accel_bias_m_s3=0.02,
            sigma_attitude_bias_rad=math.radians(0.5),
            sigma_velocity_scale=0.02,
        )
    )
    yaw_rad, begins_ms, worst_m_s = 0.9, 5000, 0.0
    for ms in range(0, begins_ms + 7000, 20):
        now = stamp(BEGIN_S + 1e-3 * ms)
        f = np.array([0.0, 0.0, -9.80665]) + np.array(off_m_s2) * (ms >= begins_ms)
        ekf.put([imu(now, f=f), attitude(now, 0.0, 0.0, yaw_rad, var=math.radians(0.5) ** 2)])
        if ms % 40 == 0:
            ekf.put([velocity(now, var=0.1**2)])
            if sighted or ms < begins_ms:
                ekf.put([sighting(now, PAD, var=4e-4, yaw_var=1e-4, seq=ms, confidence=1.0)])
        if ms > begins_ms + 4000:
            b = newest(ekf)
            worst_m_s = max(worst_m_s, *np.abs(b.x[VEL]), *np.abs(b.x[DECK_RATE[:3]] + (*b.x[VESSEL_VEL], 0.0)))
    assert worst_m_s < 0.5
    # Along the deck a tilt explains as much.
    assert newest(ekf).x[ACCEL_BIAS][2] == pytest.approx(off_m_s2[2], abs=0.2)
