"""What widens a covariance does so, in its direction and by its amount; what ties two errors ties them with the right sign."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import Ekf, EkfOptions, at, start, step
from estimator.ekf.so3 import about_down, heading
from estimator.ekf.state import (
    ATT_BIAS,
    ATT_ERR,
    ATTITUDE,
    BARO_OFFSET,
    CAMERA_DELAY,
    HEIGHT,
    PAD_YAW,
    POS_REL,
    VEL,
    VEL_SCALE,
    VELOCITY,
    VESSEL_VEL,
    Belief,
)
from tests.estimator.ekf import flown as core
from tests.estimator.ekf.oracle import aiding, so3, vision_update
from tests.estimator.ekf.oracle.measure import BY_ATTITUDE
from tests.estimator.ekf.oracle.sighting import LinearizedMeasurement

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


def fed(*events: object, options: EkfOptions | None = None) -> Ekf:
    ekf = start(options)
    for event in events:
        ekf, _ = step(ekf, event)  # type: ignore[arg-type]
    return ekf


def belief(ekf: Ekf) -> Belief:
    assert ekf.belief is not None
    return ekf.belief


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


# While the frame's rate is poorly known


def compared(b: Belief, ekf: Ekf) -> LinearizedMeasurement:
    row, fix = vision_update._compared(b, sighting(1.3), ekf.params)
    assert fix is not None
    return row


def test_what_a_delay_may_cost_is_noise_while_the_image_s_rate_is_poorly_known() -> None:
    events: list[object] = [imu(0.0), attitude(0.0)]
    for k in range(1, 65):
        events += [imu(0.02 * k), attitude(0.02 * k), sighting(0.02 * k)]
    ekf = fed(*events)
    known = belief(ekf)
    x = known.x.copy()
    x[VEL] = x[VEL] + np.array([1.0, 0.0, 0.0])
    certain = 1e-6 * known.P
    certain[CAMERA_DELAY, CAMERA_DELAY] = known.P[CAMERA_DELAY, CAMERA_DELAY]
    P = certain.copy()
    P[6:9, 6:9] += np.eye(3) * 25.0
    known, vague = known._replace(x=x, P=certain), known._replace(x=x, P=P)
    sure, unsure = compared(known, ekf), compared(vague, ekf)
    assert np.any(sure.H[:, CAMERA_DELAY] != 0.0), "well known: the delay is learned"
    assert np.all(unsure.H[:, CAMERA_DELAY] == 0.0), "poorly known: nothing is learned of it"
    rate, var = sure.H[:, CAMERA_DELAY], float(vague.P[CAMERA_DELAY, CAMERA_DELAY])
    cov_rate = unsure.G.dot(vague.P).dot(unsure.G.T)
    expected = sure.R + var * np.outer(rate, rate)
    expected[:3, :3] += var * cov_rate
    np.testing.assert_allclose(unsure.R, expected, atol=1e-12)
    assert np.all(np.linalg.eigvalsh(unsure.R - sure.R) > -1e-12)
    assert unsure.R[0, 0] - sure.R[0, 0] > 0.5 * var * 25.0


# The first attitude


def test_an_attitude_taken_as_given_errs_by_its_own_constant_error_with_the_opposite_sign() -> None:
    """What the next attitude reads is attitude plus constant error: of the second nothing must show in it yet."""
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
    after, outcomes = step(before, attitude(0.4, yaw=1.2))
    assert outcomes[0].verdict is Verdict.FUSED
    now = MonoNs(EPOCH + 400_000_000)
    one, two = at(before, now), at(after, now)
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


# A sensor that contradicts for long


def flown() -> Belief:
    events: list[object] = [imu(0.0), attitude(0.0, yaw=0.7)]
    for k in range(1, 50):
        events += [imu(0.02 * k), attitude(0.02 * k, yaw=0.7), sighting(0.02 * k)]
    return belief(fed(*events))


def test_an_attitude_with_another_north_makes_all_directions_unsure_together_and_no_place() -> None:
    b = flown()
    innov = b.R.T[:, 2] * 0.5
    added = aiding._inflated(b, ATTITUDE, innov).P - b.P
    assert added[PAD_YAW, PAD_YAW] == pytest.approx(0.25)
    down = b.R.T[:, 2]
    across = added[ATT_ERR, ATT_ERR] - 0.25 * np.outer(down, down)
    np.testing.assert_allclose(across, np.eye(3) * 0.01, atol=1e-9)
    np.testing.assert_allclose(added[PAD_YAW, ATT_ERR], 0.25 * down, atol=1e-9)
    x, y, _ = b.x[POS_REL]
    np.testing.assert_allclose(added[PAD_YAW, POS_REL], 0.25 * np.array([-y, x, 0.0]), atol=1e-9)
    np.testing.assert_allclose(added[ATT_BIAS, ATT_BIAS], 0.1)
    # The pad under the body: what its place in `level` and the relative heading gain is nothing.
    yaw = so3.heading_row(b.R).dot(b.R)
    J = np.zeros(len(b.x))
    J[ATT_ERR], J[PAD_YAW] = yaw, -1.0
    turn_only = added.copy()
    turn_only[ATT_ERR, ATT_ERR] -= np.eye(3) * 0.01
    assert J.dot(turn_only).dot(J) == pytest.approx(0.0, abs=1e-9)


def test_a_velocity_that_contradicts_for_long_makes_body_and_vessel_unsure_together() -> None:
    b = flown()
    added = aiding._inflated(b, VELOCITY, np.array([0.6, -0.8, 3.0])).P - b.P
    for axis in range(2):
        v, u = VEL.start + axis, VESSEL_VEL.start + axis
        np.testing.assert_allclose([added[v, v], added[u, u], added[v, u], added[u, v]], 1.0)
    assert added[VEL.start, VEL.start + 1] == pytest.approx(0.0)
    assert added[VEL_SCALE, VEL_SCALE] == pytest.approx(0.01)
    relative = np.zeros(len(b.x))
    relative[VEL.start], relative[VESSEL_VEL.start] = -1.0, 1.0
    assert relative.dot(added).dot(relative) == pytest.approx(0.0, abs=1e-12), "the relative velocity is not its business"


def test_a_height_that_contradicts_for_long_makes_its_offset_unsure() -> None:
    b = flown()
    added = aiding._inflated(b, HEIGHT, np.array([-1.5])).P - b.P
    assert added[BARO_OFFSET, BARO_OFFSET] == pytest.approx(2.25)
    added[BARO_OFFSET, BARO_OFFSET] = 0.0
    assert not added.any()
