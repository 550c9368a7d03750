"""The first attitude of a filter, one that replaces a diverged one, and a north that is known at last (core/filter/begin.c)."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64, Rotation, rpy_matrix, wrap_pi
from estimator.contracts.samples import Attitude
from estimator.ekf import EkfOptions, Event, Filter
from estimator.ekf.params import ATT_BIAS, ATT_ERR, PAD_YAW, POS_REL, FilterParams, N
from tests.estimator.ekf import oracle
from tests.estimator.ekf.core_state import TILTED, State, copied, correlated, heading, holding, known, newest, put
from tests.make import attitude, baro, imu, ns, range_down, sighting

OPTIONS = EkfOptions()
PARAMS = FilterParams(OPTIONS)
REST = np.array([0.0, 0.0, -9.80665])
AT_S = 500.0


def after(b: State | None, event: Event) -> tuple[State, Verdict]:
    """Return the state after an event, which agrees with the oracle's, and the verdict."""
    filter = Filter(OPTIONS) if b is None else holding(b, PARAMS)
    verdict, expected = put(filter, event).verdict, oracle.process(b, event, PARAMS)[0]
    found = newest(filter)
    np.testing.assert_allclose(found.x, expected.x, atol=1e-12)
    np.testing.assert_allclose(found.P, expected.P, atol=1e-12)
    return found, verdict


@pytest.mark.parametrize(
    "event",
    [
        baro(AT_S), range_down(AT_S, 1.0), sighting(AT_S), imu(AT_S, f=0.499 * REST), imu(AT_S, f=1.501 * REST),
    ],
)  # fmt: skip
def test_nothing_begins_without_a_way_down(event: Event) -> None:
    filter = Filter()
    assert put(filter, event).verdict is Verdict.NO_ATTITUDE
    assert filter.at(ns(AT_S)) is None


@pytest.mark.parametrize("size", [0.501, 1.0, 1.499])
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, -0.2), (-0.4, 0.5), (0.0, math.pi / 2), (3.0, -0.1)])
def test_an_accelerometer_shows_which_way_is_down_and_north_is_where_the_body_points(size, roll, pitch):
    R, w = rpy_matrix(roll, pitch, 0.0), np.array([0.1, -0.2, 0.3])
    b, verdict = after(None, imu(AT_S, w, size * R.T @ REST))
    assert verdict is Verdict.FUSED
    np.testing.assert_allclose(b.R, R, atol=1e-7)
    np.testing.assert_allclose([b.w, b.w_smooth], [w, w])
    assert (b.t_imu, b.heading_is_given, b.is_levelled) == (b.t, 0, 0)
    in_ned = R @ b.P[ATT_ERR, ATT_ERR] @ R.T
    np.testing.assert_allclose(in_ned, np.diag(np.radians([12.0, 12.0, 2.0]) ** 2), atol=1e-12)


def test_an_attitude_begins_as_it_is_reported_and_errs_by_its_own_constant_error_with_the_opposite_sign() -> None:
    event = Attitude(sighting(AT_S).stamp, Rotation(TILTED), np.diag([1e-4, 2e-4, 3e-3]))
    b, verdict = after(None, event)
    assert (verdict, b.heading_is_given, b.t_imu, b.bank.t) == (Verdict.FUSED, 1, -1, -1)
    for R in (b.R, b.levelled_by):
        np.testing.assert_allclose(R, TILTED)
    np.testing.assert_allclose(b.cov_levelled_by, event.cov_body)
    reads = np.zeros((2, N))
    reads[[0, 1], [0, 1]] = reads[[0, 1], ATT_BIAS] = 1.0
    # The reported tilt is the true one plus the constant error: their sum is known, each is not.
    np.testing.assert_allclose(np.diag(reads @ b.P @ reads.T), OPTIONS.sigma_initial_tilt_rad**2, rtol=0.3)
    assert np.diag(b.P)[ATT_BIAS] == pytest.approx(OPTIONS.sigma_attitude_bias_rad**2)
    assert np.linalg.eigvalsh(b.P).min() > -1e-9


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("var", "diverged"), [(0.122, False), (0.123, True)])
def test_an_attitude_known_to_less_than_twenty_degrees_is_replaced_outright(axis: int, var: float, diverged: bool) -> None:
    P = correlated()
    P[axis, axis] = var
    before, event = known(PARAMS, P=P), attitude(AT_S + 0.02, -0.2, 0.3, -1.0, var=[0.01, 0.02, 0.03])
    b, _ = after(before, event)
    if diverged:
        np.testing.assert_allclose([b.R, b.R_cov, b.levelled_by], [event.R_ned_body.matrix] * 3)
        assert (b.t, b.t_cov) == (event.stamp.measured_at,) * 2
        assert np.abs(b.P[ATT_ERR, POS_REL]).max() == 0.0
    else:
        assert np.abs(b.R - before.R).max() < 0.3


def test_north_that_is_known_at_last_turns_the_world_and_not_the_pad_below_the_body() -> None:
    before = Filter()
    for k in range(40):
        before.put([imu(AT_S + 0.01 * k)])
        before.put([sighting(AT_S + 0.01 * k, (1.0, 0.5, 3.0), 0.4, confidence=1.0)])
    turned, now = copied(before), ns(AT_S + 0.4)
    assert put(turned, attitude(AT_S + 0.4, yaw=1.2, var=[1e-4, 1e-4, 1e-3])).verdict is Verdict.FUSED
    one, two = before.at(now), turned.at(now)
    assert one.yaw_rad is not None
    assert two.yaw_rad == pytest.approx(one.yaw_rad, abs=0.01)
    np.testing.assert_allclose(two.d_body_pad_level, one.d_body_pad_level, atol=0.01)
    a, b = newest(before), newest(turned)
    assert heading(b.R) == pytest.approx(1.2, abs=1e-6)
    angle = 1.2 - heading(a.R)
    assert wrap_pi(float(b.x[PAD_YAW] - a.x[PAD_YAW])) == pytest.approx(wrap_pi(angle), abs=0.01)
    np.testing.assert_allclose(b.x[POS_REL], oracle.about_down(angle) @ a.x[POS_REL], atol=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_every_direction_of_the_world_turns_with_north(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before = known(PARAMS, heading_is_given=0, ins_p=rng.normal(size=3), ins_v=rng.normal(size=3))
    b, verdict = after(before, attitude(AT_S, *rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0)))
    Z: F64 = oracle.about_down(heading(b.R) - heading(before.R))
    assert (verdict, b.heading_is_given) == (Verdict.FUSED, 1)
    np.testing.assert_allclose([b.ins_p, b.ins_v], [Z @ before.ins_p, Z @ before.ins_v])
    np.testing.assert_allclose(b.x[POS_REL], Z @ before.x[POS_REL])
    np.testing.assert_allclose(b.P[POS_REL, POS_REL], Z @ before.P[POS_REL, POS_REL] @ Z.T)
    np.testing.assert_allclose(b.P, b.P.T, atol=1e-15)
