"""Inflation of a covariance: its direction and amount, and the sign of the correlation between two errors."""

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import EkfOptions, Filter
from estimator.ekf.state import ATT_BIAS, CAMERA_DELAY, PAD_YAW, POS_REL, VEL
from tests.estimator.ekf import flown as core
from tests.estimator.ekf.belief import Belief, copied, newest
from tests.estimator.ekf.oracle.measure import BY_ATTITUDE
from tests.estimator.ekf.oracle.so3 import about_down, heading

EPOCH = 1_000_000_000_000
REST = np.array([0.0, 0.0, -9.80665])


def stamp(t_s: float, sigma_s: float = 0.0) -> Stamp:
    at_ns = MonoNs(EPOCH + round(t_s * 1e9))
    return Stamp(at_ns, at_ns, sigma_s, "hw")


def attitude(t_s: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Attitude:
    return Attitude(stamp(t_s), Rotation.from_rpy(roll, pitch, yaw), np.diag([1e-4, 1e-4, 1e-3]))


def sighting(
    t_s: float, d: tuple[float, float, float] = (1.0, 0.5, 3.0), yaw: float | None = 0.4, sigma_s: float = 0.0
) -> Sighting:
    return Sighting(stamp(t_s, sigma_s), round(100 * t_s), "selected", np.array(d), yaw, False, np.diag([1e-4] * 3 + [1e-3]), 1.0)


def imu(t_s: float, w: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Imu:
    return Imu(stamp(t_s), np.array(w), REST)


def fed(*events: object, options: EkfOptions | None = None) -> Filter:
    ekf = Filter(options)
    for event in events:
        ekf.put([event])  # type: ignore[list-item]
    return ekf


def belief(ekf: Filter) -> Belief:
    return newest(ekf)


# The time of a sighting


def test_a_stamp_that_is_not_sure_adds_what_the_image_moves_in_that_time() -> None:
    b = belief(fed(imu(0.0), attitude(0.0), *(imu(0.01 * k) for k in range(1, 4)), sighting(0.03)))
    x = b.x.copy()
    x[VEL] = 2.0, -1.0, 0.5
    rows = [
        core.sighting(x, b.R, np.array([0.0, 0.0, 0.3]), sighting(0.04, sigma_s=sigma_s), b.levelled_by, np.zeros((3, 3)), 0.1)
        for sigma_s in (0.0, 0.02)
    ]
    rate = rows[0].H[:, CAMERA_DELAY]
    assert np.linalg.norm(rate[:3]) > 1.5, "it moves"
    np.testing.assert_allclose(rows[1].R - rows[0].R, np.outer(rate, rate) * 0.02**2, atol=1e-12)
    np.testing.assert_allclose(rows[0].innov, rows[1].innov)


# The first attitude


def test_an_attitude_taken_as_given_errs_by_its_own_constant_error_with_the_opposite_sign() -> None:
    """The next attitude reads attitude plus constant error; the constant error must not show in it yet."""
    options = EkfOptions()
    b = belief(fed(attitude(0.0, yaw=1.0), options=options))
    var = options.sigma_attitude_bias_rad**2
    for i in range(2):
        assert b.P[ATT_BIAS[i], ATT_BIAS[i]] == pytest.approx(var)
        assert b.P[i, ATT_BIAS[i]] == b.P[ATT_BIAS[i], i] == pytest.approx(-var)
        assert b.P[i, i] == pytest.approx(options.sigma_initial_tilt_rad**2 + var, rel=0.01)
    read = BY_ATTITUDE.dot(b.P).dot(BY_ATTITUDE.T)
    np.testing.assert_allclose(np.diag(read)[:2], options.sigma_initial_tilt_rad**2, rtol=0.01)
    assert np.linalg.eigvalsh(b.P).min() > -1e-9


def test_north_known_at_last_turns_the_world_and_not_the_pad_under_the_body() -> None:
    events: list[object] = [imu(0.0)]
    for k in range(1, 40):
        events += [imu(0.01 * k), sighting(0.01 * k)]
    before = fed(*events)
    after = copied(before)
    outcomes = after.put([attitude(0.4, yaw=1.2)])
    assert outcomes[0].verdict is Verdict.FUSED
    now = MonoNs(EPOCH + 400_000_000)
    one, two = before.at(now), after.at(now)
    assert one is not None
    assert two is not None
    assert one.yaw_rad is not None
    assert two.yaw_rad == pytest.approx(one.yaw_rad, abs=0.01)
    np.testing.assert_allclose(two.d_body_pad_level, one.d_body_pad_level, atol=0.01)
    turned, b = belief(after), belief(before)
    assert heading(turned.R) == pytest.approx(1.2, abs=1e-6)
    angle = 1.2 - heading(b.R)
    assert wrap_pi(float(turned.x[PAD_YAW] - b.x[PAD_YAW])) == pytest.approx(wrap_pi(angle), abs=0.01)
    np.testing.assert_allclose(turned.x[POS_REL], about_down(angle) @ b.x[POS_REL], atol=0.02)
