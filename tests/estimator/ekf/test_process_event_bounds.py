"""The vehicle's own samples against a belief made by hand: its beginning, what a sample may do, an attitude taken whole."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64, Rotation, rpy_matrix, wrap_pi
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Range, VesselReport
from estimator.ekf import Event
from estimator.ekf.state import ATT_BIAS, ATT_ERR, PAD_YAW, POS_REL, VEL, VESSEL_VEL, WAVES, N
from tests.estimator.ekf.belief import ATTITUDE, HEIGHT, RANGE, VELOCITY, Belief, initial, process_event
from tests.estimator.ekf.hand import LEVEL, MS, OPTIONS, TILTED, TOOLS, S, T, belief, correlated, imu, sighting, stamp, state
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.oracle.so3 import about_down

G = 9.80665
REST = np.array([0.0, 0.0, -G])
HOLD = 60 * MS


def told(R: F64, *, t: int = T, cov: F64 | None = None) -> Attitude:
    return Attitude(stamp(t), Rotation(R), np.diag([1e-4, 1e-4, 1e-3]) if cov is None else cov)


def folded(b: Belief | None, event: Event) -> tuple[Belief, Verdict]:
    after, outcome = process_event(b, event, TOOLS)
    assert after is not None
    return after, outcome.verdict


# The beginning


def test_nothing_begins_without_a_way_down() -> None:
    for event in (
        Baro(stamp(T), 1.0, 0.5),
        Range(stamp(T), 1.0, 0.1),
        sighting((0.0, 0.0, 2.0)),
        imu(T, (0.0, 0.0, 0.0), (0.0, 0.0, -0.499 * G)),
        imu(T, (0.0, 0.0, 0.0), (0.0, 0.0, -1.501 * G)),
    ):
        b, outcome = process_event(None, event, TOOLS)
        assert b is None
        assert outcome.verdict is Verdict.NO_ATTITUDE


@pytest.mark.parametrize("size", [0.501, 1.0, 1.499])
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, -0.2), (-0.4, 0.5), (0.0, math.pi / 2), (3.0, -0.1)])
def test_an_accelerometer_shows_which_way_is_down_and_points_the_world_ahead(size: float, roll: float, pitch: float) -> None:
    R = rpy_matrix(roll, pitch, 0.0)
    b, verdict = folded(None, imu(T, (0.1, -0.2, 0.3), size * R.T @ REST))
    assert verdict is Verdict.FUSED
    np.testing.assert_allclose(b.R, R, atol=1e-7)
    expected = initial(OPTIONS, T, b.R, math.radians(12.0), math.radians(2.0), b.sea)
    np.testing.assert_allclose(b.P, expected.P)
    np.testing.assert_allclose(b.x, expected.x)
    assert (b.t, b.t_imu, b.heading_is_given, b.levelled_by) == (T, T, False, None)
    for w in (b.w, b.w_smooth):
        np.testing.assert_allclose(w, [0.1, -0.2, 0.3])
    np.testing.assert_allclose(b.f, size * R.T @ REST)


def test_an_attitude_begins_as_it_is_reported_and_levels_what_is_seen() -> None:
    cov = np.diag([1e-4, 2e-4, 3e-3])
    b, verdict = folded(None, told(TILTED, cov=cov))
    assert verdict is Verdict.FUSED
    np.testing.assert_allclose(b.R, TILTED)
    assert b.levelled_by is not None
    np.testing.assert_allclose(b.levelled_by, TILTED)
    np.testing.assert_allclose(b.cov_levelled_by, cov)
    assert (b.heading_is_given, b.t, b.t_imu, b.sea.t) == (True, T, -1, -1)
    expected = initial(OPTIONS, T, TILTED, OPTIONS.sigma_initial_tilt_rad, OPTIONS.sigma_initial_heading_rad, b.sea).P.copy()
    bias = OPTIONS.sigma_attitude_bias_rad**2
    for axis, tilt in zip((0, 1), ATT_BIAS, strict=True):
        expected[axis, axis] += bias
        expected[axis, tilt] = expected[tilt, axis] = -bias
    np.testing.assert_allclose(b.P, expected)


# Samples of the IMU


def moving(**fields: object) -> Belief:
    """Return a sample of 10 ms ago holds: accelerating ahead and turning a little."""
    fields = {"t_imu": T, "w": (0.1, 0.2, 0.3), "w_smooth": (0.0, 0.1, 0.2), "f": (0.5, 0.5, 0.5 - G), **fields}
    return belief(**fields)  # type: ignore[arg-type]


def test_a_sample_carries_on_by_the_mean_of_it_and_the_one_before() -> None:
    b = moving(w=(0.0, 0.0, 0.0), w_smooth=(0.0, 0.0, 0.0))
    f = REST + np.array([1.5, -0.5, 2.5])
    after, verdict = folded(b, imu(T + 20 * MS, (0.0, 0.0, 0.4), f))
    assert verdict is Verdict.FUSED
    turned = so3.exp(np.array([0.0, 0.0, 0.2 * 0.02]))
    np.testing.assert_allclose(after.R, turned, atol=1e-9)
    np.testing.assert_allclose(after.dv, 0.02 * 0.5 * (LEVEL + turned) @ (REST + np.array([1.0, 0.0, 1.5])), atol=1e-9)
    assert (after.t, after.t_imu, after.t_cov) == (T + 20 * MS, T + 20 * MS, T)
    np.testing.assert_allclose(after.w, [0.0, 0.0, 0.4])
    np.testing.assert_allclose(after.f, f)
    # A first-order low-pass of 30 ms.
    np.testing.assert_allclose(after.w_smooth, [0.0, 0.0, 0.4 * (1.0 - math.exp(-0.02 / 0.03))], atol=1e-12)


def test_a_low_pass_comes_nearer_and_does_not_begin_again() -> None:
    b = moving()
    after, _ = folded(b, imu(T + 20 * MS, (1.0, 1.0, 1.0), np.add(b.f, 0.1)))
    share = 1.0 - math.exp(-0.02 / 0.03)
    np.testing.assert_allclose(after.w_smooth, (1.0 - share) * np.array(b.w_smooth) + share)


def test_a_sample_of_the_first_instant_holds_as_well() -> None:
    b = moving(t=0, t_imu=0, sighted=0)
    after, _ = folded(b, imu(20 * MS, np.add(b.w, 0.3), np.add(b.f, 0.2)))
    np.testing.assert_allclose(
        after.w_smooth, b.w_smooth + (1.0 - math.exp(-0.02 / 0.03)) * np.subtract(np.add(b.w, 0.3), b.w_smooth)
    )
    none = moving(t_imu=-1)
    after, verdict = folded(none, imu(T + 20 * MS, none.w, none.f))
    assert (verdict, after.t_imu) == (Verdict.FUSED, T + 20 * MS)
    np.testing.assert_allclose(after.w_smooth, none.w, err_msg="there was none to smooth it with")


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_beyond_what_a_vehicle_can_make_is_followed_part_of_the_way_and_the_rest_is_doubt(axis: int, sign: float) -> None:
    b = moving(f=np.zeros(3), w=np.zeros(3), jolt_var_m2_s2=0.1, jolt_var_rad2=0.2)
    e = sign * np.eye(3)[axis]
    for step_f, step_w in ((15.0, 4.0), (30.0, 1.0), (30.0, 0.0), (0.0, 8.0), (45.0, 12.0), (1.0, 8.0)):
        after, verdict = folded(b, imu(T + 20 * MS, step_w * e, step_f * e))
        assert verdict is Verdict.FUSED
        np.testing.assert_allclose(after.f, min(step_f, 15.0) * e, atol=1e-12)
        np.testing.assert_allclose(after.w, min(step_w, 4.0) * e, atol=1e-12)
        assert after.jolt_var_m2_s2 == pytest.approx(0.1 + (step_f > 15.0) * (step_f * 0.02) ** 2)
        assert after.jolt_var_rad2 == pytest.approx(0.2 + (step_w > 4.0) * (step_w * 0.02) ** 2)
        assert after.dv[axis] == pytest.approx(0.02 * 0.5 * min(step_f, 15.0) * sign, rel=0.01)


def test_a_step_is_one_from_the_sample_before_not_one_from_nothing() -> None:
    b = moving(f=np.full(3, 20.0), w=np.full(3, -5.0))
    after, _ = folded(b, imu(T + 20 * MS, np.full(3, -2.0), np.full(3, 10.0)))
    np.testing.assert_allclose(after.f, 10.0)
    np.testing.assert_allclose(after.w, -2.0)
    assert (after.jolt_var_m2_s2, after.jolt_var_rad2) == (0.0, 0.0)
    after, _ = folded(b, imu(T + 20 * MS, np.full(3, 3.0), np.full(3, -10.0)))
    np.testing.assert_allclose(after.f, 5.0)
    np.testing.assert_allclose(after.w, -1.0)


def test_a_pad_not_seen_for_half_a_minute_is_forgotten_by_any_sample() -> None:
    b = moving(sighted=T - 30 * S + 5 * MS)
    after, _ = folded(b, imu(T + 10 * MS, np.add(b.w, 0.1), b.f))
    assert (after.sighted, after.agreed) == (-1, 0)
    after, _ = folded(b, imu(T + 4 * MS, np.add(b.w, 0.1), b.f))
    assert after.sighted == b.sighted


# The other samples find their way


def test_each_kind_of_sample_goes_where_it_belongs() -> None:
    x = np.zeros(N)
    x[POS_REL], x[15] = (0.1, 0.0, 2.0), 1.0
    level = np.diag([0.01, 0.01, 0.01])
    b = belief(x=x, aids=(belief().aids[0]._replace(fused=T),) * 4)
    for event, kind in (
        (BodyVelocity(stamp(T + MS), np.zeros(3), level), VELOCITY),
        (Range(stamp(T + MS), 2.0, 0.1), RANGE),
        (Baro(stamp(T + MS), 2.0, 0.1), HEIGHT),
        (told(LEVEL, t=T + MS), ATTITUDE),
    ):
        after, verdict = folded(b, event)
        assert verdict is Verdict.FUSED
        assert [aid.gathered is not None for aid in after.aids] == [k == kind for k in range(4)]
    heading = VesselReport(stamp(T), None, None, 0.01, 0.1)
    after, verdict = folded(b._replace(heading_known=False), heading)
    assert verdict is Verdict.FUSED
    assert after.heading_known
    after, verdict = folded(b, sighting((0.1, 0.0, 2.0)))
    assert (verdict, after.sighted) == (Verdict.FUSED, T)


# An attitude


def test_an_attitude_is_gathered_with_its_innovation_and_levels_from_now_on() -> None:
    b = belief(TILTED, x=state(), aids=(belief().aids[0]._replace(fused=T),) * 4)
    R = TILTED @ so3.exp(np.array([0.02, -0.01, 0.03]))
    cov = np.diag([0.01, 0.02, 0.03])
    after, outcome = process_event(b, told(R, t=T, cov=cov), TOOLS)
    assert after is not None
    assert outcome.verdict is Verdict.FUSED
    assert outcome.innovation is not None
    np.testing.assert_allclose(outcome.innovation, np.array([0.02, -0.01, 0.03]) - [*b.x[ATT_BIAS], 0.0], atol=1e-9)
    assert after.levelled_by is not None
    np.testing.assert_allclose(after.levelled_by, R)
    np.testing.assert_allclose(after.cov_levelled_by, cov)
    np.testing.assert_allclose(after.R, TILTED)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("var", "astray"), [(0.122, False), (0.123, True)])
def test_an_attitude_known_to_less_than_twenty_degrees_is_replaced_outright(axis: int, var: float, astray: bool) -> None:
    assert 0.122 < 0.35**2 < 0.123
    P = correlated()
    P[axis, axis] = var
    b = belief(TILTED, x=state(), P=P, aids=(belief().aids[0]._replace(fused=T),) * 4)
    R = rpy_matrix(-0.2, 0.3, -1.0)
    cov = np.diag([0.01, 0.02, 0.03])
    after, verdict = folded(b, told(R, cov=cov))
    if not astray:
        np.testing.assert_allclose(after.R, TILTED)
        return
    assert verdict is Verdict.FUSED
    np.testing.assert_allclose(after.R, R)
    np.testing.assert_allclose(after.R_cov, R)
    np.testing.assert_allclose(after.x, b.x)
    assert after.levelled_by is not None
    np.testing.assert_allclose(after.levelled_by, R)
    np.testing.assert_allclose(after.cov_levelled_by, cov)
    np.testing.assert_allclose(after.P, _with_attitude_told(b.P, R), atol=1e-12)


def _with_attitude_told(P: F64, R: F64) -> F64:
    """Return the state after an attitude with a constant error."""
    P = P.copy()
    down, tilt_var, heading_var = R[2], OPTIONS.sigma_initial_tilt_rad**2, OPTIONS.sigma_initial_heading_rad**2
    bias = OPTIONS.sigma_attitude_bias_rad**2
    P[ATT_ERR, :] = P[:, ATT_ERR] = P[ATT_BIAS, :] = P[:, ATT_BIAS] = 0.0
    P[ATT_ERR, ATT_ERR] = tilt_var * np.eye(3) + (heading_var - tilt_var) * np.outer(down, down)
    for axis, tilt in zip((0, 1), ATT_BIAS, strict=True):
        P[axis, axis] += bias
        P[tilt, tilt] = bias
        P[axis, tilt] = P[tilt, axis] = -bias
    return P


def test_an_attitude_taken_outright_or_a_north_reported_first_is_one_of_now() -> None:
    """The belief is brought to the sample's instant before it is compared: what it knows of places is of that instant."""
    P = correlated()
    P[0, 0] = 0.2
    for fields in ({"P": P}, {"heading_is_given": False}):
        b = belief(TILTED, x=state(), **fields)
        after, _ = folded(b, told(TILTED, t=T + 20 * MS))
        assert (after.t, after.t_cov) == (T + 20 * MS, T + 20 * MS)
    ahead, _ = folded(belief(TILTED, x=state()), told(TILTED, t=T + 20 * MS))
    assert ahead.t == T + 20 * MS


def test_north_reported_first_turns_every_direction_of_the_world_and_what_is_known_of_it() -> None:
    x = state()
    b = belief(TILTED, x=x, heading_is_given=False, ins_p=np.array([1.0, 2.0, 3.0]), ins_v=np.array([4.0, -5.0, 6.0]))
    R = rpy_matrix(-0.05, 0.1, 2.0)
    after, verdict = folded(b, told(R))
    assert verdict is Verdict.FUSED
    Z = about_down(2.0 - 0.8)
    turn = np.eye(N)
    for part in (POS_REL, VEL):
        turn[part, part] = Z
    for k in range(4):
        turn[np.ix_(WAVES[:3, k], WAVES[:3, k])] = Z
    turn[VESSEL_VEL, VESSEL_VEL] = Z[:2, :2]
    expected = turn @ x
    expected[PAD_YAW] = wrap_pi(x[PAD_YAW] + 1.2)
    np.testing.assert_allclose(after.x, expected, atol=1e-12)
    np.testing.assert_allclose(after.P, _with_attitude_told(turn @ b.P @ turn.T, R), atol=1e-12)
    np.testing.assert_allclose(after.P, after.P.T)
    np.testing.assert_allclose(after.ins_p, Z @ b.ins_p)
    np.testing.assert_allclose(after.ins_v, Z @ b.ins_v)
    np.testing.assert_allclose(after.R, R)
    np.testing.assert_allclose(after.R_cov, R)
    assert after.heading_is_given
    assert after.levelled_by is not None
    np.testing.assert_allclose(after.levelled_by, R)
    again, _ = folded(after, told(R @ so3.exp(np.array([0.0, 0.0, 0.01])), t=T))
    np.testing.assert_allclose(again.x[POS_REL], after.x[POS_REL], atol=0.1)
