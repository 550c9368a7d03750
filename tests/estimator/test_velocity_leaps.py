"""A velocity that begins to be measured from somewhere else, as an autopilot's with its first GNSS fix on a ship under way."""

import math

import numpy as np
import pytest

from estimator.ekf import EkfOptions, Filter
from estimator.ekf.params import ACCEL_BIAS, VEL, VESSEL_VEL
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
