"""A velocity that begins to be measured from somewhere else, as an autopilot's with its first GNSS fix on a ship under way."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import Ekf, EkfOptions, start, step
from estimator.ekf.state import ACCEL_BIAS, VEL, VESSEL_VEL

MS, T = 1_000_000, 100_000_000_000
AT_REST, PAD = np.array([0.0, 0.0, -9.80665]), np.array([0.0, 0.0, 3.0])


def stamp(ms: int) -> Stamp:
    return Stamp(MonoNs(T + ms * MS), MonoNs(T + ms * MS), 0.001, "sim")


def after_leap(leap_ms: int, by_m_s: float, *, sighted: bool) -> Ekf:
    """Return the filter 2 s after the velocity of a body at rest over a deck leapt, which its accelerometer did not feel."""
    ekf = start(EkfOptions(velocity_is_over="ground"))
    for ms in range(0, leap_ms + 2000, 20):
        now = stamp(ms)
        ekf, _ = step(ekf, Imu(now, np.zeros(3), AT_REST))
        if ms % 100 == 0:
            v = np.array([by_m_s if ms >= leap_ms else 0.0, 0.0, 0.0])
            ekf, _ = step(ekf, Attitude(now, Rotation.identity(), math.radians(0.5) ** 2 * np.eye(3)))
            ekf, _ = step(ekf, BodyVelocity(now, v, 0.1**2 * np.eye(3)))
        if sighted and ms % 40 == 0:
            ekf, _ = step(ekf, Sighting(now, ms, "fused", PAD, 0.0, False, np.diag([4e-4, 4e-4, 4e-4, 1e-4]), 1.0))
    return ekf


@pytest.mark.parametrize(("sighted", "by_m_s"), [(False, 1.5), (False, 3.0), (False, 6.0), (True, 3.0), (True, 6.0)])
@pytest.mark.parametrize("leap_ms", [800, 1500, 4000])
def test_a_leap_is_one_of_body_and_vessel_together(leap_ms: int, by_m_s: float, sighted: bool) -> None:
    b = after_leap(leap_ms, by_m_s, sighted=sighted).history.newest()
    assert b is not None
    assert b.x[VEL][0] == pytest.approx(by_m_s, rel=0.05)
    assert not sighted or b.x[VEL][0] - b.x[VESSEL_VEL][0] == pytest.approx(0.0, abs=0.1)
    assert np.abs(b.x[ACCEL_BIAS][:2]).max() < 0.05
    assert math.degrees(math.asin(abs(b.R[2, 0]))) < 0.3
